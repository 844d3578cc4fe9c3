//! Caustics against closed forms.
//!
//! Closed forms are those of geometrical optics: the image of a light in a plane mirror, the focal curve of a ring, a ball
//! and a slab of glass.

use std::f64::consts::FRAC_1_PI;

use glam::{DAffine3, DMat3, DVec3};
use whit::numeric::Bounds;
use whit::render::RenderSettings;
use whit::scene::{
    Camera, Caustics, Falloff, Geometry, Light, LightKind, Material, MediumKind, Model, Projection, Scene,
};
use whit::shape::{Quadric, Shape, Sphere};

use super::rough_render::{glass, metal, settings};
use crate::support::images::{add, estimate, rendered};

/// Upper triangle of the matrix of the cylinder x² + y² = 1.
const CYLINDER: [f64; 10] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0];

/// Returns a surface of glTF's model that is diffuse only.
pub(super) fn lambertian(albedo: f32) -> Material {
    let mut material = Material::metallic_roughness([albedo; 3], 0.0, 1.0);
    if let Model::MetallicRoughness(model) = &mut material.model {
        model.specular = 0.0;
    }
    material
}

pub(super) fn with_caustics(photons: u32) -> Scene {
    let mut scene = Scene {
        caustics: Some(Caustics {
            photons,
            ..Caustics::default()
        }),
        ..Scene::default()
    };
    add(
        &mut scene,
        "floor",
        Geometry::Shape(Shape::Plane),
        lambertian(1.0),
        DAffine3::IDENTITY,
    );
    scene
}

pub(super) fn sun(to_light: DVec3) -> Light {
    Light {
        name: "sun".into(),
        intensity: [1.0; 3],
        kind: LightKind::Directional { to_light },
    }
}

pub(super) fn point_light(position: DVec3, intensity: f32) -> Light {
    Light {
        name: "lamp".into(),
        intensity: [intensity; 3],
        kind: LightKind::Point {
            position,
            falloff: Falloff::InverseSquare { range: None },
        },
    }
}

/// Returns a camera that looks down at one point of the floor, from below everything else.
pub(super) fn look_down(x: f64, y: f64) -> Camera {
    look_down_on(x, y, 1e-6)
}

/// Returns a camera that looks down at a square of the floor of half-width `half`.
pub(super) fn look_down_on(x: f64, y: f64, half: f64) -> Camera {
    Camera {
        world_from_camera: DAffine3::from_translation(DVec3::new(x, y, 1e-3)),
        projection: Projection::Orthographic {
            y_mag: half,
            x_mag: None,
        },
        ..Camera::default()
    }
}

/// Returns the mean irradiance around a point of the white floor by paths with at most `depth` reflections and refractions.
fn irradiance(scene: &Scene, x: f64, y: f64, depth: u32) -> f64 {
    mean_irradiance(scene, [x, y, 0.02], depth)
}

/// Returns the mean irradiance over the square of half-width `half` around a point of the floor.
fn mean_irradiance(scene: &Scene, [x, y, half]: [f64; 3], depth: u32) -> f64 {
    let settings = RenderSettings {
        depth,
        ..settings(8, 1)
    };
    let image = rendered(scene, &look_down_on(x, y, half), &settings).image;
    estimate(&image).0 / FRAC_1_PI
}

fn assert_near(what: &str, found: f64, exact: f64, tolerance: f64) {
    println!("{what}: {found:.4}, exactly {exact:.4}");
    assert!(
        (found / exact - 1.0).abs() <= tolerance,
        "{what}: {found}, not {exact}"
    );
}

