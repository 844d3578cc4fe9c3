//! Parses a settings file, and what is written of it again.

#![no_main]

use libfuzzer_sys::{fuzz_mutator, fuzz_target};
use whit::cost::SettingsFile;
use whit_fuzz::mutation::{Syntax, mutate_document};
use whit_fuzz::start;

fuzz_target!(init: start(), |text: &str| {
    if let Ok(file) = SettingsFile::parse(text) {
        let again = SettingsFile::parse(&file.text());
        assert_eq!(again.map(|file| file.settings), Ok(file.settings));
    }
});

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    mutate_document(Syntax::Toml, data, size, max_size, seed)
});
