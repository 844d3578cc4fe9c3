//! Rough surfaces in whole renders: what they reflect and let through against quadrature, and their limits.
//!
//! Estimates are compared in standard errors, estimated from the spread of the pixels: their samples are independent.
//! The quadrature has formulas of its own and goes over microfacets evenly.

use std::f64::consts::{FRAC_PI_2, TAU};

use crate::support::images::{self, add, estimate, rendered, set_environment};
use glam::{DAffine3, DMat3, DVec3};
use whit::optics::{Absorption, Cauchy, Dispersion};
use whit::render::{Category, Plan, RenderSettings};
use whit::scene::{
    AreaShape, Background, Camera, Effect, EffectOverrides, Geometry, Light, LightKind, Material, Medium,
    MediumKind, MetallicRoughness, Model, Projection, Scene,
};
use whit::shape::{Shape, Sphere};

/// Standard errors that an estimate may be off.
const ERRORS: f64 = 3.0;
/// Relative error of single precision through some dozen operations.
const ROUNDING: f64 = 64.0 / 16_777_216.0;
const IOR: f64 = 1.5;

pub(super) fn metal(color: f32, roughness: f32, rough_rays: u32) -> Material {
    Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 1.0,
            roughness,
            rough_rays,
            ..MetallicRoughness::DEFAULT
        }),
        base_color: [color, color, color, 1.0],
        ..Material::default()
    }
}

pub(super) fn glass(roughness: f32, rough_rays: u32, kind: MediumKind) -> Material {
    Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 0.0,
            roughness,
            rough_rays,
            transmission: 1.0,
            ..MetallicRoughness::DEFAULT
        }),
        interior: Some(Medium {
            ior: Dispersion::Constant(IOR),
            absorption: Absorption::NONE,
            priority: 0,
            kind,
        }),
        ..Material::default()
    }
}

fn scene(objects: Vec<(Shape, Material, DAffine3)>) -> Scene {
    let mut scene = Scene {
        background: Background::Uniform([1.0; 3]),
        ..Scene::default()
    };
    for (shape, material, place) in objects {
        add(&mut scene, "object", Geometry::Shape(shape), material, place);
    }
    scene
}

/// A plane z = 0 of this material under white surroundings.
pub(super) fn furnace(material: Material) -> Scene {
    scene(vec![(Shape::Plane, material, DAffine3::IDENTITY)])
}

/// Unit vector this many degrees off +z, to the side of +x.
fn at(degrees: f64) -> DVec3 {
    let (sin, cos) = degrees.to_radians().sin_cos();
    DVec3::new(sin, 0.0, cos)
}

/// Sees about one point, the origin, from where `wo` points.
pub(super) fn close_look(wo: DVec3) -> Camera {
    let (x, y) = wo.any_orthonormal_pair();
    Camera {
        world_from_camera: DAffine3::from_mat3_translation(DMat3::from_cols(x, y, wo), 2.0 * wo),
        projection: Projection::Orthographic {
            y_mag: 1e-6,
            x_mag: None,
        },
        ..Camera::default()
    }
}

pub(super) fn settings(size: u32, spp: u32) -> RenderSettings {
    RenderSettings {
        // So that nothing is lost on purpose.
        weight_cutoff: 0.0,
        ..images::settings(size, spp)
    }
}

/// Settings for single scattering between microfacets and glTF's weight of the diffuse light.
fn single_scattering(size: u32, spp: u32) -> RenderSettings {
    RenderSettings {
        effects: "-energy-conservation".parse().unwrap(),
        ..settings(size, spp)
    }
}

/// Asserts that single scattering shows `exact`.
fn assert_is_near(what: &str, scene: &Scene, wo: DVec3, exact: f64) {
    assert_shows(what, scene, wo, exact, &single_scattering(16, 16));
}

fn assert_shows(what: &str, scene: &Scene, wo: DVec3, exact: f64, settings: &RenderSettings) {
    let image = rendered(scene, &close_look(wo), settings).image;
    let (found, error) = estimate(&image);
    println!(
        "{what}: {found:.6} ± {error:.6}, exactly {exact:.6}, {:+.1} errors",
        (found - exact) / error
    );
    assert!(
        (found - exact).abs() <= ERRORS * error + ROUNDING * exact,
        "{what}: {found} ± {error}, not {exact}"
    );
    assert!(error < 5e-3, "{what}: {error}");
}

