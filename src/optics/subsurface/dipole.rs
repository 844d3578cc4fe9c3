//! Dipole diffusion model: a source below the surface and its negative mirror image above it represent all light
//! scattered within.
//!
//! With albedo' = sigma_s' / sigma_t', sigma_t' = sigma_s' + sigma_a and sigma_tr = (3 sigma_a sigma_t')^(1/2), the
//! source lies z_r = 1 / sigma_t' deep and its image z_v = (1 + 4 A / 3) z_r high, where A = (1 + F_dr) / (1 - F_dr)
//! moves the boundary outward to account for internal reflection. The diffuse reflectance at a distance r from the
//! point of entry is (Jensen et al. 2001, equation 4, its second term read as the first)
//!
//! R_d(r) = albedo' / 4 pi · sum over z in {z_r, z_v} of z (1 + sigma_tr d) e^(-sigma_tr d) / d³, d² = r² + z².
//!
//! As d is never less than z, nothing is singular. All terms are computed in units of z, so that no power of a length
//! leaves the range of numbers, and without a difference of nearly equal ones.

use std::f64::consts::PI;

use super::fast_exp::exp_neg;
use super::scattering::{Scattering, ScatteringError, boundary_factor};

/// Sum of coefficients below which a medium counts as clear, without diffuse reflectance.
const CLEAR: f64 = 1e-15;

/// Largest spacing of irradiance samples in mean free paths: the noise of their sum is 1 % at this distance, and four
/// times that at twice the distance.
const SPACING: f64 = 0.5;

/// Diffuse reflectance profile of a scattering half-space, by the dipole model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dipole {
    channels: [Channel; 3],
}

/// Dipole of one colour channel.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Channel {
    /// Reduced albedo, within [0, 1].
    albedo: f64,
    /// Effective transport coefficient, per unit of length.
    sigma_tr: f64,
    /// Depth of the source and height of its image, in units of length.
    z: [f64; 2],
}

impl Dipole {
    /// Creates the dipole of a scattering medium, in units of the coefficients' length.
    pub fn new(medium: &Scattering) -> Result<Dipole, ScatteringError> {
        medium.check()?;
        let image = 1.0 + 4.0 / 3.0 * boundary_factor(medium.eta);
        // Place source and image for each colour channel
        let channel = |c: usize| {
            let (sigma_s, sigma_a) = (medium.sigma_s_reduced[c], medium.sigma_a[c]);
            let sigma_t = sigma_s + sigma_a;
            if sigma_t < CLEAR {
                return Channel {
                    albedo: 0.0,
                    sigma_tr: 0.0,
                    z: [1.0 / CLEAR; 2],
                };
            }
            Channel {
                albedo: sigma_s / sigma_t,
                sigma_tr: (3.0 * sigma_a * sigma_t).sqrt(),
                z: [1.0 / sigma_t, image / sigma_t],
            }
        };
        Ok(Dipole {
            channels: std::array::from_fn(channel),
        })
    }

    /// Returns the diffuse reflectance R_d(r): radiant exitance at a distance `r` (not negative) from a point over the
    /// power that enters there, per unit of area.
    pub fn reflectance_at(&self, r: f64) -> [f64; 3] {
        self.channels.map(|channel| {
            let term = |z: f64| {
                let d = r.hypot(z);
                let x = channel.sigma_tr * d;
                // x may be infinite beyond the distance where e^(-x) underflows.
                let decay = if x < f64::MAX { (1.0 + x) * (-x).exp() } else { 0.0 };
                (z / d).powi(3) / (z * z) * decay
            };
            channel.albedo / (4.0 * PI) * (term(channel.z[0]) + term(channel.z[1]))
        })
    }

    /// Returns the total diffuse reflectance: 2 pi times the integral of R_d(r) r dr, in closed form; at most 1.
    pub fn diffuse_reflectance(&self) -> [f64; 3] {
        self.channels.map(|channel| {
            let [source, image] = channel.z.map(|z| (-channel.sigma_tr * z).exp());
            0.5 * channel.albedo * (source + image)
        })
    }

