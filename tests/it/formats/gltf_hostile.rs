//! Tests of malformed glTF files: each gives an error message, none a panic or an endless loop.

use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

use base64::Engine;
use serde_json::{Value, json};
use whit::gltf::{self, GltfError, LoadOptions};
use whit::scene::Scene;

/// Time limit for loading any of these files.
const PATIENCE: Duration = Duration::from_secs(5);

/// Loads in a separate thread; fails the test on a panic or a hang.
fn load(path: &Path) -> Result<Scene, GltfError> {
    let (sender, receiver) = mpsc::channel();
    let owned = path.to_owned();
    std::thread::spawn(move || {
        // If the receiver is gone, the test has failed already.
        let _ = sender.send(gltf::load(&owned, &LoadOptions::default()));
    });
    receiver
        .recv_timeout(PATIENCE)
        .unwrap_or_else(|e| panic!("{}: panicked or hung ({e})", path.display()))
}

fn find(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let extension = path.extension().and_then(|e| e.to_str());
        match extension {
            _ if path.is_dir() => find(&path, found),
            Some("gltf" | "glb") => found.push(path),
            _ => {}
        }
    }
}

#[test]
fn validator_files_never_panic_and_valid_ones_load() {
    let assets = std::env::var_os("WHIT_TEST_ASSETS").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/assets/gltf"),
        PathBuf::from,
    );
    let folder = assets.join("khronos-validator");
    if !folder.exists() {
        println!("skipped: {} is not there", folder.display());
        return;
    }
    let mut files = Vec::new();
    find(&folder, &mut files);
    assert_eq!(files.len(), 263);
    for file in files {
        let result = load(&file);
        let mut report = file.clone().into_os_string();
        report.push(".report.json");
        let report: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
        let is_sound = report["issues"]["numErrors"] == 0;
        match result {
            Ok(scene) => assert_eq!(scene.validate().err(), None, "{}", file.display()),
            Err(error) => {
                let sentence = error.to_string();
                assert!(
                    sentence.contains(file.file_name().unwrap().to_str().unwrap()),
                    "{sentence}"
                );
                // A buffer without data is valid by the specification, but cannot be rendered.
                let has_data = !sentence.contains("has neither a URI nor a binary chunk");
                // Valid files may have no triangle or require more than glTF 2.0; every other error fails the test.
                let is_excused = matches!(
                    error,
                    GltfError::Empty { .. }
                        | GltfError::RequiredExtensions { .. }
                        | GltfError::Version { .. }
                );
                assert!(!is_sound || !has_data || is_excused, "{sentence}");
            }
        }
    }
}

/// Returns a valid triangle as JSON, for mutation.
fn triangle() -> Value {
    let positions = [[0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let mut bytes: Vec<u8> = positions.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    bytes.extend([0u8, 1, 2]);
    let uri = data_uri(&bytes);
    json!({
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "thing"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 0, "byteOffset": 36, "componentType": 5121, "count": 3, "type": "SCALAR"}
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 39}],
        "buffers": [{"byteLength": 39, "uri": uri}]
    })
}

fn data_uri(bytes: &[u8]) -> String {
    let text = base64::engine::general_purpose::STANDARD.encode(bytes);
    format!("data:application/octet-stream;base64,{text}")
}

/// Writes `bytes` as `bad.gltf` into a temporary folder, loads it, and returns the error message.
fn sentence(bytes: &[u8]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bad.gltf");
    std::fs::write(&file, bytes).unwrap();
    match load(&file) {
        Ok(_) => panic!("loaded"),
        Err(error) => error.to_string(),
    }
}

/// Returns the error message for a triangle after the mutation `spoil`.
fn spoilt(spoil: impl FnOnce(&mut Value)) -> String {
    let mut root = triangle();
    spoil(&mut root);
    sentence(root.to_string().as_bytes())
}

/// Asserts that a message is one sentence with the file, the item and a remedy after a colon.
#[track_caller]
fn assert_advice(sentence: &str, item: &str, remedy: &str) {
    assert!(sentence.contains("bad.gltf: "), "no file: {sentence}");
    assert!(sentence.contains(item), "no `{item}`: {sentence}");
    assert!(
        sentence.rsplit(": ").next().unwrap().contains(remedy),
        "no `{remedy}`: {sentence}"
    );
    assert!(!sentence.contains('\n'), "more than a line: {sentence}");
}

