//! Tests of plain glTF files of other authors: they load with their known triangle counts.
//!
//! The files are not part of the project: `WHIT_TEST_ASSETS` gives their folder, by default `../shared/assets/gltf`. A
//! file that is absent is skipped, and the test prints a message.

use std::path::{Path, PathBuf};

use whit::gltf::{self, GltfError, LoadOptions};
use whit::mesh::Mesh;
use whit::scene::{Geometry, LightKind, MaterialInput, Scene};

fn assets() -> PathBuf {
    std::env::var_os("WHIT_TEST_ASSETS").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/assets/gltf"),
        PathBuf::from,
    )
}

/// Loads an asset; prints a message and returns `None` if it is absent.
fn load(name: &str) -> Option<Result<Scene, GltfError>> {
    let path = assets().join(name);
    if !path.exists() {
        println!("skipped: {} is not there", path.display());
        return None;
    }
    Some(gltf::load(&path, &LoadOptions::default()))
}

#[test]
fn plain_files_load_with_their_triangle_counts() {
    // Triangles by the files' index counts, times their instances, minus those of zero area.
    let expected = [
        ("BoxVertexColors.glb", 12),
        ("DamagedHelmet.glb", 46356 / 3),
        ("ShapeCollection.glb", 3542),
        ("chinesedragon.gltf", 100_960),
        ("deer.gltf", 3588),
        ("many-cubes.gltf", 501 * 12),
        ("reflection_scene.gltf", 78_658),
        ("samplebuilding.gltf", 19_220),
        ("teapot.gltf", 9128 - 8),
        ("torusknot.gltf", 2880),
        ("venus.gltf", 31_398),
        ("BoxBadNormals-glTF-Binary/BoxBadNormals.glb", 12),
        ("BoxTextured_glTF/BoxTextured.gltf", 12),
        ("BoxTextured_glTF-pbrSpecularGlossiness/BoxTextured.gltf", 12),
        ("CornellBox/CornellBox.glb", 36),
        ("FlightHelmet/FlightHelmet.gltf", 94_722),
        ("GltfPrimitives/gltf_primitives.glb", 12),
        ("GolfBall/GolfBall.glb", 356),
        ("Mesh_PrimitiveMode/Mesh_PrimitiveMode_04.gltf", 2),
        ("Mesh_PrimitiveMode/Mesh_PrimitiveMode_05.gltf", 2),
        ("Mesh_PrimitiveMode/Mesh_PrimitiveMode_06.gltf", 2),
        ("Mesh_PrimitiveMode/Mesh_PrimitiveMode_11.gltf", 2),
        ("Mesh_PrimitiveMode/Mesh_PrimitiveMode_12.gltf", 2),
        ("Mesh_PrimitiveMode/Mesh_PrimitiveMode_13.gltf", 2),
        ("Mesh_PrimitiveMode/Mesh_PrimitiveMode_14.gltf", 2),
        ("Mesh_PrimitiveMode/Mesh_PrimitiveMode_15.gltf", 2),
        ("SimpleMorph/glTF/SimpleMorph.gltf", 1),
        ("cameras/Cameras.gltf", 2),
        ("simple_skin/quad_skin.glb", 2),
        ("simple_skin/simple_skin.gltf", 8),
        ("terrain/Mountains.gltf", 2 * 12_800),
        ("terrain/terrain.glb", 31_422),
        ("textureTransform/TextureTransformTest.gltf", 24),
    ];
    for (name, triangle_count) in expected {
        let Some(loaded) = load(name) else { continue };
        let scene = loaded.unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(scene.triangle_count(), triangle_count, "{name}");
        assert_eq!(scene.validate().err(), None, "{name}");
        assert!(!scene.cameras.is_empty() && !scene.lights.is_empty(), "{name}");
    }
}

#[test]
fn lines_alone_cannot_be_rendered() {
    for number in ["01", "02", "03", "08", "09", "10"] {
        let Some(loaded) = load(&format!("Mesh_PrimitiveMode/Mesh_PrimitiveMode_{number}.gltf")) else {
            continue;
        };
        let sentence = loaded.expect_err(number).to_string();
        assert!(sentence.contains("is made of lines"), "{sentence}");
    }
}

#[test]
fn points_of_other_authors_are_loaded() {
    for number in ["00", "07"] {
        let Some(loaded) = load(&format!("Mesh_PrimitiveMode/Mesh_PrimitiveMode_{number}.gltf")) else {
            continue;
        };
        let scene = loaded.unwrap_or_else(|e| panic!("{e}"));
        assert!(scene.point_count() > 0, "{number}");
        assert_eq!(scene.validate().err(), None, "{number}");
    }
}

