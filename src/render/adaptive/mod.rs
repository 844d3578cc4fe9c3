//! Adaptive sampling: takes more samples where the mean of a pixel is still uncertain, measured in display values.
//!
//! The image is rendered in rounds. The first round gives every pixel sixteen samples; each later round doubles the
//! samples of the selected pixels, because the point sets are best stratified at powers of two. A round is finished
//! before the next one is decided, so decisions depend on the image alone, not on threads or tiles. A pixel is
//! selected while one of these criteria holds:
//!
//! 1. *Its mean is uncertain*: adding one standard error to its mean luminance changes the display value by more than
//!    the target. The standard error of n stratified samples is σ / n^¾ at edges: an edge crosses about √n of n
//!    strata, and all others are certain. It is σ / √n where the variance is noise. [`NoiseModel`] estimates the
//!    proportions of both.
//! 2. *Its neighbourhood is uncertain*: the root mean square of these errors over the pixel and its eight neighbours
//!    exceeds the target. Estimates from few samples are uncertain themselves; neighbours make them reliable.
//! 3. *Its neighbours saw something that it has not seen*: a neighbour has a sample that is brighter or darker by a
//!    display value of c than any of the pixel's own n samples, and c / (n + 1) is more than the target. By Laplace's
//!    rule of succession, something unseen in n samples may cover about 1 / (n + 1) of the pixel.
//! 4. *It inherits*: it has had one round only, and the mean of a neighbour is uncertain.
//!
//! Then [`Forecast`] decides whether the round reduces the error more than the same number of samples distributed
//! over all pixels. Where most of an image is about equally uncertain it does not, and the pixels with the fewest
//! samples join the round, so that such images are sampled uniformly. The forecast also includes features that are
//! too small to be hit. By the estimate of Good and Turing (I. J. Good, "The population frequencies of species",
//! Biometrika 40, 1953), features that no sample has hit cover about as much as those that a single sample has hit:
//! for every pixel with one sample that differs from all its others and from its neighbours', as much is hidden
//! elsewhere. Rounds continue while the root mean square of this error over the image exceeds the target.
//!
//! A feature smaller than a sixteenth of a pixel may be missed if it has neither a larger neighbour nor similar
//! features elsewhere, because no later round samples where the first one saw nothing. `tests/it/image/sampling.rs`
//! measures the savings of adaptive sampling.
//!
//! Between two rounds, and between two tiles of a round, the complete state is in [`Rounds`]: a render that resumes
//! from a stored state produces the same bits.

mod checkpoints;
mod forecast;
mod look;
mod picture;
mod pilot;
mod progress;
mod rounds;

use std::sync::atomic::Ordering;
use std::time::Instant;

use super::estimate::PixelStatistics;
use super::ledger::{Category, RenderProfile};
use super::meter::Profiler;
use super::mosaic::{Patch, PatchAtlas};
use super::wave::{PixelVisit, RendererPool};
use super::{Monitor, RenderContext};
use crate::numeric::LANES;
use crate::parallel;
use crate::scene::Effect;
use checkpoints::Pace;
use look::DisplayError;
use picture::SamplingState;
use progress::Progress;
use rounds::PixelStatus;

pub use checkpoints::Checkpoints;
pub use rounds::Rounds;

/// Smallest number of samples per pixel: a full packet.
pub(super) const ROUND: u32 = LANES as u32;

/// Smallest target error, as a display value: the largest number of samples, 2^16, has an error of σ / n^¾, which is
/// 2^-20 for σ = 2^-8, one 8-bit code. A smaller target is out of reach for all pixels but uniform ones; the others
/// would only take the largest number of samples.
pub const MIN_ADAPTIVE_ERROR: f64 = 1e-6;

/// Stopping criterion of adaptive sampling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// Target for the standard error of a pixel's mean, as a display value: 0 is black, 1 is white, an 8-bit code is
    /// 1/255. More than 0. It is estimated for stratified samples, on a curve close to that of sRGB.
    pub error: f64,
    /// Factor on radiance before display: 2 to the power of the exposure.
    pub gain: f64,
}

/// Number of bytes for a visited pixel: the visit and its estimate.
const VISIT_BYTES: usize = size_of::<PixelVisit>() + size_of::<PixelStatistics>();

/// Number of bytes per pixel between two rounds, in addition to its estimate.
pub(super) const LOOK_BYTES: usize = size_of::<DisplayError>() + size_of::<PixelStatus>();

