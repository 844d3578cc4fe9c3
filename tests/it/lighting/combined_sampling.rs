//! Light that reaches rough lobes both by light samples and by rays into the lobes.
//!
//! Metal reflects by its lobe alone, so rays into the lobe alone give the exact image as well, with more or less noise.
//! Both are compared in standard errors.

use glam::{DAffine3, DVec3};
use whit::mesh::Mesh;
use whit::scene::{AlphaMode, Background, Geometry, Instance, Material, MediumKind, Scene};
use whit::shape::{Shape, Sphere, Torus};

use super::rough_render::{close_look, furnace, glass, metal, settings};
use crate::support::emissive_scenes::{emissive_material, square};
use crate::support::images::{add, estimate, rendered, set_environment};

/// Standard errors that two estimates may differ by.
const ERRORS: f64 = 3.0;

/// Returns metal under a dim sky with small bright suns on all sides: rays into wide lobes hardly find them, light
/// samples of narrow lobes hardly the lobe. Lobe rays have the sky alone if there are no light samples.
fn under_suns(roughness: f32, samples: u32) -> Scene {
    let mut scene = furnace(metal(1.0, roughness, 1));
    let mut texels = vec![[0.2, 0.2, 0.2, 1.0]; 64 * 32];
    for row in [4, 8, 12] {
        (0..4).for_each(|sun| texels[row * 64 + 16 * sun + 3] = [60.0; 4]);
    }
    set_environment(&mut scene, [64, 32], texels, samples);
    scene
}

/// Adds a ball of glass, and a pane that lets half of the light pass, before parts of what the origin sees.
fn add_obstacles(scene: &mut Scene, ball: Sphere) {
    let ball = Geometry::Shape(Shape::Sphere(ball));
    let glass = glass(0.0, 0, MediumKind::Solid);
    add(scene, "ball", ball, glass, DAffine3::IDENTITY);
    let mut pane = metal(0.0, 0.5, 0);
    pane.alpha = AlphaMode::Blend;
    pane.base_color[3] = 0.5;
    let place = DAffine3::from_translation(DVec3::new(-0.4, 2.0, 0.9));
    add(scene, "pane", Geometry::Shape(Shape::Quad), pane, place);
}

/// Returns the mean of the image of the origin and its standard error.
fn shown(scene: &Scene) -> (f64, f64) {
    let wo = DVec3::new(0.3, -0.2, 0.9).normalize();
    estimate(&rendered(scene, &close_look(wo), &settings(16, 1024)).image)
}

/// Asserts that both ways to sample give the mean of `by_lobe_rays`, with `gain` times its error at most.
fn assert_agree(what: &str, both: &Scene, by_lobe_rays: &Scene, gain: f64) {
    let [(both, error), (single, single_error)] = [shown(both), shown(by_lobe_rays)];
    println!("{what}: {both} ± {error}, by lobe rays {single} ± {single_error}");
    let bound = ERRORS * error.hypot(single_error);
    assert!(
        (both - single).abs() <= bound,
        "{what}: {both}, not {single} ± {bound}"
    );
    assert!(
        error < gain * single_error,
        "{what}: {error}, {single_error} by lobe rays alone"
    );
}

#[test]
fn environment_seen_by_lobe_rays_and_light_samples_counts_once() {
    for (roughness, gain) in [(0.1, 3.0), (0.3, 1.0), (0.7, 0.7)] {
        let scenes = [1, 0].map(|samples| under_suns(roughness, samples));
        assert_agree(&format!("roughness {roughness}"), &scenes[0], &scenes[1], gain);
    }
}

#[test]
fn environment_behind_glass_and_half_covered_counts_once() {
    for (roughness, gain) in [(0.3, 1.2), (0.7, 0.9)] {
        let scenes = [1, 0].map(|samples| {
            let mut scene = under_suns(roughness, samples);
            let ball = Sphere {
                center: DVec3::new(-0.5, 0.3, 1.6),
                radius: 1.0,
            };
            add_obstacles(&mut scene, ball);
            scene
        });
        assert_agree(&format!("roughness {roughness}"), &scenes[0], &scenes[1], gain);
    }
}

