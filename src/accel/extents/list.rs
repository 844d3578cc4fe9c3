//! List backend: every object is tested, but behind its bounding volume.
//!
//! Sixteen rays are tested against a volume at once; the object is then tested ray by ray by the code of brute force,
//! to the same bits. The order of the objects changes no result, because ties have an order of their own.

use super::kind::{BoundingVolumeCounts, BoundingVolumeKind};
use super::object::BoundedObject;
use super::rays::RayLanes;
use super::volumes::BoundingVolumes;
use crate::accel::brute::{is_occluded_by, nearest_of};
use crate::accel::planes::Planes;
use crate::accel::{Accel, AccelPart, AccelReport, Coherence, Hit, LANES, Query, RayPacket};
use crate::mesh::simd::{SimdKernel, SimdLevel, dispatch, lanes};
use crate::scene::Scene;

/// The objects of a scene in a list, each behind its bounding volume.
pub struct ListAccel<'s> {
    pub(super) scene: &'s Scene,
    pub(super) extents: BoundingVolumes,
    pub(super) planes: Planes,
}

/// Numbers of tests that rays cause. Planes are not counted: each has the one test that no volume could save.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Tally {
    /// Number of rays traced.
    pub rays: u64,
    /// Tests of a ray against an object that would be made without bounding volumes.
    pub objects: u64,
    /// Tests of a ray against an object.
    pub object_tests: u64,
    /// Tests of a ray against a bounding volume.
    pub extent_tests: u64,
    /// Tests of a packet's screen-space box against the box of an object.
    pub film_tests: u64,
}

/// Counter of tests; the default methods count nothing, at no cost.
pub(super) trait Count {
    /// Counts the rays of a packet, each against this many objects.
    fn rays(&mut self, _mask: u32, _objects: usize) {}
    /// Counts the rays that are tested against a bounding volume.
    fn extents(&mut self, _mask: u32) {}
    /// Counts the rays that are tested against an object.
    fn objects(&mut self, _mask: u32) {}
    /// Counts a test of a packet against a screen-space box.
    fn film(&mut self) {}
}

impl Count for () {}

impl Count for Tally {
    fn rays(&mut self, mask: u32, objects: usize) {
        self.rays += u64::from(mask.count_ones());
        self.objects += u64::from(mask.count_ones()) * objects as u64;
    }

    fn extents(&mut self, mask: u32) {
        self.extent_tests += u64::from(mask.count_ones());
    }

    fn objects(&mut self, mask: u32) {
        self.object_tests += u64::from(mask.count_ones());
    }

    fn film(&mut self) {
        self.film_tests += 1;
    }
}

impl std::ops::AddAssign for Tally {
    fn add_assign(&mut self, other: Tally) {
        self.rays += other.rays;
        self.objects += other.objects;
        self.object_tests += other.object_tests;
        self.extent_tests += other.extent_tests;
        self.film_tests += other.film_tests;
    }
}

impl<'s> ListAccel<'s> {
    /// Lists a validated scene's objects with bounding volumes of that kind.
    pub fn new(scene: &'s Scene, kind: BoundingVolumeKind) -> ListAccel<'s> {
        ListAccel::of_extents(scene, BoundingVolumes::new(scene, kind))
    }

    /// Lists the objects with volumes that are already computed.
    pub(super) fn of_extents(scene: &'s Scene, extents: BoundingVolumes) -> ListAccel<'s> {
        ListAccel {
            scene,
            extents,
            planes: Planes::of(scene),
        }
    }

    /// Returns the numbers of objects by kind of bounding volume.
    pub fn counts(&self) -> BoundingVolumeCounts {
        self.extents.counts()
    }

    /// Runs [`Accel::intersect`] and returns the number of tests.
    pub fn count_intersect(&self, packets: &mut [RayPacket]) -> Tally {
        let mut tally = Tally::default();
        self.trace(packets, Query::Nearest, &mut tally);
        tally
    }

    /// Runs [`Accel::occluded`] and returns the number of tests.
    pub fn count_occluded(&self, packets: &mut [RayPacket]) -> Tally {
        let mut tally = Tally::default();
        self.trace(packets, Query::Any, &mut tally);
        tally
    }

    fn trace(&self, packets: &mut [RayPacket], query: Query, count: &mut impl Count) {
        dispatch(PrimitiveBatch {
            list: self,
            packets,
            query,
            count,
        });
        self.planes.trace(packets, query);
    }
}

impl Accel for ListAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], _order: Coherence) {
        self.trace(packets, Query::Nearest, &mut ());
    }

    fn occluded(&self, packets: &mut [RayPacket], _order: Coherence) {
        self.trace(packets, Query::Any, &mut ());
    }

    fn report(&self) -> AccelReport {
        let objects = self.extents.objects();
        AccelReport {
            bytes: size_of_val(objects) as u64,
            peak_bytes: size_of_val(objects) as u64,
            embree: None,
            parts: vec![AccelPart {
                holder: "user-geometry",
                what: "list of objects",
                bytes: size_of_val(objects) as u64,
            }],
            summary: format!(
                "a list of {} objects, {} planes",
                objects.len(),
                self.planes.count()
            ),
        }
    }
}

