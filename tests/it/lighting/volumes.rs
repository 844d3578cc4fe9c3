//! Volumes and fog through the renderer: laws with a closed form, and what must change no bit.

use crate::support::images;
use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use whit::accel::{self, AccelOptions, Backend};
use whit::render::{RenderSettings, Rendering};
use whit::scene::{
    AlphaMode, Background, Camera, Falloff, Geometry, Image, Instance, Light, LightKind, Material, Model,
    Projection, Scene, Texels,
};
use whit::shape::{Shape, Sphere};
use whit::volume::cloud::Cloud;
use whit::volume::{
    Fog, Grid, GridSamples, SkipEmpty, Thickness, Transfer, TransferNode, Volume, VolumeDescription,
};

/// Extinction of the slabs here.
const SIGMA: f64 = 0.7;

/// A cube [-1, 1]³ of matter that is the same all over, at `place`.
fn slab(sigma: f64, color: f64, step: f64, place: DVec3) -> Volume {
    let node = TransferNode {
        value: 0.0,
        thickness: sigma,
        color: [color; 3],
        emission: [0.0; 3],
    };
    Volume::new(VolumeDescription {
        density: Arc::new(Grid::new([1; 3], GridSamples::Bytes(vec![1])).unwrap()),
        color: None,
        transfer: Transfer::new(&[node], Thickness::Extinction).unwrap(),
        world_from_cube: DAffine3::from_translation(place),
        step: Some(step),
    })
    .unwrap()
}

/// Smoke in the cube [-1, 1]³, most of it empty.
fn smoke() -> Volume {
    let node = |value: f64, thickness: f64| TransferNode {
        value,
        thickness,
        color: [0.9, 0.8, 0.7],
        emission: [0.0; 3],
    };
    Volume::new(VolumeDescription {
        density: Arc::new(Cloud::SMOKE.bake([24; 3]).unwrap()),
        color: None,
        transfer: Transfer::new(&[node(0.0, 0.0), node(1.0, 9.0)], Thickness::Extinction).unwrap(),
        world_from_cube: DAffine3::from_rotation_y(0.4),
        step: Some(0.1),
    })
    .unwrap()
}

/// A view down the z axis from 4, so narrow that all its rays are on the axis to 10^-6.
fn on_axis() -> Camera {
    Camera {
        name: "eye".into(),
        world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 0.0, 4.0)),
        projection: Projection::Orthographic {
            x_mag: None,
            y_mag: 1e-6,
        },
        ..Camera::default()
    }
}

fn scene(volumes: Vec<Volume>) -> Scene {
    Scene {
        volumes,
        cameras: vec![on_axis()],
        ..Scene::default()
    }
}

/// Puts a shape of a material of its own into the scene.
fn add(scene: &mut Scene, shape: Shape, material: Material, place: DAffine3) {
    let [geometry, index] = [scene.geometries.len(), scene.materials.len()].map(|n| n as u32);
    scene.geometries.push(Geometry::Shape(shape));
    scene.materials.push(material);
    scene
        .instances
        .push(Instance::new("object", geometry, index, place).unwrap());
}

fn sun(to_light: DVec3) -> Light {
    Light {
        name: "sun".into(),
        intensity: [3.0; 3],
        kind: LightKind::Directional {
            to_light: to_light.normalize(),
        },
    }
}

fn rendered(scene: &Scene, backend: Backend, settings: &RenderSettings) -> Rendering {
    scene.validate().unwrap();
    let accel = accel::build(scene.validate().unwrap(), backend, &AccelOptions::default()).unwrap();
    images::rendered_with(scene, &*accel, settings)
}

/// The red of the one pixel that is seen along the axis.
fn red(scene: &Scene) -> f64 {
    let settings = RenderSettings {
        width: 1,
        height: 1,
        ..RenderSettings::default()
    };
    f64::from(rendered(scene, Backend::Bsp, &settings).image.pixels[0][0])
}

fn bits(rendering: &Rendering) -> Vec<u32> {
    let values = rendering.image.pixels.as_flattened().iter();
    values.map(|value| value.to_bits()).collect()
}

#[track_caller]
fn assert_near(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} {expected}");
}

