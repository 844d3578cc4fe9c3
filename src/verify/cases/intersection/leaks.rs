//! Regression cases for leaks in closed surfaces that users of other renderers reported: rays at vertices, along shared
//! edges and on the lattice that a mesh was snapped to.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};

use crate::accel::{AccelError, Hit};
use crate::mesh::Mesh;
use crate::numeric::{Ray, SplitMix64};
use crate::scene::Geometry;
use crate::verify::harness::cylinder_mesh::{COLUMNS, cylinder};
use crate::verify::harness::terrain_mesh::{SQUARES, height_at, terrain, turned};
use crate::verify::harness::test_meshes::{icosphere, mesh, scene};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, Watertightness};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H48a",
        title: "nested cylinders",
        construction: "Embree #174, #181: eleven nested closed cylinders, rays from between two at vertices of the \
            outer",
        oracle: "the cylinder around the origin of a ray is closed: a miss or a hit farther out is a leak",
        bound: "0 leaks",
        required: Watertightness::Vertices,
        run: nested_cylinders,
        ..Case::TRIANGLES
    },
    Case {
        id: "H48b",
        title: "one shared edge",
        construction: "Mitsuba 3 #1149: pairs of triangles with nothing behind them, rays at their shared edge, down to 0.3 degrees",
        oracle: "both triangles face the ray, and it is aimed 1/16 inside the edge: a miss is a leak",
        bound: "0 leaks",
        required: Watertightness::Edges,
        run: shared_edges,
        ..Case::TRIANGLES
    },
    Case {
        id: "H48f",
        title: "rays in planes of boxes",
        construction: "Embree #589: terrains on whole coordinates, rays along an axis through corners, edges and middles of squares",
        oracle: "the terrain has no holes, and its height there is known",
        bound: "0 leaks, the height to 2^-10",
        required: Watertightness::Vertices,
        run: terrains,
        ..Case::TRIANGLES
    },
    Case {
        id: "H48k",
        title: "snapped to integers",
        construction: "tinybvh #168: a bumpy closed mesh with whole corners, rays on a grid of whole and half coordinates",
        oracle: "the surface is closed: rays from inside and from above its middle must hit it",
        bound: "0 leaks",
        required: Watertightness::Vertices,
        run: snapped,
        ..Case::TRIANGLES
    },
];

/// Number of nested cylinders.
const CYLINDERS: usize = 11;
/// Number of attempts to find an origin between two adjacent cylinders; the last is used even if it is elsewhere.
const TRIES: usize = 16;

/// Returns radius and half height of a cylinder, so that each encloses the one before.
fn measures(number: usize) -> [f64; 2] {
    let number = number as f64;
    [1.0 + number, 4.0 + number]
}

/// Returns the innermost cylinder that certainly encloses a point, judged by the inscribed circle of its cross-section.
fn around(p: DVec3) -> Option<usize> {
    // Ratio of the radii of the inscribed and the circumscribed circle
    let inner = (0.5 * TAU / f64::from(COLUMNS)).cos();
    (0..CYLINDERS).find(|&number| {
        let [radius, half] = measures(number);
        p.x.hypot(p.z) < inner * radius && p.y.abs() < half
    })
}

fn nested_cylinders(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let meshes: Vec<Mesh> = (0..CYLINDERS).map(|number| cylinder(measures(number))).collect();
    let scene = scene(meshes.iter().cloned().map(Geometry::Mesh).collect());
    let engine = trial.engine(&scene)?;
    // Aim at a vertex from a point between two cylinders
    let ray = |random: &mut SplitMix64| {
        let number = random.below(CYLINDERS);
        let vertex = Vec3::from(meshes[number].positions[random.below(meshes[number].positions.len())]);
        let mut origin = 0.9 * vertex;
        for _ in 0..TRIES {
            let aside = random.within(0.0, 4.0) * random.in_cube();
            origin = (random.within(0.8, 1.0) * vertex.as_dvec3() + aside).as_vec3();
            // Accept a point between this cylinder and the next inner one
            if around(origin.as_dvec3()) == Some(number) {
                break;
            }
        }
        Ray::new(origin, vertex - origin)
    };
    // A miss, or a hit on a cylinder farther out, is a leak
    Ok(trial.nearest(&engine, &ray, &|ray, hit, _| {
        let Some(number) = around(ray.origin.as_dvec3()) else {
            return Correctness::Right;
        };
        Correctness::wrong_if(hit.is_none_or(|hit| hit.instance as usize > number))
    }))
}

