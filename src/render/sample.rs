//! A few tiles of a picture, spread evenly over it, for measurements that need not wait for all of it.
//!
//! Tiles come in the order in which the points of Roberts' R2 sequence (M. Roberts, "The Unreasonable Effectiveness of
//! Quasirandom Sequences", 2018) first fall onto them, so any first few are spread evenly. Their pixels have the bits
//! that they have in the whole picture.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use super::film::{TILE, Tile, tiles};
use super::wave::{TilePicture, Waves};
use super::{Frame, LayerSet, Ledger, LightLayers, Monitor, Plan, RenderSettings, filter};
use crate::accel::Accel;
use crate::image::LinearImage;
use crate::parallel;
use crate::scene::{Camera, Scene};

/// A part of a picture.
#[derive(Clone, Debug)]
pub struct SampledTile {
    /// Column of its left pixels in the whole picture.
    pub x: u32,
    /// Row of its top pixels.
    pub y: u32,
    /// Its pixels. A filter that takes from neighbouring tiles leaves those near them out.
    pub image: LinearImage,
    /// Seconds of processor time that its thread took for it; of wall-clock time where the system does not tell.
    pub seconds: f64,
}

/// Some tiles of a picture and what they took.
#[derive(Clone, Debug)]
pub struct TileSample {
    /// In the order of their choice.
    pub tiles: Vec<SampledTile>,
    /// Rays and seconds of these tiles alone.
    pub ledger: Ledger,
    /// What was simulated.
    pub plan: Plan,
}

impl TileSample {
    /// [`SampledTile::seconds`] of all tiles.
    pub fn seconds(&self) -> f64 {
        self.tiles.iter().map(|tile| tile.seconds).sum()
    }
}

/// How many tiles a picture has.
pub fn tile_count(width: u32, height: u32) -> usize {
    width.div_ceil(TILE) as usize * height.div_ceil(TILE) as usize
}

/// Renders `count` tiles, or all if there are fewer, in the current rayon pool. `None` if it was cancelled.
///
/// Every pixel gets all of its samples: [`RenderSettings::adaptive`] is ignored, as are [`RenderSettings::sample_aovs`]
/// and [`RenderSettings::layers`]. `scene` must have passed [`Scene::validate`], and `accel` must have been built from
/// it.
pub fn render_sample(
    (scene, camera): (&Scene, &Camera),
    accel: &dyn Accel,
    settings: &RenderSettings,
    count: usize,
    monitor: &Monitor,
) -> Option<TileSample> {
    let start = Instant::now();
    let settings = RenderSettings {
        adaptive: None,
        sample_aovs: false,
        layers: LayerSet::NONE,
        light_layers: LightLayers::NONE,
        ..*settings
    };
    let mut frame = Frame::new(scene, camera, accel, &settings);
    // What it takes is the whole picture's, not these tiles'.
    frame.scatter(monitor)?;
    let chosen = chosen_tiles(&settings, count);
    let finished = AtomicUsize::new(0);
    let waves = Waves::new(&frame);
    let render = |index: usize| {
        if monitor.cancel.load(Ordering::Relaxed) {
            return None;
        }
        let (tile, mut wave) = (chosen[index], waves.lend());
        let start = thread_seconds();
        let (picture, ledger) = wave.render_tile(tile, None);
        let seconds = thread_seconds() - start;
        let finished = finished.fetch_add(1, Ordering::Relaxed) + 1;
        (monitor.progress)(finished as f64 / chosen.len() as f64);
        let inner = inner(tile, &settings);
        let sampled = SampledTile {
            x: inner.x,
            y: inner.y,
            image: pixels(tile, inner, picture, &settings),
            seconds,
        };
        Some((sampled, ledger))
    };
    let rendered: Option<Vec<_>> = parallel::map(chosen.len(), &render).into_iter().collect();
    let (tiles, ledgers): (Vec<_>, Vec<_>) = rendered?.into_iter().unzip();
    let mut ledger = Ledger::default();
    ledgers.into_iter().for_each(|of_tile| ledger += of_tile);
    ledger.seconds = start.elapsed().as_secs_f64();
    Some(TileSample {
        tiles,
        ledger,
        plan: frame.plan.clone(),
    })
}

