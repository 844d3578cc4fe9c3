//! Command `whit render`: renders scenes to images one after another; a failure does not stop the remaining scenes.

use std::mem;
use std::time::Instant;

use whit::accel::auto::{BackendChoice, Structures};
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::batch::request::{
    self, Notes, ProjectedAccel, RenderRequest, ResolvedSettings, check_memory, choose_camera,
};
use whit::cost::StudyResult;
use whit::image::{self, Attribute, ImageChannel, ImageFormat, PngEncoding, ToneMap};
use whit::parallel;
use whit::render::{
    self, EdgeContrast, Exposure, FinishedTile, Monitor, Region, RenderSettings, Rendering, forecast_rays,
};
use whit::report::cost::AimText;
use whit::report::image_error::ImageErrorText;
use whit::report::stats::{
    AccelStats, CutoffStats, ImageStats, LedgerStats, PhaseSeconds, RayCounts, RenderStats, SceneStats,
    effect_stats,
};
use whit::report::{heat_map, memory, table};
use whit::scene::{Camera, Scene, ValidScene};
use whit::scene_file::{Output, SceneFile};
use whit::watch::TevViewer;

use super::args::RenderArgs;
use super::autotune;
use super::crop;
use super::exposure;
use super::failure::Failure;
use super::interrupt;
use super::job::{RenderJob, StatsDestination, Target};
use super::output;
use super::preview::{self, Live};
use super::progress::{Progress, Verbosity};

/// Ratio of actual to requested spacing of irradiance samples from which on a warning is printed; smaller ratios are
/// invisible.
const COARSENESS_WARNING: f64 = 1.25;
/// Seconds of a render by Embree from which on another backend's forecast is printed.
const LONG_RENDER: f64 = 10.0;

/// Renders all scenes of the arguments.
pub(super) fn run(args: &RenderArgs) -> Result<(), Failure> {
    let progress = Progress::of_kind(args.watching.format.progress, Verbosity::of_flag(args.quiet));
    let job = RenderJob::new(args)?;
    let pool = job.request.tracing.pool()?;
    let viewer = preview::connect(args.watching.tev.as_deref())?;
    let mut finished = Vec::with_capacity(job.targets.len());
    let mut failed = 0;
    // Render each scene and check its image; one failure does not stop the others
    for target in &job.targets {
        let render = || render_one(&job, target, viewer.as_ref(), &progress);
        let result = parallel::install(&pool, render).and_then(|(stats, reached)| {
            let verdict = check_finite(&stats).and_then(|()| check_reached(reached));
            let seconds = stats.seconds.total;
            finished.push(stats);
            // Statistics are written after each image, so that later failures lose nothing.
            write_stats(&job, &finished, &progress)?;
            verdict.map(|()| seconds)
        });
        preview::warn_if_gone(viewer.as_ref(), &progress);
        // With a single scene, its failure is that of the program
        match result {
            Ok(seconds) => progress.done(seconds),
            Err(failure) if job.targets.len() == 1 || matches!(failure, Failure::Interrupted) => {
                progress.clear();
                progress.failed(&failure);
                return Err(Failure::AlreadyReported {
                    exit_code: failure.exit_code(),
                });
            }
            Err(failure) => {
                progress.failed(&failure);
                failed += 1;
            }
        }
    }
    preview::finish(viewer, &progress);
    progress.clear();
    match failed {
        0 => Ok(()),
        _ => Err(Failure::Some {
            failed,
            total: job.targets.len(),
        }),
    }
}

