//! Reference image that errors are taken against: two halves by two backends, with all knobs at their strictest.

use std::time::Instant;

use super::accumulated_reference::AccumulatedReference;
use super::budget::{MEASURED_PART, NOISE_FOR_A_TARGET, PLANNED_BLOCKS};
use super::layout::Layout;
use super::noise_stratum::NoiseStratum;
use super::target::Target;
use super::view::View;
use super::workspace::Workspace;
use super::{Check, Configuration, CostError, HitPath, ImageSums, Knob, SceneChange, SplitReference, Study};
use crate::accel::{Backend, Precision};
use crate::image::LinearImage;
use crate::numeric::SpawnPolicy;
use crate::render::{HitPoint, Pattern, Plan, RenderSettings};
use crate::scene::image_settings::{MAX_DEPTH, MAX_WAVELENGTHS};
use crate::scene::{Caustics, Effect, Interreflection, Scene};

/// Largest squared error of the reference, as a fraction of the smallest squared error that is reported.
const REFERENCE_PART: f64 = 0.01;
/// Squared error that the reference aims at, as a fraction; lower than the limit because the smallest error is not
/// known well in advance.
const AIMED_PART: f64 = 0.7 * REFERENCE_PART;
/// Largest change by stricter knobs that is accepted with a target, relative to the target error.
const LEFT_FOR_A_TARGET: f64 = 0.25;
/// Largest fraction of pixel blocks in which the halves of a reference may disagree.
const DISAGREEING_PART: f64 = 0.0025;
/// Smallest number of further images of both halves for which the pixels are divided into strata: that takes the time of
/// one, and the noise falls by more from the third on.
const MIN_PAIRS_FOR_STRATA: f64 = 2.0;
/// Ratio of the noise that larger images are planned for to that of the first two: these miss bright samples that are rare.
const RARE_NOISE: f64 = 2.0;
/// First seeds of the two halves, and of the images that check the reference; the seeds of blocks count from 1. The
/// distance ensures that no image of one half has the other half's random numbers.
const REFERENCE_SEEDS: [u32; 2] = [1_000_000_000, 2_000_000_000];

/// Goal of adding images to a reference.
struct NoiseGoal {
    /// Squared noise that is small enough.
    squared: f64,
    /// Seconds of the experiment at which no image may be unfinished.
    until: f64,
}

/// Returns the base with every knob that causes bias at its strictest level.
pub(super) fn strictest_configuration(base: &Configuration, scene: &Scene, plan: &Plan) -> Configuration {
    // Sampling noise is reduced by more samples; everything else is set to its strictest level.
    let settings = base.settings;
    let mut effects = settings.effects;
    if plan.effects().has(Effect::TextureFilter) {
        // With many samples, unfiltered textures converge to the correct image.
        effects.removed = effects.removed.with(Effect::TextureFilter);
    }
    let watertight = Precision::Watertight;
    Configuration {
        settings: RenderSettings {
            pattern: Pattern::Sobol,
            adaptive: None,
            // Deep paths take time only where they keep their weight, which is where they matter.
            depth: (12 * settings.depth).min(MAX_DEPTH / 2).max(settings.depth),
            weight_cutoff: (settings.weight_cutoff / 8.0).min(1.0 / 4096.0),
            wavelengths: settings.wavelengths.max(32),
            spawn: SpawnPolicy::Bounded,
            hit_points: HitPoint::Refined,
            effects,
            ..settings
        },
        // Watertight triangles are the strictest that Embree has; any other backend becomes the exact BSP.
        path: match base.path.backend {
            Backend::Embree => HitPath {
                precision: watertight,
                ..base.path
            },
            _ => HitPath::BSP,
        },
        denoises: false,
        // Halve the steps through volumes, which bias the transmittance; let light bounce on, and halve the radii of
        // photons.
        change: SceneChange {
            step_factor: 0.5 * base.change.step_factor.min(1.0),
            bounces: scene.interreflection.map(|interreflection| {
                let bounces = base.change.bounces.unwrap_or(interreflection.bounces);
                bounces.saturating_mul(4).min(Interreflection::MAX_BOUNCES)
            }),
            photons: scene.caustics.map(|caustics| {
                let photons = base.change.photons.unwrap_or(caustics.photons);
                photons.saturating_mul(4).min(Caustics::MAX_PHOTONS)
            }),
            ..base.change
        }
        .of(plan),
    }
}

