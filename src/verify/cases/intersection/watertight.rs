//! Watertightness of closed meshes seen from inside: every ray must hit, whatever it is aimed at.

use glam::{DVec3, Vec3};

use crate::accel::AccelError;
use crate::mesh::Mesh;
use crate::numeric::{Ray, SplitMix64};
use crate::scene::Geometry;
use crate::verify::harness::test_meshes::{icosphere, lattice_cube, rings, scene};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, Watertightness, towards};

/// Values that all cases of closed meshes share.
const CLOSED_MESH: Case = Case {
    oracle: "the surface is closed and contains the origin: a miss is a leak",
    bound: "0 leaks",
    ..Case::TRIANGLES
};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H11",
        title: "vertex leaks",
        construction: "rays from inside four closed meshes, each aimed at a vertex",
        required: Watertightness::Vertices,
        run: |trial| closed_meshes(trial, at_vertex),
        ..CLOSED_MESH
    },
    Case {
        id: "H12",
        title: "edge leaks",
        construction: "rays from inside four closed meshes, each aimed at a point of an edge, not within 1/16 of its ends",
        required: Watertightness::Edges,
        run: |trial| closed_meshes(trial, at_edge),
        ..CLOSED_MESH
    },
    Case {
        id: "H13",
        title: "random leaks",
        construction: "rays in all directions from inside a sphere of radius 2 about points up to 10^6 from the origin",
        required: Watertightness::Edges,
        run: far_away,
        ..CLOSED_MESH
    },
    Case {
        id: "H14",
        title: "lattice-aligned rays",
        construction: "rays along the axes on whole and half coordinates in a cube of unit squares with whole corners",
        required: Watertightness::Vertices,
        run: along_the_lattice,
        ..CLOSED_MESH
    },
];

/// Number of squares along an edge of the lattice cube.
const LATTICE: u32 = 24;

/// Closed mesh and a ball inside it in which rays start.
struct Closed {
    mesh: Mesh,
    center: DVec3,
    radius: f64,
}

fn meshes() -> Vec<Closed> {
    let about_origin = |mesh| Closed {
        mesh,
        center: DVec3::ZERO,
        radius: 0.5,
    };
    let bumpy = |theta: f64, phi: f64| {
        1.0 + 0.05 * (20.0 * theta).sin() * (15.0 * phi).sin()
            + 0.02 * (70.0 * theta).sin() * (50.0 * phi).sin()
    };
    let middle = 0.5 * f64::from(LATTICE);
    vec![
        about_origin(rings(100, DVec3::ZERO, |_, _| 1.0)),
        about_origin(icosphere(5)),
        about_origin(rings(90, DVec3::ZERO, bumpy)),
        Closed {
            mesh: lattice_cube(LATTICE),
            center: DVec3::splat(middle),
            radius: 0.5 * middle,
        },
    ]
}

fn start(closed: &Closed, random: &mut SplitMix64) -> DVec3 {
    // Half the diagonal of the cube [-1, 1]³ is √3.
    closed.center + closed.radius / 3f64.sqrt() * random.in_cube()
}

fn at_vertex(closed: &Closed, random: &mut SplitMix64) -> Ray {
    let vertex = closed.mesh.positions[random.below(closed.mesh.positions.len())];
    towards(start(closed, random), Vec3::from(vertex).as_dvec3())
}

fn at_edge(closed: &Closed, random: &mut SplitMix64) -> Ray {
    let [a, b, _] = closed
        .mesh
        .corners_f64(random.below(closed.mesh.triangles.len()) as u32);
    // Stay away from the ends, which H11 tests
    towards(
        start(closed, random),
        a.lerp(b, random.within(1.0 / 16.0, 15.0 / 16.0)),
    )
}

fn closed_meshes(
    trial: &CaseRunner,
    aimed: impl Fn(&Closed, &mut SplitMix64) -> Ray + Sync,
) -> Result<Counts, AccelError> {
    let meshes = meshes();
    trial.over_parts(meshes.len(), &|number, trial| {
        let closed = &meshes[number];
        leaks(&trial, &closed.mesh, |random| aimed(closed, random))
    })
}

/// Counts rays that miss a closed mesh.
fn leaks(
    trial: &CaseRunner,
    mesh: &Mesh,
    ray: impl Fn(&mut SplitMix64) -> Ray + Sync,
) -> Result<Counts, AccelError> {
    let scene = scene(vec![Geometry::Mesh(mesh.clone())]);
    let engine = trial.engine(&scene)?;
    Ok(trial.nearest(&engine, &ray, &|_, hit, _| Correctness::wrong_if(hit.is_none())))
}

fn far_away(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let balls = [
        (100, DVec3::ZERO),
        (100, DVec3::new(1e3, 0.0, 0.0)),
        (100, DVec3::new(148_376.0, 1234.0, -223_423.0)),
        // Its edges are a few roundings of a coordinate long.
        (25, DVec3::new(1e6, -1e6, 1e6)),
    ];
    trial.over_parts(balls.len(), &|number, trial| {
        let (ring_count, center) = balls[number];
        let closed = Closed {
            mesh: rings(ring_count, center, |_, _| 2.0),
            center,
            radius: 1.0,
        };
        let ray = |random: &mut SplitMix64| {
            let origin = start(&closed, random).as_vec3();
            Ray::new(origin, random.direction().as_vec3())
        };
        leaks(&trial, &closed.mesh, ray)
    })
}

fn along_the_lattice(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let ray = |random: &mut SplitMix64| {
        // Whole coordinates go through vertices or along edges, half ones through the midpoints of diagonals or edges.
        let mut inner = || 0.5 * (1 + random.below(2 * LATTICE as usize - 1)) as f32;
        let origin = Vec3::new(inner(), inner(), inner());
        let axis = random.below(3);
        let mut direction = Vec3::ZERO;
        // The other components are zero of either sign.
        for k in 0..3 {
            direction[k] = random.choose(&[0.0, -0.0]);
        }
        direction[axis] = random.choose(&[1.0, -1.0]);
        Ray::new(origin, direction)
    };
    leaks(trial, &lattice_cube(LATTICE), ray)
}
