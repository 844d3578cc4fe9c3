//! Tests of glTF morph targets and skins: vertex positions in generated files and in assets of other authors.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::assets::asset;
use base64::Engine;
use glam::DVec3;
use serde_json::{Value, json};
use whit::gltf::{AnimationTime, LoadOptions, load};
use whit::mesh::Mesh;
use whit::scene::{Geometry, Scene};

const TRIANGLE: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
const FLOAT: u32 = 5126;
const BYTE: u32 = 5121;

/// Builder of a glTF file: adds accessors; the rest of the JSON is edited directly.
struct File {
    bytes: Vec<u8>,
    json: Value,
}

impl File {
    fn new() -> File {
        File {
            bytes: Vec::new(),
            json: json!({"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}),
        }
    }

    fn floats(&mut self, kind: &str, numbers: &[f32]) -> usize {
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        self.accessor((kind, FLOAT), numbers.len(), &bytes)
    }

    fn bytes(&mut self, kind: &str, numbers: &[u8]) -> usize {
        self.accessor((kind, BYTE), numbers.len(), numbers)
    }

    fn accessor(&mut self, (kind, component): (&str, u32), number_count: usize, bytes: &[u8]) -> usize {
        let width = match kind {
            "SCALAR" => 1,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let view = self.view(bytes);
        self.push(
            "accessors",
            json!({
                "bufferView": view, "componentType": component, "count": number_count / width, "type": kind
            }),
        )
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.push(
            "bufferViews",
            json!({"buffer": 0, "byteOffset": start, "byteLength": bytes.len()}),
        )
    }

    fn push(&mut self, list: &str, item: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(item);
        list.len() - 1
    }

    fn write(&self, folder: &Path) -> PathBuf {
        let mut json = self.json.clone();
        let data = base64::engine::general_purpose::STANDARD.encode(&self.bytes);
        json["buffers"] = json!([{"uri": format!("data:;base64,{data}"), "byteLength": self.bytes.len()}]);
        write(folder, &json)
    }
}

fn write(folder: &Path, json: &Value) -> PathBuf {
    let path = folder.join("deformed.gltf");
    fs::write(&path, json.to_string()).unwrap();
    path
}

/// Loads a file without an animation time, or at a time of all its animations.
fn at(path: &Path, seconds: Option<f64>) -> Result<Scene, String> {
    let pose = seconds.map(|seconds| AnimationTime {
        animation: None,
        seconds,
    });
    let options = LoadOptions {
        pose,
        ..LoadOptions::default()
    };
    load(path, &options).map_err(|error| error.to_string())
}

fn mesh(scene: &Scene, instance: usize) -> &Mesh {
    match &scene.geometries[scene.instances[instance].geometry as usize] {
        Geometry::Mesh(mesh) => mesh,
        _ => panic!("not a mesh"),
    }
}

/// Returns the first corners of an instance in the file's world space.
fn corners(scene: &Scene, instance: usize) -> [DVec3; 3] {
    let world_from_object = scene.instances[instance].world_from_object();
    let file_from_scene = scene.normalisation.inverse_map();
    let to_world = |p| file_from_scene.transform_point3(world_from_object.transform_point3(p));
    mesh(scene, instance).corners_f64(0).map(to_world)
}

fn assert_corners(path: &Path, seconds: Option<f64>, expected: [[f64; 3]; 3]) {
    let scene = at(path, seconds).unwrap();
    assert_eq!(corners(&scene, 0), expected.map(DVec3::from_array), "{seconds:?}");
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
}

/// Returns a triangle with two targets: the first moves its second corner by 1 in z, the second its third by 2 in y.
fn morphed() -> File {
    let mut file = File::new();
    let positions = file.floats("VEC3", &TRIANGLE);
    let first = file.floats("VEC3", &[0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    // The second target is sparse: only element 2 is stored.
    let (index, value) = ([2u8], [0f32, 2.0, 0.0].map(f32::to_le_bytes).concat());
    let (indices, values) = (file.view(&index), file.view(&value));
    let sparse = json!({"count": 1, "indices": {"bufferView": indices, "componentType": BYTE},
        "values": {"bufferView": values}});
    let second = file.push(
        "accessors",
        json!({"componentType": FLOAT, "count": 3, "type": "VEC3", "sparse": sparse}),
    );
    let times = file.floats("SCALAR", &[0.0, 2.0]);
    let weights = file.floats("SCALAR", &[0.0, 1.0, 1.0, 0.0]);
    file.json["scenes"] = json!([{"nodes": [0]}]);
    file.json["nodes"] = json!([{"mesh": 0}]);
    file.json["meshes"] = json!([{"primitives": [{"attributes": {"POSITION": positions},
        "targets": [{"POSITION": first}, {"POSITION": second}]}]}]);
    file.json["animations"] = json!([{"name": "morph",
        "samplers": [{"input": times, "output": weights}],
        "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}]}]);
    file
}

#[test]
fn morph_weights_come_from_mesh_node_or_animation() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = morphed();
    let still = |b: [f64; 3], c: [f64; 3]| [[0.0; 3], b, c];
    assert_corners(
        &file.write(folder.path()),
        None,
        still([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
    );
    file.json["meshes"][0]["weights"] = json!([0.5, 0.25]);
    assert_corners(
        &file.write(folder.path()),
        None,
        still([1.0, 0.0, 0.5], [0.0, 1.5, 0.0]),
    );
    file.json["nodes"][0]["weights"] = json!([-1.0, 0.0]);
    let path = file.write(folder.path());
    assert_corners(&path, None, still([1.0, 0.0, -1.0], [0.0, 1.0, 0.0]));
    // A quarter on the way from (0, 1) to (1, 0).
    assert_corners(&path, Some(0.5), still([1.0, 0.0, 0.25], [0.0, 2.5, 0.0]));
    assert_corners(&path, Some(9.0), still([1.0, 0.0, 1.0], [0.0, 1.0, 0.0]));
}

#[test]
fn morphed_normals_are_normalised() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = morphed();
    let normals = file.floats("VEC3", &[0.0, 0.0, 1.0].repeat(3));
    let turned = file.floats("VEC3", &[0.0, 1.5, 1.0].repeat(3));
    let primitive = &mut file.json["meshes"][0]["primitives"][0];
    primitive["attributes"]["NORMAL"] = json!(normals);
    primitive["targets"][0]["NORMAL"] = json!(turned);
    // (0, 0, 1) + (0, 1.5, 1) / 2 = (0, 0.75, 1.5), of which the unit vector is (0, 1, 2) / sqrt 5.
    file.json["meshes"][0]["weights"] = json!([0.5]);
    let scene = at(&file.write(folder.path()), None).unwrap();
    let normal = DVec3::from_array(mesh(&scene, 0).normals.as_ref().unwrap()[0].map(f64::from));
    let expected = DVec3::new(0.0, 1.0, 2.0) / 5f64.sqrt();
    assert!(normal.abs_diff_eq(expected, f64::from(f32::EPSILON)), "{normal}");
}

/// Returns a triangle bound to a joint at (0, 0, 0) and one that moves from (4, 0, 0) to (4, 8, 0) in a second: its
/// corners have the weights 1 and 0, 1 and 3 (of 4), 0 and 2 (of 2). Its own node is elsewhere.
fn skinned() -> File {
    let mut file = File::new();
    let positions = file.floats("VEC3", &TRIANGLE);
    let joints = file.bytes("VEC4", &[0, 1, 0, 0].repeat(3));
    let weights = file.floats(
        "VEC4",
        &[1.0, 0.0, 0.0, 0.0, 1.0, 3.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0],
    );
    let mut binds = [0f32; 32];
    for i in [0, 5, 10, 15] {
        (binds[i], binds[16 + i]) = (1.0, 1.0);
    }
    // The second joint was at (4, 0, 0) when the mesh was bound.
    binds[16 + 12] = -4.0;
    let binds = file.floats("MAT4", &binds);
    let times = file.floats("SCALAR", &[0.0, 1.0]);
    let places = file.floats("VEC3", &[4.0, 0.0, 0.0, 4.0, 8.0, 0.0]);
    file.json["scenes"] = json!([{"nodes": [0, 1]}]);
    file.json["nodes"] = json!([
        {"mesh": 0, "skin": 0, "translation": [100, 0, 0], "scale": [7, 7, 7]},
        {"children": [2]}, {"translation": [4, 0, 0]}]);
    file.json["skins"] = json!([{"joints": [1, 2], "inverseBindMatrices": binds}]);
    file.json["meshes"] = json!([{"primitives": [{"attributes":
        {"POSITION": positions, "JOINTS_0": joints, "WEIGHTS_0": weights}}]}]);
    file.json["animations"] = json!([{"name": "lift",
        "samplers": [{"input": times, "output": places}],
        "channels": [{"sampler": 0, "target": {"node": 2, "path": "translation"}}]}]);
    file
}

#[test]
fn skinned_vertices_follow_joints_and_ignore_their_node() {
    let folder = tempfile::tempdir().unwrap();
    let path = skinned().write(folder.path());
    assert_corners(&path, None, [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    // The second joint is 4 higher: corners move up by 0, 3 and 4.
    assert_corners(&path, Some(0.5), [[0.0; 3], [1.0, 3.0, 0.0], [0.0, 5.0, 0.0]]);
}

#[test]
fn morphing_precedes_skinning() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = skinned();
    // The first joint scales by 2.
    file.json["nodes"][1]["scale"] = json!([2, 2, 2]);
    let target = file.floats("VEC3", &[0.0, 0.0, 1.0].repeat(3));
    file.json["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": target}]);
    file.json["meshes"][0]["weights"] = json!([1.5]);
    let scene = at(&file.write(folder.path()), None).unwrap();
    assert_eq!(corners(&scene, 0)[0], DVec3::new(0.0, 0.0, 3.0));
}

#[test]
fn skinned_normals_use_the_inverse_transpose() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = skinned();
    // Joints twice as wide in y, the second as the child of the first: (0, 1, 1) becomes (0, 1/2, 1) before it is made
    // unit.
    file.json["nodes"][1]["scale"] = json!([1, 2, 1]);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let normals = file.floats("VEC3", &[0.0, half, half].repeat(3));
    file.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(normals);
    let scene = at(&file.write(folder.path()), None).unwrap();
    let normal = DVec3::from_array(mesh(&scene, 0).normals.as_ref().unwrap()[0].map(f64::from));
    let expected = DVec3::new(0.0, 1.0, 2.0) / 5f64.sqrt();
    assert!(
        normal.abs_diff_eq(expected, 2.0 * f64::from(f32::EPSILON)),
        "{normal}"
    );
}

#[test]
fn mirrored_skin_keeps_front_faces() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = skinned();
    file.json["nodes"][1]["scale"] = json!([-1, 1, 1]);
    let normals = file.floats("VEC3", &[0.0, 0.0, 1.0].repeat(3));
    file.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(normals);
    let scene = at(&file.write(folder.path()), None).unwrap();
    let [a, b, c] = corners(&scene, 0);
    assert!((b - a).cross(c - a).z > 0.0);
    assert_eq!(mesh(&scene, 0).normals.as_ref().unwrap()[0], [0.0, 0.0, 1.0]);
}

#[test]
fn skinned_mesh_far_from_the_origin_keeps_its_shape() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = skinned();
    file.json["nodes"][1]["translation"] = json!([1e9, 0, 0]);
    let scene = at(&file.write(folder.path()), None).unwrap();
    let [a, b, c] = corners(&scene, 0);
    assert_eq!([b - a, c - a], [DVec3::X, DVec3::Y]);
    assert!((a.x - 1e9).abs() < 1.0, "{a}");
}

#[test]
fn mesh_is_built_once_per_skin_and_shared_otherwise() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = skinned();
    file.json["scenes"] = json!([{"nodes": [0, 1, 3, 4, 5, 6]}]);
    let nodes = file.json["nodes"].as_array_mut().unwrap();
    nodes.push(json!({"mesh": 0, "skin": 1}));
    nodes.push(json!({"mesh": 0, "skin": 0}));
    nodes.push(json!({"mesh": 0, "translation": [0, 0, 20]}));
    nodes.push(json!({"mesh": 0, "translation": [0, 0, 30]}));
    let skins = file.json["skins"].as_array_mut().unwrap();
    // Without inverse bind matrices, the second joint is at (4, 0, 0) from the mesh's bind position.
    skins.push(json!({"joints": [1, 2]}));
    let scene = at(&file.write(folder.path()), None).unwrap();
    let used: Vec<u32> = scene.instances.iter().map(|instance| instance.geometry).collect();
    assert_eq!(used.len(), 5);
    assert_eq!((used[0], used[3]), (used[2], used[4]));
    assert_eq!(scene.geometries.len(), 3);
    assert_eq!(
        corners(&scene, 1),
        [[0.0; 3], [4.0, 0.0, 0.0], [4.0, 1.0, 0.0]].map(DVec3::from_array)
    );
    assert_eq!(corners(&scene, 3)[0], DVec3::new(0.0, 0.0, 20.0));
}

/// Invalid file, with words of the expected error message.
type BadFile = (File, &'static str, Value, &'static str);

#[test]
fn invalid_skins_and_morphs_are_reported_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let attributes = "/meshes/0/primitives/0/attributes";
    let mut short = skinned();
    let short_joints = short.bytes("VEC4", &[0; 8]);
    let mut foreign = skinned();
    let foreign_joints = foreign.bytes("VEC4", &[9; 12]);
    let mut infinite = skinned();
    let infinite_binds = infinite.floats("MAT4", &[f32::INFINITY; 32]);
    let cases: [BadFile; 13] = [
        (skinned(), "/nodes/0/skin", json!(4), "skin 4 does not exist"),
        (
            skinned(),
            "/skins/0/joints",
            json!([1, 77]),
            "skin 0 has node 77 as a joint",
        ),
        (skinned(), "/skins/0/joints", json!([]), "skin 0 has no joints"),
        (
            skinned(),
            "/skins/0/joints",
            json!([1, 2, 0]),
            "has 2 inverse bind matrices for 3 joints",
        ),
        (
            skinned(),
            "/skins/0/inverseBindMatrices",
            json!(0),
            "is VEC3 where MAT4 is needed",
        ),
        (
            infinite,
            "/skins/0/inverseBindMatrices",
            json!(infinite_binds),
            "not finite",
        ),
        (
            skinned(),
            attributes,
            json!({"POSITION": 0}),
            "mesh 0 has a skin, but not both JOINTS_0 and WEIGHTS_0",
        ),
        (
            short,
            "/meshes/0/primitives/0/attributes/JOINTS_0",
            json!(short_joints),
            "has joints for 2 and weights for 3 of 3 vertices",
        ),
        (
            foreign,
            "/meshes/0/primitives/0/attributes/JOINTS_0",
            json!(foreign_joints),
            "has at vertex 0 the joint 9, but its skin has 2",
        ),
        (
            morphed(),
            "/nodes/0",
            json!({"mesh": 0, "weights": [1, 2, 3]}),
            "node 0 has 3 weights for 2 morph targets",
        ),
        (
            morphed(),
            "/accessors/1/count",
            json!(2),
            "has a morph target of 2 vertices for its 3",
        ),
        (
            morphed(),
            "/animations/0/channels/0/target/node",
            json!(1),
            "node 1 does not exist",
        ),
        (
            morphed(),
            "/meshes/0/primitives/0/targets",
            json!([]),
            "morphs node 0, whose mesh has no targets",
        ),
    ];
    for (mut file, place, value, words) in cases {
        *file.json.pointer_mut(place).unwrap() = value;
        let message = at(&file.write(folder.path()), Some(1.0)).unwrap_err();
        assert!(
            message.contains(words) && message.contains("deformed.gltf"),
            "{words}: {message}"
        );
        assert!(!message.contains('\n'), "{message}");
    }
}

/// Collects the JSON pointers of all values in a document.
fn places(value: &Value, at: &str, found: &mut Vec<String>) {
    found.push(at.to_owned());
    match value {
        Value::Array(items) => {
            for (i, item) in items.iter().enumerate() {
                places(item, &format!("{at}/{i}"), found);
            }
        }
        Value::Object(object) => {
            for (key, item) in object {
                places(item, &format!("{at}/{key}"), found);
            }
        }
        _ => {}
    }
}

#[test]
fn exchanged_values_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    for file in [morphed(), skinned()] {
        let path = file.write(folder.path());
        let sound: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
        let mut all = Vec::new();
        places(&sound, "", &mut all);
        for place in all {
            for value in [
                json!(null),
                json!(-1),
                json!(1),
                json!(1e30),
                json!("CUBICSPLINE"),
                json!([]),
                json!({}),
            ] {
                let mut json = sound.clone();
                *json.pointer_mut(&place).unwrap() = value.clone();
                match at(&write(folder.path(), &json), Some(0.5)) {
                    Ok(scene) => assert_eq!(scene.validate().err(), None, "{place} {value}"),
                    Err(message) => assert!(message.contains("deformed.gltf"), "{place} {value}: {message}"),
                }
            }
        }
    }
}

#[test]
fn sample_skins_and_targets_move_without_warnings() {
    for (name, moments) in [
        ("simple_skin/simple_skin.gltf", [0.0, 1.25, 4.0]),
        ("SimpleMorph/glTF/SimpleMorph.gltf", [0.0, 1.0, 2.5]),
    ] {
        let Some(path) = asset(name) else { continue };
        let moments = moments.map(|seconds| at(&path, Some(seconds)).unwrap());
        for scene in &moments {
            assert!(scene.warnings.is_empty(), "{name}: {:?}", scene.warnings);
            assert_eq!(scene.validate().err(), None, "{name}");
        }
        let last = |scene: &Scene| {
            let position = mesh(scene, 0).positions.last().copied().unwrap();
            let p = DVec3::from_array(position.map(f64::from));
            let p = scene.instances[0].world_from_object().transform_point3(p);
            scene.normalisation.inverse_map().transform_point3(p)
        };
        let [a, b, c] = [&moments[0], &moments[1], &moments[2]].map(last);
        assert!(a != b && b != c && a != c, "{name}: {a} {b} {c}");
    }
}
