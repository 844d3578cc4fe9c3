//! Numerically stable building blocks: boxes, transforms and their animation, polynomial roots, spawn points, noise and
//! sampling warps; and double-double and random numbers to test them with.
//!
//! Each has its source and its error bound. This module does not depend on the scene.

use std::ops::AddAssign;

mod animated_transform;
mod bounds;
pub(crate) mod cumulative;
mod double_double;
pub(crate) mod lane_math;
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
pub use spawn_policy::SpawnPolicy;
pub(crate) use spawn_policy::offset_point;
pub use transform::{Ray, SingularMatrix, inverse, object_ray, transform_normal};

/// Number of rays processed in SIMD lanes: the width of every packet.
pub const LANES: usize = 16;

/// Array with one value for each lane.
pub type Lanes<T> = [T; LANES];

/// Array with one 3-vector for each lane: all x, all y, all z.
pub type Lanes3<T> = [[T; LANES]; 3];

/// Returns the sum over all lanes by pairwise halving: each value is rounded four times only, in an order that does not
/// depend on the processor.
#[inline(always)]
pub fn sum_of_lanes<T: Copy + AddAssign>(mut halves: Lanes<T>) -> T {
    let mut width = LANES / 2;
    // Add the upper half of the lanes to the lower half
    while width > 0 {
        for l in 0..width {
            let other = halves[l + width];
            halves[l] += other;
        }
        width /= 2;
    }
    halves[0]
}