#[test]
fn plane_mirror_throws_the_light_of_the_mirror_image() {
    let mut scene = with_caustics(1 << 16);
    // A mirror upright at x = 1, as wide and high as 1
    let place = DAffine3::from_mat3_translation(
        DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X) * 0.5,
        DVec3::new(1.0, 0.0, 0.5),
    );
    add(
        &mut scene,
        "mirror",
        Geometry::Shape(Shape::Quad),
        metal(1.0, 0.0, 0),
        place,
    );
    let lamp = DVec3::new(-0.5, 0.2, 1.5);
    scene.lights.push(point_light(lamp, 3.0));
    let image = DVec3::new(2.0 - lamp.x, lamp.y, lamp.z);
    for (x, y) in [(0.3, 0.1), (0.0, -0.1), (-0.2, 0.2)] {
        // The ray from the image passes the frame of the mirror
        let p = DVec3::new(x, y, 0.0);
        let through = p + (image - p) * ((1.0 - x) / (image.x - x));
        assert!(
            through.y.abs() < 0.45 && (0.05..0.95).contains(&through.z),
            "{through}"
        );
        let light = |from: DVec3| 3.0 * (from - p).normalize().z / (from - p).length_squared();
        assert_near(
            &format!("{x}, {y}"),
            irradiance(&scene, x, y, 4),
            light(lamp) + light(image),
            0.01,
        );
    }
    // Beyond the frame there is direct light alone
    let p = DVec3::new(0.3, 1.5, 0.0);
    let direct = 3.0 * (lamp - p).normalize().z / (lamp - p).length_squared();
    assert_near("beside", irradiance(&scene, p.x, p.y, 4), direct, 1e-4);
}

/// Side in pixels of the images whose every pixel is compared with a closed form.
pub(super) const SIDE: usize = 512;
/// Exposure at which these images are displayed.
const EXPOSURE: f64 = 0.2;

/// Returns the closed form's mean irradiance in each pixel of a square of the floor of half-width `half` around `x` on the
/// x axis: of even light, `landing` takes the points of a unit square to where they arrive, with their share of `flux`.
fn landed([x, half]: [f64; 2], flux: f64, landing: impl Fn(f64, f64) -> Option<([f64; 2], f64)>) -> Vec<f64> {
    const POINTS: usize = 8192;
    let side = SIDE as f64;
    let area = (2.0 * half / side).powi(2);
    let mut image = vec![0.0; SIDE * SIDE];
    let each = flux / (POINTS * POINTS) as f64 / area;
    for index in 0..POINTS * POINTS {
        // A lattice of rank one, so that points are in no rows along those of pixels
        let u = (index as f64 + 0.5) / (POINTS * POINTS) as f64;
        let v = (index as f64 * 0.618_033_988_749_894_9).fract();
        let Some(([px, py], share)) = landing(u, v) else {
            continue;
        };
        let [column, row] =
            [(px - x + half) / (2.0 * half), (half - py) / (2.0 * half)].map(|t| (t * side).floor());
        if (0.0..side).contains(&column) && (0.0..side).contains(&row) {
            image[row as usize * SIDE + column as usize] += share * each;
        }
    }
    image
}

/// Returns the displayed value of a radiance, as a part of white.
pub(super) fn displayed(radiance: f64) -> f64 {
    let value = radiance.clamp(0.0, 1.0);
    if value <= 0.0031308 {
        12.92 * value
    } else {
        1.055 * value.powf(1.0 / 2.4) - 0.055
    }
}

/// Returns the closed form's irradiance that the inside of [`ring`] throws on each pixel of a square of the floor, as
/// [`landed`] does.
pub(super) fn thrown_by_ring(view: [f64; 2]) -> Vec<f64> {
    landed(view, 4.0, |u, v| {
        let [y, z] = [2.0 * u - 1.0, 2.0 * v];
        let x = (1.0 - y * y).sqrt();
        // The chord leads inside until it reaches the ring again
        (z < 2.0 * x).then_some(([x - z * (1.0 - 2.0 * y * y), y - z * 2.0 * x * y], 1.0))
    })
}

/// Returns the root mean square difference of displayed values between an image of the white floor and a closed form of its
/// irradiance, over the pixels that `is_counted` takes by their position on the floor.
fn displayed_rmse(
    scene: &Scene,
    ([x, half], depth): ([f64; 2], u32),
    exact: &[f64],
    is_counted: impl Fn(f64, f64) -> bool,
) -> f64 {
    let settings = RenderSettings {
        depth,
        ..settings(SIDE as u32, 16)
    };
    let image = rendered(scene, &look_down_on(x, 0.0, half), &settings).image;
    let shown = |irradiance: f64| displayed(EXPOSURE * irradiance);
    let (mut sum, mut count) = (0.0, 0);
    for (index, (pixel, exact)) in image.pixels.iter().zip(exact).enumerate() {
        let at = |i: usize| ((i as f64 + 0.5) / SIDE as f64 - 0.5) * 2.0 * half;
        if is_counted(x + at(index % SIDE), at(index / SIDE)) {
            sum += (shown(f64::from(pixel[1]) / FRAC_1_PI) - shown(*exact)).powi(2);
            count += 1;
        }
    }
    (sum / f64::from(count)).sqrt()
}

