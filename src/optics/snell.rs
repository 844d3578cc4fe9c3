//! Snell's law: reflected and refracted directions, the critical angle and Brewster's angle.

use glam::DVec3;

use super::dielectric_interface::{DielectricInterface, face_forward};

/// Refracted ray behind a boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refraction {
    /// Direction of travel of the refracted ray; unit up to rounding.
    pub direction: DVec3,
    /// Cosine of that direction with the normal on the far side, within (0, 1].
    pub cos_t: f64,
}

/// Returns the direction `v` mirrored at a plane of unit normal `n`: v - 2 (v·n) n. The normal may point to either
/// side.
#[inline(always)]
pub fn reflect(v: DVec3, n: DVec3) -> DVec3 {
    v - 2.0 * v.dot(n) * n
}

/// Returns the refracted ray of the direction `d` behind the boundary from index `eta_i` to `eta_t`; `None` on total
/// internal reflection.
///
/// `d` and `n` are unit vectors to f64 accuracy; vectors widened from f32 must be normalised again, or the angle
/// carries their error. `n` may point to either side. Indices are positive and finite.
#[inline(always)]
pub fn refract(d: DVec3, n: DVec3, eta_i: f64, eta_t: f64) -> Option<Refraction> {
    let (cos_i, n) = face_forward(d, n);
    let interface = DielectricInterface::new(cos_i, eta_i, eta_t);
    if interface.total {
        return None;
    }
    Some(Refraction {
        direction: interface.refract(d, n),
        cos_t: interface.cos_t(),
    })
}

