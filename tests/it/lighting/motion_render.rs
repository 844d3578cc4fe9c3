//! Motion blur in whole renders, against what is known in closed form.

use crate::support::images::{render_image, settings};
use glam::{DAffine3, DVec3};
use whit::accel::Backend;
use whit::image::LinearImage;
use whit::optics::{Absorption, Dispersion};
use whit::render::{Plan, RenderSettings};
use whit::scene::{
    Camera, Effect, EffectOverrides, Geometry, Instance, Light, LightKind, Material, Medium, MediumKind,
    MetallicRoughness, Model, Phong, Projection, Scene, Shutter,
};
use whit::shape::{Shape, Sphere};

/// Standard errors that an estimate may be off: of a hundred estimates none is likely to be.
const ERRORS: f64 = 4.0;

fn matte() -> Material {
    Material {
        model: Model::Phong(Phong::DEFAULT),
        ..Material::default()
    }
}

fn emissive() -> Material {
    Material {
        model: Model::Unlit,
        ..Material::default()
    }
}

fn at(x: f64, y: f64, z: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(x, y, z))
}

/// Objects of one material each, from where they begin to where they end.
fn scene(objects: Vec<(Shape, Material, [DAffine3; 2])>) -> Scene {
    let mut scene = Scene::default();
    for (index, (shape, material, ends)) in (0..).zip(objects) {
        scene.geometries.push(Geometry::Shape(shape));
        scene.materials.push(material);
        let instance = Instance::moving(format!("object {index}"), index, index, ends).unwrap();
        scene.instances.push(instance);
    }
    scene
}

fn sun(to_light: DVec3) -> Light {
    Light {
        name: "sun".into(),
        intensity: [1.0; 3],
        kind: LightKind::Directional {
            to_light: to_light.normalize(),
        },
    }
}

/// Looks down -z from z = 5 at the square from -2 to 2.
fn camera() -> Camera {
    Camera {
        name: "eye".into(),
        world_from_camera: at(0.0, 0.0, 5.0),
        projection: Projection::Orthographic {
            y_mag: 2.0,
            x_mag: None,
        },
        ..Camera::default()
    }
}

fn plan(scene: &Scene, camera: &Camera) -> Plan {
    Plan::new(scene, camera, &EffectOverrides::default())
}

/// The mean of each column between `rows`, green.
fn columns(image: &LinearImage, rows: std::ops::Range<u32>) -> Vec<f64> {
    let count = f64::from(rows.end - rows.start);
    let mean = |x| rows.clone().map(|y| f64::from(image.pixel(x, y)[1])).sum::<f64>() / count;
    (0..image.width).map(mean).collect()
}

/// The part of the time in which something covers a column of the film from -2 to 2, that is 2 `half` wide and whose
/// middle goes from `from` to `to`: the mean over the column, by the trapezoid rule.
fn covered(column: u32, of: u32, half: f64, [from, to]: [f64; 2]) -> f64 {
    const POINTS: u32 = 4000;
    let share = |x: f64| {
        let [a, b] = [(x - half - from) / (to - from), (x + half - from) / (to - from)];
        (a.max(b).min(1.0) - a.min(b).max(0.0)).max(0.0)
    };
    let width = 4.0 / f64::from(of);
    let x = |i: u32| -2.0 + width * (f64::from(column) + (f64::from(i) + 0.5) / f64::from(POINTS));
    (0..POINTS).map(|i| share(x(i))).sum::<f64>() / f64::from(POINTS)
}

