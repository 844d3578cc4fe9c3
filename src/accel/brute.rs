//! Brute force: every ray against every primitive. Reference for the other two backends.

use super::shape_query::{point_hit, shape_hit};
use super::{Accel, AccelReport, Coherence, Hit, LANES, RayPacket};
use crate::mesh::Mesh;
use crate::mesh::triangle::Shear;
use crate::numeric::{Ray, object_ray};
use crate::scene::{Geometry, Instance, Scene};

/// A loop over all instances and their primitives.
pub struct BruteAccel<'s> {
    scene: &'s Scene,
}

impl<'s> BruteAccel<'s> {
    /// Wraps a scene; there is nothing to build.
    pub fn new(scene: &'s Scene) -> BruteAccel<'s> {
        BruteAccel { scene }
    }

    /// Returns the nearest hit of one ray.
    pub fn nearest(&self, ray: &Ray) -> Option<Hit> {
        let mut best = None;
        for index in 0..self.scene.instances.len() as u32 {
            nearest_of(self.scene, index, ray, &mut best);
        }
        best
    }

    /// Returns whether one ray hits anything within its interval.
    pub fn is_blocked(&self, ray: &Ray) -> bool {
        (0..self.scene.instances.len() as u32).any(|index| is_occluded_by(self.scene, index, ray))
    }
}

impl Accel for BruteAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], _order: Coherence) {
        for packet in packets {
            packet.drop_untraceable();
            for lane in 0..LANES {
                if packet.is_active(lane)
                    && let Some(hit) = self.nearest(&packet.ray(lane))
                {
                    packet.set_hit(lane, &hit);
                }
            }
        }
    }

    fn occluded(&self, packets: &mut [RayPacket], _order: Coherence) {
        for packet in packets {
            packet.drop_untraceable();
            for lane in 0..LANES {
                if packet.is_active(lane) && self.is_blocked(&packet.ray(lane)) {
                    packet.set_blocked(lane);
                }
            }
        }
    }

    fn report(&self) -> AccelReport {
        AccelReport {
            summary: format!("brute force over {} instances", self.scene.instances.len()),
            ..AccelReport::default()
        }
    }
}

/// Updates `best` with the nearest hit of the ray with one instance.
#[inline(always)]
pub(super) fn nearest_of(scene: &Scene, index: u32, ray: &Ray, best: &mut Option<Hit>) {
    let instance = &scene.instances[index as usize];
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(mesh) => nearest_triangle(mesh, &ray_in(instance, ray), index, best),
        Geometry::Shape(shape) => {
            if let Some(hit) = shape_hit(index, instance, shape, ray) {
                keep_nearest(best, hit);
            }
        }
        Geometry::Points(cloud) => {
            let points = 0..cloud.len() as u32;
            for hit in points.filter_map(|point| point_hit(index, instance, cloud, point, ray)) {
                keep_nearest(best, hit);
            }
        }
    }
}

/// Returns whether the ray hits anything of one instance.
#[inline(always)]
pub(super) fn is_occluded_by(scene: &Scene, index: u32, ray: &Ray) -> bool {
    let instance = &scene.instances[index as usize];
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(mesh) => any_triangle(mesh, &ray_in(instance, ray)),
        Geometry::Shape(shape) => shape_hit(index, instance, shape, ray).is_some(),
        Geometry::Points(cloud) => {
            (0..cloud.len() as u32).any(|point| point_hit(index, instance, cloud, point, ray).is_some())
        }
    }
}

/// Returns the ray in an instance's object space at the ray's time; unchanged if the transform is the identity.
#[inline(always)]
pub(super) fn ray_in(instance: &Instance, ray: &Ray) -> Ray {
    if instance.is_identity() {
        *ray
    } else {
        object_ray(&instance.pose(ray.time).object_from_world(), ray)
    }
}

/// Keeps the better of two hits: smallest `t`, then instance, then primitive.
fn keep_nearest(best: &mut Option<Hit>, hit: Hit) {
    let rank = |h: &Hit| (h.instance, h.primitive);
    if best.is_none_or(|b| hit.t < b.t || (hit.t == b.t && rank(&hit) < rank(&b))) {
        *best = Some(hit);
    }
}

fn nearest_triangle(mesh: &Mesh, ray: &Ray, instance: u32, best: &mut Option<Hit>) {
    let shear = Shear::new(ray);
    for primitive in 0..mesh.triangles.len() as u32 {
        // Keep the end inclusive, so that ties reach the comparison of indices
        let t_far = best.map_or(ray.t_far, |b| b.t);
        let corners = mesh.corners(primitive).map(|p| p.to_array());
        if let Some(hit) = shear.intersect(corners, ray.t_near, t_far) {
            keep_nearest(
                best,
                Hit {
                    instance,
                    primitive,
                    t: hit.t,
                    u: hit.u,
                    v: hit.v,
                },
            );
        }
    }
}

fn any_triangle(mesh: &Mesh, ray: &Ray) -> bool {
    let shear = Shear::new(ray);
    (0..mesh.triangles.len() as u32).any(|primitive| {
        let corners = mesh.corners(primitive).map(|p| p.to_array());
        shear.intersect(corners, ray.t_near, ray.t_far).is_some()
    })
}
