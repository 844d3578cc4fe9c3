//! Adaptive sampling: more samples where a pixel's mean is still uncertain, as seen on a screen.
//!
//! The picture is rendered in rounds. The first gives every pixel sixteen samples; each later one doubles those of the
//! pixels that want more, as evenly spread points are evenest at powers of two. All of a round is known before the next is
//! decided, so decisions depend on the picture alone, not on threads or tiles. A pixel wants more samples while one of these
//! holds:
//!
//! 1. *Its mean is uncertain*: one standard error of its mean luminance, brighter, is a display value off by more than
//!    the target. That of n evenly spread samples is σ / n^¾ where edges are: an edge crosses about √n of n cells, and all
//!    others are certain. It is σ / √n where the samples are noise. How much is which, [`Kinds`] tell.
//! 2. *Its neighbourhood is uncertain*: so is the root mean square of those errors over the pixel and the eight around it.
//!    Estimates from few samples are uncertain themselves; neighbours vouch for each other.
//! 3. *Its neighbours know something that it has not seen*: where one of them saw a sample that is brighter or darker by a
//!    display value of c than any of its own n, c / (n + 1) is more than the target. By Laplace's rule of succession,
//!    1 / (n + 1) or so is what something unseen in n samples may cover.
//! 4. *It inherits*: it has had one round only and the mean of a neighbour is uncertain.
//!
//! Then [`Forecast`] tells whether the round does more than its samples would if all pixels shared them. Where most of a
//! picture is about equally uncertain that is not so, and the pixels with the fewest samples join the round: such pictures
//! are sampled evenly. The forecast also knows of things too small to be met. By Good and Turing's estimate (I. J. Good, "The
//! population frequencies of species", Biometrika 40, 1953) what no sample has met covers about as much as what a single
//! sample has met: for every pixel with one sample that differs from all its others and from its neighbours', as much lies
//! hidden elsewhere. While its root mean square over the picture is more than the target, rounds go on.
//!
//! A thing smaller than a sixteenth of a pixel that has neither a larger neighbour nor its like elsewhere may be missed: no
//! later round looks where the first saw nothing. `tests/sampling.rs` measures what all of this saves.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::estimate::Estimate;
use super::forecast::Forecast;
use super::ledger::{Account, Ledger};
use super::look::{Kinds, Look};
use super::meter::Meter;
use super::mosaic::{Canvas, Site};
use super::wave::{Visit, Waves};
use super::{Frame, Monitor, RUN, pilot};
use crate::numeric::LANES;
use crate::scene::Effect;

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
pub(super) const LOOK_BYTES: usize = size_of::<Look>() + size_of::<bool>();

