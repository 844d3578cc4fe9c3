//! Text of the costs of effects: `whit info --prices`.

use std::fmt;

use crate::bench::{Ablation, AblationStudy, TimeChange};
use crate::image::metrics::Metrics;
use crate::report::format::percent;
use crate::scene::Effect;

/// Returns the text that the plan's line of an effect appends about its time.
pub(super) fn note(study: &AblationStudy, effect: Effect) -> String {
    let Some(price) = study.of_effect(effect) else {
        return String::new();
    };
    match price.share() {
        None => format!(" (time within the noise of ±{})", percent(price.time.noise)),
        Some(0.0) => format!(" (saves about {} of the time)", percent(price.time.median)),
        Some(share) => format!(" (about {} of the time)", percent(share)),
    }
}

/// Formats a percentage with its sign.
fn signed(part: f64) -> String {
    let sign = if part < 0.0 { '-' } else { '+' };
    format!("{sign}{}", percent(part))
}

impl fmt::Display for TimeChange {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if self.within_noise {
            return write!(f, "time within the noise of ±{}", percent(self.noise));
        }
        let (median, low, high) = (signed(self.median), signed(self.low), signed(self.high));
        write!(f, "{median} time ({low} to {high})")
    }
}

impl fmt::Display for Ablation {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match (self.without, self.with, self.depth) {
            (Some(effect), ..) => write!(f, "{effect}: without it")?,
            (None, Some(effect), _) => write!(f, "{effect}: with it")?,
            (None, None, depth) => write!(f, "depth: with {}", depth.unwrap_or_default())?,
        }
        if !self.takes_along.is_empty() {
            let names: Vec<&str> = self.takes_along.iter().map(|effect| effect.name()).collect();
            write!(f, " and so without {}", names.join(", "))?;
        }
        write!(f, ": {}, ", self.time)?;
        if !self.changes_picture {
            return write!(f, "no pixel changes");
        }
        let Metrics {
            changed_share, flip, ..
        } = self.picture;
        write!(f, "{} of pixels change, FLIP {flip:.3}", percent(changed_share))
    }
}

/// Text form with a line for the measurement and one for each cost.
impl fmt::Display for AblationStudy {
    // Print the conditions of the measurement
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(
            f,
            "{:<15}by {} of {} tiles of {}x{} pixels, {} samples each, rendered {} times in turn; {}, {} threads; the whole \
             image takes about {:.2} s",
            "prices",
            self.tiles,
            self.tiles_in_all,
            self.width,
            self.height,
            self.spp,
            self.runs,
            self.backend,
            self.threads,
            self.seconds_forecast
        )?;
        // Print the cost of each effect and depth
        self.list
            .iter()
            .try_for_each(|price| writeln!(f, "{:<15}{price}", "price"))?;
        match self.depth_reached.filter(|&reached| reached < self.depth) {
            Some(reached) => writeln!(
                f,
                "{:<15}depth: no sampled ray remains after {reached} steps; from {reached} to {} they cost nothing",
                "price", self.depth
            ),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::metrics::Tally;
    use crate::measure::Interval;

    #[test]
    fn change_within_the_noise_shows_the_noise() {
        let torn = TimeChange::new(Interval::of_median(&[-0.01, 0.02, 0.01, -0.02, 0.03]), 0.01);
        assert_eq!(torn.to_string(), "time within the noise of ±3.0 %");
    }

    fn price(without: Effect, change: f64) -> Ablation {
        Ablation {
            without: Some(without),
            with: None,
            takes_along: vec![],
            depth: None,
            time: TimeChange::new(Interval::exact(change), 0.0),
            changes_picture: false,
            picture: Tally::default().metrics(),
        }
    }

    #[test]
    fn line_shows_the_change_of_time_and_image() {
        let mut price = price(Effect::Refraction, -0.38);
        assert_eq!(
            price.to_string(),
            "refraction: without it: -38 % time (-38 % to -38 %), no pixel changes"
        );
        price.takes_along = vec![Effect::Dispersion, Effect::Absorption];
        price.changes_picture = true;
        price.picture.changed_share = 0.12;
        price.picture.flip = 0.0412;
        assert_eq!(
            price.to_string(),
            "refraction: without it and so without dispersion, absorption: -38 % time (-38 % to -38 %), 12 % of pixels \
             change, FLIP 0.041"
        );
    }

    #[test]
    fn percentages_have_at_most_two_digits() {
        let words = [0.0, 1e-6, 0.0005, 0.0123, 0.0949, 0.0951, 0.5].map(percent);
        assert_eq!(
            words,
            ["0 %", "<0.01 %", "0.05 %", "1.2 %", "9.5 %", "10 %", "50 %"]
        );
    }
}
