//! Parses the checkpoint of an interrupted study of settings.

#![no_main]

use libfuzzer_sys::fuzz_target;
use whit::cost::StudyCheckpoint;
use whit_fuzz::start;

fuzz_target!(init: start(), |data: &[u8]| {
    if let Ok(checkpoint) = StudyCheckpoint::parse(data) {
        let _ = checkpoint.spent();
    }
});
