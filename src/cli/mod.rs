//! Command line of the program: parses flags ([`args`]), turns them into a checked job, and runs it.
//!
//! Results go to standard output, everything else to standard error. Exit codes: 0 done; 1 a render or check failed; 2
//! bad usage or bad input; 130 interrupted.

mod ablation;
mod accel_options;
mod args;
mod autotune;
mod batch;
mod bench;
mod callgrind;
mod compare;
mod compare_stats;
mod cost;
mod crop;
mod cross_check;
mod events;
mod exposure;
mod failure;
mod forecast;
mod help;
mod image_format;
mod info;
mod interrupt;
mod job;
mod output;
mod preview;
mod progress;
mod radiosity;
mod render;
mod standard_error;
mod verify;
mod verify_replay;
mod version;

use clap::Parser;

use args::{Args, Command};
use failure::Failure;

/// Runs the program on the process's arguments and returns its exit code.
///
/// Prints results, warnings and errors itself. The caller must exit with the code at once: loaded scenes may have been
/// left allocated on purpose.
pub(crate) fn run() -> i32 {
    let result = Args::try_parse().map_err(Failure::of_usage).and_then(|args| {
        // Turn SIGINT and SIGTERM into a cancellation flag before any work starts
        interrupt::install();
        if args.version {
            return output::print(&version::describe(args.verbose));
        }
        let Some(command) = args.command else {
            return Err(Failure::Input(
                "a command is missing; `whit help` lists them".into(),
            ));
        };
        match command {
            Command::Render(args) => render::run(&args),
            Command::Batch(args) => batch::run(&args),
            Command::Merge(args) => batch::merge(&args),
            Command::Info(args) => info::run(&args),
            Command::Radiosity(args) => radiosity::run(&args),
            Command::Schema => output::print(&whit::scene_file::json_schema()),
            Command::Bench(args) => bench::run(&args),
            Command::Verify(args) => verify::run(&args),
            Command::Compare(args) => compare::run(&args),
            Command::Cost(args) => cost::run(&args),
            Command::CompareStats(args) => compare_stats::run(&args),
            Command::Help(args) => help::run(&args),
            Command::Man(args) => help::write_man_pages(&args),
            Command::Completions(args) => help::print_completions(&args),
        }
    });
    match result {
        Ok(()) => 0,
        Err(failure) => {
            failure.print();
            failure.exit_code()
        }
    }
}
