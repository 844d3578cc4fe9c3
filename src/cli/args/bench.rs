//! Flags of `whit bench`.

use std::path::PathBuf;

use clap::Args as ArgGroup;

use super::{FrameArgs, MAX_SPP, TracingArgs, or_scene};

/// Default number of samples per pixel of a benchmark: every ray is kept in memory, in about 100 bytes.
pub(in crate::cli) const DEFAULT_BENCH_SPP: u32 = 1;
/// Largest number of repetitions of a benchmark.
const MAX_REPEAT: i64 = 1000;
/// Default number of triangles of the largest generated mesh.
const DEFAULT_MAX_TRIANGLES: u64 = 10_000_000;
/// Number of triangles of the smallest generated mesh.
pub(in crate::cli) const MIN_TRIANGLES: u64 = 1_000;
/// Largest number of triangles, which would exceed the memory of any machine in use.
const MAX_TRIANGLES: u64 = 300_000_000;

const BENCH_HELP: &str = "\
Records the rays of the frame (camera, shadow, reflection), adds uniformly random rays, and replays them all on one
thread, through every variant in random order within each repetition. Modes: raw is a loop over the Embree library's
packet calls alone, raw-single over its calls for one ray; single and packet trace the rays one by one or 16 at a time;
batch passes 64 packets at once. If a scene has instances, Embree is measured with both kinds of --instancing, the
selected one first.

Examples:
  whit bench scene.glb --size 512x512 --repeat 3 --json bench.json --html bench.html
  whit bench scene.glb --scaling --html bench.html
  whit bench --sweep --size 512x512 --most-triangles 1000000 --html sweep.html";

/// Flags of `whit bench`.
#[derive(Debug, ArgGroup)]
#[command(after_help = BENCH_HELP)]
pub(in crate::cli) struct BenchArgs {
    /// Scenes: scene files (.toml) and glTF (.glb, .gltf)
    #[arg(required_unless_present = "sweep", value_name = "SCENE")]
    pub(in crate::cli) scenes: Vec<PathBuf>,

    #[command(flatten)]
    pub(in crate::cli) frame: FrameArgs,

    /// Samples per pixel of the frame whose rays are recorded
    #[arg(long, value_name = "N", help = or_scene("Samples per pixel", DEFAULT_BENCH_SPP), value_parser = clap::value_parser!(u32).range(1..=MAX_SPP))]
    pub(in crate::cli) spp: Option<u32>,

    #[command(flatten)]
    pub(in crate::cli) tracing: TracingArgs,

    /// Number of repetitions, over which medians and extremes are taken
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=MAX_REPEAT))]
    pub(in crate::cli) repeat: u32,

    /// Measure generated meshes in place of scenes: from 1000 triangles on, two sizes per factor of ten, and print the
    /// size at which Embree and the BSP are equally fast
    #[arg(long, conflicts_with = "scenes")]
    pub(in crate::cli) sweep: bool,

    /// Triangles of the largest generated mesh; the sweep stops at smaller meshes if memory is insufficient
    #[arg(long, requires = "sweep", conflicts_with = "scenes", value_name = "N", default_value_t = DEFAULT_MAX_TRIANGLES, value_parser = clap::value_parser!(u64).range(MIN_TRIANGLES..=MAX_TRIANGLES))]
    pub(in crate::cli) most_triangles: u64,

    /// Also measure with 1, 2, 4 and so on up to --threads threads
    #[arg(long)]
    pub(in crate::cli) scaling: bool,

    /// Measure bounding volumes instead: the intersection tests and the time that boxes and spheres around objects save
    #[arg(long, conflicts_with_all = ["sweep", "scaling", "html"])]
    pub(in crate::cli) extents: bool,

    /// Write the measurements as JSON
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) json: Option<PathBuf>,

    /// Write one page for a browser: tables, and plots of the measurements
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) html: Option<PathBuf>,

    /// Date or other text that the page states as its time of creation
    #[arg(long, value_name = "WORDS", requires = "html")]
    pub(in crate::cli) date: Option<String>,
}
