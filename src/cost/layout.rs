//! How large the pictures of an experiment are and of how many samples, by what small ones take.

use super::choose::Target;
use super::knob::{Reach, knobs};
use super::stage::{Stage, View};
use super::unfinished::Unfinished;
use super::{Configuration, CostError, Experiment, Halves, HitPath, Knob};
use crate::image::LinearImage;
use crate::render::{MIN_ADAPTIVE_ERROR, Plan};

/// Samples a pixel of the base and of the longest sweep, the ones that are tried first first.
const LADDER: [[u32; 2]; 5] = [[16, 32], [8, 16], [4, 16], [4, 8], [2, 8]];
/// Samples of each half of the reference for each of the longest sweep, at least: its noise is then a hundredth of the
/// sweep's even where errors fall no faster than at random.
const REFERENCE_TIMES: u32 = 50;
/// A picture of fewer pixels says little of a scene; a longer ladder is given up before.
const FEWEST_PIXELS: f64 = 12_288.0;
/// No picture is smaller than this, of its own shape and of pieces: intervals are drawn from eight of these at least.
const MIN_PIXELS: f64 = 1024.0;
const MIN_PIXELS_OF_PIECES: f64 = 2048.0;
/// Of fewer pieces than these, the interval of an error is so wide that settings for a target take twice the time: rather
/// the reference takes fewer samples.
const PIXELS_OF_MANY_PIECES: f64 = 8192.0;
/// Pixels that a pilot renders, at most and at least.
const PILOT_PIXELS: [f64; 2] = [3072.0, 192.0];
/// Samples of a pilot of the reference.
const PILOT_SPP: u32 = 4;
/// Blocks that a budget is laid out for.
pub(super) const PLANNED_BLOCKS: f64 = 8.0;
/// The same where there is a target: what single turns foretell is looked at anew when they are measured together.
const PLANNED_BLOCKS_FOR_A_TARGET: f64 = 2.0;
/// Pictures that a search for settings takes, each of about the samples that the target needs.
const PLANNED_PICTURES_OF_A_SEARCH: f64 = 8.0;
/// Part of the budget that is laid out, the pilot's included; the rest is for what was not foreseen.
const LAID_OUT: f64 = 0.85;
const PILOT_PART: f64 = 0.04;
/// Samples of the pictures that tell whether a knob at its strictest still matters.
const STRICTER_SPP: u32 = 16;
/// The same where there is a target, as they are to be small beside it alone.
const STRICTER_SPP_FOR_A_TARGET: u32 = 4;
/// What the mean of the halves may err by where there is a target, as a part of it: as errors are told without it, it
/// makes intervals wider and nothing else.
pub(super) const NOISE_FOR_A_TARGET: f64 = 0.5;
/// Samples of each half of a reference for a target.
const REFERENCE_SPP_FOR_A_TARGET: [u32; 2] = [16, 1024];
/// Samples that adaptive sampling for a target may take.
const ADAPTIVE_SAMPLES: u32 = 256;
/// Adaptive errors that are measured for a target, over it; what lies between and beyond is foretold.
const ADAPTIVE_ERRORS: [f64; 2] = [8.0, 4.0];

/// How large pictures are, and of how many samples.
pub(super) struct Layout {
    pub(super) view: View,
    pub(super) contestants: Vec<Contestant>,
    /// Samples of each half of the reference.
    pub(super) reference_spp: u32,
    /// Of the pictures that tell whether a knob at its strictest still matters.
    pub(super) stricter_spp: u32,
    /// Of the base.
    pub(super) base_spp: u32,
    /// How far the knobs of sampling are turned.
    pub(super) reach: Reach,
}

/// A configuration that is measured.
pub(super) struct Contestant {
    pub(super) knob: Option<Knob>,
    pub(super) level: String,
    pub(super) configuration: Configuration,
}

/// What samples cost, and by how much they vary.
struct Pilot {
    /// Seconds of a sample of a pixel of the base.
    unit: f64,
    /// The same of both halves of the reference together.
    halves: f64,
    /// Mean square, as displayed, by which one sample of a pixel differs from the mean of many.
    variance: f64,
}

/// All that is ever measured of an experiment, whatever its budget: what scenes and structures are made for.
pub(super) fn widest(experiment: &Experiment, plan: &Plan) -> Vec<Contestant> {
    contestants(experiment, plan, LADDER[0][0], &Reach::of(LADDER[0][1]))
}

