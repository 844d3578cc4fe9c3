//! Budget allocation: size and samples of an experiment's images, by the times of small pilot images.

use super::checkpoint::StudyCheckpoint;
use super::knob::{LevelRange, knobs};
use super::layout::{Candidate, Layout};
use super::target::Target;
use super::view::{View, area};
use super::workspace::Workspace;
use super::{Configuration, CostError, Experiment, HitPath, SplitReference};
use crate::image::LinearImage;
use crate::render::{MIN_ADAPTIVE_ERROR, Plan};

/// Samples per pixel of the base and of the largest level, in the order in which they are tried.
const LADDER: [[u32; 2]; 5] = [[16, 32], [8, 16], [4, 16], [4, 8], [2, 8]];
/// Smallest planned ratio of each reference half's samples to the largest level's: the reference's squared noise is then a
/// four-hundredth of that level's where errors fall at the random rate. The check of the noise needs a hundredth; the rest is
/// for errors that fall more slowly, as those of rare bright samples do, which display clips.
const REFERENCE_TIMES: u32 = 200;
/// Number of images that each reference half is planned as; the first shows in which pixels the noise is.
const REFERENCE_IMAGES: u32 = 16;
/// Smallest growth of the images for which the reference is begun anew.
const MIN_GROWTH: f64 = 1.5;
/// Smallest number of samples per pixel of an image of a reference half.
const MIN_REFERENCE_SPP: u32 = 64;
/// Smallest number of pixels that represents a scene well; a smaller layout of the ladder is used before going below.
const MIN_STUDY_PIXELS: f64 = 12_288.0;
/// Smallest number of pixels of a scaled-down image and of an image of patches: intervals are resampled from at least
/// eight patches.
const MIN_PIXELS: f64 = 1024.0;
const MIN_PATCH_PIXELS: f64 = 2048.0;
/// Number of pixels in patches below which the interval of an error is so wide that settings for a target take twice
/// the time; the reference then takes fewer samples instead.
const MIN_WIDE_PATCH_PIXELS: f64 = 8192.0;
/// Largest and smallest number of pixels of a pilot image.
const PILOT_PIXELS: [f64; 2] = [3072.0, 192.0];
/// Samples per pixel of the reference's pilot.
const PILOT_SPP: u32 = 4;
/// Number of blocks that a budget is planned for.
pub(super) const PLANNED_BLOCKS: f64 = 8.0;
/// Number of planned blocks with a target: predictions are corrected anyway when combinations are measured.
const PLANNED_BLOCKS_FOR_A_TARGET: f64 = 2.0;
/// Number of images that a search for settings takes, each with about the samples that the target needs.
const PLANNED_IMAGES_OF_A_SEARCH: f64 = 8.0;
/// Fraction of the budget that is planned, pilot included, and the pilot's fraction; the rest is a reserve.
const LAID_OUT: f64 = 0.85;
const PILOT_PART: f64 = 0.04;
/// Fraction of the budget after which no block begins; the remaining work is small.
pub(super) const MEASURED_PART: f64 = 0.94;
/// Part of the scene's photons that images of a study have.
const STUDIED_PHOTONS: u32 = 16;
/// Samples per pixel of the images that check whether stricter knobs still matter.
const STRICTER_SPP: u32 = 16;
/// Samples per pixel of these checks with a target, where the change must be small only relative to the target.
const STRICTER_SPP_FOR_A_TARGET: u32 = 4;
/// Largest error of the reference's mean with a target, relative to the target. Error estimates exclude it, so that it
/// only widens intervals.
pub(super) const NOISE_FOR_A_TARGET: f64 = 0.5;
/// Smallest and largest samples per pixel of each reference half with a target.
const REFERENCE_SPP_FOR_A_TARGET: [u32; 2] = [16, 1024];
/// Largest number of samples per pixel of adaptive sampling with a target.
const ADAPTIVE_SAMPLES: u32 = 256;
/// Adaptive errors that are measured with a target, relative to it; others are predicted from them.
const ADAPTIVE_ERRORS: [f64; 2] = [8.0, 4.0];

/// Cost of a sample and its variance, measured on small images.
struct Pilot {
    /// Seconds per sample and pixel of the base.
    unit: f64,
    /// Seconds per sample and pixel of both reference halves together.
    halves: f64,
    /// Mean squared difference of one sample of a pixel from the mean of many, in displayed values.
    variance: f64,
}

