//! All backends find the points of clouds alike, to the bits of brute force.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use whit::accel::brute::BruteAccel;
use whit::accel::{Coherence, Hit};
use whit::mesh::PointCloud;
use whit::numeric::Ray;
use whit::scene::{Geometry, Instance, Material, Scene};
use whit::shape::{Shape, Sphere};

use super::agreement::{backends, blocked, compare_all, nearest};
use crate::support::scenes::{self, SplitMix64};

/// Returns a cloud of overlapping points, of which in every six three coincide.
fn cloud(count: usize, seed: u64) -> PointCloud {
    let mut random = SplitMix64(seed);
    let mut positions: Vec<[f32; 3]> = (0..count)
        .map(|_| random.in_cube().as_vec3().to_array())
        .collect();
    for i in (0..count).filter(|i| (i / 3).is_multiple_of(2)) {
        positions[i] = positions[i - i % 3];
    }
    PointCloud {
        positions: positions.into(),
        radius: 0.08,
        colors: None,
    }
}

/// Returns two clouds in the world, moved, scaled, turned, stretched and mirrored, and analytic spheres at some of the same
/// places.
fn clouds() -> Scene {
    let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.1);
    let stretched = DVec3::new(-0.4, 1.5, 0.7);
    let at = |x: f64| DVec3::new(x, 0.25, -0.5);
    let first = cloud(300, 5);
    let same = (0..8).map(|point| (2 + point, DAffine3::IDENTITY));
    let spheres: Vec<Geometry> = (0..8)
        .map(|point| Geometry::Shape(first.shape(30 * point)))
        .collect();
    let places = [
        (0, DAffine3::IDENTITY),
        (0, DAffine3::IDENTITY),
        (1, DAffine3::from_translation(at(1.5))),
        (
            1,
            DAffine3::from_scale_rotation_translation(DVec3::splat(0.5), DQuat::IDENTITY, at(-1.5)),
        ),
        (
            0,
            DAffine3::from_scale_rotation_translation(stretched, turn, at(0.5)),
        ),
    ];
    let clouds = vec![Geometry::Points(first), Geometry::Points(cloud(100, 6))];
    let geometries = [clouds, spheres].concat();
    // The scene is valid only with a material
    Scene {
        materials: vec![Material::default()],
        ..scenes::scene(geometries, places.into_iter().chain(same).collect())
    }
}

/// Returns rays of all kinds, and some that start within points.
fn rays(scene: &Scene, count: usize) -> Vec<(Coherence, Vec<Ray>)> {
    let mut random = SplitMix64(31);
    let mut inside = Vec::new();
    for instance in &scene.instances {
        let Geometry::Points(cloud) = &scene.geometries[instance.geometry as usize] else {
            continue;
        };
        for point in 0..cloud.len() as u32 {
            let p_object = cloud.center(point) + 0.5 * cloud.radius * random.in_cube();
            let origin = instance.pose(0.0).world_from_object().transform_point3(p_object);
            inside.push(Ray::new(origin.as_vec3(), random.on_sphere().as_vec3()));
        }
    }
    vec![
        (Coherence::Coherent, scenes::camera_rays(scene, 64)),
        (Coherence::Incoherent, scenes::random_rays(scene, count, 7)),
        (Coherence::Incoherent, scenes::lattice_rays(scene, count, 8)),
        (Coherence::Incoherent, inside),
    ]
}

fn bits(hit: &Hit) -> [u32; 3] {
    [hit.instance, hit.primitive, hit.t.to_bits()]
}

/// Checks that every backend finds the hits of brute force, to the bit.
fn check(scene: &Scene, batches: &[(Coherence, Vec<Ray>)]) {
    scene.validate().unwrap();
    let brute = BruteAccel::new(scene);
    let backends = backends(scene);
    for (order, rays) in batches {
        let expected: Vec<_> = rays
            .iter()
            .map(|ray| brute.nearest(ray).as_ref().map(bits))
            .collect();
        // Enough hits for a comparison, though lattice rays pass between most points
        let hit_count = expected.iter().flatten().count();
        assert!(hit_count >= 40, "{hit_count} of {} rays hit", rays.len());
        for (name, accel) in &backends {
            let found = nearest(accel.as_ref(), rays, *order);
            let is_blocked = blocked(accel.as_ref(), rays, *order);
            for (i, ray) in rays.iter().enumerate() {
                assert_eq!(found[i].as_ref().map(bits), expected[i], "{name}: {ray:?}");
                assert_eq!(is_blocked[i], expected[i].is_some(), "{name}: {ray:?}");
            }
        }
    }
}

#[test]
fn all_backends_find_the_same_points_to_the_bit() {
    let scene = clouds();
    check(&scene, &rays(&scene, 4000));
}

#[test]
fn all_backends_find_the_same_moving_points_to_the_bit() {
    let mut scene = clouds();
    let turn = DQuat::from_axis_angle(DVec3::Y, 0.8);
    let end = DAffine3::from_rotation_translation(turn, DVec3::new(0.3, 0.2, 0.0));
    let start = DAffine3::from_translation(DVec3::X);
    scene.instances[0] = Instance::moving("moving", 0, 0, [start, end * start]).unwrap();
    scene.instances[3] = Instance::moving("moving", 1, 0, [end, start]).unwrap();
    let mut batches = rays(&scene, 3000);
    let mut random = SplitMix64(41);
    for ray in batches.iter_mut().flat_map(|(_, rays)| rays) {
        ray.time = random.next() as f32;
    }
    check(&scene, &batches);
}

#[test]
fn all_backends_agree_on_points_among_meshes_and_planes() {
    let mut scene = clouds();
    let geometries = scene.geometries.len() as u32;
    scene.geometries.extend([
        Geometry::Mesh(scenes::bumpy_sphere(8)),
        Geometry::Shape(Shape::Plane),
    ]);
    let turned = DAffine3::from_rotation_x(1.2) * DAffine3::from_scale(DVec3::splat(0.6));
    for (number, map) in [(0, DAffine3::IDENTITY), (0, turned), (1, turned)] {
        scene
            .instances
            .push(Instance::new("", geometries + number, 0, map).unwrap());
    }
    let (count, wrong) = compare_all("points among meshes", &scene, 48, 1500);
    assert!(count > 5_000 && wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn point_is_hit_as_its_sphere_alone() {
    let (center, radius) = (DVec3::new(0.5, -0.25, 2.0), 0.125);
    let cloud = PointCloud {
        positions: vec![[9.0; 3], center.as_vec3().to_array()].into(),
        radius,
        colors: None,
    };
    let sphere = Shape::Sphere(Sphere { center, radius });
    let place = || vec![(0, DAffine3::from_translation(DVec3::Z))];
    let alone = scenes::scene(vec![Geometry::Shape(sphere)], place());
    let scene = scenes::scene(vec![Geometry::Points(cloud)], place());
    let ray = Ray::new(Vec3::new(0.55, -0.2, -4.0), Vec3::Z);
    let expected = BruteAccel::new(&alone).nearest(&ray).unwrap();
    for (name, accel) in backends(&scene) {
        let [found] = nearest(accel.as_ref(), &[ray], Coherence::Coherent)[..] else {
            panic!("one result");
        };
        let found = found.unwrap();
        assert_eq!((found.primitive, found.t), (1, expected.t), "{name}");
    }
}
