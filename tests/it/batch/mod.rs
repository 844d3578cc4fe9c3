//! Batches of frames: interrupted, resumed, divided among processes, and made from what earlier frames left.

mod frames;
mod huge_frame;
mod reuse;
