//! Film: sums of radiance in f64 while a tile is rendered, and f32 means in the image.

use multiversion::multiversion;

use super::super::aov::{LightGroupFilm, LightSource};
use super::super::profile::Memory;
use super::super::settings::RenderSettings;
use super::super::tile::{PixelVisit, TILE, Tile};
use super::label::{pixel_of, without_step};
use super::pixel_statistics::PixelStatistics;
use super::sample_film::SampleFilm;
use super::tile_result::TileResult;
use crate::numeric::{LANES, Lanes, Lanes3, sum_of_lanes};

/// Sums of radiance over a tile, in a fixed order that does not depend on threads.
///
/// With statistics of single samples, the labels of rays contain the sample besides the pixel.
pub(in crate::render) struct TileFilm {
    sums: Vec<[f64; 3]>,
    /// Optional data in one field, so that the common case costs a single test.
    beside: Option<Beside>,
}

/// Optional data in addition to the sums.
#[derive(Default)]
struct Beside {
    samples: Option<SampleFilm>,
    light: Option<LightGroupFilm>,
}

impl Beside {
    #[inline(never)]
    fn add(&mut self, label: &Lanes<u32>, radiance: &Lanes3<f32>, source: LightSource) {
        if let Some(light) = &mut self.light {
            light.add(label, radiance, source);
        }
        if let Some(samples) = &mut self.samples {
            samples.add(&label.map(without_step), radiance);
        }
    }
}

impl TileFilm {
    pub(in crate::render) fn new(samples: Option<SampleFilm>) -> TileFilm {
        TileFilm {
            sums: vec![[0.0; 3]; (TILE * TILE) as usize],
            beside: samples.map(|samples| Beside {
                samples: Some(samples),
                light: None,
            }),
        }
    }

    /// Returns the film with sums of the layers of light, if they are requested.
    pub(in crate::render) fn with_light(mut self, light: Option<LightGroupFilm>) -> TileFilm {
        if light.is_some() {
            self.beside.get_or_insert_default().light = light;
        }
        self
    }

    /// Returns the layers of light, if any are requested.
    pub(in crate::render) fn light(&mut self) -> Option<&mut LightGroupFilm> {
        self.beside.as_mut()?.light.as_mut()
    }

    fn kept_samples(&self) -> Option<&SampleFilm> {
        self.beside.as_ref()?.samples.as_ref()
    }

    pub(in crate::render) fn clear(&mut self) {
        self.sums.fill([0.0; 3]);
        if let Some(samples) = self.samples() {
            samples.clear();
        }
        if let Some(light) = self.light() {
            light.clear();
        }
    }

    /// Returns the sums of all pixels, row by row.
    pub(in crate::render) fn sums(&self) -> &[[f64; 3]] {
        &self.sums
    }

    /// Adds the bytes of the sums and of the optional data.
    pub(in crate::render) fn add_to(&self, memory: &mut Memory) {
        memory.add("film", "sums of a tile", size_of_val(&self.sums[..]));
        let samples = self.kept_samples().map_or(0, SampleFilm::byte_count);
        memory.add("sampling", "single samples of a tile", samples);
        let light = self.beside.as_ref().and_then(|beside| beside.light.as_ref());
        let light = light.map_or(0, LightGroupFilm::byte_count);
        memory.add("film", "layers of light of a tile", light);
    }

    /// Returns the film of single samples, if it is kept.
    pub(in crate::render) fn samples(&mut self) -> Option<&mut SampleFilm> {
        self.beside.as_mut()?.samples.as_mut()
    }

    /// Adds one value per lane, all from `source`; lanes without a contribution hold zero.
    ///
    /// Pixels get identical sums with and without statistics of single samples.
    #[inline(always)]
    pub(in crate::render) fn add(&mut self, label: &Lanes<u32>, radiance: &Lanes3<f32>, source: LightSource) {
        match &mut self.beside {
            None => self.add_to_pixels(label, radiance),
            Some(beside) => {
                beside.add(label, radiance, source);
                self.add_to_pixels(&label.map(pixel_of), radiance);
            }
        }
    }

    /// Adds one value per lane to the layer of a light for each lane, if there are any; the film has it from
    /// [`LightSource::Chosen`].
    pub(in crate::render) fn add_to_lights(
        &mut self,
        label: &Lanes<u32>,
        radiance: &Lanes3<f32>,
        lights: &Lanes<u32>,
    ) {
        if let Some(light) = self.light() {
            light.add_to_lights(label, radiance, lights);
        }
    }

