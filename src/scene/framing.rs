//! Framing of a scene: the position of a camera of a given orientation from which the scene's projection fills a part
//! of the image.
//!
//! A point p, in camera axes, is projected into a square frame of slope s around an eye e if |p.x - e.x| <= s (e.z -
//! p.z) and |p.y - e.y| <= s (e.z - p.z). Each side of the frame is thus a plane through the eye, and the plane
//! touches the scene where `±p.x + s p.z` or `±p.y + s p.z` is largest. Four maxima over the scene's points determine the
//! nearest eye exactly, without iteration and without a sphere or a box around the scene.

use glam::{DMat3, DVec3};

use super::{Geometry, Instance, Scene};
use crate::mesh::{Mesh, PointCloud};
use crate::numeric::Bounds;
use crate::parallel;

/// Largest values over a set of points, in camera axes, of the left-hand sides of the four planes of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct FrameReach {
    /// Largest `p.x + s p.z`.
    right: f64,
    /// Largest `-p.x + s p.z`.
    left: f64,
    /// Largest `p.y + s p.z`.
    up: f64,
    /// Largest `-p.y + s p.z`.
    down: f64,
}

impl FrameReach {
    /// Reach of no points: the identity of [`FrameReach::union`].
    const EMPTY: FrameReach = FrameReach {
        right: f64::NEG_INFINITY,
        left: f64::NEG_INFINITY,
        up: f64::NEG_INFINITY,
        down: f64::NEG_INFINITY,
    };

    /// Returns the reach of points in camera axes in a frame of slope `slope`.
    fn of_points(points: impl Iterator<Item = DVec3>, slope: f64) -> FrameReach {
        points.fold(FrameReach::EMPTY, |reach, p| FrameReach {
            right: reach.right.max(p.x + slope * p.z),
            left: reach.left.max(-p.x + slope * p.z),
            up: reach.up.max(p.y + slope * p.z),
            down: reach.down.max(-p.y + slope * p.z),
        })
    }

    /// Returns the reach of both sets of points together.
    fn union(self, other: FrameReach) -> FrameReach {
        FrameReach {
            right: self.right.max(other.right),
            left: self.left.max(other.left),
            up: self.up.max(other.up),
            down: self.down.max(other.down),
        }
    }

    /// Returns the reach with every side moved outwards by `distance`.
    fn widened(self, distance: f64) -> FrameReach {
        FrameReach {
            right: self.right + distance,
            left: self.left + distance,
            up: self.up + distance,
            down: self.down + distance,
        }
    }

    /// Returns the nearest eye in camera axes whose frame of slope `slope` contains the points; `None` without points.
    fn eye(&self, slope: f64) -> Option<DVec3> {
        // The sides of the wider direction touch the points; those of the other are equally far from them
        let distance = (self.right + self.left).max(self.up + self.down) / (2.0 * slope);
        let eye = DVec3::new(
            0.5 * (self.right - self.left),
            0.5 * (self.up - self.down),
            distance,
        );
        eye.is_finite().then_some(eye)
    }
}

/// Number of triangles whose vertices, or of points, that are projected at a time.
const CHUNK: usize = 1 << 14;

