//! Sampling profiler of one thread: the clock is read where one kind of work ends and the next begins.
//!
//! Every reading books all time since the previous one, so that no time is missed or counted twice. A reading takes
//! about 25 ns, as long as tracing one ray, so readings are rare: one whenever a batch of packets has been generated,
//! traced, shaded or summed up. The shading of a batch is one lap; its division among accounts is estimated by timing
//! one packet in 32 in detail. The golden ratio selects these packets, because its multiples do not correlate with
//! any structure of the image; the selection is deterministic.

use std::sync::OnceLock;
use std::time::Instant;

use super::super::aov::TileCosts;
use super::super::settings::RenderSettings;
use super::super::tile::{TILE, Tile};
use super::category::Category;
use super::render_profile::{RenderProfile, Tally};
use crate::accel::RayPacket;
use crate::numeric::Lanes;

/// One of this many packets is timed in detail.
const WATCHED_ONE_IN: u32 = 32;

/// Fractional part of the golden ratio as a 32-bit fraction (2^32 over the golden ratio): its multiples are
/// distributed over all u32 more evenly than those of any other number.
const GOLDEN: u32 = 0x9e37_79b9;

/// Odd multipliers with random bits (from MurmurHash3 and xxHash), so that tiles start at uncorrelated points of the
/// sequence.
const COLUMN_STEP: u32 = 0x85eb_ca6b;
const ROW_STEP: u32 = 0xc2b2_ae35;

/// Clock of one thread, and the ledger of its current tile.
pub(in crate::render) struct Profiler {
    pub(in crate::render) ledger: RenderProfile,
    /// Start of the time that is not booked yet. `None` with the ledger off, in which case the clock is never read.
    since: Option<Instant>,
    /// Start of the time not booked yet within a packet that is timed in detail.
    watched_since: Option<Instant>,
    /// Sequence that selects packets; advances by [`GOLDEN`] with every packet.
    turn: u32,
    clock_read_seconds: f64,
    /// Cost of each pixel of the tile, if requested.
    pub(in crate::render) costs: Option<Box<TileCosts>>,
}

impl Profiler {
    /// Returns a clock that runs if the ledger is on.
    pub(in crate::render) fn new(settings: &RenderSettings) -> Profiler {
        let is_on = settings.ledger;
        Profiler {
            ledger: RenderProfile::default(),
            since: is_on.then(Instant::now),
            watched_since: None,
            turn: 0,
            clock_read_seconds: if is_on { clock_read_seconds() } else { 0.0 },
            costs: (is_on && settings.cost_aovs).then(|| Box::new(TileCosts::new())),
        }
    }

    /// Starts the ledger of a tile.
    pub(in crate::render) fn begin(&mut self, tile: Tile) {
        self.ledger = RenderProfile::default();
        self.ledger.clock_read_seconds = self.clock_read_seconds;
        // Select timed packets from a point of the sequence that depends on the tile
        self.turn = (tile.x / TILE).wrapping_mul(COLUMN_STEP) ^ (tile.y / TILE).wrapping_mul(ROW_STEP);
        if self.since.is_some() {
            self.since = Some(self.now());
        }
        if let Some(costs) = &mut self.costs {
            costs.clear();
        }
    }

    fn now(&mut self) -> Instant {
        self.ledger.clock_reads += 1;
        Instant::now()
    }

    /// Returns the seconds since the previous call; `None` with the ledger off.
    fn pass(&mut self) -> Option<f64> {
        let since = self.since?;
        let now = self.now();
        self.since = Some(now);
        Some((now - since).as_secs_f64())
    }

    /// Books all time since the last reading.
    pub(in crate::render) fn lap(&mut self, account: Category) {
        self.lap_over(account, std::iter::empty());
    }

