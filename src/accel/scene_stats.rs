//! Primitive counts of a scene by who intersects them: the backend's native triangles, or user-geometry callbacks.

use crate::scene::{Geometry, Instance, Scene};

/// Number of objects of each kind in a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PrimitiveCounts {
    /// Triangles of meshes whose object space is world space, counted once per instance.
    pub world_triangles: usize,
    /// Instances of meshes with a transform other than the identity.
    pub placed_meshes: usize,
    /// Instances of bounded analytic shapes.
    pub shapes: usize,
    /// Points of clouds, counted once per instance.
    pub points: usize,
    /// Infinite planes, which are outside all structures.
    pub planes: usize,
}

impl PrimitiveCounts {
    /// Counts the primitives of a validated scene.
    pub fn of(scene: &Scene) -> PrimitiveCounts {
        let mut contents = PrimitiveCounts::default();
        for instance in &scene.instances {
            contents.count(&scene.geometries[instance.geometry as usize], instance);
        }
        contents
    }

    /// Returns the number of objects that Embree intersects by callbacks if it has no instances of its own.
    pub fn user_geometry(&self) -> usize {
        self.placed_meshes + self.shapes + self.points
    }

    fn count(&mut self, geometry: &Geometry, instance: &Instance) {
        match geometry {
            Geometry::Mesh(mesh) if mesh.triangles.is_empty() => {}
            Geometry::Mesh(mesh) if instance.is_identity() => self.world_triangles += mesh.triangles.len(),
            Geometry::Mesh(_) => self.placed_meshes += 1,
            shape if shape.is_unbounded() => self.planes += 1,
            Geometry::Shape(_) => self.shapes += 1,
            Geometry::Points(cloud) => self.points += cloud.len(),
        }
    }
}