    /// Returns the fraction of the entering light that leaves within `radius` of the point of entry, in closed form. By
    /// symmetry it is also the exitance over irradiance at the centre of a uniformly lit disk of that radius.
    pub fn reflectance_within(&self, radius: f64) -> [f64; 3] {
        self.channels.map(|channel| {
            let term = |z: f64| {
                let d = radius.hypot(z);
                if d == f64::INFINITY {
                    return (-channel.sigma_tr * z).exp();
                }
                // Computes e^(-sigma z) - (z / d) e^(-sigma d) without cancellation, with d - z = r² / (d + z).
                let rise = radius / (d + z) * radius;
                let left = rise / d - z / d * (-channel.sigma_tr * rise).exp_m1();
                (-channel.sigma_tr * z).exp() * left
            };
            0.5 * channel.albedo * (term(channel.z[0]) + term(channel.z[1]))
        })
    }

    /// Returns the reduced mean free path 1 / sigma_t': the distance light travels between two changes of its
    /// direction, within which R_d changes little.
    pub fn mean_free_path(&self) -> [f64; 3] {
        self.channels.map(|channel| channel.z[0])
    }

    /// Returns the spacing at which irradiance must be sampled to evaluate this dipole: half of the shortest mean free
    /// path. Infinite if nothing is scattered.
    pub fn sample_spacing(&self) -> f64 {
        let scattering = self.channels.iter().filter(|channel| channel.albedo > 0.0);
        SPACING
            * scattering
                .map(|channel| channel.z[0])
                .fold(f64::INFINITY, f64::min)
    }

    /// Returns the dipole, widened where needed so that samples `spacing` apart can resolve it.
    ///
    /// Channels for which the samples lie too far apart have their coefficients divided by one number each, which
    /// leaves their reflectance unchanged: light is blurred over the distance of samples, and energy is preserved.
    pub fn widened_for_spacing(&self, spacing: f64) -> Dipole {
        let widen = |channel: Channel| {
            let factor = (spacing / (SPACING * channel.z[0])).max(1.0);
            Channel {
                albedo: channel.albedo,
                sigma_tr: channel.sigma_tr / factor,
                z: channel.z.map(|z| z * factor),
            }
        };
        Dipole {
            channels: self.channels.map(widen),
        }
    }

    /// Returns the constants of the f32 form of the dipole.
    pub(super) fn kernel(&self) -> DipoleKernel {
        let constants = |channel: &Channel| {
            channel.z.map(|z| PointSource {
                inverse_z2: (z * z).recip() as f32,
                decay: (channel.sigma_tr * z) as f32,
                peak: (channel.albedo / (4.0 * PI) / (z * z)) as f32,
            })
        };
        DipoleKernel(self.channels.each_ref().map(constants))
    }
}

/// f32 form of R_d as a function of squared distances, by colour channel: source and image.
#[derive(Clone, Copy, Debug)]
pub(super) struct DipoleKernel(pub(super) [[PointSource; 2]; 3]);

/// Point source of the dipole or its image, in units of its distance z from the surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointSource {
    inverse_z2: f32,
    /// Decay coefficient in units of z: sigma_tr z.
    decay: f32,
    /// Term at r = 0, without its decay.
    peak: f32,
}

impl PointSource {
    /// Evaluates the term of R_d at squared distance `r2`. Branch-free, so that lanes vectorise.
    ///
    /// Its relative error is within (16 + 4.5 x) 2^-24 for x = sigma_tr d, as long as it is no less than the smallest
    /// normal number. The 4.5 roundings in x itself are those of `decay`, `root` and their product, and half of the
    /// three in `u`.
    #[inline(always)]
    pub(super) fn at(&self, r2: f32) -> f32 {
        // The squared relative distance (d / z)².
        let u = r2 * self.inverse_z2 + 1.0;
        let root = u.sqrt();
        let x = (self.decay * root).min(FAR);
        self.peak * ((1.0 + x) * exp_neg(x)) / (u * root)
    }
}

