//! Tests of images: samples, layers, regions and checkpoints.

mod aovs;
mod checkpoints;
mod cryptomatte;
mod denoise;
mod edge_contrast;
mod estimated_error;
mod light_groups;
mod patch_sampling;
mod regions;
mod sampling;
mod transparent_background;
mod truncation_bound;
