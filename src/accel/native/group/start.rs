//! Check of hits so near the start of their ray that rounding may have put them there.
//!
//! Rays to a light start at surfaces, offset by no more than the error of the starting point, whereas the depth of a hit
//! has the rounding error of coordinates in the group's frame. Of the hits as near the start as their own error, those are
//! discarded whose plane has start and light on the same side: the ray leaves the triangle behind. Differences of the
//! vertices and the start, which are close together, keep nearly all digits. The others, of a triangle that rises beside
//! the start or where the side is uncertain, are decided by the reference test of the ray from its start.

use crate::accel::RayPacket;
use crate::mesh::simd::{Float8, WideLevel, lanes};
use crate::mesh::triangle::Shear;

use super::decide::LaneTriangles;
use super::edges::{CandidateLanes, Edges};
use super::frame::{GroupFrame, half, splat};
use super::projection::GroupProjection;
use super::rays::GroupRays;
use crate::accel::native::layout::LeafBlock;

/// Error of a depth relative to the greatest depth of a vertex: eight units of roundoff, rounded up.
const DEPTH_ERROR: f32 = 5e-7;
/// Error of the position of a vertex relative to a ray in the plane, relative to the greatest magnitude of coordinates: 16
/// units of roundoff, rounded up, for four roundings of the vertex and four of the ray. Those of vertices count twice, as
/// each vertex has two edges.
const POSITION_ERROR: f32 = 1e-6;
/// Error of a distance from a plane relative to the sum of the magnitudes of its products: 16 units of roundoff,
/// rounded up.
const PLANE_ERROR: f32 = 1e-6;

/// Returns a mask of the lanes whose hits are so near the start that they may lie behind it. `z` are the depths of the
/// starts, `hit_z` those of the hits.
#[inline(always)]
pub(super) fn near_start<W: WideLevel, J: GroupProjection>(
    wide: W,
    rays: &GroupRays,
    edges: &Edges<W>,
    candidates: &CandidateLanes<W>,
    z: Float8<W>,
    hit_z: Float8<W>,
) -> u32 {
    // Compute the range of the vertices' depths
    let [z0, z1, z2] = edges.z;
    let farthest = z0.max(z1.max(z2));
    let span = farthest - z0.min(z1.min(z2));
    // Bound the errors of the edge functions from their own roundings, and from those of vertices and rays in the plane
    let mut slopes = splat(wide, 0.0);
    let mut error = splat(wide, 0.0);
    for e in 0..3 {
        slopes = slopes + (edges.a[e].abs() + edges.b[e].abs());
        error = error + edges.error[e];
    }
    let mut reach = splat(wide, rays.reach());
    let mut depth = farthest;
    if J::IS_PARALLEL {
        // Depths have either sign, and both ends of the difference are rounded. A vertex is no farther from a ray inside
        // the triangle than the sum of all sides. With m the greatest coordinate and R the sum of the greatest depths, the
        // errors of two ends of an edge and of the ray are 2 (2 m + 4 R) + 2 m + 3 R units of roundoff
        depth = z0.abs().max(z1.abs().max(z2.abs())) + splat(wide, rays.frame.spread[2]);
        reach = reach + slopes + depth;
    }
    error = error + slopes * (splat(wide, POSITION_ERROR) * reach);
    let sum = candidates.sum.abs();
    let bound = error * span + splat(wide, DEPTH_ERROR) * (depth * sum);
    // Compare the distance from the start with the error of the depth, both times the sum of the edge functions
    ((z - hit_z) * sum).le(bound).bits()
}

/// Rays of a test's lanes in the packets of the group.
#[derive(Clone, Copy)]
pub(super) enum LaneRays {
    /// Rays of a sub-packet.
    Sub(usize),
    /// The same ray in all lanes, by its index in the group.
    One(usize),
}

/// Hits of a test that are to be compared with the starts of their rays.
pub(super) struct StartTest<'a> {
    /// Frame about the common target of the rays, or amid their origins.
    pub(super) frame: &'a GroupFrame,
    pub(super) block: &'a LeafBlock,
    pub(super) triangles: LaneTriangles,
    pub(super) packets: &'a [RayPacket],
    pub(super) rays: LaneRays,
}

