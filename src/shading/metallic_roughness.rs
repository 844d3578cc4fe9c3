//! glTF's metallic-roughness model (glTF 2.0, Appendix B): Lambertian diffuse under a Fresnel-weighted GGX lobe.
//!
//! The lobe is raised by multiple scattering ([`LobeAlbedo`](super::LobeAlbedo)). glTF weights the diffuse part with
//! 1 - F, where F is the Fresnel reflectance at the half vector. Under uniform light, that exceeds energy near grazing
//! views, where the lobe takes nearly all light, but half vectors still face the viewer. The weight is thus the smaller
//! one of 1 - F and 1 minus the albedo of the lobe towards the viewer: glTF's formula wherever it does not exceed
//! energy, and no surface reflects more light than arrives. Without [`Effect::EnergyConservation`], lobe and weight are
//! glTF's everywhere.
//!
//! Punctual lights are evaluated with the whole lobe. The environment is evaluated by one mirror ray where the surface
//! is smooth enough to show an image, by rays into the lobe where the material requests them, and by the ambient term
//! elsewhere.

use std::f32::consts::PI;

use multiversion::multiversion;

use super::LobeAlbedo;
use super::anisotropic_lobe::{AnisotropicLobe, dot};
use super::diffuse::diffuse_direct;
use super::material::{DEFAULT_F0, MaterialPacket};
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Effect, MIRROR_ROUGHNESS};

impl MaterialPacket {
    /// Returns the diffuse albedo of one channel.
    #[inline(always)]
    pub(super) fn c_diff<const EXTENDED: bool>(&self, channel: usize, l: usize) -> f32 {
        let scattered = self.base_color[channel][l] * (1.0 - self.metallic[l]);
        if EXTENDED {
            scattered * (1.0 - self.extended.transmission[channel][l]) * self.extended.same_side_diffuse[l]
        } else {
            scattered
        }
    }

    /// Returns the albedo of diffuse transmission to the other side of a thin surface, as a fraction of the light not
    /// reflected.
    #[inline(always)]
    pub(super) fn transmission_albedo(&self, channel: usize, l: usize) -> f32 {
        let extended = &self.extended;
        extended.translucency[channel][l]
            * (1.0 - self.metallic[l])
            * (1.0 - extended.transmission[channel][l])
    }

    /// Returns the specular reflectance at normal incidence.
    #[inline(always)]
    pub(super) fn f0<const EXTENDED: bool>(&self, channel: usize, l: usize) -> f32 {
        let dielectric = if EXTENDED {
            (self.f0[l] * self.extended.specular_color[channel][l]).min(1.0) * self.extended.specular[l]
        } else {
            DEFAULT_F0
        };
        dielectric * (1.0 - self.metallic[l]) + self.base_color[channel][l] * self.metallic[l]
    }

    /// Returns the specular reflectance at grazing incidence.
    #[inline(always)]
    fn f90<const EXTENDED: bool>(&self, l: usize) -> f32 {
        if EXTENDED {
            self.extended.specular[l] * (1.0 - self.metallic[l]) + self.metallic[l]
        } else {
            1.0
        }
    }

    /// Evaluates Schlick's Fresnel reflectance; `grazing` is the fifth power of 1 minus the cosine of incidence.
    #[inline(always)]
    pub(super) fn schlick<const EXTENDED: bool>(&self, grazing: f32, channel: usize, l: usize) -> f32 {
        let f0 = self.f0::<EXTENDED>(channel, l);
        f0 + (self.f90::<EXTENDED>(l) - f0) * grazing
    }

    /// Returns the Fresnel reflectance at this cosine of incidence: Schlick's, or that of a thin film.
    #[inline(always)]
    fn fresnel<const EXTENDED: bool, const SPECIAL: bool>(&self, cosine: f32, l: usize) -> [f32; 3] {
        let grazing = fifth_power(1.0 - cosine);
        let schlick = [
            self.schlick::<EXTENDED>(grazing, 0, l),
            self.schlick::<EXTENDED>(grazing, 1, l),
            self.schlick::<EXTENDED>(grazing, 2, l),
        ];
        if SPECIAL {
            self.with_film(schlick, cosine, l)
        } else {
            schlick
        }
    }

