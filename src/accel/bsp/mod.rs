//! Backend on a two-level, axis-aligned BSP tree, in safe Rust.
//!
//! The world tree holds the triangles of all baked meshes, the analytic shapes and the instanced meshes; every
//! instanced mesh has a tree of its own, which the ray enters in object space. Infinite planes are outside all trees.
//!
//! * `builder` splits the cells, `heuristic` chooses the plane, `clip` computes the parts on both sides.
//! * [`counters`] counts the traversal work, if that is compiled in.
//! * `reference` is the textbook traversal: plain, slow, and the reference for tests.
//! * `node8` stores the same cells eight to a node; `single` and `packet` traverse them. They are loops over
//!   arrays, compiled for each instruction set; they contain no fused multiply-add, so all give the same bits.

mod builder;
mod clip;
pub mod counters;
pub(in crate::accel) mod error_bounds;
mod heuristic;
mod node8;
mod packet;
mod piece;
mod primitives;
mod reference;
mod single;
mod two_level;

use std::sync::Arc;

use super::extents::{Spheres, shape_spheres};
use super::{
    Accel, AccelError, AccelOptions, AccelPart, AccelReport, Coherence, Kernel, Precision, Query, RayPacket,
};
use crate::mesh::simd::{F32Only, SimdKernel, SimdLevel, SimdLimit};
use crate::parallel;
use crate::scene::Scene;
use node8::Tree8;
use primitives::Contents;
use reference::PlaneTree;
use two_level::{TreeLayout, TwoLevelTree};

/// The BSP trees of a scene.
pub struct BspAccel<'s> {
    traversal: TraversalKernel<'s>,
    /// Guarantee for triangle hits: at [`Precision::Fast`] f32 decides, else f64 where f32 cannot.
    precision: Precision,
    simd: SimdLimit,
    report: AccelReport,
}

/// The trees in the layout of the kernel that traverses them.
enum TraversalKernel<'s> {
    Reference(Arc<TwoLevelTree<'s, PlaneTree>>),
    Single(Arc<TwoLevelTree<'s, Tree8>>),
    Packet(Arc<TwoLevelTree<'s, Tree8>>),
}

impl<'s> TraversalKernel<'s> {
    fn new(kernel: Kernel, levels: Arc<TwoLevelTree<'s, Tree8>>) -> TraversalKernel<'s> {
        match kernel {
            Kernel::Single => TraversalKernel::Single(levels),
            Kernel::Packet => TraversalKernel::Packet(levels),
        }
    }
}

impl<'s> BspAccel<'s> {
    /// Builds the trees of a validated scene.
    pub fn build(scene: &'s Scene, options: &AccelOptions) -> Result<BspAccel<'s>, AccelError> {
        BspAccel::build_with_spheres(scene, options, Spheres::Always)
    }

    /// Builds the trees of a validated scene with or without bounding spheres; [`BspAccel::build`] uses
    /// [`Spheres::Always`]. The results are equal.
    pub fn build_with_spheres(
        scene: &'s Scene,
        options: &AccelOptions,
        spheres: Spheres,
    ) -> Result<BspAccel<'s>, AccelError> {
        BspAccel::build_contents(scene, options, spheres, Contents::All)
    }

    fn build_contents(
        scene: &'s Scene,
        options: &AccelOptions,
        spheres: Spheres,
        contents: Contents,
    ) -> Result<BspAccel<'s>, AccelError> {
        // Build the trees, then the bounding spheres of shapes
        let levels = in_pool(options.threads, || -> Result<_, AccelError> {
            let mut levels: TwoLevelTree<Tree8> = TwoLevelTree::build(scene, options, contents)?;
            if spheres == Spheres::Always {
                levels.spheres = shape_spheres(scene);
            }
            Ok(levels)
        })?;
        // Add the spheres to the report
        let mut report = report(&levels);
        let spheres = size_of_val(&*levels.spheres) as u64;
        report.bytes += spheres;
        report.parts.push(AccelPart {
            holder: "extents",
            what: "spheres",
            bytes: spheres,
        });
        if options.precision == Precision::Fast {
            report.summary += ", triangles in f32";
        }
        Ok(BspAccel {
            traversal: TraversalKernel::new(options.kernel, Arc::new(levels)),
            precision: options.precision,
            simd: SimdLimit::within(options.isa.as_deref()),
            report,
        })
    }

    /// Returns the same trees with another kernel; those of the reference kernel keep it.
    pub(crate) fn with_kernel(&self, kernel: Kernel) -> BspAccel<'s> {
        let traversal = match &self.traversal {
            TraversalKernel::Reference(levels) => TraversalKernel::Reference(Arc::clone(levels)),
            TraversalKernel::Single(levels) | TraversalKernel::Packet(levels) => {
                TraversalKernel::new(kernel, Arc::clone(levels))
            }
        };
        BspAccel {
            traversal,
            precision: self.precision,
            simd: self.simd,
            report: self.report.clone(),
        }
    }

    /// Returns the number of instances with a bounding sphere.
    pub fn sphere_count(&self) -> usize {
        match &self.traversal {
            TraversalKernel::Reference(_) => 0,
            TraversalKernel::Single(levels) | TraversalKernel::Packet(levels) => {
                levels.spheres.iter().flatten().count()
            }
        }
    }

    /// Builds the trees of the shapes and instanced meshes of a validated scene, without its baked meshes.
    pub(super) fn build_objects(
        scene: &'s Scene,
        options: &AccelOptions,
    ) -> Result<BspAccel<'s>, AccelError> {
        BspAccel::build_contents(scene, options, Spheres::Always, Contents::Objects)
    }

    /// Builds trees for the reference kernel, which is plain and slow; the fast kernels are tested against it.
    pub fn build_reference(scene: &'s Scene, options: &AccelOptions) -> Result<BspAccel<'s>, AccelError> {
        let levels = in_pool(options.threads, || {
            TwoLevelTree::build(scene, options, Contents::All)
        })?;
        let report = report(&levels);
        Ok(BspAccel {
            traversal: TraversalKernel::Reference(Arc::new(levels)),
            precision: Precision::Watertight,
            simd: SimdLimit::within(options.isa.as_deref()),
            report,
        })
    }
}

impl Accel for BspAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: Coherence) {
        self.trace(packets, order, Query::Nearest);
    }

    fn occluded(&self, packets: &mut [RayPacket], order: Coherence) {
        self.trace(packets, order, Query::Any);
    }

    fn report(&self) -> AccelReport {
        self.report.clone()
    }
}

