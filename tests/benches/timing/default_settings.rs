//! The processor time until each way of sampling reaches a displayed error, on every example scene and on the glTF
//! models beside the repository: the evidence for the defaults, some minutes in all.
//!
//! Samples per pixel rise, or the target of adaptive sampling falls, until the image reaches the error; the time at
//! which it does is interpolated between the last two images, by the logarithms of time and error. `WHIT_SCENES=a,b`
//! takes some of the scenes.

use std::path::{Path, PathBuf};

use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::cost::{DisplayImage, ImageSums, SplitReference};
use whit::image::ToneMap;
use whit::measure::Stopwatch;
use whit::render::{Adaptive, Monitor, Pattern, Plan, RenderSettings, render};
use whit::scene::Effect;

use crate::limits::Limits;
use crate::quartiles::Quartiles;
use crate::scene_folder::{self, FiledScene};

const WIDTH: u32 = 192;
const TARGET: f64 = 0.01;
/// Samples per pixel of each half of the reference.
const REFERENCE_SPP: u32 = 256;
/// Largest number of samples per pixel that is tried.
const MAX_SPP: u32 = 256;
/// Targets of adaptive sampling that are tried: standard errors of a displayed pixel.
const ADAPTIVE_ERRORS: [f64; 5] = [0.04, 0.02, 0.014, 0.01, 0.005];
/// Images by which an error and a time are estimated.
const IMAGES: u32 = 2;
const MODELS: [&str; 2] = ["DamagedHelmet.glb", "FlightHelmet/FlightHelmet.gltf"];

/// Way of sampling.
struct Candidate {
    name: &'static str,
    pattern: Pattern,
    is_adaptive: bool,
    filters_textures: bool,
}

const fn candidate(name: &'static str, pattern: Pattern) -> Candidate {
    Candidate {
        name,
        pattern,
        is_adaptive: false,
        filters_textures: true,
    }
}

const CANDIDATES: [Candidate; 6] = [
    candidate("sobol", Pattern::Sobol),
    candidate("r2", Pattern::R2),
    candidate("jittered", Pattern::Jittered),
    candidate("regular", Pattern::Regular),
    Candidate {
        is_adaptive: true,
        ..candidate("sobol, adaptive", Pattern::Sobol)
    },
    Candidate {
        filters_textures: false,
        ..candidate("sobol, no texture filter", Pattern::Sobol)
    },
];

/// Prints the times of all candidates for each scene, and their geometric means relative to the first.
pub(crate) fn run(_: &mut Limits) {
    let some = std::env::var("WHIT_SCENES").ok();
    let is_wanted = |filed: &FiledScene| {
        let named = |some: &String| some.split(',').any(|name| name == filed.name);
        some.as_ref().is_none_or(named)
    };
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/assets/gltf");
    let models = MODELS.map(|model| models.join(model));
    let is_there = |path: &PathBuf| {
        let there = path.exists();
        if !there {
            println!("skipped: {} is absent", path.display());
        }
        there
    };
    let files = scene_folder::files()
        .into_iter()
        .chain(models.into_iter().filter(is_there));

    print!("| scene | samples to {TARGET} |");
    CANDIDATES
        .iter()
        .for_each(|candidate| print!(" {} |", candidate.name));
    println!("\n|---|--:|{}", "--:|".repeat(CANDIDATES.len()));
    let (mut ratios, mut samples) = ([const { Vec::new() }; CANDIDATES.len()], Vec::new());
    for filed in files.map(|file| scene_folder::load(&file)).filter(is_wanted) {
        let Some(row) = compare(&filed) else {
            println!(
                "| {} | no image has this error, or none is measurable |",
                filed.name
            );
            continue;
        };
        print!(
            "| {} | {:.0} |",
            filed.name,
            row[0].map_or(f64::NAN, |first| first.samples)
        );
        for (arrival, ratios) in row.iter().zip(&mut ratios) {
            match (arrival, row[0]) {
                (Some(arrival), Some(first)) => {
                    let ratio = arrival.seconds / first.seconds;
                    ratios.push(ratio);
                    print!(" {ratio:.2} |");
                }
                _ => print!(" not |"),
            }
        }
        println!();
        samples.extend(row[0].map(|first| first.samples));
    }
    print!("| all | {:.0} |", Quartiles::compute(samples));
    for ratios in ratios {
        let sum: f64 = ratios.iter().map(|ratio| ratio.ln()).sum();
        print!(" {:.2} ({}) |", (sum / ratios.len() as f64).exp(), ratios.len());
    }
    println!();
}

