//! The settings that are chosen for an error against all others that could have been chosen, some minutes a scene.
//!
//! Every combination of parameters that may reach the error is rendered, samples rising until it does or until it takes
//! longer than what was chosen. The fastest of those that reach it and the chosen settings are then timed by turns.
//! `WHIT_SCENES=a,b` takes other scenes.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::cost::{
    Choice, Configuration, DisplayImage, Experiment, HitPath, ImageSums, Interval, Knob, LevelRange,
    SceneChange, SplitReference, Target, knobs, run as run_experiment, with_knob,
};
use whit::image::ToneMap;
use whit::measure::{Blocks, Observer, Protocol, TurnTime};
use whit::render::{Monitor, Pattern, Plan, RenderSettings, Rendering, render};
use whit::scene::{Effect, Scene};

use crate::limits::Limits;
use crate::quartiles::Quartiles;
use crate::scene_folder::{self, FiledScene};

const SCENES: &str = "mirror_room,soft_shadows,textured,whitted_1980,table_of_shapes";
const WIDTH: u32 = 320;
const TARGET: f64 = 0.01;
/// The most that the chosen settings may take, as a multiple of the least time.
const MAX_TIME: f64 = 1.5;
/// Seconds that choosing may take.
const PILOT: f64 = 60.0;
/// Samples of each half of the reference.
const REFERENCE_SPP: u32 = 512;
/// Samples at which the error that more samples do not lower is estimated.
const FLOOR_SPP: u32 = 16;
/// Images by which an error and a time are estimated.
const IMAGES: u32 = 7;
/// Settings that are measured again, the fastest of those that reach the target.
const FINALISTS: usize = 5;
/// Turns of each of the last that remain.
const BLOCKS: usize = 9;

/// Chooses settings for each scene and looks for faster ones.
pub(crate) fn run(limits: &mut Limits) {
    let names = std::env::var("WHIT_SCENES").unwrap_or_else(|_| SCENES.to_owned());
    for name in names.split(',') {
        check(&scene_folder::named(&format!("{name}.toml")), limits);
    }
}

fn check(filed: &FiledScene, limits: &mut Limits) {
    // Choose settings as users do
    let scene = &filed.scene;
    let mut base = base(filed);
    let (chosen, choice) = choose(scene, base);

    // List all settings and build what they are rendered with
    base.settings.adaptive = None;
    let plan = Plan::new(scene, &scene.cameras[0], &base.settings.effects);
    let families = all_families(scene, &plan, &base);
    let strict = [base.path, HitPath::BSP].map(|path| strict(&base, &plan, path));
    let mut changes: Vec<SceneChange> = Vec::new();
    for configuration in families.iter().flatten().chain(&strict) {
        if !changes.contains(&configuration.change) {
            changes.push(configuration.change);
        }
    }
    let scenes: Vec<Scene> = changes.iter().map(|change| changed(scene, change)).collect();
    let stage = Stage::build(&changes, &scenes, &[base.path, HitPath::BSP, chosen.path]);
    let judge = Judge::new(&stage, &strict);

    // Measure the chosen settings, look for faster ones, and time the fastest by turns
    let (rmse, seconds) = judge.measure(&chosen, IMAGES, f64::INFINITY).unwrap();
    println!("{}: chosen {:?} takes {seconds:.3} s", filed.name, chosen.words());
    let (finalists, tried_count) = judge.faster(&families, seconds);
    let contestants: Vec<Configuration> = [chosen].into_iter().chain(finalists).collect();
    let (fastest, ratio) = least_time(&stage, &contestants);

    println!(
        "{}: {} of {} settings ({tried_count} were tried) do better; the fastest is {:?}",
        filed.name,
        contestants.len() - 1,
        families.iter().map(Vec::len).sum::<usize>(),
        fastest.words()
    );
    println!(
        "{}: {ratio:.2} times the least time, {}; RMSE {:.5} ({:.5} to {:.5}), {}; predicted {:.5}, {}",
        filed.name,
        limits.at_most(ratio, MAX_TIME),
        rmse.value,
        rmse.low,
        rmse.high,
        limits.at_most(rmse.value, TARGET),
        choice.rmse.value,
        limits.judge(choice.reached, TARGET)
    );
}

/// Returns the settings of the file at the size of the measurement.
fn base(filed: &FiledScene) -> Configuration {
    Configuration {
        settings: filed.settings(WIDTH, filed.output.spp.unwrap_or(1)),
        path: match Backend::default() {
            Backend::Embree => HitPath {
                backend: Backend::Embree,
                ..HitPath::BSP
            },
            _ => HitPath::BSP,
        },
        change: SceneChange::default(),
        denoises: false,
    }
}

