//! Ray-scene intersection for packets of rays: nearest hit and occlusion, by one of five backends with equal results.
//!
//! * `embree`: the system's Embree, with shapes and instances as user geometry.
//! * [`native`]: a bounding volume hierarchy in Rust for groups of rays with a common origin, end or direction.
//! * [`auto`]: the sooner of these two for each kind of ray, by forecast.
//! * [`bsp`]: an axis-aligned BSP tree, in Rust.
//! * [`brute`]: a loop over every primitive, the reference for tests.
//!
//! [`extents`] are the bounding volumes that a ray is tested against before an object.
//!
//! Ties go to the smallest `t`, then the lowest instance, then the lowest primitive, also between coincident triangles.
//! There is one exception: where a ray hits two different native triangles of Embree at the same `t`, at a shared edge
//! or where they partly overlap in one plane, Embree decides. [`hit_compare`] counts such results as ties, not as
//! wrong.

mod accel_trait;
pub mod auto;
pub mod brute;
pub mod bsp;
mod build;
#[cfg(feature = "embree")]
mod clusters;
#[cfg(feature = "embree")]
pub mod embree;
mod error;
pub mod extents;
pub mod hit_compare;
mod mesh_cache;
mod mesh_counts;
mod morton;
pub mod native;
mod options;
mod packet;
mod planes;
mod quality;
mod query;
mod ray_forecast;
mod report;
mod scene_stats;
mod shape_query;

pub use accel_trait::{Accel, Coherence, RayEnd};
pub(crate) use accel_trait::{BATCH, MAX_BATCH};
pub use build::{build, identity};
#[cfg(feature = "embree")]
#[doc(hidden)]
pub use clusters::cluster_count;
pub use error::AccelError;
pub use mesh_cache::MeshCache;
pub use mesh_counts::MeshCounts;
pub use options::{AccelOptions, Backend, Instancing, Kernel, Precision};
pub use packet::{ACTIVE, Hit, LANES, NO_HIT, RayPacket};
pub use quality::BuildQuality;
use query::Query;
pub use ray_forecast::RayForecast;
pub(crate) use report::holder_of_tree;
pub use report::{AccelPart, AccelReport, EmbreeIdentity};
pub use scene_stats::PrimitiveCounts;