/// Returns the index of refraction of a medium in which light travels at `fraction` of its speed in vacuum, within (0,
/// 1].
///
/// Snell's law with speeds, sin_t / sin_i = c_t / c_i, is the one with indices, as eta = 1 / fraction.
pub fn ior_from_speed(fraction: f64) -> f64 {
    1.0 / fraction
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{LINE_C, LINE_D, LINE_F, Sellmeier, dielectric};

    /// Wavelengths of seven spectral lines from violet to red, nanometres.
    const LINES: [f64; 7] = [404.66, 435.84, LINE_F, 546.07, LINE_D, LINE_C, 706.52];

    /// Returns the direction in the xy plane at `degrees` from the x axis.
    fn at(degrees: f64) -> DVec3 {
        let (sin, cos) = degrees.to_radians().sin_cos();
        DVec3::new(cos, sin, 0.0)
    }

    /// Returns the angle between two directions in degrees, accurate for small angles too.
    fn degrees_between(a: DVec3, b: DVec3) -> f64 {
        a.cross(b).length().atan2(a.dot(b)).to_degrees()
    }

    #[test]
    fn a_ray_at_60_degrees_is_refracted_to_28_444937_degrees() {
        // Snell's law for c2/c1 = 0.55: asin(0.55 sin 60°) = 28.444937144°.
        let refraction = refract(at(-30.0), DVec3::Y, ior_from_speed(1.0), ior_from_speed(0.55)).unwrap();
        assert_eq!(ior_from_speed(0.5), 2.0);
        assert!((refraction.cos_t.acos().to_degrees() - 28.444937144).abs() < 5e-10);
        assert!((degrees_between(refraction.direction, -DVec3::Y) - 28.444937144).abs() < 5e-10);
    }

    #[test]
    fn reflection_keeps_the_angle_for_either_normal() {
        let v = DVec3::new(1.0, -2.0, 3.0);
        assert_eq!(reflect(v, DVec3::Y), DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(reflect(v, -DVec3::Y), DVec3::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn the_side_of_the_normal_does_not_matter() {
        let (d, n) = (at(-35.0), at(80.0));
        assert_eq!(refract(d, n, 1.0, 1.5), refract(d, -n, 1.0, 1.5));
    }

    #[test]
    fn refracted_directions_are_unit_and_obey_snells_law() {
        for (eta_i, eta_t) in [(1.0, 1.5), (1.5, 1.0), (1.0, 2.42), (1.33, 1.3300001)] {
            for tenth in 1..900 {
                let d = at(-f64::from(tenth) / 10.0);
                let Some(Refraction { direction, cos_t }) = refract(d, DVec3::Y, eta_i, eta_t) else {
                    continue;
                };
                // The tangential part eta_i/eta_t d has three roundings; the normal part, cos_t, must compensate, which
                // costs tan_t times that: no more than cos_t² itself near the critical angle.
                assert!(
                    (direction.length() - 1.0).abs() <= 4.0 * f64::EPSILON,
                    "{eta_i} {eta_t} {tenth}"
                );
                assert!((eta_t * direction.x - eta_i * d.x).abs() <= 4.0 * f64::EPSILON * eta_i);
                assert!(
                    (direction.y + cos_t).abs() <= 4.0 * f64::EPSILON,
                    "{eta_i} {eta_t} {tenth}"
                );
            }
        }
    }

    #[test]
    fn a_ray_sent_back_takes_the_same_way() {
        for degrees in 1..90 {
            let d = at(-f64::from(degrees));
            let there = refract(d, DVec3::Y, 1.5, 2.0).unwrap();
            let back = refract(-there.direction, DVec3::Y, 2.0, 1.5).unwrap();
            // cos_t² and cos_i² differ by constants after scaling, so 4 EPSILON of cos_t return as at most (2/1.5)²
            // cos_t / cos_i times as much.
            let bound = 8.0 * f64::EPSILON * (1.0 + 16.0 / 9.0 / d.y.abs());
            assert!((back.direction + d).length() <= bound, "{degrees}");
        }
    }

    #[test]
    fn nearly_equal_media_bend_a_ray_by_their_difference_times_the_tangent() {
        let difference = 2f64.powi(-30);
        let d = at(-30.0);
        let direction = refract(d, DVec3::Y, 1.0, 1.0 + difference).unwrap().direction;
        // tan 60° = 1.7320508; the next term of the series is of the order of the square, 2^-60.
        let bend = d.cross(direction).length();
        assert!(
            (bend - difference * 3f64.sqrt()).abs() <= 2.0 * f64::EPSILON,
            "{bend}"
        );
    }

    #[test]
    fn no_refraction_beyond_the_critical_angle() {
        assert!(refract(at(-90.0 + 41.81), DVec3::Y, 1.5, 1.0).is_some());
        assert_eq!(refract(at(-90.0 + 41.82), DVec3::Y, 1.5, 1.0), None);
        assert_eq!(
            refract(DVec3::X, DVec3::Y, 1.0, 1.5).map(|r| r.cos_t > 0.7),
            Some(true)
        );
        assert_eq!(refract(DVec3::NAN, DVec3::Y, 1.0, 1.5), None);
    }

    #[test]
    fn critical_angles_equal_textbook_values() {
        for (eta, degrees) in [(1.5, 41.810315), (1.33, 48.753467), (2.42, 24.407469)] {
            let refracted = |degrees: f64| refract(at(degrees - 90.0), DVec3::Y, eta, 1.0);
            assert!(refracted(degrees - 5e-7).is_some() && refracted(degrees + 5e-7).is_none());
        }
    }

    #[test]
    fn brewster_angles_equal_textbook_values_and_polarise() {
        for (eta, degrees) in [(1.5, 56.309932), (1.33, 53.061237), (2.42, 67.548454)] {
            let angle = f64::atan(eta);
            assert!((angle.to_degrees() - degrees).abs() <= 5e-7);
            // An amplitude of a few roundings remains; squared it is below one EPSILON².
            let reflectance = dielectric(angle.cos(), 1.0, eta).reflectance;
            assert!(reflectance.p <= f64::EPSILON * f64::EPSILON && reflectance.s > 0.05);
        }
    }

    /// Returns the deviation in degrees of a ray by a prism of 60 degrees at the incidence `i` in degrees.
    fn prism_deviation(n: f64, i: f64) -> f64 {
        // The normals of its faces are at 150 and 30 degrees; light comes from the left.
        let d = at(-30.0 + i);
        let inside = refract(d, at(150.0), 1.0, n).unwrap().direction;
        let out = refract(inside, at(30.0), n, 1.0).unwrap().direction;
        degrees_between(d, out)
    }

    #[test]
    fn prisms_deviate_each_line_by_its_minimum() {
        let bk7 = [39.8353, 39.5194, 39.1381, 38.8158, 38.6467, 38.4291, 38.3038];
        let sf10 = [65.2179, 63.5158, 61.6690, 60.2582, 59.5690, 58.7350, 58.2838];
        for (glass, printed) in [(Sellmeier::BK7, bk7), (Sellmeier::N_SF10, sf10)] {
            for (line, printed) in LINES.into_iter().zip(printed) {
                let n = glass.ior(line);
                // Symmetric passage: sin i = n sin 30°, deviation 2i - 60°.
                let i = (0.5 * n).asin().to_degrees();
                let deviation = prism_deviation(n, i);
                assert!((deviation - (2.0 * i - 60.0)).abs() < 1e-9, "{line}");
                assert!((deviation - printed).abs() <= 5.0001e-5, "{line}: {deviation}");
                assert!(prism_deviation(n, i - 0.5) > deviation && prism_deviation(n, i + 0.5) > deviation);
            }
        }
    }

    /// Returns the angle from the antisolar point at which a ray leaves a drop that it entered at `cos_i`, after
    /// `inner` internal reflections, in degrees.
    fn bow_angle(n: f64, cos_i: f64, inner: usize) -> f64 {
        let d = DVec3::X;
        let mut p = DVec3::new(-cos_i, ((1.0 - cos_i) * (1.0 + cos_i)).sqrt(), 0.0);
        let mut inside = refract(d, p, 1.0, n).unwrap().direction;
        for pass in 0..=inner {
            p -= 2.0 * p.dot(inside) * inside;
            if pass < inner {
                inside = reflect(inside, p);
            }
        }
        degrees_between(-d, refract(inside, p, n, 1.0).unwrap().direction)
    }

    #[test]
    fn water_rainbows_have_observed_angles() {
        let primary = [40.629, 40.988, 41.429, 41.813, 42.019, 42.295, 42.461];
        let secondary = [53.509, 52.859, 52.061, 51.369, 50.996, 50.500, 50.201];
        for (bow, printed) in [(1, primary), (2, secondary)] {
            for (line, printed) in LINES.into_iter().zip(printed) {
                let n = Sellmeier::WATER.ior(line);
                let order = bow as f64;
                let cos_i = ((n * n - 1.0) / (order * (order + 2.0))).sqrt();
                let (i, r) = (cos_i.acos(), (cos_i.acos().sin() / n).asin());
                // Deviation 2(i - r) + k(180° - 2r), measured from the antisolar point.
                let closed = (2.0 * (i - r) + order * (std::f64::consts::PI - 2.0 * r)).to_degrees() - 180.0;
                let traced = bow_angle(n, cos_i, bow);
                assert!((traced - closed.abs()).abs() < 1e-9, "{line}");
                assert!((traced - printed).abs() <= 5.001e-4, "{line}: {traced}");
            }
        }
    }
}
