//! Triangles that are hardly there: slivers seen edge-on, and triangles of any bits at all.
//!
//! Embree's robust test reports slivers at parameters far beyond its own error bounds now and then; only a path with
//! another test is required to do better.

use glam::{DVec3, Vec3};

use super::exact::{self, Crossing};
use super::meshes::{mesh, scene};
use super::trial::{Answer, Tally, Trial};
use super::{Asks, Case, Closes};
use crate::accel::brute::BruteAccel;
use crate::accel::hit_compare::{HitComparison, compare};
use crate::accel::{AccelError, Hit};
use crate::mesh::Mesh;
use crate::numeric::{Ray, SplitMix64};
use crate::scene::{Geometry, Material, Scene};

pub(super) const CASES: &[Case] = &[
    Case {
        id: "H15",
        title: "slivers",
        construction: "triangles 10^3 to 10^9 times as long as high, and rays at down to 0.01 degrees to their planes",
        oracle: "exact signs of the edges, the parameter to 100 bits",
        bound: "no hit or miss beyond the derived bounds on f32, which grow as triangles turn edge-on",
        unit: "ulp of t",
        asks: Asks::Triangles,
        required: Closes::Vertices,
        run: slivers,
    },
    Case {
        id: "H17",
        title: "garbage meshes",
        construction: "meshes whose corners are random bits, as many of each exponent, as far as they pass the checks",
        oracle: "brute force, and where it differs the exact crossings; within the derived bounds on f32 a tie",
        bound: "no wrong hit or miss, no parameter that is no number",
        unit: "",
        asks: Asks::Triangles,
        required: Closes::Vertices,
        run: garbage,
    },
];

/// Slivers of a scene.
const SLIVERS: usize = 128;

/// A sliver in the cube [-1, 1]³.
fn sliver(random: &mut SplitMix64) -> [DVec3; 3] {
    let a = random.in_cube();
    let along = random.within(0.3, 1.0) * random.direction();
    let across = along.cross(random.direction()).normalize_or_zero();
    let height = along.length() * 10f64.powf(random.within(-9.0, -3.0));
    let third = a + random.unit() * along + height * across;
    [a, a + along, third].map(|p| p.as_vec3().as_dvec3())
}

/// A ray at one of the triangles, close to its plane.
fn grazing(triangles: &[[DVec3; 3]], random: &mut SplitMix64) -> Ray {
    let [a, b, c] = random.pick(triangles);
    // Within it or a little beside it.
    let (u, v) = (random.within(-0.1, 1.1), random.within(-0.1, 1.1));
    let (u, v) = if u + v > 1.1 { (1.0 - u, 1.0 - v) } else { (u, v) };
    let target = a + u * (b - a) + v * (c - a);
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let in_plane = normal.cross(random.direction()).normalize_or_zero();
    // 0.01 degrees are 1.7e-4.
    let slope = 10f64.powf(random.within(-3.76, 0.0)) * random.pick(&[1.0, -1.0]);
    let way = in_plane + slope * normal;
    let origin = (target - random.within(0.5, 3.0) * way).as_vec3();
    Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
}

fn slivers(trial: &Trial) -> Result<Tally, AccelError> {
    let mut random = SplitMix64::new(0x5117, 0);
    let triangles: Vec<[DVec3; 3]> = (0..SLIVERS).map(|_| sliver(&mut random)).collect();
    let corners: Vec<DVec3> = triangles.iter().flatten().copied().collect();
    let faces = (0..SLIVERS as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]);
    let scene = scene(vec![Geometry::Mesh(mesh(&corners, faces.collect()))]);
    let engine = trial.engine(&scene)?;
    let needles: Vec<Needle> = triangles.iter().map(Needle::of).collect();
    Ok(trial.nearest(
        &engine,
        &|random| grazing(&triangles, random),
        &|ray, hit, tally| {
            let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
            let exact = exact_nearest(&triangles, ray, |number| !needles[number].is_missed(o, d));
            if let (Some((first, t)), Some(hit)) = (&exact, hit)
                && first.primitive == hit.primitive
            {
                let ulp = f64::from(first.t.next_up()) - f64::from(first.t);
                tally.note((f64::from(hit.t) - t).abs() / ulp);
            }
            compared(&scene, ray, exact.map(|(first, _)| first), hit)
        },
    ))
}

/// A sliver as a line along its first edge, which all of it is close to.
struct Needle {
    a: DVec3,
    along: DVec3,
    /// How far from the line it reaches at most.
    height: f64,
}

impl Needle {
    fn of([a, b, c]: &[DVec3; 3]) -> Needle {
        let (along, up) = (b - a, c - a);
        let height = up.cross(along).length() / along.length();
        Needle {
            a: *a,
            along,
            // With what the cross product cancels.
            height: height + NEEDLE_ERROR * up.length(),
        }
    }

    /// Whether the line `o + t d` surely passes beside it: farther from its line than it reaches.
    fn is_missed(&self, o: DVec3, d: DVec3) -> bool {
        let w = self.a - o;
        let apart = d.dot(w.cross(self.along)).abs();
        let across = d.cross(self.along);
        // The largest of three coordinates is at least 1 / √3 of a length.
        let size = 6.0 * w.abs().max_element() * self.along.abs().max_element() * d.abs().max_element();
        let rest = apart - NEEDLE_ERROR * size;
        rest > 0.0 && rest * rest > self.height * self.height * across.length_squared() * (1.0 + NEEDLE_ERROR)
    }
}

