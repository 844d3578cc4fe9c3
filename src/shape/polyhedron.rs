//! Analytic shape: a convex polyhedron as the intersection of half-spaces n · x <= h, clipped by Cyrus and Beck.
//!
//! A plane is classified by the sign of `n · d`, which may be exactly zero, and comparisons are closed; nothing is
//! compared with an epsilon. Tolerances are used by the constructors only, relative to the solid's size.

use std::collections::HashMap;

use glam::{DMat3, DVec3};

use super::parametrization::tangents;
use super::span::{Crossings, Span, nearest, report};
use super::{Implicit, LocatedPoint, OriginSurface, ShapeHit, ShapePoint, ShapeRay, Side};
use crate::numeric::Bounds;

/// Half-space of the points with `n · x <= h`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    /// Outward normal of the boundary; the constructor of a polyhedron makes it a unit vector.
    pub n: DVec3,
    /// Distance of the boundary from the origin along `n`, times its length.
    pub h: f64,
}

impl HalfSpace {
    /// Returns the signed distance of `p` outside the boundary, times the length of `n`.
    #[inline(always)]
    fn excess(&self, p: DVec3) -> f64 {
        self.n.dot(p) - self.h
    }

    /// Returns the part of `span` inside the half-space, whose number is `part`; the ray does not leave the part `own`,
    /// on which it starts.
    #[inline(always)]
    pub(super) fn clip(&self, span: &Span, part: u32, ray: &ShapeRay, own: u32) -> Span {
        let slope = self.n.dot(ray.direction);
        let room = -self.excess(ray.origin);
        let hit = ShapeHit {
            t: room / slope,
            part,
        };
        let is_own = part == own;
        // An empty interval stays empty
        if (slope == 0.0) & (room < 0.0) & !is_own {
            return Span::NONE;
        }
        Span {
            enter: if (slope < 0.0) & (hit.t > span.enter.t) {
                hit
            } else {
                span.enter
            },
            exit: if (slope > 0.0) & (hit.t < span.exit.t) & !is_own {
                hit
            } else {
                span.exit
            },
        }
    }
}

/// Bounded convex polyhedron. Part `i` is the face on half-space `i`; its surface coordinates are lengths along two
/// orthogonal tangents.
#[derive(Clone, Debug, PartialEq)]
pub struct Polyhedron {
    half_spaces: Box<[HalfSpace]>,
    bounds: Bounds,
}

/// Reason why a polyhedron is invalid; faces and half-spaces are counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PolyhedronError {
    /// Coordinate or coefficient that is infinite or NaN.
    #[error("vertex or half-space {0} of the polyhedron is not finite")]
    NotFinite(usize),
    /// Number of faces that is too large to be validated in reasonable time.
    #[error("the polyhedron has more than {MAX_FACES} faces: make it a mesh")]
    TooManyFaces,
    /// Face with less than three vertices or no area, or half-space without a normal.
    #[error("face {0} of the polyhedron has no area: give at least three vertices that are not on one line")]
    Degenerate(usize),
    /// Face that refers to a vertex that does not exist.
    #[error("face {0} of the polyhedron refers to a vertex that does not exist")]
    NoSuchVertex(usize),
    /// Face whose vertices are not on one plane.
    #[error("face {0} of the polyhedron is not flat: split it or move its vertices onto one plane")]
    NotFlat(usize),
    /// Face with a vertex outside its plane, or one that is concave itself.
    #[error(
        "the polyhedron is not convex at face {0}, or that face is not listed counter-clockwise from outside"
    )]
    NotConvex(usize),
    /// Face with an edge that no other face shares.
    #[error("face {0} of the polyhedron has an edge that no other face shares: close the solid")]
    NotClosed(usize),
    /// Half-spaces that extend to infinity in some direction.
    #[error("the half-spaces do not enclose a bounded solid: add the missing ones")]
    Unbounded,
    /// Half-spaces without a common interior.
    #[error("half-space {0} leaves the polyhedron empty or flat")]
    Empty(usize),
}

/// Largest number of faces: finding the vertices tests every combination of three.
const MAX_FACES: usize = 512;
/// Largest distance of a vertex from its plane, relative to the solid's size: coordinates rounded to f32 or written
/// with seven digits are off by up to 2^-23 of themselves.
const FLATNESS: f64 = 1.0 / (1 << 20) as f64;
/// Error of vertices that are computed from planes, relative to their coordinates: 53 bits less those that a narrow
/// angle of 2^-12 costs.
const VERTEX_TOLERANCE: f64 = 1.0 / (1u64 << 40) as f64;

