//! Infinite planes, which have no finite bounding box and so are in no tree. All lanes are tested after the traversal.
//!
//! Embree drops primitives with an infinite box, and in the BSP a plane would be in every cell it crosses. Scenes have
//! one or two planes, if any, and each costs a division per ray.

use glam::{DAffine3, DVec3};
use multiversion::multiversion;

use super::{Query, RayPacket};
use crate::numeric::{LANES, Lanes};
use crate::scene::{Instance, Scene};

/// The infinite planes of a scene, in the order of their instances.
#[derive(Clone)]
pub(super) struct Planes {
    still: Vec<PlaneForm>,
    /// Moving planes, with their instance indices.
    moving: Vec<(u32, Instance)>,
}

/// World-space plane as a height function: the last row of the world-to-object transform, where the plane is z = 0.
#[derive(Clone)]
struct PlaneForm {
    instance: u32,
    gradient: DVec3,
    offset: f64,
}

impl Planes {
    /// Collects the infinite planes of a scene.
    pub(super) fn of(scene: &Scene) -> Planes {
        let planes = (0u32..)
            .zip(&scene.instances)
            .filter(|(_, instance)| scene.geometries[instance.geometry as usize].is_unbounded());
        // Precompute the height functions of static planes
        let (moving, still): (Vec<_>, Vec<_>) = planes.partition(|(_, instance)| instance.is_moving());
        let form = |(index, instance): (u32, &Instance)| PlaneForm::new(index, &instance.object_from_world());
        Planes {
            still: still.into_iter().map(form).collect(),
            moving: moving
                .into_iter()
                .map(|(index, instance)| (index, instance.clone()))
                .collect(),
        }
    }

    /// Returns the number of infinite planes.
    pub(super) fn count(&self) -> usize {
        self.still.len() + self.moving.len()
    }

    /// Traces the packets: records the plane hits that are nearer than their own, or marks the lanes as blocked whose
    /// ray hits any plane.
    #[inline]
    pub(super) fn trace(&self, packets: &mut [RayPacket], query: Query) {
        if self.count() == 0 {
            return;
        }
        for packet in packets {
            trace_still(&self.still, packet, query);
            for (index, plane) in &self.moving {
                let crossings = moving_crossings(*index, plane, packet);
                record(*index, &crossings, packet, query);
            }
        }
    }
}

impl PlaneForm {
    fn new(instance: u32, object_from_world: &DAffine3) -> PlaneForm {
        let m = object_from_world.matrix3;
        PlaneForm {
            instance,
            gradient: DVec3::new(m.x_axis.z, m.y_axis.z, m.z_axis.z),
            offset: object_from_world.translation.z,
        }
    }

    /// Returns the parameters at which active lanes cross the plane within their intervals, rounded once; infinity for
    /// the others.
    ///
    /// The operations are those of [`crate::shape::Plane`] on the ray in object space, in the same order, to the same
    /// bits.
    #[inline(always)]
    fn crossings(&self, packet: &RayPacket) -> Lanes<f32> {
        let mut crossings = [f32::INFINITY; LANES];
        for l in 0..LANES {
            crossings[l] = self.crossing(packet, l);
        }
        crossings
    }

    /// Returns the crossing parameter of lane `l`, or infinity.
    #[inline(always)]
    fn crossing(&self, packet: &RayPacket, l: usize) -> f32 {
        let rise = |v: [f32; 3]| {
            let [x, y, z] = v.map(f64::from);
            self.gradient.x * x + self.gradient.y * y + self.gradient.z * z
        };
        let of = |v: &[Lanes<f32>; 3]| [v[0][l], v[1][l], v[2][l]];
        let (height, slope) = (
            rise(of(&packet.origin)) + self.offset,
            rise(of(&packet.direction)),
        );
        // Adding +0 turns -0 into +0.
        let exact = -height / slope + 0.0;
        let t = exact as f32;
        let crosses = (packet.active[l] != 0)
            & (slope != 0.0)
            & (exact >= f64::from(packet.t_near[l]))
            & (t <= packet.t_far[l]);
        if crosses { t } else { f32::INFINITY }
    }
}

