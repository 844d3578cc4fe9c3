//! Adaptive sampling: more samples where a pixel's mean is still uncertain, as seen on a screen.
//!
//! The picture is rendered in rounds. The first gives every pixel sixteen samples; each later one doubles those of the
//! pixels that want more, as evenly spread points are evenest at powers of two. All of a round is known before the next is
//! decided, so decisions depend on the picture alone, not on threads or tiles. A pixel wants more samples while one of these
//! holds:
//!
//! 1. *Its mean is uncertain*: one standard error of its mean luminance, brighter, is a display value off by more than
//!    the target. The standard error of n evenly spread samples is taken for σ / n^¾: an edge crosses about √n of n cells,
//!    and all others are certain. (Of independent samples it were σ / √n.)
//! 2. *Its neighbourhood is uncertain*: so is the root mean square of those errors over the pixel and the eight around it.
//!    Estimates from few samples are uncertain themselves; neighbours vouch for each other.
//! 3. *Its neighbours know something that it has not seen*: where one of them saw a sample that is brighter or darker by a
//!    display value of c than any of its own n, c / (n + 1) is more than the target. By Laplace's rule of succession,
//!    1 / (n + 1) or so is what something unseen in n samples may cover.
//! 4. *It inherits*: it has had one round only and the mean of a neighbour is uncertain.
//!
//! What is smaller than a sixteenth of a pixel and has no larger neighbour may be missed: no later round looks where the
//! first saw nothing. `tests/sampling.rs` measures what all of this saves.
//!
//! The display value is a curve close to sRGB's, but made of a square root, which is rounded alike on every machine:
//! decisions must not depend on anybody's `pow`. It goes on above white, so highlights of linear pictures count too.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::film::{TILE, Tile, tiles};
use super::ledger::Ledger;
use super::wave::{Visit, Wave};
use super::{Frame, Monitor, RUN};
use crate::numeric::LANES;

/// Samples that a pixel gets at least: a full packet.
pub(super) const ROUND: u32 = LANES as u32;

/// When a pixel has samples enough.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// Standard error of a pixel's mean that is let pass, as a display value: 0 is black, 1 is white, an 8-bit code is
    /// 1/255. More than 0. It is estimated for evenly spread samples, on a curve close to sRGB's.
    pub error: f64,
    /// What radiance is multiplied by on its way to the display: 2 to the power of the exposure.
    pub gain: f64,
}

/// Rec. 709 luminance of linear RGB.
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// What the samples of a pixel tell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Estimate {
    /// Of radiance, linear RGB.
    pub(super) sum: [f64; 3],
    /// Sum of squared radiance, channels weighted by luminance.
    squares: f64,
    /// Least and greatest luminance of a sample.
    extremes: [f32; 2],
    /// Samples.
    pub(super) count: u32,
}

impl Estimate {
    pub(super) const NONE: Estimate = Estimate {
        sum: [0.0; 3],
        squares: 0.0,
        extremes: [f32::INFINITY, f32::NEG_INFINITY],
        count: 0,
    };

    /// Counts one more sample.
    #[inline(always)]
    pub(super) fn add(&mut self, radiance: [f64; 3]) {
        let mut luminance = 0.0;
        for channel in 0..3 {
            let value = radiance[channel];
            self.sum[channel] += value;
            luminance += LUMINANCE[channel] * value;
            self.squares += LUMINANCE[channel] * value * value;
        }
        self.extremes[0] = self.extremes[0].min(luminance as f32);
        self.extremes[1] = self.extremes[1].max(luminance as f32);
        self.count += 1;
    }

    /// Counts the samples of `other` too.
    fn merge(&mut self, other: &Estimate) {
        for channel in 0..3 {
            self.sum[channel] += other.sum[channel];
        }
        self.squares += other.squares;
        self.extremes[0] = self.extremes[0].min(other.extremes[0]);
        self.extremes[1] = self.extremes[1].max(other.extremes[1]);
        self.count += other.count;
    }

    /// Mean radiance.
    pub(super) fn mean(&self) -> [f64; 3] {
        self.sum.map(|sum| sum / f64::from(self.count))
    }

    /// Variance of the samples (not of their mean), channels weighted by luminance; 0 for a single one.
    ///
    /// It is at least that of the luminance, and sees edges between colours of equal luminance as well. In f64 the
    /// difference of squares loses 2^-53 of the squared mean, so 2^-26 of the mean in standard deviation.
    pub(super) fn variance(&self) -> f64 {
        if self.count < 2 {
            return 0.0;
        }
        let mean = self.mean();
        let mean_squares: f64 = (0..3).map(|c| LUMINANCE[c] * mean[c] * self.sum[c]).sum();
        ((self.squares - mean_squares) / f64::from(self.count - 1)).max(0.0)
    }
}

