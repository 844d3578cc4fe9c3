//! Self-hit check: hits so near the start of their ray that rounding may have put them there.
//!
//! The origin of a ray spawned on a triangle is offset by an error bound of the hit point. If the triangle is a sliver,
//! that is less than the rounding error of the parameter: an edge function has an error of the last places of its
//! products, which is a large part of a sliver's area, and the parameter has an error of the same part of the
//! triangle's depth. Therefore a hit that is as near the start as its own error is decided again, in f64 and from the
//! original vertices, and is discarded if the ray intersects the plane behind the start. A hit that remains keeps its
//! parameter: if it were clamped to the start, it would tie there with coincident primitives, and which of two boxes
//! that end at the start is entered depends on the traversal.
//!
//! With `m` the largest projected coordinate, `R` the largest depth of a vertex and `S` the depth between the nearest
//! and the farthest, all in units of the dominant axis, and `u = 2^-24`: a projected coordinate has an error of at most
//! `3 u (m + 2 R)`, as have three roundings of sums up to there; an edge function of `2 u m² + 4 m · 3 u (m + 2 R)`;
//! the mean of depths of three of these times `S` over the determinant, so of less than `72 u m (m + R) S / |det|`, and
//! of `8 u R` from its own sum and quotient.

use glam::DVec3;

use super::shear::Shear;
use crate::mesh::simd::{SimdLevel, max, min};

/// Error of the parameter from the weights, relative to `m (m + R) S / |det|`: 128 units of roundoff, more than 72
/// because the bound is itself computed in f32.
const WEIGHT_ERROR: f32 = 1.0 / (1 << 17) as f32;
/// Error of the parameter from the depths, relative to `R`: 8 units of roundoff.
const DEPTH_ERROR: f32 = 1.0 / (1 << 21) as f32;

/// Returns a mask whose bit `i` says that the hit of lane `i` at `t` is so close to the start of the ray, `t_near`,
/// that it may be behind it. `corners` are projected: x, y and the unscaled depth; `scale` is that of depths.
#[inline(always)]
pub(super) fn may_be_behind<I: SimdLevel, const N: usize>(
    isa: I,
    corners: [[&[f32; N]; 3]; 3],
    scale: &[f32; N],
    det: &[f32; N],
    [t_near, t]: [&[f32; N]; 2],
) -> u32 {
    let [a, b, c] = corners;
    let [mut bound, mut ahead] = [[0.0; N]; 2];
    for i in 0..N {
        // Bound the error of the parameter, times the determinant
        let m = max(
            max(max(a[0][i].abs(), b[0][i].abs()), c[0][i].abs()),
            max(max(a[1][i].abs(), b[1][i].abs()), c[1][i].abs()),
        );
        let nearest = min(min(a[2][i], b[2][i]), c[2][i]);
        let farthest = max(max(a[2][i], b[2][i]), c[2][i]);
        let reach = max(farthest.abs(), nearest.abs());
        let weight_error = WEIGHT_ERROR * m * (m + reach) * (farthest - nearest);
        bound[i] = scale[i].abs() * (weight_error + DEPTH_ERROR * reach * det[i].abs());
        // Compare the distance from the start with the bound, both times the determinant
        ahead[i] = (t[i] - t_near[i]) * det[i].abs();
    }
    isa.le(&ahead, &bound)
}

