//! Flags of `whit verify`.

use std::path::PathBuf;

use clap::Args as ArgGroup;

use super::{ImageSize, MAX_THREADS};
use whit::accel::Precision;

/// Default number of rays per case: enough to see an error in one ray of ten thousand, in well under a minute for all
/// cases.
const DEFAULT_RAYS: u64 = 100_000;
/// Largest number of rays per case, which take about a day.
const MAX_RAYS: u64 = 100_000_000_000;

const VERIFY_HELP: &str = "\
Each case constructs rays, or arguments of a formula, for which rounding decides the result, and computes the exact
results. It runs through every backend variant. `wrong` counts results that rounding does not explain, `ties` those
that it does. A variant that guarantees exact results must have none that are wrong; the errors of the others are
measured. The same number of rays gives the same rays, on any number of threads.

Examples:
  whit verify
  whit verify --list
  whit verify --case H11 --case H12 --rays 10000000 --isa all
  whit verify --rays 1000000 --json verify.json --html verify.html
  whit verify scene.glb --size 1920x1080 --precision robust
  whit verify scene.glb --overlay differences.png --rays-out differences.rays --html scene.html
  whit verify scene.glb --replay differences.rays

With scenes, traces the rays of their own images through Embree (without it: by brute force), and compares the results
of the BSP and of the native tree with them. Prints the differences by the kind of place, and the defects of the meshes
with their remedies.";

/// Flags of `whit verify`.
#[derive(Debug, ArgGroup)]
#[command(after_help = VERIFY_HELP)]
pub(in crate::cli) struct VerifyArgs {
    /// Scenes (.toml, .glb, .gltf) whose own rays are checked, in place of the cases
    #[arg(value_name = "SCENE", conflicts_with_all = ["cases", "list"])]
    pub(in crate::cli) scenes: Vec<PathBuf>,

    /// Size in pixels of the images of the scenes
    #[arg(long, value_name = "WxH", requires = "scenes", help = super::or_scene("Size in pixels of the image whose rays are checked", super::DEFAULT_SIZE))]
    pub(in crate::cli) size: Option<ImageSize>,

    /// Precision of Embree's triangle hits for the scenes' own rays; cases run with every precision
    #[arg(long, requires = "scenes", default_value_t = Precision::default())]
    pub(in crate::cli) precision: Precision,

    /// Rays per case and backend variant
    #[arg(long, value_name = "N", default_value_t = DEFAULT_RAYS, value_parser = clap::value_parser!(u64).range(1..=MAX_RAYS))]
    pub(in crate::cli) rays: u64,

    /// Run only this case, as in H11; may be given several times
    #[arg(long = "case", value_name = "ID")]
    pub(in crate::cli) cases: Vec<String>,

    /// Print the constructions of the cases, the sources of their exact results and their requirements; run none
    #[arg(long)]
    pub(in crate::cli) list: bool,

    /// Instruction set that Embree and the native tree are restricted to, or all that this machine has, in turn; below
    /// avx2 the native tree takes its portable form [default: the best of this machine]
    #[arg(long, value_parser = ["sse2", "sse4.2", "avx", "avx2", "avx512", "all"])]
    pub(in crate::cli) isa: Option<String>,

    /// Write the measurements as JSON
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) json: Option<PathBuf>,

    /// Image to write (.png) with the differences drawn over it: wrong red, ties yellow; for one scene
    #[arg(long, value_name = "FILE", requires = "scenes")]
    pub(in crate::cli) overlay: Option<PathBuf>,

    /// Write the rays that differ, to the bit, with their results; for one scene
    #[arg(long, value_name = "FILE", requires = "scenes")]
    pub(in crate::cli) rays_out: Option<PathBuf>,

    /// Trace the rays of a file of --rays-out with every backend variant and brute force, in place of the scene's own
    #[arg(long, value_name = "FILE", requires = "scenes", conflicts_with_all = ["overlay", "rays_out", "json", "html", "size"])]
    pub(in crate::cli) replay: Option<PathBuf>,

    /// Write one page for a browser: the result of each case, with figures of the rays
    #[arg(long, value_name = "FILE", conflicts_with = "list")]
    pub(in crate::cli) html: Option<PathBuf>,

    /// Date or other text that the page states as its time of creation
    #[arg(long, value_name = "WORDS", requires = "html")]
    pub(in crate::cli) date: Option<String>,

    /// Number of threads; 0 for one per processor
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=MAX_THREADS))]
    pub(in crate::cli) threads: u32,
}
