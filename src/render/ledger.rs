//! What was traced and how long it took, by what it was for.
//!
//! Every ray that the backend is asked for is counted under one account. Seconds add up by construction, as each
//! reading of the clock books all that went by since the one before (see `meter`); what threads spend without work is
//! `idle`.

use std::ops::AddAssign;

use super::losses::Limit;
use super::queue::Sorts;
use crate::scene::Effect;

/// What rays and seconds are booked under: every ray and every second under exactly one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Account {
    /// Making camera rays, and deciding which pixels need more of them.
    Sampling,
    /// Rays from the eye.
    Camera,
    /// Rays from surfaces to lights, as far as the first surface.
    Shadow,
    /// The same rays behind it, where light goes through surfaces, and the colour that they take on.
    TransparentShadow,
    /// Mirrored rays.
    Reflection,
    /// Rays through surfaces, and the division of light at them.
    Refraction,
    /// Rays into the lobes of opaque rough surfaces.
    RoughReflection,
    /// Rays into the lobes of rough surfaces that light goes through, on either side of them.
    RoughRefraction,
    /// Rays of a single wavelength, whatever sent them.
    Dispersion,
    /// What bodies swallow on the way of rays.
    Absorption,
    /// Samples along rays through smoke, fire and fog.
    Volume,
    /// The light that gets into bodies which scatter it within, and what of it leaves them.
    Subsurface,
    /// Points, normals and materials of hits.
    Surface,
    /// Look-ups of textures, and normals that they bend.
    Texture,
    /// Light that lamps would give if nothing stood before them.
    Lighting,
    /// Emission, ambient light and background.
    Surroundings,
    /// Sums of radiance and the picture that they become.
    Film,
    /// Setting up: surfaces made ready, and rays that find the bodies around the camera.
    Other,
    /// Threads without work, at the end of a picture most of all.
    Idle,
}

/// How many accounts there are.
pub(super) const ACCOUNTS: usize = Account::ALL.len();

impl Account {
    /// All of them, in the order of reports.
    pub const ALL: [Account; 19] = [
        Account::Sampling,
        Account::Camera,
        Account::Shadow,
        Account::TransparentShadow,
        Account::Reflection,
        Account::Refraction,
        Account::RoughReflection,
        Account::RoughRefraction,
        Account::Dispersion,
        Account::Absorption,
        Account::Volume,
        Account::Subsurface,
        Account::Surface,
        Account::Texture,
        Account::Lighting,
        Account::Surroundings,
        Account::Film,
        Account::Other,
        Account::Idle,
    ];

    /// What reports call it; an effect's account has the effect's name.
    pub const fn name(self) -> &'static str {
        match self {
            Account::Sampling => "sampling",
            Account::Camera => "camera",
            Account::Shadow => "shadow",
            Account::TransparentShadow => "transparent-shadow",
            Account::Reflection => "reflection",
            Account::Refraction => "refraction",
            Account::RoughReflection => "rough-reflection",
            Account::RoughRefraction => "rough-refraction",
            Account::Dispersion => "dispersion",
            Account::Absorption => "absorption",
            Account::Volume => "volume",
            Account::Subsurface => "subsurface",
            Account::Surface => "surface",
            Account::Texture => "texture",
            Account::Lighting => "lighting",
            Account::Surroundings => "surroundings",
            Account::Film => "film",
            Account::Other => "other",
            Account::Idle => "idle",
        }
    }

    /// The account of an effect, where it has one of its own.
    pub fn of(effect: Effect) -> Option<Account> {
        Account::ALL
            .into_iter()
            .find(|account| account.name() == effect.name())
    }
}

/// What one account took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    /// Rays that the backend was asked for.
    pub rays: u64,
    /// Seconds, summed over threads; 0 with the ledger off.
    pub seconds: f64,
    /// Of these, within the backend.
    pub trace_seconds: f64,
}

