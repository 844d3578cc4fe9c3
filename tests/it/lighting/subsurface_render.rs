//! Subsurface scattering and translucent thin surfaces in whole renders, compared with closed forms.

use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use crate::support::images::{add, rendered, set_environment, settings};
use crate::support::meshes::{Shading, ball};
use glam::{DAffine3, DVec3};
use whit::accel::{self, AccelOptions, Backend};
use whit::buffer::Buffer;
use whit::mesh::Mesh;
use whit::optics::dielectric;
use whit::optics::subsurface::{Dipole, Scattering, SubsurfacePreset, diffuse_transmittance};
use whit::render::{Category, Monitor, RenderSettings, Rendering, render};
use whit::scene::{
    AreaShape, Camera, Effect, EffectOverrides, Falloff, Geometry, Instance, Light, LightKind, Material,
    MetallicRoughness, Model, Projection, Scene, Translucency,
};
use whit::shape::{Shape, Sphere};

/// Samples a pixel.
const SPP: u32 = 16;
/// Points half a mean free path apart, in square lattices, sum to this of what they stand for.
const SAMPLING: f64 = 0.01;
/// Points spread over large triangles are less even: so much at one place, where most is absorbed.
const SAMPLING_OF_MESHES: f64 = 0.16;
/// And so much over some of them.
const MEAN_OF_MESHES: f64 = 0.02;
/// Relative error of single precision through a dozen operations.
const ROUNDING: f64 = 16.0 / 16_777_216.0;

/// A white surface of glTF's model that reflects nothing as a mirror does.
fn dull() -> Material {
    Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 0.0,
            specular: 0.0,
            ..MetallicRoughness::DEFAULT
        }),
        ..Material::default()
    }
}

fn body(scattering: Scattering) -> Material {
    Material {
        subsurface: Some(scattering),
        ..dull()
    }
}

fn preset(name: &str) -> Scattering {
    SubsurfacePreset::named(name).unwrap().scattering
}

fn scene(objects: Vec<(Geometry, Material, DAffine3)>, lights: Vec<Light>) -> Scene {
    let mut scene = Scene {
        lights,
        ..Scene::default()
    };
    for (geometry, material, place) in objects {
        add(&mut scene, "object", geometry, material, place);
    }
    scene.validate().unwrap();
    scene
}

fn light(kind: LightKind) -> Light {
    Light {
        name: "light".into(),
        intensity: [3.0, 2.0, 1.0],
        kind,
    }
}

fn sun(to_light: DVec3) -> Light {
    light(LightKind::Directional { to_light })
}

/// Looks down the z axis from `height` at a square of edge `edge`.
fn from_above(height: f64, edge: f64) -> Camera {
    Camera {
        world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 0.0, height)),
        projection: Projection::Orthographic {
            y_mag: 0.5 * edge,
            x_mag: None,
        },
        ..Camera::default()
    }
}

fn mean(rendering: &Rendering) -> [f64; 3] {
    let pixels = &rendering.image.pixels;
    [0, 1, 2].map(|c| pixels.iter().map(|pixel| f64::from(pixel[c])).sum::<f64>() / pixels.len() as f64)
}

/// The square [-half, half]² in z = 0, as a shape and as two triangles.
fn squares(half: f64) -> [(Geometry, DAffine3); 2] {
    let corner = |x: f64, y: f64| [(x * half) as f32, (y * half) as f32, 0.0];
    let mesh = Mesh {
        positions: Buffer::from(vec![
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
        ]),
        triangles: Buffer::from(vec![[0, 1, 2], [0, 2, 3]]),
        ..Mesh::default()
    };
    [
        (
            Geometry::Shape(Shape::Quad),
            DAffine3::from_scale(DVec3::splat(half)),
        ),
        (Geometry::Mesh(mesh), DAffine3::IDENTITY),
    ]
}

