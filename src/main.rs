//! Command-line program: parses arguments, runs a command, prints errors, and sets the exit code.

mod cli;

fn main() {
    // Exit without returning: the system frees gigabytes of scene data faster than destructors do.
    std::process::exit(cli::run());
}
