//! Evaluation of an experiment's measurements: points, curves and the Pareto front.

use super::accumulated_reference::AccumulatedReference;
use super::layout::Layout;
use super::measure::Measured;
use super::view::View;
use super::workspace::Workspace;
use super::{
    Configuration, Curve, HitPath, ImageSums, Interval, Knob, ParetoPoint, Point, Reference, Study,
    StudyResult, front, slope,
};
use crate::image::metrics::{Metrics, Tally, Viewing};
use crate::parallel;
use crate::render::Rendering;

impl Workspace<'_, '_> {
    /// Evaluates all measurements, except for the checks of the reference.
    pub(super) fn findings(
        &self,
        layout: &Layout,
        strict: &Configuration,
        reference: &AccumulatedReference,
        measured: Measured,
    ) -> StudyResult {
        self.report_step("analyse");
        // Compute image metrics of each first image against the reference
        let mean = reference.mean();
        let renderings: Vec<Rendering> = measured.first.into_iter().flatten().collect();
        let viewing = Viewing {
            tone: self.experiment.tone,
            ..Viewing::default()
        };
        let metrics: Vec<Metrics> = parallel::map(renderings.len(), &|place| {
            let mut tally = Tally::default();
            // The sizes are equal, so that no error can occur.
            let _ = tally.add(&mean, &renderings[place].image, &viewing);
            tally.metrics()
        });
        // Assemble the points with times and errors
        let mut points: Vec<Point> = layout
            .candidates
            .iter()
            .enumerate()
            .map(|(place, candidate)| {
                let error = measured.errors[place].estimate(&reference.halves, place as u64);
                Point {
                    knob: candidate.knob,
                    level: candidate.level.clone(),
                    settings: candidate.configuration.words(),
                    build_seconds: self.built(&candidate.configuration).seconds,
                    build_bytes: self.built(&candidate.configuration).accel.report().bytes,
                    ready_seconds: renderings[place].ready_seconds,
                    seconds: Interval::of_median(&measured.blocks.seconds(place)),
                    time_ratio: Interval::of_median(&measured.blocks.ratios(place, 0)),
                    rmse: error.rmse(),
                    bias_squared: error.bias_squared,
                    variance: error.variance(),
                    rel_mse: metrics[place].rel_mse,
                    flip: metrics[place].flip,
                    max: metrics[place].displayed.max,
                    changed_share: metrics[place].changed_share,
                    non_finite: renderings[place].image.non_finite_count() as u64,
                    rays: renderings[place].ledger.total().rays,
                    instructions: None,
                    geometry: None,
                    on_front: false,
                }
            })
            .collect();
        // Count wrong hits and mark the Pareto front
        self.count_geometric_errors(layout, &mut points);
        let places: Vec<ParetoPoint> = points
            .iter()
            .map(|point| ParetoPoint {
                time: point.time_ratio,
                error: point.rmse,
            })
            .collect();
        for (point, on_front) in points.iter_mut().zip(front(&places)) {
            point.on_front = on_front;
        }
        // Fit the fall of the errors by their blocks of pixels
        let squares: Vec<Vec<f64>> = measured.errors.iter().map(ImageSums::block_squares).collect();
        let slope_of = |places: &[usize]| {
            let chosen = places
                .iter()
                .map(|&place| (points[place].time_ratio, &squares[place][..]));
            slope(&chosen.collect::<Vec<_>>())
        };
        // Assemble the study
        let study = Study {
            size: self.size_of(layout.view),
            pieces_of: match layout.view {
                View::Whole(_) => None,
                View::Patches(_) => Some(self.whole_size()),
            },
            threads: self.experiment.threads,
            reference: Reference {
                spp: layout.reference_spp * reference.count(),
                paths: [strict.path.name(), HitPath::BSP.name()],
                noise: reference.halves.noise_squared().sqrt(),
                checks: Vec::new(),
            },
            timing: measured.blocks.timing(self.spent(), self.experiment.budget),
            curves: curves(&points, &slope_of),
            choice: None,
            points,
        };
        StudyResult {
            study,
            reference: mean,
            chosen: None,
            patch_reference: None,
            embree: self
                .built(&layout.candidates[0].configuration)
                .accel
                .report()
                .embree,
            images: renderings.into_iter().map(|rendering| rendering.image).collect(),
            configurations: layout
                .candidates
                .iter()
                .map(|candidate| candidate.configuration)
                .collect(),
        }
    }
}

/// Returns a curve for every graded knob, the base included, in order of time; `slope_of` returns the slope through some
/// of the points.
fn curves(points: &[Point], slope_of: &dyn Fn(&[usize]) -> Option<Interval>) -> Vec<Curve> {
    let graded = Knob::ALL.into_iter().filter(|knob| knob.is_graded());
    graded
        .filter_map(|knob| {
            // Adaptive sampling distributes samples unevenly, so that the uniform base is not one of its levels.
            let from_base = knob != Knob::Adaptive;
            let of_knob = |&place: &usize| place == 0 && from_base || points[place].knob == Some(knob);
            let mut places: Vec<usize> = (0..points.len()).filter(of_knob).collect();
            if places.len() < 2 {
                return None;
            }
            places.sort_by(|&a, &b| points[a].seconds.value.total_cmp(&points[b].seconds.value));
            Some(Curve {
                knob,
                slope: slope_of(falling(points, &places)),
                points: places,
            })
        })
        .collect()
}

/// Returns those of `places`, which are in order of time, up to the first with the smallest error within its interval:
/// later levels take longer without less error.
fn falling<'p>(points: &[Point], places: &'p [usize]) -> &'p [usize] {
    let least = places
        .iter()
        .map(|&place| points[place].rmse.high)
        .fold(f64::INFINITY, f64::min);
    let first = places.iter().position(|&place| points[place].rmse.low <= least);
    &places[..first.map_or(places.len(), |first| first + 1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(knob: Option<Knob>, seconds: f64, rmse: f64) -> Point {
        Point {
            rmse: Interval {
                value: rmse,
                low: 0.9 * rmse,
                high: 1.1 * rmse,
            },
            ..Point::plain(knob, seconds, rmse)
        }
    }

    #[test]
    fn slope_uses_points_only_while_the_error_falls() {
        let depth = Some(Knob::Depth);
        let points = [
            point(None, 8.0, 0.125),
            point(depth, 1.0, 1.0),
            point(depth, 2.0, 0.5),
            point(depth, 4.0, 0.25),
            point(depth, 16.0, 0.125),
            point(depth, 32.0, 0.126),
            point(Some(Knob::Pattern), 32.0, 0.01),
        ];
        let slope_of = |places: &[usize]| {
            assert_eq!(places, [1, 2, 3, 0]);
            Some(Interval::exact(-1.0))
        };
        let curves = curves(&points, &slope_of);
        let names: Vec<Knob> = curves.iter().map(|curve| curve.knob).collect();
        assert_eq!(names, [Knob::Depth], "patterns are in no order");
        assert_eq!(curves[0].points, [1, 2, 3, 0, 4, 5]);
        assert_eq!(curves[0].slope, Some(Interval::exact(-1.0)));
    }
}
