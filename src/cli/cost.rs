//! Command `whit cost`: measures the error and the time of many settings on the user's scene.

use std::fs;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use whit::accel::{AccelError, Backend};
use whit::batch::request::{TracingOptions, choose_camera, load_scene, render_settings};
use whit::cost::{
    self, Configuration, Experiment, Keep, Measured, SceneChange, SettingsFile, StudyCheckpoint, StudyResult,
    Target,
};
use whit::gltf::LoadOptions;
use whit::image::metrics::{self, Viewing};
use whit::image::{ImageFormat, ToneMap, check_writable, write, write_atomically};
use whit::parallel;
use whit::render::RenderSettings;
use whit::report::cost::{CostText, points_csv};
use whit::report::{cost_page, difference_image, memory};
use whit::scene::CameraRequest;
use whit::scene_file::{Output, SceneFile};

use super::accel_options::{check_instancing, tracing_options};
use super::args::CostArgs;
use super::callgrind;
use super::failure::Failure;
use super::interrupt;
use super::output;
use super::progress::{Progress, Verbosity};
use super::standard_error;

/// Bytes per pixel of each configuration: sums, first image, and displayed image.
const BYTES_A_PIXEL: u64 = 12 + 12 + 12;
/// Upper bound on the configurations of a scene with all effects.
const MAX_CONFIGURATIONS: u64 = 64;

/// Runs the study that the arguments request, prints it and writes the report.
pub(super) fn run(args: &CostArgs) -> Result<(), Failure> {
    // Check the backend, the flags and the output folder before anything is measured
    let start = Instant::now();
    let backend = args.backend.unwrap_or_default();
    if backend == Backend::Embree && !cfg!(feature = "embree") {
        return Err(AccelError::NoEmbree.into());
    }
    if backend == Backend::Brute {
        return Err(Failure::Input(
            "brute force is too slow for a study: choose `--backend embree` or `--backend bsp`".into(),
        ));
    }
    check_instancing(&args.tracing)?;
    if args.instructions {
        callgrind::check()?;
    }
    let folder = args.out.as_deref().map(Folder::new).transpose()?;
    let tracing = tracing_options(&args.tracing, backend);
    let progress = Progress::new(Verbosity::Normal);
    // Load the checkpoint, and count the time that the interrupted study has spent
    let unfinished = match &folder {
        Some(folder) if args.resume => Some(folder.unfinished()?),
        Some(folder) => {
            folder.warn_of_checkpoint(&progress);
            None
        }
        None => None,
    };
    let spent = unfinished.as_ref().map_or(0.0, StudyCheckpoint::spent);
    let start = start.checked_sub(Duration::from_secs_f64(spent)).unwrap_or(start);
    // Measure
    let findings = parallel::install(&tracing.pool()?, || {
        measure(args, (&tracing, folder.as_ref()), (start, unfinished), &progress)
    });
    progress.clear();
    // On an interruption, point to the checkpoint
    if let (Err(Failure::Interrupted), Some(folder)) = (&findings, &folder)
        && folder.unfinished.exists()
    {
        standard_error::emit(&format!(
            "whit: the measurements so far are in {}: resume the study with `--resume`",
            folder.unfinished.display()
        ));
    }
    let (findings, tone) = findings?;
    // Print the results and write the report
    output::print(&CostText(&findings.study).to_string())?;
    if let Some(folder) = &folder {
        folder.write(args, &findings, tone)?;
        // The report contains all of the checkpoint. A checkpoint that cannot be removed is replaced by the next study.
        let _ = fs::remove_file(&folder.unfinished);
    }
    match &findings.study.choice {
        Some(choice) if !choice.reached => Err(Failure::Work(
            "no settings were found that reach the target (the nearest are printed above): give a larger `--budget` or \
             another target"
                .into(),
        )),
        _ => Ok(()),
    }
}

