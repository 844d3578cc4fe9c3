//! Errors of glTF files, each worded as advice.

use std::path::PathBuf;

use crate::scene::SceneError;

/// Reason why a glTF file could not become a scene: one sentence with the file, the item in it, and a remedy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GltfError {
    /// The operating system cannot read the file.
    #[error("{}: {fault}: check the path and whether you may read the file", .file.display())]
    Unreadable {
        /// Path of the glTF file.
        file: PathBuf,
        /// Error message of the operating system.
        fault: String,
    },
    /// The content is not glTF, or it is truncated.
    #[error("{}: is not a complete glTF file ({fault}): give a .gltf or .glb file of glTF 2.0", .file.display())]
    NotGltf {
        /// Path of the glTF file.
        file: PathBuf,
        /// Description of what is missing.
        fault: String,
    },
    /// The file needs another version of glTF.
    #[error("{}: is written for glTF {version}: convert it to glTF 2.0", .file.display())]
    Version {
        /// Path of the glTF file.
        file: PathBuf,
        /// Version that the file requires.
        version: String,
    },
    /// The file requires extensions that are not implemented.
    #[error(
        "{}: requires extensions that this program does not support ({}): export the file without them",
        .file.display(),
        .names.join(", ")
    )]
    RequiredExtensions {
        /// Path of the glTF file.
        file: PathBuf,
        /// Names of the extensions.
        names: Vec<String>,
    },
    /// The file uses extensions that are not fully implemented, and the options refuse these.
    #[error(
        "{}: uses extensions that images do not fully honour ({}): render it without `--strict`, or export the file \
         without them",
        .file.display(),
        .names.join(", ")
    )]
    InexactExtensions {
        /// Path of the glTF file.
        file: PathBuf,
        /// Names of the extensions.
        names: Vec<String>,
    },
    /// One item of the file is invalid.
    #[error("{}: {item} {fault}: {remedy}", .file.display())]
    Item {
        /// Path of the glTF file.
        file: PathBuf,
        /// Kind and number of the item, for example `accessor 3`.
        item: String,
        /// Description of the fault.
        fault: String,
        /// Remedy that the user can take.
        remedy: &'static str,
    },
    /// No triangle is left to render.
    #[error("{}: there is nothing to render ({fault}): give a file with triangles in its scene", .file.display())]
    Empty {
        /// Path of the glTF file.
        file: PathBuf,
        /// Reason why no triangle is left.
        fault: String,
    },
    /// The parts are valid but the resulting scene is not.
    #[error("{}: {source}", .file.display())]
    Scene {
        /// Path of the glTF file.
        file: PathBuf,
        /// Fault of the scene.
        source: SceneError,
    },
}

/// Remedy if only the program that wrote the file can help.
pub(super) const EXPORT_AGAIN: &str = "export the file again";
