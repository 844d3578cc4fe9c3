//! Batches of frames that survive interruptions: fingerprints, manifests, shards, and pieces of frames on disk.
//!
//! This module does not render. It computes the hash of a frame's inputs ([`Fingerprint`]), records which frames are
//! done ([`Manifest`]), assigns frames to processes ([`Shard`]), and stores the finished pieces of a frame ([`Chunk`],
//! [`Coverage`]). Output files appear whole, and have the same bits regardless of the process that makes them; so any
//! process may be killed at any time, and two processes that make the same output do no harm to each other.

mod adaptive_checkpoint;
mod chunk;
mod chunk_file;
mod dependencies;
mod fingerprint;
mod lock;
mod manifest;
pub mod memory;
mod merge;
pub mod request;
mod shard;
pub mod slurm;

pub use chunk::{Chunk, ChunkKind, ChunkLayout, Coverage};
pub use chunk_file::{ChannelPlane, ChunkDirectory, ChunkReader, ChunkRows, FrameMetadata};
pub use dependencies::Sources;
pub use fingerprint::{Fingerprint, FingerprintHasher};
pub use lock::{Lock, LockError};
pub use manifest::{CompletedFrame, Manifest};
pub use merge::{Merge, MergeError, color_planes, planes_of};
pub use shard::Shard;
