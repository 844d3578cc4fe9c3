//! Scenes and rays for tests.

use crate::accel::brute::BruteAccel;
use crate::accel::{LANES, RayPacket};
use crate::mesh::Mesh;
use crate::mesh::simd::SimdLimit;
use crate::numeric::Ray;
use crate::scene::{Geometry, Instance, Material, Scene};
use glam::{DAffine3, Vec3};

/// Instruction set of tests: the best of this machine.
pub(super) const BEST: SimdLimit = SimdLimit::Avx512;

/// Pseudo-random numbers of a linear congruential generator.
pub(super) struct RandomNumbers(pub(super) u64);

impl RandomNumbers {
    /// Returns a number in [0, 1).
    pub(super) fn next(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Returns a vector in the cube [-1, 1]³.
    pub(super) fn vector(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next()) * 2.0 - Vec3::ONE
    }
}

/// Returns a scene of one mesh.
pub(in crate::accel) fn baked(mesh: Mesh) -> Scene {
    Scene {
        geometries: vec![Geometry::Mesh(mesh)],
        instances: vec![Instance::new("mesh", 0, 0, DAffine3::IDENTITY).unwrap()],
        materials: vec![Material::default()],
        ..Scene::default()
    }
}

/// Returns the reference of a scene, which tests every triangle.
pub(super) fn brute_force(scene: &Scene) -> BruteAccel<'_> {
    BruteAccel::new(scene.validate().unwrap().get())
}

/// Returns packets of incoherent rays, some lanes inactive.
pub(super) fn random_packets(count: usize, seed: u64) -> Vec<RayPacket> {
    let mut random = RandomNumbers(seed);
    let mut packets = vec![RayPacket::EMPTY; count];
    for packet in &mut packets {
        for lane in 0..LANES {
            let mut ray = Ray::new(random.vector() * 2.0, random.vector());
            ray.t_near = 0.1 * random.next();
            ray.t_far = if random.next() < 0.5 {
                f32::INFINITY
            } else {
                ray.t_near + 4.0 * random.next()
            };
            if random.next() < 0.9 {
                packet.set(lane, &ray);
            }
        }
    }
    packets
}
