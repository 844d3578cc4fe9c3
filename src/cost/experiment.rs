//! Everything that is measured of a scene, within a budget: a pilot that sees how large a picture can be afforded, the
//! reference, and blocks of pictures.

use std::borrow::Cow;
use std::collections::HashMap;
use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::blocks::{Blocks, Protocol};
use super::{
    Check, Configuration, Curve, Displayed, Halves, HitPath, Knob, Pictures, Place, Point, Reference,
    SceneChange, Study, front, knobs, slope,
};
use crate::accel::{self, Accel, AccelError, AccelOptions, Backend, EmbreeIdentity, Precision};
use crate::image::metrics::{Metrics, Tally, Viewing};
use crate::image::{LinearImage, ToneMap};
use crate::render::{Monitor, Pattern, Plan, RenderSettings, Rendering, render};
use crate::scene::picture::MAX_DEPTH;
use crate::scene::{Camera, Effect, Scene};

/// Samples a pixel of the base and of the longest sweep, the ones that are tried first first.
const LADDER: [[u32; 2]; 5] = [[16, 32], [8, 16], [4, 16], [4, 8], [2, 8]];
/// Samples of each half of the reference for each of the longest sweep, at least: its noise is then a hundredth of the
/// sweep's even where errors fall no faster than at random.
const REFERENCE_TIMES: u32 = 50;
/// A picture of fewer pixels says little of a scene; a longer ladder is given up before.
const FEWEST_PIXELS: f64 = 12_288.0;
/// No picture is smaller than this.
const LEAST_PIXELS: f64 = 1024.0;
/// Pixels that a pilot renders, at most and at least.
const PILOT_PIXELS: [f64; 2] = [3072.0, 192.0];
/// Blocks that a budget is laid out for, that are taken at least, and at most.
const PLANNED_BLOCKS: f64 = 8.0;
const LEAST_BLOCKS: usize = 6;
const MOST_BLOCKS: usize = 40;
/// Part of the budget that is laid out, the pilot's included; the rest is for what was not foreseen.
const LAID_OUT: f64 = 0.85;
const PILOT_PART: f64 = 0.04;
/// Part of the budget after which no block begins: what comes after is small.
const MEASURED_PART: f64 = 0.94;
/// Samples of the pictures that tell whether a knob at its strictest still matters.
const STRICTER_SPP: u32 = 16;
/// What the reference may err by, as a part of the smallest squared error that is reported.
const REFERENCE_PART: f64 = 0.01;
/// What it aims at, as the smallest error is not known well before.
const AIMED_PART: f64 = 0.7 * REFERENCE_PART;
/// Blocks of pixels in which the halves of a reference may disagree.
const DISAGREEING_PART: f64 = 0.0025;
/// Seeds of the halves of the reference and of the pictures that check it; blocks count from 1.
const REFERENCE_SEEDS: [u32; 2] = [1_000_003, 1_000_033];

/// What is to be measured.
pub struct Experiment<'a> {
    /// The scene; it has passed [`Scene::validate`].
    pub scene: &'a Scene,
    /// Who sees it.
    pub camera: &'a Camera,
    /// The base, with the size that pictures have in the end.
    pub base: Configuration,
    /// How pictures are displayed.
    pub tone: ToneMap,
    /// Width and height of the pictures that are measured; else as large as the budget affords.
    pub size: Option<[u32; 2]>,
    /// Seconds for everything since `start`.
    pub budget: f64,
    /// When it began.
    pub start: Instant,
    /// Of the current pool.
    pub threads: usize,
    /// Instruction set that Embree is held to.
    pub isa: Option<String>,
}

/// How a long experiment talks to whoever waits for it.
#[derive(Clone, Copy)]
pub struct Watcher<'a> {
    /// Told what is being done and the finished fraction of everything.
    pub progress: &'a dyn Fn(&str, f64),
    /// Set by anyone to stop.
    pub cancel: &'a std::sync::atomic::AtomicBool,
}

