//! Costs of effects for `whit info --prices`: a few tiles are rendered as planned, without each effect, and with less
//! depth.
//!
//! All variants are timed by turns and compared with the planned image of the same block. Times are processor times
//! where the system provides them. The planned image takes part twice: the ratio of its two times is the noise.

use std::time::{Duration, Instant};

use serde::Serialize;

use super::error::BenchError;
use super::options::MeasuredScene;
use crate::accel::{self, Accel, AccelOptions, Backend};
use crate::image::metrics::{Metrics, Tally, Viewing};
use crate::measure::{Blocks, Interval, Observer, Protocol, TurnTime};
use crate::render::{Category, RenderSettings, TileSample, render_sample, tile_count};
use crate::scene::{Effect, EffectSet};

/// Largest part of the image that is rendered: enough tiles to represent all of it, few enough to be quick.
const MAX_SAMPLED: f64 = 0.05;
/// Smallest number of tiles, for small images and small budgets.
const MIN_TILES: usize = 8;
/// Smallest number of blocks that bounds a median: all of five lie on one side of it with probability 1/16.
const MIN_RUNS: usize = 5;
/// Largest number of blocks; more would only resolve differences of time that are irrelevant.
const MAX_RUNS: usize = 25;
/// Largest number of depths that are tried: radiance after so many reflections is small almost everywhere.
const MAX_STEPS: u32 = 16;
/// Expected time of an image with an effect that is simulated only on request, in times of the planned image.
const ADDED_TIME: usize = 6;
/// Seed of the random order within blocks.
const SEED: u64 = 2;

/// Costs of effects in a scene, measured on a few tiles of its image.
#[derive(Clone, Debug, Serialize)]
pub struct AblationStudy {
    /// Width of the complete image in pixels.
    pub width: u32,
    /// Height of the complete image in pixels.
    pub height: u32,
    /// Number of samples per pixel.
    pub spp: u32,
    /// Maximum depth of reflected and refracted rays.
    pub depth: u32,
    /// Depth after which no ray of the sample remained; null where the search did not find it.
    pub depth_reached: Option<u32>,
    /// Name of the camera.
    pub camera: String,
    /// Intersection backend that found the hits.
    pub backend: Backend,
    /// Number of threads that rendered.
    pub threads: usize,
    /// Number of tiles that were rendered.
    pub tiles: usize,
    /// Number of tiles of the complete image.
    pub tiles_in_all: usize,
    /// Number of timed renders of each variant, in alternation.
    pub runs: usize,
    /// Estimated seconds for the complete image on all threads, if each has a processor of its own.
    pub seconds_forecast: f64,
    /// Relative variation of the unchanged image's own times.
    pub noise: f64,
    /// Changes with their effects on time and image, the most expensive first; changes within the noise are last.
    pub list: Vec<Ablation>,
}

/// Change of time and image when one thing is left out.
#[derive(Clone, Debug, Serialize)]
pub struct Ablation {
    /// Effect that is left out; null otherwise.
    pub without: Option<Effect>,
    /// Effect that is added, because it is simulated only on request; null otherwise.
    pub with: Option<Effect>,
    /// Effects that are implied, as they have no influence without it.
    pub takes_along: Vec<Effect>,
    /// Maximum depth in place of the image's; null for an effect.
    pub depth: Option<u32>,
    /// Change of the render time.
    pub time: TimeChange,
    /// True if any bit of the sample changes.
    pub changes_picture: bool,
    /// Error metrics of the changed image against the complete one, over the sample.
    pub picture: Metrics,
}

/// Relative change of a time: -0.38 for 38 % less.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TimeChange {
    /// Median change over the runs.
    pub median: f64,
    /// Lower end of the interval that contains the true median with 95 % probability, for six runs or more.
    pub low: f64,
    /// Upper end of the interval that contains the true median with 95 % probability, for six runs or more.
    pub high: f64,
    /// True if the change may be zero.
    pub within_noise: bool,
    /// Largest change up or down that is possible if the change is within the noise.
    pub noise: f64,
}

impl TimeChange {
    /// Returns the change with its interval; `noise` is the variation without a change.
    pub(crate) fn new(change: Interval, noise: f64) -> TimeChange {
        let Interval {
            value: median,
            low,
            high,
        } = change;
        TimeChange {
            median,
            low,
            high,
            // The change is noise if the interval contains zero, or if it is no larger than the noise
            within_noise: low <= 0.0 && high >= 0.0 || median.abs() <= noise,
            noise: noise.max(low.abs()).max(high.abs()),
        }
    }
}

impl Ablation {
    /// Returns the estimated fraction of the time that goes into the effect; `None` within the noise.
    pub fn share(&self) -> Option<f64> {
        (!self.time.within_noise).then_some((-self.time.median).max(0.0))
    }
}

impl AblationStudy {
    /// Returns the cost of an effect, if it was left out in the study.
    pub fn of_effect(&self, effect: Effect) -> Option<&Ablation> {
        self.list.iter().find(|price| price.without == Some(effect))
    }
}

