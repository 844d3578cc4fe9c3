//! Times in a randomised block design: every candidate runs once per block in random order, beside a calibration kernel
//! that detects whether the machine was busy with something else.

use std::hint::black_box;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::statistics::median;
use super::turn_time::TurnTime;
use crate::numeric::SplitMix64;
use crate::processor_time::thread_seconds;

/// Largest relative deviation of a block's kernel time from the median at which the block counts.
const MAX_KERNEL_DEVIATION: f64 = 0.05;
/// Rounds of the calibration kernel, which take some milliseconds.
const KERNEL_ROUNDS: u64 = 1 << 21;

/// Limits of a measurement: number of blocks, deadline and random order.
#[derive(Clone, Copy, Debug)]
pub struct Protocol {
    /// Number of blocks that are measured regardless of the deadline.
    pub least: usize,
    /// Largest number of blocks, which resolves times finely enough for all uses.
    pub most: usize,
    /// Time by which the last block must end.
    pub deadline: Instant,
    /// Seed of the random order within blocks.
    pub seed: u64,
}

impl Protocol {
    /// Returns the protocol of exactly `count` blocks.
    pub fn of_blocks(count: usize, seed: u64) -> Protocol {
        Protocol {
            least: count,
            most: count,
            deadline: Instant::now(),
            seed,
        }
    }

    /// Returns whether another block begins after `blocks` of them, the longest of which took `longest` seconds.
    pub(crate) fn may_continue(&self, blocks: usize, longest: f64) -> bool {
        let left = self
            .deadline
            .saturating_duration_since(Instant::now())
            .as_secs_f64();
        blocks < self.most && (blocks < self.least || left >= 1.05 * longest)
    }

    /// Returns the finished fraction of a measurement that began at `start`, after `blocks` blocks and parts of one.
    fn fraction(&self, start: Instant, blocks: f64) -> f64 {
        let whole = self.deadline.saturating_duration_since(start).as_secs_f64();
        let by_time = start.elapsed().as_secs_f64() / whole.max(f64::MIN_POSITIVE);
        (blocks / self.least as f64).min(by_time.max(blocks / self.most as f64))
    }
}

/// Conditions under which times were measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Number of blocks that count; every configuration runs once in each.
    pub blocks: usize,
    /// Number of blocks that do not count because the machine was busy.
    pub dropped: usize,
    /// Largest deviation of the calibration kernel among the blocks that count, as a fraction of its median.
    pub calibration_spread: f64,
    /// Fraction of its time in which the calibration kernel waited for a processor: other programs used it.
    #[serde(default)]
    pub waiting: f64,
    /// Seconds that the whole study took.
    pub spent: f64,
    /// Seconds that the study was allowed to take.
    pub budget: f64,
}

/// Measured times of all candidates in all blocks.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Blocks {
    /// Processor seconds of the less disturbed run of the kernel in each block.
    calibration: Vec<f64>,
    /// Times of both runs of the kernel together, one for each block.
    kernels: Vec<TurnTime>,
    /// Times of each candidate, one for each block.
    turns: Vec<Vec<TurnTime>>,
}

impl Blocks {
    /// Measures `candidates` candidates in blocks: `turn` receives the candidate and the block, and returns its
    /// time. `progress` receives the finished fraction after each turn.
    ///
    /// # Errors
    ///
    /// The first error of `turn`, which thereby cancels the measurement.
    pub fn measure<E>(
        candidates: usize,
        protocol: &Protocol,
        progress: &dyn Fn(f64),
        mut turn: impl FnMut(usize, usize) -> Result<TurnTime, E>,
    ) -> Result<Blocks, E> {
        let mut blocks = Blocks::new(candidates);
        let (start, mut turns, mut longest) = (Instant::now(), 0, 0.0f64);
        while protocol.may_continue(blocks.count(), longest) {
            let seconds = blocks.add(protocol.seed, |candidate, block| {
                let time = turn(candidate, block)?;
                turns += 1;
                progress(protocol.fraction(start, f64::from(turns) / candidates as f64));
                Ok(time)
            })?;
            longest = longest.max(seconds);
        }
        Ok(blocks)
    }

    /// Returns these blocks with each `count` consecutive ones added up to one: turns that were divided among them become
    /// whole.
    pub(crate) fn summed(&self, count: usize) -> Blocks {
        let sums = |turns: &Vec<TurnTime>| {
            turns
                .chunks(count)
                .map(|part| part.iter().copied().sum())
                .collect()
        };
        Blocks {
            calibration: self
                .calibration
                .chunks(count)
                .map(|part| part.iter().sum())
                .collect(),
            kernels: sums(&self.kernels),
            turns: self.turns.iter().map(sums).collect(),
        }
    }

    /// Returns an empty measurement of `candidates` candidates.
    pub(crate) fn new(candidates: usize) -> Blocks {
        Blocks {
            calibration: Vec::new(),
            kernels: Vec::new(),
            turns: vec![Vec::new(); candidates],
        }
    }

    /// Returns the number of measured blocks.
    pub(crate) fn count(&self) -> usize {
        self.calibration.len()
    }

