//! Figure data of a case: its first queries, and line drawings of their scenes.
//!
//! The first rays of each verdict (right, tie, wrong) are kept, with the scene that they were traced through: its edges
//! if it has few, else its silhouette, and close-ups of what some of the rays pass. For formulas the first arguments
//! are kept with the errors there, and the worst.

use glam::{DVec2, DVec3};

use super::correctness::Correctness;
use super::wireframe::{self, Wireframe};
use crate::accel::Hit;
use crate::mesh::Mesh;
use crate::numeric::Ray;
use crate::scene::{Geometry, Scene};

/// Largest number of rays kept per verdict.
const MAX_RAYS: usize = 24;
/// Largest number of arguments kept, not counting the worst one and wrong ones.
const MAX_ARGUMENTS: usize = 320;
/// Largest number of close-ups per verdict.
const MAX_CLOSE_UPS: usize = 3;
/// Largest number of triangles in a close-up.
const MAX_TRIANGLES: usize = 64;
/// Half width of a close-up relative to the farthest corner of the triangle at its centre.
const CLOSE_UP_MARGIN: f64 = 1.7;

/// Ray with its result and verdict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracedRay {
    /// Ray that was traced.
    pub ray: Ray,
    /// Nearest hit that was returned; `None` also for any-hit queries.
    pub hit: Option<Hit>,
    /// Verdict on the result.
    pub correctness: Correctness,
}

/// Abscissa of an error plot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FigureAxis {
    /// Name of the argument, with its unit.
    pub label: &'static str,
    /// Largest error that counts as right.
    pub bound: f64,
}

/// Error of a formula at an argument, in the unit of the case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Error {
    /// Argument, in the unit that its [`FigureAxis`] gives.
    pub at: f64,
    /// Absolute error of the result.
    pub off: f64,
    /// Verdict on the error.
    pub correctness: Correctness,
}

/// Triangles around a ray, projected along it; the ray is the point in the centre.
#[derive(Clone, Debug, PartialEq)]
pub struct CloseUp {
    /// Ray as an index into [`FigureData::traced`].
    pub traced: usize,
    /// Triangles ahead of the origin; the figure shows the square [-1, 1]².
    pub triangles: Vec<[DVec2; 3]>,
    /// Half the width of the square, in the scene's unit.
    pub size: f64,
}

/// First queries of a case, with the drawings of their scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FigureData {
    /// Rays, in the order in which they were traced.
    pub traced: Vec<TracedRay>,
    /// Numbers of queries kept that were right, tied and wrong.
    counts: [usize; 3],
    /// Wireframe of the scene that the rays were traced through.
    pub wireframe: Option<Wireframe>,
    /// Close-ups around some of the rays.
    pub close_ups: Vec<CloseUp>,
    /// Abscissa of the error plot, for formulas.
    pub axis: Option<FigureAxis>,
    /// Errors of formulas, one an argument.
    pub errors: Vec<Error>,
    worst: Option<Error>,
}

impl FigureData {
    /// Keeps a ray if it is among the first of its verdict.
    pub(in crate::verify) fn keep(&mut self, traced: TracedRay) {
        let count = &mut self.counts[traced.correctness as usize];
        if *count < MAX_RAYS {
            *count += 1;
            self.traced.push(traced);
        }
    }

    /// Keeps an error if it is among the first, the worst so far, or wrong.
    pub(super) fn plot(&mut self, axis: FigureAxis, error: Error) {
        self.axis = Some(axis);
        // The negated comparison lets a NaN replace the worst error.
        if self.worst.is_none_or(|worst| !(error.off <= worst.off)) {
            self.worst = Some(error);
        }
        let count = &mut self.counts[error.correctness as usize];
        let is_early = self.errors.len() < MAX_ARGUMENTS;
        if is_early || (error.correctness == Correctness::Wrong && *count < MAX_RAYS) {
            *count += 1;
            self.errors.push(error);
        }
    }

    /// Returns the errors to be plotted: the first ones, and the worst.
    pub fn shown_errors(&self) -> impl Iterator<Item = &Error> {
        self.errors.iter().chain(&self.worst)
    }

