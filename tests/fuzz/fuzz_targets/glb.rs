//! Loads a binary glTF file with its geometry, animations, materials and images.

#![no_main]

use libfuzzer_sys::{fuzz_mutator, fuzz_target};
use whit::gltf::{AnimationTime, LoadOptions};
use whit_fuzz::mutation::mutate_glb;
use whit_fuzz::{InputFolder, expect_valid, load_options, start};

fuzz_target!(init: start(), |data: &[u8]| {
    let folder = InputFolder::new();
    let path = folder.write("input.glb", data);
    let Ok(scene) = whit::gltf::load(&path, &load_options()) else {
        return;
    };
    expect_valid(&scene);
    // Load it again within its animations
    if !scene.animations.is_empty() {
        let posed = LoadOptions {
            pose: Some(AnimationTime { animation: None, seconds: 0.3 }),
            ..load_options()
        };
        if let Ok(scene) = whit::gltf::load(&path, &posed) {
            expect_valid(&scene);
        }
    }
});

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    mutate_glb(data, size, max_size, seed)
});
