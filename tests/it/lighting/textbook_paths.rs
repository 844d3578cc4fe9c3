//! Interreflection against a reference path tracer, and against a table of radiosity in a cube.
//!
//! Whole images are compared by the means of their regions. Standard errors follow from independent renderings and from
//! independent batches of reference paths.

use std::f64::consts::FRAC_1_PI;
use std::ops::Range;

use glam::{DAffine3, DMat3, DVec3};
use whit::accel::{self, AccelOptions, Backend};
use whit::render::{Monitor, RenderSettings, render};
use whit::scene::{
    Background, Camera, Falloff, Geometry, Interreflection, Light, LightKind, Material, Model, Projection,
    Scene,
};
use whit::shape::{Shape, Sphere};

use super::rough_render::settings;
use crate::support::emissive_scenes::square;
use crate::support::images::add;
use crate::support::textbook_paths::{
    PathObject, PathScene, Pinhole, PointSource, Primitive, Reflection, RegionEstimate, area_light,
    closed_box, diffuse, emissive, mirror, rectangle, sphere,
};

/// Standard errors that a region may differ by, with some hundred comparisons.
const ERRORS: f64 = 4.0;
/// Largest standard error of a region, relative to the mean of the image: larger ones would hide mistakes.
const LARGEST_ERROR: f64 = 0.015;
/// Relative error of the sum of 2e5 numbers in double precision.
const ROUNDING: f64 = 1e-10;
/// Regions per row and column of an image.
const GRID: u32 = 3;
const SEEDS: u32 = 3;
/// Renderings for each seed, or groups of reference paths, from which errors follow.
const BATCHES: u32 = 16;

/// Standard errors that an entry of the table may differ by.
const TABLE_ERRORS: f64 = 3.0;
/// Tolerance of the table beyond that: its own error is at most 2e-4.
const TABLE_TOLERANCE: f64 = 1e-3;
/// Largest standard error of an entry: larger ones would hide mistakes.
const LARGEST_TABLE_ERROR: f64 = 3e-3;

/// Returns a closed room with a red and a green wall and a white rest.
fn room() -> Vec<PathObject> {
    let (red, green, white) = ([0.8, 0.2, 0.15], [0.2, 0.7, 0.3], [0.75; 3]);
    let albedos = [red, green, white, white, white, white];
    closed_box(DVec3::NEG_ONE, DVec3::ONE, albedos)
}

/// Returns a camera that sees most of a room from its front.
fn room_camera() -> Pinhole {
    Pinhole::look_at(DVec3::new(0.1, 0.05, 0.95), DVec3::new(0.0, -0.1, -1.0), 0.8)
}

/// Adds a reference object to a scene of the renderer, and returns its instance. Rectangles are placed squares of the
/// geometry `square`.
fn add_object(scene: &mut Scene, object: &PathObject, square: &Geometry) -> u32 {
    let color = |rgb: DVec3| rgb.as_vec3().to_array();
    // Convert the reflection to glTF's model, without a lobe on diffuse surfaces
    let mut material = match object.reflection {
        Reflection::Diffuse(albedo) => Material::metallic_roughness(color(albedo), 0.0, 1.0),
        Reflection::Mirror(f0) => Material::metallic_roughness(color(f0), 1.0, 0.0),
    };
    if let (Model::MetallicRoughness(model), Reflection::Diffuse(_)) =
        (&mut material.model, object.reflection)
    {
        model.specular = 0.0;
    }
    material.emission = color(object.emission);
    // Place the primitive
    let (geometry, place) = match object.primitive {
        Primitive::Sphere { center, radius } => {
            let sphere = Shape::Sphere(Sphere { center, radius });
            (Geometry::Shape(sphere), DAffine3::IDENTITY)
        }
        Primitive::Rectangle {
            center,
            half_u,
            half_v,
        } => {
            let normal = half_u.cross(half_v).normalize();
            let axes = DMat3::from_cols(half_u, half_v, normal);
            (square.clone(), DAffine3::from_mat3_translation(axes, center))
        }
        Primitive::Plane { point, normal } => {
            let (x, y) = normal.any_orthonormal_pair();
            let axes = DMat3::from_cols(x, y, normal);
            let place = DAffine3::from_mat3_translation(axes, point);
            (Geometry::Shape(Shape::Plane), place)
        }
    };
    add(scene, "object", geometry, material, place)
}

