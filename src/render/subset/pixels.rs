//! Render of chosen pixels of an image.

use super::super::context::RenderContext;
use super::super::film::TileResult;
use super::super::monitor::{Cancelled, Monitor};
use super::super::settings::RenderSettings;
use super::super::tile::{Tile, tiles};
use super::super::wavefront::{RendererPool, block_corners, block_pixels};
use crate::accel::Accel;
use crate::image::LinearImage;
use crate::parallel;
use crate::scene::{Camera, ValidScene};

/// Renders the chosen pixels of the image that `settings` describe, in the current rayon pool; the others are black.
///
/// `is_chosen` marks pixels row by row, the top row first. They have the same bits as in the whole image, provided that its
/// filter is a box; [`RenderSettings::adaptive`], [`RenderSettings::edge_contrast`] and all AOVs are ignored. `accel` must
/// have been built from `scene`.
///
/// # Errors
///
/// Returns an error on cancellation.
pub fn render_pixels(
    (scene, camera): (ValidScene, &Camera),
    accel: &dyn Accel,
    settings: &RenderSettings,
    is_chosen: &[bool],
    monitor: &Monitor,
) -> Result<LinearImage, Cancelled> {
    let RenderSettings { width, height, .. } = *settings;
    debug_assert_eq!(is_chosen.len(), width as usize * height as usize);
    // Prepare the scene
    let settings = RenderSettings {
        adaptive: None,
        edge_contrast: None,
        ..settings.without_aovs()
    };
    debug_assert_eq!(settings.reach(), 0, "neighbours would be missing");
    let mut frame = RenderContext::new(scene.get(), camera, accel, &settings);
    frame.prepare_light(monitor)?;
    let frame = &frame;
    // Render the blocks of each tile that contain chosen pixels
    let is_wanted = |tile: Tile, [x, y]: [u32; 2]| is_chosen[index(width, tile, [x, y])];
    let tiles = tiles(width, height);
    let pool = RendererPool::new(frame);
    let rendered: Result<Vec<Option<TileResult>>, Cancelled> = parallel::map(tiles.len(), &|number| {
        monitor.check()?;
        let tile = tiles[number];
        let mut corners = block_corners(frame, tile)
            .filter(|&corner| block_pixels(frame, tile, corner).any(|pixel| is_wanted(tile, pixel)))
            .peekable();
        Ok(corners
            .peek()
            .is_some()
            .then(|| pool.acquire().render_blocks(tile, &mut corners, None).0))
    })
    .into_iter()
    .collect();
    // Copy the chosen pixels
    let mut image = LinearImage {
        width,
        height,
        pixels: vec![[0.0; 3]; is_chosen.len()],
    };
    for (&tile, result) in tiles.iter().zip(rendered?) {
        let Some(result) = result else { continue };
        for (from, &mean) in result.means.iter().enumerate() {
            let pixel = [from as u32 % tile.width, from as u32 / tile.width];
            if is_wanted(tile, pixel) {
                image.pixels[index(width, tile, pixel)] = mean;
            }
        }
    }
    Ok(image)
}

/// Returns the index of a pixel of a tile in an image of this width.
fn index(width: u32, tile: Tile, [x, y]: [u32; 2]) -> usize {
    (tile.y + y) as usize * width as usize + (tile.x + x) as usize
}
