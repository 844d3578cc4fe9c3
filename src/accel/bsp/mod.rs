//! Our own backend: an axis-aligned BSP tree in two levels, in safe Rust.
//!
//! The world tree holds the triangles of all baked meshes, the analytic shapes and the placed meshes; every mesh that
//! is placed has a tree of its own, which the ray enters in object space. Infinite planes are outside all trees.
//!
//! * [`builder`] cuts the cells, [`heuristic`] says where, [`clip`] what lies on which side.
//! * [`counters`] counts what rays cause, if that is compiled in.
//! * [`reference`](mod@reference) is the walk of the lecture: plain, slow, and what the others are tested against.
//! * [`node8`] stores the same cells eight to a node; [`single`] and [`packet`] walk them. They are written as loops
//!   over arrays and compiled for each instruction set; there is no fused multiply-add in them, so all give the same
//!   bits.

mod builder;
mod clip;
pub mod counters;
pub(super) mod error_bounds;
mod heuristic;
mod node8;
mod packet;
mod primitives;
mod reference;
mod single;
mod two_level;

use super::extents::{Spheres, spheres_of_shapes};
use super::planes::Planes;
use super::{
    Accel, AccelError, AccelOptions, AccelPart, AccelReport, Kernel, LANES, Precision, RayOrder, RayPacket,
};
use crate::mesh::simd::{F32Only, SimdKernel, SimdLevel, dispatch};
use crate::parallel;
use crate::scene::Scene;
use node8::Tree8;
use reference::PlaneTree;
use single::Query;
use two_level::{Layout, TwoLevelTree};

/// The BSP trees of a scene.
pub struct BspAccel<'s> {
    walker: Walker<'s>,
    /// How far hits of triangles may be trusted: at [`Precision::Fast`] f32 decides, else f64 where f32 cannot.
    precision: Precision,
    report: AccelReport,
}

/// The trees in the layout of the kernel that walks them.
enum Walker<'s> {
    Reference(TwoLevelTree<'s, PlaneTree>),
    Single(TwoLevelTree<'s, Tree8>),
    Packet(TwoLevelTree<'s, Tree8>),
}

impl Walker<'_> {
    fn planes(&self) -> &Planes {
        match self {
            Walker::Reference(levels) => &levels.planes,
            Walker::Single(levels) | Walker::Packet(levels) => &levels.planes,
        }
    }
}

impl<'s> BspAccel<'s> {
    /// Builds the trees of a validated scene.
    pub fn build(scene: &'s Scene, options: &AccelOptions) -> Result<BspAccel<'s>, AccelError> {
        BspAccel::build_with_spheres(scene, options, Spheres::Always)
    }

    /// [`BspAccel::build`], which takes [`Spheres::Always`], with or without spheres. The answers are the same.
    pub fn build_with_spheres(
        scene: &'s Scene,
        options: &AccelOptions,
        spheres: Spheres,
    ) -> Result<BspAccel<'s>, AccelError> {
        let levels = in_pool(options.threads, || -> Result<_, AccelError> {
            let mut levels: TwoLevelTree<Tree8> = TwoLevelTree::build(scene, options)?;
            if spheres == Spheres::Always {
                levels.spheres = spheres_of_shapes(scene);
            }
            Ok(levels)
        })?;
        let mut report = report(&levels);
        let spheres = size_of_val(&*levels.spheres) as u64;
        report.bytes += spheres;
        report.parts.push(AccelPart {
            holder: "extents",
            what: "spheres",
            bytes: spheres,
        });
        let walker = match options.kernel {
            Kernel::Single => Walker::Single(levels),
            Kernel::Packet => Walker::Packet(levels),
        };
        if options.precision == Precision::Fast {
            report.summary += ", triangles in f32";
        }
        Ok(BspAccel {
            walker,
            precision: options.precision,
            report,
        })
    }

    /// How many instances have a sphere.
    pub fn sphere_count(&self) -> usize {
        match &self.walker {
            Walker::Reference(_) => 0,
            Walker::Single(levels) | Walker::Packet(levels) => levels.spheres.iter().flatten().count(),
        }
    }

    /// Builds trees that are walked by the reference kernel: plain, slow, and what the fast kernels are tested against.
    pub fn build_reference(scene: &'s Scene, options: &AccelOptions) -> Result<BspAccel<'s>, AccelError> {
        let levels = in_pool(options.threads, || TwoLevelTree::build(scene, options))?;
        let report = report(&levels);
        Ok(BspAccel {
            walker: Walker::Reference(levels),
            precision: Precision::Watertight,
            report,
        })
    }
}

impl Accel for BspAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: RayOrder) {
        match &self.walker {
            Walker::Single(levels) => self.trace(levels, packets, Query::Nearest, None),
            Walker::Packet(levels) => self.trace(levels, packets, Query::Nearest, Some(order)),
            Walker::Reference(levels) => {
                for_each_lane(packets, |packet, lane| {
                    if let Some(hit) = levels.nearest(&packet.ray(lane)) {
                        packet.set_hit(lane, &hit);
                    }
                });
            }
        }
        let planes = self.walker.planes();
        if !planes.is_empty() {
            planes.intersect(packets);
        }
    }

    fn occluded(&self, packets: &mut [RayPacket], order: RayOrder) {
        match &self.walker {
            Walker::Single(levels) => self.trace(levels, packets, Query::Any, None),
            Walker::Packet(levels) => self.trace(levels, packets, Query::Any, Some(order)),
            Walker::Reference(levels) => {
                for_each_lane(packets, |packet, lane| {
                    if levels.is_blocked(&packet.ray(lane)) {
                        packet.set_blocked(lane);
                    }
                });
            }
        }
        let planes = self.walker.planes();
        if !planes.is_empty() {
            planes.occluded(packets);
        }
    }

    fn report(&self) -> AccelReport {
        self.report.clone()
    }
}