impl StartTest<'_> {
    /// Returns those of `mask` whose hits lie behind the starts of their rays.
    #[inline(always)]
    pub(super) fn behind<W: WideLevel, J: GroupProjection>(&self, wide: W, mask: u32) -> u32 {
        // Compute start and target relative to the first vertex; a light far away has a direction instead
        let [a, b, c] = self.corners(wide);
        let mut start = [splat(wide, 0.0); 3];
        let mut target = start;
        for i in 0..3 {
            let axis = self.frame.axes[i];
            start[axis] = self.start_coordinate(wide, axis) - a[axis];
            target[axis] = match J::IS_PARALLEL {
                true => splat(wide, self.frame.light_direction()[i]),
                false => splat(wide, self.frame.origin[i]) - a[axis],
            };
        }
        // Compute their distances from the plane, times the normal's length
        let (mut from_start, mut from_target) = (splat(wide, 0.0), splat(wide, 0.0));
        let (mut start_error, mut target_error) = (from_start, from_target);
        for i in 0..3 {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            let (p, q) = ((b[j] - a[j]) * (c[k] - a[k]), (b[k] - a[k]) * (c[j] - a[j]));
            let (normal, magnitude) = (p - q, p.abs() + q.abs());
            from_start = from_start + normal * start[i];
            from_target = from_target + normal * target[i];
            start_error = start_error + magnitude * start[i].abs();
            target_error = target_error + magnitude * target[i].abs();
        }
        // Compare the sides where both are certain
        let error = splat(wide, PLANE_ERROR);
        let is_certain =
            (start_error * error).lt(from_start.abs()) & (target_error * error).lt(from_target.abs());
        let other_side = (from_start ^ from_target).bits();
        let certain = is_certain.bits() & self.starting_at_origin(wide);
        let behind = mask & certain & !other_side;
        // Decide the others by the reference test
        let uncertain = mask & !behind;
        if uncertain == 0 {
            return behind;
        }
        behind | self.missed(uncertain)
    }

    /// Returns the vertices of the lanes' triangles, by corner and axis of the world.
    #[inline(always)]
    fn corners<W: WideLevel>(&self, wide: W) -> [[Float8<W>; 3]; 3] {
        let mut corners = [[splat(wide, 0.0); 3]; 3];
        for corner in 0..3 {
            for axis in 0..3 {
                let row = &self.block.triangles.corners[corner][axis];
                corners[corner][axis] = match self.triangles {
                    LaneTriangles::One(triangle) => splat(wide, row[triangle % 8]),
                    LaneTriangles::Each => Float8::load(wide, row),
                };
            }
        }
        corners
    }

    /// Returns a coordinate of the starts of the lanes' rays.
    #[inline(always)]
    fn start_coordinate<W: WideLevel>(&self, wide: W, axis: usize) -> Float8<W> {
        match self.rays {
            LaneRays::Sub(sub) => Float8::load(wide, half(&self.packets[sub / 2].origin[axis], sub)),
            LaneRays::One(ray) => splat(wide, self.packets[ray / 16].origin[axis][ray % 16]),
        }
    }

    /// Returns a mask of the lanes whose rays search from their origins on.
    #[inline(always)]
    fn starting_at_origin<W: WideLevel>(&self, wide: W) -> u32 {
        match self.rays {
            LaneRays::Sub(sub) => Float8::load(wide, half(&self.packets[sub / 2].t_near, sub))
                .le(splat(wide, 0.0))
                .bits(),
            LaneRays::One(ray) if self.packets[ray / 16].t_near[ray % 16] > 0.0 => 0,
            LaneRays::One(_) => u32::MAX,
        }
    }

    /// Returns those of `mask` whose ray, traced from its start, misses the triangle.
    #[cold]
    #[inline(never)]
    fn missed(&self, mask: u32) -> u32 {
        let mut missed = 0;
        for lane in lanes(mask) {
            // Find the lane's ray and triangle
            let index = match self.rays {
                LaneRays::Sub(sub) => 8 * sub + lane,
                LaneRays::One(ray) => ray,
            };
            let ray = self.packets[index / 16].ray(index % 16);
            let corners = self.block.triangles.triangle(self.triangles.of(lane));
            // Intersect them
            let hit = Shear::new(&ray).intersect(corners, ray.t_near, ray.t_far);
            missed |= u32::from(hit.is_none()) << lane;
        }
        missed
    }
}
