//! Flags of `whit batch` and of `whit merge`.

use std::path::PathBuf;

use clap::Args as ArgGroup;

use super::MAX_THREADS;
use super::progress::ProgressArgs;
use whit::batch::Shard;

/// Largest duration in seconds: one week; more is taken for a typing error.
const MAX_SECONDS: f64 = 604_800.0;
/// Suffixes of memory sizes with their powers of two.
const UNITS: [(char, u32); 4] = [('k', 10), ('m', 20), ('g', 30), ('t', 40)];

const BATCH_HELP: &str = "\
Examples:
  whit batch film.jobs.toml --out film --dry-run
  whit batch film.jobs.toml --out film --html film/index.html
  whit batch film.jobs.toml --out film --resume
  whit batch film.jobs.toml --out film --shard 3/24
  whit batch film.jobs.toml --out film --slurm film.sh --shards 24 && sbatch film.sh

A batch may be stopped or killed at any time: --resume renders what is missing, and the images are the same to the bit.
If one frame fails, the others are still rendered; the exit code is then 1.";

/// Flags of `whit batch`.
#[derive(Debug, ArgGroup)]
#[command(after_help = BATCH_HELP)]
pub(in crate::cli) struct BatchArgs {
    /// Job file: the frames to render, in the format that the README describes
    #[arg(value_name = "JOBS.toml")]
    pub(in crate::cli) jobs: PathBuf,

    /// Output folder for the images; it is created if it does not exist
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) out: PathBuf,

    /// Resume an earlier run: finished frames are kept if their scenes and settings are unchanged
    #[arg(long)]
    pub(in crate::cli) resume: bool,

    /// Render only shard I of N shards of about the same size; I may be `auto` within a job array of Slurm (from 1)
    /// or an indexed job of Kubernetes (from 0)
    #[arg(long, value_name = "I/N", default_value = "1/1", hide_default_value = true)]
    pub(in crate::cli) shard: Shard,

    /// List the frames with a forecast of their times and memory, without rendering
    #[arg(long)]
    pub(in crate::cli) dry_run: bool,

    /// Write a script for Slurm's `sbatch` instead, with times and memory from a forecast
    #[arg(long, value_name = "FILE.sh", conflicts_with_all = ["dry_run", "shard"])]
    pub(in crate::cli) slurm: Option<PathBuf>,

    /// Number of tasks of the script
    #[arg(long, value_name = "N", requires = "slurm", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=i64::from(whit::batch::slurm::MAX_TASKS)))]
    pub(in crate::cli) shards: u32,

    /// Save the finished part of a frame at about this interval, so that an interruption loses little of a long frame
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0, value_parser = seconds)]
    pub(in crate::cli) checkpoint: f64,

    /// Stop sampling a frame after this time, and write the image from the samples taken by then
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub(in crate::cli) time: Option<f64>,

    /// Skip frames whose forecast exceeds this memory, as in 4G or 800M [default: the free memory]
    #[arg(long, value_name = "BYTES", value_parser = bytes)]
    pub(in crate::cli) max_memory: Option<u64>,

    /// Number of threads; 0 for one per processor
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=MAX_THREADS))]
    pub(in crate::cli) threads: u32,

    /// Lower the priority of the process: 19 uses only processor time that no other process needs
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(i32).range(0..=19))]
    pub(in crate::cli) nice: Option<i32>,

    /// Write a page of thumbnails, times and effects
    #[arg(long, value_name = "FILE.html")]
    pub(in crate::cli) html: Option<PathBuf>,

    #[command(flatten)]
    pub(in crate::cli) watching: ProgressArgs,

    /// Print errors only, no warnings
    #[arg(long, short)]
    pub(in crate::cli) quiet: bool,
}

const MERGE_HELP: &str = "\
Example:
  whit merge film

Merges every frame whose pieces are all present, in little memory even if the frame is large. Lists the other frames and
returns exit code 1. A shard that renders the last piece of a frame merges the frame itself.";

/// Flags of `whit merge`.
#[derive(Debug, ArgGroup)]
#[command(after_help = MERGE_HELP)]
pub(in crate::cli) struct MergeArgs {
    /// Output folder of `whit batch`
    #[arg(value_name = "DIR")]
    pub(in crate::cli) out: PathBuf,

    /// Print errors only, no warnings
    #[arg(long, short)]
    pub(in crate::cli) quiet: bool,
}

fn seconds(text: &str) -> Result<f64, String> {
    text.strip_suffix('s')
        .unwrap_or(text)
        .parse()
        .ok()
        .filter(|seconds| (0.0..=MAX_SECONDS).contains(seconds))
        .ok_or_else(|| format!("give seconds from 0 to {MAX_SECONDS}"))
}

fn bytes(text: &str) -> Result<u64, String> {
    let lower = text.to_ascii_lowercase();
    let unit = |(letter, shift): (char, u32)| Some((lower.strip_suffix(letter)?, shift));
    let (digits, shift) = UNITS.into_iter().find_map(unit).unwrap_or((&lower, 0));
    let count: Option<u64> = digits.parse().ok();
    count
        .and_then(|count| count.checked_mul(1 << shift))
        .filter(|&bytes| bytes > 0)
        .ok_or_else(|| "give bytes, as in 800M or 4G".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_size_is_in_bytes_or_larger_units() {
        assert_eq!(bytes("4096"), Ok(4096));
        assert_eq!(bytes("2k"), Ok(2048));
        assert_eq!(bytes("4G"), Ok(4 << 30));
        for bad in ["", "0", "G", "-1", "1.5G", "20000000t"] {
            assert!(bytes(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn seconds_may_have_a_unit() {
        assert_eq!(seconds("60s"), Ok(60.0));
        assert_eq!(seconds("0.5"), Ok(0.5));
        assert!(seconds("-1").is_err() && seconds("nan").is_err());
    }
}
