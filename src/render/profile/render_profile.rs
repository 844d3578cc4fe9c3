//! Render profile: numbers of rays and seconds, by account.
//!
//! Every ray that is traced by the backend is counted under exactly one account. Seconds add up by construction,
//! because each reading of the clock books all time since the previous one (see `profiler`); time in which threads have
//! no work is booked as `idle`.

use std::ops::AddAssign;

use super::category::{ACCOUNTS, Category};
use super::ray_type_counts::RayTypeCounts;

/// Rays and time of one account.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    /// Number of rays traced by the backend.
    pub rays: u64,
    /// Seconds, summed over threads; 0 with the ledger off.
    pub seconds: f64,
    /// Part of `seconds` that was spent inside the backend.
    pub trace_seconds: f64,
}

/// Profile of a render, or of a part of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RenderProfile {
    /// Wall-clock seconds of the render phase.
    pub seconds: f64,
    /// Number of threads that took part in the render phase.
    pub threads: usize,
    /// Number of clock readings; 0 with the ledger off.
    pub clock_reads: u64,
    /// Seconds that one clock reading takes, as measured before the render.
    pub clock_read_seconds: f64,
    tallies: [Tally; ACCOUNTS],
    /// Number of single-wavelength rays that were mirrored.
    mirrored_colors: u64,
    /// Number of single-wavelength rays that were refracted.
    refracted_colors: u64,
    /// Number of single-wavelength rays into lobes of rough surfaces.
    rough_colors: u64,
    /// Seconds of shading, for all accounts together.
    shading: f64,
    /// Seconds of the packets whose shading was timed in detail, by account.
    watched: [f64; ACCOUNTS],
    /// Number of rays that were not traced because of the depth limit or the weight cut-off.
    pub lost_rays: u64,
    /// Sum of the throughputs of rays that were not traced. The sum of all samples is too dark by at most this times
    /// the largest radiance.
    pub lost_weight: f64,
    /// Largest error bound of any pixel: the sum of the lost throughputs of its samples, divided by their number.
    ///
    /// A box-filtered pixel is wrong by at most this times the radiance that a lost ray could have contributed. With
    /// adaptive sampling it is the maximum over all rounds, which is not smaller.
    pub max_lost_weight: f64,
    /// Rays that were not traced because of the depth limit.
    pub depth_limit: TruncationBound,
    /// Rays that were not traced because of the weight cut-off.
    pub weight_cutoff: TruncationBound,
    /// Number of samples interpolated in volumes, along rays and shadow rays; skipped samples do not count.
    pub volume_samples: u64,
}

/// Reason for which a ray is not traced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::render) enum TruncationLimit {
    /// Largest number of bounces, which the path would exceed.
    Depth,
    /// Weight cut-off: the throughput is too small.
    Weight,
}

/// Rays that one limit terminated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TruncationBound {
    /// Number of terminated rays.
    pub rays: u64,
    /// Sum of the throughputs of the terminated rays.
    pub weight: f64,
    /// Largest error bound of any pixel, defined like [`RenderProfile::max_lost_weight`].
    pub max_weight: f64,
}

impl RenderProfile {
    /// Returns the rays and time of an account.
    pub fn of(&self, account: Category) -> Tally {
        self.tallies[account as usize]
    }