/// Returns the scene of the renderer with the same objects and lights, whose area lights have `samples` samples.
fn rendered_scene(paths: &PathScene, square: &Geometry, samples: u32) -> Scene {
    let mut scene = Scene {
        interreflection: Some(Interreflection {
            bounces: paths.bounces,
        }),
        background: Background::Uniform(paths.sky.as_vec3().to_array()),
        ..Scene::default()
    };
    for object in &paths.objects {
        let instance = add_object(&mut scene, object, square);
        if object.is_area_light {
            scene.add_emissive_light(instance, samples).unwrap();
        }
    }
    for light in &paths.point_lights {
        scene.lights.push(Light {
            name: "lamp".into(),
            intensity: light.intensity.as_vec3().to_array(),
            kind: LightKind::Point {
                position: light.position,
                falloff: Falloff::InverseSquare { range: None },
            },
        });
    }
    scene
}

fn rendered_camera(camera: &Pinhole) -> Camera {
    let [right, up, forward] = camera.axes;
    Camera {
        world_from_camera: DAffine3::from_mat3_translation(DMat3::from_cols(right, up, -forward), camera.eye),
        projection: Projection::Perspective {
            y_fov: 2.0 * camera.half_size.atan(),
            aspect: None,
        },
        ..Camera::default()
    }
}

/// Returns the means of `grid` by `grid` regions of renderings with the seeds from `first_seed` on, one list for each
/// rendering.
fn region_means(
    scene: &Scene,
    camera: &Camera,
    grid: u32,
    settings: &RenderSettings,
    seeds: Range<u32>,
) -> Vec<Vec<DVec3>> {
    let scene = scene.validate().unwrap();
    let accel = accel::build(scene, Backend::Bsp, &AccelOptions::default()).unwrap();
    let edge = settings.width / grid;
    let means = |seed: u32| {
        let settings = RenderSettings { seed, ..*settings };
        let rendering = render(scene, camera, &*accel, &settings, &Monitor::default()).unwrap();
        let mut sums = vec![DVec3::ZERO; (grid * grid) as usize];
        for (index, pixel) in (0..).zip(&rendering.image.pixels) {
            let (x, y) = (index % settings.width, index / settings.width);
            sums[(y / edge * grid + x / edge) as usize] += DVec3::from(pixel.map(f64::from));
        }
        let means = sums.into_iter().map(|sum| sum / f64::from(edge * edge));
        means.collect::<Vec<_>>()
    };
    seeds.map(means).collect()
}

/// Number of paths that a comparison takes.
struct Effort {
    /// Samples per pixel of each rendering.
    spp: u32,
    /// Reference paths per region and batch.
    paths: u32,
}

/// Asserts that regions of the renderer's images, and whole images, have the radiance of the reference.
fn assert_same_regions(what: &str, paths: &PathScene, camera: &Pinhole, square: &Geometry, effort: &Effort) {
    let exact = paths.region_estimates(camera, GRID, BATCHES, effort.paths);
    let image = RegionEstimate::average(&exact);
    let scene = rendered_scene(paths, square, 2);
    let settings = RenderSettings {
        depth: paths.mirror_steps,
        ..settings(4 * GRID, effort.spp)
    };
    let seeds = 0..SEEDS * BATCHES;
    let batches = region_means(&scene, &rendered_camera(camera), GRID, &settings, seeds);
    let largest_error = LARGEST_ERROR * image.mean;
    for (region, exact) in exact.iter().enumerate() {
        let values: Vec<DVec3> = batches.iter().map(|means| means[region]).collect();
        assert_same(&format!("{what}, region {region}"), &values, exact, largest_error);
    }
    let average = |means: &Vec<DVec3>| means.iter().sum::<DVec3>() / means.len() as f64;
    let values: Vec<DVec3> = batches.iter().map(average).collect();
    assert_same(&format!("{what}, image"), &values, &image, largest_error);
}

