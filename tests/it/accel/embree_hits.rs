//! Hits that Embree finds, against values computed by hand.

use std::sync::Mutex;

use glam::{DAffine3, DVec3, Vec3};
use whit::accel::embree::EmbreeAccel;
use whit::accel::{Accel, AccelError, AccelOptions, Coherence, Hit, Kernel, LANES, Precision, RayPacket};
use whit::buffer::Buffer;
use whit::mesh::Mesh;
use whit::numeric::Ray;
use whit::scene::{Geometry, Instance, Scene};
use whit::shape::{Shape, Sphere};

/// The right triangle with legs of 1 along x and y, in the plane z = 0.
fn triangle() -> Geometry {
    Geometry::Mesh(Mesh {
        positions: Buffer::from(vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        triangles: Buffer::from(vec![[0, 1, 2]]),
        ..Mesh::default()
    })
}

/// A bumpy height field over [0, 1]² of `n`² cells: many triangles, no two rays alike.
fn field(n: u32) -> Geometry {
    let at = |i: u32| i as f32 / n as f32;
    let height = |x: f32, y: f32| 0.1 * (7.0 * x).sin() * (5.0 * y).cos();
    let positions: Vec<[f32; 3]> = (0..=n)
        .flat_map(|j| (0..=n).map(move |i| [at(i), at(j), height(at(i), at(j))]))
        .collect();
    let triangles: Vec<[u32; 3]> = (0..n)
        .flat_map(|j| (0..n).map(move |i| j * (n + 1) + i))
        .flat_map(|v| [[v, v + 1, v + n + 2], [v, v + n + 2, v + n + 1]])
        .collect();
    Geometry::Mesh(Mesh {
        positions: Buffer::from(positions),
        triangles: Buffer::from(triangles),
        ..Mesh::default()
    })
}

fn scene(geometries: Vec<Geometry>, placed: &[(u32, DAffine3)]) -> Scene {
    let instances = placed
        .iter()
        .map(|&(geometry, map)| Instance::new("", geometry, 0, map).unwrap());
    Scene {
        geometries,
        instances: instances.collect(),
        ..Scene::default()
    }
}

fn down(x: f32, y: f32) -> Ray {
    Ray::new(Vec3::new(x, y, 4.0), Vec3::NEG_Z)
}

/// The result for one ray in every lane, kernel and ray order; all must agree.
fn hit(scene: &Scene, ray: Ray) -> Option<Hit> {
    let mut results = Vec::new();
    for kernel in [Kernel::Packet, Kernel::Single] {
        let accel = EmbreeAccel::build(
            scene,
            &AccelOptions {
                kernel,
                ..AccelOptions::default()
            },
        )
        .unwrap();
        for order in [Coherence::Coherent, Coherence::Incoherent] {
            let mut packet = RayPacket::EMPTY;
            (0..LANES).for_each(|lane| packet.set(lane, &ray));
            let mut traced = [packet.clone()];
            accel.intersect(&mut traced, order);
            results.extend((0..LANES).map(|lane| traced[0].hit(lane)));
            let mut shadow = [packet];
            accel.occluded(&mut shadow, order);
            let is_hit = traced[0].hit(0).is_some();
            assert!(
                (0..LANES).all(|lane| shadow[0].is_blocked(lane) == is_hit),
                "{kernel:?} {order:?}"
            );
        }
    }
    assert!(results.iter().all(|result| *result == results[0]), "{results:?}");
    results[0]
}

/// Embree multiplies by reciprocals that it improves from what the processor guesses: on some processors all three
/// numbers of a hit are a rounding aside.
fn assert_nearly<const N: usize>(found: [f32; N], exact: [f32; N]) {
    let is_near = |(found, exact): (&f32, &f32)| (found - exact).abs() <= f32::EPSILON * exact;
    assert!(found.iter().zip(&exact).all(is_near), "{found:?}, not {exact:?}");
}

#[test]
fn a_native_triangle_is_hit_where_it_lies() {
    let scene = scene(vec![triangle()], &[(0, DAffine3::IDENTITY)]);
    // (0.25, 0.5) is 0.25 of the corner on x and 0.5 of the one on y; all of it is exact in binary.
    let found = hit(&scene, down(0.25, 0.5)).unwrap();
    assert_eq!((found.instance, found.primitive), (0, 0));
    assert_nearly([found.t, found.u, found.v], [4.0, 0.25, 0.5]);
    assert_eq!(hit(&scene, down(0.75, 0.5)), None);
}

#[test]
fn a_sphere_is_hit_within_its_interval_only() {
    let scene = scene(
        vec![Geometry::Shape(Shape::Sphere(Sphere::UNIT))],
        &[(0, DAffine3::IDENTITY)],
    );
    // From z = 4 the unit sphere spans t = 3 to 5.
    let with = |t_near, t_far| {
        hit(
            &scene,
            Ray {
                t_near,
                t_far,
                ..down(0.0, 0.0)
            },
        )
        .map(|hit| hit.t)
    };
    assert_eq!(with(0.0, f32::INFINITY), Some(3.0));
    assert_eq!(with(0.0, 3.0), Some(3.0));
    assert_eq!(with(0.0, 3f32.next_down()), None);
    assert_eq!(with(3f32.next_up(), f32::INFINITY), Some(5.0));
    assert_eq!(with(5f32.next_up(), f32::INFINITY), None);
}

#[test]
fn a_sphere_scaled_unevenly_is_an_ellipsoid() {
    let map = DAffine3::from_scale(DVec3::new(1.0, 1.0, 2.0));
    let scene = scene(vec![Geometry::Shape(Shape::Sphere(Sphere::UNIT))], &[(0, map)]);
    assert_eq!(hit(&scene, down(0.0, 0.0)).unwrap().t, 2.0);
}

#[test]
fn a_mirrored_and_unevenly_scaled_mesh_keeps_t_and_weights() {
    // x to -2x, y to 4y, z to z + 1: the point of weights (0.25, 0.5) is now at (-0.5, 2, 1).
    let map =
        DAffine3::from_scale_rotation_translation(DVec3::new(-2.0, 4.0, 1.0), Default::default(), DVec3::Z);
    let scene = scene(
        vec![triangle()],
        &[(0, DAffine3::from_translation(DVec3::X * 50.0)), (0, map)],
    );
    let found = hit(&scene, down(-0.5, 2.0)).unwrap();
    assert_eq!((found.instance, found.primitive), (1, 0));
    assert_nearly([found.t, found.u, found.v], [3.0, 0.25, 0.5]);
    assert_eq!(hit(&scene, down(0.5, 2.0)), None);
}

#[test]
fn at_the_same_t_the_lower_instance_is_hit() {
    let above = DAffine3::from_translation(DVec3::Z);
    let sphere = Sphere {
        center: DVec3::ZERO,
        radius: 1.0,
    };
    let two_spheres = scene(
        vec![Geometry::Shape(Shape::Sphere(sphere))],
        &[(0, DAffine3::IDENTITY); 2],
    );
    assert_eq!(hit(&two_spheres, down(0.0, 0.0)).unwrap().instance, 0);
    let two_meshes = scene(vec![triangle()], &[(0, above); 2]);
    assert_eq!(hit(&two_meshes, down(0.25, 0.25)).unwrap().instance, 0);
    // The sphere's top is at z = 1 too, at the mesh's corner.
    let both = |first: u32| {
        scene(
            vec![triangle(), Geometry::Shape(Shape::Sphere(sphere))],
            &[(first, above), (1 - first, above)],
        )
    };
    assert_eq!(
        hit(&both(0), down(0.25, 0.25)).unwrap().instance,
        1,
        "the sphere stands higher"
    );
}

#[test]
fn one_mesh_may_be_native_and_instanced() {
    let up = DAffine3::from_translation(DVec3::new(2.0, 0.0, 1.0));
    let scene = scene(vec![triangle()], &[(0, DAffine3::IDENTITY), (0, up)]);
    let at = |x: f32| hit(&scene, down(x, 0.25));
    for (x, instance, t) in [(0.25, 0, 4.0), (2.25, 1, 3.0)] {
        let found = at(x).unwrap();
        assert_eq!(found.instance, instance);
        assert_nearly([found.t], [t]);
    }
    assert_eq!(at(1.5), None);
}

#[test]
fn an_empty_scene_is_built_and_missed() {
    assert_eq!(hit(&Scene::default(), down(0.0, 0.0)), None);
    let mesh_without_triangles = scene(vec![Geometry::Mesh(Mesh::default())], &[(0, DAffine3::IDENTITY)]);
    assert_eq!(hit(&mesh_without_triangles, down(0.0, 0.0)), None);
}

#[test]
fn nan_rays_neither_abort_nor_hit() {
    let map = DAffine3::from_translation(DVec3::Z);
    let everything = scene(
        vec![triangle(), Geometry::Shape(Shape::Sphere(Sphere::UNIT))],
        &[(0, DAffine3::IDENTITY), (0, map), (1, map)],
    );
    let good = down(0.25, 0.25);
    let bad = [
        Ray {
            origin: Vec3::NAN,
            ..good
        },
        Ray {
            origin: Vec3::splat(f32::INFINITY),
            ..good
        },
        Ray {
            origin: Vec3::splat(1e19),
            ..good
        },
        Ray {
            direction: Vec3::NAN,
            ..good
        },
        Ray {
            direction: Vec3::ZERO,
            ..good
        },
        Ray { t_near: -1.0, ..good },
        Ray {
            t_near: f32::NAN,
            ..good
        },
        Ray {
            t_far: f32::NAN,
            ..good
        },
    ];
    for kernel in [Kernel::Packet, Kernel::Single] {
        let accel = EmbreeAccel::build(
            &everything,
            &AccelOptions {
                kernel,
                ..AccelOptions::default()
            },
        )
        .unwrap();
        for order in [Coherence::Coherent, Coherence::Incoherent] {
            let mut packet = RayPacket::EMPTY;
            bad.iter()
                .enumerate()
                .for_each(|(lane, ray)| packet.set(lane, ray));
            packet.set(15, &good);
            let mut traced = [packet.clone()];
            accel.intersect(&mut traced, order);
            assert!((0..15).all(|lane| traced[0].hit(lane).is_none()) && traced[0].hit(15).is_some());
            let mut shadow = [packet];
            accel.occluded(&mut shadow, order);
            assert!((0..15).all(|lane| !shadow[0].is_blocked(lane)) && shadow[0].is_blocked(15));
        }
    }
}

#[test]
fn a_ray_that_leaves_the_range_in_object_space_misses() {
    // Object space is 1e9 times finer: 4e12 away becomes 4e21, beyond what Embree accepts.
    let map = DAffine3::from_scale(DVec3::splat(1e-9));
    let scene = scene(vec![triangle()], &[(0, map)]);
    assert_eq!(
        hit(&scene, Ray::new(Vec3::new(0.0, 0.0, 4e12), Vec3::NEG_Z)),
        None
    );
}

#[test]
fn every_width_finds_the_same_primitives() {
    let turned = DAffine3::from_rotation_z(0.3) * DAffine3::from_translation(DVec3::new(0.0, 0.0, 0.5));
    let everything = scene(
        vec![
            field(24),
            Geometry::Shape(Shape::Sphere(Sphere {
                center: DVec3::new(0.5, 0.5, 0.4),
                radius: 0.3,
            })),
        ],
        &[(0, DAffine3::IDENTITY), (0, turned), (1, DAffine3::IDENTITY)],
    );
    let packets: Vec<RayPacket> = (0..64u32)
        .map(|i| {
            let mut packet = RayPacket::EMPTY;
            for lane in 0..LANES as u32 {
                // Never on the grid's lines: the cells are 1/24 wide.
                let (x, y) = ((i * 16 + lane) % 32, (i * 16 + lane) / 32);
                let origin = Vec3::new((x as f32 + 0.37) / 32.0, (y as f32 + 0.41) / 32.0, 4.0);
                packet.set(lane as usize, &Ray::new(origin, Vec3::new(0.01, -0.02, -1.0)));
            }
            packet
        })
        .collect();
    let ids = |isa: Option<&str>, kernel: Kernel| {
        let options = AccelOptions {
            isa: isa.map(str::to_owned),
            kernel,
            ..AccelOptions::default()
        };
        // A processor without the instruction set has nothing to compare.
        let accel = match EmbreeAccel::build(&everything, &options) {
            Err(AccelError::Embree { message, .. }) if message.contains("this processor has no") => {
                return None;
            }
            built => built.unwrap(),
        };
        let mut traced = packets.clone();
        accel.intersect(&mut traced, Coherence::Coherent);
        let id = |hit: Hit| (hit.instance, hit.primitive);
        Some(
            traced
                .iter()
                .flat_map(|p| (0..LANES).map(|lane| p.hit(lane).map(id)))
                .collect::<Vec<_>>(),
        )
    };
    let expected = ids(None, Kernel::Packet).unwrap();
    assert!((0..3).all(|instance| expected.iter().flatten().any(|id| id.0 == instance)));
    for isa in ["sse2", "sse4.2", "avx", "avx2", "avx512"] {
        for kernel in [Kernel::Packet, Kernel::Single] {
            if let Some(found) = ids(Some(isa), kernel) {
                assert!(found == expected, "{isa} {kernel:?}");
            }
        }
    }
}

#[test]
fn the_report_names_the_version_and_counts_memory() {
    let scene = scene(vec![field(32)], &[(0, DAffine3::IDENTITY)]);
    let accel = EmbreeAccel::build(&scene, &AccelOptions::default()).unwrap();
    let report = accel.report();
    assert!(
        report.bytes > 0 && report.peak_bytes >= report.bytes,
        "{report:?}"
    );
    let minor = |version: &str| version.rsplit_once('.').unwrap().0.to_owned();
    let running = report.embree.unwrap().version;
    let headers = [embree_sys::RTC_VERSION_MAJOR, embree_sys::RTC_VERSION_MINOR]
        .map(|n| n.to_string())
        .join(".");
    assert_eq!(minor(&running), headers);
}

#[test]
fn progress_never_falls_and_ends_at_one() {
    let turned = DAffine3::from_rotation_z(0.3);
    let scene = scene(
        vec![field(64), field(32)],
        &[(0, DAffine3::IDENTITY), (1, turned)],
    );
    for precision in Precision::ALL {
        let reported = Mutex::new(Vec::new());
        let on_progress = |fraction: f64| reported.lock().unwrap().push(fraction);
        let options = AccelOptions {
            precision,
            progress: Some(&on_progress),
            threads: 1,
            ..AccelOptions::default()
        };
        EmbreeAccel::build(&scene, &options).unwrap();
        let reported = reported.into_inner().unwrap();
        assert!(
            reported.is_sorted() && reported.last() == Some(&1.0),
            "{precision}: {reported:?}"
        );
    }
}

#[test]
fn panic_in_progress_cancels_the_build_and_propagates() {
    let scene = scene(vec![field(64)], &[(0, DAffine3::IDENTITY)]);
    let on_progress = |_: f64| panic!("stop");
    let result = std::panic::catch_unwind(|| {
        let options = AccelOptions {
            progress: Some(&on_progress),
            ..AccelOptions::default()
        };
        EmbreeAccel::build(&scene, &options).map(|_| ())
    });
    assert!(result.is_err());
}
