//! Tests of points in glTF files: their loading, their size, and their image.

use std::fs;
use std::path::{Path, PathBuf};

use base64::Engine;
use serde_json::{Value, json};
use whit::accel::{self, AccelOptions, Backend};
use whit::gltf::{self, LoadOptions};
use whit::image::LinearImage;
use whit::mesh::PointCloud;
use whit::report::info::SceneInfo;
use whit::scene::{Effect, Geometry, Scene};
use whit::scene_file;

use crate::support::cli_program::{fails_with, whit};
use crate::support::images;

/// Positions of the points of the test file; no two of their spheres of diameter 0.5 overlap in the image.
const POSITIONS: [[f32; 3]; 4] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.25],
    [0.0, 1.0, -0.5],
    [1.0, 1.0, 0.0],
];
/// Colours of the points.
const COLORS: [[f32; 3]; 4] = [
    [1.0, 0.5, 0.25],
    [0.25, 1.0, 0.5],
    [0.5, 0.25, 1.0],
    [1.0, 1.0, 1.0],
];

/// Returns a file of one primitive of points with colours.
fn points() -> Value {
    let floats = [POSITIONS, COLORS].concat();
    let bytes: &[u8] = bytemuck::cast_slice(floats.as_flattened());
    let data = base64::engine::general_purpose::STANDARD.encode(bytes);
    let view = |offset: usize| json!({"buffer": 0, "byteOffset": offset, "byteLength": 48});
    let accessor =
        |view: usize| json!({"bufferView": view, "componentType": 5126, "count": 4, "type": "VEC3"});
    json!({
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0, "translation": [0, 0, -1]}],
        "materials": [{"name": "dots", "pbrMetallicRoughness":
            {"baseColorFactor": [0.5, 0.5, 0.5, 1], "metallicFactor": 0, "roughnessFactor": 1}}],
        "meshes": [{"primitives": [
            {"mode": 0, "material": 0, "attributes": {"POSITION": 0, "COLOR_0": 1, "NORMAL": 0}}
        ]}],
        "accessors": [accessor(0), accessor(1)],
        "bufferViews": [view(0), view(48)],
        "buffers": [{"byteLength": 96, "uri": format!("data:;base64,{data}")}]
    })
}

fn write(folder: &Path, root: &Value) -> PathBuf {
    let path = folder.join("points.gltf");
    fs::write(&path, root.to_string()).unwrap();
    path
}

fn load(root: &Value, options: &LoadOptions) -> Result<Scene, String> {
    let folder = tempfile::tempdir().unwrap();
    gltf::load(&write(folder.path(), root), options).map_err(|fault| fault.to_string())
}

fn cloud(scene: &Scene) -> &PointCloud {
    match &scene.geometries[..] {
        [Geometry::Points(cloud)] => cloud,
        _ => panic!("the scene has other geometries than one cloud"),
    }
}

#[test]
fn points_are_loaded_with_their_colours_and_a_size_by_their_density() {
    let scene = load(&points(), &LoadOptions::default()).unwrap();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    let cloud = cloud(&scene);
    assert_eq!(cloud.positions[..], POSITIONS);
    let colors: Vec<[f32; 4]> = COLORS.map(|[r, g, b]| [r, g, b, 1.0]).to_vec();
    assert_eq!(cloud.colors.as_ref().unwrap()[..], colors);
    // The box is 1 x 1 x 0.75, its diagonal √2.5625; so few points have a 32nd of it as diameter.
    assert!((cloud.radius - 2.5625f64.sqrt() / 64.0).abs() < 1e-12);
    assert_eq!((scene.point_count(), scene.triangle_count()), (4, 0));
}

#[test]
fn point_size_is_the_diameter_in_the_units_of_the_positions() {
    let options = LoadOptions {
        point_size: Some(0.5),
        ..LoadOptions::default()
    };
    let mut root = points();
    root["nodes"][0]["scale"] = json!([2, 2, 2]);
    let scene = load(&root, &options).unwrap();
    assert_eq!(cloud(&scene).radius, 0.25);
    // The node doubles all lengths: points from 0 to 2, with a radius of 0.5 around.
    assert_eq!(scene.bounds().extent().x / scene.normalisation.scale, 3.0);
}

#[test]
fn indices_select_points_and_bad_ones_are_refused() {
    let with_indices = |indices: [u8; 2]| {
        let mut root = points();
        let data = base64::engine::general_purpose::STANDARD.encode(indices);
        let add = |list: &mut Value, item: Value| list.as_array_mut().unwrap().push(item);
        add(
            &mut root["buffers"],
            json!({"byteLength": 2, "uri": format!("data:;base64,{data}")}),
        );
        add(&mut root["bufferViews"], json!({"buffer": 1, "byteLength": 2}));
        add(
            &mut root["accessors"],
            json!({"bufferView": 2, "componentType": 5121, "count": 2, "type": "SCALAR"}),
        );
        root["meshes"][0]["primitives"][0]["indices"] = json!(2);
        load(&root, &LoadOptions::default())
    };
    let scene = with_indices([3, 1]).unwrap();
    assert_eq!(cloud(&scene).positions[..], [POSITIONS[3], POSITIONS[1]]);
    assert_eq!(cloud(&scene).colors.as_ref().unwrap()[1], [0.25, 1.0, 0.5, 1.0]);
    let fault = with_indices([3, 4]).unwrap_err();
    assert!(
        fault.contains("mesh 0 has the index 4, but 4 vertices"),
        "{fault}"
    );
}

