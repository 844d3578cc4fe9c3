//! Small pieces of a picture side by side, by which its error and its time can be told before all of it is made.
//!
//! They are spread evenly over the picture, and their pixels have the bits that they have in it, but for adaptive
//! sampling, which knows of a picture only what it sees of it.

use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::film::Tile;
use super::sample::{pixels, reach, spread};
use super::{
    Frame, LayerSet, LightLayers, Monitor, Region, RenderSettings, Rendering, adaptive, render_tiles,
};
use crate::accel::Accel;
use crate::image::LinearImage;
use crate::scene::{Camera, Scene};

/// Side of a piece in pixels: many small ones tell more of a picture than few large ones, and rays want neighbours.
const PIECE: u32 = 16;

/// How many pieces there are, and how they lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mosaic {
    /// Pieces beside each other.
    pub columns: u32,
    /// Pieces below each other.
    pub rows: u32,
}

/// Where pieces of a picture are seen together, a row and a column of pixels apart.
pub(super) struct Canvas {
    /// Columns and rows of pixels.
    pub(super) size: [usize; 2],
    pub(super) sites: Vec<Site>,
}

/// A piece of the picture and where it is on the canvas.
#[derive(Clone, Copy)]
pub(super) struct Site {
    pub(super) tile: Tile,
    /// Column and row of its first pixel.
    pub(super) at: [usize; 2],
}

impl Canvas {
    /// The whole picture, where it is.
    pub(super) fn whole(settings: &RenderSettings) -> Canvas {
        let RenderSettings { width, height, .. } = *settings;
        let place = |tile: Tile| Site {
            tile,
            at: [tile.x as usize, tile.y as usize],
        };
        Canvas {
            size: [width as usize, height as usize],
            sites: super::film::tiles(width, height).into_iter().map(place).collect(),
        }
    }
}

impl Mosaic {
    /// One of about so many pixels; `None` where the picture has hardly more.
    pub fn of(settings: &RenderSettings, pixels: f64) -> Option<Mosaic> {
        let side = f64::from(side(settings));
        let [columns, rows] = whole_pieces(settings);
        let wanted = (pixels / (side * side)).round().max(1.0);
        if wanted >= f64::from(columns) * f64::from(rows) {
            return None;
        }
        let columns = wanted.sqrt().floor();
        Some(Mosaic {
            columns: columns as u32,
            rows: (wanted / columns).floor() as u32,
        })
    }

    /// Width and height of it in pixels.
    pub fn size(&self, settings: &RenderSettings) -> [u32; 2] {
        [self.columns, self.rows].map(|count| count * side(settings))
    }

    /// Pieces in the order in which they lie, row by row.
    fn pieces(&self, settings: &RenderSettings) -> Vec<Tile> {
        let grid = whole_pieces(settings);
        let piece = |index: usize| {
            let [x, y] = [index as u32 % grid[0], index as u32 / grid[0]].map(|cell| cell * PIECE);
            Tile {
                x,
                y,
                width: PIECE,
                height: PIECE,
            }
        };
        let count = self.columns as usize * self.rows as usize;
        spread(grid.map(|cells| cells as usize))
            .take(count)
            .map(piece)
            .collect()
    }

