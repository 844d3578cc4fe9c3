//! Command-line flags and their ranges, as clap types. Modules below the command line do not depend on flags.

mod animation;
mod batch;
mod bench;
mod compare;
mod compare_stats;
mod cost;
mod crop;
mod denoise;
mod display;
mod environment;
mod gltf;
mod image_format;
mod program;
mod progress;
mod radiosity;
mod ray_offset;
mod verify;
mod view;

use std::fmt;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args as ArgGroup, Parser, Subcommand};

pub(super) use batch::{BatchArgs, MergeArgs};
pub(super) use bench::{BenchArgs, DEFAULT_BENCH_SPP, MIN_TRIANGLES};
pub(super) use compare::CompareArgs;
pub(super) use compare_stats::CompareStatsArgs;
pub(super) use cost::CostArgs;
pub(super) use crop::Crop;
pub(super) use denoise::DenoiseArgs;
pub(super) use display::DisplayArgs;
pub(super) use environment::EnvironmentArgs;
pub(super) use gltf::GltfArgs;
pub(super) use image_format::OutputArgs;
pub(super) use program::{CompletionsArgs, HelpArgs, ManArgs};
pub(super) use progress::ProgressArgs;
pub(super) use radiosity::RadiosityArgs;
pub(super) use ray_offset::RayOffsetArgs;
pub(super) use verify::VerifyArgs;
pub(super) use view::ViewArgs;

use whit::accel::{Backend, BuildQuality, Instancing, Precision};
use whit::batch::request::AovGroup;
use whit::image::ImageFormat;
use whit::render::{FilterKind, MIN_ADAPTIVE_ERROR, MIN_EDGE_CONTRAST, Pattern, PixelFilter};
use whit::scene::image_settings::{self, DEFAULT_DEPTH, DEFAULT_SPP, DEFAULT_WAVELENGTHS, MAX_EXPOSURE};
use whit::scene::{EffectOverrides, MAX_ROUGH_RAYS};
/// Default image size, where neither the command line nor the scene gives one.
const DEFAULT_SIZE: ImageSize = ImageSize {
    width: image_settings::DEFAULT_SIZE[0],
    height: image_settings::DEFAULT_SIZE[1],
};
/// Largest number of samples per pixel.
const MAX_SPP: i64 = image_settings::MAX_SPP as i64;
/// Largest depth: number of bounces of reflected and refracted rays.
const MAX_DEPTH: i64 = image_settings::MAX_DEPTH as i64;
/// Largest number of wavelengths per path.
const MAX_WAVELENGTHS: i64 = image_settings::MAX_WAVELENGTHS as i64;

/// Largest number of threads, above that of any machine in use.
const MAX_THREADS: i64 = 1024;

/// Default time budget in seconds, enough to measure the costs of most scenes to a few percent.
const DEFAULT_BUDGET: f64 = 30.0;
/// Largest time budget in seconds: one day; more is taken for a typing error.
const MAX_BUDGET: f64 = 86_400.0;

// `--version` shows the Embree version of the build, as results depend on it
/// A Whitted-style ray tracer for scene files and glTF scenes.
///
/// Finds hits through the system's Embree or through its own BSP tree.
#[derive(Debug, Parser)]
#[command(name = "whit", disable_version_flag = true, disable_help_subcommand = true)]
#[command(arg_required_else_help = true, after_help = EXIT_CODES)]
pub(super) struct Args {
    /// Print the version of the program
    #[arg(short = 'V', long)]
    pub(super) version: bool,

    /// Print commit, features, SIMD level and Embree, too
    #[arg(long, requires = "version")]
    pub(super) verbose: bool,

    #[command(subcommand)]
    pub(super) command: Option<Command>,
}

