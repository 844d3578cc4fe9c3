//! Trace calls: packets cross the boundary without a copy where they are as wide as the device, else in parts.

use std::mem::{MaybeUninit, offset_of};

use embree_sys as sys;

use super::build::EmbreeScene;
use crate::accel::{LANES, RayOrder, RayPacket};

/// Rows of sixteen values that make a packet with its hit, and those of the ray alone.
const ROWS: usize = size_of::<sys::RTCRayHit16>() / size_of::<[u32; LANES]>();
/// The row of `tfar` and those of the hit that callers read: u, v, primitive, geometry.
const ANSWER_ROWS: [usize; 5] = [8, 15, 16, 17, 18];
/// Rows that a ray without a hit has.
const RAY_ROWS: usize = size_of::<sys::RTCRay16>() / size_of::<[u32; LANES]>();

// A `RayPacket` begins with Embree's 16-wide ray and hit, so its address is passed as theirs.
const _: () = {
    assert!(offset_of!(RayPacket, origin) == offset_of!(sys::RTCRay16, org_x));
    assert!(offset_of!(RayPacket, t_near) == offset_of!(sys::RTCRay16, tnear));
    assert!(offset_of!(RayPacket, direction) == offset_of!(sys::RTCRay16, dir_x));
    assert!(offset_of!(RayPacket, t_far) == offset_of!(sys::RTCRay16, tfar));
    assert!(offset_of!(sys::RTCRayHit16, hit) == size_of::<sys::RTCRay16>());
    assert!(offset_of!(RayPacket, u) == size_of::<sys::RTCRay16>() + offset_of!(sys::RTCHit16, u));
    assert!(offset_of!(RayPacket, v) == size_of::<sys::RTCRay16>() + offset_of!(sys::RTCHit16, v));
    assert!(
        offset_of!(RayPacket, primitive) == size_of::<sys::RTCRay16>() + offset_of!(sys::RTCHit16, primID)
    );
    assert!(
        offset_of!(RayPacket, instance) == size_of::<sys::RTCRay16>() + offset_of!(sys::RTCHit16, geomID)
    );
    assert!(offset_of!(RayPacket, active) >= size_of::<sys::RTCRayHit16>());
    assert!(offset_of!(RayPacket, active) % 64 == 0 && align_of::<RayPacket>() >= 64);
};

/// Rays a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Width {
    One,
    Four,
    Eight,
    Sixteen,
}

/// Room for the shim's query structure, whichever version's it is.
const QUERY_WORDS: usize = 64;

/// What accompanies trace calls, with the order of the rays for callbacks to read.
#[repr(C)]
pub(super) struct Query {
    /// Embree's part comes first: callbacks get its address back.
    shim: MaybeUninit<[u64; QUERY_WORDS]>,
    order: RayOrder,
}

impl Query {
    pub(super) fn new(order: RayOrder) -> Query {
        let mut query = Query {
            shim: MaybeUninit::uninit(),
            order,
        };
        // SAFETY: the room is aligned for pointers, and `fits` has been checked when the scene was built.
        unsafe { sys::whitInitQuery(query.as_ptr(), i32::from(order == RayOrder::Coherent)) };
        query
    }

    /// Whether the shim's structure fits into the room kept for it.
    pub(super) fn fits() -> bool {
        // SAFETY: the function returns a constant.
        unsafe { sys::whitQuerySize() <= size_of::<[u64; QUERY_WORDS]>() }
    }

    /// The order of the rays of the query that `context`, a callback's argument, belongs to.
    ///
    /// # Safety
    ///
    /// `context` must come from a call that was made with a `Query`.
    pub(super) unsafe fn order_of(context: *const std::ffi::c_void) -> RayOrder {
        // SAFETY: Embree's context is the first field of the shim's structure, which is the first field of a `Query`.
        unsafe { (*context.cast::<Query>()).order }
    }

    fn as_ptr(&mut self) -> *mut sys::WhitQuery {
        std::ptr::from_mut(self).cast()
    }

