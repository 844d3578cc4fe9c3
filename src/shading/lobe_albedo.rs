//! Directional albedo of the GGX lobe, and the light that single scattering loses between microfacets.
//!
//! Under uniform light of radiance 1 from all directions, the lobe of [`Ggx`](super::Ggx) reflects the radiance E
//! to the viewer where the Fresnel reflectance is 1. The rest, 1 - E, would reach other microfacets. E. Turquin,
//! "Practical multiple scattering compensation for microfacet models" (2019), returns it by multiplying the lobe
//! with 1 + F0 (1 - E) / E, where E is that of the viewer's direction: the albedo of a white metal becomes 1, and that
//! of a coloured one about F0 E + F0² (1 - E), which is more saturated. The factor makes the lobe not reciprocal,
//! because it depends on the viewer's direction but not on the light's. (The lobe of C. Kulla and A. Conty, 2017, is
//! reciprocal, but has a second term without the shape of the lobe, which rays into the lobe would have to sample.)
//!
//! With Schlick's reflectance f0 + (f90 - f0) (1 - cos)⁵ of a microfacet, the albedo is f0 (E - B) + f90 B, where B is
//! E with the weight (1 - cos)⁵.
//!
//! E and B are rational functions, fitted to numerical integrals at 1500 points of roughness 0.02 to 1 and all angles.
//! At other random points, E is within 0.0006 of itself, and B within 0.0012 of 1.

use std::ops::{Add, Div, Mul, Sub};

use crate::numeric::{LANES, Lanes, Lanes3};

/// Directional albedo of a GGX lobe for one direction to the viewer, without the Fresnel reflectance, split by
/// Schlick's approximation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LobeAlbedo<T> {
    /// Albedo per reflectance at normal incidence: E - B.
    pub normal: T,
    /// Albedo per reflectance at grazing incidence: B.
    pub grazing: T,
    /// Light that single scattering loses over the light that it reflects: (1 - E) / E.
    pub loss: T,
}

impl LobeAlbedo<Lanes<f32>> {
    /// Albedo of zero and no loss, with which the lobe is that of single scattering.
    pub const NONE: LobeAlbedo<Lanes<f32>> = LobeAlbedo {
        normal: [0.0; LANES],
        grazing: [0.0; LANES],
        loss: [0.0; LANES],
    };

    /// Returns the albedos of sixteen surfaces; finite in every lane, whatever the directions are.
    #[inline(always)]
    pub fn of_packet(roughness: &Lanes<f32>, ns: &Lanes3<f32>, wo: &Lanes3<f32>) -> LobeAlbedo<Lanes<f32>> {
        let mut albedo = LobeAlbedo::NONE;
        for l in 0..LANES {
            let cosine = ns[0][l] * wo[0][l] + ns[1][l] * wo[1][l] + ns[2][l] * wo[2][l];
            // Lanes that hit nothing may hold NaN, which `min` replaces and `clamp` would keep
            let cosine = cosine.abs().min(1.0);
            let lane = LobeAlbedo::evaluate(cosine.max(f32::MIN_POSITIVE), roughness[l]);
            albedo.set(l, lane);
        }
        albedo
    }

    /// Sets the albedo of lane `l`.
    #[inline(always)]
    pub(super) fn set(&mut self, l: usize, lane: LobeAlbedo<f32>) {
        self.normal[l] = lane.normal;
        self.grazing[l] = lane.grazing;
        self.loss[l] = lane.loss;
    }
}

/// Arithmetic of which the fits are made: f32 in lanes, and wider numbers in references.
pub trait Arithmetic:
    Copy + From<f32> + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
}

impl<T> Arithmetic for T where
    T: Copy + From<f32> + Add<Output = T> + Sub<Output = T> + Mul<Output = T> + Div<Output = T>
{
}

