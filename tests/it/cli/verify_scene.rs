//! Command `whit verify SCENE`, run as a process.

use std::fs;
#[cfg(feature = "embree")]
use std::path::Path;

use crate::support::cli_program::{fails_with, first_light, whit};

/// Scene of a square with a crack at its lower side, a duplicate triangle, and a ball.
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
fn rays_of_a_scene_are_compared_without_errors() {
    let (text, json) = report(&first_light());
    for words in ["camera", "shadow", "reflection", "0 wrong", "triangles"] {
        assert!(text.contains(words), "{words} in {text}");
    }
    // The BSP and the native tree are compared with the first backend
    let pairs = json["pairs"].as_array().unwrap();
    assert_eq!(pairs.len(), 2);
    for (pair, name) in pairs.iter().zip(["BSP", "eight-wide tree"]) {
        assert!(pair["backends"][1].as_str().unwrap().starts_with(name), "{pair}");
        assert!(text.contains(&format!("against {name}")), "{text}");
        assert_eq!(pair["rays"]["camera"]["rays"], 40 * 30);
        assert_eq!(pair["rays"]["camera"]["wrong"].as_object().unwrap().len(), 0);
    }
    assert!(text.contains("0 ties") || text.contains("ties ("), "{text}");
    assert_eq!(json["embree"].is_object(), cfg!(feature = "embree"));
}

#[test]
fn mesh_defects_are_printed_with_their_remedies() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cracked.toml").display().to_string();
    fs::write(&path, CRACKED).unwrap();
    let (text, json) = report(&path);
    assert_eq!(json["meshes"]["t_junctions"], 1, "{text}");
    assert_eq!(json["meshes"]["duplicates"], 1, "{text}");
    assert!(text.contains("split the long edge at the corner"), "{text}");
    assert!(text.contains("remove the others"), "{text}");
}

/// Scene of two coincident slanted squares with different diagonals: rounding decides which of them is hit first.
#[cfg(feature = "embree")]
const COINCIDENT: &str = r#"
[camera]
from = [0.3, 0.2, 6]
at = [0, 0, 0]

[[light]]
kind = "directional"
direction = [0.2, -1, -1]

[[object]]
shape = { mesh = { vertices = [[-2, -2, 0], [2, -2, 0.5], [2, 2, 1], [-2, 2, 0.5]], faces = [[0, 1, 2], [0, 2, 3]] } }

[[object]]
shape = { mesh = { vertices = [[-2, -2, 0], [2, -2, 0.5], [2, 2, 1], [-2, 2, 0.5]], faces = [[1, 2, 3], [1, 3, 0]] } }
"#;

#[cfg(feature = "embree")]
fn coincident(folder: &Path) -> String {
    let path = folder.join("coincident.toml").display().to_string();
    fs::write(&path, COINCIDENT).unwrap();
    path
}