impl Polyhedron {
    /// Creates the solid inside all `half_spaces`, whose normals may have any length. It must be bounded and have a
    /// volume.
    pub fn from_half_spaces(half_spaces: &[HalfSpace]) -> Result<Polyhedron, PolyhedronError> {
        if half_spaces.len() > MAX_FACES {
            return Err(PolyhedronError::TooManyFaces);
        }
        // Normalise the planes
        let mut unit = Vec::with_capacity(half_spaces.len());
        for (i, half_space) in half_spaces.iter().enumerate() {
            let length = half_space.n.length();
            if !(length.is_finite() && half_space.h.is_finite()) {
                return Err(PolyhedronError::NotFinite(i));
            }
            let n = half_space.n / length;
            if !(n.length() > 0.5) {
                return Err(PolyhedronError::Degenerate(i));
            }
            unit.push(HalfSpace {
                n,
                h: half_space.h / length,
            });
        }
        // Reject unbounded solids
        if is_unbounded(&unit) {
            return Err(PolyhedronError::Unbounded);
        }
        // Find vertices and bounds
        let vertices = vertices_of(&unit);
        let bounds = Bounds::of_points(vertices.iter().copied());
        let slack = VERTEX_TOLERANCE * bounds.magnitude();
        // Reject solids without thickness: one has vertices inside every face.
        let flat = |s: &HalfSpace| !vertices.iter().any(|v| s.excess(*v) < -2.0 * slack);
        if let Some(i) = unit.iter().position(flat) {
            return Err(PolyhedronError::Empty(i));
        }
        Ok(Polyhedron {
            half_spaces: unit.into(),
            bounds: expanded(bounds, slack),
        })
    }

    /// Creates the solid with these vertices and faces, each face listed counter-clockwise as seen from outside.
    pub fn from_faces(vertices: &[DVec3], faces: &[Vec<u32>]) -> Result<Polyhedron, PolyhedronError> {
        if let Some(i) = vertices.iter().position(|v| !v.is_finite()) {
            return Err(PolyhedronError::NotFinite(i));
        }
        if faces.len() > MAX_FACES {
            return Err(PolyhedronError::TooManyFaces);
        }
        // Derive the half-space of each face
        let slack = FLATNESS * Bounds::of_points(vertices.iter().copied()).extent().max_element();
        let mut half_spaces = Vec::with_capacity(faces.len());
        for (i, face) in faces.iter().enumerate() {
            half_spaces.push(face_half_space(vertices, face, i, slack)?);
        }
        // Check that every edge has two faces
        check_closed(faces)?;
        let solid = Polyhedron::from_half_spaces(&half_spaces)?;
        // Include the given vertices in the bounds
        let given = Bounds::of_points(faces.iter().flatten().map(|&v| vertices[v as usize]));
        Ok(Polyhedron {
            bounds: solid.bounds.union(given),
            ..solid
        })
    }

    /// Returns the half-spaces, with unit normals, in the order of the faces.
    pub fn half_spaces(&self) -> &[HalfSpace] {
        &self.half_spaces
    }

    /// Returns the vertices, recomputed, each once for every three faces that share it.
    pub(crate) fn vertices(&self) -> Vec<DVec3> {
        vertices_of(&self.half_spaces)
    }

    /// Returns both hits of the ray by clipping its line with every half-space.
    #[inline(always)]
    fn intersections(&self, ray: &ShapeRay) -> Crossings {
        let mut span = Span::ALL;
        // A ray to the inside does not hit its own plane again, even if it is grazing and rounded.
        let own = match ray.origin_surface {
            Some(OriginSurface {
                part,
                side: Side::Inside,
            }) => part,
            _ => u32::MAX,
        };
        // Clip the interval with every half-space
        for (part, half_space) in (0u32..).zip(&self.half_spaces) {
            span = half_space.clip(&span, part, ray, own);
        }
        span.crossings_of_convex(ray, false)
    }
}

/// Returns whether the intersection of the half-spaces extends to infinity: then it does so along the common line of
/// two of the planes.
fn is_unbounded(half_spaces: &[HalfSpace]) -> bool {
    let pairs = half_spaces
        .iter()
        .enumerate()
        .flat_map(|(i, a)| half_spaces[..i].iter().map(|b| a.n.cross(b.n)));
    let mut directions = pairs.filter(|d| d.length() > VERTEX_TOLERANCE).peekable();
    let free = |d: DVec3| {
        let most = VERTEX_TOLERANCE * d.length();
        half_spaces.iter().all(|s| s.n.dot(d) <= most)
    };
    // Parallel planes alone bound nothing along them.
    directions.peek().is_none() || directions.any(|d| free(d) || free(-d))
}

