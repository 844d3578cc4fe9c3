//! Degenerate meshes: they are rejected by name before anything is built, repaired, or intersected without error.

use glam::{DVec3, Vec3};

use crate::accel::AccelError;
use crate::accel::brute::BruteAccel;
use crate::mesh::Mesh;
use crate::numeric::{Ray, SplitMix64};
use crate::scene::mesh_cleanup::{clear_non_finite_positions, drop_unusable};
use crate::scene::{Geometry, Instance, Scene};
use crate::verify::harness::test_meshes::{scene, soup};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, Watertightness, judge_against};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H16",
    title: "degenerate meshes",
    construction: "no area, repeated corners, NaN, infinity, 1e38, missing vertices: rejected, repaired as a loader \
        does, or valid",
    oracle: "the inserted fault is known; brute force for valid and repaired meshes",
    bound: "every fault rejected with the name of its item, nothing else rejected, no wrong hit or miss",
    required: Watertightness::Vertices,
    run: degenerate,
    ..Case::TRIANGLES
}];

/// Defect that can be injected into a scene.
struct Fault {
    /// Item that validation must name; empty if the scene is valid.
    place: &'static str,
    /// Flag for a defect that a loader repairs by dropping the triangle.
    is_mended: bool,
    inject: fn(&mut Scene, &mut SplitMix64),
}

const fn sound(inject: fn(&mut Scene, &mut SplitMix64)) -> Fault {
    Fault {
        place: "",
        is_mended: false,
        inject,
    }
}

const fn fatal(place: &'static str, inject: fn(&mut Scene, &mut SplitMix64)) -> Fault {
    Fault {
        place,
        is_mended: false,
        inject,
    }
}

const fn mended(inject: fn(&mut Scene, &mut SplitMix64)) -> Fault {
    Fault {
        place: "geometry 0",
        is_mended: true,
        inject,
    }
}

/// All defects; the first is none.
static FAULTS: [Fault; 19] = [
    sound(|_, _| ()),
    // Duplicate vertices and triangles, which are valid
    sound(|scene, random| {
        edit(scene, |positions, triangles| {
            let face = random.below(triangles.len());
            let twin = triangles[face].map(|corner| positions[corner as usize]);
            let first = positions.len() as u32;
            positions.extend(twin);
            triangles.push([first, first + 2, first + 1]);
            triangles.push(triangles[face]);
        });
    }),
    // A needle, as low as rounding allows
    sound(|scene, random| {
        edit(scene, |positions, triangles| {
            let [a, b, c] = random.choose(triangles);
            let middle = Vec3::from(positions[a as usize]).lerp(positions[b as usize].into(), 0.375);
            positions[c as usize] = [middle.x, middle.y.next_up(), middle.z.next_up()];
        });
    }),
    sound(|scene, _| {
        scaled(scene, 1e36);
        scene.normalise();
    }),
    sound(|scene, _| {
        scaled(scene, 1e-30);
        scene.normalise();
    }),
    mended(|scene, random| {
        edit(scene, |_, triangles| {
            let face = random.below(triangles.len());
            triangles[face][1] = triangles[face][0];
        });
    }),
    mended(|scene, random| {
        edit(scene, |positions, triangles| {
            let [a, b, c] = random.choose(triangles);
            // Collinear vertices, exactly, because sixteenths have few bits
            let sixteenths = |p: DVec3| (16.0 * p).round() / 16.0;
            let (start, step) = (sixteenths(random.in_cube()), sixteenths(random.in_cube()));
            for (corner, steps) in [(a, 0.0), (b, 1.0), (c, 3.0)] {
                positions[corner as usize] = (start + steps * step).as_vec3().to_array();
            }
        });
    }),
    mended(|scene, random| {
        edit(scene, |positions, triangles| {
            let [a, b, c] = random.choose(triangles);
            positions[b as usize] = positions[a as usize];
            positions[c as usize] = positions[a as usize];
        });
    }),
    mended(|scene, random| set_coordinate(scene, random, f32::NAN)),
    mended(|scene, random| set_coordinate(scene, random, f32::INFINITY)),
    mended(|scene, random| set_coordinate(scene, random, f32::NEG_INFINITY)),
    fatal("geometry 0", |scene, random| set_coordinate(scene, random, 1e38)),
    fatal("geometry 0", |scene, random| {
        set_coordinate(scene, random, f32::MIN)
    }),
    fatal("geometry 0", |scene, random| {
        edit(scene, |positions, triangles| {
            let (face, corner) = (random.below(triangles.len()), random.below(3));
            triangles[face][corner] = positions.len() as u32;
        });
    }),
    fatal("geometry 0", |scene, random| {
        edit(scene, |_, triangles| {
            let (face, corner) = (random.below(triangles.len()), random.below(3));
            triangles[face][corner] = u32::MAX - random.below(2) as u32;
        });
    }),
    fatal("geometry 0", |scene, random| {
        with_mesh(scene, |mesh| {
            let mut normals = vec![[0.0, 0.0, 1.0]; mesh.positions.len()];
            let broken = random.below(normals.len());
            normals[broken][random.below(3)] = f32::NAN;
            mesh.normals = Some(normals.into());
        });
    }),
    fatal("geometry 0", |scene, _| {
        with_mesh(scene, |mesh| {
            mesh.normals = Some(vec![[0.0, 0.0, 1.0]; mesh.positions.len() - 1].into());
        });
    }),
    fatal("instance 0", |scene, _| place(scene, [1, 0])),
    fatal("instance 0", |scene, _| place(scene, [0, u32::MAX])),
];

