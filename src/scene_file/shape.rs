//! Shapes of scene files and their conversion to geometries.

use std::sync::Arc;

use glam::DVec3;
use schemars::JsonSchema;
use serde::Deserialize;

use super::forms::{forms, schema};
use super::polygons::PolygonsForm;
use super::shape_diagnostic::ShapeDiagnostic;
use super::value::Vector;
use crate::numeric::Bounds;
use crate::scene::Geometry;
use crate::shape::{Cone, Cylinder, HalfSpace, Polyhedron, Quadric, Shape, Sphere, Torus};

/// The name of a shape, or the shape itself.
#[derive(Debug)]
pub(super) enum ShapeRef {
    Name(String),
    Inline(ShapeForm),
}

/// A shape in its own space, which transforms then place.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(super) enum ShapeForm {
    /// A sphere; without keys the unit sphere.
    Sphere(SphereForm),
    /// The infinite plane z = 0.
    Plane(NoKeys),
    /// The cube [-1, 1]³.
    Cube(NoKeys),
    /// The unit disk in z = 0.
    Disk(NoKeys),
    /// The square [-1, 1]² in z = 0.
    Quad(NoKeys),
    /// A cylinder of radius 1 around the z axis from z = -1 to z = 1.
    Cylinder(CappedForm),
    /// A cone around the z axis: radius 1 at z = -1, apex at z = 1.
    Cone(CappedForm),
    /// A torus around the z axis; the centre line of its tube is the unit circle.
    Torus(TorusForm),
    /// A convex polyhedron: by vertices and faces, or by half-spaces.
    Polyhedron(PolyhedronForm),
    /// A second-degree surface, clipped by a box.
    Quadric(QuadricForm),
    /// A mesh of vertices and convex polygons.
    Mesh(PolygonsForm),
}

/// Words for shapes that need no keys.
const WORDS: [&str; 8] = [
    "sphere", "plane", "cube", "disk", "quad", "cylinder", "cone", "torus",
];

#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct NoKeys {}

/// A sphere; without keys the unit sphere.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SphereForm {
    /// Centre of the sphere.
    #[serde(default = "origin")]
    center: Vector,
    /// Radius of the sphere.
    #[serde(default = "unit")]
    radius: f64,
}

fn origin() -> Vector {
    Vector(Sphere::UNIT.center)
}

fn unit() -> f64 {
    Sphere::UNIT.radius
}

/// A shape that may be open or closed.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct CappedForm {
    /// Closing of the ends, which makes the shape a solid.
    #[serde(default = "closed")]
    capped: bool,
}

fn closed() -> bool {
    true
}

/// A torus whose tube has the unit circle as its centre line.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct TorusForm {
    /// Radius of the tube, over 0 and under 1.
    #[serde(default = "tube")]
    minor_radius: f64,
}

fn tube() -> f64 {
    0.25
}

/// A convex polyhedron: `vertices` and `faces`, or `half_spaces`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PolyhedronForm {
    /// Corners of the polyhedron.
    vertices: Option<Vec<Vector>>,
    /// Faces as lists of vertex numbers from 0, counter-clockwise seen from outside.
    faces: Option<Vec<Vec<u32>>>,
    /// Half-spaces [a, b, c, h] of all points with a x + b y + c z <= h.
    half_spaces: Option<Vec<[f64; 4]>>,
}

/// A quadric inside a box.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct QuadricForm {
    /// The upper triangle of its symmetric 4 x 4 matrix, row by row.
    coefficients: [f64; 10],
    /// Low corner of the clipping box.
    min: Vector,
    /// High corner of the clipping box.
    max: Vector,
}

impl ShapeForm {
    /// Returns the shape for a word; `None` if the word is unknown.
    pub(super) fn of_word(word: &str) -> Option<ShapeForm> {
        let capped = || CappedForm { capped: closed() };
        Some(match word {
            // The defaults are those of absent keys
            "sphere" => ShapeForm::Sphere(SphereForm {
                center: origin(),
                radius: unit(),
            }),
            "plane" => ShapeForm::Plane(NoKeys {}),
            "cube" => ShapeForm::Cube(NoKeys {}),
            "disk" => ShapeForm::Disk(NoKeys {}),
            "quad" => ShapeForm::Quad(NoKeys {}),
            "cylinder" => ShapeForm::Cylinder(capped()),
            "cone" => ShapeForm::Cone(capped()),
            "torus" => ShapeForm::Torus(TorusForm { minor_radius: tube() }),
            _ => return None,
        })
    }

