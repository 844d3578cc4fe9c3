//! Bounding volumes change the time, never a result: lists with bounding volumes return the bits of brute force.

use crate::support::scenes::{self, SplitMix64, packets};
use glam::{DAffine3, DVec3, Vec3};
use whit::accel::brute::BruteAccel;
use whit::accel::bsp::BspAccel;
use whit::accel::extents::{
    BoundingSphere, BoundingVolumeKind, ListAccel, ListLimits, ScreenBounds, ScreenBox, SphereVolume,
    Spheres, TileCulledAccel,
};
use whit::accel::{Accel, AccelOptions, Coherence, Hit, LANES};
use whit::numeric::Ray;
use whit::scene::{Camera, CameraView, Geometry, Projection, Scene};
use whit::shape::{Shape, Sphere};

fn nearest(accel: &dyn Accel, rays: &[Ray]) -> Vec<Option<Hit>> {
    let mut packets = packets(rays);
    accel.intersect(&mut packets, Coherence::Coherent);
    (0..rays.len())
        .map(|i| packets[i / LANES].hit(i % LANES))
        .collect()
}

fn blocked(accel: &dyn Accel, rays: &[Ray]) -> Vec<bool> {
    let mut packets = packets(rays);
    accel.occluded(&mut packets, Coherence::Coherent);
    (0..rays.len())
        .map(|i| packets[i / LANES].is_blocked(i % LANES))
        .collect()
}

/// Every shape in every placement, and the small scenes.
fn all_scenes() -> Vec<(&'static str, Scene)> {
    let shapes = scenes::all_shapes().into_iter();
    shapes
        .map(|(name, shape)| (name, scenes::placed_shape(shape)))
        .chain(scenes::all_small())
        .collect()
}

/// Rays that touch the objects where extents do: through vertices, at right angles to the way from the middle, from
/// near and from far, and with ends where the hits are.
fn grazing_rays(scene: &Scene, count: usize, seed: u64) -> Vec<Ray> {
    let mut random = SplitMix64(seed);
    let mut rays = Vec::new();
    while rays.len() < count {
        let instance = &scene.instances[random.below(scene.instances.len())];
        let map = instance.world_from_object();
        let (center, target) = match &scene.geometries[instance.geometry as usize] {
            Geometry::Mesh(mesh) => {
                let vertex = mesh.triangles[random.below(mesh.triangles.len())][random.below(3)];
                let p = DVec3::from(mesh.positions[vertex as usize].map(f64::from));
                (mesh.bounds().center(), p)
            }
            // Points of the unit sphere, of the cube's edges and corners.
            Geometry::Shape(_) | Geometry::Points(_) => {
                let p = random.on_sphere();
                let snapped = (2.0 * p).clamp(-DVec3::ONE, DVec3::ONE);
                (DVec3::ZERO, if random.next() < 0.5 { p } else { snapped })
            }
        };
        let (center, target) = (map.transform_point3(center), map.transform_point3(target));
        let out = target - center;
        let along = if random.next() < 0.7 {
            out.cross(random.on_sphere())
        } else {
            random.on_sphere()
        };
        let distance = 10f64.powf(6.0 * random.next() - 2.0);
        let origin = (target - distance * along.normalize_or(DVec3::X)).as_vec3();
        let mut ray = Ray::new(origin, (target - origin.as_dvec3()).as_vec3());
        if random.next() < 0.3 {
            ray.t_far = 1.0;
        }
        if ray.is_traceable() {
            rays.push(ray);
        }
    }
    rays
}

fn rays_of(scene: &Scene, count: usize) -> Vec<Ray> {
    let camera = scenes::camera_rays(scene, 64);
    let hits = nearest(&BruteAccel::new(scene), &camera);
    let hits: Vec<Option<f32>> = hits.iter().map(|hit| hit.map(|h| h.t)).collect();
    [
        scenes::shadow_rays(scene, &camera, &hits),
        camera,
        scenes::random_rays(scene, count, 41),
        scenes::lattice_rays(scene, count, 42),
        grazing_rays(scene, count, 43),
    ]
    .concat()
}

