//! Runs of the compiled program, as users run it, and helpers for its folders.

#![allow(dead_code, unreachable_pub, reason = "each test program uses its part")]

use std::path::Path;
use std::process::Command;

/// Exit code and output of a run of the program.
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

/// Runs `whit` with `args` and asserts that it ends with `code` and one sentence that contains `words`.
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

/// Writes `text` and asserts that `whit info` ends with 2 and one sentence that names the line and contains `words`.
#[track_caller]
pub fn refused(text: impl AsRef<[u8]>, place: &str, words: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    refused_in(folder.path(), text, place, words);
}

/// Asserts a rejection like [`refused`], in a folder that may contain other files which `text` names.
#[track_caller]
pub fn refused_in(folder: &Path, text: impl AsRef<[u8]>, place: &str, words: &[&str]) {
    let path = folder.join("bad.toml");
    std::fs::write(&path, text).unwrap();
    let run = whit(&["info", &path.display().to_string()]);
    let message = &run.stderr;
    assert_eq!(run.code, 2, "{message}{}", run.stdout);
    assert_eq!(message.lines().count(), 1, "{message}");
    assert!(
        message.starts_with("whit: ") && message.contains(&format!("bad.toml{place}")),
        "{place}: {message}"
    );
    for word in words {
        assert!(message.contains(word), "`{word}` is not in {message}");
    }
}

/// Returns the path of the README's scene.
pub fn first_light() -> String {
    concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/first_light.gltf").into()
}

/// Returns the names of all files in `folder`, hidden ones included, sorted.
pub fn names_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}