/// Asserts for each seed that the mean of its batches is that of the reference, and that errors are small.
fn assert_same(what: &str, values: &[DVec3], exact: &RegionEstimate, largest_error: DVec3) {
    let seeds = values.chunks(BATCHES as usize);
    let estimates: Vec<RegionEstimate> = seeds.map(RegionEstimate::of_batches).collect();
    // All seeds have the same error, of which each gives an estimate
    let squares = estimates.iter().map(|estimate| estimate.error * estimate.error);
    let square = squares.sum::<DVec3>() / f64::from(SEEDS) + exact.error * exact.error;
    for channel in 0..3 {
        let (expected, error) = (exact.mean[channel], square[channel].sqrt());
        for (seed, estimate) in estimates.iter().enumerate() {
            let found = estimate.mean[channel];
            let off = (found - expected) / error;
            println!(
                "{what}, channel {channel}, seed {seed}: {found:.5}, expected {expected:.5} ± {error:.5}, \
                 {off:+.1} errors"
            );
            assert!(
                off.abs() <= ERRORS,
                "{what}, channel {channel}: {found}, not {expected} ± {error}"
            );
        }
        let largest = largest_error[channel];
        assert!(error <= largest, "{what}: the error {error} exceeds {largest}");
    }
}

#[test]
fn ball_in_a_room_under_a_panel_is_lit_as_by_the_reference() {
    let mut objects = room();
    let panel = rectangle([0.1, 0.9, -0.2], 0.5 * DVec3::X, 0.4 * DVec3::Z);
    objects.push(emissive(panel, [0.5; 3], [6.0, 5.0, 4.0]));
    objects.push(diffuse(sphere([0.3, -0.55, -0.3], 0.4), [0.3, 0.5, 0.85]));
    let scene = PathScene {
        objects,
        point_lights: Vec::new(),
        sky: DVec3::ZERO,
        bounces: 3,
        mirror_steps: 1,
    };
    let effort = Effort {
        spp: 160,
        paths: 15_000,
    };
    let quad = Geometry::Shape(Shape::Quad);
    assert_same_regions("panel", &scene, &room_camera(), &quad, &effort);
}

#[test]
fn mirrors_in_a_room_reflect_an_emissive_ball_as_in_the_reference() {
    let mut objects = room();
    let emission = [3.0, 4.0, 5.0];
    objects.push(emissive(sphere([-0.35, 0.3, -0.3], 0.35), [0.4; 3], emission));
    objects.push(mirror(sphere([0.45, -0.45, -0.35], 0.45), [0.95, 0.8, 0.6]));
    let panel = rectangle([-0.96, 0.0, 0.0], 0.8 * DVec3::Z, 0.8 * DVec3::Y);
    objects.push(mirror(panel, [0.9; 3]));
    let scene = PathScene {
        objects,
        point_lights: Vec::new(),
        sky: DVec3::ZERO,
        bounces: 2,
        mirror_steps: 2,
    };
    let effort = Effort {
        spp: 96,
        paths: 10_000,
    };
    let mesh = Geometry::Mesh(square());
    assert_same_regions("mirrors", &scene, &room_camera(), &mesh, &effort);
}

