//! Scattering and absorption coefficients of translucent media, and the internal reflection at their surface.

use thiserror::Error;

/// Largest accepted coefficient, per unit of length: squares of coefficients must fit into an f32.
const MAX_SIGMA: f64 = 1e15;

/// Range of indices over which the fit of the diffuse Fresnel reflectance holds.
pub const ETA_RANGE: std::ops::RangeInclusive<f64> = 1.0..=2.0;

/// Homogeneous medium in which light is scattered so often that diffusion describes it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scattering {
    /// Reduced scattering coefficients (1 - g) sigma_s of linear red, green and blue, per unit of length; `sigma_s'` in
    /// the literature.
    pub sigma_s_reduced: [f64; 3],
    /// Absorption coefficients of linear red, green and blue, per unit of length.
    pub sigma_a: [f64; 3],
    /// Index of refraction relative to the medium outside; within [1, 2].
    pub eta: f64,
}

/// Reason why coefficients of a scattering medium are invalid.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ScatteringError {
    /// Coefficient that is negative, too large or NaN.
    #[error(
        "{name} of the {channel} channel is {value}: give a number from 0 to 1e15, per unit of length of the scene"
    )]
    Coefficient {
        /// Name of the coefficient in the literature.
        name: &'static str,
        /// Colour channel: red, green or blue.
        channel: &'static str,
        /// Value that was given.
        value: f64,
    },
    /// Index of refraction outside the range for which the internal reflectance is known.
    #[error("the index of refraction of a material with subsurface scattering is {0}: give one from 1 to 2")]
    Index(f64),
    /// Diffuse reflectance outside [0, 1] or NaN.
    #[error("the diffuse reflectance of the {channel} channel is {value}: give a number from 0 to 1")]
    Reflectance {
        /// Colour channel: red, green or blue.
        channel: &'static str,
        /// Value that was given.
        value: f64,
    },
    /// Mean free path that is too small, too large or NaN.
    #[error(
        "the mean free path of the {channel} channel is {value}: give a length from 1e-15 to 1e15, in units of the scene"
    )]
    MeanFreePath {
        /// Colour channel: red, green or blue.
        channel: &'static str,
        /// Value that was given.
        value: f64,
    },
}

const CHANNELS: [&str; 3] = ["red", "green", "blue"];

impl Scattering {
    /// Returns the medium that has the diffuse reflectance `reflectance` in uniform light, each channel within [0, 1],
    /// and the mean free path `mean_free_path` (1 / sigma_t', in units of the scene) between two changes of direction.
    ///
    /// Colour and depth are easier to choose than coefficients (Jensen and Buhler 2002, section 3.2), for example for
    /// wax, soap or jade, for which no measured coefficients are published. The reflectance is the dipole's closed
    /// form, which increases with the albedo and is inverted by bisection to the last bit of its argument.
    pub fn from_reflectance(
        reflectance: [f64; 3],
        mean_free_path: [f64; 3],
        eta: f64,
    ) -> Result<Scattering, ScatteringError> {
        check_eta(eta)?;
        let mut medium = Scattering {
            sigma_s_reduced: [0.0; 3],
            sigma_a: [0.0; 3],
            eta,
        };
        for c in 0..3 {
            // Validate reflectance and mean free path
            let (channel, value, path) = (CHANNELS[c], reflectance[c], mean_free_path[c]);
            if !(0.0..=1.0).contains(&value) {
                return Err(ScatteringError::Reflectance { channel, value });
            }
            if !(1.0 / MAX_SIGMA..=MAX_SIGMA).contains(&path) {
                return Err(ScatteringError::MeanFreePath { channel, value: path });
            }
            // The absorbed fraction per collision, without the cancellation in one minus the albedo.
            let s = decay_of_reflectance(value, boundary_factor(eta));
            let absorbed = (s * s / 3.0).min(1.0);
            medium.sigma_a[c] = absorbed / path;
            medium.sigma_s_reduced[c] = (1.0 - absorbed) / path;
        }
        Ok(medium)
    }

    /// Returns the medium with lengths converted so that one unit of its coefficients' length is `length` units of the
    /// scene: 0.001 for coefficients per millimetre in a scene in metres.
    pub fn scaled(&self, length: f64) -> Scattering {
        Scattering {
            sigma_s_reduced: self.sigma_s_reduced.map(|sigma| sigma / length),
            sigma_a: self.sigma_a.map(|sigma| sigma / length),
            eta: self.eta,
        }
    }

    /// Checks that index and coefficients are within their ranges.
    pub(super) fn check(&self) -> Result<(), ScatteringError> {
        check_eta(self.eta)?;
        for (name, sigma) in [("sigma_s'", self.sigma_s_reduced), ("sigma_a", self.sigma_a)] {
            for (channel, value) in CHANNELS.into_iter().zip(sigma) {
                if !(0.0..=MAX_SIGMA).contains(&value) {
                    return Err(ScatteringError::Coefficient { name, channel, value });
                }
            }
        }
        Ok(())
    }
}

/// Checks that the index of refraction is within [`ETA_RANGE`].
fn check_eta(eta: f64) -> Result<(), ScatteringError> {
    if ETA_RANGE.contains(&eta) {
        Ok(())
    } else {
        Err(ScatteringError::Index(eta))
    }
}

/// Returns the fraction of perfectly diffuse light inside a medium that its smooth surface reflects back inside, for a
/// relative index of refraction `eta` within [1, 2].
///
/// It is the fit that the dipole is published with (W. G. Egan, T. W. Hilgeman, "Optical properties of inhomogeneous
/// materials", 1979; Jensen et al. 2001, section 2.1). It is within 0.0017 of the integral of Fresnel's reflectance
/// over that range, and within 0.0006 from 1.2 on; beyond 2 it soon departs from the integral.
pub fn diffuse_fresnel_reflectance(eta: f64) -> f64 {
    -1.440 / (eta * eta) + 0.710 / eta + 0.668 + 0.0636 * eta
}

