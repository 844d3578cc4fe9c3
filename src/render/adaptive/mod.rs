//! Adaptive sampling: takes more samples where the mean of a pixel is still uncertain, measured in display values.
//!
//! The image is rendered in rounds. The first round gives every pixel sixteen samples; each later round doubles the
//! samples of the selected pixels, because the point sets are best stratified at powers of two. A round is finished
//! before the next one is decided, so decisions depend on the image alone, not on threads or tiles. A pixel is
//! selected while one of these criteria holds:
//!
//! 1. *Its mean is uncertain*: adding one standard error to its mean luminance changes the display value by more than
//!    the target. The standard error of n stratified samples is σ / n^¾ at edges: an edge crosses about √n of n
//!    strata, and all others are certain. It is σ / √n where the variance is noise. [`NoiseModel`] estimates the
//!    proportions of both.
//! 2. *Its neighbourhood is uncertain*: the root mean square of these errors over the pixel and its eight neighbours
//!    exceeds the target. Estimates from few samples are uncertain themselves; neighbours make them reliable.
//! 3. *Its neighbours saw something that it has not seen*: a neighbour has a sample that is brighter or darker by a
//!    display value of c than any of the pixel's own n samples, and c / (n + 1) is more than the target. By Laplace's
//!    rule of succession, something unseen in n samples may cover about 1 / (n + 1) of the pixel.
//! 4. *It inherits*: it has had one round only, and the mean of a neighbour is uncertain.
//!
//! Then [`PassForecast`] decides whether the round reduces the error more than the same number of samples distributed
//! over all pixels. Where most of an image is about equally uncertain it does not, and the pixels with the fewest
//! samples join the round, so that such images are sampled uniformly. The forecast also includes features that are
//! too small to be hit. By the estimate of Good and Turing (I. J. Good, "The population frequencies of species",
//! Biometrika 40, 1953), features that no sample has hit cover about as much as those that a single sample has hit:
//! for every pixel with one sample that differs from all its others and from its neighbours', as much is hidden
//! elsewhere. Rounds continue while the root mean square of this error over the image exceeds the target.
//!
//! A feature smaller than a sixteenth of a pixel may be missed if it has neither a larger neighbour nor similar
//! features elsewhere, because no later round samples where the first one saw nothing. `tests/it/image/sampling.rs`
//! measures the savings of adaptive sampling.
//!
//! Between two rounds, and between two tiles of a round, the complete state is in [`Rounds`]: a render that resumes
//! from a stored state produces the same bits.

mod checkpoints;
mod display_error;
mod driver;
mod forecast;
mod pilot;
mod progress;
mod rounds;
mod state;
mod target;

pub(super) use display_error::DISPLAY_ROOT;
pub(super) use driver::{LOOK_BYTES, render};
pub(super) use target::ROUND;

pub use checkpoints::Checkpoints;
pub use rounds::Rounds;
pub use target::{Adaptive, MIN_ADAPTIVE_ERROR};