#[test]
fn slab_absorbs_by_beers_law_at_any_step() {
    for step in [0.3, 0.15, 0.07] {
        let white = Scene {
            background: Background::Uniform([1.0; 3]),
            ..scene(vec![slab(SIGMA, 0.0, step, DVec3::ZERO)])
        };
        assert_near(red(&white), (-2.0 * SIGMA).exp(), 1e-6);
    }
}

#[test]
fn fog_attenuates_by_beers_law_and_hides_the_background() {
    let mut foggy = Scene {
        background: Background::Uniform([1.0; 3]),
        fog: Some(Fog::new(SIGMA, [0.0; 3], [0.0; 3], 0.5).unwrap()),
        ..scene(Vec::new())
    };
    assert_near(red(&foggy), 0.0, 1e-6);
    add(&mut foggy, Shape::Quad, unlit(), DAffine3::IDENTITY);
    assert_near(red(&foggy), (-4.0 * SIGMA).exp(), 1e-6);
}

fn unlit() -> Material {
    Material {
        model: Model::Unlit,
        ..Material::default()
    }
}

#[test]
fn surface_in_a_volume_is_attenuated_by_the_part_in_front() {
    let mut inside = scene(vec![slab(SIGMA, 0.0, 0.3, DVec3::ZERO)]);
    let place = DAffine3::from_translation(DVec3::new(0.0, 0.0, 0.25));
    add(&mut inside, Shape::Quad, unlit(), place);
    assert_near(red(&inside), (-0.75 * SIGMA).exp(), 1e-6);
}

#[test]
fn overlapping_volumes_add_their_extinctions_in_any_order() {
    let [a, b] = [(0.4, 0.3), (0.9, 0.2)].map(|(sigma, step)| slab(sigma, 0.0, step, DVec3::ZERO));
    let shifted = slab(0.5, 0.0, 0.25, DVec3::new(0.0, 0.0, 1.5));
    for volumes in [[&a, &b, &shifted], [&shifted, &b, &a]] {
        let white = Scene {
            background: Background::Uniform([1.0; 3]),
            ..scene(volumes.map(Volume::clone).to_vec())
        };
        assert_near(red(&white), (-2.0 * (0.4 + 0.9 + 0.5_f64)).exp(), 1e-6);
    }
}

#[test]
fn front_lit_slab_scatters_the_closed_integral() {
    let lit = Scene {
        lights: vec![sun(DVec3::Z)],
        ..scene(vec![slab(SIGMA, 0.5, 0.01, DVec3::ZERO)])
    };
    // c sigma E / 4 pi times the integral of exp(-2 sigma s) over s from 0 to 2; the steps' middles are off by their
    // square.
    let expected = 0.5 * 3.0 / (8.0 * PI) * (1.0 - (-4.0 * SIGMA).exp());
    assert_near(red(&lit), expected, 1e-5);
    // Light from all around, which nothing takes away, is seen as that of an opaque body would be.
    let ambient = Scene {
        ambient: [0.2; 3],
        ..scene(vec![slab(SIGMA, 0.5, 0.3, DVec3::ZERO)])
    };
    assert_near(red(&ambient), 0.5 * 0.2 * (1.0 - (-2.0 * SIGMA).exp()), 1e-6);
}

/// A slab lit by an even environment map of radiance 1.
fn in_white(sigma: f64, color: f64) -> Scene {
    let white = Image {
        name: "white".into(),
        width: 8,
        height: 4,
        texels: Texels::Floats(vec![[1.0; 4]; 32].into()),
    };
    Scene {
        images: vec![white],
        background: Background::Environment {
            image: 0,
            rotation: 0.3,
            scale: 1.0,
            samples: 4,
        },
        ..scene(vec![slab(sigma, color, 0.1, DVec3::ZERO)])
    }
}

/// Mean and standard error of the pixels' red.
fn estimate(scene: &Scene, settings: &RenderSettings) -> (f64, f64) {
    let pixels = rendered(scene, Backend::Bsp, settings).image.pixels;
    let count = pixels.len() as f64;
    let mean = pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / count;
    let squares: f64 = pixels.iter().map(|p| (f64::from(p[0]) - mean).powi(2)).sum();
    (mean, (squares / (count - 1.0) / count).sqrt())
}

