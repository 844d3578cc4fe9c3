//! Hits of single lanes in world space, for the lanes that are not triangles in world space.

use glam::DVec3;

use super::packet::lane;
use super::shape_hit::world_point;
use super::uv_frame::UvFrame;
use super::vertex_fetch::FetchedVertices;
use crate::accel::RayPacket;
use crate::numeric::{HitErrorBound, Ray, transform_normal, triangle_spawn_error};
use crate::scene::InstanceTransform;
use crate::shape::Shape;

/// World-space hit point of one lane; normals may be on either side.
pub(super) struct WorldHit {
    pub(super) p: DVec3,
    pub(super) ng: DVec3,
    pub(super) ns: Option<DVec3>,
    pub(super) error: HitErrorBound,
}

/// Returns the hit of lane `l` on a triangle of a mesh with this transform.
pub(super) fn world_triangle(
    packet: &RayPacket,
    gathered: &FetchedVertices,
    l: usize,
    pose: &InstanceTransform,
) -> WorldHit {
    let [a, b, c] = std::array::from_fn(|corner| lane(&gathered.corners[corner], l).as_dvec3());
    let (e1, e2) = (b - a, c - a);
    let (u, v) = (f64::from(packet.u[l]), f64::from(packet.v[l]));
    let map = pose.world_from_object();
    let p = map.transform_point3(a + u * e1 + v * e2);
    let ns = gathered.smooth[l].then(|| {
        let [na, nb, nc] = std::array::from_fn(|corner| lane(&gathered.normals[corner], l).as_dvec3());
        transform_normal(&map.matrix3, (1.0 - u - v) * na + u * nb + v * nc)
    });
    WorldHit {
        p,
        ng: transform_normal(&map.matrix3, e1.cross(e2).normalize_or_zero()),
        ns: ns.filter(|n| *n != DVec3::ZERO),
        error: triangle_spawn_error(a.as_vec3(), e1.as_vec3(), e2.as_vec3()).transformed(
            &map,
            &pose.object_from_world(),
            p,
        ),
    }
}

/// Returns the hit of a ray on a part of an analytic shape with this transform, and its texture coordinates.
pub(super) fn world_shape(
    ray: &Ray,
    part: u32,
    shape: &Shape,
    pose: &InstanceTransform,
) -> (WorldHit, UvFrame) {
    let point = world_point(pose, shape, ray, part);
    let hit = WorldHit {
        p: point.p,
        ng: point.n,
        ns: None,
        error: point.error,
    };
    let frame = UvFrame {
        uv: point.uv.map(|x| x as f32),
        derivatives: [point.dpdu, point.dpdv],
    };
    (hit, frame)
}
