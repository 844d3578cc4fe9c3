//! Command `whit info`, run as a process.

use std::fs;

use crate::support::cli_program::{fails_with, first_light, whit};

#[test]
fn text_lists_triangles_lights_cameras_and_memory() {
    let run = whit(&["info", &first_light()]);
    assert_eq!((run.code, &*run.stderr), (0, ""));
    for subject in [
        "triangles",
        "light 0",
        "camera 0",
        "bounds",
        "effect         shadow on",
        "structure      user-geometry",
        "forecast       from",
        "memory",
    ] {
        assert!(
            run.stdout.lines().any(|line| line.starts_with(subject)),
            "{subject} in {}",
            run.stdout
        );
    }
}

#[test]
fn json_agrees_with_render_statistics() {
    let folder = tempfile::tempdir().unwrap();
    let [image, stats] = ["a.png", "a.json"].map(|name| folder.path().join(name).display().to_string());
    let info = whit(&["info", "--json", &first_light()]);
    assert_eq!((info.code, &*info.stderr), (0, ""));
    let info: serde_json::Value = serde_json::from_str(&info.stdout).unwrap();
    let render = whit(&[
        "render",
        &first_light(),
        "-o",
        &image,
        "--size",
        "8x8",
        "--stats",
        &stats,
    ]);
    assert_eq!(render.code, 0, "{}", render.stderr);
    let stats: serde_json::Value = serde_json::from_slice(&fs::read(&stats).unwrap()).unwrap();
    assert!(info["triangles"].as_u64().unwrap() > 0);
    assert_eq!(info["triangles"], stats["scene"]["triangles"]);
    assert_eq!(info["instances"], stats["scene"]["instances"]);
    assert_eq!(info["textures"], stats["scene"]["textures"]);
    assert_eq!(info["lights"].as_array().unwrap().len(), stats["scene"]["lights"]);
    assert_eq!(info["cameras"][0]["name"], stats["image"]["camera"]);
    assert_eq!(info["effects"]["shadow"], stats["effects"]["shadow"]["reason"]);
}

#[test]
fn switched_effects_print_their_consequences() {
    let run = whit(&["info", &first_light(), "--effects=-shadow,+dispersion"]);
    assert_eq!((run.code, &*run.stderr), (0, ""));
    for line in [
        "shadow off: switched off, so lights have no shadows; 3 of 3 lights",
        "dispersion off: no effect without refraction, which is off; switched on, though no index",
    ] {
        assert!(run.stdout.contains(line), "{line} in {}", run.stdout);
    }
    fails_with(
        2,
        "`shade` is not an effect",
        &["info", &first_light(), "--effects", "shade"],
    );
}

#[test]
fn forecast_is_omitted_if_not_requested() {
    let run = whit(&["info", &first_light(), "--forecast", "never"]);
    assert_eq!((run.code, &*run.stderr), (0, ""));
    assert!(
        run.stdout.contains("forecast       none: not requested"),
        "{}",
        run.stdout
    );
    assert!(!run.stdout.contains("(forecast: "), "{}", run.stdout);
    let json = whit(&["info", &first_light(), "--json"]).stdout;
    let info: serde_json::Value = serde_json::from_str(&json).unwrap();
    let shares = info["forecast"]["accounts"].as_object().unwrap();
    let sum: f64 = shares
        .values()
        .map(|shares| shares["rays"].as_f64().unwrap())
        .sum();
    // Rounding errors of few terms are far below one millionth.
    assert!((sum - 1.0).abs() < 1e-6, "{sum}");
}

#[test]
fn missing_scene_is_rejected_in_one_sentence() {
    fails_with(2, "no-such-scene.glb", &["info", "no-such-scene.glb"]);
}

#[cfg(unix)]
#[test]
fn closed_pipe_is_not_a_failure() {
    use std::process::{Command, Stdio};
    let mut child = Command::new(env!("CARGO_BIN_EXE_whit"))
        .args(["info", &first_light()])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!((output.status.code(), &*stderr), (Some(0), ""));
}
