//! The whole of a scene file as it is written.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Deserialize;

use super::camera::CameraForm;
use super::light::{BackgroundForm, LampForm, LightForm};
use super::material::MaterialForm;
use super::placement::{Repeat, Scatter, Step};
use super::shape::{ShapeForm, ShapeRef};
use super::texture::TextureForm;
use super::value::{At, Color, OneOrMany};
use super::volume::{FogForm, VolumeForm};
use crate::scene::image_settings::{
    DEFAULT_DEPTH, DEFAULT_SIZE, DEFAULT_SPP, DEFAULT_WAVELENGTHS, FilterKind, Pattern,
};

/// A scene for whit.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "whit scene")]
pub(super) struct Document {
    /// How the scene is rendered where the command line does not say it.
    #[serde(default)]
    pub(super) output: Option<At<OutputForm>>,
    /// The lecture's ambient light Ia: radiance that surfaces get from all around; black if absent.
    pub(super) ambient: Option<Color>,
    /// What a ray sees that hits nothing; the ambient light if absent.
    pub(super) background: Option<BackgroundForm>,
    /// One camera or several; the first is the usual one.
    #[serde(default)]
    #[schemars(with = "Option<OneOrMany<CameraForm>>")]
    pub(super) camera: OneOrMany<CameraForm>,
    /// What fills all space.
    pub(super) fog: Option<At<FogForm>>,
    /// Smoke, fire and scans.
    #[serde(default)]
    pub(super) volume: Vec<At<VolumeForm>>,
    /// Lights.
    #[serde(default)]
    pub(super) light: Vec<At<LightForm>>,
    /// Materials by name.
    #[serde(default)]
    pub(super) material: BTreeMap<String, At<MaterialForm>>,
    /// Textures by name.
    #[serde(default)]
    pub(super) texture: BTreeMap<String, At<TextureForm>>,
    /// Shapes by name, for objects that share one.
    #[serde(default)]
    pub(super) shape: BTreeMap<String, At<ShapeForm>>,
    /// Groups of objects by name, for objects that place them.
    #[serde(default)]
    pub(super) group: BTreeMap<String, At<GroupForm>>,
    /// What stands in the world.
    #[serde(default)]
    pub(super) object: Vec<At<ObjectForm>>,
}

/// How the scene is rendered where the command line does not say it.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct OutputForm {
    /// Width and height in pixels.
    #[schemars(extend("default" = DEFAULT_SIZE))]
    pub(super) size: Option<[u32; 2]>,
    /// Samples a pixel.
    #[schemars(extend("default" = DEFAULT_SPP))]
    pub(super) spp: Option<u32>,
    /// How samples lie in a pixel.
    #[schemars(extend("default" = Pattern::default()))]
    pub(super) pattern: Option<Pattern>,
    /// How samples become a pixel.
    #[schemars(extend("default" = FilterKind::default()))]
    pub(super) filter: Option<FilterKind>,
    /// Radius of the filter in pixels, 1 to 4; tent 1, gaussian 1.5, mitchell 2 if absent.
    pub(super) filter_radius: Option<f64>,
    /// Generations of secondary rays.
    #[schemars(extend("default" = DEFAULT_DEPTH))]
    pub(super) depth: Option<u32>,
    /// Wavelengths that a path splits into where glass disperses it, 1 to 400.
    #[schemars(extend("default" = DEFAULT_WAVELENGTHS))]
    pub(super) wavelengths: Option<u32>,
    /// Stops of exposure of PNG images.
    #[schemars(extend("default" = 0))]
    pub(super) exposure: Option<f32>,
}

/// Objects that are placed together.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct GroupForm {
    /// Its objects.
    pub(super) object: Vec<At<ObjectForm>>,
}

/// Something in the world: exactly one of `shape`, `group`, `gltf` and `include`, and where it stands.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ObjectForm {
    /// What messages call it.
    pub(super) name: Option<At<String>>,
    /// A shape, or the name of one.
    pub(super) shape: Option<At<ShapeRef>>,
    /// The name of a group.
    pub(super) group: Option<At<String>>,
    /// A .gltf or .glb file, beside this one, with its meshes and materials.
    pub(super) gltf: Option<At<String>>,
    /// Another scene file, beside this one, with its objects; names in it are its own.
    pub(super) include: Option<At<String>>,
    /// The name of its material. Members of a group or an include keep their own; a glTF file's are replaced.
    pub(super) material: Option<At<String>>,
    /// What is done to it, in the order written: the first first.
    #[serde(default)]
    pub(super) transform: Vec<At<Step>>,
    /// What is done to it instead where the motion ends, which makes it move from the one to the other: the origin of
    /// its own space along a line, its scale evenly, its turn evenly the short way round, so by less than half a turn.
    pub(super) transform_end: Option<At<Vec<At<Step>>>>,
    /// Copies in a row, grid or block.
    pub(super) repeat: Option<At<Repeat>>,
    /// Copies at random places of a box.
    pub(super) scatter: Option<At<Scatter>>,
    /// Whether the lights of a glTF file or an include come with it.
    #[serde(default)]
    pub(super) lights: bool,
    /// Whether the cameras of a glTF file or an include come with it.
    #[serde(default)]
    pub(super) cameras: bool,
    /// Whether what shines of it lights the scene, on both sides: points of each such object that every surface asks
    /// for light, for each sample of a pixel; `true` for as many as of a light. Otherwise emission is only seen.
    pub(super) lamp: Option<At<LampForm>>,
}