/// Number of triangle pairs; they are so far apart that no ray reaches two.
const PAIRS: usize = 64;
/// Distance between neighbouring pairs of triangles.
const APART: f64 = 16.0;

/// Two triangles that share their first edge, with opposite order of its vertices, so that both have the same
/// orientation.
type Pair = [[DVec3; 3]; 2];

/// Returns a pair of triangles at its position in the grid; every other is a unit square with integer vertices, cut
/// along a diagonal.
fn pair(number: usize, random: &mut SplitMix64) -> Pair {
    let center = APART * DVec3::new((number % 8) as f64, (number / 8) as f64, 0.0);
    let [a, b, c, d] = if number.is_multiple_of(2) {
        [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), DVec3::Y, DVec3::X]
    } else {
        // Fold the pair backwards by up to half a radian, so that both fronts still face most rays.
        let fold = random.within(0.0, 0.5);
        let corner = |x: f64, y: f64| DVec3::new(x, y, -fold * x.abs());
        [
            corner(0.0, -1.0),
            corner(0.0, 1.0),
            corner(-random.within(0.2, 1.0), random.within(-1.0, 1.0)),
            corner(random.within(0.2, 1.0), random.within(-1.0, 1.0)),
        ]
    };
    let place = |p: DVec3| (center + p).as_vec3().as_dvec3();
    [[a, b, c].map(place), [b, a, d].map(place)]
}

/// Returns a ray at the shared edge of a pair that faces both fronts, along -z or at a random angle.
fn at_shared_edge(pairs: &[Pair], random: &mut SplitMix64) -> Ray {
    let [[a, b, c], [_, _, d]] = random.choose(pairs);
    // Choose a multiple of 1/32, where points on the diagonal of a unit square are exact
    let along = (2 + random.below(29)) as f64 / 32.0;
    let target = a.lerp(b, along);
    // Choose a direction at a random angle to either triangle
    let normals = [(b - a).cross(c - a), (a - b).cross(d - b)].map(DVec3::normalize_or_zero);
    let way = if random.below(2) == 0 {
        -DVec3::Z
    } else {
        let normal = random.choose(&normals);
        let in_plane = normal.cross(random.direction()).normalize_or_zero();
        // 0.3 degrees are 10^-2.28 radians.
        in_plane - 10f64.powf(random.within(-2.28, 0.0)) * normal
    };
    // Require an angle to both triangles so steep that rounding of the target cannot move it off them.
    let is_seen = normals.iter().all(|n| n.dot(way) < -1.0 / 256.0);
    let way = if is_seen { way } else { -DVec3::Z };
    // Start one or two lengths before the target
    let origin = (target - random.choose(&[1.0, 2.0]) * way).as_vec3();
    Ray {
        t_far: 2.0,
        ..Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
    }
}

fn shared_edges(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let mut random = SplitMix64::new(0x1149, 0);
    // Merge all pairs into one mesh
    let pairs: Vec<Pair> = (0..PAIRS).map(|number| pair(number, &mut random)).collect();
    let mut corners = Vec::new();
    let mut faces = Vec::new();
    for [[a, b, c], [_, _, d]] in &pairs {
        let first = corners.len() as u32;
        corners.extend([*a, *b, *c, *d]);
        faces.extend([[0, 1, 2], [1, 0, 3]].map(|face| face.map(|corner: u32| first + corner)));
    }
    let scene = scene(vec![Geometry::Mesh(mesh(&corners, faces))]);
    let engine = trial.engine(&scene)?;
    // A miss is a leak, as nothing lies behind
    Ok(
        trial.nearest(&engine, &|random| at_shared_edge(&pairs, random), &|_, hit, _| {
            Correctness::wrong_if(hit.is_none())
        }),
    )
}

/// Height at which rays start above the terrain.
const ABOVE: f64 = 16.0;