/// The base at `base_spp` samples and everything that is held against it.
fn contestants(experiment: &Experiment, plan: &Plan, base_spp: u32, reach: &Reach) -> Vec<Contestant> {
    let mut base = experiment.base;
    base.settings.adaptive = None;
    base.settings.spp = match experiment.target {
        None => base.settings.spp.min(base_spp),
        Some(_) => base_spp,
    };
    let mut knobs = knobs(experiment.scene, plan, &base, reach);
    // What may not be chosen is not measured.
    if experiment.target.is_some() {
        knobs.retain(|(_, _, turned)| turned.is_trusted_like(&base));
    }
    for (_, _, configuration) in &mut knobs {
        if let Some(adaptive) = &mut configuration.settings.adaptive {
            adaptive.gain = f64::from(experiment.tone.exposure_ev).exp2();
        }
    }
    let base = Contestant {
        knob: None,
        level: "base".to_owned(),
        configuration: base,
    };
    let turned = knobs.into_iter().map(|(knob, level, configuration)| Contestant {
        knob: Some(knob),
        level,
        configuration,
    });
    std::iter::once(base).chain(turned).collect()
}

impl Layout {
    /// That of a study that was interrupted; `None` if its configurations, its target or its threads were others.
    pub(super) fn resumed(experiment: &Experiment, plan: &Plan, unfinished: &Unfinished) -> Option<Layout> {
        let head = &unfinished.head;
        let contestants = contestants(experiment, plan, head.base_spp, &head.reach);
        let words = contestants
            .iter()
            .map(|contestant| contestant.configuration.words());
        let is_same = words.eq(head.words.iter().cloned())
            && (head.threads, head.target) == (experiment.threads, experiment.target);
        is_same.then(|| Layout {
            view: unfinished.view(),
            contestants,
            reference_spp: head.reference_spp,
            stricter_spp: head.stricter_spp,
            base_spp: head.base_spp,
            reach: head.reach.clone(),
        })
    }
}

impl Stage<'_, '_> {
    /// Chooses how large pictures are and how many samples they have; `checks` knobs of `strict` are turned further.
    pub(super) fn lay_out(
        &self,
        plan: &Plan,
        strict: &Configuration,
        checks: usize,
    ) -> Result<Layout, CostError> {
        self.say("pilot");
        let base = &contestants(self.experiment, plan, 1, &Reach::of(1))[0].configuration;
        let small = self.view_of(PILOT_PIXELS[0]);
        // The first picture of all pays for pages and caches.
        self.picture(base, small, 0)?;
        let unit = self.picture(base, small, 0)?.1 / area(self.size_of(small));
        match self.experiment.target {
            None => self.lay_out_study(plan, strict, unit),
            Some(target) => {
                let pilot = self.pilot(strict, small, unit)?;
                self.lay_out_search(plan, target, &pilot, checks)
            }
        }
    }

    /// As large as the budget affords, of the first of the ladder with which they are large enough.
    fn lay_out_study(&self, plan: &Plan, strict: &Configuration, unit: f64) -> Result<Layout, CostError> {
        let wish = self.experiment.size;
        let budget = self.experiment.budget - self.spent();
        for (place, [base_spp, most]) in LADDER.into_iter().enumerate() {
            let reach = Reach::of(most);
            let contestants = contestants(self.experiment, plan, base_spp, &reach);
            let samples = samples_of(&contestants);
            let affordable = PILOT_PART * budget / (unit * samples);
            let pilot = self.view_of(affordable.clamp(PILOT_PIXELS[1], PILOT_PIXELS[0]));
            let is_last = place + 1 == LADDER.len();
            let reference_spp = (REFERENCE_TIMES * most).next_power_of_two();
            // Cheap enough to be told without a pilot of its own.
            let least = unit * (PLANNED_BLOCKS * samples + 2.0 * f64::from(reference_spp));
            if !is_last && LAID_OUT * budget / least < FEWEST_PIXELS && wish.is_none() {
                continue;
            }
            let block = self.block_of(&contestants, pilot)?;
            let halves = self.pilot(strict, pilot, unit)?.halves;
            let a_pixel = PLANNED_BLOCKS * block + f64::from(reference_spp) * halves;
            let pixels = LAID_OUT * (self.experiment.budget - self.spent()) / a_pixel;
            let asked = wish.map(area);
            if !is_last && pixels < asked.unwrap_or(FEWEST_PIXELS) {
                continue;
            }
            // Blocks give way to the reference where not even this is affordable.
            let view = wish.map_or_else(|| self.view_of(pixels.max(MIN_PIXELS)), View::Whole);
            return Ok(Layout {
                view,
                contestants,
                reference_spp,
                stricter_spp: STRICTER_SPP,
                base_spp,
                reach,
            });
        }
        unreachable!("the last rung is taken")
    }

