//! State of adaptive sampling: selection of pixels for the next round, and their numbers of samples.

use std::ops::Range;

use super::super::film::PixelStatistics;
use super::super::subset::{Patch, PatchAtlas};
use super::super::tile::PixelVisit;
use super::display_error::{DisplayError, NoiseModel};
use super::forecast::PassForecast;
use super::rounds::{LEVELS, Missed, PixelStatus, Rounds};
use super::target::{Adaptive, ROUND};
use crate::parallel;

/// Sampling state of all pixels.
pub(super) struct SamplingState {
    pub(super) target: Adaptive,
    pub(super) width: usize,
    pub(super) height: usize,
    /// Number of pixels that belong to a site; all others have no samples.
    pub(super) pixel_count: usize,
    /// Largest number of samples per pixel.
    pub(super) spp: u32,
    pub(super) known: Rounds,
    /// Display-referred statistics of every pixel at the end of the last round.
    display_errors: Vec<DisplayError>,
}

/// Returns how often a pixel's number of samples has doubled.
fn level(count: u32) -> usize {
    count.div_ceil(ROUND).next_power_of_two().ilog2() as usize
}

impl SamplingState {
    /// Returns the bytes of the state of all pixels.
    pub(super) fn byte_count(&self) -> usize {
        let known = size_of_val(&self.known.estimates[..]) + size_of_val(&self.known.statuses[..]);
        known + size_of_val(&self.display_errors[..])
    }

    pub(super) fn new(target: Adaptive, canvas: &PatchAtlas, spp: u32) -> SamplingState {
        let [width, height] = canvas.size;
        let pixel_count = |site: &Patch| site.tile.width as usize * site.tile.height as usize;
        SamplingState {
            target,
            width,
            height,
            pixel_count: canvas.sites.iter().map(pixel_count).sum(),
            spp,
            known: Rounds::new(canvas.size),
            display_errors: Vec::new(),
        }
    }

    /// Selects the pixels of the next round. Returns whether there are any.
    pub(super) fn decide(&mut self) -> bool {
        // Apply the criteria to every pixel
        let mut statuses = std::mem::take(&mut self.known.statuses);
        parallel::for_each_chunk_mut(&mut statuses, self.width, &|row, statuses| {
            for (column, turn) in statuses.iter_mut().enumerate() {
                *turn = match self.wants_more(column, row) {
                    true => PixelStatus::Waits,
                    false => PixelStatus::None,
                };
            }
        });
        self.known.statuses = statuses;
        // Compare the round with uniform sampling
        let counts = self.display_errors.iter().map(|look| look.count);
        let min_count = counts.filter(|&count| count > 0).min().unwrap_or(self.spp);
        let missed = self.known.missed[level(min_count)].square();
        let min_count_joins = if self.has_next() {
            !self.forecast(missed, min_count).is_worth_it()
        } else {
            missed > self.target.error * self.target.error * self.pixel_count as f64
        };
        // Add the pixels with the fewest samples
        if min_count_joins && min_count < self.spp {
            for (turn, look) in self.known.statuses.iter_mut().zip(&self.display_errors) {
                if look.count == min_count && look.error.is_finite() {
                    *turn = PixelStatus::Waits;
                }
            }
        }
        self.has_next()
    }

    /// Returns whether any pixel waits for a visit.
    fn has_next(&self) -> bool {
        self.known.statuses.contains(&PixelStatus::Waits)
    }

