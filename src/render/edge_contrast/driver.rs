//! Driver of supersampling by contrast.

use std::sync::atomic::{AtomicUsize, Ordering};

use super::super::context::RenderContext;
use super::super::driver::merged;
use super::super::film::{SampleAovs, SampleCounts, TileResult};
use super::super::monitor::{Cancelled, Monitor};
use super::super::profile::{Category, Profiler, RenderProfile};
use super::super::result::Rendering;
use super::super::subset::{Cover, Region};
use super::super::tile::Tile;
use super::super::wavefront::{RendererPool, block_corners, block_pixels};
use super::first_samples::{FIRST_FRACTION, FirstSamples};
use super::limit::EdgeContrast;
use crate::image::LinearImage;
use crate::parallel;

/// Tile with the corners, within it, of the blocks of pixels that take all samples.
struct EdgeTile {
    tile: Tile,
    corners: Vec<(u32, u32)>,
}

impl EdgeTile {
    /// Returns the columns and rows, within the tile, of the pixels that take all samples.
    fn pixels(&self, frame: &RenderContext) -> impl Iterator<Item = [u32; 2]> {
        let blocks = self.corners.iter();
        blocks.flat_map(|&corner| block_pixels(frame, self.tile, corner))
    }

    /// Returns the index of a pixel among those of the tile, row by row.
    fn index(&self, [x, y]: [u32; 2]) -> usize {
        (y * self.tile.width + x) as usize
    }
}

/// Renders a rectangle: the pixels at edges with `spp` samples of the settings, all others with one.
pub(in crate::render) fn render(
    frame: &mut RenderContext,
    contrast: EdgeContrast,
    region: &Region,
    monitor: &Monitor,
) -> Result<Rendering, Cancelled> {
    let settings = frame.settings;
    // Take one sample of each pixel of the rectangle and around it
    frame.set_spp(1);
    let first = FirstSamples::render(frame, region, contrast.exposure, monitor);
    frame.set_spp(settings.spp);
    let first = first?;
    // Find the pixels at edges
    let mut meter = Profiler::new(&settings);
    let tiles = Cover::of(region, &settings).tiles;
    let edges = parallel::map(tiles.len(), &|index| {
        let tile = tiles[index];
        let is_edge = first.edges(tile, contrast.limit as f32);
        let is_at_edge = |&corner: &(u32, u32)| {
            block_pixels(frame, tile, corner).any(|[x, y]| is_edge[y as usize][x as usize])
        };
        EdgeTile {
            tile,
            corners: block_corners(frame, tile).filter(is_at_edge).collect(),
        }
    });
    let edges: Vec<EdgeTile> = edges
        .into_iter()
        .filter(|edge| !edge.corners.is_empty())
        .collect();
    meter.lap_all_threads(Category::Sampling);
    // Take all samples of these, and put them in place of the first
    let (results, mut ledger) = supersample(frame, &edges, &first, monitor)?;
    meter.skip();
    let FirstSamples {
        cover,
        image: LinearImage { mut pixels, .. },
        mut estimates,
        ledger: first_ledger,
        ..
    } = first;
    let mut edge_count = 0;
    for (edge, result) in edges.iter().zip(results) {
        for [x, y] in edge.pixels(frame) {
            let place = [edge.tile.x + x, edge.tile.y + y];
            let (from, to) = (edge.index([x, y]), cover.index(place));
            pixels[to] = result.means[from];
            if settings.sample_aovs {
                estimates[to] = result.estimates[from];
            }
            edge_count += u64::from(region.contains(place));
        }
    }
    let image = LinearImage {
        width: region.width,
        height: region.height,
        pixels: cover.cut(pixels),
    };
    let aovs = settings
        .sample_aovs
        .then(|| SampleAovs::of(&cover.cut(estimates)));
    meter.lap_all_threads(Category::Film);
    ledger += first_ledger;
    ledger += meter.ledger;
    let samples = SampleCounts::of_edges(region.pixel_count(), edge_count, settings.spp);
    Ok(Rendering {
        aovs,
        ..Rendering::new(image, samples, ledger, frame)
    })
}

/// Renders the pixels at edges with all samples; returns the results of their tiles, in order, and the ledger.
fn supersample(
    frame: &RenderContext,
    edges: &[EdgeTile],
    first: &FirstSamples,
    monitor: &Monitor,
) -> Result<(Vec<TileResult>, RenderProfile), Cancelled> {
    let sizes: Vec<usize> = edges.iter().map(|edge| edge.corners.len()).collect();
    let all: usize = sizes.iter().sum();
    let finished = AtomicUsize::new(0);
    let waves = RendererPool::new(frame);
    let rendered = parallel::map_largest_first(&sizes, &|index| {
        // Stop between tiles if the render is cancelled
        monitor.check()?;
        let edge = &edges[index];
        let mut corners = edge.corners.iter().copied();
        let (result, ledger) = waves.acquire().render_blocks(edge.tile, &mut corners, None);
        // Report the finished tile
        if monitor.tiles.is_some() {
            let mut means = first.means(edge.tile);
            for pixel in edge.pixels(frame) {
                means[edge.index(pixel)] = result.means[edge.index(pixel)];
            }
            monitor.show(edge.tile, &means);
        }
        let finished = finished.fetch_add(sizes[index], Ordering::Relaxed) + sizes[index];
        let share = finished as f64 / all as f64;
        (monitor.progress)(FIRST_FRACTION + (1.0 - FIRST_FRACTION) * share);
        Ok((result, ledger))
    });
    drop(waves);
    merged(rendered)
}
