//! Many lights, of which surfaces behind a diffuse bounce sample one, against renders of a few lights each, which sample all.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use whit::render::{LightAovs, RenderSettings, Rendering};
use whit::scene::{
    AreaShape, Camera, Falloff, Geometry, Interreflection, Light, LightKind, Material, Model, Projection,
    Scene, Translucency,
};
use whit::shape::{Shape, Sphere};

use super::rough_render::settings;
use crate::support::images::{add, estimate, rendered};
use crate::support::scenes::box_mesh;

/// Standard errors that two estimates may differ by.
const ERRORS: f64 = 4.0;

/// Returns a matte surface.
fn matte(albedo: f32) -> Material {
    let mut material = Material::metallic_roughness([albedo; 3], 0.0, 1.0);
    if let Model::MetallicRoughness(model) = &mut material.model {
        model.specular = 0.0;
    }
    material
}

/// Returns a room with lights of one kind in two rows, some close to walls and one much brighter.
fn room(count: usize, light: impl Fn(&mut Scene, usize, DVec3, f32)) -> Scene {
    let mut scene = Scene {
        interreflection: Some(Interreflection { bounces: 4 }),
        ..Scene::default()
    };
    let walls = Geometry::Mesh(box_mesh(Vec3::new(-4.0, 0.0, -2.0), Vec3::new(4.0, 2.5, 2.0)));
    add(&mut scene, "walls", walls, matte(0.7), DAffine3::IDENTITY);
    let block = Geometry::Mesh(box_mesh(Vec3::new(-1.0, 0.0, -0.5), Vec3::new(0.5, 1.2, 0.4)));
    add(&mut scene, "block", block, matte(0.4), DAffine3::IDENTITY);
    let table = Geometry::Mesh(box_mesh(Vec3::new(-0.4, 0.6, -1.2), Vec3::new(2.4, 0.65, 1.8)));
    add(&mut scene, "table", table, matte(0.6), DAffine3::IDENTITY);
    for index in 0..count {
        let along = (index / 2) as f64 / (count / 2) as f64;
        let side = if index % 2 == 0 { -1.3 } else { 1.6 };
        let place = DVec3::new(7.6 * along - 3.8, 2.2, side);
        light(&mut scene, index, place, if index == 7 { 20.0 } else { 1.0 });
    }
    scene
}

fn lamp(scene: &mut Scene, index: usize, intensity: f32, kind: LightKind) {
    scene.lights.push(Light {
        name: format!("lamp {index}"),
        intensity: [intensity; 3],
        kind,
    });
}

const FALLOFF: Falloff = Falloff::InverseSquare { range: None };

/// Returns a camera that looks at one point of the floor below the table, which no lamp reaches.
fn look_down() -> Camera {
    Camera {
        world_from_camera: DAffine3::from_rotation_translation(
            DQuat::from_rotation_arc(DVec3::NEG_Z, DVec3::NEG_Y),
            DVec3::new(1.0, 0.5, 0.3),
        ),
        projection: Projection::Orthographic {
            y_mag: 1e-6,
            x_mag: None,
        },
        ..Camera::default()
    }
}

/// Returns the scene with each twenty of its lights alone, so few that all are sampled. Other emissive objects are dark.
fn parts(scene: &Scene) -> Vec<Scene> {
    let lights = &scene.lights;
    let with = |kept: &[Light]| {
        let mut part = Scene {
            lights: kept.to_vec(),
            ..scene.clone()
        };
        let is_kept = |light: &Light| kept.iter().any(|kept| kept.kind == light.kind);
        for light in lights.iter().filter(|light| !is_kept(light)) {
            if let Some(instance) = light.emissive_instance() {
                let material = part.instances[instance as usize].material;
                part.materials[material as usize].emission = [0.0; 3];
            }
        }
        part
    };
    lights.chunks(20).map(with).collect()
}

/// Asserts that one of the lights gives the light of all, by fewer shadow rays.
fn assert_equal_light(what: &str, scene: &Scene, camera: &Camera) {
    let shadow_rays = |rendering: &Rendering| rendering.ledger.shadow_rays();
    let one = rendered(scene, camera, &settings(16, 64));
    let (mean, error) = estimate(&one.image);
    // Add up the light of the parts
    let (mut expected, mut rest, mut rays) = (0.0, 0.0f64, 0);
    for part in parts(scene) {
        let rendering = rendered(&part, camera, &settings(16, 64));
        let (mean, error) = estimate(&rendering.image);
        (expected, rest) = (expected + mean, rest.hypot(error));
        rays += shadow_rays(&rendering);
    }
    println!("{what}: {mean:.5} ± {error:.5}, from all {expected:.5} ± {rest:.5}");
    let bound = ERRORS * error.hypot(rest);
    assert!(
        (mean - expected).abs() <= bound,
        "{what}: {mean}, from all {expected} ± {bound}"
    );
    assert!(shadow_rays(&one) < rays, "{what} samples all lights");
}