struct PrimitiveBatch<'a, 's, C> {
    list: &'a ListAccel<'s>,
    packets: &'a mut [RayPacket],
    query: Query,
    count: &'a mut C,
}

impl<C: Count> SimdKernel for PrimitiveBatch<'_, '_, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) {
        let extents = &self.list.extents;
        for packet in self.packets {
            packet.drop_untraceable();
            let mut search = PrimitiveSearch::new(isa, self.list, packet, self.query);
            self.count.rays(search.active, extents.objects().len());
            // Test every object until no lane is active
            for object in extents.objects() {
                search.test_object(isa, object, u32::MAX, self.count);
                if search.active == 0 {
                    break;
                }
            }
            search.write(packet);
        }
    }
}

/// State of one packet while it is tested against objects, in any order.
pub(super) struct PrimitiveSearch<'a, 's> {
    list: &'a ListAccel<'s>,
    query: Query,
    rays: RayLanes,
    packet: RayPacket,
    best: [Option<Hit>; LANES],
    /// Parameters beyond which hits are ignored.
    pub(super) t_far: [f32; LANES],
    /// Lanes that are still traced; occluded ones are removed.
    pub(super) active: u32,
    blocked: u32,
}

impl<'a, 's> PrimitiveSearch<'a, 's> {
    #[inline(always)]
    pub(super) fn new(
        isa: impl SimdLevel,
        list: &'a ListAccel<'s>,
        packet: &RayPacket,
        query: Query,
    ) -> Self {
        let active = (0..LANES).fold(0, |mask, l| mask | u32::from(packet.active[l] != 0) << l);
        PrimitiveSearch {
            list,
            query,
            rays: RayLanes::new(isa, packet, list.extents.origin_factor()),
            packet: packet.clone(),
            best: [None; LANES],
            t_far: packet.t_far,
            active,
            blocked: 0,
        }
    }

    /// Tests the active lanes in `among` against one object.
    #[inline(always)]
    pub(super) fn test_object(
        &mut self,
        isa: impl SimdLevel,
        object: &BoundedObject,
        among: u32,
        count: &mut impl Count,
    ) {
        let among_active = self.active & among;
        let mut mask = among_active;
        // Cull lanes by the bounding volume
        if object.has_volume() {
            count.extents(among_active);
            mask &= object.hit_mask(isa, &self.rays, &self.t_far);
        }
        count.objects(mask);
        // Test the object ray by ray
        for lane in lanes(mask) {
            let lane = lane % LANES;
            let ray = self.packet.ray(lane);
            match self.query {
                Query::Nearest => {
                    nearest_of(self.list.scene, object.instance, &ray, &mut self.best[lane]);
                    if let Some(hit) = &self.best[lane] {
                        self.t_far[lane] = hit.t;
                    }
                }
                Query::Any => {
                    if is_occluded_by(self.list.scene, object.instance, &ray) {
                        self.blocked |= 1 << lane;
                        self.active &= !(1 << lane);
                    }
                }
            }
        }
    }

    /// Returns the largest parameter at which a hit still counts in any active lane.
    #[inline(always)]
    pub(super) fn last(&self) -> f32 {
        lanes(self.active).fold(f32::NEG_INFINITY, |last, lane| last.max(self.t_far[lane % LANES]))
    }

    /// Writes the results into the packet.
    #[inline(always)]
    pub(super) fn write(self, packet: &mut RayPacket) {
        for lane in lanes(self.blocked) {
            packet.set_blocked(lane % LANES);
        }
        for lane in 0..LANES {
            if let Some(hit) = &self.best[lane] {
                packet.set_hit(lane, hit);
            }
        }
    }
}