    /// Returns the words for shapes.
    pub(super) fn words() -> impl Iterator<Item = &'static str> {
        WORDS.into_iter()
    }

    /// Returns the shape's geometry in its own space.
    pub(super) fn geometry(&self) -> Result<Geometry, ShapeDiagnostic> {
        let shape = match self {
            ShapeForm::Sphere(form) => Shape::Sphere(form.sphere()?),
            ShapeForm::Plane(_) => Shape::Plane,
            ShapeForm::Cube(_) => Shape::Cube,
            ShapeForm::Disk(_) => Shape::Disk,
            ShapeForm::Quad(_) => Shape::Quad,
            ShapeForm::Cylinder(form) => Shape::Cylinder(Cylinder { capped: form.capped }),
            ShapeForm::Cone(form) => Shape::Cone(Cone { capped: form.capped }),
            ShapeForm::Torus(form) => Shape::Torus(form.torus()?),
            ShapeForm::Polyhedron(form) => Shape::Polyhedron(Arc::new(form.polyhedron()?)),
            ShapeForm::Quadric(form) => Shape::Quadric(Arc::new(form.quadric()?)),
            // A mesh is the only geometry that is not an analytic shape
            ShapeForm::Mesh(form) => return form.mesh().map(Geometry::Mesh),
        };
        Ok(Geometry::Shape(shape))
    }
}

impl SphereForm {
    fn sphere(&self) -> Result<Sphere, String> {
        if !(self.radius > 0.0 && self.radius < f64::INFINITY) {
            return Err(format!(
                "is a sphere of radius {}: give a positive radius",
                self.radius
            ));
        }
        Ok(Sphere {
            center: self.center.0,
            radius: self.radius,
        })
    }
}

impl TorusForm {
    fn torus(&self) -> Result<Torus, String> {
        if !(self.minor_radius > 0.0 && self.minor_radius < 1.0) {
            return Err(format!(
                "is a torus with a tube of radius {}: give a `minor_radius` over 0 and under 1",
                self.minor_radius
            ));
        }
        Ok(Torus {
            minor_radius: self.minor_radius,
        })
    }
}

impl PolyhedronForm {
    fn polyhedron(&self) -> Result<Polyhedron, String> {
        let made = match (&self.vertices, &self.faces, &self.half_spaces) {
            // By faces, whose planes are computed
            (Some(vertices), Some(faces), None) => {
                let vertices: Vec<DVec3> = vertices.iter().map(|v| v.0).collect();
                Polyhedron::from_faces(&vertices, faces)
            }
            // By half-spaces, whose intersection must be bounded
            (None, None, Some(half_spaces)) => {
                let half_spaces: Vec<HalfSpace> = half_spaces
                    .iter()
                    .map(|&[a, b, c, h]| HalfSpace {
                        n: DVec3::new(a, b, c),
                        h,
                    })
                    .collect();
                Polyhedron::from_half_spaces(&half_spaces)
            }
            _ => return Err("is not one polyhedron: give `vertices` and `faces`, or `half_spaces`".into()),
        };
        made.map_err(|error| error.to_string())
    }
}

impl QuadricForm {
    fn quadric(&self) -> Result<Quadric, String> {
        let clip = Bounds {
            min: self.min.0,
            max: self.max.0,
        };
        Quadric::new(self.coefficients, clip).map_err(|error| error.to_string())
    }
}

forms! {
    ['de] ShapeRef, "a shape's name or { KIND = { ... } }";
    text name => Ok(ShapeRef::Name(name.to_owned()));
    table table => ShapeForm::deserialize(table).map(ShapeRef::Inline);
}

schema!([] ShapeRef, "ShapeOrName", generator => {
    "anyOf": [
        {
            "type": "string",
            "description": format!("One of {}, or the name of a [shape.NAME].", WORDS.join(", ")),
        },
        generator.subschema_for::<ShapeForm>(),
    ],
});
