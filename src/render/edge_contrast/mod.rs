//! Supersampling by contrast: all samples of a pixel only where it differs visibly from a neighbour.
//!
//! As in Whitted's paper, only edges are supersampled (T. Whitted, "An Improved Illumination Model for Shaded Display",
//! Communications of the ACM, 1980); contrast says where they are (D. P. Mitchell, "Generating Antialiased Images at Low
//! Sampling Densities", SIGGRAPH 1987). Every pixel takes one sample. One whose displayed value differs by more than a limit
//! from that of any of its eight neighbours then takes all samples, in place of the first. The decision depends on the
//! pixels around it alone, so a part of an image has the bits of that part of the whole.
//!
//! Details smaller than a pixel are missed where the samples of neither the pixel nor a neighbour hit them. Adaptive sampling
//! takes sixteen samples of every pixel before it decides.

mod driver;
mod first_samples;
mod limit;

pub(super) use driver::render;

pub use limit::{EdgeContrast, MIN_EDGE_CONTRAST};
