//! Wrappers for OpenEXR's tools and OpenImageIO's, if they are installed (Debian's packages `openexr` and
//! `openimageio-tools`).

use std::process::Command;

/// Returns whether a tool succeeds, and its output; prints a message and returns `None` if it is not installed.
pub fn tool(name: &str, arguments: &[&str]) -> Option<(bool, String)> {
    match Command::new(name).args(arguments).output() {
        Ok(output) => {
            let words = [output.stdout, output.stderr].concat();
            let words = String::from_utf8_lossy(&words).into_owned();
            // The exit code of `exrinfo` 3.1.5, Debian 12's, is a count that it never initialises: a quarter of its
            // runs on valid files end with another than zero. Faults are printed.
            let is_well = if name == "exrinfo" {
                !words.contains("ERROR")
            } else {
                output.status.success()
            };
            Some((is_well, words))
        }
        Err(error) => {
            println!("skipped: {name} does not run here ({error})");
            None
        }
    }
}
