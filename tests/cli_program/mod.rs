//! The real program, run as its users run it, and the folders it works in.

#![allow(dead_code, unreachable_pub, reason = "each test program uses its part")]

use std::path::Path;
use std::process::Command;

/// What a run of the program said and how it ended.
pub struct Run {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

/// Runs `whit` with `args` to its end.
pub fn whit(args: &[&str]) -> Run {
    let output = Command::new(env!("CARGO_BIN_EXE_whit"))
        .args(args)
        .output()
        .unwrap();
    Run {
        code: output.status.code().expect("whit was killed by a signal"),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

/// Runs `whit` with `args` and asserts that it ends with `code` and one sentence that holds `words`.
#[track_caller]
pub fn fails_with(code: i32, words: &str, args: &[&str]) {
    let run = whit(args);
    assert_eq!(run.code, code, "{args:?}: {}", run.stderr);
    assert_eq!(run.stdout, "", "{args:?}");
    assert!(run.stderr.starts_with("whit: "), "{args:?}: {}", run.stderr);
    assert!(
        run.stderr.contains(words),
        "{args:?}: {} lacks `{words}`",
        run.stderr
    );
    assert_eq!(run.stderr.lines().count(), 1, "{args:?}: {}", run.stderr);
}

/// The scene of the README.
pub fn first_light() -> String {
    concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/first_light.gltf").into()
}

/// The names of all files in `folder`, hidden ones included, sorted.
pub fn names_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}
