//! Points whose convex hull contains an object, in object space.
//!
//! A box or ball around the points contains the hull and so the object, also after any affine transform. Round shapes
//! are enclosed by a polygon of [`SIDES`] sides around their circles.

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DVec3};

use super::ball::BoundingSphere;
use super::guard::spectral_bound;
use crate::mesh::Mesh;
use crate::numeric::Bounds;
use crate::parallel;
use crate::scene::{Geometry, Scene};
use crate::shape::{Shape, Sphere};

/// Number of sides of the polygons around circles: with 32 they reach 0.5 % beyond them.
const SIDES: u32 = 32;
/// Number of points above which an instance is bounded by transformed balls instead of point by point.
const MANY_POINTS: usize = 4096;

/// Hull of a geometry with its bounds.
pub(super) struct HullPoints {
    form: HullForm,
    bounds: Bounds,
    /// Enclosing balls in object space.
    balls: Balls,
}

enum HullForm {
    Points(Vec<DVec3>),
    /// A sphere, which is its own hull.
    Sphere(Sphere),
}

/// The two enclosing balls of an object.
#[derive(Clone, Copy)]
pub(super) struct Balls {
    /// Ball around the centroid of the points.
    pub(super) centroid: BoundingSphere,
    /// Smallest ball that is known.
    pub(super) tight: BoundingSphere,
}

impl HullPoints {
    /// Computes the hull of a geometry; `None` if it is unbounded or empty.
    pub(super) fn of(geometry: &Geometry) -> Option<HullPoints> {
        let bounds = geometry.bounds();
        if geometry.is_unbounded() || bounds.is_empty() {
            return None;
        }
        Some(HullPoints::with_form(
            match geometry {
                Geometry::Mesh(mesh) => HullForm::Points(used_points(mesh)),
                Geometry::Shape(Shape::Sphere(sphere)) => HullForm::Sphere(*sphere),
                Geometry::Shape(shape) => HullForm::Points(shape_points(shape, &bounds)),
                Geometry::Points(_) => HullForm::Points(corners(&bounds).to_vec()),
            },
            bounds,
        ))
    }

    /// Computes a hull with only the box corners for meshes, which is fast for meshes of any size.
    pub(super) fn from_bounds(geometry: &Geometry) -> Option<HullPoints> {
        match geometry {
            Geometry::Shape(_) | Geometry::Points(_) => HullPoints::of(geometry),
            Geometry::Mesh(mesh) => {
                let bounds = mesh.bounds();
                (!bounds.is_empty())
                    .then(|| HullPoints::with_form(HullForm::Points(corners(&bounds).to_vec()), bounds))
            }
        }
    }

    fn with_form(form: HullForm, bounds: Bounds) -> HullPoints {
        let balls = match &form {
            HullForm::Points(points) => Balls::of(points),
            HullForm::Sphere(sphere) => {
                let ball = BoundingSphere {
                    center: sphere.center,
                    radius: sphere.radius,
                };
                Balls {
                    centroid: ball,
                    tight: ball,
                }
            }
        };
        HullPoints { form, bounds, balls }
    }

    /// Returns the bounding box in object space.
    pub(super) fn object_bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// Returns the balls in world space, up to some roundings of 2^-53 of the coordinates.
    pub(super) fn world_balls(&self, map: &DAffine3) -> Balls {
        match &self.form {
            // A stretched object has smaller balls than the stretched balls
            HullForm::Points(points) if points.len() <= MANY_POINTS && !preserves_spheres(map) => {
                let placed: Vec<DVec3> = points.iter().map(|&p| map.transform_point3(p)).collect();
                Balls::of(&placed)
            }
            _ => {
                let scale = spectral_bound(&map.matrix3);
                let placed = |ball: BoundingSphere| BoundingSphere {
                    center: map.transform_point3(ball.center),
                    radius: scale * ball.radius,
                };
                Balls {
                    centroid: placed(self.balls.centroid),
                    tight: placed(self.balls.tight),
                }
            }
        }
    }

    /// Returns the box in world space, up to some roundings of 2^-53 of the coordinates; `by_box` is the box around the
    /// transformed object-space box.
    pub(super) fn world_bounds(&self, map: &DAffine3, by_box: Bounds) -> Bounds {
        match &self.form {
            HullForm::Points(points) if points.len() <= MANY_POINTS => {
                Bounds::of_points(points.iter().map(|&p| map.transform_point3(p)))
            }
            _ => by_box,
        }
    }

    /// Returns points around the transformed object: its own if they are few, else the corners of its object-space box;
    /// for a sphere the corners of its world-space box `world`.
    pub(super) fn world_points(&self, map: &DAffine3, world: &Bounds) -> Vec<DVec3> {
        let placed = |points: &[DVec3]| points.iter().map(|&p| map.transform_point3(p)).collect();
        match &self.form {
            HullForm::Sphere(_) => corners(world).to_vec(),
            HullForm::Points(points) if points.len() <= MANY_POINTS => placed(points),
            HullForm::Points(_) => placed(&corners(&self.bounds)),
        }
    }
}

impl Balls {
    fn of(points: &[DVec3]) -> Balls {
        Balls {
            centroid: BoundingSphere::of_centroid(points),
            tight: BoundingSphere::smallest(points),
        }
    }
}

