//! Beer-Lambert absorption: light in an absorbing medium decays as exp(-sigma_a distance).

/// Finite substitute for an infinite coefficient: opaque at any distance, yet 0 times it is 0, and it fits into an f32.
const OPAQUE: f64 = f32::MAX as f64;

/// Absorption of linear red, green and blue in a medium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Absorption {
    /// Absorption coefficients per unit of length; finite and not negative.
    pub sigma_a: [f64; 3],
}

impl Absorption {
    /// Medium that absorbs nothing.
    pub const NONE: Absorption = Absorption { sigma_a: [0.0; 3] };

    /// Returns the medium in which white light has the colour `color` after `distance` (KHR_materials_volume: sigma_a =
    /// -ln(color) / distance).
    ///
    /// A channel of 0 is opaque at any distance. Meaningless values absorb nothing: a channel of 1 or more or NaN, a
    /// distance that is infinite (the extension's default) or not positive.
    pub fn from_color(color: [f64; 3], distance: f64) -> Absorption {
        if !(distance > 0.0 && distance < f64::INFINITY) {
            return Absorption::NONE;
        }
        let sigma_a = color.map(|c| {
            if c >= 1.0 || c.is_nan() {
                0.0
            } else {
                (-c.max(0.0).ln() / distance).min(OPAQUE)
            }
        });
        Absorption { sigma_a }
    }

    /// Returns the transmittance of each channel after `distance`, which is not negative and may be infinite.
    #[inline(always)]
    pub fn transmittance(&self, distance: f64) -> [f64; 3] {
        // A clear channel stays clear over an infinite distance, where the product would be NaN.
        self.sigma_a.map(|sigma_a| {
            if sigma_a > 0.0 {
                (-sigma_a * distance).exp()
            } else {
                1.0
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absorption_of_one_half_over_two_units_is_one_over_e() {
        let left = Absorption { sigma_a: [0.5; 3] }.transmittance(2.0);
        assert!((left[0] - 0.367879441).abs() < 5e-10);
    }

    #[test]
    fn the_half_value_distance_leaves_half() {
        let medium = Absorption {
            sigma_a: [0.01, 0.7, 40.0],
        };
        for (channel, sigma_a) in medium.sigma_a.into_iter().enumerate() {
            let distance = std::f64::consts::LN_2 / sigma_a;
            // ln 2, the quotient and the product are rounded once each, which exp(-ln 2) scales by ln 2; then exp
            // itself is rounded.
            assert!((medium.transmittance(distance)[channel] - 0.5).abs() <= 2.0 * f64::EPSILON);
        }
    }

    #[test]
    fn after_the_attenuation_distance_white_has_become_the_attenuation_colour() {
        let color = [0.9, 0.25, 1e-9];
        let left = Absorption::from_color(color, 0.37).transmittance(0.37);
        for channel in 0..3 {
            // |ln 1e-9| = 20.7: three roundings of 2^-53 in the exponent are an error of 20.7 times 1.5 EPSILON.
            assert!((left[channel] / color[channel] - 1.0).abs() <= 32.0 * f64::EPSILON);
        }
    }

    #[test]
    fn transmittances_of_distances_multiply() {
        let medium = Absorption::from_color([0.2, 0.5, 0.8], 1.0);
        let (a, b, both) = (
            medium.transmittance(0.3),
            medium.transmittance(0.45),
            medium.transmittance(0.75),
        );
        for channel in 0..3 {
            assert!((a[channel] * b[channel] - both[channel]).abs() <= 4.0 * f64::EPSILON);
        }
    }

    #[test]
    fn zero_channel_is_opaque_except_at_distance_zero() {
        let medium = Absorption::from_color([0.0, -1.0, 1.0], 2.0);
        assert_eq!(medium.transmittance(1e-30), [0.0, 0.0, 1.0]);
        assert_eq!(medium.transmittance(0.0), [1.0; 3]);
        assert_eq!(medium.transmittance(f64::INFINITY), [0.0, 0.0, 1.0]);
        assert!(medium.sigma_a.iter().all(|s| (*s as f32).is_finite()));
    }

    #[test]
    fn invalid_coefficients_absorb_nothing() {
        for distance in [f64::INFINITY, 0.0, -1.0, f64::NAN] {
            assert_eq!(
                Absorption::from_color([0.0, 0.5, 1.0], distance),
                Absorption::NONE
            );
        }
        assert_eq!(
            Absorption::from_color([2.0, 1.0, f64::NAN], 1.0),
            Absorption::NONE
        );
    }
}
