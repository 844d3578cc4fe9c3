//! Tests of the group traversal against brute force, across instruction sets, and for leaks.

use crate::accel::native::build::build_tree;
use crate::accel::native::single;
use crate::accel::native::testing::{BEST, RandomNumbers, baked, brute_force};
use crate::accel::{Accel, Coherence, LANES, Query, RayPacket};
use crate::mesh::simd::{Scalar, SimdKernel, dispatch};
use crate::mesh::{Mesh, bumpy_sphere};
use crate::numeric::{Ray, spawn_point, triangle_spawn_error};
use crate::scene::{Geometry, Scene};
use glam::Vec3;

use super::*;

pub(super) fn mesh_of(scene: &Scene) -> &Mesh {
    let Geometry::Mesh(mesh) = &scene.geometries[0] else {
        unreachable!()
    };
    mesh
}

/// Returns a mesh of triangles of sizes from 0.002 to 1.
pub(super) fn soup(count: usize, seed: u64) -> Mesh {
    let mut random = RandomNumbers(seed);
    let mut positions = Vec::new();
    for _ in 0..count {
        let (centre, size) = (random.vector(), 0.002f32.powf(random.next()));
        for _ in 0..3 {
            positions.push((centre + size * random.vector()).to_array());
        }
    }
    Mesh {
        triangles: (0..count as u32)
            .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
            .collect::<Vec<_>>()
            .into(),
        positions: positions.into(),
        ..Mesh::default()
    }
}

/// Returns packets of rays from `origin` in a cone of the given width about a point near the world's origin, in no
/// order; a few lanes are inactive or point anywhere.
fn from_origin(origin: Vec3, count: usize, width: f32, random: &mut RandomNumbers) -> Vec<RayPacket> {
    let mut packets = vec![RayPacket::EMPTY; count];
    let axis = 0.3 * random.vector() - origin;
    for packet in &mut packets {
        for lane in 0..LANES {
            let stray = random.next() < 0.02;
            let direction = if stray {
                random.vector()
            } else {
                axis + width * random.vector()
            };
            let mut ray = Ray::new(origin, direction * 2f32.powf(8.0 * random.next() - 4.0));
            if random.next() < 0.3 {
                ray.t_near = random.next() / ray.direction.length();
                ray.t_far = ray.t_near + 3.0 * random.next() / ray.direction.length();
            }
            if random.next() < 0.9 {
                packet.set(lane, &ray);
            }
        }
    }
    packets
}

/// Returns packets of rays from random points near a point to `target`.
fn to_target(target: Vec3, count: usize, random: &mut RandomNumbers) -> Vec<RayPacket> {
    let mut packets = vec![RayPacket::EMPTY; count];
    let centre = random.vector();
    for packet in &mut packets {
        for lane in 0..LANES {
            let origin = centre + 0.3 * random.vector();
            let mut ray = Ray::new(origin, target - origin);
            ray.t_far = 1.0;
            if random.next() < 0.2 {
                ray.t_near = 0.3 * random.next();
                ray.t_far = ray.t_near + (1.0 - ray.t_near) * random.next();
            }
            if random.next() < 0.9 {
                packet.set(lane, &ray);
            }
        }
    }
    packets
}

/// Asserts that the same lanes are blocked, and counts those that are not and those that are.
pub(super) fn count_blocked(expected: &[RayPacket], actual: &[RayPacket], counts: &mut [u32; 2]) {
    for (a, b) in expected.iter().zip(actual) {
        for lane in 0..LANES {
            assert_eq!(a.is_blocked(lane), b.is_blocked(lane), "{:?}", b.ray(lane));
            counts[usize::from(b.is_blocked(lane))] += 1;
        }
    }
}

