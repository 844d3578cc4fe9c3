//! Command `whit verify SCENE`: cross-checks the scene's own rays on all backends, and reports defects of its meshes.

use std::collections::BTreeMap;
use std::path::Path;

use whit::accel::{self, Accel, AccelOptions, Backend, Precision};
use whit::batch::request::{TracingOptions, choose_camera, load_scene, render_settings};
use whit::gltf::LoadOptions;
use whit::image::{self, ImageFormat, LinearImage, ToneMap, check_writable};
use whit::parallel;
use whit::render::{self, Monitor, RenderSettings};
use whit::report::cross_check::{CrossCheckReport, PairReport};
use whit::report::{cross_check_page, overlay};
use whit::scene::{Camera, Geometry, Scene, ValidScene};
use whit::scene_file::{Output, SceneFile};
use whit::verify::{Difference, MeshDiagnostics, RayKind, RaysFile, cross_check};

use super::args::VerifyArgs;
use super::failure::Failure;
use super::interrupt;
use super::output;
use super::progress::{Progress, Verbosity};

/// Samples per pixel of the image that differences are drawn over.
const OVERLAY_SPP: u32 = 4;

/// Checks each scene that the arguments name.
pub(super) fn run(args: &VerifyArgs) -> Result<(), Failure> {
    check_outputs(args)?;
    let tracing = TracingOptions::of_threads(args.threads);
    let pool = tracing.pool()?;
    let progress = Progress::new(Verbosity::Normal);
    let options = AccelOptions {
        precision: args.precision,
        threads: tracing.threads,
        isa: args.isa.clone(),
        ..AccelOptions::default()
    };
    let mut checked = Vec::new();
    // Load and check each scene
    for path in &args.scenes {
        interrupt::check()?;
        let name = path.display().to_string();
        progress.phase(&name, "load");
        let load = || load_scene(path, &[], &LoadOptions::default());
        let done = parallel::install(&pool, load)
            .map_err(Failure::from)
            .and_then(|file| {
                progress.phase(&name, "compare");
                parallel::install(&pool, || check(path, &file, args, &options))
            });
        match done {
            Ok(done) => {
                progress.suspend(|| output::print(&done.report.text()))?;
                checked.push(done);
            }
            // A scene that fails does not keep the others from being checked.
            Err(failure) if args.scenes.len() > 1 && !matches!(failure, Failure::Interrupted) => {
                progress.suspend(|| failure.print());
            }
            Err(failure) => return Err(failure),
        }
    }
    // Write the files, then decide on the exit code
    progress.clear();
    write(args, &checked)?;
    verdict(args, &checked)
}

/// Checks the output flags, before any scene is opened.
fn check_outputs(args: &VerifyArgs) -> Result<(), Failure> {
    let of_one = [
        ("--overlay", &args.overlay),
        ("--rays-out", &args.rays_out),
        ("--replay", &args.replay),
    ];
    if let Some((flag, _)) = of_one.iter().find(|(_, file)| file.is_some())
        && args.scenes.len() > 1
    {
        return Err(Failure::Input(format!(
            "`{flag}` applies to a single scene: give one scene"
        )));
    }
    if let Some(path) = &args.overlay
        && ImageFormat::of_path(path) != Some(ImageFormat::Png)
    {
        return Err(Failure::Input(format!(
            "an overlay is a PNG: change the file name {} to end in .png",
            path.display()
        )));
    }
    for path in [&args.json, &args.html, &args.overlay, &args.rays_out]
        .into_iter()
        .flatten()
    {
        check_writable(path)?;
    }
    Ok(())
}

/// Scene that was checked, with its report.
struct Checked {
    report: CrossCheckReport,
    /// Image with the differences drawn over it, if requested.
    overlay: Option<LinearImage>,
    /// Numbers of instances, and of triangles and shape primitives.
    holds: [u64; 2],
}

