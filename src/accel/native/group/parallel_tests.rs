//! Tests of rays with a common direction.

use crate::accel::native::build::build_tree;
use crate::accel::native::testing::{BEST, RandomNumbers, baked, brute_force};
use crate::accel::{Accel, Coherence, LANES, RayPacket};
use crate::mesh::simd::{Scalar, SimdKernel};
use crate::mesh::{Mesh, bumpy_sphere};
use crate::numeric::Ray;
use glam::Vec3;

use super::tests::{SurfaceRayCounts, count_blocked, mesh_of, soup};
use super::*;

/// Returns directions along axes, diagonals and planes, nearly so, and at random; of any length.
fn directions(random: &mut RandomNumbers) -> Vec<Vec3> {
    let mut directions = vec![
        Vec3::X,
        Vec3::NEG_X,
        Vec3::Y,
        Vec3::NEG_Y,
        Vec3::Z,
        Vec3::NEG_Z,
        Vec3::new(1.0, 1.0, 1.0),
        Vec3::new(-1.0, 1.0, -1.0),
        Vec3::new(0.0, 3.0, -3.0),
        Vec3::new(1.0, 1e-7, -1e-20),
        Vec3::new(1e-40, -1.0, 1e-30),
        Vec3::new(0.577, 0.577f32.next_up(), -0.577f32.next_down()),
        Vec3::new(1e-12, 2e-12, -3e-12),
        Vec3::new(-5e9, 1e9, 4e9),
    ];
    directions.extend((0..6).map(|_| random.vector()));
    directions
}

/// Returns packets of rays in a direction from random points in a cube, in no order; a few have another direction or an
/// interval, or are inactive.
fn along(direction: Vec3, cube: (Vec3, f32), count: usize, random: &mut RandomNumbers) -> Vec<RayPacket> {
    let mut packets = vec![RayPacket::EMPTY; count];
    let (centre, size) = cube;
    for packet in &mut packets {
        for lane in 0..LANES {
            let stray = random.next() < 0.02;
            let origin = centre + size * random.vector();
            let mut ray = Ray::new(origin, if stray { random.vector() } else { direction });
            if random.next() < 0.2 {
                ray.t_near = random.next() / ray.direction.length();
                ray.t_far = ray.t_near + 2.0 * random.next() / ray.direction.length();
            }
            if random.next() < 0.9 {
                packet.set(lane, &ray);
            }
        }
    }
    packets
}

#[test]
fn blocked_rays_along_a_direction_are_those_of_brute_force() {
    let mut random = RandomNumbers(7);
    let mut counts = [0; 2];
    for mesh in [bumpy_sphere(3000), soup(1500, 5)] {
        let scene = baked(mesh);
        let brute = brute_force(&scene);
        let tree = build_tree(&[mesh_of(&scene)]).unwrap();
        for direction in directions(&mut random) {
            for size in [1, 4, 16, 70] {
                // Start nearby, all over the scene, and far outside
                for width in [0.3, 1.5, 8.0] {
                    let cube = (random.vector(), width);
                    let mut expected = along(direction, cube, size, &mut random);
                    let mut actual = expected.clone();
                    brute.occluded(&mut expected, Coherence::Coherent);
                    occluded(BEST, tree.view(), &mut actual, RayEnd::Direction(direction));
                    count_blocked(&expected, &actual, &mut counts);
                }
            }
        }
    }
    assert!(counts.iter().all(|&count| count > 30_000), "{counts:?}");
}

#[test]
fn instruction_sets_give_the_same_bits_along_a_direction() {
    let mut random = RandomNumbers(3);
    let tree = build_tree(&[&soup(3000, 8)]).unwrap();
    for direction in directions(&mut random) {
        for size in [4, 64] {
            let mut a = along(direction, (Vec3::ZERO, 1.2), size, &mut random);
            let mut b = a.clone();
            // Trace them without SIMD, and with the best instruction set
            let query = AnyToLight(CommonDirection(direction));
            GroupKernel::new(tree.view(), &mut a, query, &mut Scratch::new()).run(Scalar);
            occluded(BEST, tree.view(), &mut b, RayEnd::Direction(direction));
            for (a, b) in a.iter().zip(&b) {
                for lane in 0..LANES {
                    assert_eq!(a.t_far[lane].to_bits(), b.t_far[lane].to_bits());
                }
            }
        }
    }
}