impl Scene {
    /// Returns the position in world space from which a camera with the given `axes` sees everything finite in the
    /// scene within the square frame of slope `slope`, as near as possible; `None` if nothing is finite.
    ///
    /// `object_bounds` are the bounds of the geometries. Meshes are framed by their vertices, point clouds by
    /// their spheres, analytic shapes, volumes and moving objects by the corners of their bounds.
    pub(super) fn framing_eye(&self, object_bounds: &[Bounds], axes: DMat3, slope: f64) -> Option<DVec3> {
        let camera_from_world = axes.transpose();
        let reach_of = |bounds: &Bounds| {
            let corners = bounds.corners().map(|p| camera_from_world * p);
            FrameReach::of_points(corners.into_iter(), slope)
        };
        let volumes = self.volume_bounds();
        let mut reach = match volumes.is_empty() {
            true => FrameReach::EMPTY,
            false => reach_of(&volumes),
        };
        for instance in &self.instances {
            let geometry = &self.geometries[instance.geometry as usize];
            let bounds = &object_bounds[instance.geometry as usize];
            if geometry.is_unbounded() || bounds.is_empty() {
                continue;
            }
            // The corners suffice where they do not exceed what is framed already
            let of_corners = match instance.is_moving() {
                true => reach_of(&instance.world_bounds(geometry, bounds)),
                false => reach_of_corners(instance, bounds, camera_from_world, slope),
            };
            if reach.union(of_corners) == reach {
                continue;
            }
            reach = reach.union(match geometry {
                Geometry::Mesh(mesh) if !instance.is_moving() => {
                    reach_of_vertices(mesh, instance, camera_from_world, slope)
                }
                Geometry::Points(cloud) if !instance.is_moving() => {
                    reach_of_spheres(cloud, instance, camera_from_world, slope)
                }
                _ => of_corners,
            });
        }
        Some(axes * reach.eye(slope)?)
    }
}

/// Returns the reach of the corners of an instance's bounds in object space.
fn reach_of_corners(
    instance: &Instance,
    bounds: &Bounds,
    camera_from_world: DMat3,
    slope: f64,
) -> FrameReach {
    let world_from_object = instance.world_from_object();
    let corners = bounds.corners();
    let projected = corners.map(|p| camera_from_world * world_from_object.transform_point3(p));
    FrameReach::of_points(projected.into_iter(), slope)
}

/// Returns the reach of the vertices of a mesh that some triangle uses, in parallel.
fn reach_of_vertices(mesh: &Mesh, instance: &Instance, camera_from_world: DMat3, slope: f64) -> FrameReach {
    let world_from_object = instance.world_from_object();
    let chunks = parallel::map_chunks(&mesh.triangles, CHUNK, &|_, triangles| {
        let vertices = triangles.as_flattened().iter().map(|&vertex| {
            let p = glam::Vec3::from(mesh.positions[vertex as usize]).as_dvec3();
            camera_from_world * world_from_object.transform_point3(p)
        });
        FrameReach::of_points(vertices, slope)
    });
    chunks.into_iter().fold(FrameReach::EMPTY, FrameReach::union)
}

