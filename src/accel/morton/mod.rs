//! Order of primitives along Morton's curve (G. M. Morton 1966), by which trees and clusters are built.
//!
//! 1. [`keys`]: sort the primitives by the Morton codes of their centres.
//! 2. [`chunks`]: cut the order where the highest digits of the codes differ, into chunks of nearby primitives.
//!
//! The order is the same for any number of threads.

mod box4;
mod chunks;
mod keys;

pub(super) use box4::Box4;
pub(super) use chunks::{MortonChunk, cut};
pub(super) use keys::{SortedKeys, sorted};