/// Smith's share of the microfacets that are visible from `w`.
fn visible(alpha: f64, w: DVec3) -> f64 {
    let tan = w.x.hypot(w.y) / w.z.abs();
    2.0 / (1.0 + (1.0 + (alpha * tan).powi(2)).sqrt())
}

/// The mean of `value` over the microfacets that are seen from `wo`, with the density D(m) G1(o) (o·m) / (n·o).
///
/// With tan² = alpha² x / (1 - x) an even grid of x has the same D cos dm everywhere; 1 - x = (1 - y)² thins out the
/// tail.
fn over_microfacets(alpha: f64, wo: DVec3, value: impl Fn(DVec3) -> f64) -> f64 {
    let cells = 1000;
    let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(cells);
    let mut sum = 0.0;
    for row in 0..cells {
        let y = middle(row);
        let tan = alpha * (y * (2.0 - y)).sqrt() / (1.0 - y);
        let cos = tan.hypot(1.0).recip();
        for column in 0..cells {
            let (sin_turn, cos_turn) = (TAU * middle(column)).sin_cos();
            let m = DVec3::new(tan * cos * cos_turn, tan * cos * sin_turn, cos);
            let facing = wo.dot(m);
            if facing > 0.0 {
                sum += value(m) * facing / cos * 2.0 * (1.0 - y);
            }
        }
    }
    sum * visible(alpha, wo) / wo.z / f64::from(cells * cells)
}

/// Returns the part of the background `radiance` reflected by microfacets that reflect `fresnel` by the cosine.
fn reflected(alpha: f64, wo: DVec3, fresnel: impl Fn(f64) -> f64, radiance: impl Fn(DVec3) -> f64) -> f64 {
    over_microfacets(alpha, wo, |m| {
        let wi = 2.0 * wo.dot(m) * m - wo;
        if wi.z > 0.0 {
            fresnel(wo.dot(m)) * visible(alpha, wi) * radiance(wi)
        } else {
            0.0
        }
    })
}

/// Reflectance of a boundary to a medium of relative index `eta`, and the cosine behind it.
fn fresnel(cos_i: f64, eta: f64) -> (f64, f64) {
    let squared = 1.0 - (1.0 - cos_i * cos_i) / (eta * eta);
    if squared <= 0.0 {
        return (1.0, 0.0);
    }
    let cos_t = squared.sqrt();
    let across = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    let along = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    (0.5 * (across * across + along * along), cos_t)
}

/// Returns the radiance from a rough boundary to a medium of relative index `eta`, with a white background on both sides.
fn divided(alpha: f64, wo: DVec3, eta: f64) -> f64 {
    over_microfacets(alpha, wo, |m| {
        let cos_i = wo.dot(m);
        let (r, cos_t) = fresnel(cos_i, eta);
        let mirrored = 2.0 * cos_i * m - wo;
        let bent = -wo / eta + (cos_i / eta - cos_t) * m;
        let mut sum = 0.0;
        if mirrored.z > 0.0 {
            sum += r * visible(alpha, mirrored);
        }
        if r < 1.0 && bent.z < 0.0 {
            sum += (1.0 - r) * visible(alpha, bent);
        }
        sum
    })
}

/// The roughness as materials hold it, squared.
fn alpha(roughness: f32) -> f64 {
    f64::from(roughness).powi(2)
}

#[test]
fn rough_white_metal_in_white_furnace_has_lobe_albedo() {
    // Of narrower lobes so little misses that no sample shows it, and the pixels have no spread.
    for (rays, roughness) in [(4, 0.2), (1, 0.4), (3, 0.7), (4, 1.0)] {
        for degrees in [0.0, 40.0, 75.0] {
            let wo = at(degrees);
            let exact = reflected(alpha(roughness), wo, |_| 1.0, |_| 1.0);
            let what = format!("{rays} rays, roughness {roughness}, {degrees}°");
            assert_is_near(&what, &furnace(metal(1.0, roughness, rays)), wo, exact);
        }
    }
}

