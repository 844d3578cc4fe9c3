//! Tests of AOVs of camera-ray hits: depth, normals, albedo, positions, texture coordinates, ids and motion, against
//! closed forms; and that requesting AOVs changes no bit of the image. Cryptomatte has its own tests.

use std::f64::consts::FRAC_PI_4;
use std::path::Path;

use crate::support::cli_program::{fails_with, whit};
use crate::support::images::{add, rendered, settings};
use crate::support::scene_folder;
use glam::{DAffine3, DVec2, DVec3};
use whit::accel::{self, AccelOptions, Backend};
use whit::image::ChannelKind;
use whit::image::rows::ExrScanlineReader;
use whit::mesh::Mesh;
use whit::render::{
    AovKind, AovSet, FilterKind, Monitor, Parts, Pattern, PixelFilter, Region, RenderSettings, Rendering,
};
use whit::scene::{Camera, Geometry, Instance, Material, Model, Phong, Scene, Shutter};
use whit::shape::{Shape, Sphere};

/// Relative tolerance: f32 rounds rays and results; sums of a few such numbers have this error, relative to the
/// largest.
const ROUNDING: f64 = 8.0 * f32::EPSILON as f64;

/// Number of layers: 15 of means and ids, two of motion, twelve of each Cryptomatte.
const LAYERS: usize = 15 + 2 + 24;

fn all() -> AovSet {
    AovKind::ALL.into_iter().collect()
}

/// Returns settings with all layers for a square image of `size`² pixels.
fn with_layers(size: u32, spp: u32) -> RenderSettings {
    RenderSettings {
        layers: all(),
        pattern: Pattern::Regular,
        ..settings(size, spp)
    }
}

fn values<'r>(rendering: &'r Rendering, name: &str) -> &'r [f32] {
    let mut layers = rendering.layers.iter();
    &layers.find(|layer| layer.name == name).unwrap().values
}

/// Returns three layers of one pixel as a vector.
fn vector(rendering: &Rendering, names: [&str; 3], pixel: usize) -> DVec3 {
    DVec3::from(names.map(|name| f64::from(values(rendering, name)[pixel])))
}

const NORMAL: [&str; 3] = ["normal.X", "normal.Y", "normal.Z"];
const ALBEDO: [&str; 3] = ["albedo.R", "albedo.G", "albedo.B"];
const POSITION: [&str; 3] = ["position.X", "position.Y", "position.Z"];

fn camera(z: f64) -> Camera {
    Camera {
        world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 0.0, z)),
        ..Camera::default()
    }
}

/// Returns the unit sphere at the origin seen from (0, 0, 5).
fn ball() -> Scene {
    let mut scene = Scene::default();
    let sphere = Geometry::Shape(Shape::Sphere(Sphere::UNIT));
    add(
        &mut scene,
        "ball",
        sphere,
        Material::default(),
        DAffine3::IDENTITY,
    );
    scene
}

#[test]
fn frontal_wall_has_depth_position_normal_and_ids() {
    let mut scene = Scene::default();
    let quad = || Geometry::Shape(Shape::Quad);
    // Add an object behind the wall, so that index 0 belongs to nothing visible.
    let behind = DAffine3::from_translation(DVec3::new(0.0, 0.0, -9.0));
    add(&mut scene, "behind", quad(), Material::default(), behind);
    // Turn the wall away, so that its back is seen: the normal is still on the viewer's side.
    let wall = DAffine3::from_rotation_y(std::f64::consts::PI) * DAffine3::from_scale(DVec3::splat(3.0));
    add(&mut scene, "wall", quad(), Material::default(), wall);
    let camera = camera(5.0);
    let size = 8;
    let seen = rendered(&scene, &camera, &with_layers(size, 1));
    let view = camera.view(size, size);
    for pixel in 0..(size * size) as usize {
        let at = |index: usize| (index as f64 + 0.5) / f64::from(size);
        let (x, y) = (at(pixel % size as usize), at(pixel / size as usize));
        let ray = view.ray(x, y);
        // Intersect the plane z = 0.
        let p = ray.origin - ray.direction * (ray.origin.z / ray.direction.z);
        let depth = f64::from(values(&seen, "Z")[pixel]);
        assert!(
            (depth - p.distance(DVec3::Z * 5.0)).abs() <= 5.0 * ROUNDING,
            "{depth}"
        );
        assert!(vector(&seen, POSITION, pixel).distance(p) <= 5.0 * ROUNDING);
        assert!(vector(&seen, NORMAL, pixel).distance(DVec3::Z) <= ROUNDING);
        assert_eq!(values(&seen, "id.object")[pixel], 1.0);
        assert_eq!(values(&seen, "id.material")[pixel], 1.0);
    }
}