/// Returns the fraction of perfectly diffuse light from outside that enters a medium, which is also the mean by which
/// the transmittance of leaving light is divided; `eta` is as for [`diffuse_fresnel_reflectance`].
///
/// Radiance is scaled by `eta` squared on its way in, and Fresnel's transmittance is equal both ways.
pub fn diffuse_transmittance(eta: f64) -> f64 {
    (eta * eta * (1.0 - diffuse_fresnel_reflectance(eta))).min(1.0)
}

/// Returns the boundary factor `A` of Jensen et al. 2001, by which internal reflection moves the dipole's boundary
/// outward.
pub(super) fn boundary_factor(eta: f64) -> f64 {
    let reflectance = diffuse_fresnel_reflectance(eta);
    (1.0 + reflectance) / (1.0 - reflectance)
}

/// Returns the dipole's total diffuse reflectance (Jensen et al. 2001, section 2.4) of s = (3 (1 - albedo'))^(1/2), the
/// decay of light over a mean free path.
fn reflectance_of_decay(s: f64, boundary: f64) -> f64 {
    let albedo = 1.0 - s * s / 3.0;
    0.5 * albedo * (1.0 + (-4.0 / 3.0 * boundary * s).exp()) * (-s).exp()
}

/// Inverts [`reflectance_of_decay`] by bisection. The reflectance falls from 1 at s = 0 to 0 at the square root of 3.
fn decay_of_reflectance(reflectance: f64, boundary: f64) -> f64 {
    let (mut low, mut high) = (0.0, 3f64.sqrt());
    loop {
        // Bisect until the interval holds no number between its ends
        let middle = 0.5 * (low + high);
        if !(low < middle && middle < high) {
            return if reflectance == 1.0 { 0.0 } else { high };
        }
        if reflectance_of_decay(middle, boundary) > reflectance {
            low = middle;
        } else {
            high = middle;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Dipole;
    use super::*;
    use crate::optics::dielectric;

    /// Integrates Fresnel's reflectance from inside against the cosine, by way of the outside, where it has no kink: 1
    /// - R_in = (1 - R_out) / eta². In cos = u² the integrand is smooth at grazing incidence too.
    fn integrated(eta: f64) -> f64 {
        let count = 4000;
        let middle = |i: i32| (f64::from(i) + 0.5) / f64::from(count);
        let outside: f64 = (0..count)
            .map(|i| 4.0 * middle(i).powi(3) * dielectric(middle(i).powi(2), 1.0, eta).reflectance.mean())
            .sum();
        1.0 - (1.0 - outside / f64::from(count)) / (eta * eta)
    }

    #[test]
    fn the_fitted_reflectance_stays_within_its_stated_error_of_the_integral() {
        for step in 0..=40 {
            let eta = 1.0 + f64::from(step) / 40.0;
            let error = (diffuse_fresnel_reflectance(eta) - integrated(eta)).abs();
            assert!(error <= if eta < 1.2 { 0.0017 } else { 0.0006 }, "{eta}: {error}");
        }
    }

    #[test]
    fn the_mean_transmittance_is_that_of_diffuse_light_from_outside() {
        for eta in [1.2, 1.3, 1.5, 1.8] {
            let exact = eta * eta * (1.0 - integrated(eta));
            assert!(
                (diffuse_transmittance(eta) - exact).abs() <= 0.0006 * eta * eta,
                "{eta}"
            );
        }
        assert_eq!(diffuse_transmittance(1.0), 1.0 - 0.0016000000000000458);
    }

    #[test]
    fn medium_from_reflectance_has_that_reflectance() {
        let wanted = [0.0, 0.37, 1.0];
        for eta in [1.0, 1.3, 2.0] {
            let medium = Scattering::from_reflectance(wanted, [0.1, 2.0, 5.0], eta).unwrap();
            let found = Dipole::new(&medium).unwrap().diffuse_reflectance();
            for c in 0..3 {
                // |dR/ds| < 3 for these boundary factors and s < 2: a few roundings of s, times that.
                assert!(
                    (found[c] - wanted[c]).abs() <= 16.0 * f64::EPSILON,
                    "{eta}: {found:?}"
                );
                let sum = medium.sigma_s_reduced[c] + medium.sigma_a[c];
                assert!((sum * [0.1, 2.0, 5.0][c] - 1.0).abs() <= 2.0 * f64::EPSILON);
            }
        }
    }

    #[test]
    fn invalid_coefficients_are_rejected_by_name() {
        let good = Scattering {
            sigma_s_reduced: [1.0; 3],
            sigma_a: [0.1; 3],
            eta: 1.3,
        };
        assert_eq!(good.check(), Ok(()));
        for bad in [-1.0, f64::NAN, f64::INFINITY, 1e16] {
            let medium = Scattering {
                sigma_a: [0.0, bad, 0.0],
                ..good
            };
            let text = Dipole::new(&medium).unwrap_err().to_string();
            assert!(text.starts_with("sigma_a of the green channel is"), "{text}");
        }
        for eta in [0.9, 2.1, f64::NAN] {
            let text = Dipole::new(&Scattering { eta, ..good }).unwrap_err().to_string();
            assert!(text.contains("from 1 to 2"), "{text}");
        }
        assert!(Scattering::from_reflectance([1.1; 3], [1.0; 3], 1.3).is_err());
        assert!(Scattering::from_reflectance([0.5; 3], [0.0; 3], 1.3).is_err());
        assert!(Scattering::from_reflectance([f64::NAN; 3], [1.0; 3], 1.3).is_err());
    }
}
