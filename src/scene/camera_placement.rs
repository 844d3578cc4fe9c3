//! Cameras that are placed without a camera in the scene's file: by position and target, by named view, or by default.

use std::f64::consts::FRAC_PI_4;
use std::fmt;

use glam::{DAffine3, DMat3, DVec3};

use super::camera::axes_looking_along;
use super::{Camera, Projection, Scene, SceneError, image_settings};
use crate::numeric::Bounds;

/// Part of the image's smaller side that a framed scene fills.
const FRAME_FILL: f64 = 0.8;
/// Default vertical field of view in radians: 45 degrees.
pub const DEFAULT_FOV: f64 = FRAC_PI_4;
/// Direction from the scene to the default camera: in front, slightly to the right and above.
const DEFAULT_SIDE: DVec3 = DVec3::new(0.5, 0.35, 1.0);

/// Camera that is requested for a scene, in place of those of its file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraRequest {
    /// Placement of the camera; `None` for the cameras of the file, or one that frames the scene if it has none.
    pub placement: Option<CameraPlacement>,
    /// Width and height of the image, which framing depends on; that of the scene file or the default if absent.
    pub image_size: Option<[u32; 2]>,
}

/// Placement of a camera in a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CameraPlacement {
    /// A position and a target.
    LookAt(LookAt),
    /// A direction from which the camera frames the scene.
    Framed(FramedView),
}

/// Position and target of a camera, in the coordinates of the scene's file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LookAt {
    /// Position of the camera.
    pub from: DVec3,
    /// Point that the camera looks at; the centre of the scene's bounds if absent.
    pub at: Option<DVec3>,
    /// Direction that is up in the image, of any length.
    pub up: DVec3,
    /// Vertical field of view in radians.
    pub y_fov: f64,
}

/// Named view of the whole scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FramedView {
    /// Side of the scene that the camera sees.
    pub side: ViewSide,
    /// Vertical field of view in radians.
    pub y_fov: f64,
}

/// Side from which a named view sees the scene; as in glTF, +y is up and the front faces +z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum ViewSide {
    /// From +z, the front of glTF models
    Front,
    /// From -z, the side behind
    Back,
    /// From -x, left of the front
    Left,
    /// From +x, right of the front
    Right,
    /// From +y, with -z up in the image
    Top,
    /// From -y, with +z up in the image
    Bottom,
    /// From (1, 1, 1), as isometric drawings show things, in perspective
    Iso,
}

impl ViewSide {
    /// Returns the direction from the scene to the camera, of any length.
    fn to_camera(self) -> DVec3 {
        match self {
            ViewSide::Front => DVec3::Z,
            ViewSide::Back => DVec3::NEG_Z,
            ViewSide::Left => DVec3::NEG_X,
            ViewSide::Right => DVec3::X,
            ViewSide::Top => DVec3::Y,
            ViewSide::Bottom => DVec3::NEG_Y,
            ViewSide::Iso => DVec3::ONE,
        }
    }

    /// Returns the direction that is up in the image.
    fn up(self) -> DVec3 {
        match self {
            ViewSide::Top => DVec3::NEG_Z,
            ViewSide::Bottom => DVec3::Z,
            _ => DVec3::Y,
        }
    }

    fn name(self) -> &'static str {
        match self {
            ViewSide::Front => "front",
            ViewSide::Back => "back",
            ViewSide::Left => "left",
            ViewSide::Right => "right",
            ViewSide::Top => "top",
            ViewSide::Bottom => "bottom",
            ViewSide::Iso => "iso",
        }
    }
}

impl Default for LookAt {
    fn default() -> LookAt {
        LookAt {
            from: DVec3::Z,
            at: None,
            up: DVec3::Y,
            y_fov: DEFAULT_FOV,
        }
    }
}

/// Prints position, target, up and field of view, from which the image can be reproduced.
impl fmt::Display for LookAt {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let point = |p: DVec3| format!("{},{},{}", p.x, p.y, p.z);
        write!(f, "from {}", point(self.from))?;
        if let Some(at) = self.at {
            write!(f, " at {}", point(at))?;
        }
        write!(f, " up {} fov {}", point(self.up), self.y_fov.to_degrees())
    }
}

impl Scene {
    /// Replaces the cameras by the requested one, or adds one that frames the scene if there is none.
    ///
    /// `object_bounds` are the bounds of the geometries.
    ///
    /// # Errors
    /// A requested camera without a viewing direction, and a camera that is to frame a scene without finite objects.
    pub(crate) fn place_cameras(
        &mut self,
        request: &CameraRequest,
        object_bounds: &[Bounds],
    ) -> Result<(), SceneError> {
        let view = |to_camera, up, y_fov| View {
            to_camera,
            up,
            y_fov,
            image_size: request.image_size.unwrap_or(image_settings::DEFAULT_SIZE),
        };
        let camera = match request.placement {
            Some(CameraPlacement::LookAt(look_at)) => self.look_at(&look_at, object_bounds)?,
            Some(CameraPlacement::Framed(FramedView { side, y_fov })) => Camera {
                name: side.name().into(),
                ..self.framed(&view(side.to_camera(), side.up(), y_fov), object_bounds)?
            },
            None if self.cameras.is_empty() => Camera {
                name: "framing".into(),
                ..self.framed(&view(DEFAULT_SIDE, DVec3::Y, DEFAULT_FOV), object_bounds)?
            },
            None => return Ok(()),
        };
        self.cameras = vec![camera];
        Ok(())
    }