#[test]
fn a_moving_quad_fades_in_and_out_along_straight_ramps() {
    let (size, spp) = (32, 256);
    for (shutter, [from, to], half) in [
        (Shutter::default(), [-1.0, 1.0], 0.4),
        // Over as far as 0.2 to 0.6 of the way from -1.5 to 1.5.
        (
            Shutter {
                open: 0.2,
                close: 0.6,
            },
            [-0.9, 0.3],
            0.4,
        ),
        // Farther than it is wide, so that nowhere is covered all the time; or not as far.
        (Shutter::default(), [-1.5, 1.5], 0.2),
        (Shutter::default(), [0.5, -0.1], 0.9),
    ] {
        let length = (to - from) / (shutter.close - shutter.open);
        let start = from - shutter.open * length;
        let scale = DAffine3::from_scale(DVec3::new(half, 1.5, 1.0));
        let ends = [at(start, 0.0, 0.0) * scale, at(start + length, 0.0, 0.0) * scale];
        let scene = scene(vec![(Shape::Quad, emissive(), ends)]);
        let camera = Camera { shutter, ..camera() };
        for backend in [Backend::default(), Backend::Bsp] {
            let image = render_image(&scene, &camera, backend, &settings(size, spp));
            let rows = 8..24;
            let samples = f64::from(spp * (rows.end - rows.start));
            let (mut worst, mut ramp) = (0.0f64, 0);
            for (column, found) in columns(&image, rows.clone()).into_iter().enumerate() {
                let exact = covered(column as u32, size, half, [from, to]);
                // The error if samples were independent: theirs is less.
                let error = (exact * (1.0 - exact) / samples).sqrt();
                assert!(
                    (found - exact).abs() <= ERRORS * error + 1e-6,
                    "{backend}, column {column}: {found}, not {exact} ± {error}"
                );
                worst = worst.max((found - exact).abs());
                ramp += u32::from(exact > 0.05 && exact < 0.95);
            }
            println!("{backend} {shutter:?}: {worst:.5} at worst, {ramp} columns of the ramps");
            assert!(ramp >= 4);
        }
    }
}

/// Far from everything, a ball of glass: it has shadow rays go through surfaces.
fn glass_far_away() -> (Shape, Material, [DAffine3; 2]) {
    let glass = Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 0.0,
            roughness: 0.0,
            transmission: 1.0,
            ..MetallicRoughness::DEFAULT
        }),
        interior: Some(Medium {
            ior: Dispersion::Constant(1.5),
            absorption: Absorption::NONE,
            priority: 0,
            kind: MediumKind::Solid,
        }),
        ..Material::default()
    };
    (Shape::Sphere(Sphere::UNIT), glass, [at(50.0, 0.0, 0.0); 2])
}

#[test]
fn shadows_follow_the_caster_at_ray_time() {
    let (half, [from, to]) = (0.4, [-1.0, 0.8]);
    let flat = DAffine3::from_scale(DVec3::new(half, 1.8, 1.0));
    // Over the floor, beside the camera's rays, which come from between it and the floor.
    let roof = [at(from, 0.0, 7.0) * flat, at(to, 0.0, 7.0) * flat];
    let floor = (Shape::Plane, matte(), [DAffine3::IDENTITY; 2]);
    for extra in [vec![], vec![glass_far_away()]] {
        let mut objects = vec![floor.clone(), (Shape::Quad, matte(), roof)];
        objects.extend(extra);
        let mut scene = scene(objects);
        scene.lights = vec![sun(DVec3::Z)];
        for backend in [Backend::default(), Backend::Bsp] {
            let image = render_image(&scene, &camera(), backend, &settings(32, 256));
            let lit = f64::from(image.pixel(31, 16)[1]);
            assert!(lit > 0.1);
            for (column, found) in columns(&image, 8..24).into_iter().enumerate() {
                let exact = 1.0 - covered(column as u32, 32, half, [from, to]);
                let error = (exact * (1.0 - exact) / 4096.0).sqrt();
                assert!(
                    (found / lit - exact).abs() <= ERRORS * error + 1e-5,
                    "{backend}, column {column}: {} is not {exact}",
                    found / lit
                );
            }
        }
    }
}

