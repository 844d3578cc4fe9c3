//! Hit points of analytic shapes in world space, in f64, one by one: for texture coordinates that few hits need, and as
//! the reference for packets.
//!
//! A backend reports the part of the shape and the f32 ray parameter. The intersection with that part is computed
//! again in f64, and the point is then projected onto the surface, which removes the rounding error of the parameter.

use super::uv_frame::UvFrame;
use crate::numeric::{Ray, transform_normal};
use crate::scene::InstanceTransform;
use crate::shape::{Implicit, Shape, ShapePoint, ShapeRay, refined_parameter};

/// Returns the point of `part` at the end of `ray`, whose `t_far` is the parameter of the hit.
///
/// The normal points outwards. For a mirroring instance transform, `dpdu x dpdv` points against it.
pub(super) fn world_point(pose: &InstanceTransform, shape: &Shape, ray: &Ray, part: u32) -> ShapePoint {
    // Transform the ray to object space
    let (map, inverse) = (pose.world_from_object(), pose.object_from_world());
    let line = ShapeRay::new(
        inverse.transform_point3(ray.origin.as_dvec3()),
        inverse.transform_vector3(ray.direction.as_dvec3()),
    );
    // Find the intersection nearest to the reported parameter
    let t = refined_parameter(shape, &line, part, f64::from(ray.t_far));
    let point = shape.point(line.at(t), part);
    if pose.is_identity() {
        return point;
    }
    // Transform the point back to world space
    let p = map.transform_point3(point.p);
    ShapePoint {
        p,
        n: transform_normal(&map.matrix3, point.n),
        uv: point.uv,
        dpdu: map.transform_vector3(point.dpdu),
        dpdv: map.transform_vector3(point.dpdv),
        error: point.error.transformed(&map, &inverse, p),
    }
}

/// Returns the texture coordinates of [`world_point`], and the derivatives of the point by them.
pub(super) fn shape_frame(pose: &InstanceTransform, shape: &Shape, ray: &Ray, part: u32) -> UvFrame {
    let point = world_point(pose, shape, ray, part);
    UvFrame {
        uv: point.uv.map(|x| x as f32),
        derivatives: [point.dpdu, point.dpdv],
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3, Vec3};

    use super::*;
    use crate::scene::Instance;
    use crate::shape::Sphere;

    #[test]
    fn scaled_mirrored_sphere_has_ellipsoid_normal() {
        // x² / 4 + y² + z² = 1 at x = 1: y = √3 / 2, gradient (x / 4, y) ~ (1, 2 √3).
        let map = DAffine3::from_scale(DVec3::new(-2.0, 1.0, 1.0));
        let instance = Instance::new("", 0, 0, map).unwrap();
        let ray = Ray {
            t_far: 4.133_975,
            ..Ray::new(Vec3::new(1.0, 5.0, 0.0), Vec3::NEG_Y)
        };
        let point = world_point(&instance.pose(0.0), &Shape::Sphere(Sphere::UNIT), &ray, 0);
        assert!((point.p - DVec3::new(1.0, 0.75f64.sqrt(), 0.0)).length() < 1e-15);
        let gradient = DVec3::new(1.0, 2.0 * 3f64.sqrt(), 0.0).normalize();
        assert!((point.n - gradient).length() < 1e-15, "{}", point.n);
        // Longitude 120 degrees is a third of the turn; the equator is half way up.
        assert!((point.uv[0] - 1.0 / 3.0).abs() < 1e-15 && point.uv[1] == 0.5);
        assert!(point.dpdu.dot(point.n).abs() < 1e-14 && point.dpdv.dot(point.n).abs() < 1e-14);
        assert!(point.dpdu.cross(point.dpdv).dot(point.n) < 0.0);
    }

    #[test]
    fn reported_face_determines_the_shading_point() {
        let instance = Instance::new("", 0, 0, DAffine3::IDENTITY).unwrap();
        // The ray crosses the cube from above: in at t = 2, out at t = 4, through different faces.
        let ray = |t_far| Ray {
            t_far,
            ..Ray::new(Vec3::new(0.25, 0.5, 3.0), Vec3::NEG_Z)
        };
        let mut parts = Vec::new();
        Shape::Cube.crossings(
            &ShapeRay::new(DVec3::new(0.25, 0.5, 3.0), DVec3::NEG_Z),
            &mut |hit| parts.push(hit),
        );
        for (hit, z) in parts.iter().zip([1.0, -1.0]) {
            let point = world_point(&instance.pose(0.0), &Shape::Cube, &ray(hit.t as f32), hit.part);
            assert_eq!((point.p, point.n), (DVec3::new(0.25, 0.5, z), z * DVec3::Z));
        }
        assert_eq!(parts.len(), 2);
    }
}
