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

/// Writes `text` and asserts that `whit info` ends with 2 and one sentence that names the line and holds `words`.
#[track_caller]
pub fn refused(text: impl AsRef<[u8]>, place: &str, words: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    refused_in(folder.path(), text, place, words);
}

/// As [`refused`], in a folder that may hold other files which `text` names.
#[track_caller]
pub fn refused_in(folder: &Path, text: impl AsRef<[u8]>, place: &str, words: &[&str]) {
    let path = folder.join("bad.toml");
    std::fs::write(&path, text).unwrap();
    let run = whit(&["info", &path.display().to_string()]);
    let told = &run.stderr;
    assert_eq!(run.code, 2, "{told}{}", run.stdout);
    assert_eq!(told.lines().count(), 1, "{told}");
    assert!(
        told.starts_with("whit: ") && told.contains(&format!("bad.toml{place}")),
        "{place}: {told}"
    );
    for word in words {
        assert!(told.contains(word), "`{word}` is not in {told}");
    }
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