#[test]
fn valid_triangle_loads() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("good.gltf");
    std::fs::write(&file, triangle().to_string()).unwrap();
    let scene = load(&file).unwrap();
    assert_eq!(scene.triangle_count(), 1);
    assert_eq!(&*scene.instances[0].name, "thing");
}

#[test]
fn incomplete_gltf_files_are_reported() {
    let glb = |length: u32, json: &str| {
        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend(length.to_le_bytes());
        bytes.extend((json.len() as u32).to_le_bytes());
        bytes.extend(b"JSON");
        bytes.extend(json.as_bytes());
        bytes
    };
    assert_advice(&sentence(b""), "empty", "give a .gltf or .glb");
    assert_advice(
        &sentence(b"solid cube\nfacet normal"),
        "neither",
        "give a .gltf or .glb",
    );
    assert_advice(&sentence(b"{\"asset\": {"), "EOF", "give a .gltf or .glb");
    assert_advice(&sentence(b"{\xff}"), "", "give a .gltf or .glb");
    assert_advice(&sentence(b"glTF\x02\0"), "header", "give a .gltf or .glb");
    assert_advice(&sentence(&glb(1000, "{}")), "truncated", "give a .gltf or .glb");
    assert_advice(&sentence(&glb(20, "{}")), "chunk 0", "give a .gltf or .glb");
    assert_advice(
        &sentence(b"glTF\x01\0\0\0\x14\0\0\0\0\0\0\0\0\0\0\0"),
        "version 1",
        "give a .gltf or .glb",
    );
    assert_advice(
        &sentence("[".repeat(100_000).as_bytes()),
        "neither",
        "give a .gltf or .glb",
    );
}

#[test]
fn missing_files_and_folders_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let absent = folder.path().join("bad.gltf");
    assert_advice(
        &load(&absent).unwrap_err().to_string(),
        "no such file",
        "check the path",
    );
    std::fs::create_dir(&absent).unwrap();
    assert_advice(
        &load(&absent).unwrap_err().to_string(),
        "is not a file",
        "check the path",
    );
}

#[test]
fn unsupported_versions_and_required_extensions_are_reported() {
    assert_advice(
        &spoilt(|r| r["asset"]["version"] = json!("1.0")),
        "glTF 1.0",
        "convert",
    );
    assert_advice(
        &spoilt(|r| r["asset"]["minVersion"] = json!("2.1")),
        "glTF 2.1",
        "convert",
    );
    let sentence = spoilt(|r| r["extensionsRequired"] = json!(["KHR_mesh_quantization", "X_b", "X_a"]));
    assert_advice(&sentence, "X_a, X_b", "export the file without");
    assert!(!sentence.contains("quantization"));
}

#[test]
fn out_of_range_accessors_and_indices_are_reported() {
    for (key, value, item) in [
        ("count", json!(4), "accessor 0"),
        ("count", json!(1u64 << 60), "accessor 0"),
        ("byteOffset", json!(u64::MAX), "accessor 0"),
        ("bufferView", json!(9), "buffer view 9"),
        ("componentType", json!(1), "accessor 0"),
        ("type", json!("SCALAR"), "accessor 0"),
    ] {
        assert_advice(
            &spoilt(|r| r["accessors"][0][key] = value),
            item,
            "export the file again",
        );
    }
    let view = |key: &str, value: Value| spoilt(|r| r["bufferViews"][0][key] = value);
    assert_advice(
        &view("byteLength", json!(1u64 << 62)),
        "buffer view 0",
        "export the file again",
    );
    assert_advice(&view("buffer", json!(3)), "buffer 3", "export the file again");
    let bytes = |index: u8| {
        let mut bytes = vec![0u8; 36];
        bytes.extend([0, 1, index]);
        data_uri(&bytes)
    };
    assert_advice(
        &spoilt(|r| r["buffers"][0]["uri"] = json!(bytes(7))),
        "index 7",
        "export the file again",
    );
    let primitive = |key: &str, value: Value| spoilt(|r| r["meshes"][0]["primitives"][0][key] = value);
    assert_advice(
        &primitive("indices", json!(5)),
        "accessor 5",
        "export the file again",
    );
    assert_advice(
        &primitive("material", json!(2)),
        "material 2",
        "export the file again",
    );
    assert_advice(&primitive("mode", json!(9)), "mesh 0", "export the file again");
    let short = json!({"POSITION": 0, "NORMAL": 2});
    let sentence = spoilt(|r| {
        r["meshes"][0]["primitives"][0]["attributes"] = short;
        let two = json!({"bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3"});
        r["accessors"].as_array_mut().unwrap().push(two);
    });
    assert_advice(&sentence, "2 normals for 3 vertices", "export the file again");
    assert_advice(
        &spoilt(|r| r["nodes"][0]["mesh"] = json!(1)),
        "mesh 1",
        "export the file again",
    );
    assert_advice(
        &spoilt(|r| r["scene"] = json!(4)),
        "scene 4",
        "export the file again",
    );
}