/// Largest exponent that is evaluated; larger ones count as zero: e^-87 is the last power that an f32 holds with all
/// its digits.
const FAR: f32 = 87.0;

#[cfg(test)]
mod tests {
    use super::super::SubsurfacePreset;
    use super::*;

    /// Returns the dipoles of all published materials with their names.
    fn dipoles() -> impl Iterator<Item = (&'static str, Dipole)> {
        SubsurfacePreset::ALL
            .iter()
            .map(|preset| (preset.name, Dipole::new(&preset.scattering).unwrap()))
    }

    /// Integrates 2 pi `f(r)` r dr over all r by the double exponential rule (H. Takahasi, M. Mori 1974): r = scale e^x
    /// with x = sinh t, which needs no special case at the infinite end.
    fn integral(scale: f64, f: impl Fn(f64) -> [f64; 3]) -> [f64; 3] {
        const STEP: f64 = 1.0 / 64.0;
        let mut sum = [0.0; 3];
        for k in -300..=300 {
            let t = STEP * f64::from(k);
            let r = scale * t.sinh().exp();
            let weight = 2.0 * PI * STEP * r * r * t.cosh();
            let value = f(r);
            (0..3).for_each(|c| sum[c] += weight * value[c]);
        }
        sum
    }

    #[test]
    fn the_integral_of_every_published_material_is_its_closed_form() {
        for (name, dipole) in dipoles() {
            let exact = dipole.diffuse_reflectance();
            let found = integral(dipole.mean_free_path()[0], |r| dipole.reflectance_at(r));
            for c in 0..3 {
                assert!(
                    (found[c] - exact[c]).abs() <= 1e-12,
                    "{name}: {found:?} {exact:?}"
                );
            }
        }
    }

    #[test]
    fn the_integral_of_the_single_precision_form_is_it_to_a_millionth() {
        for (name, dipole) in dipoles() {
            let exact = dipole.diffuse_reflectance();
            let kernel = dipole.kernel();
            let at = |r: f64| {
                kernel.0.map(|point_sources| {
                    point_sources.map(|point_source| f64::from(point_source.at((r * r) as f32)))
                })
            };
            let found = integral(dipole.mean_free_path()[0], |r| at(r).map(|[a, b]| a + b));
            for c in 0..3 {
                assert!((found[c] - exact[c]).abs() <= 1e-6, "{name}: {found:?} {exact:?}");
            }
        }
    }

    #[test]
    fn single_precision_keeps_its_stated_error_at_any_distance() {
        for (name, dipole) in dipoles() {
            let kernel = dipole.kernel();
            for step in 0..4000 {
                let r2 = (1e-6 * 1.01f64.powi(step)) as f32;
                let exact = dipole.reflectance_at(f64::from(r2).sqrt());
                for c in 0..3 {
                    let x = dipole.channels[c].sigma_tr * f64::from(r2).sqrt();
                    let found: f64 = kernel.0[c]
                        .iter()
                        .map(|point_source| f64::from(point_source.at(r2)))
                        .sum();
                    let bound = (16.0 + 4.5 * x) * 0.5f64.powi(24);
                    let error = (found / exact[c] - 1.0).abs();
                    if exact[c] > 4.0 * f64::from(f32::MIN_POSITIVE) {
                        assert!(error <= bound, "{name} {c} at {r2}: {error} > {bound}");
                    }
                    assert!((0.0..1e6).contains(&found), "{name} {c} at {r2}");
                }
            }
            assert!(
                kernel
                    .0
                    .iter()
                    .flatten()
                    .all(|point_source| point_source.at(f32::INFINITY) == 0.0)
            );
        }
    }

