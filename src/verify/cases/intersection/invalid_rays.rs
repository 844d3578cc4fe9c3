//! Invalid rays of arbitrary bits: a ray with NaN, infinite or zero direction must hit nothing, quickly, and must not
//! affect other rays in its packet.

use glam::{DVec3, Vec3};

use crate::accel::{AccelError, Hit};
use crate::numeric::{Ray, SplitMix64};
use crate::scene::{Geometry, Scene};
use crate::shape::{Shape, Sphere};
use crate::verify::harness::reference::Reference;
use crate::verify::harness::test_meshes::{icosphere, scene};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, judge_against};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H18",
    title: "invalid rays",
    construction: "rays of NaN, infinite, zero, denormal and huge numbers, mixed with valid ones in the same packets",
    oracle: "an invalid ray misses; brute force for the others",
    bound: "no hit for an invalid ray; for the others as in the backend comparison",
    run: any_bits,
    ..Case::TRIANGLES
}];

/// Special values of a coordinate: NaN, infinite, huge, zero and denormal.
const ODD: [f32; 12] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    2e18,
    -2e18,
    0.0,
    -0.0,
    1e-45,
    -1e-45,
    f32::MIN_POSITIVE,
];

fn any_bits(trial: &CaseRunner) -> Result<Counts, AccelError> {
    // Build a scene of a mesh and a sphere
    let ball = Sphere {
        center: DVec3::new(2.5, 0.0, 0.0),
        radius: 1.0,
    };
    let scene = scene(vec![
        Geometry::Mesh(icosphere(2)),
        Geometry::Shape(Shape::Sphere(ball)),
    ]);
    let engine = trial.engine(&scene)?;
    let reference = Reference::new(&scene);
    // Judge valid rays against brute force
    Ok(trial.nearest(&engine, &odd_ray, &|ray, hit, _| {
        judge(&scene, &reference, ray, hit)
    }))
}

/// Returns a valid ray for about half of the calls, else a ray with one or more special values.
fn odd_ray(random: &mut SplitMix64) -> Ray {
    let origin = 4.0 * random.in_cube();
    let direction = 2.0 * random.in_cube() - origin;
    let mut ray = Ray::new(origin.as_vec3(), direction.as_vec3());
    if random.below(2) == 0 {
        return ray;
    }
    // Replace one to three numbers by special values
    for _ in 0..1 + random.below(3) {
        let odd = random.choose(&ODD);
        let axis = random.below(3);
        match random.below(4) {
            0 => ray.origin[axis] = odd,
            1 => ray.direction[axis] = odd,
            2 => ray.t_near = odd,
            _ => ray.t_far = odd,
        }
    }
    // Occasionally replace the whole direction
    if random.below(16) == 0 {
        ray.direction = random.choose(&[Vec3::ZERO, -Vec3::ZERO, Vec3::NAN]);
    }
    ray
}

fn judge(scene: &Scene, reference: &Reference, ray: &Ray, hit: Option<Hit>) -> Correctness {
    // An untraceable ray must not hit anything
    if !ray.is_traceable() {
        return Correctness::wrong_if(hit.is_some());
    }
    judge_against(scene, ray, reference.nearest(ray), hit)
}