#[test]
fn all_rays_of_a_path_have_the_same_time() {
    let flat = |half: f64| DAffine3::from_scale(DVec3::new(half, half, 1.0));
    let along = |map: DAffine3| [at(-1.0, 0.0, 0.0) * map, at(1.0, 0.0, 0.0) * map];
    let mirror = Material::metallic_roughness([1.0; 3], 1.0, 0.0);
    // A board moves with its roof, and a mirror with an emissive plate over it: a ray at another time sees light
    // where there is none, or none where there is.
    let board = (Shape::Quad, matte(), along(flat(0.3)));
    let roof = (Shape::Quad, matte(), along(at(0.0, 0.0, 7.0) * flat(0.35)));
    let mirror = (Shape::Quad, mirror, along(flat(0.3)));
    let plate = (Shape::Quad, emissive(), along(at(0.0, 0.0, 7.0) * flat(0.35)));
    for extra in [vec![], vec![glass_far_away()]] {
        let mut dark = scene([vec![board.clone(), roof.clone()], extra.clone()].concat());
        dark.lights = vec![sun(DVec3::Z)];
        let bright = scene([vec![mirror.clone(), plate.clone()], extra.clone()].concat());
        for backend in [Backend::default(), Backend::Bsp] {
            let image = render_image(&dark, &camera(), backend, &settings(24, 16));
            assert!(
                image.pixels.iter().all(|pixel| *pixel == [0.0; 3]),
                "light under the roof"
            );
            let image = render_image(&bright, &camera(), backend, &settings(24, 256));
            let found = columns(&image, 11..13);
            for (column, found) in found.into_iter().enumerate() {
                let exact = covered(column as u32, 24, 0.3, [-1.0, 1.0]);
                let error = (exact * (1.0 - exact) / 512.0).sqrt();
                assert!(
                    (found - exact).abs() <= ERRORS * error + 1e-5,
                    "{backend}, column {column}: {found}, not {exact}"
                );
            }
        }
    }
}

/// A still life without a place in the middle of anything.
fn still_life() -> Vec<(Shape, Material, DAffine3)> {
    let gold = Material::metallic_roughness([0.9, 0.7, 0.3], 1.0, 0.1);
    let clay = Material::metallic_roughness([0.8, 0.3, 0.2], 0.0, 0.8);
    vec![
        (
            Shape::Cube,
            gold,
            DAffine3::from_rotation_x(0.6) * DAffine3::from_scale(DVec3::new(0.9, 0.4, 0.5)),
        ),
        (
            Shape::Sphere(Sphere::UNIT),
            clay.clone(),
            at(0.0, 0.0, 1.0) * DAffine3::from_scale(DVec3::new(0.3, 0.7, 0.2)),
        ),
        (
            Shape::Quad,
            clay,
            at(0.0, 0.0, -1.0) * DAffine3::from_scale(DVec3::new(1.7, 1.4, 1.0)),
        ),
    ]
}

fn perspective() -> Camera {
    Camera {
        projection: Projection::Perspective {
            y_fov: 0.7,
            aspect: None,
        },
        ..camera()
    }
}

#[test]
fn moving_camera_equals_oppositely_moving_scene() {
    // A slide leaves a sun where it is, and so does a roll about the way to it.
    for (motion, to_light) in [
        (at(0.7, -0.3, 0.4), DVec3::new(0.3, 0.5, 1.0)),
        (DAffine3::from_rotation_z(0.9), DVec3::Z),
    ] {
        let place = |end: DAffine3| -> Scene {
            let objects = still_life().into_iter();
            let mut scene = scene(objects.map(|(s, m, map)| (s, m, [map, end * map])).collect());
            scene.lights = vec![sun(to_light)];
            scene
        };
        let start = perspective().world_from_camera;
        let moving = Camera {
            world_from_camera_end: Some(motion * start),
            ..perspective()
        };
        for view in [
            moving.clone(),
            Camera {
                projection: camera().projection,
                ..moving
            },
        ] {
            let still = Camera {
                world_from_camera_end: None,
                ..view.clone()
            };
            let settings = settings(40, 64);
            let by_camera = render_image(&place(DAffine3::IDENTITY), &view, Backend::default(), &settings);
            let by_world = render_image(&place(motion.inverse()), &still, Backend::default(), &settings);
            let unmoved = render_image(&place(DAffine3::IDENTITY), &still, Backend::default(), &settings);
            let distance = |a: &LinearImage, b: &LinearImage| {
                let pairs = a.pixels.as_flattened().iter().zip(b.pixels.as_flattened());
                let sum: f64 = pairs.map(|(a, b)| f64::from((a - b).abs())).sum();
                sum / a.pixels.as_flattened().len() as f64
            };
            let (error, blur) = (distance(&by_camera, &by_world), distance(&by_camera, &unmoved));
            println!("mean difference {error:.2e}, of the unmoved image {blur:.2e}");
            // Both take the same samples: they differ only by rounding at edges, a sample of 64 in a few pixels.
            assert!(blur > 0.01 && error < 2e-4, "{error} {blur}");
        }
    }
}