/// Has settings chosen that reach the target.
fn choose(scene: &Scene, base: Configuration) -> (Configuration, Choice) {
    let experiment = Experiment {
        scene: scene.validate().unwrap(),
        camera: &scene.cameras[0],
        base,
        tone: ToneMap { exposure_ev: 0.0 },
        size: None,
        target: Some(Target::Error(TARGET)),
        budget: PILOT,
        start: Instant::now(),
        threads: rayon::current_num_threads(),
        isa: None,
        denoiser: None,
        unfinished: None,
        keep: None,
    };
    let watcher = Observer {
        progress: &|_, _| {},
        cancel: &AtomicBool::new(false),
    };
    let found = run_experiment(&experiment, &watcher).unwrap();
    (found.chosen.unwrap(), found.study.choice.unwrap())
}

/// Returns every combination of all parameters that may be changed for a target, in families that differ in samples
/// alone or in adaptive sampling alone, each in the order of time.
fn all_families(scene: &Scene, plan: &Plan, base: &Configuration) -> Vec<Vec<Configuration>> {
    // Gather the values of each parameter, of which the first is the base's
    let mut by_knob: BTreeMap<Knob, Vec<Configuration>> = BTreeMap::new();
    for (knob, _, configuration) in knobs(scene, plan, base, &LevelRange::of(256)) {
        let is_offered = configuration.path == base.path && configuration.is_as_accurate_as(base);
        if is_offered && configuration != *base {
            by_knob
                .entry(knob)
                .or_insert_with(|| vec![*base])
                .push(configuration);
        }
    }
    let mut samples = by_knob.remove(&Knob::Samples).unwrap_or_default();
    samples.sort_by_key(|configuration| configuration.settings.spp);
    let adaptive = by_knob.remove(&Knob::Adaptive).unwrap_or_default();
    let adaptive: Vec<Configuration> = adaptive.into_iter().skip(1).collect();

    // Combine all but the two ways of sampling
    let mut combined = vec![*base];
    for (knob, values) in by_knob {
        let with = |before: &Configuration| -> Vec<Configuration> {
            values
                .iter()
                .map(|value| with_knob(before, knob, value))
                .collect()
        };
        combined = combined.iter().flat_map(with).collect();
    }

    // Make two families of each combination
    let sampled = |one: &Configuration| {
        let with = |samplings: &[Configuration]| -> Vec<Configuration> {
            let samplings = samplings.iter();
            samplings
                .map(|sampling| with_knob(one, Knob::Adaptive, sampling))
                .collect()
        };
        let has_end = one.settings.pattern == Pattern::Regular;
        [with(&samples), if has_end { Vec::new() } else { with(&adaptive) }]
    };
    combined.iter().flat_map(sampled).collect()
}

/// Returns the settings of a reference.
fn strict(base: &Configuration, plan: &Plan, path: HitPath) -> Configuration {
    let mut strict = base.with_path(path);
    let settings = &mut strict.settings;
    settings.spp = REFERENCE_SPP;
    settings.pattern = Pattern::Sobol;
    settings.depth *= 3;
    settings.weight_cutoff /= 8.0;
    settings.wavelengths = settings.wavelengths.max(32);
    settings.effects.removed = settings.effects.removed.with(Effect::TextureFilter);
    if plan.effects().has(Effect::Volume) {
        strict.change.step_factor = 0.5;
    }
    strict
}

fn changed(scene: &Scene, change: &SceneChange) -> Scene {
    let mut changed = scene.clone();
    change.apply(&mut changed);
    changed
}

/// A scene that is changed in some way, with what finds the hits in it.
struct Set<'s> {
    change: SceneChange,
    scene: &'s Scene,
    path: HitPath,
    accel: Box<dyn Accel + 's>,
}

/// Everything that configurations are rendered with.
struct Stage<'s>(Vec<Set<'s>>);

impl<'s> Stage<'s> {
    /// Builds every structure of every changed scene once.
    fn build(changes: &[SceneChange], scenes: &'s [Scene], paths: &[HitPath]) -> Stage<'s> {
        let mut stage = Stage(Vec::new());
        for (&change, scene) in changes.iter().zip(scenes) {
            for &path in paths {
                if stage.set(change, path).is_none() {
                    let options = AccelOptions {
                        precision: path.precision,
                        ..AccelOptions::default()
                    };
                    let accel = accel::build(scene.validate().unwrap(), path.backend, &options).unwrap();
                    stage.0.push(Set {
                        change,
                        scene,
                        path,
                        accel,
                    });
                }
            }
        }
        stage
    }

    fn set(&self, change: SceneChange, path: HitPath) -> Option<&Set<'s>> {
        let mut sets = self.0.iter();
        sets.find(|set| set.change == change && set.path == path)
    }

    /// Renders an image and returns it with its seconds; `None` if it takes longer than `limit` seconds or if nothing was
    /// built for it.
    fn image(&self, configuration: &Configuration, seed: u32, limit: f64) -> Option<(Rendering, f64)> {
        let set = self.set(configuration.change, configuration.path)?;
        let settings = RenderSettings {
            seed,
            ..configuration.settings
        };
        let start = Instant::now();
        let cancel = AtomicBool::new(false);
        let watch = |_| {
            if start.elapsed().as_secs_f64() > limit {
                cancel.store(true, Ordering::Relaxed);
            }
        };
        let monitor = Monitor {
            progress: &watch,
            cancel: &cancel,
            tiles: None,
        };
        let rendering = render(
            set.scene.validate().unwrap(),
            &set.scene.cameras[0],
            &*set.accel,
            &settings,
            &monitor,
        )
        .ok()?;
        let seconds = start.elapsed().as_secs_f64() - rendering.ready_seconds;
        Some((rendering, seconds))
    }
}

