//! The watertight ray-triangle test of Woop, Benthin and Wald ("Watertight Ray/Triangle Intersection", JCGT 2(1),
//! 2013).
//!
//! The ray's largest direction component becomes the z axis and a shear aligns the ray with that axis, so that the test
//! is whether the origin lies in the projected triangle: the signs of three 2-D edge functions. The test is watertight
//! for two reasons:
//!
//! * A projected vertex depends on the vertex and the ray only, so triangles that share it use the same point.
//! * The sign of an edge function is exact. Rounding is monotonic, so the difference of two rounded products is zero or
//!   has the correct sign; where it is zero, it is computed again in f64, where products of f32 are exact. Hence no
//!   fused multiply-add here, which would round one product and not the other.
//!
//! A hit that is as near the start of its ray as its own error is decided again in f64, see `near_origin`.
//!
//! [`Shear::intersect`] is the reference; the forms for eight triangles and for sixteen rays give the same bits. On a
//! [`F32Only`](super::simd::F32Only) instruction set they never fall back to f64: what that costs in errors is measured
//! elsewhere.

mod indexed;
mod near_origin;
mod shear;
mod shear_lanes;

use glam::Vec3;

use super::simd::{Scalar, SimdLevel, add, div, lanes, max, min, mul, sub};
#[cfg(feature = "embree")]
pub(crate) use indexed::ProjectedVertices;
pub(crate) use indexed::{HitLanes, ShearedVertex, may_contain_origin};
use near_origin::may_be_behind;
pub use shear::Shear;
pub(crate) use shear::dominant_axis;
pub use shear_lanes::ShearLanes;
pub(crate) use shear_lanes::{AxisOrders, OwnAxes};
#[cfg(feature = "embree")]
pub(crate) use shear_lanes::{LaneAxes, dominant_axes};

/// Number of triangles in a [`TrianglePack`].
pub const PACK: usize = 8;

/// Hit of a ray on a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangleHit {
    /// Parameter along the ray.
    pub t: f32,
    /// Barycentric weight of the second vertex.
    pub u: f32,
    /// Barycentric weight of the third vertex.
    pub v: f32,
}

/// Hits of `N` tests in SIMD lanes; `t`, `u` and `v` are valid only in lanes whose bit in `mask` is set.
#[derive(Clone, Copy, Debug)]
pub struct LaneHits<const N: usize> {
    /// Bit mask of the lanes that hit: bit `i` is lane `i`.
    pub mask: u32,
    /// Parameters along the rays.
    pub t: [f32; N],
    /// Barycentric weights of the second vertices.
    pub u: [f32; N],
    /// Barycentric weights of the third vertices.
    pub v: [f32; N],
}

/// Eight triangles as structure of arrays. A lane of NaN is never hit.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct TrianglePack {
    /// Coordinates, indexed by vertex, axis and lane.
    pub corners: [[[f32; PACK]; 3]; 3],
}

impl TrianglePack {
    /// Pack whose lanes are all NaN, so that no ray hits it.
    pub const EMPTY: TrianglePack = TrianglePack {
        corners: [[[f32::NAN; PACK]; 3]; 3],
    };

    /// Stores a triangle in a lane.
    pub fn set(&mut self, lane: usize, corners: [Vec3; 3]) {
        for (rows, corner) in self.corners.iter_mut().zip(corners) {
            for (row, value) in rows.iter_mut().zip(corner.to_array()) {
                row[lane] = value;
            }
        }
    }

    /// Returns the triangle of a lane.
    #[inline(always)]
    pub fn triangle(&self, lane: usize) -> [[f32; 3]; 3] {
        let mut corners = [[0.0; 3]; 3];
        for corner in 0..3 {
            for axis in 0..3 {
                corners[corner][axis] = self.corners[corner][axis][lane & (PACK - 1)];
            }
        }
        corners
    }
}

