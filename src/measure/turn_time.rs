//! Time of one turn, by the clock and by the processor.

use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::processor_time::process_seconds;

/// Time that a turn of a measurement took.
///
/// Comparisons use the processor's time: a program that shares the machine delays the clock's, but adds nothing to it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TurnTime {
    /// Seconds by the clock.
    pub elapsed: f64,
    /// Processor seconds of all threads together.
    pub processor: f64,
}

impl TurnTime {
    /// Returns the time of a turn for which one number of seconds is known.
    pub fn of_seconds(seconds: f64) -> TurnTime {
        TurnTime {
            elapsed: seconds,
            processor: seconds,
        }
    }

    /// Returns this time without its first part, which took `elapsed` seconds by the clock and is assumed to have used
    /// the processor as the rest did.
    pub fn without(self, elapsed: f64) -> TurnTime {
        self * (1.0 - elapsed / self.elapsed.max(f64::MIN_POSITIVE)).max(0.0)
    }
}

impl std::ops::Mul<f64> for TurnTime {
    type Output = TurnTime;

    fn mul(self, factor: f64) -> TurnTime {
        TurnTime {
            elapsed: factor * self.elapsed,
            processor: factor * self.processor,
        }
    }
}

impl std::iter::Sum for TurnTime {
    fn sum<I: Iterator<Item = TurnTime>>(turns: I) -> TurnTime {
        turns.fold(TurnTime::of_seconds(0.0), |sum, turn| TurnTime {
            elapsed: sum.elapsed + turn.elapsed,
            processor: sum.processor + turn.processor,
        })
    }
}

/// Running measurement of a turn.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch {
    start: Instant,
    processor: f64,
}

impl Stopwatch {
    /// Starts to measure both times from now on.
    pub fn start() -> Stopwatch {
        Stopwatch {
            processor: process_seconds(),
            start: Instant::now(),
        }
    }

    /// Returns the time since the start.
    pub fn time(&self) -> TurnTime {
        TurnTime {
            elapsed: self.start.elapsed().as_secs_f64(),
            processor: process_seconds() - self.processor,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn sleep_takes_no_processor_time() {
        // Other tests of this process work meanwhile, so that only the clock's time has a bound.
        let watch = Stopwatch::start();
        std::thread::sleep(Duration::from_millis(20));
        assert!(watch.time().elapsed >= 0.02);
        let before = crate::processor_time::thread_seconds();
        std::thread::sleep(Duration::from_millis(20));
        assert!(crate::processor_time::thread_seconds() - before < 0.01);
    }

    #[test]
    fn the_rest_of_a_turn_keeps_its_share_of_the_processor() {
        let turn = TurnTime {
            elapsed: 4.0,
            processor: 2.0,
        };
        let rest = turn.without(1.0);
        assert_eq!((rest.elapsed, rest.processor), (3.0, 1.5));
        assert_eq!(turn.without(5.0).processor, 0.0);
    }
}