fn measure(
    args: &CostArgs,
    (tracing, folder): (&TracingOptions, Option<&Folder>),
    (start, unfinished): (Instant, Option<StudyCheckpoint>),
    progress: &Progress,
) -> Result<(StudyResult, ToneMap), Failure> {
    let name = args.scene.display().to_string();
    let denoiser = args.denoising.denoiser(false)?;
    if denoiser.is_some() && (args.max_error.is_some() || args.max_time.is_some()) {
        return Err(Failure::Input(
            "a search for settings measures parts of images, which cannot be denoised: leave out `--denoise`, or \
             `--max-error` and `--max-time`"
                .into(),
        ));
    }
    // Load the scene
    progress.phase(&name, "load");
    let size = args.size.map(|size| [size.width, size.height]);
    let options = LoadOptions {
        camera: CameraRequest {
            image_size: size,
            ..CameraRequest::default()
        },
        ..LoadOptions::default()
    };
    let SceneFile { scene, output, .. } = load_scene(&args.scene, &[], &options)?;
    for warning in &scene.warnings {
        progress.warn(&format!("{name}: {warning}"));
    }
    let scene = scene.validate()?;
    let camera = choose_camera(scene.get(), &args.scene, args.camera.as_deref())?;
    check_memory(size)?;
    let requested = Output {
        size: size.or(output.size),
        ..output
    };
    let tone = ToneMap {
        exposure_ev: output.exposure.unwrap_or(0.0),
    };
    // Save checkpoints into the folder
    let keep = folder.map(|folder| {
        |bytes: &[u8]| {
            let kept = interrupt::without_interruption(|| {
                write_atomically(&folder.unfinished, |file| file.write_all(bytes))
            });
            // A checkpoint that cannot be written does not stop the study.
            if let Err(error) = kept {
                progress.warn(&format!("cannot save the measurements so far: {error}"));
            }
        }
    });
    // Describe the experiment
    let experiment = Experiment {
        scene,
        camera,
        base: Configuration {
            settings: RenderSettings {
                spawn: args.leaving.spawn,
                hit_points: args.leaving.hit_points,
                ..render_settings(&requested)?
            },
            path: tracing.path(),
            change: SceneChange::default(),
            denoises: false,
        },
        tone,
        size,
        target: match (args.max_error, args.max_time) {
            (Some(most), _) => Some(Target::Error(most)),
            (None, most) => most.map(Target::Seconds),
        },
        budget: args.budget,
        start,
        threads: tracing.threads,
        isa: tracing.isa.clone(),
        denoiser: denoiser.as_ref(),
        unfinished,
        keep: keep.as_ref().map(|keep| keep as Keep),
    };
    // Measure
    progress.phase(&name, "measure");
    let findings = progress.observe(|observer| cost::run(&experiment, observer));
    let mut findings = findings.map_err(|error| match (error.into(), folder) {
        (Failure::Input(words), Some(folder)) if args.resume => {
            Failure::Input(format!("{} {words}", folder.unfinished.display()))
        }
        (failure, _) => failure,
    })?;
    // Count instructions if requested
    if args.instructions {
        callgrind::count(args, &mut findings, progress)?;
    }
    Ok((findings, tone))
}

/// Rejects image sizes for which all images of a study do not fit into memory at once.
fn check_memory(size: Option<[u32; 2]>) -> Result<(), Failure> {
    let Some([width, height]) = size else {
        return Ok(());
    };
    let needed = u64::from(width) * u64::from(height) * BYTES_A_PIXEL * MAX_CONFIGURATIONS;
    match memory::available_bytes().filter(|&free| needed > free) {
        Some(free) => Err(Failure::Input(format!(
            "images of {width}x{height} pixels in all settings take {} of memory and {} are free: give a smaller \
             `--size`",
            memory::in_words(needed),
            memory::in_words(free)
        ))),
        None => Ok(()),
    }
}

/// Paths of all files of a report.
struct Folder {
    page: PathBuf,
    json: PathBuf,
    csv: PathBuf,
    reference: PathBuf,
    settings: PathBuf,
    difference: PathBuf,
    flip: PathBuf,
    /// Checkpoint of an interrupted study.
    unfinished: PathBuf,
}