/// Renders one scene from its file to its image; returns the statistics, and whether the settings reach the target, if
/// there is one.
fn render_one(
    job: &RenderJob,
    target: &Target,
    viewer: Option<&TevViewer>,
    progress: &Progress,
) -> Result<(RenderStats, bool), Failure> {
    let start = Instant::now();
    let name = target.scene.display().to_string();
    let mut seconds = PhaseSeconds::default();

    // Load the scene
    let image_name = target.image.display().to_string();
    progress.start(&name, &image_name);
    progress.phase(&name, "load");
    let (
        SceneFile {
            mut scene, output, ..
        },
        load_seconds,
    ) = timed(|| {
        let file = (&*target.scene, &[][..]);
        Ok(request::load(
            &job.request,
            file,
            job.load.clone(),
            &interrupt::CANCELLED,
        )?)
    })?;
    seconds.load = load_seconds;
    for warning in &scene.warnings {
        progress.warn(&format!("{name}: {warning}"));
    }
    // Search for settings if the job has a target
    let given = job.request.for_output(&output);
    let aimed = aim((job, &given), target, (&mut scene, &output), progress)?;
    let request = aimed.as_ref().map_or(&given, |(request, _)| request);
    let mut resolved = request.resolved(&output)?;
    let exposure = exposure::choose(job, target, (&scene, &output), progress)
        .unwrap_or(Exposure::Stops(resolved.tone.exposure_ev));
    check_memory(&resolved.settings, scene.lights.len())?;
    if let Some(region) = &job.crop {
        crop::check_region(region, &resolved.settings)?;
    }
    let valid = scene.validate()?;
    let camera = choose_camera(&scene, &target.scene, job.camera.as_deref())?;

    // Build the acceleration structure
    progress.phase(&name, "build");
    let (accel, build_seconds) = timed(|| {
        let options = AccelOptions {
            progress: Some(&|fraction| progress.fraction(fraction)),
            ..request.tracing.options_for(valid, &resolved.settings)
        };
        let accel = accel::build(valid, request.backend(), &options)?;
        interrupt::check()?;
        Ok(accel)
    })?;
    seconds.build = build_seconds;

    // Render, with screen bounds where they pay, show tiles in the viewer, and denoise
    progress.phase(&name, "render");
    let (rendering, render_seconds) = timed(|| {
        let backend = request.backend();
        let settings = RenderSettings {
            edge_contrast: resolved
                .settings
                .edge_contrast
                .map(|contrast| EdgeContrast { exposure, ..contrast }),
            error_exposure: job.estimates_error.then_some(exposure),
            ..resolved.settings
        };
        let projected = ProjectedAccel::new((&*accel, backend), (&scene, camera), &settings);
        let size = [resolved.settings.width, resolved.settings.height];
        let live = viewer.map(|viewer| Live::begin(viewer, &image_name, size));
        let settings = match job.denoiser {
            Some(_) => settings.with_guides(),
            None => settings,
        };
        let image = (&settings, job.crop.as_ref());
        let mut rendering = trace(image, (valid, camera), projected.accel(), (progress, live))?;
        if let Some(denoiser) = &job.denoiser {
            progress.phase(&name, "denoise");
            rendering
                .denoise(denoiser, resolved.settings.layers)
                .map_err(|error| Failure::Work(error.to_string()))?;
        }
        Ok(rendering)
    })?;
    seconds.render = render_seconds;
    // Choose the exposure, unless it was chosen for the error of the same image
    resolved.tone.exposure_ev = match rendering.error.filter(|_| job.denoiser.is_none()) {
        Some(error) => error.stops,
        None => exposure.stops(&rendering.image, rendering.alpha.as_deref()),
    };
    seconds.trace = rendering.ledger.trace_seconds();

    // Warn of overridden effects and of coarse subsurface sampling
    for decision in rendering.plan.overridden() {
        progress.warn(&format!("{name}: {decision}"));
    }
    if let Some(subsurface) = rendering
        .subsurface
        .filter(|subsurface| subsurface.coarseness > COARSENESS_WARNING)
    {
        progress.warn(&format!(
            "{name}: subsurface light is blurred over {:.1} times the requested distance, as {} samples are the \
             maximum: make the objects smaller or their `scale` larger for finer samples",
            subsurface.coarseness, subsurface.samples
        ));
    }

    // Write the image and the heat map
    let (heat, write_seconds) = timed(|| {
        let embree = accel.report().embree;
        let mut notes = Notes::of(
            (request, &resolved),
            (&scene, camera),
            embree.as_ref(),
            &rendering.plan,
        );
        if let Some(denoiser) = &job.denoiser {
            notes.add("whit.denoiser", denoiser.name());
        }
        if let Some(Region { x, y, width, height }) = job.crop {
            notes.add("whit.crop", format!("{x},{y},{width},{height}"));
        }
        write_image((request, &resolved), target, &rendering, &notes.list())?;
        write_heat(job, &rendering)
    })?;
    seconds.write = write_seconds;
    seconds.total = start.elapsed().as_secs_f64();
    let chosen = (exposure == Exposure::Automatic).then_some(resolved.tone.exposure_ev);
    print_finished(target, (&rendering, chosen), seconds.total, progress)?;
    if let Some(error) = &rendering.error {
        progress.result(&format!("{}\n", ImageErrorText(error)))?;
    }
    if let Some(line) = backend_line(valid, &resolved.settings, request.backend(), seconds.total) {
        progress.result(&line)?;
    }
    let reached = match &aimed {
        Some((_, findings)) => print_tuning(findings, (&rendering, seconds.render), progress)?,
        None => true,
    };
    if let Some(line) = heat {
        progress.result(&line)?;
    }

    // Collect the statistics
    let mut stats = stats((request, target, &resolved), &scene, &*accel, &rendering);
    stats.image.camera.clone_from(&camera.name);
    stats.seconds = seconds;
    if job.targets.last() == Some(target) {
        // The process ends after the last image; freeing gigabytes piece by piece would only delay the exit.
        mem::forget(accel);
        mem::forget(scene);
    }
    Ok((stats, reached))
}

