//! A quick look at what a picture will cost: short strips of its pixels, rendered as they will be, with the ledger on.
//!
//! A strip is as long as it takes to fill a batch of packets, and strips lie where the tiles of [`super::sample`] lie,
//! one in each, so few of them see the picture evenly. How many there are goes by the rays that they took, not by the
//! clock: the same scene is always probed by the same rays.

use std::time::Instant;

use super::film::{TILE, Tile};
use super::queue::BATCH;
use super::sample::{chosen_tiles, thread_seconds};
use super::sampler::PacketShape;
use super::wave::Wave;
use super::{Account, Frame, Ledger, Monitor, Plan, RenderSettings, Tally};
use crate::accel::Accel;
use crate::scene::{Camera, Scene};

/// Strips at most: some two thousand packets, of which one in 32 tells how shading divides.
const MAX_STRIPS: usize = 128;
/// Strips at least, however many rays they take: where a few see what takes most rays, fewer would miss it or see
/// little else.
const MIN_STRIPS: usize = 48;
/// Rays after which no other strip is begun: about 0.2 s of one thread.
const ENOUGH_RAYS: u64 = 300_000;
/// Samples a pixel at most: more of them cost what these do.
const MAX_SPP: u32 = 64;

/// What a probe found.
#[derive(Clone, Debug)]
pub struct Probe {
    /// Rays of the strips, and seconds of one thread.
    pub ledger: Ledger,
    /// What a picture takes once, however large: setting up, and the light within bodies that scatter it.
    pub once: Ledger,
    /// Strips that were rendered.
    pub strips: usize,
    /// Samples that were taken.
    pub samples: u64,
    /// What was simulated.
    pub plan: Plan,
}

/// Renders strips of the picture that `settings` ask for, on this thread.
///
/// Every pixel is taken to have the same number of samples. `scene` must have passed [`Scene::validate`], and `accel`
/// must have been built from it. `None` if it was cancelled.
pub fn probe(
    (scene, camera): (&Scene, &Camera),
    accel: &dyn Accel,
    settings: &RenderSettings,
    monitor: &Monitor,
) -> Option<Probe> {
    let start = Instant::now();
    let settings = RenderSettings {
        spp: settings.spp.min(MAX_SPP),
        adaptive: None,
        sample_aovs: false,
        cost_aovs: false,
        ledger: true,
        ..*settings
    };
    let mut frame = Frame::new(scene, camera, accel, &settings);
    let setting_up = Tally {
        rays: frame.probe_count,
        seconds: start.elapsed().as_secs_f64(),
        trace_seconds: 0.0,
    };
    let mut once = frame.scatter(monitor)?;
    once.book(Account::Other, setting_up);
    let mut wave = Wave::new(&frame);
    let strips: Vec<Tile> = chosen_tiles(&settings, MAX_STRIPS)
        .into_iter()
        .enumerate()
        .map(|(number, tile)| strip(tile, number, &settings))
        .collect();
    // The first one finds all caches cold and all queues empty, as it never is for long: it does not count.
    strips.first().map(|&strip| wave.render_tile(strip, None));
    let mut probe = Probe {
        ledger: Ledger::default(),
        once,
        strips: 0,
        samples: 0,
        plan: frame.plan.clone(),
    };
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
    Some(probe)
}

/// The account of a strip. If the system gave the processor to others meanwhile, whose time would be booked as this
/// thread's, the strip is rendered again.
fn undisturbed(wave: &mut Wave, strip: Tile) -> Ledger {
    /// Renders of a strip at most.
    const MAX_TRIES: usize = 4;
    /// Part of a strip's time that others may have had.
    const ALLOWED: f64 = 0.02;
    let mut least = (f64::INFINITY, Ledger::default());
    for _ in 0..MAX_TRIES {
        let (start, worked) = (Instant::now(), thread_seconds());
        let ledger = wave.render_tile(strip, None).1;
        let (passed, worked) = (start.elapsed().as_secs_f64(), thread_seconds() - worked);
        let lost = (passed - worked) / passed;
        if lost < least.0 {
            least = (lost, ledger);
        }
        if lost <= ALLOWED {
            break;
        }
    }
    least.1
}

/// The part of a tile that is rendered: as many rows as make a batch of packets, at another height in every tile.
fn strip(tile: Tile, number: usize, settings: &RenderSettings) -> Tile {
    /// The golden ratio's inverse: heights are spread evenly, whatever the number of strips.
    const GOLDEN: f64 = 0.618_033_988_749_894_8;
    let shape = PacketShape::for_samples(settings.spp);
    let packets = tile.width.div_ceil(shape.block) * settings.spp.div_ceil(shape.samples);
    let height = (BATCH as u32).div_ceil(packets) * shape.block;
    let height = height.min(TILE).min(tile.height);
    // Blocks of a whole tile begin at multiples of their side.
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
    fn strips_lie_in_their_tiles_and_fill_a_batch_if_the_tile_can() {
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
