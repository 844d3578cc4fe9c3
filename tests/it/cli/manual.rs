//! `whit help`, `whit man` and `whit completions`, and the manual held against the flags that exist.

use std::collections::BTreeSet;

use whit::manual::TOPICS;

use crate::support::cli_program::whit;

/// Commands with flags of their own.
const COMMANDS: &[&str] = &[
    "render",
    "batch",
    "merge",
    "info",
    "schema",
    "radiosity",
    "bench",
    "verify",
    "compare",
    "cost",
    "compare-stats",
    "man",
    "completions",
];
/// Flags of other programs that the manual mentions.
const FOREIGN: &[&str] = &[
    "--bench",
    "--example",
    "--features",
    "--ignored",
    "--lib",
    "--no-default-features",
    "--release",
    "--test",
    "--triangles",
];

/// Returns the long flags that occur in a text.
fn flags(text: &str) -> BTreeSet<String> {
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '-';
    text.split(|c: char| !is_part(c))
        .filter(|word| word.starts_with("--") && word.len() > 2)
        .map(|word| word.trim_end_matches('-').to_owned())
        .collect()
}

#[test]
fn the_manual_mentions_every_flag_and_no_other() {
    // Definitions stand at the start of a line of the help
    let mut defined = BTreeSet::new();
    for command in COMMANDS {
        for line in whit(&[command, "--help"]).stdout.lines() {
            let line = line.trim_start();
            if line.starts_with("--") || line.starts_with("-q, --") {
                defined.extend(flags(line.split("  ").next().unwrap_or_default()));
            }
        }
    }
    assert!(defined.len() > 60, "{defined:?}");
    let manual: String = TOPICS.iter().map(|topic| topic.text).collect();
    let mentioned = flags(&manual);
    let missing: Vec<_> = defined.difference(&mentioned).collect();
    assert!(missing.is_empty(), "the manual does not mention {missing:?}");
    let unknown: Vec<_> = mentioned
        .difference(&defined)
        .filter(|flag| !FOREIGN.contains(&flag.as_str()) && *flag != "--help")
        .collect();
    assert!(unknown.is_empty(), "no command has {unknown:?}");
}

#[test]
fn help_prints_pages_and_flags_and_names_the_topics_otherwise() {
    let list = whit(&["help"]);
    assert_eq!((list.code, &*list.stderr), (0, ""));
    assert!(list.stdout.contains("scene-files") && list.stdout.contains("compare-stats"));
    for topic in TOPICS {
        let page = whit(&["help", topic.name]);
        assert_eq!((page.code, &*page.stdout), (0, topic.text), "{}", topic.name);
    }
    let flags = whit(&["help", "merge"]);
    assert!(flags.stdout.contains("Usage: whit merge"), "{}", flags.stdout);
    let unknown = whit(&["help", "nonsense"]);
    assert_eq!(unknown.code, 2);
    assert!(unknown.stderr.contains("`nonsense`") && unknown.stderr.contains("scene-files"));
}

#[test]
fn man_pages_and_completions_cover_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let run = whit(&["man", folder.path().to_str().unwrap()]);
    assert_eq!((run.code, &*run.stderr), (0, ""));
    let page = std::fs::read_to_string(folder.path().join("whit.1")).unwrap();
    assert!(page.contains(".TH whit 1"), "{page}");
    for command in COMMANDS {
        let page = std::fs::read_to_string(folder.path().join(format!("whit-{command}.1"))).unwrap();
        assert!(page.contains(&format!(".TH whit-{command} 1")), "{page}");
    }
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = whit(&["completions", shell]).stdout;
        assert!(
            script.contains("whit") && script.contains("compare-stats"),
            "{shell}"
        );
    }
    let missing = folder.path().join("missing");
    assert_eq!(whit(&["man", missing.to_str().unwrap()]).code, 2);
}

#[test]
fn a_verbose_version_says_what_was_built() {
    let version = whit(&["--version", "--verbose"]);
    assert_eq!((version.code, &*version.stderr), (0, ""));
    for line in ["commit: ", "features: ", "simd: ", "embree: "] {
        assert!(version.stdout.contains(line), "{line} in {}", version.stdout);
    }
}
