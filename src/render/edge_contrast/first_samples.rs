//! First samples of pixels, and the differences between neighbours.

use super::super::adaptive::DISPLAY_ROOT;
use super::super::automatic_exposure::Exposure;
use super::super::context::RenderContext;
use super::super::driver::{CoverResult, render_cover};
use super::super::film::{PixelStatistics, tile_result};
use super::super::monitor::{Cancelled, Monitor};
use super::super::profile::{Category, Profiler, RenderProfile};
use super::super::subset::{Cover, Region};
use super::super::tile::{TILE, Tile};
use crate::image::LinearImage;

/// Fraction of the progress at the end of the first samples.
pub(super) const FIRST_FRACTION: f64 = 0.5;
/// Side of a tile in pixels.
const INNER: usize = TILE as usize;
/// Side of a tile together with the pixels around it.
const OUTER: usize = INNER + 2;

/// First samples of the pixels of a rectangle and of a border of one tile.
pub(super) struct FirstSamples {
    pub(super) cover: Cover,
    /// Pixels of the tiles of the cover.
    pub(super) image: LinearImage,
    /// Factor on radiance before display.
    gain: f32,
    /// Sample statistics of these pixels, if requested.
    pub(super) estimates: Vec<PixelStatistics>,
    pub(super) ledger: RenderProfile,
}

impl FirstSamples {
    /// Takes a sample of each pixel.
    pub(super) fn render(
        frame: &RenderContext,
        region: &Region,
        exposure: Exposure,
        monitor: &Monitor,
    ) -> Result<FirstSamples, Cancelled> {
        // Render the tiles
        let settings = &frame.settings;
        let cover = Cover::with_border(region, settings, 1);
        let progress = |fraction: f64| (monitor.progress)(FIRST_FRACTION * fraction);
        let monitor = Monitor {
            progress: &progress,
            ..*monitor
        };
        let (CoverResult { pixels, tiles }, mut ledger) = render_cover(frame, &cover, None, &monitor)?;
        // Assemble their statistics
        let mut meter = Profiler::new(settings);
        let [width, height] = cover.size();
        let estimates = match settings.sample_aovs {
            true => tile_result::assemble(width, height, &tiles, &|result| &result.estimates),
            false => Vec::new(),
        };
        let image = LinearImage {
            width,
            height,
            pixels,
        };
        let gain = exposure.stops(&image, None).exp2();
        meter.lap_all_threads(Category::Film);
        ledger += meter.ledger;
        Ok(FirstSamples {
            cover,
            image,
            gain,
            estimates,
            ledger,
        })
    }

    /// Returns the pixels of a tile, row by row.
    pub(super) fn means(&self, tile: Tile) -> Vec<[f32; 3]> {
        let rows = (tile.y..tile.y + tile.height).map(|y| self.cover.index([tile.x, y]));
        rows.flat_map(|first| &self.image.pixels[first..first + tile.width as usize])
            .copied()
            .collect()
    }

    /// Returns, by row and column, which pixels of a tile differ by more than `limit` from a neighbour.
    pub(super) fn edges(&self, tile: Tile, limit: f32) -> [[bool; INNER]; INNER] {
        let mut is_edge = [[false; INNER]; INNER];
        for values in self.displayed(tile) {
            // Find the extremes of three pixels in a row
            let (mut low, mut high) = ([[0.0f32; INNER]; OUTER], [[0.0f32; INNER]; OUTER]);
            for y in 0..OUTER {
                let row = &values[y];
                for x in 0..INNER {
                    low[y][x] = row[x].min(row[x + 1].min(row[x + 2]));
                    high[y][x] = row[x].max(row[x + 1].max(row[x + 2]));
                }
            }
            // Compare each pixel with the extremes of three rows
            for y in 0..INNER {
                for x in 0..INNER {
                    let value = values[y + 1][x + 1];
                    let least = low[y][x].min(low[y + 1][x].min(low[y + 2][x]));
                    let greatest = high[y][x].max(high[y + 1][x].max(high[y + 2][x]));
                    is_edge[y][x] |= (greatest - value).max(value - least) > limit;
                }
            }
        }
        is_edge
    }

    /// Returns the displayed values of a tile and of the pixels around it, by channel, row and column. Those beyond the
    /// rectangle repeat the pixels at its border.
    fn displayed(&self, tile: Tile) -> [[[f32; OUTER]; OUTER]; 3] {
        // Find the rows and columns
        let [width, height] = self.cover.size();
        let [left, top] = self.cover.corner();
        let within = |start: u32, offset: usize, first: u32, count: u32| {
            (start + offset as u32).saturating_sub(first + 1).min(count - 1) as usize
        };
        let columns: [usize; OUTER] = std::array::from_fn(|x| within(tile.x, x, left, width));
        let rows: [usize; OUTER] = std::array::from_fn(|y| within(tile.y, y, top, height));
        // Copy the radiance
        let mut values = [[[0.0f32; OUTER]; OUTER]; 3];
        for y in 0..OUTER {
            let row = &self.image.pixels[rows[y] * width as usize..][..width as usize];
            for x in 0..OUTER {
                let pixel = row[columns[x]];
                for channel in 0..3 {
                    values[channel][y][x] = pixel[channel];
                }
            }
        }
        // Display it, by the curve of adaptive sampling
        let (root, gain) = (DISPLAY_ROOT as f32, self.gain);
        let scale = (1.0 + root * root).sqrt() + root;
        for value in values.as_flattened_mut().as_flattened_mut() {
            let shown = (gain * *value).clamp(0.0, 1.0);
            *value = ((shown + root * root).sqrt() - root) * scale;
        }
        values
    }
}