#[test]
fn uniform_environment_single_scattering_equals_the_integral() {
    // Behind the slab the map itself; of each step what its matter scatters of all that gets there, which is the mean
    // over all directions of exp(-sigma s), s being the way out of the cube: by the middles of 200 x 400 cells of equal
    // solid angle.
    let (color, step) = (0.5, 0.1);
    let mean_left = |p: DVec3| {
        let (rows, columns) = (200, 400);
        let cell = |i: u32| {
            let z = 2.0 * (f64::from(i / columns) + 0.5) / f64::from(rows) - 1.0;
            let (sin, cos) = (2.0 * PI * (f64::from(i % columns) + 0.5) / f64::from(columns)).sin_cos();
            let d = DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
            let way = ((d.signum() - p) / d).min_element();
            (-SIGMA * way).exp()
        };
        (0..rows * columns).map(cell).sum::<f64>() / f64::from(rows * columns)
    };
    let expected: f64 = (-2.0 * SIGMA).exp()
        + (0..20)
            .map(|i| {
                let before = f64::from(i) * step;
                let scattered = color * (1.0 - (-SIGMA * step).exp());
                (-SIGMA * before).exp() * scattered * mean_left(DVec3::Z * (1.0 - before - 0.5 * step))
            })
            .sum::<f64>();
    let settings = RenderSettings {
        width: 16,
        height: 16,
        spp: 64,
        ..RenderSettings::default()
    };
    let (found, error) = estimate(&in_white(SIGMA, color), &settings);
    println!("{found:.6} ± {error:.6}, by the integral {expected:.6}");
    assert!(
        (found - expected).abs() <= 3.0 * error + 1e-5,
        "{found} ± {error}, not {expected}"
    );
}

#[test]
fn thin_white_medium_vanishes_in_white_environment() {
    // What is scattered away comes from elsewhere, but for what is scattered twice: of sigma 2 s twice that, s being at
    // most the way of 2 through the cube plus 3.5 out of it. Samples of an even map have one radiance and density.
    let sigma = 1e-3;
    let settings = RenderSettings {
        width: 4,
        height: 4,
        spp: 4,
        ..RenderSettings::default()
    };
    for color in [1.0, 0.25] {
        let (found, _) = estimate(&in_white(sigma, color), &settings);
        let left = (-2.0 * sigma).exp();
        let albedo = (found - left) / (1.0 - left);
        println!("albedo {albedo:.5} of {color}");
        assert!(albedo <= color * (1.0 + 1e-4) && albedo >= color * (1.0 - 4.0 * sigma));
    }
    // A black roof over the top half of the sky takes half of it.
    let mut half = in_white(sigma, 1.0);
    // Exactly level, as the view is.
    let level = DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y);
    let roof = DAffine3::from_mat3_translation(level, DVec3::Y * 1.5);
    add(&mut half, Shape::Plane, unlit_black(), roof);
    let settings = RenderSettings { spp: 256, ..settings };
    let (found, error) = estimate(&half, &settings);
    let left = (-2.0 * sigma).exp();
    let (albedo, error) = ((found - left) / (1.0 - left), error / (1.0 - left));
    println!("under a roof {albedo:.4} ± {error:.4}");
    assert!((albedo - 0.5).abs() <= 3.0 * error + 4.0 * sigma);
}

fn unlit_black() -> Material {
    Material {
        base_color: [0.0, 0.0, 0.0, 1.0],
        ..unlit()
    }
}

/// A floor seen along the axis, in light that comes from aside and goes through a volume's diagonal if `volumes` says
/// so.
fn floor(volumes: Vec<Volume>, blended: Option<f32>) -> Scene {
    let mut floor = Scene {
        lights: vec![sun(DVec3::new(1.0, 0.0, 1.0))],
        ..scene(volumes)
    };
    add(&mut floor, Shape::Quad, Material::default(), DAffine3::IDENTITY);
    if let Some(coverage) = blended {
        let material = Material {
            alpha: AlphaMode::Blend,
            base_color: [1.0, 1.0, 1.0, coverage],
            ..Material::default()
        };
        let place =
            DAffine3::from_translation(DVec3::new(1.5, 0.0, 1.5)) * DAffine3::from_scale(DVec3::splat(0.5));
        add(&mut floor, Shape::Quad, material, place);
    }
    floor
}

