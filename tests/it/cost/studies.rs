//! `whit cost` from the command line: what is measured, what is written, and what is refused.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use serde_json::Value;

fn whit(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_whit"))
        .args(args)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap()
}

/// The study of a scene, small and quick.
fn study(scene: &str, folder: &Path) -> Value {
    study_of(scene, ["32x24", "4"], folder)
}

/// The study of a scene at a size and with a budget in seconds.
pub fn study_of(scene: &str, [size, budget]: [&str; 2], folder: &Path) -> Value {
    let out = folder.to_str().unwrap();
    let done = whit(&["cost", scene, "--size", size, "--budget", budget, "--out", out]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    serde_json::from_slice(&fs::read(folder.join("report.json")).unwrap()).unwrap()
}

fn points<'a>(study: &'a Value, knob: &str) -> Vec<&'a Value> {
    let points = study["points"].as_array().unwrap().iter();
    points.filter(|point| point["knob"] == knob).collect()
}

#[test]
fn mirror_scene_has_its_knobs_and_more_samples_reduce_error() {
    let folder = tempfile::tempdir().unwrap();
    let study = study("scenes/mirror_room.toml", folder.path());
    let all = study["points"].as_array().unwrap();
    assert!(all[0]["knob"].is_null() && all[0]["time_ratio"]["value"] == 1.0);
    for knob in ["samples", "pattern", "depth", "cutoff"] {
        assert!(!points(&study, knob).is_empty(), "no {knob}");
    }
    // Without Embree there is no other path than the base's.
    assert_eq!(points(&study, "hit-path").is_empty(), !cfg!(feature = "embree"));
    // Nothing in the scene calls for these.
    for knob in [
        "wavelengths",
        "march-step",
        "light-samples",
        "rough-rays",
        "instancing",
        "build-quality",
        "compactness",
    ] {
        assert!(points(&study, knob).is_empty(), "{knob}");
    }
    let errors = |point: &Value, kind: &str| point["geometry"][kind].as_u64();
    assert!(errors(&all[0], "camera_rays") > Some(0) && all[0]["build_bytes"].as_u64() > Some(0));
    assert_eq!(errors(&all[0], "false_shadows"), Some(0), "by the bound");
    assert!(
        points(&study, "samples")
            .iter()
            .all(|point| point["geometry"].is_null())
    );
    let spawn = points(&study, "spawn-points");
    let none = spawn.iter().find(|point| point["level"] == "none").unwrap();
    assert!(errors(none, "false_shadows") > Some(0), "{none}");
    assert_eq!(points(&study, "hit-refinement").len(), 1);
    let rmse = |point: &Value| point["rmse"]["value"].as_f64().unwrap();
    let samples = points(&study, "samples");
    let (first, last) = (samples[0], samples[samples.len() - 1]);
    assert!(rmse(last) < rmse(first), "{} and {}", rmse(first), rmse(last));
    assert!(
        rmse(points(&study, "depth")[0]) > 2.0 * rmse(&all[0]),
        "a room without mirrors"
    );
    for point in all {
        let [low, value, high] = ["low", "value", "high"].map(|end| point["seconds"][end].as_f64().unwrap());
        assert!(0.0 < low && low <= value && value <= high);
    }
    let files = [
        "report.html",
        "points.csv",
        "ref.exr",
        "settings.toml",
        "difference.png",
        "flip.png",
    ];
    for file in files {
        assert!(
            fs::metadata(folder.path().join(file)).unwrap().len() > 0,
            "{file}"
        );
    }
    let csv = fs::read_to_string(folder.path().join("points.csv")).unwrap();
    assert_eq!(csv.lines().count(), all.len() + 1);
    let seconds = study["timing"]["spent"].as_f64().unwrap();
    assert!(seconds > 0.0 && study["timing"]["blocks"].as_u64().unwrap() >= 1);
}

#[test]
fn render_applies_the_settings_file_of_a_study() {
    let folder = tempfile::tempdir().unwrap();
    study("scenes/first_light.gltf", folder.path());
    let settings = folder.path().join("settings.toml");
    let [by_file, by_flags, stats] = ["a.exr", "b.exr", "stats.json"].map(|name| folder.path().join(name));
    let rendered = |image: &Path, more: &[&str]| {
        let image = image.to_str().unwrap();
        let done = whit(
            &[
                &[
                    "render",
                    "scenes/first_light.gltf",
                    "-o",
                    image,
                    "--size",
                    "48x36",
                ],
                more,
            ]
            .concat(),
        );
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    };
    let text = "[settings]\nspp = 3\npattern = \"jittered\"\ndepth = 2\nbackend = \"bsp\"\n";
    fs::write(folder.path().join("own.toml"), text).unwrap();
    let own = folder.path().join("own.toml");
    rendered(&by_file, &["--settings", own.to_str().unwrap()]);
    rendered(
        &by_flags,
        &[
            "--spp",
            "3",
            "--pattern",
            "jittered",
            "--depth",
            "2",
            "--backend",
            "bsp",
        ],
    );
    assert_eq!(fs::read(&by_file).unwrap(), fs::read(&by_flags).unwrap());
    let [settings, stats] = [&settings, &stats].map(|path| path.to_str().unwrap());
    rendered(&by_file, &["--settings", settings, "--stats", stats]);
    let stats: Value = serde_json::from_slice(&fs::read(stats).unwrap()).unwrap();
    let text = fs::read_to_string(settings).unwrap();
    assert!(text.contains(&format!("spp = {}\n", stats["spp"])), "{text}");
    for (more, word) in [
        (&["--settings", settings, "--spp", "4"][..], "--spp"),
        (&["--settings", "Cargo.toml"], "not a settings file"),
        (&["--settings", "nowhere.toml"], "nowhere.toml"),
    ] {
        let done = whit(&[&["render", "scenes/first_light.gltf", "-o", "x.png"], more].concat());
        let said = String::from_utf8_lossy(&done.stderr);
        assert_eq!(done.status.code(), Some(2), "{said}");
        assert!(said.contains(word), "{said}");
    }
}

