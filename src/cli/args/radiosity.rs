//! Flags of `whit radiosity`.

use std::path::PathBuf;

use clap::Args as ArgGroup;

use super::progress::ProgressFormatArgs;
use super::{GltfArgs, MAX_THREADS};
use whit::accel::Backend;
use whit::render::radiosity::{MAX_ELEMENTS, RadiositySettings};

/// Default number of elements, which resolve shadows of furniture in a room in some seconds.
const DEFAULT_ELEMENTS: u64 = 50_000;
/// Largest number of rays from a side of an element: errors fall with the square root.
const MAX_RAYS: i64 = 1 << 16;

const RADIOSITY_HELP: &str = "\
Solves for the diffuse light on all surfaces, whatever the camera, and writes it as vertex colours of a glTF file that
other viewers open. Prints the remaining light, the sampling error and the balance of energy.

Examples:
  whit radiosity room.toml --out baked.glb
  whit radiosity room.glb --emissive-lights --out baked.glb --elements 200000 --rays 1024
  whit radiosity room.toml --out baked.glb --tolerance 0.01
  whit render baked.glb -o baked.png --spp 16";

/// Flags of `whit radiosity`.
#[derive(Debug, ArgGroup)]
#[command(after_help = RADIOSITY_HELP)]
pub(in crate::cli) struct RadiosityArgs {
    /// Scene file (.toml) or glTF scene (.glb, .gltf)
    #[arg(value_name = "SCENE")]
    pub(in crate::cli) scene: PathBuf,

    /// Binary glTF file to write
    #[arg(long, value_name = "FILE.glb")]
    pub(in crate::cli) out: PathBuf,

    /// Approximate number of triangles into which all surfaces are divided; a mesh with more keeps its own
    #[arg(long, value_name = "N", default_value_t = DEFAULT_ELEMENTS, value_parser = clap::value_parser!(u64).range(1..=MAX_ELEMENTS as u64))]
    pub(in crate::cli) elements: u64,

    /// Rays from each side of a triangle, rounded up to a multiple of 32
    #[arg(long, value_name = "N", default_value_t = RadiositySettings::default().rays, value_parser = clap::value_parser!(u32).range(1..=MAX_RAYS))]
    pub(in crate::cli) rays: u32,

    /// Largest power that further reflections may add, relative to the power of all sources
    #[arg(long, value_name = "FRACTION", default_value_t = RadiositySettings::default().tolerance, value_parser = tolerance)]
    pub(in crate::cli) tolerance: f64,

    /// Ray tracing backend that finds the hits [default: embree if built in, else bsp]
    #[arg(long)]
    pub(in crate::cli) backend: Option<Backend>,

    /// Number of threads; 0 for one per processor
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=MAX_THREADS))]
    pub(in crate::cli) threads: u32,

    #[command(flatten)]
    pub(in crate::cli) gltf: GltfArgs,

    #[command(flatten)]
    pub(in crate::cli) format: ProgressFormatArgs,

    /// Print errors only, no warnings and no report
    #[arg(long, short)]
    pub(in crate::cli) quiet: bool,
}

/// Parses the tolerance of sweeps.
fn tolerance(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(tolerance) if tolerance > 0.0 && tolerance <= 1.0 => Ok(tolerance),
        _ => Err("give a fraction over 0 and up to 1, as in 0.001".into()),
    }
}
