//! Embree's ray packets of any width as rows of lanes, and the trace calls on them.

use std::mem::{align_of, offset_of, size_of};

use embree_sys as sys;
use glam::Vec3;

use crate::accel::embree::scene::SceneRef;
use crate::accel::{ACTIVE, Hit, LANES, NO_HIT, Query, RayPacket};
use crate::mesh::simd::SimdLevel;
use crate::numeric::Ray;

/// Number of rows of `RTCRayHitN` in the widest version, each of one 4-byte word per lane. Embree 3 has one row fewer.
const ROW_COUNT: usize = 21;

/// Row index of each field of `RTCRayHitN`. The `Y` and `Z` rows follow `X`.
pub(in crate::accel::embree) mod row {
    pub(crate) const ORIGIN: usize = 0;
    pub(crate) const T_NEAR: usize = 3;
    pub(crate) const DIRECTION: usize = 4;
    pub(crate) const TIME: usize = 7;
    pub(crate) const T_FAR: usize = 8;
    pub(crate) const MASK: usize = 9;
    pub(crate) const U: usize = 15;
    pub(crate) const V: usize = 16;
    pub(crate) const PRIMITIVE: usize = 17;
    pub(crate) const INSTANCE: usize = 18;
    pub(crate) const LEVEL: usize = 19;
}

// `RayPacket` begins with the layout of `RTCRayHit16`, followed by its valid mask. Its private rows lie between public
// ones of the same size, so their offsets are correct if those of the public rows are.
const _: () = {
    assert!(offset_of!(RayPacket, origin) == offset_of!(sys::RTCRayHit16, ray.org_x));
    assert!(offset_of!(RayPacket, t_near) == offset_of!(sys::RTCRayHit16, ray.tnear));
    assert!(offset_of!(RayPacket, direction) == offset_of!(sys::RTCRayHit16, ray.dir_x));
    assert!(offset_of!(RayPacket, time) == offset_of!(sys::RTCRayHit16, ray.time));
    assert!(offset_of!(RayPacket, t_far) == offset_of!(sys::RTCRayHit16, ray.tfar));
    assert!(offset_of!(RayPacket, u) == offset_of!(sys::RTCRayHit16, hit.u));
    assert!(offset_of!(RayPacket, v) == offset_of!(sys::RTCRayHit16, hit.v));
    assert!(offset_of!(RayPacket, primitive) == offset_of!(sys::RTCRayHit16, hit.primID));
    assert!(offset_of!(RayPacket, instance) == offset_of!(sys::RTCRayHit16, hit.geomID));
    assert!(offset_of!(RayPacket, active) >= size_of::<sys::RTCRayHit16>());
    assert!(offset_of!(RayPacket, active) == ROW_COUNT * LANES * size_of::<u32>());
    assert!(offset_of!(RayPacket, active).is_multiple_of(64));
    assert!(align_of::<RayPacket>() >= align_of::<sys::RTCRayHit16>());
};

// `Lanes<W>` is large enough for `RTCRayHitW` of both versions. Embree pads the single one to a multiple of 16 bytes.
const _: () = {
    assert!(size_of::<Lanes<1>>() >= size_of::<sys::RTCRayHit>());
    assert!(offset_of!(Lanes<4>, active) >= size_of::<sys::RTCRayHit4>());
    assert!(offset_of!(Lanes<8>, active) >= size_of::<sys::RTCRayHit8>());
    assert!(offset_of!(Lanes<16>, active) >= size_of::<sys::RTCRayHit16>());
    assert!(
        offset_of!(Lanes<4>, active).is_multiple_of(16) && offset_of!(Lanes<8>, active).is_multiple_of(32)
    );
    assert!(
        offset_of!(sys::RTCRayHit, ray.tfar) == row::T_FAR * 4
            && offset_of!(sys::RTCRayHit, hit.u) == row::U * 4
    );
    assert!(offset_of!(sys::RTCRayHit, hit.geomID) == row::INSTANCE * 4);
    assert!(offset_of!(sys::RTCRayHit4, hit.geomID) == row::INSTANCE * 16);
    assert!(offset_of!(sys::RTCRayHit8, hit.geomID) == row::INSTANCE * 32);
};

/// Upper bound of direction components that Embree's reciprocal may replace. It takes components below a rounded 1e-18
/// as +1e-18, regardless of their sign, while the signs choose the octant of a ray. The bounds of a coherent packet
/// then contradict each other: 3.13.5 misses hits, or ends the process in an assertion. This limit is ten times
/// Embree's.
const VANISHING: f32 = 1e-17;