#[test]
fn wide_slab_reflects_closed_form_diffuse_reflectance() {
    for name in ["skin1", "marble"] {
        let scattering = preset(name);
        let dipole = Dipole::new(&scattering).unwrap();
        // So wide that what is lost over the edges is less than the bound: 20 ways of the farthest light.
        let half = if name == "skin1" { 20.0 } else { 40.0 };
        let whole = dipole.diffuse_reflectance();
        let least = dipole.reflectance_within(0.95 * half);
        let bounds = [[SAMPLING; 2], [SAMPLING_OF_MESHES, MEAN_OF_MESHES]];
        for ((geometry, place), [bound, mean_bound]) in squares(half).into_iter().zip(bounds) {
            let cosine = 0.8;
            let lit = scene(
                vec![(geometry, body(scattering), place)],
                vec![sun(DVec3::new(0.6, 0.0, cosine))],
            );
            let found = rendered(&lit, &from_above(1.0, 2.0), &settings(12, SPP));
            let arriving = dielectric(cosine, 1.0, scattering.eta).transmittance.mean() * cosine;
            let leaving = dielectric(1.0, 1.0, scattering.eta).transmittance.mean();
            let scale = arriving * leaving / (PI * diffuse_transmittance(scattering.eta));
            let stats = found.subsurface.unwrap();
            println!("{name}: {stats:?}");
            for c in 0..3 {
                let of =
                    |reflectance: [f64; 3]| reflectance[c] * scale * f64::from(lit.lights[0].intensity[c]);
                for pixel in &found.image.pixels {
                    let value = f64::from(pixel[c]);
                    assert!(
                        value >= of(least) * (1.0 - bound) && value <= of(whole) * (1.0 + bound),
                        "{name} {c}: {value} not within {} and {}",
                        of(least),
                        of(whole)
                    );
                }
                let value = mean(&found)[c];
                let share = value / of(whole);
                println!("{name} {c}: {share:.5} of the closed form");
                assert!(
                    (share - 1.0).abs() <= mean_bound + (1.0 - least[c] / whole[c]),
                    "{share}"
                );
            }
        }
    }
}

#[test]
fn uniformly_lit_ball_reflects_exitance_within_its_diameter() {
    // Of a sphere, the part within a distance r of one of its points has an area of pi r², as a disk has.
    let radius = 6.0;
    let scattering = preset("wholemilk");
    let within = Dipole::new(&scattering).unwrap().reflectance_within(2.0 * radius);
    let place = DAffine3::from_translation(DVec3::new(1.0, -2.0, -radius)) * DAffine3::from_rotation_x(0.6);
    let sphere = Sphere {
        center: DVec3::ZERO,
        radius,
    };
    let mut ball = scene(
        vec![(Geometry::Shape(Shape::Sphere(sphere)), body(scattering), place)],
        Vec::new(),
    );
    ball.ambient = [0.5, 0.4, 0.3];
    let mut camera = from_above(1.0, 0.5);
    camera.world_from_camera.translation += DVec3::new(1.0, -2.0, 0.0);
    let found = rendered(&ball, &camera, &settings(8, SPP));
    assert_eq!(found.ledger.of(Category::Subsurface).rays, 0);
    let leaving = dielectric(1.0, 1.0, scattering.eta).transmittance.mean();
    for pixel in &found.image.pixels {
        for c in 0..3 {
            let expected = f64::from(ball.ambient[c]) * within[c] * leaving;
            let error = (f64::from(pixel[c]) / expected - 1.0).abs();
            assert!(error <= 3.0 * SAMPLING, "{c}: {} {expected}", pixel[c]);
        }
    }
}

/// A milky ball over a slab of marble, behind a pane and a post, under lights of all kinds.
fn studio() -> (Scene, Camera) {
    let place = |x: f64, y: f64, z: f64, size: f64| {
        DAffine3::from_translation(DVec3::new(x, y, z)) * DAffine3::from_scale(DVec3::splat(size))
    };
    let glass = Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 0.0,
            transmission: 0.9,
            ..MetallicRoughness::DEFAULT
        }),
        ..Material::default()
    };
    let mut scene = scene(
        vec![
            (
                Geometry::Mesh(ball(2, Shading::Smooth)),
                body(preset("skimmilk").scaled(0.2)),
                place(0.0, 0.0, 0.0, 0.8),
            ),
            (
                Geometry::Shape(Shape::Quad),
                body(preset("marble").scaled(0.1)),
                place(0.0, 0.0, -1.0, 2.0),
            ),
            (Geometry::Shape(Shape::Disk), glass, place(1.0, 0.0, 1.5, 0.5)),
            (Geometry::Shape(Shape::Cube), dull(), place(-1.0, 1.0, 1.0, 0.2)),
        ],
        vec![
            sun(DVec3::new(0.6, 0.0, 0.8)),
            light(LightKind::Point {
                position: DVec3::new(-2.0, 2.0, 2.0),
                falloff: Falloff::PHYSICAL,
            }),
            light(LightKind::Area {
                shape: AreaShape::Sphere {
                    center: DVec3::new(0.0, -2.0, 2.0),
                    radius: 0.3,
                },
                samples: 2,
            }),
        ],
    );
    let texels: Vec<[f32; 4]> = (0..8).map(|i| [0.1 * i as f32, 0.3, 0.5, 1.0]).collect();
    set_environment(&mut scene, [4, 2], texels, 2);
    (scene, from_above(4.0, 3.0))
}

