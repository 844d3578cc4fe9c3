//! Drivers of a render: preparation, tiles in parallel, and assembly of the image.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use super::adaptive::{self, Adaptive, Checkpoints};
use super::aov::{AovBuffers, PixelCostBuffer, layer};
use super::context::RenderContext;
use super::edge_contrast;
use super::film::{
    SampleAovs, SampleCounts, SharedImage, TileResult, filtered_image, tile_result, transparency,
};
use super::monitor::{Cancelled, Monitor};
use super::profile::{Category, Profiler, RenderProfile, Tally};
use super::result::Rendering;
use super::settings::RenderSettings;
use super::subset::{Cover, PatchAtlas, Region, image_error};
use super::tile::Tile;
use super::wavefront::RendererPool;
use crate::accel::Accel;
use crate::image::LinearImage;
use crate::parallel;
use crate::scene::{Camera, ValidScene};

/// Renders `scene` as seen by `camera`, in the current rayon pool.
///
/// `accel` must have been built from `scene`.
pub fn render(
    scene: ValidScene,
    camera: &Camera,
    accel: &dyn Accel,
    settings: &RenderSettings,
    monitor: &Monitor,
) -> Result<Rendering, Cancelled> {
    render_on(scene, camera, accel, settings, monitor, None)
}

/// Renders as [`render`] does and, with adaptive sampling, resumes from and writes `checkpoints`.
///
/// Images without adaptive sampling are resumed by [`Parts`](super::Parts) instead. Pixel costs are not part of a checkpoint, so
/// they count only the work after it.
pub fn render_on(
    scene: ValidScene,
    camera: &Camera,
    accel: &dyn Accel,
    settings: &RenderSettings,
    monitor: &Monitor,
    checkpoints: Option<&mut Checkpoints>,
) -> Result<Rendering, Cancelled> {
    // Prepare the scene and the light that all tiles share
    let start = Instant::now();
    let mut frame = RenderContext::new(scene.get(), camera, accel, settings);
    let setup_seconds = settings.ledger.then(|| start.elapsed().as_secs_f64());
    let scattered = frame.prepare_light(monitor)?;
    let ready_seconds = start.elapsed().as_secs_f64();
    // Render the image with adaptive sample counts or those that contrast and settings give
    let mut rendering = match settings.target() {
        Some(target) => render_adaptively(&mut frame, target, monitor, checkpoints)?,
        None => render_region(&mut frame, &Region::whole(settings), monitor)?,
    };
    rendering.ready_seconds = ready_seconds;
    rendering.subsurface = frame.bodies.as_ref().map(|bodies| bodies.stats);
    // Account for the preparation and finish the statistics
    let ledger = &mut rendering.ledger;
    *ledger += scattered;
    let setting_up = Tally {
        rays: frame.probe_count,
        seconds: setup_seconds.unwrap_or(0.0),
        trace_seconds: 0.0,
    };
    ledger.book(Category::Other, setting_up);
    ledger.settle(rayon::current_num_threads(), start.elapsed().as_secs_f64());
    rendering.memory = frame.memory();
    rendering.costs = frame.costs.take().map(PixelCostBuffer::finish);
    // Estimate the error
    if let Some(exposure) = settings.error_exposure {
        let stops = exposure.stops(&rendering.image, rendering.alpha.as_deref());
        let taken = rendering.samples.mean;
        rendering.error = Some(image_error(frame, (&rendering.image, taken), stops, monitor)?);
    }
    Ok(rendering)
}

/// Renders a rectangle, with `spp` samples in every pixel or in those at edges.
pub(super) fn render_region(
    frame: &mut RenderContext,
    region: &Region,
    monitor: &Monitor,
) -> Result<Rendering, Cancelled> {
    match frame.settings.contrast() {
        Some(contrast) => edge_contrast::render(frame, contrast, region, monitor),
        None => render_uniformly(frame, region, monitor),
    }
}

