//! Tests of the two lighting models against their formulas in f64, written out as in their sources: glTF 2.0, Appendix
//! B, with KHR_materials_specular and KHR_materials_ior; and the Phong and Whitted model.
//!
//! The renderer's f32 must be within 1e-6 of each value. The bound is wider only where a formula magnifies the rounding
//! of its arguments, by that magnification: light or viewer within a few degrees of the horizon, the peak of a sharp
//! highlight, light from nearly behind the viewer for reflectances that vanish there.

use std::f64::consts::PI;

use crate::numeric::{LANES, Lanes3};
use crate::optics::{Absorption, Dispersion};
use crate::scene::{EffectSet, Material, Medium, MediumKind, MetallicRoughness, Model, Phong};
use crate::shading::{LobeAlbedo, MaterialPacket, direct, phong_direct};
use glam::DVec3;

use crate::numeric::SplitMix64;

/// Largest error accepted, relative to each value.
const BOUND: f64 = 1e-6;
/// Number of packets of sixteen: 10 000 directions and materials.
const PACKETS: u64 = 625;
/// Value below which a sum of products up to 1 has a relative error, three roundings of 2^-24, above [`BOUND`].
const HARMLESS: f64 = 0.2;

/// Sixteen unit vectors, rounded to f32.
struct Directions {
    lanes: Lanes3<f32>,
}

impl Directions {
    fn of(mut make: impl FnMut(usize) -> DVec3) -> Directions {
        let mut lanes = [[0.0; LANES]; 3];
        for l in 0..LANES {
            let v = make(l).to_array();
            (0..3).for_each(|axis| lanes[axis][l] = v[axis] as f32);
        }
        Directions { lanes }
    }

    /// Returns the vector of lane `l`, normalised in f64.
    fn exact(&self, l: usize) -> DVec3 {
        DVec3::from([0, 1, 2].map(|axis| f64::from(self.lanes[axis][l]))).normalize()
    }
}

/// Returns random normals, directions to viewers above them, and directions to lights anywhere.
fn random_directions(random: &mut SplitMix64) -> [Directions; 3] {
    let n = Directions::of(|_| random.direction());
    let v = Directions::of(|l| {
        let v = random.direction();
        if v.dot(n.exact(l)) < 0.0 { -v } else { v }
    });
    let light = Directions::of(|l| {
        let light = random.direction();
        // One light in eight may lie below the horizon.
        if l % 8 != 0 && light.dot(n.exact(l)) < 0.0 {
            -light
        } else {
            light
        }
    });
    [n, v, light]
}

fn packet_of(materials: &[Material]) -> MaterialPacket {
    let mut packet = MaterialPacket::BLACK;
    packet.effects = EffectSet::ALL;
    for (l, material) in materials.iter().enumerate() {
        packet.set(l, material);
    }
    packet
}

/// Parameters of the metallic-roughness model in f64.
struct Gltf {
    color: DVec3,
    metallic: f64,
    roughness: f64,
    specular: f64,
    specular_color: DVec3,
    ior: f64,
}

impl Gltf {
    /// Converts the parameters of a material from f32.
    fn of(material: &Material) -> Gltf {
        let Model::MetallicRoughness(model) = material.model else {
            unreachable!()
        };
        let [r, g, b, _] = material.base_color.map(f64::from);
        Gltf {
            color: DVec3::new(r, g, b),
            metallic: model.metallic.into(),
            roughness: model.roughness.into(),
            specular: model.specular.into(),
            specular_color: DVec3::from(model.specular_color.map(f64::from)),
            ior: material.ior(587.56),
        }
    }

