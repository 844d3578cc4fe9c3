//! Cost probe: estimates the cost of an image from short strips of pixels, rendered as in the image with the ledger
//! on.
//!
//! A strip has enough rows to fill a batch of packets. Strips lie in the tiles selected by [`super::tiles`], one per
//! tile, so a few of them are evenly distributed. Their number depends on the rays that they took, not on the clock:
//! a scene is always probed with the same rays.

use std::time::Instant;

use super::super::context::RenderContext;
use super::super::monitor::{Cancelled, Monitor};
use super::super::plan::Plan;
use super::super::profile::{Category, RenderProfile, Tally};
use super::super::sampler::PacketShape;
use super::super::settings::RenderSettings;
use super::super::tile::{TILE, Tile};
use super::super::wavefront::TileRenderer;
use super::tiles::chosen_tiles;
use crate::accel::{Accel, BATCH};
use crate::processor_time::thread_seconds;
use crate::scene::{Camera, ValidScene};

/// Largest number of strips: about two thousand packets, of which one in 32 is timed in detail to divide the time of
/// shading.
const MAX_STRIPS: usize = 128;
/// Smallest number of strips, for any number of rays: where a few strips contain most of the rays, fewer strips would
/// miss these or contain little else.
const MIN_STRIPS: usize = 48;
/// Number of rays after which no further strip is rendered: about 0.2 s of one thread.
const ENOUGH_RAYS: u64 = 300_000;
/// Largest number of samples per pixel: further samples cost as much as these.
const MAX_SPP: u32 = 64;

/// Result of a probe.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Probe {
    /// Rays of the strips, and seconds of one thread.
    pub ledger: RenderProfile,
    /// One-time cost of an image of any size: preparation and subsurface irradiance.
    pub once: RenderProfile,
    /// Number of strips that were rendered.
    pub strips: usize,
    /// Number of samples that were taken.
    pub samples: u64,
    /// Effects that were simulated, with the reason for each.
    pub plan: Plan,
}

/// Renders strips of the image that `settings` describe, on this thread.
///
/// Every pixel is assumed to have the same number of samples. `accel` must have been built
/// from `scene`.
pub fn probe(
    (scene, camera): (ValidScene, &Camera),
    accel: &dyn Accel,
    settings: &RenderSettings,
    monitor: &Monitor,
) -> Result<Probe, Cancelled> {
    let start = Instant::now();
    let settings = RenderSettings {
        spp: settings.spp.min(MAX_SPP),
        adaptive: None,
        edge_contrast: None,
        sample_aovs: false,
        cost_aovs: false,
        ledger: true,
        ..*settings
    };
    let mut frame = RenderContext::new(scene.get(), camera, accel, &settings);
    // Measure the one-time cost
    let setting_up = Tally {
        rays: frame.probe_count,
        seconds: start.elapsed().as_secs_f64(),
        trace_seconds: 0.0,
    };
    let mut once = frame.prepare_light(monitor)?;
    once.book(Category::Other, setting_up);
    let mut wave = TileRenderer::new(&frame);
    // Select the strips
    let strips: Vec<Tile> = chosen_tiles(&settings, MAX_STRIPS)
        .into_iter()
        .enumerate()
        .map(|(number, tile)| strip(tile, number, &settings))
        .collect();
    // The first strip runs with cold caches and empty queues, which is not representative, so it is rendered once
    // more.
    strips.first().map(|&strip| wave.render_tile(strip, None));
    let mut probe = Probe {
        ledger: RenderProfile::default(),
        once,
        strips: 0,
        samples: 0,
        plan: frame.plan.clone(),
    };
    // Render strips until there are enough rays
    for strip in strips {
        if probe.strips >= MIN_STRIPS && probe.ledger.total().rays >= ENOUGH_RAYS {
            break;
        }
        probe.ledger += undisturbed(&mut wave, strip);
        probe.strips += 1;
        probe.samples += u64::from(strip.width * strip.height) * u64::from(settings.spp);
    }
    probe.ledger.settle(1, 0.0);
    probe.ledger.seconds = probe.ledger.total().seconds;
    Ok(probe)
}

/// Returns the ledger of a strip. The strip is rendered again if other processes used the processor meanwhile,
/// because their time would be booked for this thread.
fn undisturbed(wave: &mut TileRenderer, strip: Tile) -> RenderProfile {
    /// Largest number of attempts per strip.
    const MAX_TRIES: usize = 4;
    /// Largest fraction of a strip's time that other processes may use.
    const ALLOWED: f64 = 0.02;
    let mut best = (f64::INFINITY, RenderProfile::default());
    for _ in 0..MAX_TRIES {
        let (start, worked) = (Instant::now(), thread_seconds());
        let ledger = wave.render_tile(strip, None).1;
        let (passed, worked) = (start.elapsed().as_secs_f64(), thread_seconds() - worked);
        let lost = (passed - worked) / passed;
        if lost < best.0 {
            best = (lost, ledger);
        }
        if lost <= ALLOWED {
            break;
        }
    }
    best.1
}

/// Returns the part of a tile that is rendered: enough rows for a batch of packets, at a different height in every
/// tile.
fn strip(tile: Tile, number: usize, settings: &RenderSettings) -> Tile {
    /// Inverse of the golden ratio, which distributes heights evenly for any number of strips.
    const GOLDEN: f64 = 0.618_033_988_749_894_8;
    let shape = PacketShape::for_samples(settings.spp);
    let packets = tile.width.div_ceil(shape.block) * settings.spp.div_ceil(shape.samples);
    let height = (BATCH as u32).div_ceil(packets) * shape.block;
    let height = height.min(TILE).min(tile.height);
    // Align the strip to blocks of pixels, which start at multiples of their side.
    let places = (tile.height - height) / shape.block + 1;
    let place = ((number as f64 * GOLDEN).fract() * f64::from(places)) as u32;
    Tile {
        y: tile.y + place * shape.block,
        height,
        ..tile
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_lie_in_their_tiles_and_fill_a_batch() {
        for spp in [1, 2, 4, 15, 16, 33, 64] {
            let settings = RenderSettings {
                spp,
                width: 200,
                height: 100,
                ..RenderSettings::default()
            };
            for (number, tile) in chosen_tiles(&settings, 30).into_iter().enumerate() {
                let strip = strip(tile, number, &settings);
                assert_eq!((strip.x, strip.width), (tile.x, tile.width));
                assert!(strip.y >= tile.y && strip.y + strip.height <= tile.y + tile.height);
                let shape = PacketShape::for_samples(spp);
                let packets = strip.width.div_ceil(shape.block)
                    * strip.height.div_ceil(shape.block)
                    * spp.div_ceil(shape.samples);
                assert!(packets >= BATCH as u32 || strip.height == tile.height, "{spp}");
                assert!(packets <= 128, "{spp}: {packets}");
            }
        }
    }
}
