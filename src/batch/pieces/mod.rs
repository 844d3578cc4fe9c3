//! Pieces of frames on disk: what they cover, their files, and merging them to images.

mod adaptive_checkpoint;
mod chunk;
mod chunk_directory;
mod chunk_format;
mod image_writer;
mod merge;

pub use chunk::{Chunk, ChunkKind, ChunkLayout, Coverage};
pub use chunk_directory::{ChunkDirectory, FrameMetadata};
pub use chunk_format::{ChunkReader, ChunkRows};
pub(super) use image_writer::{merge, write};
pub(super) use merge::add_sums;
pub use merge::{Merge, MergeError, color_planes, planes_of};
