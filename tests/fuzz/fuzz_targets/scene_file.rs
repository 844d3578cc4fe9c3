//! Loads a scene file, which may refer to an image, a volume, a glTF file and another scene file beside it.

#![no_main]

use libfuzzer_sys::{fuzz_mutator, fuzz_target};
use serde_json::json;
use whit_fuzz::glb::{Glb, document_of};
use whit_fuzz::mutation::{Syntax, mutate_document};
use whit_fuzz::{InputFolder, expect_valid, load_options, start};

/// Scene file that inputs may include.
const INCLUDED: &[u8] = b"[[object]]\nname = \"ball\"\nshape = \"sphere\"\n";
/// Volume of 2 x 2 x 2 samples.
const VOLUME: &[u8] =
    b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n\n\x00\x10\x20\x30\x40\x50\x60\x70";
/// Image of 2 x 1 pixels.
const IMAGE: &[u8] = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n\x80\x40\x00\x8a\x80\x80\x80\x81";

fuzz_target!(init: start(), |data: &[u8]| {
    let folder = InputFolder::new();
    folder.write("a.toml", INCLUDED);
    folder.write("a.nrrd", VOLUME);
    folder.write("a.hdr", IMAGE);
    folder.write("a.glb", &triangle().bytes());
    let path = folder.write("input.toml", data);
    if let Ok(file) = whit::scene_file::load(&path, &load_options()) {
        expect_valid(&file.scene);
    }
});

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    mutate_document(Syntax::Toml, data, size, max_size, seed)
});

/// Returns a model of one triangle.
fn triangle() -> Glb {
    let corners: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let bytes: Vec<u8> = corners.into_iter().flat_map(f32::to_le_bytes).collect();
    let document = document_of(
        json!({"attributes": {"POSITION": 0}}),
        json!([{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}]),
        json!([{"buffer": 0, "byteLength": bytes.len()}]),
        &[bytes.len()],
    );
    Glb::new(&document, &bytes)
}