#[test]
fn points_that_are_not_finite_are_skipped_with_a_warning() {
    let mut root = points();
    let mut positions = POSITIONS;
    positions[1][2] = f32::NAN;
    let bytes: Vec<u8> = bytemuck::cast_slice([positions, COLORS].concat().as_flattened()).to_vec();
    let data = base64::engine::general_purpose::STANDARD.encode(bytes);
    root["buffers"][0]["uri"] = json!(format!("data:;base64,{data}"));
    let scene = load(&root, &LoadOptions::default()).unwrap();
    assert_eq!(cloud(&scene).positions[1], POSITIONS[2]);
    assert_eq!(cloud(&scene).colors.as_ref().unwrap().len(), 3);
    assert_eq!(
        scene.warnings,
        ["mesh 0 has 1 points that are not finite and were skipped"]
    );
}

#[test]
fn lines_beside_points_are_skipped_with_a_warning() {
    let mut root = points();
    let lines = json!({"mode": 1, "attributes": {"POSITION": 0}});
    root["meshes"][0]["primitives"]
        .as_array_mut()
        .unwrap()
        .push(lines);
    let scene = load(&root, &LoadOptions::default()).unwrap();
    assert_eq!(scene.point_count(), 4);
    assert_eq!(
        scene.warnings,
        ["mesh 0 primitive 1 is made of lines and was skipped"]
    );
}

/// Returns a scene file of the camera and light of the tests, with these objects.
fn scene_text(objects: &str) -> String {
    format!(
        "background = [0.1, 0.2, 0.3]\n[camera]\nfrom = [0.5, 0.4, 3]\nat = [0.5, 0.5, -1]\nfov = 40\n\
         [[light]]\nkind = 'directional'\ndirection = [-0.4, -0.7, -0.6]\nintensity = 2\n{objects}"
    )
}

fn render(scene: &Scene, backend: Backend) -> LinearImage {
    let accel = accel::build(scene.validate().unwrap(), backend, &AccelOptions::default()).unwrap();
    let settings = images::settings(64, 1);
    images::rendered_with(scene, accel.as_ref(), &settings).image
}

#[test]
fn points_have_the_image_of_the_same_analytic_spheres() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &points());
    let load = |name: &str, text: String| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        scene_file::load(&path, &LoadOptions::default()).unwrap().scene
    };
    // One sphere with a material of its own for each point
    let spheres = POSITIONS
        .iter()
        .zip(COLORS)
        .enumerate()
        .map(|(i, ([x, y, z], color))| {
            let [r, g, b] = color.map(|c| 0.5 * c);
            let z = z - 1.0;
            format!(
                "[material.m{i}]\nbase_color = [{r}, {g}, {b}]\nroughness = 1\nmetallic = 0\n\
             [[object]]\nshape = 'sphere'\nmaterial = 'm{i}'\n\
             transform = [{{ scale = 0.25 }}, {{ translate = [{x}, {y}, {z}] }}]\n"
            )
        });
    let spheres = load("spheres.toml", scene_text(&spheres.collect::<String>()));
    let points = load(
        "points.toml",
        scene_text("[[object]]\ngltf = 'points.gltf'\npoint_size = 0.5\n"),
    );
    assert_eq!(points.point_count(), 4);
    let expected = render(&spheres, Backend::Bsp);
    for backend in [Backend::Bsp, Backend::Native, Backend::default()] {
        let found = render(&points, backend);
        let values = |image: &LinearImage| image.pixels.as_flattened().to_vec();
        let off = values(&expected)
            .iter()
            .zip(values(&found))
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        // Colours are multiplied in another order: a few roundings of 2^-24.
        assert!(off < 1e-6, "{backend:?}: {off}");
    }
    // The points are seen, in other colours than the background
    let lit = expected.pixels.iter().filter(|p| p[0] > 0.11).count();
    assert!(lit > 100, "{lit}");
}

#[test]
fn vertex_colours_of_points_call_for_their_effect() {
    let scene = load(&points(), &LoadOptions::default()).unwrap();
    let info = SceneInfo::of(&scene, "points.gltf", &Default::default());
    let reason = &info.effects[Effect::VertexColor.name()];
    assert_eq!(reason, "a point cloud of material `dots` has vertex colours");
    assert_eq!((info.points, info.objects["point cloud"]), (4, 1));
}

#[test]
fn bad_point_sizes_are_errors_of_the_arguments() {
    let folder = tempfile::tempdir().unwrap();
    let file = write(folder.path(), &points()).display().to_string();
    let image = folder.path().join("out.png").display().to_string();
    for size in ["-1", "0", "nan", "inf", "1px", ""] {
        let words = "is no diameter of points: give a positive number";
        fails_with(2, words, &["render", &file, "-o", &image, "--point-size", size]);
    }
    let run = whit(&["info", "--json", &file, "--point-size", "0.5"]);
    let info: Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(info["bounds"]["max"][0], 1.25, "{}", run.stderr);
}

#[test]
fn bad_point_sizes_of_objects_are_errors_of_the_scene_file() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &points());
    for (object, words) in [
        (
            "gltf = 'points.gltf'\npoint_size = -2.0\n",
            "give a positive number",
        ),
        ("shape = 'sphere'\npoint_size = 1.0\n", "only to `gltf`"),
    ] {
        let path = folder.path().join("bad.toml");
        fs::write(&path, scene_text(&format!("[[object]]\n{object}"))).unwrap();
        let fault = scene_file::load(&path, &LoadOptions::default())
            .unwrap_err()
            .to_string();
        assert!(fault.contains("point_size") && fault.contains(words), "{fault}");
    }
}

#[test]
fn point_cloud_cannot_be_an_area_light() {
    let mut root = points();
    root["materials"][0]["emissiveFactor"] = json!([1, 1, 1]);
    let mut scene = load(&root, &LoadOptions::default()).unwrap();
    let fault = scene.add_emissive_light(0, 1).unwrap_err();
    assert!(fault.contains("a point cloud cannot be an area light"), "{fault}");
}
