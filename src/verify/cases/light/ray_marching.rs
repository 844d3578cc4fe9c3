//! Ray marching through a homogeneous medium: neither the number of steps nor the length of the last one may affect the
//! result.

use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, FigureAxis};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H40",
    title: "ray marching steps",
    construction: "1 to 10^6 steps of a length that divides the slab, exactly, by some ulps more or less, or not at all",
    oracle: "exponential of the depth: in a homogeneous medium the result does not depend on the number of steps",
    bound: "10^-12 (1 + depth) of the radiance and of the transmittance",
    unit: "of the bound",
    run: |trial| Ok(marches(trial)),
    ..Case::FORMULAS
}];

/// Relative error bound of a march, to be multiplied by 1 + optical depth.
const BOUND: f64 = 1e-12;
const STEPS: FigureAxis = FigureAxis {
    label: "steps",
    bound: 1.0,
};

fn marches(trial: &CaseRunner) -> Counts {
    const MAX_RAYS: u64 = 1_000_000;
    let mut tally = Counts::default();
    let mut count = 1;
    while count <= trial.rays.min(MAX_RAYS) {
        // Try steps that divide the length exactly, nearly and not at all
        for length in [2.0, 1.0, 1.7, 1.0 / 3.0] {
            let even = length / count as f64;
            let beside = [even.next_up(), even.next_down(), even * (1.0 + 1e-9), even * 1.1];
            for step in std::iter::once(even).chain(beside) {
                for sigma in [1e-6, 0.3, 20.0] {
                    run_query(trial, (sigma, length, step), &mut tally);
                }
            }
        }
        count *= 10;
    }
    tally
}

fn run_query(trial: &CaseRunner, (sigma, length, step): (f64, f64, f64), tally: &mut Counts) {
    // March through the medium
    let found = (trial.subject.formulas.march)(sigma, length, step);
    // Compare with the Beer-Lambert law
    let depth = sigma * length;
    let exact = [-(-depth).exp_m1(), (-depth).exp()];
    let bound = BOUND * (1.0 + depth);
    let off = |i: usize| (found[i] - exact[i]).abs() / (exact[i] * bound);
    let worst = off(0).max(off(1));
    tally.record_error_at(STEPS, length / step, worst);
    tally.count(Correctness::wrong_if(!(off(0) <= 1.0 && off(1) <= 1.0)), || {
        format!("extinction {sigma:e} over {length:e} in steps of {step:e}: {found:?}, not {exact:?}")
    });
}
