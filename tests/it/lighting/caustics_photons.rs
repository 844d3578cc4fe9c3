//! Photons of caustics against rays from diffuse surfaces, their bits, and the surfaces and colours that they reach.

use std::f64::consts::FRAC_1_PI;

use glam::{DAffine3, DMat3, DVec3};
use whit::accel::{AccelOptions, Backend};
use whit::optics::{Dispersion, Sellmeier};
use whit::render::{Category, RenderSettings};
use whit::scene::{Background, Camera, Geometry, Interreflection, MediumKind, Scene};
use whit::shape::{HalfSpace, Polyhedron, Shape, Sphere};

use super::caustics::{lambertian, look_down, look_down_on, point_light, slab, sun, with_caustics};
use super::rough_render::{glass, metal, settings};
use crate::support::images::{add, estimate, rendered, rendered_by};
use crate::support::optical_bench::ideal;

#[test]
fn photons_bring_the_light_that_rays_from_diffuse_surfaces_find_in_mirrors() {
    // An emissive ball before a mirror and a mirroring ball
    let lit = |has_caustics: bool, is_sampled: bool| {
        let mut scene = with_caustics(1 << 17);
        scene.interreflection = Some(Interreflection { bounces: 16 });
        if !has_caustics {
            scene.caustics = None;
        }
        let place = DAffine3::from_mat3_translation(
            DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X) * 0.6,
            DVec3::new(1.0, 0.0, 0.6),
        );
        add(
            &mut scene,
            "mirror",
            Geometry::Shape(Shape::Quad),
            metal(0.9, 0.0, 0),
            place,
        );
        let ball = |center: DVec3, radius: f64| Geometry::Shape(Shape::Sphere(Sphere { center, radius }));
        let mirror = ball(DVec3::new(-0.6, 0.3, 0.4), 0.35);
        add(&mut scene, "ball", mirror, metal(0.8, 0.0, 0), DAffine3::IDENTITY);
        let mut lamp = lambertian(0.0);
        lamp.emission = [20.0; 3];
        let lamp = add(
            &mut scene,
            "lamp",
            ball(DVec3::new(0.1, -0.2, 0.9), 0.2),
            lamp,
            DAffine3::IDENTITY,
        );
        if is_sampled {
            scene.add_emissive_light(lamp, 1).unwrap();
        }
        scene
    };
    let camera = look_down_on(0.2, 0.0, 0.7);
    let mean = |scene: &Scene| {
        let means: Vec<f64> = (0..8)
            .map(|seed| {
                let settings = RenderSettings {
                    seed,
                    ..settings(24, 64)
                };
                estimate(&rendered(scene, &camera, &settings).image).0
            })
            .collect();
        let mean = means.iter().sum::<f64>() / 8.0;
        let variance = means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / 7.0;
        (mean, (variance / 8.0).sqrt())
    };
    let [photons, rays, unsampled] =
        [lit(true, true), lit(false, true), lit(false, false)].map(|scene| mean(&scene));
    println!("photons {photons:?}, rays {rays:?}, without light samples {unsampled:?}");
    // Discs blur light over edges of the image, by much less than this part
    let bound = 4.0 * photons.1.hypot(rays.1) + 0.003 * rays.0;
    assert!(
        (photons.0 - rays.0).abs() <= bound,
        "{photons:?}, not {rays:?} ± {bound}"
    );
    let bound = 4.0 * unsampled.1.hypot(rays.1);
    assert!(
        (unsampled.0 - rays.0).abs() <= bound,
        "{unsampled:?}, not {rays:?} ± {bound}"
    );
}

#[test]
fn same_bits_for_all_threads_and_scaled_bits_for_scaled_light() {
    let mut scene = with_caustics(1 << 13);
    let (cube, place) = slab();
    add(&mut scene, "slab", cube, glass(0.0, 0, MediumKind::Solid), place);
    scene.lights.push(point_light(DVec3::new(0.3, -0.4, 1.5), 3.0));
    let camera = look_down_on(0.0, 0.0, 1.2);
    let pixels = |scene: &Scene, backend: Backend, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let options = AccelOptions::default();
        let settings = settings(64, 2);
        pool.install(|| {
            rendered_by(scene, &camera, (backend, &options), &settings)
                .image
                .pixels
        })
    };
    let one = pixels(&scene, Backend::Bsp, 1);
    assert!(one.iter().any(|pixel| pixel[0] > 0.0));
    for threads in [2, 7] {
        assert!(one == pixels(&scene, Backend::Bsp, threads), "{threads} threads");
    }
    assert!(one == pixels(&scene, Backend::Native, 2), "native");
    scene.lights[0].intensity = [3.0 * 32.0; 3];
    for (pixel, scaled) in one.iter().zip(&pixels(&scene, Backend::Bsp, 2)) {
        assert_eq!(pixel.map(|channel| channel * 32.0), *scaled);
    }
}

