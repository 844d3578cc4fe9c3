//! Reads an EXR image row by row, as the pieces of frames are read.

#![no_main]

use libfuzzer_sys::fuzz_target;
use whit::image::rows::{ExrScanlineReader, Samples};
use whit_fuzz::{InputFolder, MAX_TEXELS, start};

/// Number of rows that are read at a time, which is no multiple of the rows of a block.
const ROWS: usize = 5;
/// Largest number of rows that are read.
const MAX_ROWS: u32 = 1 << 10;

fuzz_target!(init: start(), |data: &[u8]| {
    let folder = InputFolder::new();
    let path = folder.write("input.exr", data);
    let Ok(mut reader) = ExrScanlineReader::open(&path) else {
        return;
    };
    let _ = (reader.note("whit.frame"), reader.display_window());
    let [width, height] = reader.data_window().size;
    let value_count = u64::from(width) * ROWS as u64 * reader.channels().len() as u64;
    if value_count > MAX_TEXELS {
        return;
    }
    for start in (0..height.min(MAX_ROWS)).step_by(ROWS) {
        let rows = start..height.min(start + ROWS as u32);
        let row_count = rows.len();
        let Ok(planes) = reader.read_rows(rows) else {
            return;
        };
        let expected = row_count * width as usize;
        for plane in planes {
            let count = match plane {
                Samples::Floats(values) => values.len(),
                Samples::Integers(values) => values.len(),
            };
            assert_eq!(count, expected, "number of values of a channel");
        }
    }
});
