//! Fresnel's equations for metals, whose index of refraction is complex: eta + i k.
//!
//! With t = eta² - k² - sin², the normal component of the refracted wave vector is a + i b, (a + i b)² = t + 2 i eta k.
//! Both reflectances are then quotients of sums of squares (Born and Wolf, Principles of Optics, 7th ed., section
//! 14.2). The smaller of a and b comes from their product eta k, not from a difference.

use super::polarised::Polarised;

/// Complex index of refraction of a metal for linear red, green and blue, each channel at one wavelength: 650, 550 and
/// 450 nm.
///
/// Values: the Brendel-Bormann model fitted by Rakić, Djurišić, Elazar and Majewski, "Optical properties of metallic
/// films for vertical-cavity optoelectronic devices", Applied Optics 37(22), 1998.
/// films for vertical-cavity optoelectronic devices", Applied Optics 37(22), 1998.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conductor {
    /// Real part of the index.
    pub eta: [f64; 3],
    /// Extinction coefficient, the imaginary part of the index.
    pub k: [f64; 3],
}

impl Conductor {
    /// Optical constants of gold.
    pub const GOLD: Conductor = Conductor {
        eta: [0.18299, 0.42108, 1.3734],
        k: [3.4242, 2.3459, 1.7704],
    };
    /// Optical constants of silver.
    pub const SILVER: Conductor = Conductor {
        eta: [0.15943, 0.14512, 0.13547],
        k: [3.9291, 3.1900, 2.3808],
    };
    /// Optical constants of copper.
    pub const COPPER: Conductor = Conductor {
        eta: [0.27105, 0.67693, 1.3164],
        k: [3.6092, 2.6248, 2.2921],
    };
    /// Optical constants of aluminium.
    pub const ALUMINIUM: Conductor = Conductor {
        eta: [1.3456, 0.96521, 0.61722],
        k: [7.4746, 6.3995, 5.3031],
    };

    /// Returns the fraction of unpolarised light that a smooth surface in a medium of index `eta_i` reflects, by
    /// channel.
    pub fn reflectance(&self, cos_i: f64, eta_i: f64) -> [f64; 3] {
        std::array::from_fn(|c| conductor(cos_i, self.eta[c] / eta_i, self.k[c] / eta_i).mean())
    }
}

/// Returns the fraction of light that a smooth conductor reflects; the remainder to 1 is absorbed.
///
/// `cos_i` is as for [`dielectric`](super::dielectric); `eta` > 0 and `k` >= 0 are relative to the incident medium.
/// Without extinction it is a dielectric.
#[inline(always)]
pub fn conductor(cos_i: f64, eta: f64, k: f64) -> Polarised {
    let cos_i = if cos_i > 1.0 { 1.0 } else { cos_i };
    let sin_square = (1.0 - cos_i) * (1.0 + cos_i);
    let t = (eta - k) * (eta + k) - sin_square;
    let (a, b) = square_root(t, eta * k);
    // Reflectances are quotients of sums of squares
    let s_minus = (a - cos_i) * (a - cos_i) + b * b;
    let s_plus = (a + cos_i) * (a + cos_i) + b * b;
    let along = a * cos_i;
    let across = (b * cos_i) * (b * cos_i);
    let p_minus = (along - sin_square) * (along - sin_square) + across;
    let p_plus = (along + sin_square) * (along + sin_square) + across;
    let s = if s_plus > 0.0 { s_minus / s_plus } else { 1.0 };
    let p = if p_plus > 0.0 { s * (p_minus / p_plus) } else { s };
    Polarised { s, p }
}

/// Returns the square root a + i b of t + 2 i `half`, `half` >= 0.
#[inline(always)]
fn square_root(t: f64, half: f64) -> (f64, f64) {
    let modulus = (t * t + 4.0 * half * half).sqrt();
    let larger = (0.5 * (modulus + t.abs())).sqrt();
    let smaller = if larger > 0.0 { half / larger } else { 0.0 };
    if t >= 0.0 {
        (larger, smaller)
    } else {
        (smaller, larger)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::dielectric;

    #[test]
    fn normal_reflectance_equals_the_closed_form() {
        // ((eta - 1)² + k²) / ((eta + 1)² + k²): gold's green 5.8384 / 7.5227, silver's green 10.9069 / 11.4874.
        for (eta, k) in [(0.42108, 2.3459), (0.14512, 3.19), (6.0, 0.1)] {
            let expected = ((eta - 1.0f64).powi(2) + k * k) / ((eta + 1.0f64).powi(2) + k * k);
            let found = conductor(1.0, eta, k);
            // About a dozen roundings of 2^-53 in sums of squares.
            assert!((found.s - expected).abs() <= 8.0 * f64::EPSILON);
            assert!((found.p - expected).abs() <= 8.0 * f64::EPSILON);
        }
    }

    #[test]
    fn conductor_without_extinction_is_a_dielectric() {
        for eta in [1.0 / 1.5, 1.2, 2.4] {
            for step in 1..100 {
                let cos_i = f64::from(step) / 100.0;
                let (metal, glass) = (
                    conductor(cos_i, eta, 0.0),
                    dielectric(cos_i, 1.0, eta).reflectance,
                );
                // The difference a - cos_i carries a's rounding errors, amplified by up to 1/cos_t at the critical
                // angle; the steps stay 1e-3 away from it.
                assert!(
                    (metal.s - glass.s).abs() < 1e-13 && (metal.p - glass.p).abs() < 1e-13,
                    "{eta} {cos_i}"
                );
            }
        }
    }

    #[test]
    fn agrees_with_complex_arithmetic_at_an_oblique_angle() {
        // Gold's green at 60 degrees, from 60-digit complex arithmetic; about a dozen roundings of 2^-53.
        let found = conductor(0.5, 0.42108, 2.3459);
        assert!((found.s - 0.887_507_172_114_208_1).abs() <= 8.0 * f64::EPSILON);
        assert!((found.p - 0.673_077_469_845_570_7).abs() <= 8.0 * f64::EPSILON);
    }

    #[test]
    fn reflectance_is_at_most_one_and_one_at_grazing() {
        for metal in [
            Conductor::GOLD,
            Conductor::SILVER,
            Conductor::COPPER,
            Conductor::ALUMINIUM,
        ] {
            for step in 0..=1000 {
                let shares = metal.reflectance(f64::from(step) / 1000.0, 1.0);
                assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)));
            }
            assert_eq!(metal.reflectance(0.0, 1.0), [1.0; 3]);
        }
    }

    #[test]
    fn gold_and_copper_are_warm_and_silver_and_aluminium_nearly_grey() {
        for (metal, expected) in [
            (Conductor::GOLD, [0.943, 0.776, 0.373]),
            (Conductor::COPPER, [0.926, 0.721, 0.504]),
            (Conductor::SILVER, [0.962, 0.949, 0.922]),
            (Conductor::ALUMINIUM, [0.912, 0.914, 0.920]),
        ] {
            let found = metal.reflectance(1.0, 1.0);
            for channel in 0..3 {
                assert!((found[channel] - expected[channel]).abs() < 1.5e-2, "{found:?}");
            }
        }
    }
}
