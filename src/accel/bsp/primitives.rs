//! Primitives of one tree, with consecutive indices.
//!
//! The world tree numbers the triangles of all baked meshes, the points of all clouds, the analytic shapes and the
//! instanced meshes in the order of their instances; the tree of an instanced mesh numbers its triangles. So the
//! smaller of two indices is also the smaller (instance, primitive), and ties are broken by comparing indices.

use glam::Vec3;

use super::piece::PrimitivePiece;
use crate::mesh::{Mesh, PointCloud};
use crate::numeric::Bounds;
use crate::parallel;
use crate::scene::{Geometry, Instance, Scene};

/// The primitives of one tree.
pub(super) struct Primitives<'s> {
    runs: Vec<PrimitiveRun<'s>>,
    count: usize,
}

/// Range of consecutive indices that belong to one instance.
pub(super) struct PrimitiveRun<'s> {
    /// First index of the range.
    pub(super) first: u32,
    /// Index of the instance in [`Scene::instances`].
    pub(super) instance: u32,
    /// Kind of the primitives in the range.
    pub(super) kind: RunKind<'s>,
}

/// Kind of the primitives in a run.
pub(super) enum RunKind<'s> {
    /// One index per triangle, in the space of the tree.
    Triangles(&'s Mesh),
    /// One index per point of an instanced cloud, each of which is intersected as a sphere.
    Points(&'s PointCloud, &'s Instance),
    /// One index for an object that is intersected as a whole, a shape or an instanced mesh, with its bounds in the
    /// tree's space.
    Whole(Bounds),
}

/// Choice of the primitives in the world tree.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Contents {
    /// All bounded primitives of the world.
    All,
    /// Shapes, points of clouds and instanced meshes, but no baked meshes.
    Objects,
}

impl<'s> Primitives<'s> {
    /// Collects the bounded primitives of the world; `None` if there are too many for 32-bit indices.
    pub(super) fn of_world(scene: &'s Scene, contents: Contents) -> Option<Primitives<'s>> {
        let mut world = Primitives {
            runs: Vec::with_capacity(scene.instances.len()),
            count: 0,
        };
        // Compute object bounds once per geometry, not per instance
        let object_bounds = parallel::map(scene.geometries.len(), &|index| scene.geometries[index].bounds());
        for (index, instance) in scene.instances.iter().enumerate() {
            let geometry = &scene.geometries[instance.geometry as usize];
            // Number baked meshes by triangle and clouds by point, other objects as a whole
            let kind = match geometry {
                Geometry::Mesh(_) if instance.is_identity() && contents == Contents::Objects => continue,
                Geometry::Mesh(mesh) if instance.is_identity() => RunKind::Triangles(mesh),
                Geometry::Points(cloud) => RunKind::Points(cloud, instance),
                _ if geometry.is_unbounded() => continue,
                _ => {
                    let bounds = &object_bounds[instance.geometry as usize];
                    RunKind::Whole(instance.world_bounds(geometry, bounds))
                }
            };
            world.push(index as u32, kind)?;
        }
        Some(world)
    }

    /// Collects the triangles of one mesh in object space; `None` if there are too many for 32-bit indices.
    pub(super) fn of_mesh(mesh: &'s Mesh) -> Option<Primitives<'s>> {
        let mut object = Primitives {
            runs: Vec::with_capacity(1),
            count: 0,
        };
        object.push(0, RunKind::Triangles(mesh))?;
        Some(object)
    }

    fn push(&mut self, instance: u32, kind: RunKind<'s>) -> Option<()> {
        let count = match &kind {
            RunKind::Triangles(mesh) => mesh.triangles.len(),
            RunKind::Points(cloud, _) => cloud.len(),
            RunKind::Whole(bounds) => usize::from(!bounds.is_empty()),
        };
        if count == 0 {
            return Some(());
        }
        self.runs.push(PrimitiveRun {
            first: u32::try_from(self.count).ok()?,
            instance,
            kind,
        });
        self.count += count;
        // The largest index marks an empty slot.
        (self.count < u32::MAX as usize).then_some(())
    }

    /// Returns the bytes of the list of runs.
    pub(super) fn byte_count(&self) -> u64 {
        (self.runs.capacity() * size_of::<PrimitiveRun>()) as u64
    }

    /// Returns the number of primitives other than triangles.
    pub(super) fn object_count(&self) -> usize {
        let counts = self.runs.iter().map(|run| match run.kind {
            RunKind::Triangles(_) => 0,
            RunKind::Points(cloud, _) => cloud.len(),
            RunKind::Whole(_) => 1,
        });
        counts.sum()
    }

    /// Returns the number of primitives.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Returns the run that an index belongs to.
    #[inline(always)]
    pub(super) fn run(&self, number: u32) -> &PrimitiveRun<'s> {
        match self.runs.as_slice() {
            [only] => only,
            runs => &runs[runs.partition_point(|run| run.first <= number) - 1],
        }
    }

    /// Returns the vertices of a triangle; `None` for all other primitives.
    #[inline(always)]
    pub(super) fn corners(&self, number: u32) -> Option<[Vec3; 3]> {
        let run = self.run(number);
        match run.kind {
            RunKind::Triangles(mesh) => Some(mesh.corners(number - run.first)),
            RunKind::Points(..) | RunKind::Whole(_) => None,
        }
    }

    /// Returns all primitives, unsplit, with their bounds.
    pub(super) fn pieces(&self) -> Vec<PrimitivePiece> {
        const CHUNK: usize = 1 << 12;
        // Allocate first, so that threads fill disjoint chunks
        let mut pieces: Vec<PrimitivePiece> = bytemuck::zeroed_vec(self.count);
        for run in &self.runs {
            let of_run = &mut pieces[run.first as usize..];
            match &run.kind {
                RunKind::Triangles(mesh) => {
                    let of_run = &mut of_run[..mesh.triangles.len()];
                    parallel::for_each_chunk_mut(of_run, CHUNK, &|chunk, pieces| {
                        for (i, piece) in ((chunk * CHUNK) as u32..).zip(pieces) {
                            *piece = PrimitivePiece::of_triangle(run.first + i, mesh.corners(i));
                        }
                    });
                }
                RunKind::Points(cloud, instance) => {
                    let of_run = &mut of_run[..cloud.len()];
                    parallel::for_each_chunk_mut(of_run, CHUNK, &|chunk, pieces| {
                        for (i, piece) in ((chunk * CHUNK) as u32..).zip(pieces) {
                            let (low, high) = instance.point_bounds(cloud, i).to_f32_outward();
                            *piece = PrimitivePiece::new(run.first + i, low, high);
                        }
                    });
                }
                RunKind::Whole(bounds) => {
                    let (low, high) = bounds.to_f32_outward();
                    of_run[0] = PrimitivePiece::new(run.first, low, high);
                }
            }
        }
        pieces
    }
}
