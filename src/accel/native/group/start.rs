//! Check of hits so near the start of their ray that rounding may have put them there.
//!
//! Rays to a light start at surfaces, offset by no more than the error of the starting point, whereas the depth of a hit
//! has the rounding error of coordinates in the group's frame. Of the hits as near the start as their own error, those are
//! discarded whose plane has start and light on the same side: the ray leaves the triangle behind. Differences of the
//! vertices and the start, which are close together, keep nearly all digits. The others, of a triangle that rises beside
//! the start or where the side is uncertain, are decided by the reference test of the ray from its start.

use crate::accel::{LANES, RayPacket};
use crate::mesh::simd::{Floats, WideLevel, lanes};
use crate::mesh::triangle::Shear;

use super::decide::LaneTriangles;
use super::edges::{CandidateLanes, Edges};
use super::frame::{GroupFrame, splat};
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
pub(super) fn near_start<J: GroupProjection, W: WideLevel<N>, const N: usize>(
    level: W,
    rays: &GroupRays,
    edges: &Edges<W, N>,
    candidates: &CandidateLanes<W, N>,
    z: Floats<W, N>,
    hit_z: Floats<W, N>,
) -> u32 {
    // Compute the range of the vertices' depths
    let [z0, z1, z2] = edges.z;
    let farthest = z0.max(z1.max(z2));
    let span = farthest - z0.min(z1.min(z2));
    // Bound the errors of the edge functions from their own roundings, and from those of vertices and rays in the plane
    let mut slopes = splat(level, 0.0);
    let mut error = splat(level, 0.0);
    for e in 0..3 {
        slopes = slopes + (edges.a[e].abs() + edges.b[e].abs());
        error = error + edges.error[e];
    }
    let mut reach = splat(level, rays.reach());
    let mut depth = farthest;
    if J::IS_PARALLEL {
        // Depths have either sign, and both ends of the difference are rounded. A vertex is no farther from a ray inside
        // the triangle than the sum of all sides. With m the greatest coordinate and R the sum of the greatest depths, the
        // errors of two ends of an edge and of the ray are 2 (2 m + 4 R) + 2 m + 3 R units of roundoff
        depth = z0.abs().max(z1.abs().max(z2.abs())) + splat(level, rays.frame.spread[2]);
        reach = reach + slopes + depth;
    }
    error = error + slopes * (splat(level, POSITION_ERROR) * reach);
    let sum = candidates.sum.abs();
    let bound = error * span + splat(level, DEPTH_ERROR) * (depth * sum);
    // Compare the distance from the start with the error of the depth, both times the sum of the edge functions
    ((z - hit_z) * sum).le(bound).bits()
}

/// Rays of a test's lanes, as their index in the packets of the group.
#[derive(Clone, Copy)]
pub(super) enum LaneRays {
    /// Rays of a packet.
    Packet(usize),
    /// The same ray in all lanes: its packet, and its lane there.
    One { packet: usize, lane: usize },
}

/// Hits of a test that are to be compared with the starts of their rays.
pub(super) struct StartTest<'a, W: WideLevel<N>, const N: usize> {
    /// Frame about the common target of the rays, or amid their origins.
    frame: &'a GroupFrame,
    block: &'a LeafBlock,
    triangles: LaneTriangles,
    packets: &'a [RayPacket],
    rays: LaneRays,
    level: W,
    /// Vertices of the lanes' triangles, by corner and axis of the world.
    corners: [[Floats<W, N>; 3]; 3],
    /// Starts of the lanes' rays, by axis of the world.
    start: [Floats<W, N>; 3],
    /// Mask of the lanes whose rays search from their origins on.
    from_origin: u32,
}

