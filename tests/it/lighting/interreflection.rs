//! Interreflection against closed forms of diffuse light, in standard errors of the pixels, and against itself.
//!
//! Closed forms are those of radiosity: of closed rooms, of planes that meet at right angles and of parallel planes.

use std::f64::consts::FRAC_1_PI;

use glam::{DAffine3, DQuat, DVec3};
use whit::accel::{AccelOptions, Backend};
use whit::image::LinearImage;
use whit::render::{Category, RenderSettings};
use whit::scene::{
    AlphaMode, AreaShape, Background, Camera, Effect, EffectOverrides, EffectSet, Falloff, Geometry,
    Interreflection, Light, LightKind, Material, Model, Projection, Scene, Translucency,
};
use whit::shape::{Shape, Sphere};

use super::rough_render::{metal, settings};
use crate::support::images::{add, estimate, rendered, rendered_by, set_environment};
use crate::support::scenes::box_mesh;

/// Standard errors that an estimate may differ by, with three seeds for each scene.
const ERRORS: f64 = 4.0;
/// Relative error of single precision along a path.
const ROUNDING: f64 = 1e-6;
const SEEDS: [u32; 3] = [0, 1, 2];

/// Returns a surface of glTF's model that is diffuse only.
fn lambertian(albedo: f32) -> Material {
    let mut material = Material::metallic_roughness([albedo; 3], 0.0, 1.0);
    if let Model::MetallicRoughness(model) = &mut material.model {
        model.specular = 0.0;
    }
    material
}

fn shining(albedo: f32, emission: f32) -> Material {
    Material {
        emission: [emission; 3],
        ..lambertian(albedo)
    }
}

fn interreflecting(bounces: u32) -> Scene {
    Scene {
        interreflection: Some(Interreflection { bounces }),
        ..Scene::default()
    }
}

/// Returns a camera at `place` that looks at one point of a surface, in the direction `forward`.
fn look(place: DVec3, forward: DVec3) -> Camera {
    let turn = DQuat::from_rotation_arc(DVec3::NEG_Z, forward.normalize());
    Camera {
        world_from_camera: DAffine3::from_rotation_translation(turn, place),
        projection: Projection::Orthographic {
            y_mag: 1e-6,
            x_mag: None,
        },
        ..Camera::default()
    }
}

/// Returns a plane through `place` with the normal `normal`.
fn plane(place: DVec3, normal: DVec3) -> DAffine3 {
    DAffine3::from_rotation_translation(DQuat::from_rotation_arc(DVec3::Z, normal), place)
}

fn with_seed(seed: u32, settings: RenderSettings) -> RenderSettings {
    RenderSettings { seed, ..settings }
}

/// Asserts that the mean of the image is `exact`, for three seeds.
fn assert_mean(what: &str, scene: &Scene, camera: &Camera, exact: f64) {
    for seed in SEEDS {
        let settings = with_seed(seed, settings(16, 256));
        let (mean, error) = estimate(&rendered(scene, camera, &settings).image);
        println!("{what}, seed {seed}: {mean:.6} ± {error:.6}, exactly {exact:.6}");
        let bound = ERRORS * error + ROUNDING * exact;
        assert!(
            (mean - exact).abs() <= bound,
            "{what}: {mean} ± {error}, not {exact}"
        );
    }
}

#[test]
fn closed_room_that_shines_everywhere_has_a_geometric_series_of_bounces() {
    let sphere = Geometry::Shape(Shape::Sphere(Sphere::UNIT));
    let room = Geometry::Mesh(box_mesh(glam::Vec3::NEG_ONE, glam::Vec3::new(2.0, 1.0, 1.5)));
    for (name, geometry) in [("sphere", sphere), ("box", room)] {
        for (albedo, bounces) in [(0.5f32, 1), (0.5, 3), (0.8, 4), (0.5, 64), (0.8, 256)] {
            let mut scene = interreflecting(bounces);
            add(
                &mut scene,
                name,
                geometry.clone(),
                shining(albedo, 1.5),
                DAffine3::IDENTITY,
            );
            let rho = f64::from(albedo);
            let exact = 1.5 * (1.0 - rho.powi(bounces as i32 + 1)) / (1.0 - rho);
            let camera = look(DVec3::new(0.2, 0.1, -0.3), DVec3::new(0.5, 0.3, 1.0));
            assert_mean(
                &format!("{name}, albedo {albedo}, {bounces} bounces"),
                &scene,
                &camera,
                exact,
            );
        }
    }
}