    /// What it shows of a picture that was made with `settings`.
    pub fn of_picture(&self, settings: &RenderSettings, picture: &LinearImage) -> LinearImage {
        let mut image = self.blank(settings);
        let (reach, side) = (reach(settings), side(settings));
        for (number, tile) in self.pieces(settings).into_iter().enumerate() {
            let row = |y: u32| {
                let first =
                    (tile.y + reach + y) as usize * picture.width as usize + (tile.x + reach) as usize;
                &picture.pixels[first..first + side as usize]
            };
            let pixels: Vec<[f32; 3]> = (0..side).flat_map(row).copied().collect();
            put(&mut image, self.place(number), side, &pixels);
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

    /// Column and row of a piece.
    fn place(&self, number: usize) -> [usize; 2] {
        let columns = self.columns as usize;
        [number % columns, number / columns]
    }

    fn canvas(&self, pieces: &[Tile]) -> Canvas {
        let apart = PIECE as usize + 1;
        let site = |(number, &tile): (usize, &Tile)| Site {
            tile,
            at: self.place(number).map(|place| place * apart),
        };
        Canvas {
            size: [self.columns, self.rows].map(|count| count as usize * apart),
            sites: pieces.iter().enumerate().map(site).collect(),
        }
    }
}

/// Side of what a piece shows: a filter that takes from neighbouring pieces leaves out what they reach.
fn side(settings: &RenderSettings) -> u32 {
    PIECE - 2 * reach(settings)
}

/// How many pieces the picture has that nothing is missing from, side by side and one below the other.
fn whole_pieces(settings: &RenderSettings) -> [u32; 2] {
    [settings.width / PIECE, settings.height / PIECE]
}

/// Renders a mosaic of the picture that `settings` ask for, in the current rayon pool. `None` if it was cancelled.
///
/// [`RenderSettings::sample_aovs`], [`RenderSettings::layers`] and [`RenderSettings::cost_aovs`] are ignored. `scene`
/// must have passed [`Scene::validate`], and `accel` must have been built from it.
pub fn render_mosaic(
    (scene, camera): (&Scene, &Camera),
    accel: &dyn Accel,
    settings: &RenderSettings,
    mosaic: Mosaic,
    monitor: &Monitor,
) -> Option<Rendering> {
    let start = Instant::now();
    let settings = RenderSettings {
        sample_aovs: false,
        layers: LayerSet::NONE,
        light_layers: LightLayers::NONE,
        cost_aovs: false,
        ..*settings
    };
    let mut frame = Frame::new(scene, camera, accel, &settings);
    let scattered = frame.scatter(monitor)?;
    let ready_seconds = start.elapsed().as_secs_f64();
    let pieces = mosaic.pieces(&settings);
    let mut image = mosaic.blank(&settings);
    let (samples, mut ledger) = match settings.target() {
        Some(target) => {
            let canvas = mosaic.canvas(&pieces);
            let (estimates, ledger) = adaptive::render(&mut frame, target, &canvas, monitor, None)?;
            let mut shown = Vec::with_capacity(image.pixels.len());
            for (number, site) in canvas.sites.iter().enumerate() {
                let row = |y: usize| {
                    let first = (site.at[1] + y) * canvas.size[0] + site.at[0];
                    &estimates[first..first + PIECE as usize]
                };
                let of_piece: Vec<_> = (0..PIECE as usize).flat_map(row).copied().collect();
                let means = of_piece.iter().map(|estimate| estimate.mean().map(|x| x as f32));
                put(
                    &mut image,
                    mosaic.place(number),
                    PIECE,
                    &means.collect::<Vec<_>>(),
                );
                shown.extend(of_piece);
            }
            (super::SampleCounts::of(&shown), ledger)
        }
        None => {
            let (tiles, ledger) = render_tiles(&frame, &pieces, None, monitor)?;
            let (reach, side) = (reach(&settings), side(&settings));
            for (number, (tile, picture)) in tiles.into_iter().enumerate() {
                let inner = Tile {
                    x: tile.x + reach,
                    y: tile.y + reach,
                    width: side,
                    height: side,
                };
                let piece = pixels(tile, inner, picture, &settings);
                put(&mut image, mosaic.place(number), side, &piece.pixels);
            }
            (
                super::SampleCounts::uniform(Region::whole(&settings).pixel_count(), settings.spp),
                ledger,
            )
        }
    };
    ledger += scattered;
    Some(Rendering {
        ready_seconds,
        subsurface: frame.bodies.as_ref().map(|bodies| bodies.stats),
        ..Rendering::new(image, samples, ledger, &frame)
    })
}

/// Puts a piece of `side` by `side` pixels at its place among such pieces.
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
    fn pieces_lie_in_the_picture_and_none_twice() {
        for (width, height, wanted) in [(64, 64, 9), (100, 33, 7), (640, 480, 100), (1920, 1080, 31)] {
            let settings = RenderSettings {
                width,
                height,
                ..RenderSettings::default()
            };
            let mosaic = Mosaic::of(&settings, 256.0 * f64::from(wanted)).unwrap();
            let pieces = mosaic.pieces(&settings);
            let [across, down] = mosaic.size(&settings);
            assert_eq!(pieces.len() as u32 * 256, across * down);
            assert!((0.7..=1.0).contains(&(pieces.len() as f64 / f64::from(wanted))));
            for (number, piece) in pieces.iter().enumerate() {
                assert!(piece.x + PIECE <= width && piece.y + PIECE <= height);
                assert!(!pieces[..number].contains(piece));
            }
        }
    }

    #[test]
    fn a_picture_that_has_hardly_more_is_taken_whole() {
        let settings = RenderSettings {
            width: 40,
            height: 33,
            ..RenderSettings::default()
        };
        assert_eq!(Mosaic::of(&settings, 1024.0), None);
        assert_eq!(Mosaic::of(&settings, 500.0), Some(Mosaic { columns: 1, rows: 2 }));
        let small = RenderSettings { width: 8, ..settings };
        assert_eq!(Mosaic::of(&small, 1.0), None);
    }
}