#[test]
fn wall_under_the_sky_and_a_point_light_is_lit_as_by_the_reference() {
    let floor = Primitive::Plane {
        point: DVec3::NEG_Y,
        normal: DVec3::Y,
    };
    let wall = rectangle([-0.2, 0.0, -0.8], 1.5 * DVec3::X, DVec3::Y);
    let scene = PathScene {
        objects: vec![
            diffuse(floor, [0.6, 0.55, 0.4]),
            diffuse(wall, [0.8, 0.3, 0.3]),
            diffuse(sphere([-0.5, -0.5, -0.2], 0.5), [0.3, 0.5, 0.85]),
            mirror(sphere([0.6, -0.6, -0.1], 0.4), [0.9, 0.9, 0.7]),
        ],
        point_lights: vec![PointSource {
            position: DVec3::new(0.4, 0.8, 0.1),
            intensity: DVec3::new(3.0, 2.5, 1.5),
        }],
        sky: DVec3::new(0.3, 0.5, 0.9),
        bounces: 2,
        mirror_steps: 3,
    };
    let camera = Pinhole::look_at(DVec3::new(0.3, 0.2, 2.5), DVec3::new(0.0, -0.3, 0.0), 0.55);
    let effort = Effort {
        spp: 64,
        paths: 15_000,
    };
    let quad = Geometry::Shape(Shape::Quad);
    assert_same_regions("sky", &scene, &camera, &quad, &effort);
}

#[test]
fn sampled_and_unsampled_lights_add_up_as_in_the_reference() {
    for (name, geometry, bounces) in [
        ("mesh", Geometry::Mesh(square()), 1),
        ("quad", Geometry::Shape(Shape::Quad), 4),
    ] {
        let mut objects = room();
        let lamp = sphere([-0.4, 0.3, -0.4], 0.25);
        objects.push(area_light(lamp, [0.3; 3], [2.0, 4.0, 6.0]));
        let turned = DVec3::new(0.0, 0.3, 0.3);
        let panel = rectangle([0.5, 0.6, -0.3], 0.4 * DVec3::X, turned);
        objects.push(area_light(panel, [0.5; 3], [4.0, 3.0, 1.0]));
        let panel = rectangle([0.0, -0.98, -0.2], 0.3 * DVec3::X, 0.4 * DVec3::Z);
        objects.push(emissive(panel, [0.5; 3], [0.5, 1.0, 2.0]));
        objects.push(mirror(sphere([0.45, -0.5, -0.35], 0.4), [0.95, 0.8, 0.6]));
        let scene = PathScene {
            objects,
            point_lights: Vec::new(),
            sky: DVec3::ZERO,
            bounces,
            mirror_steps: 5,
        };
        let effort = Effort {
            spp: 32,
            paths: 10_000,
        };
        assert_same_regions(name, &scene, &room_camera(), &geometry, &effort);
    }
}

/// Asserts that the reference sees `exact` from `eye` in a direction.
fn assert_reference(what: &str, scene: &PathScene, eye: DVec3, direction: DVec3, exact: f64) {
    let estimate = scene.ray_estimate(eye, direction, 200_000);
    let (found, error) = (estimate.mean.x, estimate.error.x);
    println!("{what}: {found:.6} ± {error:.6}, exactly {exact:.6}");
    assert!(
        (found - exact).abs() <= ERRORS * error + ROUNDING * exact,
        "{what}: {found} ± {error}, not {exact}"
    );
    assert!(error < LARGEST_ERROR * exact, "{what}: ± {error}");
}