impl Default for Estimate {
    fn default() -> Estimate {
        Estimate::NONE
    }
}

/// A pixel as the display shows it.
#[derive(Clone, Copy, Debug)]
struct Look {
    /// Display value of one standard error of the mean.
    error: f64,
    /// Display values of the darkest and the brightest sample.
    extremes: [f64; 2],
    count: u32,
}

/// What a pixel takes between two rounds besides its estimate.
pub(super) const LOOK_BYTES: usize = size_of::<Look>();

impl Look {
    fn of(estimate: &Estimate, gain: f64) -> Look {
        let count = f64::from(estimate.count);
        let mean: f64 = gain * (0..3).map(|c| LUMINANCE[c] * estimate.sum[c]).sum::<f64>() / count;
        // σ / n^¾.
        let error = gain * (estimate.variance() / (count * count.sqrt())).sqrt();
        Look {
            error: display_value(mean + error) - display_value(mean),
            extremes: estimate.extremes.map(|l| display_value(gain * f64::from(l))),
            count: estimate.count,
        }
    }

    /// How much more a neighbour has seen: the larger step beyond this pixel's own extremes.
    fn unseen(&self, neighbour: &Look) -> f64 {
        let brighter = neighbour.extremes[1] - self.extremes[1];
        let darker = self.extremes[0] - neighbour.extremes[0];
        brighter.max(darker)
    }
}

/// Nearly the sRGB value of a luminance, from 0 for black to 1 for white and on: within 0.07 of it, and as steep at black.
fn display_value(luminance: f64) -> f64 {
    /// Makes the slope at zero 12.92, as in IEC 61966-2-1: (√(1 + r²) + r) / (2 r) = 12.92.
    const ROOT: f64 = 0.0403;
    let shifted = |x: f64| (x + ROOT * ROOT).sqrt();
    (shifted(luminance.clamp(0.0, f64::INFINITY)) - ROOT) * (shifted(1.0) + ROOT)
}

/// What every pixel's samples tell, row by row, and what they took. `None` if the render was cancelled.
pub(super) fn render(frame: &Frame, target: Adaptive, monitor: &Monitor) -> Option<(Vec<Estimate>, Ledger)> {
    let (width, height) = (frame.settings.width, frame.settings.height);
    let tiles = tiles(width, height);
    let mut picture = Picture::new(frame, target);
    let mut ledger = Ledger::default();
    let mut first_count = None;
    loop {
        let round = picture.wanted(&tiles);
        let wanted_count: usize = round.iter().map(|(_, visits)| visits.len()).sum();
        if wanted_count == 0 {
            return Some((picture.estimates, ledger));
        }
        // The first round is taken for half of the work; the second half is done as pixels have enough.
        let whole = *first_count.get_or_insert(wanted_count);
        let progress = |done: f64| {
            let part = if picture.looks.is_empty() {
                0.5 * done
            } else {
                1.0 - 0.5 * wanted_count as f64 / whole as f64
            };
            (monitor.progress)(part);
        };
        for (tile, visits, estimates, tile_ledger) in render_round(frame, round, monitor, &progress)? {
            ledger += tile_ledger;
            picture.merge(tile, &visits, &estimates);
        }
        picture.look();
    }
}

/// A tile, the pixels of it that were visited, what their new samples tell, and what they took.
type Visited = (Tile, Vec<Visit>, Vec<Estimate>, Ledger);

fn render_round(
    frame: &Frame,
    round: Vec<(Tile, Vec<Visit>)>,
    monitor: &Monitor,
    progress: &(dyn Fn(f64) + Sync),
) -> Option<Vec<Visited>> {
    let finished = AtomicUsize::new(0);
    let tile_count = round.len() as f64;
    round
        .into_par_iter()
        .with_max_len(RUN)
        .map_init(
            || Wave::new(frame),
            |wave, (tile, visits)| {
                if monitor.cancel.load(Ordering::Relaxed) {
                    return None;
                }
                let (estimates, ledger) = wave.render_visits(tile, &visits);
                progress((finished.fetch_add(1, Ordering::Relaxed) + 1) as f64 / tile_count);
                Some((tile, visits, estimates, ledger))
            },
        )
        .collect()
}

/// The state of all pixels between two rounds.
struct Picture {
    target: Adaptive,
    width: usize,
    height: usize,
    /// Most samples a pixel.
    spp: u32,
    estimates: Vec<Estimate>,
    /// One for each estimate, after the first round.
    looks: Vec<Look>,
}

