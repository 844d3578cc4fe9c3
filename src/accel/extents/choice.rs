//! Cost model that chooses the bounding volume of an object: the cost of tests is measured, their benefit estimated.
//!
//! The expected time of a ray at an object is `C(volume) + P(volume) C(object)`. The costs are nanoseconds, measured
//! here on the objects themselves; P is the fraction of the lines through the scene that hit the volume, which for
//! convex bodies is the ratio of their surfaces (Goldsmith and Salmon, "Automatic creation of object hierarchies for
//! ray tracing", 1987). Timings differ from run to run, and so may choices: they change no result.

use std::hint::black_box;
use std::time::Instant;

use glam::DVec3;

use super::ball::BoundingSphere;
use super::candidates::Candidates;
use super::guard::HitError;
use super::hull::HullPoints;
use super::kind::BoundingVolumeKind;
use super::object::BoundedObject;
use super::rays::RayLanes;
use super::shape::{BoundingVolume, BoxVolume, SphereVolume};
use crate::accel::brute::nearest_of;
use crate::accel::{LANES, RayPacket};
use crate::mesh::simd::{SimdKernel, SimdLevel, dispatch};
use crate::numeric::{Bounds, Ray};
use crate::scene::{Geometry, Instance, Scene};

/// Number of volume tests that are timed together.
const EXTENT_TESTS: usize = 256;
/// Number of rays that are timed against an object.
const OBJECT_RAYS: usize = 64;
/// Maximum number of triangles of a mesh that are timed; all cost the same.
const MAX_TRIANGLES: usize = 256;
/// Number of timings, of which the shortest counts: interruptions only add time.
const TIMINGS: usize = 3;

/// Measured costs of tests, in nanoseconds per ray.
pub(super) struct Costs {
    of_box: f64,
    of_sphere: f64,
    /// Cost of testing an object, by geometry.
    of_object: Vec<f64>,
    /// Surface area of the scene's bounding box.
    scene_area: f64,
}

impl Costs {
    /// Times the tests of volumes, and every geometry in its first instance.
    pub(super) fn measure(scene: &Scene, hulls: &[Option<HullPoints>]) -> Costs {
        let mut first = vec![None; scene.geometries.len()];
        for instance in &scene.instances {
            first[instance.geometry as usize].get_or_insert(instance);
        }
        let of_object = first
            .iter()
            .zip(hulls)
            .enumerate()
            .map(|(index, (instance, hull))| match (instance, hull) {
                (Some(instance), Some(hull)) => object_cost(&scene.geometries[index], instance, hull),
                _ => 0.0,
            })
            .collect();
        let [of_box, of_sphere] = extent_costs();
        Costs {
            of_box,
            of_sphere,
            of_object,
            scene_area: surface(&scene.bounds()),
        }
    }

    /// Returns the kind of volume with which an object of that geometry is cheapest.
    pub(super) fn cheapest(&self, geometry: u32, candidates: &Candidates) -> BoundingVolumeKind {
        let object = self.of_object[geometry as usize];
        let with = |cost: f64, area: f64| cost + (area / self.scene_area).min(1.0) * object;
        let mut best = (BoundingVolumeKind::None, object);
        for (kind, cost) in [
            (
                BoundingVolumeKind::TightSphere,
                with(self.of_sphere, candidates.tight.area()),
            ),
            (
                BoundingVolumeKind::CentroidSphere,
                with(self.of_sphere, candidates.centroid.area()),
            ),
            (
                BoundingVolumeKind::Box,
                with(self.of_box, candidates.bounds.area()),
            ),
        ] {
            if cost < best.1 {
                best = (kind, cost);
            }
        }
        best.0
    }
}

/// Returns the nanoseconds for one ray and the only object of a scene.
fn nearest_ns(scene: &Scene, rays: &[Ray]) -> f64 {
    let ns = shortest(|| {
        for ray in rays {
            let mut best = None;
            nearest_of(scene, 0, ray, &mut best);
            black_box(best);
        }
    });
    ns / rays.len() as f64
}

/// Returns a scene with one object.
fn alone(geometry: &Geometry, instance: &Instance) -> Scene {
    let mut placed = instance.clone();
    placed.geometry = 0;
    Scene {
        geometries: vec![geometry.clone()],
        instances: vec![placed],
        ..Scene::default()
    }
}

/// Returns the shortest of a few timings of `work`, in nanoseconds.
fn shortest(mut work: impl FnMut()) -> f64 {
    let time = |_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64() * 1e9
    };
    (0..TIMINGS).map(time).fold(f64::INFINITY, f64::min)
}

/// Returns the nanoseconds for one ray and one box, and for one ray and one sphere.
fn extent_costs() -> [f64; 2] {
    let mut packet = RayPacket::EMPTY;
    for lane in 0..LANES {
        packet.set(lane, &Ray::new(glam::Vec3::splat(lane as f32), glam::Vec3::ONE));
    }
    let bounds = Bounds {
        min: DVec3::ZERO,
        max: DVec3::ONE,
    };
    let ball = BoundingSphere {
        center: DVec3::ZERO,
        radius: 1.0,
    };
    let object = |extent| BoundedObject { instance: 0, extent };
    [
        BoundingVolume::Box(BoxVolume::new(&bounds, &HitError::NONE)),
        BoundingVolume::Sphere(SphereVolume::new(&ball, &HitError::NONE)),
    ]
    .map(|extent| {
        let objects: Vec<BoundedObject> = (0..EXTENT_TESTS).map(|_| object(extent)).collect();
        let ns = shortest(|| {
            black_box(dispatch(Calibration {
                packet: &packet,
                objects: &objects,
            }));
        });
        ns / (EXTENT_TESTS * LANES) as f64
    })
}

