//! Reference traversal kernel: one ray, one plane, one triangle at a time, the textbook traversal of a BSP tree.
//!
//! "Near side first; the other side if the ray crosses the boundary." Rounding errors require in addition:
//!
//! * Planes are thick by [`SlabError`], so that a hit which the triangle test reports a little beside the true triangle
//!   is found from both sides of a nearby plane.
//! * A ray that runs within a plane never divides by its zero component; it visits the side or sides it lies on.
//! * A hit counts wherever it lies, in this cell or not; the traversal ends only when everything left lies beyond it.
//!
//! It is slow on purpose: the fast kernels are tested against it.

use glam::Vec3;

use super::builder::{Branch, CellContent};
use super::error_bounds::{Line, SlabError};
use super::primitives::{Primitives, RunKind};
use super::two_level::{TreeLayout, TwoLevelTree};
use crate::accel::brute::ray_in;
use crate::accel::shape_query::{point_hit, shape_hit};
use crate::accel::{Hit, LANES, Query, RayPacket};
use crate::mesh::Mesh;
use crate::mesh::triangle::Shear;
use crate::numeric::Ray;
use crate::scene::Geometry;

/// A binary tree of planes, in depth-first order.
pub(super) struct PlaneTree {
    nodes: Vec<ReferenceNode>,
    numbers: Vec<u32>,
    slab_error: SlabError,
}

enum ReferenceNode {
    Leaf {
        first: u32,
        count: u32,
    },
    /// Inner node; the lower half follows it, the upper half is at index `above`.
    Split {
        axis: usize,
        position: f32,
        above: u32,
    },
}

/// Instruction of the visitor to the traversal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Continuation {
    /// Continue up to this parameter.
    Until(f32),
    /// Stop: the query is resolved.
    Done,
}

impl PlaneTree {
    /// Lays out a built tree.
    pub(super) fn new(root: &Branch) -> PlaneTree {
        let mut tree = PlaneTree {
            nodes: Vec::new(),
            numbers: Vec::new(),
            slab_error: SlabError::of(&root.cell),
        };
        tree.add(root);
        tree
    }

    fn add(&mut self, branch: &Branch) {
        match &branch.content {
            CellContent::Leaf(numbers) => {
                self.nodes.push(ReferenceNode::Leaf {
                    first: self.numbers.len() as u32,
                    count: numbers.len() as u32,
                });
                self.numbers.extend_from_slice(numbers);
            }
            CellContent::Split {
                axis,
                position,
                halves,
            } => {
                let here = self.nodes.len();
                // Reserve the node until the index of the upper half is known
                self.nodes.push(ReferenceNode::Leaf { first: 0, count: 0 });
                self.add(&halves[0]);
                let above = self.nodes.len() as u32;
                self.nodes[here] = ReferenceNode::Split {
                    axis: *axis,
                    position: *position,
                    above,
                };
                self.add(&halves[1]);
            }
        }
    }

    /// Calls `visit` for every primitive that the line may hit between `t_near` and `t_far`, nearest cells first;
    /// `visit` returns how far the traversal must still go.
    pub(super) fn traverse(
        &self,
        origin: Vec3,
        direction: Vec3,
        [t_near, t_far]: [f32; 2],
        mut visit: impl FnMut(u32) -> Continuation,
    ) {
        let line = Line::new(origin.to_array(), direction.to_array());
        let mut end = t_far;
        let mut waiting = vec![(0u32, t_near, t_far)];
        // Pop a cell; skip it if it lies beyond the nearest hit
        while let Some((index, enter, leave)) = waiting.pop() {
            if enter > end {
                continue;
            }
            match self.nodes[index as usize] {
                ReferenceNode::Leaf { first, count } => {
                    for &number in &self.numbers[first as usize..][..count as usize] {
                        match visit(number) {
                            Continuation::Until(t) => end = t,
                            Continuation::Done => return,
                        }
                    }
                }
                ReferenceNode::Split {
                    axis,
                    position,
                    above,
                } => {
                    // Intersect the line with both half spaces
                    let [low, high] = [(index + 1, -1.0), (above, 1.0)].map(|(child, side)| {
                        let [from, to] = line.half_space(axis, position, side, self.slab_error);
                        (child, enter.max(from), leave.min(to))
                    });
                    // Push the far side first, so that the near side is visited first
                    let order = if line.rises(axis) {
                        [high, low]
                    } else {
                        [low, high]
                    };
                    waiting.extend(order.into_iter().filter(|(_, from, to)| from <= to));
                }
            }
        }
    }
}

impl TreeLayout for PlaneTree {
    fn lay_out(root: &Branch, _primitives: &Primitives) -> Option<PlaneTree> {
        Some(PlaneTree::new(root))
    }

    fn byte_count(&self) -> u64 {
        (size_of_val(&*self.nodes) + size_of_val(&*self.numbers)) as u64
    }
}