    /// Books all time since the last reading and divides it equally among packets, which are given by the labels of
    /// their lanes and their active lanes.
    #[inline(always)]
    pub(in crate::render) fn lap_over<'a>(
        &mut self,
        account: Category,
        packets: impl Iterator<Item = (&'a Lanes<u32>, &'a Lanes<i32>)> + Clone,
    ) {
        let Some(seconds) = self.pass() else { return };
        let tally = Tally {
            seconds,
            ..Tally::default()
        };
        self.ledger.book(account, tally);
        if let Some(costs) = &mut self.costs {
            let each = seconds / packets.clone().count().max(1) as f64;
            for (labels, active) in packets {
                costs.set_packet(labels, active);
                costs.share(account, each);
            }
        }
    }

    /// Discards the time since the last reading, which is booked elsewhere.
    pub(in crate::render) fn skip(&mut self) {
        self.pass();
    }

    /// Books all time since the last reading for all threads of the pool, which worked on it together.
    pub(in crate::render) fn lap_all_threads(&mut self, account: Category) {
        if let Some(seconds) = self.pass() {
            let tally = Tally {
                seconds: seconds * rayon::current_num_threads() as f64,
                ..Tally::default()
            };
            self.ledger.book(account, tally);
        }
    }

    /// Books all time since the last reading as shading.
    pub(in crate::render) fn lap_shading(&mut self) {
        if let Some(seconds) = self.pass() {
            self.ledger.book_shading(seconds);
        }
    }

    /// Runs a trace and returns its number of active rays and its time, for the caller to book. `labels_and_accounts` returns the
    /// labels of a packet and the accounts of its lanes.
    #[inline(always)]
    pub(in crate::render) fn trace<'a>(
        &mut self,
        packets: &mut [RayPacket],
        labels_and_accounts: impl Fn(usize) -> (&'a Lanes<u32>, Accounts<'a>),
        mut trace: impl FnMut(&mut [RayPacket], usize),
    ) -> Tally {
        // Count active lanes, which are -1
        let rays: i32 = packets.iter().flat_map(|packet| &packet.active).sum();
        let seconds = match self.costs.take() {
            // Time all packets together
            None => {
                trace(packets, 0);
                self.pass().unwrap_or(0.0)
            }
            // Trace packets one by one to time each of them
            Some(mut costs) => {
                let mut sum = 0.0;
                for (index, packet) in packets.iter_mut().enumerate() {
                    let (labels, accounts) = labels_and_accounts(index);
                    costs.set_packet(labels, &packet.active);
                    trace(std::slice::from_mut(packet), index);
                    let seconds = self.pass().unwrap_or(0.0);
                    costs.trace(|l| accounts.of(l), seconds);
                    sum += seconds;
                }
                self.costs = Some(costs);
                sum
            }
        };
        Tally {
            rays: u64::from(rays.unsigned_abs()),
            seconds,
            trace_seconds: seconds,
        }
    }

    /// Begins the shading of a packet. Returns whether it is timed in detail.
    pub(in crate::render) fn watch(&mut self, labels: &Lanes<u32>, active: &Lanes<i32>) -> bool {
        if self.since.is_none() {
            return false;
        }
        self.turn = self.turn.wrapping_add(GOLDEN);
        let mut is_timed = self.turn < u32::MAX / WATCHED_ONE_IN;
        // With pixel costs, every packet is timed in detail.
        if let Some(costs) = &mut self.costs {
            costs.set_packet(labels, active);
            is_timed = true;
        }
        self.watched_since = is_timed.then(|| self.now());
        is_timed
    }

    /// Books the time since the last reading within a packet that is timed in detail.
    #[inline(always)]
    pub(in crate::render) fn part(&mut self, account: Category) {
        if self.watched_since.is_some() {
            let now = self.now();
            self.part_until(account, now);
        }
    }

    /// Books the time within a packet that is timed in detail up to `moment`, which was read elsewhere.
    pub(in crate::render) fn part_until(&mut self, account: Category, moment: Instant) {
        if let Some(since) = self.watched_since.replace(moment) {
            // The time between two readings includes the duration of one reading.
            let seconds = moment.duration_since(since).as_secs_f64() - self.clock_read_seconds;
            self.ledger.book_watched(account, seconds.max(0.0));
            if let Some(costs) = &mut self.costs {
                costs.share(account, seconds.max(0.0));
            }
        }
    }

    /// Counts a clock reading that was made elsewhere.
    pub(in crate::render) fn count_read(&mut self) {
        self.ledger.clock_reads += 1;
    }

    /// Resumes the detailed timing of a packet after other work, whose time is booked already.
    pub(in crate::render) fn resume(&mut self, labels: &Lanes<u32>, active: &Lanes<i32>) {
        if self.watched_since.is_some() {
            self.watched_since = self.since;
        }
        if let Some(costs) = &mut self.costs {
            costs.set_packet(labels, active);
        }
    }

    /// Ends the shading of a packet.
    pub(in crate::render) fn leave(&mut self) {
        self.watched_since = None;
    }
}

