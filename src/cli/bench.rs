//! Command `whit bench`: compares Embree and the BSP on the same recorded rays.

mod structures;
mod sweep;
mod times;

use std::path::Path;

use rayon::ThreadPool;
use serde::Serialize;

use crate::accel::{AccelError, Instancing, RayPacket};
use crate::image::check_writable;
use crate::numeric::LANES;
use crate::parallel;
use crate::render::RenderSettings;
use crate::report::bench::{BenchRow, BenchTable, Scaled, ScaledBuild, Spread};
use crate::report::{bench_page, crossover, memory};
use crate::scene::{Camera, EffectSet, Scene};
use crate::scene_file::{Output, SceneFile};

use super::args::{BenchArgs, DEFAULT_BENCH_SPP};
use super::failure::Failure;
use super::interrupt;
use super::job::{Tracing, check_instancing, choose_camera, requested, settings};
use super::output;
use super::progress::{Progress, Verbosity};
use super::replay::{Differences, RayWorkload, differences};
use super::scene;
use structures::{Contestant, Structures};
use times::{Frame, Seconds, Times};

/// Checked parameters of `whit bench` for all scenes.
pub(super) struct BenchJob {
    /// Image settings of the command line; the scene may give those that are absent.
    requested: Output,
    pub(super) tracing: Tracing,
    pub(super) repeat: u32,
    /// Thread pools of the scaling measurement, fewest threads first; empty without `--scaling`.
    scaling: Vec<ThreadPool>,
}

impl BenchJob {
    /// Checks the arguments and starts the thread pools.
    pub(super) fn new(args: &BenchArgs) -> Result<BenchJob, Failure> {
        let tracing = Tracing::new(&args.tracing);
        // Start a pool for each thread count of the scaling measurement
        let counts = match args.scaling {
            true => thread_counts(tracing.threads),
            false => Vec::new(),
        };
        let pool = |threads| Tracing::of_threads(threads).pool();
        Ok(BenchJob {
            requested: Output {
                spp: args.spp,
                ..requested(&args.frame)
            },
            tracing,
            repeat: args.repeat,
            scaling: counts.into_iter().map(pool).collect::<Result<_, _>>()?,
        })
    }

    /// Returns the render settings for a scene whose file gives the image settings `output`.
    pub(super) fn settings(&self, output: &Output) -> Result<RenderSettings, Failure> {
        let mut requested = self.requested.or(output);
        requested.spp = requested.spp.or(Some(DEFAULT_BENCH_SPP));
        let settings = settings(&requested)?;
        let (width, height, spp) = (settings.width, settings.height, settings.spp);
        // All rays are recorded, so even the camera rays must fit into memory
        let packets = u64::from(width) * u64::from(height) * u64::from(spp) / LANES as u64;
        let needed = packets * size_of::<RayPacket>() as u64;
        if let Some(free) = memory::available_bytes().filter(|&free| needed > free) {
            return Err(Failure::Input(format!(
                "the camera rays of {width}x{height} pixels with {spp} samples alone take {} of memory and {} are \
                 free: give a smaller `--size` or `--spp`",
                memory::in_words(needed),
                memory::in_words(free)
            )));
        }
        Ok(settings)
    }
}

/// Returns the powers of two below `most`, and `most`.
fn thread_counts(most: usize) -> Vec<u32> {
    let most = u32::try_from(most).unwrap_or(u32::MAX).max(1);
    let mut counts: Vec<u32> = (0..32)
        .map(|power| 1 << power)
        .take_while(|&count| count < most)
        .collect();
    counts.push(most);
    counts
}