    /// Sets what depends on the viewers along `wo`: the albedo of the lobe and the reflectance of thin films.
    #[inline(always)]
    pub fn set_view(&mut self, ns: &Lanes3<f32>, wo: &Lanes3<f32>) {
        self.lobe = LobeAlbedo::of_packet(&self.roughness, ns, wo);
        if self.effects.has(Effect::Anisotropy) {
            self.set_anisotropic_albedos(ns, wo);
        }
        if self.effects.has(Effect::Iridescence) {
            self.set_film_reflectance(ns, wo);
        }
    }

    /// Returns the widths alpha of the lobe in lane `l`: along the direction of anisotropy, and across.
    #[inline(always)]
    pub fn alphas(&self, l: usize) -> [f32; 2] {
        let alpha = self.roughness[l] * self.roughness[l];
        let strength = self.extended.anisotropy[l];
        [alpha + (1.0 - alpha) * strength * strength, alpha]
    }

    /// Returns the reflectances at normal and at grazing incidence of the albedo of the lobe.
    #[inline(always)]
    fn albedo_reflectances<const EXTENDED: bool, const SPECIAL: bool>(
        &self,
        channel: usize,
        l: usize,
    ) -> [f32; 2] {
        let [f0, f90] = [self.f0::<EXTENDED>(channel, l), self.f90::<EXTENDED>(l)];
        if SPECIAL {
            let (weight, film) = (self.extended.film[l], self.extended.film_reflectance[channel][l]);
            return [f0, f90].map(|x| x + weight * (film - x));
        }
        [f0, f90]
    }

    /// Returns the factor by which light that scatters more than once between microfacets raises the lobe; 1 where
    /// only single scattering counts.
    #[inline(always)]
    fn multiple_scattering<const EXTENDED: bool, const SPECIAL: bool>(
        &self,
        channel: usize,
        l: usize,
    ) -> f32 {
        let [f0, _] = self.albedo_reflectances::<EXTENDED, SPECIAL>(channel, l);
        1.0 + f0 * self.lobe.loss[l]
    }

    /// Returns the fraction of uniform light that the lobe reflects to the viewer; 0 where only single scattering
    /// counts.
    #[inline(always)]
    pub(super) fn specular_albedo<const EXTENDED: bool, const SPECIAL: bool>(
        &self,
        channel: usize,
        l: usize,
    ) -> f32 {
        let [f0, f90] = self.albedo_reflectances::<EXTENDED, SPECIAL>(channel, l);
        let single = f0 * self.lobe.normal[l] + f90 * self.lobe.grazing[l];
        single * self.multiple_scattering::<EXTENDED, SPECIAL>(channel, l)
    }

    /// Returns the weights of a ray that a microfacet of lane `l` reflects, at the cosine of incidence `cosine`:
    /// Schlick's Fresnel reflectance, with multiple scattering.
    pub fn microfacet_reflectance(&self, cosine: f32, l: usize) -> [f32; 3] {
        let reflectance = self.fresnel::<true, true>(cosine, l);
        let raised = self.multiple_scattering_factors(l);
        std::array::from_fn(|channel| reflectance[channel] * raised[channel])
    }

    /// Returns the factors by which multiple scattering raises the lobe of lane `l`.
    pub fn multiple_scattering_factors(&self, l: usize) -> [f32; 3] {
        std::array::from_fn(|channel| self.multiple_scattering::<true, true>(channel, l))
    }

