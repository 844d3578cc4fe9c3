//! Parses a file of rays, and what is written of it again.

#![no_main]

use libfuzzer_sys::fuzz_target;
use whit::verify::{RaysFile, RaysOfPair, bits};
use whit_fuzz::start;

fuzz_target!(init: start(), |text: &str| {
    let Ok(file) = RaysFile::parse(text) else {
        return;
    };
    // Compare the bits of the rays, as they may hold NaN
    let again = RaysFile::parse(&file.text()).expect("a written file is read again");
    assert_eq!(again.holds, file.holds);
    assert_eq!(again.pairs.len(), file.pairs.len());
    for (read, written) in again.pairs.iter().zip(&file.pairs) {
        let bits_of_rays = |pair: &RaysOfPair| -> Vec<String> {
            pair.rays.iter().map(|difference| bits(&difference.ray)).collect()
        };
        assert_eq!(bits_of_rays(read), bits_of_rays(written));
    }
});