/// Why there is no study.
#[derive(Debug, thiserror::Error)]
pub enum CostError {
    /// It was cancelled.
    #[error("interrupted")]
    Cancelled,
    /// A structure could not be built.
    #[error(transparent)]
    Accel(#[from] AccelError),
}

/// A study and its pictures.
pub struct Findings {
    /// In numbers.
    pub study: Study,
    /// The mean of the halves of the reference.
    pub reference: LinearImage,
    /// The first picture of each point.
    pub pictures: Vec<LinearImage>,
    /// The configuration of each point.
    pub configurations: Vec<Configuration>,
    /// Which Embree found the hits of the base, if one did.
    pub embree: Option<EmbreeIdentity>,
}

/// A structure that finds hits, and what it took to build.
struct Built<'s> {
    accel: Box<dyn Accel + 's>,
    seconds: f64,
}

/// A configuration that is measured.
struct Contestant {
    knob: Option<Knob>,
    level: String,
    configuration: Configuration,
}

/// Measures everything, in the current rayon pool.
///
/// # Errors
///
/// Where a structure cannot be built, and where it is cancelled.
pub fn run(experiment: &Experiment, watcher: &Watcher) -> Result<Findings, CostError> {
    let plan = Plan::new(
        experiment.scene,
        experiment.camera,
        &experiment.base.settings.effects,
    );
    let strict = strictest(&experiment.base, &plan);
    // Those of all ladders have the same scenes and paths.
    let longest = contestants(experiment, &plan, LADDER[0]);
    let stricter = stricter(&strict, &plan);
    let all = || {
        let measured = longest.iter().map(|contestant| contestant.configuration);
        measured
            .chain([strict])
            .chain(stricter.iter().map(|(_, configuration)| *configuration))
    };
    let scenes: Vec<(SceneChange, Cow<Scene>)> = distinct(all().map(|configuration| configuration.change))
        .into_iter()
        .map(|change| (change, scene_of(experiment.scene, &change)))
        .collect();
    let mut stage = Stage {
        experiment,
        watcher,
        scenes: &scenes,
        built: HashMap::new(),
    };
    for configuration in all().chain([on(strict, HitPath::BSP)]) {
        stage.build(&configuration)?;
    }
    let layout = stage.lay_out(&plan, &strict)?;
    let mut reference = stage.reference(&layout, &strict)?;
    stage.refine(&layout, &strict, &mut reference)?;
    let mut left = Vec::new();
    for (knob, configuration) in &stricter {
        left.push((*knob, stage.left_by(&layout, &strict, configuration)?));
    }
    let measured = stage.measure(&layout, &reference)?;
    Ok(stage.findings(&layout, &strict, &reference, &left, measured))
}

fn scene_of<'s>(scene: &'s Scene, change: &SceneChange) -> Cow<'s, Scene> {
    if *change == SceneChange::default() {
        Cow::Borrowed(scene)
    } else {
        let mut changed = scene.clone();
        change.apply(&mut changed);
        Cow::Owned(changed)
    }
}

fn distinct(changes: impl Iterator<Item = SceneChange>) -> Vec<SceneChange> {
    let mut all: Vec<SceneChange> = Vec::new();
    for change in changes {
        if !all.contains(&change) {
            all.push(change);
        }
    }
    all
}

fn on(configuration: Configuration, path: HitPath) -> Configuration {
    Configuration {
        path,
        ..configuration
    }
}

