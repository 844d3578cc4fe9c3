//! Top-level serde types of a scene file.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Deserialize;

use super::camera::CameraForm;
use super::light::{BackgroundForm, EmissiveForm, LightForm};
use super::material_form::MaterialForm;
use super::on_request::{CausticsForm, InterreflectionForm};
use super::placement::{Repeat, Scatter, Step};
use super::shape::{ShapeForm, ShapeRef};
use super::texture::TextureForm;
use super::value::{Color, Located, OneOrMany};
use super::visible_background::VisibleBackgroundForm;
use super::volume::{FogForm, VolumeForm};
use crate::accel::Backend;
use crate::image::ToneOperator;
use crate::scene::image_settings::{
    DEFAULT_DEPTH, DEFAULT_SIZE, DEFAULT_SPP, DEFAULT_WAVELENGTHS, FilterKind, Pattern,
};

/// A scene for whit.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "whit scene")]
pub(super) struct Document {
    /// Image settings; the command line overrides them.
    #[serde(default)]
    pub(super) output: Option<Located<OutputForm>>,
    /// Constant ambient radiance Ia that surfaces receive from all directions; black if absent.
    pub(super) ambient: Option<Color>,
    /// Radiance of rays that miss the scene; the ambient light if absent.
    pub(super) background: Option<BackgroundForm>,
    /// Diffuse light from surfaces to other surfaces, which makes a render several times as long.
    pub(super) interreflection: Option<InterreflectionForm>,
    /// Light that mirrors and refracting bodies throw onto diffuse surfaces.
    pub(super) caustics: Option<CausticsForm>,
    /// One camera or several; the first is the default one.
    #[serde(default)]
    #[schemars(with = "Option<OneOrMany<CameraForm>>")]
    pub(super) camera: OneOrMany<CameraForm>,
    /// A medium that fills all space.
    pub(super) fog: Option<Located<FogForm>>,
    /// Volumes such as smoke, fire and scans.
    #[serde(default)]
    pub(super) volume: Vec<Located<VolumeForm>>,
    /// Lights that illuminate the scene.
    #[serde(default)]
    pub(super) light: Vec<Located<LightForm>>,
    /// Materials by their names.
    #[serde(default)]
    pub(super) material: BTreeMap<String, Located<MaterialForm>>,
    /// Textures by their names.
    #[serde(default)]
    pub(super) texture: BTreeMap<String, Located<TextureForm>>,
    /// Shapes by name, for objects that share one.
    #[serde(default)]
    pub(super) shape: BTreeMap<String, Located<ShapeForm>>,
    /// Groups of objects by name, for objects that place them.
    #[serde(default)]
    pub(super) group: BTreeMap<String, Located<GroupForm>>,
    /// Objects in the world.
    #[serde(default)]
    pub(super) object: Vec<Located<ObjectForm>>,
}

/// Image settings; the command line overrides them.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct OutputForm {
    /// Width and height in pixels.
    #[schemars(extend("default" = DEFAULT_SIZE))]
    pub(super) size: Option<[u32; 2]>,
    /// Number of samples per pixel.
    #[schemars(extend("default" = DEFAULT_SPP))]
    pub(super) spp: Option<u32>,
    /// Pattern of the samples in a pixel.
    #[schemars(extend("default" = Pattern::default()))]
    pub(super) pattern: Option<Pattern>,
    /// Filter that weights samples into pixels.
    #[schemars(extend("default" = FilterKind::default()))]
    pub(super) filter: Option<FilterKind>,
    /// Radius of the filter in pixels, 1 to 4; tent 1, gaussian 1.5, mitchell 2 if absent.
    pub(super) filter_radius: Option<f64>,
    /// Number of generations of secondary rays.
    #[schemars(extend("default" = DEFAULT_DEPTH))]
    pub(super) depth: Option<u32>,
    /// Number of wavelengths that a path splits into where glass disperses it, 1 to 400.
    #[schemars(extend("default" = DEFAULT_WAVELENGTHS))]
    pub(super) wavelengths: Option<u32>,
    /// Stops of exposure of PNG images.
    #[schemars(extend("default" = 0))]
    pub(super) exposure: Option<f32>,
    /// Background that camera rays see which go straight into the distance; lights, mirrors and refraction keep that of
    /// the scene.
    #[schemars(extend("default" = "environment"))]
    pub(super) background: Option<VisibleBackgroundForm>,
    /// Tone mapping operator of PNG images, after exposure.
    #[schemars(extend("default" = ToneOperator::default()))]
    pub(super) tone_map: Option<ToneOperator>,
    /// Backend that finds the hits of rays; if absent, Embree where it is built in, else the BSP.
    pub(super) backend: Option<Backend>,
}

/// Objects that are placed together.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct GroupForm {
    /// Objects of the group.
    pub(super) object: Vec<Located<ObjectForm>>,
}

/// An object in the world: exactly one of `shape`, `group`, `gltf` and `include`, with its transform.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ObjectForm {
    /// Name of the object in messages.
    pub(super) name: Option<Located<String>>,
    /// A shape, or the name of one.
    pub(super) shape: Option<Located<ShapeRef>>,
    /// The name of a group.
    pub(super) group: Option<Located<String>>,
    /// A .gltf or .glb file, relative to this one, with its meshes and materials.
    pub(super) gltf: Option<Located<String>>,
    /// Another scene file, relative to this one, with its objects; names in it are its own.
    pub(super) include: Option<Located<String>>,
    /// The name of its material. Members of a group or an include keep their own; a glTF file's are replaced.
    pub(super) material: Option<Located<String>>,
    /// Transforms of the object, applied in the order written.
    #[serde(default)]
    pub(super) transform: Vec<Located<Step>>,
    /// Transforms of the object at the end of its motion, which make it move: the origin of its own space along a line,
    /// its scale evenly, its rotation evenly the short way round, so by less than half a turn.
    pub(super) transform_end: Option<Located<Vec<Located<Step>>>>,
    /// Copies in a row, grid or block.
    pub(super) repeat: Option<Located<Repeat>>,
    /// Copies at random positions in a box.
    pub(super) scatter: Option<Located<Scatter>>,
    /// Import of the lights of a glTF file or an include with the object.
    #[serde(default)]
    pub(super) lights: bool,
    /// Import of the cameras of a glTF file or an include with the object.
    #[serde(default)]
    pub(super) cameras: bool,
    /// Diameter of the points of a glTF file, in the units of their positions; otherwise it follows from their density.
    pub(super) point_size: Option<Located<f64>>,
    /// Illumination of the scene by the object's emission, on both sides: the number of points on each emissive object
    /// that every shading point samples, for each sample of a pixel; `true` for the default number of a light.
    /// Otherwise the emission is only visible.
    pub(super) lamp: Option<Located<EmissiveForm>>,
}