#[test]
fn image_bits_are_equal_for_one_and_seven_threads() {
    let (scene, camera) = studio();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let found = pool.install(|| rendered(&scene, &camera, &settings(40, SPP)));
        assert!(found.ledger.of(Category::Subsurface).rays > 1000);
        assert_eq!(found.subsurface.unwrap().bodies, 2);
        let values = found.image.pixels.as_flattened().iter();
        values.map(|value| value.to_bits()).collect::<Vec<u32>>()
    };
    let one = with(1);
    assert!(one == with(2) && one == with(7));
}

#[test]
fn subsurface_shadow_rays_are_counted() {
    let (scene, camera) = studio();
    let found = rendered(&scene, &camera, &settings(16, SPP));
    let stats = found.subsurface.unwrap();
    // Four lights, two of them sampled twice, and the points of the ball that face none of them.
    let rays = found.ledger.of(Category::Subsurface).rays;
    assert!(
        rays >= stats.samples as u64 && rays <= 2 * 6 * stats.samples as u64,
        "{rays} {stats:?}"
    );
    assert!(stats.bytes > 24 * stats.samples as u64 && stats.coarseness == 1.0);
    let off = RenderSettings {
        effects: "-subsurface".parse().unwrap(),
        ..settings(16, SPP)
    };
    let paint = rendered(&scene, &camera, &off);
    assert_eq!(
        (paint.subsurface, paint.ledger.of(Category::Subsurface).rays),
        (None, 0)
    );
    assert!(paint.image != found.image);
}

#[test]
fn occluders_shadow_subsurface_samples() {
    let scattering = preset("marble");
    let slab = || squares(3.0)[0].clone();
    let of = |with_lid: bool| {
        let mut objects = vec![(slab().0, body(scattering), slab().1)];
        if with_lid {
            let lid = DAffine3::from_translation(DVec3::new(0.0, 0.0, 2.0))
                * DAffine3::from_scale(DVec3::splat(4.0));
            objects.push((Geometry::Shape(Shape::Quad), dull(), lid));
        }
        let lit = scene(objects, vec![sun(DVec3::Z)]);
        mean(&rendered(&lit, &from_above(1.0, 1.0), &settings(4, SPP)))
    };
    assert!(of(false).iter().all(|value| *value > 0.1));
    assert_eq!(of(true), [0.0; 3]);
}

#[test]
fn mirrored_mesh_receives_subsurface_light_on_its_outside() {
    let of = |size: DVec3| {
        let lit = scene(
            vec![(
                Geometry::Mesh(ball(3, Shading::Smooth)),
                body(preset("wholemilk")),
                DAffine3::from_scale(size),
            )],
            vec![sun(DVec3::Z)],
        );
        mean(&rendered(&lit, &from_above(8.0, 2.0), &settings(4, SPP)))
    };
    let (plain, mirrored) = (of(DVec3::splat(4.0)), of(DVec3::new(4.0, -4.0, 4.0)));
    for c in 0..3 {
        assert!(
            plain[c] > 0.1 && (mirrored[c] / plain[c] - 1.0).abs() <= SAMPLING,
            "{plain:?} {mirrored:?}"
        );
    }
}

#[test]
fn excessive_subsurface_sample_counts_are_limited_and_reported() {
    let fine = body(preset("spectralon").scaled(0.001));
    let (geometry, place) = squares(1.0)[0].clone();
    let mut lit = scene(vec![(geometry, fine, place)], Vec::new());
    lit.ambient = [1.0; 3];
    let found = rendered(&lit, &from_above(1.0, 0.1), &settings(2, SPP));
    let stats = found.subsurface.unwrap();
    assert!(stats.samples <= 1 << 21 && stats.coarseness > 10.0, "{stats:?}");
    // White as it is, it sends back all but what it reflects.
    let leaving = dielectric(1.0, 1.0, 1.3).transmittance.mean();
    for value in found.image.pixels.as_flattened() {
        assert!(
            (f64::from(*value) / leaving - 1.0).abs() <= SAMPLING,
            "{value} {leaving}"
        );
    }
}

#[test]
fn cancelled_subsurface_render_returns_early() {
    let (scene, camera) = studio();
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    let monitor = Monitor {
        progress: &|_| panic!("nothing is finished"),
        cancel: &AtomicBool::new(true),
        tiles: None,
    };
    assert!(
        render(
            scene.validate().unwrap(),
            &camera,
            &*accel,
            &settings(16, SPP),
            &monitor
        )
        .is_err()
    );
}

