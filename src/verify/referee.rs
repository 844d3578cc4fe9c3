//! Brute force that passes over what a ray surely misses, and gives the same answers.

use glam::DVec3;

use crate::accel::Hit;
use crate::accel::brute::BruteAccel;
use crate::mesh::Mesh;
use crate::numeric::{Bounds, Ray};
use crate::scene::{Geometry, Instance, Scene};

/// Triangles that are passed over together: as many as a box has, or about.
const TOGETHER: usize = 12;

/// What a line may pass a ball by and yet be said to meet a triangle in it, as a share of the coordinates: far more than
/// the few roundings of 2^-24 of a test in f32.
const SLACK: f64 = 1.0 / (1 << 16) as f64;

/// The nearest hits of a scene.
pub(super) struct Referee {
    groups: Vec<Group>,
}

/// Some primitives of an instance, in a ball.
struct Group {
    center: DVec3,
    radius: f64,
    /// They alone.
    scene: Scene,
    instance: u32,
    /// The number of the first in the whole scene.
    first: u32,
}

impl Referee {
    /// Takes a scene apart: meshes that stand unmoved into groups of neighbours, all else as it is.
    pub(super) fn new(scene: &Scene) -> Referee {
        let mut groups = Vec::new();
        for (number, instance) in scene.instances.iter().enumerate() {
            let geometry = &scene.geometries[instance.geometry as usize];
            match geometry {
                Geometry::Mesh(mesh) if instance.is_identity() => {
                    groups.extend(parts(mesh, number as u32, instance));
                }
                // Never passed over.
                _ => groups.push(Group {
                    center: DVec3::ZERO,
                    radius: f64::INFINITY,
                    scene: alone(geometry.clone(), instance),
                    instance: number as u32,
                    first: 0,
                }),
            }
        }
        Referee { groups }
    }

    /// The nearest hit of one ray, the one of brute force.
    pub(super) fn nearest(&self, ray: &Ray) -> Option<Hit> {
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let mut best: Option<Hit> = None;
        for group in self.groups.iter().filter(|group| !group.is_missed(o, d)) {
            let Some(hit) = BruteAccel::new(&group.scene).nearest(ray) else {
                continue;
            };
            let hit = Hit {
                instance: group.instance,
                primitive: group.first + hit.primitive,
                ..hit
            };
            let rank = |hit: &Hit| (hit.instance, hit.primitive);
            if best.is_none_or(|best| hit.t < best.t || hit.t == best.t && rank(&hit) < rank(&best)) {
                best = Some(hit);
            }
        }
        best
    }
}

impl Group {
    /// Whether the line `o + t d` surely passes by.
    fn is_missed(&self, o: DVec3, d: DVec3) -> bool {
        let f = self.center - o;
        let reach = self.radius + SLACK * (f.abs().element_sum() + self.radius);
        // What is no number is not passed over.
        f.cross(d).length_squared() > reach * reach * d.length_squared()
    }
}

fn alone(geometry: Geometry, instance: &Instance) -> Scene {
    let mut instance = instance.clone();
    instance.geometry = 0;
    Scene {
        geometries: vec![geometry],
        instances: vec![instance],
        ..Scene::default()
    }
}

fn parts(mesh: &Mesh, number: u32, instance: &Instance) -> Vec<Group> {
    let faces: Vec<[u32; 3]> = mesh.triangles.iter().copied().collect();
    let part = |(chunk, faces): (usize, &[[u32; 3]])| {
        let corners = |p: u32| DVec3::from_array(mesh.positions[p as usize].map(f64::from));
        let bounds = Bounds::of_points(faces.iter().flatten().map(|&p| corners(p)));
        let part = Mesh {
            triangles: faces.to_vec().into(),
            ..mesh.clone()
        };
        Group {
            center: bounds.center(),
            radius: 0.5 * bounds.extent().length(),
            scene: alone(Geometry::Mesh(part), instance),
            instance: number,
            first: (chunk * TOGETHER) as u32,
        }
    };
    faces.chunks(TOGETHER).enumerate().map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;
    use crate::shape::{Shape, Sphere};
    use crate::verify::meshes::{icosphere, lattice_cube, scene};

    #[test]
    fn the_referee_gives_the_answers_of_brute_force() {
        let ball = Sphere {
            center: DVec3::new(2.5, 0.0, 0.0),
            radius: 1.0,
        };
        let scene = scene(vec![
            Geometry::Mesh(icosphere(2)),
            Geometry::Shape(Shape::Sphere(ball)),
            Geometry::Mesh(lattice_cube(3)),
        ]);
        let (referee, brute) = (Referee::new(&scene), BruteAccel::new(&scene));
        let seed = 11;
        let mut random = SplitMix64::new(seed, 0);
        let mut met = 0;
        for _ in 0..20_000 {
            let origin = (4.0 * random.in_cube()).as_vec3();
            let corner = (3.0 * random.in_cube()).round();
            let anywhere = 2.0 * random.in_cube();
            let target = random.pick(&[corner, anywhere]);
            let ray = Ray::new(origin, (target - origin.as_dvec3()).as_vec3());
            let hit = referee.nearest(&ray);
            assert_eq!(hit, brute.nearest(&ray), "seed {seed}: {ray:?}");
            met += usize::from(hit.is_some());
        }
        assert!(met > 5000, "{met}");
    }
}
