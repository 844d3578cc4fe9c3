//! Watertight test in two steps for indexed triangles: each vertex is projected once per ray, then each triangle is
//! tested by its projected vertices.
//!
//! The arithmetic is that of [`Shear::intersect`], operation by operation, so the results are bit-identical.

#[cfg(any(test, feature = "embree"))]
use super::PACK;
use super::near_origin::may_be_behind;
use super::shear_lanes::LaneAxes;
use super::{Shear, ShearLanes, TriangleHit, project};
use crate::mesh::simd::{SimdLevel, add, div, lanes, max, min, mul, sub};

/// Projected vertices in SIMD lanes: x and y in the sheared frame, where the ray is the origin.
pub(crate) type ProjectedVertices<const N: usize> = [[f32; N]; 2];

/// Vertex in the sheared frame of each of `N` rays.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct ShearedVertex<const N: usize> {
    pub(crate) projected: ProjectedVertices<N>,
    /// Coordinate along the dominant axis from the origin of the ray.
    depth: [f32; N],
}

impl<const N: usize> ShearedVertex<N> {
    /// Vertex at the origins.
    pub(crate) const ZERO: ShearedVertex<N> = ShearedVertex {
        projected: [[0.0; N]; 2],
        depth: [0.0; N],
    };

    /// Returns the coordinates in the frames of the rays.
    #[inline(always)]
    fn rows(&self) -> [&[f32; N]; 3] {
        let [x, y] = &self.projected;
        [x, y, &self.depth]
    }
}

/// Returns a mask whose bit `i` says that the `i`-th of `N` triangles may contain the origin. It is clear only if two
/// edge functions have opposite signs, so that [`Shear::intersect`] misses for every interval.
#[inline(always)]
pub(crate) fn may_contain_origin<I: SimdLevel, const N: usize>(
    isa: I,
    corners: [&ProjectedVertices<N>; 3],
) -> u32 {
    let [u, v, w] = edges(corners);
    let zero = [0.0; N];
    let mut product = zero;
    for i in 0..N {
        // The product is negative if the signs are opposite; if it underflows, it is zero, and the bit is set.
        product[i] = min(min(u[i], v[i]), w[i]) * max(max(u[i], v[i]), w[i]);
    }
    !isa.lt(&product, &zero) & (u32::MAX >> (u32::BITS as usize - N))
}

/// Returns the edge functions opposite to each vertex.
#[inline(always)]
fn edges<const N: usize>([a, b, c]: [&ProjectedVertices<N>; 3]) -> [[f32; N]; 3] {
    [
        sub(&mul(&c[0], &b[1]), &mul(&c[1], &b[0])),
        sub(&mul(&a[0], &c[1]), &mul(&a[1], &c[0])),
        sub(&mul(&b[0], &a[1]), &mul(&b[1], &a[0])),
    ]
}

impl Shear {
    /// Projects `N` points, given by axis.
    #[cfg(any(test, feature = "embree"))]
    #[inline(always)]
    pub(crate) fn flatten<const N: usize>(&self, points: &[[f32; N]; 3]) -> ProjectedVertices<N> {
        let [kx, ky, kz] = self.axes;
        let [ox, oy, oz] = self.origin;
        let [sx, sy, _] = self.shear;
        let origin = [[ox; N], [oy; N], [oz; N]];
        let points = [&points[kx], &points[ky], &points[kz]];
        let [x, y, _] = project(points, &origin, &[[sx; N], [sy; N]]);
        [x, y]
    }
}

/// Hits of rays on one triangle; the arrays are valid only in lanes whose bit in `mask` is set.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HitLanes<const N: usize> {
    pub(crate) mask: u32,
    /// Parameters along the rays.
    pub(crate) t: [f32; N],
    /// Barycentric weights of the second and the third vertex, times `det`.
    pub(crate) weights: [[f32; N]; 2],
    pub(crate) det: [f32; N],
}

impl<const N: usize, A: LaneAxes<N>> ShearLanes<N, A> {
    /// Transforms one of eight points, given by axis, to the frame of each ray.
    #[cfg(any(test, feature = "embree"))]
    #[inline(always)]
    pub(crate) fn sheared_slot(&self, points: &[[f32; PACK]; 3], slot: usize) -> ShearedVertex<N> {
        self.sheared_along(&self.axes.along_slot(points, slot))
    }

    /// Transforms points, given by their coordinates in the order of the axes of each ray, to the frames of the rays.
    #[inline(always)]
    pub(crate) fn sheared_along(&self, coordinates: &[[f32; N]; 3]) -> ShearedVertex<N> {
        let [sx, sy, _] = self.shear;
        let [x, y, depth] = project(coordinates.each_ref(), &self.origin, &[sx, sy]);
        ShearedVertex {
            projected: [x, y],
            depth,
        }
    }