#[test]
fn lists_with_bounding_volumes_equal_brute_force() {
    let (mut ray_count, mut hit_count) = (0, 0);
    for (name, scene) in all_scenes() {
        let rays = rays_of(&scene, 2000);
        let brute = BruteAccel::new(&scene);
        let hits = nearest(&brute, &rays);
        for kind in BoundingVolumeKind::ALL {
            let list = ListAccel::new(&scene, kind);
            for ((ray, a), b) in rays.iter().zip(&hits).zip(nearest(&list, &rays)) {
                assert_eq!(*a, b, "{name}, {kind}: {ray:?}");
            }
            for ((ray, a), b) in rays.iter().zip(&hits).zip(blocked(&list, &rays)) {
                assert_eq!(a.is_some(), b, "{name}, {kind}: {ray:?}");
            }
        }
        ray_count += rays.len();
        hit_count += hits.iter().flatten().count();
    }
    println!("{ray_count} rays, {hit_count} hits");
    assert!(
        hit_count > 25_000,
        "only {hit_count} of {ray_count} rays hit anything"
    );
}

#[test]
fn bounding_spheres_in_the_bsp_change_no_bit() {
    for (name, scene) in all_scenes() {
        let rays = rays_of(&scene, 2000);
        let options = AccelOptions::default();
        let [without, with] = [Spheres::Never, Spheres::Always]
            .map(|spheres| BspAccel::build_with_spheres(&scene, &options, spheres).unwrap());
        assert_eq!(without.sphere_count(), 0);
        assert_eq!(nearest(&without, &rays), nearest(&with, &rays), "{name}");
        assert_eq!(blocked(&without, &rays), blocked(&with, &rays), "{name}");
    }
}

#[test]
fn intersection_test_counts_add_up() {
    for (name, scene) in all_scenes() {
        let rays = rays_of(&scene, 1000);
        let bounded = scene
            .instances
            .iter()
            .filter(|i| !scene.geometries[i.geometry as usize].is_unbounded())
            .count() as u64;
        for kind in BoundingVolumeKind::ALL {
            let list = ListAccel::new(&scene, kind);
            let counts = list.counts();
            let all = counts.none + counts.boxes + counts.centroid_spheres + counts.tight_spheres;
            assert_eq!(all, bounded, "{name}");
            let mut traced = packets(&rays);
            let tally = list.count_intersect(&mut traced);
            assert_eq!(tally.rays, rays.len() as u64, "{name}");
            assert_eq!(tally.objects, tally.rays * bounded, "{name}");
            assert_eq!(
                tally.extent_tests,
                tally.rays * (bounded - counts.none),
                "{name}, {kind}"
            );
            let hits = nearest(&list, &rays);
            let on_objects = hits.iter().flatten().filter(|hit| {
                let instance = &scene.instances[hit.instance as usize];
                !scene.geometries[instance.geometry as usize].is_unbounded()
            });
            assert!(tally.object_tests >= on_objects.count() as u64, "{name}, {kind}");
            if kind == BoundingVolumeKind::None {
                assert_eq!(
                    (tally.object_tests, counts.none),
                    (tally.objects, bounded),
                    "{name}"
                );
            } else {
                assert!(tally.object_tests <= tally.objects, "{name}, {kind}");
            }
            let any = list.count_occluded(&mut packets(&rays));
            assert!(
                any.object_tests <= tally.objects && any.rays == tally.rays,
                "{name}, {kind}"
            );
        }
    }
}

#[test]
fn bounding_volumes_save_most_tests_for_many_objects() {
    let scene = scenes::instance_grid(5);
    let rays = scenes::random_rays(&scene, 4000, 7);
    for kind in [
        BoundingVolumeKind::Box,
        BoundingVolumeKind::CentroidSphere,
        BoundingVolumeKind::TightSphere,
    ] {
        let tally = ListAccel::new(&scene, kind).count_intersect(&mut packets(&rays));
        assert!(4 * tally.object_tests < tally.objects, "{kind}: {tally:?}");
    }
}

fn camera(projection: Projection, eye: DVec3, at: DVec3, z_near: f64) -> Camera {
    let z = (eye - at).normalize();
    let x = DVec3::Y.cross(z).normalize();
    Camera {
        world_from_camera: DAffine3 {
            matrix3: glam::DMat3::from_cols(x, z.cross(x), z),
            translation: eye,
        },
        projection,
        z_near,
        ..Camera::default()
    }
}