/// Returns all configurations that an experiment may measure under any budget; scenes and acceleration structures are
/// prepared for them.
pub(super) fn widest(experiment: &Experiment, plan: &Plan) -> Vec<Candidate> {
    candidates(experiment, plan, LADDER[0][0], &LevelRange::of(LADDER[0][1]))
}

/// Returns the base at `base_spp` samples and all configurations that are compared with it.
fn candidates(experiment: &Experiment, plan: &Plan, base_spp: u32, reach: &LevelRange) -> Vec<Candidate> {
    // Set the samples of the base
    let mut base = experiment.base;
    base.settings.adaptive = None;
    base.settings.spp = match experiment.target {
        None => base.settings.spp.min(base_spp),
        Some(_) => base_spp,
    };
    // A study traces photons anew for each of its images; their own knob shows what the scene's number brings
    if experiment.target.is_none()
        && let Some(caustics) = experiment.scene.get().caustics
    {
        let photons = base.change.photons.unwrap_or(caustics.photons);
        base.change.photons = Some((photons / STUDIED_PHOTONS).max(1));
    }
    // List the levels of all knobs; patches of an image cannot be denoised
    let reach = LevelRange {
        denoises: experiment.denoiser.is_some() && experiment.target.is_none(),
        ..reach.clone()
    };
    let mut knobs = knobs(&experiment.scene, plan, &base, &reach);
    // Configurations that may not be chosen are not measured.
    if experiment.target.is_some() {
        knobs.retain(|(_, _, turned)| turned.is_as_accurate_as(&base));
    }
    for (_, _, configuration) in &mut knobs {
        if let Some(adaptive) = &mut configuration.settings.adaptive {
            adaptive.gain = f64::from(experiment.tone.exposure_ev).exp2();
        }
    }
    // Put the base first
    let base = Candidate {
        knob: None,
        level: "base".to_owned(),
        configuration: base,
    };
    let turned = knobs.into_iter().map(|(knob, level, configuration)| Candidate {
        knob: Some(knob),
        level,
        configuration,
    });
    std::iter::once(base).chain(turned).collect()
}

impl Layout {
    /// Returns the layout of an interrupted study; `None` if its configurations, target or threads were different.
    pub(super) fn resumed(
        experiment: &Experiment,
        plan: &Plan,
        unfinished: &StudyCheckpoint,
    ) -> Option<Layout> {
        let head = &unfinished.head;
        let candidates = candidates(experiment, plan, head.base_spp, &head.reach);
        let words = candidates.iter().map(|candidate| candidate.configuration.words());
        let is_same = words.eq(head.words.iter().cloned())
            && (head.threads, head.target) == (experiment.threads, experiment.target);
        is_same.then(|| Layout {
            view: unfinished.view(),
            candidates,
            reference_spp: head.reference_spp,
            stricter_spp: head.stricter_spp,
            base_spp: head.base_spp,
            reach: head.reach.clone(),
        })
    }
}

impl Workspace<'_, '_> {
    /// Chooses the size and the samples of all images; `checks` is the number of knobs of `strict` that are checked at
    /// stricter levels.
    pub(super) fn plan_layout(
        &self,
        plan: &Plan,
        strict: &Configuration,
        checks: usize,
    ) -> Result<Layout, CostError> {
        self.report_step("pilot");
        let base = &candidates(self.experiment, plan, 1, &LevelRange::of(1))[0].configuration;
        let small = self.choose_view(PILOT_PIXELS[0]);
        // The very first image includes page faults and cold caches, so that it is not counted.
        self.render_image(base, small, 0)?;
        let unit = self.render_image(base, small, 0)?.1.elapsed / area(self.size_of(small));
        match self.experiment.target {
            None => self.plan_study(plan, strict, unit),
            Some(target) => {
                let pilot = self.pilot(strict, small, unit)?;
                self.plan_search(plan, target, &pilot, checks)
            }
        }
    }

