//! Counters of traversal work, behind the cargo feature `counters`. Without it there is no code and no cost.

/// Traversal work since the last [`take`], over all trees and threads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TraversalCounts {
    /// Nodes entered, by one ray or by a group of rays.
    pub nodes: u64,
    /// Tests of one ray against eight triangles.
    pub packs: u64,
    /// Tests of sixteen rays against one triangle.
    pub triangles: u64,
}

#[cfg(feature = "counters")]
mod totals {
    use std::sync::atomic::{AtomicU64, Ordering};

    pub(super) static NODES: AtomicU64 = AtomicU64::new(0);
    pub(super) static PACKS: AtomicU64 = AtomicU64::new(0);
    pub(super) static TRIANGLES: AtomicU64 = AtomicU64::new(0);

    pub(super) fn add(total: &AtomicU64) {
        total.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn take(total: &AtomicU64) -> u64 {
        total.swap(0, Ordering::Relaxed)
    }
}

/// Returns the counts so far and resets them to zero; `None` without the feature `counters`.
pub fn take() -> Option<TraversalCounts> {
    #[cfg(feature = "counters")]
    return Some(TraversalCounts {
        nodes: totals::take(&totals::NODES),
        packs: totals::take(&totals::PACKS),
        triangles: totals::take(&totals::TRIANGLES),
    });
    #[cfg(not(feature = "counters"))]
    None
}

#[inline(always)]
pub(super) fn node() {
    #[cfg(feature = "counters")]
    totals::add(&totals::NODES);
}

#[inline(always)]
pub(super) fn pack() {
    #[cfg(feature = "counters")]
    totals::add(&totals::PACKS);
}

#[inline(always)]
pub(super) fn triangle() {
    #[cfg(feature = "counters")]
    totals::add(&totals::TRIANGLES);
}
