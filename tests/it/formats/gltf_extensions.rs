//! Tests of glTF extensions: compressed, instanced, hidden and converted contents give the scenes that they stand for.
//!
//! Files of other authors are not part of the project, see `gltf_files`; a test of one that is absent says so.

use base64::Engine;
use serde_json::{Value, json};
use whit::gltf::{self, LoadOptions, UnsupportedExtensions};
use whit::mesh::Mesh;
use whit::scene::{ExtensionSupport, Geometry, Instance, Scene};

use crate::support::assets::asset;

/// Writes a file and loads it.
fn load(root: &Value, options: &LoadOptions) -> Result<Scene, String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file.gltf");
    std::fs::write(&file, root.to_string()).unwrap();
    gltf::load(&file, options).map_err(|error| error.to_string())
}

/// Returns a triangle in the plane z = 0, with room for the values of one more accessor.
fn triangle(more: &[f32]) -> Value {
    let positions = [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let bytes: Vec<u8> = positions
        .iter()
        .chain(more)
        .flat_map(|x| x.to_le_bytes())
        .collect();
    let data = base64::engine::general_purpose::STANDARD.encode(&bytes);
    json!({
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0, "name": "leaf"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 0, "byteOffset": 36, "componentType": 5126, "count": more.len() / 3, "type": "VEC3"}
        ],
        "bufferViews": [{"buffer": 0, "byteLength": bytes.len()}],
        "buffers": [{"byteLength": bytes.len(), "uri": format!("data:;base64,{data}")}]
    })
}

fn mesh(scene: &Scene) -> &Mesh {
    match &scene.geometries[0] {
        Geometry::Mesh(mesh) => mesh,
        Geometry::Shape(_) | Geometry::Points(_) => panic!("a mesh"),
    }
}

#[test]
fn instancing_places_a_copy_for_each_translation() {
    let mut root = triangle(&[10.0, 0.0, 0.0, 0.0, 20.0, 0.0]);
    root["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]);
    root["nodes"][0]["translation"] = json!([1, 0, 0]);
    root["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 1}}});
    let scene = load(&root, &LoadOptions::default()).unwrap();
    let file_from_world = scene.normalisation.inverse_map();
    let corner = |instance: &Instance| {
        (file_from_world * instance.world_from_object())
            .translation
            .to_array()
    };
    let places: Vec<[f64; 3]> = scene.instances.iter().map(corner).collect();
    assert_eq!(places, [[11.0, 0.0, 0.0], [1.0, 20.0, 0.0]]);
    assert_eq!(&*scene.instances[1].name, "leaf copy 1");
}

#[test]
fn instancing_attributes_of_different_lengths_are_refused() {
    let mut root = triangle(&[10.0, 0.0, 0.0]);
    root["nodes"][0]["extensions"] =
        json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 1, "SCALE": 0}}});
    let fault = load(&root, &LoadOptions::default()).unwrap_err();
    assert!(
        fault.contains("node 0 `leaf` has attributes of EXT_mesh_gpu_instancing"),
        "{fault}"
    );
}

#[test]
fn hidden_node_is_neither_rendered_nor_framed() {
    let mut root = triangle(&[]);
    let far = json!({"mesh": 0, "translation": [100, 0, 0], "extensions": {"KHR_node_visibility": {"visible": false}}});
    root["nodes"].as_array_mut().unwrap().push(far);
    root["extensionsUsed"] = json!(["KHR_node_visibility"]);
    let scene = load(&root, &LoadOptions::default()).unwrap();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert_eq!(
        (
            scene.instances.len(),
            scene.bounds().max.x - scene.bounds().min.x <= 2.0
        ),
        (1, true)
    );
    // With all nodes hidden nothing is left
    root["nodes"] = json!([root["nodes"][1]]);
    let fault = load(&root, &LoadOptions::default()).unwrap_err();
    assert!(fault.contains("nothing to render"), "{fault}");
}

#[test]
fn restart_index_separates_strips() {
    let mut root = triangle(&[]);
    let data = base64::engine::general_purpose::STANDARD.encode([0u8, 1, 2, 255, 2, 1, 0, 255]);
    root["buffers"]
        .as_array_mut()
        .unwrap()
        .push(json!({"byteLength": 8, "uri": format!("data:;base64,{data}")}));
    root["bufferViews"]
        .as_array_mut()
        .unwrap()
        .push(json!({"buffer": 1, "byteLength": 8}));
    root["accessors"][1] = json!({"bufferView": 1, "componentType": 5121, "count": 8, "type": "SCALAR"});
    root["meshes"][0]["primitives"][0]["indices"] = json!(1);
    root["meshes"][0]["primitives"][0]["mode"] = json!(5);
    let fault = load(&root, &LoadOptions::default()).unwrap_err();
    assert!(fault.contains("the index 255"), "{fault}");
    root["extensionsRequired"] = json!(["KHR_mesh_primitive_restart"]);
    let scene = load(&root, &LoadOptions::default()).unwrap();
    assert_eq!(mesh(&scene).triangles[..], [[0, 1, 2], [2, 1, 0]]);
}

#[test]
fn strict_loading_refuses_what_is_only_approximated() {
    let mut root = triangle(&[]);
    root["extensionsUsed"] = json!(["KHR_materials_sheen", "KHR_xmp_json_ld"]);
    let strict = LoadOptions {
        unsupported: UnsupportedExtensions::Refuse,
        ..LoadOptions::default()
    };
    let scene = load(&root, &LoadOptions::default()).unwrap();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    let is_approximated = matches!(scene.extensions[0].support, ExtensionSupport::Approximated(_));
    assert!(is_approximated && scene.extensions[1].support == ExtensionSupport::WithoutEffect);
    let fault = load(&root, &strict).unwrap_err();
    assert!(
        fault.contains("(KHR_materials_sheen): render it without"),
        "{fault}"
    );
}

#[test]
fn compressed_boxes_are_the_box() {
    for name in ["BoxDraco.gltf", "BoxMeshopt.gltf", "BoxMeshopt.glb"] {
        let Some(path) = asset(name) else { continue };
        let scene = gltf::load(&path, &LoadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        assert!(scene.warnings.is_empty(), "{name}: {:?}", scene.warnings);
        assert_eq!(scene.triangle_count(), 12, "{name}");
        // A unit cube about the origin, whose normals are those of its faces
        let mesh = mesh(&scene);
        let normals = mesh.normals.as_ref().unwrap();
        let bounds = scene.bounds();
        let size = (bounds.max - bounds.min) / scene.normalisation.scale;
        assert!(
            (size - glam::DVec3::ONE).abs().max_element() < 1e-3,
            "{name}: {size}"
        );
        for triangle in mesh.triangles.iter() {
            let [a, b, c] = triangle.map(|v| glam::Vec3::from(mesh.positions[v as usize]));
            let facing = (b - a).cross(c - a).normalize();
            let stored = glam::Vec3::from(normals[triangle[0] as usize]);
            assert!(facing.dot(stored) > 0.99, "{name}: {facing} {stored}");
        }
    }
}