#[test]
fn sphere_layers_end_at_its_silhouette() {
    let size = 33;
    let seen = rendered(&ball(), &camera(5.0), &with_layers(size, 1));
    let view = camera(5.0).view(size, size);
    let mut missed = 0;
    for pixel in 0..(size * size) as usize {
        let at = |index: usize| (index as f64 + 0.5) / f64::from(size);
        let ray = view.ray(at(pixel % size as usize), at(pixel / size as usize));
        // Solve |5 z + t d|² = 1 for a unit d: t² + 10 dz t + 24 = 0.
        let dz = ray.direction.normalize().z;
        let discriminant = 25.0 * dz * dz - 24.0;
        let depth = f64::from(values(&seen, "Z")[pixel]);
        if discriminant > 0.0 {
            let expected = -5.0 * dz - discriminant.sqrt();
            // Near the silhouette a small error of the ray moves the hit by much more.
            let bound = 25.0 * ROUNDING / discriminant.sqrt();
            assert!((depth - expected).abs() <= bound, "{depth} for {expected}");
            let normal = vector(&seen, NORMAL, pixel);
            assert!(normal.distance(vector(&seen, POSITION, pixel)) <= ROUNDING);
            assert_eq!(values(&seen, "id.object")[pixel], 0.0);
        } else {
            missed += 1;
            assert_eq!(depth, f64::INFINITY);
            assert_eq!(vector(&seen, NORMAL, pixel), DVec3::ZERO);
            for name in ["id.object", "id.material", "id.primitive"] {
                assert_eq!(values(&seen, name)[pixel], -1.0);
            }
        }
    }
    assert!(missed > 100 && missed < size * size - 100);
}

#[test]
fn missed_samples_are_excluded_from_the_mean() {
    // Pixels are so large that hardly any lies within the sphere: if misses were counted, depths would be under 4.
    let seen = rendered(&ball(), &camera(5.0), &with_layers(7, 64));
    let depths = values(&seen, "Z").iter().filter(|depth| depth.is_finite());
    let depths: Vec<f32> = depths.copied().collect();
    // The largest distance is that of tangent points.
    let farthest = 24f32.sqrt();
    assert!(
        depths.iter().all(|depth| (4.0..=farthest).contains(depth)),
        "{depths:?}"
    );
    let ids = values(&seen, "id.object");
    assert_eq!(depths.len(), ids.iter().filter(|&&id| id == 0.0).count());
    assert!((4..49).contains(&depths.len()));
}

