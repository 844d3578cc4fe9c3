//! Parts of a picture: rectangles of its pixels, and shares of its samples.
//!
//! A rectangle has the bits that it has in the whole picture. Tiles lie where they lie in that; those that the
//! rectangle touches are rendered and cut, with one more around them where a filter takes from neighbours.
//!
//! A picture of very many samples may be the sum of several shares of them, each of which is summed up by itself.
//! Floating-point sums depend on their order, so such a picture may differ in its last bits from one that was made at
//! once; it is the same whoever makes which share, and when, as shares are added in order.

use std::ops::Range;
use std::time::Instant;

use super::estimate::Estimate;
use super::film::{self, TILE, Tile, tiles_among};
use super::filter;
use super::ledger::{Ledger, Tally};
use super::sample::reach;
use super::sampler::PacketShape;
use super::wave::TilePicture;
use super::{Account, Frame, Monitor, RenderSettings, Rendering, SampleAovs, render_tiles, render_uniformly};
use crate::accel::Accel;
use crate::scene::{Camera, Scene};

/// A rectangle of a picture's pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// Its first column.
    pub x: u32,
    /// Its first row.
    pub y: u32,
    /// Columns; at least 1.
    pub width: u32,
    /// Rows; at least 1.
    pub height: u32,
}

impl Region {
    /// All of a picture.
    pub fn whole(settings: &RenderSettings) -> Region {
        Region::of_rows(settings, 0..settings.height)
    }

    /// Some rows of a picture.
    pub fn of_rows(settings: &RenderSettings, rows: Range<u32>) -> Region {
        Region {
            x: 0,
            y: rows.start,
            width: settings.width,
            height: rows.end - rows.start,
        }
    }

    /// How many pixels it has.
    pub fn pixel_count(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

/// One of several shares of every pixel's samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    /// Which, from 0.
    pub index: u32,
    /// Of how many.
    pub count: u32,
}

impl Share {
    /// All samples.
    pub const ALL: Share = Share { index: 0, count: 1 };

    /// How many shares there may be of so many samples a pixel: each has at least a packet of them.
    pub fn most(spp: u32) -> u32 {
        spp.div_ceil(PacketShape::for_samples(spp).samples)
    }

    /// Which of so many packets of samples it takes.
    fn of(self, packet_count: usize) -> Range<usize> {
        let start = |index: u32| (packet_count as u64 * u64::from(index) / u64::from(self.count)) as usize;
        start(self.index)..start(self.index + 1)
    }
}

/// Side of the squares that pictures are rendered by: rectangles along them cost nothing beyond themselves.
pub const TILE_SIDE: u32 = TILE;

/// A picture that is rendered in parts; what they have in common is made ready once.
pub struct Parts<'s> {
    frame: Frame<'s>,
    ready_seconds: f64,
    /// What making ready took, until a part has it in its ledger.
    ready: Ledger,
}

impl<'s> Parts<'s> {
    /// Makes a picture ready, in the current rayon pool. `None` if that was cancelled.
    ///
    /// [`RenderSettings::adaptive`] is ignored, as numbers of samples depend on more than a part;
    /// [`RenderSettings::cost_aovs`] too. `scene` must have passed [`Scene::validate`], and `accel` must have been built
    /// from it.
    pub fn new(
        (scene, camera): (&'s Scene, &Camera),
        accel: &'s dyn Accel,
        settings: &RenderSettings,
        monitor: &Monitor,
    ) -> Option<Parts<'s>> {
        let start = Instant::now();
        let settings = RenderSettings {
            adaptive: None,
            cost_aovs: false,
            ..*settings
        };
        let mut frame = Frame::new(scene, camera, accel, &settings);
        let made_ready = settings.ledger.then(|| start.elapsed().as_secs_f64());
        let mut ready = frame.scatter(monitor)?;
        let setting_up = Tally {
            rays: frame.probe_count,
            seconds: made_ready.unwrap_or(0.0),
            trace_seconds: 0.0,
        };
        ready.book(Account::Other, setting_up);
        Some(Parts {
            frame,
            ready_seconds: start.elapsed().as_secs_f64(),
            ready,
        })
    }

    /// A rectangle of the finished picture. `None` if it was cancelled.
    pub fn region(&mut self, region: &Region, monitor: &Monitor) -> Option<Rendering> {
        let start = Instant::now();
        self.frame.part = 0..self.packet_count();
        self.frame.keeps_sums = false;
        let mut rendering = render_uniformly(&self.frame, region, monitor)?;
        rendering.ledger += std::mem::take(&mut self.ready);
        rendering.ready_seconds = std::mem::take(&mut self.ready_seconds);
        let seconds = start.elapsed().as_secs_f64() + rendering.ready_seconds;
        rendering.ledger.settle(rayon::current_num_threads(), seconds);
        rendering.subsurface = self.frame.bodies.as_ref().map(|bodies| bodies.stats);
        Some(rendering)
    }

    /// What a share of the samples of a rectangle's pixels adds up to, and what it took. `None` if it was cancelled.
    pub fn sums(&mut self, region: &Region, share: Share, monitor: &Monitor) -> Option<(Sums, Ledger)> {
        let packets = share.of(self.packet_count());
        self.sums_of(region, packets, monitor)
    }

    /// Packets of samples that a pixel has: what may be summed up by itself.
    pub fn packet_count(&self) -> usize {
        self.frame.groups.len()
    }

