//! Where the time of a tile goes: a clock that is read where one kind of work ends and the next begins.
//!
//! Every reading books all that went by since the one before, so nothing is left out and nothing counts twice. A
//! reading takes about 25 ns, as long as a ray, so there are few: one where a batch of packets is made, traced, shaded
//! or summed up. The shading of a batch is one lap; how it divides is found out by watching one packet in 32 closely.
//! Which ones is a matter of the golden ratio, as its multiples are in step with no picture; it is the same in every
//! run.

use std::sync::OnceLock;
use std::time::Instant;

use super::RenderSettings;
use super::costs::TileCosts;
use super::film::{TILE, Tile};
use super::ledger::{Account, Ledger, Tally};
use crate::accel::RayPacket;
use crate::numeric::Lanes;

/// Of so many packets one is watched closely.
const WATCHED_ONE_IN: u32 = 32;

/// 2^32 over the golden ratio: multiples of it are spread over all u32 more evenly than those of any other number.
const GOLDEN: u32 = 0x9e37_79b9;

/// Odd numbers with bits at random (those of MurmurHash3 and xxHash): tiles begin at unrelated places of the sequence.
const COLUMN_STEP: u32 = 0x85eb_ca6b;
const ROW_STEP: u32 = 0xc2b2_ae35;

/// The clock of one thread, and what it has booked for a tile.
pub(super) struct Meter {
    pub(super) ledger: Ledger,
    /// When that began which is not booked yet. `None` with the ledger off: the clock is never read then.
    since: Option<Instant>,
    /// The same within a packet that is watched closely.
    watched_since: Option<Instant>,
    /// Goes on by [`GOLDEN`] with every packet.
    turn: u32,
    clock_read_seconds: f64,
    /// What each pixel cost, where somebody asks.
    pub(super) costs: Option<Box<TileCosts>>,
}

impl Meter {
    /// A clock that runs if the settings say so.
    pub(super) fn new(settings: &RenderSettings) -> Meter {
        let is_on = settings.ledger;
        Meter {
            ledger: Ledger::default(),
            since: is_on.then(Instant::now),
            watched_since: None,
            turn: 0,
            clock_read_seconds: if is_on { clock_read_seconds() } else { 0.0 },
            costs: (is_on && settings.cost_aovs).then(|| Box::new(TileCosts::new())),
        }
    }

