//! Check of hits so near the start of their ray that rounding may have put them there.
//!
//! Rays to a light start at surfaces, offset by no more than the error of the starting point, whereas the depth of a hit
//! has the rounding error of coordinates in the group's frame ([`Edges::depth_error`](super::edges::Edges::depth_error)).
//! Of the hits as near the start as their own error, on either side of it, those are discarded whose plane has start and
//! light on the same side: the ray leaves the triangle behind. Differences of the vertices and the start, which are close
//! together, keep nearly all digits. The others, of a triangle that rises beside the start or where the side is uncertain,
//! are decided by the reference test of the ray from its start.

use std::ops::{Add, Mul, Sub};

use crate::accel::{LANES, RayPacket};
use crate::mesh::simd::{Floats, WideLevel, lanes};
use crate::mesh::triangle::Shear;

use super::decide::LaneTriangles;
use super::frame::{GroupFrame, splat};
use super::projection::GroupProjection;
use crate::accel::native::layout::LeafBlock;

/// Error of a distance from a plane relative to the sum of the magnitudes of its products: 16 units of roundoff,
/// rounded up.
const PLANE_ERROR: f32 = 1e-6;

/// Rays of a test's lanes, as their index in the packets of the group.
#[derive(Clone, Copy)]
pub(super) enum LaneRays {
    /// Rays of a packet.
    Packet(usize),
    /// The same ray in all lanes: its packet, and its lane there.
    One { packet: usize, lane: usize },
}

/// Number that a plane is computed with: of one triangle, or of several in the lanes of a register.
trait Number: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// Returns the magnitude of each value.
    fn magnitude(self) -> Self;
}

impl Number for f32 {
    #[inline(always)]
    fn magnitude(self) -> f32 {
        self.abs()
    }
}

impl<W: WideLevel<N>, const N: usize> Number for Floats<W, N> {
    #[inline(always)]
    fn magnitude(self) -> Floats<W, N> {
        self.abs()
    }
}

/// Plane of a triangle, by axes of the world.
#[derive(Clone, Copy)]
struct TrianglePlane<T> {
    /// First vertex of the triangle.
    point: [T; 3],
    /// Cross product of two edges.
    normal: [T; 3],
    /// Sums of the magnitudes of the products in the normal.
    magnitude: [T; 3],
    /// Distance of the light from the plane times the normal's length.
    light: PlaneDistance<T>,
}

/// Distance of a point from a plane times the length of its normal; for a direction its scalar product with the normal.
#[derive(Clone, Copy)]
struct PlaneDistance<T> {
    value: T,
    /// Sum of the magnitudes of its products.
    magnitude: T,
}

impl<T: Number> TrianglePlane<T> {
    /// Computes the plane through three vertices, and on which side of it the light is. `zero` is 0 in all lanes.
    #[inline(always)]
    fn new<J: GroupProjection>([a, b, c]: [[T; 3]; 3], light: [T; 3], zero: T) -> TrianglePlane<T> {
        let mut plane = TrianglePlane {
            point: a,
            normal: [zero; 3],
            magnitude: [zero; 3],
            light: PlaneDistance {
                value: zero,
                magnitude: zero,
            },
        };
        for i in 0..3 {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            let (p, q) = ((b[j] - a[j]) * (c[k] - a[k]), (b[k] - a[k]) * (c[j] - a[j]));
            plane.normal[i] = p - q;
            plane.magnitude[i] = p.magnitude() + q.magnitude();
        }
        // A light far away has a direction instead of a position
        let mut target = light;
        for i in 0..3 {
            target[i] = if J::IS_PARALLEL { light[i] } else { light[i] - a[i] };
        }
        plane.light = plane.product(target, zero);
        plane
    }

    /// Returns the scalar product of a vector with the normal.
    #[inline(always)]
    fn product(&self, vector: [T; 3], zero: T) -> PlaneDistance<T> {
        let (mut value, mut magnitude) = (zero, zero);
        for i in 0..3 {
            value = value + self.normal[i] * vector[i];
            magnitude = magnitude + self.magnitude[i] * vector[i].magnitude();
        }
        PlaneDistance { value, magnitude }
    }
}

impl TrianglePlane<f32> {
    /// Returns the plane in all lanes.
    #[inline(always)]
    fn splat<W: WideLevel<N>, const N: usize>(&self, level: W) -> TrianglePlane<Floats<W, N>> {
        let zero = [splat(level, 0.0); 3];
        let (mut point, mut normal, mut magnitude) = (zero, zero, zero);
        for i in 0..3 {
            point[i] = splat(level, self.point[i]);
            normal[i] = splat(level, self.normal[i]);
            magnitude[i] = splat(level, self.magnitude[i]);
        }
        TrianglePlane {
            point,
            normal,
            magnitude,
            light: PlaneDistance {
                value: splat(level, self.light.value),
                magnitude: splat(level, self.light.magnitude),
            },
        }
    }
}

