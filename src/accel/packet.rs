//! Packet of sixteen rays and their hits.
//!
//! The memory layout is that of Embree's 16-wide calls, so packets are passed without a copy (`accel/embree` checks it
//! at compile time). Other backends read and write the same lanes.

use glam::Vec3;

pub use crate::numeric::LANES;
use crate::numeric::Ray;

/// Value of [`RayPacket::instance`] for a lane without a hit.
pub const NO_HIT: u32 = u32::MAX;

/// Value of [`RayPacket::active`] for a lane that is traced.
pub const ACTIVE: i32 = -1;

/// Result of an intersection query, without shading data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index of the instance in [`crate::scene::Scene::instances`].
    pub instance: u32,
    /// Triangle of the mesh, or part of the analytic shape as in [`crate::shape::ShapeHit::part`].
    pub primitive: u32,
    /// Parameter along the ray, in units of the length of its direction.
    pub t: f32,
    /// Barycentric weight of the triangle's second vertex.
    pub u: f32,
    /// Barycentric weight of the triangle's third vertex.
    pub v: f32,
}

/// Sixteen rays and their hits as structure of arrays; each array holds one value per lane.
#[repr(C, align(64))]
#[derive(Clone, Debug)]
pub struct RayPacket {
    /// Ray origins: x, y, z.
    pub origin: [[f32; LANES]; 3],
    /// Lower ends of the ray intervals.
    pub t_near: [f32; LANES],
    /// Ray directions: x, y, z; not normalised.
    pub direction: [[f32; LANES]; 3],
    /// Times of the rays, as in [`Ray::time`].
    pub time: [f32; LANES],
    /// In: upper ends of the ray intervals. Out: parameter of the hit, or -∞ for a blocked lane.
    pub t_far: [f32; LANES],
    mask: [u32; LANES],
    id: [u32; LANES],
    flags: [u32; LANES],
    ng: [[f32; LANES]; 3],
    /// Barycentric weight of the second vertex, valid for lanes with a hit.
    pub u: [f32; LANES],
    /// Barycentric weight of the third vertex, valid for lanes with a hit.
    pub v: [f32; LANES],
    /// Triangle of the mesh or part of the shape, valid for lanes with a hit.
    pub primitive: [u32; LANES],
    /// Index of the instance hit, or [`NO_HIT`].
    pub instance: [u32; LANES],
    level: [u32; LANES],
    level_primitive: [u32; LANES],
    /// [`ACTIVE`] for lanes that are traced, 0 for lanes that are skipped.
    pub active: [i32; LANES],
}

impl RayPacket {
    /// A packet without active lanes, harmless to trace.
    pub const EMPTY: RayPacket = RayPacket {
        origin: [[0.0; LANES]; 3],
        t_near: [0.0; LANES],
        direction: [[1.0; LANES]; 3],
        time: [0.0; LANES],
        t_far: [f32::INFINITY; LANES],
        mask: [u32::MAX; LANES],
        id: [0; LANES],
        flags: [0; LANES],
        ng: [[0.0; LANES]; 3],
        u: [0.0; LANES],
        v: [0.0; LANES],
        primitive: [NO_HIT; LANES],
        instance: [NO_HIT; LANES],
        level: [NO_HIT; LANES],
        level_primitive: [NO_HIT; LANES],
        active: [0; LANES],
    };

    /// Clears rays and hits for refilling the packet; cheaper than a new one.
    #[inline(always)]
    pub(crate) fn recycle(&mut self) {
        self.instance = [NO_HIT; LANES];
        self.level = [NO_HIT; LANES];
        self.active = [0; LANES];
    }

    /// Clears the hit of one lane; the ray stays, except for its `t_far`.
    #[inline(always)]
    pub fn clear_hit(&mut self, lane: usize) {
        self.instance[lane] = NO_HIT;
        self.level[lane] = NO_HIT;
    }

