//! Merges the pieces of a frame: the input is the EXR file of each, under the names that its header asks for.

#![no_main]

use libfuzzer_sys::fuzz_target;
use serde_json::Value;
use whit::batch::{BatchError, OngoingWrites, merge_frames};
use whit::image::load_image;
use whit::image::rows::ExrScanlineReader;
use whit_fuzz::{InputFolder, start};

/// Largest number of shares that have a piece.
const MAX_SHARES: u64 = 3;
/// Number of digits of a frame's key that its folder is named by.
const FOLDER_DIGITS: usize = 16;

fuzz_target!(init: start(), |data: &[u8]| {
    let folder = InputFolder::new();
    let probe = folder.write("probe.exr", data);
    let Some(names) = names(&probe) else {
        return;
    };
    for name in names {
        folder.write(&name, data);
    }
    let out = folder.path();
    let mut merged = Vec::new();
    let report = |image: &std::path::Path, result: Result<bool, BatchError>| {
        merged.extend(result.is_ok_and(|is_new| is_new).then(|| out.join(image)));
        Ok::<(), BatchError>(())
    };
    let _ = merge_frames(out, &OngoingWrites::new(), report);
    for image in merged {
        assert!(image.starts_with(out) && image.is_file(), "{}", image.display());
        let _ = load_image(&image);
    }
});

/// Returns the names of the pieces that the file may be; `None` if it is none.
fn names(path: &std::path::Path) -> Option<Vec<String>> {
    let reader = ExrScanlineReader::open(path).ok()?;
    let frame: Value = serde_json::from_str(&reader.note("whit.frame")?).ok()?;
    let key = frame["key"].as_str()?.get(..FOLDER_DIGITS)?;
    if !key.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    let window = reader.data_window();
    let start = i64::from(window.origin[1]);
    let rows = format!("{start}-{}", start + i64::from(window.size[1]));
    let shares = frame["shares"].as_u64()?;
    let parts: Vec<String> = match shares {
        0 | 1 => vec!["all".into()],
        _ => (0..shares.min(MAX_SHARES))
            .map(|share| format!("{share}-of-{shares}"))
            .collect(),
    };
    let key = key.to_ascii_lowercase();
    Some(
        parts
            .iter()
            .map(|part| format!(".whit-pieces/{key}/{rows}.{part}.exr"))
            .collect(),
    )
}