/// Estimator of the errors of configurations.
struct Judge<'a, 's> {
    stage: &'a Stage<'s>,
    reference: SplitReference,
}

impl<'a, 's> Judge<'a, 's> {
    /// Renders both halves of the reference.
    fn new(stage: &'a Stage<'s>, strict: &[Configuration; 2]) -> Judge<'a, 's> {
        let [a, b] = [0, 1].map(|half: usize| {
            let seed = 1_000_000 * (half as u32 + 1);
            displayed(&stage.image(&strict[half], seed, f64::INFINITY).unwrap().0)
        });
        Judge {
            stage,
            reference: SplitReference { a, b },
        }
    }

    /// Returns the error and the median of the seconds of some images, `None` if one takes longer than `limit` seconds.
    fn measure(&self, configuration: &Configuration, count: u32, limit: f64) -> Option<(Interval, f64)> {
        let mut images = ImageSums::new(&self.reference);
        let mut seconds = Vec::new();
        for seed in 0..count {
            let (rendering, taken) = self.stage.image(configuration, 77 + seed, limit)?;
            images.add(&self.reference, &displayed(&rendering));
            seconds.push(taken);
        }
        let rmse = images.estimate(&self.reference, 5).rmse();
        Some((rmse, Quartiles::compute(seconds).median))
    }

    /// Returns the fastest settings that reach the target in less than `seconds`, and how many settings were tried.
    fn faster(&self, families: &[Vec<Configuration>], seconds: f64) -> (Vec<Configuration>, usize) {
        let mut floors = Vec::new();
        let mut faster: Vec<(f64, Configuration)> = Vec::new();
        let mut tried_count = 0;
        for family in families {
            let Some(first) = family.first() else { continue };
            if !self.may_reach_target(first, &mut floors) {
                continue;
            }
            for one in family {
                tried_count += 1;
                // Those that follow take longer still
                let Some((rmse, taken)) = self.measure(one, 1, seconds) else {
                    break;
                };
                if rmse.value <= TARGET {
                    if taken < seconds {
                        faster.push((taken, *one));
                    }
                    break;
                }
            }
        }
        faster.sort_by(|a, b| a.0.total_cmp(&b.0));
        faster.truncate(FINALISTS);
        let reaches = |one: &Configuration| {
            let measured = self.measure(one, IMAGES, f64::INFINITY);
            measured.is_some_and(|(rmse, _)| rmse.value <= TARGET)
        };
        let finalists = faster.into_iter().map(|(_, one)| one).filter(reaches);
        (finalists.collect(), tried_count)
    }

    /// Returns whether a configuration reaches the target with enough samples; `floors` are those of which that is known.
    fn may_reach_target(&self, one: &Configuration, floors: &mut Vec<(Configuration, bool)>) -> bool {
        let mut sampled = *one;
        (sampled.settings.spp, sampled.settings.adaptive) = (FLOOR_SPP, None);
        sampled.settings.pattern = Pattern::Sobol;
        if let Some((_, reaches)) = floors.iter().find(|(known, _)| *known == sampled) {
            return *reaches;
        }
        let mut images = ImageSums::new(&self.reference);
        for seed in 0..2 {
            let (rendering, _) = self.stage.image(&sampled, 177 + seed, f64::INFINITY).unwrap();
            images.add(&self.reference, &displayed(&rendering));
        }
        let estimate = images.estimate(&self.reference, 6);
        let reaches = estimate.bias_squared.low <= TARGET * TARGET;
        floors.push((sampled, reaches));
        reaches
    }
}

fn displayed(rendering: &Rendering) -> DisplayImage {
    DisplayImage::new(&rendering.image, ToneMap { exposure_ev: 0.0 })
}

/// Times configurations by turns and returns the fastest, with the time of the first over that of the fastest.
fn least_time(stage: &Stage, contestants: &[Configuration]) -> (Configuration, f64) {
    let protocol = Protocol::of_blocks(BLOCKS, 3);
    let blocks = Blocks::measure(contestants.len(), &protocol, &|_| {}, |who, block| {
        let image = stage.image(&contestants[who], block as u32, f64::INFINITY);
        image.map(|(_, seconds)| TurnTime::of_seconds(seconds)).ok_or(())
    });
    let blocks = blocks.unwrap();
    let ratio = |who| Interval::of_median(&blocks.ratios(0, who)).value;
    let ratios = (0..contestants.len()).map(|who| (contestants[who], ratio(who)));
    ratios.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap()
}
