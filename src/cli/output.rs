//! Output of results: to standard output, where a closed pipe causes no panic, and to files.

use std::io::{self, ErrorKind, Write};
use std::path::Path;

use serde::Serialize;

use whit::image::write_atomically;

use super::failure::Failure;

/// Prints a result. A reader that has closed the pipe (`whit ... | head`) is no error.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Work(format!("cannot write to standard output: {error}")))
        }
        _ => Ok(()),
    }
}

/// Writes `value` to `path` as JSON, atomically.
pub(super) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), Failure> {
    write_atomically(path, |file| {
        // Serialize to memory first: serde_json is compiled anew for each type of writer.
        let mut bytes = serde_json::to_vec_pretty(value)?;
        bytes.push(b'\n');
        file.write_all(&bytes)
    })?;
    Ok(())
}

/// Writes `text` to `path`, atomically.
pub(super) fn write_text(path: &Path, text: &str) -> Result<(), Failure> {
    write_atomically(path, |file| file.write_all(text.as_bytes()))?;
    Ok(())
}