const EXIT_CODES: &str = "\
Exit codes: 0 success; 1 a render or check failed; 2 bad usage or bad input; 130 interrupted (finished work is kept).
Results go to standard output, everything else to standard error.";

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Render scenes to PNG or EXR images
    Render(Box<RenderArgs>),
    /// Render many frames, on one machine or on several, and resume after interruptions
    Batch(Box<BatchArgs>),
    /// Merge the pieces of frames that several processes rendered
    Merge(MergeArgs),
    /// Print a summary of a scene as it was loaded
    Info(InfoArgs),
    /// Bake the diffuse light of a scene into the vertex colours of a glTF file
    Radiosity(Box<RadiosityArgs>),
    /// Print the JSON schema of scene files, for editors
    Schema,
    /// Compare the times of Embree and the BSP on the same recorded rays
    Bench(BenchArgs),
    /// Check every backend variant on hard cases with known exact results
    Verify(VerifyArgs),
    /// Print how much an image differs from its reference
    Compare(CompareArgs),
    /// Measure the cost of accuracy in time: error over seconds for every parameter of a scene
    Cost(CostArgs),
    /// Compare measurements with earlier ones; exit code 1 if any has regressed
    CompareStats(CompareStatsArgs),
    /// Print a page of the manual, or the flags of a command
    Help(HelpArgs),
    /// Write man pages of all commands
    Man(ManArgs),
    /// Print completions for a shell
    Completions(CompletionsArgs),
}

const RENDER_EXAMPLES: &str = "\
Examples:
  whit render scene.glb -o scene.png
  whit render scene.glb -o scene.exr --size 1920x1080 --spp 64 --camera top --stats scene.json
  whit render scene.glb -o scene.png --from 3,2,5 --at 0,1,0 --fov 30
  whit render scene.glb -o scene.png --view top --size 800x600
  whit render scene.glb -o scene.png --environment studio --environment-turn 30
  whit render scene.glb -o scene.png --exposure 1.5 --tone-map neutral
  whit render scene.glb -o scene.png --background transparent
  whit render scene.glb -o part.png --size 1920x1080 --crop 800,400,320,200
  whit render a.glb b.gltf --out images --format exr
  whit render scene.glb -o scene.png --spp 64 --pattern sobol --filter mitchell
  whit render scene.glb -o scene.exr --adaptive 0.005 --spp 1024 --aov samples
  whit render mesh.glb -o mesh.png --edge-contrast 0.03
  whit render scene.toml -o scene.png --effects=-dispersion,-transparent-shadow
  whit render scene.toml -o scene.png --settings scene.cost/settings.toml
  whit render scene.toml -o scene.png --error 0.01
  whit render scene.toml -o scene.png --max-time 2.5 --pilot 60

If one of several scenes fails, the others are still rendered; the exit code is then 1.";

/// Flags of `whit render`.
#[derive(Debug, ArgGroup)]
#[command(after_help = RENDER_EXAMPLES)]
#[group(id = "target", required = true, args = ["output", "out"])]
pub(super) struct RenderArgs {
    /// Scenes: scene files (.toml) and glTF (.glb, .gltf)
    #[arg(required = true, value_name = "SCENE")]
    pub(super) scenes: Vec<PathBuf>,

    /// Image to write, .png (sRGB) or .exr (linear radiance); for one scene
    #[arg(short = 'o', value_name = "FILE")]
    pub(super) output: Option<PathBuf>,

    /// Existing folder to write one image per scene into, named like the scene
    #[arg(long, value_name = "DIR", conflicts_with = "output")]
    pub(super) out: Option<PathBuf>,

    /// Format of the images in --out [default: png]
    #[arg(long, requires = "out")]
    pub(super) format: Option<ImageFormat>,

    #[command(flatten)]
    pub(super) encoding: OutputArgs,

    #[command(flatten)]
    pub(super) frame: FrameArgs,

    /// Part of the image to render alone, with the same bits: left column, top row, width and height in pixels
    #[arg(long, value_name = "X,Y,W,H", conflicts_with_all = ["error", "max_time", "tev"])]
    pub(super) crop: Option<Crop>,

    #[command(flatten)]
    pub(super) sampling: SamplingArgs,

    /// Ray tracing backend that finds the hits [default: embree if built in, else bsp]
    #[arg(long)]
    pub(super) backend: Option<Backend>,

    #[command(flatten)]
    pub(super) tracing: TracingArgs,

    #[command(flatten)]
    pub(super) leaving: RayOffsetArgs,