/// Options of a measurement of costs.
#[derive(Clone, Copy)]
pub struct AblationOptions {
    /// Intersection backend that finds the hits.
    pub backend: Backend,
    /// Number of threads of the current pool.
    pub threads: usize,
    /// Viewing conditions of the comparison of images.
    pub viewing: Viewing,
    /// Seconds for the whole measurement, which may be exceeded by the least number of runs.
    pub budget: f64,
}

/// Measures the costs of all planned effects and of each depth, in the current thread pool.
///
/// # Errors
///
/// Returns an error where the acceleration structure cannot be built, and on cancellation.
pub fn ablation_study(
    measured: &MeasuredScene,
    options: &AblationOptions,
    observer: &Observer,
) -> Result<AblationStudy, BenchError> {
    // Build the acceleration structure
    let build_options = AccelOptions {
        threads: options.threads,
        progress: Some(&|fraction| (observer.progress)("build", fraction)),
        ..AccelOptions::default()
    };
    let accel = accel::build(measured.scene, options.backend, &build_options)?;
    // Render a first sample to determine how many tiles the budget allows
    (observer.progress)("sample", 0.0);
    let mut sampler = TileSampler {
        measured,
        accel: &*accel,
        tiles: MIN_TILES,
        observer,
    };
    sampler.tiles = sampler.affordable_tiles(options.budget)?;
    // Render each variant once to compare its image with the planned one
    let start = Instant::now();
    let (variants, depth_reached) = sampler.variants()?;
    // Time the variants with the rest of the budget, and the planned one a second time
    let budget = Duration::try_from_secs_f64(options.budget).unwrap_or_default();
    let protocol = Protocol {
        least: MIN_RUNS,
        most: MAX_RUNS,
        deadline: start + budget,
        seed: SEED,
    };
    let progress = |fraction| (observer.progress)("time", fraction);
    let control = variants.len();
    let blocks = Blocks::measure(control + 1, &protocol, &progress, |candidate, _| {
        let variant = variants.get(candidate).unwrap_or(&variants[0]);
        let sample = sampler.render(&variant.settings)?;
        Ok::<_, BenchError>(TurnTime::of_seconds(sample.seconds()))
    })?;
    // The noise is the difference between the two measurements of the planned image
    let change = |candidate| Interval::of_median(&blocks.ratios(candidate, 0)).map(|ratio| ratio - 1.0);
    let noise = TimeChange::new(change(control), 0.0).noise;
    let mut list: Vec<Ablation> = variants
        .iter()
        .enumerate()
        .skip(1)
        .map(|(index, variant)| {
            let time = TimeChange::new(change(index), noise);
            variant.cost(&variants[0], time, &options.viewing)
        })
        .collect();
    sort(&mut list);
    // Extrapolate from the tiles to the whole image
    let RenderSettings {
        width,
        height,
        spp,
        depth,
        ..
    } = measured.settings;
    let tiles = &variants[0].sample.tiles;
    let pixels: usize = tiles.iter().map(|tile| tile.image.pixels.len()).sum();
    let per_pixel = Interval::of_median(&blocks.seconds(0)).value / pixels.max(1) as f64;
    Ok(AblationStudy {
        width,
        height,
        spp,
        depth,
        depth_reached,
        camera: measured.camera.name.clone(),
        backend: options.backend,
        threads: options.threads,
        tiles: tiles.len(),
        tiles_in_all: tile_count(width, height),
        runs: blocks.count(),
        seconds_forecast: per_pixel * f64::from(width) * f64::from(height) / options.threads as f64,
        noise,
        list,
    })
}

/// Sorts by cost in descending order, with changes within the noise last; the sort is stable.
fn sort(list: &mut [Ablation]) {
    let key = |price: &Ablation| match price.time.within_noise {
        true => f64::INFINITY,
        false => price.time.median,
    };
    list.sort_by(|a, b| key(a).total_cmp(&key(b)));
}

/// Renderer of the same tiles with different settings.
struct TileSampler<'a> {
    measured: &'a MeasuredScene<'a>,
    accel: &'a dyn Accel,
    /// Number of tiles rendered of each variant.
    tiles: usize,
    observer: &'a Observer<'a>,
}

