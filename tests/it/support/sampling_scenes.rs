//! Test scenes that are easy or hard to sample, for different reasons.

use std::f64::consts::PI;
use std::path::Path;

use glam::{DAffine3, DVec3};
use whit::gltf::{LoadOptions, load};
use whit::scene::{Background, Geometry, LightKind, Material, Scene};
use whit::shape::{Shape, Sphere};

use super::meshes::rectangle;
use super::wave_scenes::{
    add_geometry, add_material, camera, light, matte, metal, moved, perspective, place, textures,
};

/// Returns all scenes with their names.
pub fn scenes() -> Vec<(&'static str, Scene)> {
    vec![
        ("first light", first_light()),
        ("mostly empty", mostly_empty()),
        ("mirrored spheres", mirrored_spheres()),
        ("fence", fence()),
        ("dust", dust()),
        ("noise", noise()),
    ]
}

/// Loads the scene of the README.
pub fn first_light() -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/first_light.gltf");
    load(&path, &LoadOptions::default()).unwrap()
}

/// Returns two small spheres in front of a uniform background.
pub fn mostly_empty() -> Scene {
    let mut scene = lit([0.4, 0.45, 0.6]);
    let clay = add_material(&mut scene, matte([0.7, 0.3, 0.2], 0.8));
    let ball = unit_sphere(&mut scene);
    place(
        &mut scene,
        ball,
        clay,
        moved(-0.4, 0.3, 0.0) * scaled(0.25, 0.25, 0.25),
    );
    place(
        &mut scene,
        ball,
        clay,
        moved(0.6, -0.35, 0.0) * scaled(0.06, 0.3, 0.06),
    );
    scene.cameras = vec![camera([0.1, 0.2, 4.0], [0.0, 0.0, 0.0], perspective(0.6))];
    scene
}

/// Returns mirrors over a ground, which reflect each other and emissive objects; without a light, whose image in a
/// mirror is a point that no number of samples resolves.
pub fn mirrored_spheres() -> Scene {
    let mut scene = Scene {
        ambient: [0.1, 0.15, 0.3],
        background: Background::Uniform([0.1, 0.15, 0.3]),
        ..Scene::default()
    };
    let silver = add_material(&mut scene, metal([0.95, 0.93, 0.9], 0.0));
    let glazed = add_material(&mut scene, matte([0.6, 0.1, 0.1], 0.05));
    let emissive = add_material(
        &mut scene,
        Material {
            emission: [0.9, 0.8, 0.3],
            ..matte([0.0; 3], 1.0)
        },
    );
    let ball = unit_sphere(&mut scene);
    for i in 0..9 {
        let (x, z) = (f64::from(i % 3) - 1.0, f64::from(i / 3) - 1.0);
        let material = if i == 4 {
            emissive
        } else {
            [silver, glazed][i as usize % 2]
        };
        let at = moved(1.1 * x, 0.45, 1.1 * z);
        place(&mut scene, ball, material, at * scaled(0.45, 0.45, 0.45));
    }
    let chalk = add_material(&mut scene, matte([0.8, 0.8, 0.7], 1.0));
    let ground = add_geometry(&mut scene, Geometry::Mesh(rectangle(6.0, 6.0)));
    place(&mut scene, ground, chalk, DAffine3::from_rotation_x(-0.5 * PI));
    scene.cameras = vec![camera([0.7, 2.0, 4.0], [0.0, 0.4, 0.0], perspective(0.75))];
    scene
}

/// Returns slats a tenth of a pixel to a few pixels wide, extending into the distance.
pub fn fence() -> Scene {
    let mut scene = lit([0.05, 0.07, 0.1]);
    let chalk = add_material(&mut scene, matte([0.9, 0.9, 0.85], 1.0));
    let slat = add_geometry(&mut scene, Geometry::Mesh(rectangle(0.06, 1.0)));
    for i in 0..120 {
        let at = moved(0.11 * f64::from(i) - 1.5, 0.0, -0.35 * f64::from(i));
        place(&mut scene, slat, chalk, at);
    }
    scene.cameras = vec![camera([0.0, 0.2, 2.5], [1.0, 0.0, -2.0], perspective(0.7))];
    scene
}

/// Returns spheres much smaller than a pixel, far from each other, so that the first samples miss many of them.
pub fn dust() -> Scene {
    let mut scene = lit([0.02; 3]);
    let chalk = add_material(&mut scene, matte([0.9; 3], 1.0));
    let ball = unit_sphere(&mut scene);
    for i in 0..400 {
        // The golden angle distributes them over a disk (H. Vogel, 1979).
        let (radius, angle) = (0.06 * f64::from(i).sqrt(), 2.399_963 * f64::from(i));
        let at = moved(radius * angle.cos(), radius * angle.sin(), 0.0);
        place(&mut scene, ball, chalk, at * scaled(0.003, 0.003, 0.003));
    }
    scene.cameras = vec![camera([0.0, 0.0, 4.0], [0.0, 0.0, 0.0], perspective(0.6))];
    scene
}

/// Returns random texels a third of a pixel wide everywhere: every pixel has variance, none much more than others.
pub fn noise() -> Scene {
    let mut scene = textures().scene;
    scene.instances.clear();
    scene.geometries.clear();
    let panel = add_geometry(&mut scene, Geometry::Mesh(super::meshes::textured_panel()));
    for i in 0..900 {
        let (x, y) = (f64::from(i % 30) - 14.5, f64::from(i / 30) - 14.5);
        place(
            &mut scene,
            panel,
            (i % 3) as u32,
            moved(0.1 * x, 0.1 * y, 0.0) * scaled(0.1, 0.1, 1.0),
        );
    }
    scene.lights = vec![sun()];
    scene.cameras = vec![camera([0.0, 0.0, 4.0], [0.0, 0.0, 0.0], perspective(0.45))];
    scene
}

fn lit(ambient: [f32; 3]) -> Scene {
    Scene {
        ambient,
        background: Background::Uniform(ambient),
        lights: vec![sun()],
        ..Scene::default()
    }
}

fn sun() -> whit::scene::Light {
    light(
        [2.5, 2.4, 2.2],
        LightKind::Directional {
            to_light: DVec3::new(0.4, 0.7, 0.6).normalize(),
        },
    )
}

fn unit_sphere(scene: &mut Scene) -> u32 {
    add_geometry(scene, Geometry::Shape(Shape::Sphere(Sphere::UNIT)))
}

fn scaled(x: f64, y: f64, z: f64) -> DAffine3 {
    DAffine3::from_scale(DVec3::new(x, y, z))
}
