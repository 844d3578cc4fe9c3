//! Command `whit radiosity`: solves for the diffuse light of a scene and bakes it into a glTF file.

use std::path::Path;

use whit::accel::{self, AccelError, AccelOptions, Backend, Precision};
use whit::batch::request::{TracingOptions, load_scene};
use whit::gltf::{UnlitScene, write_unlit};
use whit::image::{check_writable, write_atomically};
use whit::mesh::Mesh;
use whit::parallel;
use whit::render::Monitor;
use whit::render::radiosity::{
    self, Bake, ElementScene, MAX_SWEEPS, RadiosityError, RadiosityReport, RadiositySettings,
};
use whit::scene::image_settings::DEFAULT_SIZE;

use super::args::RadiosityArgs;
use super::failure::Failure;
use super::interrupt;
use super::progress::{Progress, Verbosity};

/// Bakes the scene of the arguments, and prints the errors of the solution.
pub(super) fn run(args: &RadiosityArgs) -> Result<(), Failure> {
    // Check the flags and the output file before the scene is opened
    let backend = args.backend.unwrap_or_default();
    if backend == Backend::Embree && !cfg!(feature = "embree") {
        return Err(AccelError::NoEmbree.into());
    }
    check_out(&args.out)?;
    let tracing = TracingOptions::of_threads(args.threads);
    let progress = Progress::of_kind(args.format.progress, Verbosity::of_flag(args.quiet));
    let report = parallel::install(&tracing.pool()?, || {
        bake(args, backend, tracing.threads, &progress)
    });
    progress.clear();
    progress.result(&report?)
}

/// Returns an error if the file cannot be written or is no binary glTF by its name.
fn check_out(path: &Path) -> Result<(), Failure> {
    if !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb")) {
        return Err(Failure::Input(format!(
            "a bake is a binary glTF file: change the file name {} to end in .glb",
            path.display()
        )));
    }
    Ok(check_writable(path)?)
}

/// Loads and solves a scene, writes the bake, and returns the report.
fn bake(
    args: &RadiosityArgs,
    backend: Backend,
    threads: usize,
    progress: &Progress,
) -> Result<String, Failure> {
    let name = args.scene.display().to_string();
    let settings = RadiositySettings {
        rays: args.rays,
        tolerance: args.tolerance,
    };
    // Load the scene and divide its surfaces
    progress.phase(&name, "load");
    let loaded = load_scene(&args.scene, &[], &args.gltf.load_options())?;
    loaded.scene.validate()?;
    for warning in &loaded.scene.warnings {
        progress.warn(&format!("{name}: {warning}"));
    }
    interrupt::check()?;
    progress.phase(&name, "divide");
    let failed = |error: RadiosityError| Failure::Input(format!("{name}: {error}"));
    let elements = ElementScene::new(loaded.scene, args.elements as usize).map_err(failed)?;
    settings.check_memory(&elements).map_err(failed)?;
    for warning in &elements.warnings {
        progress.warn(&format!("{name}: {warning}"));
    }
    // Build the acceleration structure, closed at all edges
    progress.phase(&name, "build");
    let scene = elements.scene.validate()?;
    let options = AccelOptions {
        precision: Precision::Watertight,
        threads,
        ..AccelOptions::default()
    };
    let accel = accel::build(scene, backend, &options)?;
    interrupt::check()?;
    // Solve
    progress.phase(&name, "solve");
    let monitor = Monitor {
        progress: &|fraction| progress.fraction(fraction),
        cancel: &interrupt::CANCELLED,
        ..Monitor::default()
    };
    let solution = radiosity::solve(&elements, scene, &*accel, &settings, &monitor)?;
    if !solution.report.has_converged {
        progress.warn(&format!(
            "{name}: {MAX_SWEEPS} sweeps do not reach the tolerance, because surfaces absorb too little light: give a \
             larger `--tolerance` or darker materials"
        ));
    }
    // Write the file
    progress.phase(&name, "write");
    let bake = Bake::new(&elements, &solution);
    let meshes: Vec<(&str, &Mesh)> = bake
        .meshes
        .iter()
        .map(|baked| (&*baked.name, &baked.mesh))
        .collect();
    let [width, height] = loaded.output.size.unwrap_or(DEFAULT_SIZE).map(f64::from);
    let content = UnlitScene {
        meshes: &meshes,
        cameras: &elements.scene.cameras,
        file_from_world: elements.scene.normalisation.inverse_map(),
        aspect: width / height,
        white: bake.white,
    };
    interrupt::without_interruption(|| write_atomically(&args.out, |file| write_unlit(&content, file)))?;
    Ok(text(&solution.report, &bake))
}

/// Returns the report as text, one line for each figure.
fn text(report: &RadiosityReport, bake: &Bake) -> String {
    let percent = |fraction: f64| format!("{:.3} %", 100.0 * fraction);
    let energy = report.energy;
    let of_emitted = |power: f64| {
        percent(if energy.emitted > 0.0 {
            power / energy.emitted
        } else {
            0.0
        })
    };
    let rows = [
        (
            "triangles",
            format!("{} in {} meshes", report.elements, bake.meshes.len()),
        ),
        ("rays", format!("{} from each side of a triangle", report.rays)),
        ("sweeps", report.sweeps.to_string()),
        (
            "remaining light",
            format!(
                "{} of the power of all sources, estimated",
                percent(report.remaining)
            ),
        ),
        (
            "sampling error",
            format!(
                "{} of the mean radiosity (RMS of a triangle)",
                percent(report.sampling_error)
            ),
        ),
        (
            "energy",
            format!(
                "{} absorbed, {} escaped, {} unaccounted for",
                of_emitted(energy.absorbed),
                of_emitted(energy.escaped),
                percent(energy.imbalance())
            ),
        ),
        (
            "white",
            format!(
                "radiance {:.4}; {} of the lit area is brighter and clipped",
                bake.white,
                percent(bake.clipped)
            ),
        ),
    ];
    let lines = rows.iter().map(|(name, value)| format!("{name:16} {value}\n"));
    lines.collect()
}