#[test]
fn empty_scenes_are_reported_with_a_reason() {
    let nan = data_uri(&[0xff; 39]);
    let sentence = spoilt(|r| {
        r["buffers"][0]["uri"] = json!(nan);
        r["meshes"][0]["primitives"][0]
            .as_object_mut()
            .unwrap()
            .remove("indices");
    });
    assert_advice(
        &sentence,
        "1 triangle with vertices that are not finite",
        "give a file with triangles",
    );
    assert_advice(
        &spoilt(|r| r["scenes"][0]["nodes"] = json!([])),
        "no node",
        "give a file with triangles",
    );
    let flat = spoilt(|r| r["accessors"][1]["byteOffset"] = json!(0));
    assert_advice(&flat, "1 triangle without an area", "give a file with triangles");
}

#[test]
fn singular_matrices_and_node_cycles_are_reported() {
    assert_advice(
        &spoilt(|r| r["nodes"][0]["scale"] = json!([1, 1, 0])),
        "node 0 `thing`",
        "scale other than zero",
    );
    let infinite = spoilt(|r| r["nodes"][0]["translation"] = json!([1e39, 0, 0]));
    assert_advice(&infinite, "node 0 `thing`", "correct its transform");
    let mut matrix = [0; 16];
    matrix[3] = 1;
    assert_advice(
        &spoilt(|r| r["nodes"][0]["matrix"] = json!(matrix)),
        "not affine",
        "correct its transform",
    );
    assert_advice(
        &spoilt(|r| r["nodes"][0]["children"] = json!([0])),
        "own ancestor",
        "export the file again",
    );
}

#[test]
fn missing_or_short_buffers_are_reported() {
    let buffer = |key: &str, value: Value| spoilt(|r| r["buffers"][0][key] = value);
    let missing = buffer("uri", json!("not%20there.bin"));
    assert_advice(&missing, "buffer 0 is in", "put the file there");
    assert!(missing.contains("not there.bin"), "{missing}");
    assert_advice(
        &buffer("uri", json!("%ff%fe.bin")),
        "buffer 0",
        "export the file again",
    );
    assert_advice(
        &buffer("uri", json!("data:nonsense")),
        "buffer 0",
        "export the file again",
    );
    assert_advice(
        &buffer("uri", json!("https://example.org/a.bin")),
        "buffer 0",
        "download",
    );
    assert_advice(
        &buffer("byteLength", json!(40)),
        "39 bytes of the 40",
        "truncated",
    );
    let without = spoilt(|r| drop(r["buffers"][0].as_object_mut().unwrap().remove("uri")));
    assert_advice(&without, "buffer 0", "export the file again");
}

/// Returns the error message for a triangle with an image of these bytes as its base colour.
fn textured(image: &[u8]) -> String {
    spoilt(|r| {
        r["images"] = json!([{"uri": data_uri(image), "name": "paint"}]);
        r["textures"] = json!([{"source": 0}]);
        r["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]);
        let primitive = &mut r["meshes"][0]["primitives"][0];
        primitive["material"] = json!(0);
        primitive["attributes"]["TEXCOORD_0"] = json!(2);
        let uv = json!({"bufferView": 0, "componentType": 5121, "count": 3, "type": "VEC2"});
        r["accessors"].as_array_mut().unwrap().push(uv);
    })
}

#[test]
fn unreadable_or_oversized_images_are_reported() {
    assert_advice(&textured(b"GIF89a"), "image 0 `paint`", "PNG, JPEG or WebP");
    assert_advice(
        &textured(b"\x89PNG\r\n\x1a\n"),
        "image 0 `paint`",
        "PNG, JPEG or WebP",
    );
    // A PNG header of 100 000 by 100 000 texels.
    let mut bomb = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    bomb.extend(100_000u32.to_be_bytes());
    bomb.extend(100_000u32.to_be_bytes());
    bomb.extend([8, 6, 0, 0, 0]);
    bomb.extend(crc32(&bomb[12..]).to_be_bytes());
    bomb.extend(b"\0\0\0\x01IDAT\x78");
    let sentence = textured(&bomb);
    assert!(
        sentence.contains("image 0 `paint`") && sentence.contains("bad.gltf"),
        "{sentence}"
    );
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            if crc & 1 == 1 {
                crc >> 1 ^ 0xEDB8_8320
            } else {
                crc >> 1
            }
        })
    })
}

