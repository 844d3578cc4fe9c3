//! What a picture will probably cost, by a quick probe of it: `whit info`.

use std::collections::BTreeMap;
use std::fmt::{self, Write};

use serde::Serialize;

use crate::accel::Backend;
use crate::render::{Account, Ledger, Probe, RenderSettings, Tally};
use crate::scene::Effect;

/// A forecast of where rays and time will go.
#[derive(Clone, Debug, Serialize)]
pub struct Forecast {
    /// Pixels a row of the picture.
    pub width: u32,
    /// Its rows.
    pub height: u32,
    /// Samples a pixel.
    pub spp: u32,
    /// Steps that rays are followed at most.
    pub depth: u32,
    /// What found the hits.
    pub backend: Backend,
    /// Strips of pixels that were rendered.
    pub strips: usize,
    /// Their samples.
    pub samples: u64,
    /// Their rays.
    pub rays: u64,
    /// Seconds of processor time that the whole picture may take, setting up included.
    pub seconds: f64,
    /// By account; an effect's has the effect's name.
    pub accounts: BTreeMap<&'static str, Shares>,
}

/// An account's parts of the whole.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shares {
    /// Of the time, setting up included.
    pub time: f64,
    /// Of the rays.
    pub rays: f64,
}

impl Forecast {
    /// What `probe` says of the picture that `settings` ask for.
    pub fn of(probe: &Probe, settings: &RenderSettings, backend: Backend) -> Forecast {
        let samples = f64::from(settings.width) * f64::from(settings.height) * f64::from(settings.spp);
        let times = samples / probe.samples.max(1) as f64;
        let of_picture = |of: &dyn Fn(&Ledger) -> Tally| {
            let (strips, once) = (of(&probe.ledger), of(&probe.once));
            let rays = strips.rays as f64 * times + once.rays as f64;
            (strips.seconds * times + once.seconds, rays)
        };
        let (seconds, rays) = of_picture(&Ledger::total);
        let part = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
        let shares = |account: Account| {
            let (of_seconds, of_rays) = of_picture(&|ledger| ledger.of(account));
            Shares {
                time: part(of_seconds, seconds),
                rays: part(of_rays, rays),
            }
        };
        Forecast {
            width: settings.width,
            height: settings.height,
            spp: settings.spp,
            depth: settings.depth,
            backend,
            strips: probe.strips,
            samples: probe.samples,
            rays: probe.ledger.total().rays,
            seconds,
            accounts: Account::ALL
                .into_iter()
                .map(|account| (account.name(), shares(account)))
                .filter(|(_, shares)| shares.time > 0.0 || shares.rays > 0.0)
                .collect(),
        }
    }

    /// What the plan's line of an effect says of it; nothing if it has no account of its own.
    pub fn note(&self, effect: Effect) -> String {
        match self.accounts.get(effect.name()) {
            Some(shares) => format!(" (forecast: {shares})"),
            None => String::new(),
        }
    }
}

impl fmt::Display for Shares {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} of the time", percent(self.time))?;
        match self.rays > 0.0 {
            true => write!(f, ", {} of the rays", percent(self.rays)),
            false => Ok(()),
        }
    }
}

/// Whole percents: a probe tells no more.
fn percent(part: f64) -> String {
    match 100.0 * part {
        p if p > 0.0 && p < 1.0 => "<1 %".into(),
        p => format!("{p:.0} %"),
    }
}

/// A line for the probe and one for what is no effect's.
impl fmt::Display for Forecast {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(
            f,
            "{:<15}by {} samples, {} rays, of {}x{} pixels, {} samples each; {}: about {:.2} s of processor time",
            "forecast",
            self.samples,
            self.rays,
            self.width,
            self.height,
            self.spp,
            self.backend,
            self.seconds
        )?;
        let is_effect = |name: &str| Effect::ALL.iter().any(|effect| effect.name() == name);
        let mut others: Vec<_> = self
            .accounts
            .iter()
            .filter(|(name, _)| !is_effect(name))
            .collect();
        others.sort_by(|a, b| b.1.time.total_cmp(&a.1.time));
        let mut line = String::new();
        for (name, shares) in others {
            let comma = if line.is_empty() { "" } else { ", " };
            write!(line, "{comma}{name} {}", percent(shares.time))?;
        }
        writeln!(f, "{:<15}beside effects: {line} of the time", "forecast")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_whole_percents_and_rays_are_told_where_there_are_any() {
        let shares = |time, rays| Shares { time, rays }.to_string();
        assert_eq!(shares(0.234, 0.0), "23 % of the time");
        assert_eq!(shares(0.004, 0.5), "<1 % of the time, 50 % of the rays");
        assert_eq!(shares(0.0, 0.0), "0 % of the time");
    }
}
