//! Command `whit bench`, run as a process.

use std::collections::BTreeSet;
use std::fs;

use crate::support::cli_program::{fails_with, first_light, names_in, whit};

#[test]
fn all_backends_and_modes_agree_on_the_same_rays() {
    let folder = tempfile::tempdir().unwrap();
    let [json, html] =
        ["bench.json", "bench.html"].map(|name| folder.path().join(name).display().to_string());
    let flags = ["--size", "48x32", "--repeat", "2", "--json", &json];
    let page = ["--html", &html, "--date", "2026-01-02"];
    let run = whit(&[&["bench", &first_light()], &flags[..], &page].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stdout.contains("Mrays/s"), "{}", run.stdout);
    let page = fs::read_to_string(&html).unwrap();
    for words in [
        "first_light",
        r#"["date","2026-01-02"]"#,
        "million rays per second",
    ] {
        assert!(page.contains(words), "{words}");
    }
    let rows: serde_json::Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    let mut measured = BTreeSet::new();
    for row in rows.as_array().unwrap() {
        for key in ["scene", "backend", "precision", "rays", "mode"] {
            assert!(row[key].is_string(), "{key} in {row}");
        }
        for key in ["mrays_per_s", "mrays_per_s_min", "mrays_per_s_max"] {
            assert!(row[key].as_f64().unwrap() > 0.0, "{key} in {row}");
        }
        assert!(row["build_seconds"].is_f64() && row["bytes"].is_u64(), "{row}");
        assert!(row["mrays_per_s_min"].as_f64() <= row["mrays_per_s_max"].as_f64());
        assert_eq!(row["mismatches"], 0, "{row}");
        assert!(row["triangles"].as_u64().unwrap() > 0, "{row}");
        assert_eq!(row["scaling"], serde_json::json!([]), "{row}");
        assert_eq!(row["embree"].is_object(), row["backend"] == "embree", "{row}");
        assert_eq!(row["frame"].is_object(), cfg!(feature = "embree"), "{row}");
        measured.insert(format!(
            "{} {} {}",
            row["rays"].as_str().unwrap(),
            row["backend"].as_str().unwrap(),
            row["mode"].as_str().unwrap()
        ));
    }
    let mut ways = vec!["bsp single", "bsp packet", "bsp batch"];
    if cfg!(feature = "embree") {
        ways.extend([
            "embree raw",
            "embree raw-single",
            "embree single",
            "embree packet",
        ]);
    }
    for rays in ["camera", "shadow", "reflection", "random"] {
        for way in &ways {
            assert!(
                measured.contains(&format!("{rays} {way}")),
                "{rays} {way} in {measured:?}"
            );
        }
    }
}

