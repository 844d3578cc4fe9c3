//! Radiosity against closed forms of diffuse light, against interreflection, and its command.

use std::f64::consts::{FRAC_1_PI, PI};
use std::path::Path;

use glam::{DAffine3, DQuat, DVec3};
use whit::accel::{self, AccelOptions, Backend, Precision};
use whit::gltf::LoadOptions;
use whit::image::LinearImage;
use whit::render::radiosity::{
    self, Bake, ElementScene, RadiosityError, RadiositySettings, RadiositySolution,
};
use whit::render::{Monitor, RenderSettings};
use whit::scene::{Background, Falloff, Geometry, Light, LightKind, Material, Model, Scene};
use whit::shape::Shape;

use crate::support::cli_program::{fails_with, names_in, whit};
use crate::support::images::{add, rendered, settings};
use crate::support::scenes::box_mesh;

/// Standard errors that an estimate may differ by.
const ERRORS: f64 = 3.0;

/// Returns a surface that is diffuse only.
fn diffuse(albedo: f32, emission: f64) -> Material {
    let mut material = Material::metallic_roughness([albedo; 3], 0.0, 1.0);
    if let Model::MetallicRoughness(model) = &mut material.model {
        model.specular = 0.0;
    }
    material.emission = [emission as f32; 3];
    material
}

/// Adds a square of edge 1 around `center`, whose front has the normal `normal`.
fn add_square(scene: &mut Scene, center: DVec3, normal: DVec3, material: Material) {
    let turned = DQuat::from_rotation_arc(DVec3::Z, normal);
    let place = DAffine3::from_scale_rotation_translation(DVec3::splat(0.5), turned, center);
    add(scene, "square", Geometry::Shape(Shape::Quad), material, place);
}

/// Returns the room between 0 and 1 whose walls have these materials: at x = 0, x = 1, y = 0, y = 1, z = 0, z = 1.
fn room(materials: [Material; 6]) -> Scene {
    let mut scene = Scene::default();
    for (number, material) in materials.into_iter().enumerate() {
        let normal = DVec3::AXES[number / 2] * if number % 2 == 0 { 1.0 } else { -1.0 };
        add_square(&mut scene, DVec3::splat(0.5) - 0.5 * normal, normal, material);
    }
    scene
}

fn solution(elements: &ElementScene, settings: RadiositySettings) -> RadiositySolution {
    let scene = elements.scene.validate().unwrap();
    let options = AccelOptions {
        precision: Precision::Watertight,
        ..AccelOptions::default()
    };
    let accel = accel::build(scene, Backend::Bsp, &options).unwrap();
    radiosity::solve(elements, scene, &*accel, &settings, &Monitor::default()).unwrap()
}

/// Elements of a scene with their solution.
struct Solved {
    elements: ElementScene,
    solution: RadiositySolution,
}

impl Solved {
    fn new(scene: Scene, wanted: usize, settings: RadiositySettings) -> Solved {
        let elements = ElementScene::new(scene, wanted).unwrap();
        let solution = solution(&elements, settings);
        Solved { elements, solution }
    }

    /// Returns the area of the elements of an instance, and the integral over them of `value` of a side.
    fn integral(&self, instance: u32, half: usize, value: impl Fn(&radiosity::SideLight) -> f64) -> [f64; 2] {
        let mut sums = [0.0; 2];
        for (number, element) in self.elements.elements().iter().enumerate() {
            if element.instance == instance {
                sums[0] += element.area;
                sums[1] += element.area * value(&self.solution.sides[2 * number + half]);
            }
        }
        sums
    }

    /// Returns the mean of `value` over the fronts of an instance, and their number.
    fn mean(&self, instance: u32, value: impl Fn(&radiosity::SideLight) -> f64) -> (f64, f64) {
        let [area, sum] = self.integral(instance, 0, value);
        let elements = self.elements.elements().iter();
        (
            sum / area,
            elements.filter(|element| element.instance == instance).count() as f64,
        )
    }
}

fn with_tolerance(rays: u32, tolerance: f64) -> RadiositySettings {
    RadiositySettings { rays, tolerance }
}