    #[inline(always)]
    fn add_to_pixels(&mut self, pixel: &Lanes<u32>, radiance: &Lanes3<f32>) {
        // Sum up the lanes first if all belong to one pixel
        if pixel.iter().fold(0, |differ, p| differ | (p ^ pixel[0])) == 0 {
            let sum = &mut self.sums[pixel[0] as usize];
            let added = sums_of_lanes(radiance);
            for channel in 0..3 {
                sum[channel] += added[channel];
            }
            return;
        }
        // Otherwise add lane by lane, in order
        for l in 0..LANES {
            let sum = &mut self.sums[pixel[l] as usize];
            for channel in 0..3 {
                sum[channel] += f64::from(radiance[channel][l]);
            }
        }
    }

    /// Returns the pixels of a tile after `settings.spp` samples per pixel.
    pub(in crate::render) fn picture(&self, tile: Tile, settings: RenderSettings) -> TileResult {
        let samples = self.kept_samples();
        // Crop the statistics to the tile
        let estimates = samples
            .filter(|_| settings.sample_aovs)
            .map(SampleFilm::estimates);
        TileResult {
            means: self.means(tile, settings.spp),
            sums: Vec::new(),
            splat: samples.and_then(SampleFilm::splat).cloned(),
            estimates: estimates.map_or(Vec::new(), |all| cut(tile, all).copied().collect()),
            transparency: None,
        }
    }

    /// Returns the sums of the pixels of the tile, row by row.
    pub(in crate::render) fn sums_of(&self, tile: Tile) -> Vec<[f64; 3]> {
        cut(tile, &self.sums).copied().collect()
    }

    /// Returns the sample statistics of the visited pixels.
    pub(in crate::render) fn estimates(&self, visits: &[PixelVisit]) -> Vec<PixelStatistics> {
        let all = self.kept_samples().map_or(&[][..], SampleFilm::estimates);
        let of = |visit: &PixelVisit| {
            let estimate = all.get((visit.y * TILE + visit.x) as usize);
            estimate.copied().unwrap_or(PixelStatistics::NONE)
        };
        visits.iter().map(of).collect()
    }

    /// Returns the means over `spp` samples of the pixels of the tile, row by row.
    fn means(&self, tile: Tile, spp: u32) -> Vec<[f32; 3]> {
        let mut means = vec![[0.0; 3]; (tile.width * tile.height) as usize];
        // Crop the rows to the tile
        let rows = self.sums.chunks(TILE as usize);
        for (means, sums) in means.chunks_mut(tile.width as usize).zip(rows) {
            set_means(
                means.as_flattened_mut(),
                sums.as_flattened(),
                1.0 / f64::from(spp),
            );
        }
        means
    }
}

/// Returns the sum that a pixel forms of one channel of successive sample packets.
pub fn pixel_sum(packets: impl Iterator<Item = Lanes<f32>>) -> f64 {
    let mut film = TileFilm::new(None);
    for samples in packets {
        film.add(
            &[0; LANES],
            &[samples, [0.0; LANES], [0.0; LANES]],
            LightSource::Emission,
        );
    }
    film.sums()[0][0]
}

/// Returns the pixels of a full-size tile that lie inside `tile`, row by row.
pub(in crate::render) fn cut<T>(tile: Tile, pixels: &[T]) -> impl Iterator<Item = &T> {
    let rows = pixels.chunks(TILE as usize).take(tile.height as usize);
    rows.flat_map(move |row| &row[..tile.width as usize])
}

/// Sets each mean to the sum at its place, times `scale`.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn set_means(means: &mut [f32], sums: &[f64], scale: f64) {
    for (mean, sum) in means.iter_mut().zip(sums) {
        *mean = (sum * scale) as f32;
    }
}

/// Returns the f64 sums over all lanes of a packet.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn sums_of_lanes(radiance: &Lanes3<f32>) -> [f64; 3] {
    radiance.map(|values| sum_of_lanes(values.map(f64::from)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_of_one_and_sixteen_pixels_sum_equally() {
        let radiance = [std::array::from_fn(|l| l as f32), [0.25; LANES], [0.0; LANES]];
        let mut film = TileFilm::new(None);
        film.add(&[5; LANES], &radiance, LightSource::Emission);
        // 0 + 1 + ... + 15 = 120.
        assert_eq!(film.sums[5], [120.0, 4.0, 0.0]);
        film.add(
            &std::array::from_fn(|l| l as u32),
            &radiance,
            LightSource::Emission,
        );
        assert_eq!(film.sums[7], [7.0, 0.25, 0.0]);
        assert_eq!(film.sums[5], [125.0, 4.25, 0.0]);
    }
}
