//! What can be wrong with a glTF file, each worded as advice.

use std::path::PathBuf;

use crate::scene::SceneError;

/// Why a glTF file could not become a scene. The sentence names the file, the item in it, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GltfError {
    /// The operating system does not give the file.
    #[error("{}: {fault}: check the path and whether you may read the file", .file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the system says.
        fault: String,
    },
    /// The content is something else, or broken off.
    #[error("{}: is not a whole glTF file ({fault}): give a .gltf or .glb file of glTF 2.0", .file.display())]
    NotGltf {
        /// The file.
        file: PathBuf,
        /// What is missing.
        fault: String,
    },
    /// Another version of glTF.
    #[error("{}: is made for glTF {version}: convert it to glTF 2.0", .file.display())]
    Version {
        /// The file.
        file: PathBuf,
        /// What it asks for.
        version: String,
    },
    /// The file says that it cannot be shown without extensions that are not known here.
    #[error("{}: needs what this program does not know: {}: export the file without it", .file.display(), .names.join(", "))]
    RequiredExtensions {
        /// The file.
        file: PathBuf,
        /// The extensions.
        names: Vec<String>,
    },
    /// One item of the file is wrong.
    #[error("{}: {item} {fault}: {remedy}", .file.display())]
    Item {
        /// The file.
        file: PathBuf,
        /// For example `accessor 3`.
        item: String,
        /// What is wrong with it.
        fault: String,
        /// What to do.
        remedy: &'static str,
    },
    /// No triangle is left.
    #[error("{}: there is nothing to render ({fault}): give a file with triangles in its scene", .file.display())]
    Empty {
        /// The file.
        file: PathBuf,
        /// Where the triangles went.
        fault: String,
    },
    /// The parts are right but the whole is not.
    #[error("{}: {source}", .file.display())]
    Scene {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        source: SceneError,
    },
}

/// The remedy where only the program that wrote the file can help.
pub(super) const EXPORT_AGAIN: &str = "export the file again";