/// What the samples of every pixel of the canvas tell, row by row, and what they took. `None` if the render was cancelled.
pub(super) fn render(
    frame: &mut Frame,
    target: Adaptive,
    canvas: &Canvas,
    monitor: &Monitor,
) -> Option<(Vec<Estimate>, Ledger)> {
    let sites = &canvas.sites;
    let mut picture = Picture::new(target, canvas, frame.settings.spp);
    let mut ledger = Ledger::default();
    let mut meter = Meter::new(&frame.settings);
    if frame.effects().has(Effect::TextureFilter) {
        ledger += pilot(frame, &mut picture, sites, monitor)?;
        meter.skip();
    }
    let waves = Waves::new(frame);
    let mut first_count = None;
    loop {
        picture.decide();
        let round = picture.visits(sites);
        meter.lap_all_threads(Account::Sampling);
        let wanted_count: usize = round.iter().map(|(_, visits)| visits.len()).sum();
        if wanted_count == 0 {
            ledger += meter.ledger;
            return Some((picture.estimates, ledger));
        }
        if let Some(memory) = &frame.thread_memory {
            memory.note_round(picture.byte_count() + wanted_count * VISIT_BYTES);
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
        let visited = render_round(&waves, round, monitor, &progress)?;
        meter.skip();
        for (site, visits, estimates, tile_ledger) in visited {
            ledger += tile_ledger;
            picture.merge(site, &visits, &estimates);
            monitor.show_estimates(site, &picture.estimates, picture.width);
        }
        meter.lap(Account::Sampling);
        if picture.looks.is_empty() {
            // With those that were asked before.
            picture.wanted.fill(true);
        }
        picture.look();
    }
}

/// Makes rays as wide as [`pilot`] finds; what that took. The pixels that were asked last have had their first round, unless
/// its rays were of another width. `None` if the render was cancelled.
fn pilot(frame: &mut Frame, picture: &mut Picture, sites: &[Site], monitor: &Monitor) -> Option<Ledger> {
    let size = [picture.width, picture.height];
    let asked = |index: usize| pilot::is_asked([index % size[0], index / size[0]], size);
    picture.wanted = (0..picture.wanted.len()).map(asked).collect();
    let mut ledger = Ledger::default();
    for _ in 0..pilot::MOST_ROUNDS {
        let visited = render_round(&Waves::new(frame), picture.visits(sites), monitor, &|_| ())?;
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
    let estimates = &picture.estimates;
    picture.wanted = estimates.iter().map(|estimate| estimate.count == 0).collect();
    Some(ledger)
}

/// A tile, the pixels of it that were visited, what their new samples tell, and what they took.
type Visited = (Site, Vec<Visit>, Vec<Estimate>, Ledger);

fn render_round(
    waves: &Waves,
    round: Vec<(Site, Vec<Visit>)>,
    monitor: &Monitor,
    progress: &(dyn Fn(f64) + Sync),
) -> Option<Vec<Visited>> {
    let finished = AtomicUsize::new(0);
    let tile_count = round.len() as f64;
    // Into a place of its own each, which no list of options that ends at the first `None` would do.
    let visited = round
        .into_par_iter()
        .with_max_len(RUN)
        .map_init(
            || waves.lend(),
            |wave, (site, visits)| {
                if monitor.cancel.load(Ordering::Relaxed) {
                    return None;
                }
                let (estimates, ledger) = wave.render_visits(site.tile, &visits);
                progress((finished.fetch_add(1, Ordering::Relaxed) + 1) as f64 / tile_count);
                Some((site, visits, estimates, ledger))
            },
        )
        .collect::<Vec<Option<_>>>();
    visited.into_iter().collect()
}

/// The state of all pixels between two rounds.
struct Picture {
    target: Adaptive,
    width: usize,
    height: usize,
    /// Those that are on a site; the others have no samples.
    pixel_count: usize,
    /// Most samples a pixel.
    spp: u32,
    estimates: Vec<Estimate>,
    /// One for each estimate, after the first round.
    looks: Vec<Look>,
    /// Which pixels are in the round.
    wanted: Vec<bool>,
    /// What was missed by all pixels when they had 16 samples, 32 and so on, by [`level`].
    missed: [Missed; LEVELS],
}

/// What no sample has met, by what single samples did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Missed {
    /// Of squared errors.
    sum: f64,
    /// Of their squares.
    squares: f64,
}

impl Missed {
    fn add(&mut self, square: f64) {
        self.sum += square;
        self.squares += square * square;
    }

    fn merge(&mut self, other: Missed) {
        self.sum += other.sum;
        self.squares += other.squares;
    }

    /// The squared error of all pixels together, less its own standard error: one find alone, like a lamp's image in a far
    /// mirror, says nothing about the rest of the picture.
    fn square(&self) -> f64 {
        (self.sum - self.squares.sqrt()).max(0.0)
    }
}

/// How often a pixel's samples can double.
const LEVELS: usize = u32::BITS as usize;

/// How often a pixel's samples have doubled.
fn level(count: u32) -> usize {
    count.div_ceil(ROUND).next_power_of_two().ilog2() as usize
}

impl Picture {
    /// Bytes of what is known of all pixels.
    fn byte_count(&self) -> usize {
        size_of_val(&self.estimates[..]) + size_of_val(&self.looks[..]) + size_of_val(&self.wanted[..])
    }

    fn new(target: Adaptive, canvas: &Canvas, spp: u32) -> Picture {
        let [width, height] = canvas.size;
        let pixel_count = |site: &Site| site.tile.width as usize * site.tile.height as usize;
        Picture {
            target,
            width,
            height,
            pixel_count: canvas.sites.iter().map(pixel_count).sum(),
            spp,
            estimates: vec![Estimate::NONE; width * height],
            looks: Vec::new(),
            wanted: vec![true; width * height],
            missed: [Missed::default(); LEVELS],
        }
    }

    /// Finds out which pixels are in the next round, after the first.
    fn decide(&mut self) {
        if self.looks.is_empty() {
            return;
        }
        let this = &*self;
        let wants = |row: usize| (0..this.width).map(move |column| this.wants_more(column, row));
        self.wanted = (0..this.height).into_par_iter().flat_map_iter(wants).collect();
        let counts = self.looks.iter().map(|look| look.count);
        let least = counts.filter(|&count| count > 0).min().unwrap_or(self.spp);
        let missed = self.missed[level(least)].square();
        let least_join = if self.wanted.contains(&true) {
            !self.forecast(missed, least).is_worth_it()
        } else {
            missed > self.target.error * self.target.error * self.pixel_count as f64
        };
        if least_join && least < self.spp {
            for (wanted, look) in self.wanted.iter_mut().zip(&self.looks) {
                *wanted |= look.count == least && look.error.is_finite();
            }
        }
    }

    /// Of the pixels in the next round, with what pixels of `least` samples have missed.
    fn forecast(&self, missed: f64, least: u32) -> Forecast {
        let of_row = |row: usize| {
            let mut forecast = Forecast::default();
            for index in row * self.width..(row + 1) * self.width {
                let look = &self.looks[index];
                let next = if self.wanted[index] {
                    (2 * look.count).min(self.spp)
                } else {
                    look.count
                };
                if look.error.is_finite() {
                    forecast.add(look.error * look.error, look.noise, look.count, next);
                }
            }
            forecast
        };
        let rows: Vec<Forecast> = (0..self.height).into_par_iter().map(of_row).collect();
        // Summed up in one order, whoever made the parts.
        let mut forecast = Forecast::default();
        rows.iter().for_each(|row| forecast.merge(row));
        forecast.add_missed(missed, least);
        forecast
    }

    /// What lies hidden elsewhere for what single samples of this pixel met, as a squared error.
    fn missed_like(&self, column: usize, row: usize) -> f64 {
        let look = &self.looks[row * self.width + column];
        let middle = 0.5 * (look.extremes[0] + look.extremes[1]);
        // Itself and those around it that see it too.
        let mut seen_by = [0; 2];
        for y in row.saturating_sub(1)..(row + 2).min(self.height) {
            let start = y * self.width;
            for other in &self.looks[start + column.saturating_sub(1)..start + (column + 2).min(self.width)] {
                seen_by[0] += u32::from(other.extremes[0] < middle);
                seen_by[1] += u32::from(other.extremes[1] > middle);
            }
        }
        let hidden = |end: usize| {
            if seen_by[end] == 1 {
                look.single_steps[end]
            } else {
                0.0
            }
        };
        hidden(0) * hidden(0) + hidden(1) * hidden(1)
    }

    /// The pixels of the round, by tile; tiles without any are left out.
    fn visits(&self, sites: &[Site]) -> Vec<(Site, Vec<Visit>)> {
        sites
            .par_iter()
            .map(|&site| (site, self.visits_in(site)))
            .filter(|(_, visits)| !visits.is_empty())
            .collect()
    }

    fn visits_in(&self, Site { tile, at }: Site) -> Vec<Visit> {
        let mut visits = Vec::new();
        for y in 0..tile.height {
            for x in 0..tile.width {
                let (column, row) = (at[0] + x as usize, at[1] + y as usize);
                if self.wanted[row * self.width + column] {
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

    fn merge(&mut self, site: Site, visits: &[Visit], estimates: &[Estimate]) {
        for (visit, estimate) in visits.iter().zip(estimates) {
            let (column, row) = (site.at[0] + visit.x as usize, site.at[1] + visit.y as usize);
            self.estimates[row * self.width + column].merge(estimate);
        }
    }

    /// How much of the variance is noise, for each pixel of a row by those around it too: of one pixel alone it is too
    /// uncertain.
    fn noises(&self, row: usize) -> Vec<f64> {
        let rows = row.saturating_sub(1)..(row + 2).min(self.height);
        let of_column = |column: usize| {
            let mut kinds = Kinds::default();
            rows.clone()
                .for_each(|row| kinds.add(&self.estimates[row * self.width + column]));
            kinds
        };
        let columns: Vec<Kinds> = (0..self.width).map(of_column).collect();
        let around = |column: usize| {
            let near = &columns[column.saturating_sub(1)..(column + 2).min(self.width)];
            near.iter().fold(Kinds::default(), Kinds::merged).noise()
        };
        (0..self.width).map(around).collect()
    }

    /// Sees all pixels anew.
    fn look(&mut self) {
        let mut looks = std::mem::take(&mut self.looks);
        looks.resize(self.estimates.len(), Look::default());
        looks
            .par_chunks_mut(self.width)
            .zip(self.estimates.par_chunks(self.width))
            .enumerate()
            .for_each(|(row, (looks, estimates))| {
                let seen = estimates.iter().zip(self.noises(row));
                for (look, (estimate, noise)) in looks.iter_mut().zip(seen) {
                    *look = Look::of(estimate, noise, self.target.gain);
                }
            });
        self.looks = looks;
        let missed_in = |row: usize| {
            let mut missed = [Missed::default(); LEVELS];
            for column in 0..self.width {
                let index = row * self.width + column;
                if self.wanted[index] {
                    missed[level(self.looks[index].count)].add(self.missed_like(column, row));
                }
            }
            missed
        };
        let rows: Vec<[Missed; LEVELS]> = (0..self.height).into_par_iter().map(missed_in).collect();
        for row in rows {
            (0..LEVELS).for_each(|level| self.missed[level].merge(row[level]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::estimate::estimate;
    use super::super::look::display_value;
    use super::*;

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
            pixel_count: 9,
            spp: 256,
            estimates,
            looks: Vec::new(),
            wanted: vec![true; 9],
            missed: [Missed::default(); LEVELS],
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
    fn what_kind_a_pixels_variance_is_its_neighbours_tell_too() {
        // Of its own, this one's samples are all noise; those around have as much variance and none of it is.
        let noise = [[0.0; 4], [1.0; 4], [0.0; 4], [1.0; 4]].concat();
        let alone = around(&noise, 0.5, 16, 0.01);
        assert_eq!(alone.noises(1), [1.0; 3]);
        let mut beside = around(&noise, 0.5, 16, 0.01);
        let even = estimate(&[0.0, 1.0].repeat(8));
        for pixel in (0..9).filter(|pixel| *pixel != 4) {
            beside.estimates[pixel] = even;
        }
        let mut kinds = Kinds::default();
        beside.estimates.iter().for_each(|one| kinds.add(one));
        assert!(kinds.noise() < 1.0);
        assert!((beside.noises(1)[1] - kinds.noise()).abs() < 1e-12);
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
    fn pixels_that_are_all_alike_get_the_round_together() {
        let mut half = vec![0.0; 16];
        half[..8].fill(1.0);
        let mut picture = around(&half, 0.5, 16, 1.0);
        picture.looks = vec![
            Look {
                count: 32,
                ..picture.looks[4]
            };
            9
        ];
        picture.target.error = 0.999 * picture.looks[4].error;
        for look in &mut picture.looks[..4] {
            look.error *= 0.99;
        }
        picture.decide();
        assert_eq!(picture.wanted, [true; 9]);
        // None wants more: none gets more.
        picture.target.error *= 1.1;
        picture.decide();
        assert_eq!(picture.wanted, [false; 9]);
    }

    #[test]
    fn what_one_sample_met_of_one_pixel_lies_hidden_elsewhere_too() {
        let mut speck = vec![0.0; 16];
        speck[3] = 1.0;
        let picture = around(&speck, 0.0, 16, 0.01);
        // One of seventeen samples that sees white.
        let square = display_value(1.0 / 17.0).powi(2);
        assert!((picture.missed[0].sum / square - 1.0).abs() < 1e-12);
        assert_eq!(picture.missed[0].square(), 0.0);
        // Four of them: less a half, the root of four in four.
        let mut four = Missed::default();
        (0..4).for_each(|_| four.add(square));
        assert!((four.square() / (2.0 * square) - 1.0).abs() < 1e-12);
        // Two samples of a pixel, or neighbours that see it, tell of a larger thing.
        speck[4] = 1.0;
        assert_eq!(around(&speck, 0.0, 16, 0.01).missed[0].sum, 0.0);
        let mut beside = around(&speck[..4], 0.0, 4, 0.01);
        beside.estimates[5] = beside.estimates[4];
        beside.missed = [Missed::default(); LEVELS];
        beside.look();
        assert_eq!(beside.missed[0].sum, 0.0);
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
