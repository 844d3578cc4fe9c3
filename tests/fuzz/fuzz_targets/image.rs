//! Decodes an image as a texture and for comparison: PNG, JPEG, WebP, HDR or EXR.

#![no_main]

use libfuzzer_sys::fuzz_target;
use whit::image::{TransferCurve, load_image, read, read_size};
use whit_fuzz::{InputFolder, start};

/// Largest number of texels of an input. Larger images take time in proportion, but no other code.
const MAX_TEXELS: u64 = 1 << 14;

fuzz_target!(init: start(), |data: &[u8]| {
    let folder = InputFolder::new();
    let path = folder.write("input.png", data);
    let texture = read(&path, TransferCurve::Srgb, MAX_TEXELS);
    // Comparisons allow larger images than fit into the time of an input
    let Ok([width, height]) = read_size(&path) else {
        assert!(texture.is_err(), "an image is decoded whose size cannot be read");
        return;
    };
    if let Ok(texture) = &texture {
        assert_eq!([texture.width, texture.height], [width, height]);
    }
    if u64::from(width) * u64::from(height) <= MAX_TEXELS {
        let _ = load_image(&path);
    }
});