/// Searches for settings that reach the job's target and returns the request with these settings and the findings;
/// changes the scene accordingly. Returns `None` if the job has no target or no settings were chosen.
fn aim(
    (job, request): (&RenderJob, &RenderRequest),
    target: &Target,
    (scene, output): (&mut Scene, &Output),
    progress: &Progress,
) -> Result<Option<(RenderRequest, StudyResult)>, Failure> {
    let Some(aim) = job.aim else {
        return Ok(None);
    };
    progress.phase(&target.scene.display().to_string(), "choose");
    let resolved = request.resolved(output)?;
    let camera = choose_camera(scene, &target.scene, job.camera.as_deref())?;
    let findings = autotune::find_settings((request, aim, &resolved), (scene.validate()?, camera), progress)?;
    let Some(chosen) = &findings.chosen else {
        return Ok(None);
    };
    let settings = chosen.to_settings();
    settings.change().apply(scene);
    Ok(Some((request.with(&settings), findings)))
}

/// Prints the chosen settings and their result; returns whether they reach the target.
fn print_tuning(
    findings: &StudyResult,
    (rendering, seconds): (&Rendering, f64),
    progress: &Progress,
) -> Result<bool, Failure> {
    let text = AimText {
        study: &findings.study,
        rmse: findings
            .patch_reference
            .as_ref()
            .and_then(|patch_reference| patch_reference.rmse(&rendering.image)),
        seconds,
    };
    progress.result(&text.to_string())?;
    Ok(findings.study.choice.as_ref().is_none_or(|choice| choice.reached))
}

/// Returns the result of `work` and its wall-clock seconds.
fn timed<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<(T, f64), Failure> {
    let start = Instant::now();
    let result = work()?;
    Ok((result, start.elapsed().as_secs_f64()))
}

fn trace(
    (settings, region): (&RenderSettings, Option<&Region>),
    (scene, camera): (ValidScene, &Camera),
    accel: &dyn Accel,
    (progress, live): (&Progress, Option<Live>),
) -> Result<Rendering, Failure> {
    let show = live.map(|live| move |tile: FinishedTile| live.show(tile));
    // Report progress, poll for Ctrl-C, and show finished tiles
    let monitor = Monitor {
        progress: &|fraction| progress.fraction(fraction),
        cancel: &interrupt::CANCELLED,
        tiles: show.as_ref().map(|show| show as _),
    };
    let rendering = match region {
        Some(region) => crop::render((scene, camera), accel, (settings, region), &monitor)?,
        None => render::render(scene, camera, accel, settings, &monitor)?,
    };
    if let Some(live) = live {
        live.finish(&rendering.image);
    }
    Ok(rendering)
}

fn write_image(
    (request, resolved): (&RenderRequest, &ResolvedSettings),
    target: &Target,
    rendering: &Rendering,
    notes: &[Attribute],
) -> Result<(), Failure> {
    let (image, path) = (&rendering.image, &target.image);
    if target.format == ImageFormat::Png {
        let encoding = PngEncoding {
            tone: resolved.tone,
            operator: resolved.operator,
            bits: request.encoding.png_bits,
        };
        interrupt::without_interruption(|| match &rendering.alpha {
            None => image::write_png_with(image, encoding, notes, path),
            Some(alpha) => image::write_png_with_alpha(image, alpha, encoding, notes, path),
        })?;
        return Ok(());
    }
    // Collect the further channels, which only EXR files can hold
    let channels = request::channels(&request.aovs, rendering);
    let extra: Vec<ImageChannel> = channels
        .iter()
        .map(|layer| ImageChannel {
            name: &layer.name,
            values: &layer.values,
            kind: layer.kind,
        })
        .collect();
    interrupt::without_interruption(|| {
        image::write_exr_with(image, &extra, request.encoding.exr, notes, path)
    })?;
    Ok(())
}

/// Writes the requested heat map; returns a line with the range of its scale.
fn write_heat(job: &RenderJob, rendering: &Rendering) -> Result<Option<String>, Failure> {
    let (Some(path), Some(costs)) = (&job.heat, &rendering.costs) else {
        return Ok(None);
    };
    let heat = heat_map::map(&costs.all_nanoseconds(), rendering.image.width);
    interrupt::without_interruption(|| {
        image::write(&heat.image, path, ImageFormat::Png, ToneMap::default())
    })?;
    let [low, high] = heat.range;
    Ok(Some(format!(
        "{}: {low:.0} to {high:.0} ns per pixel, tick marks at powers of ten\n",
        path.display()
    )))
}

