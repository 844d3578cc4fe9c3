//! Area lights of analytic shapes under any affine map: points of their pieces, sampled in object space.
//!
//! A piece is chosen in proportion to its area in object space, then a point on it. A map M with the inverse transpose
//! N scales an area with the unit normal n by |det M| |N n|, so the density of points in the world follows from that in
//! object space; it need not be uniform, as every sample carries its own density. From outside of a closed shape its
//! inner side is not visible, nor its outer one from inside, so points that face away from the shaded point are
//! rejected.

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DMat3, DVec3};

use super::{AreaLightError, LightSample, LightVector, is_density, sample_of_area};
use crate::numeric::warp;
use crate::shape::{Implicit, Shape};

/// Analytic shape in the world, as a light.
#[derive(Clone, Debug)]
pub struct ShapeLight {
    shape: Shape,
    pieces: &'static [LightPiece],
    world_from_object: DAffine3,
    object_from_world: DAffine3,
    /// Inverse transpose of the map, times its determinant.
    area_map: DMat3,
}

/// Part of a shape's surface in object space.
#[derive(Clone, Copy, Debug, PartialEq)]
enum LightPiece {
    /// Sphere of unit radius around the origin.
    Sphere,
    /// Face of the cube across an axis, on one side of the origin.
    Face { axis: usize, side: f64 },
    /// Lateral surface of the cylinder.
    CylinderWall,
    /// Unit disk at a height, facing up or down.
    Cap { z: f64 },
    /// Lateral surface of the cone.
    ConeWall,
    /// Whole surface of the torus.
    Torus,
}

/// Sampled point on a shape in object space.
struct PiecePoint {
    p: DVec3,
    /// Unit normal, pointing outward.
    n: DVec3,
    /// Area there per unit of the random numbers' unit square.
    area: f64,
}

const fn face(axis: usize, side: f64) -> LightPiece {
    LightPiece::Face { axis, side }
}

/// Faces of the cube, in the order of its part numbers, as the other arrays of pieces are in theirs.
const CUBE: [LightPiece; 6] = [
    face(0, -1.0),
    face(0, 1.0),
    face(1, -1.0),
    face(1, 1.0),
    face(2, -1.0),
    face(2, 1.0),
];
const CYLINDER: [LightPiece; 3] = [
    LightPiece::CylinderWall,
    LightPiece::Cap { z: 1.0 },
    LightPiece::Cap { z: -1.0 },
];
const CONE: [LightPiece; 2] = [LightPiece::ConeWall, LightPiece::Cap { z: -1.0 }];