#[test]
fn white_metal_and_paint_in_white_furnace_reflect_all_light_with_multiple_scattering() {
    // Error of the fits of the lobe's albedo: of E, which is that of the metal, and of B
    const FIT: f64 = 1.2e-3;
    let paint = |roughness: f32, rays: u32| Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 0.0,
            roughness,
            rough_rays: rays,
            ..MetallicRoughness::DEFAULT
        }),
        ..Material::default()
    };
    for (rays, roughness) in [(4, 0.2), (1, 0.4), (3, 0.7), (4, 1.0)] {
        for degrees in [0.0, 40.0, 75.0] {
            let white = furnace(metal(1.0, roughness, rays));
            // The ambient term gives the diffuse part of paint, rays the lobe.
            let mut ambient = furnace(paint(roughness, rays));
            ambient.ambient = [1.0; 3];
            for (what, scene) in [("metal", white), ("paint", ambient)] {
                let image = rendered(&scene, &close_look(at(degrees)), &settings(16, 16)).image;
                let (found, error) = estimate(&image);
                assert!(
                    (found - 1.0).abs() <= ERRORS * error + FIT && error < 5e-3,
                    "{what}, {rays} rays, roughness {roughness}, {degrees}°: {found} ± {error}"
                );
            }
        }
    }
}

#[test]
fn rough_glass_in_white_furnace_matches_lobe_transmittance() {
    for (rays, roughness) in [(4, 0.2), (1, 0.4), (2, 0.8)] {
        for degrees in [10.0, 50.0, 75.0] {
            let wo = at(degrees);
            let scene = furnace(glass(roughness, rays, MediumKind::Solid));
            let what = format!("{rays} rays, roughness {roughness}, {degrees}°");
            let outside = divided(alpha(roughness), wo, IOR);
            assert_is_near(&format!("{what} from outside"), &scene, wo, outside);
            // From 41.8° on most of it is reflected whole.
            let within = divided(alpha(roughness), wo, IOR.recip());
            assert_is_near(&format!("{what} from within"), &scene, wo.with_z(-wo.z), within);
        }
    }
}

#[test]
fn frosted_wall_loses_as_much_as_white_metal() {
    for roughness in [0.2, 0.6] {
        let wo = at(30.0);
        let exact = reflected(alpha(roughness), wo, |_| 1.0, |_| 1.0);
        let scene = furnace(glass(roughness, 2, MediumKind::ThinSlab));
        assert_is_near(&format!("wall of roughness {roughness}"), &scene, wo, exact);
    }
}

#[test]
fn rough_metal_reflects_mean_sky_over_its_lobe() {
    let (f0, horizon, up, down) = (0.5, 0.25, 1.5, 0.75);
    let sky = |wi: DVec3| horizon + (if wi.y < 0.0 { down } else { up } - horizon) * wi.y.abs();
    let schlick = |cos: f64| f0 + (1.0 - f0) * (1.0 - cos).powi(5);
    for (rays, roughness) in [(1, 0.3), (4, 0.6)] {
        let wo = DVec3::new(0.3, -0.5, 0.6).normalize();
        let mut scene = furnace(metal(f0 as f32, roughness, rays));
        scene.background = Background::Gradient {
            horizon: [horizon as f32; 3],
            up: [up as f32; 3],
            down: [down as f32; 3],
        };
        let exact = reflected(alpha(roughness), wo, schlick, sky);
        assert_is_near(&format!("roughness {roughness}"), &scene, wo, exact);
    }
}