/// Renders a rectangle with `spp` samples in every pixel.
fn render_uniformly(
    frame: &RenderContext,
    region: &Region,
    monitor: &Monitor,
) -> Result<Rendering, Cancelled> {
    let settings = &frame.settings;
    // Allocate the AOVs, which the tiles write directly
    let cover = Cover::of(region, settings);
    let mut layers = layer::blank(settings.layers, region);
    layers.extend(frame.light_sheet.blank(region));
    let planes = AovBuffers::over(&mut layers, region);
    // Render all tiles that the region touches
    let (CoverResult { mut pixels, tiles }, mut ledger) =
        render_cover(frame, &cover, Some(&planes), monitor)?;
    drop(planes);
    // Add the samples of neighbouring pixels
    let [width, height] = cover.size();
    let mut meter = Profiler::new(settings);
    if !settings.filter.is_box() {
        filtered_image::assemble(width, &mut pixels, &tiles);
    }
    let aovs = || {
        SampleAovs::of(
            &cover.cut(tile_result::assemble(width, height, &tiles, &|result| {
                &result.estimates
            })),
        )
    };
    let aovs = settings.sample_aovs.then(aovs);
    // Compute the coverage, for which the films of the tiles are no longer needed
    let alpha = transparency::coverage([width, height], tiles, settings).map(|alpha| cover.cut(alpha));
    meter.lap_all_threads(Category::Film);
    ledger += meter.ledger;
    let image = LinearImage {
        width: region.width,
        height: region.height,
        pixels: cover.cut(pixels),
    };
    let samples = SampleCounts::uniform(region.pixel_count(), settings.spp);
    Ok(Rendering {
        aovs,
        alpha,
        layers,
        ..Rendering::new(image, samples, ledger, frame)
    })
}

/// Results of the tiles of a cover.
pub(super) struct CoverResult {
    /// Means of the pixels of the cover.
    pub(super) pixels: Vec<[f32; 3]>,
    /// All else, with positions relative to the cover.
    pub(super) tiles: Vec<(Tile, TileResult)>,
}

/// Renders the tiles of a cover, and returns their results and the ledger; AOVs are written to `planes`.
pub(super) fn render_cover(
    frame: &RenderContext,
    cover: &Cover,
    planes: Option<&AovBuffers>,
    monitor: &Monitor,
) -> Result<(CoverResult, RenderProfile), Cancelled> {
    let [width, height] = cover.size();
    let mut pixels = vec![[0.0; 3]; width as usize * height as usize];
    let image = SharedImage::over(&mut pixels, cover.corner(), width);
    let (tiles, ledger) = render_tiles(frame, &cover.tiles, Some(&image), planes, monitor)?;
    drop(image);
    let tiles = cover.placed(tiles);
    Ok((CoverResult { pixels, tiles }, ledger))
}

/// Renders `tiles` and returns them in order. Their means are written to `image`, if there is one, and are then no part of
/// the results; their AOVs are written to `planes`.
pub(super) fn render_tiles(
    frame: &RenderContext,
    tiles: &[Tile],
    image: Option<&SharedImage>,
    planes: Option<&AovBuffers>,
    monitor: &Monitor,
) -> Result<(Vec<(Tile, TileResult)>, RenderProfile), Cancelled> {
    let finished = AtomicUsize::new(0);
    // Render tiles in parallel with pooled working memory
    let waves = RendererPool::new(frame);
    let render_tile = |index: usize| {
        // Stop between tiles if the render is cancelled
        monitor.check()?;
        let tile = tiles[index];
        let (mut result, ledger) = waves.acquire().render_tile(tile, planes);
        // Report the finished tile
        monitor.show(tile, &result.means);
        if let Some(image) = image {
            image.put(tile, &std::mem::take(&mut result.means));
        }
        let finished = finished.fetch_add(1, Ordering::Relaxed) + 1;
        (monitor.progress)(finished as f64 / tiles.len() as f64);
        Ok(((tile, result), ledger))
    };
    let rendered = parallel::map(tiles.len(), &render_tile);
    drop(waves);
    merged(rendered)
}

/// Returns the results of tiles and the sum of their ledgers, in the order of the tiles.
pub(super) fn merged<T>(
    rendered: Vec<Result<(T, RenderProfile), Cancelled>>,
) -> Result<(Vec<T>, RenderProfile), Cancelled> {
    let mut ledger = RenderProfile::default();
    let mut results = Vec::with_capacity(rendered.len());
    for tile in rendered {
        let (result, tile_ledger) = tile?;
        ledger += tile_ledger;
        results.push(result);
    }
    Ok((results, ledger))
}

/// Renders with adaptive sampling, in rounds, until each pixel reaches its target error.
fn render_adaptively(
    frame: &mut RenderContext,
    target: Adaptive,
    monitor: &Monitor,
    checkpoints: Option<&mut Checkpoints>,
) -> Result<Rendering, Cancelled> {
    // Sample the whole image as one canvas
    let canvas = PatchAtlas::whole(&frame.settings);
    let (estimates, ledger) = adaptive::render(frame, target, &canvas, monitor, checkpoints)?;
    let settings = &frame.settings;
    // Convert estimates to pixels
    let to_pixel = |index: usize| estimates[index].mean().map(|channel| channel as f32);
    let image = LinearImage {
        width: settings.width,
        height: settings.height,
        pixels: parallel::generate(estimates.len(), to_pixel),
    };
    Ok(Rendering {
        aovs: settings.sample_aovs.then(|| SampleAovs::of(&estimates)),
        ..Rendering::new(image, SampleCounts::of(&estimates), ledger, frame)
    })
}