#[test]
fn walls_of_a_cube_with_a_bright_ceiling_have_the_radiosities_of_exact_form_factors() {
    // Albedos of x = 0, x = 1 and the rest, then the means of floor, ceiling, x = 0 and x = 1
    for (albedos, exact) in [
        ([0.5, 0.5, 0.5], [0.17122, 1.1044, 0.18111, 0.18111]),
        ([0.8, 0.8, 0.8], [0.66098, 1.5875, 0.68788, 0.68788]),
        ([0.6, 0.1, 0.7], [0.26937, 1.1804, 0.25039, 0.04413]),
    ] {
        let [left, right, rest] = albedos;
        let scene = room([
            diffuse(left, 0.0),
            diffuse(right, 0.0),
            diffuse(rest, 0.0),
            diffuse(rest, FRAC_1_PI),
            diffuse(rest, 0.0),
            diffuse(rest, 0.0),
        ]);
        let solved = Solved::new(scene, 6000, with_tolerance(256, 1e-5));
        let report = &solved.solution.report;
        assert!(report.has_converged, "{report:?}");
        assert!(report.energy.imbalance().abs() < 0.01, "{report:?}");
        for (instance, exact) in [2, 3, 0, 1].into_iter().zip(exact) {
            let (mean, count) = solved.mean(instance, |side| PI * f64::from(side.radiance[1]));
            let bound = ERRORS * report.sampling_error * mean / count.sqrt() + 1e-3;
            println!("{albedos:?} {instance}: {mean:.5}, exactly {exact}, bound {bound:.5}");
            assert!((mean - exact).abs() <= bound, "{albedos:?} {instance}: {mean}");
        }
    }
}

#[test]
fn rays_between_unit_squares_give_their_form_factors() {
    let faces = [
        ("parallel", DVec3::Z, DVec3::NEG_Z, 0.199_824_895_698_387_46),
        (
            "at right angles",
            DVec3::new(0.5, 0.0, 0.5),
            DVec3::NEG_X,
            0.200_043_776_075_403_16,
        ),
    ];
    for (what, center, normal, exact) in faces {
        let mut scene = Scene::default();
        add_square(&mut scene, DVec3::ZERO, DVec3::Z, diffuse(0.5, 0.0));
        add_square(&mut scene, center, normal, diffuse(0.0, 1.0));
        let solved = Solved::new(scene, 1000, with_tolerance(256, 0.001));
        let (mean, count) = solved.mean(0, |side| f64::from(side.gathered[0]));
        // Each ray hits with the probability F
        let bound = ERRORS * (exact * (1.0 - exact) / (256.0 * count)).sqrt();
        println!("{what}: {mean:.6}, exactly {exact:.6}, bound {bound:.6}");
        assert!((mean - exact).abs() <= bound, "{what}: {mean} {exact} {bound}");
    }
}

#[test]
fn closed_room_that_shines_everywhere_sums_all_bounces() {
    for albedo in [0.5f32, 0.8] {
        let mut scene = Scene::default();
        let mesh = box_mesh(glam::Vec3::NEG_ONE, glam::Vec3::new(2.0, 1.0, 1.5));
        add(
            &mut scene,
            "box",
            Geometry::Mesh(mesh),
            diffuse(albedo, 1.5),
            DAffine3::IDENTITY,
        );
        let solved = Solved::new(scene, 500, with_tolerance(32, 1e-5));
        let exact = 1.5 / (1.0 - f64::from(albedo));
        for pair in solved.solution.sides.chunks(2) {
            // The front sees nothing; the tolerance is relative to the light of both sides
            assert_eq!(pair[0].radiance, [1.5; 3]);
            let inside = f64::from(pair[1].radiance[0]);
            assert!((inside / exact - 1.0).abs() <= 1e-4, "{inside}, exactly {exact}");
        }
    }
}

#[test]
fn walls_of_a_closed_room_absorb_what_a_point_light_emits() {
    let albedos = [0.2f32, 0.7, 0.5, 0.9, 0.4, 0.6];
    let mut scene = room(albedos.map(|albedo| diffuse(albedo, 0.0)));
    scene.lights.push(Light {
        name: "point".into(),
        intensity: [3.0; 3],
        kind: LightKind::Point {
            position: DVec3::new(0.4, 0.55, 0.6),
            falloff: Falloff::InverseSquare { range: None },
        },
    });
    let solved = Solved::new(scene, 6000, with_tolerance(256, 1e-5));
    let flux = 4.0 * PI * 3.0;
    let (mut arrived, mut absorbed) = (0.0, 0.0);
    for instance in 0..6 {
        // The radiance is ρ (D + H), of which H is gathered and D comes from the light
        let albedo = f64::from(albedos[instance as usize]);
        let direct =
            |side: &radiosity::SideLight| f64::from(side.radiance[0]) / albedo - f64::from(side.gathered[0]);
        arrived += PI * solved.integral(instance, 0, direct)[1];
        let share = 1.0 - albedo;
        let all = |side: &radiosity::SideLight| share * f64::from(side.radiance[0]) / albedo;
        absorbed += PI * solved.integral(instance, 0, all)[1];
    }
    println!("flux {flux:.4}, arrived {arrived:.4}, absorbed {absorbed:.4}");
    // 6000 elements of 32 stratified points; the nearest wall varies by less than its own size over one
    assert!((arrived / flux - 1.0).abs() <= 2e-3, "{arrived} of {flux}");
    assert!((absorbed / flux - 1.0).abs() <= 5e-3, "{absorbed} of {flux}");
}

