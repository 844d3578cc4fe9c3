//! Speeds of all backends and modes on the rays of one scene.

use super::error::{BenchError, check};
use super::options::{BenchOptions, MeasuredScene};
use super::ray_workload::RayWorkload;
use super::replay::{Differences, differences};
use super::rows::{BenchRow, Scaled, ScaledBuild};
use super::structures::{Contestant, Structure, time_builds};
use super::times::Times;
use crate::measure::Interval;

/// Measures all backends on the rays of a scene and returns a row for each set of rays and tracing method.
///
/// # Errors
///
/// Returns an error where an acceleration structure cannot be built, and on cancellation.
pub fn measure_backends(
    measured: &MeasuredScene,
    options: &BenchOptions,
) -> Result<Vec<BenchRow>, BenchError> {
    let scene = measured.scene.get();
    let step = |step| (options.observer.progress)(step, 0.0);
    // Build all acceleration structures, and again to time it
    step("build");
    let structures = Structure::all(scene, options)?;
    let builds = time_builds(scene, &structures, options)?;
    let contestants = Contestant::all(&structures);
    // Record the rays of the frame with the first one
    step("record");
    let sets = RayWorkload::all(measured, structures[0].accel());
    // Replay the rays through each, and render the frame
    let times = Times::measure(measured, &sets, &structures, &contestants, options)?;
    // Compare the hits with those of the reference, and make the rows
    step("compare");
    let ways = 1 + options.scaling.len();
    let mut rows = Vec::with_capacity(sets.len() * contestants.len());
    for (set, rays) in sets.iter().enumerate() {
        for (index, contestant) in contestants.iter().enumerate() {
            check(options.observer)?;
            // The first contestant is the reference and is not compared with itself.
            let reference = contestant.reference(&contestants);
            let differ = match index {
                0 => Differences::default(),
                _ => differences(scene, rays, reference.engine, contestant.engine),
            };
            let structure = &structures[contestant.structure];
            let report = structure.accel().report();
            let speed = |way| times.speed(set, index, way);
            let build = |way| Interval::of_extremes(&builds.seconds(contestant.structure * ways + way));
            let threads = |way: usize| options.scaling[way - 1].current_num_threads();
            rows.push(BenchRow {
                scene: measured.name.into(),
                triangles: measured.scene.triangle_count() as u64,
                backend: structure.backend,
                instancing: structure.instancing(),
                precision: structure.precision(),
                rays: rays.kind,
                mode: contestant.mode,
                mrays_per_s: speed(0).value,
                mrays_per_s_min: speed(0).low,
                mrays_per_s_max: speed(0).high,
                ray_count: rays.ray_count,
                build_seconds: build(0).value,
                build_seconds_min: build(0).low,
                build_seconds_max: build(0).high,
                bytes: report.bytes,
                mismatches: differ.wrong,
                ties: differ.ties,
                threads: options.pool.current_num_threads(),
                waiting: times.waiting(),
                embree: report.embree,
                frame: times.frame(index),
                scaling: (1..ways)
                    .map(|way| Scaled {
                        threads: threads(way),
                        mrays_per_s: speed(way).value,
                        mrays_per_s_min: speed(way).low,
                        mrays_per_s_max: speed(way).high,
                    })
                    .collect(),
                build_scaling: (1..ways)
                    .map(|way| ScaledBuild {
                        threads: threads(way),
                        build_seconds: build(way).value,
                        build_seconds_min: build(way).low,
                        build_seconds_max: build(way).high,
                    })
                    .collect(),
            });
        }
    }
    Ok(rows)
}