    /// Returns the camera that looks from a point at another.
    fn look_at(&self, look_at: &LookAt, object_bounds: &[Bounds]) -> Result<Camera, SceneError> {
        let from = self.normalisation.point(look_at.from);
        let at = match look_at.at {
            Some(at) => self.normalisation.point(at),
            None => {
                let bounds = self.bounds_from(object_bounds).union(self.volume_bounds());
                Some(bounds.center()).filter(|_| !bounds.is_empty()).ok_or_else(|| {
                    fault("nothing in the scene is finite, so it has no default target: give the point that it looks at")
                })?
            }
        };
        let axes = axes_looking_along(at - from, look_at.up).ok_or_else(|| {
            fault(
                "it has no viewing direction, or looks along its up direction: move its position or its target, or give \
                 another up direction",
            )
        })?;
        Ok(Camera {
            name: look_at.to_string(),
            world_from_camera: DAffine3::from_mat3_translation(axes, from),
            ..perspective(look_at.y_fov)
        })
    }

    /// Returns the camera that frames the scene as seen from a direction.
    fn framed(&self, view: &View, object_bounds: &[Bounds]) -> Result<Camera, SceneError> {
        let axes = view.axes();
        let eye = self.framing_eye(object_bounds, axes, FRAME_FILL * view.slope());
        let eye = eye.ok_or_else(|| {
            fault(
                "nothing in the scene is finite, so nothing can be framed: give its position and its target",
            )
        })?;
        Ok(Camera {
            world_from_camera: DAffine3::from_mat3_translation(axes, eye),
            ..perspective(view.y_fov)
        })
    }
}

/// Direction, field of view and image size of a camera that frames a scene.
struct View {
    /// Direction from the scene to the camera, of any length.
    to_camera: DVec3,
    /// Direction that is up in the image, not parallel to the former.
    up: DVec3,
    /// Vertical field of view in radians.
    y_fov: f64,
    /// Width and height of the image in pixels.
    image_size: [u32; 2],
}

impl View {
    fn axes(&self) -> DMat3 {
        // The directions of all views differ from their up directions
        axes_looking_along(-self.to_camera, self.up).unwrap_or(DMat3::IDENTITY)
    }

    /// Returns the slope from the view axis to the edge of the image in the middle of its longer side.
    fn slope(&self) -> f64 {
        let [width, height] = self.image_size.map(f64::from);
        (0.5 * self.y_fov).tan() * (width / height).min(1.0)
    }
}

/// Returns a pinhole camera with the given vertical field of view in radians, at the origin.
fn perspective(y_fov: f64) -> Camera {
    Camera {
        projection: Projection::Perspective { y_fov, aspect: None },
        ..Camera::default()
    }
}

