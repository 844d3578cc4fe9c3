//! Parts of an image that are rendered by themselves: rectangles, shares of samples, tiles, patches, pixels and strips.

mod cover;
mod image_error;
mod parts;
mod patch_atlas;
mod patches;
mod pixels;
mod probe;
mod ray_recorder;
mod region;
mod tiles;

pub use image_error::ImageError;
pub use parts::{PartSums, Parts, Share};
pub use patches::{PatchGrid, render_patches};
pub use pixels::render_pixels;
pub use probe::{Probe, probe};
pub use ray_recorder::{RecordedRays, record};
pub use region::Region;
pub use tiles::{SampledTile, TileSample, render_sample, tile_count};

pub(super) use cover::Cover;
pub(super) use image_error::image_error;
pub(super) use patch_atlas::{Patch, PatchAtlas};
