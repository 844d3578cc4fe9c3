//! Shading terminator: near grazing light on a tessellated sphere, facets are in shadow that smooth normals would
//! light, and others may be lit although they face away.

use std::f64::consts::PI;

use glam::{DAffine3, DVec3};

use crate::accel::AccelError;
use crate::mesh::Mesh;
use crate::scene::{
    Background, Camera, Geometry, Light, LightKind, Material, Model, Phong, Projection, Scene,
};
use crate::shape::{Shape, Sphere};
use crate::verify::harness::test_meshes::{rings, scene};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H46",
    title: "shading terminator",
    construction: "spheres of 8, 16, ... up to 512 rings of triangles with smooth normals, lit from the side",
    oracle: "the analytic sphere, whose irradiance is the cosine of the angle to the light",
    bound: "0 lit beyond the terminator, 0 dark before it, by more than a facet's tilt; the mean error falls with every doubling",
    unit: "of the coarser mesh's error",
    run: terminators,
    ..Case::TRIANGLES
}];

/// Numbers of rings of the coarsest and of the finest sphere.
const RINGS: [u32; 2] = [8, 512];
/// Largest number of triangles that is tested even if there are fewer rays.
const MIN_TRIANGLES: u64 = 4096;
/// Half the height of the orthographic view.
const REACH: f64 = 1.05;
/// Smallest and largest size of the image in pixels.
const SIZES: [f64; 2] = [24.0, 512.0];

/// Returns a scene of a ball lit along x, with a diffuse material that reflects the cosine of the angle to the light.
fn lit_scene(geometry: Geometry) -> Scene {
    let mut scene = scene(vec![geometry]);
    scene.materials = vec![Material {
        model: Model::Phong(Phong {
            ambient: [0.0; 3],
            ..Phong::DEFAULT
        }),
        base_color: [1.0, 1.0, 0.0, 1.0],
        ..Material::default()
    }];
    // Mark pixels beside the ball by blue
    scene.background = Background::Uniform([0.0, 0.0, 1.0]);
    scene.lights = vec![Light {
        name: String::new(),
        intensity: [1.0; 3],
        kind: LightKind::Directional { to_light: DVec3::X },
    }];
    scene
}

fn camera() -> Camera {
    Camera {
        world_from_camera: DAffine3::from_translation(3.0 * DVec3::Z),
        projection: Projection::Orthographic {
            y_mag: REACH,
            x_mag: None,
        },
        ..Camera::default()
    }
}

/// Returns a tessellated ball with the normals of the sphere.
fn ball(ring_count: u32) -> Mesh {
    let mesh = rings(ring_count, DVec3::ZERO, |_, _| 1.0);
    Mesh {
        normals: Some(mesh.positions.to_vec().into()),
        ..mesh
    }
}

/// Renders a ball and returns the radiance of each pixel, NaN beside the ball.
fn render_radiance(
    trial: &CaseRunner,
    geometry: Geometry,
    size: u32,
) -> Result<Option<Vec<f64>>, AccelError> {
    let rendering = trial.render_image((&lit_scene(geometry), &camera()), size, (0, 0.0))?;
    let light = |pixel: &[f32; 3]| match pixel[2] {
        0.0 => f64::from(pixel[0]),
        _ => f64::NAN,
    };
    Ok(rendering.map(|rendering| rendering.image.pixels.iter().map(light).collect()))
}

fn terminators(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let mut tally = Counts::default();
    // Share the rays among the resolutions
    let steps = (RINGS[1] / RINGS[0]).ilog2() + 1;
    let size = ((trial.rays / u64::from(steps)) as f64)
        .sqrt()
        .clamp(SIZES[0], SIZES[1]) as u32;
    // Render the analytic sphere
    let Some(exact) = render_radiance(trial, Geometry::Shape(Shape::Sphere(Sphere::UNIT)), size)? else {
        return Ok(tally);
    };
    // Render balls of doubling resolution
    let mut coarser = f64::INFINITY;
    let mut ring_count = RINGS[0];
    while ring_count <= RINGS[1] && 4 * u64::from(ring_count).pow(2) <= trial.rays.max(MIN_TRIANGLES) {
        let Some(found) = render_radiance(trial, Geometry::Mesh(ball(ring_count)), size)? else {
            break;
        };
        // Compare pixels, and the mean error with that of the coarser ball
        let error = judge(ring_count, size, (&exact, &found), &mut tally);
        tally.record_error(error / coarser);
        tally.count(Correctness::wrong_if(!(error < coarser)), || {
            format!("{ring_count} rings differ by {error:e} of the total light, half as many by {coarser:e}")
        });
        coarser = error;
        ring_count *= 2;
    }
    Ok(tally)
}

/// Counts the pixels and returns their total error as a share of all light.
fn judge(ring_count: u32, size: u32, (exact, found): (&[f64], &[f64]), tally: &mut Counts) -> f64 {
    let pixel = 2.0 * REACH / f64::from(size);
    // A facet is at most that far across, and its tilt against each point of the sphere below it is no larger.
    let tilt = 2f64.sqrt() * PI / f64::from(ring_count);
    let (mut sum, mut error) = (0.0, 0.0);
    for (number, (&exact, &found)) in exact.iter().zip(found).enumerate() {
        // Skip pixels beside either ball
        if exact.is_nan() || found.is_nan() {
            continue;
        }
        // Compute the cosine of the angle to the light from the column
        let column = (number % size as usize) as f64;
        let cosine = (column + 0.5) * pixel - REACH;
        // Check the analytic sphere, and facets beyond and before the terminator
        let is_off = (exact - cosine.max(0.0)).abs() > COSINE_ERROR;
        let leaks = cosine < -tilt && found > 0.0;
        let is_dark = cosine > tilt && !(found > 0.0);
        tally.count(Correctness::wrong_if(is_off || leaks || is_dark), || {
            format!(
                "{ring_count} rings, pixel {number} of {size} x {size}: {found:e}, the sphere has {exact:e}"
            )
        });
        sum += exact;
        error += (found - exact).abs();
    }
    error / sum
}

/// Error bound of the analytic sphere's radiance: the normal and the sum of its products are rounded to f32, three
/// times each.
const COSINE_ERROR: f64 = 8.0 / (1 << 24) as f64;
