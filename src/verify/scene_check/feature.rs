//! Mesh feature at which two results for a ray differ: an edge, a sliver, the end of the ray.

use glam::DVec3;
use serde::Serialize;

use crate::accel::Hit;
use crate::numeric::Ray;
use crate::scene::{Geometry, Scene};

/// Mesh feature at which two results differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum MeshFeature {
    /// Hit parameter that is NaN.
    Nan,
    /// Hit on an analytic shape.
    Shape,
    /// Two triangles at equal distance, away from their edges: coplanar, or intersecting there.
    Coplanar,
    /// Hit close to a vertex of a triangle.
    Vertex,
    /// Hit close to an edge of a triangle.
    Edge,
    /// Triangle lower than 10^-4 of its longest edge.
    Sliver,
    /// Triangle seen at less than about half a degree to its plane.
    Grazing,
    /// Triangle more than 10^5 of its own lengths away.
    Far,
    /// Hit at `t_near` or `t_far` of the ray.
    End,
    /// None of the other features.
    Other,
}

impl MeshFeature {
    /// All features, in the order in which they are tested for.
    pub const ALL: [MeshFeature; 10] = [
        MeshFeature::Nan,
        MeshFeature::Shape,
        MeshFeature::Coplanar,
        MeshFeature::Vertex,
        MeshFeature::Edge,
        MeshFeature::Sliver,
        MeshFeature::Grazing,
        MeshFeature::Far,
        MeshFeature::End,
        MeshFeature::Other,
    ];

    /// Returns the word for the feature in files.
    pub fn word(self) -> &'static str {
        match self {
            MeshFeature::Nan => "nan",
            MeshFeature::Shape => "shape",
            MeshFeature::Coplanar => "coplanar",
            MeshFeature::Vertex => "vertex",
            MeshFeature::Edge => "edge",
            MeshFeature::Sliver => "sliver",
            MeshFeature::Grazing => "grazing",
            MeshFeature::Far => "far",
            MeshFeature::End => "end",
            MeshFeature::Other => "other",
        }
    }

    /// Returns the name of the feature in tables.
    pub fn name(self) -> &'static str {
        match self {
            MeshFeature::Nan => "not a number",
            MeshFeature::End => "end of ray",
            MeshFeature::Other => "elsewhere",
            _ => self.word(),
        }
    }
}

/// Hits closer to an edge than this share of the triangle's height above it are at the edge.
const AT_EDGE: f64 = 1.0 / 4096.0;
/// Sine of the angle to a plane below which a ray grazes it.
const GRAZING: f64 = 0.01;
/// Share of the longest edge below which the height of a triangle makes it a sliver.
const SLIVER: f64 = 1e-4;
/// Distance, in lengths of a triangle, beyond which it is far.
const FAR: f64 = 1e5;
/// Relative difference of parameters below which they count as equal.
const SAME_T: f64 = 1.0 / (1 << 18) as f64;

pub(super) fn feature(scene: &Scene, ray: &Ray, hits: [Option<Hit>; 2]) -> MeshFeature {
    if hits.iter().flatten().any(|hit| hit.t.is_nan()) {
        return MeshFeature::Nan;
    }
    // Describe the ray at each triangle that it hits
    let hit_geometries: Vec<HitGeometry> = hits
        .iter()
        .flatten()
        .filter_map(|hit| HitGeometry::of(scene, ray, hit))
        .collect();
    if hit_geometries.len() < hits.iter().flatten().count() {
        return MeshFeature::Shape;
    }
    // Choose the first feature that applies to either hit
    let any = |of: fn(&HitGeometry) -> bool| hit_geometries.iter().any(of);
    // Compare the parameters with each other and with the ends of the ray
    let is_same = |a: f64, b: f64| (a - b).abs() <= SAME_T * a.abs().max(b.abs());
    let ends = [ray.t_near, ray.t_far].map(f64::from).into_iter();
    let ends: Vec<f64> = ends.filter(|end| end.is_finite()).collect();
    if any(|view| view.near_edges >= 2) {
        MeshFeature::Vertex
    } else if any(|view| view.near_edges == 1) {
        MeshFeature::Edge
    } else if any(|view| view.is_sliver) {
        MeshFeature::Sliver
    } else if any(|view| view.is_grazing) {
        MeshFeature::Grazing
    } else if hit_geometries.len() == 2 && is_same(hit_geometries[0].t, hit_geometries[1].t) {
        MeshFeature::Coplanar
    } else if hit_geometries
        .iter()
        .any(|view| ends.iter().any(|&end| is_same(view.t, end)))
    {
        MeshFeature::End
    } else if any(|view| view.is_far) {
        MeshFeature::Far
    } else {
        MeshFeature::Other
    }
}

/// Geometric relation of a ray to a triangle that it hits.
struct HitGeometry {
    t: f64,
    /// Number of edges that the ray passes close to.
    near_edges: usize,
    is_sliver: bool,
    is_grazing: bool,
    is_far: bool,
}

impl HitGeometry {
    /// Computes the relation; `None` for a hit on a shape.
    fn of(scene: &Scene, ray: &Ray, hit: &Hit) -> Option<HitGeometry> {
        let instance = scene.instances.get(hit.instance as usize)?;
        let Geometry::Mesh(mesh) = scene.geometries.get(instance.geometry as usize)? else {
            return None;
        };
        // Transform the triangle to world space at the time of the ray
        let pose = instance.pose(ray.time);
        let map = pose.world_from_object();
        let [a, b, c] = mesh.corners_f64(hit.primitive).map(|p| map.transform_point3(p));
        let d = ray.direction.as_dvec3();
        // Intersect the ray with the plane of the triangle in f64
        let n = (b - a).cross(c - a);
        let t = n.dot(a - ray.origin.as_dvec3()) / n.dot(d);
        let p = ray.at(t);
        // Compute barycentric weights: each is the distance from an edge as a share of the height above it
        let weight = |q: DVec3, r: DVec3| (q - p).cross(r - p).dot(n) / n.length_squared();
        let weights = [weight(b, c), weight(c, a), weight(a, b)];
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        Some(HitGeometry {
            t,
            near_edges: weights.iter().filter(|w| w.abs() < AT_EDGE).count(),
            is_sliver: n.length() < SLIVER * longest * longest,
            is_grazing: n.dot(d).abs() < GRAZING * n.length() * d.length(),
            is_far: t * d.length() > FAR * longest,
        })
    }
}