    /// Returns the layout of a study without a target: the first rung of the ladder at which images within the budget
    /// are large enough.
    fn plan_study(&self, plan: &Plan, strict: &Configuration, unit: f64) -> Result<Layout, CostError> {
        let requested_size = self.experiment.size;
        let budget = self.experiment.budget - self.spent();
        // Try rungs from the most samples to the fewest
        for (place, [base_spp, most]) in LADDER.into_iter().enumerate() {
            let reach = LevelRange::of(most);
            let candidates = candidates(self.experiment, plan, base_spp, &reach);
            let samples = samples_of(&candidates);
            let affordable = PILOT_PART * budget / (unit * samples);
            let pilot = self.choose_view(affordable.clamp(PILOT_PIXELS[1], PILOT_PIXELS[0]));
            let is_last = place + 1 == LADDER.len();
            let mut reference_spp = (REFERENCE_TIMES * most).next_power_of_two();
            // Predict the cost without a pilot of its own, and skip hopeless rungs early.
            let least = unit * (PLANNED_BLOCKS * samples + 2.0 * f64::from(reference_spp));
            if !is_last && LAID_OUT * budget / least < MIN_STUDY_PIXELS && requested_size.is_none() {
                continue;
            }
            // Measure the time per pixel by a pilot of every configuration
            let block = self.block_of(&candidates, pilot)?;
            let halves = self.pilot(strict, pilot, unit)?.halves;
            let left = LAID_OUT * (self.experiment.budget - self.spent());
            let affordable =
                |reference_spp: u32| left / (PLANNED_BLOCKS * block + f64::from(reference_spp) * halves);
            let requested_area = requested_size.map(area);
            if !is_last && affordable(reference_spp) < requested_area.unwrap_or(MIN_STUDY_PIXELS) {
                continue;
            }
            // Where even the smallest size exceeds the budget, take a noisier reference, and fewer blocks than planned
            while affordable(reference_spp) < requested_area.unwrap_or(MIN_PIXELS)
                && reference_spp > MIN_REFERENCE_SPP
            {
                reference_spp /= 2;
            }
            let pixels = affordable(reference_spp).max(MIN_PIXELS);
            let view = requested_size.map_or_else(|| self.choose_view(pixels), View::Whole);
            return Ok(Layout {
                view,
                candidates,
                reference_spp: (reference_spp / REFERENCE_IMAGES).max(MIN_REFERENCE_SPP),
                stricter_spp: STRICTER_SPP,
                base_spp,
                reach,
            });
        }
        unreachable!("the last rung is taken")
    }

    /// Returns a study's layout with images of at most `factor` times the pixels, from which intervals become narrower; `None`
    /// if that would gain little, or their size is fixed.
    pub(super) fn with_larger_images(&self, layout: &Layout, factor: f64) -> Option<Layout> {
        let pixels = area(self.size_of(layout.view));
        let view = self.choose_view(factor * pixels);
        let is_larger = area(self.size_of(view)) >= MIN_GROWTH * pixels;
        (is_larger && self.experiment.size.is_none()).then(|| Layout {
            view,
            candidates: layout.candidates.clone(),
            reach: layout.reach.clone(),
            ..*layout
        })
    }

    /// Returns a study's layout with the samples of a later rung of the ladder: the first at which errors of random samples
    /// have at least `factor` times the square. Returns `None` if there is none.
    pub(super) fn with_fewer_samples(&self, plan: &Plan, layout: &Layout, factor: f64) -> Option<Layout> {
        let rung = [layout.base_spp, layout.reach.samples];
        let place = LADDER.iter().position(|known| *known == rung)?;
        let reaches = |[_, most]: &&[u32; 2]| f64::from(rung[1]) >= factor * f64::from(*most);
        let [base_spp, most] = *LADDER[place + 1..].iter().find(reaches)?;
        let reach = LevelRange::of(most);
        Some(Layout {
            candidates: candidates(self.experiment, plan, base_spp, &reach),
            base_spp,
            reach,
            ..*layout
        })
    }

