//! `whit verify SCENE` as its users meet it.

mod cli_program;

use std::fs;

use cli_program::{fails_with, first_light, whit};

/// A square with a crack at its lower side, a triangle that is there twice, and a ball.
const CRACKED: &str = r#"
[camera]
from = [1, 1, 6]
at = [1, 1, 0]

[[light]]
kind = "directional"
direction = [0.2, -1, -1]

[[object]]
shape = { mesh = { vertices = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [1, 0, 0], [0, -1, 0], [2, -1, 0]], faces = [[0, 1, 2], [4, 3, 0], [4, 5, 3], [5, 1, 3], [2, 0, 1]] } }

[[object]]
shape = "sphere"
"#;

fn report(scene: &str) -> (String, serde_json::Value) {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("own.json").display().to_string();
    let run = whit(&["verify", scene, "--size", "40x30", "--json", &json]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let all: serde_json::Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    (run.stdout, all[0].clone())
}

#[test]
fn a_scenes_own_rays_are_compared_and_nothing_is_wrong() {
    let (text, json) = report(&first_light());
    for words in ["camera", "shadow", "reflection", "0 wrong", "triangles"] {
        assert!(text.contains(words), "{words} in {text}");
    }
    assert_eq!(json["rays"]["camera"]["rays"], 40 * 30);
    assert_eq!(json["rays"]["camera"]["wrong"].as_object().unwrap().len(), 0);
    assert_eq!(json["embree"].is_object(), cfg!(feature = "embree"));
}

#[test]
fn what_is_wrong_with_a_mesh_is_told_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cracked.toml").display().to_string();
    fs::write(&path, CRACKED).unwrap();
    let (text, json) = report(&path);
    assert_eq!(json["meshes"]["t_junctions"], 1, "{text}");
    assert_eq!(json["meshes"]["duplicates"], 1, "{text}");
    assert!(text.contains("split the long edge at the corner"), "{text}");
    assert!(text.contains("take the others away"), "{text}");
}

#[test]
fn what_cannot_be_checked_is_refused_in_one_sentence() {
    fails_with(2, "no-such-scene.glb", &["verify", "no-such-scene.glb"]);
    let both = whit(&["verify", "a.glb", "--case", "H11"]);
    assert_eq!(both.code, 2, "{}", both.stderr);
}