/// The rays of a square image in blocks of 4 x 4 pixels, as the renderer makes them.
fn film_rays(view: &CameraView, width: usize) -> Vec<Ray> {
    let mut rays = Vec::new();
    for block in 0..(width / 4) * (width / 4) {
        for pixel in 0..16 {
            let (x, y) = (
                4 * (block % (width / 4)) + pixel % 4,
                4 * (block / (width / 4)) + pixel / 4,
            );
            let ray = view.ray((x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / width as f64);
            rays.push(Ray {
                origin: ray.origin.as_vec3(),
                direction: ray.direction.as_vec3(),
                t_near: ray.t_near as f32,
                t_far: ray.t_far as f32,
                time: 0.0,
            });
        }
    }
    rays
}

/// From outside, from within, with a near plane that cuts, and parallel.
fn cameras(scene: &Scene) -> Vec<Camera> {
    let bounds = scene.bounds();
    let (center, size) = (bounds.center(), bounds.extent().length());
    let outside = center + size * DVec3::new(0.4, 0.3, 0.8);
    let wide = Projection::Perspective {
        y_fov: 1.2,
        aspect: None,
    };
    let window = Projection::Window {
        half_width: 0.7,
        half_height: 0.6,
        distance: 0.8,
    };
    let parallel = Projection::Orthographic {
        y_mag: 0.4 * size,
        x_mag: None,
    };
    vec![
        camera(wide, outside, center, 0.0),
        camera(wide, outside, center, 0.9 * size),
        camera(window, center + 0.01 * size * DVec3::ONE, bounds.max, 0.0),
        camera(window, center, bounds.min, 0.1 * size),
        camera(parallel, outside, center, 0.0),
        camera(parallel, center, bounds.max, 0.05 * size),
    ]
}

#[test]
fn screen_space_boxes_equal_brute_force() {
    let mut hit_count = 0;
    for (name, scene) in all_scenes() {
        let brute = BruteAccel::new(&scene);
        let bsp = BspAccel::build(&scene, &AccelOptions::default()).unwrap();
        for (number, camera) in cameras(&scene).iter().enumerate() {
            let view = camera.view(64, 64);
            let rays = film_rays(&view, 64);
            let hits = nearest(&brute, &rays);
            hit_count += hits.iter().flatten().count();
            let few = ListLimits {
                objects: 2,
                primitives: 12,
            };
            for (inner, kind, limits) in [
                (&brute as &dyn Accel, BoundingVolumeKind::None, ListLimits::NONE),
                (&brute, BoundingVolumeKind::Chosen, ListLimits::NONE),
                (&bsp, BoundingVolumeKind::TightSphere, few),
                (&bsp, BoundingVolumeKind::TightSphere, ListLimits::BESIDE_A_TREE),
            ] {
                let projected = TileCulledAccel::new(&scene, &view, inner, kind, limits).unwrap();
                for ((ray, a), b) in rays.iter().zip(&hits).zip(nearest(&projected, &rays)) {
                    assert_eq!(*a, b, "{name}, camera {number}, {kind}: {ray:?}");
                }
                // Rays that are not the camera's are traced all the same.
                let others = scenes::random_rays(&scene, 160, 3);
                assert_eq!(nearest(&projected, &others), nearest(inner, &others), "{name}");
            }
        }
    }
    assert!(hit_count > 100_000, "only {hit_count}");
}

#[test]
fn every_hit_lies_in_its_objects_screen_space_box() {
    for (name, scene) in all_scenes() {
        for camera in cameras(&scene) {
            let view = camera.view(64, 64);
            let boxes = ScreenBounds::new(&scene, &view).unwrap();
            let rays = film_rays(&view, 64);
            for (i, hit) in nearest(&BruteAccel::new(&scene), &rays).iter().enumerate() {
                let Some(hit) = hit else { continue };
                let (block, pixel) = (i / 16, i % 16);
                let x = (4 * (block % 16) + pixel % 4) as f32 + 0.5;
                let y = (4 * (block / 16) + pixel / 4) as f32 + 0.5;
                // The direction was rounded: by far less than a hundredth of a pixel.
                let pixel = ScreenBox {
                    low: [(x - 0.01) / 64.0, (y - 0.01) / 64.0],
                    high: [(x + 0.01) / 64.0, (y + 0.01) / 64.0],
                    depth: 0.0,
                };
                assert!(
                    boxes.screen_box(hit.instance).overlaps(&pixel),
                    "{name}: {:?}",
                    rays[i]
                );
            }
        }
    }
}

fn balls(places: &[DVec3]) -> Scene {
    let geometry = Geometry::Shape(Shape::Sphere(Sphere::UNIT));
    let placed = places.iter().map(|&p| (0, DAffine3::from_translation(p)));
    scenes::scene(vec![geometry], placed.collect())
}

#[test]
fn objects_behind_or_around_the_camera_have_empty_or_full_boxes() {
    let scene = balls(&[
        DVec3::new(0.0, 0.0, 5.0),
        DVec3::new(0.0, 0.0, 0.5),
        DVec3::new(0.0, 0.0, -5.0),
    ]);
    let right_angle = Projection::Perspective {
        y_fov: std::f64::consts::FRAC_PI_2,
        aspect: None,
    };
    let view = camera(right_angle, DVec3::ZERO, -DVec3::Z, 0.0).view(100, 100);
    let boxes = ScreenBounds::new(&scene, &view).unwrap();
    assert!(boxes.screen_box(0).is_nowhere());
    let around = boxes.screen_box(1);
    assert!(around.low[0] <= 0.0 && around.low[1] <= 0.0 && around.high[0] >= 1.0 && around.high[1] >= 1.0);
    // The cube around the ball begins in depth 4, where the film is 8 wide: 1/8 either way from its middle.
    let ahead = boxes.screen_box(2);
    for (found, expected) in [(ahead.low, 0.375), (ahead.high, 0.625)] {
        assert!(
            (found[0] - expected).abs() < 1e-5 && (found[1] - expected).abs() < 1e-5,
            "{ahead:?}"
        );
    }
    assert!(ahead.depth <= 4.0 && ahead.depth > 3.9999);
    let beyond = camera(right_angle, DVec3::ZERO, -DVec3::Z, 6.5).view(100, 100);
    let boxes = ScreenBounds::new(&scene, &beyond).unwrap();
    assert!(boxes.screen_box(2).is_nowhere());
}

#[test]
fn orthographic_camera_bounds_a_sphere_by_its_square() {
    let scene = balls(&[DVec3::new(1.0, 0.0, -5.0)]);
    let parallel = Projection::Orthographic {
        y_mag: 4.0,
        x_mag: None,
    };
    let view = camera(parallel, DVec3::ZERO, -DVec3::Z, 0.0).view(100, 100);
    let film = ScreenBounds::new(&scene, &view).unwrap().screen_box(0);
    // From 0 to 2 of -4 to 4.
    assert!(
        (film.low[0] - 0.5).abs() < 1e-5 && (film.high[0] - 0.75).abs() < 1e-5,
        "{film:?}"
    );
    assert!((film.depth - 4.0).abs() < 1e-4, "{film:?}");
}

#[test]
fn camera_with_tiny_field_of_view_has_no_projection() {
    let scene = balls(&[DVec3::ZERO]);
    let hair = Projection::Perspective {
        y_fov: 1e-4,
        aspect: None,
    };
    let view = camera(hair, DVec3::new(5.0, 4.0, 9.0), DVec3::ZERO, 0.0).view(100, 100);
    assert!(ScreenBounds::new(&scene, &view).is_none());
}

#[test]
fn tight_and_centroid_spheres_contain_all_points() {
    let seed = 5;
    let mut random = SplitMix64(seed);
    for count in [1, 3, 40, 3000] {
        // More points on one side pull the centroid there.
        let points: Vec<DVec3> = (0..count)
            .map(|_| {
                let p = random.in_cube();
                DVec3::new(p.x * p.x, p.y, 0.2 * p.z) + DVec3::new(3.0, -7.0, 1.0)
            })
            .collect();
        let (tight, centroid) = (
            SphereVolume::smallest(&points),
            SphereVolume::of_centroid(&points),
        );
        assert!(tight.radius() <= centroid.radius(), "seed {seed}");
        let ball = BoundingSphere::smallest(&points);
        assert!(
            ball.radius <= tight.radius() && points.iter().all(|p| p.distance(ball.center) <= ball.radius)
        );
    }
}

#[test]
fn empty_scene_and_invalid_rays_are_handled() {
    let empty = Scene::default();
    let list = ListAccel::new(&empty, BoundingVolumeKind::Chosen);
    let good = Ray::new(Vec3::ZERO, Vec3::X);
    let bad = Ray::new(Vec3::NAN, Vec3::X);
    assert_eq!(nearest(&list, &[good, bad]), [None, None]);
    let view = camera(
        Projection::Orthographic {
            y_mag: 1.0,
            x_mag: None,
        },
        DVec3::ZERO,
        DVec3::Z,
        0.0,
    )
    .view(8, 8);
    let projected =
        TileCulledAccel::new(&empty, &view, &list, BoundingVolumeKind::Chosen, ListLimits::NONE).unwrap();
    assert_eq!(nearest(&projected, &[good, bad]), [None, None]);
    assert_eq!(nearest(&projected, &[bad]), [None]);
}