fn fault(fault: &str) -> SceneError {
    SceneError {
        item: "camera".into(),
        fault: fault.into(),
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;
    use crate::buffer::Buffer;
    use crate::mesh::Mesh;
    use crate::scene::{Geometry, Instance};

    /// Returns a scene of an octahedron with half axes 3, 2 and 1 around `center`, and its vertices.
    fn octahedron(center: DVec3) -> (Scene, Vec<DVec3>) {
        let half_axes = [DVec3::X * 3.0, DVec3::Y * 2.0, DVec3::Z];
        let vertices: Vec<DVec3> = half_axes
            .iter()
            .flat_map(|&axis| [center + axis, center - axis])
            .collect();
        let mut triangles = Vec::new();
        for corner in 0..8 {
            triangles.push([corner & 1, 2 + (corner >> 1 & 1), 4 + (corner >> 2)]);
        }
        let mesh = Mesh {
            positions: Buffer::from(
                vertices
                    .iter()
                    .map(|p| p.as_vec3().to_array())
                    .collect::<Vec<_>>(),
            ),
            triangles: Buffer::from(triangles),
            ..Mesh::default()
        };
        let scene = Scene {
            geometries: vec![Geometry::Mesh(mesh)],
            instances: vec![Instance::new("a", 0, 0, DAffine3::IDENTITY).unwrap()],
            ..Scene::default()
        };
        (scene, vertices)
    }

    fn placed(scene: &Scene, request: CameraRequest) -> Result<Camera, SceneError> {
        let mut scene = scene.clone();
        let bounds: Vec<Bounds> = scene.geometries.iter().map(Geometry::bounds).collect();
        scene.place_cameras(&request, &bounds)?;
        Ok(scene.cameras[0].clone())
    }

    fn side(side: ViewSide) -> Option<CameraPlacement> {
        Some(CameraPlacement::Framed(FramedView {
            side,
            y_fov: DEFAULT_FOV,
        }))
    }

    #[test]
    fn larger_side_of_the_projected_bounds_fills_four_fifths_of_the_smaller_side() {
        let (scene, vertices) = octahedron(DVec3::new(5.0, -7.0, 2.0));
        let placements = [
            None,
            side(ViewSide::Front),
            side(ViewSide::Top),
            side(ViewSide::Iso),
        ];
        for (placement, [width, height]) in placements
            .into_iter()
            .flat_map(|placement| [[100, 100], [400, 100], [100, 300]].map(|size| (placement, size)))
        {
            let request = CameraRequest {
                placement,
                image_size: Some([width, height]),
            };
            let view = placed(&scene, request).unwrap().view(width, height);
            // Project the vertices to pixels
            let scale = DVec2::new(f64::from(width), f64::from(height));
            let pixels: Vec<DVec2> = vertices
                .iter()
                .map(|&p| view.film_point(p).unwrap() * scale)
                .collect();
            let low = pixels.iter().copied().reduce(DVec2::min).unwrap();
            let high = pixels.iter().copied().reduce(DVec2::max).unwrap();
            let smaller = f64::from(width.min(height));
            let fill = (high - low).max_element() / smaller;
            assert!(
                (fill - 0.8).abs() < 1e-9,
                "{placement:?} {width}x{height}: {fill}"
            );
            // The wider direction is centred
            let wide = if high.x - low.x > high.y - low.y { 0 } else { 1 };
            assert!((0.5 * (low + high) - 0.5 * scale)[wide].abs() < 1e-9 * smaller);
        }
    }

    #[test]
    fn named_views_look_along_their_axes() {
        let (scene, _) = octahedron(DVec3::ZERO);
        // Direction to the right and up in the image
        for (view, right, up) in [
            (ViewSide::Front, DVec3::X, DVec3::Y),
            (ViewSide::Back, DVec3::NEG_X, DVec3::Y),
            (ViewSide::Right, DVec3::NEG_Z, DVec3::Y),
            (ViewSide::Left, DVec3::Z, DVec3::Y),
            (ViewSide::Top, DVec3::X, DVec3::NEG_Z),
            (ViewSide::Bottom, DVec3::X, DVec3::Z),
        ] {
            let request = CameraRequest {
                placement: side(view),
                image_size: None,
            };
            let axes = placed(&scene, request).unwrap().world_from_camera.matrix3;
            assert_eq!((axes.x_axis, axes.y_axis), (right, up), "{view:?}");
        }
        // From (1, 1, 1), the three axes are equally long
        let request = CameraRequest {
            placement: side(ViewSide::Iso),
            image_size: None,
        };
        let axes = placed(&scene, request).unwrap().world_from_camera.matrix3;
        assert!((axes.z_axis - DVec3::splat(3f64.sqrt().recip())).length() < 4.0 * f64::EPSILON);
    }

    #[test]
    fn look_at_is_in_the_coordinates_of_the_file() {
        // A scene of extent 2^20 far away is moved and scaled by a power of two
        let scale = f64::from(1 << 20);
        let center = DVec3::new(scale * 64.0, 0.0, 0.0);
        let (mut scene, _) = octahedron(DVec3::ZERO);
        scene.instances[0] = Instance::new(
            "a",
            0,
            0,
            DAffine3::from_scale_rotation_translation(DVec3::splat(scale), glam::DQuat::IDENTITY, center),
        )
        .unwrap();
        scene.normalise();
        assert!(!scene.normalisation.is_identity());
        let look_at = LookAt {
            from: center + DVec3::new(0.0, 0.0, 10.0 * scale),
            ..LookAt::default()
        };
        for at in [None, Some(center)] {
            let request = CameraRequest {
                placement: Some(CameraPlacement::LookAt(LookAt { at, ..look_at })),
                image_size: None,
            };
            let camera = placed(&scene, request).unwrap();
            let in_file = scene.normalisation.inverse_map() * camera.world_from_camera;
            assert_eq!(in_file.translation, look_at.from);
            assert_eq!(camera.world_from_camera.matrix3, DMat3::IDENTITY);
        }
    }

    #[test]
    fn camera_without_a_direction_is_rejected() {
        let (scene, _) = octahedron(DVec3::ZERO);
        for (from, up) in [
            (DVec3::ZERO, DVec3::Y),
            (DVec3::Y, DVec3::Y),
            (DVec3::X, DVec3::ZERO),
        ] {
            let request = CameraRequest {
                placement: Some(CameraPlacement::LookAt(LookAt {
                    from,
                    up,
                    ..LookAt::default()
                })),
                image_size: None,
            };
            let error = placed(&scene, request).unwrap_err();
            assert!(error.fault.contains("no viewing direction"), "{error}");
        }
    }
}
