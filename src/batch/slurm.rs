//! A script that has Slurm make a batch on many machines: one task a shard.
//!
//! The cluster's tasks run the same command as anybody would. One that is started anew (its node failed) goes on where it
//! was; its ghost, which may still run beside it, writes the same bits. One whose time is nearly up keeps what it has and
//! goes back into the queue, so a forecast that was too short costs a wait and no frame.

use std::fmt::Write;
use std::path::Path;

/// The most shards: a site's arrays have 1001 numbers from 0, unless it says otherwise.
pub const MAX_TASKS: u32 = 1000;

/// How much more time and memory are asked for than were forecast.
const ROOM: f64 = 2.0;
/// Least seconds that are asked for: what is forecast to take one must not fail for a slow disk.
const MIN_SECONDS: f64 = 600.0;
/// Least bytes that are asked for.
const MIN_BYTES: u64 = 512 << 20;
/// Seconds before the end of a task's time at which it is told, so that it can keep what it has.
const NOTICE: u32 = 60;

/// How often a task whose time is up may begin again: frames that cannot be kept half-made would else do so for ever.
const MAX_RESTARTS: u32 = 20;

/// What a script is made of.
#[derive(Clone, Copy, Debug)]
pub struct Task<'a> {
    /// The program, as the nodes find it.
    pub program: &'a Path,
    /// The batch's file.
    pub jobs: &'a Path,
    /// Where pictures go, which all nodes see.
    pub folder: &'a Path,
    /// Shards, up to [`MAX_TASKS`].
    pub shards: u32,
    /// Processors of a task.
    pub threads: u32,
    /// What a shard is forecast to take.
    pub seconds: f64,
    /// What memory it is forecast to take.
    pub bytes: u64,
    /// Further arguments.
    pub arguments: &'a [String],
}

/// The script, for `sbatch`.
pub fn script(task: &Task) -> String {
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
    let [program, jobs, folder] =
        [task.program, task.jobs, task.folder].map(|path| quoted(&path.to_string_lossy()));
    let mut arguments = String::new();
    for argument in task.arguments {
        // A string takes whatever is written to it.
        let _ = write!(arguments, " {}", quoted(argument));
    }
    let (shards, threads) = (task.shards, task.threads);
    format!(
        "#!/bin/bash
# {shards} shards of a batch, forecast to take {:.0} s and {} MiB each; {ROOM} times that is asked for.
# Submit it with `sbatch`. What is left over when all tasks are done is put together by
#   {program} merge {folder}
#SBATCH --job-name={name}
#SBATCH --array=1-{shards}
#SBATCH --cpus-per-task={threads}
#SBATCH --time={}
#SBATCH --mem={}M
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:USR1@{NOTICE}
# Slurm says so {NOTICE} s before the time is up.
late=
trap 'late=yes; kill -TERM \"$task\"' USR1
{program} batch {jobs} --out {folder} --shard \"$SLURM_ARRAY_TASK_ID/{shards}\" --resume --threads {threads}{arguments} &
task=$!
wait \"$task\"
code=$?
if [ -n \"$late\" ]; then
    # That was the signal; now comes the end, with 130 (143 where it had hardly begun) if work is left.
    wait \"$task\"
    code=$?
    case $code in
    130 | 143)
        # What it has done is kept: the rest waits in line again, unless that was in vain all along.
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

/// What is asked for of memory.
fn mebibytes(bytes: u64) -> u64 {
    ((ROOM * bytes as f64) as u64).max(MIN_BYTES).div_ceil(1 << 20)
}

/// Days, hours, minutes and seconds as Slurm reads them.
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

/// A word for the shell, whatever it holds.
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

    fn task<'a>(arguments: &'a [String]) -> Task<'a> {
        Task {
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
    fn a_script_asks_for_twice_the_forecast_and_can_be_started_anew() {
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
    fn little_is_rounded_up_to_what_cannot_fail() {
        let task = Task {
            seconds: 0.1,
            bytes: 1,
            ..task(&[])
        };
        let script = script(&task);
        assert!(script.contains("--time=0-00:10:00\n"), "{script}");
        assert!(script.contains("--mem=512M\n"), "{script}");
    }
}
