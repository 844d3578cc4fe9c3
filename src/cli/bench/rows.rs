//! Rows of measurements of one scene, one for each set of rays and contestant.

use std::path::Path;

use rayon::ThreadPool;

use super::job::BenchJob;
use super::scenes::BenchScene;
use super::seconds::Seconds;
use super::structures::{Contestant, Structures};
use super::times::{Frame, Times};
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::cli::progress::Progress;
use crate::cli::replay::{Differences, RayWorkload, differences};
use whit::report::bench::{BenchRow, Scaled, ScaledBuild, Spread};

/// Measures one scene and returns its rows.
pub(super) fn bench_scene(
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
    fn slowest_run_has_the_lowest_speed() {
        // Four million rays in 1, 2 and 4 seconds give 4, 2 and 1 million rays per second.
        let spread = speed(4_000_000, &[2.0, 4.0, 1.0]);
        let (median, min, max) = (2.0, 1.0, 4.0);
        assert_eq!(spread, Spread { median, min, max });
    }
}