/// Returns the points common to three of the planes and inside all others.
fn vertices_of(half_spaces: &[HalfSpace]) -> Vec<DVec3> {
    let mut vertices = Vec::new();
    for (i, a) in half_spaces.iter().enumerate() {
        for (j, b) in half_spaces[..i].iter().enumerate() {
            for c in &half_spaces[..j] {
                // Intersect three planes by Cramer's rule
                let normals = DMat3::from_cols(a.n, b.n, c.n);
                let volume = normals.determinant();
                let p = (a.h * b.n.cross(c.n) + b.h * c.n.cross(a.n) + c.h * a.n.cross(b.n)) / volume;
                let slack = VERTEX_TOLERANCE * (p.abs().max_element() + a.h.abs() + b.h.abs() + c.h.abs());
                if p.is_finite() && half_spaces.iter().all(|s| s.excess(p) <= slack) {
                    vertices.push(p);
                }
            }
        }
    }
    vertices
}

/// Returns the bounds, enlarged by `by` on every side.
fn expanded(bounds: Bounds, by: f64) -> Bounds {
    Bounds {
        min: bounds.min - DVec3::splat(by),
        max: bounds.max + DVec3::splat(by),
    }
}

/// Returns the half-space of one face by Newell's normal; fails unless all vertices lie inside.
fn face_half_space(
    vertices: &[DVec3],
    face: &[u32],
    index: usize,
    slack: f64,
) -> Result<HalfSpace, PolyhedronError> {
    // Look up the corners
    let mut corners = Vec::with_capacity(face.len());
    for &v in face {
        let corner = vertices.get(v as usize).copied();
        corners.push(corner.ok_or(PolyhedronError::NoSuchVertex(index))?);
    }
    let count = corners.len();
    let first = corners.first().copied().unwrap_or_default();
    // Sum twice the vector area from one corner.
    let area: DVec3 = (0..count)
        .map(|k| (corners[k] - first).cross(corners[(k + 1) % count] - first))
        .sum();
    let n = area.normalize_or_zero();
    if count < 3 || n == DVec3::ZERO || area.length() <= slack * slack {
        return Err(PolyhedronError::Degenerate(index));
    }
    // Check that the face is flat
    let (low, high) = corners
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| {
            (low.min(n.dot(*p)), high.max(n.dot(*p)))
        });
    if high - low > slack {
        return Err(PolyhedronError::NotFlat(index));
    }
    // Check that the face is convex
    for k in 0..count {
        let (a, b, c) = (corners[k], corners[(k + 1) % count], corners[(k + 2) % count]);
        let turn = (b - a).cross(c - b).dot(n);
        if turn < -slack * ((b - a).length() + (c - b).length()) {
            return Err(PolyhedronError::NotConvex(index));
        }
    }
    // Check that no vertex lies outside
    let outermost = vertices.iter().fold(high, |most, p| most.max(n.dot(*p)));
    if outermost - high > slack {
        return Err(PolyhedronError::NotConvex(index));
    }
    Ok(HalfSpace { n, h: outermost })
}

/// Checks that every edge is traversed once in either direction.
fn check_closed(faces: &[Vec<u32>]) -> Result<(), PolyhedronError> {
    let mut edges: HashMap<(u32, u32), usize> = HashMap::new();
    let edges_of = |face: &[u32]| -> Vec<(u32, u32)> {
        (0..face.len())
            .map(|k| (face[k], face[(k + 1) % face.len()]))
            .collect()
    };
    // Record directed edges; each may occur once
    for (i, face) in faces.iter().enumerate() {
        for edge in edges_of(face) {
            if edges.insert(edge, i).is_some() {
                return Err(PolyhedronError::NotClosed(i));
            }
        }
    }
    // Find a directed edge without its opposite
    let open = |face: &Vec<u32>| edges_of(face).iter().any(|&(a, b)| !edges.contains_key(&(b, a)));
    match faces.iter().position(open) {
        Some(i) => Err(PolyhedronError::NotClosed(i)),
        None => Ok(()),
    }
}

impl Implicit for Polyhedron {
    #[inline]
    fn bounds(&self) -> Bounds {
        self.bounds
    }

    #[inline]
    fn intersect(&self, ray: &ShapeRay) -> Option<ShapeHit> {
        nearest(ray, self.intersections(ray))
    }

    fn crossings(&self, ray: &ShapeRay, out: &mut dyn FnMut(ShapeHit)) {
        report(ray, self.intersections(ray), out);
    }