impl Picture {
    fn new(frame: &Frame, target: Adaptive) -> Picture {
        let (width, height) = (frame.settings.width as usize, frame.settings.height as usize);
        Picture {
            target,
            width,
            height,
            spp: frame.settings.spp,
            estimates: vec![Estimate::NONE; width * height],
            looks: Vec::new(),
        }
    }

    /// The pixels that want samples, by tile; tiles without any are left out.
    fn wanted(&self, tiles: &[Tile]) -> Vec<(Tile, Vec<Visit>)> {
        tiles
            .par_iter()
            .map(|&tile| (tile, self.wanted_in(tile)))
            .filter(|(_, visits)| !visits.is_empty())
            .collect()
    }

    fn wanted_in(&self, tile: Tile) -> Vec<Visit> {
        let mut visits = Vec::new();
        for y in 0..tile.height {
            for x in 0..tile.width {
                let (column, row) = ((tile.x + x) as usize, (tile.y + y) as usize);
                if self.looks.is_empty() || self.wants_more(column, row) {
                    visits.push(Visit {
                        x,
                        y,
                        groups: self.next_groups(row * self.width + column),
                    });
                }
            }
        }
        visits
    }

    /// As many packets as a pixel has had already, up to the most samples that there are.
    fn next_groups(&self, index: usize) -> Range<u32> {
        let first = self.estimates[index].count / ROUND;
        first..(2 * first).max(1).min(self.spp.div_ceil(ROUND))
    }

    /// The rule at the head of this file.
    fn wants_more(&self, column: usize, row: usize) -> bool {
        let target = self.target.error;
        let look = &self.looks[row * self.width + column];
        // More samples do not make a number of what is none.
        if look.count >= self.spp || !look.error.is_finite() {
            return false;
        }
        if look.error > target {
            return true;
        }
        let unseen_limit = target * f64::from(look.count + 1);
        let (mut squares, mut sound_count) = (0.0, 0.0);
        for y in row.saturating_sub(1)..(row + 2).min(self.height) {
            let start = y * self.width;
            let near = start + column.saturating_sub(1)..start + (column + 2).min(self.width);
            for other in self.looks[near].iter().filter(|other| other.error.is_finite()) {
                if look.unseen(other) > unseen_limit || (look.count <= ROUND && other.error > target) {
                    return true;
                }
                squares += other.error * other.error;
                sound_count += 1.0;
            }
        }
        squares > target * target * sound_count
    }

    fn merge(&mut self, tile: Tile, visits: &[Visit], estimates: &[Estimate]) {
        for (visit, estimate) in visits.iter().zip(estimates) {
            let (column, row) = ((tile.x + visit.x) as usize, (tile.y + visit.y) as usize);
            self.estimates[row * self.width + column].merge(estimate);
        }
    }