#[test]
fn ambient_environment_and_emission_count_once() {
    let (wo, roughness, color) = (at(50.0), 0.4f32, 0.5);
    let schlick = |cos: f64| 0.04 + 0.96 * (1.0 - cos).powi(5);
    let lobe = reflected(alpha(roughness), wo, schlick, |_| 1.0);
    let paint = |rays: u32| Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 0.0,
            roughness,
            rough_rays: rays,
            ..MetallicRoughness::DEFAULT
        }),
        base_color: [color, color, color, 1.0],
        ..Material::default()
    };
    let mut lit = furnace(paint(4));
    lit.ambient = [1.0; 3];
    assert_is_near("ambient light", &lit, wo, f64::from(color) + lobe);

    // Metal has no diffuse part: all that the map gives comes by rays.
    let mut mapped = furnace(metal(1.0, roughness, 2));
    set_environment(&mut mapped, [4, 2], vec![[1.0; 4]; 8], 2);
    let exact = reflected(alpha(roughness), wo, |_| 1.0, |_| 1.0);
    assert_is_near("environment map", &mapped, wo, exact);

    // Rays do not hit point lights, so nothing is added to what shadow rays bring.
    let [with, without] = [4, 0].map(|rays| {
        let mut with_light = furnace(paint(rays));
        with_light.background = Background::default();
        with_light.lights.push(Light {
            name: "lamp".into(),
            intensity: [2.0; 3],
            kind: LightKind::Area {
                shape: AreaShape::Sphere {
                    center: 3.0 * at(-50.0),
                    radius: 1.0,
                },
                samples: 2,
            },
        });
        rendered(&with_light, &close_look(wo), &settings(8, 4))
            .image
            .pixels
    });
    assert!(with == without && with[0] != [0.0; 3]);
}

/// Balls of rough metal and glass and a thin pane on a floor, under a light and a sky.
fn still_life(rays: u32, roughness: f32) -> (Scene, Camera) {
    let ball = |x: f64, material: Material| {
        let sphere = Sphere {
            center: DVec3::new(x, 0.3 * x, 0.8),
            radius: 0.7,
        };
        (Shape::Sphere(sphere), material, DAffine3::IDENTITY)
    };
    let chalk = Material::metallic_roughness([0.7, 0.5, 0.3], 0.0, 0.9);
    let mut prism = glass(roughness, rays, MediumKind::Solid);
    if let Some(inside) = &mut prism.interior {
        inside.ior = Dispersion::Cauchy(Cauchy { a: 1.5, b: 20_000.0 });
    }
    let pane = DAffine3::from_translation(DVec3::new(-0.8, -1.5, 0.6))
        * DAffine3::from_rotation_x(FRAC_PI_2)
        * DAffine3::from_scale(DVec3::splat(0.5));
    let mut scene = scene(vec![
        (Shape::Plane, chalk, DAffine3::IDENTITY),
        ball(-1.6, metal(0.8, roughness, rays)),
        ball(0.0, glass(roughness, rays, MediumKind::Solid)),
        ball(1.6, prism),
        (Shape::Quad, glass(roughness, rays, MediumKind::ThinSlab), pane),
    ]);
    scene.background = Background::Gradient {
        horizon: [0.9, 0.8, 0.6],
        up: [0.1, 0.2, 0.7],
        down: [0.1; 3],
    };
    scene.lights.push(Light {
        name: "lamp".into(),
        intensity: [2.0; 3],
        kind: LightKind::Area {
            shape: AreaShape::Sphere {
                center: DVec3::new(1.0, -2.0, 4.0),
                radius: 0.5,
            },
            samples: 2,
        },
    });
    let axes = DMat3::from_rotation_x(1.1);
    let camera = Camera {
        world_from_camera: DAffine3::from_mat3_translation(axes, DVec3::new(0.0, -6.0, 3.5)),
        projection: Projection::Perspective {
            y_fov: 0.7,
            aspect: None,
        },
        ..close_look(DVec3::Z)
    };
    (scene, camera)
}

fn renders(rays: [u32; 2], roughness: f32, settings: &RenderSettings) -> [Vec<[f32; 3]>; 2] {
    rays.map(|rays| {
        let (scene, camera) = still_life(rays, roughness);
        rendered(&scene, &camera, settings).image.pixels
    })
}

#[test]
fn zero_roughness_image_equals_smooth_image() {
    let [with, without] = renders([5, 0], 0.0, &settings(40, 4));
    assert!(with == without);
}

