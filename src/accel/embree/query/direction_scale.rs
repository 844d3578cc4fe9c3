//! Rescaling of very short or very long ray directions before they are passed to Embree.
//!
//! Embree's traversal replaces components of a direction below 10^-18 by +10^-18, regardless of their sign and the
//! other components: a ray with no larger component gets a wrong direction. It accepts none above 10^18, which a
//! direction may reach in the object space of a scaled-down instance. Such directions are therefore multiplied by a
//! power of two, and their intervals divided by it, which is exact and undone on the results. Beside a component of
//! [`SMALL`] or more, the error that Embree makes in the other components is 10^-12 of it, which the padding of boxes
//! covers.

use multiversion::multiversion;

use crate::accel::{LANES, RayPacket};

/// Directions whose largest component is below this are lengthened: 2^-20.
const SMALL: f32 = 1.0 / (1 << 20) as f32;
/// Directions whose largest component is at least this are shortened: 2^40, larger than the distance to any light, as
/// rescaled rays are slower.
const LARGE: f32 = (1u64 << 40) as f32;

/// State of a lane before its direction was rescaled.
struct Lane {
    packet: usize,
    lane: usize,
    direction: [f32; 3],
    t_near: f32,
    t_far: f32,
    /// Factor that the direction was multiplied by.
    scale: f64,
}

/// Original rays of all lanes whose directions were rescaled.
#[must_use = "results are in the wrong unit until they are restored"]
pub(in crate::accel::embree) struct RescaledRays(Vec<Lane>);

impl RescaledRays {
    /// Rescales the very short and very long directions among `packets`.
    #[inline(always)]
    pub(in crate::accel::embree) fn of(packets: &mut [RayPacket]) -> RescaledRays {
        let mut lanes = Vec::new();
        if has_out_of_range(packets) {
            for (number, packet) in packets.iter_mut().enumerate() {
                rescale(packet, number, &mut lanes);
            }
        }
        RescaledRays(lanes)
    }

    /// Restores the original rays, and converts the parameters of their hits back.
    #[inline(always)]
    pub(in crate::accel::embree) fn restore(self, packets: &mut [RayPacket]) {
        for was in self.0 {
            restore(&was, &mut packets[was.packet]);
        }
    }
}

/// Returns whether any direction may have to be rescaled.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.2"))]
fn has_out_of_range(packets: &[RayPacket]) -> bool {
    let mut any = [0; LANES];
    for packet in packets {
        let [x, y, z] = &packet.direction;
        for lane in 0..LANES {
            // Inactive lanes often have a zero direction and are ignored
            let [x, y, z] = [size(x[lane]), size(y[lane]), size(z[lane])];
            let largest = x.max(y).max(z);
            // One unsigned comparison tests both ends, as values below the lower bound wrap around.
            let is_out_of_range = largest.wrapping_sub(SMALL.to_bits()) >= LARGE.to_bits() - SMALL.to_bits();
            any[lane] |= if is_out_of_range { packet.active[lane] } else { 0 };
        }
    }
    any != [0; LANES]
}

/// Returns the bits of the absolute value of a number, which order as these values do.
#[inline(always)]
fn size(x: f32) -> u32 {
    x.to_bits() & 0x7fff_ffff
}

#[cold]
fn rescale(packet: &mut RayPacket, number: usize, lanes: &mut Vec<Lane>) {
    for lane in 0..LANES {
        let ray = packet.ray(lane);
        let largest = ray.direction.abs().max_element();
        let is_in_range = (SMALL..LARGE).contains(&largest);
        if is_in_range || !packet.is_active(lane) || !ray.is_traceable() {
            continue;
        }
        // Choose the power of two that brings the largest component into [1, 2)
        let largest = f64::from(largest);
        // It is the negated exponent of the component.
        let exponent = (largest.to_bits() >> 52) as i32 - 1023;
        let scale = f64::from_bits(((1023 - exponent) as u64) << 52);
        lanes.push(Lane {
            packet: number,
            lane,
            direction: ray.direction.to_array(),
            t_near: ray.t_near,
            t_far: ray.t_far,
            scale,
        });
        for axis in 0..3 {
            packet.direction[axis][lane] = (f64::from(ray.direction[axis]) * scale) as f32;
        }
        // Clamp to the largest float: no hit is farther, and an interval may not start later.
        packet.t_near[lane] = ((f64::from(ray.t_near) / scale) as f32).min(f32::MAX);
        packet.t_far[lane] = (f64::from(ray.t_far) / scale) as f32;
    }
}