/// A batch of packets for the fast kernels. One dispatch a batch: all below is compiled for each instruction set.
struct Batch<'a, 's> {
    levels: &'a TwoLevelTree<'s, Tree8>,
    packets: &'a mut [RayPacket],
    question: Query,
    /// Absent for singles.
    order: Option<RayOrder>,
}

impl SimdKernel for Batch<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) {
        self.ask(isa);
    }
}

/// A batch whose triangles are left to f32.
struct RoundedBatch<'a, 's>(Batch<'a, 's>);

impl SimdKernel for RoundedBatch<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) {
        self.0.ask(F32Only(isa));
    }
}

impl Batch<'_, '_> {
    #[inline(always)]
    fn ask(self, isa: impl SimdLevel) {
        let Batch { levels, packets, .. } = self;
        // A kernel for each question, so that what only the other one needs is not in it.
        match (self.order, self.question) {
            (None, Query::Nearest) => single::trace_singles(isa, levels, packets, Query::Nearest),
            (None, Query::Any) => single::trace_singles(isa, levels, packets, Query::Any),
            (Some(order), Query::Nearest) => {
                packet::trace_packets(isa, levels, packets, Query::Nearest, order)
            }
            (Some(order), Query::Any) => packet::trace_packets(isa, levels, packets, Query::Any, order),
        }
    }
}

impl BspAccel<'_> {
    fn trace(
        &self,
        levels: &TwoLevelTree<Tree8>,
        packets: &mut [RayPacket],
        question: Query,
        order: Option<RayOrder>,
    ) {
        let batch = Batch {
            levels,
            packets,
            question,
            order,
        };
        match self.precision {
            Precision::Fast => dispatch(RoundedBatch(batch)),
            Precision::Robust | Precision::Watertight => dispatch(batch),
        }
    }
}

fn for_each_lane(packets: &mut [RayPacket], mut ask: impl FnMut(&mut RayPacket, usize)) {
    for packet in packets {
        packet.drop_untraceable();
        for lane in 0..LANES {
            if packet.is_active(lane) {
                ask(packet, lane);
            }
        }
    }
}

fn report<T: Layout>(levels: &TwoLevelTree<T>) -> AccelReport {
    AccelReport {
        bytes: levels.byte_count(),
        peak_bytes: levels.peak_bytes,
        embree: None,
        summary: levels.summary(),
        parts: levels.parts(),
    }
}

/// Runs `work` on `threads` threads of its own, or on the current pool for 0.
pub(super) fn in_pool<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    if threads == 0 || threads == rayon::current_num_threads() {
        return work();
    }
    // Where the system grants no more threads, the current ones do the work.
    let Ok(pool) = rayon::ThreadPoolBuilder::new().num_threads(threads).build() else {
        return work();
    };
    parallel::install(&pool, work)
}