impl Shear {
    /// Intersects one triangle from either side, for finite `t` within [`t_near`, `t_far`], both ends included.
    ///
    /// A triangle that is exactly edge-on, or has no area, is missed.
    #[inline(always)]
    pub fn intersect(&self, corners: [[f32; 3]; 3], t_near: f32, t_far: f32) -> Option<TriangleHit> {
        // Transform the vertices to the sheared frame of the ray
        let [kx, ky, kz] = self.axes;
        let [sx, sy, sz] = self.shear;
        let mut projected = [[0.0f32; 3]; 3];
        for (out, p) in projected.iter_mut().zip(&corners) {
            let z = p[kz] - self.origin[2];
            *out = [
                (p[kx] - self.origin[0]) - sx * z,
                (p[ky] - self.origin[1]) - sy * z,
                z,
            ];
        }
        let [a, b, c] = projected;
        // Compute the edge functions, and fall back to f64 if one is zero
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        if u == 0.0 || v == 0.0 || w == 0.0 {
            return self.resolve_edge_in_f64(corners, projected, [t_near, t_far]);
        }
        // Test whether the origin is on the same side of all edges
        let inside = (u > 0.0 && v > 0.0 && w > 0.0) || (u < 0.0 && v < 0.0 && w < 0.0);
        if !inside {
            return None;
        }
        // Compute the parameter from the weighted depths
        let det = (u + v) + w;
        let t = ((u * (sz * a[2]) + v * (sz * b[2])) + w * (sz * c[2])) / det;
        let within = t_near <= t && t <= t_far && t < f32::INFINITY;
        // Reject a hit behind the start, which rounding may move in front of it
        let is_hit = within && !self.is_behind(corners, projected, det, [t_near, t]);
        is_hit.then(|| TriangleHit {
            t,
            u: v / det,
            v: w / det,
        })
    }

    /// Returns whether the exact hit is behind the start of the ray, `t_near`, although rounding put `t` at or beyond
    /// it.
    #[inline(always)]
    fn is_behind(
        &self,
        corners: [[f32; 3]; 3],
        projected: [[f32; 3]; 3],
        det: f32,
        [t_near, t]: [f32; 2],
    ) -> bool {
        let [a, b, c] = projected.map(|p| p.map(|x| [x]));
        let rows = [&a, &b, &c].map(|[x, y, z]| [x, y, z]);
        may_be_behind(Scalar, rows, &[self.shear[2]], &[det], [&[t_near], &[t]]) != 0
            && self.plane_is_before(corners, t_near)
    }

    /// Decides in f64 where f32 cannot: the ray passes through an edge or a vertex, or the triangle is edge-on.
    #[cold]
    #[inline(never)]
    fn resolve_edge_in_f64(
        &self,
        corners: [[f32; 3]; 3],
        projected: [[f32; 3]; 3],
        [t_near, t_far]: [f32; 2],
    ) -> Option<TriangleHit> {
        // Products of f32 are exact in f64, so the signs are, too.
        let [a, b, c] = projected.map(|p| p.map(f64::from));
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        let outside = (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0);
        let det = u + v + w;
        if outside || det == 0.0 {
            return None;
        }
        let [za, zb, zc] = projected.map(|p| f64::from(self.shear[2] * p[2]));
        let t = ((u * za + v * zb + w * zc) / det) as f32;
        let within = t_near <= t && t <= t_far && t < f32::INFINITY;
        let is_hit = within && !self.is_behind(corners, projected, det as f32, [t_near, t]);
        is_hit.then(|| TriangleHit {
            t,
            u: (v / det) as f32,
            v: (w / det) as f32,
        })
    }

    /// Intersects eight triangles, each with the result of [`Shear::intersect`].
    #[inline(always)]
    pub(crate) fn intersect_pack(
        &self,
        isa: impl SimdLevel,
        pack: &TrianglePack,
        t_near: f32,
        t_far: f32,
    ) -> LaneHits<PACK> {
        // Project the vertices of all lanes
        let [sx, sy, sz] = self.shear;
        let [ox, oy, oz] = self.origin;
        let origin = [[ox; PACK], [oy; PACK], [oz; PACK]];
        let shear = [[sx; PACK], [sy; PACK]];
        let [kx, ky, kz] = self.axes;
        let [a, b, c] = &pack.corners;
        let a = project([&a[kx], &a[ky], &a[kz]], &origin, &shear);
        let b = project([&b[kx], &b[ky], &b[kz]], &origin, &shear);
        let c = project([&c[kx], &c[ky], &c[kz]], &origin, &shear);
        // Test all lanes in f32, then the undecided ones in f64
        let test = edge_test(isa, [a, b, c], [sz; PACK], [&[t_near; PACK], &[t_far; PACK]]);
        if test.undecided != 0 {
            return self.resolve_in_f64(test, pack, t_near, t_far);
        }
        test.hits
    }

