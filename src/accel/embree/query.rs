//! Packets in, answers out: as wide as the processor takes them, or one ray at a time.

use std::fmt;
use std::mem::{MaybeUninit, offset_of};

use embree_sys as sys;
use multiversion::multiversion;

use super::device::Device;
use super::native_instances;
use super::ray_packet::{Lanes, row, vanishes};
use super::scene::{EmbreeScene, SceneRef};
use crate::accel::{Hit, Kernel, LANES, NO_HIT, RayOrder, RayPacket};

/// How many rays go into one call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Width {
    /// The whole packet, without a copy.
    Sixteen,
    /// Halves of it.
    Eight,
    /// Quarters of it.
    Four,
    /// Each lane by itself.
    One,
}

impl Width {
    /// The widest that runs natively; wider packets Embree would take apart itself, Embree 4 into single rays.
    pub(super) fn of(device: &Device, kernel: Kernel) -> Width {
        if kernel == Kernel::Single {
            Width::One
        } else if device.has(sys::RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED) {
            Width::Sixteen
        } else if device.has(sys::RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED) {
            Width::Eight
        } else if device.has(sys::RTC_DEVICE_PROPERTY_NATIVE_RAY4_SUPPORTED) {
            Width::Four
        } else {
            Width::One
        }
    }
}

/// From so many primitives of the user geometry on, or instances of Embree's own, incoherent rays go one by one. Embree
/// walks a packet through either as a whole, every ray into every cell that any of them meets, and not ray by ray as it
/// does over triangles: measured against single rays (`cargo bench --bench timing -- packet_width`) that is slower from
/// some hundred spheres on, nine times with 10^5.
const MANY_OBJECTS: usize = 256;

impl Width {
    /// What to take for incoherent rays through a scene with that many shapes and placed meshes.
    pub(super) fn for_incoherent(self, object_count: usize) -> Width {
        if object_count >= MANY_OBJECTS {
            Width::One
        } else {
            self
        }
    }
}

impl fmt::Display for Width {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Width::Sixteen => "packets of 16",
            Width::Eight => "packets of 8",
            Width::Four => "packets of 4",
            Width::One => "single rays",
        })
    }
}

/// Nearest hits of every packet.
pub(super) fn intersect(scene: &EmbreeScene, width: Width, packets: &mut [RayPacket], order: RayOrder) {
    let scene = scene.as_ref();
    for_each_traceable(scene, packets, order, |query, packet| match width {
        Width::Sixteen => intersect_packet(scene, query, packet),
        Width::Eight => intersect_split::<8>(scene, query, packet),
        Width::Four => intersect_split::<4>(scene, query, packet),
        Width::One => intersect_split::<1>(scene, query, packet),
    });
}

/// Blocked lanes of every packet.
pub(super) fn occluded(scene: &EmbreeScene, width: Width, packets: &mut [RayPacket], order: RayOrder) {
    let scene = scene.as_ref();
    for_each_traceable(scene, packets, order, |query, packet| match width {
        Width::Sixteen => occluded_packet(scene, query, packet),
        Width::Eight => occluded_split::<8>(scene, query, packet),
        Width::Four => occluded_split::<4>(scene, query, packet),
        Width::One => occluded_split::<1>(scene, query, packet),
    });
}

/// Hands on every packet of which anything may be traced, with the query that suits its rays.
#[inline(always)]
fn for_each_traceable(
    scene: SceneRef,
    packets: &mut [RayPacket],
    order: RayOrder,
    ask: impl Fn(*mut sys::EmbreeQuery, &mut RayPacket),
) {
    let (mut coherent, mut incoherent) = (new_query(scene.order(order)), new_query(RayOrder::Incoherent));
    let (coherent, incoherent) = (&raw mut coherent, &raw mut incoherent);
    for packet in packets {
        if scene.has_instances() {
            packet.drop_beyond(native_instances::RAY_LIMIT);
        }
        match keep_traceable(packet) {
            Remaining::Nothing => {}
            Remaining::Tame => ask(coherent, packet),
            Remaining::Wild => ask(incoherent, packet),
        }
    }
}

/// A query without a filter, for any number of calls.
pub(super) fn new_query(order: RayOrder) -> sys::EmbreeQuery {
    let mut query = MaybeUninit::uninit();
    // SAFETY: room for a query, which the call fills.
    unsafe { sys::embree_query_init(query.as_mut_ptr(), i32::from(order == RayOrder::Coherent)) };
    // SAFETY: filled just now, in every field that Embree reads.
    unsafe { query.assume_init() }
}