    /// Measures one more block and returns the seconds that it took by the clock.
    ///
    /// # Errors
    ///
    /// The first error of `turn`; the blocks are unusable afterwards.
    pub(crate) fn add<E>(
        &mut self,
        seed: u64,
        mut turn: impl FnMut(usize, usize) -> Result<TurnTime, E>,
    ) -> Result<f64, E> {
        let start = Instant::now();
        let block = self.count();
        // Shuffle the order of candidates
        let mut order: Vec<usize> = (0..self.turns.len()).collect();
        shuffle(&mut order, &mut SplitMix64::new(seed, block as u64));
        // Measure each candidate between two runs of the kernel
        let before = kernel_time();
        for candidate in order {
            let time = turn(candidate, block)?;
            self.turns[candidate].push(time);
        }
        let after = kernel_time();
        self.calibration.push(before.processor.min(after.processor));
        self.kernels.push([before, after].into_iter().sum());
        Ok(start.elapsed().as_secs_f64())
    }

    /// Returns for each block whether it counts: the machine was undisturbed. If fewer than six such blocks exist, all
    /// count.
    fn undisturbed(&self) -> Vec<bool> {
        let undisturbed: Vec<bool> = self
            .kernel_deviations()
            .iter()
            .map(|&deviation| deviation <= MAX_KERNEL_DEVIATION)
            .collect();
        let count = undisturbed
            .iter()
            .filter(|&&is_undisturbed| is_undisturbed)
            .count();
        // Six is the smallest number whose extremes enclose a median at 95 %.
        if count < self.calibration.len().min(6) {
            vec![true; self.calibration.len()]
        } else {
            undisturbed
        }
    }

    /// Returns how far the kernel's processor time deviates from its median in each block, as a fraction.
    fn kernel_deviations(&self) -> Vec<f64> {
        let usual = median(&self.calibration);
        self.calibration
            .iter()
            .map(|seconds| (seconds / usual - 1.0).abs())
            .collect()
    }

    /// Returns a candidate's times in the blocks that count.
    pub fn turns(&self, candidate: usize) -> Vec<TurnTime> {
        let turns = self.turns[candidate].iter().zip(self.undisturbed());
        turns
            .filter_map(|(&turn, is_undisturbed)| is_undisturbed.then_some(turn))
            .collect()
    }

    /// Returns a candidate's seconds by the clock in the blocks that count.
    pub fn seconds(&self, candidate: usize) -> Vec<f64> {
        self.turns(candidate).iter().map(|turn| turn.elapsed).collect()
    }

    /// Returns a candidate's processor seconds in the blocks that count.
    pub fn processor_seconds(&self, candidate: usize) -> Vec<f64> {
        self.turns(candidate).iter().map(|turn| turn.processor).collect()
    }

    /// Returns the ratios of a candidate's processor time to that of `base` in the same block, for the blocks that count.
    pub fn ratios(&self, candidate: usize, base: usize) -> Vec<f64> {
        let pairs = self.processor_seconds(candidate).into_iter();
        pairs
            .zip(self.processor_seconds(base))
            .map(|(seconds, base)| seconds / base)
            .collect()
    }

    /// Returns the conditions of the measurement, in a run of `spent` seconds with a budget of `budget`.
    pub fn timing(&self, spent: f64, budget: f64) -> Timing {
        let undisturbed = self.undisturbed();
        // Find the largest deviation among the blocks that count
        let deviations = self.kernel_deviations();
        let spread = deviations
            .iter()
            .zip(&undisturbed)
            .filter_map(|(&deviation, &is_undisturbed)| is_undisturbed.then_some(deviation))
            .fold(0.0, f64::max);
        // Compare the kernel's two clocks over all blocks
        let kernels: TurnTime = self.kernels.iter().copied().sum();
        let waiting = 1.0 - kernels.processor / kernels.elapsed;
        let blocks = undisturbed
            .iter()
            .filter(|&&is_undisturbed| is_undisturbed)
            .count();
        Timing {
            blocks,
            dropped: undisturbed.len() - blocks,
            calibration_spread: spread,
            waiting: waiting.max(0.0),
            spent,
            budget,
        }
    }
}

/// Permutes `order` uniformly at random (R. Durstenfeld, "Algorithm 235: Random permutation", CACM 7(7), 1964).
fn shuffle(order: &mut [usize], random: &mut SplitMix64) {
    for last in (1..order.len()).rev() {
        order.swap(last, random.below(last + 1));
    }
}

