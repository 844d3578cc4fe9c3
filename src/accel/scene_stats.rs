//! What a structure is made of, by who answers for it: a backend's own triangles, or whoever is called back.

use crate::scene::{Geometry, Instance, Scene};

/// How many objects of each kind a scene shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PrimitiveCounts {
    /// Triangles of meshes whose object space is world space: those of several instances in it count each time.
    pub world_triangles: usize,
    /// Instances of meshes that stand elsewhere.
    pub placed_meshes: usize,
    /// Instances of analytic shapes with an end.
    pub shapes: usize,
    /// Infinite planes, which are outside all structures.
    pub planes: usize,
}

impl PrimitiveCounts {
    /// Those of a validated scene.
    pub fn of(scene: &Scene) -> PrimitiveCounts {
        let mut contents = PrimitiveCounts::default();
        for instance in &scene.instances {
            contents.count(&scene.geometries[instance.geometry as usize], instance);
        }
        contents
    }

    /// Objects that Embree asks about by callbacks, where it has no instances of its own.
    pub fn user_geometry(&self) -> usize {
        self.placed_meshes + self.shapes
    }

    fn count(&mut self, geometry: &Geometry, instance: &Instance) {
        match geometry {
            Geometry::Mesh(mesh) if mesh.triangles.is_empty() => {}
            Geometry::Mesh(mesh) if instance.is_identity() => self.world_triangles += mesh.triangles.len(),
            Geometry::Mesh(_) => self.placed_meshes += 1,
            shape if shape.is_unbounded() => self.planes += 1,
            Geometry::Shape(_) => self.shapes += 1,
        }
    }
}