impl TwoLevelTree<'_, PlaneTree> {
    /// Traces the packets with the reference kernel, one ray after the other.
    pub(super) fn trace(&self, packets: &mut [RayPacket], query: Query) {
        for packet in &mut *packets {
            packet.drop_untraceable();
            for lane in 0..LANES {
                if !packet.is_active(lane) {
                    continue;
                }
                let ray = packet.ray(lane);
                match query {
                    Query::Nearest => {
                        if let Some(hit) = self.nearest(&ray) {
                            packet.set_hit(lane, &hit);
                        }
                    }
                    Query::Any if self.is_blocked(&ray) => packet.set_blocked(lane),
                    Query::Any => {}
                }
            }
        }
        self.planes.trace(packets, query);
    }

    /// Returns the nearest hit of one ray.
    fn nearest(&self, ray: &Ray) -> Option<Hit> {
        let mut best = NearestHit::new(ray.t_far);
        let shear = Shear::new(ray);
        let span = [ray.t_near, ray.t_far.min(f32::MAX)];
        self.world
            .tree
            .traverse(ray.origin, ray.direction, span, |number| {
                // Triangles of baked meshes are in the world tree itself
                let run = self.world.primitives.run(number);
                match &run.kind {
                    RunKind::Triangles(mesh) => {
                        best.offer_triangle(&shear, mesh, ray, run.instance, number - run.first);
                    }
                    RunKind::Points(cloud, instance) => {
                        let point = number - run.first;
                        if let Some(hit) = point_hit(run.instance, instance, cloud, point, ray) {
                            best.offer(hit);
                        }
                    }
                    RunKind::Whole(_) => self.nearest_within(run.instance, ray, &mut best),
                }
                Continuation::Until(best.t)
            });
        best.hit
    }

    fn nearest_within(&self, index: u32, ray: &Ray, best: &mut NearestHit) {
        let instance = &self.scene.instances[index as usize];
        match &self.scene.geometries[instance.geometry as usize] {
            Geometry::Shape(shape) => {
                if let Some(hit) = shape_hit(index, instance, shape, ray) {
                    best.offer(hit);
                }
            }
            // Points are primitives of the world's own
            Geometry::Points(_) => (),
            Geometry::Mesh(mesh) => {
                let Some(object) = &self.objects[instance.geometry as usize] else {
                    return;
                };
                // Traverse the object-space tree up to the nearest hit so far
                let ray = ray_in(instance, ray);
                let shear = Shear::new(&ray);
                object
                    .tree
                    .traverse(ray.origin, ray.direction, [ray.t_near, best.t], |number| {
                        best.offer_triangle(&shear, mesh, &ray, index, number);
                        Continuation::Until(best.t)
                    });
            }
        }
    }

    /// Returns whether one ray hits anything within its interval.
    fn is_blocked(&self, ray: &Ray) -> bool {
        let mut blocked = false;
        let shear = Shear::new(ray);
        let span = [ray.t_near, ray.t_far.min(f32::MAX)];
        self.world
            .tree
            .traverse(ray.origin, ray.direction, span, |number| {
                let run = self.world.primitives.run(number);
                blocked = match &run.kind {
                    RunKind::Triangles(mesh) => is_blocked_by(&shear, mesh, ray, number - run.first),
                    RunKind::Points(cloud, instance) => {
                        point_hit(run.instance, instance, cloud, number - run.first, ray).is_some()
                    }
                    RunKind::Whole(_) => self.is_blocked_within(run.instance, ray),
                };
                if blocked {
                    Continuation::Done
                } else {
                    Continuation::Until(span[1])
                }
            });
        blocked
    }

    fn is_blocked_within(&self, index: u32, ray: &Ray) -> bool {
        let instance = &self.scene.instances[index as usize];
        match &self.scene.geometries[instance.geometry as usize] {
            Geometry::Shape(shape) => shape_hit(index, instance, shape, ray).is_some(),
            Geometry::Points(_) => false,
            Geometry::Mesh(mesh) => {
                let Some(object) = &self.objects[instance.geometry as usize] else {
                    return false;
                };
                let mut blocked = false;
                let ray = ray_in(instance, ray);
                let shear = Shear::new(&ray);
                let span = [ray.t_near, ray.t_far.min(f32::MAX)];
                object.tree.traverse(ray.origin, ray.direction, span, |number| {
                    blocked = is_blocked_by(&shear, mesh, &ray, number);
                    if blocked {
                        Continuation::Done
                    } else {
                        Continuation::Until(span[1])
                    }
                });
                blocked
            }
        }
    }
}

/// Nearest hit so far, with its parameter.
struct NearestHit {
    t: f32,
    hit: Option<Hit>,
}

impl NearestHit {
    fn new(t_far: f32) -> NearestHit {
        NearestHit {
            t: t_far.min(f32::MAX),
            hit: None,
        }
    }

    /// Keeps the better hit: smallest `t`, then instance, then primitive. `hit.t` is within the ray's interval.
    fn offer(&mut self, hit: Hit) {
        let rank = |h: &Hit| (h.instance, h.primitive);
        if self
            .hit
            .is_none_or(|b| hit.t < b.t || (hit.t == b.t && rank(&hit) < rank(&b)))
        {
            self.t = hit.t;
            self.hit = Some(hit);
        }
    }

    fn offer_triangle(&mut self, shear: &Shear, mesh: &Mesh, ray: &Ray, instance: u32, primitive: u32) {
        let corners = mesh.corners(primitive).map(|p| p.to_array());
        if let Some(hit) = shear.intersect(corners, ray.t_near, self.t) {
            self.offer(Hit {
                instance,
                primitive,
                t: hit.t,
                u: hit.u,
                v: hit.v,
            });
        }
    }
}

fn is_blocked_by(shear: &Shear, mesh: &Mesh, ray: &Ray, primitive: u32) -> bool {
    let corners = mesh.corners(primitive).map(|p| p.to_array());
    shear.intersect(corners, ray.t_near, ray.t_far).is_some()
}