#[test]
fn settings_are_chosen_and_unreachable_targets_reported() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let run = |target: &[&str]| {
        let common = [
            "cost",
            "scenes/first_light.gltf",
            "--size",
            "24x18",
            "--budget",
            "4",
            "--out",
            out,
        ];
        let done = whit(&[&common[..], target].concat());
        let report = fs::read(folder.path().join("report.json")).unwrap();
        let report: Value = serde_json::from_slice(&report).unwrap();
        let said = [done.stdout, done.stderr].concat();
        (
            done.status.code().unwrap(),
            report["choice"].clone(),
            String::from_utf8(said).unwrap(),
        )
    };
    // As much as the base errs by, at least: something reaches it.
    let (code, choice, said) = run(&["--max-error", "0.5"]);
    assert_eq!((code, &choice["reached"]), (0, &Value::Bool(true)), "{said}");
    assert!(choice["rmse"]["high"].as_f64().unwrap() <= 0.5, "{said}");
    let (code, choice, said) = run(&["--max-error", "0.000001"]);
    assert_eq!((code, &choice["reached"]), (1, &Value::Bool(false)), "{said}");
    assert!(
        said.contains("no settings were found") && said.contains("nearest to"),
        "{said}"
    );
    let (code, choice, said) = run(&["--max-time", "1000"]);
    assert_eq!((code, &choice["reached"]), (0, &Value::Bool(true)), "{said}");
    assert!(
        choice["whole_seconds"]["high"].as_f64().unwrap() <= 1000.0,
        "{said}"
    );
    let settings = fs::read_to_string(folder.path().join("settings.toml")).unwrap();
    assert!(
        settings.contains("[settings]") && settings.contains("spp = "),
        "{settings}"
    );
}

#[test]
fn render_reaches_error_and_time_targets_or_reports_failure() {
    let folder = tempfile::tempdir().unwrap();
    let image = folder.path().join("a.png");
    let run = |aim: &[&str]| {
        let _ = fs::remove_file(&image);
        let common = [
            "render",
            "scenes/first_light.gltf",
            "-o",
            image.to_str().unwrap(),
            "--size",
            "96x72",
            "--pilot",
            "4",
        ];
        let done = whit(&[&common[..], aim].concat());
        let said = String::from_utf8([done.stdout, done.stderr].concat()).unwrap();
        assert!(image.exists(), "{said}");
        (done.status.code().unwrap(), said)
    };
    let (code, said) = run(&["--error", "0.2"]);
    assert_eq!(code, 0, "{said}");
    assert!(said.contains("for an error of at most 0.2"), "{said}");
    let error = said.split("this image: RMSE ").nth(1).unwrap();
    let error: f64 = error.split(' ').next().unwrap().parse().unwrap();
    assert!(error > 0.0 && error <= 0.2, "{said}");
    let (code, said) = run(&["--max-time", "60", "--pattern", "sobol"]);
    assert_eq!(code, 0, "{said}");
    assert!(said.contains("at most 60.0 s per image"), "{said}");
    let (code, said) = run(&["--error", "0.000001"]);
    assert_eq!(code, 1, "{said}");
    assert!(
        said.contains("nearest to") && said.contains("rendered with the nearest"),
        "{said}"
    );
    for more in [
        &["--error", "0.01", "--max-time", "3"][..],
        &["--error", "2"],
        &["--error", "0.01", "--backend", "brute"],
    ] {
        let done = whit(&[&["render", "scenes/first_light.gltf", "-o", "x.png"], more].concat());
        assert_eq!(done.status.code(), Some(2), "{more:?}");
    }
}

#[test]
fn smoke_scene_varies_the_march_step() {
    let folder = tempfile::tempdir().unwrap();
    let study = study("scenes/smoke.toml", folder.path());
    assert_eq!(points(&study, "march-step").len(), 3);
    assert!(points(&study, "depth").is_empty());
}

