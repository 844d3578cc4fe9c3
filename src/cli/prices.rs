//! `whit info --prices`: a few tiles of the picture rendered as planned, without each effect and with less depth.
//!
//! Every picture is rendered in turn within each run, forwards and backwards by turns, and held against the planned
//! picture of the same run, so that whatever else the machine does hits all alike. Times are those of the processor
//! where the system tells them. The planned picture takes part twice: by how much
//! its times differ from each other is the noise.

use std::time::Instant;

use crate::accel::{self, Accel, AccelOptions, Backend};
use crate::image::ToneMap;
use crate::image::metrics::{Tally, Viewing};
use crate::parallel;
use crate::render::{Monitor, Plan, RenderSettings, TileSample, render_sample, tile_count};
use crate::report::bench::Spread;
use crate::report::prices::{MIN_RUNS, Price, PriceList, TimeChange};
use crate::scene::{Camera, Effect, Scene};
use crate::scene_file::{Output, SceneFile};

use super::args::InfoArgs;
use super::failure::Failure;
use super::interrupt;
use super::job::{self, Tracing, choose_camera};
use super::progress::{Progress, Verbosity};

/// Part of a picture that is rendered at most: enough tiles to see all of it, few enough to be quick.
const MAX_SAMPLED: f64 = 0.05;
/// Tiles that are rendered even of a small picture, and however small the budget.
const MIN_TILES: usize = 8;
/// More runs would only tell times apart that make no difference.
const MAX_RUNS: usize = 25;
/// Steps of depth that are tried: what is reflected so often is dark almost everywhere.
const MAX_STEPS: u32 = 16;

/// What is said of the picture by the arguments, else by the scene.
fn picture(args: &InfoArgs, output: &Output) -> Output {
    let wish = Output {
        size: args.prices.size.map(|size| [size.width, size.height]),
        spp: args.prices.spp,
        depth: args.prices.depth,
        ..Output::default()
    };
    wish.or(output)
}

/// The settings that this makes.
pub(super) fn settings_of(args: &InfoArgs, output: &Output) -> Result<RenderSettings, Failure> {
    Ok(RenderSettings {
        effects: args.effects.unwrap_or_default(),
        ..job::settings(&picture(args, output))?
    })
}

/// What the prices of a scene are asked for.
pub(super) struct PriceJob<'a> {
    args: &'a InfoArgs,
    settings: RenderSettings,
    viewing: Viewing,
    backend: Backend,
    tracing: Tracing,
}

impl<'a> PriceJob<'a> {
    /// What the arguments mean for a scene that says `output` of its picture.
    pub(super) fn new(args: &'a InfoArgs, output: &Output) -> Result<PriceJob<'a>, Failure> {
        let backend = args.prices.backend.unwrap_or_default();
        let picture = picture(args, output);
        Ok(PriceJob {
            args,
            settings: settings_of(args, output)?,
            viewing: Viewing {
                tone: ToneMap {
                    exposure_ev: picture.exposure.unwrap_or(0.0),
                },
                ..Viewing::default()
            },
            backend,
            tracing: Tracing::of_threads(args.prices.threads),
        })
    }

    /// Measures on the threads that were asked for.
    pub(super) fn run(&self, loaded: &SceneFile) -> Result<PriceList, Failure> {
        let progress = Progress::new(Verbosity::Normal);
        let list = parallel::install(&self.tracing.pool()?, || self.measure(loaded, &progress));
        progress.clear();
        list
    }

    fn measure(&self, loaded: &SceneFile, progress: &Progress) -> Result<PriceList, Failure> {
        let name = self.args.scene.display().to_string();
        let scene = &loaded.scene;
        let camera = choose_camera(scene, &self.args.scene, None)?;
        progress.phase(&name, "build");
        let options = AccelOptions {
            threads: self.tracing.threads,
            progress: Some(&|fraction| progress.fraction(fraction)),
            ..AccelOptions::default()
        };
        let accel = accel::build(scene, self.backend, &options)?;
        interrupt::check()?;
        progress.phase(&name, "sample");
        let mut studio = Studio {
            scene,
            camera,
            accel: &*accel,
            tiles: MIN_TILES,
        };
        let budget = self.args.prices.budget;
        studio.tiles = self.affordable_tiles(&studio, budget)?;
        let start = Instant::now();
        let (variants, depth_reached) = self.variants(&studio, progress)?;
        progress.phase(&name, "time");
        let left = budget - start.elapsed().as_secs_f64();
        let times = Times::measure(&studio, &variants, left, progress)?;
        Ok(self.list(&studio, &variants, &times, depth_reached))
    }

    /// How many tiles may be rendered so that the least runs keep within the budget.
    fn affordable_tiles(&self, studio: &Studio, budget: f64) -> Result<usize, Failure> {
        let start = Instant::now();
        let pilot = studio.render(&self.settings)?;
        let per_tile = start.elapsed().as_secs_f64() / pilot.tiles.len().max(1) as f64;
        let changes = pilot.plan.effects().iter().count() + self.settings.depth.min(MAX_STEPS) as usize;
        // The plan itself twice, and one run for the pictures.
        let renders = (changes + 2) * (MIN_RUNS + 1);
        let (width, height) = (self.settings.width, self.settings.height);
        let most = (MAX_SAMPLED * tile_count(width, height) as f64).round() as usize;
        let affordable = budget / (per_tile * renders as f64);
        Ok((affordable as usize).min(most).max(MIN_TILES))
    }

    /// All pictures that take part, the planned one first; and after how many steps no ray of it is left, if that is
    /// known.
    fn variants(&self, studio: &Studio, progress: &Progress) -> Result<(Vec<Variant>, Option<u32>), Failure> {
        let planned = Variant::new(self.settings, Change::None, studio)?;
        let effects: Vec<Effect> = planned.sample.plan.effects().iter().collect();
        let steps = self.settings.depth.min(MAX_STEPS);
        let whole = (effects.len() + steps as usize) as f64;
        let mut variants = vec![planned];
        for &effect in &effects {
            let mut settings = self.settings;
            settings.effects.added = settings.effects.added.without(effect);
            settings.effects.removed = settings.effects.removed.with(effect);
            variants.push(Variant::new(settings, Change::Without(effect), studio)?);
            progress.fraction(variants.len() as f64 / whole);
        }
        for depth in 0..steps {
            let settings = RenderSettings {
                depth,
                ..self.settings
            };
            let shallow = Variant::new(settings, Change::Depth(depth), studio)?;
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
        studio: &Studio,
        variants: &[Variant],
        times: &Times,
        depth_reached: Option<u32>,
    ) -> PriceList {
        let (width, height) = (self.settings.width, self.settings.height);
        let planned = &variants[0];
        let control = TimeChange::of(&times.changes(Times::CONTROL), 0.0);
        let pixels: usize = planned
            .sample
            .tiles
            .iter()
            .map(|tile| tile.image.pixels.len())
            .sum();
        let per_pixel = Spread::of(&times.seconds[0]).median / pixels.max(1) as f64;
        let price = |(index, variant): (usize, &Variant)| Price {
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
            ..variant.against(planned, &self.viewing)
        };
        let mut list = PriceList {
            width,
            height,
            spp: self.settings.spp,
            depth: self.settings.depth,
            depth_reached,
            camera: studio.camera.name.clone(),
            backend: self.backend,
            threads: self.tracing.threads,
            tiles: planned.sample.tiles.len(),
            tiles_in_all: tile_count(width, height),
            runs: times.seconds[0].len(),
            seconds_forecast: per_pixel * f64::from(width) * f64::from(height) / self.tracing.threads as f64,
            noise: control.noise,
            list: variants.iter().enumerate().skip(1).map(price).collect(),
        };
        list.sort();
        list
    }
}

/// Where pictures are taken.
struct Studio<'a> {
    scene: &'a Scene,
    camera: &'a Camera,
    accel: &'a dyn Accel,
    /// How many tiles of each.
    tiles: usize,
}

impl Studio<'_> {
    fn render(&self, settings: &RenderSettings) -> Result<TileSample, Failure> {
        let monitor = Monitor {
            progress: &|_| {},
            cancel: &interrupt::CANCELLED,
            tiles: None,
        };
        render_sample(
            (self.scene, self.camera),
            self.accel,
            settings,
            self.tiles,
            &monitor,
        )
        .ok_or(Failure::Interrupted)
    }
}