#[test]
fn reference_has_closed_forms_of_diffuse_light() {
    let dark = PathScene {
        objects: Vec::new(),
        point_lights: Vec::new(),
        sky: DVec3::ZERO,
        bounces: 3,
        mirror_steps: 1,
    };
    let (rho, emission) = (0.5, 1.5);
    let series = |terms: i32| emission * (1.0 - f64::powi(rho, terms)) / (1.0 - rho);
    let ball = sphere([0.3, 0.0, 0.0], 1.0);
    let everywhere = |objects| PathScene {
        objects,
        ..dark.clone()
    };
    // Bounces in a closed room that emits everywhere are a geometric series, with a term more for area lights
    let toward = DVec3::new(0.1, 0.7, 0.4);
    let emissive_ball = everywhere(vec![emissive(ball, [rho; 3], [emission; 3])]);
    assert_reference("sphere", &emissive_ball, DVec3::ZERO, toward, series(4));
    let sampled_ball = everywhere(vec![area_light(ball, [rho; 3], [emission; 3])]);
    assert_reference("area light", &sampled_ball, DVec3::ZERO, toward, series(5));
    let mut faces = closed_box(DVec3::NEG_ONE, DVec3::ONE, [[rho; 3]; 6]);
    for face in &mut faces {
        face.emission = DVec3::splat(emission);
    }
    assert_reference("box", &everywhere(faces), DVec3::ZERO, toward, series(4));
    // A ball above a floor hides the share cos (r / d)² of the sky, and a mirror reflects F0 + (1 - F0) (1 - cos)⁵
    let floor = Primitive::Plane {
        point: DVec3::ZERO,
        normal: DVec3::Y,
    };
    let black = diffuse(sphere([0.0, 2.0, 0.0], 1.0), [0.0; 3]);
    let mut under_sky = everywhere(vec![diffuse(floor, [rho; 3]), black]);
    under_sky.sky = DVec3::splat(2.0);
    let eye = DVec3::new(-1.5, 1.0, 0.0);
    assert_reference("floor", &under_sky, eye, -eye, rho * 2.0 * (1.0 - 0.25));
    under_sky.objects = vec![mirror(floor, [0.6; 3])];
    let fresnel = 0.6 + 0.4 * (1.0 - 1.0 / eye.length()).powi(5);
    assert_reference("mirror", &under_sky, eye, -eye, fresnel * 2.0);
    // A point light has the irradiance I cos / d², and is hidden by a ball in front of it
    let mut lit = everywhere(vec![diffuse(floor, [rho; 3]), black]);
    lit.point_lights = vec![PointSource {
        position: DVec3::new(3.0, 4.0, 0.0),
        intensity: DVec3::splat(50.0),
    }];
    let exact = FRAC_1_PI * rho * 50.0 * 0.8 / 25.0;
    assert_reference("point light", &lit, eye, -eye, exact);
    lit.objects[1].primitive = sphere([1.5, 2.0, 0.0], 0.5);
    let shadowed = lit.ray_estimate(eye, -eye, 1000);
    assert_eq!(shadowed.mean, DVec3::ZERO);
}

/// Part of a face of the unit cube that the table has values for.
struct Patch {
    name: &'static str,
    center: [f64; 3],
    /// Normal of the face, into the cube.
    normal: DVec3,
    /// Half the edge of the patch; small for values at a point.
    half_size: f64,
    /// Radiosity for each choice of albedos.
    radiosity: [f64; 3],
}

/// Half the edge of the patches that stand for points.
const POINT: f64 = 1e-6;

/// Radiosity in the unit cube whose ceiling y = 1 emits the radiosity 1, by patches with exact form factors. Columns
/// are those of [`TABLE_ALBEDOS`].
const TABLE: [Patch; 8] = {
    const fn patch(
        name: &'static str,
        center: [f64; 3],
        normal: DVec3,
        half_size: f64,
        radiosity: [f64; 3],
    ) -> Patch {
        Patch {
            name,
            center,
            normal,
            half_size,
            radiosity,
        }
    }
    let (x, y) = (DVec3::X, DVec3::Y);
    let (left, right) = ([0.0, 0.5, 0.5], [1.0, 0.5, 0.5]);
    let (floor, ceiling) = ([0.5, 0.0, 0.5], [0.5, 1.0, 0.5]);
    [
        patch("floor", floor, y, 0.5, [0.17122, 0.66098, 0.26937]),
        patch("ceiling", ceiling, DVec3::NEG_Y, 0.5, [1.1044, 1.5875, 1.1804]),
        patch("wall x = 0", left, x, 0.5, [0.18111, 0.68788, 0.25039]),
        patch(
            "wall x = 1",
            right,
            DVec3::NEG_X,
            0.5,
            [0.18111, 0.68788, 0.04413],
        ),
        patch("centre of floor", floor, y, POINT, [0.19761, 0.7131, 0.3072]),
        patch(
            "floor (0.25, 0.25)",
            [0.25, 0.0, 0.25],
            y,
            POINT,
            [0.17753, 0.6747, 0.2907],
        ),
        patch(
            "floor (0.1, 0.1)",
            [0.1, 0.0, 0.1],
            y,
            POINT,
            [0.14840, 0.61290, 0.25297],
        ),
        patch(
            "centre of wall x = 0",
            left,
            x,
            POINT,
            [0.17765, 0.68366, 0.23827],
        ),
    ]
};