#[test]
fn invalid_studies_are_reported_in_one_sentence() {
    for (args, word) in [
        (&["cost", "scenes/nowhere.toml"][..], "nowhere.toml"),
        (
            &["cost", "scenes/smoke.toml", "--backend", "brute"],
            "brute force",
        ),
        (&["cost", "scenes/smoke.toml", "--budget", "0"], "seconds"),
        (&["cost", "scenes/smoke.toml", "--out", "Cargo.toml/x"], "folder"),
        (&["cost", "scenes/smoke.toml", "--size", "40000x40000"], "memory"),
        (&["cost", "scenes/smoke.toml", "--camera", "missing"], "camera"),
    ] {
        let done = whit(args);
        let said = String::from_utf8_lossy(&done.stderr);
        assert_eq!(done.status.code(), Some(2), "{args:?}: {said}");
        assert!(said.contains(word), "{args:?}: {said}");
    }
}

/// A study of a small picture that has been interrupted once something was kept.
fn interrupted(scene: &str, folder: &Path) {
    let out = folder.to_str().unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_whit"))
        .args(["cost", scene, "--size", "16x12", "--budget", "60", "--out", out])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let kept = folder.join("unfinished.study");
    while !kept.exists() {
        assert!(
            child.try_wait().unwrap().is_none(),
            "it ended before anything was kept"
        );
        std::thread::sleep(Duration::from_millis(50));
    }
    let pid = child.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-INT", &pid])
            .status()
            .unwrap()
            .success()
    );
    let done = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert_eq!(done.status.code(), Some(130), "{said}");
    assert!(said.contains("--resume"), "{said}");
    assert!(!folder.join("report.json").exists());
}

#[test]
fn interrupted_study_resumes_only_with_its_own_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let kept = folder.path().join("unfinished.study");
    let scene = "scenes/first_light.gltf";
    let resume = |scene: &str| {
        whit(&[
            "cost", scene, "--size", "16x12", "--budget", "1", "--out", out, "--resume",
        ])
    };
    let refused = |scene: &str, word: &str| {
        let done = resume(scene);
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(2), "{said}");
        assert!(said.contains(word) && said.contains("unfinished.study"), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
    };
    refused(scene, "no study was interrupted");
    interrupted(scene, folder.path());
    let whole = fs::read(&kept).unwrap();
    refused("scenes/mirror_room.toml", "another scene");
    for length in [0, 5, 13, 200, whole.len() / 2, whole.len() - 1] {
        fs::write(&kept, &whole[..length]).unwrap();
        refused(
            scene,
            if length < 5000 {
                "not an interrupted study"
            } else {
                "truncated"
            },
        );
    }
    fs::write(&kept, &whole).unwrap();
    let done = resume(scene);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert!(!kept.exists());
    let study: Value = serde_json::from_slice(&fs::read(folder.path().join("report.json")).unwrap()).unwrap();
    let timing = &study["timing"];
    // With hardly a second to go on for, the least number of blocks is taken all the same.
    let blocks = timing["blocks"].as_u64().unwrap() + timing["dropped"].as_u64().unwrap();
    assert!(blocks >= 6, "{timing}");
    assert!(
        timing["spent"].as_f64() > Some(1.0),
        "what it took before counts: {timing}"
    );
}

#[test]
fn instructions_are_counted_if_valgrind_is_installed() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let scene = folder.path().join("ball.toml");
    fs::write(
        &scene,
        "camera = { from = [0, 0, 3], at = [0, 0, 0] }\n[[object]]\nshape = 'sphere'\n",
    )
    .unwrap();
    let scene = scene.to_str().unwrap();
    let args = [
        "cost",
        scene,
        "--size",
        "16x12",
        "--budget",
        "1",
        "--backend",
        "bsp",
        "--instructions",
    ];
    let done = whit(&[&args[..], &["--out", out]].concat());
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    if Command::new("valgrind").arg("--version").output().is_err() {
        assert_eq!(done.status.code(), Some(2), "{said}");
        assert!(said.contains("valgrind"), "{said}");
        return;
    }
    assert!(done.status.success(), "{said}");
    let study: Value = serde_json::from_slice(&fs::read(folder.path().join("report.json")).unwrap()).unwrap();
    let of = |point: &Value| point["instructions"].as_f64().unwrap();
    let samples = points(&study, "samples");
    // The numbers of samples that there was time for.
    let counted: Vec<(f64, f64)> = samples
        .iter()
        .map(|point| (point["level"].as_str().unwrap().parse().unwrap(), of(point)))
        .collect();
    assert!(counted.len() >= 2, "{samples:?}");
    for pair in counted.windows(2) {
        let [(fewer, less), (more, most)] = pair else {
            unreachable!()
        };
        let ratio = (most / less) / (more / fewer);
        assert!((0.75..1.1).contains(&ratio), "{counted:?}");
    }
    assert!(
        fs::read_to_string(folder.path().join("report.html"))
            .unwrap()
            .contains(r#"["instructions",true]"#)
    );
}