    /// Returns the forecast for the pixels of the next round, with the squared error `missed` by pixels of `min_count`
    /// samples.
    fn forecast(&self, missed: f64, min_count: u32) -> PassForecast {
        let of_row = |row: usize| {
            let mut forecast = PassForecast::default();
            for index in row * self.width..(row + 1) * self.width {
                let look = &self.display_errors[index];
                let next = if self.known.statuses[index] == PixelStatus::Waits {
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
        let rows: Vec<PassForecast> = parallel::map(self.height, &of_row);
        // Sum in a fixed order, so that the result does not depend on threads.
        let mut forecast = PassForecast::default();
        rows.iter().for_each(|row| forecast.merge(row));
        forecast.add_missed(missed, min_count);
        forecast
    }

    /// Returns the squared error of hidden features that single samples of this pixel indicate.
    fn missed_like(&self, column: usize, row: usize) -> f64 {
        let look = &self.display_errors[row * self.width + column];
        let middle = 0.5 * (look.extremes[0] + look.extremes[1]);
        // Count the pixel itself and neighbours that saw the feature too.
        let mut seen_by = [0; 2];
        for y in row.saturating_sub(1)..(row + 2).min(self.height) {
            let start = y * self.width;
            for other in
                &self.display_errors[start + column.saturating_sub(1)..start + (column + 2).min(self.width)]
            {
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

    /// Returns the pixels of the round that have not been visited yet, by tile; tiles without any are omitted.
    pub(super) fn visits(&self, sites: &[Patch]) -> Vec<(Patch, Vec<PixelVisit>)> {
        let visits = parallel::map(sites.len(), &|index| self.visits_in(sites[index]));
        let of_sites = sites.iter().copied().zip(visits);
        of_sites.filter(|(_, visits)| !visits.is_empty()).collect()
    }

    fn visits_in(&self, Patch { tile, at }: Patch) -> Vec<PixelVisit> {
        let mut visits = Vec::new();
        for y in 0..tile.height {
            for x in 0..tile.width {
                let (column, row) = (at[0] + x as usize, at[1] + y as usize);
                if self.known.statuses[row * self.width + column] == PixelStatus::Waits {
                    visits.push(PixelVisit {
                        x,
                        y,
                        groups: self.next_groups(row * self.width + column),
                    });
                }
            }
        }
        visits
    }

    /// Returns as many sample groups as the pixel has had already, up to the largest number of samples.
    fn next_groups(&self, index: usize) -> Range<u32> {
        let first = self.known.estimates[index].count / ROUND;
        first..(2 * first).max(1).min(self.spp.div_ceil(ROUND))
    }

    /// Returns the number of samples of all pixels together.
    pub(super) fn taken(&self) -> u64 {
        let counts = self.known.estimates.iter();
        counts.map(|estimate| u64::from(estimate.count)).sum()
    }

    /// Returns the number of samples that pixels of the current round will probably need after it, by their errors
    /// before it; `None` if no round has ended since the start or since resuming.
    pub(super) fn likely_later(&self) -> Option<u64> {
        if self.display_errors.is_empty() {
            return None;
        }
        let later = |(turn, look): (&PixelStatus, &DisplayError)| match turn {
            PixelStatus::None => 0,
            PixelStatus::Waits | PixelStatus::Had => {
                let next = (2 * look.count).min(self.spp);
                u64::from(look.likely_count(self.target.error, self.spp).max(next) - next)
            }
        };
        Some(
            self.known
                .statuses
                .iter()
                .zip(&self.display_errors)
                .map(later)
                .sum(),
        )
    }

    /// Evaluates criteria 1 to 4 of the [module](super) documentation.
    fn wants_more(&self, column: usize, row: usize) -> bool {
        let target = self.target.error;
        let look = &self.display_errors[row * self.width + column];
        // Further samples do not make a non-finite value finite.
        if look.count >= self.spp || !look.error.is_finite() {
            return false;
        }
        // Criterion 1
        if look.error > target {
            return true;
        }
        // Criteria 3 and 4, and the sums of criterion 2
        let unseen_limit = target * f64::from(look.count + 1);
        let (mut squares, mut sound_count) = (0.0, 0.0);
        for y in row.saturating_sub(1)..(row + 2).min(self.height) {
            let start = y * self.width;
            let near = start + column.saturating_sub(1)..start + (column + 2).min(self.width);
            for other in self.display_errors[near]
                .iter()
                .filter(|other| other.error.is_finite())
            {
                if look.unseen_step(other) > unseen_limit || (look.count <= ROUND && other.error > target) {
                    return true;
                }
                squares += other.error * other.error;
                sound_count += 1.0;
            }
        }
        // Criterion 2
        squares > target * target * sound_count
    }

    /// Adds the new samples of visited pixels.
    pub(super) fn merge(&mut self, site: Patch, visits: &[PixelVisit], estimates: &[PixelStatistics]) {
        for (visit, estimate) in visits.iter().zip(estimates) {
            let (column, row) = (site.at[0] + visit.x as usize, site.at[1] + visit.y as usize);
            let index = row * self.width + column;
            self.known.estimates[index].merge(estimate);
            self.known.statuses[index] = PixelStatus::Had;
        }
    }

    /// Returns the fraction of variance that is noise, for each pixel of a row, averaged over its neighbourhood,
    /// because the estimate of a single pixel is too uncertain.
    fn noises(&self, row: usize) -> Vec<f64> {
        let rows = row.saturating_sub(1)..(row + 2).min(self.height);
        let of_column = |column: usize| {
            let mut noise_model = NoiseModel::default();
            rows.clone()
                .for_each(|row| noise_model.add(&self.known.estimates[row * self.width + column]));
            noise_model
        };
        // Sum over columns first, then over neighbouring columns
        let columns: Vec<NoiseModel> = (0..self.width).map(of_column).collect();
        let around = |column: usize| {
            let near = &columns[column.saturating_sub(1)..(column + 2).min(self.width)];
            near.iter()
                .fold(NoiseModel::default(), NoiseModel::merged)
                .noise()
        };
        (0..self.width).map(around).collect()
    }

    /// Updates the statistics of all pixels after the last visit of a round.
    pub(super) fn end_round(&mut self) {
        if std::mem::take(&mut self.known.is_first) {
            // This includes the pixels that a pilot visited.
            self.known.statuses.fill(PixelStatus::Had);
        }
        // Compute the display errors of all pixels
        let mut display_errors = std::mem::take(&mut self.display_errors);
        display_errors.resize(self.known.estimates.len(), DisplayError::default());
        parallel::for_each_chunk_mut(&mut display_errors, self.width, &|row, display_errors| {
            let estimates = &self.known.estimates[row * self.width..];
            let seen = estimates.iter().zip(self.noises(row));
            for (look, (estimate, noise)) in display_errors.iter_mut().zip(seen) {
                *look = DisplayError::of(estimate, noise, self.target.gain);
            }
        });
        self.display_errors = display_errors;
        // Sum up the errors of missed features by number of samples
        let missed_in = |row: usize| {
            let mut missed = [Missed::default(); LEVELS];
            for column in 0..self.width {
                let index = row * self.width + column;
                if self.known.statuses[index] == PixelStatus::Had {
                    missed[level(self.display_errors[index].count)].add(self.missed_like(column, row));
                }
            }
            missed
        };
        let rows: Vec<[Missed; LEVELS]> = parallel::map(self.height, &missed_in);
        for row in rows {
            (0..LEVELS).for_each(|level| self.known.missed[level].merge(row[level]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::film::estimate;
    use super::super::display_error::display_value;
    use super::*;

    /// Returns the state of three by three pixels with `count` gray samples each, except for the centre.
    fn around(middle: &[f64], gray: f64, count: usize, target: f64) -> SamplingState {
        let mut known = Rounds::new([3, 3]);
        known.estimates.fill(estimate(&vec![gray; count]));
        known.estimates[4] = estimate(middle);
        let mut state = SamplingState {
            target: Adaptive {
                error: target,
                gain: 1.0,
            },
            width: 3,
            height: 3,
            pixel_count: 9,
            spp: 256,
            known,
            display_errors: Vec::new(),
        };
        state.end_round();
        state
    }

    #[test]
    fn uniform_image_needs_no_more_samples() {
        let state = around(&[0.5; 16], 0.5, 16, 0.01);
        assert!((0..9).all(|pixel| !state.wants_more(pixel % 3, pixel / 3)));
    }

    #[test]
    fn uncertain_pixel_and_its_neighbours_get_more_samples() {
        let mut edge = vec![0.2; 16];
        edge[5] = 0.9;
        let once = around(&edge, 0.5, 16, 0.01);
        assert!((0..9).all(|pixel| once.wants_more(pixel % 3, pixel / 3)));
        // With both extremes seen and two rounds taken, only the criterion of the neighbourhood remains.
        let mut twice = around(&edge, 0.5, 32, 0.01);
        for look in &mut twice.display_errors {
            look.extremes = [0.0, 1.0];
        }
        assert!(twice.wants_more(1, 1) && twice.wants_more(0, 0));
        // A corner has three neighbours: the root mean square over the four is half of the only error.
        let error = twice.display_errors[4].error;
        twice.target.error = 0.51 * error;
        assert!(twice.wants_more(1, 1) && !twice.wants_more(0, 0));
        twice.target.error = 0.49 * error;
        assert!(twice.wants_more(0, 0));
    }

    #[test]
    fn variance_kind_uses_neighbouring_pixels() {
        // The samples of the centre are all noise by themselves; its neighbours have the same variance without noise.
        let noise = [[0.0; 4], [1.0; 4], [0.0; 4], [1.0; 4]].concat();
        let alone = around(&noise, 0.5, 16, 0.01);
        assert_eq!(alone.noises(1), [1.0; 3]);
        let mut beside = around(&noise, 0.5, 16, 0.01);
        let even = estimate(&[0.0, 1.0].repeat(8));
        for pixel in (0..9).filter(|pixel| *pixel != 4) {
            beside.known.estimates[pixel] = even;
        }
        let mut noise_model = NoiseModel::default();
        beside.known.estimates.iter().for_each(|one| noise_model.add(one));
        assert!(noise_model.noise() < 1.0);
        assert!((beside.noises(1)[1] - noise_model.noise()).abs() < 1e-12);
    }

    #[test]
    fn rounds_double_samples_up_to_the_maximum() {
        let mut state = around(&[0.5; 16], 0.5, 16, 0.01);
        state.spp = 100;
        for (count, groups) in [(0, 0..1), (16, 1..2), (32, 2..4), (64, 4..7)] {
            state.known.estimates[4].count = count;
            assert_eq!(state.next_groups(4), groups, "{count}");
        }
    }

    #[test]
    fn pixel_searches_for_feature_seen_by_neighbour() {
        // A step from black to white between pixels that are certain: 1 / (n + 1) of it may be hidden.
        let target = 1.0 / 50.0;
        for (count, more) in [(16, true), (48, true), (64, false)] {
            let state = around(&vec![1.0; count], 0.0, count, target);
            assert_eq!(state.wants_more(0, 0), more, "{count}");
            assert_eq!(state.wants_more(1, 1), more, "{count}");
        }
    }

    #[test]
    fn equal_pixels_get_the_round_together() {
        let mut half = vec![0.0; 16];
        half[..8].fill(1.0);
        let mut state = around(&half, 0.5, 16, 1.0);
        state.display_errors = vec![
            DisplayError {
                count: 32,
                ..state.display_errors[4]
            };
            9
        ];
        state.target.error = 0.999 * state.display_errors[4].error;
        for look in &mut state.display_errors[..4] {
            look.error *= 0.99;
        }
        assert!(state.decide());
        assert_eq!(state.known.statuses, [PixelStatus::Waits; 9]);
        // No pixel needs more samples, so none gets any.
        state.target.error *= 1.1;
        assert!(!state.decide());
        assert_eq!(state.known.statuses, [PixelStatus::None; 9]);
    }

    #[test]
    fn single_outliers_indicate_missed_features() {
        let mut speck = vec![0.0; 16];
        speck[3] = 1.0;
        let state = around(&speck, 0.0, 16, 0.01);
        // One of seventeen samples would be white.
        let square = display_value(1.0 / 17.0).powi(2);
        assert!((state.known.missed[0].sum / square - 1.0).abs() < 1e-12);
        assert_eq!(state.known.missed[0].square(), 0.0);
        // Four such pixels: the sum of four minus the root of four is half of it.
        let mut four = Missed::default();
        (0..4).for_each(|_| four.add(square));
        assert!((four.square() / (2.0 * square) - 1.0).abs() < 1e-12);
        // Two samples of a pixel, or neighbours that see the feature, indicate a larger one.
        speck[4] = 1.0;
        assert_eq!(around(&speck, 0.0, 16, 0.01).known.missed[0].sum, 0.0);
        let mut beside = around(&speck[..4], 0.0, 4, 0.01);
        beside.known.estimates[5] = beside.known.estimates[4];
        beside.known.missed = [Missed::default(); LEVELS];
        beside.known.statuses.fill(PixelStatus::Had);
        beside.end_round();
        assert_eq!(beside.known.missed[0].sum, 0.0);
    }

    #[test]
    fn no_pixel_exceeds_the_maximum_sample_count() {
        let mut edge = vec![0.0; 256];
        edge[..128].fill(1.0);
        assert!(!around(&edge, 0.5, 256, 1e-6).wants_more(1, 1));
    }

    #[test]
    fn nan_pixel_gets_no_more_samples() {
        for value in [f64::NAN, f64::INFINITY] {
            let state = around(&[value; 16], 0.5, 16, 0.01);
            assert!(!state.wants_more(1, 1), "{value}");
        }
    }
}
