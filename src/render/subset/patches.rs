//! Patch sampling: small patches of an image side by side, from which its error and render time are estimated.
//!
//! Patches are evenly distributed over the image, and their pixels have the same bits as in it, except with adaptive
//! sampling, which decides by the visible pixels alone.

use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::super::adaptive;
use super::super::context::RenderContext;
use super::super::driver::render_tiles;
use super::super::film::SampleCounts;
use super::super::monitor::{Cancelled, Monitor};
use super::super::result::Rendering;
use super::super::settings::RenderSettings;
use super::super::tile::Tile;
use super::patch_atlas::{Patch, PatchAtlas};
use super::region::Region;
use super::tiles::{pixels, spread};
use crate::accel::Accel;
use crate::image::LinearImage;
use crate::scene::{Camera, ValidScene};

/// Side of a patch in pixels: many small patches represent an image better than few large ones, but rays need
/// coherent neighbours.
const PATCH_SIDE: u32 = 16;

/// Grid of patches, by its numbers of columns and rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PatchGrid {
    /// Number of patches per row.
    pub columns: u32,
    /// Number of rows of patches.
    pub rows: u32,
}

impl PatchGrid {
    /// Returns a grid of patches with about `pixels` pixels in all; `None` if the image has hardly more.
    pub fn of(settings: &RenderSettings, pixels: f64) -> Option<PatchGrid> {
        let side = f64::from(side(settings));
        let [columns, rows] = complete_patches(settings);
        let wanted = (pixels / (side * side)).round().max(1.0);
        if wanted >= f64::from(columns) * f64::from(rows) {
            return None;
        }
        // Choose a nearly square grid with at most the wanted number
        let columns = wanted.sqrt().floor();
        Some(PatchGrid {
            columns: columns as u32,
            rows: (wanted / columns).floor() as u32,
        })
    }

    /// Returns the width and height of all patches together, in pixels.
    pub fn size(&self, settings: &RenderSettings) -> [u32; 2] {
        [self.columns, self.rows].map(|count| count * side(settings))
    }

    /// Returns the patches in their order on the grid, row by row.
    fn patches(&self, settings: &RenderSettings) -> Vec<Tile> {
        let grid = complete_patches(settings);
        let patch = |index: usize| {
            let [x, y] = [index as u32 % grid[0], index as u32 / grid[0]].map(|cell| cell * PATCH_SIDE);
            Tile {
                x,
                y,
                width: PATCH_SIDE,
                height: PATCH_SIDE,
            }
        };
        let count = self.columns as usize * self.rows as usize;
        // Take the first cells of an evenly distributed order
        spread(grid.map(|cells| cells as usize))
            .take(count)
            .map(patch)
            .collect()
    }

    /// Returns the patches of `rendered`, an image that was rendered with `settings`, as one image.
    pub fn of_picture(&self, settings: &RenderSettings, rendered: &LinearImage) -> LinearImage {
        let mut image = self.blank(settings);
        let (reach, side) = (settings.reach(), side(settings));
        // Copy the visible part of each patch
        for (number, tile) in self.patches(settings).into_iter().enumerate() {
            let row = |y: u32| {
                let first =
                    (tile.y + reach + y) as usize * rendered.width as usize + (tile.x + reach) as usize;
                &rendered.pixels[first..first + side as usize]
            };
            let pixels: Vec<[f32; 3]> = (0..side).flat_map(row).copied().collect();
            put(&mut image, self.grid_position(number), side, &pixels);
        }
        image
    }

    fn blank(&self, settings: &RenderSettings) -> LinearImage {
        let [width, height] = self.size(settings);
        LinearImage {
            width,
            height,
            pixels: vec![[0.0; 3]; width as usize * height as usize],
        }
    }

    /// Returns the column and row of a patch in the grid.
    fn grid_position(&self, number: usize) -> [usize; 2] {
        let columns = self.columns as usize;
        [number % columns, number / columns]
    }

    fn canvas(&self, patches: &[Tile]) -> PatchAtlas {
        let apart = PATCH_SIDE as usize + 1;
        let site = |(number, &tile): (usize, &Tile)| Patch {
            tile,
            at: self
                .grid_position(number)
                .map(|grid_position| grid_position * apart),
        };
        PatchAtlas {
            size: [self.columns, self.rows].map(|count| count as usize * apart),
            sites: patches.iter().enumerate().map(site).collect(),
        }
    }
}

/// Returns the side of the visible part of a patch: pixels that the filter would mix with other patches are left out.
fn side(settings: &RenderSettings) -> u32 {
    PATCH_SIDE - 2 * settings.reach()
}

/// Returns the number of complete patches in the image, horizontally and vertically.
fn complete_patches(settings: &RenderSettings) -> [u32; 2] {
    [settings.width / PATCH_SIDE, settings.height / PATCH_SIDE]
}