/// Start of a step that may be timed.
#[derive(Clone, Copy)]
pub(in crate::render) enum Moment {
    /// No time is requested.
    Unknown,
    /// A reading is requested at the start of the step, which has not begun.
    Wanted,
    /// Time at which the step began.
    Read(Instant),
}

/// Accounts that the lanes of a packet are booked under.
#[derive(Clone, Copy)]
pub(in crate::render) enum Accounts<'a> {
    All(Category),
    Each(&'a Lanes<Category>),
}

impl Accounts<'_> {
    fn of(&self, l: usize) -> Category {
        match self {
            Accounts::All(account) => *account,
            Accounts::Each(accounts) => accounts[l],
        }
    }
}

/// Returns the seconds that one clock reading takes: the median of many short series, measured once.
pub(in crate::render) fn clock_read_seconds() -> f64 {
    const SERIES: usize = 101;
    const READS: u32 = 32;
    static SECONDS: OnceLock<f64> = OnceLock::new();
    *SECONDS.get_or_init(|| {
        let series = || {
            let start = Instant::now();
            (1..READS).for_each(|_| {
                std::hint::black_box(Instant::now());
            });
            (Instant::now() - start).as_secs_f64() / f64::from(READS)
        };
        let mut seconds: Vec<f64> = (0..SERIES).map(|_| series()).collect();
        seconds.sort_by(f64::total_cmp);
        seconds[SERIES / 2]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::LANES;

    const SOME_TILE: Tile = Tile {
        x: 64,
        y: 32,
        width: 32,
        height: 32,
    };

    #[test]
    fn with_the_ledger_off_the_clock_is_never_read() {
        let mut meter = Profiler::new(&RenderSettings::default());
        meter.begin(SOME_TILE);
        for _ in 0..1000 {
            assert!(!meter.watch(&[0; LANES], &[-1; LANES]));
            meter.part(Category::Surface);
            meter.leave();
        }
        meter.lap(Category::Film);
        meter.lap_shading();
        let labels_and_accounts = |_| (&[0; LANES], Accounts::All(Category::Camera));
        let tally = meter.trace(&mut [RayPacket::EMPTY], labels_and_accounts, |_, _| {});
        assert_eq!(tally, Tally::default());
        assert_eq!(meter.ledger, RenderProfile::default());
    }

    #[test]
    fn one_packet_in_thirty_two_is_timed_aperiodically() {
        let mut meter = Profiler::new(&RenderSettings {
            ledger: true,
            ..RenderSettings::default()
        });
        meter.begin(SOME_TILE);
        let watched: Vec<usize> = (0..32_000)
            .filter(|_| meter.watch(&[0; LANES], &[-1; LANES]))
            .collect();
        // The number of multiples of the golden ratio that fall into an interval differs from its length times their
        // number by less than 3 log2 of that number.
        assert!(watched.len().abs_diff(1000) < 45, "{}", watched.len());
        let mut residues = [0; 16];
        watched.iter().for_each(|packet| residues[packet % 16] += 1);
        assert!(residues.iter().all(|&count| count > 30), "{residues:?}");
    }
}
