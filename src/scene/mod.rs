//! The scene as plain data: vectors linked by index. [`Scene::validate`] checks all of them.

mod area_light;
mod bake;
mod camera;
mod camera_placement;
mod effect;
mod emissive;
mod environment;
mod extension_use;
mod framing;
mod image_cache;
pub mod image_settings;
mod instance;
mod instance_transform;
mod lens;
mod lens_view;
mod light;
mod material;
mod material_layer;
pub(crate) mod mesh_cleanup;
mod normalise;
mod on_request;
mod texture;
mod validate;
mod validate_geometry;
mod validate_light;
mod validate_material;
mod validate_value;
mod volumes;

use std::collections::HashSet;

pub use area_light::{
    AreaLight, AreaLightError, DiskLight, LightSample, MeshLight, QuadLight, ShapeLight, SphereLight,
};
pub(crate) use area_light::{LightSamplePacket, LightView, SurfacePoint};
pub(crate) use camera::axes_looking_along;
pub use camera::{Camera, CameraRay, CameraView, Projection, Shutter};
pub use camera_placement::{CameraPlacement, CameraRequest, DEFAULT_FOV, FramedView, LookAt, ViewSide};
pub use effect::{Effect, EffectOverrides, EffectSet};
pub use environment::BuiltInEnvironment;
pub use extension_use::{ExtensionSupport, ExtensionUse};
pub(crate) use image_cache::CachedImage;
pub use image_cache::{CacheStats, ImageCache};
pub use instance::Instance;
pub use instance_transform::InstanceTransform;
pub use lens::{Aperture, Lens, LensError};
pub use lens_view::LensView;
pub use light::{AreaShape, DEFAULT_LIGHT_SAMPLES, Falloff, Light, LightKind};
pub use material::{
    AlphaMode, DEFAULT_IOR, MAX_ROUGH_RAYS, MIRROR_ROUGHNESS, Material, Medium, MediumKind,
    MetallicRoughness, Model, Phong, Translucency,
};
pub use material_layer::{Anisotropy, Clearcoat, Iridescence, Sheen};
pub use normalise::Normalisation;
pub use on_request::{Caustics, Interreflection};
pub use texture::{
    Encoding, Filter, Image, MaterialInput, Pattern, Procedural, Sampler, Space, Texels, Texture,
    TextureBinding, TextureUse, UvTransform, Wrap,
};
pub use validate::{SceneError, ValidScene};
// Parts of materials
pub use crate::optics::subsurface::{Scattering, SubsurfacePreset};
pub use crate::optics::{Absorption, Cauchy, Dispersion, Sellmeier};
pub(crate) use validate::check_camera;
pub(crate) use validate_light::{MAX_LIGHT_SAMPLES, check_light};
pub(crate) use validate_material::{MAX_OPAQUE_IOR, check_factors, check_procedural, check_scattering};

use crate::mesh::{Mesh, PointCloud};
use crate::numeric::Bounds;
use crate::shape::{Implicit, Shape};
use crate::volume::{Fog, Volume};

/// Everything that is rendered. Lengths are metres unless a file says otherwise, colours linear RGB.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Meshes, analytic shapes and point clouds, each in its object space.
    pub geometries: Vec<Geometry>,
    /// Transforms and materials of geometries in the world. A hit reports the index of its instance.
    pub instances: Vec<Instance>,
    /// Materials that instances refer to.
    pub materials: Vec<Material>,
    /// Images with their samplers, and procedural textures.
    pub textures: Vec<Texture>,
    /// Decoded images that textures refer to.
    pub images: Vec<Image>,
    /// Lights, in world space.
    pub lights: Vec<Light>,
    /// Cameras, in world space; the first is the default one.
    pub cameras: Vec<Camera>,
    /// Animations of the source files; the scene is one moment of them.
    pub animations: Vec<Animation>,
    /// Heterogeneous volumes such as smoke, fire and scans, in world space; they may overlap.
    pub volumes: Vec<Volume>,
    /// Fog, a medium that fills all space.
    pub fog: Option<Fog>,
    /// Constant ambient radiance Ia of Phong and Whitted's model, linear RGB.
    pub ambient: [f32; 3],
    /// Radiance of rays that miss the scene.
    pub background: Background,
    /// Settings of interreflection; `None` if it is not requested.
    pub interreflection: Option<Interreflection>,
    /// Settings of caustics; `None` if they are not requested.
    pub caustics: Option<Caustics>,
    /// Names of the variants of materials that a glTF file has.
    pub variants: Vec<String>,
    /// Extensions that the source files state, by name.
    pub extensions: Vec<ExtensionUse>,
    /// Warnings about what was dropped or approximated while loading, one sentence each.
    pub warnings: Vec<String>,
    /// Map from the file's coordinates to world coordinates.
    pub normalisation: Normalisation,
}

/// Summary of an animation in a glTF file.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Animation {
    /// Name of the animation, or its number.
    pub name: String,
    /// Times in seconds of the first and of the last keyframe.
    pub seconds: [f64; 2],
    /// Number of animated node properties.
    pub channels: usize,
}