/// Returns `strict` with fewer photons, for the checks of other knobs: whether these matter does not depend on photons, which
/// are traced anew for every image.
pub(super) fn checked_configuration(strict: &Configuration) -> Configuration {
    Configuration {
        change: SceneChange {
            photons: strict.change.photons.map(|photons| (photons / 64).max(1)),
            ..strict.change
        },
        ..*strict
    }
}

/// Returns a configuration for each knob that causes bias, with that knob even stricter than in `strict`.
pub(super) fn stricter(strict: &Configuration, plan: &Plan) -> Vec<(Knob, Configuration)> {
    let has = |effect| plan.effects().has(effect);
    let set = |change: fn(&mut Configuration)| {
        let mut configuration = *strict;
        change(&mut configuration);
        configuration
    };
    let mut all = Vec::new();
    if has(Effect::Reflection) || has(Effect::Refraction) {
        all.push((
            Knob::Depth,
            set(|c| c.settings.depth = (2 * c.settings.depth).min(MAX_DEPTH)),
        ));
        all.push((Knob::Cutoff, set(|c| c.settings.weight_cutoff /= 8.0)));
    }
    if has(Effect::Dispersion) {
        all.push((
            Knob::Wavelengths,
            set(|c| c.settings.wavelengths = (2 * c.settings.wavelengths).min(MAX_WAVELENGTHS)),
        ));
    }
    if has(Effect::Volume) {
        all.push((Knob::MarchStep, set(|c| c.change.step_factor *= 0.5)));
    }
    all
}

impl SceneChange {
    /// Returns these changes without those for effects that the plan does not have.
    fn of(self, plan: &Plan) -> SceneChange {
        SceneChange {
            step_factor: if plan.effects().has(Effect::Volume) {
                self.step_factor
            } else {
                1.0
            },
            bounces: self
                .bounces
                .filter(|_| plan.effects().has(Effect::Interreflection)),
            photons: self.photons.filter(|_| plan.effects().has(Effect::Caustics)),
            ..self
        }
    }
}

impl Workspace<'_, '_> {
    /// Renders both halves, each by its own intersection backend; `rendered` images of each were rendered before.
    pub(super) fn reference(
        &self,
        layout: &Layout,
        strict: &Configuration,
        rendered: u32,
    ) -> Result<AccumulatedReference, CostError> {
        let start = Instant::now();
        let means = self.pair(layout, strict, rendered, None)?;
        let seconds = start.elapsed().as_secs_f64();
        let halves = self.halves(layout.view, [&means[0], &means[1]]);
        Ok(AccumulatedReference {
            strata: vec![NoiseStratum::whole(halves.a.pixels.len(), seconds)],
            halves,
            means,
            rendered: rendered + 1,
        })
    }

    pub(super) fn halves(&self, view: View, means: [&LinearImage; 2]) -> SplitReference {
        let [a, b] = means.map(|mean| self.displayed(mean, view));
        SplitReference { a, b }
    }

    /// Renders one image for each half, or only the chosen pixels of it. The random numbers are selected by `rendered`, which
    /// is the number of earlier images.
    fn pair(
        &self,
        layout: &Layout,
        strict: &Configuration,
        rendered: u32,
        is_chosen: Option<&[bool]>,
    ) -> Result<[LinearImage; 2], CostError> {
        let half = |path, first_seed: u32| {
            self.report_step("reference");
            let mut configuration = strict.with_path(path);
            configuration.settings.spp = layout.reference_spp;
            let seed = first_seed + rendered;
            match is_chosen {
                Some(is_chosen) => self.render_pixels(&configuration, layout.view, seed, is_chosen),
                None => Ok(self.render_image(&configuration, layout.view, seed)?.0.image),
            }
        };
        Ok([
            half(strict.path, REFERENCE_SEEDS[0])?,
            half(HitPath::BSP, REFERENCE_SEEDS[1])?,
        ])
    }