#[cold]
fn restore(was: &Lane, packet: &mut RayPacket) {
    let lane = was.lane;
    let t = (f64::from(packet.t_far[lane]) * was.scale) as f32;
    let is_hit = packet.hit(lane).is_some();
    for axis in 0..3 {
        packet.direction[axis][lane] = was.direction[axis];
    }
    packet.t_near[lane] = was.t_near;
    if is_hit && t < f32::INFINITY {
        packet.t_far[lane] = t;
    } else if !packet.is_blocked(lane) {
        // A hit beyond the largest float is a miss.
        packet.clear_hit(lane);
        packet.t_far[lane] = was.t_far;
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::accel::Hit;
    use crate::numeric::Ray;

    fn packet(direction: Vec3, t_near: f32, t_far: f32) -> RayPacket {
        let mut packet = RayPacket::EMPTY;
        let ray = Ray {
            t_near,
            t_far,
            ..Ray::new(Vec3::ONE, direction)
        };
        packet.set(3, &ray);
        packet.set(4, &Ray::new(Vec3::ZERO, Vec3::X));
        packet
    }

    #[test]
    fn tiny_direction_is_scaled_up_and_restored_with_its_hit() {
        let tiny = Vec3::new(3.0 * 0.5f32.powi(100), -0.0, 0.5f32.powi(149));
        let mut packets = [packet(tiny, 2.0, 4.0)];
        let ray = packets[0].ray(3);
        let other = packets[0].ray(4);
        let rescaled = RescaledRays::of(&mut packets);
        // 3 / 2^100 times 2^99 is 1.5.
        assert_eq!(packets[0].ray(3).direction, Vec3::new(1.5, -0.0, 0.5f32.powi(50)));
        assert_eq!(packets[0].t_near[3], 2.0 * 0.5f32.powi(99));
        assert_eq!(packets[0].ray(4), other);
        let hit = Hit {
            instance: 1,
            primitive: 2,
            t: 3.0 * 0.5f32.powi(99),
            u: 0.25,
            v: 0.5,
        };
        packets[0].set_hit(3, &hit);
        rescaled.restore(&mut packets);
        assert_eq!(packets[0].hit(3), Some(Hit { t: 3.0, ..hit }));
        assert_eq!(packets[0].ray(3), Ray { t_far: 3.0, ..ray });
    }

    #[test]
    fn huge_direction_is_scaled_down_and_restored_with_its_hit() {
        let huge = Vec3::new(0.0, -5.0 * 2f32.powi(50), 1.0);
        let mut packets = [packet(huge, 0.5f32.powi(60), f32::INFINITY)];
        let ray = packets[0].ray(3);
        let rescaled = RescaledRays::of(&mut packets);
        // 5 times 2^50 over 2^52 is 1.25.
        assert_eq!(
            packets[0].ray(3),
            Ray {
                direction: Vec3::new(0.0, -1.25, 0.5f32.powi(52)),
                t_near: 0.5f32.powi(8),
                ..ray
            }
        );
        let hit = Hit {
            instance: 1,
            primitive: 2,
            t: 3.0,
            u: 0.25,
            v: 0.5,
        };
        packets[0].set_hit(3, &hit);
        rescaled.restore(&mut packets);
        let t = 3.0 * 0.5f32.powi(52);
        assert_eq!(packets[0].hit(3), Some(Hit { t, ..hit }));
        assert_eq!(packets[0].ray(3), Ray { t_far: t, ..ray });

        // The interval starts beyond the largest float after rescaling: nothing can be hit.
        let mut packets = [packet(huge, 2f32.powi(100), f32::INFINITY)];
        let ray = packets[0].ray(3);
        let rescaled = RescaledRays::of(&mut packets);
        assert!(packets[0].ray(3).is_traceable());
        rescaled.restore(&mut packets);
        assert_eq!((packets[0].ray(3), packets[0].hit(3)), (ray, None));
    }

    #[test]
    fn miss_occlusion_and_out_of_range_hit_are_restored() {
        let tiny = Vec3::splat(1e-40);
        let mut packets = [packet(tiny, 0.0, f32::INFINITY)];
        let ray = packets[0].ray(3);
        RescaledRays::of(&mut packets).restore(&mut packets);
        assert_eq!((packets[0].ray(3), packets[0].hit(3)), (ray, None));

        let rescaled = RescaledRays::of(&mut packets);
        packets[0].set_blocked(3);
        rescaled.restore(&mut packets);
        assert!(packets[0].is_blocked(3));

        let mut packets = [packet(tiny, 0.0, f32::INFINITY)];
        let rescaled = RescaledRays::of(&mut packets);
        let far = Hit {
            instance: 0,
            primitive: 0,
            t: 1.0,
            u: 0.0,
            v: 0.0,
        };
        packets[0].set_hit(3, &far);
        rescaled.restore(&mut packets);
        // 1 times 2^133 overflows f32.
        assert_eq!(packets[0].hit(3), None);
        assert_eq!(packets[0].t_far[3], f32::INFINITY);
    }
}
