//! Film: sums, statistics and filtered pixels of samples.

mod filter;
pub(super) mod filtered_image;
mod label;
mod pixel_statistics;
mod sample_aovs;
mod sample_film;
mod shared_image;
mod splat;
mod tile_film;
pub(super) mod tile_result;
pub(super) mod transparency;

pub use filter::PixelFilter;
pub use sample_aovs::{SampleAovs, SampleCounts};
pub use tile_film::pixel_sum;

pub(super) use label::{STEP_SHIFT, STEPS, number_of, pixel_of, with_step, without_step};
pub(super) use pixel_statistics::PixelStatistics;
#[cfg(test)]
pub(super) use pixel_statistics::estimate;
pub(super) use sample_film::SampleFilm;
pub(super) use shared_image::SharedImage;
pub(super) use splat::weighted_mean;
pub(super) use tile_film::TileFilm;
pub(super) use tile_result::TileResult;