fn with_mesh(scene: &mut Scene, change: impl FnOnce(&mut Mesh)) {
    if let Some(Geometry::Mesh(mesh)) = scene.geometries.first_mut() {
        change(mesh);
    }
}

/// Changes the vertices and triangles of the mesh.
fn edit(scene: &mut Scene, change: impl FnOnce(&mut Vec<[f32; 3]>, &mut Vec<[u32; 3]>)) {
    with_mesh(scene, |mesh| {
        let mut positions = mesh.positions.to_vec();
        let mut triangles = mesh.triangles.to_vec();
        change(&mut positions, &mut triangles);
        mesh.positions = positions.into();
        mesh.triangles = triangles.into();
    });
}

fn scaled(scene: &mut Scene, factor: f32) {
    edit(scene, |positions, _| {
        positions.as_flattened_mut().iter_mut().for_each(|x| *x *= factor);
    });
}

fn set_coordinate(scene: &mut Scene, random: &mut SplitMix64, value: f32) {
    edit(scene, |positions, _| {
        let vertex = random.below(positions.len());
        positions[vertex][random.below(3)] = value;
    });
}

/// Makes the only instance refer to a geometry and a material.
fn place(scene: &mut Scene, [geometry, material]: [u32; 2]) {
    let map = glam::DAffine3::IDENTITY;
    scene.instances = Instance::new("", geometry, material, map).into_iter().collect();
}

/// Number of triangles of a mesh.
const TRIANGLES: u32 = 24;
/// Number of rays for each mesh while there are few meshes.
const RAYS_A_MESH: u64 = 64;
/// Largest number of meshes; beyond it, each mesh gets more rays.
const MAX_MESHES: u64 = 4096;

/// Returns random triangles that share no vertices.
fn triangles(random: &mut SplitMix64) -> Mesh {
    let mut triangle = || {
        let center = random.in_cube();
        [0; 3].map(|_| center + 0.5 * random.in_cube())
    };
    soup(&(0..TRIANGLES).map(|_| triangle()).collect::<Vec<_>>())
}

fn degenerate(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let mesh_count = trial.rays.div_ceil(RAYS_A_MESH).min(MAX_MESHES);
    trial.over_parts(mesh_count as usize, &|number, part| {
        let mut random = SplitMix64::new(0xde6e, number as u64);
        // Inject a defect
        let fault = &FAULTS[number % FAULTS.len()];
        let mut scene = scene(vec![Geometry::Mesh(triangles(&mut random))]);
        (fault.inject)(&mut scene, &mut random);
        // Check that validation reports it
        let mut tally = Counts::default();
        let is_sound = judge_refusal(trial, &scene, fault, &mut tally);
        // Repair the mesh as a loader does
        if fault.is_mended {
            with_mesh(&mut scene, |mesh| {
                drop_unusable(mesh);
                clear_non_finite_positions(mesh);
            });
        }
        // Trace no rays through a scene that was wrongly accepted.
        if is_sound || (fault.is_mended && judge_refusal(trial, &scene, &FAULTS[0], &mut tally)) {
            tally = tally.with(hits_of(&part, &scene)?);
        }
        Ok(tally)
    })
}

/// Counts whether validation rejects the scene as it should. Returns whether the scene is valid and accepted.
fn judge_refusal(trial: &CaseRunner, scene: &Scene, fault: &Fault, tally: &mut Counts) -> bool {
    let verdict = (trial.subject.formulas.validate)(scene);
    let is_right = match &verdict {
        Ok(()) => fault.place.is_empty(),
        Err(error) => !fault.place.is_empty() && error.item.starts_with(fault.place),
    };
    tally.count(Correctness::wrong_if(!is_right), || {
        let said = verdict
            .as_ref()
            .map_or_else(ToString::to_string, |()| "nothing".into());
        format!("validation reports {said} for a fault of {:?}", fault.place)
    });
    verdict.is_ok() && is_right
}

fn hits_of(trial: &CaseRunner, scene: &Scene) -> Result<Counts, AccelError> {
    let engine = trial.engine(scene)?;
    let brute = BruteAccel::new(scene);
    let Geometry::Mesh(mesh) = &scene.geometries[0] else {
        return Ok(Counts::default());
    };
    let bounds = mesh.bounds();
    let (center, reach) = (bounds.center(), 0.5 * bounds.extent().length());
    let ray = |random: &mut SplitMix64| {
        let origin = (center + 2.0 * reach * random.direction()).as_vec3();
        let [a, b, c] = mesh.corners_f64(random.below(mesh.triangles.len()) as u32);
        let target = (a + b + c) / 3.0 + 0.1 * reach * random.in_cube();
        Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
    };
    // Require finite hits that agree with brute force
    Ok(trial.nearest(&engine, &ray, &|ray, hit, tally| {
        if hit.is_some_and(|hit| !(hit.t.is_finite() && hit.u.is_finite() && hit.v.is_finite())) {
            tally.record_error(f64::INFINITY);
            return Correctness::Wrong;
        }
        judge_against(scene, ray, brute.nearest(ray), hit)
    }))
}