    /// Makes lane `lane` an active ray without a hit.
    #[inline(always)]
    pub fn set(&mut self, lane: usize, ray: &Ray) {
        for axis in 0..3 {
            self.origin[axis][lane] = ray.origin[axis];
            self.direction[axis][lane] = ray.direction[axis];
        }
        self.t_near[lane] = ray.t_near;
        self.t_far[lane] = ray.t_far;
        self.time[lane] = ray.time;
        self.instance[lane] = NO_HIT;
        self.level[lane] = NO_HIT;
        self.active[lane] = ACTIVE;
    }

    /// Makes lane `lane`, which has no hit, an active ray from `origin` on.
    #[inline(always)]
    pub(crate) fn begin_ray(&mut self, lane: usize, [origin, direction]: [[f32; 3]; 2], time: f32) {
        for axis in 0..3 {
            self.origin[axis][lane] = origin[axis];
            self.direction[axis][lane] = direction[axis];
        }
        self.t_near[lane] = 0.0;
        self.t_far[lane] = f32::INFINITY;
        self.time[lane] = time;
        self.active[lane] = ACTIVE;
    }

    /// Returns the ray of lane `lane`; after a query its `t_far` is that of the result.
    #[inline(always)]
    pub fn ray(&self, lane: usize) -> Ray {
        let vector = |v: &[[f32; LANES]; 3]| Vec3::new(v[0][lane], v[1][lane], v[2][lane]);
        Ray {
            origin: vector(&self.origin),
            direction: vector(&self.direction),
            t_near: self.t_near[lane],
            t_far: self.t_far[lane],
            time: self.time[lane],
        }
    }

    /// Returns whether lane `lane` is traced.
    #[inline(always)]
    pub fn is_active(&self, lane: usize) -> bool {
        self.active[lane] != 0
    }

    /// Returns the mask of the lanes that are traced: bit `i` is lane `i`.
    #[inline(always)]
    pub(in crate::accel) fn active_mask(&self) -> u32 {
        let mut mask = 0;
        for lane in 0..LANES {
            mask |= u32::from(self.active[lane] != 0) << lane;
        }
        mask
    }

    /// Returns whether any lane is traced.
    #[inline(always)]
    pub fn any_active(&self) -> bool {
        self.active.iter().fold(0, |a, &b| a | b) != 0
    }

    /// Records a hit: the lane's `t_far` becomes `hit.t`.
    #[inline(always)]
    pub fn set_hit(&mut self, lane: usize, hit: &Hit) {
        self.t_far[lane] = hit.t;
        self.u[lane] = hit.u;
        self.v[lane] = hit.v;
        self.primitive[lane] = hit.primitive;
        self.instance[lane] = hit.instance;
    }

    /// Returns the hit of an active lane after [`super::Accel::intersect`].
    #[inline(always)]
    pub fn hit(&self, lane: usize) -> Option<Hit> {
        (self.is_active(lane) && self.instance[lane] != NO_HIT).then(|| Hit {
            instance: self.instance[lane],
            primitive: self.primitive[lane],
            t: self.t_far[lane],
            u: self.u[lane],
            v: self.v[lane],
        })
    }

    /// Replaces the geometry index of hits in Embree's own instances by the index of the instance, as in all other
    /// hits.
    #[cfg(feature = "embree")]
    #[inline(always)]
    pub(super) fn use_instance_ids(&mut self) {
        for lane in 0..LANES {
            let level = self.level[lane];
            if level != NO_HIT {
                self.instance[lane] = level;
            }
            self.level[lane] = NO_HIT;
        }
    }

    /// Deactivates every lane whose ray has a coordinate of `limit` or more in origin or direction.
    #[cfg(feature = "embree")]
    #[inline(always)]
    pub(super) fn drop_beyond(&mut self, limit: f32) {
        for lane in 0..LANES {
            let sizes = [0, 1, 2].map(|axis| {
                self.origin[axis][lane]
                    .abs()
                    .max(self.direction[axis][lane].abs())
            });
            let is_within = sizes[0].max(sizes[1]).max(sizes[2]) < limit;
            self.active[lane] = if is_within { self.active[lane] } else { 0 };
        }
    }