/// The base at `base_spp` samples and everything that is held against it.
fn contestants(experiment: &Experiment, plan: &Plan, [base_spp, most]: [u32; 2]) -> Vec<Contestant> {
    let mut base = experiment.base;
    base.settings.adaptive = None;
    base.settings.spp = base.settings.spp.min(base_spp);
    let knobs = knobs(experiment.scene, plan, &base, most);
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

/// All knobs at their strictest that are not a matter of noise alone.
fn strictest(base: &Configuration, plan: &Plan) -> Configuration {
    let settings = base.settings;
    let mut effects = settings.effects;
    if plan.effects().has(Effect::TextureFilter) {
        // Many samples show textures as they are.
        effects.removed = effects.removed.with(Effect::TextureFilter);
    }
    let watertight = Precision::Watertight;
    Configuration {
        settings: RenderSettings {
            pattern: Pattern::Sobol,
            adaptive: None,
            depth: (3 * settings.depth).min(MAX_DEPTH / 2),
            weight_cutoff: (settings.weight_cutoff / 8.0).min(1.0 / 4096.0),
            wavelengths: settings.wavelengths.max(32),
            effects,
            ..settings
        },
        path: match base.path.backend {
            Backend::Embree => HitPath {
                precision: watertight,
                ..base.path
            },
            _ => HitPath::BSP,
        },
        change: SceneChange {
            step_factor: 0.5 * base.change.step_factor.min(1.0),
            ..base.change
        }
        .of(plan),
    }
}

/// Each knob that leaves a bias, stricter still.
fn stricter(strict: &Configuration, plan: &Plan) -> Vec<(Knob, Configuration)> {
    let has = |effect| plan.effects().has(effect);
    let set = |change: fn(&mut Configuration)| {
        let mut configuration = *strict;
        change(&mut configuration);
        configuration
    };
    let mut all = Vec::new();
    if has(Effect::Reflection) || has(Effect::Refraction) {
        all.push((Knob::Depth, set(|c| c.settings.depth *= 2)));
        all.push((Knob::Cutoff, set(|c| c.settings.weight_cutoff /= 8.0)));
    }
    if has(Effect::Dispersion) {
        all.push((Knob::Wavelengths, set(|c| c.settings.wavelengths *= 2)));
    }
    if has(Effect::Volume) {
        all.push((Knob::MarchStep, set(|c| c.change.step_factor *= 0.5)));
    }
    all
}

impl SceneChange {
    /// Without what the plan has no use for.
    fn of(self, plan: &Plan) -> SceneChange {
        SceneChange {
            step_factor: if plan.effects().has(Effect::Volume) {
                self.step_factor
            } else {
                1.0
            },
            ..self
        }
    }
}

/// Where pictures are taken.
struct Stage<'a, 's> {
    experiment: &'a Experiment<'a>,
    watcher: &'a Watcher<'a>,
    scenes: &'s [(SceneChange, Cow<'a, Scene>)],
    /// By scene and path.
    built: HashMap<(usize, HitPath), Built<'s>>,
}

/// How large pictures are, and of how many samples.
struct Layout {
    size: [u32; 2],
    contestants: Vec<Contestant>,
    /// Samples of each half of the reference.
    reference_spp: u32,
}

/// The reference.
struct Halved {
    /// Pictures of each half, all of one number of samples.
    count: u32,
    /// Their means.
    means: [LinearImage; 2],
    /// As displayed.
    halves: Halves,
    /// Seconds of a picture of each half.
    seconds: f64,
}

impl Halved {
    /// The mean of both halves.
    fn mean(&self) -> LinearImage {
        let mut mean = self.means[0].clone();
        blend(&mut mean, &self.means[1], 0.5);
        mean
    }
}

/// Moves `image` to `other` by so much of the way.
fn blend(image: &mut LinearImage, other: &LinearImage, part: f32) {
    for (pixel, other) in image.pixels.iter_mut().zip(&other.pixels) {
        for (channel, other) in pixel.iter_mut().zip(other) {
            *channel += part * (other - *channel);
        }
    }
}

/// What the blocks gave.
struct Measured {
    blocks: Blocks,
    errors: Vec<Pictures>,
    /// The first picture of each contestant.
    first: Vec<Option<Rendering>>,
}

impl Stage<'_, '_> {
    fn spent(&self) -> f64 {
        self.experiment.start.elapsed().as_secs_f64()
    }

    fn say(&self, what: &str) {
        (self.watcher.progress)(what, (self.spent() / self.experiment.budget).min(1.0));
    }

    fn scene_index(&self, change: &SceneChange) -> usize {
        let place = self.scenes.iter().position(|(known, _)| known == change);
        place.expect("scenes were made for all configurations")
    }

    fn build(&mut self, configuration: &Configuration) -> Result<(), CostError> {
        let scene = self.scene_index(&configuration.change);
        let path = configuration.path;
        if self.built.contains_key(&(scene, path)) {
            return Ok(());
        }
        self.say("build");
        let options = AccelOptions {
            precision: path.precision,
            instancing: path.instancing,
            threads: self.experiment.threads,
            isa: self.experiment.isa.clone(),
            ..AccelOptions::default()
        };
        let start = Instant::now();
        let accel = accel::build(&self.scenes[scene].1, path.backend, &options)?;
        let seconds = start.elapsed().as_secs_f64();
        self.built.insert((scene, path), Built { accel, seconds });
        Ok(())
    }