    /// Returns BRDF times cosine, and the error bound of f32: [`BOUND`] of each summand, magnified as the formula does.
    fn reflected(&self, n: DVec3, v: DVec3, l: DVec3) -> (DVec3, DVec3) {
        let h = (v + l).normalize();
        let [n_l, n_v, n_h, v_h] = [n.dot(l), n.dot(v), n.dot(h), v.dot(h)];
        if n_l <= 0.0 {
            return (DVec3::ZERO, DVec3::ZERO);
        }
        let alpha = self.roughness * self.roughness;
        let a2 = alpha * alpha;
        // B.3.2: distribution of Trowbridge and Reitz, and Smith's joint masking and shadowing over 4 |n·l| |n·v|.
        let width = n_h * n_h * (a2 - 1.0) + 1.0;
        let d = if n_h > 0.0 { a2 / (PI * width * width) } else { 0.0 };
        let smith = |cos: f64| cos.abs() + (a2 + (1.0 - a2) * cos * cos).sqrt();
        let visibility = 1.0 / (smith(n_l) * smith(n_v));
        // Specular reflectance by KHR_materials_ior and KHR_materials_specular.
        let head_on = ((self.ior - 1.0) / (self.ior + 1.0)).powi(2);
        let dielectric_f0 = (head_on * self.specular_color).min(DVec3::ONE) * self.specular;
        // B.3.5: blend of dielectric and metal by `metallic`.
        let f0 = dielectric_f0.lerp(self.color, self.metallic);
        let f90 = DVec3::splat(self.specular).lerp(DVec3::ONE, self.metallic);
        let grazing = (f90 - f0) * (1.0 - v_h.abs()).powi(5);
        let f = f0 + grazing;
        let c_diff = self.color.lerp(DVec3::ZERO, self.metallic);
        let diffuse = (DVec3::ONE - f) * c_diff / PI;
        let lobe = d * visibility;

        // The cosine is a sum of products up to 1; so are the components of n x h, which the peak squares twice, and of
        // h itself. Schlick's term takes the fifth power.
        let slant = (HARMLESS / n_l).max(1.0);
        let sharpness = (2.0 * HARMLESS / width.sqrt()).max(HARMLESS / (v + l).length());
        let peak = slant.max(sharpness).max(HARMLESS / smith(n_v));
        let bend = grazing.abs() * (5.0 * HARMLESS / (1.0 - v_h));
        let bound = diffuse * slant + lobe * (f * peak + bend);
        ((diffuse + f * lobe) * n_l, BOUND * n_l * bound)
    }
}

fn gltf_material(random: &mut SplitMix64, specular: bool) -> Material {
    let mut number = || random.unit() as f32;
    let metallic = number();
    let mut material = Material::metallic_roughness(
        [number(), number(), number()],
        // A third each of dielectrics, metals and mixtures.
        (3.0 * metallic - 1.0).clamp(0.0, 1.0),
        0.05 + 0.95 * number(),
    );
    if !specular {
        return material;
    }
    let mut color = [number(); 3];
    if number() < 0.5 {
        // The extension leaves open how a coloured specular layer filters the diffuse one: use no diffuse colour here.
        color = [number(), number(), number()];
        material.base_color = [0.0, 0.0, 0.0, 1.0];
    }
    // Vary roughness, specular strength and specular colour
    material.model = Model::MetallicRoughness(MetallicRoughness {
        metallic: (3.0 * metallic - 1.0).clamp(0.0, 1.0),
        roughness: 0.05 + 0.95 * number(),
        specular: number(),
        specular_color: color.map(|c| 2.0 * c),
        transmission: 0.0,
        rough_rays: 0,
    });
    // Vary the index of refraction
    material.interior = Some(Medium {
        ior: Dispersion::Constant(1.0 + 1.5 * f64::from(number())),
        absorption: Absorption::NONE,
        priority: 0,
        kind: MediumKind::Solid,
    });
    material
}

/// Returns the largest error in units of its bound, and the fraction of values whose bound is at most 1.25 [`BOUND`].
fn compare_gltf(seed: u64, specular: bool) -> (f64, f64) {
    let mut random = SplitMix64::new(seed, 0);
    let (mut worst, mut plain) = (0.0f64, 0);
    for _ in 0..PACKETS {
        let materials: Vec<Material> = (0..LANES).map(|_| gltf_material(&mut random, specular)).collect();
        let [n, v, light] = random_directions(&mut random);
        let found = direct(&packet_of(&materials), &n.lanes, &v.lanes, &light.lanes);
        for l in 0..LANES {
            let numbers = Gltf::of(&materials[l]);
            let (expected, bound) = numbers.reflected(n.exact(l), v.exact(l), light.exact(l));
            plain += usize::from(bound.cmple(1.25 * BOUND * expected).all());
            for channel in 0..3 {
                let found = f64::from(found[channel][l]);
                let off = (found - expected[channel]).abs();
                if expected[channel] == 0.0 {
                    assert_eq!(found, 0.0, "{:?}", materials[l]);
                } else {
                    worst = worst.max(off / bound[channel]);
                }
            }
        }
    }
    (worst, plain as f64 / (PACKETS as usize * LANES) as f64)
}

