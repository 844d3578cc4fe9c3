//! Partial renders: rectangles of pixels of an image, and shares of its samples.
//!
//! A rectangle has the same bits as in the whole image. The tile grid is that of the whole image; the tiles that the
//! rectangle touches are rendered and cropped, with a border of one tile if a filter needs neighbours.
//!
//! An image of very many samples may be the sum of several shares, each of which is summed up separately.
//! Floating-point sums depend on their order, so such an image may differ in its last bits from one that was rendered
//! at once. It does not depend on which process renders which share or when, because shares are added in order.

use std::ops::Range;
use std::time::Instant;

use super::super::context::RenderContext;
use super::super::driver::{render_region, render_tiles};
use super::super::film::{
    PixelStatistics, SampleAovs, TileResult, filtered_image, tile_result, weighted_mean,
};
use super::super::monitor::{Cancelled, Monitor};
use super::super::profile::{Category, RenderProfile, Tally};
use super::super::result::Rendering;
use super::super::sampler::PacketShape;
use super::super::settings::RenderSettings;
use super::super::tile::Tile;
use super::cover::Cover;
use super::region::Region;
use crate::accel::Accel;
use crate::scene::{Camera, ValidScene};

/// Share of the samples of every pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    /// Index of the share, from 0.
    pub index: u32,
    /// Total number of shares.
    pub count: u32,
}

impl Share {
    /// Single share with all samples.
    pub const ALL: Share = Share { index: 0, count: 1 };

    /// Returns the largest number of shares for `spp` samples per pixel: each has at least one packet of them.
    pub fn most(spp: u32) -> u32 {
        spp.div_ceil(PacketShape::for_samples(spp).samples)
    }

    /// Returns the range of sample packets that belong to the share.
    fn of(self, packet_count: usize) -> Range<usize> {
        let start = |index: u32| (packet_count as u64 * u64::from(index) / u64::from(self.count)) as usize;
        start(self.index)..start(self.index + 1)
    }
}

/// Render of an image in parts, which share one preparation.
pub struct Parts<'s> {
    frame: RenderContext<'s>,
    ready_seconds: f64,
    /// Ledger of the preparation, until a part includes it.
    ready: RenderProfile,
}

impl<'s> Parts<'s> {
    /// Prepares a render in parts, in the current rayon pool.
    ///
    /// Ignores [`RenderSettings::adaptive`], because its sample counts depend on more than one part, and
    /// [`RenderSettings::cost_aovs`]. `accel` must have been built from `scene`.
    pub fn new(
        (scene, camera): (ValidScene<'s>, &Camera),
        accel: &'s dyn Accel,
        settings: &RenderSettings,
        monitor: &Monitor,
    ) -> Result<Parts<'s>, Cancelled> {
        let start = Instant::now();
        // Ignore settings that need all parts
        let settings = RenderSettings {
            adaptive: None,
            cost_aovs: false,
            ..*settings
        };
        // Prepare the scene and the light that all tiles share
        let mut frame = RenderContext::new(scene.get(), camera, accel, &settings);
        let setup_seconds = settings.ledger.then(|| start.elapsed().as_secs_f64());
        let mut ready = frame.prepare_light(monitor)?;
        // Book the preparation, which the first part includes
        let setting_up = Tally {
            rays: frame.probe_count,
            seconds: setup_seconds.unwrap_or(0.0),
            trace_seconds: 0.0,
        };
        ready.book(Category::Other, setting_up);
        Ok(Parts {
            frame,
            ready_seconds: start.elapsed().as_secs_f64(),
            ready,
        })
    }

    /// Renders a rectangle of the finished image. With [`RenderSettings::edge_contrast`] it should have the exposure in
    /// stops, for an automatic one depends on the rectangle.
    pub fn region(&mut self, region: &Region, monitor: &Monitor) -> Result<Rendering, Cancelled> {
        let start = Instant::now();
        self.frame.part = 0..self.packet_count();
        self.frame.returns_sums = false;
        let mut rendering = render_region(&mut self.frame, region, monitor)?;
        // Include the preparation in the ledger of the first part
        rendering.ledger += std::mem::take(&mut self.ready);
        rendering.ready_seconds = std::mem::take(&mut self.ready_seconds);
        let seconds = start.elapsed().as_secs_f64() + rendering.ready_seconds;
        rendering.ledger.settle(rayon::current_num_threads(), seconds);
        rendering.subsurface = self.frame.bodies.as_ref().map(|bodies| bodies.stats);
        Ok(rendering)
    }

    /// Renders a share of the samples of a rectangle and returns their sums with the ledger. Every pixel takes the whole
    /// share, whatever [`RenderSettings::edge_contrast`] is.
    pub fn sums(
        &mut self,
        region: &Region,
        share: Share,
        monitor: &Monitor,
    ) -> Result<(PartSums, RenderProfile), Cancelled> {
        let packets = share.of(self.packet_count());
        self.sums_of(region, packets, monitor)
    }