    /// Merges two sketches; of two scenes keeps the one with the worse verdict, else the first.
    pub(super) fn with(mut self, other: FigureData) -> FigureData {
        // Keep one scene only: the one with the worse verdict
        if self.wireframe.is_some() && other.wireframe.is_some() {
            return if other.rank() > self.rank() { other } else { self };
        }
        if other.wireframe.is_some() && self.traced.is_empty() {
            return other;
        }
        // Merge the rays and errors
        other.traced.into_iter().for_each(|traced| self.keep(traced));
        if let Some(axis) = other.axis {
            for error in other.errors.into_iter().chain(other.worst) {
                self.plot(axis, error);
            }
        }
        self
    }

    /// Returns the interest of the sketch: 3 if something is wrong, 2 if something ties, 1 if there are rays, else 0.
    fn rank(&self) -> usize {
        match self.counts {
            [0, 0, 0] => 0,
            [_, 0, 0] => 1,
            [_, _, 0] => 2,
            _ => 3,
        }
    }

    /// Adds the wireframe of `scene` and close-ups around some of the rays.
    pub(in crate::verify) fn draw(&mut self, scene: &Scene) {
        // Draw the outline of the scene
        let hit_triangles: Vec<[u32; 2]> = self
            .traced
            .iter()
            .filter_map(|traced| traced.hit)
            .map(|hit| [hit.instance, hit.primitive])
            .collect();
        self.wireframe = Some(wireframe::of(scene, &hit_triangles));
        // Draw close-ups, those of wrong results first
        for correctness in [Correctness::Wrong, Correctness::Tie, Correctness::Right] {
            let kind = (0..self.traced.len()).filter(|&i| self.traced[i].correctness == correctness);
            let views: Vec<CloseUp> = kind
                .filter_map(|i| close_up(scene, &self.traced[i].ray, i))
                .take(MAX_CLOSE_UPS)
                .collect();
            self.close_ups.extend(views);
        }
    }
}

/// Triangle projected along a ray.
struct ProjectedTriangle {
    corners: [DVec2; 3],
    /// Mean depth of the corners ahead of the ray origin.
    depth: f64,
    /// Distance at which the ray passes the triangle, 0 if it passes through.
    distance_to_ray: f64,
}

fn close_up(scene: &Scene, ray: &Ray, traced: usize) -> Option<CloseUp> {
    if !ray.is_traceable() {
        return None;
    }
    // Build the coordinate system of the ray
    let ahead = ray.direction.as_dvec3().normalize();
    let across = ahead.any_orthonormal_vector();
    let up = across.cross(ahead);
    let o = ray.origin.as_dvec3();
    // Project the triangles that are not wholly behind the origin
    let mut seen = Vec::new();
    for instance in &scene.instances {
        let Geometry::Mesh(mesh) = &scene.geometries[instance.geometry as usize] else {
            continue;
        };
        let map = instance.world_from_object();
        seen.extend(triangles_of(mesh).filter_map(|corners| {
            let corners = corners.map(|p| map.transform_point3(p) - o);
            let depths = corners.map(|p| p.dot(ahead));
            if depths.iter().all(|&depth| depth <= 0.0) {
                return None;
            }
            let corners = corners.map(|p| DVec2::new(p.dot(across), p.dot(up)));
            Some(ProjectedTriangle {
                distance_to_ray: distance_to_ray(&corners),
                depth: depths.iter().sum::<f64>() / 3.0,
                corners,
            })
        }));
    }
    // Find the triangle that the ray passes closest to; of several the nearest along the ray
    let order = |a: &ProjectedTriangle, b: &ProjectedTriangle| {
        let by_depth = a.depth.total_cmp(&b.depth);
        a.distance_to_ray.total_cmp(&b.distance_to_ray).then(by_depth)
    };
    let middle = seen.iter().min_by(|a, b| order(a, b))?;
    let size = CLOSE_UP_MARGIN * middle.corners.iter().map(|p| p.length()).fold(0.0, f64::max);
    // Reject empty and infinite windows
    if !(size > 0.0 && size < f64::INFINITY) {
        return None;
    }
    // Keep the triangles in the window that are closest to the ray
    seen.retain(|triangle| triangle.distance_to_ray < size);
    seen.sort_by(order);
    seen.truncate(MAX_TRIANGLES);
    // Sort far ones first, for the painter's algorithm
    seen.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    Some(CloseUp {
        traced,
        triangles: seen.iter().map(|seen| seen.corners.map(|p| p / size)).collect(),
        size,
    })
}

