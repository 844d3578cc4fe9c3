//! Adaptive sampling: more samples where a pixel's mean is still uncertain, as seen on a screen.
//!
//! The picture is rendered in rounds. The first gives every pixel sixteen samples; each later one doubles those of the
//! pixels that want more, as evenly spread points are evenest at powers of two. All of a round is known before the next
//! is decided, so decisions depend on the picture alone, not on threads or tiles. A pixel wants more samples while one of
//! these holds:
//!
//! 1. *Its mean is uncertain*: one standard error of its mean luminance, brighter, is a display value off by more than
//!    the target. That of n evenly spread samples is σ / n^¾ where edges are: an edge crosses about √n of n cells, and
//!    all others are certain. It is σ / √n where the samples are noise. How much is which, [`Kinds`] tell.
//! 2. *Its neighbourhood is uncertain*: so is the root mean square of those errors over the pixel and the eight around
//!    it. Estimates from few samples are uncertain themselves; neighbours vouch for each other.
//! 3. *Its neighbours know something that it has not seen*: where one of them saw a sample that is brighter or darker by
//!    a display value of c than any of its own n, c / (n + 1) is more than the target. By Laplace's rule of succession, 1
//!    / (n + 1) or so is what something unseen in n samples may cover.
//! 4. *It inherits*: it has had one round only and the mean of a neighbour is uncertain.
//!
//! Then [`Forecast`] tells whether the round does more than its samples would if all pixels shared them. Where most of a
//! picture is about equally uncertain that is not so, and the pixels with the fewest samples join the round: such
//! pictures are sampled evenly. The forecast also knows of things too small to be met. By Good and Turing's estimate (I.
//! J. Good, "The population frequencies of species", Biometrika 40, 1953) what no sample has met covers about as much as
//! what a single sample has met: for every pixel with one sample that differs from all its others and from its
//! neighbours', as much lies hidden elsewhere. While its root mean square over the picture is more than the target,
//! rounds go on.
//!
//! A thing smaller than a sixteenth of a pixel that has neither a larger neighbour nor its like elsewhere may be missed:
//! no later round looks where the first saw nothing. `tests/it/image/sampling.rs` measures what all of this saves.
//!
//! Between two rounds, and between two tiles of one, all that later ones need is in [`Rounds`]: whoever keeps that can go
//! on at another time, to the same bits.

mod checkpoints;
mod forecast;
mod look;
mod picture;
mod pilot;
mod progress;
mod rounds;

use std::sync::atomic::Ordering;
use std::time::Instant;

use super::estimate::Estimate;
use super::ledger::{Account, Ledger};
use super::meter::Meter;
use super::mosaic::{Canvas, Site};
use super::wave::{Visit, Waves};
use super::{Frame, Monitor};
use crate::numeric::LANES;
use crate::parallel;
use crate::scene::Effect;
use checkpoints::Pace;
use look::Look;
use picture::Picture;
use progress::Progress;
use rounds::Turn;

pub use checkpoints::Checkpoints;
pub use rounds::Rounds;

/// Samples that a pixel gets at least: a full packet.
pub(super) const ROUND: u32 = LANES as u32;

/// The least error that may be asked for, as a display value: the most samples, 2^16, have one of σ / n^¾, which is 2^-20
/// where σ is 2^-8, an 8-bit code. Less is out of reach for all pixels but those that are even already; the others would
/// only take the most samples.
pub const MIN_ADAPTIVE_ERROR: f64 = 1e-6;

/// When a pixel has samples enough.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// Standard error of a pixel's mean that is let pass, as a display value: 0 is black, 1 is white, an 8-bit code is
    /// 1/255. More than 0. It is estimated for evenly spread samples, on a curve close to sRGB's.
    pub error: f64,
    /// What radiance is multiplied by on its way to the display: 2 to the power of the exposure.
    pub gain: f64,
}

/// What a pixel that is visited takes: the visit and what it tells.
const VISIT_BYTES: usize = size_of::<Visit>() + size_of::<Estimate>();

/// What a pixel takes between two rounds besides its estimate.
pub(super) const LOOK_BYTES: usize = size_of::<Look>() + size_of::<Turn>();