#[test]
fn nearest_hits_are_those_of_brute_force() {
    let mut random = RandomNumbers(11);
    let mut hit_count = 0;
    for (mesh, seed) in [(bumpy_sphere(3000), 1), (soup(1500, 5), 2)] {
        random.0 += seed;
        let scene = baked(mesh);
        let brute = brute_force(&scene);
        let mesh = mesh_of(&scene);
        let tree = build_tree(&[mesh]).unwrap();
        // Compare cones of all sizes and widths
        for size in [1, 4, 16, 64, 70] {
            for width in [0.05, 0.4, 2.0] {
                let origin = random.vector() * if width < 0.1 { 4.0 } else { 1.5 };
                let mut expected = from_origin(origin, size, width, &mut random);
                let mut actual = expected.clone();
                brute.intersect(&mut expected, Coherence::Coherent);
                intersect(BEST, tree.view(), &mut actual, origin);
                for (a, b) in expected.iter().zip(&actual) {
                    for lane in 0..LANES {
                        let (Some(a), Some(b)) = (a.hit(lane), b.hit(lane)) else {
                            assert_eq!(a.hit(lane), b.hit(lane));
                            assert_eq!(a.t_far[lane], b.t_far[lane]);
                            continue;
                        };
                        hit_count += 1;
                        assert_eq!(a.primitive, b.primitive, "{a:?} {b:?}");
                        assert!((a.t - b.t).abs() <= 2e-5 * a.t, "{a:?} {b:?}");
                    }
                }
            }
        }
    }
    assert!(hit_count > 5000, "{hit_count}");
}

#[test]
fn of_coincident_triangles_that_of_the_lowest_number_is_hit() {
    // Repeat all triangles under higher numbers
    let count = 300;
    let mut mesh = soup(count, 4);
    mesh.triangles = mesh.triangles.repeat(3).into();
    let tree = build_tree(&[&mesh]).unwrap();
    let mut random = RandomNumbers(9);
    let mut hit_count = 0;
    for size in [1, 64] {
        for width in [0.01, 0.5] {
            let origin = random.vector() * 2.0;
            let mut packets = from_origin(origin, size, width, &mut random);
            intersect(BEST, tree.view(), &mut packets, origin);
            let hits = packets
                .iter()
                .flat_map(|packet| (0..LANES).filter_map(|lane| packet.hit(lane)));
            for hit in hits {
                hit_count += 1;
                assert!((hit.primitive as usize) < count, "{hit:?}");
            }
        }
    }
    assert!(hit_count > 500, "{hit_count}");
}

#[test]
fn blocked_rays_are_those_of_brute_force() {
    let mut random = RandomNumbers(7);
    let mut counts = [0; 2];
    for mesh in [bumpy_sphere(3000), soup(1500, 5)] {
        let scene = baked(mesh);
        let brute = brute_force(&scene);
        let tree = build_tree(&[mesh_of(&scene)]).unwrap();
        for size in [1, 4, 16, 64, 70] {
            for turn in 0..4 {
                let point = random.vector() * [1.0, 3.0][turn % 2];
                let mut expected = to_target(point, size, &mut random);
                let mut actual = expected.clone();
                brute.occluded(&mut expected, Coherence::Coherent);
                occluded(BEST, tree.view(), &mut actual, RayEnd::Point(point));
                count_blocked(&expected, &actual, &mut counts);
            }
        }
    }
    assert!(counts.iter().all(|&count| count > 3000), "{counts:?}");
}

#[test]
fn instruction_sets_give_the_same_bits() {
    let mut random = RandomNumbers(3);
    let mesh = soup(3000, 8);
    let tree = build_tree(&[&mesh]).unwrap();
    for size in [1, 4, 16, 64] {
        for turn in 0..2 {
            let point = random.vector() * 2.0;
            let packets = match turn {
                0 => from_origin(point, size, 0.5, &mut random),
                _ => to_target(point, size, &mut random),
            };
            // Trace them without SIMD, with AVX2, and with the best instruction set
            let mut copies = [packets.clone(), packets.clone(), packets];
            let mut scratch = Scratch::new();
            let [scalar, eight, best] = &mut copies;
            match turn {
                0 => {
                    let query = NearestFromOrigin(point);
                    GroupKernel::new(tree.view(), scalar, query, &mut scratch).run(Scalar);
                    dispatch(GroupKernel::new(tree.view(), eight, query, &mut scratch));
                    intersect(BEST, tree.view(), best, point);
                }
                _ => {
                    let query = AnyToLight(CommonEnd::Target(point));
                    GroupKernel::new(tree.view(), scalar, query, &mut scratch).run(Scalar);
                    dispatch(GroupKernel::new(tree.view(), eight, query, &mut scratch));
                    occluded(BEST, tree.view(), best, RayEnd::Point(point));
                }
            }
            // Compare the bits
            let [scalar, others @ ..] = &copies;
            for (a, b) in others.iter().flat_map(|other| scalar.iter().zip(other)) {
                for lane in 0..LANES {
                    let bits = |p: &RayPacket| {
                        p.hit(lane)
                            .map(|h| (h.primitive, h.t.to_bits(), h.u.to_bits(), h.v.to_bits()))
                    };
                    assert_eq!(bits(a), bits(b));
                    assert_eq!(a.t_far[lane].to_bits(), b.t_far[lane].to_bits());
                }
            }
        }
    }
}