    // The arguments are passed by value, so that the arrays of the common path can stay in registers.
    #[cold]
    #[inline(never)]
    fn resolve_in_f64(
        &self,
        mut test: EdgeTest<PACK>,
        pack: &TrianglePack,
        t_near: f32,
        t_far: f32,
    ) -> LaneHits<PACK> {
        for lane in lanes(test.undecided) {
            test.resolve_in_f64(lane, self.intersect(pack.triangle(lane), t_near, t_far));
        }
        test.hits
    }
}

/// Result of the f32 part of `N` tests, with a mask of the lanes that need f64.
struct EdgeTest<const N: usize> {
    hits: LaneHits<N>,
    undecided: u32,
}

impl<const N: usize> EdgeTest<N> {
    fn resolve_in_f64(&mut self, lane: usize, hit: Option<TriangleHit>) {
        let hits = &mut self.hits;
        hits.mask &= !(1 << lane);
        if let Some(hit) = hit {
            hits.mask |= 1 << lane;
            hits.t[lane] = hit.t;
            hits.u[lane] = hit.u;
            hits.v[lane] = hit.v;
        }
    }
}

/// Evaluates the edge functions, parameters and weights of `N` tests in f32. The vertices are projected: x, y and the
/// unscaled z; `sz` is the scale of z.
#[inline(always)]
fn edge_test<I: SimdLevel, const N: usize>(
    isa: I,
    [a, b, c]: [[[f32; N]; 3]; 3],
    sz: [f32; N],
    [t_near, t_far]: [&[f32; N]; 2],
) -> EdgeTest<N> {
    // Compute the edge functions
    let u = sub(&mul(&c[0], &b[1]), &mul(&c[1], &b[0]));
    let v = sub(&mul(&a[0], &c[1]), &mul(&a[1], &c[0]));
    let w = sub(&mul(&b[0], &a[1]), &mul(&b[1], &a[0]));
    // Reduce them to the values that decide: minimum, maximum, and smallest magnitude
    let zero = [0.0; N];
    let [mut min_edge, mut max_edge, mut min_magnitude] = [zero; 3];
    for i in 0..N {
        min_edge[i] = min(min(u[i], v[i]), w[i]);
        max_edge[i] = max(max(u[i], v[i]), w[i]);
        min_magnitude[i] = min(min(u[i].abs(), v[i].abs()), w[i].abs());
    }
    // In f32 alone, an edge belongs to both triangles that share it.
    let (inside, on_edge) = match I::IS_EXACT {
        true => (
            isa.lt(&zero, &min_edge) | isa.lt(&max_edge, &zero),
            isa.eq(&min_magnitude, &zero),
        ),
        false => (isa.le(&zero, &min_edge) | isa.le(&max_edge, &zero), 0),
    };
    let mut hits = LaneHits {
        mask: 0,
        t: zero,
        u: zero,
        v: zero,
    };
    // Return early if no lane is inside
    if inside == 0 {
        return EdgeTest {
            hits,
            undecided: on_edge,
        };
    }
    // Compute the parameters and compare them with the interval
    let det = add(&add(&u, &v), &w);
    let [za, zb, zc] = [mul(&sz, &a[2]), mul(&sz, &b[2]), mul(&sz, &c[2])];
    let scaled_t = add(&add(&mul(&u, &za), &mul(&v, &zb)), &mul(&w, &zc));
    hits.t = div(&scaled_t, &det);
    hits.mask =
        inside & isa.le(t_near, &hits.t) & isa.le(&hits.t, t_far) & isa.lt(&hits.t, &[f32::INFINITY; N]);
    let mut undecided = on_edge;
    // Compute the weights, and mark hits that may be behind the start
    if hits.mask != 0 {
        hits.u = div(&v, &det);
        hits.v = div(&w, &det);
        if I::IS_EXACT {
            let rows = [&a, &b, &c].map(|[x, y, z]| [x, y, z]);
            undecided |= hits.mask & may_be_behind(isa, rows, &sz, &det, [t_near, &hits.t]);
        }
    }
    EdgeTest { hits, undecided }
}

