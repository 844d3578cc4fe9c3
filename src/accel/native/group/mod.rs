//! Traversal with groups of up to 1024 rays that start or end at a common point, or have a common direction.
//!
//! In a [`frame`] about the common point, or along the common direction, the rays of a group are points of a plane, and
//! boxes and triangles project to windows in it (so the traversal resembles a hierarchical rasteriser that skips what is
//! hidden). A node is tested against the four planes around the group, a triangle against the windows of the group's parts
//! ([`rays`]), and only what overlaps is tested against rays, eight at a time ([`leaf`]). The gain over packets is that
//! each node and triangle is prepared once for all rays. The kernel is compiled for each [`projection`].
//!
//! Rays should come in such an order that aligned runs of packets have small windows: tiles of the image in Morton order.
//! Groups whose rays leave their window mostly empty are split in four, and again. Rays that point elsewhere are traced
//! as a group of their own, and very few of them one at a time.
//!
//! # Errors
//!
//! The test is watertight ([`edges`]). Depths decide which triangle is the nearest, and are then replaced by the results
//! of the reference test ([`exact`]). With u = 2^-24, a depth has three roundings of coordinates relative to the common
//! point and about 5 of the interpolation, so its relative error is below 16 u for triangles that do not point at the
//! common point; for a triangle seen at a grazing angle the error of the weights is multiplied by the range of its depths.
//!
//! The result for a shadow ray differs from that of the reference test of the ray alone only where rounding decides: where it
//! passes the outline of what blocks it, or its interval ends at a hit, within the errors of coordinates in the group's
//! frame. They are relative to the distance from the target ([`common_end`]), or from the middle of the group's origins
//! ([`common_direction`]); `hit_compare` allows for them. Hits near the start, on either side of it, are compared with it as
//! closely as by the reference test ([`start`]).

mod common_direction;
mod common_end;
mod decide;
mod edges;
mod exact;
mod frame;
mod frustum;
mod kernel;
mod leaf;
#[cfg(test)]
mod parallel_tests;
mod projection;
mod query;
mod rays;
mod start;
#[cfg(test)]
mod tests;
mod traverse;

use std::cell::Cell;

use crate::accel::native::layout::TreeView;
use crate::accel::{RayEnd, RayPacket};
use crate::mesh::simd::SimdLimit;
use glam::Vec3;

use common_direction::CommonDirection;
use common_end::CommonEnd;
use kernel::{GroupKernel, Scratch};
use query::{AnyToLight, GroupQuery, NearestFromOrigin};

/// Finds the nearest hit of every active lane. All rays must start at `origin`, which should not lie on a surface: a
/// hit as near as its own rounding error may be lost.
pub(super) fn intersect(simd: SimdLimit, tree: TreeView, packets: &mut [RayPacket], origin: Vec3) {
    trace(simd, tree, packets, NearestFromOrigin(origin));
}

/// Marks every active lane as blocked whose ray hits anything within its interval, ends included. All rays must have the
/// end in common: pass through the point, up to rounding, at the end of their intervals or behind it, or have exactly the
/// direction (others are traced one at a time). They may start at surfaces.
pub(super) fn occluded(simd: SimdLimit, tree: TreeView, packets: &mut [RayPacket], end: RayEnd) {
    match end {
        RayEnd::Point(target) => trace(simd, tree, packets, AnyToLight(CommonEnd::Target(target))),
        RayEnd::Direction(direction) => trace(simd, tree, packets, AnyToLight(CommonDirection(direction))),
    }
}

/// Runs the kernel of a query with the thread's scratch memory.
fn trace<P: GroupQuery>(simd: SimdLimit, tree: TreeView, packets: &mut [RayPacket], query: P) {
    thread_local! {
        static SCRATCH: Cell<Option<Box<Scratch>>> = const { Cell::new(None) };
    }
    let mut scratch = SCRATCH.take().unwrap_or_else(Scratch::new);
    simd.dispatch_sixteen(GroupKernel::new(tree, packets, query, &mut scratch));
    SCRATCH.set(Some(scratch));
}
