//! Many frames that get finished, whatever happens on the way.
//!
//! Nothing here renders. A batch knows what a frame is made of ([`Key`]), which frames are done ([`Manifest`]), which of
//! them are whose ([`Shard`]), and what of a frame there is ([`Piece`], [`Coverage`]). Outputs appear whole, and have
//! the same bits whoever makes them; so any process may be killed at any time, and two that make the same thing do not
//! harm each other.

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
