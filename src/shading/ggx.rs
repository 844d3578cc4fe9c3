//! GGX microfacet lobe for ray sampling: reflection and refraction, with sampling of visible normals (VNDF).
//!
//! The lobe equals the one that `direct` evaluates for lights: alpha = roughness², D of Trowbridge and Reitz, and
//! Smith's masking G1 for the viewer times G1 for the light (glTF 2.0, Appendix B). Microfacet normals are sampled with
//! the density of the visible ones, G1(o) D(m) (o·m) / (n·o), by J. Dupuy and A. Benyoub ("Sampling Visible GGX Normals
//! with Spherical Caps", HPG 2023; the density is E. Heitz's, JCGT 7(4), 2018). A reflected or refracted ray (B. Walter
//! et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007) then has the weight G1(i) times the
//! Fresnel term at the microfacet. The caller applies the Fresnel term: it may be coloured, and selects which of the
//! two rays is sent. The fraction that G1 removes is light that would hit another microfacet; the model drops it.
//!
//! Vectors are unit, in the surface's frame: +z is the normal, on the viewer's side. `wo` points to the viewer, `wi`
//! toward the light. Transmission is that of power, or of radiance over the squared index: radiance itself is scaled by
//! the square of the viewer's index over the other one. All arithmetic is f64: the hot part is some forty operations,
//! and f32 would leave a lobe of roughness 0.05 (alpha = 0.0025) four digits.

use std::f64::consts::PI;

use glam::DVec3;

use crate::numeric::warp;
use crate::optics;

/// GGX lobe of one roughness, which may be wider along x than along y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ggx {
    /// Width alpha along the x axis.
    alpha: f64,
    /// Width along the y axis over that along the x axis: 1 for an isotropic lobe.
    aspect: f64,
}

/// Direction sampled from a GGX lobe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LobeSample {
    /// Unit vector toward the incident light.
    pub wi: DVec3,
    /// Unit normal of the microfacet, on the viewer's side of it. The Fresnel term is that at the cosine `wo`·m.
    pub m: DVec3,
    /// Weight of the incident radiance, without the Fresnel term, within [0, 1]: the lobe times n·wi over its density.
    pub weight: f64,
}

impl Ggx {
    /// Lobe of a mirror.
    pub const SMOOTH: Ggx = Ggx {
        alpha: 0.0,
        aspect: 1.0,
    };

    /// Creates the lobe of a perceptual roughness from 0 (a mirror) to 1: alpha is its square.
    pub fn from_roughness(roughness: f64) -> Ggx {
        Ggx {
            alpha: roughness * roughness,
            aspect: 1.0,
        }
    }

    /// Creates the lobe of these widths alpha along x and along y; the first must be positive.
    pub fn anisotropic([along, across]: [f64; 2]) -> Ggx {
        Ggx {
            alpha: along,
            aspect: across / along,
        }
    }

    /// Returns whether the lobe has zero width: it then reflects and refracts as a smooth surface does, and has no
    /// density.
    pub fn is_smooth(&self) -> bool {
        self.alpha * self.alpha * self.aspect == 0.0
    }

    /// Evaluates D: the area of microfacets of normal `m` per steradian and per area of the surface.
    #[inline(always)]
    pub fn distribution(&self, m: DVec3) -> f64 {
        let squared = self.alpha * self.alpha * self.aspect;
        // Written as sin² + α² cos², which has no cancellation.
        let below = m.x * m.x * self.aspect + m.y * m.y / self.aspect + squared * m.z * m.z;
        if m.z > 0.0 && squared > 0.0 {
            squared / (PI * below * below)
        } else {
            0.0
        }
    }

    /// Evaluates Smith's G1: the fraction of the microfacets facing `w` that are visible from there; equal on both
    /// sides of the surface. For a sampled direction it is G2 / G1, the weight of the sample.
    #[inline(always)]
    pub fn smith_g1(&self, w: DVec3) -> f64 {
        let cosine = w.z.abs();
        let y = w.y * self.aspect;
        let root = (self.alpha * self.alpha * (w.x * w.x + y * y) + w.z * w.z).sqrt();
        // Keep the root at least the cosine, also where squares underflow.
        let root = root.max(cosine);
        if cosine > 0.0 {
            2.0 * cosine / (cosine + root)
        } else {
            0.0
        }
    }

    /// Returns the density per steradian of the normals that [`Ggx::sample_vndf`] samples, for `wo` above the surface.
    #[inline(always)]
    pub fn vndf_pdf(&self, wo: DVec3, m: DVec3) -> f64 {
        if wo.z <= 0.0 {
            return 0.0;
        }
        self.smith_g1(wo) * self.distribution(m) * wo.dot(m).max(0.0) / wo.z
    }