    /// Read the settings from a file that `whit cost --out` wrote, in place of flags
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["spp", "pattern", "adaptive", "edge_contrast", "depth", "wavelengths", "backend", "precision", "instancing", "build_quality", "compact", "spawn", "hit_points", "rough_rays"])]
    pub(super) settings: Option<PathBuf>,

    /// Choose the fastest settings whose RMSE as displayed (black is 0, white 1) is at most this, by rendering parts of
    /// the image; the flags for samples and other settings are the start of the search
    #[arg(long, value_name = "RMSE", value_parser = cost::error, conflicts_with_all = ["settings", "adaptive", "edge_contrast", "max_time"])]
    pub(super) error: Option<f64>,

    /// Choose the most accurate settings at which the image takes at most this many seconds, without loading and
    /// building
    #[arg(long, value_name = "SECONDS", value_parser = cost::seconds, conflicts_with_all = ["settings", "adaptive", "edge_contrast"])]
    pub(super) max_time: Option<f64>,

    /// Seconds that the search for settings may take
    #[arg(long, value_name = "SECONDS", default_value_t = DEFAULT_BUDGET, value_parser = cost::budget)]
    pub(super) pilot: f64,

    #[command(flatten)]
    pub(super) view: ViewArgs,

    #[command(flatten)]
    pub(super) gltf: GltfArgs,

    /// Radiance of the environment, as X or R,G,B, in place of the scene's own
    #[arg(long, value_name = "RADIANCE", allow_hyphen_values = true)]
    pub(super) ambient: Option<Ambient>,

    #[command(flatten)]
    pub(super) surroundings: EnvironmentArgs,

    /// Seed of the random numbers; images of different seeds differ only in their noise
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(super) seed: u32,

    /// Number of rays per camera ray in the lobe of a rough surface, 0 for none, in place of the materials' own; with
    /// --environment, 1 where the materials have none
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=i64::from(MAX_ROUGH_RAYS)))]
    pub(super) rough_rays: Option<u32>,

    #[command(flatten)]
    pub(super) denoising: DenoiseArgs,

    #[command(flatten)]
    pub(super) display: DisplayArgs,

    /// Effects to add (+NAME) to those of the scene or to remove (-NAME), or `all`; see `whit info`
    #[arg(long, value_name = "LIST", allow_hyphen_values = true)]
    pub(super) effects: Option<EffectOverrides>,

    /// Write rays, seconds and memory as JSON; with several scenes a list. `-` prints a table of rays and seconds by
    /// effect
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub(super) stats: Option<PathBuf>,

    /// Write a heat map of the time that each pixel took, with a scale; for one scene. Slows the render down
    #[arg(long, value_name = "FILE.png", requires = "output")]
    pub(super) heat: Option<PathBuf>,

    #[command(flatten)]
    pub(super) watching: ProgressArgs,

    /// Print errors only, no warnings
    #[arg(long, short)]
    pub(super) quiet: bool,
}

/// Flags of pixel sampling.
#[derive(Clone, Debug, ArgGroup)]
pub(super) struct SamplingArgs {
    /// Samples per pixel; with --adaptive and --edge-contrast the largest number that a pixel gets
    #[arg(long, value_name = "N", help = or_scene("Samples per pixel; with --adaptive and --edge-contrast the largest number that a pixel gets", DEFAULT_SPP), value_parser = clap::value_parser!(u32).range(1..=MAX_SPP))]
    pub(super) spp: Option<u32>,