#[test]
fn ring_is_displayed_within_a_hundredth_of_its_closed_form() {
    let mut scene = ring();
    let to_light = DVec3::new(-1.0, 0.0, 1.0).normalize();
    // Light of irradiance 1 on the floor, at an elevation of 45 degrees
    let mut light = sun(to_light);
    light.intensity = [to_light.z.recip() as f32; 3];
    scene.lights.push(light);
    let view = [0.25, 0.7];
    let exact: Vec<f64> = thrown_by_ring(view).iter().map(|thrown| 1.0 + thrown).collect();
    let rmse = displayed_rmse(&scene, (view, 1), &exact, |x, y| x * x + y * y < 0.97);
    println!("ring: {rmse:.4}");
    assert!(rmse <= 0.01, "{rmse}");
}

#[test]
fn ball_is_displayed_within_a_hundredth_of_its_closed_form() {
    let distance = 1.5;
    let mut scene = ball(distance);
    scene.lights.push(sun(DVec3::Z));
    let view = [0.0, 0.45];
    let exact = landed(view, std::f64::consts::PI, |u, v| {
        // A ray at distance h from the axis is turned twice by the difference of its angles to the normal
        let [h, azimuth] = [u.sqrt(), v * std::f64::consts::TAU];
        let [outside, inside] = [h.asin(), (h / 1.5).asin()];
        let turned = 2.0 * (outside - inside);
        // It leaves the ball at this point of its cross-section
        let angle = outside + std::f64::consts::PI - 2.0 * inside;
        let [radius, z] = [angle.sin(), angle.cos() + distance];
        let radius = radius - z * turned.tan();
        let [s, p] = [
            ((outside - inside).sin() / (outside + inside).sin()).powi(2),
            ((outside - inside).tan() / (outside + inside).tan()).powi(2),
        ];
        let passed = 1.0 - 0.5 * (s + p);
        let at = [radius * azimuth.cos(), radius * azimuth.sin()];
        (h > 0.0 && z > 0.0).then_some((at, passed * passed))
    });
    let rmse = displayed_rmse(&scene, (view, 2), &exact, |_, _| true);
    println!("ball: {rmse:.4}");
    assert!(rmse <= 0.01, "{rmse}");
}

/// Returns a scene of half of a ring that mirrors, on the floor.
fn ring() -> Scene {
    let mut scene = with_caustics(1 << 18);
    // Half of a cylinder, twice as high as the shadow of its edge is long
    let clip = Bounds {
        min: DVec3::new(0.0, -1.0, 0.0),
        max: DVec3::new(1.0, 1.0, 2.0),
    };
    let half = Quadric::new(CYLINDER, clip).unwrap();
    add(
        &mut scene,
        "ring",
        Geometry::Shape(Shape::Quadric(half.into())),
        metal(1.0, 0.0, 0),
        DAffine3::IDENTITY,
    );
    scene
}

#[test]
fn ring_has_the_focal_curve_of_its_closed_form() {
    let mut scene = ring();
    let to_light = DVec3::new(-1.0, 0.0, 1.0).normalize();
    scene.lights.push(sun(to_light));
    for (x, y, exact) in [
        (0.0, 0.0, 1.0),
        (0.3, 0.0, 2.5),
        (0.3, 0.2, 1.26246),
        (-0.2, 0.3, 0.61951),
        (0.6, 0.3, 0.66669),
        (0.0, 0.5, 0.57735),
    ] {
        // Direct light reaches the whole inside
        let found = irradiance(&scene, x, y, 1) / to_light.z - 1.0;
        assert_near(&format!("{x}, {y}"), found, exact, 0.05);
    }
}

