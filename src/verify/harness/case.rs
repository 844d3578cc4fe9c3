//! Numerically hard test case.

use serde::Serialize;

use super::counts::Counts;
use super::runner::{CaseRunner, Recording};
use super::system_under_test::SystemUnderTest;
use super::variant::{BackendVariant, Watertightness};
use crate::accel::AccelError;

/// Kind of code that a case tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum CaseKind {
    /// Triangle intersection, on every variant that finds hits.
    Triangles,
    /// Intersection of analytic shapes, on every variant that finds hits.
    Shapes,
    /// Formulas that need no scene.
    Formulas,
}

/// Numerically hard test case with its oracle and error bound.
#[derive(Clone, Copy, Serialize)]
pub struct Case {
    /// Identifier of the case: `H` and two digits.
    pub id: &'static str,
    /// Name of the case in reports.
    pub title: &'static str,
    /// Description of the rays or arguments that the case generates.
    pub construction: &'static str,
    /// Description of the oracle that yields the expected results.
    pub oracle: &'static str,
    /// Largest admissible error of a result, in words.
    pub bound: &'static str,
    /// Unit of the largest error; empty if the case measures none.
    pub unit: &'static str,
    /// Kind of code that the case tests.
    #[serde(rename = "asks")]
    pub kind: CaseKind,
    /// Least watertightness from which on a variant must return nothing wrong.
    pub required: Watertightness,
    #[serde(skip)]
    pub(in crate::verify) run: fn(&CaseRunner) -> Result<Counts, AccelError>,
}

impl Case {
    /// Case of triangles without texts, queries or errors, that every variant must pass: a base for struct updates.
    pub(in crate::verify) const TRIANGLES: Case = Case {
        id: "",
        title: "",
        construction: "",
        oracle: "",
        bound: "",
        unit: "",
        kind: CaseKind::Triangles,
        required: Watertightness::Faces,
        run: |_| Ok(Counts::default()),
    };

    /// Case of analytic shapes, as [`Case::TRIANGLES`] for other values.
    pub(in crate::verify) const SHAPES: Case = Case {
        kind: CaseKind::Shapes,
        ..Case::TRIANGLES
    };

    /// Case of formulas, as [`Case::TRIANGLES`] for other values.
    pub(in crate::verify) const FORMULAS: Case = Case {
        kind: CaseKind::Formulas,
        required: Watertightness::Vertices,
        ..Case::TRIANGLES
    };

    /// Returns whether the case can run on `variant`.
    pub fn applies_to(&self, path: &BackendVariant) -> bool {
        (self.kind == CaseKind::Formulas) == path.accel.is_none()
    }

    /// Returns whether the case must have no wrong results on `variant`.
    pub fn requires(&self, path: &BackendVariant) -> bool {
        path.closes >= self.required
    }

    /// Runs the case on `subject` with about `rays` queries.
    ///
    /// # Errors
    ///
    /// Fails if an acceleration structure cannot be built.
    pub fn run_case(&self, rays: u64, subject: &SystemUnderTest) -> Result<Counts, AccelError> {
        self.run_recording(Recording::Queries, rays, subject)
    }

    /// Runs the case as [`Case::run_case`] does, and adds the requested details to [`Counts::figure_data`].
    pub(super) fn run_recording(
        &self,
        recording: Recording,
        rays: u64,
        subject: &SystemUnderTest,
    ) -> Result<Counts, AccelError> {
        (self.run)(&CaseRunner::new(self.id, rays.max(1), subject, recording))
    }
}
