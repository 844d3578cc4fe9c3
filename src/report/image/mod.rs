//! Reports as images.

pub mod difference_image;
pub mod heat_map;
pub mod overlay;
pub mod worst_tiles;
