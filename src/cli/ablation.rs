//! Costs of effects for `whit info --prices`: a few tiles are rendered as planned, without each effect, and with less
//! depth.
//!
//! All variants are rendered in turn within each run, in alternating order, and compared with the planned image of the
//! same run, so that other load on the machine affects all alike. Times are processor times where the system provides
//! them. The planned image takes part twice: the difference of its two times is the noise.

use std::time::Instant;

use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::image::ToneMap;
use whit::image::metrics::{Tally, Viewing};
use whit::parallel;
use whit::render::{Monitor, Plan, RenderSettings, TileSample, render_sample, tile_count};
use whit::report::ablation::{Ablation, AblationStudy, MIN_RUNS, TimeChange};
use whit::report::bench::Spread;
use whit::scene::{Camera, Effect, Scene};
use whit::scene_file::{Output, SceneFile};

use super::args::InfoArgs;
use super::failure::Failure;
use super::interrupt;
use super::job::{self, Tracing, choose_camera};
use super::progress::{Progress, Verbosity};

/// Largest part of the image that is rendered: enough tiles to represent all of it, few enough to be quick.
const MAX_SAMPLED: f64 = 0.05;
/// Smallest number of tiles, for small images and small budgets.
const MIN_TILES: usize = 8;
/// Largest number of runs; more would only resolve differences of time that are irrelevant.
const MAX_RUNS: usize = 25;
/// Largest number of depths that are tried: radiance after so many reflections is small almost everywhere.
const MAX_STEPS: u32 = 16;

/// Returns the image settings of the arguments, completed by those of the scene.
fn image_settings(args: &InfoArgs, output: &Output) -> Output {
    let requested = Output {
        size: args.ablation.size.map(|size| [size.width, size.height]),
        spp: args.ablation.spp,
        depth: args.ablation.depth,
        ..Output::default()
    };
    requested.or(output)
}

/// Returns the render settings for the arguments and the image settings of the scene.
pub(super) fn settings_of(args: &InfoArgs, output: &Output) -> Result<RenderSettings, Failure> {
    Ok(RenderSettings {
        effects: args.effects.unwrap_or_default(),
        ..job::settings(&image_settings(args, output))?
    })
}

/// Checked parameters of a measurement of costs.
pub(super) struct AblationJob<'a> {
    args: &'a InfoArgs,
    settings: RenderSettings,
    viewing: Viewing,
    backend: Backend,
    tracing: Tracing,
}