/// A batch of packets for the fast kernels. SIMD dispatch happens once per batch: all code below is compiled for each
/// instruction set.
struct PacketBatch<'a, 's> {
    levels: &'a TwoLevelTree<'s, Tree8>,
    packets: &'a mut [RayPacket],
    query: Query,
    /// Coherence hint; `None` for the single-ray kernel.
    order: Option<Coherence>,
}

impl SimdKernel for PacketBatch<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) {
        self.trace_rays(isa);
    }
}

/// A batch whose triangles are decided in f32 alone.
struct RoundedBatch<'a, 's>(PacketBatch<'a, 's>);

impl SimdKernel for RoundedBatch<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) {
        self.0.trace_rays(F32Only(isa));
    }
}

impl PacketBatch<'_, '_> {
    #[inline(always)]
    fn trace_rays(self, isa: impl SimdLevel) {
        let PacketBatch { levels, packets, .. } = self;
        // Compile a kernel for each kind of query, without the code of the other.
        match (self.order, self.query) {
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
    fn trace(&self, packets: &mut [RayPacket], order: Coherence, query: Query) {
        let (levels, order) = match &self.traversal {
            TraversalKernel::Single(levels) => (levels, None),
            TraversalKernel::Packet(levels) => (levels, Some(order)),
            TraversalKernel::Reference(levels) => return levels.trace(packets, query),
        };
        let batch = PacketBatch {
            levels,
            packets: &mut *packets,
            query,
            order,
        };
        let simd = self.simd;
        match self.precision {
            Precision::Fast => simd.dispatch(RoundedBatch(batch)),
            Precision::Robust | Precision::Watertight => simd.dispatch(batch),
        }
        levels.planes.trace(packets, query);
    }
}

fn report<T: TreeLayout>(levels: &TwoLevelTree<T>) -> AccelReport {
    AccelReport {
        bytes: levels.byte_count(),
        peak_bytes: levels.peak_bytes,
        embree: None,
        summary: levels.summary(),
        parts: levels.parts(),
    }
}

/// Runs `work` on a new pool of `threads` threads, or on the current pool for 0.
pub(super) fn in_pool<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    if threads == 0 || threads == rayon::current_num_threads() {
        return work();
    }
    // If the system grants no more threads, the current ones do the work.
    let Ok(pool) = rayon::ThreadPoolBuilder::new().num_threads(threads).build() else {
        return work();
    };
    parallel::install(&pool, work)
}