    /// Adds images to the reference until its noise is small compared to every measured error, or until no time is
    /// left. Returns the layout: with larger images where the time allows it, or with fewer samples where only the larger errors of
    /// these allow the noise.
    pub(super) fn refine(
        &self,
        plan: &Plan,
        mut layout: Layout,
        strict: &Configuration,
        reference: &mut AccumulatedReference,
    ) -> Result<Layout, CostError> {
        // With a target, the planned reference is already as long as necessary.
        if self.experiment.target.is_some() {
            return Ok(layout);
        }
        loop {
            // Measure the smallest error, and reserve time for the blocks
            let start = Instant::now();
            let least = self.smallest_error(&layout, reference)?;
            let reserved = PLANNED_BLOCKS * start.elapsed().as_secs_f64();
            let until = MEASURED_PART * self.experiment.budget - reserved;
            // Begin anew with larger images if the time allows these, at the rate at which random noise falls
            let aimed = AIMED_PART * least;
            let missing = (RARE_NOISE * reference.halves.noise_squared() / aimed).max(1.0);
            let left = until + reserved - self.spent();
            if let Some(seconds) = reference.seconds_of_first()
                && let Some(larger) =
                    self.with_larger_images(&layout, left / (reserved + (1.0 + missing) * seconds))
            {
                *reference = self.reference(&larger, strict, reference.rendered)?;
                layout = larger;
                continue;
            }
            // Reduce the noise
            let goal = NoiseGoal {
                squared: aimed,
                until,
            };
            self.reduce_noise(&layout, strict, reference, &goal)?;
            // Go on with fewer samples if these promise errors for which the noise is small
            let excess = reference.halves.noise_squared() / (REFERENCE_PART * least);
            match self.with_fewer_samples(plan, &layout, excess) {
                Some(fewer) if excess > 1.0 => layout = fewer,
                _ => return Ok(layout),
            }
        }
    }

    /// Adds images to the reference until the goal is reached.
    fn reduce_noise(
        &self,
        layout: &Layout,
        strict: &Configuration,
        reference: &mut AccumulatedReference,
        goal: &NoiseGoal,
    ) -> Result<(), CostError> {
        let left = || goal.until - self.spent();
        let is_noisy = |reference: &AccumulatedReference| reference.halves.noise_squared() > goal.squared;
        // Divide the pixels by their noise, and begin anew if there is time for more than that
        if let Some(seconds) = reference.seconds_of_first()
            && is_noisy(reference)
            && strict.settings.filter.is_box()
            && left() > MIN_PAIRS_FOR_STRATA * seconds
        {
            let strata = NoiseStratum::by_noise(&reference.halves, seconds);
            *reference = AccumulatedReference {
                strata,
                ..self.reference(layout, strict, reference.rendered)?
            };
        }
        // Add images of the pixels that gain most by them
        while is_noisy(reference)
            && let Some(stratum) = reference.next_stratum(left())
        {
            self.add_images(layout, strict, reference, stratum)?;
        }
        Ok(())
    }

    /// Returns the smallest squared error of all candidates, each estimated from one image; infinity if none is positive.
    fn smallest_error(&self, layout: &Layout, reference: &AccumulatedReference) -> Result<f64, CostError> {
        let mut least = f64::INFINITY;
        for candidate in &layout.candidates {
            self.report_step("reference");
            let image = self
                .render_image(&candidate.configuration, layout.view, 0)?
                .0
                .image;
            let mut sums = ImageSums::new(&reference.halves);
            sums.add(&reference.halves, &self.displayed(&image, layout.view));
            let square = sums.mean_square();
            least = if square > 0.0 { least.min(square) } else { least };
        }
        Ok(least)
    }