impl<'a> AblationJob<'a> {
    /// Returns the parameters for a scene whose file gives the image settings `output`.
    pub(super) fn new(args: &'a InfoArgs, output: &Output) -> Result<AblationJob<'a>, Failure> {
        let backend = args.ablation.backend.unwrap_or_default();
        let requested = image_settings(args, output);
        Ok(AblationJob {
            args,
            settings: settings_of(args, output)?,
            viewing: Viewing {
                tone: ToneMap {
                    exposure_ev: requested.exposure.unwrap_or(0.0),
                },
                ..Viewing::default()
            },
            backend,
            tracing: Tracing::of_threads(args.ablation.threads),
        })
    }

    /// Measures the costs on the requested number of threads.
    pub(super) fn run(&self, loaded: &SceneFile) -> Result<AblationStudy, Failure> {
        let progress = Progress::new(Verbosity::Normal);
        let list = parallel::install(&self.tracing.pool()?, || self.measure(loaded, &progress));
        progress.clear();
        list
    }

    fn measure(&self, loaded: &SceneFile, progress: &Progress) -> Result<AblationStudy, Failure> {
        let name = self.args.scene.display().to_string();
        let scene = &loaded.scene;
        let camera = choose_camera(scene, &self.args.scene, None)?;
        // Build the acceleration structure
        progress.phase(&name, "build");
        let options = AccelOptions {
            threads: self.tracing.threads,
            progress: Some(&|fraction| progress.fraction(fraction)),
            ..AccelOptions::default()
        };
        let accel = accel::build(scene, self.backend, &options)?;
        interrupt::check()?;
        // Render a first sample to determine how many tiles the budget allows
        progress.phase(&name, "sample");
        let mut measurement_scene = MeasurementScene {
            scene,
            camera,
            accel: &*accel,
            tiles: MIN_TILES,
        };
        let budget = self.args.ablation.budget;
        measurement_scene.tiles = self.affordable_tiles(&measurement_scene, budget)?;
        // Render each variant once to compare its image with the planned one
        let start = Instant::now();
        let (variants, depth_reached) = self.variants(&measurement_scene, progress)?;
        // Time the variants with the rest of the budget
        progress.phase(&name, "time");
        let left = budget - start.elapsed().as_secs_f64();
        let times = Times::measure(&measurement_scene, &variants, left, progress)?;
        Ok(self.list(&measurement_scene, &variants, &times, depth_reached))
    }

    /// Returns the number of tiles with which the smallest number of runs fits into the budget.
    fn affordable_tiles(&self, measurement_scene: &MeasurementScene, budget: f64) -> Result<usize, Failure> {
        let start = Instant::now();
        let pilot = measurement_scene.render(&self.settings)?;
        let per_tile = start.elapsed().as_secs_f64() / pilot.tiles.len().max(1) as f64;
        let changes = pilot.plan.effects().iter().count() + self.settings.depth.min(MAX_STEPS) as usize;
        // The planned image takes part twice, and there is one run for the images.
        let renders = (changes + 2) * (MIN_RUNS + 1);
        let (width, height) = (self.settings.width, self.settings.height);
        let most = (MAX_SAMPLED * tile_count(width, height) as f64).round() as usize;
        let affordable = budget / (per_tile * renders as f64);
        Ok((affordable as usize).min(most).max(MIN_TILES))
    }

    /// Returns all variants, the planned one first, and the depth from which on no ray is left, if it is known.
    fn variants(
        &self,
        measurement_scene: &MeasurementScene,
        progress: &Progress,
    ) -> Result<(Vec<Variant>, Option<u32>), Failure> {
        let planned = Variant::new(self.settings, Change::None, measurement_scene)?;
        let effects: Vec<Effect> = planned.sample.plan.effects().iter().collect();
        let steps = self.settings.depth.min(MAX_STEPS);
        let whole = (effects.len() + steps as usize) as f64;
        let mut variants = vec![planned];
        // Leave out each effect
        for &effect in &effects {
            let mut settings = self.settings;
            settings.effects.added = settings.effects.added.without(effect);
            settings.effects.removed = settings.effects.removed.with(effect);
            variants.push(Variant::new(
                settings,
                Change::Without(effect),
                measurement_scene,
            )?);
            progress.fraction(variants.len() as f64 / whole);
        }
        // Limit the depth, up to the depth at which no ray is cut off
        for depth in 0..steps {
            let settings = RenderSettings {
                depth,
                ..self.settings
            };
            let shallow = Variant::new(settings, Change::Depth(depth), measurement_scene)?;
            if shallow.traced_rays() == variants[0].traced_rays() {
                return Ok((variants, Some(depth)));
            }
            variants.push(shallow);
            progress.fraction(variants.len() as f64 / whole);
        }
        Ok((variants, None))
    }

    fn list(
        &self,
        measurement_scene: &MeasurementScene,
        variants: &[Variant],
        times: &Times,
        depth_reached: Option<u32>,
    ) -> AblationStudy {
        let (width, height) = (self.settings.width, self.settings.height);
        let planned = &variants[0];
        // The noise is the difference between the two measurements of the planned image
        let control = TimeChange::of(&times.changes(Times::CONTROL), 0.0);
        // Compute the time per pixel of the planned image
        let pixels: usize = planned
            .sample
            .tiles
            .iter()
            .map(|tile| tile.image.pixels.len())
            .sum();
        let per_pixel = Spread::of(&times.seconds[0]).median / pixels.max(1) as f64;
        // Compute the cost of each variant from its times and from its difference to the planned image
        let cost = |(index, variant): (usize, &Variant)| Ablation {
            without: match variant.change {
                Change::Without(effect) => Some(effect),
                _ => None,
            },
            depth: match variant.change {
                Change::Depth(depth) => Some(depth),
                _ => None,
            },
            takes_along: variant.takes_along(&planned.sample.plan),
            time: TimeChange::of(&times.changes(index), control.noise),
            ..variant.compare_images(planned, &self.viewing)
        };
        // Extrapolate from the tiles to the whole image
        let mut list = AblationStudy {
            width,
            height,
            spp: self.settings.spp,
            depth: self.settings.depth,
            depth_reached,
            camera: measurement_scene.camera.name.clone(),
            backend: self.backend,
            threads: self.tracing.threads,
            tiles: planned.sample.tiles.len(),
            tiles_in_all: tile_count(width, height),
            runs: times.seconds[0].len(),
            seconds_forecast: per_pixel * f64::from(width) * f64::from(height) / self.tracing.threads as f64,
            noise: control.noise,
            list: variants.iter().enumerate().skip(1).map(cost).collect(),
        };
        // Order the costs for the report
        list.sort();
        list
    }
}

/// Scene, camera and acceleration structure of all variants.
struct MeasurementScene<'a> {
    scene: &'a Scene,
    camera: &'a Camera,
    accel: &'a dyn Accel,
    /// Number of tiles rendered of each variant.
    tiles: usize,
}