#[test]
fn three_orthogonal_planes_gather_three_quarters_of_their_light_from_each_other() {
    for albedo in [0.3f32, 0.9] {
        let mut scene = interreflecting(256);
        for normal in DVec3::AXES {
            add(
                &mut scene,
                "plane",
                Geometry::Shape(Shape::Plane),
                lambertian(albedo),
                plane(DVec3::ZERO, normal),
            );
        }
        scene.lights.push(Light {
            name: "sun".into(),
            intensity: [2.0; 3],
            kind: LightKind::Directional {
                to_light: DVec3::ONE.normalize(),
            },
        });
        let (rho, irradiance) = (f64::from(albedo), 2.0 / 3f64.sqrt());
        let exact = FRAC_1_PI * rho * irradiance / (1.0 - 0.75 * rho);
        for (what, place) in [
            ("near the corner", DVec3::new(0.3, 0.7, 0.2)),
            ("far away", DVec3::new(9.0, 0.2, 30.0)),
        ] {
            let camera = look(place, DVec3::new(0.0, -0.1, -1.0));
            assert_mean(&format!("albedo {albedo}, {what}"), &scene, &camera, exact);
        }
        // The sky lights a quarter of each hemisphere
        scene.lights.clear();
        scene.background = Background::Uniform([3.0; 3]);
        let exact = rho * 3.0 / 4.0 / (1.0 - 0.75 * rho);
        let camera = look(DVec3::new(0.3, 0.7, 0.2), DVec3::new(0.0, -0.1, -1.0));
        assert_mean(&format!("albedo {albedo}, sky"), &scene, &camera, exact);
        // Ambient light comes from outside of the scene as the sky does
        scene.background = Background::default();
        scene.ambient = [3.0; 3];
        assert_mean(&format!("albedo {albedo}, ambient"), &scene, &camera, exact);
    }
}

#[test]
fn indirect_light_of_a_sphere_is_the_same_everywhere() {
    let (albedo, radius, intensity) = (0.7f32, 2.0, 5.0f32);
    let mut scene = interreflecting(256);
    add(
        &mut scene,
        "sphere",
        Geometry::Shape(Shape::Sphere(Sphere {
            center: DVec3::ZERO,
            radius,
        })),
        lambertian(albedo),
        DAffine3::IDENTITY,
    );
    let lamp = DVec3::new(0.9, -0.6, 1.1);
    scene.lights.push(Light {
        name: "lamp".into(),
        intensity: [intensity; 3],
        kind: LightKind::Point {
            position: lamp,
            falloff: Falloff::InverseSquare { range: None },
        },
    });
    let rho = f64::from(albedo);
    let indirect = FRAC_1_PI * rho * rho * f64::from(intensity) / (radius * radius * (1.0 - rho));
    for forward in [DVec3::new(1.0, -0.3, 0.4), DVec3::new(-0.2, 0.5, -1.0)] {
        // Direct light follows from the distance and the angle
        let toward = forward.normalize();
        let place = DVec3::new(0.1, 0.2, 0.0);
        let along = place.dot(toward);
        let point =
            place + toward * (-along + (along * along - place.length_squared() + radius * radius).sqrt());
        let to_lamp = lamp - point;
        let cosine = (-point / radius).dot(to_lamp.normalize());
        let direct = FRAC_1_PI * rho * f64::from(intensity) * cosine / to_lamp.length_squared();
        assert_mean("sphere", &scene, &look(place, forward), direct + indirect);
    }
}

#[test]
fn parallel_planes_light_each_other() {
    let (below, above, emission) = (0.6f32, 0.4f32, 2.0f32);
    let mut scene = interreflecting(256);
    let shape = Geometry::Shape(Shape::Plane);
    add(
        &mut scene,
        "floor",
        shape.clone(),
        lambertian(below),
        plane(DVec3::ZERO, DVec3::Z),
    );
    add(
        &mut scene,
        "ceiling",
        shape,
        shining(above, emission),
        plane(DVec3::Z, DVec3::NEG_Z),
    );
    let [below, above] = [below, above].map(f64::from);
    let exact = below * f64::from(emission) / (1.0 - below * above);
    let camera = look(DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.1, 0.3, -1.0));
    assert_mean("floor", &scene, &camera, exact);
}

