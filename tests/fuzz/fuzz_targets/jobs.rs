//! Expands the job file of a batch to frames; the scenes that it may name are empty files.

#![no_main]

use std::path::Component;

use libfuzzer_sys::{fuzz_mutator, fuzz_target};
use whit::jobs::Jobs;
use whit_fuzz::mutation::{Syntax, mutate_document};
use whit_fuzz::{InputFolder, start};

fuzz_target!(init: start(), |data: &[u8]| {
    let folder = InputFolder::new();
    for scene in ["a.toml", "b.toml", "a.glb"] {
        folder.write(scene, b"");
    }
    let path = folder.write("jobs.toml", data);
    let Ok(jobs) = Jobs::load(&path) else {
        return;
    };
    assert!(!jobs.frames.is_empty());
    for frame in &jobs.frames {
        let stays = |part| matches!(part, Component::Normal(_));
        assert!(frame.image.components().all(stays), "{} leaves the folder", frame.image.display());
    }
});

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    mutate_document(Syntax::Toml, data, size, max_size, seed)
});
