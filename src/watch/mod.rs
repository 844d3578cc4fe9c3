//! Live preview of a render in an external viewer: the client of the image viewer tev.

mod packet;
mod queue;
mod tev;

pub use tev::{Rectangle, TevError, TevViewer};
