//! The scene as plain data: vectors linked by index, all checks behind it after [`Scene::validate`].

mod bake;
mod camera;
mod light;
mod material;
mod normalise;
pub(crate) mod survey;
mod texture;
mod validate;

use glam::DAffine3;

pub use camera::{Camera, CameraView, Projection};
pub use light::{Falloff, Light, LightKind};
pub use material::{
    AlphaMode, DEFAULT_IOR, Interior, Lecture, MIRROR_ROUGHNESS, Material, MetallicRoughness, Model,
};
pub use normalise::Normalisation;
pub use texture::{
    Encoding, Filter, Image, Layer, Parameter, Pattern, Procedural, Sampler, Space, Texels, Texture,
    TextureUse, UvTransform, Wrap,
};
pub use validate::SceneError;
pub(crate) use validate::{check_camera, check_light, check_procedural};

use crate::mesh::Mesh;
use crate::numeric::{self, Bounds, SingularMatrix};
use crate::shape::Sphere;

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
    /// Punctual lights, in world space.
    pub lights: Vec<Light>,
    /// Cameras, in world space; the first is the default one.
    pub cameras: Vec<Camera>,
    /// The lecture's ambient light Ia: what surfaces get from all around, linear RGB.
    pub ambient: [f32; 3],
    /// What a ray sees that hits nothing.
    pub background: Background,
    /// What was dropped or approximated while loading, one sentence each.
    pub warnings: Vec<String>,
    /// How world coordinates relate to the file's.
    pub normalisation: Normalisation,
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
    /// A sphere.
    Sphere(Sphere),
}

impl Geometry {
    /// The smallest box around it, in object space.
    pub fn bounds(&self) -> Bounds {
        match self {
            Geometry::Mesh(mesh) => mesh.bounds(),
            Geometry::Sphere(sphere) => sphere.bounds(),
        }
    }

    /// How many primitives it holds: triangles of a mesh, one for an analytic shape.
    pub fn primitive_count(&self) -> usize {
        match self {
            Geometry::Mesh(mesh) => mesh.triangles.len(),
            Geometry::Sphere(_) => 1,
        }
    }
}

/// A geometry placed in the world.
#[derive(Clone, Debug)]
pub struct Instance {
    /// What messages call it: the node's name or number.
    pub name: String,
    /// Index into [`Scene::geometries`].
    pub geometry: u32,
    /// Index into [`Scene::materials`].
    pub material: u32,
    /// Object to world.
    pub world_from_object: DAffine3,
    /// World to object, the checked inverse.
    pub object_from_world: DAffine3,
}

impl Instance {
    /// Places `geometry` by `world_from_object`.
    pub fn new(
        name: impl Into<String>,
        geometry: u32,
        material: u32,
        world_from_object: DAffine3,
    ) -> Result<Instance, SingularMatrix> {
        Ok(Instance {
            name: name.into(),
            geometry,
            material,
            world_from_object,
            object_from_world: numeric::inverse(&world_from_object)?,
        })
    }

    /// Whether object space is world space, as it is for every baked mesh.
    pub fn is_identity(&self) -> bool {
        self.world_from_object == DAffine3::IDENTITY
    }

    /// Whether the placement turns left into right, so that windings seen from the front run clockwise.
    pub fn is_mirrored(&self) -> bool {
        self.world_from_object.matrix3.determinant() < 0.0
    }
}

impl Scene {
    /// The geometry of an instance.
    #[inline(always)]
    pub fn geometry_of(&self, instance: u32) -> &Geometry {
        &self.geometries[self.instances[instance as usize].geometry as usize]
    }

    /// The box around all instances, in world space.
    pub fn bounds(&self) -> Bounds {
        let object_bounds: Vec<Bounds> = self.geometries.iter().map(Geometry::bounds).collect();
        self.instances
            .iter()
            .map(|i| object_bounds[i.geometry as usize].transformed(&i.world_from_object))
            .fold(Bounds::EMPTY, Bounds::union)
    }

    /// Triangles as they are seen: those of a geometry count once for every instance of it.
    pub fn triangle_count(&self) -> usize {
        self.instances
            .iter()
            .map(|i| match &self.geometries[i.geometry as usize] {
                Geometry::Mesh(mesh) => mesh.triangles.len(),
                Geometry::Sphere(_) => 0,
            })
            .sum()
    }
}