#[test]
fn mesh_of_infinite_vertices_cannot_be_rendered() {
    let Some(loaded) = load("BoxWithInfinites-glTF-Binary/BoxWithInfinites.glb") else {
        return;
    };
    let sentence = loaded.unwrap_err().to_string();
    assert!(
        sentence.contains("12 triangles with vertices that are not finite"),
        "{sentence}"
    );
}

#[test]
fn large_packed_arrays_stay_where_they_were_read() {
    let Some(loaded) = load("DamagedHelmet.glb") else {
        return;
    };
    let scene = loaded.unwrap();
    let Geometry::Mesh(mesh) = &scene.geometries[0] else {
        panic!("the helmet is a mesh");
    };
    // The node rotates the helmet, so its vertices are baked; arrays that a rotation does not change are not copied.
    assert!(!mesh.positions.is_window());
    assert!(mesh.tex_coords[0].is_window());
    // Its textures, and the map of the default light
    assert_eq!(scene.images.len(), 5 + 1);
    assert_eq!((scene.images[0].width, scene.images[0].height), (2048, 2048));
}

#[test]
fn packed_vertices_and_indices_of_a_glb_are_not_copied() {
    let json = r#"{"asset":{"version":"2.0"},"nodes":[{"mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
        {"bufferView":0,"byteOffset":36,"componentType":5125,"count":3,"type":"SCALAR"}],
        "bufferViews":[{"buffer":0,"byteLength":48}],"buffers":[{"byteLength":48}]}"#;
    // Write the GLB: header, JSON chunk, binary chunk
    let json = format!("{json:<width$}", width = json.len().next_multiple_of(4));
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend((12 + 8 + json.len() as u32 + 8 + 48).to_le_bytes());
    glb.extend((json.len() as u32).to_le_bytes());
    glb.extend(b"JSON");
    glb.extend(json.as_bytes());
    glb.extend(48u32.to_le_bytes());
    glb.extend(b"BIN\0");
    for x in [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
        glb.extend(x.to_le_bytes());
    }
    for i in [2u32, 0, 1] {
        glb.extend(i.to_le_bytes());
    }
    let folder = tempfile::tempdir().unwrap();
    // The format is detected by the content, not by the name.
    let file = folder.path().join("triangle.gltf");
    std::fs::write(&file, glb).unwrap();
    let scene = gltf::load(&file, &LoadOptions::default()).unwrap();
    let Geometry::Mesh(mesh) = &scene.geometries[0] else {
        panic!("a mesh");
    };
    assert!(mesh.positions.is_window() && mesh.triangles.is_window());
    assert_eq!(mesh.positions[1], [1.0, 0.0, 0.0]);
    assert_eq!(mesh.triangles[..], [[2, 0, 1]]);
    assert!(mesh.normals.is_none());
}

#[test]
fn cameras_follow_their_nodes() {
    let Some(loaded) = load("cameras/Cameras.gltf") else {
        return;
    };
    let scene = loaded.unwrap();
    let place = scene.cameras[0].world_from_camera.translation;
    assert_eq!(place.to_array(), [0.5, 0.5, 3.0]);
    assert_eq!(scene.cameras.len(), 2);
    assert_eq!(scene.ambient, [0.25; 3], "the file has no light of its own");
}

#[test]
fn first_light_scene_loads_with_lights_and_instances() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/first_light.gltf");
    let scene = gltf::load(&path, &LoadOptions::default()).unwrap();
    assert_eq!(scene.validate().err(), None);
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert_eq!(scene.lights.len(), 3);
    assert!(matches!(scene.lights[1].kind, LightKind::Spot { .. }));
    assert_eq!(scene.ambient, [0.0; 3]);
    assert!(scene.instances.iter().filter(|i| i.is_mirrored()).count() == 1);
    assert!(scene.instances.len() > 40);
}

fn mesh(scene: &Scene, index: usize) -> &Mesh {
    match &scene.geometries[index] {
        Geometry::Mesh(mesh) => mesh,
        Geometry::Shape(_) | Geometry::Points(_) => panic!("geometry {index} is no mesh"),
    }
}

/// Asserts that every tangent has unit length, is perpendicular to its normal up to the rounding of both, and has a
/// handedness.
fn assert_frames(mesh: &Mesh, name: &str) {
    /// Tolerance: files round directions to f32 or coarser; baking rotates them.
    const ACROSS: f32 = 0.02;
    let (tangents, normals) = (mesh.tangents.as_ref().unwrap(), mesh.normals.as_ref().unwrap());
    assert_eq!(tangents.len(), mesh.positions.len(), "{name}");
    for &v in mesh.triangles.iter().flatten() {
        let ([x, y, z, w], [a, b, c]) = (tangents[v as usize], normals[v as usize]);
        let (length, dot) = (x * x + y * y + z * z, x * a + y * b + z * c);
        assert!(
            (length - 1.0).abs() < ACROSS && dot.abs() < ACROSS && w.abs() == 1.0,
            "{name}: vertex {v} has {x} {y} {z} {w} on {a} {b} {c}"
        );
    }
}