/// Returns whether a ray with this direction component must not be flagged as coherent. Zeros may: their sign decides
/// nothing.
#[inline(always)]
pub(super) fn is_vanishing(component: f32) -> bool {
    // Compare the bits without the sign; zero minus one wraps around and is above every other value.
    (component.to_bits() & 0x7fff_ffff).wrapping_sub(1) < VANISHING.to_bits() - 1
}

/// A packet of `W` = 1, 4, 8 or 16 rays in Embree's layout.
#[repr(C, align(64))]
pub(in crate::accel::embree) struct Lanes<const W: usize> {
    rows: [[u32; W]; ROW_COUNT],
    active: [i32; W],
}

impl<const W: usize> Lanes<W> {
    /// Creates a packet with no active lane and no hit.
    pub(in crate::accel::embree) fn new() -> Lanes<W> {
        let mut rows = [[0; W]; ROW_COUNT];
        rows[row::MASK] = [u32::MAX; W];
        rows[row::PRIMITIVE] = [NO_HIT; W];
        rows[row::INSTANCE] = [NO_HIT; W];
        rows[row::LEVEL] = [NO_HIT; W];
        Lanes { rows, active: [0; W] }
    }

    /// Copies the rays of part `number` of a packet, whose active rays are traceable, without their hits. Inactive
    /// lanes become zero.
    #[inline(always)]
    pub(super) fn load_rays(&mut self, packet: &RayPacket, number: usize) {
        self.active = *lanes_of(&packet.active, number);
        self.rows[row::INSTANCE] = [NO_HIT; W];
        self.rows[row::LEVEL] = [NO_HIT; W];
        let [origin, direction] = [&packet.origin, &packet.direction];
        for (row, values) in [
            (row::ORIGIN, &origin[0]),
            (row::ORIGIN + 1, &origin[1]),
            (row::ORIGIN + 2, &origin[2]),
            (row::T_NEAR, &packet.t_near),
            (row::DIRECTION, &direction[0]),
            (row::DIRECTION + 1, &direction[1]),
            (row::DIRECTION + 2, &direction[2]),
            (row::TIME, &packet.time),
            (row::T_FAR, &packet.t_far),
        ] {
            let values: &[f32; W] = lanes_of(values, number);
            for lane in 0..W {
                // The bits of active lanes are all set
                self.rows[row][lane] = values[lane].to_bits() & self.active[lane] as u32;
            }
        }
    }

    /// Writes the results of a query into part `number` of the packet that it was copied from.
    #[inline(always)]
    pub(super) fn put_results(&self, packet: &mut RayPacket, number: usize, query_kind: Query) {
        let t_far = lanes_of_mut::<_, W>(&mut packet.t_far, number);
        if query_kind == Query::Any {
            for lane in 0..W {
                let is_blocked = self.is_active(lane) & self.is_blocked(lane);
                t_far[lane] = if is_blocked {
                    f32::NEG_INFINITY
                } else {
                    t_far[lane]
                };
            }
            return;
        }
        // Replace the hits of the lanes that have one
        let [u, v] = [&mut packet.u, &mut packet.v].map(|row| lanes_of_mut::<_, W>(row, number));
        let [primitive, instance] =
            [&mut packet.primitive, &mut packet.instance].map(|row| lanes_of_mut::<_, W>(row, number));
        for lane in 0..W {
            let is_hit = self.is_active(lane) & (self.rows[row::INSTANCE][lane] != NO_HIT);
            let hit = hit_of(self, lane);
            t_far[lane] = if is_hit { hit.t } else { t_far[lane] };
            u[lane] = if is_hit { hit.u } else { u[lane] };
            v[lane] = if is_hit { hit.v } else { v[lane] };
            primitive[lane] = if is_hit { hit.primitive } else { primitive[lane] };
            instance[lane] = if is_hit { hit.instance } else { instance[lane] };
        }
    }

    /// Sets a lane to a ray without a hit; a ray that is not traceable stays inactive.
    #[inline(always)]
    pub(in crate::accel::embree) fn set(&mut self, lane: usize, ray: &Ray) {
        for axis in 0..3 {
            self.rows[row::ORIGIN + axis][lane] = ray.origin[axis].to_bits();
            self.rows[row::DIRECTION + axis][lane] = ray.direction[axis].to_bits();
        }
        self.rows[row::T_NEAR][lane] = ray.t_near.to_bits();
        self.rows[row::T_FAR][lane] = ray.t_far.to_bits();
        self.rows[row::TIME][lane] = ray.time.to_bits();
        self.active[lane] = if ray.is_traceable() { ACTIVE } else { 0 };
    }