    /// Returns the rays of the mask `active`, all of which [may contain](may_contain_origin) a triangle, without those whose
    /// origins are beyond all its vertices: they miss it, as no ray that is traced begins before its origin.
    #[inline(always)]
    pub(crate) fn starting_before(
        &self,
        isa: impl SimdLevel,
        vertices: [&ShearedVertex<N>; 3],
        active: u32,
    ) -> u32 {
        // Find the farthest vertex along each ray
        let [a, b, c] = self.parameters(vertices);
        let mut last = [0.0; N];
        for i in 0..N {
            last[i] = max(max(a[i], b[i]), c[i]);
        }
        // The weights have one sign, so no rounding brings a mean of negative parameters over 0
        active & !isa.lt(&last, &[0.0; N])
    }

    /// Returns the parameters of the vertices of a triangle.
    #[inline(always)]
    fn parameters(&self, [a, b, c]: [&ShearedVertex<N>; 3]) -> [[f32; N]; 3] {
        let scale = &self.shear[2];
        [mul(scale, &a.depth), mul(scale, &b.depth), mul(scale, &c.depth)]
    }

    /// Intersects a triangle with the rays of the mask `active`, all of which [may contain](may_contain_origin) it,
    /// each with the result of [`Shear::intersect`]. `sheared` are its vertices as transformed by [`ShearLanes::sheared`] from
    /// `corners`, which few rays need; the interval is given by the smallest and largest parameters.
    #[inline(always)]
    pub(crate) fn intersect_sheared(
        &self,
        isa: impl SimdLevel,
        [a, b, c]: [&ShearedVertex<N>; 3],
        corners: impl FnOnce() -> [[f32; 3]; 3],
        active: u32,
        [t_near, t_far]: [&[f32; N]; 2],
    ) -> HitLanes<N> {
        // Compute the edge functions and their signs
        let [u, v, w] = edges([&a.projected, &b.projected, &c.projected]);
        let zero = [0.0; N];
        let [mut min_edge, mut max_edge, mut min_magnitude] = [zero; 3];
        for i in 0..N {
            min_edge[i] = min(min(u[i], v[i]), w[i]);
            max_edge[i] = max(max(u[i], v[i]), w[i]);
            min_magnitude[i] = min(min(u[i].abs(), v[i].abs()), w[i].abs());
        }
        let inside = isa.lt(&zero, &min_edge) | isa.lt(&max_edge, &zero);
        let on_edge = isa.eq(&min_magnitude, &zero) & active;
        // Compute the parameters from the depths
        let scale = &self.shear[2];
        let [ta, tb, tc] = self.parameters([a, b, c]);
        let det = add(&add(&u, &v), &w);
        let t = div(&add(&add(&mul(&u, &ta), &mul(&v, &tb)), &mul(&w, &tc)), &det);
        // Compare the parameters with the interval
        let within = isa.le(t_near, &t) & isa.le(&t, t_far) & isa.lt(&t, &[f32::INFINITY; N]);
        let mask = active & inside & within;
        // Decide rays through an edge or a vertex, and hits that may be behind the start, one by one
        let uncertain = match mask {
            0 => 0,
            _ => mask & may_be_behind(isa, [a, b, c].map(ShearedVertex::rows), scale, &det, [t_near, &t]),
        };
        let mut hit_lanes = HitLanes {
            mask: mask & !uncertain,
            t,
            weights: [v, w],
            det,
        };
        let undecided = on_edge | uncertain;
        if undecided != 0 {
            self.decide(&mut hit_lanes, undecided, corners, [t_near, t_far]);
        }
        hit_lanes
    }

    /// Intersects the rays of the mask `undecided` one by one, with the f64 fallback of the scalar test.
    #[cold]
    #[inline(never)]
    fn decide(
        &self,
        hit_lanes: &mut HitLanes<N>,
        undecided: u32,
        corners: impl FnOnce() -> [[f32; 3]; 3],
        [t_near, t_far]: [&[f32; N]; 2],
    ) {
        let corners = corners();
        for lane in lanes(undecided) {
            let lane = lane % N;
            let hit = self.lane(lane).intersect(corners, t_near[lane], t_far[lane]);
            if let Some(hit) = hit {
                hit_lanes.set(lane, &hit);
            }
        }
    }
}

