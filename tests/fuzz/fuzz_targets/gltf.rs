//! Loads a glTF document of JSON, whose buffers and images are data URIs.

#![no_main]

use libfuzzer_sys::{fuzz_mutator, fuzz_target};
use whit_fuzz::mutation::{Syntax, mutate_document};
use whit_fuzz::{InputFolder, expect_valid, load_options, start};

fuzz_target!(init: start(), |data: &[u8]| {
    let folder = InputFolder::new();
    let path = folder.write("input.gltf", data);
    if let Ok(scene) = whit::gltf::load(&path, &load_options()) {
        expect_valid(&scene);
    }
});

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    mutate_document(Syntax::Json, data, size, max_size, seed)
});
