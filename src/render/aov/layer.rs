//! Layers (AOVs) of an image: channels in addition to its colours, with one value per pixel.

use super::super::subset::Region;
use super::selection::AovSet;
use crate::image::ChannelKind;

/// Layer of an image: one f32 value per pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Channel name in files, as listed for [`AovKind`](super::AovKind).
    pub name: String,
    /// Kind of channel, which decides whether a file of half floats may round the layer.
    pub kind: ChannelKind,
    /// Pixel values, row by row from the top.
    pub values: Vec<f32>,
}

impl Layer {
    /// Returns a layer of zeros for the pixels of `region`.
    pub(in crate::render) fn blank(name: String, kind: ChannelKind, region: &Region) -> Layer {
        Layer {
            name,
            kind,
            values: vec![0.0; region.width as usize * region.height as usize],
        }
    }
}

/// Returns layers of zeros for the requested groups and the pixels of `region`.
pub(in crate::render) fn blank(wanted: AovSet, region: &Region) -> Vec<Layer> {
    let layers = wanted
        .kinds()
        .flat_map(|kind| kind.names().iter().map(move |&name| (kind, name)));
    layers
        .map(|(kind, name)| Layer::blank(name.into(), kind.rounding(), region))
        .collect()
}
