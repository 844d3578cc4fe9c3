//! The textbook's camera: `P(x, y) = E + w(2x/c - 1) i + h(2y/r - 1) j - n k`, columns x from the left and rows y from
//! the bottom, with t = 1 on the near plane.

use glam::{DAffine3, DMat3, DVec3};
use whit::render::{Pattern, Purpose, RenderSettings, sample_2d};
use whit::scene::{Background, Camera, Geometry, Instance, Material, Model, Projection, Scene};
use whit::shape::{Shape, Sphere};

use crate::support::optical_bench::{backends, render_image, square};

/// The textbook's camera with its own names.
struct FormulaCamera {
    eye: DVec3,
    /// The axes i, j, k.
    axes: DMat3,
    w: f64,
    h: f64,
    n: f64,
    /// Columns and rows.
    c: u32,
    r: u32,
}

impl FormulaCamera {
    /// An askew one.
    fn askew(c: u32, r: u32) -> FormulaCamera {
        let turn = DMat3::from_rotation_y(0.7) * DMat3::from_rotation_x(-0.4) * DMat3::from_rotation_z(0.2);
        FormulaCamera {
            eye: DVec3::new(1.3, -2.1, 0.7),
            axes: turn,
            w: 0.75,
            h: 0.4,
            n: 1.25,
            c,
            r,
        }
    }

    /// The textbook's formula.
    fn point(&self, x: f64, y: f64) -> DVec3 {
        let [i, j, k] = [self.axes.x_axis, self.axes.y_axis, self.axes.z_axis];
        let (c, r) = (f64::from(self.c), f64::from(self.r));
        self.eye + self.w * (2.0 * x / c - 1.0) * i + self.h * (2.0 * y / r - 1.0) * j - self.n * k
    }

    fn camera(&self) -> Camera {
        Camera {
            world_from_camera: DAffine3::from_mat3_translation(self.axes, self.eye),
            projection: Projection::Window {
                half_width: self.w,
                half_height: self.h,
                distance: self.n,
            },
            z_near: self.n,
            ..Camera::default()
        }
    }
}

#[test]
fn camera_rays_pass_through_the_formulas_points() {
    let formula = FormulaCamera::askew(7, 5);
    let view = formula.camera().view(formula.c, formula.r);
    assert_eq!((view.t_near(), view.eye()), (1.0, Some(formula.eye)));
    let spp = 6;
    let corners_and_middle = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.5]];
    for column in 0..formula.c {
        for row in 0..formula.r {
            let mut places = corners_and_middle.to_vec();
            for pattern in [Pattern::Regular, Pattern::Jittered, Pattern::Sobol] {
                let place = |sample| sample_2d(pattern, [column, row], sample, spp, Purpose::FILM);
                places.extend((0..spp).map(place));
            }
            for [dx, dy] in places {
                // Images count rows from the top.
                let (x, from_top) = (f64::from(column) + dx, f64::from(row) + dy);
                let y = f64::from(formula.r) - from_top;
                let ray = view.ray(x / f64::from(formula.c), from_top / f64::from(formula.r));
                let off = (ray.origin + ray.direction - formula.point(x, y))
                    .abs()
                    .max_element();
                // Either side sums three terms to the eye, of two or three roundings each.
                let size = formula.eye.abs().max_element() + formula.w + formula.h + formula.n;
                assert!(off <= 8.0 * f64::EPSILON * size, "({x}, {y}): {off}");
            }
        }
    }
}

#[test]
fn images_show_objects_at_the_formulas_points() {
    // Red by how far up a ray goes, green by how far down; the axes take turns at being up.
    let background = Background::Gradient {
        horizon: [0.0; 3],
        up: [1.0, 0.0, 0.0],
        down: [0.0, 1.0, 0.0],
    };
    let mut formula = FormulaCamera::askew(9, 6);
    for _ in 0..3 {
        let behind = Sphere {
            center: formula.eye + 5.0 * formula.axes.z_axis,
            radius: 0.5,
        };
        let scene = Scene {
            geometries: vec![Geometry::Shape(Shape::Sphere(behind))],
            instances: vec![Instance::new("behind the camera", 0, 0, DAffine3::IDENTITY).unwrap()],
            materials: vec![Material::default()],
            background,
            ..Scene::default()
        };
        let settings = RenderSettings {
            width: formula.c,
            height: formula.r,
            ..RenderSettings::default()
        };
        for backend in backends() {
            let pixels = render_image(&scene, &formula.camera(), backend, &settings);
            for (index, pixel) in (0..).zip(pixels) {
                let (column, row) = (index % formula.c, index / formula.c);
                let y = f64::from(formula.r) - f64::from(row) - 0.5;
                let point = formula.point(f64::from(column) + 0.5, y);
                let height = (point - formula.eye).normalize().y;
                // Directions are rounded to f32 once, and the radiance twice.
                let off = (pixel.x - pixel.y - height).abs();
                assert!(
                    off < 4.0 * f64::from(f32::EPSILON),
                    "({column}, {row}), {backend:?}: {off}"
                );
            }
        }
        formula.axes = DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X) * formula.axes;
    }
}

#[test]
fn near_plane_clips_nearer_objects_only() {
    // Looks straight down on the square at y = 0, from a height of t near-plane distances.
    let emissive = Material {
        model: Model::Unlit,
        ..Material::default()
    };
    let scene = Scene {
        geometries: vec![Geometry::Mesh(square())],
        instances: vec![Instance::new("wall", 0, 0, DAffine3::IDENTITY).unwrap()],
        materials: vec![emissive],
        ..Scene::default()
    };
    let step = 2f64.powi(-20);
    for (t, is_seen) in [(0.5, false), (1.0 - step, false), (1.0 + step, true), (2.0, true)] {
        let formula = FormulaCamera {
            eye: DVec3::new(0.1, 0.5 * t, -0.2),
            axes: DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y),
            w: 0.15,
            h: 0.15,
            n: 0.5,
            c: 8,
            r: 8,
        };
        let settings = RenderSettings {
            width: formula.c,
            height: formula.r,
            ..RenderSettings::default()
        };
        for backend in backends() {
            let expected = if is_seen { DVec3::ONE } else { DVec3::ZERO };
            for pixel in render_image(&scene, &formula.camera(), backend, &settings) {
                assert_eq!(pixel, expected, "t = {t}, {backend:?}");
            }
        }
    }
}
