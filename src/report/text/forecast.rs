//! Estimate of an image's cost from a quick probe: `whit info`.

use std::collections::BTreeMap;
use std::fmt::{self, Write};

use serde::Serialize;

use crate::accel::Backend;
use crate::render::{Category, Probe, RenderProfile, RenderSettings, Tally};
use crate::scene::Effect;

/// Estimated distribution of rays and time.
#[derive(Clone, Debug, Serialize)]
pub struct Forecast {
    /// Width of the image in pixels.
    pub width: u32,
    /// Height of the image in pixels.
    pub height: u32,
    /// Number of samples per pixel.
    pub spp: u32,
    /// Maximum depth of reflected and refracted rays.
    pub depth: u32,
    /// Intersection backend of the probe.
    pub backend: Backend,
    /// Number of pixel strips that the probe rendered.
    pub strips: usize,
    /// Number of samples in the strips.
    pub samples: u64,
    /// Number of rays in the strips.
    pub rays: u64,
    /// Estimated seconds of processor time for the complete image, setup included.
    pub seconds: f64,
    /// Shares by account; an effect's account has the effect's name.
    pub accounts: BTreeMap<&'static str, Shares>,
}

/// Fractions of time and rays that an account takes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shares {
    /// Fraction of the time, setup included.
    pub time: f64,
    /// Fraction of the rays.
    pub rays: f64,
}

impl Forecast {
    /// Extrapolates `probe` to the image that `settings` describe.
    pub fn of(probe: &Probe, settings: &RenderSettings, backend: Backend) -> Forecast {
        // Scale the strips by samples, and add setup once
        let samples = f64::from(settings.width) * f64::from(settings.height) * f64::from(settings.spp);
        let times = samples / probe.samples.max(1) as f64;
        let of_image = |of: &dyn Fn(&RenderProfile) -> Tally| {
            let (strips, once) = (of(&probe.ledger), of(&probe.once));
            let rays = strips.rays as f64 * times + once.rays as f64;
            (strips.seconds * times + once.seconds, rays)
        };
        let (seconds, rays) = of_image(&RenderProfile::total);
        let part = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
        // Divide each account by the total
        let shares = |account: Category| {
            let (of_seconds, of_rays) = of_image(&|ledger| ledger.of(account));
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
            // Keep accounts that took time or rays
            accounts: Category::ALL
                .into_iter()
                .map(|account| (account.name(), shares(account)))
                .filter(|(_, shares)| shares.time > 0.0 || shares.rays > 0.0)
                .collect(),
        }
    }

    /// Returns the text that the plan's line of an effect appends; empty if the effect has no account of its own.
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

/// Formats whole percentages, as a probe is not more accurate.
fn percent(part: f64) -> String {
    match 100.0 * part {
        p if p > 0.0 && p < 1.0 => "<1 %".into(),
        p => format!("{p:.0} %"),
    }
}

/// Text form with a line for the probe and one for accounts that are not effects.
impl fmt::Display for Forecast {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(
            f,
            "{:<15}from {} samples, {} rays, of {}x{} pixels, {} samples each; {}: about {:.2} s of processor time",
            "forecast",
            self.samples,
            self.rays,
            self.width,
            self.height,
            self.spp,
            self.backend,
            self.seconds
        )?;
        // List accounts outside effects, in descending order of time
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
        writeln!(f, "{:<15}outside effects: {line} of the time", "forecast")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_whole_percents_and_zero_rays_are_omitted() {
        let shares = |time, rays| Shares { time, rays }.to_string();
        assert_eq!(shares(0.234, 0.0), "23 % of the time");
        assert_eq!(shares(0.004, 0.5), "<1 % of the time, 50 % of the rays");
        assert_eq!(shares(0.0, 0.0), "0 % of the time");
    }
}
