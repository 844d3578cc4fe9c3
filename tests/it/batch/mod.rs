//! Batches of frames: interruption, resuming, shards, and reuse of data between frames.

mod frames;
mod huge_frame;
mod reuse;
mod shards;
