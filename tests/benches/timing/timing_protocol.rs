//! A tenth more of real work, as the blocks of `whit cost` measure it.

use std::convert::Infallible;
use std::hint::black_box;
use std::time::{Duration, Instant};

use whit::measure::{Blocks, Interval, Protocol};

use crate::limits::Limits;

const BLOCKS: usize = 30;
/// Rounds of arithmetic, a tenth of a second: long beside the tenth of a millisecond by which a sleeper oversleeps.
const WORK_ROUNDS: u64 = 100_000_000;
/// The part of its work that the second contestant sleeps in addition.
const MORE: f64 = 0.1;
/// The least and the largest ratio that may be measured.
const RATIOS: [f64; 2] = [1.08, 1.12];

/// Measures two contestants of which the second takes a tenth longer.
pub(crate) fn run(limits: &mut Limits) {
    let blocks = Blocks::measure(2, &Protocol::of_blocks(BLOCKS, 4), &|_| {}, |who, _| {
        let start = Instant::now();
        work();
        if who == 1 {
            std::thread::sleep(Duration::from_secs_f64(MORE * start.elapsed().as_secs_f64()));
        }
        Ok::<_, Infallible>(start.elapsed().as_secs_f64())
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

/// Computes the same numbers every time.
fn work() {
    let mut state = black_box(1u64);
    for round in 0..WORK_ROUNDS {
        state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(round);
    }
    black_box(state);
}