/// What sets a picture apart from the planned one.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    None,
    Without(Effect),
    Depth(u32),
}

/// A picture that takes part.
struct Variant {
    settings: RenderSettings,
    change: Change,
    sample: TileSample,
}

impl Variant {
    fn new(settings: RenderSettings, change: Change, studio: &Studio) -> Result<Variant, Failure> {
        Ok(Variant {
            sample: studio.render(&settings)?,
            settings,
            change,
        })
    }

    fn traced_rays(&self) -> u64 {
        let ledger = &self.sample.ledger;
        ledger.reflection_rays() + ledger.refraction_rays()
    }

    /// Effects of the plan that are off with the one that was left out.
    fn takes_along(&self, planned: &Plan) -> Vec<Effect> {
        let gone = planned.effects().minus(self.sample.plan.effects());
        gone.iter()
            .filter(|&effect| self.change != Change::Without(effect))
            .collect()
    }

    /// What the picture lacks; the rest of the price is empty.
    fn against(&self, planned: &Variant, viewing: &Viewing) -> Price {
        let mut tally = Tally::default();
        let mut changes_picture = false;
        for (reference, test) in planned.sample.tiles.iter().zip(&self.sample.tiles) {
            changes_picture |= reference.image != test.image;
            let sizes_match = tally.add(&reference.image, &test.image, viewing).is_ok();
            debug_assert!(sizes_match, "both are samples of one picture");
        }
        Price {
            without: None,
            takes_along: Vec::new(),
            depth: None,
            time: TimeChange::of(&[], 0.0),
            changes_picture,
            picture: tally.metrics(),
        }
    }
}

/// Seconds of every variant in every run, and of the planned picture once more.
struct Times {
    /// By variant, the control last; then by run.
    seconds: Vec<Vec<f64>>,
}

impl Times {
    /// Stands for the second one of the planned picture.
    const CONTROL: usize = usize::MAX;

    /// Renders all in turn, at least as often as tells a median, and as often as `budget` seconds allow.
    fn measure(
        studio: &Studio,
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
                seconds[index].push(studio.render(&variant.settings)?.seconds());
                let runs = run as f64 + (done + 1) as f64 / order.len() as f64;
                let by_budget = start.elapsed().as_secs_f64() / budget.max(f64::MIN_POSITIVE);
                progress.fraction((runs / MIN_RUNS as f64).min(by_budget.max(runs / MAX_RUNS as f64)));
            }
            order.reverse();
            let passed = start.elapsed().as_secs_f64();
            let next_end = passed * (run + 2) as f64 / (run + 1) as f64;
            if run + 1 >= MIN_RUNS && next_end > budget {
                break;
            }
        }
        Ok(Times { seconds })
    }

    /// How a variant's time differs in each run from that of the planned picture, which is the mean of its two; the
    /// control is held against the other one.
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