    /// Finds the nearest hits of a packet whose active rays have been checked.
    #[inline]
    pub(super) fn intersect(&mut self, scene: &EmbreeScene, packet: &mut RayPacket, width: Width) {
        match width {
            Width::Sixteen => self.intersect_whole(scene, packet),
            Width::Eight => in_parts::<8, ROWS>(packet, &ANSWER_ROWS, |valid, part| {
                // SAFETY: `valid` and `part` have Embree's layout and alignment, and the scene is committed.
                unsafe { sys::whitIntersect8(valid, scene.raw(), self.as_ptr(), part.cast()) }
            }),
            Width::Four => in_parts::<4, ROWS>(packet, &ANSWER_ROWS, |valid, part| {
                // SAFETY: as above.
                unsafe { sys::whitIntersect4(valid, scene.raw(), self.as_ptr(), part.cast()) }
            }),
            Width::One => in_parts::<1, ROWS>(packet, &ANSWER_ROWS, |_, part| {
                // SAFETY: as above; a single ray is active, or the part would not be traced.
                unsafe { sys::whitIntersect1(scene.raw(), self.as_ptr(), part.cast()) }
            }),
        }
    }

    /// Marks the blocked rays of a packet whose active rays have been checked.
    #[inline]
    pub(super) fn occluded(&mut self, scene: &EmbreeScene, packet: &mut RayPacket, width: Width) {
        const T_FAR: [usize; 1] = [ANSWER_ROWS[0]];
        match width {
            Width::Sixteen => self.occluded_whole(scene, packet),
            Width::Eight => in_parts::<8, RAY_ROWS>(packet, &T_FAR, |valid, part| {
                // SAFETY: `valid` and `part` have Embree's layout and alignment, and the scene is committed.
                unsafe { sys::whitOccluded8(valid, scene.raw(), self.as_ptr(), part.cast()) }
            }),
            Width::Four => in_parts::<4, RAY_ROWS>(packet, &T_FAR, |valid, part| {
                // SAFETY: as above.
                unsafe { sys::whitOccluded4(valid, scene.raw(), self.as_ptr(), part.cast()) }
            }),
            Width::One => in_parts::<1, RAY_ROWS>(packet, &T_FAR, |_, part| {
                // SAFETY: as above; a single ray is active, or the part would not be traced.
                unsafe { sys::whitOccluded1(scene.raw(), self.as_ptr(), part.cast()) }
            }),
        }
    }

    /// The bare 16-wide call.
    #[inline]
    pub(super) fn intersect_whole(&mut self, scene: &EmbreeScene, packet: &mut RayPacket) {
        let valid = packet.active.as_ptr();
        let rays = std::ptr::from_mut(packet).cast();
        // SAFETY: the layout is checked above; `active` lies behind what Embree writes; the scene is committed.
        unsafe { sys::whitIntersect16(valid, scene.raw(), self.as_ptr(), rays) };
    }

    /// The bare 16-wide call.
    #[inline]
    pub(super) fn occluded_whole(&mut self, scene: &EmbreeScene, packet: &mut RayPacket) {
        let valid = packet.active.as_ptr();
        let rays = std::ptr::from_mut(packet).cast();
        // SAFETY: as for `intersect_whole`; only the ray's rows are touched.
        unsafe { sys::whitOccluded16(valid, scene.raw(), self.as_ptr(), rays) };
    }
}

/// A narrower packet: `R` rows of `N` values. For `N = 1` this is Embree's single ray, field by field.
#[repr(C, align(64))]
struct Part<const N: usize, const R: usize> {
    rows: [[u32; N]; R],
}

/// A mask of its own alignment.
#[repr(C, align(64))]
struct Mask<const N: usize>([i32; N]);

/// Traces a packet `N` lanes at a time through `trace` and copies the rows `answers` back.
#[inline]
fn in_parts<const N: usize, const R: usize>(
    packet: &mut RayPacket,
    answers: &[usize],
    mut trace: impl FnMut(*const i32, *mut Part<N, R>),
) {
    for start in (0..LANES).step_by(N) {
        let mut valid = Mask([0; N]);
        valid.0.copy_from_slice(&packet.active[start..start + N]);
        if valid.0.iter().all(|&active| active == 0) {
            continue;
        }
        let rows = rows_of(packet);
        let mut part = Part::<N, R> { rows: [[0; N]; R] };
        for (row, whole) in part.rows.iter_mut().zip(rows.iter()) {
            row.copy_from_slice(&whole[start..start + N]);
        }
        trace(valid.0.as_ptr(), &mut part);
        for &row in answers {
            rows[row][start..start + N].copy_from_slice(&part.rows[row]);
        }
    }
}

/// The packet as rows of 32-bit values.
fn rows_of(packet: &mut RayPacket) -> &mut [[u32; LANES]; ROWS] {
    // SAFETY: a `RayPacket` is `repr(C)`, at least `ROWS` rows long, and made of 32-bit numbers for which any bits do.
    unsafe { &mut *std::ptr::from_mut(packet).cast() }
}
