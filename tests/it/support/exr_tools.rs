//! OpenEXR's own tools and OpenImageIO's, where they are installed (Debian's packages `openexr` and `openimageio-tools`).

use std::process::Command;

/// Whether a tool is content, and its words; or `None` and a printed reason where it is not installed.
pub fn tool(name: &str, arguments: &[&str]) -> Option<(bool, String)> {
    match Command::new(name).args(arguments).output() {
        Ok(output) => {
            let words = [output.stdout, output.stderr].concat();
            let words = String::from_utf8_lossy(&words).into_owned();
            // The exit code of `exrinfo` 3.1.5, Debian 12's, is a count that it never sets: a quarter of its runs on
            // sound files end with another than zero. What it finds wrong it prints.
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
