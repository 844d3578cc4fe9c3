//! Backend on a bounding volume hierarchy of our own, which groups of rays with a common origin, end or direction traverse
//! together.
//!
//! The tree holds the triangles of all baked meshes. Camera rays of a pinhole, and shadow rays to a point or a direction,
//! traverse it in groups of up to 1024 (`group`); all others one at a time (`single`), or sixteen at a time through a small
//! tree (`packet`). Shapes and instanced meshes are left to a BSP, and infinite planes are tested last.

mod build;
mod child_stack;
mod group;
mod layout;
mod packet;
mod packet_part;
mod single;
mod small_tree;
#[cfg(test)]
pub(super) mod testing;
mod triangle_run;

use std::sync::Arc;

use glam::Vec3;

use super::bsp::BspAccel;
use super::planes::Planes;
use super::{
    Accel, AccelError, AccelOptions, AccelPart, AccelReport, Coherence, Kernel, LANES, MAX_BATCH, NO_HIT,
    Query, RayEnd, RayPacket,
};
use crate::mesh::Mesh;
use crate::mesh::simd::{Floats, LaneMask, SimdKernel, SimdLevel, SimdLimit};
use crate::numeric::Lanes;
use crate::scene::{Geometry, Scene};
use layout::GroupTree;
use small_tree::SmallTree;
use triangle_run::TriangleRun;

/// The structures of a scene.
pub struct NativeAccel<'s> {
    /// Tree of the triangles of all baked meshes.
    triangles: Arc<GroupTree>,
    /// Leaves of the tree if it is small.
    small: Option<Arc<SmallTree>>,
    /// Instances of the triangles, in the order of their numbers.
    runs: Vec<TriangleRun>,
    others: Others<'s>,
    kernel: Kernel,
    simd: SimdLimit,
    report: AccelReport,
}

/// Structures for what the tree does not hold.
enum Others<'s> {
    /// Infinite planes only, or nothing.
    Planes(Planes),
    /// BSP of shapes and instanced meshes, which tests planes, too.
    Objects(Box<BspAccel<'s>>),
}

