//! Choice of a step in proportion to its size, by inverting cumulative sums.
//!
//! A guide table gives the first step of each of as many equal buckets of the last sum as there are steps. From there a
//! search is a step or two long on average (H. Chen, Y. Asau, "On Generating Random Variates from an Empirical
//! Distribution", AIIE Transactions 6(2), 1974), where bisection takes the logarithm of the number of steps.

use multiversion::multiversion;

use super::{LANES, Lanes};

/// Greatest number of steps that [`invert_packet`] compares one by one, in lanes, instead of searching lane by lane. For two
/// steps this takes 0.6 of the time of sixteen searches.
const FEW: usize = 8;

/// Steps that sixteen numbers choose.
pub(crate) struct ChosenSteps {
    /// Indices of the steps.
    pub(crate) index: Lanes<u32>,
    /// Positions within the steps, in [0, 1].
    pub(crate) within: Lanes<f64>,
}

/// Inverts cumulative sums for sixteen numbers, with the results of [`invert`].
pub(crate) fn invert_packet(sums: &[f64], guide: &[u32], u: &Lanes<f64>) -> ChosenSteps {
    let mut steps = ChosenSteps {
        index: [0; LANES],
        within: [0.0; LANES],
    };
    if sums.len() <= FEW {
        invert_few(sums, u, &mut steps);
        return steps;
    }
    for l in 0..LANES {
        let (index, within) = invert(sums, guide, u[l]);
        steps.index[l] = index as u32;
        steps.within[l] = within;
    }
    steps
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn invert_few(sums: &[f64], u: &Lanes<f64>, steps: &mut ChosenSteps) {
    // Find the last step that is not zero, which rounding may choose instead of those behind it
    let mut last = sums.len() - 1;
    while last > 0 && sums[last] == sums[last - 1] {
        last -= 1;
    }
    let total = sums[last];
    let (mut before, mut sum) = ([0.0; LANES], [sums[0]; LANES]);
    // Indices as wide as the sums, so that one comparison selects both
    let mut index = [0u64; LANES];
    for (step, ends) in sums[..=last].windows(2).enumerate() {
        // Go on from steps that end at or before the target
        let (end, next_end) = (ends[0], ends[1]);
        for l in 0..LANES {
            let is_beyond = end <= u[l] * total;
            index[l] = if is_beyond { step as u64 + 1 } else { index[l] };
            before[l] = if is_beyond { end } else { before[l] };
            sum[l] = if is_beyond { next_end } else { sum[l] };
        }
    }
    for l in 0..LANES {
        steps.index[l] = index[l] as u32;
        steps.within[l] = ((u[l] * total - before[l]) / (sum[l] - before[l])).clamp(0.0, 1.0);
    }
}

/// Inverts cumulative sums: returns the index of the step that contains the fraction `u` of the last sum, and the
/// position within that step, in [0, 1].
///
/// `guide` is the table that [`guide`] makes. Never selects a step of zero; the last sum must be positive.
#[inline(always)]
pub(crate) fn invert(sums: &[f64], guide: &[u32], u: f64) -> (usize, f64) {
    let last = sums.len() - 1;
    let target = u * sums[last];
    let bucket = ((u * sums.len() as f64) as usize).min(last);
    let mut chosen = guide[bucket] as usize;
    while chosen < last && sums[chosen] <= target {
        chosen += 1;
    }
    // Rounding may carry the target to another bucket, or to the end, where steps of zero may follow
    while chosen > 0 && (sums[chosen - 1] > target || sums[chosen] == sums[chosen - 1]) {
        chosen -= 1;
    }
    let before = if chosen == 0 { 0.0 } else { sums[chosen - 1] };
    let within = ((target - before) / (sums[chosen] - before)).clamp(0.0, 1.0);
    (chosen, within)
}

/// Appends the guide table of cumulative sums: for each bucket the first step whose sum is beyond its start.
pub(crate) fn guide(sums: &[f64], first_steps: &mut Vec<u32>) {
    let last = sums.len() - 1;
    let width = sums[last] / sums.len() as f64;
    let mut step = 0;
    for bucket in 0..sums.len() {
        while step < last && sums[step] <= width * bucket as f64 {
            step += 1;
        }
        first_steps.push(step as u32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    /// Returns the chosen step by a search from the first one.
    fn searched(sums: &[f64], u: f64) -> usize {
        let target = u * sums[sums.len() - 1];
        let mut chosen = sums
            .iter()
            .position(|&sum| sum > target)
            .unwrap_or(sums.len() - 1);
        while chosen > 0 && sums[chosen] == sums[chosen - 1] {
            chosen -= 1;
        }
        chosen
    }

    #[test]
    fn guided_search_finds_the_step_of_a_search_from_the_first_one() {
        let mut random = SplitMix64::new(3, 1);
        for count in [1, 2, 3, 7, 10, 1000] {
            for is_uneven in [false, true] {
                // Steps of zero, also at both ends, and steps that differ by ten orders of magnitude
                let mut sum = 0.0;
                let mut sums: Vec<f64> = Vec::new();
                for step in 0..count {
                    let is_zero = count > 3 && (step == 0 || step == count - 1 || step % 3 == 1);
                    let size = if is_uneven {
                        10f64.powf(-10.0 * random.unit())
                    } else {
                        1.0
                    };
                    sum += if is_zero { 0.0 } else { size };
                    sums.push(sum);
                }
                let mut table = Vec::new();
                guide(&sums, &mut table);
                // Random fractions, both ends, the starts of all steps, and numbers next to those of all buckets
                let starts = sums.iter().map(|start| (start / sum).min(1.0 - f64::EPSILON));
                let buckets = (1..count).map(|bucket| f64::from(bucket) / f64::from(count));
                let buckets = buckets.flat_map(|start| [start.next_down(), start, start.next_up()]);
                let random = (0..2000).map(|_| random.unit());
                let fractions: Vec<f64> = starts.chain(buckets).chain(random).collect();
                for u in fractions.into_iter().chain([0.0, 1.0 - 0.5 * f64::EPSILON, 1.0]) {
                    let (chosen, within) = invert(&sums, &table, u);
                    let steps = invert_packet(&sums, &table, &[u; LANES]);
                    assert_eq!(
                        (steps.index, steps.within),
                        ([chosen as u32; LANES], [within; LANES])
                    );
                    assert_eq!(chosen, searched(&sums, u), "{count} steps, {u}");
                    assert!((0.0..=1.0).contains(&within));
                    let before = if chosen == 0 { 0.0 } else { sums[chosen - 1] };
                    let found = before + within * (sums[chosen] - before);
                    assert!(
                        (found - u * sum).abs() <= 4.0 * f64::EPSILON * sum,
                        "{count} steps, {u}"
                    );
                }
            }
        }
    }
}