    /// Returns the number of sample packets per pixel, the smallest units that can be summed up separately.
    pub fn packet_count(&self) -> usize {
        self.frame.groups.len()
    }

    /// Renders some sample packets of the pixels of a rectangle and returns their sums with the ledger. Every pixel takes
    /// all of these, whatever [`RenderSettings::edge_contrast`] is.
    ///
    /// # Panics
    /// If `packets` is out of range.
    pub fn sums_of(
        &mut self,
        region: &Region,
        packets: Range<usize>,
        monitor: &Monitor,
    ) -> Result<(PartSums, RenderProfile), Cancelled> {
        let start = Instant::now();
        self.frame.part = packets;
        self.frame.returns_sums = true;
        let frame = &self.frame;
        // Render the tiles that the region touches
        let cover = Cover::of(region, &frame.settings);
        let (tiles, mut ledger) = render_tiles(frame, &cover.tiles, None, None, monitor)?;
        let sums = cover.sums(frame, &cover.placed(tiles));
        // Include the preparation in the ledger of the first part
        ledger += std::mem::take(&mut self.ready);
        let ready_seconds = std::mem::take(&mut self.ready_seconds);
        ledger.settle(
            rayon::current_num_threads(),
            start.elapsed().as_secs_f64() + ready_seconds,
        );
        Ok((sums, ledger))
    }
}

/// Sums over samples of the pixels of a rectangle, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct PartSums {
    /// Number of samples per pixel in the sums.
    pub samples: u32,
    /// Sums of linear RGB radiance.
    pub radiance: Vec<[f64; 3]>,
    /// Sums of linear RGB radiance times filter weights, and sums of the weights; `None` for a box filter.
    pub weighted: Option<Vec<[f64; 4]>>,
    /// Sums of squared radiance, channels weighted by luminance; only with [`RenderSettings::sample_aovs`].
    pub squares: Option<Vec<f64>>,
}

impl PartSums {
    /// Adds the sums of the share that follows this one.
    ///
    /// # Panics
    /// If the sums belong to another rectangle.
    pub fn add(&mut self, next: &PartSums) {
        fn add_all<const N: usize>(sums: &mut [[f64; N]], next: &[[f64; N]]) {
            assert_eq!(sums.len(), next.len(), "sums of other pixels");
            for (sum, next) in sums.iter_mut().zip(next) {
                (0..N).for_each(|channel| sum[channel] += next[channel]);
            }
        }
        self.samples += next.samples;
        add_all(&mut self.radiance, &next.radiance);
        if let (Some(sums), Some(next)) = (&mut self.weighted, &next.weighted) {
            add_all(sums, next);
        }
        if let (Some(sums), Some(next)) = (&mut self.squares, &next.squares) {
            sums.iter_mut().zip(next).for_each(|(sum, next)| *sum += next);
        }
    }

    /// Returns the pixels as linear RGB radiance.
    pub fn pixels(&self) -> Vec<[f32; 3]> {
        let scale = 1.0 / f64::from(self.samples);
        let mean = |sum: &[f64; 3]| sum.map(|channel| (channel * scale) as f32);
        match &self.weighted {
            None => self.radiance.iter().map(mean).collect(),
            Some(weighted) => weighted
                .iter()
                .zip(&self.radiance)
                // Fall back to the unfiltered mean where weights cancel
                .map(|(&sums, plain)| weighted_mean(sums).unwrap_or_else(|| mean(plain)))
                .collect(),
        }
    }

    /// Returns the statistics of single samples, if they were requested.
    pub fn aovs(&self) -> Option<SampleAovs> {
        let squares = self.squares.as_ref()?;
        let estimates = self.radiance.iter().zip(squares);
        let estimates: Vec<PixelStatistics> = estimates
            .map(|(&sum, &squares)| PixelStatistics::of_sums(sum, squares, self.samples))
            .collect();
        Some(SampleAovs::of(&estimates))
    }
}

impl Cover {
    /// Returns the sums over the samples of the rectangle, from tiles with positions relative to the cover.
    fn sums(&self, frame: &RenderContext, tiles: &[(Tile, TileResult)]) -> PartSums {
        let [width, height] = self.size();
        let settings = &frame.settings;
        let squares = || {
            let estimates = tile_result::assemble(width, height, tiles, &|result| &result.estimates);
            self.cut(estimates).iter().map(PixelStatistics::squares).collect()
        };
        PartSums {
            samples: frame.samples_taken(),
            radiance: self.cut(tile_result::assemble(width, height, tiles, &|result| {
                &result.sums
            })),
            weighted: (!settings.filter.is_box())
                .then(|| self.cut(filtered_image::sums(width, height, tiles))),
            squares: settings.sample_aovs.then(squares),
        }
    }
}
