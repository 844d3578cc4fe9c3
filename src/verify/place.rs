//! What kind of place a ray meets a scene at, where two answers differ: an edge, a sliver, the end of the ray.

use glam::DVec3;
use serde::Serialize;

use crate::accel::Hit;
use crate::numeric::Ray;
use crate::scene::{Geometry, Scene};

/// What kind of place two answers differ at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Place {
    /// A parameter is no number.
    Nan,
    /// An analytic shape.
    Shape,
    /// Two triangles at the same distance, away from their edges: they lie in one plane, or cross there.
    Coplanar,
    /// A corner.
    Vertex,
    /// An edge.
    Edge,
    /// A triangle lower than 10^-4 of its longest edge.
    Sliver,
    /// A triangle seen at less than about half a degree to its plane.
    Grazing,
    /// A triangle more than 10^5 of its own lengths away.
    Far,
    /// Right at one end of the ray.
    End,
    /// None of these.
    Other,
}

impl Place {
    /// All of them.
    pub const ALL: [Place; 10] = [
        Place::Nan,
        Place::Shape,
        Place::Coplanar,
        Place::Vertex,
        Place::Edge,
        Place::Sliver,
        Place::Grazing,
        Place::Far,
        Place::End,
        Place::Other,
    ];

    /// In one word, as files have it.
    pub fn word(self) -> &'static str {
        match self {
            Place::Nan => "nan",
            Place::Shape => "shape",
            Place::Coplanar => "coplanar",
            Place::Vertex => "vertex",
            Place::Edge => "edge",
            Place::Sliver => "sliver",
            Place::Grazing => "grazing",
            Place::Far => "far",
            Place::End => "end",
            Place::Other => "other",
        }
    }

    /// As a table has it.
    pub fn name(self) -> &'static str {
        match self {
            Place::Nan => "not a number",
            Place::End => "end of ray",
            Place::Other => "elsewhere",
            _ => self.word(),
        }
    }
}

/// What is nearer to an edge than this share of the triangle's height above it is at the edge.
const AT_EDGE: f64 = 1.0 / 4096.0;
/// Sine of the angle to a plane below which a ray grazes it.
const GRAZING: f64 = 0.01;
/// Lower than this share of the longest edge a triangle is a sliver.
const SLIVER: f64 = 1e-4;
/// Lengths of a triangle from which on it is far.
const FAR: f64 = 1e5;
/// Parameters that differ by less than this share are the same.
const SAME_T: f64 = 1.0 / (1 << 18) as f64;

pub(super) fn place(scene: &Scene, ray: &Ray, hits: [Option<Hit>; 2]) -> Place {
    if hits.iter().flatten().any(|hit| hit.t.is_nan()) {
        return Place::Nan;
    }
    let views: Vec<View> = hits
        .iter()
        .flatten()
        .filter_map(|hit| View::of(scene, ray, hit))
        .collect();
    if views.len() < hits.iter().flatten().count() {
        return Place::Shape;
    }
    let any = |of: fn(&View) -> bool| views.iter().any(of);
    let is_same = |a: f64, b: f64| (a - b).abs() <= SAME_T * a.abs().max(b.abs());
    let ends = [ray.t_near, ray.t_far].map(f64::from).into_iter();
    let ends: Vec<f64> = ends.filter(|end| end.is_finite()).collect();
    if any(|view| view.near_edges >= 2) {
        Place::Vertex
    } else if any(|view| view.near_edges == 1) {
        Place::Edge
    } else if any(|view| view.is_sliver) {
        Place::Sliver
    } else if any(|view| view.is_grazed) {
        Place::Grazing
    } else if views.len() == 2 && is_same(views[0].t, views[1].t) {
        Place::Coplanar
    } else if views
        .iter()
        .any(|view| ends.iter().any(|&end| is_same(view.t, end)))
    {
        Place::End
    } else if any(|view| view.is_far) {
        Place::Far
    } else {
        Place::Other
    }
}

/// How a ray sees a triangle that it is said to hit.
struct View {
    t: f64,
    /// Edges that it passes close to.
    near_edges: usize,
    is_sliver: bool,
    is_grazed: bool,
    is_far: bool,
}

impl View {
    /// `None` for a shape.
    fn of(scene: &Scene, ray: &Ray, hit: &Hit) -> Option<View> {
        let instance = scene.instances.get(hit.instance as usize)?;
        let Geometry::Mesh(mesh) = scene.geometries.get(instance.geometry as usize)? else {
            return None;
        };
        let pose = instance.pose(ray.time);
        let map = pose.world_from_object();
        let [a, b, c] = mesh.corners_f64(hit.primitive).map(|p| map.transform_point3(p));
        let d = ray.direction.as_dvec3();
        let n = (b - a).cross(c - a);
        let t = n.dot(a - ray.origin.as_dvec3()) / n.dot(d);
        let p = ray.at(t);
        // Each weight is the distance from an edge as a share of the height above it.
        let weight = |q: DVec3, r: DVec3| (q - p).cross(r - p).dot(n) / n.length_squared();
        let weights = [weight(b, c), weight(c, a), weight(a, b)];
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        Some(View {
            t,
            near_edges: weights.iter().filter(|w| w.abs() < AT_EDGE).count(),
            is_sliver: n.length() < SLIVER * longest * longest,
            is_grazed: n.dot(d).abs() < GRAZING * n.length() * d.length(),
            is_far: t * d.length() > FAR * longest,
        })
    }
}