    /// Sampling pattern: positions of the samples in a pixel
    #[arg(
        long,
        value_enum,
        help = or_scene("Sampling pattern: positions of the samples in a pixel", word(Pattern::default()))
    )]
    pub(super) pattern: Option<Pattern>,

    /// Reconstruction filter that combines samples to a pixel
    #[arg(
        long,
        value_enum,
        help = or_scene("Reconstruction filter that combines samples to a pixel", word(FilterKind::default()))
    )]
    pub(super) filter: Option<FilterKind>,

    /// Radius of the filter in pixels, 1 to 4 [default: the scene file's, else tent 1, gaussian 1.5, mitchell 2]
    #[arg(long, value_name = "PIXELS", value_parser = filter_radius)]
    pub(super) filter_radius: Option<f64>,

    /// Take 16 samples and more, up to --spp, until the standard error of a pixel as displayed is under this; black is
    /// 0 and white 1, so 0.004 is one 8-bit code
    #[arg(long, value_name = "ERR", value_parser = adaptive_error)]
    pub(super) adaptive: Option<f64>,

    /// Take --spp samples only of pixels that differ from a neighbour by more than this as displayed, and one of all
    /// others; black is 0 and white 1, and 0.02 to 0.05 show no steps at edges
    #[arg(long, value_name = "DIFF", value_parser = edge_contrast, conflicts_with = "adaptive")]
    pub(super) edge_contrast: Option<f64>,

    /// Additional channels of EXR images; samples: their number and their variance in each pixel, as `samples` and
    /// `variance`; rays, time: rays and nanoseconds of each pixel, in total and by effect, as `rays`, `rays.shadow`,
    /// `time`, `time.shadow`; lights, effects: the contribution of each light and of each effect, which add up to the
    /// image, with the box filter only; the others describe the first hit of camera rays, as means over the samples of
    /// a pixel
    #[arg(long, value_name = "LIST", value_enum, value_delimiter = ',')]
    pub(super) aov: Vec<AovGroup>,
}

/// Flags of the image that apply to every scene.
#[derive(Clone, Copy, Debug, ArgGroup)]
pub(super) struct FrameArgs {
    /// Image size in pixels
    #[arg(long, value_name = "WxH", help = or_scene("Image size in pixels", DEFAULT_SIZE))]
    pub(super) size: Option<ImageSize>,

    /// Largest number of bounces of reflected and refracted rays; 0 for none
    #[arg(long, value_name = "N", help = or_scene("Largest number of bounces of reflected and refracted rays; 0 for none", DEFAULT_DEPTH), value_parser = clap::value_parser!(u32).range(0..=MAX_DEPTH))]
    pub(super) depth: Option<u32>,

    /// Number of wavelengths into which a path splits where glass disperses it
    #[arg(long, value_name = "N", help = or_scene("Number of wavelengths into which a path splits where glass disperses it", DEFAULT_WAVELENGTHS), value_parser = clap::value_parser!(u32).range(1..=MAX_WAVELENGTHS))]
    pub(super) wavelengths: Option<u32>,
}

/// Flags of ray tracing: precision, acceleration structures and threads.
#[derive(Clone, Debug, ArgGroup)]
pub(super) struct TracingArgs {
    /// Precision of triangle hits; at fast, f32 alone decides and the BSP is not watertight; brute force always is
    #[arg(long, default_value_t = Precision::default())]
    pub(super) precision: Precision,

    /// Representation of instanced meshes in Embree; auto is the fastest that provides the requested precision
    #[arg(long, value_enum, default_value_t = Instancing::default())]
    pub(super) instancing: Instancing,

    /// Build quality of Embree's trees; high acts as medium unless --precision is fast
    #[arg(long, value_enum, default_value_t = BuildQuality::default())]
    pub(super) build_quality: BuildQuality,

    /// Make Embree save memory at the cost of time; no effect at --precision robust
    #[arg(long)]
    pub(super) compact: bool,

    /// Instruction set that tracing is restricted to, so that results are the same on other machines; below avx2 whit's
    /// own tracing takes its portable form [default: the best of this machine]
    #[arg(long, value_parser = ["sse2", "sse4.2", "avx", "avx2", "avx512"])]
    pub(super) isa: Option<String>,

    /// Number of threads; 0 for one per processor
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=MAX_THREADS))]
    pub(super) threads: u32,
}

const INFO_EXAMPLES: &str = "\
Examples:
  whit info scene.glb
  whit info scene.toml --json
  whit info scene.toml --prices
  whit info scene.toml --prices --size 1920x1080 --spp 64 --budget 60";

/// Flags of `whit info`.
#[derive(Debug, ArgGroup)]
#[command(after_help = INFO_EXAMPLES)]
pub(super) struct InfoArgs {
    /// Scene file (.toml) or glTF scene (.glb, .gltf)
    #[arg(value_name = "SCENE")]
    pub(super) scene: PathBuf,

