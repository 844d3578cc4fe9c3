//! Thin wall of a dielectric, such as a window pane or a soap film without interference.
//!
//! Light is reflected between the two faces repeatedly; the geometric series of all internal reflections gives 2R/(1 +
//! R) reflected and (1 - R)/(1 + R) transmitted for each polarisation. Transmitted light keeps its direction.

use super::fresnel::dielectric;
use super::polarised::Polarised;

/// Reflectance and transmittance of a thin wall, all internal reflections included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThinSlab {
    /// Reflected over incident power.
    pub reflectance: Polarised,
    /// Transmitted over incident power.
    pub transmittance: Polarised,
}

/// Returns reflectance and transmittance of a wall of index `eta_slab` with a medium of index `eta_outside` on both
/// sides.
///
/// `cos_i` is as for [`dielectric`]. Nothing is absorbed.
#[inline(always)]
pub fn thin_slab(cos_i: f64, eta_outside: f64, eta_slab: f64) -> ThinSlab {
    let face = dielectric(cos_i, eta_outside, eta_slab);
    let series = |r: f64, t: f64| (2.0 * r / (1.0 + r), t / (1.0 + r));
    let s = series(face.reflectance.s, face.transmittance.s);
    let p = series(face.reflectance.p, face.transmittance.p);
    ThinSlab {
        reflectance: Polarised { s: s.0, p: p.0 },
        transmittance: Polarised { s: s.1, p: p.1 },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_pane_passes_twelve_thirteenths_head_on() {
        // R = 0.04, (1 - R)/(1 + R) = 0.96/1.04 = 12/13 = 0.923077.
        let pane = thin_slab(1.0, 1.0, 1.5);
        assert!((pane.transmittance.mean() - 12.0 / 13.0).abs() <= 4.0 * f64::EPSILON);
        assert!((pane.reflectance.mean() - 1.0 / 13.0).abs() <= 4.0 * f64::EPSILON);
    }

    #[test]
    fn the_closed_form_is_the_sum_of_all_internal_reflections() {
        for degrees in [0.0f64, 30.0, 60.0, 80.0] {
            let cos_i = degrees.to_radians().cos();
            let face = dielectric(cos_i, 1.0, 1.5);
            let (r, t) = (face.reflectance.s, face.transmittance.s);
            // R < 0.7 here, so after 200 terms less than 0.7^400 remains.
            let passes: f64 = (0..200).map(|k| t * t * r.powi(2 * k)).sum();
            let slab = thin_slab(cos_i, 1.0, 1.5);
            assert!(
                (slab.transmittance.s - passes).abs() <= 16.0 * f64::EPSILON,
                "{degrees}"
            );
            let reflected = r + r * passes;
            assert!(
                (slab.reflectance.s - reflected).abs() <= 16.0 * f64::EPSILON,
                "{degrees}"
            );
        }
    }

    #[test]
    fn air_film_under_water_reflects_totally_beyond_critical_angle() {
        let film = thin_slab(0.5, 1.33, 1.0);
        assert_eq!(film.reflectance, Polarised { s: 1.0, p: 1.0 });
        assert_eq!(film.transmittance, Polarised { s: 0.0, p: 0.0 });
    }
}
