//! Forecast of a batch: a list of its frames with their costs, and a script for a cluster.

use std::path::{Path, absolute};

use whit::batch::slurm::{SlurmTask, script};
use whit::image::write_atomically;
use whit::render::{self, Monitor};
use whit::report::forecast::Forecast;
use whit::report::memory;

use super::super::args::BatchArgs;
use super::super::failure::Failure;
use super::super::interrupt;
use super::super::output;
use super::super::progress::Progress;
use super::built_scene::{BuiltScene, LoadedScene, SceneCaches};
use super::plan::Plan;
use super::progress::progress;
use super::row_schedule::film_bytes;

/// Forecast cost of a frame.
#[derive(Clone, Copy)]
struct FrameCost {
    /// Seconds of processor time, summed over threads.
    seconds: f64,
    /// Additional seconds of the first frame of a scene, for loading and building.
    setup_seconds: f64,
    bytes: u64,
    size: [u32; 2],
    spp: u32,
}

/// Prints the frames with their forecast time and memory, and the totals.
pub(super) fn list(args: &BatchArgs, plans: &[Plan]) -> Result<(), Failure> {
    let threads = rayon::current_num_threads() as f64;
    // Print one line per frame
    let mut total = 0.0;
    let mut most = 0;
    for (plan, cost) in plans.iter().zip(costs(plans, args)?) {
        let [width, height] = cost.size;
        let seconds = cost.seconds / threads;
        total += seconds + cost.setup_seconds;
        most = most.max(cost.bytes);
        let from = plan
            .frame
            .camera
            .as_ref()
            .map_or_else(String::new, |camera| format!(", camera {camera}"));
        let edits: String = plan.frame.edits.iter().map(|edit| format!(", {edit}")).collect();
        // Costs are processor times, divided evenly among the threads here
        output::print(&format!(
            "{}: {}{from}{edits}, {width}x{height}, {} samples per pixel: about {seconds:.2} s, {}\n",
            plan.name(),
            plan.frame.scene.display(),
            cost.spp,
            memory::in_words(cost.bytes)
        ))?;
    }
    // Print the totals
    output::print(&format!(
        "{} frames: about {} on {threads} threads, up to {}\n",
        plans.len(),
        in_words(total),
        memory::in_words(most)
    ))
}

/// Writes the Slurm script for a batch.
pub(super) fn write_script(args: &BatchArgs, path: &Path, plans: &[Plan]) -> Result<(), Failure> {
    // Forecast the rendering time per shard
    let threads = rayon::current_num_threads() as u32;
    let costs = costs(plans, args)?;
    let pieces: usize = plans.iter().map(Plan::piece_count).sum();
    let shards = args.shards.min(u32::try_from(pieces).unwrap_or(u32::MAX)).max(1);
    let rendering: f64 = costs.iter().map(|cost| cost.seconds / f64::from(threads)).sum();
    // Each shard loads the scenes of its own frames; in the worst case it loads one more than its share, the slowest.
    let setup_seconds: f64 = costs.iter().map(|cost| cost.setup_seconds).sum::<f64>() / f64::from(shards);
    let slowest = costs.iter().map(|cost| cost.setup_seconds).fold(0.0, f64::max);
    // Use absolute paths, as the nodes may have another working directory
    let unknown = |error| Failure::Work(format!("cannot find the path of whit for the script: {error}"));
    let program = std::env::current_exe().map_err(unknown)?;
    let [jobs, folder] = [&args.jobs, &args.out].map(|path| absolute(path).unwrap_or_else(|_| path.clone()));
    let mut arguments = vec!["--checkpoint".to_owned(), args.checkpoint.to_string()];
    if let Some(seconds) = args.time {
        arguments.extend(["--time".to_owned(), seconds.to_string()]);
    }
    // Write the script with the time and the memory of the most expensive shard
    let text = script(&SlurmTask {
        program: &program,
        jobs: &jobs,
        folder: &folder,
        shards,
        threads,
        seconds: rendering / f64::from(shards) + setup_seconds + slowest,
        bytes: costs.iter().map(|cost| cost.bytes).max().unwrap_or(0),
        arguments: &arguments,
    });
    interrupt::without_interruption(|| {
        write_atomically(path, |file| std::io::Write::write_all(file, text.as_bytes()))
    })?;
    if args.quiet {
        return Ok(());
    }
    output::print(&format!(
        "{}: {shards} tasks; submit the script with `sbatch`\n",
        path.display()
    ))
}

/// Returns the forecast costs of all frames; of frames that share a scene only the first is probed.
fn costs(plans: &[Plan], args: &BatchArgs) -> Result<Vec<FrameCost>, Failure> {
    let progress = progress(args);
    let kept = SceneCaches::for_frames(plans);
    let mut costs: Vec<FrameCost> = Vec::with_capacity(plans.len());
    for (index, plan) in plans.iter().enumerate() {
        let before = index.checked_sub(1).and_then(|before| plans.get(before));
        // Frames of the same scene have the cost of the first, without loading and building
        match (
            before.filter(|before| before.shares_scene_with(plan)),
            costs.last(),
        ) {
            (Some(_), Some(&cost)) => costs.push(FrameCost {
                setup_seconds: 0.0,
                ..cost
            }),
            _ => costs.push(probe_frame(plan, &kept, (args, &progress))?),
        }
        progress.fraction(index as f64 / plans.len() as f64);
    }
    progress.clear();
    Ok(costs)
}

fn probe_frame(
    plan: &Plan,
    kept: &SceneCaches,
    (args, progress): (&BatchArgs, &Progress),
) -> Result<FrameCost, Failure> {
    // Load and build the scene as for rendering, then probe a few pixels
    progress.phase(&plan.name(), "probe");
    let loaded = LoadedScene::new(plan, kept, progress)?;
    let stage = BuiltScene::new(plan, &loaded, kept)?;
    let resolved = plan.request.resolved(&loaded.file.output)?;
    let camera = loaded.camera(plan)?;
    let monitor = Monitor {
        cancel: &interrupt::CANCELLED,
        ..Monitor::default()
    };
    let probe = render::probe(
        (stage.scene, &camera),
        &*stage.accel,
        &resolved.settings,
        &monitor,
    )?;
    let forecast = Forecast::of(&probe, &resolved.settings, plan.request.backend);
    let bytes = loaded.forecast(&plan.request);
    Ok(FrameCost {
        seconds: forecast.seconds,
        setup_seconds: loaded.seconds + stage.build_seconds,
        bytes: kept.bytes()
            + bytes.loaded
            + bytes.to_come
            + film_bytes(&loaded.film(&resolved.settings), args.time),
        size: [resolved.settings.width, resolved.settings.height],
        spp: resolved.settings.spp,
    })
}

/// Returns a duration in hours, minutes or seconds with one decimal.
fn in_words(seconds: f64) -> String {
    const MINUTE: f64 = 60.0;
    const HOUR: f64 = 3600.0;
    match seconds {
        seconds if seconds >= HOUR => format!("{:.1} h", seconds / HOUR),
        seconds if seconds >= MINUTE => format!("{:.1} min", seconds / MINUTE),
        seconds => format!("{seconds:.1} s"),
    }
}