impl<'s> NativeAccel<'s> {
    /// Builds the structures of a validated scene.
    pub fn build(scene: &'s Scene, options: &AccelOptions) -> Result<NativeAccel<'s>, AccelError> {
        super::bsp::in_pool(options.threads, || NativeAccel::build_here(scene, options))
    }

    /// Builds the structures in the current thread pool.
    fn build_here(scene: &'s Scene, options: &AccelOptions) -> Result<NativeAccel<'s>, AccelError> {
        // Number the triangles of baked meshes in the order of their instances
        let (mut meshes, mut runs) = (Vec::<&Mesh>::new(), Vec::new());
        let (mut count, mut has_objects) = (0u32, false);
        for (index, instance) in scene.instances.iter().enumerate() {
            match &scene.geometries[instance.geometry as usize] {
                Geometry::Mesh(mesh) if instance.is_identity() => {
                    let first = count;
                    let length = u32::try_from(mesh.triangles.len()).ok();
                    count = length
                        .and_then(|length| count.checked_add(length))
                        .ok_or(AccelError::OutOfMemory)?;
                    runs.push(TriangleRun {
                        first,
                        end: count,
                        instance: index as u32,
                    });
                    meshes.push(mesh);
                }
                geometry => has_objects |= !geometry.is_unbounded(),
            }
        }
        // Build the tree, then the structure of everything else
        let triangles = build::build_tree(&meshes).ok_or(AccelError::OutOfMemory)?;
        let others = match has_objects {
            true => Others::Objects(Box::new(BspAccel::build_objects(scene, options)?)),
            false => Others::Planes(Planes::of(scene)),
        };
        // Report that all is built
        if let Some(progress) = options.progress {
            progress(1.0);
        }
        let small = SmallTree::of(&triangles);
        let tree_bytes = triangles.byte_count() + small.as_ref().map_or(0, SmallTree::byte_count);
        Ok(NativeAccel {
            report: report(tree_bytes as u64, count, &others),
            small: small.map(Arc::new),
            triangles: Arc::new(triangles),
            runs,
            others,
            kernel: options.kernel,
            simd: SimdLimit::within(options.isa.as_deref()),
        })
    }

    /// Returns the same structures with another kernel.
    pub(crate) fn with_kernel(&self, kernel: Kernel) -> NativeAccel<'s> {
        NativeAccel {
            triangles: Arc::clone(&self.triangles),
            small: self.small.clone(),
            runs: self.runs.clone(),
            others: match &self.others {
                Others::Planes(planes) => Others::Planes(planes.clone()),
                Others::Objects(bsp) => Others::Objects(Box::new(bsp.with_kernel(kernel))),
            },
            kernel,
            simd: self.simd,
            report: self.report.clone(),
        }
    }

    /// Finds the nearest hits if the rays can be traced as a group; else returns false, with hits of earlier queries
    /// forgotten.
    pub(super) fn intersect_group(&self, packets: &mut [RayPacket], order: Coherence) -> bool {
        // Find a common origin. Rays from surfaces are no case for groups: their origins are as uncertain as the
        // nearest hits
        let simd = self.simd;
        let common_origin = simd.dispatch(QueryStart(packets));
        let is_grouped = self.kernel == Kernel::Packet && order == Coherence::Coherent;
        let Some(origin) = common_origin.filter(|_| is_grouped) else {
            return false;
        };
        // Trace them, then name the hits
        group::intersect(simd, self.triangles.view(), packets, origin);
        self.complete(packets, order);
        true
    }

    /// Traces rays of any origins and directions through the tree.
    fn trace_triangles(&self, packets: &mut [RayPacket], query: Query) {
        let (simd, tree) = (self.simd, self.triangles.view());
        match &self.small {
            Some(small) if self.kernel == Kernel::Packet => packet::trace(simd, tree, small, packets, query),
            _ => single::trace(simd, tree, packets, query),
        }
    }

    /// Names the instances of the hits, then looks for nearer hits of shapes and planes.
    fn complete(&self, packets: &mut [RayPacket], order: Coherence) {
        let runs = &self.runs;
        self.simd.dispatch(HitNames { runs, packets });
        self.intersect_others(packets, order);
    }

    /// Finds hits of the structures other than the tree that are nearer than those in the packets.
    fn intersect_others(&self, packets: &mut [RayPacket], order: Coherence) {
        let bsp = match &self.others {
            Others::Planes(planes) => return planes.trace(packets, Query::Nearest),
            Others::Objects(bsp) => bsp,
        };
        for packets in packets.chunks_mut(MAX_BATCH) {
            // Keep the hits of triangles where the BSP finds others at the same parameter
            let before: [FoundHits; MAX_BATCH] =
                std::array::from_fn(|index| packets.get(index).map_or(FoundHits::NONE, FoundHits::of));
            bsp.intersect(packets, order);
            for (packet, before) in packets.iter_mut().zip(&before) {
                before.keep_ties(packet);
            }
        }
    }

    /// Marks the lanes that other structures than the tree block.
    fn occlude_others(&self, packets: &mut [RayPacket], order: Coherence) {
        let bsp = match &self.others {
            Others::Planes(planes) => return planes.trace(packets, Query::Any),
            Others::Objects(bsp) => bsp,
        };
        for packets in packets.chunks_mut(MAX_BATCH) {
            let before: [Lanes<i32>; MAX_BATCH] =
                std::array::from_fn(|index| packets.get(index).map_or([0; LANES], |packet| packet.active));
            // Blocked lanes have an empty interval, and need no second query
            for packet in packets.iter_mut() {
                for lane in 0..LANES {
                    let is_blocked = packet.t_far[lane] == f32::NEG_INFINITY;
                    packet.active[lane] = if is_blocked { 0 } else { packet.active[lane] };
                }
            }
            bsp.occluded(packets, order);
            // Restore the lanes
            for (packet, before) in packets.iter_mut().zip(&before) {
                packet.active = *before;
            }
        }
    }
}

impl Accel for NativeAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: Coherence) {
        if self.intersect_group(packets, order) {
            return;
        }
        self.trace_triangles(packets, Query::Nearest);
        self.complete(packets, order);
    }

    fn occluded(&self, packets: &mut [RayPacket], order: Coherence) {
        self.trace_triangles(packets, Query::Any);
        self.occlude_others(packets, order);
    }

    fn occluded_towards(&self, packets: &mut [RayPacket], end: RayEnd) {
        if self.kernel == Kernel::Single {
            return self.occluded(packets, Coherence::Coherent);
        }
        group::occluded(self.simd, self.triangles.view(), packets, end);
        self.occlude_others(packets, Coherence::Coherent);
    }

    fn gains_from_ends(&self) -> bool {
        self.kernel != Kernel::Single
    }

    fn batch(&self) -> usize {
        MAX_BATCH
    }

    fn report(&self) -> AccelReport {
        self.report.clone()
    }
}

/// Packets before a query for the nearest hits.
struct QueryStart<'a>(&'a mut [RayPacket]);

