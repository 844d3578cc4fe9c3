//! Rounds of adaptive sampling, from the first samples of an image to the last.

use std::time::Instant;

use super::super::context::RenderContext;
use super::super::film::PixelStatistics;
use super::super::monitor::{Cancelled, Monitor};
use super::super::profile::{Category, Profiler, RenderProfile};
use super::super::subset::{Patch, PatchAtlas};
use super::super::tile::PixelVisit;
use super::super::wavefront::RendererPool;
use super::checkpoints::{Checkpoints, Pace};
use super::display_error::DisplayError;
use super::pilot;
use super::progress::AdaptiveProgress;
use super::rounds::PixelStatus;
use super::state::SamplingState;
use super::target::Adaptive;
use crate::parallel;
use crate::scene::Effect;

/// Number of bytes for a visited pixel: the visit and its estimate.
const VISIT_BYTES: usize = size_of::<PixelVisit>() + size_of::<PixelStatistics>();

/// Number of bytes per pixel between two rounds, in addition to its estimate.
pub(in crate::render) const LOOK_BYTES: usize = size_of::<DisplayError>() + size_of::<PixelStatus>();

/// Returns the sample statistics of every pixel of the canvas, row by row, and the ledger.
pub(in crate::render) fn render(
    frame: &mut RenderContext,
    target: Adaptive,
    canvas: &PatchAtlas,
    monitor: &Monitor,
    mut checkpoints: Option<&mut Checkpoints>,
) -> Result<(Vec<PixelStatistics>, RenderProfile), Cancelled> {
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
    let mut progress = AdaptiveProgress::default();
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
            let Ok(visited) = render_visits(&waves, left, monitor, Some(&progress)) else {
                // The render ends in any case.
                let _ = pace.keep(&state.known);
                return Err(Cancelled);
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
                return Err(Cancelled);
            }
            meter.lap(Category::Sampling);
        }
        // Evaluate the errors and select the pixels of the next round
        state.end_round();
        if !state.decide() {
            meter.lap_all_threads(Category::Sampling);
            ledger += meter.ledger;
            return Ok((state.known.estimates, ledger));
        }
    }
}

/// Sets the ray cones by the pilot rounds of [`pilot`] and returns their ledger. The pixels of the last pilot round
/// keep their samples as first round, unless their rays had a different width.
fn pilot(
    frame: &mut RenderContext,
    state: &mut SamplingState,
    sites: &[Patch],
    monitor: &Monitor,
) -> Result<RenderProfile, Cancelled> {
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
    Ok(ledger)
}

/// Site, its visited pixels, the statistics of their new samples, and the ledger.
type Visited = (Patch, Vec<PixelVisit>, Vec<PixelStatistics>, RenderProfile);

/// Renders the visits of a round in parallel. With `progress`, the monitor is notified of every finished tile.
fn render_visits(
    waves: &RendererPool,
    round: Vec<(Patch, Vec<PixelVisit>)>,
    monitor: &Monitor,
    progress: Option<&AdaptiveProgress>,
) -> Result<Vec<Visited>, Cancelled> {
    let rendered = parallel::map(round.len(), &|index| {
        monitor.check()?;
        let (site, visits) = &round[index];
        let rendered = waves.acquire().render_visits(site.tile, visits);
        if let Some(progress) = progress {
            (monitor.progress)(progress.finish(visits));
        }
        Ok(rendered)
    });
    let visited = round.into_iter().zip(rendered);
    visited
        .map(|((site, visits), rendered)| {
            rendered.map(|(estimates, ledger)| (site, visits, estimates, ledger))
        })
        .collect()
}