    /// Effects to add (+NAME) to those of the scene or to remove (-NAME), or `all`; see `whit info`
    #[arg(long, value_name = "LIST", allow_hyphen_values = true)]
    pub(super) effects: Option<EffectOverrides>,

    #[command(flatten)]
    pub(super) gltf: GltfArgs,

    /// Print the summary as JSON
    #[arg(long)]
    pub(super) json: bool,

    /// Estimate each effect's share of the time by a quick probe; auto: unless loading and building take long
    #[arg(long, value_name = "WHEN", default_value = "auto")]
    pub(super) forecast: ForecastMode,

    #[command(flatten)]
    pub(super) ablation: AblationArgs,
}

/// Choices of `whit info --forecast`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum ForecastMode {
    Auto,
    Always,
    Never,
}

/// Flags of the image that is rendered to measure costs.
#[derive(Clone, Copy, Debug, ArgGroup)]
pub(super) struct AblationArgs {
    /// Measure the cost in time of each effect and of each bounce, and the difference of the image without it: renders
    /// some of its tiles many times
    #[arg(long)]
    pub(super) prices: bool,

    /// Size of the image that is sampled
    #[arg(long, requires = "prices", value_name = "WxH", help = or_scene("Size in pixels of the image that is sampled", DEFAULT_SIZE))]
    pub(super) size: Option<ImageSize>,

    /// Samples per pixel of the image that is sampled
    #[arg(long, requires = "prices", value_name = "N", help = or_scene("Samples per pixel of the image that is sampled", DEFAULT_SPP), value_parser = clap::value_parser!(u32).range(1..=MAX_SPP))]
    pub(super) spp: Option<u32>,

    /// Largest number of bounces of reflected and refracted rays in the image that is sampled
    #[arg(long, requires = "prices", value_name = "N", help = or_scene("Largest number of bounces in the image that is sampled", DEFAULT_DEPTH), value_parser = clap::value_parser!(u32).range(0..=MAX_DEPTH))]
    pub(super) depth: Option<u32>,

    /// Approximate seconds of the measurement, which takes fewer tiles and runs to fit, but at least 8 tiles and 5 runs
    #[arg(long, requires = "prices", value_name = "SECONDS", default_value_t = DEFAULT_BUDGET, value_parser = budget)]
    pub(super) budget: f64,

    /// Ray tracing backend that finds the hits [default: embree if built in, else bsp]
    #[arg(long, requires = "prices")]
    pub(super) backend: Option<Backend>,

    /// Number of threads; 0 for one per processor
    #[arg(long, requires = "prices", value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=MAX_THREADS))]
    pub(super) threads: u32,
}

/// Width and height in pixels, at least 1 each and at most [`ImageSize::MAX_PIXELS`] together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ImageSize {
    pub(super) width: u32,
    pub(super) height: u32,
}

impl ImageSize {
    /// Largest number of pixels of an image; the machine's memory usually sets a lower limit.
    pub(super) const MAX_PIXELS: u64 = image_settings::MAX_PIXELS;
}

impl fmt::Display for ImageSize {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// Returns the help text of a flag whose default a scene file may override.
fn or_scene(what: &str, default: impl fmt::Display) -> String {
    format!("{what} [default: the scene file's, else {default}]")
}

/// Returns the spelling of a value on the command line.
fn word(value: impl clap::ValueEnum) -> String {
    let word = value.to_possible_value();
    word.map_or_else(String::new, |word| word.get_name().to_owned())
}

impl FromStr for ImageSize {
    type Err = String;

    fn from_str(text: &str) -> Result<ImageSize, String> {
        let sides = text.split_once(['x', 'X']).and_then(|(width, height)| {
            let side = |digits: &str| digits.parse::<u64>().ok();
            Some((side(width)?, side(height)?))
        });
        let Some((width, height)) = sides else {
            return Err("give width and height in pixels, as in 640x480".into());
        };
        if width == 0 || height == 0 {
            return Err(
                "an image needs at least one pixel in width and height: give a size as in 640x480".into(),
            );
        }
        // Check the number of pixels in u64, where the product cannot overflow
        match (u32::try_from(width), u32::try_from(height)) {
            (Ok(w), Ok(h)) if u64::from(w) * u64::from(h) <= ImageSize::MAX_PIXELS => {
                Ok(ImageSize { width: w, height: h })
            }
            _ => Err("an image may have at most 2^31 pixels: give a smaller size".into()),
        }
    }
}

/// Linear RGB radiance, finite and not negative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ambient(pub(super) [f32; 3]);

impl FromStr for Ambient {
    type Err = String;

