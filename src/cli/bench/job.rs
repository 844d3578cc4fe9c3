//! Checked parameters of `whit bench` for all scenes.

use rayon::ThreadPool;

use crate::cli::accel_options::tracing_options;
use crate::cli::args::{BenchArgs, DEFAULT_BENCH_SPP};
use crate::cli::failure::Failure;
use crate::cli::job::requested;
use whit::accel::{Backend, RayPacket};
use whit::batch::request::{TracingOptions, render_settings};
use whit::numeric::LANES;
use whit::render::RenderSettings;
use whit::report::memory;
use whit::scene_file::Output;

/// Checked parameters of `whit bench` for all scenes.
pub(super) struct BenchJob {
    /// Image settings of the command line; the scene may give those that are absent.
    requested: Output,
    pub(super) tracing: TracingOptions,
    /// Thread pools of the scaling measurement, fewest threads first; empty without `--scaling`.
    pub(super) scaling: Vec<ThreadPool>,
}

impl BenchJob {
    /// Checks the arguments and starts the thread pools.
    pub(super) fn new(args: &BenchArgs) -> Result<BenchJob, Failure> {
        let tracing = tracing_options(&args.tracing, Backend::default());
        // Start a pool for each thread count of the scaling measurement
        let counts = match args.scaling {
            true => thread_counts(tracing.threads),
            false => Vec::new(),
        };
        let pool = |threads| TracingOptions::of_threads(threads).pool();
        Ok(BenchJob {
            requested: Output {
                spp: args.spp,
                ..requested(&args.frame)
            },
            tracing,
            scaling: counts.into_iter().map(pool).collect::<Result<_, _>>()?,
        })
    }

    /// Returns the render settings for a scene whose file gives the image settings `output`.
    pub(super) fn settings(&self, output: &Output) -> Result<RenderSettings, Failure> {
        let mut requested = self.requested.or(output);
        requested.spp = requested.spp.or(Some(DEFAULT_BENCH_SPP));
        let settings = render_settings(&requested)?;
        let (width, height, spp) = (settings.width, settings.height, settings.spp);
        // All rays are recorded, so even the camera rays must fit into memory
        let packets = u64::from(width) * u64::from(height) * u64::from(spp) / LANES as u64;
        let needed = packets * size_of::<RayPacket>() as u64;
        if let Some(free) = memory::available_bytes().filter(|&free| needed > free) {
            return Err(Failure::Input(format!(
                "the camera rays of {width}x{height} pixels with {spp} samples alone take {} of memory and {} are \
                 free: give a smaller `--size` or `--spp`",
                memory::in_words(needed),
                memory::in_words(free)
            )));
        }
        Ok(settings)
    }
}

/// Returns the powers of two below `most`, and `most`.
fn thread_counts(most: usize) -> Vec<u32> {
    let most = u32::try_from(most).unwrap_or(u32::MAX).max(1);
    let mut counts: Vec<u32> = (0..32)
        .map(|power| 1 << power)
        .take_while(|&count| count < most)
        .collect();
    counts.push(most);
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thread_counts_double_up_to_the_largest() {
        assert_eq!(thread_counts(1), [1]);
        assert_eq!(thread_counts(2), [1, 2]);
        assert_eq!(thread_counts(6), [1, 2, 4, 6]);
        assert_eq!(thread_counts(8), [1, 2, 4, 8]);
    }
}