/// Returns the position of the light, or the direction of one far away, by axes of the world.
#[inline(always)]
fn light_of<J: GroupProjection>(frame: &GroupFrame) -> [f32; 3] {
    let mut light = [0.0; 3];
    for i in 0..3 {
        light[frame.axes[i] % 3] = match J::IS_PARALLEL {
            true => frame.light_direction()[i],
            false => frame.origin[i],
        };
    }
    light
}

/// Hits of a test that are to be compared with the starts of their rays.
pub(super) struct StartTest<'a, W: WideLevel<N>, const N: usize> {
    block: &'a LeafBlock,
    triangles: LaneTriangles,
    packets: &'a [RayPacket],
    rays: LaneRays,
    level: W,
    /// Planes of the lanes' triangles.
    plane: TrianglePlane<Floats<W, N>>,
    /// Starts of the lanes' rays, by axis of the world.
    start: [Floats<W, N>; 3],
    /// Mask of the lanes whose rays search from their origins on.
    from_origin: u32,
}

impl<'a, W: WideLevel<LANES>> StartTest<'a, W, LANES> {
    /// Compares the rays of a packet with one triangle of a block.
    #[inline(always)]
    pub(super) fn of_packet<J: GroupProjection>(
        level: W,
        frame: &GroupFrame,
        packets: &'a [RayPacket],
        packet: usize,
        block: &'a LeafBlock,
        triangle: usize,
    ) -> StartTest<'a, W, LANES> {
        let rays = &packets[packet];
        let mut start = [splat(level, 0.0); 3];
        for axis in 0..3 {
            start[axis] = Floats::load(level, &rays.origin[axis]);
        }
        let corners = block.triangles.triangle(triangle % 8);
        StartTest {
            block,
            triangles: LaneTriangles::One(triangle),
            packets,
            rays: LaneRays::Packet(packet),
            level,
            plane: TrianglePlane::new::<J>(corners, light_of::<J>(frame), 0.0).splat(level),
            start,
            from_origin: Floats::load(level, &rays.t_near).le(splat(level, 0.0)).bits(),
        }
    }
}

impl<'a, W: WideLevel<8>> StartTest<'a, W, 8> {
    /// Compares one ray of a packet with the eight triangles of a block.
    #[inline(always)]
    pub(super) fn of_ray<J: GroupProjection>(
        level: W,
        frame: &GroupFrame,
        packets: &'a [RayPacket],
        packet: usize,
        lane: usize,
        block: &'a LeafBlock,
    ) -> StartTest<'a, W, 8> {
        // Fetch start and light in all lanes, and the triangles
        let rays = &packets[packet];
        let zero = splat(level, 0.0);
        let mut corners = [[zero; 3]; 3];
        let (mut start, mut light) = ([zero; 3], [zero; 3]);
        let position = light_of::<J>(frame);
        for axis in 0..3 {
            start[axis] = splat(level, rays.origin[axis][lane]);
            light[axis] = splat(level, position[axis]);
            for corner in 0..3 {
                corners[corner][axis] = Floats::load(level, &block.triangles.corners[corner][axis]);
            }
        }
        StartTest {
            block,
            triangles: LaneTriangles::Each,
            packets,
            rays: LaneRays::One { packet, lane },
            level,
            plane: TrianglePlane::new::<J>(corners, light, zero),
            start,
            from_origin: if rays.t_near[lane] > 0.0 { 0 } else { u32::MAX },
        }
    }
}

impl<W: WideLevel<N>, const N: usize> StartTest<'_, W, N> {
    /// Returns those of `mask` whose hits lie behind the starts of their rays.
    #[inline(always)]
    pub(super) fn behind(&self, mask: u32) -> u32 {
        // Compute the distances of the starts from the planes
        let mut from_corner = self.start;
        for axis in 0..3 {
            from_corner[axis] = self.start[axis] - self.plane.point[axis];
        }
        let start = self.plane.product(from_corner, splat(self.level, 0.0));
        let light = &self.plane.light;
        // Compare the sides where both are certain
        let error = splat(self.level, PLANE_ERROR);
        let is_certain =
            (start.magnitude * error).lt(start.value.abs()) & (light.magnitude * error).lt(light.value.abs());
        let other_side = (start.value ^ light.value).signs();
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