/// Roundings of a triple product, of 2^-53 of its size each: 3 differences, 3 products, 5 sums, and as many for what it
/// is compared with.
const NEEDLE_ERROR: f64 = 16.0 * f64::EPSILON;

/// The first triangle that the ray meets, and where, among those whose numbers `is_near` admits.
pub(super) fn exact_nearest(
    triangles: &[[DVec3; 3]],
    ray: &Ray,
    is_near: impl Fn(usize) -> bool,
) -> Option<(Hit, f64)> {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let meets = |corners: &[DVec3; 3]| {
        matches!(
            exact::crossing(o, d, *corners),
            Crossing::Through | Crossing::Touching
        )
    };
    let near = triangles
        .iter()
        .enumerate()
        .filter(|&(number, _)| is_near(number));
    let met = near.filter(|(_, corners)| meets(corners));
    let at = met.map(|(number, corners)| (number, exact::parameter(o, d, *corners)));
    let ahead = at.filter(|(_, t)| t.nearest() >= 0.0);
    let (number, t) = ahead.reduce(|a, b| if b.1 < a.1 { b } else { a })?;
    let hit = Hit {
        instance: 0,
        primitive: number as u32,
        t: t.nearest() as f32,
        u: 0.0,
        v: 0.0,
    };
    Some((hit, t.nearest()))
}

/// What the comparison of backends says of an answer.
pub(super) fn compared(scene: &Scene, ray: &Ray, exact: Option<Hit>, hit: Option<Hit>) -> Answer {
    match compare(scene, ray, exact, hit) {
        HitComparison::Same => Answer::Right,
        HitComparison::Tie => Answer::Tie,
        HitComparison::Wrong => Answer::Wrong,
    }
}

/// Rays for each mesh of garbage, where there are few.
const RAYS_A_MESH: u64 = 64;
/// Meshes of garbage at most: more rays go to each.
const MAX_MESHES: u64 = 10_000;

fn garbage(trial: &Trial) -> Result<Tally, AccelError> {
    let mesh_count = trial.rays.div_ceil(RAYS_A_MESH).min(MAX_MESHES);
    trial.over_parts(mesh_count as usize, &|number, part| {
        let mut random = SplitMix64::new(0x6a7ba6e, number as u64);
        let mut scene = Scene {
            materials: vec![Material::default()],
            ..scene(vec![Geometry::Mesh(any_mesh(&mut random))])
        };
        if scene.validate().is_err() {
            // Named and refused before anything is built.
            return Ok(Tally::default());
        }
        scene.normalise();
        garbage_of(&part, &scene)
    })
}

/// A number of any exponent and sign that passes the checks of a scene's vertices.
fn any_number(random: &mut SplitMix64) -> f32 {
    loop {
        let x = f32::from_bits(random.bits() as u32);
        if x.abs() < Ray::LIMIT {
            return x;
        }
    }
}

fn any_mesh(random: &mut SplitMix64) -> Mesh {
    let count = 1 + random.below(30) as u32;
    // Some of one size, some of all sizes together.
    let size = any_number(random).abs();
    let is_even = random.below(2) == 0;
    let corners = (0..3 * count).map(|_| {
        let mut number = || {
            if is_even {
                f64::from(size) * random.within(-1.0, 1.0)
            } else {
                any_number(random).into()
            }
        };
        DVec3::new(number(), number(), number())
    });
    let corners: Vec<DVec3> = corners.collect();
    mesh(
        &corners,
        (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
    )
}

/// Reach of a ray at a triangle below which the sums of a parameter lose digits: 2^-34, as a distance times an edge
/// function is of its cube, and that times 2^-24 is just normal.
const SMALLEST: f32 = 1.0 / (1u64 << 34) as f32;

fn garbage_of(trial: &Trial, scene: &Scene) -> Result<Tally, AccelError> {
    let engine = trial.engine(scene)?;
    let brute = BruteAccel::new(scene);
    let Geometry::Mesh(mesh) = &scene.geometries[0] else {
        return Ok(Tally::default());
    };
    let triangles: Vec<[DVec3; 3]> = (0..mesh.triangles.len() as u32)
        .map(|number| mesh.corners_f64(number))
        .collect();
    let ray = |random: &mut SplitMix64| {
        let [a, b, c] = random.pick(&triangles);
        let (u, v) = (0.5 * random.unit(), 0.5 * random.unit());
        let target = a + u * (b - a) + v * (c - a);
        let reach = (b - a).length().max((c - a).length());
        let origin: Vec3 = (target + reach * random.direction()).as_vec3();
        Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
    };
    Ok(trial.nearest(&engine, &ray, &|ray, hit, _| {
        if !ray.is_traceable() {
            return Answer::wrong_if(hit.is_some());
        }
        match compared(scene, ray, brute.nearest(ray), hit) {
            // Products of what is so small underflow in f32, which the bounds leave out.
            Answer::Wrong if ray.direction.abs().max_element() < SMALLEST => Answer::Tie,
            // Brute force rounds as well.
            Answer::Wrong => {
                let exact = exact_nearest(&triangles, ray, |_| true);
                compared(scene, ray, exact.map(|(hit, _)| hit), hit)
            }
            answer => answer,
        }
    }))
}
