//! Regression cases for leaks in closed surfaces that users of other renderers reported: rays at vertices, along shared
//! edges and on the lattice that a mesh was snapped to.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};

use super::runner::{CaseRunner, Correctness, Counts};
use super::test_meshes::{icosphere, mesh, scene};
use super::{Case, CaseKind, Watertightness};
use crate::accel::{AccelError, Hit};
use crate::mesh::Mesh;
use crate::numeric::{Ray, SplitMix64};
use crate::scene::Geometry;

pub(super) const CASES: &[Case] = &[
    Case {
        id: "H48a",
        title: "nested cylinders",
        construction: "Embree #174, #181: eleven nested closed cylinders, rays from between two at vertices of the \
            outer",
        oracle: "the cylinder around the origin of a ray is closed: a miss or a hit farther out is a leak",
        bound: "0 leaks",
        unit: "",
        kind: CaseKind::Triangles,
        required: Watertightness::Vertices,
        run: nested_cylinders,
    },
    Case {
        id: "H48b",
        title: "one shared edge",
        construction: "Mitsuba 3 #1149: pairs of triangles with nothing behind them, rays at their shared edge, down to 0.3 degrees",
        oracle: "both triangles face the ray, and it is aimed 1/16 inside the edge: a miss is a leak",
        bound: "0 leaks",
        unit: "",
        kind: CaseKind::Triangles,
        required: Watertightness::Edges,
        run: shared_edges,
    },
    Case {
        id: "H48f",
        title: "rays in planes of boxes",
        construction: "Embree #589: terrains on whole coordinates, rays along an axis through corners, edges and middles of squares",
        oracle: "the terrain has no holes, and its height there is known",
        bound: "0 leaks, the height to 2^-10",
        unit: "",
        kind: CaseKind::Triangles,
        required: Watertightness::Vertices,
        run: terrains,
    },
    Case {
        id: "H48k",
        title: "snapped to integers",
        construction: "tinybvh #168: a bumpy closed mesh with whole corners, rays on a grid of whole and half coordinates",
        oracle: "the surface is closed: rays from inside and from above its middle must hit it",
        bound: "0 leaks",
        unit: "",
        kind: CaseKind::Triangles,
        required: Watertightness::Vertices,
        run: snapped,
    },
];

/// Number of nested cylinders.
const CYLINDERS: usize = 11;
/// Number of sides of a cylinder.
const COLUMNS: u32 = 36;
/// Number of squares along a side.
const ROWS: u32 = 12;
/// Number of attempts to find an origin between two adjacent cylinders; the last is used even if it is elsewhere.
const TRIES: usize = 16;

/// Returns radius and half height of a cylinder, so that each encloses the one before.
fn measures(number: usize) -> [f64; 2] {
    let number = number as f64;
    [1.0 + number, 4.0 + number]
}

/// Returns a closed cylinder of that radius and half height about the y axis.
pub(super) fn cylinder([radius, half]: [f64; 2]) -> Mesh {
    let at = |row: u32, column: u32| {
        let (sin, cos) = (TAU * f64::from(column) / f64::from(COLUMNS)).sin_cos();
        let y = half * (2.0 * f64::from(row) / f64::from(ROWS) - 1.0);
        DVec3::new(radius * cos, y, radius * sin)
    };
    // Place the vertices of the side, then the centres of both caps
    let mut corners: Vec<DVec3> = (0..=ROWS)
        .flat_map(|row| (0..COLUMNS).map(move |column| at(row, column)))
        .collect();
    corners.extend([-half, half].map(|y| DVec3::new(0.0, y, 0.0)));
    let [bottom, top] = [corners.len() as u32 - 2, corners.len() as u32 - 1];
    let index = |row: u32, column: u32| row * COLUMNS + column % COLUMNS;
    let mut faces = Vec::new();
    // Triangulate caps and side
    for column in 0..COLUMNS {
        faces.push([bottom, index(0, column), index(0, column + 1)]);
        faces.push([top, index(ROWS, column + 1), index(ROWS, column)]);
        for row in 0..ROWS {
            let [a, b] = [index(row, column), index(row, column + 1)];
            let [c, d] = [index(row + 1, column), index(row + 1, column + 1)];
            faces.extend([[a, c, b], [b, c, d]]);
        }
    }
    mesh(&corners, faces)
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

/// Number of squares along a side of a terrain.
const SQUARES: usize = 32;
/// Height at which rays start above the terrain.
const ABOVE: f64 = 16.0;

/// Returns the pseudo-random height of a vertex, a whole number from 0 to 7.
fn height(x: usize, z: usize) -> f64 {
    (SplitMix64::new(0x589, (x * (SQUARES + 1) + z) as u64).below(8)) as f64
}

/// Returns a terrain over a square with `axis` up.
pub(super) fn terrain(axis: usize) -> Mesh {
    let count = SQUARES + 1;
    let corners: Vec<DVec3> = (0..count * count)
        .map(|number| {
            let (x, z) = (number / count, number % count);
            turned(axis, x as f64, height(x, z), z as f64)
        })
        .collect();
    let index = |x: usize, z: usize| (x * count + z) as u32;
    let squares = (0..SQUARES * SQUARES).map(|number| (number / SQUARES, number % SQUARES));
    let faces = squares.flat_map(|(x, z)| {
        let [a, b] = [index(x, z), index(x + 1, z)];
        let [c, d] = [index(x, z + 1), index(x + 1, z + 1)];
        [[a, c, b], [b, c, d]]
    });
    mesh(&corners, faces.collect())
}

/// Returns the point with `up` along `axis` and the other coordinates along the other two axes.
fn turned(axis: usize, x: f64, up: f64, z: f64) -> DVec3 {
    let mut p = DVec3::ZERO;
    (p[(axis + 2) % 3], p[axis], p[(axis + 1) % 3]) = (x, up, z);
    p
}

/// Returns the height of the terrain at whole and half coordinates; the centre of a square lies on the diagonal that
/// cuts it.
fn height_at(x: f64, z: f64) -> f64 {
    let ends = |v: f64| [v.floor() as usize, v.ceil() as usize];
    let ([x0, x1], [z0, z1]) = (ends(x), ends(z));
    // The mean over the diagonal from (x1, z0) to (x0, z1) is also that of an edge's ends or of a single vertex.
    0.5 * (height(x1, z0) + height(x0, z1))
}

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

    #[test]
    fn terrain_height_at_square_centre_is_mean_of_corners() {
        assert_eq!(height_at(3.0, 4.0), height(3, 4));
        assert_eq!(height_at(3.5, 4.0), 0.5 * (height(3, 4) + height(4, 4)));
        assert_eq!(height_at(3.5, 4.5), 0.5 * (height(4, 4) + height(3, 5)));
    }
}