/// Projects vertices to the sheared frame: x, y and the unscaled z.
#[inline(always)]
fn project<const N: usize>(
    [x, y, z]: [&[f32; N]; 3],
    origin: &[[f32; N]; 3],
    shear: &[[f32; N]; 2],
) -> [[f32; N]; 3] {
    let z = sub(z, &origin[2]);
    let x = sub(&sub(x, &origin[0]), &mul(&shear[0], &z));
    let y = sub(&sub(y, &origin[1]), &mul(&shear[1], &z));
    [x, y, z]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::simd::{SimdKernel, dispatch};
    use crate::numeric::{Ray, spawn_point, triangle_spawn_error};
    use glam::DVec3;

    /// Generator of numbers in [0, 1): a 64-bit linear congruential generator (Knuth's multiplier).
    pub(super) struct Random(pub(super) u64);

    impl Random {
        pub(super) fn next(&mut self) -> f64 {
            self.0 = self
                .0
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }

        pub(super) fn vector(&mut self) -> DVec3 {
            DVec3::new(self.next(), self.next(), self.next()) * 2.0 - DVec3::ONE
        }
    }

    fn ray(origin: DVec3, direction: DVec3) -> Ray {
        Ray::new(origin.as_vec3(), direction.as_vec3())
    }

    /// Returns a ray spawned at a random point of the triangle, at an angle of at least 3 degrees to its plane; `None`
    /// for flatter rays and for triangles without area.
    pub(super) fn spawned_ray(corners: [Vec3; 3], random: &mut Random) -> Option<Ray> {
        let [a, b, c] = corners.map(|p| p.as_dvec3());
        let normal = (b - a).cross(c - a).try_normalize()?;
        let (u, v) = (random.next(), random.next());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let p = a + u * (b - a) + v * (c - a);
        let error = triangle_spawn_error(corners[0], corners[1] - corners[0], corners[2] - corners[0]);
        let origin = spawn_point(p, normal, error.along(normal));
        let direction = random.vector().normalize() * 5.0;
        (normal.dot(direction) > 0.25).then(|| Ray::new(origin, direction.as_vec3()))
    }

    /// Returns a closed mesh: an octahedron subdivided once and displaced irregularly.
    fn closed_mesh() -> Vec<[Vec3; 3]> {
        let corners = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z];
        let faces = [
            [0, 1, 2],
            [1, 3, 2],
            [3, 4, 2],
            [4, 0, 2],
            [1, 0, 5],
            [3, 1, 5],
            [4, 3, 5],
            [0, 4, 5],
        ];
        let push = |p: Vec3| p.normalize() * (1.0 + 0.2 * (7.0 * p.x + 3.0 * p.y - 5.0 * p.z).sin());
        let mut triangles = Vec::new();
        for face in faces {
            let [a, b, c] = face.map(|i: usize| corners[i]);
            let [ab, bc, ca] = [a + b, b + c, c + a].map(|p| p * 0.5);
            for t in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
                triangles.push(t.map(push));
            }
        }
        triangles
    }

    #[test]
    fn hand_computed_hit_has_embrees_barycentric_weights() {
        // (0.25, 0.5) = (1 - 0.25 - 0.5) v0 + 0.25 v1 + 0.5 v2, and z falls from 3 to 0 over t = 3.
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let ray = Ray::new(Vec3::new(0.25, 0.5, 3.0), Vec3::new(0.0, 0.0, -1.0));
        let hit = Shear::new(&ray).intersect(corners, 0.0, f32::INFINITY);
        assert_eq!(
            hit,
            Some(TriangleHit {
                t: 3.0,
                u: 0.25,
                v: 0.5
            })
        );
        let [a, b, c] = corners;
        assert_eq!(
            Shear::new(&ray)
                .intersect([a, c, b], 3.0, 3.0)
                .map(|h| (h.u, h.v)),
            Some((0.5, 0.25))
        );
        assert_eq!(Shear::new(&ray).intersect(corners, 0.0, 3f32.next_down()), None);
        assert_eq!(Shear::new(&ray).intersect(corners, 3f32.next_up(), 9.0), None);
    }

    #[test]
    fn edge_on_or_degenerate_triangle_is_missed() {
        let shear = Shear::new(&Ray::new(Vec3::ZERO, Vec3::X));
        assert_eq!(
            shear.intersect([[1.0, 0.0, -1.0], [2.0, 0.0, 1.0], [3.0, 0.0, 0.0]], 0.0, 9.0),
            None
        );
        assert_eq!(shear.intersect([[1.0, 0.0, 0.0]; 3], 0.0, 9.0), None);
        assert_eq!(
            shear.intersect([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0]], 0.0, 9.0),
            None
        );
    }

    #[test]
    fn no_ray_leaves_a_closed_mesh_through_corners_or_edges() {
        let mesh = closed_mesh();
        let mut random = Random(7);
        let mut leaks = 0;
        for _ in 0..31_250 {
            // Aim at a vertex and a point of an edge of 16 triangles, from one random inner point: 10^6 rays
            let origin = random.vector() * 0.2;
            for &[a, b, _] in mesh.iter().take(16) {
                let along = random.next();
                let edge = a.as_dvec3().lerp(b.as_dvec3(), along);
                for target in [a.as_dvec3(), edge] {
                    let shear = Shear::new(&ray(origin, target - origin));
                    let hit = |t: &[Vec3; 3]| {
                        shear
                            .intersect(t.map(|p| p.to_array()), 0.0, f32::INFINITY)
                            .is_some()
                    };
                    leaks += u32::from(!mesh.iter().any(hit));
                }
            }
        }
        assert_eq!(leaks, 0);
    }

    #[test]
    fn simd_tests_of_triangles_and_rays_match_scalar_bits() {
        let mesh = closed_mesh();
        let mut pack = TrianglePack::EMPTY;
        for (lane, &corners) in mesh.iter().skip(3).take(7).enumerate() {
            pack.set(lane, corners);
        }
        let mut random = Random(11);
        let mut hit_count = 0;
        for round in 0..20_000 {
            // Make sixteen rays with the same dominant axis
            let aim = pack.triangle(round % 7).map(|p| Vec3::from(p).as_dvec3());
            let mut rays = Vec::new();
            while rays.len() < 16 {
                // Aim a quarter of them at vertices, the others anywhere
                let target = if rays.len() % 4 == 0 {
                    aim[rays.len() / 4 % 3]
                } else {
                    random.vector()
                };
                let candidate = ray(random.vector() * 3.0, DVec3::ZERO);
                let candidate = ray(candidate.origin.as_dvec3(), target - candidate.origin.as_dvec3());
                if dominant_axis(candidate.direction.to_array()) == round % 3 {
                    rays.push(candidate);
                }
            }
            // Compare sixteen rays, eight triangles, and the best instruction set with the reference
            let lane_rows = |f: &dyn Fn(&Ray) -> Vec3| {
                [0, 1, 2].map(|axis| std::array::from_fn::<f32, 16, _>(|i| f(&rays[i])[axis]))
            };
            let shears = ShearLanes::new(round % 3, &lane_rows(&|r| r.origin), &lane_rows(&|r| r.direction));
            let (near, far) = ([0.0; 16], [2.0; 16]);
            for triangle in 0..8 {
                let lanes = shears.intersect(Scalar, pack.triangle(triangle), &near, &far);
                for (i, r) in rays.iter().enumerate() {
                    let one = Shear::new(r).intersect(pack.triangle(triangle), 0.0, 2.0);
                    assert_eq!(lane_hit(&lanes, i), one);
                    let eight = Shear::new(r).intersect_pack(Scalar, &pack, 0.0, 2.0);
                    assert_eq!(lane_hit(&eight, triangle), one);
                    let best = dispatch(Eight(Shear::new(r), pack));
                    assert_eq!(lane_hit(&best, triangle), one);
                    hit_count += u32::from(one.is_some());
                }
            }
        }
        assert!(hit_count > 10_000, "only {hit_count} hits");
    }

    /// Kernel that intersects eight triangles on the best instruction set.
    struct Eight(Shear, TrianglePack);

    impl SimdKernel for Eight {
        type Output = LaneHits<PACK>;

        #[inline(always)]
        fn run<I: SimdLevel>(self, isa: I) -> LaneHits<PACK> {
            self.0.intersect_pack(isa, &self.1, 0.0, 2.0)
        }
    }

    fn lane_hit<const N: usize>(hits: &LaneHits<N>, lane: usize) -> Option<TriangleHit> {
        (hits.mask >> lane & 1 == 1).then(|| TriangleHit {
            t: hits.t[lane],
            u: hits.u[lane],
            v: hits.v[lane],
        })
    }
}
