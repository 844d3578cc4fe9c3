//! Tests of glTF node animations: transforms at given times, in generated files.

use std::fs;
use std::path::{Path, PathBuf};

use base64::Engine;
use glam::DVec3;
use serde_json::{Value, json};
use whit::gltf::{AnimationTime, LoadOptions, load};
use whit::scene::Scene;

/// Samplers as interpolation, times and values.
type Samplers<'a> = &'a [(&'a str, &'a [f32], &'a [f32])];

/// Writes a file with a triangle on an animated node, and a camera on its child.
fn file(folder: &Path, samplers: Samplers, channels: Value) -> PathBuf {
    let mut bytes: Vec<u8> = Vec::new();
    let (mut views, mut accessors) = (Vec::new(), Vec::new());
    // Append an array as buffer view and accessor
    let mut add = |numbers: &[f32], kind: &str, width: usize| {
        views.push(json!({"buffer": 0, "byteOffset": bytes.len(), "byteLength": 4 * numbers.len()}));
        accessors.push(json!({
            "bufferView": views.len() - 1, "componentType": 5126, "count": numbers.len() / width, "type": kind
        }));
        bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        accessors.len() - 1
    };
    let positions = add(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3", 3);
    // Write the samplers, whose splines have three values a key
    let samplers: Vec<Value> = samplers
        .iter()
        .map(|(how, times, values)| {
            let per_key = values.len() / times.len() / if *how == "CUBICSPLINE" { 3 } else { 1 };
            let input = add(times, "SCALAR", 1);
            let output = add(values, if per_key == 4 { "VEC4" } else { "VEC3" }, per_key);
            json!({"input": input, "output": output, "interpolation": how})
        })
        .collect();
    // Write the document with an embedded buffer
    let uri = format!(
        "data:;base64,{}",
        base64::engine::general_purpose::STANDARD.encode(&bytes)
    );
    let gltf = json!({
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "children": [1], "name": "mover"}, {"camera": 0, "translation": [0, 0, 5]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": positions}}]}],
        "animations": [{"name": "move", "samplers": samplers, "channels": channels}],
        "accessors": accessors, "bufferViews": views,
        "buffers": [{"uri": uri, "byteLength": bytes.len()}]
    });
    let path = folder.join("animated.gltf");
    fs::write(&path, gltf.to_string()).unwrap();
    path
}

fn at(path: &Path, animation: Option<&str>, seconds: f64) -> Result<Scene, String> {
    let options = LoadOptions {
        pose: Some(AnimationTime {
            animation: animation.map(str::to_owned),
            seconds,
        }),
        ..LoadOptions::default()
    };
    load(path, &options).map_err(|error| error.to_string())
}

/// Returns the position of the camera, a child of the animated node.
fn eye(scene: &Scene) -> DVec3 {
    scene
        .normalisation
        .inverse_map()
        .transform_point3(scene.cameras[0].world_from_camera.translation)
}

fn channel(path: &str) -> Value {
    json!([{"sampler": 0, "target": {"node": 0, "path": path}}])
}

#[test]
fn animated_node_and_children_follow_the_time() {
    let folder = tempfile::tempdir().unwrap();
    let values = [0.0, 0.0, 0.0, 4.0, 0.0, 0.0];
    let path = file(
        folder.path(),
        &[("LINEAR", &[1.0, 3.0], &values)],
        channel("translation"),
    );
    for (seconds, x) in [(0.0, 0.0), (1.5, 1.0), (2.0, 2.0), (9.0, 4.0)] {
        let scene = at(&path, Some("move"), seconds).unwrap();
        assert_eq!(eye(&scene), DVec3::new(x, 0.0, 5.0), "at {seconds} s");
        let corner = scene
            .normalisation
            .inverse_map()
            .transform_point3(scene.bounds().min);
        assert_eq!(corner, DVec3::new(x, 0.0, 0.0), "at {seconds} s");
    }
    // Without a time the node has its static transform.
    let scene = load(&path, &LoadOptions::default()).unwrap();
    assert_eq!(eye(&scene), DVec3::new(0.0, 0.0, 5.0));
    assert_eq!(scene.animations.len(), 1);
    assert_eq!(
        (scene.animations[0].name.as_str(), scene.animations[0].seconds),
        ("move", [1.0, 3.0])
    );
}

#[test]
fn quarter_turn_is_an_eighth_at_half_time() {
    let folder = tempfile::tempdir().unwrap();
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let values = [0.0, 0.0, 0.0, 1.0, 0.0, half, 0.0, half];
    let path = file(
        folder.path(),
        &[("LINEAR", &[0.0, 1.0], &values)],
        channel("rotation"),
    );
    let expected = DVec3::new(5.0, 0.0, 5.0) * std::f64::consts::FRAC_1_SQRT_2;
    let found = eye(&at(&path, None, 0.5).unwrap());
    // The file stores f32.
    assert!(
        found.abs_diff_eq(expected, 5.0 * f64::from(f32::EPSILON)),
        "{found}"
    );
}

#[test]
fn spline_animates_the_scale_of_a_node() {
    let folder = tempfile::tempdir().unwrap();
    // In tangent, value, out tangent for each key: from 1 to 3 in 2 s, both flat, is 2 in the middle and 1.3125 at 1/4:
    // 1 + 2 (3/16 - 2/64) = 1.3125.
    let values = [
        0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 3.0, 3.0, 0.0, 0.0, 0.0,
    ];
    let path = file(
        folder.path(),
        &[("CUBICSPLINE", &[0.0, 2.0], &values)],
        channel("scale"),
    );
    for (seconds, scale) in [(0.0, 1.0), (0.5, 1.3125), (1.0, 2.0), (2.0, 3.0)] {
        let found = eye(&at(&path, Some("0"), seconds).unwrap());
        assert_eq!(found, DVec3::new(0.0, 0.0, 5.0 * scale), "at {seconds} s");
    }
}

#[test]
fn invalid_animations_are_reported_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let good: [f32; 6] = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
    let cases: [(Samplers, Value, Option<&str>, &str); 7] = [
        (
            &[("LINEAR", &[0.0, 1.0], &good)],
            channel("scale"),
            Some("run"),
            "animation `run` does not exist: the file has 0 `move`",
        ),
        (
            &[("LINEAR", &[0.0, 1.0], &good)],
            channel("hue"),
            None,
            "animation",
        ),
        (
            &[("LINEAR", &[1.0, 1.0], &good)],
            channel("scale"),
            None,
            "times that do not increase",
        ),
        (&[("LINEAR", &[0.0, f32::NAN], &good)], channel("scale"), None, ""),
        (
            &[("CURVED", &[0.0, 1.0], &good)],
            channel("scale"),
            None,
            "animation",
        ),
        (
            &[("LINEAR", &[0.0, 1.0], &good)],
            channel("rotation"),
            None,
            "VEC",
        ),
        (
            &[("LINEAR", &[0.0, 1.0], &good)],
            json!([{"sampler": 0, "target": {"node": 7, "path": "scale"}}]),
            None,
            "node 7",
        ),
    ];
    for (samplers, channels, animation, words) in cases {
        let path = file(folder.path(), samplers, channels);
        let message = at(&path, animation, 0.5).unwrap_err();
        assert!(
            message.contains(words) && message.contains("animated.gltf"),
            "{words}: {message}"
        );
        assert!(!message.contains('\n'), "{message}");
    }
}
