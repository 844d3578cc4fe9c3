//! Pieces of frames on disk: what they cover, their files, and merging them to images.

mod adaptive_checkpoint;
mod chunk;
mod chunk_directory;
mod chunk_format;
mod image_writer;
mod merge;

pub(super) use chunk::{Chunk, ChunkKind, ChunkLayout};
pub(super) use chunk_directory::{ChunkDirectory, FrameMetadata};
pub(super) use image_writer::{colors, merge, write};
pub use merge::MergeError;
pub(super) use merge::{Merge, add_sums, color_planes, planes_of};