/// Measures all scenes or generated meshes of the arguments.
pub(super) fn run(args: &BenchArgs) -> Result<(), Failure> {
    if args.extents {
        return super::bench_bounding_volumes::run(args);
    }
    // Check the output files and the flags before anything is measured
    for path in [&args.json, &args.html].into_iter().flatten() {
        check_writable(path)?;
    }
    let needs_embree = args.tracing.isa.is_some() || args.tracing.instancing != Instancing::Auto;
    if needs_embree && !cfg!(feature = "embree") {
        return Err(AccelError::NoEmbree.into());
    }
    check_instancing(&args.tracing)?;
    // List the scenes, or the generated meshes of a sweep
    let subjects = match args.sweep {
        true => sweep::sizes(args.most_triangles)
            .into_iter()
            .map(Subject::Made)
            .collect(),
        false => Subject::files(args),
    };
    // Measure each, and write the files after each
    let reporter = Reporter {
        table: |rows: &[BenchRow]| BenchTable(rows).to_string(),
        write: |rows: &[BenchRow]| write(args, rows),
    };
    let rows = measure_scenes(args, &subjects, bench_scene, reporter)?;
    if args.sweep {
        output::print(&crossover::text(&rows))?;
    }
    Ok(())
}

/// Writes the JSON file and the HTML page that the arguments request.
fn write(args: &BenchArgs, rows: &[BenchRow]) -> Result<(), Failure> {
    write_json(args, rows)?;
    let Some(path) = &args.html else { return Ok(()) };
    let facts = bench_page::Facts {
        is_sweep: args.sweep,
        repeat: args.repeat,
        date: args.date.as_deref(),
    };
    interrupt::without_interruption(|| output::write_text(path, &bench_page::page(rows, &facts)))
}

/// Writes all rows as JSON if the arguments request it.
pub(super) fn write_json(args: &BenchArgs, rows: &[impl Serialize]) -> Result<(), Failure> {
    match &args.json {
        Some(path) => interrupt::without_interruption(|| output::write_json(path, &rows)),
        None => Ok(()),
    }
}

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
                let SceneFile { scene, output, .. } = scene::load((path, &[], None), EffectSet::NONE)?;
                Ok((scene, output))
            }
            Subject::Made(triangles) => Ok((sweep::scene(*triangles)?, Output::default())),
        }
    }
}

/// Scene to measure, with its camera and settings.
pub(super) struct BenchScene<'s> {
    pub(super) path: &'s Path,
    pub(super) name: &'s str,
    pub(super) scene: &'s Scene,
    pub(super) camera: &'s Camera,
    pub(super) settings: RenderSettings,
}

/// Functions that output the rows.
pub(super) struct Reporter<Table, Write> {
    /// Function that formats the rows of one scene as a table for the terminal.
    pub(super) table: Table,
    /// Function that writes all rows so far; called after each scene, so that later failures lose nothing.
    pub(super) write: Write,
}