/// Timing kernel of one packet against many volumes.
struct Calibration<'a> {
    packet: &'a RayPacket,
    objects: &'a [BoundedObject],
}

impl SimdKernel for Calibration<'_> {
    type Output = u32;

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) -> u32 {
        let rays = RayLanes::new(isa, self.packet, 0.0);
        let t_far = black_box(self.packet.t_far);
        self.objects
            .iter()
            .fold(0, |mask, object| mask ^ object.hit_mask(isa, &rays, &t_far))
    }
}

/// Returns the nanoseconds for one ray and the object, for rays from all directions towards points in its box.
fn object_cost(geometry: &Geometry, instance: &Instance, hull: &HullPoints) -> f64 {
    // Time a part of a large mesh and scale the result
    let (sample, scale) = match geometry {
        Geometry::Mesh(mesh) if mesh.triangles.len() > MAX_TRIANGLES => {
            let mut part = mesh.clone();
            part.triangles = mesh.triangles[..MAX_TRIANGLES].to_vec().into();
            let scale = mesh.triangles.len() as f64 / MAX_TRIANGLES as f64;
            (Geometry::Mesh(part), scale)
        }
        Geometry::Points(cloud) if cloud.len() > MAX_TRIANGLES => {
            let mut part = cloud.clone();
            part.positions = cloud.positions[..MAX_TRIANGLES].to_vec().into();
            let scale = cloud.len() as f64 / MAX_TRIANGLES as f64;
            (Geometry::Points(part), scale)
        }
        _ => (geometry.clone(), 1.0),
    };
    let bounds = hull.object_bounds().transformed(&instance.world_from_object());
    scale * nearest_ns(&alone(&sample, instance), &rays_towards(&bounds))
}

/// Returns rays from around a box to points all over it, by a low-discrepancy sequence.
fn rays_towards(bounds: &Bounds) -> Vec<Ray> {
    // Steps of the R3 sequence (Roberts 2018): the powers of the root of x⁴ = x + 1.
    const STEPS: DVec3 = DVec3::new(0.819_172_513_4, 0.671_043_606_7, 0.549_700_477_9);
    (0..OBJECT_RAYS)
        .map(|i| {
            let place = |k: usize| (k as f64 * STEPS).fract();
            let target = bounds.min + place(i) * bounds.extent();
            let away = 2.0 * place(i + OBJECT_RAYS) - DVec3::ONE;
            let origin = bounds.center() + 4.0 * bounds.extent().length() * away.normalize_or(DVec3::X);
            Ray::new(origin.as_vec3(), (target - origin).as_vec3())
        })
        .collect()
}

/// Returns the surface area of a box.
fn surface(bounds: &Bounds) -> f64 {
    let e = bounds.extent();
    2.0 * (e.x * e.y + e.y * e.z + e.z * e.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidates(area_of_box: f64, area_of_sphere: f64) -> Candidates {
        let side = (area_of_box / 6.0).sqrt();
        let bounds = Bounds {
            min: DVec3::ZERO,
            max: DVec3::splat(side),
        };
        let ball = |area: f64| BoundingSphere {
            center: DVec3::ZERO,
            radius: (area / (4.0 * std::f64::consts::PI)).sqrt(),
        };
        Candidates {
            bounds: BoxVolume::new(&bounds, &HitError::NONE),
            centroid: SphereVolume::new(&ball(2.0 * area_of_sphere), &HitError::NONE),
            tight: SphereVolume::new(&ball(area_of_sphere), &HitError::NONE),
        }
    }

    #[test]
    fn cheapest_bounding_volume_is_chosen_if_any_pays() {
        let costs = |of_object| Costs {
            of_box: 2.0,
            of_sphere: 1.0,
            of_object: vec![of_object],
            scene_area: 100.0,
        };
        // Box 2 + 0.1 x 100 = 12, sphere 1 + 0.2 x 100 = 21.
        assert_eq!(
            costs(100.0).cheapest(0, &candidates(10.0, 20.0)),
            BoundingVolumeKind::Box
        );
        // Box 2 + 0.1 x 5 = 2.5, sphere 1 + 0.2 x 5 = 2.
        assert_eq!(
            costs(5.0).cheapest(0, &candidates(10.0, 20.0)),
            BoundingVolumeKind::TightSphere
        );
        // Sphere 1 + 0.2 x 1 = 1.2, no volume 1.
        assert_eq!(
            costs(1.0).cheapest(0, &candidates(10.0, 20.0)),
            BoundingVolumeKind::None
        );
    }

    #[test]
    fn measured_costs_are_positive() {
        assert!(extent_costs().iter().all(|ns| *ns > 0.0));
    }
}