    /// Samples a microfacet normal among those visible from `wo`, which is above the surface, by `u` in [0, 1)².
    #[inline(always)]
    pub fn sample_vndf(&self, wo: DVec3, u: [f64; 2]) -> DVec3 {
        // Stretch space so that the microfacets form a hemisphere; mirroring its visible part gives a spherical cap.
        // Divide by the larger component first, so that the square of neither a narrow lobe nor a grazing view
        // underflows.
        let scale = self.alpha.max(wo.z);
        let alpha = self.alpha / scale;
        let seen = DVec3::new(alpha * wo.x, alpha * self.aspect * wo.y, wo.z / scale).normalize();
        // Sample the spherical cap of mirrored directions
        let cap = warp::direction(u[1] * (1.0 + seen.z), u[0]);
        // The half vector's z is (1 - u)(1 + z), free of cancellation; scale back to the unstretched space.
        let z = (1.0 - u[1]) * (1.0 + seen.z);
        let across = self.alpha * self.aspect;
        DVec3::new(self.alpha * (cap.x + seen.x), across * (cap.y + seen.y), z).normalize()
    }

    /// Evaluates the reflection lobe D G / (4 |n·wo| |n·wi|) without the Fresnel term: symmetric, per steradian.
    #[inline(always)]
    pub fn reflection(&self, wo: DVec3, wi: DVec3) -> f64 {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return 0.0;
        }
        let masking = self.smith_g1(wo) * self.smith_g1(wi);
        self.distribution((wo + wi).normalize()) * masking / (4.0 * wo.z * wi.z)
    }

    /// Returns the density of [`Ggx::sample_reflection`] per steradian.
    #[inline(always)]
    pub fn reflection_pdf(&self, wo: DVec3, wi: DVec3) -> f64 {
        let half = wo + wi;
        // For unit vectors the cosine with the half vector is half its length.
        let m = half.normalize_or_zero();
        let cosine = 0.5 * half.length();
        if cosine > 0.0 && m.z > 0.0 {
            self.vndf_pdf(wo, m) / (4.0 * cosine)
        } else {
            0.0
        }
    }

    /// Samples a reflected direction by `u` in [0, 1)². Returns `None` where it points into the surface; such samples
    /// count as zero.
    #[inline(always)]
    pub fn sample_reflection(&self, wo: DVec3, u: [f64; 2]) -> Option<LobeSample> {
        let m = self.sample_vndf(wo, u);
        let wi = optics::reflect(-wo, m);
        (wi.z > 0.0).then(|| LobeSample {
            wi,
            m,
            weight: self.smith_g1(wi),
        })
    }

    /// Evaluates the refraction lobe without the Fresnel term, per steradian; `wi` is below the surface and `eta` is
    /// the index there over that on the viewer's side. Divided by `eta` it is symmetric.
    ///
    /// It is Walter's equation 21 over the squared ratio of indices. The denominator (o·m + eta i·m)² is |o + eta i|²,
    /// as m has that direction.
    #[inline(always)]
    pub fn transmission(&self, wo: DVec3, wi: DVec3, eta: f64) -> f64 {
        let Some((m, below)) = self.refracting_normal(wo, wi, eta) else {
            return 0.0;
        };
        let masking = self.smith_g1(wo) * self.smith_g1(wi);
        let cosines = wo.dot(m) * -wi.dot(m) / (wo.z * -wi.z);
        cosines * eta * eta * self.distribution(m) * masking / below
    }

    /// Returns the density of [`Ggx::sample_transmission`] per steradian of `wi` (Walter, equation 17).
    #[inline(always)]
    pub fn transmission_pdf(&self, wo: DVec3, wi: DVec3, eta: f64) -> f64 {
        let Some((m, below)) = self.refracting_normal(wo, wi, eta) else {
            return 0.0;
        };
        self.vndf_pdf(wo, m) * eta * eta * -wi.dot(m) / below
    }

    /// Returns the microfacet normal that refracts `wi` to `wo`, and |wo + eta wi|²; `None` if there is none.
    #[inline(always)]
    fn refracting_normal(&self, wo: DVec3, wi: DVec3, eta: f64) -> Option<(DVec3, f64)> {
        let across = wo + eta * wi;
        let below = across.length_squared();
        // The half vector points to the side of the lower index.
        let m = across * (below.sqrt().recip() * if eta > 1.0 { -1.0 } else { 1.0 });
        let faces = wo.z > 0.0 && wi.z < 0.0 && below > 0.0 && m.z > 0.0;
        (faces && wo.dot(m) > 0.0 && wi.dot(m) < 0.0).then_some((m, below))
    }

    /// Samples a refracted direction by `u` in [0, 1)²; `eta` is the index on the far side over that on the viewer's
    /// side.
    ///
    /// Returns `None` on total internal reflection at the microfacet, or where the ray would not get below the surface;
    /// such samples count as zero. Equal indices bend no ray, but the lobe still masks: skip such boundaries.
    #[inline(always)]
    pub fn sample_transmission(&self, wo: DVec3, eta: f64, u: [f64; 2]) -> Option<LobeSample> {
        let m = self.sample_vndf(wo, u);
        let wi = optics::refract(-wo, m, 1.0, eta)?.direction;
        (wi.z < 0.0).then(|| LobeSample {
            wi,
            m,
            weight: self.smith_g1(wi),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::numeric::LANES;
    use crate::shading::{MaterialPacket, direct};

    const ROUGHNESSES: [f64; 6] = [0.05, 0.1, 0.25, 0.5, 0.8, 1.0];
    const INDICES: [f64; 4] = [1.5, 1.0 / 1.5, 1.01, 2.4];

    /// Returns the unit vector at this angle from the normal, in the xz plane.
    fn at(degrees: f64) -> DVec3 {
        let (sin, cos) = degrees.to_radians().sin_cos();
        DVec3::new(sin, 0.0, cos)
    }

    /// Returns points of Roberts' R4 sequence: low-discrepancy numbers for two directions.
    fn quadruples(count: u32) -> impl Iterator<Item = [f64; 4]> {
        const STEP: [f64; 4] = [
            0.856_674_883_854_502_8,
            0.733_891_856_627_126,
            0.628_706_720_775_458_5,
            0.538_596_859_579_463_9,
        ];
        (0..count).map(|i| STEP.map(|step| (0.5 + f64::from(i) * step).fract()))
    }

    /// Returns a direction of the upper hemisphere from two random numbers.
    fn upper(u: f64, turn: f64) -> DVec3 {
        warp::direction(u, turn)
    }

    #[test]
    fn sample_weight_is_lobe_times_cosine_over_density() {
        for roughness in ROUGHNESSES {
            let lobe = Ggx::from_roughness(roughness);
            let mut checked = 0;
            for [a, b, c, d] in quadruples(10_000) {
                let wo = upper(a, b);
                // Compare the sample's weight with lobe, cosine and density
                let check = |name: &str, s: LobeSample, value: f64, pdf: f64| {
                    let found = value * s.wi.z.abs() / pdf;
                    assert!(
                        (found / s.weight - 1.0).abs() < 1e-6,
                        "{name} {roughness} {wo} {}: {found}",
                        s.wi
                    );
                };
                // Check a reflected sample
                if let Some(s) = lobe.sample_reflection(wo, [c, d]) {
                    check(
                        "reflection",
                        s,
                        lobe.reflection(wo, s.wi),
                        // Check refracted samples for all indices
                        lobe.reflection_pdf(wo, s.wi),
                    );
                    checked += 1;
                }
                for eta in INDICES {
                    if let Some(s) = lobe.sample_transmission(wo, eta, [c, d]) {
                        let pdf = lobe.transmission_pdf(wo, s.wi, eta);
                        check("transmission", s, lobe.transmission(wo, s.wi, eta), pdf);
                        checked += 1;
                    }
                }
            }
            assert!(checked > 30_000, "{checked}");
        }
    }

    #[test]
    fn the_sampled_lobe_equals_the_one_evaluated_for_lights() {
        for roughness in ROUGHNESSES {
            let material = MaterialPacket {
                base_color: [[1.0; LANES]; 3],
                metallic: [1.0; LANES],
                roughness: [roughness as f32; LANES],
                ..MaterialPacket::BLACK
            };
            let lobe = Ggx::from_roughness(f64::from(roughness as f32));
            let up = [[0.0; LANES], [0.0; LANES], [1.0; LANES]];
            for [a, b, c, d] in quadruples(10_000) {
                let wo = upper(a, b);
                let Some(sample) = lobe.sample_reflection(wo, [c, d]) else {
                    continue;
                };
                let [wo, wi] = [wo, sample.wi].map(|w| w.as_vec3());
                let lanes = |w: glam::Vec3| w.to_array().map(|axis| [axis; LANES]);
                // Shade in f32 and compare with the f64 lobe
                let shaded = f64::from(direct(&material, &up, &lanes(wo), &lanes(wi))[0][0]);
                let (wo, wi) = (wo.as_dvec3(), wi.as_dvec3());
                let exact = lobe.reflection(wo, wi) * wi.z;
                // f32: h is off by 2^-24 of the vectors, so sin by 2^-23 / |h| beside alpha, and D by four times that
                // over alpha; some twenty operations with roundings of 2^-24 follow. Rounded inputs are unit to 2^-23.
                let unit = f64::from(f32::EPSILON);
                let alpha = (roughness * roughness).min(1.0);
                let bound = unit * (16.0 + 8.0 / (alpha * (wo + wi).length()));
                assert!(
                    (shaded / exact - 1.0).abs() < bound,
                    "{roughness} {wo} {wi}: {shaded}, not {exact}"
                );
            }
        }
    }

    #[test]
    fn anisotropic_samples_have_the_lobe_that_lights_evaluate() {
        let up = [[0.0; LANES], [0.0; LANES], [1.0; LANES]];
        for (roughness, strength) in [(0.1f32, 0.3f32), (0.3, 1.0), (0.6, 0.5), (0.9, 0.8)] {
            let mut material = MaterialPacket {
                effects: crate::scene::EffectSet::NONE.with(crate::scene::Effect::Anisotropy),
                base_color: [[1.0; LANES]; 3],
                metallic: [1.0; LANES],
                roughness: [roughness; LANES],
                ..MaterialPacket::BLACK
            };
            material.extended.anisotropy = [strength; LANES];
            material.extended.anisotropy_direction[0] = [1.0; LANES];
            let lobe = Ggx::anisotropic(material.alphas(0).map(f64::from));
            // The widths are those of KHR_materials_anisotropy
            let across = f64::from(roughness).powi(2);
            let along = across + (1.0 - across) * f64::from(strength).powi(2);
            for [a, b, c, d] in quadruples(10_000) {
                let wo = upper(a, b);
                let Some(sample) = lobe.sample_reflection(wo, [c, d]) else {
                    continue;
                };
                let (wo, wi) = (wo.as_vec3().as_dvec3(), sample.wi.as_vec3().as_dvec3());
                // Evaluate D with unit vectors, and Smith's masking, as the extension writes them
                let h = (wo + wi).normalize();
                let f = DVec3::new(h.x / along, h.y / across, h.z);
                let distribution = 1.0 / (PI * along * across * f.length_squared().powi(2));
                let masking = |w: DVec3| w.z + DVec3::new(along * w.x, across * w.y, w.z).length();
                let expected = distribution / (masking(wo) * masking(wi)) * wi.z;
                let lanes = |w: DVec3| w.to_array().map(|axis| [axis as f32; LANES]);
                let shaded = f64::from(direct(&material, &up, &lanes(wo), &lanes(wi))[0][0]);
                let sampled = sample.weight * lobe.reflection_pdf(wo, wi);
                for found in [shaded, sampled, lobe.reflection(wo, wi) * wi.z] {
                    assert!(
                        (found / expected - 1.0).abs() < 2e-3,
                        "{roughness} {strength} {wo} {wi}: {found}, not {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn microfacet_areas_and_visible_areas_are_normalised() {
        for roughness in ROUGHNESSES {
            let lobe = Ggx::from_roughness(roughness);
            for degrees in [0.0, 30.0, 60.0, 85.0] {
                let wo = at(degrees);
                let (mut surface, mut seen) = (0.0, 0.0);
                over_microfacets(&lobe, 512, |m, dm| {
                    surface += lobe.distribution(m) * m.z * dm;
                    seen += lobe.vndf_pdf(wo, m) * dm;
                });
                assert!((surface - 1.0).abs() < 1e-9, "{roughness}: {surface}");
                assert!((seen - 1.0).abs() < 2e-5, "{roughness} {degrees}: {seen}");
            }
        }
    }

    /// Calls `add` with `cells` by `cells` normals m and the solid angle dm of each.
    ///
    /// With tan² = alpha² x / (1 - x) all cells of a regular grid of x would have equal D cos dm; 1 - x = (1 - y)²
    /// removes the singularity of the far tail at a grazing view.
    fn over_microfacets(lobe: &Ggx, cells: u32, mut add: impl FnMut(DVec3, f64)) {
        let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(cells);
        for i in 0..cells * cells {
            let (y, turn) = (middle(i % cells), TAU * middle(i / cells));
            let tan = lobe.alpha * (y * (2.0 - y)).sqrt() / (1.0 - y);
            let cos = tan.hypot(1.0).recip();
            let m = DVec3::new(tan * cos * turn.cos(), tan * cos * turn.sin(), cos);
            add(
                m,
                2.0 * (1.0 - y) / (f64::from(cells * cells) * lobe.distribution(m) * cos),
            );
        }
    }

    #[test]
    fn sampled_microfacets_have_the_mean_visible_normal() {
        for roughness in ROUGHNESSES {
            let lobe = Ggx::from_roughness(roughness);
            for degrees in [0.0, 50.0, 85.0] {
                let wo = at(degrees);
                let mut exact = DVec3::ZERO;
                over_microfacets(&lobe, 512, |m, dm| exact += lobe.vndf_pdf(wo, m) * dm * m);
                let cells = 512;
                let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(cells);
                // The far tail is where u[1] nears 1: use finer steps there.
                let drawn: DVec3 = (0..cells * cells)
                    .map(|i| {
                        let rest = 1.0 - middle(i / cells);
                        2.0 * rest * lobe.sample_vndf(wo, [middle(i % cells), 1.0 - rest * rest])
                    })
                    .sum();
                let found = drawn / f64::from(cells * cells);
                assert!(
                    (found - exact).length() < 1e-5,
                    "{roughness} {degrees}: {found}, not {exact}"
                );
            }
        }
    }

    #[test]
    fn lobes_are_reciprocal_up_to_squared_indices() {
        for [a, b, c, d] in quadruples(2000) {
            let (wo, wi) = (upper(a, b), upper(c, d));
            for roughness in ROUGHNESSES {
                let lobe = Ggx::from_roughness(roughness);
                let same =
                    |there: f64, back: f64| assert!((there - back).abs() <= 1e-9 * there, "{there} {back}");
                same(lobe.reflection(wo, wi), lobe.reflection(wi, wo));
                for eta in INDICES {
                    // Seen from the other side, above and below are exchanged.
                    let there = lobe.transmission(wo, -wi, eta) / eta;
                    let back = lobe.transmission(wi, -wo, eta.recip()) * eta;
                    same(there, back);
                }
            }
        }
    }

    #[test]
    fn zero_roughness_gives_smooth_surface_directions() {
        let mirror = Ggx::from_roughness(0.0);
        assert!(mirror.is_smooth());
        for (u, degrees) in [([0.0, 0.0], 0.0), ([0.3, 0.99], 40.0), ([0.7, 0.5], 89.9)] {
            let wo = at(degrees);
            let reflected = mirror.sample_reflection(wo, u).unwrap();
            assert_eq!((reflected.m, reflected.weight), (DVec3::Z, 1.0));
            assert_eq!(reflected.wi, DVec3::new(-wo.x, 0.0, wo.z));
            let refracted = mirror.sample_transmission(wo, 1.5, u).unwrap();
            assert_eq!(refracted.weight, 1.0);
            assert!((refracted.wi.x + wo.x / 1.5).abs() < 4.0 * f64::EPSILON);
        }
        assert!(
            mirror
                .sample_transmission(at(60.0), 1.0 / 1.5, [0.5; 2])
                .is_none()
        );
    }

    #[test]
    fn grazing_and_extreme_inputs_stay_finite() {
        let last = 1.0 - 2f64.powi(-32);
        for roughness in [0.0, 1e-4, 0.05, 1.0] {
            let lobe = Ggx::from_roughness(roughness);
            for z in [1e-300, 1e-12, 1e-3, 1.0] {
                let wo = DVec3::new((1.0f64 - z * z).max(0.0).sqrt(), 0.0, z);
                for u in [
                    [0.0, 0.0],
                    [0.5, last],
                    [last, 0.0],
                    [0.0, last],
                    [last, last],
                    [0.25, 0.5],
                ] {
                    let m = lobe.sample_vndf(wo, u);
                    assert!(
                        (m.length() - 1.0).abs() < 4.0 * f64::EPSILON && m.z > 0.0,
                        "{roughness} {z} {u:?}"
                    );
                    // Where the cap's point and the view cancel, a relative error of f64::EPSILON remains over 1 -
                    // u[1].
                    assert!(
                        wo.dot(m) >= -f64::EPSILON * 2f64.powi(32),
                        "{roughness} {z} {u:?}"
                    );
                    // Check the weights of samples of both kinds
                    for s in [
                        lobe.sample_reflection(wo, u),
                        lobe.sample_transmission(wo, 1.5, u),
                    ]
                    .into_iter()
                    .flatten()
                    {
                        assert!((0.0..=1.0).contains(&s.weight) && s.wi.is_finite());
                    }
                }
            }
        }
    }
}