impl ShapeLight {
    /// Creates the light of `shape` transformed by `world_from_object`. Returns `None` for unbounded surfaces, and for
    /// shapes whose points cannot be sampled.
    pub fn new(
        shape: &Shape,
        world_from_object: DAffine3,
        object_from_world: DAffine3,
    ) -> Option<Result<ShapeLight, AreaLightError>> {
        // Divide the surface into pieces
        let pieces: &'static [LightPiece] = match shape {
            Shape::Sphere(_) => &[LightPiece::Sphere],
            Shape::Cube => &CUBE,
            Shape::Cylinder(cylinder) if cylinder.capped => &CYLINDER,
            Shape::Cylinder(_) => &CYLINDER[..1],
            Shape::Cone(cone) if cone.capped => &CONE,
            Shape::Cone(_) => &CONE[..1],
            Shape::Torus(_) => &[LightPiece::Torus],
            Shape::Plane | Shape::Disk | Shape::Quad | Shape::Polyhedron(_) | Shape::Quadric(_) => {
                return None;
            }
        };
        let light = ShapeLight {
            shape: shape.clone(),
            pieces,
            world_from_object,
            object_from_world,
            area_map: object_from_world.matrix3.transpose() * world_from_object.matrix3.determinant(),
        };
        // Reject lights without a usable area
        let area = light.area();
        let is_light = is_density(area) && is_density(area.recip());
        Some(is_light.then_some(light).ok_or(AreaLightError::NoArea))
    }

    /// Samples the point that `u` in [0, 1)² selects for `p`. Returns `None` if it lies on a side that is not visible
    /// from there.
    #[inline]
    pub fn sample(&self, p: DVec3, u: [f64; 2]) -> Option<LightSample> {
        let (part, position, normal, area) = self.point(u);
        let sample = LightSample {
            primitive: part,
            ..sample_of_area(p, position, normal, area)?
        };
        // Reject points on the side that faces away
        if self.shape.is_solid() {
            let is_inside = self.shape.contains(self.object_from_world.transform_point3(p));
            if is_inside == sample.is_front() {
                return None;
            }
        }
        Some(sample)
    }

    /// Returns the density per steradian with which the direction from `p` to `position`, a point of the shape with the
    /// unit `normal` that is visible from `p`, is chosen.
    pub(super) fn pdf(&self, p: DVec3, position: DVec3, normal: DVec3) -> f64 {
        // Area of the random numbers' unit square in object space
        let in_object = match &self.shape {
            Shape::Sphere(sphere) => 4.0 * PI * sphere.radius * sphere.radius,
            Shape::Torus(torus) => {
                let axis_distance = self
                    .object_from_world
                    .transform_point3(position)
                    .truncate()
                    .length();
                TAU * TAU * torus.minor_radius * axis_distance
            }
            _ => self.pieces.iter().map(|piece| piece.area()).sum(),
        };
        // The map stretches areas by |det M| |N n|, and Mᵀ turns the normal in the world back
        let map = self.world_from_object.matrix3;
        let stretch = map.determinant().abs() / (map.transpose() * normal).length();
        LightVector::of_area(position - p, normal, in_object * stretch).pdf
    }

    /// Returns the area of the outer side in square metres, to about four digits where the map stretches.
    pub fn area(&self) -> f64 {
        const CELLS: u32 = 96;
        let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(CELLS);
        let cells = (0..CELLS * CELLS).map(|i| self.point([middle(i % CELLS), middle(i / CELLS)]).3);
        cells.sum::<f64>() / f64::from(CELLS * CELLS)
    }

    /// Returns the part and the point that `u` selects, its outward unit normal, and the area there per unit of the
    /// random numbers' unit square.
    #[inline(always)]
    fn point(&self, u: [f64; 2]) -> (u32, DVec3, DVec3, f64) {
        // Choose a piece in proportion to its area, and rescale the random number
        let total: f64 = self.pieces.iter().map(|piece| piece.area()).sum();
        let mut target = u[0] * total;
        let last = self.pieces.len() - 1;
        let mut part = 0;
        while part < last && target >= self.pieces[part].area() {
            target -= self.pieces[part].area();
            part += 1;
        }
        let chosen = self.pieces[part];
        let within = (target / chosen.area()).clamp(0.0, 1.0 - 0.5 * f64::EPSILON);
        // Transform the normal, whose stretch is that of the area
        let at = chosen.point(&self.shape, [within, u[1]]);
        let n = self.area_map * at.n;
        let stretch = n.length();
        // The determinant of a mirroring map has turned the normal inward.
        let outward = n * self.world_from_object.matrix3.determinant().signum() / stretch;
        let area = at.area * stretch * total / chosen.area();
        (
            part as u32,
            self.world_from_object.transform_point3(at.p),
            outward,
            area,
        )
    }
}

impl LightPiece {
    /// Returns the weight with which the piece is chosen: its area in object space, if the shape has several pieces.
    fn area(self) -> f64 {
        match self {
            LightPiece::Sphere | LightPiece::Torus | LightPiece::CylinderWall => 4.0 * PI,
            LightPiece::Face { .. } => 4.0,
            LightPiece::Cap { .. } => PI,
            // Radius 1 and a slant of √(1² + 2²).
            LightPiece::ConeWall => PI * 5f64.sqrt(),
        }
    }