#[test]
fn albedo_matches_the_lit_colour_of_both_models() {
    let mut scene = Scene::default();
    let wall = |x: f64| {
        DAffine3::from_translation(DVec3::new(x, 0.0, 0.0)) * DAffine3::from_scale(DVec3::splat(3.0))
    };
    // Add one wall with each reflection model
    let base_color = [0.25, 0.5, 0.75, 1.0];
    let gltf = Material {
        base_color,
        ..Material::default()
    };
    let phong = Material {
        base_color,
        model: Model::Phong(Phong {
            diffuse: [0.5, 0.5, 1.0],
            ..Phong::DEFAULT
        }),
        ..Material::default()
    };
    let quad = || Geometry::Shape(Shape::Quad);
    add(&mut scene, "left", quad(), gltf, wall(-3.0));
    add(&mut scene, "right", quad(), phong, wall(3.0));
    let seen = rendered(&scene, &camera(5.0), &with_layers(4, 16));
    // Compare with the base colour, times Phong's diffuse coefficient on the right
    for row in 0..4 {
        assert_eq!(vector(&seen, ALBEDO, 4 * row), DVec3::new(0.25, 0.5, 0.75));
        assert_eq!(vector(&seen, ALBEDO, 4 * row + 3), DVec3::new(0.125, 0.25, 0.75));
    }
    // Only the albedo layers are colours
    let albedo = seen
        .layers
        .iter()
        .filter(|layer| layer.kind == ChannelKind::Color);
    assert_eq!(albedo.map(|layer| &layer.name[..]).collect::<Vec<_>>(), ALBEDO);
}

#[test]
fn texture_coordinates_match_shapes_and_meshes() {
    let mesh = Mesh {
        positions: vec![
            [-1.0, -1.0, 0.0],
            [1.0, -1.0, 0.0],
            [1.0, 1.0, 0.0],
            [-1.0, 1.0, 0.0],
        ]
        .into(),
        triangles: vec![[0, 1, 2], [0, 2, 3]].into(),
        // Eight times a shape's.
        tex_coords: vec![vec![[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]].into()],
        ..Mesh::default()
    };
    let without = Mesh {
        tex_coords: Vec::new(),
        ..mesh.clone()
    };
    let quads = [
        (Geometry::Shape(Shape::Quad), 1.0),
        (Geometry::Mesh(mesh), 8.0),
        (Geometry::Mesh(without), 0.0),
    ];
    // Compare coordinates with the position, for each kind of wall
    for (quad, times) in quads {
        let mut scene = Scene::default();
        let place = DAffine3::from_scale(DVec3::splat(3.0));
        add(&mut scene, "wall", quad, Material::default(), place);
        // The position determines the coordinates
        let seen = rendered(&scene, &camera(5.0), &with_layers(6, 4));
        for pixel in 0..36 {
            let p = vector(&seen, POSITION, pixel);
            for (name, along) in [("uv.U", p.x), ("uv.V", p.y)] {
                let expected = times * 0.5 * (along / 3.0 + 1.0);
                let found = f64::from(values(&seen, name)[pixel]);
                assert!(
                    (found - expected).abs() <= times * ROUNDING,
                    "{found} for {expected}"
                );
            }
        }
    }
}

#[test]
fn positions_and_depths_use_file_units() {
    // The scene is so large and far away that it is translated and scaled before rendering.
    let center = DVec3::new(3e6, 0.0, 0.0);
    let mut scene = Scene::default();
    let place = DAffine3::from_translation(center) * DAffine3::from_scale(DVec3::splat(3e4));
    add(
        &mut scene,
        "wall",
        Geometry::Shape(Shape::Quad),
        Material::default(),
        place,
    );
    scene.cameras.push(Camera {
        world_from_camera: DAffine3::from_translation(center + 5e4 * DVec3::Z),
        ..Camera::default()
    });
    scene.normalise();
    assert!(!scene.normalisation.is_identity());
    // The only sample of the only pixel is in its middle.
    let seen = rendered(&scene, &scene.cameras[0], &with_layers(1, 1));
    assert!((f64::from(values(&seen, "Z")[0]) - 5e4).abs() <= 5e4 * ROUNDING);
    assert!(vector(&seen, POSITION, 0).distance(center) <= center.length() * ROUNDING);
}

/// Returns a square wall that moves between two transforms while the shutter is open.
fn moving_wall(ends: [DAffine3; 2]) -> Scene {
    let mut scene = Scene::default();
    scene.geometries.push(Geometry::Shape(Shape::Quad));
    scene.materials.push(Material::default());
    scene
        .instances
        .push(Instance::moving("wall", 0, 0, ends).unwrap());
    scene
}