/// Measures each scene with `measure` and reports its rows; returns the rows of all scenes.
pub(super) fn measure_scenes<Row>(
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

/// Measures one scene and returns its rows.
fn bench_scene(
    job: &BenchJob,
    bench_scene: BenchScene,
    pool: &ThreadPool,
    progress: &Progress,
) -> Result<Vec<BenchRow>, Failure> {
    let BenchScene {
        path,
        name,
        scene,
        camera,
        settings,
    } = bench_scene;
    // Build all acceleration structures
    progress.phase(name, "build");
    let structures = Structures::build(scene, job, pool)?;
    let contestants = structures.contestants();
    // Record the rays of the frame with the first one
    progress.phase(name, "record");
    let frame = Frame {
        scene,
        camera,
        settings,
        accel: structures.first(),
    };
    let sets = frame.ray_sets();
    // Replay the rays through each, and render the frame
    progress.phase(name, "replay");
    let times = Times::measure(&contestants, &sets, &frame, job, progress)?;
    // Compare the hits with those of the reference
    progress.phase(name, "compare");
    rows(job, path, &contestants, &sets, &times, &frame)
}

/// Returns the measurements as rows, one for each ray set and contestant.
fn rows(
    job: &BenchJob,
    path: &Path,
    contestants: &[Contestant],
    sets: &[RayWorkload],
    times: &Times,
    frame: &Frame,
) -> Result<Vec<BenchRow>, Failure> {
    // Compute the frame times of the contestants
    let frame_times: Vec<_> = (0..contestants.len())
        .map(|index| times.frame(contestants, sets, index))
        .collect();
    let mut rows = Vec::with_capacity(sets.len() * contestants.len());
    // Make a row for each ray set and contestant
    for (set, of_set) in sets.iter().zip(&times.replays) {
        for ((contestant, replays), frame_time) in contestants.iter().zip(of_set).zip(&frame_times) {
            interrupt::check()?;
            // The first contestant is the reference and is not compared with itself.
            let differ = match rows.len() % contestants.len() {
                0 => Differences::default(),
                _ => differences(
                    frame.scene,
                    set,
                    contestant.reference(contestants).engine,
                    contestant.engine,
                ),
            };
            // Convert times to speeds
            let speed = speed(set.ray_count, &replays.base);
            let build = Spread::of(&contestant.builds.base);
            rows.push(BenchRow {
                scene: path.to_owned(),
                triangles: frame.scene.triangle_count() as u64,
                backend: contestant.backend,
                instancing: contestant.instancing,
                precision: contestant.precision,
                rays: set.kind,
                mode: contestant.mode,
                mrays_per_s: speed.median,
                mrays_per_s_min: speed.min,
                mrays_per_s_max: speed.max,
                ray_count: set.ray_count,
                build_seconds: build.median,
                build_seconds_min: build.min,
                build_seconds_max: build.max,
                bytes: contestant.report.bytes,
                mismatches: differ.wrong,
                ties: differ.ties,
                threads: job.tracing.threads,
                embree: contestant.report.embree.clone(),
                frame: *frame_time,
                scaling: scaling(job, replays, set.ray_count),
                build_scaling: build_scaling(job, contestant.builds),
            });
        }
    }
    Ok(rows)
}

/// Returns the speed in million rays per second.
fn speed(ray_count: u64, seconds: &[f64]) -> Spread {
    // The longest time is the smallest speed
    let speed = |seconds: f64| ray_count as f64 * 1e-6 / seconds;
    let spread = Spread::of(seconds);
    Spread {
        median: speed(spread.median),
        min: speed(spread.max),
        max: speed(spread.min),
    }
}

fn scaling(job: &BenchJob, replays: &Seconds, ray_count: u64) -> Vec<Scaled> {
    let of = |(pool, seconds): (&ThreadPool, &Vec<f64>)| {
        let speed = speed(ray_count, seconds);
        Scaled {
            threads: pool.current_num_threads(),
            mrays_per_s: speed.median,
            mrays_per_s_min: speed.min,
            mrays_per_s_max: speed.max,
        }
    };
    job.scaling.iter().zip(&replays.by_threads).map(of).collect()
}

fn build_scaling(job: &BenchJob, builds: &Seconds) -> Vec<ScaledBuild> {
    let of = |(pool, seconds): (&ThreadPool, &Vec<f64>)| {
        let build = Spread::of(seconds);
        ScaledBuild {
            threads: pool.current_num_threads(),
            build_seconds: build.median,
            build_seconds_min: build.min,
            build_seconds_max: build.max,
        }
    };
    job.scaling.iter().zip(&builds.by_threads).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thread_counts_double_up_to_the_largest() {
        assert_eq!(thread_counts(1), [1]);
        assert_eq!(thread_counts(2), [1, 2]);
        assert_eq!(thread_counts(6), [1, 2, 4, 6]);
        assert_eq!(thread_counts(8), [1, 2, 4, 8]);
    }

    #[test]
    fn slowest_run_has_the_lowest_speed() {
        // Four million rays in 1, 2 and 4 seconds give 4, 2 and 1 million rays per second.
        let spread = speed(4_000_000, &[2.0, 4.0, 1.0]);
        let (median, min, max) = (2.0, 1.0, 4.0);
        assert_eq!(spread, Spread { median, min, max });
    }
}