    /// Returns the point that `u` selects on the piece, with outward normal and area.
    #[inline(always)]
    fn point(self, shape: &Shape, u: [f64; 2]) -> PiecePoint {
        let (sin, cos) = (TAU * u[1]).sin_cos();
        let around = DVec3::new(cos, sin, 0.0);
        let (p, n, area) = match (self, shape) {
            // Sample the sphere uniformly
            (LightPiece::Sphere, Shape::Sphere(sphere)) => {
                let n = warp::direction(2.0 * u[0], u[1]);
                let p = sphere.center + sphere.radius * n;
                (p, n, self.area() * sphere.radius * sphere.radius)
            }
            // Sample the face of the cube uniformly
            (LightPiece::Face { axis, side }, _) => {
                let n = side * DVec3::AXES[axis];
                let (right, up) = (DVec3::AXES[(axis + 1) % 3], DVec3::AXES[(axis + 2) % 3]);
                (
                    n + (2.0 * u[0] - 1.0) * right + (2.0 * u[1] - 1.0) * up,
                    n,
                    self.area(),
                )
            }
            // Sample the cap uniformly
            (LightPiece::Cap { z }, _) => {
                let offset = warp::disk(u);
                (DVec3::new(offset.x, offset.y, z), DVec3::Z * z, self.area())
            }
            (LightPiece::ConeWall, _) => {
                // The area within a radius grows with its square; there the height is 1 - 2 radius.
                let radius = u[0].sqrt();
                let n = (2.0 * around + DVec3::Z) / 5f64.sqrt();
                (radius * around + (1.0 - 2.0 * radius) * DVec3::Z, n, self.area())
            }
            // Sample the torus uniformly in both angles
            (LightPiece::Torus, Shape::Torus(torus)) => {
                let r = torus.minor_radius;
                let (sin_tube, cos_tube) = (TAU * u[0]).sin_cos();
                let n = cos_tube * around + sin_tube * DVec3::Z;
                (around + r * n, n, TAU * TAU * r * (1.0 + r * cos_tube))
            }
            // Sample the wall of the cylinder uniformly
            _ => (around + (2.0 * u[0] - 1.0) * DVec3::Z, around, self.area()),
        };
        PiecePoint { p, n, area }
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::super::AreaLight;
    use super::super::tests::mean;
    use super::*;
    use crate::shape::{Cone, Cylinder, Sphere, Torus};

    /// Returns shapes with their areas in object space.
    fn shapes_with_areas() -> Vec<(Shape, f64)> {
        let torus = Torus { minor_radius: 0.3 };
        vec![
            (Shape::Sphere(Sphere::UNIT), 4.0 * PI),
            (Shape::Cube, 24.0),
            (Shape::Cylinder(Cylinder { capped: true }), 6.0 * PI),
            (Shape::Cylinder(Cylinder { capped: false }), 4.0 * PI),
            (Shape::Cone(Cone { capped: true }), PI * (1.0 + 5f64.sqrt())),
            (Shape::Cone(Cone { capped: false }), PI * 5f64.sqrt()),
            (Shape::Torus(torus), TAU * TAU * 0.3),
        ]
    }

    fn light(shape: &Shape, map: DAffine3) -> ShapeLight {
        ShapeLight::new(shape, map, map.inverse()).unwrap().unwrap()
    }

    fn skew() -> DAffine3 {
        let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.7);
        DAffine3::from_scale_rotation_translation(
            DVec3::new(-1.5, 0.6, 2.0),
            turn,
            DVec3::new(1.0, -0.4, 2.5),
        )
    }