    fn built(&self, configuration: &Configuration) -> &Built<'_> {
        &self.built[&(self.scene_index(&configuration.change), configuration.path)]
    }

    /// A picture, and the seconds that its samples took.
    fn picture(
        &self,
        configuration: &Configuration,
        [width, height]: [u32; 2],
        seed: u32,
    ) -> Result<(Rendering, f64), CostError> {
        let settings = RenderSettings {
            width,
            height,
            seed,
            ledger: false,
            sample_aovs: false,
            cost_aovs: false,
            ..configuration.settings
        };
        let monitor = Monitor {
            progress: &|_| {},
            cancel: self.watcher.cancel,
        };
        let scene = &self.scenes[self.scene_index(&configuration.change)].1;
        let accel = &*self.built(configuration).accel;
        let start = Instant::now();
        let rendering = render(scene, self.experiment.camera, accel, &settings, &monitor);
        let seconds = start.elapsed().as_secs_f64();
        rendering
            .map(|rendering| (rendering, seconds))
            .ok_or(CostError::Cancelled)
    }

    /// The size of the whole picture's shape with about so many pixels, not more than the picture has.
    fn size_of(&self, pixels: f64) -> [u32; 2] {
        let RenderSettings { width, height, .. } = self.experiment.base.settings;
        let scale = (pixels / (f64::from(width) * f64::from(height))).sqrt().min(1.0);
        [width, height].map(|side| ((f64::from(side) * scale).round() as u32).max(1))
    }

    /// Chooses how large pictures are and how many samples they have, by what small ones take.
    fn lay_out(&self, plan: &Plan, strict: &Configuration) -> Result<Layout, CostError> {
        self.say("pilot");
        let budget = self.experiment.budget - self.spent();
        let base = &contestants(self.experiment, plan, [1, 1])[0].configuration;
        let small = self.size_of(PILOT_PIXELS[0]);
        // The first picture of all pays for pages and caches.
        self.picture(base, small, 0)?;
        let unit = self.picture(base, small, 0)?.1 / area(small);
        for (place, rung) in LADDER.into_iter().enumerate() {
            let contestants = contestants(self.experiment, plan, rung);
            let samples: f64 = contestants
                .iter()
                .map(|c| f64::from(c.configuration.settings.spp))
                .sum();
            let affordable = PILOT_PART * budget / (unit * samples);
            let pilot_size = self.size_of(affordable.clamp(PILOT_PIXELS[1], PILOT_PIXELS[0]));
            let is_last = place + 1 == LADDER.len();
            let reference_spp = (REFERENCE_TIMES * rung[1]).next_power_of_two();
            // Cheap enough to be told without a pilot of its own.
            let least = unit * (PLANNED_BLOCKS * samples + 2.0 * f64::from(reference_spp));
            if !is_last && LAID_OUT * budget / least < FEWEST_PIXELS && self.experiment.size.is_none() {
                continue;
            }
            let mut block = 0.0;
            for contestant in &contestants {
                block += self.picture(&contestant.configuration, pilot_size, 0)?.1;
                self.say("pilot");
            }
            let mut halves = 0.0;
            for path in [strict.path, HitPath::BSP] {
                let mut configuration = on(*strict, path);
                configuration.settings.spp = 4;
                halves += self.picture(&configuration, pilot_size, 0)?.1 / 4.0;
            }
            let a_pixel = (PLANNED_BLOCKS * block + f64::from(reference_spp) * halves) / area(pilot_size);
            let pixels = LAID_OUT * (self.experiment.budget - self.spent()) / a_pixel;
            let asked = self.experiment.size.map(area);
            if !is_last && pixels < asked.unwrap_or(FEWEST_PIXELS) {
                continue;
            }
            // Blocks give way to the reference where not even this is affordable.
            let size = self
                .experiment
                .size
                .unwrap_or_else(|| self.size_of(pixels.max(LEAST_PIXELS)));
            return Ok(Layout {
                size,
                contestants,
                reference_spp,
            });
        }
        unreachable!("the last rung is taken")
    }

    /// Both halves, each through a path of its own.
    fn reference(&self, layout: &Layout, strict: &Configuration) -> Result<Halved, CostError> {
        let start = Instant::now();
        let [a, b] = self.pair(layout, strict, 0)?;
        let tone = self.experiment.tone;
        Ok(Halved {
            count: 1,
            halves: Halves {
                a: Displayed::new(&a, tone),
                b: Displayed::new(&b, tone),
            },
            means: [a, b],
            seconds: start.elapsed().as_secs_f64(),
        })
    }

    /// A picture for each half, the ones that `before` others came before.
    fn pair(
        &self,
        layout: &Layout,
        strict: &Configuration,
        before: u32,
    ) -> Result<[LinearImage; 2], CostError> {
        let half = |path, seed: u32| {
            self.say("reference");
            let mut configuration = on(*strict, path);
            configuration.settings.spp = layout.reference_spp;
            let rendering = self.picture(&configuration, layout.size, seed + 2 * before)?.0;
            Ok::<_, CostError>(rendering.image)
        };
        Ok([
            half(strict.path, REFERENCE_SEEDS[0])?,
            half(HitPath::BSP, REFERENCE_SEEDS[1])?,
        ])
    }

    /// Adds pictures to the reference until its noise is small beside every error, or no time is left for more.
    fn refine(
        &self,
        layout: &Layout,
        strict: &Configuration,
        reference: &mut Halved,
    ) -> Result<(), CostError> {
        let start = Instant::now();
        let mut least = f64::INFINITY;
        for contestant in &layout.contestants {
            self.say("reference");
            let picture = self.picture(&contestant.configuration, layout.size, 0)?.0.image;
            let mut pictures = Pictures::new(&reference.halves);
            pictures.add(&reference.halves, &Displayed::new(&picture, self.experiment.tone));
            let square = pictures.mean_square();
            least = if square > 0.0 { least.min(square) } else { least };
        }
        let blocks = PLANNED_BLOCKS * start.elapsed().as_secs_f64();
        while reference.halves.noise_squared() > AIMED_PART * least
            && self.spent() + reference.seconds + blocks < MEASURED_PART * self.experiment.budget
        {
            let more = self.pair(layout, strict, reference.count)?;
            reference.count += 1;
            for (mean, more) in reference.means.iter_mut().zip(&more) {
                blend(mean, more, 1.0 / reference.count as f32);
            }
            let [a, b] = &reference.means;
            reference.halves = Halves {
                a: Displayed::new(a, self.experiment.tone),
                b: Displayed::new(b, self.experiment.tone),
            };
        }
        Ok(())
    }

    /// Blocks until the time is up.
    fn measure(&self, layout: &Layout, reference: &Halved) -> Result<Measured, CostError> {
        let count = layout.contestants.len();
        let mut errors = vec![Pictures::new(&reference.halves); count];
        let mut first: Vec<Option<Rendering>> = (0..count).map(|_| None).collect();
        let until = MEASURED_PART * self.experiment.budget;
        let protocol = Protocol {
            least: LEAST_BLOCKS,
            most: MOST_BLOCKS,
            deadline: self.experiment.start + Duration::from_secs_f64(until),
            seed: 1,
        };
        let blocks = Blocks::measure(count, &protocol, |contestant, block| {
            self.say("measure");
            let configuration = &layout.contestants[contestant].configuration;
            let (rendering, seconds) = self.picture(configuration, layout.size, block as u32 + 1)?;
            errors[contestant].add(
                &reference.halves,
                &Displayed::new(&rendering.image, self.experiment.tone),
            );
            first[contestant].get_or_insert(rendering);
            Ok::<f64, CostError>(seconds)
        })?;
        Ok(Measured {
            blocks,
            errors,
            first,
        })
    }

    /// What it all comes to; `left` is by how much knobs at their strictest still move the reference.
    fn findings(
        &self,
        layout: &Layout,
        strict: &Configuration,
        reference: &Halved,
        left: &[(Knob, f64)],
        measured: Measured,
    ) -> Findings {
        self.say("analyse");
        let mean = reference.mean();
        let pictures: Vec<Rendering> = measured.first.into_iter().flatten().collect();
        let viewing = Viewing {
            tone: self.experiment.tone,
            ..Viewing::default()
        };
        let metrics: Vec<Metrics> = pictures
            .par_iter()
            .map(|picture| {
                let mut tally = Tally::default();
                // Sizes are equal.
                let _ = tally.add(&mean, &picture.image, &viewing);
                tally.metrics()
            })
            .collect();
        let mut points: Vec<Point> = layout
            .contestants
            .iter()
            .enumerate()
            .map(|(place, contestant)| {
                let error = measured.errors[place].estimate(&reference.halves, place as u64);
                Point {
                    knob: contestant.knob,
                    level: contestant.level.clone(),
                    settings: contestant.configuration.words(),
                    build_seconds: self.built(&contestant.configuration).seconds,
                    ready_seconds: pictures[place].ready_seconds,
                    seconds: measured.blocks.seconds(place),
                    time_ratio: measured.blocks.ratio(place, 0),
                    rmse: error.rmse(),
                    bias_squared: error.bias_squared,
                    variance: error.variance(),
                    rel_mse: metrics[place].rel_mse,
                    flip: metrics[place].flip,
                    max: metrics[place].displayed.max,
                    changed_share: metrics[place].changed_share,
                    non_finite: pictures[place].image.non_finite_count() as u64,
                    rays: pictures[place].ledger.total().rays,
                    on_front: false,
                }
            })
            .collect();
        let places: Vec<Place> = points
            .iter()
            .map(|point| Place {
                time: point.time_ratio,
                error: point.rmse,
            })
            .collect();
        for (point, on_front) in points.iter_mut().zip(front(&places)) {
            point.on_front = on_front;
        }
        let checks = checks(strict, reference, &points, left);
        let study = Study {
            size: layout.size,
            threads: self.experiment.threads,
            reference: Reference {
                spp: layout.reference_spp * reference.count,
                paths: [strict.path.name(), HitPath::BSP.name()],
                noise: reference.halves.noise_squared().sqrt(),
                checks,
            },
            timing: measured.blocks.timing(self.spent(), self.experiment.budget),
            curves: curves(&points),
            points,
        };
        Findings {
            study,
            reference: mean,
            embree: self
                .built(&layout.contestants[0].configuration)
                .accel
                .report()
                .embree,
            pictures: pictures.into_iter().map(|rendering| rendering.image).collect(),
            configurations: layout
                .contestants
                .iter()
                .map(|contestant| contestant.configuration)
                .collect(),
        }
    }

    /// By how much `strict` differs from what is stricter in the mean, noise not counted: the mean product of the
    /// differences of two pairs, each pair of one seed.
    fn left_by(
        &self,
        layout: &Layout,
        strict: &Configuration,
        stricter: &Configuration,
    ) -> Result<f64, CostError> {
        self.say("check");
        let mut differences = Vec::new();
        for seed in REFERENCE_SEEDS {
            let mut pair = Vec::new();
            for configuration in [strict, stricter] {
                let mut configuration = *configuration;
                configuration.settings.spp = STRICTER_SPP;
                let picture = self.picture(&configuration, layout.size, seed)?.0.image;
                pair.push(Displayed::new(&picture, self.experiment.tone));
            }
            differences.push(pair[0].minus(&pair[1]));
        }
        let products = differences[0].iter().zip(&differences[1]).map(|(a, b)| a * b);
        Ok((products.sum::<f64>() / differences[0].len() as f64)
            .max(0.0)
            .sqrt())
    }
}