#[test]
fn moving_wall_has_its_motion_in_pixels() {
    let scale = DAffine3::from_scale(DVec3::splat(3.0));
    let step = DVec3::new(0.5, -0.25, 0.0);
    let (camera, size) = (camera(5.0), 12);
    // At a distance of 5 the image's height is 10 tan(45 deg / 2); y is up in the world and down in the image.
    let pixel = 10.0 * (0.5 * FRAC_PI_4).tan() / f64::from(size);
    let expected = step.truncate() * DVec2::new(1.0, -1.0) / pixel;
    for part in [1.0, 0.5] {
        let scene = moving_wall([scale, DAffine3::from_translation(step) * scale]);
        let camera = Camera {
            shutter: Shutter {
                open: 0.0,
                close: part,
            },
            ..camera.clone()
        };
        let seen = rendered(&scene, &camera, &with_layers(size, 4));
        for pixel in 0..(size * size) as usize {
            let motion = ["motion.X", "motion.Y"].map(|name| f64::from(values(&seen, name)[pixel]));
            let error = (DVec2::from(motion) - part * expected).length();
            // Positions are accurate to the rounding of rays, and motions are within some ten pixels.
            assert!(
                error <= f64::from(size) * ROUNDING,
                "{motion:?} for {}",
                part * expected
            );
        }
    }
}

#[test]
fn approaching_objects_move_outward_and_still_ones_do_not() {
    let scale = DAffine3::from_scale(DVec3::splat(9.0));
    let nearer = DAffine3::from_translation(DVec3::Z) * scale;
    let size = 6;
    let seen = rendered(&moving_wall([scale, nearer]), &camera(5.0), &with_layers(size, 4));
    let still = rendered(&moving_wall([scale, scale]), &camera(5.0), &with_layers(size, 4));
    let corner = |seen: &Rendering| ["motion.X", "motion.Y"].map(|name| values(seen, name)[0]);
    let [x, y] = corner(&seen);
    assert!(x < 0.0 && y < 0.0, "{x} {y}");
    assert_eq!(corner(&still), [0.0; 2]);
}

/// Returns settings for a small image with many effects.
fn small(filter: FilterKind) -> RenderSettings {
    RenderSettings {
        width: 45,
        height: 37,
        spp: 4,
        filter: PixelFilter::of_kind(filter),
        depth: 3,
        ..RenderSettings::default()
    }
}

#[test]
fn layers_do_not_change_image_bits() {
    // Scenes that together use most effects
    let scenes = [
        "glass_of_water.toml",
        "prism.toml",
        "smoke.toml",
        "soft_shadows.toml",
        "motion.toml",
        "depth_of_field.toml",
        "textured.toml",
        "foliage.toml",
    ];
    for name in scenes {
        let scene = scene_folder::named(name).scene;
        for filter in [FilterKind::Box, FilterKind::Mitchell] {
            let without = RenderSettings {
                width: 20,
                height: 15,
                spp: 2,
                ..small(filter)
            };
            let with = RenderSettings {
                layers: all(),
                ..without
            };
            // Render with and without layers
            let plain = rendered(&scene, &scene.cameras[0], &without);
            let layered = rendered(&scene, &scene.cameras[0], &with);
            assert_eq!(plain.image.pixels, layered.image.pixels, "{name}");
            assert_eq!((plain.layers.len(), layered.layers.len()), (0, LAYERS));
            let depths = values(&layered, "Z");
            assert!(depths.iter().any(|depth| depth.is_finite()), "{name}");
        }
    }
}

