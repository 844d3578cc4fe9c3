//! Choice of the number of rays in one Embree call: packets at the width that the processor supports, or single rays.

use std::fmt;

use embree_sys as sys;
use multiversion::multiversion;

use crate::accel::embree::device::Device;
use crate::accel::{Coherence, Kernel, LANES, RayPacket};

/// Number of rays in one Embree call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::accel::embree) enum Width {
    /// The whole packet, without a copy.
    Sixteen,
    /// Halves of the packet, copied.
    Eight,
    /// Quarters of the packet, copied.
    Four,
    /// Single lanes, each copied.
    One,
}

impl Width {
    /// Returns the largest native width; Embree would split wider packets itself, Embree 4 into single rays.
    pub(in crate::accel::embree) fn of(device: &Device, kernel: Kernel) -> Width {
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

/// Least number of user-geometry primitives, or instances of Embree's own, at which incoherent packets that share few
/// nodes are traced one ray at a time. Embree traverses both with the packet as a whole, every ray into every node that
/// any of them hits, and not ray by ray as it does over triangles.
const MANY_OBJECTS: usize = 256;
/// Least number of active lanes of an incoherent packet that is traced as one through many objects. Through 10^4 spheres
/// (`cargo bench --bench timing -- packet_width`) packets of sixteen nearby rays take 0.3 to 0.5 of the time of single
/// rays, of two rays 1.2 to 1.3 of it.
const MIN_LANES: u32 = 9;
/// Largest distance of the origins of such a packet from the first, relative to the size of the scene. Rays between any
/// two points of a scene take 2.2 times as long in packets, through 4096 spheres.
const MAX_ORIGIN_DISTANCE: f32 = 0.4;
/// Largest distance of the directions of such a packet from the first, relative to its length.
const MAX_DIRECTION_DISTANCE: f32 = 1.2;
/// Largest distance of the directions from the first, relative to its length, of rays that are traced as coherent. Through
/// 10^4 spheres, Embree's traversal of coherent rays takes 0.89 of the time of that of incoherent ones up to a distance of
/// 0.02, 1.06 up to 0.2, 1.5 up to 1 and 1.9 up to 2.
const MAX_COHERENT_DISTANCE: f32 = 0.2;

/// Choice of a width for each packet of a scene.
#[derive(Clone, Copy, Debug)]
pub(in crate::accel::embree) struct Widths {
    /// Width for packets that are not traced one ray at a time.
    packet: Width,
    has_many_objects: bool,
    /// Largest distance of the origins from the first of an incoherent packet that is traced as one.
    max_origin_distance: f32,
}

impl Widths {
    /// Returns the choice for a scene of that size along its longest axis; `object_count` is the number of shapes,
    /// instanced meshes and clusters of triangles in it.
    pub(in crate::accel::embree) fn new(packet: Width, object_count: usize, size: f32) -> Widths {
        Widths {
            packet,
            has_many_objects: object_count >= MANY_OBJECTS,
            max_origin_distance: MAX_ORIGIN_DISTANCE * size,
        }
    }

    /// Returns the width for a packet, and whether its rays are traced as coherent; `order` is what their sender
    /// expects.
    #[inline(always)]
    pub(super) fn of(self, packet: &RayPacket, order: Coherence) -> (Width, Coherence) {
        // Rays to a large light or an environment that start next to each other may point anywhere
        if order == Coherence::Coherent && is_narrow(packet) {
            return (self.packet, Coherence::Coherent);
        }
        if self.has_many_objects && !is_near(packet, self.max_origin_distance) {
            return (Width::One, Coherence::Incoherent);
        }
        (self.packet, Coherence::Incoherent)
    }
}

/// Returns whether the active rays differ so little in direction that Embree's traversal of coherent rays pays.
fn is_narrow(packet: &RayPacket) -> bool {
    let first = first_active(packet);
    let limit = MAX_COHERENT_DISTANCE * length_of(&packet.direction, first);
    are_near(&packet.direction, &packet.active, first, limit)
}

/// Returns whether enough rays are active, and start and point near enough to each other, to be traced as one packet.
fn is_near(packet: &RayPacket, max_origin_distance: f32) -> bool {
    let lanes: u32 = packet.active.iter().map(|&active| u32::from(active != 0)).sum();
    let first = first_active(packet);
    let limit = MAX_DIRECTION_DISTANCE * length_of(&packet.direction, first);
    lanes >= MIN_LANES
        && are_near(&packet.origin, &packet.active, first, max_origin_distance)
        && are_near(&packet.direction, &packet.active, first, limit)
}

/// Returns the first active lane; 0 if there is none.
#[inline(always)]
fn first_active(packet: &RayPacket) -> usize {
    packet.active.iter().position(|&active| active != 0).unwrap_or(0)
}

/// Returns the largest absolute value of a coordinate of a lane.
#[inline(always)]
fn length_of(rows: &[[f32; LANES]; 3], lane: usize) -> f32 {
    rows.iter().map(|row| row[lane].abs()).fold(0.0, f32::max)
}

/// Returns whether the points or directions of all active lanes are at most `limit` from that of `first` along each axis.
fn are_near(rows: &[[f32; LANES]; 3], active: &[i32; LANES], first: usize, limit: f32) -> bool {
    rows.iter().all(|row| is_row_near(row, active, row[first], limit))
}

/// Returns whether the coordinates of all active lanes are at most `limit` from one.
// Compiled for one axis: within a loop over axes, the compiler would gather these lane by lane.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.2"))]
fn is_row_near(row: &[f32; LANES], active: &[i32; LANES], from: f32, limit: f32) -> bool {
    // Compare in lanes: the largest distance would be found lane by lane
    let mut far = 0;
    for lane in 0..LANES {
        let is_far = (row[lane] - from).abs() > limit;
        far |= if is_far { active[lane] } else { 0 };
    }
    far == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::Ray;
    use glam::Vec3;

    /// Returns `lanes` rays that start along the x axis and point up, and up to `tilt` aside.
    fn fan(lanes: usize, length: f32, tilt: f32) -> RayPacket {
        let mut packet = RayPacket::EMPTY;
        for lane in 0..lanes {
            let share = lane as f32 / (lanes - 1) as f32;
            let direction = Vec3::new(tilt * share, 0.0, 1.0);
            packet.set(lane, &Ray::new(Vec3::X * length * share, direction));
        }
        packet
    }

    #[test]
    fn incoherent_packets_through_many_objects_are_traced_together_if_they_are_full_and_near() {
        let widths = Widths::new(Width::Sixteen, MANY_OBJECTS, 10.0);
        let width = |packet: &RayPacket| widths.of(packet, Coherence::Incoherent).0;
        assert_eq!(width(&fan(16, 1.0, 1.0)), Width::Sixteen);
        assert_eq!(width(&fan(8, 1.0, 1.0)), Width::One);
        assert_eq!(width(&fan(16, 6.0, 1.0)), Width::One);
        assert_eq!(width(&fan(16, 1.0, -1.1)), Width::Sixteen);
        // The directions of these differ by more than their length
        let mut opposed = fan(16, 1.0, 1.0);
        opposed.set(3, &Ray::new(Vec3::ZERO, Vec3::NEG_Z));
        assert_eq!(width(&opposed), Width::One);
        let few = Widths::new(Width::Sixteen, MANY_OBJECTS - 1, 10.0);
        assert_eq!(few.of(&opposed, Coherence::Incoherent).0, Width::Sixteen);
    }

    #[test]
    fn coherent_packets_are_traced_as_such_if_their_directions_agree() {
        let widths = Widths::new(Width::Sixteen, MANY_OBJECTS, 10.0);
        let of = |packet: &RayPacket| widths.of(packet, Coherence::Coherent);
        assert_eq!(of(&fan(2, 9.0, 0.2)), (Width::Sixteen, Coherence::Coherent));
        assert_eq!(of(&fan(16, 1.0, 1.0)), (Width::Sixteen, Coherence::Incoherent));
        assert_eq!(of(&fan(2, 1.0, 1.0)), (Width::One, Coherence::Incoherent));
    }
}