#[test]
fn metallic_roughness_equals_gltf_appendix_b() {
    let (worst, plain) = compare_gltf(11, false);
    println!("worst {worst} of its bound, {plain} with a plain one");
    assert!(worst <= 1.0 && plain > 0.5);
}

#[test]
fn specular_and_ior_equal_their_gltf_extensions() {
    let (worst, plain) = compare_gltf(12, true);
    println!("worst {worst} of its bound, {plain} with a plain one");
    assert!(worst <= 1.0 && plain > 0.5);
}

#[test]
fn pure_dielectrics_and_metals_are_the_two_brdfs_that_gltf_mixes() {
    let mut random = SplitMix64::new(13, 0);
    for _ in 0..100 {
        let [n, v, light] = random_directions(&mut random);
        for metallic in [0.0, 1.0] {
            let materials: Vec<Material> = (0..LANES)
                .map(|_| {
                    let color = [0; 3].map(|_| random.unit() as f32);
                    Material::metallic_roughness(color, metallic, 0.3 + 0.7 * random.unit() as f32)
                })
                .collect();
            let found = direct(&packet_of(&materials), &n.lanes, &v.lanes, &light.lanes);
            // Compare with a blend of the diffuse and the specular BRDF
            for l in 0..LANES {
                let numbers = Gltf::of(&materials[l]);
                let (n, v, light) = (n.exact(l), v.exact(l), light.exact(l));
                let bound = numbers.reflected(n, v, light).1;
                // Isolate the lobe with a white metal, whose reflectance is 1 at any angle.
                let mirror = Gltf {
                    color: DVec3::ONE,
                    metallic: 1.0,
                    ..numbers
                };
                let lobe = mirror.reflected(n, v, light).0.x;
                let schlick = (1.0 - v.dot((v + light).normalize())).powi(5);
                for channel in 0..3 {
                    let color = numbers.color[channel];
                    let expected = if metallic == 1.0 {
                        lobe * (color + (1.0 - color) * schlick)
                    } else {
                        // mix(diffuse, specular, fresnel)
                        let fresnel = 0.04 + 0.96 * schlick;
                        let diffuse = color / PI * n.dot(light).max(0.0);
                        diffuse + fresnel * (lobe - diffuse)
                    };
                    let off = (f64::from(found[channel][l]) - expected).abs();
                    assert!(off <= bound[channel], "{metallic}: {off} of {expected}");
                }
            }
        }
    }
}

#[test]
fn energy_conserving_lanes_equal_a_scalar_reference() {
    // Rounding of the fits of the lobe's albedo: some 40 operations on terms of up to 65 times their sums.
    const FIT: f64 = 40.0 * 65.0 / 16_777_216.0;
    let mut random = SplitMix64::new(16, 0);
    for _ in 0..100 {
        let [n, v, light] = random_directions(&mut random);
        let materials: Vec<Material> = (0..LANES).map(|_| gltf_material(&mut random, false)).collect();
        let mut packet = packet_of(&materials);
        packet.lobe = LobeAlbedo::of_packet(&packet.roughness, &n.lanes, &v.lanes);
        let found = direct(&packet, &n.lanes, &v.lanes, &light.lanes);
        for l in 0..LANES {
            let numbers = Gltf::of(&materials[l]);
            let (n, v, light) = (n.exact(l), v.exact(l), light.exact(l));
            let bound = numbers.reflected(n, v, light).1;
            // Isolate the lobe with a white metal, whose reflectance is 1 at any angle.
            let mirror = Gltf {
                color: DVec3::ONE,
                metallic: 1.0,
                ..numbers
            };
            let lobe = mirror.reflected(n, v, light).0.x;
            let schlick = (1.0 - v.dot((v + light).normalize())).powi(5);
            let albedo = LobeAlbedo::evaluate(n.dot(v).abs(), numbers.roughness);
            for channel in 0..3 {
                let color = numbers.color[channel];
                let f0 = 0.04 + (color - 0.04) * numbers.metallic;
                let raised = 1.0 + f0 * albedo.loss;
                let fresnel = f0 + (1.0 - f0) * schlick;
                let taken = fresnel.max((f0 * albedo.normal + albedo.grazing) * raised);
                let diffuse = color * (1.0 - numbers.metallic) / PI * n.dot(light).max(0.0);
                let expected = (1.0 - taken) * diffuse + fresnel * lobe * raised;
                let bound = bound[channel] * raised + FIT * (diffuse + fresnel * lobe);
                let off = (f64::from(found[channel][l]) - expected).abs();
                assert!(off <= bound, "{off} of {expected}: {:?}", materials[l]);
            }
        }
    }
}

