//! Flags of how glTF files are loaded.

use clap::Args as ArgGroup;

use whit::gltf::{LoadOptions, UnsupportedExtensions};

use super::animation::AnimationArgs;

/// Flags of how glTF files are loaded.
#[derive(Clone, Debug, Default, ArgGroup)]
pub(in crate::cli) struct GltfArgs {
    #[command(flatten)]
    moment: AnimationArgs,

    /// Variant of the materials of a glTF file, by name, as in `--variant "Red Leather"`; `whit info` lists them
    #[arg(long, value_name = "NAME")]
    variant: Option<String>,

    /// Refuse glTF files with extensions that images do not fully honour; `whit info` lists them
    #[arg(long)]
    strict: bool,
}

impl GltfArgs {
    /// Returns the options for loading a file.
    pub(in crate::cli) fn load_options(&self) -> LoadOptions {
        LoadOptions {
            pose: self.moment.pose(),
            variant: self.variant.clone(),
            unsupported: if self.strict {
                UnsupportedExtensions::Refuse
            } else {
                UnsupportedExtensions::Warn
            },
            ..LoadOptions::default()
        }
    }
}