#[cfg(feature = "embree")]
#[test]
fn differences_are_drawn_recorded_and_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let scene = coincident(folder.path());
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (png, rays) = (at("a.png"), at("a.rays"));
    let run = whit(&[
        "verify",
        &scene,
        "--size",
        "80x60",
        "--precision",
        "robust",
        "--overlay",
        &png,
        "--rays-out",
        &rays,
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let written = fs::read_to_string(&rays).unwrap();
    assert!(written.starts_with("whit rays 1\n"), "{written}");
    let count = written
        .lines()
        .filter(|line| line.matches('|').count() == 3 && !line.starts_with('#'))
        .count();
    assert!(count > 0, "coincident surfaces tie: {}", run.stdout);
    let watertight = whit(&["verify", &scene, "--size", "80x60"]);
    assert!(
        watertight.stdout.contains("rays: 0 wrong, 0 ties"),
        "{}",
        watertight.stdout
    );
    let overlay = image::open(&png).unwrap().into_rgb8();
    assert_eq!(overlay.dimensions(), (80, 60));
    // Ties are drawn in yellow: much red and green, no blue.
    let yellow = overlay
        .pixels()
        .filter(|p| p[0] > 250 && p[1] > 200 && p[2] < 10)
        .count();
    assert!(yellow > 0);

    let again = whit(&["verify", &scene, "--replay", &rays]);
    assert_eq!(again.code, 0, "{}", again.stderr);
    let lines = |words: &str| {
        again
            .stdout
            .lines()
            .filter(|line| line.trim().starts_with(words))
            .count()
    };
    assert_eq!(lines("brute force"), count, "{}", again.stdout);
    assert_eq!(lines("bsp single"), count);
    assert_eq!(lines("embree fast"), count);
    // The same structures give the recorded results again.
    let query_results = |name: &str| -> Vec<String> {
        let of_name = |line: &str| Some(line.trim().strip_prefix(name)?.trim().to_owned());
        again.stdout.lines().filter_map(of_name).collect()
    };
    let now: Vec<String> = query_results("embree robust");
    assert_eq!(now.len(), count);
    for (then, now) in query_results("first, then").iter().zip(&now) {
        assert!(now.starts_with(then.as_str()), "{now} now, {then} then");
    }
    // The rays that differ on the BSP come first
    let heading = |words: &str| again.stdout.find(words).unwrap();
    let of_bsp = again.stdout[heading("BSP")..heading("eight-wide tree")]
        .lines()
        .filter(|line| line.trim().starts_with("second, then"))
        .count();
    assert!(of_bsp > 0);
    let bsp: Vec<String> = query_results("bsp")
        .into_iter()
        .filter(|reply| !reply.starts_with("single"))
        .collect();
    assert_eq!(query_results("second, then")[..of_bsp], bsp[..of_bsp]);
}

#[cfg(feature = "embree")]
#[test]
fn invalid_ray_files_are_rejected_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let scene = coincident(folder.path());
    let rays = folder.path().join("a.rays").display().to_string();
    let run = whit(&[
        "verify",
        &scene,
        "--size",
        "40x30",
        "--precision",
        "robust",
        "--rays-out",
        &rays,
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    fails_with(
        2,
        "has rays of another scene",
        &["verify", &first_light(), "--replay", &rays],
    );
    let good = fs::read_to_string(&rays).unwrap();
    fs::write(&rays, good.replacen("camera tie", "camera odd", 1)).unwrap();
    let line = good.lines().position(|line| line.contains("camera tie")).unwrap() + 1;
    fails_with(
        2,
        &format!("a.rays: line {line}: `odd`"),
        &["verify", &scene, "--replay", &rays],
    );
    fs::write(&rays, [0xff, 0xfe]).unwrap();
    fails_with(2, "cannot read", &["verify", &scene, "--replay", &rays]);
    fails_with(2, "cannot read", &["verify", &scene, "--replay", "no-such.rays"]);
}

#[test]
fn failing_scene_does_not_stop_the_checks_of_others() {
    let run = whit(&["verify", "no-such-scene.glb", &first_light(), "--size", "20x15"]);
    assert_eq!(run.code, 1, "{}", run.stderr);
    assert!(run.stdout.contains("first_light"), "{}", run.stdout);
    assert!(run.stderr.contains("no-such-scene.glb") && run.stderr.contains("1 of 2 scenes failed"));
}

#[test]
fn invalid_arguments_are_rejected_in_one_sentence() {
    fails_with(2, "no-such-scene.glb", &["verify", "no-such-scene.glb"]);
    fails_with(
        2,
        "applies to a single scene",
        &["verify", "a.glb", "b.glb", "--overlay", "a.png"],
    );
    fails_with(2, "to end in .png", &["verify", "a.glb", "--overlay", "a.exr"]);
    fails_with(
        2,
        "no-such-folder",
        &["verify", "a.glb", "--rays-out", "/no-such-folder/a.rays"],
    );
    let both = whit(&["verify", "a.glb", "--case", "H11"]);
    assert_eq!(both.code, 2, "{}", both.stderr);
}
