//! Ray intersection with analytic shapes, shared by all backends so that they return the same bits.
//!
//! The f32 ray is exact by definition; its f64 extension is transformed into object space and never rounded there. The
//! parameter is rounded to f32 once and compared after that: `t_far` of a ray may be the parameter of an earlier hit,
//! which was rounded too, and the order of the tests must not decide between surfaces at the same parameter.

use glam::DVec3;

use super::Hit;
use crate::mesh::PointCloud;
use crate::numeric::Ray;
use crate::scene::{Instance, InstanceTransform};
use crate::shape::{Implicit, Shape, ShapeHit, ShapeRay, Sphere};

/// Returns the nearest hit of a ray with a shape instance within its interval; `primitive` is the part of the shape.
#[inline(always)]
pub(super) fn shape_hit(index: u32, instance: &Instance, shape: &Shape, ray: &Ray) -> Option<Hit> {
    let pose = instance.pose(ray.time);
    if let Some(sphere) = world_sphere(&pose, shape) {
        return sphere_hit(&sphere, ray).map(|t| sphere_at(index, t));
    }
    let ShapeHit { t, part } = shape.intersect(&shape_ray(&pose, ray))?;
    let t = t_in_range(t, ray)?;
    Some(Hit {
        primitive: part,
        ..sphere_at(index, t)
    })
}

/// Returns the nearest hit of a ray with one point of an instanced cloud within its interval: that with its sphere as a
/// shape.
#[inline(always)]
pub(super) fn point_hit(
    index: u32,
    instance: &Instance,
    cloud: &PointCloud,
    point: u32,
    ray: &Ray,
) -> Option<Hit> {
    let hit = shape_hit(index, instance, &cloud.shape(point), ray)?;
    Some(Hit {
        primitive: point,
        ..hit
    })
}

/// Returns the nearest parameter at which a ray intersects a world-space sphere within its interval.
#[inline(always)]
pub(super) fn sphere_hit(sphere: &Sphere, ray: &Ray) -> Option<f32> {
    let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let t = sphere.nearest(origin, direction, f64::from(ray.t_near), f64::INFINITY)?;
    t_in_range(t, ray)
}

/// Rounds a parameter to f32; `None` if it is beyond the ray's `t_far`.
#[inline(always)]
fn t_in_range(t: f64, ray: &Ray) -> Option<f32> {
    let t = t as f32;
    (t <= ray.t_far && t < f32::INFINITY).then_some(t)
}

/// Returns the hit record of a sphere, which has one part.
#[inline(always)]
pub(super) fn sphere_at(instance: u32, t: f32) -> Hit {
    Hit {
        instance,
        primitive: 0,
        t,
        u: 0.0,
        v: 0.0,
    }
}

/// Returns the instance's shape as a world-space sphere, if the transform keeps it one and does not move: rays then
/// need no transform.
#[inline(always)]
pub(super) fn world_sphere(pose: &InstanceTransform, shape: &Shape) -> Option<Sphere> {
    match shape {
        Shape::Sphere(sphere) => pose.world_sphere(sphere),
        _ => None,
    }
}

/// Returns the ray in object space, from its `t_near` on.
#[inline(always)]
fn shape_ray(pose: &InstanceTransform, ray: &Ray) -> ShapeRay {
    let (origin, direction) = object_line(pose, ray);
    ShapeRay {
        t_near: ray.t_near.into(),
        ..ShapeRay::new(origin, direction)
    }
}

/// Returns origin and direction in object space; the ray parameter is unchanged.
#[inline(always)]
fn object_line(pose: &InstanceTransform, ray: &Ray) -> (DVec3, DVec3) {
    let map = pose.object_from_world();
    (
        map.transform_point3(ray.origin.as_dvec3()),
        map.transform_vector3(ray.direction.as_dvec3()),
    )
}