    /// Returns whether any lane is active.
    #[inline(always)]
    pub(in crate::accel::embree) fn any_active(&self) -> bool {
        self.active.iter().fold(0, |a, &b| a | b) != 0
    }

    /// Returns whether the active lanes may be flagged as coherent (see [`is_vanishing`]).
    #[inline(always)]
    pub(in crate::accel::embree) fn may_be_coherent(&self) -> bool {
        let directions = &self.rows[row::DIRECTION..row::DIRECTION + 3];
        !directions
            .iter()
            .any(|row| (0..W).any(|lane| self.active[lane] != 0 && is_vanishing(f32::from_bits(row[lane]))))
    }

    /// Returns whether a lane is active.
    #[inline(always)]
    pub(in crate::accel::embree) fn is_active(&self, lane: usize) -> bool {
        self.active[lane] != 0
    }

    /// Returns one field of one lane, as bits.
    #[inline(always)]
    pub(in crate::accel::embree) fn get(&self, row: usize, lane: usize) -> u32 {
        self.rows[row][lane]
    }

    /// Returns whether an occlusion query has found a hit of the lane.
    #[inline(always)]
    pub(in crate::accel::embree) fn is_blocked(&self, lane: usize) -> bool {
        f32::from_bits(self.get(row::T_FAR, lane)) == f32::NEG_INFINITY
    }

    /// Traces the active lanes. Occlusion sets `T_FAR` of every lane that hits anything to negative infinity.
    #[inline(always)]
    pub(in crate::accel::embree) fn trace(
        &mut self,
        scene: SceneRef,
        query: *mut sys::EmbreeQuery,
        query_kind: Query,
    ) {
        let rays: *mut Lanes<W> = self;
        let valid = rays.wrapping_byte_add(offset_of!(Lanes<W>, active)).cast::<i32>();
        let scene = scene.handle();
        match (W, query_kind) {
            // SAFETY: the lane is active (the caller checks it first) and traceable; `query` belongs to this thread.
            (1, Query::Nearest) => unsafe { sys::embree_intersect1(scene, query, rays.cast()) },
            // SAFETY: `Lanes` holds an `RTCRayHit4` and, behind it, its aligned mask; active lanes are traceable.
            (4, Query::Nearest) => unsafe { sys::embree_intersect4(valid, scene, query, rays.cast()) },
            // SAFETY: as for 4.
            (8, Query::Nearest) => unsafe { sys::embree_intersect8(valid, scene, query, rays.cast()) },
            // SAFETY: as for 4.
            (16, Query::Nearest) => unsafe { sys::embree_intersect16(valid, scene, query, rays.cast()) },
            // SAFETY: as for the nearest hit; an `RTCRayN` is the beginning of an `RTCRayHitN`.
            (1, Query::Any) => unsafe { sys::embree_occluded1(scene, query, rays.cast()) },
            // SAFETY: as for 1 and as for the nearest hit.
            (4, Query::Any) => unsafe { sys::embree_occluded4(valid, scene, query, rays.cast()) },
            // SAFETY: as for 1 and as for the nearest hit.
            (8, Query::Any) => unsafe { sys::embree_occluded8(valid, scene, query, rays.cast()) },
            // SAFETY: as for 1 and as for the nearest hit.
            (16, Query::Any) => unsafe { sys::embree_occluded16(valid, scene, query, rays.cast()) },
            _ => unreachable!("Embree traces packets of 1, 4, 8 and 16 rays"),
        }
    }
}

/// Returns `W` lanes of a row, of which `number` times as many are before them.
#[inline(always)]
fn lanes_of<T, const W: usize>(row: &[T; LANES], number: usize) -> &[T; W] {
    let (parts, _) = row.as_chunks::<W>();
    &parts[number]
}

/// Returns `W` lanes of a row as [`lanes_of`] does, for writing.
#[inline(always)]
fn lanes_of_mut<T, const W: usize>(row: &mut [T; LANES], number: usize) -> &mut [T; W] {
    let (parts, _) = row.as_chunks_mut::<W>();
    &mut parts[number]
}

/// View of lanes `first .. first + W` of a packet that Embree passes to a callback.
#[derive(Clone, Copy)]
pub(in crate::accel::embree) struct CallbackPacket {
    base: *mut u32,
    count: usize,
    first: usize,
}

impl CallbackPacket {
    /// Wraps a packet of a callback.
    ///
    /// # Safety
    ///
    /// `base` points to an `RTCRayN` or `RTCRayHitN` of `count` lanes to which this thread has exclusive access while
    /// the value lives, and `first` plus the width used never exceeds `count`.
    pub(in crate::accel::embree) unsafe fn new(base: *mut u32, count: usize, first: usize) -> CallbackPacket {
        CallbackPacket { base, count, first }
    }