    fn point(&self, p: DVec3, part: u32) -> ShapePoint {
        let surface = self.surface(p, part);
        let [s, t] = tangents(surface.n);
        surface.parametrized([surface.p.dot(s), surface.p.dot(t)], [s, t])
    }

    #[inline]
    fn surface(&self, p: DVec3, part: u32) -> LocatedPoint {
        let last = self.half_spaces.len() - 1;
        let face = self.half_spaces[(part as usize).min(last)];
        let p = p - face.excess(p) * face.n;
        LocatedPoint::new(p, face.n, self.bounds.magnitude())
    }

    #[inline]
    fn is_solid(&self) -> bool {
        true
    }

    #[inline]
    fn contains(&self, p: DVec3) -> bool {
        self.half_spaces.iter().all(|s| s.excess(p) <= 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> (Vec<DVec3>, Vec<Vec<u32>>) {
        (
            vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
            vec![vec![0, 2, 1], vec![0, 1, 3], vec![0, 3, 2], vec![1, 2, 3]],
        )
    }

    fn cube_half_spaces() -> Vec<HalfSpace> {
        (0..6)
            .map(|part| HalfSpace {
                n: if part % 2 == 0 { -3.0 } else { 3.0 } * DVec3::AXES[part / 2],
                h: 3.0,
            })
            .collect()
    }

    #[test]
    fn half_spaces_of_a_cube_give_the_hits_of_the_cube() {
        let cube = Polyhedron::from_half_spaces(&cube_half_spaces()).unwrap();
        for (o, d) in [
            (DVec3::new(0.3, -0.2, 5.0), DVec3::new(0.0, -0.0, -2.0)),
            (DVec3::new(1.0, 0.3, -5.0), DVec3::Z),
            (DVec3::splat(3.0), -DVec3::ONE),
            (DVec3::ZERO, DVec3::new(1.0, 2.0, -3.0)),
            (DVec3::splat(3.0), DVec3::new(-1.0, 0.0, 0.0)),
        ] {
            let ray = ShapeRay::new(o, d);
            assert_eq!(
                cube.intersect(&ray),
                super::super::Cube.intersect(&ray),
                "{ray:?}"
            );
        }
    }

    #[test]
    fn a_tetrahedron_from_faces_is_hit_on_the_face_that_is_named() {
        let (vertices, faces) = tetrahedron();
        let solid = Polyhedron::from_faces(&vertices, &faces).unwrap();
        // From (1, 1, 1) towards the origin: x + y + z = 1 at t = 2/3.
        let hit = solid.intersect(&ShapeRay::new(DVec3::ONE, -DVec3::ONE)).unwrap();
        assert_eq!(hit.part, 3);
        assert!((hit.t - 2.0 / 3.0).abs() <= 4.0 * f64::EPSILON);
        assert!(solid.contains(DVec3::splat(0.25)) && !solid.contains(DVec3::splat(0.5)));
    }

    #[test]
    fn invalid_faces_are_rejected_by_number() {
        let (vertices, faces) = tetrahedron();
        let with = |change: fn(&mut Vec<DVec3>, &mut Vec<Vec<u32>>)| {
            let (mut vertices, mut faces) = (vertices.clone(), faces.clone());
            change(&mut vertices, &mut faces);
            Polyhedron::from_faces(&vertices, &faces).unwrap_err()
        };
        assert_eq!(with(|_, f| f[2].reverse()), PolyhedronError::NotConvex(2));
        assert_eq!(with(|_, f| f[1][0] = 9), PolyhedronError::NoSuchVertex(1));
        assert_eq!(with(|_, f| f[1].truncate(2)), PolyhedronError::Degenerate(1));
        assert_eq!(with(|_, f| drop(f.pop())), PolyhedronError::NotClosed(0));
        assert_eq!(with(|v, _| v[3].z = f64::NAN), PolyhedronError::NotFinite(3));
        assert_eq!(
            with(|v, f| {
                v.push(DVec3::new(0.3, 0.3, 0.3));
                f[0].insert(1, 4);
            }),
            PolyhedronError::NotFlat(0)
        );
    }

    #[test]
    fn empty_or_unbounded_half_spaces_are_rejected() {
        let cube = cube_half_spaces();
        assert_eq!(
            Polyhedron::from_half_spaces(&cube[..5]),
            Err(PolyhedronError::Unbounded)
        );
        assert_eq!(Polyhedron::from_half_spaces(&[]), Err(PolyhedronError::Unbounded));
        for h in [-3.0, -4.0] {
            let mut thin = cube.clone();
            thin[0].h = h;
            assert!(matches!(
                Polyhedron::from_half_spaces(&thin),
                Err(PolyhedronError::Empty(_))
            ));
        }
    }
}