/// Returns the time that a fixed amount of arithmetic takes on this thread at present.
fn kernel_time() -> TurnTime {
    let (start, worked) = (Instant::now(), thread_seconds());
    // `black_box` prevents the compiler from evaluating the loop in advance.
    let mut state = black_box(1u64);
    for round in 0..KERNEL_ROUNDS {
        state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(round);
    }
    black_box(state);
    TurnTime {
        elapsed: start.elapsed().as_secs_f64(),
        processor: thread_seconds() - worked,
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::convert::Infallible;
    use std::time::Duration;

    use super::super::Interval;
    use super::*;

    fn ratio(blocks: &Blocks, candidate: usize, base: usize) -> Interval {
        Interval::of_median(&blocks.ratios(candidate, base))
    }

    #[test]
    fn each_block_runs_everything_once_in_changing_order() {
        let (mut turns, fractions) = (Vec::new(), RefCell::new(Vec::new()));
        let progress = |fraction| fractions.borrow_mut().push(fraction);
        let blocks = Blocks::measure(5, &Protocol::of_blocks(8, 1), &progress, |who, block| {
            turns.push((block, who));
            Ok::<_, Infallible>(TurnTime::of_seconds(who as f64 + 1.0))
        })
        .unwrap_or_else(|never| match never {});
        let fractions = fractions.into_inner();
        assert!(
            fractions.is_sorted() && fractions.last() == Some(&1.0),
            "{fractions:?}"
        );
        let orders: Vec<Vec<usize>> = turns
            .chunks(5)
            .map(|turns| turns.iter().map(|turn| turn.1).collect())
            .collect();
        for order in &orders {
            let mut sorted = order.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, [0, 1, 2, 3, 4]);
        }
        assert!(orders.iter().any(|order| *order != orders[0]));
        assert_eq!(ratio(&blocks, 3, 1), Interval::exact(2.0));
    }

    #[test]
    fn equal_contestants_differ_significantly_in_at_most_five_percent() {
        let mut apart = 0;
        for run in 0..400 {
            let mut random = SplitMix64::new(5, run);
            let blocks = Blocks {
                calibration: vec![1.0; 10],
                kernels: vec![TurnTime::of_seconds(2.0); 10],
                turns: (0..2)
                    .map(|_| {
                        let seconds = (0..10).map(|_| 1.0 + 0.3 * random.unit().powi(4));
                        seconds.map(TurnTime::of_seconds).collect()
                    })
                    .collect(),
            };
            apart += usize::from(!ratio(&blocks, 1, 0).holds(1.0));
        }
        assert!(apart <= 20, "{apart} of 400");
    }

    #[test]
    fn blocks_on_a_busy_machine_do_not_count() {
        let mut blocks = Blocks {
            calibration: vec![1.0; 9],
            kernels: vec![TurnTime::of_seconds(2.0); 9],
            turns: [1.0, 1.1]
                .map(|seconds| vec![TurnTime::of_seconds(seconds); 9])
                .into(),
        };
        blocks.calibration[4] = 1.2;
        blocks.turns[1][4] = TurnTime::of_seconds(9.0);
        let timing = blocks.timing(1.0, 2.0);
        assert_eq!((timing.blocks, timing.dropped), (8, 1));
        assert!((ratio(&blocks, 1, 0).high - 1.1).abs() < 1e-12);
    }

    #[test]
    fn programs_that_share_the_processor_change_no_ratio() {
        // The clock runs two to four times as fast as the processor is given.
        let shared = |seconds: f64, block: usize| TurnTime {
            elapsed: seconds * (2 + block % 3) as f64,
            processor: seconds,
        };
        let turns = |seconds| (0..9).map(|block| shared(seconds, block)).collect();
        let blocks = Blocks {
            calibration: vec![0.5; 9],
            kernels: turns(1.0),
            turns: [1.0, 1.5].map(turns).into(),
        };
        assert_eq!(ratio(&blocks, 1, 0), Interval::exact(1.5));
        let timing = blocks.timing(1.0, 2.0);
        assert_eq!((timing.blocks, timing.dropped), (9, 0));
        assert!((timing.waiting - 2.0 / 3.0).abs() < 1e-12, "{}", timing.waiting);
    }

    #[test]
    fn parts_of_turns_add_up() {
        let turns = |seconds: &[f64]| seconds.iter().copied().map(TurnTime::of_seconds).collect();
        let blocks = Blocks {
            calibration: vec![1.0, 2.0, 1.0, 2.0],
            kernels: turns(&[2.0, 4.0, 2.0, 4.0]),
            turns: vec![turns(&[1.0, 3.0, 2.0, 2.0]), turns(&[2.0, 6.0, 4.0, 4.0])],
        };
        let summed = blocks.summed(2);
        assert_eq!(summed.count(), 2);
        assert_eq!(summed.seconds(0), [4.0, 4.0]);
        assert_eq!(summed.ratios(1, 0), [2.0, 2.0]);
    }

    #[test]
    fn measuring_ends_before_the_deadline_after_the_minimum() {
        let deadline = Instant::now() + Duration::from_millis(400);
        let protocol = Protocol {
            least: 1,
            most: 1000,
            deadline,
            seed: 3,
        };
        let nap = Duration::from_millis(20);
        let blocks = Blocks::measure(1, &protocol, &|_| {}, |_, _| {
            std::thread::sleep(nap);
            Ok::<_, Infallible>(TurnTime::of_seconds(nap.as_secs_f64()))
        });
        let count = blocks.unwrap_or_else(|never| match never {}).calibration.len();
        assert!((1..20).contains(&count), "{count}");
    }
}