    /// Adds one image of the pixels of a stratum to each half of the reference.
    fn add_images(
        &self,
        layout: &Layout,
        strict: &Configuration,
        reference: &mut AccumulatedReference,
        stratum: usize,
    ) -> Result<(), CostError> {
        let start = Instant::now();
        let is_member = &reference.strata[stratum].is_member;
        let is_chosen = (reference.strata.len() > 1).then_some(&is_member[..]);
        let images = self.pair(layout, strict, reference.rendered, is_chosen)?;
        reference.rendered += 1;
        reference.add(stratum, &images);
        reference.strata[stratum].seconds = start.elapsed().as_secs_f64();
        let [a, b] = &reference.means;
        reference.halves = self.halves(layout.view, [a, b]);
        Ok(())
    }

    /// Returns the root mean squared difference between `strict` and `stricter`, without noise: the mean product of the
    /// differences of two image pairs, each pair with its own seed.
    pub(super) fn residual_bias(
        &self,
        layout: &Layout,
        strict: &Configuration,
        stricter: &Configuration,
    ) -> Result<f64, CostError> {
        self.report_step("check");
        // Render two independent pairs of images
        let mut differences = Vec::new();
        for seed in REFERENCE_SEEDS {
            let mut pair = Vec::new();
            for configuration in [strict, stricter] {
                let mut configuration = *configuration;
                configuration.settings.spp = layout.stricter_spp;
                let image = self.render_image(&configuration, layout.view, seed)?.0.image;
                pair.push(self.displayed(&image, layout.view));
            }
            differences.push(pair[0].minus(&pair[1]));
        }
        // Average the products, in which independent noise cancels
        let products = differences[0].iter().zip(&differences[1]).map(|(a, b)| a * b);
        Ok((products.sum::<f64>() / differences[0].len() as f64)
            .max(0.0)
            .sqrt())
    }
}

/// Returns the checks that a reference must pass before errors against it are reliable.
pub(super) fn checks(
    strict: &Configuration,
    reference: &AccumulatedReference,
    study: &Study,
    left: &[(Knob, f64)],
) -> Vec<Check> {
    // Choose bounds by the smallest reported error, or by the target
    let [noise_bound, left_bound, error] = match &study.choice {
        None => {
            let known = study.points.iter().map(|point| point.rmse.value);
            let least = known.filter(|&rmse| rmse > 0.0).fold(f64::INFINITY, f64::min);
            let bound = REFERENCE_PART.sqrt() * least;
            [bound, bound, least]
        }
        Some(choice) => {
            let error = match choice.target {
                Target::Error(most) => most,
                Target::Seconds(_) => choice.rmse.value,
            };
            // Even with twice the planned noise the reference hardly widens an interval.
            [2.0 * NOISE_FOR_A_TARGET * error, LEFT_FOR_A_TARGET * error, error]
        }
    };
    // Check the noise of the mean
    let noise = reference.halves.noise_squared().sqrt();
    let of_what = if study.choice.is_some() {
        "the error"
    } else {
        "the smallest error"
    };
    let mut checks = vec![Check {
        name: "noise".to_owned(),
        holds: noise <= noise_bound,
        words: format!("noise {noise:.2e}, at most {noise_bound:.2e} allowed for {of_what} of {error:.2e}"),
    }];
    // Check that both backends agree
    let disagreeing = reference.halves.disagreeing_fraction();
    checks.push(Check {
            name: "two paths".to_owned(),
            holds: disagreeing <= DISAGREEING_PART,
            words: format!(
                "halves by {} and {} differ by more than noise in {:.2} % of the pixel blocks, at most {:.2} % allowed",
                strict.path.name(),
                HitPath::BSP.name(),
                100.0 * disagreeing,
                100.0 * DISAGREEING_PART
            ),
        });
    // Check for non-finite pixels
    let means = reference.means.iter();
    let non_finite: usize = means.map(LinearImage::non_finite_count).sum();
    checks.push(Check {
        name: "numbers".to_owned(),
        holds: non_finite == 0,
        words: format!("{non_finite} pixels are not finite"),
    });
    // Check that stricter knobs do not change the image
    for (knob, left) in left {
        checks.push(Check {
            name: knob.name().to_owned(),
            holds: *left <= left_bound,
            words: format!(
                "a stricter value changes the image by {left:.2e}, at most {left_bound:.2e} allowed"
            ),
        });
    }
    checks
}