#[test]
fn planes_of_a_wedge_light_each_other_the_more_the_narrower_it_is() {
    for degrees in [60.0f64, 90.0, 120.0] {
        let (albedo, angle) = (0.8f32, degrees.to_radians());
        let mut scene = interreflecting(256);
        // Both planes hold the y axis; the other side of each is outside of the wedge
        let normals = [DVec3::Z, DVec3::new(angle.sin(), 0.0, -angle.cos())];
        for normal in normals {
            let shape = Geometry::Shape(Shape::Plane);
            add(
                &mut scene,
                "plane",
                shape,
                lambertian(albedo),
                plane(DVec3::ZERO, normal),
            );
        }
        // A sun along the middle of the wedge lights both planes alike
        let to_light = (normals[0] + normals[1]).normalize();
        scene.lights.push(Light {
            name: "sun".into(),
            intensity: [2.0; 3],
            kind: LightKind::Directional { to_light },
        });
        let (rho, irradiance) = (f64::from(albedo), 2.0 * to_light.z);
        let exact = FRAC_1_PI * rho * irradiance / (1.0 - 0.5 * rho * (1.0 + angle.cos()));
        let place = DVec3::new((0.5 * angle).cos(), 0.0, (0.5 * angle).sin());
        let camera = look(place, DVec3::new(0.3, 0.2, -1.0));
        assert_mean(&format!("{degrees} degrees"), &scene, &camera, exact);
    }
}

#[test]
fn concentric_spheres_light_each_other_and_the_outer_one_itself() {
    let (inner, outer, emission, ratio) = (0.5f32, 0.8f32, 2.0f32, 0.4);
    let mut scene = interreflecting(256);
    for (radius, material) in [(ratio, shining(inner, emission)), (1.0, lambertian(outer))] {
        let center = DVec3::ZERO;
        let sphere = Geometry::Shape(Shape::Sphere(Sphere { center, radius }));
        add(&mut scene, "sphere", sphere, material, DAffine3::IDENTITY);
    }
    // B1 = E1 + rho1 B2 and B2 = rho2 (q B1 + (1 - q) B2), where q is the ratio of the areas
    let [inner, outer, emission] = [inner, outer, emission].map(f64::from);
    let q = ratio * ratio;
    let gain = outer * q / (1.0 - outer * (1.0 - q));
    let of_inner = emission / (1.0 - inner * gain);
    for (what, forward, exact) in [
        ("inner", DVec3::new(-1.0, 0.1, 0.2), of_inner),
        ("outer", DVec3::new(1.0, 0.5, 0.2), gain * of_inner),
    ] {
        assert_mean(what, &scene, &look(DVec3::new(0.7, 0.1, 0.0), forward), exact);
    }
}

#[test]
fn no_light_leaks_through_a_thin_wall_or_along_its_edges() {
    // Two rooms with a wall of a millionth of their size between them, one of which is lit
    let room = |low: f32, high: f32| {
        Geometry::Mesh(box_mesh(
            glam::Vec3::new(low, -1.0, -1.0),
            glam::Vec3::new(high, 1.0, 1.0),
        ))
    };
    let mut scene = interreflecting(16);
    add(
        &mut scene,
        "lit",
        room(-2.0, -1e-6),
        lambertian(0.9),
        DAffine3::IDENTITY,
    );
    add(
        &mut scene,
        "dark",
        room(1e-6, 2.0),
        lambertian(0.9),
        DAffine3::IDENTITY,
    );
    scene.lights.push(Light {
        name: "lamp".into(),
        intensity: [100.0; 3],
        kind: LightKind::Point {
            position: DVec3::new(-0.3, 0.2, 0.1),
            falloff: Falloff::InverseSquare { range: None },
        },
    });
    // The camera sees the wall and all edges around it
    let view = |x: f64, forward: DVec3| Camera {
        projection: Projection::Orthographic {
            y_mag: 0.999_999,
            x_mag: None,
        },
        ..look(DVec3::new(x, 0.0, 0.0), forward)
    };
    for backend in [Backend::default(), Backend::Native, Backend::Bsp] {
        let options = AccelOptions::default();
        let rendered = |camera: &Camera| {
            let settings = settings(64, 16);
            rendered_by(&scene, camera, (backend, &options), &settings).image
        };
        let dark = rendered(&view(1.5, DVec3::NEG_X));
        assert!(dark.pixels.iter().all(|pixel| *pixel == [0.0; 3]), "{backend}");
        let lit = rendered(&view(-1.5, DVec3::X));
        assert!(lit.pixels.iter().all(|pixel| pixel[1] > 0.0), "{backend}");
    }
}