fn check(
    path: &Path,
    SceneFile { scene, output, .. }: &SceneFile,
    args: &VerifyArgs,
    options: &AccelOptions,
) -> Result<Checked, Failure> {
    // Determine the frame whose rays are checked
    let requested = Output {
        size: args.size.map(|size| [size.width, size.height]),
        ..Output::default()
    };
    let settings = RenderSettings {
        spp: 1,
        adaptive: None,
        ..render_settings(&requested.or(output))?
    };
    let scene = scene.validate()?;
    let camera = choose_camera(scene.get(), path, None)?;
    // Record the rays of the frame on Embree, or without Embree on brute force
    let first = match Backend::default() {
        Backend::Embree => accel::build(scene, Backend::Embree, options)?,
        _ => accel::build(scene, Backend::Brute, options)?,
    };
    let recorded = render::record(scene, camera, &*first, &settings);
    let packets = [recorded.camera, recorded.shadow, recorded.reflection];
    // Trace them with each other backend; only two structures are in memory at a time
    let exact = AccelOptions {
        precision: Precision::Watertight,
        ..options.clone()
    };
    let mut pairs = Vec::new();
    for backend in [Backend::Bsp, Backend::Native] {
        interrupt::check()?;
        let second = accel::build(scene, backend, &exact)?;
        let accels: [&dyn Accel; 2] = [&*first, &*second];
        let mut rays = BTreeMap::new();
        for (kind, packets) in RayKind::ALL.into_iter().zip(&packets) {
            interrupt::check()?;
            rays.insert(kind.word(), cross_check(&scene, accels, packets, kind));
        }
        let backends = accels.map(|accel| accel.report().summary);
        pairs.push(PairReport { backends, rays });
    }
    let report = CrossCheckReport {
        scene: path.to_owned(),
        pairs,
        embree: first.report().embree,
        meshes: mesh_diagnostics(&scene),
        warnings: scene.warnings.clone(),
    };
    // Draw the differences over the image
    let overlay = if args.overlay.is_some() || args.html.is_some() {
        Some(draw(&report, (scene, camera), &*first, settings)?)
    } else {
        None
    };
    Ok(Checked {
        report,
        overlay,
        holds: holds(&scene),
    })
}

/// Returns the image with the differences drawn over it.
fn draw(
    report: &CrossCheckReport,
    (scene, camera): (ValidScene, &Camera),
    accel: &dyn Accel,
    settings: RenderSettings,
) -> Result<LinearImage, Failure> {
    let settings = RenderSettings {
        spp: OVERLAY_SPP,
        ..settings
    };
    let monitor = Monitor {
        cancel: &interrupt::CANCELLED,
        ..Monitor::default()
    };
    let rendering = render::render(scene, camera, accel, &settings, &monitor)?;
    let view = camera.view(settings.width, settings.height);
    let differences: Vec<&Difference> = report.differences().collect();
    Ok(overlay::draw(&rendering.image, &view, &differences))
}

/// Returns the numbers of instances, and of triangles and shape primitives.
pub(super) fn holds(scene: &Scene) -> [u64; 2] {
    let primitives = scene.geometries.iter().map(Geometry::primitive_count);
    [scene.instances.len() as u64, primitives.sum::<usize>() as u64]
}

/// Returns the defects of all meshes together, each mesh counted once.
fn mesh_diagnostics(scene: &Scene) -> MeshDiagnostics {
    let meshes = scene.geometries.iter().filter_map(|geometry| match geometry {
        Geometry::Mesh(mesh) => Some(MeshDiagnostics::of(mesh)),
        Geometry::Shape(_) | Geometry::Points(_) => None,
    });
    meshes.fold(MeshDiagnostics::default(), MeshDiagnostics::with)
}

/// Writes all files that the arguments request.
fn write(args: &VerifyArgs, checked: &[Checked]) -> Result<(), Failure> {
    // JSON report
    if let Some(path) = &args.json {
        let reports: Vec<&CrossCheckReport> = checked.iter().map(|done| &done.report).collect();
        interrupt::without_interruption(|| output::write_json(path, &reports))?;
    }
    // HTML page
    if let Some(path) = &args.html {
        let scenes: Vec<cross_check_page::Part> = checked
            .iter()
            .map(|done| cross_check_page::Part {
                report: &done.report,
                overlay: done.overlay.as_ref(),
            })
            .collect();
        let page = cross_check_page::page(&scenes, args.date.as_deref());
        interrupt::without_interruption(|| output::write_text(path, &page))?;
    }
    // Overlay and recorded rays, which are for a single scene
    for done in checked {
        if let (Some(path), Some(overlay)) = (&args.overlay, &done.overlay) {
            interrupt::without_interruption(|| {
                image::write(overlay, path, ImageFormat::Png, ToneMap::default())
            })?;
        }
        if let Some(path) = &args.rays_out {
            let file = RaysFile {
                scene: done.report.scene.display().to_string(),
                holds: done.holds,
                pairs: done.report.pairs.iter().map(PairReport::rays_file_part).collect(),
            };
            interrupt::without_interruption(|| output::write_text(path, &file.text()))?;
        }
    }
    Ok(())
}

/// Returns an error if a scene could not be checked, or if backends differ by more than rounding.
fn verdict(args: &VerifyArgs, checked: &[Checked]) -> Result<(), Failure> {
    // Differences beyond rounding are failures
    let wrong = checked.iter().filter(|done| done.report.is_wrong()).count();
    if wrong > 0 {
        return Err(Failure::Work(format!(
            "backends differ by more than rounding in {wrong} of {} scenes",
            checked.len()
        )));
    }
    // So are scenes that could not be checked
    match args.scenes.len() - checked.len() {
        0 => Ok(()),
        failed => Err(Failure::Some {
            failed,
            total: args.scenes.len(),
        }),
    }
}
