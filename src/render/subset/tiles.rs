//! Evenly distributed subset of the tiles of an image, for measurements that do not render all of it.
//!
//! Tiles are ordered by the first point of Roberts' R2 sequence (M. Roberts, "The Unreasonable Effectiveness of
//! Quasirandom Sequences", 2018) that falls into them, so any number of first tiles is evenly distributed. Their
//! pixels have the same bits as in the whole image.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use super::super::context::RenderContext;
use super::super::film::{TileResult, filtered_image};
use super::super::monitor::{Cancelled, Monitor};
use super::super::plan::Plan;
use super::super::profile::RenderProfile;
use super::super::settings::RenderSettings;
use super::super::tile::{TILE, Tile, tiles};
use super::super::wavefront::RendererPool;
use crate::accel::Accel;
use crate::image::LinearImage;
use crate::parallel;
use crate::processor_time::thread_seconds;
use crate::scene::{Camera, ValidScene};

/// Rendered tile of an image.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct SampledTile {
    /// Column of the left pixels in the whole image.
    pub x: u32,
    /// Row of the top pixels in the whole image.
    pub y: u32,
    /// Pixels of the tile. With a filter that needs neighbouring tiles, pixels near them are left out.
    pub image: LinearImage,
    /// Processor time in seconds that its thread needed; wall-clock time if the system does not provide it.
    pub seconds: f64,
}

/// Subset of the tiles of an image, with its statistics.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct TileSample {
    /// Tiles in the order of their selection.
    pub tiles: Vec<SampledTile>,
    /// Numbers of rays and seconds of these tiles alone.
    pub ledger: RenderProfile,
    /// Effects that were simulated, with the reason for each.
    pub plan: Plan,
}

impl TileSample {
    /// Returns the sum of [`SampledTile::seconds`] over all tiles.
    pub fn seconds(&self) -> f64 {
        self.tiles.iter().map(|tile| tile.seconds).sum()
    }
}

/// Returns the number of tiles of an image.
pub fn tile_count(width: u32, height: u32) -> usize {
    width.div_ceil(TILE) as usize * height.div_ceil(TILE) as usize
}

/// Renders `count` tiles, or all if there are fewer, in the current rayon pool.
///
/// Every pixel gets all of its samples: [`RenderSettings::adaptive`] and [`RenderSettings::edge_contrast`] are ignored, as
/// are all AOVs. `accel` must have been built from `scene`.
pub fn render_sample(
    (scene, camera): (ValidScene, &Camera),
    accel: &dyn Accel,
    settings: &RenderSettings,
    count: usize,
    monitor: &Monitor,
) -> Result<TileSample, Cancelled> {
    let start = Instant::now();
    let settings = RenderSettings {
        adaptive: None,
        edge_contrast: None,
        ..settings.without_aovs()
    };
    let mut frame = RenderContext::new(scene.get(), camera, accel, &settings);
    // The cost of subsurface scattering belongs to the whole image, not to these tiles.
    frame.prepare_light(monitor)?;
    // Select the tiles
    let chosen = chosen_tiles(&settings, count);
    let finished = AtomicUsize::new(0);
    let waves = RendererPool::new(&frame);
    // Render them in parallel, each with its processor time
    let render = |index: usize| {
        monitor.check()?;
        let (tile, mut wave) = (chosen[index], waves.acquire());
        let start = thread_seconds();
        let (result, ledger) = wave.render_tile(tile, None);
        let seconds = thread_seconds() - start;
        let finished = finished.fetch_add(1, Ordering::Relaxed) + 1;
        (monitor.progress)(finished as f64 / chosen.len() as f64);
        let inner = inner(tile, &settings);
        let sampled = SampledTile {
            x: inner.x,
            y: inner.y,
            image: pixels(tile, inner, result, &settings),
            seconds,
        };
        Ok((sampled, ledger))
    };
    // Merge the ledgers in the order of the tiles
    let rendered: Result<Vec<_>, Cancelled> = parallel::map(chosen.len(), &render).into_iter().collect();
    let (tiles, ledgers): (Vec<_>, Vec<_>) = rendered?.into_iter().unzip();
    let mut ledger = RenderProfile::default();
    ledgers.into_iter().for_each(|of_tile| ledger += of_tile);
    ledger.seconds = start.elapsed().as_secs_f64();
    Ok(TileSample {
        tiles,
        ledger,
        plan: frame.plan.clone(),
    })
}

/// Returns the cells of a grid of `columns` by `rows`, numbered row by row, in an order in which any number of first
/// cells is evenly distributed.
pub(in crate::render) fn spread([columns, rows]: [usize; 2]) -> impl Iterator<Item = usize> {
    /// Powers of the inverse of the plastic number, which is the root of x³ = x + 1.
    const R2: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];
    /// Number of R2 points per cell after which few cells are left, which then follow row by row.
    const POINTS_PER_CELL: usize = 8;
    let count = columns * rows;
    let of_point = move |k: usize| {
        let cell = |axis: usize, cells: usize| ((0.5 + k as f64 * R2[axis]).fract() * cells as f64) as usize;
        cell(1, rows) * columns + cell(0, columns)
    };
    let mut chosen = vec![false; count];
    // Skip points in cells that are chosen already, then append the remaining cells
    let order = (0..POINTS_PER_CELL * count).map(of_point).chain(0..count);
    order.filter(move |&index| !std::mem::replace(&mut chosen[index], true))
}

/// Returns the first `count` tiles in the order of the subset.
pub(in crate::render) fn chosen_tiles(settings: &RenderSettings, count: usize) -> Vec<Tile> {
    let all = tiles(settings.width, settings.height);
    let columns = settings.width.div_ceil(TILE) as usize;
    spread([columns, all.len() / columns])
        .map(|index| all[index])
        .filter(|&tile| inner(tile, settings).width > 0 && inner(tile, settings).height > 0)
        .take(count)
        .collect()
}

/// Returns the pixels of a tile that no sample of another tile affects.
pub(in crate::render) fn inner(tile: Tile, settings: &RenderSettings) -> Tile {
    let reach = settings.reach();
    let along = |start: u32, size: u32, end: u32| {
        // There are no neighbouring tiles at the edges of the image.
        let before = if start > 0 { reach } else { 0 };
        let behind = if start + size < end { reach } else { 0 };
        (start + before, size.saturating_sub(before + behind))
    };
    let (x, width) = along(tile.x, tile.width, settings.width);
    let (y, height) = along(tile.y, tile.height, settings.height);
    Tile { x, y, width, height }
}

/// Returns the pixels of a rendered tile inside `inner`, filtered if necessary.
pub(in crate::render) fn pixels(
    tile: Tile,
    inner: Tile,
    result: TileResult,
    settings: &RenderSettings,
) -> LinearImage {
    let mut means = result.means.clone();
    // Filter the tile by itself
    if !settings.filter.is_box() {
        let alone = Tile { x: 0, y: 0, ..tile };
        filtered_image::assemble(tile.width, &mut means, &[(alone, result)]);
    }
    // Crop it to the inner pixels
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
    fn tiles_are_sampled_without_repetition() {
        for (width, height) in [(1, 1), (33, 70), (640, 480), (3000, 20)] {
            let chosen = chosen_tiles(&settings(width, height), usize::MAX);
            assert_eq!(chosen.len(), tile_count(width, height));
            let area: u32 = chosen.iter().map(|tile| tile.width * tile.height).sum();
            assert_eq!(area, width * height);
        }
    }

    #[test]
    fn few_tiles_cover_all_quarters() {
        // 16 of 1024: four per quarter if perfectly even, off by at most one or two.
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
