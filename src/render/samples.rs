//! Single samples: what each saw by itself, for those who need more than a pixel's sum.
//!
//! The rays of a wave carry the number of their sample beside that of their pixel. When the wave is over, all that its
//! samples will ever see has arrived, and each is weighed: into the pixel's estimate of its own error, and by the
//! reconstruction filter. Samples are weighed in the order of their numbers.

use super::estimate::{Estimate, RUN};
use super::film::TILE;
use super::filter::{PixelFilter, Splat};
use super::light_layers::STEP_SHIFT;
use super::wave::WAVE;
use crate::numeric::{LANES, Lanes, Lanes3};

/// How many samples a picture took.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct SampleCounts {
    /// Of all pixels.
    pub total: u64,
    /// Over the number of pixels.
    pub mean: f64,
    /// Of the pixel that took most.
    pub max: u32,
}

impl SampleCounts {
    pub(super) fn uniform(pixel_count: u64, spp: u32) -> SampleCounts {
        SampleCounts {
            total: pixel_count * u64::from(spp),
            mean: f64::from(spp),
            max: spp,
        }
    }

    pub(super) fn of(estimates: &[Estimate]) -> SampleCounts {
        let counts = || estimates.iter().map(|estimate| estimate.count);
        let total = counts().map(u64::from).sum();
        SampleCounts {
            total,
            mean: total as f64 / estimates.len() as f64,
            max: counts().max().unwrap_or(0),
        }
    }
}

/// What each pixel's samples tell, row by row, the top row first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SampleAovs {
    /// How many there are; whole numbers.
    pub samples: Vec<f32>,
    /// Variance of the samples' linear radiance about their mean, channels weighted by Rec. 709 luminance; 0 for a
    /// single sample. That of the pixel is smaller by their number, if they were independent, and more so as they are
    /// evenly spread.
    pub variance: Vec<f32>,
}

impl SampleAovs {
    pub(super) fn of(estimates: &[Estimate]) -> SampleAovs {
        SampleAovs {
            samples: estimates.iter().map(|e| e.count as f32).collect(),
            variance: estimates.iter().map(|e| e.variance() as f32).collect(),
        }
    }
}

/// Bits of a ray's label that tell the pixel within the tile; those above tell the sample within the wave.
const PIXEL_BITS: u32 = (TILE * TILE).ilog2();
const _: () = assert!(TILE * TILE == 1 << PIXEL_BITS && ((WAVE * LANES) << PIXEL_BITS) <= 1 << STEP_SHIFT);

/// The pixel that a label tells.
#[inline(always)]
pub(super) fn pixel_of(label: u32) -> u32 {
    label & ((1 << PIXEL_BITS) - 1)
}

/// The samples of a wave, and what those of earlier waves of the tile have come to.
pub(super) struct SampleFilm {
    radiance: Vec<[f64; 3]>,
    places: Vec<Place>,
    estimates: Vec<Estimate>,
    splat: Option<Splat>,
}

/// Where a sample lies.
#[derive(Clone, Copy)]
struct Place {
    /// Within the tile.
    pixel: u32,
    /// Within the pixel.
    position: [f64; 2],
    /// Whether the lane has a sample at all.
    exists: bool,
}

impl SampleFilm {
    pub(super) fn new(filter: PixelFilter) -> SampleFilm {
        SampleFilm {
            radiance: vec![[0.0; 3]; WAVE * LANES],
            places: Vec::with_capacity(WAVE * LANES),
            estimates: vec![Estimate::NONE; (TILE * TILE) as usize],
            splat: (!filter.is_box()).then(|| Splat::new(filter)),
        }
    }

    /// Bytes of all arrays.
    pub(super) fn byte_count(&self) -> usize {
        size_of_val(&self.radiance[..])
            + self.places.capacity() * size_of::<Place>()
            + size_of_val(&self.estimates[..])
            + self.splat.as_ref().map_or(0, Splat::byte_count)
    }

    pub(super) fn clear(&mut self) {
        self.radiance.fill([0.0; 3]);
        self.places.clear();
        self.estimates.fill(Estimate::NONE);
        if let Some(splat) = &mut self.splat {
            splat.clear();
        }
    }

    /// Gives the samples of a camera packet their numbers: `labels` holds their pixels, and their labels afterwards.
    pub(super) fn expect(
        &mut self,
        labels: &mut Lanes<u32>,
        position: &[Lanes<f64>; 2],
        active: &Lanes<i32>,
    ) {
        for l in 0..LANES {
            let place = Place {
                pixel: labels[l],
                position: [position[0][l], position[1][l]],
                exists: active[l] != 0,
            };
            labels[l] |= (self.places.len() as u32) << PIXEL_BITS;
            self.places.push(place);
        }
    }

