//! Single samples of a wave, for pixel statistics and reconstruction filters that need more than the sum of a pixel.
//!
//! The label of a ray holds the number of its sample besides its pixel. When the wave is finished, all radiance of
//! its samples has arrived, and each sample is added to the statistics of its pixel and splatted by the
//! reconstruction filter, in the order of sample numbers.

use super::super::tile::TILE;
use super::super::wavefront::WAVE;
use super::filter::PixelFilter;
use super::label::PIXEL_BITS;
use super::pixel_statistics::{PixelStatistics, RUN};
use super::splat::Splat;
use crate::numeric::{LANES, Lanes, Lanes3};

/// Radiance of the samples of the current wave, and statistics of earlier waves of the tile.
pub(in crate::render) struct SampleFilm {
    radiance: Vec<[f64; 3]>,
    places: Vec<SamplePosition>,
    estimates: Vec<PixelStatistics>,
    splat: Option<Splat>,
}

/// Pixel and position of a sample.
#[derive(Clone, Copy)]
struct SamplePosition {
    /// Pixel within the tile, `TILE` pixels per row.
    pixel: u32,
    /// Position within the pixel, from its top left corner.
    position: [f64; 2],
    /// True if the lane holds a sample.
    exists: bool,
}

impl SampleFilm {
    pub(in crate::render) fn new(filter: PixelFilter) -> SampleFilm {
        SampleFilm {
            radiance: vec![[0.0; 3]; WAVE * LANES],
            places: Vec::with_capacity(WAVE * LANES),
            estimates: vec![PixelStatistics::NONE; (TILE * TILE) as usize],
            splat: (!filter.is_box()).then(|| Splat::new(filter)),
        }
    }

    /// Returns the bytes of all arrays.
    pub(in crate::render) fn byte_count(&self) -> usize {
        size_of_val(&self.radiance[..])
            + self.places.capacity() * size_of::<SamplePosition>()
            + size_of_val(&self.estimates[..])
            + self.splat.as_ref().map_or(0, Splat::byte_count)
    }

    pub(in crate::render) fn clear(&mut self) {
        self.radiance.fill([0.0; 3]);
        self.places.clear();
        self.estimates.fill(PixelStatistics::NONE);
        if let Some(splat) = &mut self.splat {
            splat.clear();
        }
    }

    /// Registers the samples of a camera packet: `labels` holds their pixels, to which sample numbers are added.
    pub(in crate::render) fn expect(
        &mut self,
        labels: &mut Lanes<u32>,
        position: &[Lanes<f64>; 2],
        active: &Lanes<i32>,
    ) {
        for l in 0..LANES {
            let place = SamplePosition {
                pixel: labels[l],
                position: [position[0][l], position[1][l]],
                exists: active[l] != 0,
            };
            labels[l] |= (self.places.len() as u32) << PIXEL_BITS;
            self.places.push(place);
        }
        // Grow with the longest wave
        let count = self.places.len().max(self.radiance.len());
        self.radiance.resize(count, [0.0; 3]);
    }

    /// Adds radiance to the samples of `labels`.
    pub(in crate::render) fn add(&mut self, labels: &Lanes<u32>, radiance: &Lanes3<f32>) {
        for l in 0..LANES {
            let sum = &mut self.radiance[(labels[l] >> PIXEL_BITS) as usize];
            for channel in 0..3 {
                sum[channel] += f64::from(radiance[channel][l]);
            }
        }
    }

    /// Adds the finished samples of the wave to pixel statistics and to the filter's sums.
    pub(in crate::render) fn weigh(&mut self) {
        for (packet, radiances) in self.places.chunks(LANES).zip(self.radiance.chunks_mut(LANES)) {
            // Record the sums of runs of successive samples
            let runs = packet.chunks(RUN as usize).zip(radiances.chunks(RUN as usize));
            for (places, radiances) in runs {
                // A packet holds sixteen successive samples of one pixel, four of each of four, or one of each of
                // sixteen.
                let pixel = places[0].pixel;
                if places.iter().all(|place| place.exists && place.pixel == pixel) {
                    let sum = |channel: usize| radiances.iter().map(|radiance| radiance[channel]).sum();
                    self.estimates[pixel as usize].note_run([sum(0), sum(1), sum(2)]);
                }
            }
            // Add each sample to its pixel and splat it
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

    /// Returns the statistics of the pixels of the tile, `TILE` per row.
    pub(in crate::render) fn estimates(&self) -> &[PixelStatistics] {
        &self.estimates
    }

    /// Returns the filter's sums over the tile, unless the filter is a box.
    pub(in crate::render) fn splat(&self) -> Option<&Splat> {
        self.splat.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::super::label::pixel_of;
    use super::super::pixel_statistics::estimate;
    use super::*;

    #[test]
    fn partial_contributions_count_as_one_sample() {
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
        // Fifteen samples of 2 in green, so that the variance is zero.
        let estimate = film.estimates()[7];
        assert_eq!((estimate.count, estimate.sum), (15, [0.0, 30.0, 0.0]));
        assert_eq!(estimate.variance(), 0.0);
        assert_eq!(film.estimates()[8].count, 0);
        film.weigh();
        assert_eq!(film.estimates()[7].count, 15);
    }

    #[test]
    fn only_contiguous_sample_runs_are_recorded() {
        let mut film = SampleFilm::new(PixelFilter::default());
        let values: Lanes<f32> = std::array::from_fn(|sample| (sample * sample % 13) as f32);
        let mut labels = [7; LANES];
        film.expect(&mut labels, &[[0.5; LANES]; 2], &[-1; LANES]);
        film.add(&labels, &[values; 3]);
        film.weigh();
        let gray: Vec<f64> = values.iter().map(|&value| f64::from(value)).collect();
        let expected = estimate(&gray);
        assert!((film.estimates()[7].noise_variance() - expected.noise_variance()).abs() < 1e-12);
        // Four pixels with four samples each, one of which does not exist: its pixel has no run, the others have one
        // each.
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