/// Point at which images reach the target.
#[derive(Clone, Copy)]
struct Arrival {
    seconds: f64,
    /// Samples per pixel.
    samples: f64,
}

/// Returns where each candidate reaches the target, `None` if not within the limits; `None` for a scene whose
/// reference has too large an error itself.
fn compare(filed: &FiledScene) -> Option<[Option<Arrival>; CANDIDATES.len()]> {
    let scene = filed.scene.validate().unwrap();
    let accel = accel::build(scene, Backend::default(), &AccelOptions::default()).unwrap();
    let stage = Stage {
        filed,
        accel: &*accel,
    };
    let half = |seed: u32| {
        let mut settings = filed.settings(WIDTH, REFERENCE_SPP);
        settings.seed = seed;
        settings.pattern = Pattern::Sobol;
        settings.effects.removed = settings.effects.removed.with(Effect::TextureFilter);
        stage.image(&settings).0
    };
    let reference = SplitReference {
        a: half(1_000_001),
        b: half(1_000_002),
    };
    if reference.noise_squared() > (0.5 * TARGET).powi(2) {
        return None;
    }
    let has_filter = Plan::new(&filed.scene, &filed.scene.cameras[0], &Default::default())
        .effects()
        .has(Effect::TextureFilter);
    Some(CANDIDATES.each_ref().map(|candidate| {
        (candidate.filters_textures || has_filter)
            .then(|| stage.arrival(candidate, &reference))
            .flatten()
    }))
}

/// Scene with the structure that finds the hits in it.
struct Stage<'s> {
    filed: &'s FiledScene,
    accel: &'s dyn Accel,
}

impl Stage<'_> {
    /// Returns where the candidate reaches the target, if it does.
    fn arrival(&self, candidate: &Candidate, reference: &SplitReference) -> Option<Arrival> {
        let mut settings = self.filed.settings(WIDTH, 1);
        settings.pattern = candidate.pattern;
        if !candidate.filters_textures {
            settings.effects.removed = settings.effects.removed.with(Effect::TextureFilter);
        }
        let steps: Vec<RenderSettings> = if candidate.is_adaptive {
            let adaptive = |error| RenderSettings {
                spp: MAX_SPP,
                adaptive: Some(Adaptive { error, gain: 1.0 }),
                ..settings
            };
            ADAPTIVE_ERRORS.map(adaptive).to_vec()
        } else {
            let powers = (0..=MAX_SPP.ilog2()).map(|power| 1 << power);
            powers.map(|spp| RenderSettings { spp, ..settings }).collect()
        };
        let mut last: Option<(Arrival, f64)> = None;
        for step in &steps {
            let (here, error) = self.measure(step, reference);
            if error <= TARGET {
                return Some(last.map_or(here, |(before, larger)| {
                    let part = (larger / TARGET).ln() / (larger / error).ln();
                    let between = |a: f64, b: f64| a * (b / a).powf(part);
                    Arrival {
                        seconds: between(before.seconds, here.seconds),
                        samples: between(before.samples, here.samples),
                    }
                }));
            }
            last = Some((here, error));
        }
        None
    }

    /// Returns time, samples and error of images with these settings.
    fn measure(&self, settings: &RenderSettings, reference: &SplitReference) -> (Arrival, f64) {
        let mut images = ImageSums::new(reference);
        let (mut seconds, mut samples) = (Vec::new(), Vec::new());
        for seed in 0..IMAGES {
            let (image, taken, count) = self.image(&RenderSettings { seed, ..*settings });
            images.add(reference, &image);
            seconds.push(taken);
            samples.push(count);
        }
        let here = Arrival {
            seconds: Quartiles::compute(seconds).median,
            samples: Quartiles::compute(samples).median,
        };
        (here, images.mean_square().max(0.0).sqrt())
    }

    /// Returns an image with the processor seconds of its render phase and its samples per pixel.
    fn image(&self, settings: &RenderSettings) -> (DisplayImage, f64, f64) {
        let scene = self.filed.scene.validate().unwrap();
        let watch = Stopwatch::start();
        let monitor = Monitor::default();
        let rendering = render(scene, &scene.cameras[0], self.accel, settings, &monitor).unwrap();
        let seconds = watch.time().without(rendering.ready_seconds).processor;
        let pixels = f64::from(settings.width) * f64::from(settings.height);
        let samples = rendering.ledger.camera_rays() as f64 / pixels;
        let image = DisplayImage::new(&rendering.image, ToneMap { exposure_ev: 0.0 });
        (image, seconds, samples)
    }
}