    /// Returns radiance that needs no light sampling: emission, plus the ambient radiance `ambient` reflected
    /// diffusely, and specularly where no other ray gathers the environment.
    #[inline(always)]
    pub fn ambient(&self, ambient: [f32; 3]) -> Lanes3<f32> {
        if !self.effects.needs_full_material() {
            self.ambient_of::<false, false>(ambient)
        } else if self.effects.has_special_lobes() {
            self.special_ambient(ambient)
        } else {
            self.ambient_of::<true, false>(ambient)
        }
    }

    /// Evaluates [`MaterialPacket::ambient`] with thin films. Not inlined, like [`special_direct`].
    #[inline(never)]
    fn special_ambient(&self, ambient: [f32; 3]) -> Lanes3<f32> {
        self.ambient_of::<true, true>(ambient)
    }

    /// Implements [`MaterialPacket::ambient`]; `EXTENDED` must be true if the effects are rich.
    #[inline(always)]
    fn ambient_of<const EXTENDED: bool, const SPECIAL: bool>(&self, ambient: [f32; 3]) -> Lanes3<f32> {
        let mut rough = [0.0; LANES];
        // Mask lanes whose specular reflection is gathered by rays
        for l in 0..LANES {
            rough[l] = if self.roughness[l] <= MIRROR_ROUGHNESS || (EXTENDED && self.has_lobe(l)) {
                0.0
            } else {
                1.0
            };
        }
        // Add the ambient light by diffuse and specular albedo. No loop over the channels, which would be vectorised in
        // place of that over the lanes
        let mut radiance = self.emission;
        let [r, g, b] = &mut radiance;
        self.add_ambient::<EXTENDED, SPECIAL>(0, ambient[0], &rough, r);
        self.add_ambient::<EXTENDED, SPECIAL>(1, ambient[1], &rough, g);
        self.add_ambient::<EXTENDED, SPECIAL>(2, ambient[2], &rough, b);
        radiance
    }

    /// Adds the reflected ambient radiance of one channel: by the diffuse albedo, and by that of lobes where `rough` is 1.
    #[inline(always)]
    fn add_ambient<const EXTENDED: bool, const SPECIAL: bool>(
        &self,
        channel: usize,
        ambient: f32,
        rough: &Lanes<f32>,
        radiance: &mut Lanes<f32>,
    ) {
        let extended = &self.extended;
        let conserves_energy = self.effects.has(Effect::EnergyConservation);
        for l in 0..LANES {
            let mut diffuse = self.c_diff::<EXTENDED>(channel, l);
            if EXTENDED {
                diffuse += self.transmission_albedo(channel, l);
            }
            // The diffuse part loses what the lobe takes, by the ambient term or by rays
            let mut albedo = if conserves_energy {
                let specular = self.specular_albedo::<EXTENDED, SPECIAL>(channel, l);
                diffuse * (1.0 - specular) + specular * rough[l]
            } else {
                diffuse + self.f0::<EXTENDED>(channel, l) * rough[l]
            };
            if EXTENDED {
                let phong = extended.ambient[channel][l] * self.base_color[channel][l];
                albedo = if extended.is_phong[l] { phong } else { albedo };
                albedo *= extended.occlusion[l];
            }
            radiance[l] += ambient * albedo;
        }
    }
}

/// Returns the reflected radiance per unit of irradiance at normal incidence, that is BRDF times n·wi, at sixteen
/// points.
///
/// `ns`, `wo` and `wi` are unit vectors; lanes with n·wi <= 0 give zero.
#[inline(always)]
pub fn direct(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
    wi: &Lanes3<f32>,
) -> Lanes3<f32> {
    if material.effects.needs_full_material() {
        direct_of::<true>(material, ns, wo, wi)
    } else {
        direct_of::<false>(material, ns, wo, wi)
    }
}

/// Evaluates [`direct`]; `EXTENDED` must be true if the material's effects are rich.
#[inline(always)]
pub fn direct_of<const EXTENDED: bool>(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
    wi: &Lanes3<f32>,
) -> Lanes3<f32> {
    direct_combined::<EXTENDED>(material, ns, wo, wi, None)
}