    #[test]
    fn shape_areas_equal_closed_forms() {
        for (shape, exact) in shapes_with_areas() {
            let found = light(&shape, DAffine3::IDENTITY).area();
            assert!(
                (found / exact - 1.0).abs() < 1e-12,
                "{shape:?}: {found}, not {exact}"
            );
            let found = light(&shape, DAffine3::from_scale(DVec3::splat(-2.0))).area();
            assert!((found / exact - 4.0).abs() < 1e-12, "{shape:?}: {found}");
        }
    }

    #[test]
    fn sampled_points_lie_on_the_shape_with_outward_normals() {
        for (shape, _) in shapes_with_areas() {
            for map in [DAffine3::IDENTITY, skew()] {
                let light = light(&shape, map);
                for i in 0..400 {
                    let u = [f64::from(i % 20), f64::from(i / 20)].map(|i| (i + 0.5) / 20.0);
                    let (_, p, n, _) = light.point(u);
                    assert!((n.length() - 1.0).abs() < 1e-13);
                    if shape.is_solid() {
                        let inside =
                            |side: f64| shape.contains(map.inverse().transform_point3(p + side * 1e-9 * n));
                        assert!(inside(-1.0) && !inside(1.0), "{shape:?} {u:?}");
                    } else {
                        let p = map.inverse().transform_point3(p);
                        let off = shape.point(p, 0).p - p;
                        assert!(off.length() < 1e-13, "{shape:?} {u:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn closed_shapes_cover_the_full_sphere_from_inside() {
        for (shape, _) in shapes_with_areas().iter().filter(|(shape, _)| shape.is_solid()) {
            let inside = match shape {
                Shape::Torus(_) => DVec3::new(1.05, 0.05, 0.1),
                _ => DVec3::new(0.05, 0.1, -0.4),
            };
            let light = light(shape, skew());
            let is_convex = light.shape.is_solid() && !matches!(light.shape, Shape::Torus(_));
            let light = AreaLight::Shape(Box::new(light));
            let p = skew().transform_point3(inside);
            let around = mean(&light, p, 1024, |s| s.pdf.recip());
            // The torus is not convex: part of its inner side lies behind more of its outer side.
            assert!(around / (4.0 * PI) > 1.0 - 2e-3, "{shape:?}: {around}");
            if is_convex {
                assert!(around / (4.0 * PI) < 1.0 + 2e-3, "{shape:?}: {around}");
            }
        }
    }

    #[test]
    fn the_density_of_a_direction_is_that_of_the_sample_in_it() {
        let p = DVec3::new(4.0, -3.0, 5.0);
        for (shape, _) in shapes_with_areas() {
            let light = AreaLight::Shape(Box::new(light(&shape, skew())));
            mean(&light, p, 16, |sample| {
                let pdf = light.pdf(p, sample.position, sample.normal);
                assert!((pdf / sample.pdf - 1.0).abs() < 1e-12, "{shape:?}: {pdf}");
                0.0
            });
        }
    }

    #[test]
    fn a_stretched_sphere_is_seen_in_the_solid_angle_of_its_ellipsoid() {
        // Seen from distance 5 along the axis of symmetry, half axes 2 (across) and 1: tangent cone, tan² = 4 / (25 -
        // 1).
        let map = DAffine3::from_scale(DVec3::new(2.0, 2.0, 1.0));
        let light = AreaLight::Shape(Box::new(light(&Shape::Sphere(Sphere::UNIT), map)));
        let found = mean(&light, DVec3::Z * 5.0, 1024, |s| s.pdf.recip());
        let cos = (1.0 + 4.0 / 24.0f64).sqrt().recip();
        let exact = TAU * (1.0 - cos);
        assert!((found / exact - 1.0).abs() < 1e-3, "{found}, not {exact}");
    }

    #[test]
    fn unsampleable_shapes_give_none() {
        for shape in [Shape::Plane, Shape::Disk, Shape::Quad] {
            assert!(ShapeLight::new(&shape, DAffine3::IDENTITY, DAffine3::IDENTITY).is_none());
        }
    }
}
