//! Hands the version of Embree's headers on to the crate, as `WHIT_EMBREE_HEADERS`: empty without the feature `embree`.

fn main() {
    // Set by cargo from what the build script of `embree-sys` reports.
    let version = std::env::var("DEP_EMBREE_VERSION").unwrap_or_default();
    println!("cargo::rustc-env=WHIT_EMBREE_HEADERS={version}");
    println!("cargo::rerun-if-changed=build.rs");
}