fn terrains(trial: &CaseRunner) -> Result<Counts, AccelError> {
    trial.over_parts(3, &|axis, trial| {
        let scene = scene(vec![Geometry::Mesh(terrain(axis))]);
        let engine = trial.engine(&scene)?;
        // Aim along the up axis, with signed zeros
        let ray = |random: &mut SplitMix64| {
            let mut inner = || 0.5 * (1 + random.below(2 * SQUARES - 1)) as f64;
            let origin = turned(axis, inner(), ABOVE, inner()).as_vec3();
            let mut zero = || random.choose(&[0.0, -0.0]);
            Ray::new(origin, turned(axis, zero(), -1.0, zero()).as_vec3())
        };
        // Compare the parameter with the known height
        let judge = |ray: &Ray, hit: Option<Hit>, _: &mut Counts| {
            let [x, z] = [(axis + 2) % 3, (axis + 1) % 3].map(|k| f64::from(ray.origin[k]));
            let t = ABOVE - height_at(x, z);
            Correctness::wrong_if(hit.is_none_or(|hit| !((f64::from(hit.t) - t).abs() <= 1.0 / 1024.0)))
        };
        Ok(trial.nearest(&engine, &ray, &judge))
    })
}

/// Radius of the snapped mesh in lattice units.
const RADIUS: f64 = 64.0;

/// Returns a bumpy closed mesh with integer vertices, at least 3/4 [`RADIUS`] from the origin.
fn snapped_mesh() -> Mesh {
    let mut mesh = icosphere(4);
    let snapped = mesh.positions.iter().map(|&p| {
        let p = Vec3::from(p).as_dvec3();
        let bumps = (9.0 * p.x).sin() * (8.0 * p.y).sin() * (7.0 * p.z).sin();
        let whole = (RADIUS * (1.0 + 0.2 * bumps) * p).round();
        whole.as_vec3().to_array()
    });
    mesh.positions = snapped.collect::<Vec<_>>().into();
    mesh
}

fn snapped(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let scene = scene(vec![Geometry::Mesh(snapped_mesh())]);
    let engine = trial.engine(&scene)?;
    let ray = |random: &mut SplitMix64| {
        // Start within 1/4 of the radius along each axis, so within 0.44 of it from the origin: well inside the surface
        let reach = RADIUS as usize / 2;
        let mut near = || 0.5 * (random.below(2 * reach + 1) as f32 - reach as f32);
        let mut origin = Vec3::new(near(), near(), near());
        let mut step = || random.choose(&[0.0, -0.0, 1.0, -1.0]);
        let mut direction = Vec3::new(step(), step(), step());
        // Aim half of the rays straight down from above
        if random.below(2) == 0 || direction == Vec3::ZERO {
            origin.y = 2.0 * RADIUS as f32;
            direction = Vec3::new(0.0, -1.0, -0.0);
        }
        Ray::new(origin, direction)
    };
    Ok(trial.nearest(&engine, &ray, &|ray, hit, _| {
        // From above, a hit beyond the centre is on the far side, so the near side leaks.
        let last = if ray.origin.y > RADIUS as f32 {
            ray.origin.y
        } else {
            f32::INFINITY
        };
        Correctness::wrong_if(hit.is_none_or(|hit| !(hit.t < last)))
    }))
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;
    use crate::verify::harness::cylinder_mesh::ROWS;

    #[test]
    fn cylinders_and_snapped_meshes_are_closed_without_degenerate_triangles() {
        for (mesh, count) in [
            (cylinder(measures(0)), 2 * COLUMNS * (ROWS + 1)),
            (snapped_mesh(), 20 * 256),
        ] {
            // Check that each edge occurs once in either direction
            let edges: HashSet<[u32; 2]> = mesh
                .triangles
                .iter()
                .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
                .collect();
            assert_eq!(mesh.triangles.len(), count as usize);
            assert_eq!(edges.len(), 3 * mesh.triangles.len());
            assert!(edges.iter().all(|&[a, b]| edges.contains(&[b, a])));
            // Check that no triangle is degenerate
            for face in 0..count {
                let [a, b, c] = mesh.corners_f64(face);
                assert!((b - a).cross(c - a) != DVec3::ZERO, "{face}");
            }
        }
        // Check that the origins are inside the snapped mesh
        let mesh = snapped_mesh();
        let nearest = mesh.positions.iter().map(|&p| Vec3::from(p).length());
        assert!(nearest.fold(f32::INFINITY, f32::min) > 0.75 * RADIUS as f32);
    }
}