    /// Iterates over all accounts with their rays and times.
    pub fn tallies(&self) -> impl Iterator<Item = (Category, Tally)> + '_ {
        Category::ALL.into_iter().zip(self.tallies)
    }

    /// Returns the sum over all accounts.
    pub fn total(&self) -> Tally {
        let mut total = Tally::default();
        self.tallies.iter().for_each(|&tally| total += tally);
        total
    }

    /// Returns the number of camera rays.
    pub fn camera_rays(&self) -> u64 {
        self.of(Category::Camera).rays
    }

    /// Returns the number of shadow rays; one that goes through surfaces counts again behind each.
    pub fn shadow_rays(&self) -> u64 {
        self.of(Category::Shadow).rays + self.of(Category::TransparentShadow).rays
    }

    /// Returns the number of mirror rays from smooth surfaces, of all wavelengths or of a single one.
    pub fn reflection_rays(&self) -> u64 {
        self.of(Category::Reflection).rays + self.mirrored_colors
    }

    /// Returns the number of rays that went through surfaces, refracted or through alpha, of all wavelengths or of a
    /// single one.
    pub fn refraction_rays(&self) -> u64 {
        self.of(Category::Refraction).rays + self.refracted_colors
    }

    /// Returns the number of rays into lobes of rough surfaces, of all wavelengths or of a single one.
    pub fn rough_rays(&self) -> u64 {
        let (opaque, clear) = (Category::RoughReflection, Category::RoughRefraction);
        self.of(opaque).rays + self.of(clear).rays + self.rough_colors
    }

    /// Returns the seconds inside the backend, summed over threads.
    pub fn trace_seconds(&self) -> f64 {
        self.total().trace_seconds
    }

    /// Returns the seconds spent reading the clock, summed over threads.
    pub fn seconds_of_measuring(&self) -> f64 {
        self.clock_reads as f64 * self.clock_read_seconds
    }

    /// Returns a ledger that books all rays under one account, with `seconds` summed over threads.
    pub(in crate::render) fn gathered(&self, account: Category, seconds: f64) -> RenderProfile {
        let mut gathered = RenderProfile {
            clock_reads: self.clock_reads,
            clock_read_seconds: self.clock_read_seconds,
            volume_samples: self.volume_samples,
            ..RenderProfile::default()
        };
        let tally = Tally {
            seconds,
            ..self.total()
        };
        gathered.book(account, tally);
        gathered
    }

    /// Adds a tally to an account.
    pub(in crate::render) fn book(&mut self, account: Category, tally: Tally) {
        self.tallies[account as usize] += tally;
    }

    /// Books rays that surfaces sent; rays of different types share packets, so time is divided by their numbers.
    pub(in crate::render) fn book_sent(&mut self, all: Tally, ray_types: RayTypeCounts) {
        let shared = ray_types.accounts(all.rays);
        for (account, rays) in shared {
            let share = rays as f64 / all.rays.max(1) as f64;
            let tally = Tally {
                rays,
                seconds: all.seconds * share,
                trace_seconds: all.trace_seconds * share,
            };
            self.book(account, tally);
        }
        self.mirrored_colors += ray_types.mirrored_colors;
        self.refracted_colors += ray_types.refracted_colors;
        self.rough_colors += ray_types.rough_colors;
    }

    /// Books seconds of shading, which [`RenderProfile::settle`] divides among accounts.
    pub(in crate::render) fn book_shading(&mut self, seconds: f64) {
        self.shading += seconds;
    }

    /// Books seconds of a packet whose shading is timed in detail.
    pub(in crate::render) fn book_watched(&mut self, account: Category, seconds: f64) {
        self.watched[account as usize] += seconds;
    }

    /// Divides the time of shading in the proportions of the packets timed in detail, and books the rest of `threads`
    /// times `seconds` as idle.
    pub(in crate::render) fn settle(&mut self, threads: usize, seconds: f64) {
        self.seconds = seconds;
        self.threads = threads;
        if self.clock_reads == 0 {
            return;
        }
        // Divide the time of shading among accounts
        let watched: f64 = self.watched.iter().sum();
        if watched > 0.0 {
            for (tally, part) in self.tallies.iter_mut().zip(self.watched) {
                tally.seconds += self.shading * (part / watched);
            }
        } else {
            self.tallies[Category::Surface as usize].seconds += self.shading;
        }
        (self.shading, self.watched) = (0.0, [0.0; ACCOUNTS]);
        // Book the remaining thread time as idle
        let idle = threads as f64 * seconds - self.total().seconds;
        self.tallies[Category::Idle as usize].seconds += idle.max(0.0);
    }

    /// Books a ray that is not traced because of `limit`.
    pub(in crate::render) fn lose(&mut self, limit: TruncationLimit, weight: f32) {
        self.lost_rays += 1;
        self.lost_weight += f64::from(weight);
        let loss = match limit {
            TruncationLimit::Depth => &mut self.depth_limit,
            TruncationLimit::Weight => &mut self.weight_cutoff,
        };
        loss.rays += 1;
        loss.weight += f64::from(weight);
    }
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Tally) {
        self.rays += other.rays;
        self.seconds += other.seconds;
        self.trace_seconds += other.trace_seconds;
    }
}

