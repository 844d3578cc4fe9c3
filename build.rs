//! Hands the version of Embree's headers on to the program, which compares it with the library that it runs with.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=DEP_EMBREE_VERSION");
    let version = std::env::var("DEP_EMBREE_VERSION").unwrap_or_default();
    println!("cargo::rustc-env=WHIT_EMBREE_HEADERS={version}");
}