/// Evaluates [`direct_of`] for light samples that are combined with rays into the lobe by the balance heuristic.
///
/// `ratios` holds the number of rays into the lobe over the number of light samples times their density per steradian;
/// 0 where light samples alone represent the lobe.
#[inline(always)]
pub fn direct_combined<const EXTENDED: bool>(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
    wi: &Lanes3<f32>,
    ratios: Option<&Lanes<f32>>,
) -> Lanes3<f32> {
    if EXTENDED && material.effects.has_special_lobes() {
        return special_direct(material, ns, wo, wi, ratios);
    }
    match ratios {
        _ if EXTENDED && material.is_diffuse_only() => diffuse_direct(material, ns, wi),
        Some(ratios) if EXTENDED => direct_lanes::<true, false, true>(material, ns, wo, wi, (ratios, None)),
        _ => direct_lanes::<EXTENDED, false, false>(material, ns, wo, wi, (&[0.0; LANES], None)),
    }
}

/// Evaluates [`direct_combined`] with anisotropic lobes and thin films. Not inlined, so that scenes without them keep their
/// registers.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn special_direct(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
    wi: &Lanes3<f32>,
    ratios: Option<&Lanes<f32>>,
) -> Lanes3<f32> {
    // Evaluate the films at the microfacets that reflect the light
    let mut films = None;
    if material.has_film() {
        let mut cosines = [0.0; LANES];
        for l in 0..LANES {
            cosines[l] = microfacet_cosine([wo[0][l] + wi[0][l], wo[1][l] + wi[1][l], wo[2][l] + wi[2][l]]);
        }
        films = Some(material.films().reflectance(&cosines));
    }
    let ratios = ratios.unwrap_or(&[0.0; LANES]);
    direct_lanes::<true, true, true>(material, ns, wo, wi, (ratios, films.as_ref()))
}

/// Returns the cosine of the angle of incidence on a microfacet that reflects between two unit vectors of the sum `h`.
#[inline(always)]
fn microfacet_cosine(h: [f32; 3]) -> f32 {
    0.5 * dot(h, h).sqrt()
}

