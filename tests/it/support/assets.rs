//! Files of other authors, which are not part of the project.
//!
//! `WHIT_TEST_ASSETS` gives their folder, by default `../shared/assets/gltf`.

use std::path::{Path, PathBuf};

/// Returns the path of an asset; prints a message and returns `None` if it is absent.
pub fn asset(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("WHIT_TEST_ASSETS").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/assets/gltf"),
        PathBuf::from,
    );
    let path = folder.join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is not there", path.display());
    None
}