impl Shear {
    /// Returns whether the ray intersects the plane of a triangle before `t_near`; false if that is uncertain.
    ///
    /// The intersection is searched between the nearest and the farthest vertex. Its sign is correct: differences of
    /// f32 are exact in f64, and the ray's direction has an error in its last place only, which scales the parameter.
    #[cold]
    #[inline(never)]
    pub(super) fn plane_is_before(&self, corners: [[f32; 3]; 3], t_near: f32) -> bool {
        let [kx, ky, kz] = self.axes;
        let origin = DVec3::from_array(self.origin.map(f64::from));
        let [a, b, c] = corners.map(|p| DVec3::from_array([p[kx], p[ky], p[kz]].map(f64::from)) - origin);
        let [sx, sy, sz] = self.shear.map(f64::from);
        let normal = (b - a).cross(c - a);
        let depth = normal.dot(a) / normal.dot(DVec3::new(sx, sy, 1.0));
        let nearest = a.z.min(b.z).min(c.z);
        let farthest = a.z.max(b.z).max(c.z);
        depth.is_finite() && sz * depth.clamp(nearest, farthest) < f64::from(t_near)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::tests::{Random, spawned_ray};
    use super::super::{PACK, ShearLanes, TrianglePack, dominant_axis};
    use super::*;
    use crate::mesh::simd::{F32Only, Scalar};

    /// Returns a triangle near the cube [-1, 1]³ of that aspect ratio, length over height.
    fn sliver(random: &mut Random, aspect: f64) -> [Vec3; 3] {
        let a = random.vector();
        let along = random.vector();
        let across = along.cross(random.vector()).normalize() * along.length() / aspect;
        [a, a + along, a + random.next() * along + across].map(|p| p.as_vec3())
    }

    #[test]
    fn rays_leaving_a_sliver_do_not_hit_it_again() {
        let mut random = Random(23);
        for aspect in [1.0, 10.0, 100.0, 1e3, 1e4, 1e5] {
            let mut hit_count = 0;
            for _ in 0..20_000 {
                let corners = sliver(&mut random, aspect);
                let Some(ray) = spawned_ray(corners, &mut random) else {
                    continue;
                };
                // Intersect one triangle, eight triangles, and several rays
                let corners = corners.map(|p| p.to_array());
                let shear = Shear::new(&ray);
                let one = shear.intersect(corners, 0.0, f32::INFINITY);
                let mut pack = TrianglePack::EMPTY;
                pack.set(3, corners.map(Vec3::from));
                let eight = shear.intersect_pack(Scalar, &pack, 0.0, f32::INFINITY);
                let rows = |v: Vec3| v.to_array().map(|x| [x; PACK]);
                let dominant = dominant_axis(ray.direction.to_array());
                let shears = ShearLanes::new(dominant, &rows(ray.origin), &rows(ray.direction));
                let lanes = shears.intersect(Scalar, corners, &[0.0; PACK], &[f32::INFINITY; PACK]);
                hit_count += u32::from(one.is_some() || eight.mask != 0 || lanes.mask != 0);
            }
            assert_eq!(hit_count, 0, "{aspect} times as long as high");
        }
    }

    #[test]
    fn f32_alone_hits_slivers_again_and_shares_edges() {
        let mut random = Random(23);
        let mut hit_count = 0;
        for _ in 0..20_000 {
            let corners = sliver(&mut random, 1e4);
            let Some(ray) = spawned_ray(corners, &mut random) else {
                continue;
            };
            let mut pack = TrianglePack::EMPTY;
            pack.set(3, corners);
            let hits = Shear::new(&ray).intersect_pack(F32Only(Scalar), &pack, 0.0, f32::INFINITY);
            hit_count += u32::from(hits.mask == 1 << 3);
        }
        assert!(hit_count > 0);
        let mut pack = TrianglePack::EMPTY;
        let [a, b, c, d] =
            [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 2.0));
        pack.set(0, [a, b, c]);
        pack.set(5, [b, a, d]);
        let ray = crate::numeric::Ray::new(Vec3::new(0.5, 0.5, 0.0), Vec3::Z);
        let hits = Shear::new(&ray).intersect_pack(F32Only(Scalar), &pack, 0.0, f32::INFINITY);
        assert_eq!((hits.mask, hits.t[0], hits.t[5]), (1 | 1 << 5, 2.0, 2.0));
    }

    #[test]
    fn hits_behind_the_origin_are_separated_from_hits_ahead() {
        let corners = [[0.0, 0.0, 3.0], [1.0, 0.0, 3.5], [0.0, 1.0, 4.0]];
        let ray = crate::numeric::Ray::new(Vec3::new(0.2, 0.3, 0.0), Vec3::Z);
        let shear = Shear::new(&ray);
        // The ray intersects the plane at 3 + 0.2 · 0.5 + 0.3 · 1 = 3.4, up to the rounding of 0.2 and 0.3.
        assert!(!shear.plane_is_before(corners, 3.4 * (1.0 - f32::EPSILON)));
        assert!(shear.plane_is_before(corners, 3.4 * (1.0 + f32::EPSILON)));
        // A triangle without area has no plane.
        assert!(!shear.plane_is_before([[0.0; 3]; 3], 7.0));
    }

    #[test]
    fn hit_at_the_ray_origin_is_kept() {
        let mut random = Random(5);
        let mut hit_count = 0;
        for _ in 0..10_000 {
            // In a plane of constant depth every sum is exact, and so is an origin in the plane.
            let [a, b, c] = sliver(&mut random, 1.0).map(|p| p.with_z(0.75));
            let origin = (a + b + c) / 3.0;
            let shear = Shear::new(&crate::numeric::Ray::new(
                origin.with_z(0.75),
                Vec3::new(0.3, -0.2, 0.9),
            ));
            let hit = shear.intersect([a, b, c].map(|p| p.to_array()), 0.0, 1.0);
            hit_count += u32::from(hit.is_some_and(|hit| hit.t == 0.0));
        }
        assert!(hit_count > 9_900, "{hit_count}");
    }
}