/// Returns the reach of the spheres of a point cloud, in parallel; a stretched sphere counts by its longest axis.
fn reach_of_spheres(
    cloud: &PointCloud,
    instance: &Instance,
    camera_from_world: DMat3,
    slope: f64,
) -> FrameReach {
    let world_from_object = instance.world_from_object();
    let columns = [0, 1, 2].map(|axis| world_from_object.matrix3.col(axis).length());
    // The plane of a side has the normal (1, slope), by whose length it moves farther than the radius
    let radius = cloud.radius * columns.into_iter().fold(0.0, f64::max) * slope.hypot(1.0);
    let chunks = parallel::map_chunks(&cloud.positions, CHUNK, &|_, positions| {
        let centers = positions.iter().map(|&position| {
            let p = glam::Vec3::from(position).as_dvec3();
            camera_from_world * world_from_object.transform_point3(p)
        });
        FrameReach::of_points(centers, slope)
    });
    chunks
        .into_iter()
        .fold(FrameReach::EMPTY, FrameReach::union)
        .widened(radius)
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;
    use crate::buffer::Buffer;
    use crate::shape::{Shape, Sphere};

    /// Returns a scene of one mesh whose vertices are `points`.
    fn mesh_scene(points: &[[f32; 3]]) -> Scene {
        let count = points.len() as u32;
        let mesh = Mesh {
            positions: Buffer::from(points.to_vec()),
            triangles: Buffer::from((0..count - 2).map(|i| [i, i + 1, i + 2]).collect::<Vec<_>>()),
            ..Mesh::default()
        };
        Scene {
            geometries: vec![Geometry::Mesh(mesh)],
            instances: vec![Instance::new("a", 0, 0, DAffine3::IDENTITY).unwrap()],
            ..Scene::default()
        }
    }

    fn eye(scene: &Scene, axes: DMat3, slope: f64) -> Option<DVec3> {
        let bounds: Vec<Bounds> = scene.geometries.iter().map(Geometry::bounds).collect();
        scene.framing_eye(&bounds, axes, slope)
    }

    #[test]
    fn square_touches_the_frame_at_the_hand_computed_distance() {
        // A square of side 2 around (1, 2, 3), seen along -z: it touches a frame of slope 1/2 at a distance of 2.
        let square = [[0.0, 1.0, 3.0], [2.0, 1.0, 3.0], [0.0, 3.0, 3.0], [2.0, 3.0, 3.0]];
        let found = eye(&mesh_scene(&square), DMat3::IDENTITY, 0.5).unwrap();
        assert_eq!(found, DVec3::new(1.0, 2.0, 5.0));
        // Twice as wide: at twice the distance from the same centre line
        let wide = [
            [-1.0, 1.0, 3.0],
            [3.0, 1.0, 3.0],
            [-1.0, 3.0, 3.0],
            [3.0, 3.0, 3.0],
        ];
        let found = eye(&mesh_scene(&wide), DMat3::IDENTITY, 0.5).unwrap();
        assert_eq!(found, DVec3::new(1.0, 2.0, 7.0));
    }

    #[test]
    fn near_points_count_more_than_far_ones() {
        // Points at x = ±1 in the plane z = 0 and at x = 0, y = ±0.5 in the plane z = 1. With slope 1/2 the first need
        // an eye at z = 2, and the second one at z = 1 + 1 = 2, so all four touch.
        let points = [
            [-1.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 0.5, 1.0],
            [0.0, -0.5, 1.0],
        ];
        assert_eq!(
            eye(&mesh_scene(&points), DMat3::IDENTITY, 0.5),
            Some(DVec3::new(0.0, 0.0, 2.0))
        );
    }

    #[test]
    fn shape_is_framed_by_its_box_and_nothing_by_nothing() {
        let sphere = Sphere {
            center: DVec3::ZERO,
            radius: 1.0,
        };
        let mut scene = Scene {
            geometries: vec![Geometry::Shape(Shape::Sphere(sphere))],
            instances: vec![Instance::new("a", 0, 0, DAffine3::from_scale(DVec3::splat(2.0))).unwrap()],
            ..Scene::default()
        };
        // The front face of the box of side 4 lies at z = 2, and needs a distance of 2 / 1.
        assert_eq!(eye(&scene, DMat3::IDENTITY, 1.0), Some(DVec3::new(0.0, 0.0, 4.0)));
        scene.geometries = vec![Geometry::Shape(Shape::Plane)];
        assert_eq!(eye(&scene, DMat3::IDENTITY, 1.0), None);
    }

    #[test]
    fn instance_inside_the_frame_changes_nothing() {
        let square = [
            [-1.0, -1.0, 0.0],
            [1.0, -1.0, 0.0],
            [-1.0, 1.0, 0.0],
            [1.0, 1.0, 0.0],
        ];
        let mut scene = mesh_scene(&square);
        let alone = eye(&scene, DMat3::IDENTITY, 0.5);
        let behind = DAffine3::from_translation(DVec3::new(0.0, 0.0, -1.0));
        scene.instances.push(Instance::new("b", 0, 0, behind).unwrap());
        assert_eq!(eye(&scene, DMat3::IDENTITY, 0.5), alone);
        // In front of it by 1, the same square needs the eye in front of it by 1, too
        let before = DAffine3::from_translation(DVec3::Z);
        scene.instances.push(Instance::new("c", 0, 0, before).unwrap());
        assert_eq!(eye(&scene, DMat3::IDENTITY, 0.5), alone.map(|eye| eye + DVec3::Z));
    }
}
