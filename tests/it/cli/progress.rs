//! `whit render --progress`: the events of a running render as JSON lines.

use std::collections::BTreeSet;

use crate::support::cli_program::{first_light, whit};
use serde_json::Value;

/// Keys of each kind of event, none of which is optional.
const KEYS: [(&str, &[&str]); 6] = [
    ("start", &["scene", "image"]),
    ("phase", &["scene", "image", "phase"]),
    (
        "progress",
        &["scene", "image", "phase", "fraction", "seconds", "seconds_left"],
    ),
    ("warning", &["message"]),
    ("done", &["scene", "image", "seconds"]),
    ("failed", &["scene", "image", "message", "exit_code"]),
];

/// Parses every line as an event, and checks that it has exactly the documented keys.
fn events(stderr: &str) -> Vec<Value> {
    let event = |line: &str| -> Value {
        let event: Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"));
        let name = event["event"].as_str().unwrap();
        let (_, keys) = KEYS
            .iter()
            .find(|(known, _)| *known == name)
            .unwrap_or_else(|| panic!("{line}"));
        let given: BTreeSet<&str> = event.as_object().unwrap().keys().map(String::as_str).collect();
        let wanted: BTreeSet<&str> = keys.iter().copied().chain(["event"]).collect();
        assert_eq!(given, wanted, "{line}");
        event
    };
    stderr.lines().map(event).collect()
}

fn names(events: &[Value]) -> Vec<&str> {
    let all = events.iter().map(|event| event["event"].as_str().unwrap());
    all.filter(|&name| name != "progress").collect()
}

fn folder() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.png").to_str().unwrap().to_owned();
    (folder, out)
}

#[test]
fn render_events_cover_start_phases_progress_and_end() {
    let (_folder, out) = folder();
    let run = whit(&[
        "render",
        &first_light(),
        "-o",
        &out,
        "--size",
        "160x120",
        "--spp",
        "16",
        "--progress",
        "json",
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    // Results still go to standard output.
    assert!(
        run.stdout.starts_with(&format!("{out}: 160x120")),
        "{}",
        run.stdout
    );
    let events = events(&run.stderr);
    assert_eq!(names(&events), ["start", "phase", "phase", "phase", "done"]);
    for event in &events {
        assert_eq!(event["scene"], first_light());
        assert_eq!(event["image"], *out);
    }
    let progress: Vec<&Value> = events
        .iter()
        .filter(|event| event["event"] == "progress")
        .collect();
    assert!(!progress.is_empty());
    let renders = progress.iter().filter(|event| event["phase"] == "render");
    let fractions: Vec<f64> = renders.map(|event| event["fraction"].as_f64().unwrap()).collect();
    assert!(
        fractions.is_sorted() && fractions.iter().all(|f| (0.0..=1.0).contains(f)),
        "{fractions:?}"
    );
    assert!(
        progress
            .iter()
            .all(|event| event["seconds_left"].as_f64().unwrap() >= 0.0)
    );
    let seconds = events.last().unwrap()["seconds"].as_f64().unwrap();
    assert!(
        progress.len() as f64 <= 10.0 * seconds + 1.0,
        "{} in {seconds} s",
        progress.len()
    );
}

#[test]
fn warnings_are_events() {
    let (_folder, out) = folder();
    let run = whit(&[
        "render",
        &first_light(),
        "-o",
        &out,
        "--size",
        "8x8",
        "--effects=-shadow",
        "--progress",
        "json",
    ]);
    let events = events(&run.stderr);
    let warning = events
        .iter()
        .find(|event| event["event"] == "warning")
        .expect("a warning");
    assert!(
        warning["message"].as_str().unwrap().contains("shadow"),
        "{warning}"
    );
}

#[test]
fn failure_events_have_message_and_exit_code() {
    let (folder, out) = folder();
    let run = whit(&["render", "missing.glb", "-o", &out, "--progress", "json"]);
    let failed = events(&run.stderr);
    assert_eq!(
        (run.code, &*names(&failed)),
        (2, &["start", "phase", "failed"][..]),
        "{}",
        run.stderr
    );
    assert_eq!(
        (&failed[2]["scene"], &failed[2]["exit_code"]),
        (&"missing.glb".into(), &2.into())
    );

    // Failure before any image is started.
    let run = whit(&[
        "render",
        "a.glb",
        "-o",
        "no/such/folder/a.png",
        "--progress",
        "json",
    ]);
    let failed = events(&run.stderr);
    assert_eq!((run.code, &*names(&failed)), (2, &["failed"][..]));
    assert_eq!(failed[0]["scene"], Value::Null);

    // Failure of one scene of two: its own event, and that of the command.
    let place = folder.path().to_str().unwrap();
    let run = whit(&[
        "render",
        "missing.glb",
        &first_light(),
        "--out",
        place,
        "--size",
        "8x8",
        "--progress",
        "json",
        "--quiet",
    ]);
    let failed = events(&run.stderr);
    assert_eq!(
        (run.code, &*names(&failed)),
        (1, &["failed", "failed"][..]),
        "{}",
        run.stderr
    );
    assert_eq!(failed[1]["message"], "1 of 2 scenes failed");
}

#[test]
fn no_progress_is_printed_without_a_terminal_unless_requested() {
    let (_folder, out) = folder();
    for kind in ["auto", "none"] {
        let run = whit(&[
            "render",
            &first_light(),
            "-o",
            &out,
            "--size",
            "8x8",
            "--progress",
            kind,
        ]);
        assert_eq!((run.code, &*run.stderr), (0, ""), "{kind}");
    }
    let run = whit(&["render", &first_light(), "-o", &out, "--progress", "loud"]);
    assert_eq!(run.code, 2);
}