#[cfg(feature = "embree")]
#[test]
fn every_precision_is_measured_with_its_own_frame_time() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("bench.json").display().to_string();
    // In an image this small, some packets have inactive lanes.
    let flags = ["--size", "32x32", "--repeat", "1", "--json", &json];
    let run = whit(&[&["bench", &first_light()], &flags[..]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    for precision in ["fast", "robust"] {
        assert!(
            run.stdout.contains(&format!("frame, {precision}: ")),
            "{}",
            run.stdout
        );
    }
    let rows: serde_json::Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    let seconds_at = |precision: &str| {
        let is_it = |row: &&serde_json::Value| {
            row["backend"] == "embree" && row["mode"] == "packet" && row["precision"] == precision
        };
        let row = rows.as_array().unwrap().iter().find(is_it).unwrap();
        row["frame"]["seconds"].as_f64().unwrap()
    };
    let seconds = ["fast", "robust", "watertight"].map(seconds_at);
    assert!(seconds.iter().all(|&seconds| seconds > 0.0));
    assert!(
        seconds[0] != seconds[1] && seconds[1] != seconds[2],
        "{seconds:?}"
    );
}

#[cfg(feature = "embree")]
const PLACED: &str = r#"
[camera]
from = [0, 1, 9]
at = [0, 0, 0]

[[object]]
shape = { mesh = { vertices = [[-1, 0, 0], [1, 0, 0], [0, 1, 0]], faces = [[0, 1, 2]] } }
repeat = { count = [3, 1, 1], step = [2, 0, 0] }
"#;

#[cfg(feature = "embree")]
#[test]
fn both_kinds_of_instancing_are_measured_only_for_instances() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    fs::write(path("placed.toml"), PLACED).unwrap();
    let flags = ["--size", "16x16", "--repeat", "1", "--json", &path("a.json")];
    let chosen = |flag: &[&str]| {
        let run = whit(&[&["bench", &path("placed.toml")], &flags[..], flag].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        for words in ["callback instancing", "native instancing", " native "] {
            assert!(run.stdout.contains(words), "{words} in {}", run.stdout);
        }
        let rows: serde_json::Value = serde_json::from_slice(&fs::read(path("a.json")).unwrap()).unwrap();
        for row in rows.as_array().unwrap() {
            assert_eq!(row["instancing"].is_string(), row["backend"] == "embree", "{row}");
            assert_eq!(row["mismatches"], 0, "{row}");
        }
        rows[0]["instancing"].as_str().unwrap().to_owned()
    };
    assert_eq!(chosen(&[]), "callback");
    assert_eq!(chosen(&["--precision", "fast"]), "native");
    let native = ["--precision", "robust", "--instancing", "native"];
    assert_eq!(chosen(&native), "native");
    let refused = whit(&["bench", &path("placed.toml"), "--instancing", "native"]);
    assert_eq!(refused.code, 2);
    assert!(
        refused.stderr.contains("`--precision fast` or `robust`"),
        "{}",
        refused.stderr
    );
    assert_eq!(chosen(&["--precision", "robust"]), "callback");

    fs::write(path("plain.toml"), "[[object]]\nshape = \"sphere\"\n").unwrap();
    let run = whit(&[&["bench", &path("plain.toml")], &flags[..]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(!run.stdout.contains("instancing"), "{}", run.stdout);
}

#[test]
fn flags_override_the_image_settings_of_the_scene_file() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let text = "[output]\nsize = [6, 4]\nspp = 3\ndepth = 0\n[material.m]\nroughness = 0\n\
                [[object]]\nshape = 'sphere'\nmaterial = 'm'\n";
    fs::write(at("a.toml"), text).unwrap();
    let count = |kind: &str, flags: &[&str]| {
        let (scene, json) = (at("a.toml"), at("a.json"));
        let run = whit(&[&["bench", &scene, "--repeat", "1", "--json", &json], flags].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        let rows: serde_json::Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
        let row = rows.as_array().unwrap().iter().find(|row| row["rays"] == kind);
        row.map_or(0, |row| row["ray_count"].as_u64().unwrap())
    };
    assert_eq!(count("camera", &[]), 6 * 4 * 3);
    assert_eq!(count("reflection", &[]), 0);
    assert_eq!(count("camera", &["--size", "5x5", "--spp", "1"]), 25);
    assert!(count("reflection", &["--depth", "1"]) > 0);
}

#[test]
fn sweep_measures_generated_meshes_and_reports_crossings() {
    let folder = tempfile::tempdir().unwrap();
    let [json, html] = ["a.json", "a.html"].map(|name| folder.path().join(name).display().to_string());
    let flags = ["--size", "32x24", "--repeat", "1", "--threads", "2", "--scaling"];
    let files = ["--json", &json, "--html", &html];
    let sweep = ["bench", "--sweep", "--most-triangles", "2000"];
    let run = whit(&[&sweep, &flags[..], &files].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    let rows: serde_json::Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    let mut measured = BTreeSet::new();
    for row in rows.as_array().unwrap() {
        assert_eq!(row["mismatches"], 0, "{row}");
        for (list, key) in [("scaling", "mrays_per_s"), ("build_scaling", "build_seconds")] {
            let all = row[list].as_array().unwrap();
            let threads: Vec<_> = all
                .iter()
                .map(|scaled| scaled["threads"].as_u64().unwrap())
                .collect();
            assert_eq!(threads, [1, 2], "{row}");
            assert!(
                all.iter().all(|scaled| scaled[key].as_f64().unwrap() > 0.0),
                "{row}"
            );
        }
        measured.insert((row["triangles"].as_u64().unwrap(), row["rays"].as_str().unwrap()));
    }
    // The sphere has 12 · 9² or 12 · 13² triangles, the ground 2.
    let sizes = [974, 2030].map(|size| ["camera", "random", "reflection", "shadow"].map(|kind| (size, kind)));
    assert_eq!(Vec::from_iter(measured), sizes.concat());
    assert!(run.stdout.contains("efficiency"), "{}", run.stdout);
    assert!(
        run.stdout.contains("bumpy sphere, 2 000 triangles"),
        "{}",
        run.stdout
    );
    let page = fs::read_to_string(&html).unwrap();
    assert!(page.contains("Speed over mesh size") && page.contains("Dashed:"));
    for words in [
        "crossings of Embree with the native tree and the BSP",
        "camera rays, packets against batches      native",
        "builds per second",
        "triangles per byte",
    ] {
        assert_eq!(
            run.stdout.contains(words),
            cfg!(feature = "embree"),
            "{words} in {}",
            run.stdout
        );
    }
    let same = whit(&["compare-stats", &json, &json]);
    assert_eq!(same.code, 0, "{}", same.stderr);
    assert!(same.stdout.contains("0 regressed") && same.stdout.contains("0 unclear"));
}

#[test]
fn invalid_input_is_rejected_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let there = |name: &str| folder.path().join(name).display().to_string();
    fails_with(
        2,
        "no-such-scene.glb",
        &["bench", "no-such-scene.glb", "--json", &there("a.json")],
    );
    fails_with(
        2,
        "there is no folder",
        &["bench", &first_light(), "--json", &there("no/a.json")],
    );
    fails_with(
        2,
        "there is no folder",
        &["bench", &first_light(), "--html", &there("no/a.html")],
    );
    fails_with(2, "1..=1000", &["bench", &first_light(), "--repeat", "0"]);
    fails_with(
        2,
        "1000..=300000000",
        &["bench", "--sweep", "--most-triangles", "5"],
    );
    let scene = first_light();
    for (words, flags) in [
        ("SCENE", &[][..]),
        ("--sweep", &[&scene, "--sweep"]),
        ("--most-triangles", &[&scene, "--most-triangles", "5000"]),
        ("--extents", &[&scene, "--extents", "--html", &there("a.html")]),
        ("--html", &[&scene, "--date", "today"]),
    ] {
        let run = whit(&[&["bench"], flags].concat());
        assert_eq!((run.code, &*run.stdout), (2, ""), "{flags:?}");
        assert!(
            run.stderr.starts_with("whit: ") && run.stderr.contains(words),
            "{}",
            run.stderr
        );
    }
    assert_eq!(names_in(folder.path()), Vec::<String>::new());
}
