//! Lines on standard error; a closed pipe causes no panic.

use std::io::{self, Write};

/// Prints a line on standard error.
pub(super) fn emit(line: &str) {
    // An error of standard error cannot be reported anywhere.
    let _ = writeln!(io::stderr().lock(), "{line}");
}
