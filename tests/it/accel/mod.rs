//! Acceleration structures: Embree, the BSP tree and brute force compared with each other and with exact results.

mod agreement;
mod bounding_volumes;
mod bsp_f32;
#[cfg(feature = "embree")]
mod cross_version_bits;
#[cfg(feature = "embree")]
mod embree_hits;
#[cfg(feature = "embree")]
mod embree_ties;
#[cfg(feature = "embree")]
mod embree_watchdog;
#[cfg(feature = "embree")]
mod instance_memory;
mod intersection_errors;
mod motion;
mod point_clouds;
mod self_intersection;
#[cfg(feature = "embree")]
mod watertight;