#[test]
fn image_converges_to_smooth_as_roughness_vanishes() {
    let settings = settings(40, 4);
    let [rough, smooth] = renders([3, 0], 0.002, &settings);
    assert!(rough != smooth);
    let differ = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).any(|c| (a[c] - b[c]).abs() > 2e-3 * (1.0 + b[c]));
    let different = rough.iter().zip(&smooth).filter(|pair| differ(*pair)).count();
    // Where a ray just hits an edge or misses it, a sample is another's.
    println!("{different} of {} pixels differ", rough.len());
    assert!(different * 50 <= rough.len(), "{different} of {}", rough.len());
    let [rough, smooth] = renders([3, 0], 0.3, &settings);
    let different = rough.iter().zip(&smooth).filter(|pair| differ(*pair)).count();
    assert!(different * 5 > rough.len(), "{different}: this test cannot fail");
}

#[test]
fn image_bits_do_not_depend_on_threads_or_sample_callback() {
    let (scene, view) = still_life(3, 0.3);
    for spp in [1, 4, 20] {
        let settings = settings(40, spp);
        let by = |threads: usize, settings: &RenderSettings| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.unwrap()
                .install(|| rendered(&scene, &view, settings).image.pixels)
        };
        let one = by(1, &settings);
        for threads in [2, 7] {
            assert!(one == by(threads, &settings), "{spp} samples, {threads} threads");
        }
        let watched = RenderSettings {
            sample_aovs: true,
            ledger: true,
            cost_aovs: true,
            ..settings
        };
        assert!(one == by(2, &watched), "{spp}");
    }
}

#[test]
fn materials_send_as_many_rough_rays_as_requested() {
    // Two planes of metal that face each other.
    let facing = |rays: u32| {
        scene(vec![
            (Shape::Plane, metal(1.0, 0.15, rays), DAffine3::IDENTITY),
            (
                Shape::Plane,
                metal(1.0, 0.15, rays),
                DAffine3::from_translation(4.0 * DVec3::Z),
            ),
        ])
    };
    let settings = RenderSettings {
        depth: 3,
        ..settings(16, 4)
    };
    let none = rendered(&facing(0), &close_look(at(20.0)), &settings);
    assert!(!none.plan.effects().has_lobes());
    assert_eq!(none.ledger.rough_rays(), 0);
    let requested = rendered(&facing(8), &close_look(at(20.0)), &settings);
    assert!(requested.plan.effects().has(Effect::RoughReflection));
    assert!(!requested.plan.effects().has(Effect::RoughRefraction));
    // Eight a camera ray, and each of these sends one at either of the other two bounces.
    let rays = requested.ledger.of(Category::RoughReflection).rays as f64 / f64::from(16 * 16 * 4);
    // But for those that would go into the surface, of which this roughness makes one in some hundred.
    assert!((23.7..=24.0).contains(&rays), "{rays} a camera ray");
    assert_eq!(requested.ledger.reflection_rays(), 0);

    let (scene, camera) = still_life(4, 0.3);
    let reasons = Plan::new(&scene, &camera, &EffectOverrides::default()).to_string();
    assert!(
        reasons.contains("rough-reflection on: material `default` has roughness 0.3 and sends 4 rays"),
        "{reasons}"
    );
    let off: EffectOverrides = "-rough-reflection,-rough-refraction".parse().unwrap();
    let off = RenderSettings {
        effects: off,
        ..settings
    };
    let without = rendered(&scene, &camera, &off);
    assert_eq!(without.ledger.rough_rays(), 0);
    let (plain, camera) = still_life(0, 0.3);
    assert!(without.image.pixels == rendered(&plain, &camera, &settings).image.pixels);
}

#[test]
fn weight_cutoff_applies_to_all_lobe_rays_together() {
    // 4 % over 64 rays are 1/1600 a ray, under the usual cut-off of 1/512.
    let paint = Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 0.0,
            roughness: 0.3,
            rough_rays: 64,
            ..MetallicRoughness::DEFAULT
        }),
        ..Material::default()
    };
    let settings = RenderSettings {
        weight_cutoff: RenderSettings::default().weight_cutoff,
        ..settings(4, 1)
    };
    let found = rendered(&furnace(paint), &close_look(DVec3::Z), &settings);
    let rays = found.ledger.of(Category::RoughReflection).rays;
    assert!(rays * 100 > 99 * 64 * 16, "{rays}");
    assert!((0.039..0.041).contains(&estimate(&found.image).0));
}