impl Folder {
    /// Reads the checkpoint of an interrupted study.
    fn unfinished(&self) -> Result<StudyCheckpoint, Failure> {
        let path = self.unfinished.display();
        let bytes = match fs::read(&self.unfinished) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == ErrorKind::NotFound => {
                return Err(Failure::Input(format!(
                    "{path} does not exist: no study was interrupted, so leave out `--resume`"
                )));
            }
            Err(error) => return Err(Failure::Input(format!("cannot read {path}: {error}"))),
        };
        StudyCheckpoint::parse(&bytes).map_err(|words| Failure::Input(format!("{path} {words}")))
    }

    /// Warns that the folder has a checkpoint which the new study will replace.
    fn warn_of_checkpoint(&self, progress: &Progress) {
        if self.unfinished.exists() {
            progress.warn(&format!(
                "{} has an interrupted study, which starts again from the beginning: give `--resume` to continue it",
                self.unfinished.display()
            ));
        }
    }

    /// Creates the folder if necessary, and checks that the files of the report can be written.
    fn new(folder: &Path) -> Result<Folder, Failure> {
        fs::create_dir_all(folder).map_err(|error| {
            Failure::Input(format!("cannot create the folder {}: {error}", folder.display()))
        })?;
        let files = Folder {
            page: folder.join("report.html"),
            json: folder.join("report.json"),
            csv: folder.join("points.csv"),
            reference: folder.join("ref.exr"),
            settings: folder.join("settings.toml"),
            difference: folder.join("difference.png"),
            flip: folder.join("flip.png"),
            unfinished: folder.join("unfinished.study"),
        };
        for path in [
            &files.page,
            &files.json,
            &files.csv,
            &files.reference,
            &files.settings,
            &files.difference,
            &files.flip,
        ] {
            check_writable(path)?;
        }
        Ok(files)
    }

    fn write(&self, args: &CostArgs, findings: &StudyResult, tone: ToneMap) -> Result<(), Failure> {
        let StudyResult {
            study,
            reference,
            images: renderings,
            configurations,
            chosen,
            patch_reference: _,
            embree,
        } = findings;
        // Write the numbers as JSON and CSV
        interrupt::without_interruption(|| output::write_json(&self.json, study))?;
        interrupt::without_interruption(|| output::write_text(&self.csv, &points_csv(study)))?;
        // Write the chosen settings, or those at the knee of the Pareto front
        let knee = study.knee();
        let (configuration, rmse, seconds) = match (chosen, &study.choice) {
            (Some(chosen), Some(choice)) => (chosen, choice.rmse, choice.seconds),
            _ => {
                let point = &study.points[knee];
                (&configurations[knee], point.rmse, point.seconds)
            }
        };
        let settings = SettingsFile {
            settings: configuration.to_settings(),
            measured: Some(Measured {
                scene: args.scene.display().to_string(),
                size: study.size,
                rmse,
                seconds,
                threads: study.threads,
                converged: study.reference.has_converged(),
            }),
        };
        interrupt::without_interruption(|| output::write_text(&self.settings, &settings.text()))?;
        // Write the reference, and the differences of the base image from it
        interrupt::without_interruption(|| write(reference, &self.reference, ImageFormat::Exr, tone))?;
        let base = &renderings[0];
        let viewing = Viewing {
            tone,
            ..Viewing::default()
        };
        let compared = metrics::compare(reference, base, &viewing);
        let flip = compared
            .map_err(|error| Failure::Work(error.to_string()))?
            .flip_map;
        let facts = cost_page::Facts {
            scene: &args.scene,
            embree: embree
                .as_ref()
                .map(|embree| format!("{} ({})", embree.version, embree.isa)),
            tone,
            date: args.date.as_deref(),
        };
        let compared_images = cost_page::ComparedImages {
            reference,
            image: base,
            difference: &difference_image::signed(reference, base, tone.exposure_ev),
            flip: &difference_image::heat(&flip, reference.width),
        };
        for (image, path) in [
            (compared_images.difference, &self.difference),
            (compared_images.flip, &self.flip),
        ] {
            interrupt::without_interruption(|| write(image, path, ImageFormat::Png, ToneMap::default()))?;
        }
        // Write the HTML page
        let page = cost_page::page(study, &facts, &compared_images).map_err(|error| {
            Failure::Work(format!(
                "cannot encode the images of {}: {error}",
                self.page.display()
            ))
        })?;
        interrupt::without_interruption(|| output::write_text(&self.page, &page))
    }
}
