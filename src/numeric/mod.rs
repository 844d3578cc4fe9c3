//! The stable formulas that everything else is built from: boxes, transforms and their motion, roots, spawn points,
//! noise, maps of the unit square; and what they are checked with: wide and random numbers.
//!
//! Each carries its source and its error bound. Nothing here knows what a scene is.

use std::ops::AddAssign;

mod animated_transform;
mod bounds;
mod double_double;
pub(crate) mod morton;
pub mod noise;
mod rng;
pub mod roots;
mod spawn;
mod spawn_policy;
mod transform;
pub mod warp;

pub use animated_transform::{AnimatedTransform, MotionError};
pub use bounds::Bounds;
pub use double_double::DoubleDouble;
pub use rng::SplitMix64;
pub use spawn::{HitErrorBound, spawn_point, triangle_spawn_bound, triangle_spawn_error};
pub use spawn_policy::{SpawnPolicy, shifted_point};
pub use transform::{Ray, SingularMatrix, inverse, object_ray, transform_normal};

/// Rays handled side by side: the width of every packet.
pub const LANES: usize = 16;

/// One value a lane.
pub type Lanes<T> = [T; LANES];

/// One 3-vector a lane: all x, all y, all z.
pub type Lanes3<T> = [[T; LANES]; 3];

/// The sum over all lanes by halves: rounded four times only, in an order that no processor changes.
#[inline(always)]
pub fn sum_of_lanes<T: Copy + AddAssign>(mut halves: Lanes<T>) -> T {
    let mut width = LANES / 2;
    while width > 0 {
        for l in 0..width {
            let other = halves[l + width];
            halves[l] += other;
        }
        width /= 2;
    }
    halves[0]
}