    /// Loads one row as bits. Rows from `U` on exist only in an `RTCRayHitN`.
    #[inline(always)]
    pub(in crate::accel::embree) fn load<const W: usize>(&self, row: usize) -> [u32; W] {
        let at = self
            .base
            .wrapping_add(row * self.count + self.first)
            .cast::<[u32; W]>();
        // SAFETY: within the packet by the contract of `new`; plain words of alignment 4.
        unsafe { at.read_unaligned() }
    }

    /// Loads one row as floats.
    #[inline(always)]
    pub(in crate::accel::embree) fn floats<const W: usize>(&self, row: usize) -> [f32; W] {
        let at = self
            .base
            .wrapping_add(row * self.count + self.first)
            .cast::<[f32; W]>();
        // SAFETY: as in `load`; every word is a float.
        unsafe { at.read_unaligned() }
    }

    /// Loads three rows as the coordinates of vectors.
    #[inline(always)]
    pub(in crate::accel::embree) fn vectors<const W: usize>(&self, row: usize) -> [[f32; W]; 3] {
        [self.floats(row), self.floats(row + 1), self.floats(row + 2)]
    }

    /// Loads one field of one lane, as bits.
    #[inline(always)]
    pub(in crate::accel::embree) fn load_one(&self, row: usize, lane: usize) -> u32 {
        let at = self.base.wrapping_add(row * self.count + self.first + lane);
        // SAFETY: within the packet by the contract of `new`.
        unsafe { at.read() }
    }

    /// Stores one row of `W` lanes.
    #[inline(always)]
    pub(in crate::accel::embree) fn store<const W: usize>(&self, row: usize, bits: [u32; W]) {
        let at = self
            .base
            .wrapping_add(row * self.count + self.first)
            .cast::<[u32; W]>();
        // SAFETY: within the packet by the contract of `new`, which also gives exclusive access.
        unsafe { at.write_unaligned(bits) };
    }

    /// Stores one field of one lane.
    #[inline(always)]
    pub(in crate::accel::embree) fn set(&self, row: usize, lane: usize, bits: u32) {
        let at = self.base.wrapping_add(row * self.count + self.first + lane);
        // SAFETY: within the packet by the contract of `new`, which also gives exclusive access.
        unsafe { at.write(bits) };
    }
}

/// Gathers the ray of one lane from loaded rows; `interval` is `t_near`, `t_far` and the time.
#[inline(always)]
pub(in crate::accel::embree) fn ray_of<const W: usize>(
    origin: &[[f32; W]; 3],
    direction: &[[f32; W]; 3],
    interval: (f32, f32, f32),
    lane: usize,
) -> Ray {
    let vector = |v: &[[f32; W]; 3]| Vec3::new(v[0][lane], v[1][lane], v[2][lane]);
    Ray {
        origin: vector(origin),
        direction: vector(direction),
        t_near: interval.0,
        t_far: interval.1,
        time: interval.2,
    }
}

/// Returns a bit mask of the active lanes: bit `i` is set if lane `i` is active.
#[inline(always)]
pub(in crate::accel::embree) fn active_lanes<I: SimdLevel, const W: usize>(isa: I, valid: &[i32; W]) -> u32 {
    let mut bits = [0.0; W];
    for lane in 0..W {
        // An active lane is all ones, which as a float is NaN and so unequal to zero.
        bits[lane] = f32::from_bits(valid[lane] as u32);
    }
    !isa.eq(&bits, &[0.0; W]) & (u32::MAX >> (u32::BITS as usize - W))
}

/// Returns the hit of a lane that has one.
#[inline(always)]
pub(in crate::accel::embree) fn hit_of<const W: usize>(lanes: &Lanes<W>, lane: usize) -> Hit {
    Hit {
        instance: number_of_instance([row::INSTANCE, row::LEVEL].map(|row| lanes.get(row, lane))),
        primitive: lanes.get(row::PRIMITIVE, lane),
        t: f32::from_bits(lanes.get(row::T_FAR, lane)),
        u: f32::from_bits(lanes.get(row::U, lane)),
        v: f32::from_bits(lanes.get(row::V, lane)),
    }
}

/// Returns the scene's index of the instance hit, from Embree's geometry ID and instance ID. In an instance of Embree's
/// own the geometry ID has no meaning; all other geometry is in no instance.
#[inline(always)]
pub(in crate::accel::embree) fn number_of_instance([geometry, level]: [u32; 2]) -> u32 {
    if level == NO_HIT { geometry } else { level }
}