/// Returns small lamps of every kind, with their names.
fn lamps() -> Vec<(&'static str, Geometry)> {
    let bent = Mesh {
        // A roof, so that both halves are seen at different angles
        positions: vec![
            [-1.0, 0.0, 0.4],
            [1.0, 0.0, 0.4],
            [1.0, 1.0, 0.0],
            [-1.0, 1.0, 0.0],
            [1.0, -1.0, 0.0],
            [-1.0, -1.0, 0.0],
        ]
        .into(),
        triangles: vec![[0, 1, 2], [0, 2, 3], [0, 5, 4], [0, 4, 1]].into(),
        ..square()
    };
    let bent = Mesh {
        tex_coords: Vec::new(),
        ..bent
    };
    vec![
        ("sphere", Geometry::Shape(Shape::Sphere(Sphere::UNIT))),
        ("quad", Geometry::Shape(Shape::Quad)),
        ("disk", Geometry::Shape(Shape::Disk)),
        ("mesh", Geometry::Mesh(bent)),
        ("cube", Geometry::Shape(Shape::Cube)),
        (
            "torus",
            Geometry::Shape(Shape::Torus(Torus { minor_radius: 0.3 })),
        ),
    ]
}

/// Returns metal below a lamp, which is an area light if it `is_sampled`.
fn under_lamp(geometry: &Geometry, roughness: f32, is_sampled: bool) -> Scene {
    let mut scene = furnace(metal(1.0, roughness, 1));
    scene.background = Background::default();
    let place = DAffine3::from_translation(DVec3::new(-1.2, 0.5, 2.2))
        * DAffine3::from_rotation_y(0.4)
        * DAffine3::from_scale(DVec3::splat(0.3));
    let lamp = Material {
        emission: [20.0; 3],
        ..emissive_material()
    };
    let lamp = add(&mut scene, "lamp", geometry.clone(), lamp, place);
    if is_sampled {
        scene.add_emissive_light(lamp, 1).unwrap();
    }
    scene
}

#[test]
fn emissive_objects_seen_by_lobe_rays_and_light_samples_count_once() {
    for (what, geometry) in lamps() {
        for (roughness, gain) in [(0.15, 2.0), (0.6, 0.6)] {
            let [both, by_lobe_rays] =
                [true, false].map(|is_sampled| under_lamp(&geometry, roughness, is_sampled));
            assert_agree(
                &format!("{what}, roughness {roughness}"),
                &both,
                &by_lobe_rays,
                gain,
            );
        }
    }
}

#[test]
fn emissive_object_behind_glass_and_half_covered_counts_once() {
    for what in ["sphere", "mesh"] {
        let lamps = lamps();
        let (_, geometry) = lamps.iter().find(|(name, _)| *name == what).unwrap();
        for pane_size in [0.3, 0.6] {
            let [both, by_lobe_rays] = [true, false].map(|is_sampled| {
                let mut scene = under_lamp(geometry, 0.5, is_sampled);
                let ball = Sphere {
                    center: DVec3::new(-1.0, 0.1, 1.2),
                    radius: 0.5,
                };
                add_obstacles(&mut scene, ball);
                // Another pane covers the lamp or a part of it
                let pane = scene.instances.last().unwrap().clone();
                let place = DAffine3::from_translation(DVec3::new(-0.1, 0.9, 0.6))
                    * DAffine3::from_scale(DVec3::splat(pane_size));
                let pane = Instance::new("near pane", pane.geometry, pane.material, place);
                scene.instances.push(pane.unwrap());
                scene
            });
            assert_agree(&format!("{what}, pane of {pane_size}"), &both, &by_lobe_rays, 1.2);
        }
    }
}