/// The radiance that comes from outside the scene, linear RGB.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Background {
    /// One radiance for all directions.
    Uniform([f32; 3]),
    /// A mix by the height of the direction: `horizon` for level directions, `up` and `down` for the vertical ones.
    Gradient {
        /// Radiance of level directions.
        horizon: [f32; 3],
        /// Radiance straight up, along +y.
        up: [f32; 3],
        /// Radiance straight down, along -y.
        down: [f32; 3],
    },
    /// An environment map, which also lights the scene: equirectangular, its top row at +y, its middle at -z and +x to
    /// the right of that.
    Environment {
        /// Index of the scene's image that holds the map; its texels are floats.
        image: u32,
        /// Rotation about +y in radians, counter-clockwise as seen from above.
        rotation: f64,
        /// Factor on the texels of the map.
        scale: f32,
        /// Directions into the map that each shading point samples; see [`LightKind::Area`]. With 0 the map lights
        /// nothing: rays see it, and the ambient light stands for its diffuse light.
        samples: u32,
    },
}

impl Default for Background {
    fn default() -> Background {
        Background::Uniform([0.0; 3])
    }
}

/// A primitive or mesh that rays can hit, in object space.
#[derive(Clone, Debug)]
pub enum Geometry {
    /// A mesh of indexed triangles.
    Mesh(Mesh),
    /// An analytic shape, such as a sphere, a torus or a quadric.
    Shape(Shape),
    /// A point cloud, whose points are spheres of one radius.
    Points(PointCloud),
}

impl Geometry {
    /// Returns the bounding box in object space; infinite for the plane.
    pub fn bounds(&self) -> Bounds {
        match self {
            Geometry::Mesh(mesh) => mesh.bounds(),
            Geometry::Shape(shape) => shape.bounds(),
            Geometry::Points(cloud) => cloud.bounds(),
        }
    }

    /// Returns whether no finite box contains the geometry: the infinite plane, which bounding volumes leave out.
    #[inline(always)]
    pub fn is_unbounded(&self) -> bool {
        matches!(self, Geometry::Shape(Shape::Plane))
    }

    /// Returns the point cloud; `None` for meshes and shapes.
    #[inline(always)]
    pub fn point_cloud(&self) -> Option<&PointCloud> {
        match self {
            Geometry::Points(cloud) => Some(cloud),
            Geometry::Mesh(_) | Geometry::Shape(_) => None,
        }
    }

    /// Returns whether the vertices or points have colours of their own.
    pub(crate) fn has_colors(&self) -> bool {
        match self {
            Geometry::Mesh(mesh) => mesh.colors.is_some(),
            Geometry::Points(cloud) => cloud.colors.is_some(),
            Geometry::Shape(_) => false,
        }
    }

    /// Returns the number of primitives: triangles of a mesh, points of a cloud, one for an analytic shape.
    pub fn primitive_count(&self) -> usize {
        match self {
            Geometry::Mesh(mesh) => mesh.triangles.len(),
            Geometry::Shape(_) => 1,
            Geometry::Points(cloud) => cloud.len(),
        }
    }
}

impl Scene {
    /// Returns the indices of images that some texture of a material uses whose effect is not in `without`.
    pub(crate) fn images_for(&self, without: EffectSet) -> HashSet<u32> {
        let mut wanted = HashSet::new();
        let is_simulated = |effect: Effect| !without.has(effect);
        for layer in self.materials.iter().flat_map(|material| &material.layers) {
            // Only images of simulated effects are needed
            if let Texture::Image { image, .. } = self.textures[layer.texture.texture as usize]
                && is_simulated(layer.effect())
            {
                wanted.insert(image);
            }
        }
        wanted
    }

    /// Returns the geometry of an instance.
    #[inline(always)]
    pub fn geometry_of(&self, instance: u32) -> &Geometry {
        &self.geometries[self.instances[instance as usize].geometry as usize]
    }

    /// Returns the world-space box around all instances except unbounded ones.
    pub fn bounds(&self) -> Bounds {
        let object_bounds: Vec<Bounds> = self.geometries.iter().map(Geometry::bounds).collect();
        self.bounds_from(&object_bounds)
    }

    /// Returns [`Scene::bounds`] from the bounds of the geometries.
    pub(crate) fn bounds_from(&self, object_bounds: &[Bounds]) -> Bounds {
        self.instances
            .iter()
            // The infinite plane has no box
            .filter(|i| !self.geometries[i.geometry as usize].is_unbounded())
            .map(|i| {
                i.world_bounds(
                    &self.geometries[i.geometry as usize],
                    &object_bounds[i.geometry as usize],
                )
            })
            .fold(Bounds::EMPTY, Bounds::union)
    }

    /// Returns the number of triangles in the world: those of a mesh count once for every instance of it.
    pub fn triangle_count(&self) -> usize {
        self.instances
            .iter()
            .map(|i| match &self.geometries[i.geometry as usize] {
                Geometry::Mesh(mesh) => mesh.triangles.len(),
                Geometry::Shape(_) | Geometry::Points(_) => 0,
            })
            .sum()
    }

    /// Returns the number of points in the world: those of a cloud count once for every instance of it.
    pub fn point_count(&self) -> usize {
        let clouds = self
            .instances
            .iter()
            .filter_map(|i| self.geometries[i.geometry as usize].point_cloud());
        clouds.map(PointCloud::len).sum()
    }
}