impl MeasurementScene<'_> {
    fn render(&self, settings: &RenderSettings) -> Result<TileSample, Failure> {
        let monitor = Monitor {
            cancel: &interrupt::CANCELLED,
            ..Monitor::default()
        };
        Ok(render_sample(
            (self.scene, self.camera),
            self.accel,
            settings,
            self.tiles,
            &monitor,
        )?)
    }
}

/// Difference of a variant from the planned settings.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    None,
    Without(Effect),
    Depth(u32),
}

/// Variant that takes part in the measurement, with its rendered tiles.
struct Variant {
    settings: RenderSettings,
    change: Change,
    sample: TileSample,
}

impl Variant {
    fn new(
        settings: RenderSettings,
        change: Change,
        measurement_scene: &MeasurementScene,
    ) -> Result<Variant, Failure> {
        Ok(Variant {
            sample: measurement_scene.render(&settings)?,
            settings,
            change,
        })
    }

    fn traced_rays(&self) -> u64 {
        let ledger = &self.sample.ledger;
        ledger.reflection_rays() + ledger.refraction_rays()
    }

    /// Returns the planned effects that are off in this variant besides the one that was left out.
    fn takes_along(&self, planned: &Plan) -> Vec<Effect> {
        let gone = planned.effects().minus(self.sample.plan.effects());
        gone.iter()
            .filter(|&effect| self.change != Change::Without(effect))
            .collect()
    }

    /// Returns the cost with only the image difference from the planned variant filled in.
    fn compare_images(&self, planned: &Variant, viewing: &Viewing) -> Ablation {
        let mut tally = Tally::default();
        let mut changes_picture = false;
        for (reference, test) in planned.sample.tiles.iter().zip(&self.sample.tiles) {
            changes_picture |= reference.image != test.image;
            let sizes_match = tally.add(&reference.image, &test.image, viewing).is_ok();
            debug_assert!(sizes_match, "both are samples of the same image");
        }
        Ablation {
            without: None,
            takes_along: Vec::new(),
            depth: None,
            time: TimeChange::of(&[], 0.0),
            changes_picture,
            picture: tally.metrics(),
        }
    }
}

/// Seconds of each variant in each run, with those of the planned image a second time.
struct Times {
    /// Seconds by variant, the control last, then by run.
    seconds: Vec<Vec<f64>>,
}

impl Times {
    /// Index of the second measurement of the planned image, the control.
    const CONTROL: usize = usize::MAX;

    /// Renders all variants in turn, at least `MIN_RUNS` times and as often as `budget` seconds allow.
    fn measure(
        measurement_scene: &MeasurementScene,
        variants: &[Variant],
        budget: f64,
        progress: &Progress,
    ) -> Result<Times, Failure> {
        let start = Instant::now();
        let mut seconds = vec![Vec::new(); variants.len() + 1];
        let mut order: Vec<usize> = (0..seconds.len()).collect();
        for run in 0..MAX_RUNS {
            for (done, &index) in order.iter().enumerate() {
                let variant = variants.get(index).unwrap_or(&variants[0]);
                seconds[index].push(measurement_scene.render(&variant.settings)?.seconds());
                let runs = run as f64 + (done + 1) as f64 / order.len() as f64;
                let by_budget = start.elapsed().as_secs_f64() / budget.max(f64::MIN_POSITIVE);
                progress.fraction((runs / MIN_RUNS as f64).min(by_budget.max(runs / MAX_RUNS as f64)));
            }
            // Alternate the order, so that a drift of the clock rate cancels
            order.reverse();
            let passed = start.elapsed().as_secs_f64();
            // Stop if another run would exceed the budget
            let next_end = passed * (run + 2) as f64 / (run + 1) as f64;
            if run + 1 >= MIN_RUNS && next_end > budget {
                break;
            }
        }
        Ok(Times { seconds })
    }

    /// Returns the relative change of a variant's time in each run. The reference is the mean of the two planned
    /// images; for the control it is the other planned image.
    fn changes(&self, variant: usize) -> Vec<f64> {
        let control = self.seconds.len() - 1;
        let runs = self.seconds[0].iter().zip(&self.seconds[control]).enumerate();
        runs.map(|(run, (planned, again))| match variant {
            Times::CONTROL => again / planned - 1.0,
            variant => self.seconds[variant][run] / (0.5 * (planned + again)) - 1.0,
        })
        .collect()
    }
}