/// What the samples of every pixel of the canvas tell, row by row, and what they took. `None` if the render was
/// cancelled.
pub(super) fn render(
    frame: &mut Frame,
    target: Adaptive,
    canvas: &Canvas,
    monitor: &Monitor,
    mut checkpoints: Option<&mut Checkpoints>,
) -> Option<(Vec<Estimate>, Ledger)> {
    let sites = &canvas.sites;
    let mut picture = Picture::new(target, canvas, frame.settings.spp);
    let mut ledger = Ledger::default();
    let mut meter = Meter::new(&frame.settings);
    let has_widths = frame.effects().has(Effect::TextureFilter);
    let start = checkpoints
        .as_mut()
        .and_then(|checkpoints| checkpoints.start.take());
    if let Some(rounds) = start.filter(|rounds| rounds.is_of(canvas.size, picture.spp)) {
        if has_widths {
            frame.set_even_count(rounds.even_count);
        }
        picture.known = rounds;
    } else if has_widths {
        ledger += pilot(frame, &mut picture, sites, monitor)?;
        meter.skip();
    }
    picture.known.even_count = frame.even_count;
    let waves = Waves::new(frame);
    let mut pace = Pace::new(checkpoints);
    let mut progress = Progress::default();
    loop {
        let mut left = picture.visits(sites);
        meter.lap_all_threads(Account::Sampling);
        let wanted_count: usize = left.iter().map(|(_, visits)| visits.len()).sum();
        if let Some(memory) = &frame.thread_memory {
            memory.note_round(picture.byte_count() + wanted_count * VISIT_BYTES);
        }
        progress.begin_round(&picture, left.iter().flat_map(|(_, visits)| visits));
        while !left.is_empty() {
            let later = left.split_off(pace.tile_count().min(left.len()));
            let begun = Instant::now();
            let Some(visited) = render_visits(&waves, left, monitor, Some(&progress)) else {
                // It is ended anyway.
                let _ = pace.keep(&picture.known);
                return None;
            };
            left = later;
            meter.skip();
            pace.took(visited.len(), begun.elapsed());
            for (site, visits, estimates, tile_ledger) in visited {
                ledger += tile_ledger;
                picture.merge(site, &visits, &estimates);
                monitor.show_estimates(site, &picture.known.estimates, picture.width);
            }
            if pace.is_due() && pace.keep(&picture.known).is_break() {
                return None;
            }
            meter.lap(Account::Sampling);
        }
        picture.end_round();
        if !picture.decide() {
            meter.lap_all_threads(Account::Sampling);
            ledger += meter.ledger;
            return Some((picture.known.estimates, ledger));
        }
    }
}

/// Makes rays as wide as [`pilot`] finds; what that took. The pixels that were asked last have had their first round,
/// unless its rays were of another width. `None` if the render was cancelled.
fn pilot(frame: &mut Frame, picture: &mut Picture, sites: &[Site], monitor: &Monitor) -> Option<Ledger> {
    let size = [picture.width, picture.height];
    let turn = |index: usize| match pilot::is_asked([index % size[0], index / size[0]], size) {
        true => Turn::Waits,
        false => Turn::None,
    };
    picture.known.turns = (0..picture.known.turns.len()).map(turn).collect();
    let mut ledger = Ledger::default();
    for _ in 0..pilot::MAX_ROUNDS {
        let visited = render_visits(&Waves::new(frame), picture.visits(sites), monitor, None)?;
        let first_rounds: Vec<Estimate> = visited.iter().flat_map(|visited| &visited.2).copied().collect();
        let before = frame.even_count;
        frame.set_even_count(pilot::even_count(&first_rounds, picture.target, picture.spp));
        let has_settled = pilot::has_settled(before, frame.even_count);
        for (site, visits, estimates, tile_ledger) in visited {
            ledger += tile_ledger;
            if has_settled {
                picture.merge(site, &visits, &estimates);
            }
        }
        if has_settled {
            break;
        }
    }
    for turn in &mut picture.known.turns {
        if *turn == Turn::None {
            *turn = Turn::Waits;
        }
    }
    Some(ledger)
}

/// A tile, the pixels of it that were visited, what their new samples tell, and what they took.
type Visited = (Site, Vec<Visit>, Vec<Estimate>, Ledger);

/// Where there is `progress`, the monitor hears of every tile that is finished.
fn render_visits(
    waves: &Waves,
    round: Vec<(Site, Vec<Visit>)>,
    monitor: &Monitor,
    progress: Option<&Progress>,
) -> Option<Vec<Visited>> {
    let told = parallel::map(round.len(), &|index| {
        if monitor.cancel.load(Ordering::Relaxed) {
            return None;
        }
        let (site, visits) = &round[index];
        let told = waves.lend().render_visits(site.tile, visits);
        if let Some(progress) = progress {
            (monitor.progress)(progress.finish(visits));
        }
        Some(told)
    });
    let visited = round.into_iter().zip(told);
    visited
        .map(|((site, visits), told)| told.map(|(estimates, ledger)| (site, visits, estimates, ledger)))
        .collect()
}