/// Returns the number of rays in a direction from inside a closed mesh about `centre` that hit nothing, although they are
/// aimed at vertices, or at points on edges; about as many for each group size.
fn leaks_along(mesh: &Mesh, centre: Vec3, direction: Vec3, ray_count: usize, at_edges: bool) -> usize {
    let tree = build_tree(&[mesh]).unwrap();
    let mut random = RandomNumbers(17);
    let unit = direction.normalize();
    let mut misses = 0;
    let triangles: &[[u32; 3]] = &mesh.triangles;
    for size in [1, 4, 16, 64] {
        let (mut traced, mut first) = (0, 0);
        while traced < ray_count / 4 {
            // Aim at vertices in the order of triangles, which is that of rows of the mesh
            let mut packets = vec![RayPacket::EMPTY; size];
            for index in 0..size * LANES {
                let [a, b, _] = triangles[(first + index) % triangles.len()]
                    .map(|v| Vec3::from(mesh.positions[v as usize]));
                let aim = if at_edges { a + random.next() * (b - a) } else { a };
                // Start where the ray is closest to the centre, if that is well inside; along an axis the origin has
                // exactly the vertex's other coordinates
                let reach = (aim - centre).dot(unit);
                if reach > 0.7 {
                    let ray = Ray::new(aim - reach * unit, direction);
                    packets[index / LANES].set(index % LANES, &ray);
                    traced += 1;
                }
            }
            first += 7919 * LANES;
            occluded(BEST, tree.view(), &mut packets, RayEnd::Direction(direction));
            for packet in &packets {
                let is_free = |&lane: &usize| packet.is_active(lane) && !packet.is_blocked(lane);
                misses += (0..LANES).filter(is_free).count();
            }
        }
    }
    misses
}

#[test]
fn nothing_leaks_along_a_direction() {
    for offset in [Vec3::ZERO, Vec3::new(100.0, 37.0, -55.0)] {
        let mut mesh = bumpy_sphere(500_000);
        let positions: Vec<_> = mesh
            .positions
            .iter()
            .map(|&p| (Vec3::from(p) + offset).to_array())
            .collect();
        mesh.positions = positions.into();
        for direction in [Vec3::Y, Vec3::new(-1.0, 1e-7, 0.0), Vec3::new(0.3, -0.8, 0.52)] {
            for at_edges in [false, true] {
                assert_eq!(
                    leaks_along(&mesh, offset, direction, 400_000, at_edges),
                    0,
                    "{offset} {direction} {at_edges}"
                );
            }
        }
    }
}

#[test]
fn rays_from_surfaces_along_a_direction_are_not_blocked_by_their_triangle() {
    let ends = directions(&mut RandomNumbers(13))
        .into_iter()
        .map(RayEnd::Direction);
    let counts = SurfaceRayCounts::of(ends, false);
    let SurfaceRayCounts { all, free, different } = counts;
    println!("{different} of {all}, {free} free");
    assert!(all > 500_000 && free > all / 2, "{free} of {all}");
    assert!(different <= all / 50_000, "{different} of {all}");
}

#[test]
fn rays_along_a_direction_are_blocked_by_a_triangle_a_rounding_error_before_their_start() {
    let ends = directions(&mut RandomNumbers(13))
        .into_iter()
        .map(RayEnd::Direction);
    let counts = SurfaceRayCounts::of(ends, true);
    let SurfaceRayCounts { all, free, different } = counts;
    assert!(all > 500_000 && free == 0, "{free} of {all}");
    assert!(different <= all / 100_000, "{different} of {all}");
}