fn triangles_of(mesh: &Mesh) -> impl Iterator<Item = [DVec3; 3]> {
    (0..mesh.triangles.len() as u32).map(|number| mesh.corners_f64(number))
}

/// Returns the distance from the origin to a triangle, 0 inside.
fn distance_to_ray([a, b, c]: &[DVec2; 3]) -> f64 {
    let sides = [(a, b), (b, c), (c, a)];
    let turns = sides.map(|(p, q)| p.perp_dot(*q));
    if turns.iter().all(|&t| t > 0.0) || turns.iter().all(|&t| t < 0.0) {
        return 0.0;
    }
    let to_side = |(p, q): (&DVec2, &DVec2)| {
        let along = *q - *p;
        let length_squared = along.length_squared();
        let t = if length_squared > 0.0 {
            (-p.dot(along) / length_squared).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (*p + t * along).length()
    };
    sides.map(to_side).into_iter().fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::test_meshes::{icosphere, scene};
    use super::*;

    fn traced(correctness: Correctness) -> TracedRay {
        TracedRay {
            ray: Ray::new(Vec3::ZERO, Vec3::new(0.1, 0.2, 1.0)),
            hit: None,
            correctness,
        }
    }

    #[test]
    fn first_rays_of_each_verdict_are_kept() {
        let mut figure_data = FigureData::default();
        (0..1000).for_each(|_| figure_data.keep(traced(Correctness::Right)));
        figure_data.keep(traced(Correctness::Wrong));
        assert_eq!(figure_data.counts, [MAX_RAYS, 0, 1]);
        let twice = figure_data.clone().with(figure_data);
        assert_eq!(twice.counts, [MAX_RAYS, 0, 2]);
        assert_eq!(twice.traced.len(), MAX_RAYS + 2);
    }

    #[test]
    fn scene_with_wrong_result_is_drawn() {
        let with = |correctness| {
            let mut figure_data = FigureData::default();
            figure_data.keep(traced(correctness));
            figure_data.draw(&scene(vec![Geometry::Mesh(icosphere(1))]));
            figure_data
        };
        let [right, tie, wrong] = [Correctness::Right, Correctness::Tie, Correctness::Wrong].map(with);
        assert_eq!(right.clone().with(wrong.clone()), wrong);
        assert_eq!(wrong.clone().with(right.clone()), wrong);
        assert_eq!(right.clone().with(tie.clone()).with(wrong.clone()), wrong);
        assert_eq!(tie.clone().with(right), tie);
    }

    #[test]
    fn close_up_shows_hit_triangle_and_nothing_behind_the_ray() {
        let mut figure_data = FigureData::default();
        figure_data.keep(traced(Correctness::Right));
        figure_data.draw(&scene(vec![Geometry::Mesh(icosphere(1))]));
        let [view] = &figure_data.close_ups[..] else {
            panic!("one ray has one close-up");
        };
        let around = view
            .triangles
            .iter()
            .filter(|t| distance_to_ray(t) == 0.0)
            .count();
        assert_eq!(around, 1);
        // The ray starts inside the sphere, so about half of the 80 triangles are behind its origin.
        assert!(view.triangles.len() < 60, "{}", view.triangles.len());
        assert!(view.size < 2.0);
    }

    #[test]
    fn the_distance_to_a_triangle_is_that_to_its_nearest_side() {
        let at = |x: f64, y: f64| DVec2::new(x, y);
        assert_eq!(
            distance_to_ray(&[at(-1.0, -1.0), at(1.0, -1.0), at(0.0, 1.0)]),
            0.0
        );
        assert_eq!(distance_to_ray(&[at(-1.0, 2.0), at(1.0, 2.0), at(0.0, 3.0)]), 2.0);
        assert_eq!(distance_to_ray(&[at(3.0, 4.0); 3]), 5.0);
    }

    #[test]
    fn plot_keeps_argument_with_largest_error() {
        let mut figure_data = FigureData::default();
        let axis = FigureAxis {
            label: "x",
            bound: 4.0,
        };
        for i in 0..10_000 {
            let off = if i == 7777 { 3.0 } else { 0.5 };
            let at = f64::from(i);
            figure_data.plot(
                axis,
                Error {
                    at,
                    off,
                    correctness: Correctness::Right,
                },
            );
        }
        assert_eq!(figure_data.shown_errors().count(), MAX_ARGUMENTS + 1);
        assert!(figure_data.shown_errors().any(|error| error.at == 7777.0));
    }
}
