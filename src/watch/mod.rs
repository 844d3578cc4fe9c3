//! Live preview of a render in an external viewer: the client of the image viewer tev.

mod client;
mod protocol;
mod rectangle;
mod send_queue;

pub use client::{TevError, TevViewer};
pub use rectangle::Rectangle;
