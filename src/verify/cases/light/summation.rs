//! Accuracy of long sums and products: opacity correction, transmittance of many layers, and sums of pixel samples.

use crate::numeric::{DoubleDouble, LANES, Lanes, SplitMix64};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, FigureAxis};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H41",
        title: "corrected opacity",
        construction: "opacities from 10^-9 to 1 - 2^-24 over 10^-6 to 10^6 times their step",
        oracle: "exponential and logarithm to 84 bits",
        bound: "4 ulp",
        unit: "ulp",
        run: |trial| Ok(trial.in_chunks(&|random, count| opacities(trial, random, count))),
        ..Case::FORMULAS
    },
    Case {
        id: "H42",
        title: "transmittance",
        construction: "depths from 0 to 700 in 1 to 10^7 layers, and some so deep that the transmittance underflows",
        oracle: "exponential to 84 bits",
        bound: "10^-9 (1 + depth) of the exact value, 0 where it underflows",
        unit: "of the bound",
        run: |trial| Ok(layers(trial)),
        ..Case::FORMULAS
    },
    Case {
        id: "H43",
        title: "pixel sums",
        construction: "sums of 1, of tenths, and of mixtures of 1, 10^8 and 10^-8 over up to 2^30 samples",
        oracle: "sums to 106 bits",
        bound: "10^-12 of the exact value",
        unit: "of the bound",
        run: |trial| Ok(pixels(trial)),
        ..Case::FORMULAS
    },
];

/// Largest admissible error of an opacity in ulps.
const OPACITY_ULPS: f64 = 4.0;
const OPACITY: FigureAxis = FigureAxis {
    label: "length over the step of the given opacity",
    bound: OPACITY_ULPS,
};
const LAYERS: FigureAxis = FigureAxis {
    label: "layers",
    bound: 1.0,
};
const SAMPLES: FigureAxis = FigureAxis {
    label: "mixture",
    bound: 1.0,
};

fn opacities(trial: &CaseRunner, random: &mut SplitMix64, count: usize) -> Counts {
    let mut tally = Counts::default();
    for _ in 0..count {
        // Choose opacities close to 0 and close to 1
        let small = 10f64.powf(random.within(-9.0, 0.0));
        let alpha = match random.below(2) {
            0 => small.min(1.0 - 0.5f64.powi(24)),
            // Close to 1 the logarithm cancels.
            _ => 1.0 - small.max(0.5f64.powi(24)),
        };
        // Compare with the double-double result
        let ratio = 10f64.powf(random.within(-6.0, 6.0));
        let found = (trial.subject.formulas.corrected_opacity)(alpha, ratio);
        let exact = -(DoubleDouble::of(ratio) * (-DoubleDouble::of(alpha)).ln_1p()).exp_m1();
        let off = exact.ulps_from(found);
        tally.record_error_at(OPACITY, ratio, off);
        tally.count(Correctness::wrong_if(!(off <= OPACITY_ULPS)), || {
            format!("{alpha:e} over {ratio:e} steps is {found:e}, {off} ulp off")
        });
    }
    tally
}

/// Counts `found` against `expansion` and records its error as a share of `bound`, plotted over `at`.
fn hold(
    tally: &mut Counts,
    (axis, at): (FigureAxis, f64),
    [found, exact]: [f64; 2],
    bound: f64,
    describe: impl FnOnce() -> String,
) {
    // Avoid 0 / 0 where the result is exactly 0
    let off = (found - exact).abs();
    let share = if off == 0.0 { 0.0 } else { off / bound };
    tally.record_error_at(axis, at, share);
    tally.count(Correctness::wrong_if(!(share <= 1.0)), || {
        format!("{}: {found:e}, not {exact:e}", describe())
    });
}

/// Tests 1, 10, 100, ... layers, up to the number of rays or 10^7.
fn layers(trial: &CaseRunner) -> Counts {
    const MAX_RAYS: u64 = 10_000_000;
    let mut tally = Counts::default();
    let mut count = 1;
    // Try optical depths from 0 to beyond underflow, in layers of equal depth
    while count <= trial.rays.min(MAX_RAYS) {
        for tau in [
            0.0,
            1e-12,
            1e-3,
            0.1,
            1.0,
            3.7,
            30.0,
            300.0,
            700.0,
            1e4,
            f64::INFINITY,
        ] {
            let layer = tau / count as f64;
            let found = (trial.subject.formulas.transmittance)(layer, count);
            // Take the sum of the rounded layers, which differs slightly from the total depth
            let depth = DoubleDouble::of(layer) * DoubleDouble::of(count as f64);
            // Beyond a depth of 745 the transmittance underflows to 0
            let exact = if tau > 745.0 {
                0.0
            } else {
                ((-depth).exp_m1() + DoubleDouble::ONE).nearest()
            };
            let bound = 1e-9 * (1.0 + tau) * exact;
            hold(&mut tally, (LAYERS, count as f64), [found, exact], bound, || {
                format!("depth {tau:e} in {count} layers")
            });
        }
        count *= 10;
    }
    tally
}

/// Sample values that a pixel sums up cyclically.
const MIXTURES: [&[f32]; 4] = [&[1.0], &[0.1], &[1.0, 1e8, 1e-8], &[1e8, 1e-8, -1e8, 1.0]];

fn pixels(trial: &CaseRunner) -> Counts {
    const MAX_RAYS: u64 = 1 << 30;
    let mut tally = Counts::default();
    // Sum up whole packets, with four accumulators
    let packets = (trial.rays.min(MAX_RAYS) / LANES as u64).max(1);
    // Add up the mixture cyclically with the function under test
    for (number, mixture) in MIXTURES.iter().enumerate() {
        let sample = |i: u64| mixture[(i % mixture.len() as u64) as usize];
        let lanes = |packet: u64| -> Lanes<f32> {
            std::array::from_fn(|lane| sample(packet * LANES as u64 + lane as u64))
        };
        let found = (trial.subject.formulas.pixel_sum)(&lanes, packets);
        let count = packets * LANES as u64;
        // Compute the exact sum from whole cycles and a rest
        let (rounds, rest) = (count / mixture.len() as u64, count % mixture.len() as u64);
        let sum = |part: &[f32]| {
            part.iter()
                .fold(DoubleDouble::ZERO, |sum, &x| sum + DoubleDouble::of(x.into()))
        };
        let exact = sum(mixture) * DoubleDouble::of(rounds as f64) + sum(&mixture[..rest as usize]);
        // For mixed signs the bound is relative to the sum of absolute values.
        let size: f64 = mixture.iter().map(|x| f64::from(x.abs())).sum::<f64>() * (rounds + 1) as f64;
        let (at, sums) = ((SAMPLES, number as f64), [found, exact.nearest()]);
        hold(&mut tally, at, sums, 1e-12 * size, || {
            format!("mixture {number} of {count} samples")
        });
    }
    tally
}