const THIN_SURFACE: Translucency = Translucency {
    factor: 0.4,
    color: [0.9, 0.5, 0.2],
};

/// A thin surface of base colour 0.8 seen from above, with a light at `height` over or under its middle.
fn thin_surface(height: f64) -> Scene {
    let leaf = Material {
        base_color: [0.8, 0.8, 0.8, 1.0],
        translucency: Some(THIN_SURFACE),
        ..dull()
    };
    let point_light = light(LightKind::Point {
        position: DVec3::new(0.0, 0.0, height),
        falloff: Falloff::PHYSICAL,
    });
    scene(
        vec![(Geometry::Shape(Shape::Quad), leaf, DAffine3::IDENTITY)],
        vec![point_light],
    )
}

/// Returns the radiance of the middle of the scene, also with shadow rays that nothing can block.
fn middle(scene: &Scene) -> [f64; 3] {
    let camera = from_above(1.0, 1e-6);
    let all = RenderSettings {
        effects: EffectOverrides::ALL,
        ..settings(1, SPP)
    };
    let planned = rendered(scene, &camera, &settings(1, SPP));
    assert!(planned.image == rendered(scene, &camera, &all).image);
    mean(&planned)
}

#[test]
fn leaf_shows_translucency_backlit_and_reflectance_frontlit() {
    let (front, back) = (middle(&thin_surface(2.0)), middle(&thin_surface(-2.0)));
    for c in 0..3 {
        let irradiance = [3.0, 2.0, 1.0][c] / 4.0;
        let through = f64::from(THIN_SURFACE.factor) * f64::from(THIN_SURFACE.color[c]);
        let reflected = (1.0 - f64::from(THIN_SURFACE.factor)) * f64::from(0.8f32);
        assert!(
            (back[c] / (through * irradiance / PI) - 1.0).abs() <= ROUNDING,
            "{back:?}"
        );
        assert!(
            (front[c] / (reflected * irradiance / PI) - 1.0).abs() <= ROUNDING,
            "{front:?}"
        );
        assert!(through + reflected <= 1.0);
    }
}

#[test]
fn uniformly_lit_leaf_conserves_energy() {
    let mut leaf = thin_surface(2.0);
    leaf.lights.clear();
    leaf.ambient = [1.0; 3];
    leaf.materials[0].base_color = [1.0; 4];
    leaf.materials[0].translucency = Some(Translucency {
        factor: 0.7,
        color: [1.0, 0.5, 0.0],
    });
    let found = middle(&leaf);
    // 0.3 + 0.7 times the colour.
    for (value, expected) in found.iter().zip([1.0, 0.65, 0.3]) {
        assert!((value - expected).abs() <= ROUNDING, "{found:?}");
    }
}

#[test]
fn leaf_is_shadowed_from_behind_and_by_itself() {
    let lid = |z: f64| DAffine3::from_translation(DVec3::new(0.0, 0.0, z));
    let mut shaded = thin_surface(-2.0);
    shaded.geometries.push(Geometry::Shape(Shape::Disk));
    shaded.materials.push(dull());
    shaded
        .instances
        .push(Instance::new("lid", 1, 1, lid(-1.0)).unwrap());
    assert_eq!(middle(&shaded), [0.0; 3]);
    // Its far half is between its top and a light below.
    let mut ball = thin_surface(-4.0);
    ball.geometries[0] = Geometry::Shape(Shape::Sphere(Sphere::UNIT));
    ball.instances[0] = Instance::new("ball", 0, 0, lid(-1.5)).unwrap();
    assert_eq!(middle(&ball), [0.0; 3]);
    let bare = RenderSettings {
        effects: "-shadow".parse::<EffectOverrides>().unwrap(),
        ..settings(1, SPP)
    };
    assert!(mean(&rendered(&ball, &from_above(1.0, 1e-6), &bare))[0] > 0.0);
}

#[test]
fn plan_names_materials_with_translucency_and_subsurface() {
    let (mut scene, camera) = studio();
    scene.materials[3].translucency = Some(THIN_SURFACE);
    scene.materials[3].name = "leaf".into();
    scene.materials[0].name = "milk".into();
    let plan = rendered(&scene, &camera, &settings(1, SPP)).plan;
    let reason = |effect: Effect| {
        let decision = plan.decisions.iter().find(|decision| decision.effect == effect);
        decision.unwrap().reason.clone()
    };
    assert_eq!(
        reason(Effect::Subsurface),
        "material `milk` has subsurface scattering, and 1 more of 4"
    );
    assert_eq!(
        reason(Effect::Translucency),
        "material `leaf` transmits 0.4 of its diffuse light"
    );
}