    /// For a target, samples are those that it needs, and the pieces of the picture as many as can be afforded.
    fn lay_out_search(
        &self,
        plan: &Plan,
        target: Target,
        pilot: &Pilot,
        checks: usize,
    ) -> Result<Layout, CostError> {
        let needed = match target {
            Target::Error(most) => pilot.variance / (most * most),
            Target::Seconds(most) => most / (pilot.unit * area(self.whole_size())),
        };
        let error = match target {
            Target::Error(most) => most,
            Target::Seconds(_) => (pilot.variance / needed).sqrt(),
        };
        let needed = needed.clamp(1.0, f64::from(ADAPTIVE_SAMPLES));
        // What knobs other than samples do must not drown in noise.
        let base_spp = power_of_two(0.25 * needed).clamp(2, 8);
        let reach = Reach {
            samples: 4 * base_spp,
            adaptive_samples: ADAPTIVE_SAMPLES,
            adaptive_errors: ADAPTIVE_ERRORS
                .map(|times| (times * error).clamp(MIN_ADAPTIVE_ERROR, 1.0))
                .to_vec(),
        };
        let contestants = contestants(self.experiment, plan, base_spp, &reach);
        let affordable = PILOT_PART * self.experiment.budget / (pilot.unit * samples_of(&contestants));
        let small = self.view_of(affordable.clamp(PILOT_PIXELS[1], PILOT_PIXELS[0]));
        let block = self.block_of(&contestants, small)?;
        let aimed = NOISE_FOR_A_TARGET * error;
        // Two halves.
        let samples = (0.5 * pilot.variance / (aimed * aimed)).ceil();
        let [least, most] = REFERENCE_SPP_FOR_A_TARGET;
        let mut reference_spp = (samples as u32).clamp(least, most).next_power_of_two();
        let checking = (4 * checks) as f64 * f64::from(STRICTER_SPP_FOR_A_TARGET) * pilot.unit;
        let rest = PLANNED_BLOCKS_FOR_A_TARGET * block
            + checking
            + PLANNED_PICTURES_OF_A_SEARCH * needed * pilot.unit;
        let left = LAID_OUT * (self.experiment.budget - self.spent());
        let affordable = |reference_spp: u32| left / (rest + f64::from(reference_spp) * pilot.halves);
        // Of a quarter of the samples the noise is twice as large.
        for _ in 0..2 {
            if affordable(reference_spp) < PIXELS_OF_MANY_PIECES && reference_spp > least {
                reference_spp /= 2;
            }
        }
        Ok(Layout {
            view: self.view_of(affordable(reference_spp).max(MIN_PIXELS_OF_PIECES)),
            contestants,
            reference_spp,
            stricter_spp: STRICTER_SPP_FOR_A_TARGET,
            base_spp,
            reach,
        })
    }

    /// Seconds of a picture of each, over the pixels of `view`.
    fn block_of(&self, contestants: &[Contestant], view: View) -> Result<f64, CostError> {
        let mut seconds = 0.0;
        for contestant in contestants {
            seconds += self.picture(&contestant.configuration, view, 0)?.1;
            self.say("pilot");
        }
        Ok(seconds / area(self.size_of(view)))
    }

    /// What a reference costs and how it varies, by few samples of each half.
    fn pilot(&self, strict: &Configuration, view: View, unit: f64) -> Result<Pilot, CostError> {
        let mut seconds = 0.0;
        let mut half = |path: HitPath, seed: u32| -> Result<LinearImage, CostError> {
            let mut configuration = strict.through(path);
            configuration.settings.spp = PILOT_SPP;
            let (rendering, taken) = self.picture(&configuration, view, seed)?;
            seconds += taken;
            Ok(rendering.image)
        };
        let [a, b] = [half(strict.path, 1)?, half(HitPath::BSP, 2)?];
        let halves = Halves {
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

/// Samples of all of them together.
fn samples_of(contestants: &[Contestant]) -> f64 {
    let samples = contestants
        .iter()
        .map(|contestant| f64::from(contestant.configuration.settings.spp));
    samples.sum()
}

/// The greatest power of two that is not more than `number`, 1 at least.
fn power_of_two(number: f64) -> u32 {
    let whole = number.min(f64::from(u32::MAX)) as u32;
    1 << whole.max(1).ilog2()
}

/// Pixels of a picture.
pub(super) fn area([width, height]: [u32; 2]) -> f64 {
    f64::from(width) * f64::from(height)
}