/// Processor time of this thread so far: what other programs do meanwhile is not in it.
#[cfg(target_os = "linux")]
pub(super) fn thread_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Time since the first call.
#[cfg(not(target_os = "linux"))]
pub(super) fn thread_seconds() -> f64 {
    use std::sync::LazyLock;
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    START.elapsed().as_secs_f64()
}

/// The cells of a grid of `columns` by `rows`, numbered row by row, in an order in which any first few are spread evenly.
pub(super) fn spread([columns, rows]: [usize; 2]) -> impl Iterator<Item = usize> {
    /// Powers of the inverse of the plastic number, the root of x³ = x + 1.
    const R2: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];
    /// R2 points for each cell after which few are left, which then follow row by row.
    const POINTS_PER_CELL: usize = 8;
    let count = columns * rows;
    let of_point = move |k: usize| {
        let cell = |axis: usize, cells: usize| ((0.5 + k as f64 * R2[axis]).fract() * cells as f64) as usize;
        cell(1, rows) * columns + cell(0, columns)
    };
    let mut chosen = vec![false; count];
    let order = (0..POINTS_PER_CELL * count).map(of_point).chain(0..count);
    order.filter(move |&index| !std::mem::replace(&mut chosen[index], true))
}

/// The first `count` tiles in the order of the sample.
pub(super) fn chosen_tiles(settings: &RenderSettings, count: usize) -> Vec<Tile> {
    let all = tiles(settings.width, settings.height);
    let columns = settings.width.div_ceil(TILE) as usize;
    spread([columns, all.len() / columns])
        .map(|index| all[index])
        .filter(|&tile| inner(tile, settings).width > 0 && inner(tile, settings).height > 0)
        .take(count)
        .collect()
}

/// Pixels from its own up to which a sample is seen; adaptive sampling takes every filter for a box.
pub(super) fn reach(settings: &RenderSettings) -> u32 {
    if settings.filter.is_box() || settings.target().is_some() {
        0
    } else {
        settings.filter.reach() as u32
    }
}

/// The pixels of a tile that no other tile's samples reach.
fn inner(tile: Tile, settings: &RenderSettings) -> Tile {
    let reach = reach(settings);
    let along = |start: u32, size: u32, end: u32| {
        let before = if start > 0 { reach } else { 0 };
        let behind = if start + size < end { reach } else { 0 };
        (start + before, size.saturating_sub(before + behind))
    };
    let (x, width) = along(tile.x, tile.width, settings.width);
    let (y, height) = along(tile.y, tile.height, settings.height);
    Tile { x, y, width, height }
}

/// What `inner` shows of a rendered tile.
pub(super) fn pixels(
    tile: Tile,
    inner: Tile,
    picture: TilePicture,
    settings: &RenderSettings,
) -> LinearImage {
    let mut means = picture.means.clone();
    if !settings.filter.is_box() {
        let alone = Tile { x: 0, y: 0, ..tile };
        filter::assemble(tile.width, &mut means, &[(alone, picture)]);
    }
    let rows = means.chunks(tile.width as usize);
    let rows = rows.skip((inner.y - tile.y) as usize).take(inner.height as usize);
    let first = (inner.x - tile.x) as usize;
    LinearImage {
        width: inner.width,
        height: inner.height,
        pixels: rows
            .flat_map(|row| &row[first..first + inner.width as usize])
            .copied()
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(width: u32, height: u32) -> RenderSettings {
        RenderSettings {
            width,
            height,
            ..RenderSettings::default()
        }
    }

    #[test]
    fn all_tiles_are_chosen_once_before_any_comes_again() {
        for (width, height) in [(1, 1), (33, 70), (640, 480), (3000, 20)] {
            let chosen = chosen_tiles(&settings(width, height), usize::MAX);
            assert_eq!(chosen.len(), tile_count(width, height));
            let area: u32 = chosen.iter().map(|tile| tile.width * tile.height).sum();
            assert_eq!(area, width * height);
        }
    }

    #[test]
    fn a_few_tiles_lie_in_all_quarters() {
        // 16 of 1024: four a quarter if spread evenly, off by one or two of them at most.
        let chosen = chosen_tiles(&settings(1024, 1024), 16);
        let mut quarters = [0; 4];
        for tile in chosen {
            quarters[(2 * (tile.y / 512) + tile.x / 512) as usize] += 1;
        }
        assert!(
            quarters.iter().all(|count| (2..=6).contains(count)),
            "{quarters:?}"
        );
    }
}
