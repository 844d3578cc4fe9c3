//! Batches of frames that survive interruptions: fingerprints, manifests, shards, and pieces of frames on disk.
//!
//! This module does not render. It computes the hash of a frame's inputs ([`Key`]), records which frames are done
//! ([`Manifest`]), assigns frames to processes ([`Shard`]), and stores the finished pieces of a frame ([`Piece`],
//! [`Coverage`]). Output files appear whole, and have the same bits regardless of the process that makes them; so any
//! process may be killed at any time, and two processes that make the same output do no harm to each other.

mod key;
mod lock;
mod manifest;
mod merge;
mod piece;
mod piece_file;
mod rounds_file;
mod shard;
pub mod slurm;
mod sources;

pub use key::{Key, Keyring};
pub use lock::{Lock, LockError};
pub use manifest::{Done, Manifest};
pub use merge::{Merge, MergeError, color_planes, planes_of};
pub use piece::{Coverage, Cut, Part, Piece};
pub use piece_file::{FrameHead, PieceFolder, PieceReader, PieceRows, Plane};
pub use shard::Shard;
pub use sources::Sources;
