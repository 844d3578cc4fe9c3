//! Coverage (alpha) of pixels, from films of the transparency of tiles.

use super::super::settings::RenderSettings;
use super::super::tile::Tile;
use super::filtered_image;
use super::tile_result::{self, TileResult};

/// Returns the pixels of an image of `size` (width and height) that tiles form: means, or filtered sums.
pub(in crate::render) fn assembled(
    [width, height]: [u32; 2],
    tiles: &[(Tile, TileResult)],
    settings: &RenderSettings,
) -> Vec<[f32; 3]> {
    let mut pixels = tile_result::assemble(width, height, tiles, &|result| &result.means);
    // Add the samples of neighbouring pixels
    if !settings.filter.is_box() {
        filtered_image::assemble(width, &mut pixels, tiles);
    }
    pixels
}

/// Returns the coverage of the pixels of an image of `size`, which is 1 minus the mean transparency of the channels;
/// `None` if the tiles have no film of transparency.
///
/// A filter with negative lobes may give values slightly below 0 and above 1.
pub(in crate::render) fn coverage(
    size: [u32; 2],
    tiles: Vec<(Tile, TileResult)>,
    settings: &RenderSettings,
) -> Option<Vec<f32>> {
    // Filter the transparency as the colours are filtered
    let films: Option<Vec<(Tile, TileResult)>> = tiles
        .into_iter()
        .map(|(tile, result)| Some((tile, *result.transparency?)))
        .collect();
    let transparencies = assembled(size, &films?, settings);
    // Average the channels, which coloured volumes weaken unequally
    let alpha = |channels: [f32; 3]| {
        let sum: f64 = channels.iter().map(|&channel| f64::from(channel)).sum();
        (1.0 - sum / 3.0) as f32
    };
    Some(transparencies.into_iter().map(alpha).collect())
}