#[test]
fn truncation_at_any_length_gives_an_error() {
    let json = triangle().to_string();
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend((20 + json.len() as u32).to_le_bytes());
    glb.extend((json.len() as u32).to_le_bytes());
    glb.extend(b"JSON");
    glb.extend(json.as_bytes());
    for length in 0..glb.len() {
        let advice = sentence(&glb[..length]);
        assert!(advice.contains("give a .gltf or .glb"), "{length}: {advice}");
    }
}

#[test]
fn one_corrupt_byte_never_panics() {
    let json = triangle().to_string();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bad.gltf");
    for at in 0..json.len() {
        for byte in *b"9\"]-" {
            let mut bytes = json.clone().into_bytes();
            bytes[at] = byte;
            std::fs::write(&file, &bytes).unwrap();
            if let Ok(scene) = gltf::load(&file, &LoadOptions::default()) {
                assert_eq!(scene.validate().err(), None, "byte {at} = {byte}");
            }
        }
    }
}

/// Loads the triangle with a material and further attributes, from bytes that the accessors of `root` refer to.
fn odd_triangle(spoil: impl FnOnce(&mut Value)) -> Result<Scene, GltfError> {
    let mut root = triangle();
    let positions = [[0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let floats = positions.as_flattened().iter().flat_map(|x| x.to_le_bytes());
    let mut bytes: Vec<u8> = floats.chain([0, 1, 2, 0]).collect();
    // NaN and zero, enough for three tangents.
    bytes.extend([f32::NAN.to_le_bytes(), [0; 4]].as_flattened().repeat(6));
    let sound_normals = [[0f32, 0.0, 1.0]; 3];
    bytes.extend(sound_normals.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
    root["buffers"][0] = json!({"byteLength": bytes.len(), "uri": data_uri(&bytes)});
    root["bufferViews"][0]["byteLength"] = json!(bytes.len());
    let accessors = root["accessors"].as_array_mut().unwrap();
    accessors
        .push(json!({"bufferView": 0, "byteOffset": 40, "componentType": 5126, "count": 3, "type": "VEC4"}));
    accessors
        .push(json!({"bufferView": 0, "byteOffset": 40, "componentType": 5126, "count": 3, "type": "VEC2"}));
    for offset in [40, 88] {
        let normals =
            json!({"bufferView": 0, "byteOffset": offset, "componentType": 5126, "count": 3, "type": "VEC3"});
        accessors.push(normals);
    }
    let pixel = image_of_one_texel();
    root["images"] = json!([{"uri": data_uri(&pixel)}]);
    root["textures"] = json!([{"source": 0}]);
    root["materials"] = json!([{"normalTexture": {"index": 0}}]);
    root["meshes"][0]["primitives"][0]["material"] = json!(0);
    spoil(&mut root);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bad.gltf");
    std::fs::write(&file, root.to_string()).unwrap();
    load(&file)
}

fn image_of_one_texel() -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let texel = image::RgbaImage::from_pixel(1, 1, image::Rgba([128, 128, 255, 255]));
    texel.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

#[test]
fn tangents_without_direction_are_recomputed() {
    let attributes = [
        json!({"POSITION": 0, "TEXCOORD_0": 3}),
        json!({"POSITION": 0, "TEXCOORD_0": 3, "TANGENT": 2}),
        json!({"POSITION": 0, "TEXCOORD_0": 3, "TANGENT": 2, "NORMAL": 0}),
        json!({"POSITION": 0, "TEXCOORD_0": 3, "TANGENT": 2, "NORMAL": 4}),
        json!({"POSITION": 0, "TEXCOORD_0": 3, "TANGENT": 2, "NORMAL": 5}),
    ];
    // Load invalid tangents with different normals
    for attributes in attributes {
        let scene =
            odd_triangle(|r| r["meshes"][0]["primitives"][0]["attributes"] = attributes.clone()).unwrap();
        assert_eq!(scene.validate().err(), None, "{attributes}");
        let is_reported = scene
            .warnings
            .iter()
            .any(|w| w.contains("tangents without a direction"));
        assert_eq!(is_reported, attributes["NORMAL"] == 5, "{:?}", scene.warnings);
        let whit::scene::Geometry::Mesh(mesh) = &scene.geometries[0] else {
            panic!("a mesh");
        };
        // Generated tangents have unit length and a handedness
        for [x, y, z, w] in mesh.tangents.as_ref().unwrap().iter() {
            assert!(
                (x * x + y * y + z * z - 1.0).abs() < 1e-6 && w.abs() == 1.0,
                "{attributes}"
            );
        }
    }
    // A wrong number of tangents is an error
    let few = odd_triangle(|r| {
        r["accessors"][2]["count"] = json!(2);
        let attributes = json!({"POSITION": 0, "TEXCOORD_0": 3, "TANGENT": 2, "NORMAL": 5});
        r["meshes"][0]["primitives"][0]["attributes"] = attributes;
    });
    let sentence = few.map(|_| ()).unwrap_err().to_string();
    assert_advice(&sentence, "2 tangents for 3 vertices", "export the file again");
}

#[test]
fn normal_map_is_dropped_without_its_coordinates() {
    let scene =
        odd_triangle(|r| r["materials"][0]["normalTexture"]["texCoord"] = json!(4_000_000_000u32)).unwrap();
    assert_eq!(scene.validate().err(), None);
    assert!(scene.materials[0].layers.is_empty() && scene.images.is_empty());
    assert!(
        scene.warnings[0].contains("TEXCOORD_4000000000"),
        "{:?}",
        scene.warnings
    );
}

#[test]
fn supported_extensions_may_be_required_and_others_are_reported() {
    let required = json!([
        "KHR_materials_dispersion",
        "KHR_materials_ior",
        "KHR_materials_specular",
        "KHR_materials_transmission",
        "KHR_materials_unlit",
        "KHR_materials_volume",
        "KHR_texture_transform"
    ]);
    let used = json!(["KHR_materials_ior", "KHR_materials_subsurface", "X_y"]);
    let scene = odd_triangle(|r| {
        r["extensionsRequired"] = required;
        r["extensionsUsed"] = used;
        // Values that a scene rejects, all in the range of JSON.
        r["materials"][0]["extensions"] = json!({
            "KHR_materials_ior": {"ior": -1e300}, "KHR_materials_dispersion": {"dispersion": 1e300},
            "KHR_materials_transmission": {"transmissionFactor": 1e300},
            "KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": 1e-320, "attenuationColor": [0, 1, 2]},
            "KHR_materials_specular": {"specularColorFactor": [1e300, 1, 1]}
        });
    })
    .unwrap();
    assert_eq!(scene.validate().err(), None);
    let warned = |what: &str| scene.warnings.iter().filter(|w| w.contains(what)).count();
    assert_eq!(
        warned("KHR_materials_subsurface is not supported"),
        1,
        "{:?}",
        scene.warnings
    );
    assert_eq!(
        (warned("X_y is not supported"), warned("outside their range")),
        (1, 1)
    );
    let sentence = spoilt(|r| r["extensionsRequired"] = json!(["KHR_materials_subsurface"]));
    assert_advice(&sentence, "KHR_materials_subsurface", "export the file without");
}

#[test]
fn fan_of_a_hundred_thousand_triangles_with_normal_map_loads() {
    const COUNT: u32 = 100_000;
    let mut bytes: Vec<u8> = [0f32; 3].iter().flat_map(|x| x.to_le_bytes()).collect();
    for i in 0..=COUNT {
        let angle = std::f32::consts::PI * i as f32 / COUNT as f32;
        bytes.extend(
            [angle.cos(), angle.sin(), 0.0]
                .iter()
                .flat_map(|x: &f32| x.to_le_bytes()),
        );
    }
    let uri = data_uri(&bytes);
    let scene = odd_triangle(|r| {
        let count = COUNT + 2;
        r["buffers"][0] = json!({"byteLength": bytes.len(), "uri": uri});
        r["bufferViews"][0] = json!({"buffer": 0, "byteLength": bytes.len()});
        r["bufferViews"]
            .as_array_mut()
            .unwrap()
            .push(json!({"buffer": 0, "byteLength": bytes.len(), "byteStride": 12}));
        r["accessors"][0]["count"] = json!(count);
        r["accessors"][3] = json!({"bufferView": 1, "componentType": 5126, "count": count, "type": "VEC2"});
        r["meshes"][0]["primitives"][0] =
            json!({"attributes": {"POSITION": 0, "TEXCOORD_0": 3}, "mode": 6, "material": 0});
    })
    .unwrap();
    assert_eq!(scene.validate().err(), None);
    assert!(scene.triangle_count() as u32 > COUNT / 2);
}