/// Albedos of the faces of the cube, in the order of [`closed_box`], for each column of the table.
const TABLE_ALBEDOS: [[f64; 6]; 3] = [[0.5; 6], [0.8; 6], [0.6, 0.1, 0.7, 0.7, 0.7, 0.7]];

/// Asserts that the patches of a column of the table have its radiosity; the ceiling has light samples if its emission
/// is that of an area light.
fn assert_column(column: usize, is_area_light: bool, spp: u32) {
    let albedos = TABLE_ALBEDOS[column].map(|albedo| [albedo; 3]);
    let mut paths = PathScene {
        objects: closed_box(DVec3::ZERO, DVec3::ONE, albedos),
        point_lights: Vec::new(),
        sky: DVec3::ZERO,
        bounces: Interreflection::MAX_BOUNCES,
        mirror_steps: 1,
    };
    let ceiling = &mut paths.objects[3];
    ceiling.emission = DVec3::splat(FRAC_1_PI);
    ceiling.is_area_light = is_area_light;
    let scene = rendered_scene(&paths, &Geometry::Shape(Shape::Quad), 1);
    for (patch, first_seed) in TABLE.iter().zip((0..).step_by(BATCHES as usize)) {
        let (x, y) = patch.normal.any_orthonormal_pair();
        let place = DVec3::from(patch.center) + 0.5 * patch.normal;
        let camera = Camera {
            world_from_camera: DAffine3::from_mat3_translation(DMat3::from_cols(x, y, patch.normal), place),
            projection: Projection::Orthographic {
                y_mag: patch.half_size,
                x_mag: None,
            },
            ..Camera::default()
        };
        let means = region_means(
            &scene,
            &camera,
            1,
            &settings(16, spp),
            first_seed..first_seed + BATCHES,
        );
        let values: Vec<DVec3> = means.iter().map(|means| means[0] / FRAC_1_PI).collect();
        let estimate = RegionEstimate::of_batches(&values);
        let (found, error, exact) = (estimate.mean[1], estimate.error[1], patch.radiosity[column]);
        println!(
            "{}, column {column}, area light {is_area_light}: {found:.5} ± {error:.5}, expected {exact:.5}, {:+.1}",
            patch.name,
            (found - exact) / error
        );
        assert!(
            (found - exact).abs() <= TABLE_ERRORS * error + TABLE_TOLERANCE,
            "{}, column {column}: {found} ± {error}, not {exact}",
            patch.name
        );
        assert!(error < LARGEST_TABLE_ERROR, "{}: ± {error}", patch.name);
    }
}

#[test]
fn cube_with_an_emissive_ceiling_has_the_radiosity_of_the_table() {
    for (column, spp) in [16, 64, 16].into_iter().enumerate() {
        assert_column(column, false, spp);
    }
}

#[test]
fn cube_under_an_area_light_has_the_radiosity_of_the_table() {
    for (column, spp) in [4, 16, 8].into_iter().enumerate() {
        assert_column(column, true, spp);
    }
}