/// Returns a white floor with a white cube that is sunk into it, under a white sky.
fn sunk_cube() -> Scene {
    let mut scene = Scene {
        background: Background::Uniform([1.0; 3]),
        ..Scene::default()
    };
    let floor = DAffine3::from_scale(DVec3::splat(2.0));
    add(
        &mut scene,
        "floor",
        Geometry::Shape(Shape::Quad),
        diffuse(1.0, 0.0),
        floor,
    );
    let turned = DQuat::from_rotation_z(0.4);
    let place =
        DAffine3::from_scale_rotation_translation(DVec3::splat(0.7), turned, DVec3::new(0.1, 0.2, 0.3));
    add(
        &mut scene,
        "cube",
        Geometry::Shape(Shape::Cube),
        diffuse(1.0, 0.0),
        place,
    );
    scene
}

#[test]
fn white_surfaces_under_a_white_sky_are_white_up_to_where_they_enter_solids() {
    let solved = Solved::new(sunk_cube(), 3000, with_tolerance(64, 1e-6));
    let (mut visible, mut partly, mut hidden) = (0, 0, 0);
    for side in &solved.solution.sides {
        match side.visible {
            0.0 => hidden += 1,
            1.0 => visible += 1,
            _ => partly += 1,
        }
        if side.visible > 0.0 {
            assert!((side.radiance[0] - 1.0).abs() <= 1e-3, "{side:?}");
        }
    }
    assert!(
        visible > 2000 && partly > 50 && hidden > 500,
        "{visible} {partly} {hidden}"
    );
    // No vertex is dark but those of elements inside of the cube
    let bake = Bake::new(&solved.elements, &solved.solution);
    assert_eq!(bake.meshes.len(), 3);
    for baked in &bake.meshes {
        let colors = baked.mesh.colors.as_ref().unwrap();
        let gray = colors.iter().filter(|color| color[0] < 0.999 && color[0] > 0.0);
        assert_eq!(gray.count(), 0, "{}", baked.name);
    }
}

#[test]
fn solution_has_the_same_bits_for_all_threads() {
    let bits = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| Solved::new(sunk_cube(), 2000, with_tolerance(64, 1e-3)).solution)
    };
    let one = bits(1);
    assert!(one == bits(3));
}

#[test]
fn scenes_without_light_or_surfaces_and_huge_requests_are_handled() {
    let dark = Solved::new(
        room([(); 6].map(|()| diffuse(0.5, 0.0))),
        100,
        with_tolerance(32, 1e-3),
    );
    assert!(dark.solution.sides.iter().all(|side| side.radiance == [0.0; 3]));
    assert_eq!(dark.solution.report.sweeps, 0);
    assert_eq!(Bake::new(&dark.elements, &dark.solution).meshes.len(), 6);
    let mut plane = Scene::default();
    let infinite = Geometry::Shape(Shape::Plane);
    add(
        &mut plane,
        "ground",
        infinite,
        diffuse(0.5, 0.0),
        DAffine3::IDENTITY,
    );
    assert_eq!(
        ElementScene::new(plane.clone(), 100).err(),
        Some(RadiosityError::NoSurface)
    );
    add_square(&mut plane, DVec3::Z, DVec3::Z, diffuse(0.5, 0.0));
    let elements = ElementScene::new(plane, 100).unwrap();
    assert!(
        elements.warnings.len() == 1 && elements.warnings[0].starts_with("`ground` is left out"),
        "{:?}",
        elements.warnings
    );
    let most = with_tolerance(u32::MAX, 1e-3).check_memory(&elements);
    assert!(
        matches!(most, Err(RadiosityError::TooManyRays { .. })),
        "{most:?}"
    );
}

/// Returns the path of the Cornell box.
const CORNELL_BOX: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cornell_box.toml");

