//! Result rows of the verification suite of hard cases: `whit verify`.

use std::collections::BTreeSet;
use std::fmt::Write;

use serde::Serialize;

use crate::accel::Backend;
use crate::mesh::simd::SimdLimit;
use crate::verify::{BackendVariant, Case, CaseKind, Outcome, VARIANTS, Verdict, Watertightness};

/// Result of one case on one backend configuration.
#[derive(Clone, Serialize)]
pub struct VerifyRow {
    /// Case that was verified.
    #[serde(flatten)]
    pub case: Case,
    /// Name of the backend configuration.
    pub path: &'static str,
    /// Instruction set of Embree, or of the native tree's kernels.
    pub isa: Option<String>,
    /// Verdict and counts of the case.
    #[serde(flatten)]
    pub outcome: Outcome,
}

impl VerifyRow {
    /// Returns the row of an outcome on a variant that was restricted to the instruction set `isa`, if one is given.
    pub fn new(case: &Case, path: &BackendVariant, isa: Option<&str>, outcome: Outcome) -> VerifyRow {
        // Name the form of the native tree's kernels; Embree names its own
        let isa = match path.accel {
            Some((Backend::Native, ..)) => Some(SimdLimit::within(isa).name().to_owned()),
            _ => outcome.embree.as_ref().map(|embree| embree.isa.clone()),
        };
        VerifyRow {
            case: *case,
            path: path.name,
            isa,
            outcome,
        }
    }

    /// Returns the largest error with its unit, or an empty text if the case measures none.
    pub(in crate::report) fn worst(&self) -> String {
        if self.case.unit.is_empty() {
            return String::new();
        }
        format!("{:.2} {}", self.outcome.tally.worst, self.case.unit)
    }
}

/// Returns the name of a verdict in reports.
pub(in crate::report) fn word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Holds => "holds",
        Verdict::Measured => "measured",
        Verdict::Fails => "FAILS",
    }
}

/// Returns all rows as a table with a heading for each case; then the first wrong result of every check that failed.
pub fn table(rows: &[VerifyRow]) -> String {
    let mut text = String::new();
    // List the Embree versions
    let versions: BTreeSet<&str> = rows
        .iter()
        .filter_map(|row| row.outcome.embree.as_ref())
        .map(|embree| embree.version.as_str())
        .collect();
    for version in versions {
        text += &format!("Embree {version}\n");
    }
    let mut last = "";
    // Print each row below the heading of its case
    for row in rows {
        // Writing to a string cannot fail.
        if row.case.id != last {
            let _ = writeln!(text, "\n{} {}: {}", row.case.id, row.case.title, row.case.bound);
            let _ = writeln!(
                text,
                "    {:17} {:8} {:>12} {:>10} {:>10} {:>16}",
                "path", "isa", "rays", "wrong", "ties", "worst"
            );
            last = row.case.id;
        }
        let tally = &row.outcome.tally;
        let isa = row.isa.as_deref().unwrap_or_default();
        let _ = writeln!(
            text,
            "    {:17} {:8} {:>12} {:>10} {:>10} {:>16}  {}",
            row.path,
            isa,
            tally.rays,
            tally.wrong,
            tally.ties,
            row.worst(),
            word(row.outcome.verdict),
        );
    }
    // Print an example of every failed check
    for row in rows.iter().filter(|row| row.outcome.verdict == Verdict::Fails) {
        if let Some(example) = &row.outcome.tally.example {
            let _ = writeln!(text, "\n{} on {}: {example}", row.case.id, row.path);
        }
    }
    // Print the number of checks by verdict
    let count = |verdict| rows.iter().filter(|row| row.outcome.verdict == verdict).count();
    let _ = writeln!(
        text,
        "\n{} checks: {} hold, {} measured without a requirement, {} failed",
        rows.len(),
        count(Verdict::Holds),
        count(Verdict::Measured),
        count(Verdict::Fails)
    );
    text
}

/// Returns the construction and requirement of each case, and the list of those missing among the 48 planned ones.
pub fn case_list(cases: &[&Case]) -> String {
    let mut text = String::new();
    for case in cases {
        let _ = writeln!(text, "{} {}", case.id, case.title);
        let _ = writeln!(text, "    input     {}", case.construction);
        let _ = writeln!(text, "    oracle    {}", case.oracle);
        let _ = writeln!(text, "    requires  {}, {}", case.bound, required_of(case));
    }
    // List planned cases that the suite lacks
    let missing: Vec<String> = (1..=PLANNED)
        .map(|number| format!("H{number:02}"))
        .filter(|id| !crate::verify::cases().iter().any(|case| case.id == id))
        .collect();
    if !missing.is_empty() {
        let _ = writeln!(text, "\nPlanned, but not in this suite: {}", missing.join(", "));
    }
    text
}

/// Number of planned cases, implemented or not.
const PLANNED: u32 = 48;

pub(in crate::report) fn required_of(case: &Case) -> String {
    if case.kind == CaseKind::Formulas {
        return "for the formulas".into();
    }
    if case.required == Watertightness::Faces {
        return "on every path".into();
    }
    let names: Vec<&str> = VARIANTS
        .iter()
        .filter(|path| case.applies_to(path) && case.requires(path))
        .map(|path| path.name)
        .collect();
    format!("on {}; measured on the others", names.join(", "))
}
