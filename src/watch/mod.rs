//! Watching a render from outside: a live picture in the viewer tev.

mod packet;
mod queue;
mod tev;

pub use tev::{Rectangle, TevError, TevViewer};
