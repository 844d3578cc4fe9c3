//! Bound on the distance of ray origins from the coordinate origin, and the padding of watertight triangles' boxes that
//! follows from it.
//!
//! Embree reaches the triangles of a box only if the ray hits the box, by a test that is right for the exact ray. The
//! triangle test is right for a slightly displaced ray: with the unit roundoff `u = 2^-24`, a ray from `o`, and `p`
//! where it passes the triangle, a difference, a quotient and a product move a projected vertex by at most
//! `4 u |p_a - o_a|` along an axis `a`, and by `u` of the triangle's size. The parameter, which is compared to the
//! ray's entry into a box, is off by at most `10 u` of the distance: a weighted mean of depths, each of which is
//! rounded three times, with weights that are rounded twice, over their sum. With `M` the largest coordinate of the box
//! and `R` that of the origin, all of this is under `16 u (M + R)`, by which boxes are padded on every side.
//!
//! The boxes of other user geometry have the same padding, at every precision: Embree's traversal to user geometry
//! computes `b/d - o/d`, robust or not, and places a side `b` some 3 u of the distance aside.
//!
//! The bound does not hold for triangles seen nearly edge-on, whose weights may be anything. They are hit wherever they
//! are; but between two that lie within their own depth of each other, rounding decides which is nearer.
//!
//! The possible origins of rays follow from a scene: at a camera, or on or in a bounded object. Rays that start on an
//! infinite plane or in fog farther away than all of these lose a part of their position in their own coordinates, and
//! the watertight guarantee with it.

use glam::{DAffine3, DMat3, DVec3};

use crate::numeric::{Bounds, Ray};
use crate::scene::{Camera, Instance, Projection, Scene};

/// Padding of boxes relative to the distances involved: 16 units of roundoff.
const PADDING: f64 = 16.0 / (1 << 24) as f64;

/// Largest coordinate, along any axis, of ray origins in some space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct OriginBound {
    distance: f64,
    /// Relative padding: [`PADDING`], unless a test overrides it.
    padding: f64,
}

impl OriginBound {
    /// Computes the bound in the world space of a validated scene, whose geometries have the bounds `object_bounds`.
    pub(super) fn of(scene: &Scene, object_bounds: &[Bounds]) -> OriginBound {
        // Rays start on objects, in volumes and at cameras
        let volumes = scene.volumes.iter().map(|volume| volume.bounds().magnitude());
        let solid = scene.bounds_from(object_bounds).magnitude();
        let cameras = scene
            .cameras
            .iter()
            .map(|camera| camera_origin_bound(camera, solid));
        OriginBound::to(volumes.chain(cameras).fold(solid, f64::max))
    }

    fn to(distance: f64) -> OriginBound {
        #[cfg(not(test))]
        let padding = PADDING;
        #[cfg(test)]
        let padding = test_padding();
        OriginBound {
            distance: distance.min(f64::from(Ray::LIMIT)),
            padding,
        }
    }

    /// Computes the bound in the object space of a mesh over all of `instances`; `self` is the bound in world space.
    pub(super) fn in_object<'a>(self, instances: impl Iterator<Item = &'a Instance>) -> OriginBound {
        let distances = instances.map(|instance| self.in_instance(instance));
        let distance = distances.fold(0.0, f64::max);
        OriginBound {
            distance: distance.min(f64::from(Ray::LIMIT)),
            ..self
        }
    }

    /// Returns the padding on every side of a box that rounding errors require.
    pub(super) fn padding(self, bounds: &Bounds) -> f64 {
        self.padding * (bounds.magnitude() + self.distance)
    }

    /// Returns a box padded for rounding errors.
    pub(super) fn padded(self, bounds: &Bounds) -> Bounds {
        let padding = DVec3::splat(self.padding(bounds));
        Bounds {
            min: bounds.min - padding,
            max: bounds.max + padding,
        }
    }

    /// Returns [`OriginBound::padded`] in f32, clamped to Embree's coordinate range, as Embree skips boxes beyond it.
    pub(super) fn embree_box(self, bounds: &Bounds) -> ([f32; 3], [f32; 3]) {
        #[cfg(test)]
        if self.padding == 0.0 {
            return [bounds.min, bounds.max].map(|p| p.as_vec3().to_array()).into();
        }
        let (low, high) = self.padded(bounds).to_f32_outward();
        let most = Ray::LIMIT.next_down();
        (low.map(|x| x.max(-most)), high.map(|x| x.min(most)))
    }

    /// Bounds the origins in one instance's object space at any time. No interpolated stretch matrix, nor its inverse,
    /// lengthens a vector by more than those of the two ends, as they are definite (see
    /// [`crate::numeric::AnimatedTransform`]).
    fn in_instance(self, instance: &Instance) -> f64 {
        let ends = match instance.motion() {
            Some(motion) => motion.ends(),
            None => [instance.world_from_object(); 2],
        };
        let size = |m: &DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
        // Frobenius norms bound the factor by which the inverse lengthens a vector
        let shrink = ends
            .iter()
            .map(|map| size(&map.matrix3.inverse()))
            .fold(0.0, f64::max);
        let distance = |map: &DAffine3| DVec3::splat(self.distance).length() + map.translation.length();
        shrink * ends.iter().map(distance).fold(0.0, f64::max)
    }
}

