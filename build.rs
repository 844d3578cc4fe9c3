//! Hands facts about the build to the crate: `WHIT_EMBREE_HEADERS`, the version of Embree's headers (empty without the
//! feature `embree`), and `WHIT_COMMIT`, the commit of the checkout (empty if unknown).

use std::path::Path;
use std::process::Command;

/// Changes with every commit and checkout.
const GIT_LOG: &str = ".git/logs/HEAD";

fn main() {
    // Set by cargo from what the build script of `embree-sys` reports.
    let version = std::env::var("DEP_EMBREE_VERSION").unwrap_or_default();
    println!("cargo::rustc-env=WHIT_EMBREE_HEADERS={version}");
    println!("cargo::rustc-env=WHIT_COMMIT={}", commit().unwrap_or_default());
    println!("cargo::rerun-if-changed=build.rs");
}

/// Returns the abbreviated commit. Debug builds have none, so that a commit alone does not rebuild the tests.
fn commit() -> Option<String> {
    if std::env::var("PROFILE").ok()? != "release" || !Path::new(GIT_LOG).exists() {
        return None;
    }
    println!("cargo::rerun-if-changed={GIT_LOG}");
    let output = Command::new("git")
        .args(["rev-parse", "--short=12", "HEAD"])
        .output()
        .ok()?;
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