    /// Sees all pixels anew.
    fn look(&mut self) {
        let gain = self.target.gain;
        self.estimates
            .par_iter()
            .with_min_len((TILE * TILE) as usize)
            .map(|estimate| Look::of(estimate, gain))
            .collect_into_vec(&mut self.looks);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(samples: &[f64]) -> Estimate {
        let mut estimate = Estimate::NONE;
        for &gray in samples {
            estimate.add([gray; 3]);
        }
        estimate
    }

    #[test]
    fn mean_and_variance_are_those_of_the_samples() {
        let four = estimate(&[1.0, 2.0, 3.0, 6.0]);
        // Mean 3; squared differences 4 + 1 + 0 + 9 over 3.
        assert_eq!(four.mean(), [3.0; 3]);
        assert!((four.variance() - 14.0 / 3.0).abs() < 1e-14);
        assert_eq!(estimate(&[5.0]).variance(), 0.0);
        let mut merged = estimate(&[1.0, 2.0]);
        merged.merge(&estimate(&[3.0, 6.0]));
        assert_eq!(merged, four);
    }

    #[test]
    fn an_edge_between_colours_of_equal_luminance_has_a_variance() {
        let mut edge = Estimate::NONE;
        edge.add([1.0 / LUMINANCE[0], 0.0, 0.0]);
        edge.add([0.0, 1.0 / LUMINANCE[1], 0.0]);
        assert!(edge.extremes[0] > 0.99 && edge.extremes[1] < 1.01);
        assert!(edge.variance() > 1.0);
    }

    #[test]
    fn the_display_value_keeps_close_to_srgb_and_ends_where_it_ends() {
        assert_eq!(display_value(0.0), 0.0);
        assert_eq!(display_value(-1.0), 0.0);
        assert!((display_value(1.0) - 1.0).abs() < 1e-15);
        assert!((display_value(1e-7) / 1e-7 / 12.92 - 1.0).abs() < 1e-3);
        for step in 0..=1000 {
            let luminance = f64::from(step) / 1000.0;
            let srgb = if luminance <= 0.003_130_8 {
                12.92 * luminance
            } else {
                1.055 * luminance.powf(1.0 / 2.4) - 0.055
            };
            assert!((display_value(luminance) - srgb).abs() < 0.07, "{luminance}");
        }
    }

    /// A picture of three by three pixels of `count` gray samples each, but for its middle.
    fn around(middle: &[f64], gray: f64, count: usize, target: f64) -> Picture {
        let mut estimates = vec![estimate(&vec![gray; count]); 9];
        estimates[4] = estimate(middle);
        let mut picture = Picture {
            target: Adaptive {
                error: target,
                gain: 1.0,
            },
            width: 3,
            height: 3,
            spp: 256,
            estimates,
            looks: Vec::new(),
        };
        picture.look();
        picture
    }

    #[test]
    fn an_even_picture_wants_nothing() {
        let picture = around(&[0.5; 16], 0.5, 16, 0.01);
        assert!((0..9).all(|pixel| !picture.wants_more(pixel % 3, pixel / 3)));
    }

    #[test]
    fn an_uncertain_pixel_wants_more_and_its_neighbours_look_closer_once() {
        let mut edge = vec![0.2; 16];
        edge[5] = 0.9;
        let once = around(&edge, 0.5, 16, 0.01);
        assert!((0..9).all(|pixel| once.wants_more(pixel % 3, pixel / 3)));
        // Having seen both extremes themselves, and with two rounds behind them, they mind the neighbourhood.
        let mut twice = around(&edge, 0.5, 32, 0.01);
        for look in &mut twice.looks {
            look.extremes = [0.0, 1.0];
        }
        assert!(twice.wants_more(1, 1) && twice.wants_more(0, 0));
        // A corner has three neighbours: the root mean square over the four is half of the only error.
        let error = twice.looks[4].error;
        twice.target.error = 0.51 * error;
        assert!(twice.wants_more(1, 1) && !twice.wants_more(0, 0));
        twice.target.error = 0.49 * error;
        assert!(twice.wants_more(0, 0));
    }

    #[test]
    fn the_error_is_that_of_evenly_spread_samples_on_the_display() {
        // Eight samples of 0 and eight of 1: variance 16/15 · 1/4; over 16^1.5 = 64, its root is 0.064550.
        let mut half = vec![0.0; 16];
        half[..8].fill(1.0);
        let look = Look::of(&estimate(&half), 1.0);
        let expected = display_value(0.5 + (16.0 / 15.0 / 4.0 / 64.0f64).sqrt()) - display_value(0.5);
        assert!((look.error - expected).abs() < 1e-12, "{}", look.error);
        assert_eq!(look.extremes[0], 0.0);
    }

    #[test]
    fn rounds_double_a_pixels_samples_up_to_the_most() {
        let mut picture = around(&[0.5; 16], 0.5, 16, 0.01);
        picture.spp = 100;
        for (count, groups) in [(0, 0..1), (16, 1..2), (32, 2..4), (64, 4..7)] {
            picture.estimates[4].count = count;
            assert_eq!(picture.next_groups(4), groups, "{count}");
        }
    }

    #[test]
    fn what_a_neighbour_saw_and_a_pixel_did_not_is_looked_for() {
        // A step from black to white, each pixel certain of itself: 1 / (n + 1) of it may be hidden.
        let target = 1.0 / 50.0;
        for (count, more) in [(16, true), (48, true), (64, false)] {
            let picture = around(&vec![1.0; count], 0.0, count, target);
            assert_eq!(picture.wants_more(0, 0), more, "{count}");
            assert_eq!(picture.wants_more(1, 1), more, "{count}");
        }
    }

    #[test]
    fn no_pixel_wants_more_than_the_most() {
        let mut edge = vec![0.0; 256];
        edge[..128].fill(1.0);
        assert!(!around(&edge, 0.5, 256, 1e-6).wants_more(1, 1));
    }

    #[test]
    fn a_pixel_that_is_no_number_wants_nothing() {
        for value in [f64::NAN, f64::INFINITY] {
            let picture = around(&[value; 16], 0.5, 16, 0.01);
            assert!(!picture.wants_more(1, 1), "{value}");
        }
    }
}
