//! Counts of a case's queries, wrong results and ties.

use serde::Serialize;

use super::correctness::Correctness;
use super::figure_data::{Error, FigureAxis, FigureData, TracedRay};
use super::query_result::describe;
use crate::accel::Hit;
use crate::numeric::Ray;
use crate::render::Rendering;

/// Counts of a case, with its largest error.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Counts {
    /// Number of queries: rays, or arguments of a formula.
    pub rays: u64,
    /// Results that are wrong by more than the rounding error bound.
    pub wrong: u64,
    /// Results that differ from the exact one within the rounding error bound.
    pub ties: u64,
    /// Largest error, in the unit of the case; 0 if the case measures none.
    pub worst: f64,
    /// First wrong result, in a form that allows reproducing the ray.
    pub example: Option<String>,
    /// First queries of each kind, for figures.
    #[serde(skip)]
    pub figure_data: FigureData,
}

impl Counts {
    /// Counts one result; `describe` is called only for the first wrong one.
    pub(in crate::verify) fn count(&mut self, correctness: Correctness, describe: impl FnOnce() -> String) {
        self.rays += 1;
        match correctness {
            Correctness::Right => {}
            Correctness::Tie => self.ties += 1,
            Correctness::Wrong => {
                self.wrong += 1;
                self.example.get_or_insert_with(describe);
            }
        }
    }

    /// Counts the result of a ray query and keeps the ray if it is among the first of its kind.
    pub(in crate::verify) fn count_ray(&mut self, correctness: Correctness, ray: &Ray, hit: Option<Hit>) {
        let ray = *ray;
        self.figure_data.keep(TracedRay {
            ray,
            hit,
            correctness,
        });
        self.count(correctness, || describe(&ray, hit));
    }

    /// Counts the secondary rays of an image; its camera rays have been counted with their verdicts.
    pub(in crate::verify) fn count_secondary_rays(&mut self, rendering: &Rendering) {
        let pixels = rendering.image.pixels.len() as u64;
        self.rays += rendering.ledger.total().rays.saturating_sub(pixels);
    }

    /// Records the error of a formula at an argument, for the plot.
    pub(in crate::verify) fn record_error_at(&mut self, axis: FigureAxis, at: f64, off: f64) {
        self.record_error(off);
        let correctness = Correctness::wrong_if(!(off <= axis.bound));
        self.figure_data.plot(axis, Error { at, off, correctness });
    }

    /// Records an error, in the unit of the case.
    pub(in crate::verify) fn record_error(&mut self, error: f64) {
        // NaN counts as an infinite error.
        let error = if error.is_nan() { f64::INFINITY } else { error };
        self.worst = self.worst.max(error);
    }

    /// Returns the sum of two tallies; the first example wins.
    pub(in crate::verify) fn with(self, other: Counts) -> Counts {
        Counts {
            rays: self.rays + other.rays,
            wrong: self.wrong + other.wrong,
            ties: self.ties + other.ties,
            worst: self.worst.max(other.worst),
            example: self.example.or(other.example),
            figure_data: self.figure_data.with(other.figure_data),
        }
    }
}