    /// Starts the account of a tile.
    pub(super) fn begin(&mut self, tile: Tile) {
        self.ledger = Ledger::default();
        self.ledger.clock_read_seconds = self.clock_read_seconds;
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

    /// Seconds since the last call of this; `None` with the ledger off.
    fn pass(&mut self) -> Option<f64> {
        let since = self.since?;
        let now = self.now();
        self.since = Some(now);
        Some((now - since).as_secs_f64())
    }

    /// Books all that is not booked yet.
    pub(super) fn lap(&mut self, account: Account) {
        self.lap_over(account, std::iter::empty());
    }

    /// Books all that is not booked yet, which was spent on these packets alike: their lanes' labels, and those in use.
    #[inline(always)]
    pub(super) fn lap_over<'a>(
        &mut self,
        account: Account,
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
                costs.turn_to(labels, active);
                costs.share(account, each);
            }
        }
    }

    /// Leaves to others what is not booked yet.
    pub(super) fn skip(&mut self) {
        self.pass();
    }

    /// Books all that is not booked yet, which all threads of the pool worked on.
    pub(super) fn lap_all_threads(&mut self, account: Account) {
        if let Some(seconds) = self.pass() {
            let tally = Tally {
                seconds: seconds * rayon::current_num_threads() as f64,
                ..Tally::default()
            };
            self.ledger.book(account, tally);
        }
    }

    /// Books all that is not booked yet as shading.
    pub(super) fn lap_shading(&mut self) {
        if let Some(seconds) = self.pass() {
            self.ledger.book_shading(seconds);
        }
    }

    /// Runs a trace, and returns its active rays and its time, which are to be booked. `whose` tells the labels of a
    /// packet and the accounts of its lanes.
    #[inline(always)]
    pub(super) fn trace<'a>(
        &mut self,
        packets: &mut [RayPacket],
        whose: impl Fn(usize) -> (&'a Lanes<u32>, Accounts<'a>),
        trace: impl Fn(&mut [RayPacket]),
    ) -> Tally {
        let rays: i32 = packets.iter().flat_map(|packet| &packet.active).sum();
        let seconds = match self.costs.take() {
            None => {
                trace(packets);
                self.pass().unwrap_or(0.0)
            }
            Some(mut costs) => {
                let mut sum = 0.0;
                for (index, packet) in packets.iter_mut().enumerate() {
                    let (labels, accounts) = whose(index);
                    costs.turn_to(labels, &packet.active);
                    trace(std::slice::from_mut(packet));
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

    /// Begins the shading of a packet. Returns whether it is watched closely.
    pub(super) fn watch(&mut self, labels: &Lanes<u32>, active: &Lanes<i32>) -> bool {
        if self.since.is_none() {
            return false;
        }
        self.turn = self.turn.wrapping_add(GOLDEN);
        let mut is_watched = self.turn < u32::MAX / WATCHED_ONE_IN;
        if let Some(costs) = &mut self.costs {
            costs.turn_to(labels, active);
            is_watched = true;
        }
        self.watched_since = is_watched.then(|| self.now());
        is_watched
    }

    /// Of a packet that is watched closely, books what went by since the last call of this.
    #[inline(always)]
    pub(super) fn part(&mut self, account: Account) {
        if self.watched_since.is_some() {
            let now = self.now();
            self.part_until(account, now);
        }
    }

    /// The same up to a moment that has been read elsewhere.
    pub(super) fn part_until(&mut self, account: Account, moment: Instant) {
        if let Some(since) = self.watched_since.replace(moment) {
            // Of what is between two readings, one reading is not the work's.
            let seconds = moment.duration_since(since).as_secs_f64() - self.clock_read_seconds;
            self.ledger.book_watched(account, seconds.max(0.0));
            if let Some(costs) = &mut self.costs {
                costs.share(account, seconds.max(0.0));
            }
        }
    }

    /// Counts a reading that was made elsewhere.
    pub(super) fn count_read(&mut self) {
        self.ledger.clock_reads += 1;
    }

    /// Goes on with a packet whose shading was interrupted by other work, which is booked already.
    pub(super) fn resume(&mut self, labels: &Lanes<u32>, active: &Lanes<i32>) {
        if self.watched_since.is_some() {
            self.watched_since = self.since;
        }
        if let Some(costs) = &mut self.costs {
            costs.turn_to(labels, active);
        }
    }

    /// Ends the shading of a packet.
    pub(super) fn leave(&mut self) {
        self.watched_since = None;
    }
}

/// When something began.
#[derive(Clone, Copy)]
pub(super) enum Moment {
    /// Nobody wants to know.
    Unknown,
    /// The clock is to be read when it does; it has not begun.
    Wanted,
    /// Then.
    Read(Instant),
}

/// What the lanes of a packet are booked under.
#[derive(Clone, Copy)]
pub(super) enum Accounts<'a> {
    All(Account),
    Each(&'a Lanes<Account>),
}

impl Accounts<'_> {
    fn of(&self, l: usize) -> Account {
        match self {
            Accounts::All(account) => *account,
            Accounts::Each(accounts) => accounts[l],
        }
    }
}

/// Seconds that one reading of the clock takes: the median of many short series, measured once.
pub(super) fn clock_read_seconds() -> f64 {
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
        let mut meter = Meter::new(&RenderSettings::default());
        meter.begin(SOME_TILE);
        for _ in 0..1000 {
            assert!(!meter.watch(&[0; LANES], &[-1; LANES]));
            meter.part(Account::Surface);
            meter.leave();
        }
        meter.lap(Account::Film);
        meter.lap_shading();
        let whose = |_| (&[0; LANES], Accounts::All(Account::Camera));
        let tally = meter.trace(&mut [RayPacket::EMPTY], whose, |_| {});
        assert_eq!(tally, Tally::default());
        assert_eq!(meter.ledger, Ledger::default());
    }

    #[test]
    fn one_packet_in_thirty_two_is_watched_in_step_with_no_power_of_two() {
        let mut meter = Meter::new(&RenderSettings {
            ledger: true,
            ..RenderSettings::default()
        });
        meter.begin(SOME_TILE);
        let watched: Vec<usize> = (0..32_000)
            .filter(|_| meter.watch(&[0; LANES], &[-1; LANES]))
            .collect();
        // The multiples of the golden ratio that fall into an interval are off its length times their number by less
        // than 3 log2 of it.
        assert!(watched.len().abs_diff(1000) < 45, "{}", watched.len());
        let mut residues = [0; 16];
        watched.iter().for_each(|packet| residues[packet % 16] += 1);
        assert!(residues.iter().all(|&count| count > 30), "{residues:?}");
    }
}