/// Evaluates all lanes: with the parameters that few materials use if `EXTENDED`, with anisotropic lobes and the
/// reflectances of thin films `films` if `SPECIAL`, and with the shares of light samples by `ratios` if `COMBINED`.
#[inline(always)]
fn direct_lanes<const EXTENDED: bool, const SPECIAL: bool, const COMBINED: bool>(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
    wi: &Lanes3<f32>,
    (ratios, films): (&Lanes<f32>, Option<&Lanes3<f32>>),
) -> Lanes3<f32> {
    let mut reflected = [[0.0; LANES]; 3];
    for l in 0..LANES {
        // Compute cosines and the half vector
        let n = [ns[0][l], ns[1][l], ns[2][l]];
        let v = [wo[0][l], wo[1][l], wo[2][l]];
        let i = [wi[0][l], wi[1][l], wi[2][l]];
        let n_dot_l = dot(n, i).max(0.0);
        let n_dot_v = dot(n, v).abs();
        let h = [v[0] + i[0], v[1] + i[1], v[2] + i[2]];
        let h_squared = dot(h, h);
        // The half vector stays unnormalised: for unit v and i, v·h over |h| is |h| / 2.
        let v_dot_h = 0.5 * h_squared.sqrt();
        // Write the GGX denominator 1 - (n·h)²(1 - α²) as sin² + α² cos², times |h|²: near the peak of a smooth lobe
        // the textbook form loses all digits, this one none.
        let c = [
            n[1] * h[2] - n[2] * h[1],
            n[2] * h[0] - n[0] * h[2],
            n[0] * h[1] - n[1] * h[0],
        ];
        let n_dot_h = dot(n, h);
        let alpha = material.roughness[l] * material.roughness[l];
        let mut alpha_squared = alpha * alpha;
        let mut denominator = dot(c, c) + alpha_squared * n_dot_h * n_dot_h;
        // Evaluate Smith's separable masking and shadowing
        let mut shadowing_l = n_dot_l + (alpha_squared + (1.0 - alpha_squared) * n_dot_l * n_dot_l).sqrt();
        let mut shadowing_v = n_dot_v + (alpha_squared + (1.0 - alpha_squared) * n_dot_v * n_dot_v).sqrt();
        // Replace all by those of an anisotropic lobe
        if SPECIAL && material.extended.anisotropy[l] > 0.0 {
            let lobe = AnisotropicLobe::of(material, n, l);
            alpha_squared = lobe.along * lobe.across;
            denominator = lobe.denominator(h, n_dot_h);
            shadowing_l = n_dot_l + lobe.shadowing(i, n_dot_l);
            shadowing_v = n_dot_v + lobe.shadowing(v, n_dot_v);
        }
        let below = PI * denominator * denominator * shadowing_l * shadowing_v;
        // alpha = 0 is a mirror: a punctual light is never exactly in the mirror direction.
        let mut lobe = if n_dot_h > 0.0 && alpha_squared > 0.0 && below > 0.0 {
            alpha_squared * h_squared * h_squared / below
        } else {
            0.0
        };
        // The density of a ray into the lobe is D G1(v) / (4 n·v)
        if COMBINED {
            let share = 1.0 / (1.0 + ratios[l] * (0.5 * lobe * shadowing_l));
            lobe *= if ratios[l] > 0.0 { share } else { 1.0 };
        }
        // Blend diffuse and specular by Schlick's Fresnel term
        let grazing = fifth_power(1.0 - v_dot_h);
        for channel in 0..3 {
            let mut fresnel = material.schlick::<EXTENDED>(grazing, channel, l);
            if SPECIAL && let Some(films) = films {
                fresnel = material.blend_film(fresnel, films[channel][l], l);
            }
            let taken = fresnel.max(material.specular_albedo::<EXTENDED, SPECIAL>(channel, l));
            let diffuse = (1.0 - taken) * material.c_diff::<EXTENDED>(channel, l) * (1.0 / PI);
            let specular = fresnel * lobe * material.multiple_scattering::<EXTENDED, SPECIAL>(channel, l);
            reflected[channel][l] = (diffuse + specular) * n_dot_l;
        }
    }
    reflected
}

/// Returns the radiance that thin surfaces transmit diffusely per unit of irradiance at normal incidence, from lights
/// behind them; lanes with n·wi >= 0 give zero.
///
/// The back of the surface reflects as much as its front would of light from the mirrored direction; only the remainder
/// is transmitted.
#[inline(always)]
pub fn diffuse_transmission(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
    wi: &Lanes3<f32>,
) -> Lanes3<f32> {
    let mut transmitted = [[0.0; LANES]; 3];
    for l in 0..LANES {
        let n = [ns[0][l], ns[1][l], ns[2][l]];
        let i = [wi[0][l], wi[1][l], wi[2][l]];
        let behind = (-dot(n, i)).max(0.0);
        // Compute the half vector with the light mirrored to the front
        let mut h = [wo[0][l], wo[1][l], wo[2][l]];
        for axis in 0..3 {
            h[axis] += i[axis] + 2.0 * behind * n[axis];
        }
        let grazing = fifth_power(1.0 - 0.5 * dot(h, h).sqrt());
        for channel in 0..3 {
            let fresnel = material.schlick::<true>(grazing, channel, l);
            let taken = fresnel.max(material.specular_albedo::<true, false>(channel, l));
            transmitted[channel][l] =
                (1.0 - taken) * material.transmission_albedo(channel, l) * (1.0 / PI) * behind;
        }
    }
    transmitted
}

