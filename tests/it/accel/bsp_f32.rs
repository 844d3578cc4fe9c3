//! The BSP in f32 alone: as right as f32 on well-shaped triangles, and no more than that on slivers.

use crate::support::scenes::{self, SplitMix64};
use glam::Vec3;
use whit::accel::bsp::BspAccel;
use whit::accel::hit_compare::{HitComparison, compare};
use whit::accel::{Accel, AccelOptions, Coherence, Kernel, Precision, RayPacket};
use whit::numeric::{Ray, spawn_point, triangle_spawn_error};
use whit::scene::Scene;

/// A triangle of a world and how many times as long it is as high.
const ASPECT: f64 = 1e4;

fn tree(scene: &Scene, precision: Precision, kernel: Kernel) -> BspAccel<'_> {
    let options = AccelOptions {
        precision,
        kernel,
        threads: 1,
        ..AccelOptions::default()
    };
    BspAccel::build(scene, &options).unwrap()
}

/// A sliver, and a ray that leaves it as new rays do.
fn sliver(random: &mut SplitMix64) -> ([Vec3; 3], Ray) {
    let (a, along) = (random.in_cube(), random.in_cube());
    let across = along.cross(random.in_cube()).normalize() * along.length() / ASPECT;
    let corners = [a, a + along, a + random.next() * along + across].map(|p| p.as_vec3());
    let [a, b, c] = corners.map(|p| p.as_dvec3());
    let normal = (b - a).cross(c - a).normalize();
    let (u, v) = (0.8 * random.next(), 0.2 * random.next());
    let error = triangle_spawn_error(corners[0], corners[1] - corners[0], corners[2] - corners[0]);
    let origin = spawn_point(a + u * (b - a) + v * (c - a), normal, error.along(normal));
    let direction = normal + 2.0 * random.on_sphere().cross(normal);
    (corners, Ray::new(origin, direction.as_vec3()))
}

#[test]
fn slivers_self_shadow_in_f32_but_not_in_f64() {
    let mut random = SplitMix64(29);
    let mut blocked = [0; 2];
    for _ in 0..2000 {
        let (corners, ray) = sliver(&mut random);
        let scene = scenes::baked(scenes::mesh(
            corners.map(|p| p.to_array()).to_vec(),
            vec![[0, 1, 2]],
        ));
        for (count, precision) in blocked.iter_mut().zip([Precision::Fast, Precision::Watertight]) {
            let mut packets = [RayPacket::EMPTY];
            packets[0].set(0, &ray);
            tree(&scene, precision, Kernel::Packet).occluded(&mut packets, Coherence::Incoherent);
            *count += u32::from(packets[0].is_blocked(0));
        }
    }
    let [in_f32, in_f64] = blocked;
    assert!(in_f32 > 0 && in_f64 == 0, "{blocked:?}");
}

#[test]
fn well_shaped_triangles_in_f32_agree_with_f64() {
    let scene = scenes::baked(scenes::bumpy_sphere(40));
    let rays = scenes::camera_rays(&scene, 64);
    let hits = |precision, kernel, order| {
        let mut packets = scenes::packets(&rays);
        let tree = tree(&scene, precision, kernel);
        tree.intersect(&mut packets, order);
        assert_eq!(
            tree.report().summary.contains("f32"),
            precision == Precision::Fast
        );
        let all = packets
            .into_iter()
            .flat_map(|packet| std::array::from_fn::<_, 16, _>(|lane| packet.hit(lane)));
        all.take(rays.len()).collect::<Vec<_>>()
    };
    let right = hits(Precision::Watertight, Kernel::Packet, Coherence::Coherent);
    assert_eq!(
        right,
        hits(Precision::Robust, Kernel::Packet, Coherence::Coherent)
    );
    for (kernel, order) in [
        (Kernel::Packet, Coherence::Coherent),
        (Kernel::Packet, Coherence::Incoherent),
        (Kernel::Single, Coherence::Coherent),
    ] {
        let found = hits(Precision::Fast, kernel, order);
        assert!(found.iter().flatten().count() > 500);
        for ((ray, right), found) in rays.iter().zip(&right).zip(found) {
            assert_ne!(
                compare(&scene, ray, *right, found),
                HitComparison::Wrong,
                "{ray:?}"
            );
        }
    }
}
