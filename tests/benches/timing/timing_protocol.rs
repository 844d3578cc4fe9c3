//! A tenth more of work, as the blocks of `whit cost` measure it.

use std::convert::Infallible;
use std::hint::black_box;

use whit::measure::{Blocks, Interval, Protocol, Stopwatch};

use crate::limits::Limits;

const BLOCKS: usize = 30;
/// Rounds of arithmetic, a tenth of a second.
const WORK_ROUNDS: u64 = 100_000_000;
/// The part of its work that the second contestant does in addition.
const MORE: f64 = 0.1;
/// The least and the largest ratio that may be measured.
const RATIOS: [f64; 2] = [1.08, 1.12];

/// Measures two contestants of which the second takes a tenth longer.
pub(crate) fn run(limits: &mut Limits) {
    let blocks = Blocks::measure(2, &Protocol::of_blocks(BLOCKS, 4), &|_| {}, |who, _| {
        let watch = Stopwatch::start();
        work(WORK_ROUNDS);
        if who == 1 {
            work((MORE * WORK_ROUNDS as f64) as u64);
        }
        Ok::<_, Infallible>(watch.time())
    });
    let blocks = blocks.unwrap_or_else(|never| match never {});
    let ratio = Interval::of_median(&blocks.ratios(1, 0));
    println!(
        "a tenth more is measured as {:.4} (95 %: {:.4} to {:.4}), {}",
        ratio.value,
        ratio.low,
        ratio.high,
        limits.between(ratio.value, RATIOS[0], RATIOS[1])
    );
}

/// Computes so many numbers, the same every time.
fn work(rounds: u64) {
    let mut state = black_box(1u64);
    for round in 0..rounds {
        state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(round);
    }
    black_box(state);
}