/// Returns the mirror rays of sixteen surfaces: unit direction and Schlick's Fresnel reflectance, which is zero where
/// the surface is rougher than [`MIRROR_ROUGHNESS`] or sends rays into its lobe. In lanes of the Phong and Whitted
/// model the reflectance is kr. `EXTENDED` must be true if the material's effects are rich.
#[inline(always)]
pub fn mirror<const EXTENDED: bool>(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
) -> (Lanes3<f32>, Lanes3<f32>) {
    if EXTENDED && material.effects.has_special_lobes() {
        special_mirror(material, ns, wo)
    } else {
        mirror_lanes::<EXTENDED, false>(material, ns, wo)
    }
}

/// Evaluates [`mirror`] with thin films. Not inlined, like [`special_direct`].
#[inline(never)]
fn special_mirror(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
) -> (Lanes3<f32>, Lanes3<f32>) {
    mirror_lanes::<true, true>(material, ns, wo)
}

/// Evaluates [`mirror`], with thin films if `SPECIAL`.
#[inline(always)]
fn mirror_lanes<const EXTENDED: bool, const SPECIAL: bool>(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
) -> (Lanes3<f32>, Lanes3<f32>) {
    let mut direction = [[0.0; LANES]; 3];
    let mut reflectance = [[0.0; LANES]; 3];
    for l in 0..LANES {
        // Reflect the view direction about the normal
        let cosine = ns[0][l] * wo[0][l] + ns[1][l] * wo[1][l] + ns[2][l] * wo[2][l];
        for axis in 0..3 {
            direction[axis][l] = 2.0 * cosine * ns[axis][l] - wo[axis][l];
        }
        // Lanes that are rough or have a lobe send no mirror ray
        let smooth = if material.roughness[l] <= MIRROR_ROUGHNESS && !(EXTENDED && material.has_lobe(l)) {
            1.0
        } else {
            0.0
        };
        // Take Schlick's reflectance, or kr in lanes of the Phong and Whitted model
        let fresnel = material.fresnel::<EXTENDED, SPECIAL>(cosine.abs(), l);
        for channel in 0..3 {
            let polished = smooth * fresnel[channel];
            reflectance[channel][l] = if EXTENDED && material.extended.is_phong[l] {
                material.extended.reflection[channel][l]
            } else {
                polished
            };
        }
    }
    (direction, reflectance)
}

