//! White furnace test: non-absorbing objects in uniform light are invisible.

use glam::{DAffine3, DQuat, DVec3};

use crate::accel::AccelError;
use crate::optics::{Absorption, Dispersion};
use crate::scene::{
    Background, Camera, Geometry, Instance, Material, Medium, MediumKind, MetallicRoughness, Model, Scene,
};
use crate::shape::{Cylinder, Shape, Sphere};
use crate::verify::harness::test_meshes::{lattice_cube, scene};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H39",
    title: "white furnace",
    construction: "glass, diamond, a mirror and water in glass in an environment of radiance 1, and a cube around the \
        camera, to 64 bounces",
    oracle: "reflectance and transmittance of each boundary add up to 1, so every pixel is 1, less the weights of \
        untraced rays",
    bound: "the derived f32 rounding bound, plus the weight of untraced rays in the worst pixel",
    unit: "of 10^-4",
    run: furnace,
    ..Case::SHAPES
}];

/// Largest deviation of a pixel from 1, in addition to the weight of rays not traced.
const BOUND: f64 = 1e-4;
/// Number of bounces that are traced.
const DEPTH: u32 = 64;
/// Throughput below which rays are not traced; a pixel has a few hundred such rays.
const CUTOFF: f32 = 1e-7;
/// Bound on rounding errors, in addition to the weight of rays not traced: in each bounce the Fresnel shares, the
/// throughputs and the sums over all rays are rounded to f32 three times, by 2^-24 at most, and a pixel's radiance is
/// summed up once a ray, of which there are about a hundred.
const ROUNDING: f64 = (3 * DEPTH + 128) as f64 / (1u64 << 24) as f64;
/// Approximate number of rays a pixel.
const FOLLOWED: u64 = 32;

/// Returns a smooth dielectric of index `ior` and `priority`; a mirror if there is no index.
fn material(ior: Option<f64>, priority: i32) -> Material {
    let model = MetallicRoughness {
        metallic: if ior.is_some() { 0.0 } else { 1.0 },
        roughness: 0.0,
        transmission: if ior.is_some() { 1.0 } else { 0.0 },
        ..MetallicRoughness::DEFAULT
    };
    Material {
        model: Model::MetallicRoughness(model),
        interior: ior.map(|ior| Medium {
            ior: Dispersion::Constant(ior),
            absorption: Absorption::NONE,
            priority,
            kind: MediumKind::Solid,
        }),
        ..Material::default()
    }
}

/// Returns a scene of glass, water, diamond and mirror objects in front of the default camera.
fn dielectric_scene() -> Scene {
    let mut scene = scene(vec![
        Geometry::Shape(Shape::Sphere(Sphere::UNIT)),
        Geometry::Shape(Shape::Cube),
        Geometry::Shape(Shape::Cylinder(Cylinder { capped: true })),
        Geometry::Mesh(lattice_cube(1)),
    ]);
    // Glass, water, diamond, mirror
    scene.materials = vec![
        material(Some(1.5), 1),
        material(Some(1.33), 0),
        material(Some(2.42), 2),
        material(None, 0),
    ];
    scene.background = Background::Uniform([1.0; 3]);
    // Place the objects
    let turn = |angle: f64| DQuat::from_axis_angle(DVec3::new(0.36, 0.48, 0.8), angle);
    let place = |size: f64, angle: f64, at: [f64; 3]| {
        DAffine3::from_scale_rotation_translation(DVec3::splat(size), turn(angle), DVec3::from_array(at))
    };
    let placed = [
        (0, 0, place(1.0, 0.0, [-1.2, 0.4, -6.0])),
        // Half of the water sphere overlaps the glass.
        (0, 1, place(0.7, 0.0, [-0.6, 0.3, -6.2])),
        (1, 0, place(0.5, 0.7, [0.9, 0.9, -5.5])),
        (2, 2, place(0.5, 1.9, [0.8, -0.9, -5.0])),
        (3, 1, place(1.1, 0.4, [-0.9, -1.6, -6.0])),
        (0, 3, place(0.4, 0.0, [1.9, -0.1, -6.5])),
    ];
    scene.instances = placed
        .into_iter()
        .filter_map(|(geometry, material, map)| Instance::new("", geometry, material, map).ok())
        .collect();
    scene
}

/// Returns a scene with a cube around the default camera, of an index below 1.2247: no direction is totally reflected
/// on all of its sides, so that no light is trapped.
fn scene_around_camera() -> Scene {
    let cube = DAffine3::from_scale_rotation_translation(
        DVec3::splat(2.0),
        DQuat::from_axis_angle(DVec3::new(0.36, 0.48, 0.8), 0.5),
        DVec3::new(-0.9, -0.8, -1.1),
    );
    Scene {
        materials: vec![material(Some(1.2), 0)],
        background: Background::Uniform([1.0; 3]),
        instances: Instance::new("", 0, 0, cube).into_iter().collect(),
        ..scene(vec![Geometry::Mesh(lattice_cube(1))])
    }
}

fn furnace(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let size = (trial.rays / (2 * FOLLOWED)).isqrt().max(4) as u32;
    let mut tally = Counts::default();
    // Render each scene
    for scene in [dielectric_scene(), scene_around_camera()] {
        let Some(rendering) = trial.render_image((&scene, &Camera::default()), size, (DEPTH, CUTOFF))? else {
            continue;
        };
        // Compare each pixel with 1, less the weight that was cut off
        let lost = rendering.ledger.max_lost_weight;
        for (number, pixel) in rendering.image.pixels.iter().enumerate() {
            let off = pixel.map(|channel| f64::from(channel) - 1.0);
            let worst = off.into_iter().map(f64::abs).fold(0.0, f64::max);
            tally.record_error((worst - lost).max(0.0) / BOUND);
            // Comparisons with NaN are false.
            let is_right = |x: f64| -lost - ROUNDING <= x && x <= ROUNDING;
            let is_wrong = !(off.into_iter().all(is_right));
            tally.count(Correctness::wrong_if(is_wrong), || {
                format!("pixel {number} of {size} x {size} is {pixel:?}, untraced rays weigh {lost:e}")
            });
        }
        // Count the secondary rays
        tally.count_secondary_rays(&rendering);
        if trial.draws_scenes() {
            tally.figure_data.draw(&scene);
        }
    }
    Ok(tally)
}
