//! Motion vectors: the movement of surface points in pixels of the image while the shutter is open.
//!
//! A hit point is moved with its instance to the times of shutter open and shutter close. Both positions are
//! projected by the camera at that time. The vectors do not depend on whether motion blur is simulated.

use glam::{DVec2, DVec3};

use crate::scene::{Camera, CameraView, Instance, Shutter};

/// Camera views at shutter open and at shutter close.
pub(in crate::render) struct ScreenMotion {
    views: [CameraView; 2],
    shutter: Shutter,
    /// Width and height of the image in pixels.
    size: DVec2,
    is_camera_moving: bool,
}

impl ScreenMotion {
    pub(in crate::render) fn new(camera: &Camera, [width, height]: [u32; 2]) -> ScreenMotion {
        let shutter = camera.shutter;
        let motion = camera.motion();
        let view = |time: f64| match &motion {
            None => camera.view(width, height),
            Some(motion) => Camera {
                world_from_camera: motion.at(time),
                ..camera.clone()
            }
            .view(width, height),
        };
        ScreenMotion {
            views: [shutter.open, shutter.close].map(view),
            shutter,
            size: DVec2::new(f64::from(width), f64::from(height)),
            is_camera_moving: motion.is_some(),
        }
    }

    /// Returns the motion in pixels, to the right and down, of `p`, a point of `instance` at `time`; zero if it is
    /// behind the camera at either end.
    pub(in crate::render) fn of(&self, p: DVec3, instance: &Instance, time: f32) -> DVec2 {
        if !self.is_camera_moving && !instance.is_moving() {
            return DVec2::ZERO;
        }
        // Move the point with its instance
        let p_object = instance.pose(time).object_from_world().transform_point3(p);
        let place = |time: f64| match instance.motion() {
            None => p,
            Some(motion) => motion.at(time).transform_point3(p_object),
        };
        // Project both positions and take their difference
        let Shutter { open, close } = self.shutter;
        let [before, after] =
            [(0, open), (1, close)].map(|(end, time)| self.views[end].film_point(place(time)));
        before
            .zip(after)
            .map_or(DVec2::ZERO, |(before, after)| (after - before) * self.size)
    }
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;
    use crate::scene::Projection;

    /// Returns a camera at the origin that looks along -z; its square image covers -1 to 1 on the plane z = -1.
    fn camera() -> Camera {
        Camera {
            projection: Projection::Window {
                half_width: 1.0,
                half_height: 1.0,
                distance: 1.0,
            },
            ..Camera::default()
        }
    }

    fn at(x: f64, y: f64, z: f64) -> DAffine3 {
        DAffine3::from_translation(DVec3::new(x, y, z))
    }

    fn body(ends: [DAffine3; 2]) -> Instance {
        Instance::moving("body", 0, 0, ends).unwrap()
    }

    #[test]
    fn screen_motion_spans_the_shutter_interval() {
        let motion = ScreenMotion::new(&camera(), [100, 100]);
        let body = body([at(0.0, 0.0, -2.0), at(0.5, 0.25, -2.0)]);
        // At half the time the origin of the object is here. At twice the distance a unit is 25 pixels.
        let moved = motion.of(DVec3::new(0.25, 0.125, -2.0), &body, 0.5);
        assert_eq!(moved, DVec2::new(12.5, -6.25));
    }

    #[test]
    fn motion_outside_the_shutter_interval_is_ignored() {
        let half = Camera {
            shutter: Shutter {
                open: 0.25,
                close: 0.75,
            },
            ..camera()
        };
        let motion = ScreenMotion::new(&half, [100, 100]);
        let body = body([at(0.0, 0.0, -2.0), at(0.5, 0.0, -2.0)]);
        assert_eq!(
            motion.of(DVec3::new(0.25, 0.0, -2.0), &body, 0.5),
            DVec2::new(6.25, 0.0)
        );
    }

    #[test]
    fn static_points_move_against_the_camera() {
        let still = Instance::new("still", 0, 0, DAffine3::IDENTITY).unwrap();
        let p = DVec3::new(0.3, 0.7, -4.0);
        assert_eq!(
            ScreenMotion::new(&camera(), [10, 10]).of(p, &still, 0.5),
            DVec2::ZERO
        );
        let moving = Camera {
            world_from_camera_end: Some(at(0.8, 0.0, 0.0)),
            ..camera()
        };
        // At four times the distance 10 pixels are 8 units.
        let moved = ScreenMotion::new(&moving, [10, 10]).of(p, &still, 0.5);
        assert!(
            (moved - DVec2::new(-1.0, 0.0)).length() <= 8.0 * f64::EPSILON,
            "{moved}"
        );
    }

    #[test]
    fn points_behind_the_camera_have_no_motion() {
        let motion = ScreenMotion::new(&camera(), [10, 10]);
        let body = body([at(0.0, 0.0, 2.0), at(0.0, 0.0, -6.0)]);
        assert_eq!(motion.of(DVec3::new(0.5, 0.0, -2.0), &body, 0.5), DVec2::ZERO);
    }
}
