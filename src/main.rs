//! Entry point of the program `whit`: runs the command line and exits with its exit code.

fn main() {
    // Exit instead of returning from `main`: this skips freeing gigabytes of memory that the operating system reclaims
    // anyway.
    std::process::exit(whit::cli::run());
}