    /// What some packets of the samples of a rectangle's pixels add up to, and what that took. `None` if it was
    /// cancelled.
    ///
    /// # Panics
    /// If there are no such packets.
    pub fn sums_of(
        &mut self,
        region: &Region,
        packets: Range<usize>,
        monitor: &Monitor,
    ) -> Option<(Sums, Ledger)> {
        let start = Instant::now();
        self.frame.part = packets;
        self.frame.keeps_sums = true;
        let frame = &self.frame;
        let cover = Cover::of(region, &frame.settings);
        let (tiles, mut ledger) = render_tiles(frame, &cover.tiles, None, monitor)?;
        let sums = cover.sums(frame, &cover.placed(tiles));
        ledger += std::mem::take(&mut self.ready);
        let ready_seconds = std::mem::take(&mut self.ready_seconds);
        ledger.settle(
            rayon::current_num_threads(),
            start.elapsed().as_secs_f64() + ready_seconds,
        );
        Some((sums, ledger))
    }
}

/// What samples of the pixels of a rectangle add up to, row by row, the top row first.
#[derive(Clone, Debug, PartialEq)]
pub struct Sums {
    /// Samples a pixel.
    pub samples: u32,
    /// Linear RGB radiance.
    pub radiance: Vec<[f64; 3]>,
    /// Linear RGB radiance by the filter's weights, and these; none for a box.
    pub weighted: Option<Vec<[f64; 4]>>,
    /// Squared radiance, channels weighted by luminance; only with [`RenderSettings::sample_aovs`].
    pub squares: Option<Vec<f64>>,
}

impl Sums {
    /// Adds the sums of the share that comes next.
    ///
    /// # Panics
    /// If it is of another rectangle.
    pub fn add(&mut self, next: &Sums) {
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

    /// The pixels that they give: linear RGB radiance.
    pub fn pixels(&self) -> Vec<[f32; 3]> {
        let scale = 1.0 / f64::from(self.samples);
        let mean = |sum: &[f64; 3]| sum.map(|channel| (channel * scale) as f32);
        match &self.weighted {
            None => self.radiance.iter().map(mean).collect(),
            Some(weighted) => weighted
                .iter()
                .zip(&self.radiance)
                .map(|(&sums, plain)| filter::weighted_mean(sums).unwrap_or_else(|| mean(plain)))
                .collect(),
        }
    }

    /// What they tell of single samples, if that was asked for.
    pub fn aovs(&self) -> Option<SampleAovs> {
        let squares = self.squares.as_ref()?;
        let estimates = self.radiance.iter().zip(squares);
        let estimates: Vec<Estimate> = estimates
            .map(|(&sum, &squares)| Estimate::of_sums(sum, squares, self.samples))
            .collect();
        Some(SampleAovs::of(&estimates))
    }
}

/// The tiles that a rectangle needs.
pub(super) struct Cover {
    /// The rectangle that they fill.
    outer: Region,
    inner: Region,
    /// Row by row.
    pub(super) tiles: Vec<Tile>,
}

impl Cover {
    pub(super) fn of(region: &Region, settings: &RenderSettings) -> Cover {
        let margin = u32::from(reach(settings) > 0);
        let along = |start: u32, size: u32, end: u32| {
            let first = (start / TILE).saturating_sub(margin);
            let last = ((start + size).div_ceil(TILE) + margin).min(end.div_ceil(TILE));
            (first..last, first * TILE, (last * TILE).min(end) - first * TILE)
        };
        let (columns, x, width) = along(region.x, region.width, settings.width);
        let (rows, y, height) = along(region.y, region.height, settings.height);
        Cover {
            outer: Region { x, y, width, height },
            inner: *region,
            tiles: tiles_among([settings.width, settings.height], [columns, rows]),
        }
    }

    /// Width and height of what the tiles fill.
    pub(super) fn size(&self) -> [u32; 2] {
        [self.outer.width, self.outer.height]
    }

    /// The same tiles, where they lie in the rectangle that they fill.
    pub(super) fn placed(&self, mut tiles: Vec<(Tile, TilePicture)>) -> Vec<(Tile, TilePicture)> {
        for (tile, _) in &mut tiles {
            tile.x -= self.outer.x;
            tile.y -= self.outer.y;
        }
        tiles
    }

    /// What of values of the pixels that the tiles fill lies in the rectangle.
    pub(super) fn cut<T: Copy>(&self, values: Vec<T>) -> Vec<T> {
        if self.outer == self.inner {
            return values;
        }
        let (inner, outer) = (&self.inner, &self.outer);
        let first = (inner.x - outer.x) as usize;
        values
            .chunks(outer.width as usize)
            .skip((inner.y - outer.y) as usize)
            .take(inner.height as usize)
            .flat_map(|row| &row[first..first + inner.width as usize])
            .copied()
            .collect()
    }

    /// What the rectangle's samples add up to, by tiles that lie where they lie.
    fn sums(&self, frame: &Frame, tiles: &[(Tile, TilePicture)]) -> Sums {
        let [width, height] = self.size();
        let settings = &frame.settings;
        let squares = || {
            let estimates = film::assemble(width, height, tiles, &|picture| &picture.estimates);
            self.cut(estimates).iter().map(Estimate::squares).collect()
        };
        Sums {
            samples: frame.samples_taken(),
            radiance: self.cut(film::assemble(width, height, tiles, &|picture| &picture.sums)),
            weighted: (!settings.filter.is_box()).then(|| self.cut(filter::sums(width, height, tiles))),
            squares: settings.sample_aovs.then(squares),
        }
    }
}

impl Frame<'_> {
    /// Samples a pixel of the share that is taken.
    pub(super) fn samples_taken(&self) -> u32 {
        let before = |group: usize| self.settings.spp.min(group as u32 * self.shape.samples);
        before(self.part.end) - before(self.part.start)
    }
}
