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

    /// Diameter of the spheres as which points of a glTF file are rendered, in the units of their positions
    /// [default: by the density of the points]
    #[arg(long, value_name = "DIAMETER", value_parser = point_size, allow_hyphen_values = true)]
    point_size: Option<f64>,

    /// Let emissive objects of a glTF file light the scene, the 32 strongest at most; a file without other lights then
    /// gets none
    #[arg(long)]
    emissive_lights: bool,

    /// Allow buffers and images of glTF files outside of the folder of the file
    #[arg(long)]
    allow_outside: bool,

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
            point_size: self.point_size,
            emissive_lights: self.emissive_lights,
            allows_outside: self.allow_outside,
            ..LoadOptions::default()
        }
    }
}

/// Parses the diameter of points.
fn point_size(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(size) if size > 0.0 && size.is_finite() => Ok(size),
        _ => Err("is no diameter of points: give a positive number, such as 0.01".into()),
    }
}