impl AddAssign for TruncationBound {
    /// Adds the losses of another task, which covers different pixels.
    fn add_assign(&mut self, other: TruncationBound) {
        self.rays += other.rays;
        self.weight += other.weight;
        self.max_weight = self.max_weight.max(other.max_weight);
    }
}

impl AddAssign for RenderProfile {
    /// Adds the tallies of another task; wall-clock time is not summed.
    fn add_assign(&mut self, other: RenderProfile) {
        self.clock_reads += other.clock_reads;
        self.clock_read_seconds = self.clock_read_seconds.max(other.clock_read_seconds);
        for account in 0..ACCOUNTS {
            self.tallies[account] += other.tallies[account];
            self.watched[account] += other.watched[account];
        }
        self.mirrored_colors += other.mirrored_colors;
        self.refracted_colors += other.refracted_colors;
        self.rough_colors += other.rough_colors;
        self.shading += other.shading;
        self.lost_rays += other.lost_rays;
        self.lost_weight += other.lost_weight;
        self.max_lost_weight = self.max_lost_weight.max(other.max_lost_weight);
        self.depth_limit += other.depth_limit;
        self.weight_cutoff += other.weight_cutoff;
        self.volume_samples += other.volume_samples;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shading_time_is_divided_by_sampled_packets() {
        let mut ledger = RenderProfile {
            clock_reads: 4,
            ..RenderProfile::default()
        };
        ledger.book_shading(8.0);
        ledger.book_watched(Category::Surface, 0.25);
        ledger.book_watched(Category::Texture, 0.75);
        let camera = Tally {
            rays: 5,
            seconds: 1.0,
            trace_seconds: 1.0,
        };
        ledger.book(Category::Camera, camera);
        ledger.settle(2, 6.0);
        let seconds = |account| ledger.of(account).seconds;
        // 8 s are divided 1 to 3 as 2 + 6; two threads for 6 s are 12 s, of which 8 + 1 are booked.
        assert_eq!(
            (seconds(Category::Surface), seconds(Category::Texture)),
            (2.0, 6.0)
        );
        assert_eq!(seconds(Category::Idle), 3.0);
        assert_eq!(ledger.total().seconds, 12.0);
        assert_eq!((ledger.total().rays, ledger.trace_seconds()), (5, 1.0));
    }

    #[test]
    fn dispersed_rays_have_their_own_account() {
        let mut ledger = RenderProfile::default();
        let all = Tally {
            rays: 20,
            seconds: 1.0,
            trace_seconds: 0.5,
        };
        // 18 of the 20 rays have a counted type; the other two are mirror rays of all wavelengths.
        let ray_types = RayTypeCounts {
            refracted: 3,
            refracted_colors: 4,
            mirrored_colors: 1,
            rough_reflected: 2,
            rough_refracted: 3,
            rough_colors: 5,
            ..RayTypeCounts::default()
        };
        ledger.book_sent(all, ray_types);
        let rays = [
            Category::Reflection,
            Category::Refraction,
            Category::RoughReflection,
            Category::RoughRefraction,
            Category::Dispersion,
        ]
        .map(|account| ledger.of(account).rays);
        assert_eq!(rays, [2, 3, 2, 3, 10]);
        assert_eq!((ledger.reflection_rays(), ledger.refraction_rays()), (3, 7));
        assert_eq!(ledger.rough_rays(), 10);
        assert_eq!(ledger.of(Category::Dispersion).seconds, 0.5);
    }
}