/// Returns a scene of a ball of glass with its centre at this height over the floor.
fn ball(height: f64) -> Scene {
    let mut scene = with_caustics(1 << 18);
    let ball = Sphere {
        center: DVec3::Z * height,
        radius: 1.0,
    };
    add(
        &mut scene,
        "ball",
        Geometry::Shape(Shape::Sphere(ball)),
        glass(0.0, 0, MediumKind::Solid),
        DAffine3::IDENTITY,
    );
    scene
}

#[test]
fn glass_ball_focuses_parallel_light() {
    for (distance, expected) in [
        (1.2, [3.898, 1.005, 0.1634]),
        (1.5, [9.634, 2.769, 0.6164]),
        (2.0, [5.680, 3.014, 1.0336]),
        (3.0, [0.894, 0.819, 0.6106]),
    ] {
        let mut scene = ball(distance);
        scene.lights.push(sun(DVec3::Z));
        // Average narrow rings of one image around the axis
        let settings = RenderSettings {
            depth: 2,
            ..settings(256, 1)
        };
        let image = rendered(&scene, &look_down_on(0.0, 0.0, 0.45), &settings).image;
        for (radius, exact) in [0.1, 0.2, 0.4].into_iter().zip(expected) {
            let (mut sum, mut count) = (0.0, 0.0);
            for (index, pixel) in image.pixels.iter().enumerate() {
                let [x, y] = [index % 256, index / 256].map(|i| (i as f64 - 127.5) * 0.9 / 256.0);
                if (x.hypot(y) - radius).abs() < 0.006 {
                    sum += f64::from(pixel[1]) / FRAC_1_PI;
                    count += 1.0;
                }
            }
            let what = format!("distance {distance}, radius {radius}");
            // Next to the focal curve at radius 0.07, kernels carry some light away from the nearer point
            let tolerance = if (distance, radius) == (1.2, 0.1) {
                0.08
            } else {
                0.05
            };
            assert_near(&what, sum / count, exact, tolerance);
        }
    }
}

/// Returns a block of glass from z = 0.2 to 0.4 over the floor.
pub(super) fn slab() -> (Geometry, DAffine3) {
    let place = DAffine3::from_translation(DVec3::Z * 0.3) * DAffine3::from_scale(DVec3::new(1.0, 1.0, 0.1));
    (Geometry::Shape(Shape::Cube), place)
}

#[test]
fn glass_slab_passes_twelve_thirteenths_of_parallel_light() {
    let mut scene = with_caustics(1 << 16);
    let (cube, place) = slab();
    add(&mut scene, "slab", cube, glass(0.0, 0, MediumKind::Solid), place);
    scene.lights.push(sun(DVec3::Z));
    assert_near(
        "below the slab",
        mean_irradiance(&scene, [0.0, 0.0, 0.5], 16),
        12.0 / 13.0,
        0.004,
    );
    // Without caustics, shadow rays pass straight without reflection between the faces
    scene.caustics = None;
    assert_near("straight", irradiance(&scene, 0.1, 0.2, 16), 0.96 * 0.96, 1e-4);
}

#[test]
fn light_inside_of_a_medium_is_divided_by_its_squared_index() {
    // A white disk within glass, seen and lit from above
    let mut scene = with_caustics(1 << 16);
    add(
        &mut scene,
        "block",
        Geometry::Shape(Shape::Cube),
        glass(0.0, 0, MediumKind::Solid),
        DAffine3::from_translation(DVec3::Z * 2.0),
    );
    let place = DAffine3::from_translation(DVec3::Z * 1.5) * DAffine3::from_scale(DVec3::splat(0.5));
    add(
        &mut scene,
        "disk",
        Geometry::Shape(Shape::Disk),
        lambertian(0.8),
        place,
    );
    scene.lights.push(sun(DVec3::Z));
    let camera = Camera {
        world_from_camera: DAffine3::from_translation(DVec3::Z * 4.0),
        ..look_down_on(0.0, 0.0, 0.25)
    };
    let image = rendered(&scene, &camera, &settings(8, 1)).image;
    let exact = FRAC_1_PI * 0.8 * 0.96 * 0.96 / (1.5 * 1.5);
    assert_near("disk", estimate(&image).0, exact, 0.005);
}
