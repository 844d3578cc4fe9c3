//! Parse, run, print the error, set the exit code.

fn main() {
    // Not by returning: leaving at once spares freeing gigabytes that the system takes back anyway.
    std::process::exit(whit::cli::run());
}
