//! Sampling warps from the unit square to disks, triangles, spheres and linear densities.
//!
//! Each map is continuous or nearly so and preserves relative areas, so well-distributed points stay well distributed.
//! Inputs lie in [0, 1).

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, TAU};

use glam::{DVec2, DVec3};

use super::lane_math::sin_cos;

/// Returns a point of the unit disk, uniform in area (P. Shirley, K. Chiu, "A Low Distortion Map Between Disk and
/// Square", JGT 2(3), 1997).
#[inline(always)]
pub fn disk(u: [f64; 2]) -> DVec2 {
    let (x, y) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    // Map concentric squares to concentric circles; the centre has a radius of zero at any angle
    let is_wide = x.abs() > y.abs();
    let radius = if is_wide { x } else { y };
    let across = if is_wide { y } else { x };
    let part = FRAC_PI_4 * (across / if radius == 0.0 { 1.0 } else { radius });
    let [sin, cos] = sin_cos(if is_wide { part } else { FRAC_PI_2 - part });
    DVec2::new(radius * cos, radius * sin)
}

/// Returns the barycentric weights of a triangle's second and third vertex for a point uniform in area (E. Heitz, "A
/// Low-Distortion Map Between Triangle and Square", 2019).
#[inline(always)]
pub fn triangle(u: [f64; 2]) -> [f64; 2] {
    if u[1] > u[0] {
        let second = 0.5 * u[0];
        [second, u[1] - second]
    } else {
        let third = 0.5 * u[1];
        [u[0] - third, third]
    }
}

/// Returns the unit vector whose cosine with +z is 1 - `below`, rotated about +z by `turn` (a fraction of a full turn)
/// from +x.
///
/// Because the argument is the difference of the cosine from 1, narrow cones keep their digits: sin² = `below` (2 -
/// `below`). If it is uniform over [0, b), the result is uniform in solid angle over the cone of cosine 1 - b
/// (Archimedes).
#[inline(always)]
pub fn direction(below: f64, turn: f64) -> DVec3 {
    let sin = (below * (2.0 - below)).max(0.0).sqrt();
    let [sin_turn, cos_turn] = sin_cos(TAU * turn);
    DVec3::new(sin * cos_turn, sin * sin_turn, 1.0 - below)
}

/// Samples the linear density (1 - t) `start` + t `end` by inversion: returns the t in [0, 1] below which the share `u`
/// of the density lies.
///
/// `start` and `end` must not be negative; if both are zero, the density is constant. The root of the quadratic is
/// computed in the form without cancellation.
#[inline(always)]
pub fn linear(start: f64, end: f64, u: f64) -> f64 {
    let below = start + ((1.0 - u) * start * start + u * end * end).sqrt();
    // Fall back to a root of 0, or to the constant density, where the quotient is 0 / 0
    if below > 0.0 {
        (u * (start + end) / below).min(1.0)
    } else if start + end > 0.0 {
        0.0
    } else {
        u
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the centres of `count` by `count` cells.
    fn grid(count: u32) -> impl Iterator<Item = [f64; 2]> {
        let middle = move |i: u32| (f64::from(i) + 0.5) / f64::from(count);
        (0..count * count).map(move |i| [middle(i % count), middle(i / count)])
    }

    #[test]
    fn disk_samples_are_uniform_by_area() {
        let inside = grid(512)
            .filter(|&u| {
                let p = disk(u);
                assert!(p.length() <= 1.0 + 2.0 * f64::EPSILON);
                p.length() < 0.5
            })
            .count();
        // Circles are images of squares: |x|, |y| < 1/2 contains exactly a quarter of the cells.
        assert_eq!(inside, 512 * 512 / 4);
        assert_eq!(disk([0.5, 0.5]), DVec2::ZERO);
        assert!((disk([0.0, 0.5]) - DVec2::NEG_X).length() < 1e-15);
    }

    #[test]
    fn disk_second_moments_are_uniform() {
        let cells = 512;
        let mut moment = [0.0; 3];
        for u in grid(cells) {
            let p = disk(u);
            moment = [
                moment[0] + p.x * p.x,
                moment[1] + p.y * p.y,
                moment[2] + p.x * p.y,
            ];
        }
        // The mean of x² is 1/4, of xy 0; the error of the midpoint rule is about the square of the cell's size.
        let count = f64::from(cells * cells);
        assert!((moment[0] / count - 0.25).abs() < 1e-5 && (moment[1] / count - 0.25).abs() < 1e-5);
        assert!((moment[2] / count).abs() < 1e-12);
    }

    #[test]
    fn triangle_samples_lie_inside_with_uniform_moments() {
        let cells = 512;
        let mut sum = [0.0; 3];
        for u in grid(cells) {
            let [b, c] = triangle(u);
            assert!(b >= 0.0 && c >= 0.0 && b + c <= 1.0);
            sum = [sum[0] + b, sum[1] + b * b, sum[2] + b * c];
        }
        let count = f64::from(cells * cells);
        // Dirichlet(1, 1, 1) has means 1/3, squares 1/6, products 1/12.
        for (found, exact) in sum.into_iter().zip([1.0 / 3.0, 1.0 / 6.0, 1.0 / 12.0]) {
            assert!((found / count - exact).abs() < 1e-5, "{found}");
        }
    }

    #[test]
    fn narrow_cone_samples_are_accurate() {
        // 1 - cos = 1e-20: sin = sqrt(2e-20).
        let w = direction(1e-20, 0.25);
        assert_eq!(w.z, 1.0);
        assert!((w.y / 2e-20f64.sqrt() - 1.0).abs() < 4.0 * f64::EPSILON);
        assert_eq!(direction(2.0, 0.3).z, -1.0);
    }

    #[test]
    fn linear_density_is_inverted_at_every_slope() {
        for (start, end) in [
            (1.0, 1.0),
            (0.0, 1.0),
            (1.0, 0.0),
            (1e-30, 1e30),
            (3.0, 5.0),
            (1e38, 1e-38),
        ] {
            for step in 0..=64 {
                let u = f64::from(step) / 64.0;
                let t = linear(start, end, u);
                let share = t * (2.0 * start + t * (end - start)) / (start + end);
                assert!((0.0..=1.0).contains(&t));
                // The tolerance covers the share's own rounding, and twice that of t where all density is at one end.
                assert!(
                    (share - u).abs() <= 8.0 * f64::EPSILON,
                    "{start} {end} {u}: {share}"
                );
            }
        }
        assert_eq!(linear(0.0, 0.0, 0.3), 0.3);
        assert_eq!(linear(0.0, 2.0, 0.0), 0.0);
    }
}