/// Returns the largest coordinate of the origins of those camera rays that hit anything with coordinates up to `solid`.
fn camera_origin_bound(camera: &Camera, solid: f64) -> f64 {
    let ends = [Some(camera.world_from_camera), camera.world_from_camera_end];
    let eyes = ends
        .into_iter()
        .flatten()
        .map(|map| map.translation.abs().max_element());
    let eye = eyes.fold(0.0, f64::max) + camera.lens_radius();
    match camera.projection {
        // Orthographic rays start, seen along them, where they end, and at the depth of the camera; a rotated
        // coordinate is at most the square root of 3 times as large.
        Projection::Orthographic { .. } => 2.0 * (eye + solid),
        Projection::Perspective { .. } | Projection::Window { .. } => eye,
    }
}

#[cfg(test)]
thread_local! {
    static IS_PADDED: std::cell::Cell<bool> = const { std::cell::Cell::new(true) };
}

/// Returns [`PADDING`], or zero within [`unpadded`].
#[cfg(test)]
fn test_padding() -> f64 {
    if IS_PADDED.get() { PADDING } else { 0.0 }
}

/// Runs `build` on this thread with boxes that are not padded.
#[cfg(test)]
pub(super) fn unpadded<T>(build: impl FnOnce() -> T) -> T {
    IS_PADDED.set(false);
    let built = build();
    IS_PADDED.set(true);
    built
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, Vec3};

    use super::*;
    use crate::buffer::Buffer;
    use crate::mesh::Mesh;
    use crate::numeric::object_ray;
    use crate::scene::Geometry;

    #[test]
    fn origin_bound_covers_cameras_and_bounded_objects() {
        let mesh = Mesh {
            positions: Buffer::from(vec![[0.0; 3], [1.0, 0.0, -5.0], [0.0, 1.0, 0.0]]),
            triangles: Buffer::from(vec![[0, 1, 2]]),
            ..Mesh::default()
        };
        let mut scene = Scene {
            geometries: vec![Geometry::Mesh(mesh)],
            instances: vec![Instance::new("", 0, 0, DAffine3::IDENTITY).unwrap()],
            ..Scene::default()
        };
        let reach = |scene: &Scene| OriginBound::of(scene, &[scene.geometries[0].bounds()]);
        assert_eq!(reach(&scene), OriginBound::to(5.0));
        let at = |x: f64| DAffine3::from_translation(DVec3::new(0.0, x, 0.0));
        scene.cameras = vec![Camera {
            world_from_camera: at(-7.0),
            world_from_camera_end: Some(at(-9.0)),
            ..Camera::default()
        }];
        assert_eq!(reach(&scene), OriginBound::to(9.0));
        scene.cameras[0].projection = Projection::Orthographic {
            y_mag: 100.0,
            x_mag: None,
        };
        assert_eq!(reach(&scene), OriginBound::to(2.0 * (9.0 + 5.0)));
    }

    #[test]
    fn origin_bound_covers_moving_instances_at_all_times() {
        let place = |scale: DVec3, turn: f64, x: f64| {
            let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), turn);
            DAffine3::from_scale_rotation_translation(scale, turn, DVec3::new(x, 0.5, 0.0))
        };
        let ends = [
            place(DVec3::new(0.5, 2.0, 1.0), 0.0, 3.0),
            place(DVec3::new(4.0, 0.25, 1.0), 2.0, -2.0),
        ];
        let moving = Instance::moving("", 0, 0, ends).unwrap();
        let reach = OriginBound::to(10.0).in_object(std::iter::once(&moving)).distance;
        let mut most = 0.0f32;
        for i in 0..=64 {
            for corner in 0..8 {
                let sign = |axis: usize| if corner >> axis & 1 == 0 { 10.0 } else { -10.0 };
                let ray = crate::numeric::Ray::new(Vec3::new(sign(0), sign(1), sign(2)), Vec3::X);
                let map = moving.pose(i as f32 / 64.0).object_from_world();
                most = most.max(object_ray(&map, &ray).origin.abs().max_element());
            }
        }
        // At most 10 √3 + 3.05 away, lengthened by at most the norm of the larger inverse, √(1/16 + 16 + 1).
        assert!(f64::from(most) <= reach && reach < 85.0, "{most} {reach}");
    }

    #[test]
    fn boxes_are_padded_by_rounding_within_embrees_range() {
        let unit = Bounds::of_points([DVec3::ZERO, DVec3::ONE]);
        let padded = OriginBound::to(3.0).padded(&unit);
        // 16 units of 2^-24 times 1 + 3.
        assert_eq!(padded.max - unit.max, DVec3::splat(4.0 / (1 << 20) as f64));
        assert_eq!(unit.min - padded.min, DVec3::splat(4.0 / (1 << 20) as f64));
        let far = Bounds::of_points([DVec3::splat(-1.8439e18), DVec3::ONE]);
        let (low, high) = OriginBound::to(f64::INFINITY).embree_box(&far);
        assert!(low.into_iter().chain(high).all(|x| x.abs() < Ray::LIMIT));
    }
}
