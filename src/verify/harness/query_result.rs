//! Result of a ray query, and its text with the ray.

use std::fmt;

use crate::accel::Hit;
use crate::numeric::Ray;

/// Result of a nearest-hit or any-hit query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum QueryResult {
    /// Nearest hit of the ray.
    Hit {
        /// Instance as an index into [`Scene::instances`](crate::scene::Scene::instances).
        instance: u32,
        /// Triangle of the mesh or part of the shape.
        primitive: u32,
        /// Parameter along the ray.
        t: f32,
    },
    /// Miss of a nearest-hit query.
    Nothing,
    /// Any-hit query that is occluded.
    Blocked,
    /// Any-hit query that is not occluded.
    Free,
}

impl QueryResult {
    /// Converts the result of a nearest-hit query.
    pub(in crate::verify) fn of_hit(hit: Option<Hit>) -> QueryResult {
        hit.map_or(QueryResult::Nothing, |hit| QueryResult::Hit {
            instance: hit.instance,
            primitive: hit.primitive,
            t: hit.t,
        })
    }
}

impl fmt::Display for QueryResult {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            QueryResult::Hit {
                instance,
                primitive,
                t,
            } => write!(f, "instance {instance} primitive {primitive} at {t:e}"),
            QueryResult::Nothing => f.write_str("nothing"),
            QueryResult::Blocked => f.write_str("blocked"),
            QueryResult::Free => f.write_str("not blocked"),
        }
    }
}

/// Formats a ray with its hit so that both can be reproduced.
pub fn describe(ray: &Ray, hit: Option<Hit>) -> String {
    format!("{}: {}", describe_ray(ray), QueryResult::of_hit(hit))
}

/// Formats a ray so that it can be reproduced.
pub fn describe_ray(ray: &Ray) -> String {
    let Ray {
        origin: o,
        direction: d,
        t_near,
        t_far,
        ..
    } = ray;
    format!(
        "from [{:e}, {:e}, {:e}] along [{:e}, {:e}, {:e}] between {t_near:e} and {t_far:e}",
        o.x, o.y, o.z, d.x, d.y, d.z
    )
}
