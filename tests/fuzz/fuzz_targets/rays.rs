//! Parses a file of rays, and what is written of it again.

#![no_main]

use libfuzzer_sys::fuzz_target;
use whit::verify::{RaysFile, bits};
use whit_fuzz::start;

fuzz_target!(init: start(), |text: &str| {
    let Ok(file) = RaysFile::parse(text) else {
        return;
    };
    // Compare the bits of the rays, as they may hold NaN
    let again = RaysFile::parse(&file.text()).expect("a written file is read again");
    assert_eq!(again.holds, file.holds);
    assert_eq!(again.rays.len(), file.rays.len());
    for (read, written) in again.rays.iter().zip(&file.rays) {
        assert_eq!(bits(&read.ray), bits(&written.ray));
    }
});