    /// Adds to the samples that `labels` tell.
    pub(super) fn add(&mut self, labels: &Lanes<u32>, radiance: &Lanes3<f32>) {
        for l in 0..LANES {
            let sum = &mut self.radiance[(labels[l] >> PIXEL_BITS) as usize];
            for channel in 0..3 {
                sum[channel] += f64::from(radiance[channel][l]);
            }
        }
    }

    /// Weighs the wave's samples, to which nothing will be added any more.
    pub(super) fn weigh(&mut self) {
        for (packet, radiances) in self.places.chunks(LANES).zip(self.radiance.chunks_mut(LANES)) {
            let runs = packet.chunks(RUN as usize).zip(radiances.chunks(RUN as usize));
            for (places, radiances) in runs {
                // A packet holds sixteen samples in a row of a pixel, four of each of four, or one of each of sixteen.
                let pixel = places[0].pixel;
                if places.iter().all(|place| place.exists && place.pixel == pixel) {
                    let sum = |channel: usize| radiances.iter().map(|radiance| radiance[channel]).sum();
                    self.estimates[pixel as usize].note_run([sum(0), sum(1), sum(2)]);
                }
            }
            for (place, radiance) in packet.iter().zip(radiances) {
                let radiance = std::mem::take(radiance);
                if place.exists {
                    self.estimates[place.pixel as usize].add(radiance);
                    if let Some(splat) = &mut self.splat {
                        splat.add(place.pixel, place.position, radiance);
                    }
                }
            }
        }
        self.places.clear();
    }

    /// What is known of the tile's pixels, `TILE` to a row.
    pub(super) fn estimates(&self) -> &[Estimate] {
        &self.estimates
    }

    /// The filter's sums over the tile, where there is a filter.
    pub(super) fn splat(&self) -> Option<&Splat> {
        self.splat.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::super::estimate::estimate;
    use super::*;

    #[test]
    fn what_comes_in_pieces_is_weighed_as_one_sample() {
        let mut film = SampleFilm::new(PixelFilter::default());
        let mut labels = [7; LANES];
        let mut active = [-1; LANES];
        active[15] = 0;
        film.expect(&mut labels, &[[0.5; LANES]; 2], &active);
        assert!(labels.iter().all(|&label| pixel_of(label) == 7));
        let mut radiance = [[0.0; LANES]; 3];
        radiance[1] = [1.0; LANES];
        film.add(&labels, &radiance);
        film.add(&labels, &radiance);
        film.weigh();
        // Fifteen samples that saw 2 in green, so none differs from another.
        let estimate = film.estimates()[7];
        assert_eq!((estimate.count, estimate.sum), (15, [0.0, 30.0, 0.0]));
        assert_eq!(estimate.variance(), 0.0);
        assert_eq!(film.estimates()[8].count, 0);
        film.weigh();
        assert_eq!(film.estimates()[7].count, 15);
    }

    #[test]
    fn runs_of_a_pixels_samples_are_noted_and_those_with_gaps_are_not() {
        let mut film = SampleFilm::new(PixelFilter::default());
        let values: Lanes<f32> = std::array::from_fn(|sample| (sample * sample % 13) as f32);
        let mut labels = [7; LANES];
        film.expect(&mut labels, &[[0.5; LANES]; 2], &[-1; LANES]);
        film.add(&labels, &[values; 3]);
        film.weigh();
        let gray: Vec<f64> = values.iter().map(|&value| f64::from(value)).collect();
        let expected = estimate(&gray);
        assert!((film.estimates()[7].noise_variance() - expected.noise_variance()).abs() < 1e-12);
        // Four pixels of four samples each, one of which does not exist: it has no run, the others one each.
        film.clear();
        let mut labels: Lanes<u32> = std::array::from_fn(|l| l as u32 / 4);
        let mut active = [-1; LANES];
        active[6] = 0;
        film.expect(&mut labels, &[[0.5; LANES]; 2], &active);
        film.add(&labels, &[[1.0; LANES]; 3]);
        film.weigh();
        let four = estimate(&[1.0; 4]);
        let mut three = estimate(&[1.0; 3]);
        three.sum = [3.0; 3];
        assert_eq!(film.estimates()[0], four);
        assert_eq!(film.estimates()[1], three);
    }
}
