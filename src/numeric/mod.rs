//! The stable formulas that everything else is built from: boxes, transforms, spawn points.
//!
//! Each carries its source and its error bound. Nothing here knows what a scene is.

mod bounds;
mod spawn;
mod transform;

pub use bounds::Bounds;
pub use spawn::{SpawnError, spawn_point, triangle_spawn_error};
pub use transform::{Ray, SingularMatrix, inverse, object_ray, transform_normal};
