//! Command `whit compare-stats` on files written by `whit bench` and `whit cost`, and on counts.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::{Value, json};

fn whit(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_whit"))
        .args(args)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Returns the exit code and the text of both output streams.
fn compared(base: &Path, new: &Path, more: &[&str]) -> (i32, String) {
    let done = whit(&[&["compare-stats", text(base), text(new)], more].concat());
    let said = [done.stdout, done.stderr].concat();
    (done.status.code().unwrap(), String::from_utf8(said).unwrap())
}

#[test]
fn slower_benchmark_has_regressed_and_an_equal_one_has_not() {
    let folder = tempfile::tempdir().unwrap();
    let [base, slow] = ["base.json", "slow.json"].map(|name| folder.path().join(name));
    let done = whit(&[
        "bench",
        "scenes/first_light.gltf",
        "--size",
        "32x24",
        "--repeat",
        "2",
        "--json",
        text(&base),
    ]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let (code, said) = compared(&base, &base, &[]);
    assert_eq!(code, 0, "{said}");
    assert!(
        said.contains("0 regressed") && said.contains("0 unclear"),
        "{said}"
    );
    let mut rows: Value = serde_json::from_slice(&fs::read(&base).unwrap()).unwrap();
    for key in ["mrays_per_s", "mrays_per_s_min", "mrays_per_s_max"] {
        let rate = rows[0][key].as_f64().unwrap();
        // Slower than the slowest repetition.
        rows[0][key] = json!(0.01 * rate);
    }
    fs::write(&slow, rows.to_string()).unwrap();
    let changes = folder.path().join("changes.json");
    let (code, said) = compared(&base, &slow, &["--json", text(&changes)]);
    assert_eq!(code, 1, "{said}");
    assert!(said.contains("regressed") && said.contains("Mrays/s"), "{said}");
    let changes: Value = serde_json::from_slice(&fs::read(changes).unwrap()).unwrap();
    assert_eq!(changes["changes"][0]["verdict"], "regressed");
    let (code, said) = compared(&slow, &base, &[]);
    assert_eq!(code, 0, "{said}");
    assert!(said.contains("1 improved"), "{said}");
}

#[test]
fn study_with_larger_errors_has_regressed_and_an_equal_one_has_not() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let done = whit(&[
        "cost",
        "scenes/first_light.gltf",
        "--size",
        "16x12",
        "--budget",
        "2",
        "--out",
        text(&out),
    ]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let base = out.join("report.json");
    let (code, said) = compared(&base, &base, &["--max-regress", "0%"]);
    assert_eq!(code, 0, "{said}");
    let mut study: Value = serde_json::from_slice(&fs::read(&base).unwrap()).unwrap();
    study["points"][0]["rmse"] = json!({"value": 0.9, "low": 0.8, "high": 1.0});
    let worse = folder.path().join("worse.json");
    fs::write(&worse, study.to_string()).unwrap();
    let (code, said) = compared(&base, &worse, &[]);
    assert_eq!(code, 1, "{said}");
    assert!(said.contains("base: RMSE"), "{said}");
}

#[test]
fn counts_may_grow_within_the_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, value: Value| {
        let path = folder.path().join(name);
        fs::write(&path, value.to_string()).unwrap();
        path
    };
    let base = file("base.json", json!({"dark": 1000, "bright": 2000}));
    let more = file("more.json", json!({"dark": 1020, "bright": 2000}));
    let other = file("other.json", json!({"dim": 1000}));
    assert_eq!(compared(&base, &more, &[]).0, 0);
    let (code, said) = compared(&base, &more, &["--max-regress", "1%"]);
    assert_eq!(code, 1);
    assert!(said.contains("dark") && said.contains("2.0 % worse"), "{said}");
    for (args, word) in [
        ((&base, &other, &[][..]), "no measurements in common"),
        ((&base, &folder.path().join("none.json"), &[]), "none.json"),
        ((&base, &more, &["--max-regress", "0.05"]), "percentage"),
    ] {
        let (code, said) = compared(args.0, args.1, args.2);
        assert_eq!(code, 2, "{said}");
        assert!(said.contains(word), "{said}");
    }
}