#[test]
fn ball_hides_the_share_of_the_sky_that_it_covers() {
    let mut scene = interreflecting(8);
    add(
        &mut scene,
        "floor",
        Geometry::Shape(Shape::Plane),
        lambertian(0.5),
        DAffine3::IDENTITY,
    );
    let (radius, center) = (0.8, DVec3::new(0.5, 0.3, 1.2));
    add(
        &mut scene,
        "ball",
        Geometry::Shape(Shape::Sphere(Sphere { center, radius })),
        lambertian(0.0),
        DAffine3::IDENTITY,
    );
    scene.background = Background::Uniform([2.0; 3]);
    let hidden = radius * radius * center.z / center.length().powi(3);
    let camera = look(DVec3::new(-0.6, -0.6, 0.3), DVec3::new(0.6, 0.6, -0.3));
    assert_mean("floor", &scene, &camera, 0.5 * 2.0 * (1.0 - hidden));
}

#[test]
fn white_sheet_under_white_light_on_both_sides_is_as_bright_as_the_light() {
    for factor in [0.3, 1.0] {
        let mut scene = interreflecting(4);
        let sheet = Material {
            translucency: Some(Translucency {
                factor,
                color: [1.0; 3],
            }),
            ..lambertian(1.0)
        };
        add(
            &mut scene,
            "sheet",
            Geometry::Shape(Shape::Quad),
            sheet,
            DAffine3::IDENTITY,
        );
        scene.background = Background::Uniform([1.0; 3]);
        let camera = look(DVec3::new(0.2, 0.1, 0.5), DVec3::new(0.1, 0.3, -1.0));
        assert_mean(&format!("transmits {factor}"), &scene, &camera, 1.0);
    }
}

/// Returns a room with a block, open at the top, with glossy metal, lit by nothing yet.
fn furnished() -> Scene {
    let mut scene = interreflecting(6);
    let quad = || Geometry::Shape(Shape::Quad);
    let turned = |normal: DVec3| plane(-normal, normal);
    for normal in [DVec3::Z, DVec3::Y, DVec3::NEG_X, DVec3::X] {
        add(&mut scene, "wall", quad(), lambertian(0.7), turned(normal));
    }
    let block = box_mesh(glam::Vec3::new(-0.5, -0.7, -1.0), glam::Vec3::new(0.1, 0.2, -0.2));
    add(
        &mut scene,
        "block",
        Geometry::Mesh(block),
        lambertian(0.4),
        DAffine3::IDENTITY,
    );
    // A pane lets half of the light pass straight
    let mut pane = lambertian(0.5);
    pane.alpha = AlphaMode::Blend;
    pane.base_color[3] = 0.5;
    let place =
        DAffine3::from_translation(DVec3::new(0.3, 0.1, 0.4)) * DAffine3::from_scale(DVec3::splat(0.4));
    add(&mut scene, "pane", quad(), pane, place);
    let ball = Geometry::Shape(Shape::Sphere(Sphere {
        center: DVec3::new(0.6, 0.4, -0.7),
        radius: 0.3,
    }));
    add(&mut scene, "ball", ball, metal(0.9, 0.4, 1), DAffine3::IDENTITY);
    scene
}

/// Asserts that both scenes have the same mean image, with at most `gain` times the error of the second.
fn assert_same_mean(what: &str, scenes: [&Scene; 2], gain: f64) {
    let camera = Camera {
        projection: Projection::Orthographic {
            y_mag: 0.8,
            x_mag: None,
        },
        world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 0.0, 3.0)),
        ..Camera::default()
    };
    // Means of whole images have no error that follows from their pixels, so several seeds give one
    let means = scenes.map(|scene| -> LinearImage {
        let means = (0..16).map(|seed| {
            let image = rendered(scene, &camera, &with_seed(seed, settings(24, 64))).image;
            [estimate(&image).0 as f32; 3]
        });
        LinearImage {
            width: 16,
            height: 1,
            pixels: means.collect(),
        }
    });
    let [(mean, error), (other, other_error)] = means.map(|image| estimate(&image));
    println!("{what}: {mean:.6} ± {error:.6}, {other:.6} ± {other_error:.6}");
    let bound = ERRORS * error.hypot(other_error);
    assert!(
        (mean - other).abs() <= bound,
        "{what}: {mean}, not {other} ± {bound}"
    );
    assert!(
        error < gain * other_error,
        "{what}: {error}, not below {other_error}"
    );
}

