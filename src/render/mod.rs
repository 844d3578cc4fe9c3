//! Renderer: turns a scene, a camera and an acceleration structure into an image, in parallel over tiles.
//!
//! This module depends on no file format and on no particular backend. An image has the same bits for any number of
//! threads and any order of tiles, because every tile owns its pixels and adds up samples in a fixed order.

mod adaptive;
mod aov;
mod automatic_exposure;
mod camera;
mod caustics;
mod context;
mod denoise;
mod driver;
mod edge_contrast;
mod film;
mod irradiance;
mod lighting;
mod monitor;
pub mod plan;
mod profile;
pub mod radiosity;
mod result;
mod sampler;
mod scattering;
mod settings;
mod settings_memory;
mod subset;
mod subsurface;
mod surface;
mod tile;
mod wavefront;

pub use adaptive::{Adaptive, Checkpoints, MIN_ADAPTIVE_ERROR, Rounds};
pub use aov::{AovKind, AovSet, Layer, LightAovs, PixelCosts};
pub use automatic_exposure::{Exposure, automatic_exposure};
pub use driver::{render, render_on};
pub use edge_contrast::{EdgeContrast, MIN_EDGE_CONTRAST};
pub use film::{PixelFilter, SampleAovs, SampleCounts, pixel_sum};
pub use monitor::{Cancelled, FinishedTile, Monitor};
pub use plan::{Plan, forecast_rays};
pub use profile::{Category, Memory, MemoryEntry, RenderProfile, Tally, TruncationBound};
pub use result::Rendering;
pub use sampler::{Purpose, sample_2d};
pub use settings::{HitPoint, RenderSettings};
pub use subset::{
    ImageError, PartSums, Parts, PatchGrid, Probe, RecordedRays, Region, SampledTile, Share, TileSample,
    probe, record, render_patches, render_pixels, render_sample, tile_count,
};
pub use subsurface::{SubsurfaceStats, subsurface_bytes};
pub use surface::{SpawnPoint, SpawnProbe};
pub use tile::TILE_SIDE;

pub use crate::scene::image_settings::{FilterKind, Pattern};