#[test]
fn bake_of_the_cornell_box_looks_like_its_interreflection_and_opens_with_its_camera() {
    // Bake it by the command
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("baked.glb");
    let out = path.display().to_string();
    let run = whit(&[
        "radiosity",
        CORNELL_BOX,
        "--out",
        &out,
        "--elements",
        "20000",
        "--rays",
        "128",
    ]);
    assert_eq!((run.code, &*run.stderr), (0, ""), "{}", run.stdout);
    for figure in [
        "triangles",
        "sweeps",
        "remaining light",
        "sampling error",
        "energy",
        "white",
    ] {
        assert!(run.stdout.contains(figure), "{}", run.stdout);
    }
    assert_eq!(names_in(folder.path()), ["baked.glb"]);
    // Read it back, and its radiance of white
    let mut baked = whit::gltf::load(&path, &LoadOptions::default()).unwrap();
    assert!(baked.warnings.is_empty(), "{:?}", baked.warnings);
    assert!(
        baked
            .instances
            .iter()
            .any(|instance| &*instance.name == "tall block")
    );
    baked.background = Background::default();
    let white = white_radiance(&path);
    let original = whit::scene_file::load(Path::new(CORNELL_BOX), &LoadOptions::default()).unwrap();
    // Compare both images where no part of a pixel is brighter than white
    let render_settings = |spp: u32| RenderSettings {
        width: 48,
        height: 48,
        ..settings(48, spp)
    };
    let bake = rendered(&baked, &baked.cameras[0], &render_settings(16)).image;
    let truth = rendered(&original.scene, &original.scene.cameras[0], &render_settings(256)).image;
    let [difference, mean] = relative_differences(&bake, &truth, white);
    println!("white {white}, mean absolute difference {difference:.4}, difference of means {mean:.4}");
    assert!(
        difference < MAX_DIFFERENCE && mean.abs() < MAX_MEAN_DIFFERENCE,
        "{difference} {mean}"
    );
}

/// Largest mean absolute difference relative to the mean: 3 % are noise of 256 paths per pixel, the rest edges of shadows and
/// of objects, which elements and pixels of a tenth of a metre blur.
const MAX_DIFFERENCE: f64 = 0.05;
/// Largest difference of the means: noise of all paths and of all rays is 0.2 %, and the floor at the edges of the blocks is
/// darker by 2 %, because elements there are partly under the blocks, which are open below.
const MAX_MEAN_DIFFERENCE: f64 = 0.01;

/// Returns the radiance of white that a bake states.
fn white_radiance(path: &Path) -> f64 {
    let bytes = std::fs::read(path).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let document: serde_json::Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    document["asset"]["extras"]["white_radiance"].as_f64().unwrap()
}

/// Returns the mean absolute difference of a bake's image from the original and the mean difference, relative to the mean of
/// the original, over all pixels that are not brighter than white.
fn relative_differences(bake: &LinearImage, truth: &LinearImage, white: f64) -> [f64; 2] {
    let (mut differences, mut sum, mut count) = ([0.0; 2], 0.0, 0);
    for (pixel, truth) in bake.pixels.iter().zip(&truth.pixels) {
        if truth.iter().any(|&channel| f64::from(channel) > white) {
            continue;
        }
        count += 1;
        for c in 0..3 {
            let difference = white * f64::from(pixel[c]) - f64::from(truth[c]);
            differences[0] += difference.abs();
            differences[1] += difference;
            sum += f64::from(truth[c]);
        }
    }
    assert!(count > bake.pixels.len() * 9 / 10, "{count}");
    differences.map(|difference| difference / sum)
}

#[test]
fn mistakes_of_the_command_are_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (scene, good) = (at("scene.toml"), at("baked.glb"));
    std::fs::write(
        &scene,
        "camera = { from = [0, 1, 4], at = [0, 0, 0] }\nobject = [{ shape = \"plane\" }]\n",
    )
    .unwrap();
    fails_with(
        2,
        "end in .glb",
        &["radiosity", CORNELL_BOX, "--out", &at("baked.gltf")],
    );
    fails_with(
        2,
        "folder",
        &["radiosity", CORNELL_BOX, "--out", &at("no/baked.glb")],
    );
    fails_with(2, "no surface to bake", &["radiosity", &scene, "--out", &good]);
    fails_with(
        2,
        "missing.toml",
        &["radiosity", &at("missing.toml"), "--out", &good],
    );
    let with = |flag: &'static str, value: &'static str| {
        ["radiosity", CORNELL_BOX, "--out", &good, flag, value].map(String::from)
    };
    for (words, args) in [
        ("fraction over 0", with("--tolerance", "0")),
        ("elements", with("--elements", "0")),
        ("rays", with("--rays", "100000")),
        ("2 gigabytes", with("--rays", "65536")),
    ] {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        fails_with(2, words, &args);
    }
    assert_eq!(names_in(folder.path()), ["scene.toml"]);
}