#[test]
fn shadow_through_a_volume_is_its_transmittance() {
    let volume = || vec![slab(SIGMA, 0.5, 0.3, DVec3::new(3.0, 0.0, 3.0))];
    let clear = red(&floor(Vec::new(), None));
    let left = (-SIGMA * 8f64.sqrt()).exp();
    assert_near(red(&floor(volume(), None)), clear * left, 1e-5);
    assert_near(red(&floor(Vec::new(), Some(0.25))), clear * 0.75, 1e-5);
    assert_near(red(&floor(volume(), Some(0.25))), clear * 0.75 * left, 1e-5);
}

/// Smoke with a ball in it, in fog, before a spotlight.
fn busy() -> Scene {
    let mut busy = Scene {
        ambient: [0.1; 3],
        background: Background::Uniform([0.2, 0.3, 0.5]),
        fog: Some(Fog::new(0.05, [0.9; 3], [0.0; 3], 0.4).unwrap()),
        lights: vec![
            sun(DVec3::new(1.0, 2.0, 0.5)),
            Light {
                name: "spot".into(),
                intensity: [30.0; 3],
                kind: LightKind::Spot {
                    position: DVec3::new(-3.0, 1.0, 0.0),
                    direction: DVec3::X,
                    cos_inner: 0.97,
                    cos_outer: 0.95,
                    falloff: Falloff::PHYSICAL,
                },
            },
        ],
        ..scene(vec![smoke()])
    };
    busy.cameras[0].projection = Projection::Perspective {
        y_fov: 0.9,
        aspect: None,
    };
    let small = DAffine3::from_scale(DVec3::splat(0.3));
    add(&mut busy, Shape::Sphere(Sphere::UNIT), Material::default(), small);
    busy
}

fn small_image() -> RenderSettings {
    RenderSettings {
        width: 24,
        height: 18,
        ..RenderSettings::default()
    }
}

#[test]
fn empty_space_skipping_changes_no_bit() {
    let clear = Scene { fog: None, ..busy() };
    let leaping = rendered(&clear, Backend::Bsp, &small_image());
    let settings = RenderSettings {
        skip_empty: SkipEmpty::Never,
        ..small_image()
    };
    assert!(clear.volumes[0].empty_space().share() > 0.3);
    let everywhere = rendered(&clear, Backend::Bsp, &settings);
    assert!(bits(&leaping) == bits(&everywhere));
    let [taken, all] = [&leaping, &everywhere].map(|rendering| rendering.ledger.volume_samples);
    assert!(0 < taken && 2 * taken < all, "{taken} of {all}");
}

#[test]
fn volume_images_do_not_depend_on_threads_or_backend() {
    let scene = busy();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap()
            .install(|| rendered(&scene, Backend::Bsp, &small_image()))
    };
    let (one, many) = (on(1), on(3));
    assert!(bits(&one) == bits(&many));
    let other = rendered(&scene, Backend::default(), &small_image());
    let pairs = one.image.pixels.iter().zip(&other.image.pixels);
    let differ = |(a, b): &(&[f32; 3], &[f32; 3])| (0..3).any(|c| (a[c] - b[c]).abs() > 1e-4 * (1.0 + a[c]));
    // A silhouette's pixel or two, and samples at the edge of the ball's shadow.
    assert!(pairs.filter(differ).count() <= 4);
}

#[test]
fn ball_casts_a_shadow_into_a_light_beam() {
    let mut beam = scene(vec![slab(0.05, 1.0, 0.05, DVec3::ZERO)]);
    beam.lights = vec![sun(DVec3::X)];
    let lit = rendered(&beam, Backend::Bsp, &small_image());
    // Nothing can hide the light.
    assert_eq!(lit.ledger.shadow_rays(), 0);
    let open = red(&beam);
    assert!(open > 0.0);
    let place = DAffine3::from_translation(DVec3::new(5.0, 0.0, 0.0));
    add(&mut beam, Shape::Sphere(Sphere::UNIT), Material::default(), place);
    let cut = rendered(&beam, Backend::Bsp, &small_image());
    let camera_rays = cut.ledger.camera_rays();
    assert!(
        cut.ledger.shadow_rays() >= 10 * camera_rays,
        "{:?}",
        cut.ledger.shadow_rays()
    );
    // The ball is as wide as the slab is deep: all of the ray lies in its shadow but for the edge.
    assert!(red(&beam) < 0.05 * open, "{open}");
}