/// `rtcIntersect16` on the packet itself. Embree may abort the process, but no more, if an active lane is not
/// traceable.
#[inline(always)]
pub(super) fn intersect_packet(scene: SceneRef, query: *mut sys::EmbreeQuery, packet: &mut RayPacket) {
    let rays: *mut RayPacket = packet;
    let valid = rays
        .wrapping_byte_add(offset_of!(RayPacket, active))
        .cast::<i32>();
    // SAFETY: a `RayPacket` begins as an `RTCRayHit16` and holds its aligned mask (asserted in `ray_packet`); both are this
    // thread's own, as is the query.
    unsafe { sys::embree_intersect16(valid, scene.handle(), query, rays.cast()) };
    if scene.has_instances() {
        packet.name_instances();
    }
}

/// `rtcOccluded16` on the packet itself, as [`intersect_packet`].
#[inline(always)]
pub(super) fn occluded_packet(scene: SceneRef, query: *mut sys::EmbreeQuery, packet: &mut RayPacket) {
    let rays: *mut RayPacket = packet;
    let valid = rays
        .wrapping_byte_add(offset_of!(RayPacket, active))
        .cast::<i32>();
    // SAFETY: as in `intersect_packet`; an `RTCRay16` is the beginning of an `RTCRayHit16`.
    unsafe { sys::embree_occluded16(valid, scene.handle(), query, rays.cast()) };
}

fn intersect_split<const W: usize>(scene: SceneRef, query: *mut sys::EmbreeQuery, packet: &mut RayPacket) {
    for first in (0..LANES).step_by(W) {
        let mut part = part_of::<W>(packet, first);
        if !part.any_active() {
            continue;
        }
        part.intersect(scene, query);
        for lane in (0..W).filter(|&lane| part.is_active(lane)) {
            if part.get(row::INSTANCE, lane) != NO_HIT {
                packet.set_hit(first + lane, &hit_of(&part, lane));
            }
        }
    }
}

fn occluded_split<const W: usize>(scene: SceneRef, query: *mut sys::EmbreeQuery, packet: &mut RayPacket) {
    for first in (0..LANES).step_by(W) {
        let mut part = part_of::<W>(packet, first);
        if !part.any_active() {
            continue;
        }
        part.occluded(scene, query);
        for lane in (0..W).filter(|&lane| part.is_active(lane)) {
            if f32::from_bits(part.get(row::T_FAR, lane)) == f32::NEG_INFINITY {
                packet.set_blocked(first + lane);
            }
        }
    }
}

fn part_of<const W: usize>(packet: &RayPacket, first: usize) -> Lanes<W> {
    let mut part = Lanes::new();
    for lane in (0..W).filter(|&lane| packet.is_active(first + lane)) {
        part.set(lane, &packet.ray(first + lane));
    }
    part
}

/// The hit of a lane that has one.
#[inline(always)]
pub(super) fn hit_of<const W: usize>(lanes: &Lanes<W>, lane: usize) -> Hit {
    Hit {
        instance: number_of_instance([row::INSTANCE, row::LEVEL].map(|row| lanes.get(row, lane))),
        primitive: lanes.get(row::PRIMITIVE, lane),
        t: f32::from_bits(lanes.get(row::T_FAR, lane)),
        u: f32::from_bits(lanes.get(row::U, lane)),
        v: f32::from_bits(lanes.get(row::V, lane)),
    }
}

/// The scene's number of the instance hit, out of Embree's numbers of the geometry and of the instance around it. In an
/// instance of Embree's own the geometry's number means nothing; everything else is within none.
#[inline(always)]
pub(super) fn number_of_instance([geometry, level]: [u32; 2]) -> u32 {
    if level == NO_HIT { geometry } else { level }
}

/// What is left of a packet to trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Remaining {
    /// No ray.
    Nothing,
    /// Rays that Embree may be told are coherent, if they are.
    Tame,
    /// Rays that must not be called coherent (see [`vanishes`]).
    Wild,
}

/// Switches off what Embree may not be asked about, 3.13.5 aborts on it, and says what is left.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.2"))]
fn keep_traceable(packet: &mut RayPacket) -> Remaining {
    packet.drop_untraceable();
    if !packet.any_active() {
        return Remaining::Nothing;
    }
    let mut vanishing = 0;
    for lane in 0..LANES {
        let [x, y, z] = [0, 1, 2].map(|axis| vanishes(packet.direction[axis][lane]));
        vanishing |= if x | y | z { packet.active[lane] } else { 0 };
    }
    if vanishing == 0 {
        Remaining::Tame
    } else {
        Remaining::Wild
    }
}