impl<const N: usize> HitLanes<N> {
    /// Stores the result of [`Shear::intersect`] for a lane.
    #[inline(always)]
    fn set(&mut self, lane: usize, hit: &TriangleHit) {
        self.mask |= 1 << lane;
        self.t[lane] = hit.t;
        (self.weights[0][lane], self.weights[1][lane]) = (hit.u, hit.v);
        self.det[lane] = 1.0;
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::dominant_axis;
    use super::*;
    use crate::mesh::simd::{Scalar, SimdKernel, dispatch};
    use crate::numeric::Ray;

    /// Returns a small integer from -2 to 2 (Weyl sequence of the golden ratio), so that many rays hit edges and
    /// vertices.
    fn small(i: usize) -> f32 {
        ((i as f64 * 0.618_033_988_749_894_9).fract() * 5.0).floor() as f32 - 2.0
    }

    fn point(i: usize) -> [f32; 3] {
        [small(3 * i), small(5 * i + 1), small(7 * i + 2)]
    }

    /// Returns eight rays and their intervals, all with the dominant axis `common` or each with another.
    fn rays(i: usize, common: Option<usize>) -> [Ray; 8] {
        std::array::from_fn(|lane| {
            let dominant = common.unwrap_or((i + lane * lane) % 3);
            let mut direction = point(i * 8 + lane).map(|x| 0.25 * x);
            direction[dominant] = if (i + lane).is_multiple_of(2) { 1.0 } else { -2.0 };
            let mut ray = Ray::new(point(i + 11 * lane).into(), direction.into());
            ray.t_far = [f32::INFINITY, 1.0, 0.0][lane % 3];
            ray
        })
    }

    /// Kernel that computes the hits of eight rays on one triangle, by their common dominant axis if they have one.
    struct IndexedTest([Ray; 8], Option<usize>, [[f32; 3]; 3]);

    impl SimdKernel for IndexedTest {
        type Output = [Option<TriangleHit>; 8];

        #[inline(always)]
        fn run<I: SimdLevel>(self, isa: I) -> [Option<TriangleHit>; 8] {
            let IndexedTest(rays, common, corners) = self;
            let rows = |of: fn(&Ray) -> Vec3| {
                [0, 1, 2].map(|axis| std::array::from_fn(|lane| of(&rays[lane])[axis]))
            };
            let (origin, direction) = (rows(|r| r.origin), rows(|r| r.direction));
            match common {
                Some(axis) => hits_of(isa, &ShearLanes::new(axis, &origin, &direction), &rays, corners),
                None => hits_of(isa, &ShearLanes::of_each(&origin, &direction), &rays, corners),
            }
        }
    }

    /// Returns the hits of eight rays, each with its shear, on one triangle.
    fn hits_of<A: LaneAxes<8>>(
        isa: impl SimdLevel,
        shears: &ShearLanes<8, A>,
        rays: &[Ray; 8],
        corners: [[f32; 3]; 3],
    ) -> [Option<TriangleHit>; 8] {
        // Project the vertices once
        let vertices = corners.map(|corner| shears.sheared_slot(&corner.map(|x| [x; PACK]), 3));
        let [a, b, c] = &vertices;
        // Test the triangle
        let active = may_contain_origin(isa, [&a.projected, &b.projected, &c.projected]);
        let interval = [&rays.map(|r| r.t_near), &rays.map(|r| r.t_far)];
        let kept = shears.starting_before(isa, [a, b, c], active);
        let hit_lanes = shears.intersect_sheared(isa, [a, b, c], || corners, active, interval);
        assert_eq!(hit_lanes.mask & !kept, 0);
        // Divide the weights by the determinant
        std::array::from_fn(|lane| {
            (hit_lanes.mask >> lane & 1 != 0).then(|| TriangleHit {
                t: hit_lanes.t[lane],
                u: hit_lanes.weights[0][lane] / hit_lanes.det[lane],
                v: hit_lanes.weights[1][lane] / hit_lanes.det[lane],
            })
        })
    }

    #[test]
    fn preprojected_corners_give_the_bits_of_the_full_test() {
        let (mut hits, mut edge_hits) = (0, 0);
        for i in 0..20_000 {
            let common = [None, Some(0), Some(1), Some(2)][i % 4];
            let corners = [point(i), point(i + 1), point(i + 3)];
            let rays = rays(i, common);
            let has_common = |axis| rays.iter().all(|r| dominant_axis(r.direction.to_array()) == axis);
            assert!(common.is_none_or(has_common));
            let expected = rays.map(|ray| Shear::new(&ray).intersect(corners, ray.t_near, ray.t_far));
            assert_eq!(IndexedTest(rays, common, corners).run(Scalar), expected);
            assert_eq!(dispatch(IndexedTest(rays, common, corners)), expected);
            for ray in rays {
                let shear = Shear::new(&ray);
                let projected = corners.map(|corner| shear.flatten::<8>(&corner.map(|x| [x; 8])));
                let [a, b, c] = &projected;
                let may_hit = may_contain_origin(Scalar, [a, b, c]);
                assert!(may_hit == 0 || may_hit == 0xff);
                assert!(may_hit != 0 || shear.intersect(corners, 0.0, f32::INFINITY).is_none());
            }
            hits += expected.iter().flatten().count();
            let is_edge = |hit: &&TriangleHit| hit.u == 0.0 || hit.v == 0.0 || hit.u + hit.v == 1.0;
            edge_hits += expected.iter().flatten().filter(is_edge).count();
        }
        assert!(hits > 2000 && edge_hits > 500, "{hits}, {edge_hits}");
    }
}