impl TileSampler<'_> {
    fn render(&self, settings: &RenderSettings) -> Result<TileSample, BenchError> {
        let view = (self.measured.scene, self.measured.camera);
        let monitor = self.observer.monitor();
        Ok(render_sample(view, self.accel, settings, self.tiles, &monitor)?)
    }

    /// Returns the number of tiles with which the smallest number of runs fits into the budget.
    fn affordable_tiles(&self, budget: f64) -> Result<usize, BenchError> {
        let settings = &self.measured.settings;
        let start = Instant::now();
        let pilot = self.render(settings)?;
        let per_tile = start.elapsed().as_secs_f64() / pilot.tiles.len().max(1) as f64;
        let changes = pilot.plan.effects().iter().count() + settings.depth.min(MAX_STEPS) as usize;
        // Effects that are added take several times as long as the planned image
        let absent = EffectSet::ON_REQUEST.minus(pilot.plan.effects());
        let changes = changes + ADDED_TIME * absent.iter().count();
        // The planned image takes part twice, and there is one run for the images.
        let renders = (changes + 2) * (MIN_RUNS + 1);
        let most = (MAX_SAMPLED * tile_count(settings.width, settings.height) as f64).round() as usize;
        let affordable = budget / (per_tile * renders as f64);
        Ok((affordable as usize).min(most).max(MIN_TILES))
    }

    /// Returns all variants, the planned one first, and the depth from which on no ray is left, if it is known.
    fn variants(&self) -> Result<(Vec<Variant>, Option<u32>), BenchError> {
        let planned = self.measured.settings;
        let new = |settings, change| {
            Ok::<_, BenchError>(Variant {
                sample: self.render(&settings)?,
                settings,
                change,
            })
        };
        let mut variants = vec![new(planned, Change::Depth)?];
        let effects: Vec<Effect> = variants[0].sample.plan.effects().iter().collect();
        let steps = planned.depth.min(MAX_STEPS);
        let whole = (effects.len() + steps as usize) as f64;
        // Leave out each effect
        for &effect in &effects {
            let mut settings = planned;
            settings.effects.added = settings.effects.added.without(effect);
            settings.effects.removed = settings.effects.removed.with(effect);
            variants.push(new(settings, Change::Without(effect))?);
            (self.observer.progress)("sample", variants.len() as f64 / whole);
        }
        // Add each effect that is simulated only on request, if it has any rays
        let absent = EffectSet::ON_REQUEST.minus(variants[0].sample.plan.effects());
        for effect in absent.iter() {
            let mut settings = planned;
            settings.effects.added = settings.effects.added.with(effect);
            settings.effects.removed = settings.effects.removed.without(effect);
            let added = new(settings, Change::With(effect))?;
            let account = Category::of(effect).map(|account| added.sample.ledger.of(account));
            if account.is_some_and(|account| account.rays > 0) {
                variants.push(added);
            }
        }
        // Limit the depth, up to the depth at which no ray is cut off
        for depth in 0..steps {
            let shallow = new(RenderSettings { depth, ..planned }, Change::Depth)?;
            if shallow.traced_rays() == variants[0].traced_rays() {
                return Ok((variants, Some(depth)));
            }
            variants.push(shallow);
            (self.observer.progress)("sample", variants.len() as f64 / whole);
        }
        Ok((variants, None))
    }
}

/// Variant that takes part in the measurement, with its rendered tiles.
struct Variant {
    settings: RenderSettings,
    change: Change,
    sample: TileSample,
}

/// Change of the settings that a variant makes.
#[derive(Clone, Copy)]
enum Change {
    /// The depth is smaller.
    Depth,
    /// An effect is left out.
    Without(Effect),
    /// An effect is added.
    With(Effect),
}

impl Variant {
    fn traced_rays(&self) -> u64 {
        let ledger = &self.sample.ledger;
        ledger.reflection_rays() + ledger.refraction_rays()
    }

    /// Returns the cost of what the variant lacks, by its change of time and its difference from the planned image.
    fn cost(&self, planned: &Variant, time: TimeChange, viewing: &Viewing) -> Ablation {
        let (without, with) = match self.change {
            Change::Depth => (None, None),
            Change::Without(effect) => (Some(effect), None),
            Change::With(effect) => (None, Some(effect)),
        };
        // List the planned effects that are off besides the one that was left out
        let gone = planned.sample.plan.effects().minus(self.sample.plan.effects());
        let takes_along = gone.iter().filter(|&effect| without != Some(effect)).collect();
        // Compare the tiles with the planned ones
        let mut tally = Tally::default();
        let mut changes_picture = false;
        for (reference, test) in planned.sample.tiles.iter().zip(&self.sample.tiles) {
            changes_picture |= reference.image != test.image;
            let sizes_match = tally.add(&reference.image, &test.image, viewing).is_ok();
            debug_assert!(sizes_match, "both are samples of the same image");
        }
        Ablation {
            without,
            with,
            takes_along,
            depth: matches!(self.change, Change::Depth).then_some(self.settings.depth),
            time,
            changes_picture,
            picture: tally.metrics(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn change_is_noise_unless_all_runs_agree() {
        let of = |runs: &[f64], noise| TimeChange::new(Interval::of_median(runs), noise);
        let clear = of(&[-0.4, -0.3, -0.35, -0.9, -0.38], 0.02);
        assert_eq!((clear.median, clear.low, clear.high), (-0.38, -0.9, -0.3));
        assert!(!clear.within_noise);
        let torn = of(&[-0.01, 0.02, 0.01, -0.02, 0.03], 0.01);
        assert!(torn.within_noise);
        assert_eq!(torn.noise, 0.03);
        // The change is as small as the variation of the image itself.
        assert!(of(&[-0.01; 5], 0.02).within_noise);
    }
}