#[test]
fn coordinates_out_of_range_are_traced_too() {
    let mut random = RandomNumbers(9);
    for scale in [1e-17, 1e17] {
        let mut mesh = bumpy_sphere(1000);
        let positions: Vec<_> = mesh.positions.iter().map(|p| p.map(|x| x * scale)).collect();
        mesh.positions = positions.into();
        let tree = build_tree(&[&mesh]).unwrap();
        let mut packets = from_origin(Vec3::ZERO, 4, 1.0, &mut random);
        for packet in &mut packets {
            packet.t_near = [0.0; LANES];
            packet.t_far = [f32::INFINITY; LANES];
            for axis in 0..3 {
                packet.direction[axis] = packet.direction[axis].map(|x| x * scale);
            }
        }
        intersect(BEST, tree.view(), &mut packets, Vec3::ZERO);
        for packet in &packets {
            for lane in 0..LANES {
                assert_eq!(packet.hit(lane).is_some(), packet.is_active(lane));
            }
        }
    }
}

/// Returns the number of rays from `origin`, inside a closed mesh, that hit nothing although they are aimed at vertices,
/// or at points on edges; twice for each group size, as nearest hits and as shadow rays from afar.
fn leaks(mesh: &Mesh, origin: Vec3, ray_count: usize, at_edges: bool) -> usize {
    let tree = build_tree(&[mesh]).unwrap();
    let mut random = RandomNumbers(17);
    let mut misses = 0;
    let triangles: &[[u32; 3]] = &mesh.triangles;
    for size in [1, 4, 16, 64] {
        let mut traced = 0;
        let mut first = 0;
        while traced < ray_count / 4 {
            // Aim at vertices in the order of triangles, which is that of rows of the mesh
            let mut packets = vec![RayPacket::EMPTY; size];
            let mut shadows = packets.clone();
            for index in 0..size * LANES {
                let [a, b, _] = triangles[(first + index) % triangles.len()]
                    .map(|v| Vec3::from(mesh.positions[v as usize]));
                let aim = if at_edges { a + random.next() * (b - a) } else { a };
                packets[index / LANES].set(index % LANES, &Ray::new(origin, aim - origin));
                let outside = origin + 3.0 * (aim - origin);
                let mut shadow = Ray::new(outside, origin - outside);
                shadow.t_far = 1.0;
                shadows[index / LANES].set(index % LANES, &shadow);
            }
            first += 7919 * LANES;
            traced += size * LANES;
            intersect(BEST, tree.view(), &mut packets, origin);
            occluded(BEST, tree.view(), &mut shadows, RayEnd::Point(origin));
            for (packet, shadow) in packets.iter().zip(&shadows) {
                for lane in 0..LANES {
                    misses += usize::from(packet.hit(lane).is_none()) + usize::from(!shadow.is_blocked(lane));
                }
            }
        }
    }
    misses
}

#[test]
fn nothing_leaks_through_vertices_or_edges() {
    for offset in [Vec3::ZERO, Vec3::new(100.0, 37.0, -55.0)] {
        let mut mesh = bumpy_sphere(500_000);
        let positions: Vec<_> = mesh
            .positions
            .iter()
            .map(|&p| (Vec3::from(p) + offset).to_array())
            .collect();
        mesh.positions = positions.into();
        let origin = Vec3::new(0.03, 0.05, -0.02) + offset;
        for at_edges in [false, true] {
            assert_eq!(
                leaks(&mesh, origin, 1_000_000, at_edges),
                0,
                "{offset} {at_edges}"
            );
        }
    }
}