fn phong_material(random: &mut SplitMix64) -> Material {
    let mut number = || random.unit() as f32;
    Material {
        model: Model::Phong(Phong {
            diffuse: [number(), number(), number()],
            specular: [number(), number(), number()],
            // Half of the highlights are broad.
            exponent: if number() < 0.5 {
                4.0 * number()
            } else {
                200.0 * number()
            },
            ..Phong::DEFAULT
        }),
        base_color: [number(), number(), number(), 1.0],
        ..Material::default()
    }
}

#[test]
fn phong_lighting_matches_its_formula_with_clamps() {
    let mut random = SplitMix64::new(14, 0);
    let mut worst = 0.0f64;
    let mut cases = [0; 3];
    for _ in 0..PACKETS {
        let materials: Vec<Material> = (0..LANES).map(|_| phong_material(&mut random)).collect();
        let [m, v, s] = random_directions(&mut random);
        let found = phong_direct(&packet_of(&materials), &m.lanes, &v.lanes, &s.lanes);
        for l in 0..LANES {
            let Model::Phong(phong) = materials[l].model else {
                unreachable!()
            };
            let (m, v, s) = (m.exact(l), v.exact(l), s.exact(l));
            let r = 2.0 * s.dot(m) * m - s;
            let (s_m, r_v) = (s.dot(m), r.dot(v));
            // Behind the surface expect zero; with the mirrored light behind the viewer expect no highlight.
            let case = if s_m <= 0.0 { 0 } else { 1 + usize::from(r_v > 0.0) };
            cases[case] += 1;
            let f = f64::from(phong.exponent);
            // Compare each channel with the f64 formula
            for channel in 0..3 {
                let found = f64::from(found[channel][l]);
                if case == 0 {
                    assert_eq!(found, 0.0);
                    continue;
                }
                let color = f64::from(materials[l].base_color[channel]);
                let diffuse = f64::from(phong.diffuse[channel]) * color * s_m;
                let highlight = f64::from(phong.specular[channel]) * r_v.max(0.0).powf(f);
                // The power multiplies the relative error of its base by f.
                let bound =
                    diffuse * (HARMLESS / s_m).max(1.0) + highlight * (2.0 * HARMLESS * f / r_v).max(1.0);
                worst = worst.max((found - diffuse - highlight).abs() / (BOUND * bound));
            }
        }
    }
    println!("worst {worst} of its bound; behind, without and with highlight: {cases:?}");
    assert!(
        worst <= 1.0 && cases.iter().all(|count| *count > 500),
        "{worst} {cases:?}"
    );
}

#[test]
fn highlight_never_exceeds_specular_colour() {
    // r·v may round to above 1, which a large exponent would magnify.
    let mut random = SplitMix64::new(15, 0);
    let material = Material {
        model: Model::Phong(Phong {
            diffuse: [0.0; 3],
            specular: [0.5; 3],
            exponent: 1e6,
            ..Phong::DEFAULT
        }),
        ..Material::default()
    };
    let packet = packet_of(&vec![material; LANES]);
    for _ in 0..100 {
        let [m, s, _] = random_directions(&mut random);
        let v = Directions::of(|l| {
            let (m, s) = (m.exact(l), s.exact(l));
            2.0 * s.dot(m) * m - s
        });
        let found = phong_direct(&packet, &m.lanes, &v.lanes, &s.lanes);
        assert!(found[0].iter().all(|value| *value <= 0.5), "{found:?}");
    }
}