/// Prints one line per image on standard output, with the stops of exposure that were chosen automatically.
fn print_finished(
    target: &Target,
    (rendering, chosen): (&Rendering, Option<f32>),
    seconds: f64,
    progress: &Progress,
) -> Result<(), Failure> {
    let exposure = chosen.map_or_else(String::new, |stops| format!(", exposure {stops:.2} stops"));
    progress.result(&format!(
        "{}: {}x{}, {seconds:.2} s{exposure}\n",
        target.image.display(),
        rendering.image.width,
        rendering.image.height
    ))
}

/// Returns the line about the choice of `--backend auto`: what it chose, or what it would gain in a long render by
/// Embree.
fn backend_line(
    scene: ValidScene,
    settings: &RenderSettings,
    backend: Backend,
    seconds: f64,
) -> Option<String> {
    let choice = || BackendChoice::new(scene.get(), &forecast_rays(scene, settings));
    match backend {
        Backend::Auto => Some(format!("backend: {}\n", choice())),
        Backend::Embree if seconds > LONG_RENDER => {
            let choice = choice();
            (choice.structures != Structures::Embree).then(|| {
                let share = choice.share;
                format!("`--backend auto` is forecast to build and to trace in {share:.2} of the time\n")
            })
        }
        _ => None,
    }
}

/// Returns an error if the image was rendered with settings that miss the target.
fn check_reached(reached: bool) -> Result<(), Failure> {
    match reached {
        true => Ok(()),
        false => Err(Failure::Work(
            "no settings were found that reach the target, and the image was rendered with the nearest: give a longer \
             `--pilot` or another target"
                .into(),
        )),
    }
}

/// Returns an error if the image contains NaNs or infinities.
fn check_finite(stats: &RenderStats) -> Result<(), Failure> {
    match stats.image.non_finite_pixels {
        0 => Ok(()),
        n => Err(Failure::Work(format!(
            "{n} pixels of {} are not finite: check {} for extreme light intensities",
            stats.image.path.display(),
            stats.scene.path.display()
        ))),
    }
}

/// Writes the statistics of the finished images: in a file one object for one scene, a list for several; on standard
/// output a table of the last.
fn write_stats(job: &RenderJob, finished: &[RenderStats], progress: &Progress) -> Result<(), Failure> {
    let path = match &job.stats {
        None => return Ok(()),
        Some(StatsDestination::File(path)) => path,
        Some(StatsDestination::Stdout) => {
            let table = finished.last().map(table::ledger);
            return progress.suspend(|| output::print(&table.unwrap_or_default()));
        }
    };
    interrupt::without_interruption(|| match finished {
        [one] if job.targets.len() == 1 => output::write_json(path, one),
        several => output::write_json(path, &several),
    })
}

/// Returns the statistics of an image, without its times and its camera's name.
fn stats(
    (request, target, resolved): (&RenderRequest, &Target, &ResolvedSettings),
    scene: &Scene,
    accel: &dyn Accel,
    rendering: &Rendering,
) -> RenderStats {
    let report = accel.report();
    // Times and the camera's name are filled in by the caller
    RenderStats {
        version: env!("CARGO_PKG_VERSION"),
        scene: SceneStats::of(scene, &target.scene),
        image: ImageStats {
            path: target.image.clone(),
            width: rendering.image.width,
            height: rendering.image.height,
            camera: String::new(),
            ambient: scene.ambient,
            exposure_ev: resolved.tone.exposure_ev,
            non_finite_pixels: rendering.image.non_finite_count(),
        },
        spp: resolved.settings.spp,
        samples: rendering.samples,
        depth: resolved.settings.depth,
        cutoff: CutoffStats::of(&rendering.ledger, rendering.samples.total),
        backend: request.backend(),
        precision: request.tracing.path().precision,
        threads: request.tracing.threads,
        seconds: PhaseSeconds::default(),
        rays: RayCounts::of(&rendering.ledger),
        effects: effect_stats(rendering),
        ledger: LedgerStats::of(&rendering.ledger, &rendering.memory),
        subsurface: rendering.subsurface,
        error: rendering.error,
        accel: AccelStats {
            bytes: report.bytes,
            peak_bytes: report.peak_bytes,
            summary: report.summary,
        },
        embree: report.embree,
        peak_memory_bytes: memory::peak_bytes(),
    }
}