/// The account of a render.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ledger {
    /// Wall-clock seconds of the render phase.
    pub seconds: f64,
    /// Threads that worked in it.
    pub threads: usize,
    /// How often the clock was read; 0 with the ledger off.
    pub clock_reads: u64,
    /// Seconds that one reading takes, as measured before the render.
    pub clock_read_seconds: f64,
    tallies: [Tally; ACCOUNTS],
    /// Of the rays of single wavelengths, those that were mirrored.
    mirrored_colors: u64,
    /// Of the rays of single wavelengths, those that went through a surface.
    refracted_colors: u64,
    /// Of the rays of single wavelengths, those of the lobes of rough surfaces.
    rough_colors: u64,
    /// Seconds of shading, all work on hits together.
    shading: f64,
    /// Seconds of the packets whose shading was watched closely, by what they were for.
    watched: [f64; ACCOUNTS],
    /// Rays that were not followed because of the depth limit of transparent scenes or the weight cut-off.
    pub lost_rays: u64,
    /// The sum of their weights: by so many times the largest radiance, at most, is the sum of all samples too dark.
    pub lost_weight: f64,
    /// The most that any pixel lacks: the sum of its samples' lost weights over their number. By so many times the
    /// radiance that a lost ray could have brought, at most, is a pixel wrong that is filtered by a box. With adaptive
    /// sampling it is the most of any round, which is no less.
    pub max_lost_weight: f64,
    /// Of the lost rays, those beyond the depth limit.
    pub depth_limit: Loss,
    /// Of the lost rays, those that weighed too little.
    pub weight_cutoff: Loss,
    /// Samples that marches interpolated in volumes, along rays and shadow rays; those that were leapt over do not count.
    pub volume_samples: u64,
}

/// Rays that one limit cut off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loss {
    /// How many.
    pub rays: u64,
    /// The sum of their weights.
    pub weight: f64,
    /// The most that any pixel lacks, as [`Ledger::max_lost_weight`] has it.
    pub max_weight: f64,
}

impl Ledger {
    /// What an account took.
    pub fn of(&self, account: Account) -> Tally {
        self.tallies[account as usize]
    }