#[test]
fn no_caustic_leaks_through_a_thin_floor() {
    // A second floor a millionth below the first, seen from below
    let mut scene = with_caustics(1 << 14);
    let below = DAffine3::from_translation(DVec3::NEG_Z * 1e-6);
    add(
        &mut scene,
        "floor below",
        Geometry::Shape(Shape::Plane),
        lambertian(1.0),
        below,
    );
    let ball = Geometry::Shape(Shape::Sphere(Sphere {
        center: DVec3::Z * 1.5,
        radius: 1.0,
    }));
    add(
        &mut scene,
        "ball",
        ball,
        glass(0.0, 0, MediumKind::Solid),
        DAffine3::IDENTITY,
    );
    scene.lights.push(sun(DVec3::Z));
    let from_below = Camera {
        world_from_camera: DAffine3::from_rotation_x(std::f64::consts::PI)
            * DAffine3::from_translation(DVec3::Z * 1.0),
        ..look_down_on(0.0, 0.0, 1.0)
    };
    let dark = rendered(&scene, &from_below, &settings(32, 4)).image;
    assert!(dark.pixels.iter().all(|pixel| *pixel == [0.0; 3]));
    let lit = rendered(&scene, &look_down_on(0.0, 0.0, 0.2), &settings(32, 4)).image;
    assert!(lit.pixels.iter().all(|pixel| pixel[0] > 0.0));
}

#[test]
fn spectrum_of_a_narrow_prism_has_no_gaps_between_its_wavelengths() {
    // A prism 6 mm wide turns light by an amount that varies by 0.1 m on the floor, 2 m below
    let top = DVec3::new(0.5f64.sin(), 0.0, 0.5f64.cos());
    let half_spaces = [
        (DVec3::NEG_Z, 0.0),
        (top, 0.01),
        (DVec3::X, 0.003),
        (DVec3::NEG_X, 0.003),
        (DVec3::Y, 0.02),
        (DVec3::NEG_Y, 0.02),
    ];
    let prism = Polyhedron::from_half_spaces(&half_spaces.map(|(n, h)| HalfSpace { n, h })).unwrap();
    let mut scene = with_caustics(1 << 16);
    add(
        &mut scene,
        "prism",
        Geometry::Shape(Shape::Polyhedron(prism.into())),
        ideal(Dispersion::Sellmeier(Sellmeier::N_SF10), 0.0),
        DAffine3::from_translation(DVec3::Z * 2.0),
    );
    scene.lights.push(sun(DVec3::Z));
    let settings = RenderSettings {
        wavelengths: 4,
        ..settings(128, 1)
    };
    let image = rendered(&scene, &look_down_on(-0.845, 0.0, 0.08), &settings).image;
    // Sum what each column gets in its middle beside the light that comes straight from the sun
    let columns: Vec<f64> = (0..128)
        .map(|x| {
            let middle = (60..68).map(|y| image.pixels[y * 128 + x]);
            let sums = middle.map(|pixel| pixel.iter().map(|&c| f64::from(c)).sum::<f64>());
            sums.sum::<f64>() / 8.0 / FRAC_1_PI - 3.0
        })
        .collect();
    let most = columns.iter().copied().fold(0.0, f64::max);
    let bright: Vec<usize> = (0..128).filter(|&x| columns[x] > 0.1 * most).collect();
    let (first, last) = (bright[0], bright[bright.len() - 1]);
    println!(
        "columns {first} to {last}, {} of them bright, at most {most:.3}",
        bright.len()
    );
    // From red to blue the light moves by 0.06 m, which is 48 columns
    assert!(last - first > 48, "columns {first} to {last}");
    assert_eq!(bright.len(), last - first + 1, "{columns:.3?}");
}

#[test]
fn caustics_are_simulated_only_on_request_and_need_mirrors_and_lights() {
    let mut scene = with_caustics(1 << 12);
    let (cube, place) = slab();
    add(&mut scene, "slab", cube, glass(0.0, 0, MediumKind::Solid), place);
    scene.background = Background::Uniform([0.2; 3]);
    let rays = |scene: &Scene| {
        let rendering = rendered(scene, &look_down(0.0, 0.0), &settings(4, 1));
        rendering.ledger.of(Category::Caustics).rays
    };
    assert_eq!(rays(&scene), 0);
    scene.lights.push(sun(DVec3::Z));
    assert!(rays(&scene) > 1 << 12);
    scene.caustics = None;
    assert_eq!(rays(&scene), 0);
}