impl<'a, W: WideLevel<LANES>> StartTest<'a, W, LANES> {
    /// Compares the rays of a packet with one triangle of a block.
    #[inline(always)]
    pub(super) fn of_packet(
        level: W,
        frame: &'a GroupFrame,
        packets: &'a [RayPacket],
        packet: usize,
        block: &'a LeafBlock,
        triangle: usize,
    ) -> StartTest<'a, W, LANES> {
        // Fetch the starts, and the triangle in all lanes
        let rays = &packets[packet];
        let mut corners = [[splat(level, 0.0); 3]; 3];
        let mut start = [splat(level, 0.0); 3];
        for axis in 0..3 {
            start[axis] = Floats::load(level, &rays.origin[axis]);
            for corner in 0..3 {
                corners[corner][axis] = splat(level, block.triangles.corners[corner][axis][triangle % 8]);
            }
        }
        StartTest {
            frame,
            block,
            triangles: LaneTriangles::One(triangle),
            packets,
            rays: LaneRays::Packet(packet),
            level,
            corners,
            start,
            from_origin: Floats::load(level, &rays.t_near).le(splat(level, 0.0)).bits(),
        }
    }
}

impl<'a, W: WideLevel<8>> StartTest<'a, W, 8> {
    /// Compares one ray of a packet with the eight triangles of a block.
    #[inline(always)]
    pub(super) fn of_ray(
        level: W,
        frame: &'a GroupFrame,
        packets: &'a [RayPacket],
        packet: usize,
        lane: usize,
        block: &'a LeafBlock,
    ) -> StartTest<'a, W, 8> {
        // Fetch the start in all lanes, and the triangles
        let rays = &packets[packet];
        let mut corners = [[splat(level, 0.0); 3]; 3];
        let mut start = [splat(level, 0.0); 3];
        for axis in 0..3 {
            start[axis] = splat(level, rays.origin[axis][lane]);
            for corner in 0..3 {
                corners[corner][axis] = Floats::load(level, &block.triangles.corners[corner][axis]);
            }
        }
        StartTest {
            frame,
            block,
            triangles: LaneTriangles::Each,
            packets,
            rays: LaneRays::One { packet, lane },
            level,
            corners,
            start,
            from_origin: if rays.t_near[lane] > 0.0 { 0 } else { u32::MAX },
        }
    }
}

impl<W: WideLevel<N>, const N: usize> StartTest<'_, W, N> {
    /// Returns those of `mask` whose hits lie behind the starts of their rays.
    #[inline(always)]
    pub(super) fn behind<J: GroupProjection>(&self, mask: u32) -> u32 {
        // Compute start and target relative to the first vertex; a light far away has a direction instead
        let (level, [a, b, c]) = (self.level, self.corners);
        let mut start = [splat(level, 0.0); 3];
        let mut target = start;
        for i in 0..3 {
            let axis = self.frame.axes[i];
            start[axis] = self.start[axis] - a[axis];
            target[axis] = match J::IS_PARALLEL {
                true => splat(level, self.frame.light_direction()[i]),
                false => splat(level, self.frame.origin[i]) - a[axis],
            };
        }
        // Compute their distances from the plane, times the normal's length
        let (mut from_start, mut from_target) = (splat(level, 0.0), splat(level, 0.0));
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
        let error = splat(level, PLANE_ERROR);
        let is_certain =
            (start_error * error).lt(from_start.abs()) & (target_error * error).lt(from_target.abs());
        let other_side = (from_start ^ from_target).signs();
        let certain = is_certain.bits() & self.from_origin;
        let behind = mask & certain & !other_side;
        // Decide the others by the reference test
        let uncertain = mask & !behind;
        if uncertain == 0 {
            return behind;
        }
        behind | self.missed(uncertain)
    }

    /// Returns those of `mask` whose ray, traced from its start, misses the triangle.
    #[cold]
    #[inline(never)]
    fn missed(&self, mask: u32) -> u32 {
        let mut missed = 0;
        for lane in lanes(mask) {
            // Find the lane's ray and triangle
            let (packet, ray_lane) = match self.rays {
                LaneRays::Packet(packet) => (packet, lane),
                LaneRays::One { packet, lane } => (packet, lane),
            };
            let ray = self.packets[packet].ray(ray_lane);
            let corners = self.block.triangles.triangle(self.triangles.of(lane));
            // Intersect them
            let hit = Shear::new(&ray).intersect(corners, ray.t_near, ray.t_far);
            missed |= u32::from(hit.is_none()) << lane;
        }
        missed
    }
}
