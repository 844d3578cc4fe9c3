//! Complete state of adaptive sampling between two tiles of a round, from which a render can be resumed.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::super::film::PixelStatistics;
use super::target::ROUND;

/// Largest number of times that a pixel's samples can double.
pub(super) const LEVELS: usize = u32::BITS as usize;

/// State of an adaptively sampled image that is not finished.
#[derive(Clone, Debug, PartialEq)]
pub struct Rounds {
    width: usize,
    /// Sample statistics of the pixels, row by row.
    pub(super) estimates: Vec<PixelStatistics>,
    /// Status of each pixel in the current round.
    pub(super) statuses: Vec<PixelStatus>,
    /// True during the first round.
    pub(super) is_first: bool,
    /// Number of evenly distributed samples per pixel for which ray cones are as wide as a sample.
    pub(super) even_count: u32,
    /// Errors of missed features, summed over all pixels when they had 16 samples, 32 and so on.
    pub(super) missed: [Missed; LEVELS],
}

/// Status of a pixel in the current round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PixelStatus {
    /// Pixel that needs no more samples.
    None,
    /// Pixel that has not been visited yet.
    Waits,
    /// Pixel that has been visited.
    Had,
}

/// Estimated error of features that no sample has hit, derived from those that a single sample has hit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Missed {
    /// Sum of squared errors.
    pub(super) sum: f64,
    /// Sum of the squares of squared errors.
    squares: f64,
}

/// State that does not belong to single pixels; f64 numbers are stored as bits.
#[derive(Serialize, Deserialize)]
struct RemainingTime {
    is_first: bool,
    even_count: u32,
    missed: Vec<[u64; 2]>,
}

impl Rounds {
    /// Names of the 32-bit values that each pixel is stored as.
    pub const WORDS: [&'static str; 17] = [
        "red.high",
        "red.low",
        "green.high",
        "green.low",
        "blue.high",
        "blue.low",
        "squares.high",
        "squares.low",
        "runs.high",
        "runs.low",
        "halves.high",
        "halves.low",
        "halves.count",
        "darkest",
        "brightest",
        "count",
        "turn",
    ];

    /// Returns the initial state of an image of that width and height, with all pixels waiting.
    pub fn new([width, height]: [usize; 2]) -> Rounds {
        Rounds {
            width,
            estimates: vec![PixelStatistics::NONE; width * height],
            statuses: vec![PixelStatus::Waits; width * height],
            is_first: true,
            even_count: ROUND,
            missed: [Missed::default(); LEVELS],
        }
    }

    /// Returns the stored form of some rows: [`Rounds::WORDS`] planes with one value per pixel.
    pub fn words(&self, rows: &Range<usize>) -> Vec<Vec<u32>> {
        let pixels = self.pixels(rows);
        let of_pixel = |(estimate, &turn): (&PixelStatistics, &PixelStatus)| {
            let mut words = [0; Self::WORDS.len()];
            words[..Self::WORDS.len() - 1].copy_from_slice(&estimate.to_words());
            words[Self::WORDS.len() - 1] = turn as u32;
            words
        };
        let statuses = &self.statuses[pixels.clone()];
        let words: Vec<_> = self.estimates[pixels]
            .iter()
            .zip(statuses)
            .map(of_pixel)
            .collect();
        let plane = |word: usize| words.iter().map(|words| words[word]).collect();
        (0..Self::WORDS.len()).map(plane).collect()
    }

    /// Restores rows from their stored form; `None` if that is invalid.
    #[must_use]
    pub fn set_words(&mut self, rows: &Range<usize>, planes: &[&[u32]]) -> Option<()> {
        let pixels = self.pixels(rows);
        // Check the number and the sizes of the planes
        let is_sound =
            planes.len() == Self::WORDS.len() && planes.iter().all(|plane| plane.len() == pixels.len());
        if !is_sound {
            return None;
        }
        for (number, pixel) in pixels.enumerate() {
            let word = |word: usize| planes[word][number];
            self.estimates[pixel] = PixelStatistics::of_words(std::array::from_fn(word));
            self.statuses[pixel] = match word(Self::WORDS.len() - 1) {
                0 => PixelStatus::None,
                1 => PixelStatus::Waits,
                2 => PixelStatus::Had,
                _ => return None,
            };
        }
        Some(())
    }