#[test]
fn emissive_object_lights_a_room_alike_with_and_without_light_samples() {
    let with_lamp = |is_sampled: bool| {
        let mut scene = furnished();
        let lamp = Geometry::Shape(Shape::Sphere(Sphere {
            center: DVec3::new(-0.2, 0.3, 0.7),
            radius: 0.15,
        }));
        let lamp = add(&mut scene, "lamp", lamp, shining(0.3, 10.0), DAffine3::IDENTITY);
        if is_sampled {
            scene.add_emissive_light(lamp, 2).unwrap();
        }
        scene
    };
    assert_same_mean("lamp", [&with_lamp(true), &with_lamp(false)], 0.5);
}

#[test]
fn environment_lights_a_room_alike_with_and_without_light_samples() {
    let lit = |samples: u32| {
        let mut scene = furnished();
        let mut texels = vec![[0.3, 0.3, 0.3, 1.0]; 32 * 16];
        texels[32 * 2 + 16] = [80.0; 4];
        texels[32 * 3 + 20] = [80.0; 4];
        set_environment(&mut scene, [32, 16], texels, samples);
        scene
    };
    assert_same_mean("environment", [&lit(2), &lit(0)], 0.7);
}

#[test]
fn same_bits_for_all_threads_and_scaled_bits_for_scaled_light() {
    let mut scene = furnished();
    scene.background = Background::Uniform([0.2; 3]);
    scene.lights.push(Light {
        name: "panel".into(),
        intensity: [3.0; 3],
        kind: LightKind::Area {
            shape: AreaShape::Disk {
                center: DVec3::new(0.0, 0.0, 0.9),
                half_u: 0.5 * DVec3::Y,
                half_v: 0.5 * DVec3::X,
            },
            samples: 2,
        },
    });
    let camera = Camera {
        projection: Projection::Orthographic {
            y_mag: 0.8,
            x_mag: None,
        },
        world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 0.0, 3.0)),
        ..Camera::default()
    };
    let bits = |scene: &Scene, backend: Backend, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let options = AccelOptions::default();
        let settings = settings(80, 2);
        let rendering = pool.install(|| rendered_by(scene, &camera, (backend, &options), &settings));
        rendering.image.pixels
    };
    let one = bits(&scene, Backend::Bsp, 1);
    for threads in [2, 7] {
        assert!(one == bits(&scene, Backend::Bsp, threads), "{threads} threads");
    }
    assert!(one == bits(&scene, Backend::Native, 2), "native");
    // Powers of two are exact
    let scale = 2f32.powi(5);
    scene.background = Background::Uniform([0.2 * scale; 3]);
    scene.lights[0].intensity = [3.0 * scale; 3];
    let scaled = bits(&scene, Backend::Bsp, 2);
    for (pixel, scaled) in one.iter().zip(&scaled) {
        assert_eq!(pixel.map(|channel| channel * scale), *scaled);
    }
}

#[test]
fn interreflection_is_simulated_only_on_request_and_is_counted() {
    let mut scene = furnished();
    scene.background = Background::Uniform([0.2; 3]);
    let camera = look(DVec3::new(0.2, -0.5, 2.0), DVec3::NEG_Z);
    let requested = rendered(&scene, &camera, &settings(16, 4));
    assert!(requested.ledger.of(Category::Interreflection).rays > 0);
    scene.interreflection = None;
    let without = rendered(&scene, &camera, &settings(16, 4));
    assert_eq!(without.ledger.of(Category::Interreflection).rays, 0);
    // All effects do not include it, but its name does
    let effects = |effects: EffectOverrides| RenderSettings {
        effects,
        ..settings(16, 4)
    };
    let all = rendered(&scene, &camera, &effects(EffectOverrides::ALL));
    assert!(all.image.pixels == without.image.pixels);
    let added = EffectOverrides {
        added: EffectSet::NONE.with(Effect::Interreflection),
        ..EffectOverrides::default()
    };
    let added = rendered(&scene, &camera, &effects(added));
    assert!(added.ledger.of(Category::Interreflection).rays > 0);
}
