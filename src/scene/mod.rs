//! The scene as plain data: vectors linked by index, all checks behind it after [`Scene::validate`].

mod bake;
mod camera;
mod effect;
mod emissive;
mod image_cache;
pub mod image_settings;
mod instance;
mod instance_transform;
mod lens;
mod light;
mod material;
pub(crate) mod mesh_cleanup;
mod normalise;
mod texture;
mod validate;
mod validate_geometry;
mod validate_light;
mod validate_material;
mod volumes;

use std::collections::HashSet;

pub use camera::{Camera, CameraRay, CameraView, Projection, Shutter};
pub use effect::{Effect, EffectOverrides, EffectSet};
pub(crate) use image_cache::CachedImage;
pub use image_cache::{CacheStats, ImageCache};
pub use instance::Instance;
pub use instance_transform::InstanceTransform;
pub use lens::{Aperture, Lens, LensError, LensView};
pub use light::{AreaShape, Falloff, Light, LightKind};
pub use material::{
    AlphaMode, DEFAULT_IOR, Interior, Lecture, MAX_ROUGH_RAYS, MIRROR_ROUGHNESS, Material, MetallicRoughness,
    Model, Translucency,
};
pub use normalise::Normalisation;
pub use texture::{
    Encoding, Filter, Image, MaterialInput, Pattern, Procedural, Sampler, Space, Texels, Texture,
    TextureBinding, TextureUse, UvTransform, Wrap,
};
pub use validate::SceneError;
pub(crate) use validate::check_camera;
pub(crate) use validate_light::{MAX_LIGHT_SAMPLES, check_light};
pub(crate) use validate_material::{check_procedural, check_scattering};

use crate::mesh::Mesh;
use crate::numeric::Bounds;
use crate::shape::{Implicit, Shape};
use crate::volume::{Fog, Volume};

/// Everything that is rendered. Lengths are metres unless a file says otherwise, colours linear RGB.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// What can be hit, each in its object space.
    pub geometries: Vec<Geometry>,
    /// Where geometries stand. The index of an instance is what a hit reports.
    pub instances: Vec<Instance>,
    /// What surfaces are made of.
    pub materials: Vec<Material>,
    /// Images with the way they are sampled.
    pub textures: Vec<Texture>,
    /// Decoded images.
    pub images: Vec<Image>,
    /// Lights, in world space.
    pub lights: Vec<Light>,
    /// Cameras, in world space; the first is the default one.
    pub cameras: Vec<Camera>,
    /// Animations of the files that it was made of, of which it is one moment.
    pub animations: Vec<Animation>,
    /// Smoke, fire and scans, in world space; they may overlap.
    pub volumes: Vec<Volume>,
    /// What fills all space.
    pub fog: Option<Fog>,
    /// The lecture's ambient light Ia: what surfaces get from all around, linear RGB.
    pub ambient: [f32; 3],
    /// What a ray sees that hits nothing.
    pub background: Background,
    /// What was dropped or approximated while loading, one sentence each.
    pub warnings: Vec<String>,
    /// How world coordinates relate to the file's.
    pub normalisation: Normalisation,
}

/// What a glTF file can move.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Animation {
    /// Its name, or its number.
    pub name: String,
    /// Seconds of its first and of its last key.
    pub seconds: [f64; 2],
    /// Properties of nodes that it moves.
    pub channels: usize,
}

/// The radiance that comes from outside the scene, linear RGB.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Background {
    /// The same from everywhere.
    Uniform([f32; 3]),
    /// Mixed by the height of the direction: `horizon` level, `up` straight up and down.
    Gradient {
        /// Level.
        horizon: [f32; 3],
        /// Straight up.
        up: [f32; 3],
        /// Straight down.
        down: [f32; 3],
    },
    /// An image all around, which also lights the scene: equirectangular, its top row at +y, its middle at -z and +x to
    /// the right of that.
    Environment {
        /// Which of the scene's images; of floats.
        image: u32,
        /// Radians that it is turned by about +y, counter-clockwise as seen from above.
        rotation: f64,
        /// What its texels are multiplied by.
        scale: f32,
        /// Directions that each surface asks for light, at least 1; see [`LightKind::Area`].
        samples: u32,
    },
}

impl Default for Background {
    fn default() -> Background {
        Background::Uniform([0.0; 3])
    }
}

/// Something to hit, in object space.
#[derive(Clone, Debug)]
pub enum Geometry {
    /// A triangle mesh.
    Mesh(Mesh),
    /// An analytic shape.
    Shape(Shape),
}

impl Geometry {
    /// The smallest box around it, in object space; infinite for what has no end.
    pub fn bounds(&self) -> Bounds {
        match self {
            Geometry::Mesh(mesh) => mesh.bounds(),
            Geometry::Shape(shape) => shape.bounds(),
        }
    }

    /// Whether no box holds it: the infinite plane, which everything that goes by boxes leaves out.
    #[inline(always)]
    pub fn is_unbounded(&self) -> bool {
        matches!(self, Geometry::Shape(Shape::Plane))
    }

    /// How many primitives it holds: triangles of a mesh, one for an analytic shape.
    pub fn primitive_count(&self) -> usize {
        match self {
            Geometry::Mesh(mesh) => mesh.triangles.len(),
            Geometry::Shape(_) => 1,
        }
    }
}

impl Scene {
    /// The images that some layer of a material looks up whose effect is not among `without`.
    pub(crate) fn images_for(&self, without: EffectSet) -> HashSet<u32> {
        let mut wanted = HashSet::new();
        let is_simulated = |effect: Effect| !without.has(effect);
        for layer in self.materials.iter().flat_map(|material| &material.layers) {
            if let Texture::Image { image, .. } = self.textures[layer.texture.texture as usize]
                && is_simulated(layer.effect())
            {
                wanted.insert(image);
            }
        }
        wanted
    }

    /// The geometry of an instance.
    #[inline(always)]
    pub fn geometry_of(&self, instance: u32) -> &Geometry {
        &self.geometries[self.instances[instance as usize].geometry as usize]
    }

    /// The box around all instances but those without an end, in world space.
    pub fn bounds(&self) -> Bounds {
        let object_bounds: Vec<Bounds> = self.geometries.iter().map(Geometry::bounds).collect();
        self.bounds_from(&object_bounds)
    }

    /// [`Scene::bounds`] from the bounds of the geometries.
    pub(crate) fn bounds_from(&self, object_bounds: &[Bounds]) -> Bounds {
        self.instances
            .iter()
            .filter(|i| !self.geometries[i.geometry as usize].is_unbounded())
            .map(|i| {
                i.world_bounds(
                    &self.geometries[i.geometry as usize],
                    &object_bounds[i.geometry as usize],
                )
            })
            .fold(Bounds::EMPTY, Bounds::union)
    }

    /// Triangles as they are seen: those of a geometry count once for every instance of it.
    pub fn triangle_count(&self) -> usize {
        self.instances
            .iter()
            .map(|i| match &self.geometries[i.geometry as usize] {
                Geometry::Mesh(mesh) => mesh.triangles.len(),
                Geometry::Shape(_) => 0,
            })
            .sum()
    }
}
