//! Exact nearest hit among triangles, and the verdict on a hit against it.

use glam::DVec3;

use super::correctness::Correctness;
use super::expansion::{self, SurfaceCrossing};
use crate::accel::Hit;
use crate::accel::hit_compare::compare;
use crate::numeric::Ray;
use crate::scene::Scene;

/// Returns the nearest triangle that the ray hits, with its parameter in f64, among the triangles that `is_near`
/// admits.
pub(in crate::verify) fn exact_nearest(
    triangles: &[[DVec3; 3]],
    ray: &Ray,
    is_near: impl Fn(usize) -> bool,
) -> Option<(Hit, f64)> {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let is_hit = |corners: &[DVec3; 3]| {
        matches!(
            expansion::crossing(o, d, *corners),
            SurfaceCrossing::Through | SurfaceCrossing::Touching
        )
    };
    // Keep triangles that the line intersects exactly
    let near = triangles
        .iter()
        .enumerate()
        .filter(|&(number, _)| is_near(number));
    let hits = near.filter(|(_, corners)| is_hit(corners));
    // Find the nearest one ahead of the origin
    let at = hits.map(|(number, corners)| (number, expansion::parameter(o, d, *corners)));
    let ahead = at.filter(|(_, t)| t.nearest() >= 0.0);
    let (number, t) = ahead.reduce(|a, b| if b.1 < a.1 { b } else { a })?;
    let hit = Hit {
        instance: 0,
        primitive: number as u32,
        t: t.nearest() as f32,
        u: 0.0,
        v: 0.0,
    };
    Some((hit, t.nearest()))
}

/// Converts the verdict of the backend comparison on `hit` against `expansion`.
pub(in crate::verify) fn judge_against(
    scene: &Scene,
    ray: &Ray,
    exact: Option<Hit>,
    hit: Option<Hit>,
) -> Correctness {
    compare(scene, ray, exact, hit).into()
}