/// Returns the fifth power of max(x, 0).
#[inline(always)]
pub(super) fn fifth_power(x: f32) -> f32 {
    let x = x.max(0.0);
    let squared = x * x;
    squared * squared * x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::EffectSet;
    use crate::shading::LobeAlbedo;

    fn lanes3(v: [f32; 3]) -> Lanes3<f32> {
        v.map(|axis| [axis; LANES])
    }

    fn material(base: f32, metallic: f32, roughness: f32) -> MaterialPacket {
        MaterialPacket {
            base_color: [[base; LANES]; 3],
            metallic: [metallic; LANES],
            roughness: [roughness; LANES],
            ..MaterialPacket::BLACK
        }
    }

    #[test]
    fn a_rough_white_dielectric_seen_and_lit_head_on_is_lambert_plus_four_percent() {
        let up = lanes3([0.0, 0.0, 1.0]);
        let out = direct(&material(1.0, 0.0, 1.0), &up, &up, &up);
        // Diffuse 0.96 / π, lobe D = 1/π, V = 1/4: 0.04 / (4π).
        let expected = 0.96 / PI + 0.04 / (4.0 * PI);
        assert!((out[1][5] - expected).abs() < 4.0 * f32::EPSILON * expected);
    }

    #[test]
    fn light_below_horizon_contributes_nothing() {
        let up = lanes3([0.0, 0.0, 1.0]);
        let out = direct(&material(1.0, 0.0, 0.5), &up, &up, &lanes3([0.6, 0.0, -0.8]));
        assert_eq!(out, [[0.0; LANES]; 3]);
    }

    #[test]
    fn peak_of_smooth_lobe_is_accurate() {
        let up = lanes3([0.0, 0.0, 1.0]);
        let roughness = 0.05f32;
        let out = direct(&material(1.0, 1.0, roughness), &up, &up, &up);
        // Head on: D = 1 / (π α²), V = 1/4, F = 1.
        let alpha = f64::from(roughness) * f64::from(roughness);
        let expected = 1.0 / (4.0 * std::f64::consts::PI * alpha * alpha);
        assert!((f64::from(out[0][0]) / expected - 1.0).abs() < 16.0 * f64::from(f32::EPSILON));
    }

    #[test]
    fn a_perfect_mirror_has_no_lobe_and_reflects_about_the_normal() {
        let up = lanes3([0.0, 0.0, 1.0]);
        let wo = lanes3([0.6, 0.0, 0.8]);
        let polished = material(0.5, 1.0, 0.0);
        assert_eq!(
            direct(&polished, &up, &wo, &lanes3([-0.6, 0.0, 0.8])),
            [[0.0; LANES]; 3]
        );
        let (direction, reflectance) = mirror::<false>(&polished, &up, &wo);
        let close = |a: f32, b: f32| (a - b).abs() < 4.0 * f32::EPSILON;
        assert!(close(direction[0][2], -0.6) && close(direction[2][2], 0.8));
        // f0 = 1/2, (1 - 0.8)^5 = 0.00032.
        assert!(close(reflectance[0][2], 0.5 + 0.5 * 0.00032));
        assert_eq!(
            mirror::<false>(&material(0.5, 1.0, 0.2), &up, &wo).1,
            [[0.0; LANES]; 3]
        );
    }

    #[test]
    fn energy_conservation_changes_no_bit_of_a_smooth_metal() {
        let up = lanes3([0.0, 0.0, 1.0]);
        let (wo, wi) = (lanes3([0.6, 0.0, 0.8]), lanes3([-0.8, 0.0, 0.6]));
        let single = material(0.5, 1.0, 0.0);
        let conserving = MaterialPacket {
            effects: EffectSet::NONE.with(Effect::EnergyConservation),
            lobe: LobeAlbedo::of_packet(&single.roughness, &up, &wo),
            ..single.clone()
        };
        assert_eq!(
            mirror::<false>(&conserving, &up, &wo),
            mirror::<false>(&single, &up, &wo)
        );
        assert_eq!(direct(&conserving, &up, &wo, &wi), direct(&single, &up, &wo, &wi));
        assert_eq!(conserving.ambient([1.0; 3]), single.ambient([1.0; 3]));
    }

    #[test]
    fn ambient_light_is_reflected_by_the_albedos_and_never_in_excess() {
        let (up, wo) = (lanes3([0.0, 0.0, 1.0]), lanes3([0.6, 0.0, 0.8]));
        for (metallic, roughness) in [(0.0, 0.5), (0.0, 1.0), (1.0, 0.5), (1.0, 1.0)] {
            let single = material(1.0, metallic, roughness);
            let conserving = MaterialPacket {
                effects: EffectSet::NONE.with(Effect::EnergyConservation),
                lobe: LobeAlbedo::of_packet(&single.roughness, &up, &wo),
                ..single.clone()
            };
            // c_diff (1 - a) + a = 1 for white dielectrics, a = 1 for white metals.
            let ambient = conserving.ambient([1.0; 3])[0][0];
            assert!(
                (ambient - 1.0).abs() < 8.0 * f32::EPSILON,
                "{metallic} {roughness}: {ambient}"
            );
            // Without energy conservation: c_diff + f0.
            let plain = single.ambient([1.0; 3])[0][0];
            assert!((plain - if metallic == 0.0 { 1.04 } else { 1.0 }).abs() < 4.0 * f32::EPSILON);
        }
    }
}