impl<T: Arithmetic> LobeAlbedo<T> {
    /// Evaluates the fits for a viewer at `cosine` to the normal, more than 0 and at most 1, and a perceptual
    /// `roughness` of 0 to 1.
    #[inline(always)]
    pub fn evaluate(cosine: T, roughness: T) -> LobeAlbedo<T> {
        let one = T::from(1.0);
        let alpha = roughness * roughness;
        // All change where the cosine is about alpha, however small that is: so does this measure of the angle, from
        // 0 at grazing incidence to 1 at normal incidence
        let u = cosine * (one + alpha) / (cosine + alpha);
        let root = root_of_loss(u, alpha);
        let loss = root * root;
        let albedo = one / (one + loss);
        let rest = one - cosine - alpha * tilt(u, roughness);
        let squared = rest * rest;
        let grazing = albedo * (squared * squared * rest);
        LobeAlbedo {
            normal: albedo - grazing,
            grazing,
            loss,
        }
    }
}

/// Returns the root of (1 - E) / E, which is nearly linear in alpha.
#[inline(always)]
fn root_of_loss<T: Arithmetic>(u: T, alpha: T) -> T {
    let numerator = [
        by(
            [0.260_169_8, 0.251_077_1, 1.779_084, -0.097_381_65, 0.332_411_7],
            alpha,
        ),
        by([-0.202_825_4, -0.401_686_8, -0.894_079_1, 1.619_573], alpha),
        by([0.024_620_09, 0.226_417_7, -1.304_224], alpha),
        by([-0.192_345_7, 0.363_854_9], alpha),
        T::from(0.106_770_8),
    ];
    let denominator = [
        by([1.0, 0.819_176_4, 1.418_139, -0.052_908_51], alpha),
        by([-1.599_046, -0.353_406_4, 0.014_772_76], alpha),
        by([0.634_828_7, -0.989_545_7], alpha),
        T::from(0.352_836_3),
    ];
    polynomial(numerator, u) / polynomial(denominator, u)
}

/// Returns the mean tilt of microfacets towards the viewer over alpha: the difference to the cosine with the normal,
/// by which (1 - cos)⁵ becomes its mean over the lobe.
#[inline(always)]
fn tilt<T: Arithmetic>(u: T, roughness: T) -> T {
    let numerator = [
        by([8.093_338, 18.707_47, -0.579_082_4], roughness),
        by([-6.162_172, -25.639], roughness),
        T::from(-1.252_64),
    ];
    let denominator = [
        by([1.0, 16.272_85, 7.485_854, 28.283_77], roughness),
        by([-0.503_565_1, -1.395_282, -22.149_02], roughness),
        by([2.119_932, -7.285_267], roughness),
        T::from(0.074_517_65),
    ];
    polynomial(numerator, u) / polynomial(denominator, u)
}

/// Evaluates a polynomial of constant coefficients at `x`, lowest power first.
#[inline(always)]
fn by<T: Arithmetic, const N: usize>(coefficients: [f32; N], x: T) -> T {
    polynomial(coefficients.map(T::from), x)
}