    /// Returns the layout for a target: samples by what the target needs, and as many patches of the image as the
    /// budget allows.
    fn plan_search(
        &self,
        plan: &Plan,
        target: Target,
        pilot: &Pilot,
        checks: usize,
    ) -> Result<Layout, CostError> {
        // Estimate the samples that the target needs, and the error it allows
        let needed = match target {
            Target::Error(most) => pilot.variance / (most * most),
            Target::Seconds(most) => most / (pilot.unit * area(self.whole_size())),
        };
        let error = match target {
            Target::Error(most) => most,
            Target::Seconds(_) => (pilot.variance / needed).sqrt(),
        };
        let needed = needed.clamp(1.0, f64::from(ADAPTIVE_SAMPLES));
        // Effects of knobs other than samples must be visible above the noise.
        let base_spp = power_of_two(0.25 * needed).clamp(2, 8);
        let reach = LevelRange {
            samples: 4 * base_spp,
            adaptive_samples: ADAPTIVE_SAMPLES,
            adaptive_errors: ADAPTIVE_ERRORS
                .map(|times| (times * error).clamp(MIN_ADAPTIVE_ERROR, 1.0))
                .to_vec(),
            denoises: false,
        };
        // Measure the time of a block by a pilot
        let candidates = candidates(self.experiment, plan, base_spp, &reach);
        let affordable = PILOT_PART * self.experiment.budget / (pilot.unit * samples_of(&candidates));
        let small = self.choose_view(affordable.clamp(PILOT_PIXELS[1], PILOT_PIXELS[0]));
        let block = self.block_of(&candidates, small)?;
        // Choose the reference's samples by its allowed noise
        let aimed = NOISE_FOR_A_TARGET * error;
        // The mean of two halves needs half of the samples in each.
        let samples = (0.5 * pilot.variance / (aimed * aimed)).ceil();
        let [least, most] = REFERENCE_SPP_FOR_A_TARGET;
        let mut reference_spp = (samples as u32).clamp(least, most).next_power_of_two();
        // Choose the number of patches by the rest of the budget
        let checking = (4 * checks) as f64 * f64::from(STRICTER_SPP_FOR_A_TARGET) * pilot.unit;
        let rest =
            PLANNED_BLOCKS_FOR_A_TARGET * block + checking + PLANNED_IMAGES_OF_A_SEARCH * needed * pilot.unit;
        let left = LAID_OUT * (self.experiment.budget - self.spent());
        let affordable = |reference_spp: u32| left / (rest + f64::from(reference_spp) * pilot.halves);
        // At a quarter of the samples the noise is twice as large, which is the limit.
        for _ in 0..2 {
            if affordable(reference_spp) < MIN_WIDE_PATCH_PIXELS && reference_spp > least {
                reference_spp /= 2;
            }
        }
        Ok(Layout {
            view: self.choose_view(affordable(reference_spp).max(MIN_PATCH_PIXELS)),
            candidates,
            reference_spp,
            stricter_spp: STRICTER_SPP_FOR_A_TARGET,
            base_spp,
            reach,
        })
    }

    /// Returns the seconds per pixel of one block: an image of each candidate.
    fn block_of(&self, candidates: &[Candidate], view: View) -> Result<f64, CostError> {
        let mut seconds = 0.0;
        for candidate in candidates {
            seconds += self.render_image(&candidate.configuration, view, 0)?.1.elapsed;
            self.report_step("pilot");
        }
        Ok(seconds / area(self.size_of(view)))
    }

    /// Measures the cost and the variance of reference samples, by a few samples of each half.
    fn pilot(&self, strict: &Configuration, view: View, unit: f64) -> Result<Pilot, CostError> {
        // Render both halves
        let mut seconds = 0.0;
        let mut half = |path: HitPath, seed: u32| -> Result<LinearImage, CostError> {
            let mut configuration = strict.with_path(path);
            configuration.settings.spp = PILOT_SPP;
            let (rendering, taken) = self.render_image(&configuration, view, seed)?;
            seconds += taken.elapsed;
            Ok(rendering.image)
        };
        let [a, b] = [half(strict.path, 1)?, half(HitPath::BSP, 2)?];
        // Estimate the variance of a sample from their difference
        let halves = SplitReference {
            a: self.displayed(&a, view),
            b: self.displayed(&b, view),
        };
        let samples = f64::from(PILOT_SPP);
        Ok(Pilot {
            unit,
            halves: seconds / samples / area(self.size_of(view)),
            variance: 2.0 * samples * halves.noise_squared(),
        })
    }
}

/// Returns the sum of all candidates' samples per pixel.
fn samples_of(candidates: &[Candidate]) -> f64 {
    let samples = candidates
        .iter()
        .map(|candidate| f64::from(candidate.configuration.settings.spp));
    samples.sum()
}

/// Returns the largest power of two that is at most `number`, and at least 1.
fn power_of_two(number: f64) -> u32 {
    let whole = number.min(f64::from(u32::MAX)) as u32;
    1 << whole.max(1).ilog2()
}