/// Renders the patches of the image that `settings` describe, in the current rayon pool.
///
/// [`RenderSettings::edge_contrast`] and all AOVs are ignored. `accel` must have been built from `scene`.
pub fn render_patches(
    (scene, camera): (ValidScene, &Camera),
    accel: &dyn Accel,
    settings: &RenderSettings,
    mosaic: PatchGrid,
    monitor: &Monitor,
) -> Result<Rendering, Cancelled> {
    let start = Instant::now();
    let settings = RenderSettings {
        edge_contrast: None,
        ..settings.without_aovs()
    };
    // Prepare the scene
    let mut frame = RenderContext::new(scene.get(), camera, accel, &settings);
    let scattered = frame.prepare_light(monitor)?;
    let ready_seconds = start.elapsed().as_secs_f64();
    let patches = mosaic.patches(&settings);
    let mut image = mosaic.blank(&settings);
    let (samples, mut ledger) = match settings.target() {
        Some(target) => {
            // Sample the canvas adaptively and copy its patches
            let canvas = mosaic.canvas(&patches);
            let (estimates, ledger) = adaptive::render(&mut frame, target, &canvas, monitor, None)?;
            let mut shown = Vec::with_capacity(image.pixels.len());
            for (number, site) in canvas.sites.iter().enumerate() {
                let row = |y: usize| {
                    let first = (site.at[1] + y) * canvas.size[0] + site.at[0];
                    &estimates[first..first + PATCH_SIDE as usize]
                };
                let of_piece: Vec<_> = (0..PATCH_SIDE as usize).flat_map(row).copied().collect();
                let means = of_piece.iter().map(|estimate| estimate.mean().map(|x| x as f32));
                put(
                    &mut image,
                    mosaic.grid_position(number),
                    PATCH_SIDE,
                    &means.collect::<Vec<_>>(),
                );
                shown.extend(of_piece);
            }
            (SampleCounts::of(&shown), ledger)
        }
        None => {
            // Render patches as tiles and crop what the filter mixes
            let (tiles, ledger) = render_tiles(&frame, &patches, None, None, monitor)?;
            let (reach, side) = (settings.reach(), side(&settings));
            for (number, (tile, result)) in tiles.into_iter().enumerate() {
                let inner = Tile {
                    x: tile.x + reach,
                    y: tile.y + reach,
                    width: side,
                    height: side,
                };
                let patch = pixels(tile, inner, result, &settings);
                put(&mut image, mosaic.grid_position(number), side, &patch.pixels);
            }
            (
                SampleCounts::uniform(Region::whole(&settings).pixel_count(), settings.spp),
                ledger,
            )
        }
    };
    ledger += scattered;
    Ok(Rendering {
        ready_seconds,
        subsurface: frame.bodies.as_ref().map(|bodies| bodies.stats),
        ..Rendering::new(image, samples, ledger, &frame)
    })
}

/// Copies a patch of `side` by `side` pixels to its cell of the grid.
fn put(image: &mut LinearImage, [column, row]: [usize; 2], side: u32, pixels: &[[f32; 3]]) {
    let (side, width) = (side as usize, image.width as usize);
    for (y, line) in pixels.chunks(side).enumerate() {
        let first = (row * side + y) * width + column * side;
        image.pixels[first..first + side].copy_from_slice(line);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_lie_in_the_image_without_overlap() {
        for (width, height, wanted) in [(64, 64, 9), (100, 33, 7), (640, 480, 100), (1920, 1080, 31)] {
            let settings = RenderSettings {
                width,
                height,
                ..RenderSettings::default()
            };
            let mosaic = PatchGrid::of(&settings, 256.0 * f64::from(wanted)).unwrap();
            let patches = mosaic.patches(&settings);
            let [across, down] = mosaic.size(&settings);
            assert_eq!(patches.len() as u32 * 256, across * down);
            assert!((0.7..=1.0).contains(&(patches.len() as f64 / f64::from(wanted))));
            for (number, patch) in patches.iter().enumerate() {
                assert!(patch.x + PATCH_SIDE <= width && patch.y + PATCH_SIDE <= height);
                assert!(!patches[..number].contains(patch));
            }
        }
    }

    #[test]
    fn small_image_has_no_patches() {
        let settings = RenderSettings {
            width: 40,
            height: 33,
            ..RenderSettings::default()
        };
        assert_eq!(PatchGrid::of(&settings, 1024.0), None);
        assert_eq!(
            PatchGrid::of(&settings, 500.0),
            Some(PatchGrid { columns: 1, rows: 2 })
        );
        let small = RenderSettings { width: 8, ..settings };
        assert_eq!(PatchGrid::of(&small, 1.0), None);
    }
}