/// Computes [`PlaneForm::crossings`] of a moving plane, with its position at each ray's time.
fn moving_crossings(index: u32, plane: &Instance, packet: &RayPacket) -> Lanes<f32> {
    std::array::from_fn(|l| {
        if !packet.is_active(l) {
            return f32::INFINITY;
        }
        let pose = plane.pose(packet.time[l]);
        PlaneForm::new(index, &pose.object_from_world()).crossing(packet, l)
    })
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.2"))]
fn trace_still(planes: &[PlaneForm], packet: &mut RayPacket, query: Query) {
    for plane in planes {
        let crossings = plane.crossings(packet);
        record(plane.instance, &crossings, packet, query);
    }
}

/// Records the crossings of a plane: in the lanes where they are the nearest hit, or as blocked lanes.
#[inline(always)]
fn record(instance: u32, crossings: &Lanes<f32>, packet: &mut RayPacket, query: Query) {
    match query {
        Query::Nearest => take(instance, crossings, packet),
        Query::Any => block(crossings, packet),
    }
}

/// Records the crossings of a plane in the lanes where they are the nearest hit.
#[inline(always)]
fn take(instance: u32, crossings: &Lanes<f32>, packet: &mut RayPacket) {
    for l in 0..LANES {
        let t = crossings[l];
        // A lane without a hit holds `NO_HIT`, the largest index, so a plane at its very end is taken.
        let is_first = (t < packet.t_far[l]) | (instance < packet.instance[l]);
        let taken = (t < f32::INFINITY) & is_first;
        packet.t_far[l] = if taken { t } else { packet.t_far[l] };
        packet.u[l] = if taken { 0.0 } else { packet.u[l] };
        packet.v[l] = if taken { 0.0 } else { packet.v[l] };
        packet.primitive[l] = if taken { 0 } else { packet.primitive[l] };
        packet.instance[l] = if taken { instance } else { packet.instance[l] };
    }
}

/// Marks the lanes that cross a plane as blocked.
#[inline(always)]
fn block(crossings: &Lanes<f32>, packet: &mut RayPacket) {
    for l in 0..LANES {
        let is_hit = crossings[l] < f32::INFINITY;
        packet.t_far[l] = if is_hit {
            f32::NEG_INFINITY
        } else {
            packet.t_far[l]
        };
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::accel::Hit;
    use crate::numeric::Ray;
    use crate::scene::{Geometry, Instance};
    use crate::shape::Shape;

    fn floors(heights: &[f64]) -> Scene {
        let place = |&z: &f64| Instance::new("", 0, 0, DAffine3::from_translation(z * DVec3::Z)).unwrap();
        Scene {
            geometries: vec![Geometry::Shape(Shape::Plane)],
            instances: heights.iter().map(place).collect(),
            ..Scene::default()
        }
    }

    fn falling(from: f32) -> RayPacket {
        let mut packet = RayPacket::EMPTY;
        packet.set(5, &Ray::new(Vec3::new(0.0, 0.0, from), Vec3::NEG_Z));
        packet
    }

    #[test]
    fn nearest_plane_is_hit_and_ties_go_to_the_first() {
        let planes = Planes::of(&floors(&[0.0, 2.0, 2.0]));
        let mut packets = [falling(3.0)];
        planes.trace(&mut packets, Query::Nearest);
        let hit = packets[0].hit(5).unwrap();
        assert_eq!((hit.instance, hit.t), (1, 1.0));
        assert_eq!(packets[0].hit(4), None);
    }

    #[test]
    fn hit_is_kept_unless_plane_is_nearer_or_lower_numbered() {
        let planes = Planes::of(&floors(&[0.0, 1.0]));
        for (instance, t, expected) in [(9, 1.5, 9), (9, 2.0, 1), (0, 2.0, 0), (9, 2.5, 1)] {
            let mut packets = [falling(3.0)];
            let found = Hit {
                instance,
                primitive: 7,
                t,
                u: 0.5,
                v: 0.5,
            };
            packets[0].set_hit(5, &found);
            planes.trace(&mut packets, Query::Nearest);
            assert_eq!(packets[0].hit(5).unwrap().instance, expected, "{instance} at {t}");
        }
    }

    #[test]
    fn ray_is_occluded_only_within_its_interval() {
        let planes = Planes::of(&floors(&[0.0]));
        for (t_near, t_far, expected) in [(0.0, 2.9, false), (0.0, 3.0, true), (3.1, 9.0, false)] {
            let mut packets = [falling(3.0)];
            (packets[0].t_near[5], packets[0].t_far[5]) = (t_near, t_far);
            planes.trace(&mut packets, Query::Any);
            assert_eq!(packets[0].is_blocked(5), expected, "{t_near} to {t_far}");
        }
    }
}