/// Returns packets of rays from random points of the triangles that face a light, a rounding error off them, to it: from
/// their sides away from it if the rays `cross` them.
fn from_surface(mesh: &Mesh, end: RayEnd, cross: bool) -> Vec<RayPacket> {
    let mut random = RandomNumbers(29);
    let mut rays = Vec::new();
    let to_light = |p: Vec3| match end {
        RayEnd::Point(target) => target - p,
        RayEnd::Direction(direction) => direction,
    };
    for number in 0..mesh.triangles.len() as u32 {
        let [a, b, c] = mesh.corners(number);
        let ng = (b - a).cross(c - a).as_dvec3().normalize();
        // Choose a point of the triangle
        let (u, v) = (random.next(), random.next());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let p = a + u * (b - a) + v * (c - a);
        if ng.dot(to_light(p).as_dvec3()) <= 0.0 {
            continue;
        }
        // Spawn a ray there
        let error = triangle_spawn_error(a, b - a, c - a).along(ng);
        let side = if cross { -ng } else { ng };
        let origin = spawn_point(p.as_dvec3(), side, error);
        let mut ray = Ray::new(origin, to_light(origin));
        ray.t_far = match end {
            RayEnd::Point(_) => 1.0,
            RayEnd::Direction(_) => f32::INFINITY,
        };
        rays.push(ray);
    }
    let mut packets = vec![RayPacket::EMPTY; rays.len().div_ceil(LANES)];
    for (index, ray) in rays.iter().enumerate() {
        packets[index / LANES].set(index % LANES, ray);
    }
    packets
}

/// Numbers of rays from surfaces.
#[derive(Default)]
pub(super) struct SurfaceRayCounts {
    pub(super) all: usize,
    pub(super) free: usize,
    /// Rays for which groups differ from rays that are traced one at a time.
    pub(super) different: usize,
}

impl SurfaceRayCounts {
    /// Counts rays from a bumpy sphere towards each end; they `cross` the triangles that they start at or leave them.
    pub(super) fn of(ends: impl IntoIterator<Item = RayEnd>, cross: bool) -> SurfaceRayCounts {
        let mesh = bumpy_sphere(100_000);
        let mut counts = SurfaceRayCounts::default();
        for end in ends {
            counts.add(&mesh, end, cross);
        }
        counts
    }

    /// Traces rays from all triangles that face a light, in groups and one at a time; they `cross` these triangles or leave them.
    fn add(&mut self, mesh: &Mesh, end: RayEnd, cross: bool) {
        let tree = build_tree(&[mesh]).unwrap();
        let mut actual = from_surface(mesh, end, cross);
        let mut expected = actual.clone();
        occluded(BEST, tree.view(), &mut actual, end);
        single::trace(BEST, tree.view(), &mut expected, Query::Any);
        for (a, b) in expected.iter().zip(&actual) {
            for lane in 0..LANES {
                self.all += usize::from(a.is_active(lane));
                self.free += usize::from(a.is_active(lane) && !a.is_blocked(lane));
                self.different += usize::from(a.is_blocked(lane) != b.is_blocked(lane));
            }
        }
    }
}

/// Lights near the mesh and far from it.
const TARGETS: [Vec3; 2] = [Vec3::new(2.0, 3.0, 1.5), Vec3::new(-40.0, 5.0, 9.0)];

#[test]
fn rays_from_surfaces_are_not_blocked_by_their_triangle() {
    let counts = SurfaceRayCounts::of(TARGETS.map(RayEnd::Point), false);
    // Nine of 537 000 such rays differ: their hits are as near the start as the rounding error of either test
    let SurfaceRayCounts { all, free, different } = counts;
    assert!(all > 50_000 && free > all / 2, "{free} of {all}");
    assert!(different <= all / 10_000, "{different} of {all}");
}

#[test]
fn rays_are_blocked_by_a_triangle_a_rounding_error_before_their_start() {
    let counts = SurfaceRayCounts::of(TARGETS.map(RayEnd::Point), true);
    // Twelve of 87 000 pass the outline of the mesh, by less than the rounding error of its vertices relative to the light
    let SurfaceRayCounts { all, free, different } = counts;
    assert!(all > 50_000 && free == 0, "{free} of {all}");
    assert!(different <= all / 5_000, "{different} of {all}");
}