/// Evaluates a polynomial at `x`, lowest power first.
#[inline(always)]
fn polynomial<T: Arithmetic, const N: usize>(coefficients: [T; N], x: T) -> T {
    let mut sum = coefficients[N - 1];
    for power in (0..N - 1).rev() {
        sum = sum * x + coefficients[power];
    }
    sum
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use glam::DVec3;

    use super::*;
    use crate::numeric::SplitMix64;
    use crate::shading::{Ggx, MaterialPacket, direct};

    const ROUGHNESSES: [f32; 7] = [0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0];
    const COSINES: [f64; 8] = [0.001, 0.01, 0.05, 0.15, 0.35, 0.6, 0.85, 1.0];
    /// Steps of each random number of a quadrature: E is then right to some 1e-4.
    const STEPS: u32 = 96;

    /// Returns the unit vector to the viewer at this cosine, in the xz plane.
    fn viewer(cosine: f64) -> DVec3 {
        DVec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine)
    }

    /// Returns the mean of `value` over a grid of random pairs, which is denser where the second one nears 1.
    fn mean(mut value: impl FnMut([f64; 2]) -> DVec3) -> DVec3 {
        let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(STEPS);
        let mut sum = DVec3::ZERO;
        for i in 0..STEPS * STEPS {
            let rest = 1.0 - middle(i / STEPS);
            sum += 3.0 * rest * rest * value([middle(i % STEPS), 1.0 - rest.powi(3)]);
        }
        sum / f64::from(STEPS * STEPS)
    }

    /// Returns E and B by quadrature over the visible microfacets.
    fn integrals(roughness: f32, wo: DVec3) -> [f64; 2] {
        let lobe = Ggx::from_roughness(roughness.into());
        let sums = mean(|u| {
            lobe.sample_reflection(wo, u).map_or(DVec3::ZERO, |s| {
                s.weight * DVec3::new(1.0, (1.0 - wo.dot(s.m)).powi(5), 0.0)
            })
        });
        [sums.x, sums.y]
    }

    #[test]
    fn fits_are_within_their_stated_errors_of_the_integrals() {
        for roughness in ROUGHNESSES {
            for cosine in COSINES {
                let [albedo, grazing] = integrals(roughness, viewer(cosine));
                let found = LobeAlbedo::evaluate(cosine as f32, roughness);
                let compensated = albedo * (1.0 + f64::from(found.loss));
                assert!(
                    (compensated - 1.0).abs() < 6e-4,
                    "{roughness} {cosine}: {compensated}"
                );
                let off = f64::from(found.grazing) - grazing;
                assert!(off.abs() < 1.2e-3, "{roughness} {cosine}: {off}");
                let sum = f64::from(found.normal + found.grazing) * (1.0 + f64::from(found.loss));
                assert!((sum - 1.0).abs() < 4.0 * f64::from(f32::EPSILON));
            }
        }
    }

    #[test]
    fn lanes_equal_wider_arithmetic() {
        // Of 20 million such points, the largest difference is 2.3e-6
        const BOUND: f64 = 4e-6;
        let mut random = SplitMix64::new(7, 0);
        for _ in 0..100_000 {
            let cosine = random.unit().powi(2).max(1e-4) as f32;
            let roughness = random.unit() as f32;
            let lane = LobeAlbedo::evaluate(cosine, roughness);
            let wide = LobeAlbedo::evaluate(f64::from(cosine), f64::from(roughness));
            for (lane, wide) in [
                (lane.normal, wide.normal),
                (lane.grazing, wide.grazing),
                (lane.loss, wide.loss),
            ] {
                assert!(
                    (f64::from(lane) - wide).abs() < BOUND,
                    "{roughness} {cosine}: {lane} {wide}"
                );
            }
        }
    }

    #[test]
    fn albedo_of_zero_roughness_is_schlicks_reflectance_at_the_normal() {
        for cosine in COSINES {
            let found = LobeAlbedo::evaluate(cosine as f32, 0.0);
            assert!(
                (f64::from(found.grazing) - (1.0 - cosine).powi(5)).abs() < 6e-4,
                "{cosine}"
            );
            assert!(found.loss < 6e-4);
        }
    }

    #[test]
    fn lanes_without_a_hit_are_finite() {
        let any = [f32::NAN, 0.0, f32::INFINITY, -2.0];
        let wild: Lanes3<f32> = std::array::from_fn(|axis| std::array::from_fn(|l| any[(axis + l) % 4]));
        for roughness in [0.0, 0.3, 1.0] {
            let found = LobeAlbedo::of_packet(&[roughness; LANES], &wild, &wild);
            for lanes in [found.normal, found.grazing, found.loss] {
                assert!(lanes.iter().all(|value| value.is_finite()), "{lanes:?}");
            }
        }
    }

    /// Returns a material with its lobe's albedo for this viewer.
    fn material(base: [f32; 3], metallic: f32, roughness: f32, wo: DVec3) -> MaterialPacket {
        let mut material = MaterialPacket {
            base_color: base.map(|channel| [channel; LANES]),
            metallic: [metallic; LANES],
            roughness: [roughness; LANES],
            ..MaterialPacket::BLACK
        };
        material.lobe = LobeAlbedo::of_packet(&material.roughness, &lanes(DVec3::Z), &lanes(wo));
        material
    }

    fn lanes(v: DVec3) -> Lanes3<f32> {
        v.as_vec3().to_array().map(|axis| [axis; LANES])
    }

    /// Returns the radiance that a metal or a dielectric reflects by [`direct`] under uniform light of radiance 1.
    fn furnace(material: &MaterialPacket, wo: DVec3) -> [f64; 3] {
        let lobe = Ggx::from_roughness(material.roughness[0].into());
        let reflected = |material: &MaterialPacket, wi: DVec3| {
            let reflected = direct(material, &lanes(DVec3::Z), &lanes(wo), &lanes(wi));
            DVec3::from(reflected.map(|channel| f64::from(channel[0])))
        };
        // Sample the lobe, which is all that a black dielectric has, and the diffuse rest by the cosine
        let mut specular = material.clone();
        if material.metallic[0] == 0.0 {
            specular.base_color = [[0.0; LANES]; 3];
        }
        let by_lobe = mean(|u| {
            lobe.sample_reflection(wo, u).map_or(DVec3::ZERO, |s| {
                reflected(&specular, s.wi) / lobe.reflection_pdf(wo, s.wi)
            })
        });
        let by_cosine = mean(|[turn, u]| {
            let (sin, cos) = (TAU * turn).sin_cos();
            let wi = DVec3::new(u.sqrt() * cos, u.sqrt() * sin, (1.0 - u).sqrt());
            (reflected(material, wi) - reflected(&specular, wi)) * PI / wi.z
        });
        (by_lobe + by_cosine).to_array()
    }

    #[test]
    fn white_metal_in_a_furnace_reflects_all_light() {
        for roughness in ROUGHNESSES {
            for cosine in COSINES {
                let wo = viewer(cosine);
                let [albedo, ..] = furnace(&material([1.0; 3], 1.0, roughness, wo), wo);
                assert!((albedo - 1.0).abs() < 1e-3, "{roughness} {cosine}: {albedo}");
            }
        }
    }

    #[test]
    fn no_material_in_a_furnace_reflects_more_than_arrives() {
        for roughness in ROUGHNESSES {
            for cosine in COSINES {
                let wo = viewer(cosine);
                for (base, metallic) in [([1.0, 0.77, 0.34], 1.0), ([1.0, 0.5, 0.0], 0.0)] {
                    let albedo = furnace(&material(base, metallic, roughness, wo), wo);
                    assert!(
                        albedo.iter().all(|a| *a <= 1.0 + 1e-3),
                        "{roughness} {cosine}: {albedo:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn single_scattering_loses_two_thirds_of_the_light_on_the_roughest_white_metal() {
        let single = MaterialPacket {
            lobe: LobeAlbedo::NONE,
            ..material([1.0; 3], 1.0, 1.0, DVec3::Z)
        };
        assert!((furnace(&single, DVec3::Z)[0] - 0.3068).abs() < 2e-4);
    }

    #[test]
    fn diffuse_weight_is_gltfs_where_it_does_not_exceed_energy() {
        // Head on, the lobe of a dielectric takes no more than the Fresnel reflectance of any half vector.
        let wi = DVec3::new(0.6, 0.0, 0.8);
        let conserving = material([0.5; 3], 0.0, 0.0, DVec3::Z);
        let gltf = MaterialPacket {
            lobe: LobeAlbedo::NONE,
            ..conserving.clone()
        };
        let [conserving, gltf] = [conserving, gltf]
            .map(|material| direct(&material, &lanes(DVec3::Z), &lanes(DVec3::Z), &lanes(wi)));
        assert_eq!(conserving, gltf);
    }

    #[test]
    fn multiple_scattering_is_not_reciprocal() {
        let (a, b) = (viewer(0.2), viewer(1.0));
        let brdf = |wo: DVec3, wi: DVec3| {
            let white = material([1.0; 3], 1.0, 0.8, wo);
            f64::from(direct(&white, &lanes(DVec3::Z), &lanes(wo), &lanes(wi))[0][0]) / wi.z
        };
        // The ratio of the two directions is that of their 1 / E.
        let raised = |wo: DVec3| 1.0 + LobeAlbedo::evaluate(wo.z, 0.8).loss;
        let ratio = brdf(a, b) / brdf(b, a);
        assert!((ratio / (raised(a) / raised(b)) - 1.0).abs() < 1e-4, "{ratio}");
        assert!((ratio - 1.0).abs() > 0.05, "{ratio}");
    }
}