/// Everything that a path can do to a ray, turning and sliding.
fn everything() -> (Scene, Camera) {
    let (_, glass, _) = glass_far_away();
    let mut objects: Vec<_> = still_life()
        .into_iter()
        .map(|(shape, material, map)| {
            let end = at(0.3, 0.1, 0.0) * DAffine3::from_rotation_y(0.8) * map;
            (shape, material, [map, end])
        })
        .collect();
    let ball = DAffine3::from_scale(DVec3::splat(0.4));
    objects.push((
        Shape::Sphere(Sphere::UNIT),
        glass,
        [at(-0.5, 0.0, 2.0) * ball, at(0.5, 0.3, 2.0) * ball],
    ));
    objects.push((Shape::Plane, matte(), [at(0.0, 0.0, -2.0), at(0.0, 0.0, -1.5)]));
    let mut scene = scene(objects);
    scene.lights = vec![sun(DVec3::new(0.4, 0.2, 1.0))];
    let view = Camera {
        world_from_camera_end: Some(DAffine3::from_rotation_z(0.1) * perspective().world_from_camera),
        ..perspective()
    };
    (scene, view)
}

#[test]
fn image_bits_do_not_depend_on_thread_count() {
    let (scene, view) = everything();
    for spp in [1, 4, 20] {
        let settings = settings(50, spp);
        let by = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.unwrap()
                .install(|| render_image(&scene, &view, Backend::default(), &settings).pixels)
        };
        let one = by(1);
        for threads in [2, 7] {
            assert!(one == by(threads), "{spp} samples, {threads} threads");
        }
    }
}

#[test]
fn backends_agree_on_motion_blur() {
    let (scene, view) = everything();
    let settings = settings(40, 16);
    let images = [Backend::Brute, Backend::Bsp, Backend::default()]
        .map(|b| render_image(&scene, &view, b, &settings).pixels);
    for other in &images[1..] {
        let differ =
            |(a, b): (&[f32; 3], &[f32; 3])| (0..3).any(|c| (a[c] - b[c]).abs() > 1e-4 * (1.0 + a[c]));
        let different = images[0].iter().zip(other).filter(|pair| differ(*pair)).count();
        // Where a ray just hits an edge or misses it, one sample of 16 is another's.
        println!("{different} of {} pixels differ", other.len());
        assert!(different * 100 <= other.len(), "{different} of {}", other.len());
    }
}

#[test]
fn zero_motion_is_static_and_costs_nothing() {
    let still = |[start, _]: [DAffine3; 2]| [start; 2];
    let (moving, view) = everything();
    let mut scene = moving.clone();
    for instance in &mut scene.instances {
        let ends = still(
            instance
                .motion()
                .map_or([instance.world_from_object(); 2], |motion| motion.ends()),
        );
        *instance = Instance::moving(&*instance.name, instance.geometry, instance.material, ends).unwrap();
    }
    let view = Camera {
        world_from_camera_end: Some(view.world_from_camera),
        ..view
    };
    assert!(!plan(&scene, &view).effects().has(Effect::MotionBlur));
    let plan = plan(&moving, &view);
    let decision = plan
        .decisions
        .iter()
        .find(|d| d.effect == Effect::MotionBlur)
        .unwrap();
    assert_eq!(decision.reason, "`object 0` moves, and 4 more objects");
    // Switched off, everything stands where its motion begins.
    let settings = settings(32, 4);
    let off = RenderSettings {
        effects: "-motion-blur".parse().unwrap(),
        ..settings
    };
    let frozen = render_image(&moving, &view, Backend::default(), &off).pixels;
    let differ = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).any(|c| (a[c] - b[c]).abs() > 1e-4 * (1.0 + a[c]));
    let still = render_image(&scene, &view, Backend::default(), &settings).pixels;
    assert!(frozen.iter().zip(&still).filter(|pair| differ(*pair)).count() * 100 <= still.len());
}
