//! Measurement of one scene after another, with a report after each.

use std::path::Path;

use super::job::BenchJob;
use super::sweep::{self, Room};
use crate::cli::args::BenchArgs;
use crate::cli::failure::Failure;
use crate::cli::progress::{Progress, Verbosity};
use whit::batch::request::{choose_camera, load_scene};
use whit::bench::{BenchError, BenchOptions, MeasuredScene};
use whit::gltf::LoadOptions;
use whit::parallel;
use whit::scene::Scene;
use whit::scene_file::{Output, SceneFile};

/// Source of a scene to measure.
pub(super) enum Subject<'a> {
    /// Scene file at this path.
    File(&'a Path),
    /// Generated mesh of about this many triangles.
    Made(u64),
}

impl<'a> Subject<'a> {
    /// Returns the scene files that the arguments name.
    pub(super) fn files(args: &'a BenchArgs) -> Vec<Subject<'a>> {
        args.scenes.iter().map(|path| Subject::File(path)).collect()
    }

    /// Returns the name of the scene in the rows.
    fn name(&self) -> String {
        match self {
            Subject::File(path) => path.display().to_string(),
            Subject::Made(triangles) => sweep::name(*triangles),
        }
    }

    fn scene(&self) -> Result<(Scene, Output), Failure> {
        match self {
            Subject::File(path) => {
                let SceneFile { scene, output, .. } = load_scene(path, &[], &LoadOptions::default())?;
                Ok((scene, output))
            }
            Subject::Made(triangles) => Ok((sweep::scene(*triangles)?, Output::default())),
        }
    }
}

/// Measures each scene with `measure` and returns the rows of all scenes. After each, `report` receives its rows, and
/// all rows so far, so that later failures lose nothing.
pub(super) fn measure_scenes<Row>(
    args: &BenchArgs,
    subjects: &[Subject],
    measure: impl Fn(&MeasuredScene, &BenchOptions) -> Result<Vec<Row>, BenchError>,
    report: impl Fn(&[Row], &[Row]) -> Result<(), Failure>,
) -> Result<Vec<Row>, Failure> {
    let job = BenchJob::new(args)?;
    let (pool, accel) = (job.tracing.pool()?, job.tracing.options());
    let progress = Progress::new(Verbosity::Normal);
    let mut rows = Vec::new();
    for subject in subjects {
        let name = subject.name();
        // Measure less of a sweep where memory is short, and end it where it does not suffice
        let room = match subject {
            Subject::Made(triangles) => Room::of(*triangles),
            Subject::File(_) => Room::All,
        };
        if let Room::Nothing(words) = &room {
            progress.warn(words);
            break;
        }
        if let Room::OnePrecision = &room {
            progress.warn(&format!(
                "{name}: memory is short, so Embree is measured at the requested precision alone"
            ));
        }
        // Load or generate the scene
        progress.phase(&name, "load");
        let (scene, output) = parallel::install(&pool, || subject.scene())?;
        let measured = MeasuredScene {
            name: &name,
            settings: job.settings(&output)?,
            camera: choose_camera(&scene, Path::new(&name), None)?,
            scene: scene.validate()?,
        };
        for warning in &scene.warnings {
            progress.warn(&format!("{name}: {warning}"));
        }
        // Measure and report it
        progress.phase(&name, "build");
        let of_scene = progress.observe(|observer| {
            let options = BenchOptions {
                accel: &accel,
                all_precisions: matches!(room, Room::All),
                repeat: args.repeat as usize,
                pool: &pool,
                scaling: &job.scaling,
                observer,
            };
            measure(&measured, &options)
        })?;
        let first = rows.len();
        rows.extend(of_scene);
        progress.suspend(|| report(&rows[first..], &rows))?;
    }
    progress.clear();
    Ok(rows)
}