/// Returns whether the transform maps balls to balls: it rotates, mirrors and scales uniformly.
fn preserves_spheres(map: &DAffine3) -> bool {
    let m = map.matrix3;
    let gram = m.transpose() * m;
    let scale = gram.x_axis.x;
    // Error of a rotation given in f32; a ball of a slightly stretched object is that little too large.
    let slack = 1e-5 * scale;
    (0..3).all(|i| {
        let column = gram.col(i);
        (0..3).all(|j| (column[j] - if i == j { scale } else { 0.0 }).abs() <= slack)
    })
}

/// Returns the vertices that a triangle uses, each once.
fn used_points(mesh: &Mesh) -> Vec<DVec3> {
    let mut is_used = vec![false; mesh.positions.len()];
    for &vertex in mesh.triangles.iter().flatten() {
        is_used[vertex as usize] = true;
    }
    let used = mesh.positions.iter().zip(is_used).filter(|(_, used)| *used);
    used.map(|(p, _)| DVec3::from(p.map(f64::from))).collect()
}

/// Returns points around a bounded shape other than a sphere.
fn shape_points(shape: &Shape, bounds: &Bounds) -> Vec<DVec3> {
    match shape {
        Shape::Polyhedron(polyhedron) => polyhedron.vertices(),
        Shape::Disk => circle(1.0, 0.0),
        Shape::Cylinder(_) => [circle(1.0, -1.0), circle(1.0, 1.0)].concat(),
        Shape::Cone(_) => [circle(1.0, -1.0), vec![DVec3::Z]].concat(),
        Shape::Torus(torus) => {
            let (reach, z) = (1.0 + torus.minor_radius, torus.minor_radius);
            [circle(reach, -z), circle(reach, z)].concat()
        }
        Shape::Quad => [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
            .map(|[x, y]| DVec3::new(x, y, 0.0))
            .to_vec(),
        Shape::Cube | Shape::Quadric(_) | Shape::Sphere(_) | Shape::Plane => corners(bounds).to_vec(),
    }
}

/// Returns the vertices of a regular polygon around the circle of that radius at that height.
fn circle(radius: f64, z: f64) -> Vec<DVec3> {
    let outer = radius / (PI / f64::from(SIDES)).cos();
    let corner = |i: u32| {
        let (sin, cos) = (TAU * f64::from(i) / f64::from(SIDES)).sin_cos();
        DVec3::new(outer * cos, outer * sin, z)
    };
    (0..SIDES).map(corner).collect()
}

/// Returns the corners of a box.
pub(super) fn corners(bounds: &Bounds) -> [DVec3; 8] {
    std::array::from_fn(|corner| {
        let pick = |axis: usize| {
            if corner >> axis & 1 == 0 {
                bounds.min[axis]
            } else {
                bounds.max[axis]
            }
        };
        DVec3::new(pick(0), pick(1), pick(2))
    })
}

/// Computes the hulls of all geometries.
pub(super) fn hulls_of(scene: &Scene) -> Vec<Option<HullPoints>> {
    parallel::map(scene.geometries.len(), &|index| {
        HullPoints::of(&scene.geometries[index])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::{Cylinder, Torus};

    #[test]
    fn round_shapes_have_smaller_balls_than_their_boxes() {
        let radius = |shape| {
            HullPoints::of(&Geometry::Shape(shape))
                .unwrap()
                .balls
                .tight
                .radius
        };
        // The polygon has the circumradius 1 / cos(π/32) = 1.0048.
        let outer = 1.0 / (PI / 32.0).cos();
        assert!((radius(Shape::Disk) - outer).abs() < 1e-12);
        let cylinder = Shape::Cylinder(Cylinder { capped: true });
        assert!((radius(cylinder) - (outer * outer + 1.0).sqrt()).abs() < 1e-12);
        let torus = Shape::Torus(Torus { minor_radius: 0.25 });
        assert!((radius(torus) - (1.25 * outer).hypot(0.25)).abs() < 1e-12);
    }

    #[test]
    fn unused_vertices_and_planes_are_ignored() {
        let mesh = Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [900.0; 3]].into(),
            triangles: vec![[0, 1, 2]].into(),
            ..Mesh::default()
        };
        let hull = HullPoints::of(&Geometry::Mesh(mesh)).unwrap();
        assert!((hull.balls.tight.radius - 0.5f64.sqrt()).abs() < 1e-15);
        assert!(HullPoints::of(&Geometry::Shape(Shape::Plane)).is_none());
        assert!(HullPoints::of(&Geometry::Mesh(Mesh::default())).is_none());
    }

    #[test]
    fn stretched_sphere_has_bounding_sphere_of_its_longest_axis() {
        let hull = HullPoints::of(&Geometry::Shape(Shape::Sphere(Sphere::UNIT))).unwrap();
        let map = DAffine3::from_rotation_x(0.4) * DAffine3::from_scale(DVec3::new(1.0, 3.0, 0.5));
        let ball = hull.world_balls(&map).tight;
        assert!((3.0..3.06).contains(&ball.radius), "{}", ball.radius);
    }
}