    #[test]
    fn exitance_within_radius_equals_the_integral() {
        for (name, dipole) in dipoles() {
            for radius in [1e-9, 1e-3, 0.5, 4.0, 100.0] {
                // Substitute r = radius / (1 + e^-x), which ends at the radius; its derivative is r (1 - r / radius).
                let disk = |x: f64| radius / (1.0 + (-x).exp());
                let mut found = [0.0; 3];
                for k in -2500..=2500 {
                    let x = f64::from(k) / 64.0;
                    let r = disk(x);
                    let weight = 2.0 * PI / 64.0 * r * r / (1.0 + x.exp());
                    let value = dipole.reflectance_at(r);
                    (0..3).for_each(|c| found[c] += weight * value[c]);
                }
                let exact = dipole.reflectance_within(radius);
                for c in 0..3 {
                    let error = (found[c] - exact[c]).abs();
                    assert!(error <= 1e-10 * exact[c], "{name} {radius}: {found:?} {exact:?}");
                }
            }
            assert_eq!(dipole.reflectance_within(0.0), [0.0; 3]);
            let whole = dipole.reflectance_within(f64::INFINITY);
            assert_eq!(whole, dipole.diffuse_reflectance(), "{name}");
        }
    }

    #[test]
    fn dipole_conserves_energy() {
        for albedo in [0.0, 1e-9, 0.5, 0.999, 1.0 - 1e-12, 1.0] {
            for eta in [1.0, 1.3, 2.0] {
                let medium = Scattering {
                    sigma_s_reduced: [albedo, 1e-9 * albedo, 1e9 * albedo],
                    sigma_a: [1.0 - albedo, 1e-9 * (1.0 - albedo), 1e9 * (1.0 - albedo)],
                    eta,
                };
                let found = Dipole::new(&medium).unwrap().diffuse_reflectance();
                for c in 0..3 {
                    assert!((0.0..=albedo).contains(&found[c]), "{albedo} {eta}: {found:?}");
                    // The result is independent of the unit of length.
                    assert!((found[c] - found[0]).abs() <= 1e-14, "{albedo} {eta}: {found:?}");
                }
                assert!(albedo < 1.0 || found == [1.0; 3]);
            }
        }
    }

    #[test]
    fn tiny_absorption_is_kept() {
        // 1 - R = s (1 + 2 A / 3) for small s = (3 sigma_a / sigma_t')^(1/2) = 3^(1/2) 1e-10.
        let medium = Scattering {
            sigma_s_reduced: [1.0; 3],
            sigma_a: [1e-20; 3],
            eta: 1.3,
        };
        let lost = 1.0 - Dipole::new(&medium).unwrap().diffuse_reflectance()[0];
        let expected = 3f64.sqrt() * 1e-10 * (1.0 + 2.0 / 3.0 * boundary_factor(1.3));
        assert!((lost - expected).abs() <= 2.0 * f64::EPSILON, "{lost} {expected}");
    }

    #[test]
    fn clear_and_black_media_return_nothing() {
        for sigma_a in [0.0, 1e-20, 1.0] {
            let medium = Scattering {
                sigma_s_reduced: [0.0; 3],
                sigma_a: [sigma_a; 3],
                eta: 1.3,
            };
            let dipole = Dipole::new(&medium).unwrap();
            for r in [0.0, 1.0, f64::INFINITY] {
                assert_eq!(dipole.reflectance_at(r), [0.0; 3]);
            }
            assert_eq!(dipole.diffuse_reflectance(), [0.0; 3]);
            assert!(
                dipole
                    .kernel()
                    .0
                    .iter()
                    .flatten()
                    .all(|point_source| point_source.at(0.0) == 0.0)
            );
        }
    }

    #[test]
    fn widened_dipole_keeps_its_reflectance() {
        for (name, dipole) in dipoles() {
            let wide = dipole.widened_for_spacing(3.0 * SPACING);
            let (paths, wide_paths) = (dipole.mean_free_path(), wide.mean_free_path());
            let (exact, found) = (dipole.diffuse_reflectance(), wide.diffuse_reflectance());
            for c in 0..3 {
                assert!(
                    (wide_paths[c] / paths[c].max(3.0) - 1.0).abs() <= 2.0 * f64::EPSILON,
                    "{name}"
                );
                assert!((found[c] - exact[c]).abs() <= 8.0 * f64::EPSILON, "{name}");
            }
            assert_eq!(dipole.widened_for_spacing(dipole.sample_spacing()), dipole);
        }
    }
}
