//! Measurement of one scene after another, with a report after each.

use std::path::Path;

use rayon::ThreadPool;
use serde::Serialize;

use super::job::BenchJob;
use super::sweep;
use crate::cli::args::BenchArgs;
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::cli::job::choose_camera;
use crate::cli::output;
use crate::cli::progress::{Progress, Verbosity};
use crate::cli::scene;
use whit::parallel;
use whit::render::RenderSettings;
use whit::scene::{Camera, EffectSet, Scene};
use whit::scene_file::{Output, SceneFile};

/// Writes all rows as JSON if the arguments request it.
pub(in crate::cli) fn write_json(args: &BenchArgs, rows: &[impl Serialize]) -> Result<(), Failure> {
    match &args.json {
        Some(path) => interrupt::without_interruption(|| output::write_json(path, &rows)),
        None => Ok(()),
    }
}

/// Source of a scene to measure.
pub(in crate::cli) enum Subject<'a> {
    /// Scene file at this path.
    File(&'a Path),
    /// Generated mesh of about this many triangles.
    Made(u64),
}

impl<'a> Subject<'a> {
    /// Returns the scene files that the arguments name.
    pub(in crate::cli) fn files(args: &'a BenchArgs) -> Vec<Subject<'a>> {
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
                let SceneFile { scene, output, .. } = scene::load((path, &[], None), EffectSet::NONE)?;
                Ok((scene, output))
            }
            Subject::Made(triangles) => Ok((sweep::scene(*triangles)?, Output::default())),
        }
    }
}

/// Scene to measure, with its camera and settings.
pub(in crate::cli) struct BenchScene<'s> {
    pub(in crate::cli) path: &'s Path,
    pub(in crate::cli) name: &'s str,
    pub(in crate::cli) scene: &'s Scene,
    pub(in crate::cli) camera: &'s Camera,
    pub(in crate::cli) settings: RenderSettings,
}

/// Functions that output the rows.
pub(in crate::cli) struct Reporter<Table, Write> {
    /// Function that formats the rows of one scene as a table for the terminal.
    pub(in crate::cli) table: Table,
    /// Function that writes all rows so far; called after each scene, so that later failures lose nothing.
    pub(in crate::cli) write: Write,
}

/// Measures each scene with `measure` and reports its rows; returns the rows of all scenes.
pub(in crate::cli) fn measure_scenes<Row>(
    args: &BenchArgs,
    subjects: &[Subject],
    measure: impl Fn(&BenchJob, BenchScene, &ThreadPool, &Progress) -> Result<Vec<Row>, Failure>,
    reporter: Reporter<impl Fn(&[Row]) -> String, impl Fn(&[Row]) -> Result<(), Failure>>,
) -> Result<Vec<Row>, Failure> {
    let job = BenchJob::new(args)?;
    let pool = job.tracing.pool()?;
    let progress = Progress::new(Verbosity::Normal);
    let mut rows = Vec::new();
    for subject in subjects {
        let name = subject.name();
        // End the sweep where the memory does not suffice
        if let Subject::Made(triangles) = subject
            && let Some(words) = sweep::lacks_memory(*triangles)
        {
            progress.warn(&words);
            break;
        }
        // Load or generate the scene
        progress.phase(&name, "load");
        let (scene, output) = parallel::install(&pool, || subject.scene())?;
        let path = Path::new(&name);
        let bench_scene = BenchScene {
            path,
            name: &name,
            settings: job.settings(&output)?,
            camera: choose_camera(&scene, path, None)?,
            scene: &scene,
        };
        for warning in &scene.warnings {
            progress.warn(&format!("{name}: {warning}"));
        }
        // Measure and report it
        let of_scene = measure(&job, bench_scene, &pool, &progress)?;
        progress.suspend(|| output::print(&(reporter.table)(&of_scene)))?;
        rows.extend(of_scene);
        (reporter.write)(&rows)?;
    }
    progress.clear();
    Ok(rows)
}
