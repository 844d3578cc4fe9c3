//! Code that the fuzz targets share: input files in memory, limits, and mutation of documents.

pub mod glb;
pub mod mutation;

use std::path::{Path, PathBuf};

use rayon::ThreadPoolBuilder;
use tempfile::TempDir;
use whit::gltf::LoadOptions;
use whit::scene::Scene;

/// Largest number of texels of all images of an input: 64 MiB of them.
pub const MAX_TEXELS: u64 = 1 << 24;
/// Largest number of bytes of a volume.
pub const MAX_VOLUME_BYTES: u64 = 1 << 26;
/// Folder of a file system in memory, where there is one.
const MEMORY_FOLDER: &str = "/dev/shm";

/// Prepares the process; each target calls it once, before its first input.
///
/// All work runs on the calling thread, so that an input always takes the same path. A panic is reported as usual and
/// unwinds to the target's caller, which aborts: code that catches panics of a decoder stays testable.
///
/// # Panics
/// If rayon's global pool exists already.
pub fn start() {
    std::panic::set_hook(Box::new(|panic| eprintln!("{panic}")));
    let pool = ThreadPoolBuilder::new().num_threads(1).use_current_thread();
    pool.build_global().expect("the global pool is built once");
}

/// Returns the options of loading a scene, with limits that keep an input within memory and time.
pub fn load_options() -> LoadOptions {
    LoadOptions {
        max_texels: MAX_TEXELS,
        ..LoadOptions::default()
    }
}

/// Checks the promise of the loaders: a scene that they return is valid.
///
/// # Panics
/// If the scene is invalid.
pub fn expect_valid(scene: &Scene) {
    if let Err(error) = scene.validate() {
        panic!("a loaded scene is invalid: {error}");
    }
}

/// Folder with the files of one input, which is removed when the value is dropped.
pub struct InputFolder(TempDir);

impl InputFolder {
    /// Creates an empty folder, in memory if possible.
    ///
    /// # Panics
    /// If no folder can be created.
    #[allow(clippy::new_without_default)]
    pub fn new() -> InputFolder {
        let memory = Path::new(MEMORY_FOLDER);
        let folder = match memory.is_dir() {
            true => TempDir::with_prefix_in("whit-fuzz-", memory),
            false => TempDir::with_prefix("whit-fuzz-"),
        };
        InputFolder(folder.expect("the folder of temporary files is writable"))
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        self.0.path()
    }

    /// Writes a file, with the folders of its name, and returns its path.
    ///
    /// # Panics
    /// If the file cannot be written.
    pub fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        let written = match path.parent() {
            Some(folder) => std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&path, bytes)),
            None => std::fs::write(&path, bytes),
        };
        written.expect("a temporary file is writable");
        path
    }
}
