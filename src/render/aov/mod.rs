//! Layers (AOVs) in addition to the colours of an image.

mod buffers;
mod cryptomatte;
mod first_hits;
pub(super) mod layer;
mod light_groups;
mod pixel_cost;
mod selection;

pub use layer::Layer;
pub use pixel_cost::PixelCosts;
pub use selection::{AovKind, AovSet, LightAovs};

pub(super) use buffers::{AovBuffers, TileLayer};
pub(super) use cryptomatte::MatteIds;
pub(super) use first_hits::FirstHits;
pub(super) use light_groups::{LightGroupFilm, LightGroups, LightSource};
pub(super) use pixel_cost::{PixelCostBuffer, TileCosts};