/// What is asked of a reference before errors against it are believed.
fn checks(strict: &Configuration, reference: &Halved, points: &[Point], left: &[(Knob, f64)]) -> Vec<Check> {
    let known = points
        .iter()
        .map(|point| point.rmse.value)
        .filter(|&rmse| rmse > 0.0);
    let least = known.fold(f64::INFINITY, f64::min);
    let bound = REFERENCE_PART.sqrt() * least;
    let noise = reference.halves.noise_squared().sqrt();
    let mut checks = vec![Check {
        name: "noise".to_owned(),
        holds: noise <= bound,
        words: format!("errs by {noise:.2e}; {bound:.2e} is a tenth of the smallest error"),
    }];
    let disagreeing = reference.halves.disagreeing_share();
    checks.push(Check {
            name: "two paths".to_owned(),
            holds: disagreeing <= DISAGREEING_PART,
            words: format!(
                "halves through {} and {} differ by more than noise in {:.2} % of the blocks of pixels; {:.2} % may",
                strict.path.name(),
                HitPath::BSP.name(),
                100.0 * disagreeing,
                100.0 * DISAGREEING_PART
            ),
        });
    let means = reference.means.iter();
    let non_finite: usize = means.map(LinearImage::non_finite_count).sum();
    checks.push(Check {
        name: "numbers".to_owned(),
        holds: non_finite == 0,
        words: format!("{non_finite} pixels are no numbers"),
    });
    for (knob, left) in left {
        checks.push(Check {
            name: knob.name().to_owned(),
            holds: *left <= bound,
            words: format!("stricter, it moves the picture by {left:.2e}; {bound:.2e} may be"),
        });
    }
    checks
}