    /// Marks a lane as blocked.
    #[inline(always)]
    pub fn set_blocked(&mut self, lane: usize) {
        self.t_far[lane] = f32::NEG_INFINITY;
    }

    /// Returns whether [`super::Accel::occluded`] found the lane blocked.
    #[inline(always)]
    pub fn is_blocked(&self, lane: usize) -> bool {
        self.is_active(lane) && self.t_far[lane] == f32::NEG_INFINITY
    }

    /// Deactivates every lane whose ray is not traceable (see [`Ray::is_traceable`]) and returns the number of such
    /// lanes.
    #[inline(always)]
    pub fn drop_untraceable(&mut self) -> u32 {
        // Without sign bits, floats order as their bits do, with infinity and NaN above all others.
        let size = |x: f32| x.to_bits() & 0x7fff_ffff;
        let mut dropped = 0;
        for lane in 0..LANES {
            let [ox, oy, oz] = [0, 1, 2].map(|axis| size(self.origin[axis][lane]));
            let [dx, dy, dz] = [0, 1, 2].map(|axis| size(self.direction[axis][lane]));
            let largest = ox.max(oy).max(oz).max(dx).max(dy).max(dz);
            let (t_near, t_far) = (self.t_near[lane], self.t_far[lane]);
            // All conditions without branches, so that the loop vectorizes
            let good = (largest < Ray::LIMIT.to_bits())
                & ((dx | dy | dz) != 0)
                & (0.0..f32::INFINITY).contains(&t_near)
                & (t_far >= t_near);
            let kept = if good { self.active[lane] } else { 0 };
            dropped += u32::from(self.active[lane] != kept);
            self.active[lane] = kept;
        }
        dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packet_returns_the_ray_of_each_lane() {
        let mut packet = RayPacket::EMPTY;
        let ray = Ray {
            origin: Vec3::new(1.0, 2.0, 3.0),
            direction: Vec3::new(4.0, 5.0, 6.0),
            t_near: 0.5,
            t_far: 7.0,
            time: 0.25,
        };
        packet.set(11, &ray);
        assert_eq!(packet.ray(11), ray);
        assert!(packet.is_active(11) && !packet.is_active(10));
        assert_eq!(packet.hit(11), None);
    }

    #[test]
    fn a_recycled_packet_has_no_rays_and_no_hits() {
        let mut packet = RayPacket::EMPTY;
        packet.set(3, &Ray::new(Vec3::ZERO, Vec3::X));
        let hit = Hit {
            instance: 1,
            primitive: 2,
            t: 3.0,
            u: 0.0,
            v: 0.0,
        };
        packet.set_hit(3, &hit);
        assert_eq!(packet.hit(3), Some(hit));
        packet.recycle();
        assert!(!packet.any_active());
        packet.set(3, &Ray::new(Vec3::ZERO, Vec3::X));
        assert_eq!(packet.hit(3), None);
    }

    #[test]
    fn lanes_with_invalid_rays_are_inactive() {
        // Set one valid ray and five that Embree must not get
        let mut packet = RayPacket::EMPTY;
        let good = Ray::new(Vec3::ZERO, Vec3::X);
        packet.set(0, &good);
        packet.set(
            1,
            &Ray {
                origin: Vec3::NAN,
                ..good
            },
        );
        packet.set(
            2,
            &Ray {
                direction: Vec3::new(0.0, f32::INFINITY, 0.0),
                ..good
            },
        );
        packet.set(
            3,
            &Ray {
                t_far: f32::NAN,
                ..good
            },
        );
        packet.set(4, &Ray { t_near: -0.5, ..good });
        packet.set(
            5,
            &Ray {
                direction: Vec3::ZERO,
                ..good
            },
        );
        assert_eq!(packet.drop_untraceable(), 5);
        assert_eq!(packet.active.iter().filter(|&&a| a != 0).count(), 1);
        assert!(packet.is_active(0));
    }
}