/// Returns the sample statistics of every pixel of the canvas, row by row, and the ledger. Returns `None` if
/// cancelled.
pub(super) fn render(
    frame: &mut RenderContext,
    target: Adaptive,
    canvas: &PatchAtlas,
    monitor: &Monitor,
    mut checkpoints: Option<&mut Checkpoints>,
) -> Option<(Vec<PixelStatistics>, RenderProfile)> {
    let sites = &canvas.sites;
    let mut state = SamplingState::new(target, canvas, frame.settings.spp);
    let mut ledger = RenderProfile::default();
    let mut meter = Profiler::new(&frame.settings);
    let has_widths = frame.effects().has(Effect::TextureFilter);
    // Resume from a checkpoint, or find the width of rays in a pilot
    let start = checkpoints
        .as_mut()
        .and_then(|checkpoints| checkpoints.start.take());
    if let Some(rounds) = start.filter(|rounds| rounds.is_of(canvas.size, state.spp)) {
        if has_widths {
            frame.set_even_count(rounds.even_count);
        }
        state.known = rounds;
    } else if has_widths {
        ledger += pilot(frame, &mut state, sites, monitor)?;
        meter.skip();
    }
    state.known.even_count = frame.even_count;
    let waves = RendererPool::new(frame);
    let mut pace = Pace::new(checkpoints);
    let mut progress = Progress::default();
    // Render rounds until no pixel needs more samples
    loop {
        // Collect the pixels of the round and announce its size
        let mut left = state.visits(sites);
        meter.lap_all_threads(Category::Sampling);
        let wanted_count: usize = left.iter().map(|(_, visits)| visits.len()).sum();
        if let Some(memory) = &frame.thread_memory {
            memory.note_round(state.byte_count() + wanted_count * VISIT_BYTES);
        }
        progress.begin_round(&state, left.iter().flat_map(|(_, visits)| visits));
        // Render the round in parts that a checkpoint interval can afford
        while !left.is_empty() {
            let later = left.split_off(pace.tile_count().min(left.len()));
            let begun = Instant::now();
            let Some(visited) = render_visits(&waves, left, monitor, Some(&progress)) else {
                // The render ends in any case.
                let _ = pace.keep(&state.known);
                return None;
            };
            left = later;
            meter.skip();
            pace.record_time(visited.len(), begun.elapsed());
            // Merge the new samples into the state
            for (site, visits, estimates, tile_ledger) in visited {
                ledger += tile_ledger;
                state.merge(site, &visits, &estimates);
                monitor.show_estimates(site, &state.known.estimates, state.width);
            }
            // Write a checkpoint if it is due
            if pace.is_due() && pace.keep(&state.known).is_break() {
                return None;
            }
            meter.lap(Category::Sampling);
        }
        // Evaluate the errors and select the pixels of the next round
        state.end_round();
        if !state.decide() {
            meter.lap_all_threads(Category::Sampling);
            ledger += meter.ledger;
            return Some((state.known.estimates, ledger));
        }
    }
}

/// Sets the ray cones by the pilot rounds of [`pilot`] and returns their ledger. The pixels of the last pilot round
/// keep their samples as first round, unless their rays had a different width. Returns `None` if cancelled.
fn pilot(
    frame: &mut RenderContext,
    state: &mut SamplingState,
    sites: &[Patch],
    monitor: &Monitor,
) -> Option<RenderProfile> {
    // Select the pixels of the pilot
    let size = [state.width, state.height];
    let turn = |index: usize| match pilot::is_pilot_pixel([index % size[0], index / size[0]], size) {
        true => PixelStatus::Waits,
        false => PixelStatus::None,
    };
    state.known.statuses = (0..state.known.statuses.len()).map(turn).collect();
    let mut ledger = RenderProfile::default();
    // Repeat the pilot round until the width of rays settles
    for _ in 0..pilot::MAX_ROUNDS {
        let visited = render_visits(&RendererPool::new(frame), state.visits(sites), monitor, None)?;
        let first_rounds: Vec<PixelStatistics> =
            visited.iter().flat_map(|visited| &visited.2).copied().collect();
        let before = frame.even_count;
        frame.set_even_count(pilot::even_count(&first_rounds, state.target, state.spp));
        let has_settled = pilot::has_settled(before, frame.even_count);
        for (site, visits, estimates, tile_ledger) in visited {
            ledger += tile_ledger;
            if has_settled {
                state.merge(site, &visits, &estimates);
            }
        }
        if has_settled {
            break;
        }
    }
    // Let all other pixels have their first round
    for turn in &mut state.known.statuses {
        if *turn == PixelStatus::None {
            *turn = PixelStatus::Waits;
        }
    }
    Some(ledger)
}

/// Site, its visited pixels, the statistics of their new samples, and the ledger.
type Visited = (Patch, Vec<PixelVisit>, Vec<PixelStatistics>, RenderProfile);

/// Renders the visits of a round in parallel and returns `None` if cancelled. With `progress`, the monitor is
/// notified of every finished tile.
fn render_visits(
    waves: &RendererPool,
    round: Vec<(Patch, Vec<PixelVisit>)>,
    monitor: &Monitor,
    progress: Option<&Progress>,
) -> Option<Vec<Visited>> {
    let rendered = parallel::map(round.len(), &|index| {
        if monitor.cancel.load(Ordering::Relaxed) {
            return None;
        }
        let (site, visits) = &round[index];
        let rendered = waves.acquire().render_visits(site.tile, visits);
        if let Some(progress) = progress {
            (monitor.progress)(progress.finish(visits));
        }
        Some(rendered)
    });
    let visited = round.into_iter().zip(rendered);
    visited
        .map(|((site, visits), rendered)| {
            rendered.map(|(estimates, ledger)| (site, visits, estimates, ledger))
        })
        .collect()
}
