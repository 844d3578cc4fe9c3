//! Brute-force reference that culls groups of primitives, with results identical to plain brute force.

use glam::DVec3;

use crate::accel::Hit;
use crate::accel::brute::BruteAccel;
use crate::mesh::Mesh;
use crate::numeric::{Bounds, Ray};
use crate::scene::{Geometry, Instance, Scene};

/// Triangles of a group that is culled as a whole: about as many as a box has.
const GROUP_SIZE: usize = 12;

/// Distance at which a line may pass a bounding sphere and still be reported as hitting a triangle in it, as a share of
/// the coordinates: far more than the few roundings of 2^-24 of a test in f32.
const SLACK: f64 = 1.0 / (1 << 16) as f64;

/// Nearest-hit reference of a scene.
pub(in crate::verify) struct Reference {
    groups: Vec<CheckGroup>,
}

/// Primitives of one instance with their bounding sphere.
struct CheckGroup {
    center: DVec3,
    radius: f64,
    /// Scene that contains only these primitives.
    scene: Scene,
    instance: u32,
    /// Number of the group's first primitive in the whole scene.
    first: u32,
}

impl Reference {
    /// Splits a scene: meshes with identity transform into groups of consecutive triangles, all other geometries as a
    /// whole.
    pub(in crate::verify) fn new(scene: &Scene) -> Reference {
        let mut groups = Vec::new();
        for (number, instance) in scene.instances.iter().enumerate() {
            let geometry = &scene.geometries[instance.geometry as usize];
            match geometry {
                // Split meshes whose object space is world space
                Geometry::Mesh(mesh) if instance.is_identity() => {
                    groups.extend(triangle_groups(mesh, number as u32, instance));
                }
                // Never cull shapes and transformed meshes
                _ => groups.push(CheckGroup {
                    center: DVec3::ZERO,
                    radius: f64::INFINITY,
                    scene: single_geometry_scene(geometry.clone(), instance),
                    instance: number as u32,
                    first: 0,
                }),
            }
        }
        Reference { groups }
    }

    /// Returns the nearest hit of one ray, identical to that of brute force.
    pub(in crate::verify) fn nearest(&self, ray: &Ray) -> Option<Hit> {
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let mut best: Option<Hit> = None;
        // Trace the groups that the ray may hit
        for group in self.groups.iter().filter(|group| !group.is_missed(o, d)) {
            let Some(hit) = BruteAccel::new(&group.scene).nearest(ray) else {
                continue;
            };
            // Map the hit to the numbers of the whole scene
            let hit = Hit {
                instance: group.instance,
                primitive: group.first + hit.primitive,
                ..hit
            };
            // Break ties at equal t by the lower number, as brute force does
            let rank = |hit: &Hit| (hit.instance, hit.primitive);
            if best.is_none_or(|best| hit.t < best.t || hit.t == best.t && rank(&hit) < rank(&best)) {
                best = Some(hit);
            }
        }
        best
    }
}

impl CheckGroup {
    /// Returns whether the line `o + t d` certainly misses the bounding sphere.
    fn is_missed(&self, o: DVec3, d: DVec3) -> bool {
        let f = self.center - o;
        let reach = self.radius + SLACK * (f.abs().element_sum() + self.radius);
        // A comparison with NaN is false, so such rays are never culled.
        f.cross(d).length_squared() > reach * reach * d.length_squared()
    }
}

fn single_geometry_scene(geometry: Geometry, instance: &Instance) -> Scene {
    let mut instance = instance.clone();
    instance.geometry = 0;
    Scene {
        geometries: vec![geometry],
        instances: vec![instance],
        ..Scene::default()
    }
}

fn triangle_groups(mesh: &Mesh, number: u32, instance: &Instance) -> Vec<CheckGroup> {
    let faces: Vec<[u32; 3]> = mesh.triangles.iter().copied().collect();
    let part = |(chunk, faces): (usize, &[[u32; 3]])| {
        let corners = |p: u32| DVec3::from_array(mesh.positions[p as usize].map(f64::from));
        let bounds = Bounds::of_points(faces.iter().flatten().map(|&p| corners(p)));
        let part = Mesh {
            triangles: faces.to_vec().into(),
            ..mesh.clone()
        };
        CheckGroup {
            center: bounds.center(),
            radius: 0.5 * bounds.extent().length(),
            scene: single_geometry_scene(Geometry::Mesh(part), instance),
            instance: number,
            first: (chunk * GROUP_SIZE) as u32,
        }
    };
    faces.chunks(GROUP_SIZE).enumerate().map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::super::test_meshes::{icosphere, lattice_cube, scene};
    use super::*;
    use crate::numeric::SplitMix64;
    use crate::shape::{Shape, Sphere};

    #[test]
    fn reference_results_equal_brute_force() {
        let ball = Sphere {
            center: DVec3::new(2.5, 0.0, 0.0),
            radius: 1.0,
        };
        let scene = scene(vec![
            Geometry::Mesh(icosphere(2)),
            Geometry::Shape(Shape::Sphere(ball)),
            Geometry::Mesh(lattice_cube(3)),
        ]);
        let (referee, brute) = (Reference::new(&scene), BruteAccel::new(&scene));
        let seed = 11;
        let mut random = SplitMix64::new(seed, 0);
        let mut hit_count = 0;
        for _ in 0..20_000 {
            let origin = (4.0 * random.in_cube()).as_vec3();
            let corner = (3.0 * random.in_cube()).round();
            let anywhere = 2.0 * random.in_cube();
            let target = random.choose(&[corner, anywhere]);
            let ray = Ray::new(origin, (target - origin.as_dvec3()).as_vec3());
            let hit = referee.nearest(&ray);
            assert_eq!(hit, brute.nearest(&ray), "seed {seed}: {ray:?}");
            hit_count += usize::from(hit.is_some());
        }
        assert!(hit_count > 5000, "{hit_count}");
    }
}
