//! Flags of `whit cost`.

use std::path::PathBuf;

use clap::Args as ArgGroup;

use super::{DenoiseArgs, ImageSize, RayOffsetArgs, TracingArgs};
use whit::accel::Backend;
use whit::render::MIN_ADAPTIVE_ERROR;

/// Default time budget in seconds, enough for a few thousand pixels of a slow scene.
const DEFAULT_BUDGET: f64 = 120.0;

const COST_HELP: &str = "\
Varies every parameter that affects the scene, one at a time: samples per pixel and their pattern, adaptive sampling,
depth, contribution cutoff, wavelengths, samples per light, rays per lobe, bounces of interreflection, photons of
caustics, volume steps, the texture filter, the backend and its precision, the build of Embree's trees, the computation
of hit points and the offset of ray origins; with --denoise, images of each number of samples are also measured denoised.
Also compares the hits of the backends with those in f64: leaks, false hits, false shadows and light leaks. Errors are
those of values as displayed (black is 0, white 1), compared with two independent halves of a reference, one through
Embree and one through the BSP; times are ratios within blocks that run every setting once. Images are as large as the
budget allows, unless --size is given.

Files in --out: report.html (self-contained), report.json, points.csv, ref.exr, the base's difference.png and flip.png,
and settings.toml for `whit render --settings`: the settings at the knee of the curve, beyond which less error is
expensive, or those that --max-error or --max-time chose. If no settings reach the target, the exit code is 1, and the
nearest settings are printed.

Examples:
  whit cost scene.toml
  whit cost scene.glb --budget 300 --out scene.cost
  whit cost scene.toml --max-error 0.01 --out scene.cost
  whit cost scene.toml --max-time 2.5 --out scene.cost
  whit cost scene.glb --budget 600 --out scene.cost --resume
  whit cost scene.toml --denoise --oidn pyoidn/oidn/lib
  whit cost scene.toml --size 320x240 --out scene.cost --date 2026-11-23";

/// Flags of `whit cost`.
#[derive(Debug, ArgGroup)]
#[command(after_help = COST_HELP)]
pub(in crate::cli) struct CostArgs {
    /// Scene file (.toml) or glTF scene (.glb, .gltf)
    #[arg(value_name = "SCENE")]
    pub(in crate::cli) scene: PathBuf,

    /// Seconds that the whole study may take, including loading
    #[arg(long, value_name = "SECONDS", default_value_t = DEFAULT_BUDGET, value_parser = budget)]
    pub(in crate::cli) budget: f64,

    /// Width and height of the images that are measured [default: as large as the budget allows]
    #[arg(long, value_name = "WxH")]
    pub(in crate::cli) size: Option<ImageSize>,

    /// Choose the fastest settings whose RMSE as displayed (black is 0, white 1) is at most this, and measure them
    #[arg(long, value_name = "RMSE", value_parser = error, conflicts_with = "max_time")]
    pub(in crate::cli) max_error: Option<f64>,

    /// Choose the most accurate settings at which the whole image takes at most this many seconds, and measure them
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub(in crate::cli) max_time: Option<f64>,

    /// Camera to render from, by name or number; see `whit info`
    #[arg(long, value_name = "NAME|N")]
    pub(in crate::cli) camera: Option<String>,

    /// Ray tracing backend of the base [default: embree if built in, else bsp]
    #[arg(long)]
    pub(in crate::cli) backend: Option<Backend>,

    #[command(flatten)]
    pub(in crate::cli) tracing: TracingArgs,

    #[command(flatten)]
    pub(in crate::cli) leaving: RayOffsetArgs,

    #[command(flatten)]
    pub(in crate::cli) denoising: DenoiseArgs,

    /// Also count the instructions per pixel of every setting by valgrind, which takes minutes beyond the budget
    #[arg(long)]
    pub(in crate::cli) instructions: bool,

    /// Folder to write the report into; it is created if it does not exist
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) out: Option<PathBuf>,

    /// Resume a study that was interrupted before its report was written into --out
    #[arg(long, requires = "out")]
    pub(in crate::cli) resume: bool,

    /// Date or other text that the report's page states as its time of creation
    #[arg(long, value_name = "WORDS", requires = "out")]
    pub(in crate::cli) date: Option<String>,
}

pub(super) fn error(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|error| (MIN_ADAPTIVE_ERROR..=1.0).contains(error))
        .ok_or_else(|| format!("give an error from {MIN_ADAPTIVE_ERROR} to 1, as in 0.01"))
}

pub(super) fn seconds(text: &str) -> Result<f64, String> {
    text.strip_suffix('s')
        .unwrap_or(text)
        .parse()
        .ok()
        .filter(|seconds| (0.001..=super::MAX_BUDGET).contains(seconds))
        .ok_or_else(|| format!("give seconds from 0.001 to {}", super::MAX_BUDGET))
}

pub(super) fn budget(text: &str) -> Result<f64, String> {
    text.strip_suffix('s')
        .unwrap_or(text)
        .parse()
        .ok()
        .filter(|seconds| (1.0..=super::MAX_BUDGET).contains(seconds))
        .ok_or_else(|| format!("give seconds from 1 to {}", super::MAX_BUDGET))
}
