//! Reads the manifest of a batch, in a folder with an unfinished frame, which makes the manifest be read.

#![no_main]

use libfuzzer_sys::{fuzz_mutator, fuzz_target};
use serde_json::json;
use whit::batch::{BatchError, OngoingWrites, merge_frames};
use whit::image::rows::{ExrChannel, ExrLayout, ExrScanlineWriter, SampleType, Samples};
use whit::image::{Attribute, ExrEncoding, PngEncoding};
use whit_fuzz::mutation::{Syntax, mutate_document};
use whit_fuzz::{InputFolder, start};

/// Hash of the inputs of the frame.
const KEY: &str = "0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef";
/// Folder of the frame's pieces.
const PIECES: &str = ".whit-pieces/0123456789abcdef";

fuzz_target!(init: start(), |data: &[u8]| {
    let folder = InputFolder::new();
    folder.write("whit-batch.jsonl", data);
    folder.write("a.png", b"1234");
    let piece = folder.write(&format!("{PIECES}/0-1.all.exr"), b"");
    write_piece(&piece).expect("a piece is writable");
    let report = |_: &std::path::Path, _: Result<bool, BatchError>| Ok::<(), BatchError>(());
    let _ = merge_frames(folder.path(), &OngoingWrites::new(), report);
});

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    mutate_document(Syntax::Json, data, size, max_size, seed)
});

/// Writes the first of two rows of a frame of one pixel's width.
fn write_piece(path: &std::path::Path) -> Result<(), whit::image::ImageError> {
    let frame = json!({
        "key": KEY, "number": 0, "image": "a.png", "size": [1, 2], "spp": 1, "shares": 1,
        "exr": ExrEncoding::default(), "png": PngEncoding::default(), "notes": [],
    });
    let notes = [Attribute {
        name: "whit.frame",
        text: &frame.to_string(),
    }];
    let layout = ExrLayout {
        notes: &notes,
        ..ExrLayout::of_size([1, 1], vec![ExrChannel::new("R", SampleType::Float)])
    };
    let mut writer = ExrScanlineWriter::create(path, &layout)?;
    writer.write_rows(&[Samples::from(vec![0.5f32])])?;
    writer.finish()
}