impl SimdKernel for QueryStart<'_> {
    type Output = Option<Vec3>;

    /// Forgets hits of earlier queries, whose triangles have other numbers. Returns the origin of all active rays, if
    /// they have the same.
    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) -> Option<Vec3> {
        // Find the origin of the first active ray
        let QueryStart(packets) = self;
        let first = packets.iter().find(|packet| packet.any_active())?;
        let lane = (0..LANES).find(|&lane| first.is_active(lane))?;
        let origin = first.origin.map(|axis| axis[lane]);
        let sixteen = isa.sixteen();
        let common = origin.map(|x| Floats::splat(sixteen, x));
        let mut differs = 0;
        for packet in packets {
            // Compare it with the others
            let mut same = Floats::load(sixteen, &packet.origin[0]).eq(common[0]);
            for axis in 1..3 {
                same = same & Floats::load(sixteen, &packet.origin[axis]).eq(common[axis]);
            }
            let active = Floats::load(sixteen, bytemuck::cast_ref(&packet.active)).signs();
            differs |= active & !same.bits();
            // Clear the hits; the bits of active lanes are all set, and so are those of `NO_HIT`
            for lane in 0..LANES {
                packet.instance[lane] |= packet.active[lane] as u32;
            }
        }
        (differs == 0).then(|| Vec3::from(origin))
    }
}

/// Packets whose hits have numbers of triangles, which are to be replaced by their instances and indices.
struct HitNames<'a> {
    runs: &'a [TriangleRun],
    packets: &'a mut [RayPacket],
}

impl SimdKernel for HitNames<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) {
        let sixteen = isa.sixteen();
        let none = Floats::splat(sixteen, f32::from_bits(NO_HIT));
        let zero = Floats::splat(sixteen, 0.0);
        for packet in self.packets {
            // Find the lanes with hits
            let is_missing = Floats::load(sixteen, bytemuck::cast_ref(&packet.instance)).eq_bits(none);
            let active = Floats::load(sixteen, bytemuck::cast_ref(&packet.active)).signs();
            let mut remaining = active & !is_missing.bits();
            while remaining != 0 {
                // Find those on the instance of the first one
                let first = remaining.trailing_zeros() as usize % LANES;
                let run = TriangleRun::of(self.runs, packet.primitive[first]);
                let own = remaining & run.contains(sixteen, &packet.primitive);
                remaining &= !own;
                // Replace the numbers; all instances were 0
                let own = LaneMask::of_bits(sixteen, own);
                let start = own.select(Floats::splat(sixteen, f32::from_bits(run.first)), zero);
                let instance = own.select(Floats::splat(sixteen, f32::from_bits(run.instance)), zero);
                let [start, instance]: [Lanes<u32>; 2] = [
                    bytemuck::cast(start.to_array()),
                    bytemuck::cast(instance.to_array()),
                ];
                for lane in 0..LANES {
                    packet.primitive[lane] -= start[lane];
                    packet.instance[lane] |= instance[lane];
                }
            }
        }
    }
}

/// Hits of a packet that another structure may replace.
struct FoundHits {
    t: Lanes<f32>,
    u: Lanes<f32>,
    v: Lanes<f32>,
    primitive: Lanes<u32>,
    instance: Lanes<u32>,
}

impl FoundHits {
    const NONE: FoundHits = FoundHits {
        t: [0.0; LANES],
        u: [0.0; LANES],
        v: [0.0; LANES],
        primitive: [NO_HIT; LANES],
        instance: [NO_HIT; LANES],
    };

    #[inline(always)]
    fn of(packet: &RayPacket) -> FoundHits {
        FoundHits {
            t: packet.t_far,
            u: packet.u,
            v: packet.v,
            primitive: packet.primitive,
            instance: packet.instance,
        }
    }

    /// Restores these hits where a hit of a later instance at the same parameter has replaced them.
    #[inline(always)]
    fn keep_ties(&self, packet: &mut RayPacket) {
        for lane in 0..LANES {
            let is_tie = (packet.t_far[lane] == self.t[lane]) & (self.instance[lane] < packet.instance[lane]);
            packet.u[lane] = if is_tie { self.u[lane] } else { packet.u[lane] };
            packet.v[lane] = if is_tie { self.v[lane] } else { packet.v[lane] };
            packet.primitive[lane] = if is_tie {
                self.primitive[lane]
            } else {
                packet.primitive[lane]
            };
            packet.instance[lane] = if is_tie {
                self.instance[lane]
            } else {
                packet.instance[lane]
            };
        }
    }
}

/// Describes the structures and their memory.
fn report(tree_bytes: u64, count: u32, others: &Others) -> AccelReport {
    // Start with the report of the other structures
    let (mut report, beside) = match others {
        Others::Planes(planes) => (AccelReport::default(), format!("{} planes", planes.count())),
        Others::Objects(bsp) => (bsp.report(), bsp.report().summary),
    };
    // Add the tree
    report.bytes += tree_bytes;
    report.peak_bytes = report.bytes.max(report.peak_bytes + tree_bytes);
    report.parts.push(AccelPart {
        holder: "triangles",
        what: "tree of triangles",
        bytes: tree_bytes,
    });
    report.summary = format!("eight-wide tree of {count} triangles for groups of rays, {beside}");
    report
}