    /// The accounts with what they took.
    pub fn tallies(&self) -> impl Iterator<Item = (Account, Tally)> + '_ {
        Account::ALL.into_iter().zip(self.tallies)
    }

    /// All together.
    pub fn total(&self) -> Tally {
        let mut total = Tally::default();
        self.tallies.iter().for_each(|&tally| total += tally);
        total
    }

    /// Rays from the eye.
    pub fn camera_rays(&self) -> u64 {
        self.of(Account::Camera).rays
    }

    /// Rays from surfaces to lights; one that goes through surfaces counts again behind each.
    pub fn shadow_rays(&self) -> u64 {
        self.of(Account::Shadow).rays + self.of(Account::TransparentShadow).rays
    }

    /// Rays that smooth surfaces mirrored, whether of all wavelengths or of one.
    pub fn reflection_rays(&self) -> u64 {
        self.of(Account::Reflection).rays + self.mirrored_colors
    }

    /// Rays that went through surfaces, refracted or where one is not there, of all wavelengths or of one.
    pub fn refraction_rays(&self) -> u64 {
        self.of(Account::Refraction).rays + self.refracted_colors
    }

    /// Rays into the lobes of rough surfaces, of all wavelengths or of one.
    pub fn rough_rays(&self) -> u64 {
        let (opaque, clear) = (Account::RoughReflection, Account::RoughRefraction);
        self.of(opaque).rays + self.of(clear).rays + self.rough_colors
    }

    /// Seconds inside the backend, summed over threads.
    pub fn trace_seconds(&self) -> f64 {
        self.total().trace_seconds
    }

    /// Seconds that reading the clock took, summed over threads.
    pub fn seconds_of_measuring(&self) -> f64 {
        self.clock_reads as f64 * self.clock_read_seconds
    }

    /// The same rays under one account, with `seconds` of all threads together.
    pub(super) fn gathered(&self, account: Account, seconds: f64) -> Ledger {
        let mut gathered = Ledger {
            clock_reads: self.clock_reads,
            clock_read_seconds: self.clock_read_seconds,
            volume_samples: self.volume_samples,
            ..Ledger::default()
        };
        let tally = Tally {
            seconds,
            ..self.total()
        };
        gathered.book(account, tally);
        gathered
    }

    /// Books a tally.
    pub(super) fn book(&mut self, account: Account, tally: Tally) {
        self.tallies[account as usize] += tally;
    }

    /// Books rays that surfaces sent out; they shared packets, and so share the time.
    pub(super) fn book_sent(&mut self, all: Tally, sorts: Sorts) {
        let shared = sorts.accounts(all.rays);
        for (account, rays) in shared {
            let share = rays as f64 / all.rays.max(1) as f64;
            let tally = Tally {
                rays,
                seconds: all.seconds * share,
                trace_seconds: all.trace_seconds * share,
            };
            self.book(account, tally);
        }
        self.mirrored_colors += sorts.mirrored_colors;
        self.refracted_colors += sorts.refracted_colors;
        self.rough_colors += sorts.rough_colors;
    }

    /// Books seconds of shading, which are not yet divided.
    pub(super) fn book_shading(&mut self, seconds: f64) {
        self.shading += seconds;
    }

    /// Books what a closely watched packet took for something.
    pub(super) fn book_watched(&mut self, account: Account, seconds: f64) {
        self.watched[account as usize] += seconds;
    }

    /// Divides the time of shading as that of the watched packets was, and books what is left of `threads` times the
    /// phase as idle.
    pub(super) fn settle(&mut self, threads: usize, seconds: f64) {
        self.seconds = seconds;
        self.threads = threads;
        if self.clock_reads == 0 {
            return;
        }
        let watched: f64 = self.watched.iter().sum();
        if watched > 0.0 {
            for (tally, part) in self.tallies.iter_mut().zip(self.watched) {
                tally.seconds += self.shading * (part / watched);
            }
        } else {
            self.tallies[Account::Surface as usize].seconds += self.shading;
        }
        (self.shading, self.watched) = (0.0, [0.0; ACCOUNTS]);
        let idle = threads as f64 * seconds - self.total().seconds;
        self.tallies[Account::Idle as usize].seconds += idle.max(0.0);
    }

    /// Books a ray that is not followed.
    pub(super) fn lose(&mut self, limit: Limit, weight: f32) {
        self.lost_rays += 1;
        self.lost_weight += f64::from(weight);
        let loss = match limit {
            Limit::Depth => &mut self.depth_limit,
            Limit::Weight => &mut self.weight_cutoff,
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

impl AddAssign for Loss {
    /// Adds another task's; pixels are different ones.
    fn add_assign(&mut self, other: Loss) {
        self.rays += other.rays;
        self.weight += other.weight;
        self.max_weight = self.max_weight.max(other.max_weight);
    }
}

impl AddAssign for Ledger {
    /// Adds another task's tallies; wall-clock time is not a sum.
    fn add_assign(&mut self, other: Ledger) {
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
    fn every_account_stands_in_the_list_at_its_own_place() {
        for (index, account) in Account::ALL.into_iter().enumerate() {
            assert_eq!(account as usize, index);
        }
        assert_eq!(Account::of(Effect::Dispersion), Some(Account::Dispersion));
        assert_eq!(Account::of(Effect::Occlusion), None);
    }

    #[test]
    fn shading_is_divided_as_the_watched_packets_were_and_idle_is_the_rest() {
        let mut ledger = Ledger {
            clock_reads: 4,
            ..Ledger::default()
        };
        ledger.book_shading(8.0);
        ledger.book_watched(Account::Surface, 0.25);
        ledger.book_watched(Account::Texture, 0.75);
        let camera = Tally {
            rays: 5,
            seconds: 1.0,
            trace_seconds: 1.0,
        };
        ledger.book(Account::Camera, camera);
        ledger.settle(2, 6.0);
        let seconds = |account| ledger.of(account).seconds;
        // 8 = 2 + 6 as 1 to 3; two threads for 6 s are 12 s, of which 8 + 1 are booked.
        assert_eq!((seconds(Account::Surface), seconds(Account::Texture)), (2.0, 6.0));
        assert_eq!(seconds(Account::Idle), 3.0);
        assert_eq!(ledger.total().seconds, 12.0);
        assert_eq!((ledger.total().rays, ledger.trace_seconds()), (5, 1.0));
    }

    #[test]
    fn rays_of_one_wavelength_have_an_account_and_keep_their_direction() {
        let mut ledger = Ledger::default();
        let all = Tally {
            rays: 20,
            seconds: 1.0,
            trace_seconds: 0.5,
        };
        let sorts = Sorts {
            refracted: 3,
            refracted_colors: 4,
            mirrored_colors: 1,
            rough_reflected: 2,
            rough_refracted: 3,
            rough_colors: 5,
        };
        ledger.book_sent(all, sorts);
        let rays = [
            Account::Reflection,
            Account::Refraction,
            Account::RoughReflection,
            Account::RoughRefraction,
            Account::Dispersion,
        ]
        .map(|account| ledger.of(account).rays);
        assert_eq!(rays, [2, 3, 2, 3, 10]);
        assert_eq!((ledger.reflection_rays(), ledger.refraction_rays()), (3, 7));
        assert_eq!(ledger.rough_rays(), 10);
        assert_eq!(ledger.of(Account::Dispersion).seconds, 0.5);
    }
}