    /// Returns the state besides the words of pixels, as JSON.
    pub fn rest(&self) -> String {
        let rest = RemainingTime {
            is_first: self.is_first,
            even_count: self.even_count,
            missed: self
                .missed
                .iter()
                .map(|missed| [missed.sum, missed.squares].map(f64::to_bits))
                .collect(),
        };
        serde_json::to_string(&rest).unwrap_or_default()
    }

    /// Restores the state besides the words of pixels; `None` if the text is invalid.
    #[must_use]
    pub fn set_rest(&mut self, text: &str) -> Option<()> {
        let rest: RemainingTime = serde_json::from_str(text).ok()?;
        let missed = rest.missed.into_iter().map(|bits| {
            let [sum, squares] = bits.map(f64::from_bits);
            Missed { sum, squares }
        });
        self.missed = missed.collect::<Vec<Missed>>().try_into().ok()?;
        self.is_first = rest.is_first;
        self.even_count = rest.even_count;
        Some(())
    }

    /// Returns whether the state is consistent with an image of this size and at most `spp` samples per pixel.
    pub(super) fn is_of(&self, size: [usize; 2], spp: u32) -> bool {
        let limit = spp.next_multiple_of(ROUND);
        let has_sound_counts = || self.estimates.iter().all(|estimate| estimate.count <= limit);
        let has_sound_widths = (ROUND..=limit).contains(&self.even_count);
        [self.width, self.estimates.len()] == [size[0], size[0] * size[1]]
            && has_sound_widths
            && has_sound_counts()
    }

    fn pixels(&self, rows: &Range<usize>) -> Range<usize> {
        rows.start * self.width..rows.end * self.width
    }
}

impl Missed {
    pub(super) fn add(&mut self, square: f64) {
        self.sum += square;
        self.squares += square * square;
    }

    pub(super) fn merge(&mut self, other: Missed) {
        self.sum += other.sum;
        self.squares += other.squares;
    }

    /// Returns the squared error of all pixels together, minus its own standard error: a single observation, like a
    /// light source reflected in a distant mirror, gives no information about the rest of the image.
    pub(super) fn square(&self) -> f64 {
        (self.sum - self.squares.sqrt()).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::film::estimate;
    use super::*;

    #[test]
    fn stored_rounds_are_restored_bit_exactly() {
        // Fill a state with distinct values
        let mut known = Rounds::new([3, 4]);
        for (pixel, known) in known.estimates.iter_mut().enumerate().skip(1) {
            let samples: Vec<f64> = (0..32)
                .map(|sample| 1.0 / f64::from(sample + pixel as u32))
                .collect();
            *known = estimate(&samples[..16 * (1 + pixel % 2)]);
        }
        known.statuses[2] = PixelStatus::None;
        known.statuses[7] = PixelStatus::Had;
        known.is_first = false;
        known.even_count = 48;
        known.missed[5].add(0.1);
        // Restore it from its stored form, in two parts
        let mut read = Rounds::new([3, 4]);
        assert_ne!(read, known);
        for rows in [0..1, 1..4] {
            let words = known.words(&rows);
            let planes: Vec<&[u32]> = words.iter().map(|plane| &plane[..]).collect();
            read.set_words(&rows, &planes).unwrap();
            assert_eq!(read.set_words(&(0..4), &planes), None);
            assert_eq!(read.set_words(&rows, &planes[1..]), None);
        }
        read.set_rest(&known.rest()).unwrap();
        assert_eq!(read, known);
        assert_eq!(read.set_rest("{}"), None);
        assert!(known.is_of([3, 4], 48));
        assert!(!known.is_of([4, 3], 48) && !known.is_of([3, 3], 48) && !known.is_of([3, 4], 16));
    }

    #[test]
    fn invalid_status_word_is_rejected() {
        let mut known = Rounds::new([1, 1]);
        let mut words = known.words(&(0..1));
        words[Rounds::WORDS.len() - 1][0] = 3;
        let planes: Vec<&[u32]> = words.iter().map(|plane| &plane[..]).collect();
        assert_eq!(known.set_words(&(0..1), &planes), None);
    }
}
