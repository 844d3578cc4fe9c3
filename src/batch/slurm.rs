//! Generation of a Slurm batch script that renders a job file with one array task per shard.
//!
//! The tasks run the same command as a user would. A task that is restarted (because its node failed) resumes at the
//! last checkpoint; its predecessor, which may still be running, writes the same bits. A task whose time is nearly up
//! saves its state and is requeued, so a forecast that is too short costs waiting time but no frame.

use std::fmt::Write;
use std::path::Path;

/// Largest number of shards: a site's arrays have 1001 indices from 0 by default.
pub const MAX_TASKS: u32 = 1000;

/// Factor by which the requested time and memory exceed the forecast.
const ROOM: f64 = 2.0;
/// Smallest requested time in seconds: a task forecast to take one second must not fail because of a slow disk.
const MIN_SECONDS: f64 = 600.0;
/// Smallest requested memory in bytes.
const MIN_BYTES: u64 = 512 << 20;
/// Seconds before a task's time limit at which Slurm signals it, so that it can save its state.
const NOTICE: u32 = 60;

/// Largest number of restarts of a task at its time limit: frames without checkpoints would otherwise restart forever.
const MAX_RESTARTS: u32 = 20;

/// Parameters of a Slurm script.
#[derive(Clone, Copy, Debug)]
pub struct SlurmTask<'a> {
    /// Path of the program on the nodes.
    pub program: &'a Path,
    /// Path of the job file.
    pub jobs: &'a Path,
    /// Output folder, which all nodes share.
    pub folder: &'a Path,
    /// Number of shards, at most [`MAX_TASKS`].
    pub shards: u32,
    /// Number of processors per task.
    pub threads: u32,
    /// Forecast time of a shard in seconds.
    pub seconds: f64,
    /// Forecast memory of a shard in bytes.
    pub bytes: u64,
    /// Further arguments of the command line.
    pub arguments: &'a [String],
}

/// Returns the script as input for `sbatch`.
pub fn script(task: &SlurmTask) -> String {
    // Derive the job name from the file name, in characters that Slurm accepts
    let name = task
        .jobs
        .file_stem()
        .map_or("whit".into(), |stem| stem.to_string_lossy());
    let name: String = name
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() || "-_.".contains(c) {
                c
            } else {
                '_'
            }
        })
        .collect();
    // Quote all paths and arguments for the shell
    let [program, jobs, folder] =
        [task.program, task.jobs, task.folder].map(|path| quoted(&path.to_string_lossy()));
    let mut arguments = String::new();
    for argument in task.arguments {
        // Writing to a `String` cannot fail.
        let _ = write!(arguments, " {}", quoted(argument));
    }
    let (shards, threads) = (task.shards, task.threads);
    // Fill in the script: resources, a signal handler, and the requeue at the time limit
    format!(
        "#!/bin/bash
# {shards} shards of a batch, forecast to take {:.0} s and {} MiB each; the script requests {ROOM} times as much.
# Submit it with `sbatch`. When all tasks are done, merge the frames that are left with
#   {program} merge {folder}
#SBATCH --job-name={name}
#SBATCH --array=1-{shards}
#SBATCH --cpus-per-task={threads}
#SBATCH --time={}
#SBATCH --mem={}M
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:USR1@{NOTICE}
# Slurm sends USR1 {NOTICE} s before the time limit.
late=
trap 'late=yes; kill -TERM \"$task\"' USR1
{program} batch {jobs} --out {folder} --shard \"$SLURM_ARRAY_TASK_ID/{shards}\" --resume --threads {threads}{arguments} &
task=$!
wait \"$task\"
code=$?
if [ -n \"$late\" ]; then
    # The signal ended the first wait; now the task ends, with 130 (143 if it had hardly started) if work is left.
    wait \"$task\"
    code=$?
    case $code in
    130 | 143)
        # Finished work is kept: requeue the rest, unless restarts have been in vain.
        [ \"${{SLURM_RESTART_COUNT:-0}}\" -ge {MAX_RESTARTS} ] ||
            scontrol requeue \"${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID\"
        ;;
    esac
fi
exit \"$code\"
",
        task.seconds,
        task.bytes >> 20,
        clock(ROOM * task.seconds),
        mebibytes(task.bytes),
    )
}

/// Returns the memory to request, in MiB.
fn mebibytes(bytes: u64) -> u64 {
    ((ROOM * bytes as f64) as u64).max(MIN_BYTES).div_ceil(1 << 20)
}

/// Returns the time to request in Slurm's format, days-hours:minutes:seconds.
fn clock(seconds: f64) -> String {
    let seconds = seconds.max(MIN_SECONDS).ceil() as u64;
    let (minutes, hours) = (seconds / 60, seconds / 3600);
    format!(
        "{}-{:02}:{:02}:{:02}",
        hours / 24,
        hours % 24,
        minutes % 60,
        seconds % 60
    )
}

/// Returns `word` quoted for the shell, if necessary.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:+@%".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task<'a>(arguments: &'a [String]) -> SlurmTask<'a> {
        SlurmTask {
            program: Path::new("/opt/whit"),
            jobs: Path::new("it's here/the film.jobs.toml"),
            folder: Path::new("out"),
            shards: 24,
            threads: 8,
            seconds: 100_000.0,
            bytes: 3 << 30,
            arguments,
        }
    }

    #[test]
    fn script_requests_twice_the_forecast_and_can_be_requeued() {
        let script = script(&task(&["--checkpoint".into(), "60".into()]));
        for line in [
            "#SBATCH --job-name=the_film.jobs",
            "#SBATCH --array=1-24",
            "#SBATCH --cpus-per-task=8",
            // 200,000 s are 2 days, 7 hours, 33 minutes and 20 seconds.
            "#SBATCH --time=2-07:33:20",
            "#SBATCH --mem=6144M",
            "#SBATCH --requeue",
            "#SBATCH --signal=B:USR1@60",
            "/opt/whit batch 'it'\\''s here/the film.jobs.toml' --out out --shard \"$SLURM_ARRAY_TASK_ID/24\" \
             --resume --threads 8 --checkpoint 60 &",
        ] {
            assert!(script.lines().any(|it| it == line), "{line} is not in\n{script}");
        }
    }

    #[test]
    fn small_forecasts_are_raised_to_the_minimum_request() {
        let task = SlurmTask {
            seconds: 0.1,
            bytes: 1,
            ..task(&[])
        };
        let script = script(&task);
        assert!(script.contains("--time=0-00:10:00\n"), "{script}");
        assert!(script.contains("--mem=512M\n"), "{script}");
    }
}