#[test]
fn one_of_many_lights_of_each_kind_gives_the_light_of_all() {
    let points = room(40, |scene, index, position, intensity| {
        let falloff = FALLOFF;
        lamp(scene, index, intensity, LightKind::Point { position, falloff });
    });
    assert_equal_light("points", &points, &look_down());
    let spots = room(40, |scene, index, position, intensity| {
        let kind = LightKind::Spot {
            position,
            direction: DVec3::new(0.3, -1.0, 0.2 * position.x).normalize(),
            cos_inner: 0.95,
            cos_outer: 0.8,
            falloff: FALLOFF,
        };
        lamp(scene, index, 4.0 * intensity, kind);
    });
    assert_equal_light("spots", &spots, &look_down());
    let shapes = room(40, |scene, index, center, intensity| {
        let (half_u, half_v) = (DVec3::new(0.1, 0.02, 0.0), DVec3::new(0.0, 0.03, 0.15));
        let shape = match index % 3 {
            0 => AreaShape::Quad {
                center,
                half_u,
                half_v,
            },
            1 => AreaShape::Disk {
                center,
                half_u,
                half_v,
            },
            _ => AreaShape::Sphere { center, radius: 0.08 },
        };
        lamp(
            scene,
            index,
            20.0 * intensity,
            LightKind::Area { shape, samples: 2 },
        );
    });
    assert_equal_light("shapes", &shapes, &look_down());
}

#[test]
fn one_of_many_emissive_objects_gives_the_light_of_all() {
    let ball = Geometry::Shape(Shape::Sphere(Sphere {
        radius: 0.08,
        ..Sphere::UNIT
    }));
    let cube = Geometry::Mesh(box_mesh(Vec3::splat(-0.06), Vec3::splat(0.06)));
    let mut scene = room(40, |scene, index, place, intensity| {
        let material = Material {
            emission: [15.0 * intensity; 3],
            ..matte(0.2)
        };
        let geometry = if index % 2 == 0 {
            ball.clone()
        } else {
            cube.clone()
        };
        let turn = DQuat::from_rotation_y(index as f64);
        let place = DAffine3::from_rotation_translation(turn, place);
        let instance = add(scene, "lamp", geometry, material, place);
        scene.add_emissive_light(instance, 1).unwrap();
    });
    assert_equal_light("emissive objects", &scene, &look_down());
    // Mirrors see the objects beside the light samples
    let smooth = Material::metallic_roughness([0.8; 3], 0.5, 0.0);
    let mirror = Geometry::Mesh(box_mesh(Vec3::new(1.5, 0.0, -1.0), Vec3::new(2.5, 1.0, 0.0)));
    add(&mut scene, "mirror", mirror, smooth, DAffine3::IDENTITY);
    assert_equal_light("emissive objects and a mirror", &scene, &look_down());
}

#[test]
fn one_of_many_lights_reaches_thin_surfaces_from_behind() {
    let mut scene = room(40, |scene, index, position, intensity| {
        let falloff = FALLOFF;
        lamp(scene, index, intensity, LightKind::Point { position, falloff });
    });
    let paper = Material {
        translucency: Some(Translucency {
            factor: 0.6,
            color: [1.0; 3],
        }),
        ..matte(0.8)
    };
    let panel = Geometry::Mesh(box_mesh(Vec3::new(-2.0, 1.8, -1.0), Vec3::new(2.0, 1.81, 1.0)));
    add(&mut scene, "panel", panel, paper, DAffine3::IDENTITY);
    assert_equal_light("a panel below the lights", &scene, &look_down());
}

#[test]
fn one_of_many_lights_has_the_same_bits_for_any_number_of_threads() {
    let scene = room(40, |scene, index, position, intensity| {
        let falloff = FALLOFF;
        lamp(scene, index, intensity, LightKind::Point { position, falloff });
    });
    let image = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| rendered(&scene, &look_down(), &settings(48, 4)).image)
    };
    let first = image(1);
    for threads in [2, 7] {
        assert_eq!(image(threads).pixels, first.pixels, "{threads} threads");
    }
}

#[test]
fn layers_of_many_lights_change_no_bit_and_add_up_to_the_image() {
    let scene = room(40, |scene, index, position, intensity| {
        let falloff = FALLOFF;
        lamp(scene, index, intensity, LightKind::Point { position, falloff });
    });
    let plain = rendered(&scene, &look_down(), &settings(16, 4));
    let with_layers = RenderSettings {
        light_layers: LightAovs {
            lights: true,
            effects: true,
        },
        ..settings(16, 4)
    };
    let layered = rendered(&scene, &look_down(), &with_layers);
    assert_eq!(plain.image.pixels, layered.image.pixels);
    // Each light has a part of the light
    let reds = layered
        .layers
        .iter()
        .filter(|layer| layer.name.starts_with("light.") && layer.name.ends_with(".R"));
    let mut sums = vec![0.0f64; plain.image.pixels.len()];
    let mut lit = 0;
    for layer in reds {
        lit += u32::from(layer.values.iter().any(|&value| value > 0.0));
        sums.iter_mut()
            .zip(&layer.values)
            .for_each(|(sum, &value)| *sum += f64::from(value));
    }
    assert!(lit >= 40, "{lit}");
    for (sum, pixel) in sums.iter().zip(&plain.image.pixels) {
        assert!(
            (sum - f64::from(pixel[0])).abs() <= 1e-5 * f64::from(pixel[0]),
            "{sum}, not {}",
            pixel[0]
        );
    }
}