    fn from_str(text: &str) -> Result<Ambient, String> {
        // Parse the comma-separated values, each finite and not negative
        let values: Vec<f32> = text
            .split(',')
            .map(|value| {
                value
                    .trim()
                    .parse()
                    .ok()
                    .filter(|v: &f32| v.is_finite() && *v >= 0.0)
            })
            .collect::<Option<_>>()
            .ok_or(
                "give one radiance or three (red, green, blue) of zero or more, as in 0.2 or 0.1,0.2,0.3",
            )?;
        match values[..] {
            [gray] => Ok(Ambient([gray; 3])),
            [red, green, blue] => Ok(Ambient([red, green, blue])),
            _ => Err("give one radiance or three (red, green, blue), as in 0.2 or 0.1,0.2,0.3".into()),
        }
    }
}

fn exposure(text: &str) -> Result<f32, String> {
    text.parse()
        .ok()
        .filter(|ev: &f32| ev.abs() <= MAX_EXPOSURE)
        .ok_or_else(|| format!("give stops from -{MAX_EXPOSURE} to {MAX_EXPOSURE}"))
}

fn budget(text: &str) -> Result<f64, String> {
    within(text, 0.0..=MAX_BUDGET).ok_or_else(|| format!("give seconds from 0 to {MAX_BUDGET}"))
}

fn filter_radius(text: &str) -> Result<f64, String> {
    let (min, max) = (PixelFilter::MIN_RADIUS, PixelFilter::MAX_RADIUS);
    within(text, min..=max).ok_or_else(|| format!("give a radius from {min} to {max} pixels"))
}

fn adaptive_error(text: &str) -> Result<f64, String> {
    within(text, MIN_ADAPTIVE_ERROR..=1.0).ok_or_else(|| {
        format!("give an error from {MIN_ADAPTIVE_ERROR} to 1, as in 0.004 for one 8-bit code")
    })
}

fn edge_contrast(text: &str) -> Result<f64, String> {
    within(text, MIN_EDGE_CONTRAST..=1.0).ok_or_else(|| {
        format!("give a difference from {MIN_EDGE_CONTRAST} to 1, as in 0.04 for ten 8-bit codes")
    })
}

/// Returns the number that a text gives, if it is one within the bounds.
fn within(text: &str, bounds: RangeInclusive<f64>) -> Option<f64> {
    text.parse().ok().filter(|number| bounds.contains(number))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_pass_the_checks_of_clap() {
        use clap::CommandFactory;
        Args::command().debug_assert();
    }

    #[test]
    fn size_is_two_whole_numbers_within_the_limit() {
        let size = |text: &str| text.parse::<ImageSize>();
        assert_eq!(
            size("640x480"),
            Ok(ImageSize {
                width: 640,
                height: 480
            })
        );
        for bad in [
            "640",
            "x",
            "640x",
            "-1x5",
            "0x5",
            "5x0",
            "1e3x5",
            "65536x32769",
            "99999999999x1",
        ] {
            assert!(size(bad).is_err(), "{bad}");
        }
        assert!(size("65536x32768").is_ok());
    }

    #[test]
    fn ambient_radiance_is_one_number_or_three() {
        let ambient = |text: &str| text.parse::<Ambient>();
        assert_eq!(ambient("0.25"), Ok(Ambient([0.25; 3])));
        assert_eq!(ambient("0.1,0.2, 3"), Ok(Ambient([0.1, 0.2, 3.0])));
        for bad in ["", "-1", "nan", "inf", "1,2", "1,2,3,4", "a"] {
            assert!(ambient(bad).is_err(), "{bad}");
        }
    }
}