#[test]
fn helmet_loads_with_all_maps_and_tangents() {
    let Some(loaded) = load("DamagedHelmet.glb") else {
        return;
    };
    let scene = loaded.unwrap();
    let parameters = [
        MaterialInput::BaseColor,
        MaterialInput::MetallicRoughness,
        MaterialInput::Emission,
        MaterialInput::Normal,
        MaterialInput::Occlusion,
    ];
    let material = &scene.materials[0];
    assert_eq!(
        material.layers.iter().map(|l| l.parameter).collect::<Vec<_>>(),
        parameters
    );
    assert!(material.layers.iter().all(|l| l.strength == 1.0));
    assert_frames(mesh(&scene, 0), "DamagedHelmet");
}

#[test]
fn computed_tangents_agree_with_tangents_of_files() {
    let Some(loaded) = load("FlightHelmet/FlightHelmet.gltf") else {
        return;
    };
    let scene = loaded.unwrap();
    let (mut corner_count, mut agreeing) = (0u32, 0u32);
    // Compare the file's tangents with generated ones, corner by corner
    for index in 0..scene.geometries.len() {
        let given = mesh(&scene, index);
        assert_frames(given, "FlightHelmet");
        let made = given.with_tangents(0);
        let (given_tangents, made_tangents) = (given.tangents.as_ref(), made.tangents.as_ref());
        let corners = given
            .triangles
            .as_flattened()
            .iter()
            .zip(made.triangles.as_flattened());
        for (&g, &m) in corners {
            let [a, b] = [
                given_tangents.unwrap()[g as usize],
                made_tangents.unwrap()[m as usize],
            ];
            let cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
            corner_count += 1;
            agreeing += u32::from(cosine > 0.99 && a[3] == b[3]);
        }
    }
    // The exporter's tangents are not bit-identical to MikkTSpace's.
    println!("{agreeing} of {corner_count} corners agree");
    assert!(
        agreeing as f64 > 0.95 * corner_count as f64,
        "{agreeing} of {corner_count}"
    );
}

#[test]
fn texture_transform_test_points_at_the_green_markers() {
    let Some(loaded) = load("textureTransform/TextureTransformTest.gltf") else {
        return;
    };
    let scene = loaded.unwrap();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    let transform = |name: &str| {
        let material = scene.materials.iter().find(|m| m.name == name).unwrap();
        material
            .layer(MaterialInput::BaseColor)
            .unwrap()
            .texture
            .transform
    };
    assert_eq!(transform("Offset U").apply([0.25, 0.25]), [0.75, 0.25]);
    assert_eq!(transform("Offset V").apply([0.25, 0.25]), [0.25, 0.75]);
    assert_eq!(transform("Offset UV").apply([0.25, 0.25]), [0.75, 0.75]);
    // Positions of markers by their nodes' translations: the unrotated arrow's tip is at the yellow one. A square
    // extends from -0.5 to 0.5, and v increases downwards.
    let coordinates = |[x, y]: [f32; 2]| [x + 0.5, 0.5 - y];
    let tip = coordinates([0.277_817_46, -0.277_817_46]);
    let markers = [
        ("Rotation", [-0.079_048_224, -0.516_267_5], 1e-3),
        ("Scale", [0.018_544_973, -0.018_544_973], 1e-3),
        ("All", [-0.07, -0.25], 0.05),
    ];
    for (name, marker, tolerance) in markers {
        let [u, v] = transform(name).apply(coordinates(marker));
        let error = (u - tip[0]).hypot(v - tip[1]);
        assert!(error < tolerance, "{name}: {u} {v} is {error} from the tip");
    }
}

#[test]
fn supported_extensions_of_real_files_are_read_others_reported() {
    if let Some(loaded) = load("terrain/Mountains.gltf") {
        assert!(loaded.unwrap().warnings.iter().all(|w| !w.contains("extension")));
    }
    if let Some(loaded) = load("GolfBall/GolfBall.glb") {
        let scene = loaded.unwrap();
        assert!(scene.warnings.iter().all(|w| !w.contains("extension")));
        assert!(scene.materials.iter().any(|material| material.coated().is_some()));
        assert_frames(mesh(&scene, 0), "GolfBall");
    }
}