#[test]
fn region_layers_match_the_full_image_bits() {
    let scene = scene_folder::named("textured.toml").scene;
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    let camera = &scene.cameras[0];
    for filter in [FilterKind::Box, FilterKind::Mitchell] {
        let settings = RenderSettings {
            layers: all(),
            ..small(filter)
        };
        let whole = rendered(&scene, camera, &settings);
        let mut parts = Parts::new(
            (scene.validate().unwrap(), camera),
            &*accel,
            &settings,
            &Monitor::default(),
        )
        .unwrap();
        for [x, y, width, height] in [[0, 32, 45, 5], [30, 7, 9, 28], [44, 36, 1, 1]] {
            let region = Region { x, y, width, height };
            let part = parts.region(&region, &Monitor::default()).unwrap();
            for (layer, all) in part.layers.iter().zip(&whole.layers) {
                let rows = all.values.chunks(45).skip(y as usize).take(height as usize);
                let shown = rows.flat_map(|row| &row[x as usize..(x + width) as usize]);
                assert_eq!(layer.name, all.name);
                assert!(layer.values.iter().eq(shown), "{} of {region:?}", all.name);
            }
            assert_eq!(part.layers.len(), LAYERS);
        }
    }
}

#[test]
fn only_requested_layers_exist_and_are_unchanged() {
    let scene = scene_folder::named("textured.toml").scene;
    let camera = &scene.cameras[0];
    let of = |layers: AovSet| {
        let settings = RenderSettings {
            layers,
            ..small(FilterKind::Box)
        };
        rendered(&scene, camera, &settings).layers
    };
    let together = of(all());
    let mut alone = Vec::new();
    for kind in AovKind::ALL {
        let layers = of(AovSet::NONE.with(kind));
        let names: Vec<&str> = layers.iter().map(|layer| &layer.name[..]).collect();
        assert_eq!(names, kind.names());
        alone.extend(layers);
    }
    assert!(alone == together);
}

const BALL: &str = "[camera]\nfrom = [0, 0, 5]\nat = [0, 0, 0]\n\n[[light]]\nkind = \"directional\"\ndirection = [0, 0, -1]\n\n\
                    [material.red]\nbase_color = [0.8, 0.1, 0.1]\n\n[[object]]\nshape = \"sphere\"\nmaterial = \"red\"\n";

#[test]
fn half_files_store_only_colours_as_halves() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (scene, image) = (path("ball.toml"), path("ball.exr"));
    // Render a file of halves with all layers
    std::fs::write(&scene, BALL).unwrap();
    let aovs = "depth,normal,albedo,position,uv,ids,motion,crypto-object,crypto-material";
    let run = whit(&[
        "render",
        &scene,
        "-o",
        &image,
        "--size",
        "9x9",
        "--backend",
        "bsp",
        "--exr-type",
        "half",
        "--aov",
        aovs,
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    // Check the types of the channels
    let mut reader = ExrScanlineReader::open(Path::new(&image)).unwrap();
    let mut kinds: Vec<String> = Vec::new();
    for channel in reader.channels() {
        kinds.push(format!("{} {:?}", channel.name, channel.sample));
    }
    for wanted in [
        "R Half",
        "Z Float",
        "albedo.G Half",
        "normal.X Float",
        "id.primitive Float",
        "uv.V Float",
        "motion.Y Float",
        "CryptoObject00.R Float",
        "CryptoMaterial02.A Float",
    ] {
        assert!(kinds.iter().any(|kind| kind == wanted), "{wanted}: {kinds:?}");
    }
    // Check the number of channels
    assert_eq!(kinds.len(), 3 + LAYERS);
    assert_eq!(reader.read_rows(0..9).unwrap().len(), 3 + LAYERS);
}

#[test]
fn layers_with_unequal_samples_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (scene, image) = (path("ball.toml"), path("ball.exr"));
    std::fs::write(&scene, BALL).unwrap();
    let words = "`--adaptive` supports only the channels";
    fails_with(
        2,
        words,
        &[
            "render",
            &scene,
            "-o",
            &image,
            "--aov",
            "depth",
            "--adaptive",
            "0.01",
        ],
    );
}