fn area([width, height]: [u32; 2]) -> f64 {
    f64::from(width) * f64::from(height)
}

/// Every knob whose places lie in an order, the base among them, by time.
fn curves(points: &[Point]) -> Vec<Curve> {
    let graded = Knob::ALL.into_iter().filter(|knob| knob.is_graded());
    graded
        .filter_map(|knob| {
            // Samples that differ from pixel to pixel are no further step of equally many.
            let from_base = knob != Knob::Adaptive;
            let of_knob = |&place: &usize| place == 0 && from_base || points[place].knob == Some(knob);
            let mut places: Vec<usize> = (0..points.len()).filter(of_knob).collect();
            if places.len() < 2 {
                return None;
            }
            places.sort_by(|&a, &b| points[a].seconds.value.total_cmp(&points[b].seconds.value));
            Some(Curve {
                knob,
                slope: slope(&falling(points, &places)),
                points: places,
            })
        })
        .collect()
}

/// Seconds and errors of those of `places`, which are in the order of time, up to the first that is as close as any: what
/// comes after it takes longer for nothing.
fn falling(points: &[Point], places: &[usize]) -> Vec<(f64, f64)> {
    let least = places
        .iter()
        .map(|&place| points[place].rmse.high)
        .fold(f64::INFINITY, f64::min);
    let first = places.iter().position(|&place| points[place].rmse.low <= least);
    let fall = &places[..first.map_or(places.len(), |first| first + 1)];
    fall.iter()
        .map(|&place| (points[place].time_ratio.value, points[place].rmse.value))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::Interval;

    fn point(knob: Option<Knob>, seconds: f64, rmse: f64) -> Point {
        let time = Interval::exact(seconds);
        Point {
            knob,
            level: String::new(),
            settings: std::collections::BTreeMap::new(),
            build_seconds: 0.0,
            ready_seconds: 0.0,
            seconds: time,
            time_ratio: time,
            rmse: Interval {
                value: rmse,
                low: 0.9 * rmse,
                high: 1.1 * rmse,
            },
            bias_squared: Interval::exact(0.0),
            variance: 0.0,
            rel_mse: 0.0,
            flip: 0.0,
            max: 0.0,
            changed_share: 0.0,
            non_finite: 0,
            rays: 0,
            on_front: false,
        }
    }

    #[test]
    fn a_slope_ends_where_the_error_does_not_fall_any_more() {
        let depth = Some(Knob::Depth);
        let points = [
            point(None, 8.0, 0.125),
            point(depth, 1.0, 1.0),
            point(depth, 2.0, 0.5),
            point(depth, 4.0, 0.25),
            point(depth, 16.0, 0.125),
            point(depth, 32.0, 0.126),
            point(Some(Knob::Pattern), 32.0, 0.01),
        ];
        let curves = curves(&points);
        let names: Vec<Knob> = curves.iter().map(|curve| curve.knob).collect();
        assert_eq!(names, [Knob::Depth], "patterns are in no order");
        assert_eq!(curves[0].points, [1, 2, 3, 0, 4, 5]);
        assert!((curves[0].slope.unwrap().value + 1.0).abs() < 1e-12);
    }
}
