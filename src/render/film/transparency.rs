//! Coverage (alpha) of pixels, from films of the transparency of tiles.

use super::super::settings::RenderSettings;
use super::super::tile::Tile;
use super::filtered_image;
use super::tile_result::{self, TileResult};

/// Returns the coverage of the pixels of an image of `size` (width and height), which is 1 minus the mean transparency of
/// the channels; `None` if the tiles have no film of transparency.
///
/// A filter with negative lobes may give values slightly below 0 and above 1.
pub(in crate::render) fn coverage(
    [width, height]: [u32; 2],
    tiles: Vec<(Tile, TileResult)>,
    settings: &RenderSettings,
) -> Option<Vec<f32>> {
    // Filter the transparency as the colours are filtered
    let films: Option<Vec<(Tile, TileResult)>> = tiles
        .into_iter()
        .map(|(tile, result)| Some((tile, *result.transparency?)))
        .collect();
    let films = films?;
    let mut transparencies = tile_result::assemble(width, height, &films, &|film| &film.means);
    if !settings.filter.is_box() {
        filtered_image::assemble(width, &mut transparencies, &films);
    }
    // Average the channels, which coloured volumes weaken unequally
    let alpha = |channels: [f32; 3]| {
        let sum: f64 = channels.iter().map(|&channel| f64::from(channel)).sum();
        (1.0 - sum / 3.0) as f32
    };
    Some(transparencies.into_iter().map(alpha).collect())
}
