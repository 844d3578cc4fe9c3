//! Diffuse reflection and transmission alone: the weights of rays from diffuse surfaces, and what ambient light adds to
//! surfaces that send such rays.

use std::f32::consts::PI;

use multiversion::multiversion;

use super::anisotropic_lobe::dot;
use super::material::MaterialPacket;
use super::metallic_roughness::fifth_power;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Effect, MIRROR_ROUGHNESS};

/// Returns the weights of radiance from the directions `wi` at sixteen surfaces, where directions are distributed by the
/// cosine to the normal: the BRDF of the diffuse part times π. It is the albedo of a surface that reflects light from all
/// directions alike.
///
/// Directions below the surface have the weight of diffuse transmission. The coefficient rd of the Phong and Whitted model
/// is taken for an albedo, as its ambient coefficient is.
pub fn diffuse_weights(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
    wi: &Lanes3<f32>,
) -> Lanes3<f32> {
    match (
        material.effects.needs_full_material(),
        material.effects.has_special_lobes(),
    ) {
        (false, _) => basic_weights(material, ns, wo, wi),
        (true, false) => full_weights(material, ns, wo, wi),
        (true, true) => weight_lanes::<true, true>(material, ns, wo, wi),
    }
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn basic_weights(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
    wi: &Lanes3<f32>,
) -> Lanes3<f32> {
    weight_lanes::<false, false>(material, ns, wo, wi)
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn full_weights(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
    wi: &Lanes3<f32>,
) -> Lanes3<f32> {
    weight_lanes::<true, false>(material, ns, wo, wi)
}

/// Evaluates [`direct_combined`](super::direct_combined) where no lane has a lobe.
///
/// The result has the same bits, as what the lobe takes and adds is 0.
#[inline(always)]
pub(super) fn diffuse_direct(material: &MaterialPacket, ns: &Lanes3<f32>, wi: &Lanes3<f32>) -> Lanes3<f32> {
    let mut reflected = [[0.0; LANES]; 3];
    for l in 0..LANES {
        let n_dot_l = dot([ns[0][l], ns[1][l], ns[2][l]], [wi[0][l], wi[1][l], wi[2][l]]).max(0.0);
        for channel in 0..3 {
            reflected[channel][l] = material.c_diff::<true>(channel, l) * (1.0 / PI) * n_dot_l;
        }
    }
    reflected
}

/// Evaluates all lanes: with the parameters that few materials use if `EXTENDED`, with thin films if `SPECIAL`.
#[inline(always)]
fn weight_lanes<const EXTENDED: bool, const SPECIAL: bool>(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
    wi: &Lanes3<f32>,
) -> Lanes3<f32> {
    let mut weights = [[0.0; LANES]; 3];
    for l in 0..LANES {
        let n = [ns[0][l], ns[1][l], ns[2][l]];
        let i = [wi[0][l], wi[1][l], wi[2][l]];
        // Compute the half vector, with light from behind mirrored to the front
        let behind = (-dot(n, i)).max(0.0);
        let mut h = [wo[0][l], wo[1][l], wo[2][l]];
        for axis in 0..3 {
            h[axis] += i[axis] + 2.0 * behind * n[axis];
        }
        let grazing = fifth_power(1.0 - 0.5 * dot(h, h).sqrt());
        // The lobe takes its part first
        for channel in 0..3 {
            let fresnel = material.schlick::<EXTENDED>(grazing, channel, l);
            let taken = fresnel.max(material.specular_albedo::<EXTENDED, SPECIAL>(channel, l));
            let mut albedo = material.c_diff::<EXTENDED>(channel, l);
            let mut phong = 0.0;
            if EXTENDED {
                let transmitted = material.transmission_albedo(channel, l);
                albedo = if behind > 0.0 { transmitted } else { albedo };
                phong = material.extended.diffuse[channel][l] * material.base_color[channel][l];
            }
            let weight = (1.0 - taken) * albedo;
            weights[channel][l] = if EXTENDED && material.extended.is_phong[l] {
                if behind > 0.0 { 0.0 } else { phong }
            } else {
                weight
            };
        }
    }
    weights
}

impl MaterialPacket {
    /// Returns emission plus the ambient radiance `ambient` reflected by lobes that no ray gathers.
    ///
    /// It is what surfaces that send rays from their diffuse part add without light samples: those rays bring the rest of
    /// the ambient light.
    pub fn emission_and_lobes(&self, ambient: [f32; 3]) -> Lanes3<f32> {
        // Without ambient light only emission is left
        let mut radiance = self.emission;
        if ambient == [0.0; 3] {
            return radiance;
        }
        // Add the albedo of each lobe that is not gathered by rays
        let mut shares = [0.0; LANES];
        for l in 0..LANES {
            let is_gathered = self.roughness[l] <= MIRROR_ROUGHNESS || self.has_lobe(l);
            let is_added = !(is_gathered || self.extended.is_phong[l]);
            shares[l] = if is_added { self.extended.occlusion[l] } else { 0.0 };
        }
        // No loop over the channels, which would be vectorised in place of that over the lanes
        let [r, g, b] = &mut radiance;
        self.add_lobes(0, ambient[0], &shares, r);
        self.add_lobes(1, ambient[1], &shares, g);
        self.add_lobes(2, ambient[2], &shares, b);
        radiance
    }

    /// Adds the light that lobes reflect of uniform radiance in one channel, times `shares`.
    #[inline(always)]
    fn add_lobes(&self, channel: usize, ambient: f32, shares: &Lanes<f32>, radiance: &mut Lanes<f32>) {
        for l in 0..LANES {
            let albedo = if self.effects.has(Effect::EnergyConservation) {
                self.specular_albedo::<true, true>(channel, l)
            } else {
                self.f0::<true>(channel, l)
            };
            radiance[l] += ambient * albedo * shares[l];
        }
    }

    /// Returns whether no lane reflects specularly, at any angle.
    #[inline(always)]
    pub(super) fn is_diffuse_only(&self) -> bool {
        // Sums and maxima of floats have an order, which the compiler keeps; bits have none
        let mut bits = 0;
        for l in 0..LANES {
            bits |= self.metallic[l].to_bits() | self.extended.specular[l].to_bits();
        }
        bits == 0
    }

    /// Returns whether light samples light the surface in lane `l`: by its diffuse part, or by a lobe that no ray samples.
    pub fn scatters_light_samples(&self, l: usize) -> bool {
        // The Phong model has a highlight where no reflected ray shows it
        let extended = &self.extended;
        if extended.is_phong[l] {
            let has_highlight = (0..3).all(|c| extended.reflection[c][l] == 0.0);
            return (0..3).any(|c| {
                extended.diffuse[c][l] > 0.0 || has_highlight && extended.specular_color[c][l] > 0.0
            });
        }
        // glTF's model scatters by its diffuse part, or by a lobe that no ray samples
        let is_diffuse = (0..3).any(|c| self.c_diff::<true>(c, l) > 0.0);
        let is_rough = self.roughness[l] > MIRROR_ROUGHNESS && !self.has_lobe(l) && !self.transmits(l);
        is_diffuse || is_rough || self.is_thin_surface(l)
    }

    /// Returns the share of the diffuse light of each lane that leaves on the other side of the surface; 0 where nothing
    /// is transmitted diffusely.
    pub fn transmitted_share(&self) -> Lanes<f32> {
        // Compare the sums of the channels
        let mut shares = [0.0; LANES];
        if self.effects.has(Effect::Translucency) {
            for l in 0..LANES {
                let sum = |value: &dyn Fn(usize) -> f32| value(0) + value(1) + value(2);
                let transmitted = sum(&|channel| self.transmission_albedo(channel, l));
                let reflected = sum(&|channel| self.c_diff::<true>(channel, l));
                let both = transmitted + reflected;
                shares[l] = if transmitted > 0.0 {
                    transmitted / both
                } else {
                    0.0
                };
            }
        }
        shares
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;
    use crate::shading::metallic_roughness::direct_combined;

    #[test]
    fn surfaces_without_lobes_have_the_bits_of_the_whole_model() {
        let mut random = SplitMix64::new(7, 0);
        let mut lit_count = 0;
        for _ in 0..100 {
            // Choose materials without lobes, and directions
            let mut diffuse = MaterialPacket::BLACK;
            let mut directions = [[[0.0; LANES]; 3]; 3];
            for l in 0..LANES {
                diffuse.roughness[l] = random.unit() as f32;
                diffuse.extended.specular[l] = 0.0;
                for channel in 0..3 {
                    diffuse.base_color[channel][l] = random.unit() as f32;
                }
                for vectors in &mut directions {
                    let direction = random.direction().as_vec3();
                    for axis in 0..3 {
                        vectors[axis][l] = direction[axis];
                    }
                }
            }
            // Give the last lane a lobe, with which all lanes are evaluated by the whole model
            let mut mixed = diffuse.clone();
            mixed.extended.specular[LANES - 1] = 1.0;
            assert!(diffuse.is_diffuse_only() && !mixed.is_diffuse_only());
            let [ns, wo, wi] = &directions;
            let alone = direct_combined::<true>(&diffuse, ns, wo, wi, None);
            let among = direct_combined::<true>(&mixed, ns, wo, wi, None);
            for channel in 0..3 {
                let bits = |lanes: &Lanes<f32>| lanes.map(f32::to_bits);
                let [alone, among] = [bits(&alone[channel]), bits(&among[channel])];
                assert_eq!(alone[..LANES - 1], among[..LANES - 1]);
                lit_count += alone.iter().filter(|&&bits| bits != 0).count();
            }
        }
        assert!(lit_count > 1000, "{lit_count}");
    }
}
