//! The part of a render's time that the accounts of its ledger add up to, and what measuring takes of it.

use whit::accel::{self, AccelOptions, Backend};
use whit::render::Category;

use crate::ledgers::{ledger, load, one_thread};
use crate::limits::Limits;

const SCENES: [&str; 5] = ["whitted_1980", "textured", "prism", "sphereflake", "mirror_room"];
const WIDTH: u32 = 320;
const SPP: u32 = 16;
/// The least and the largest part of the time that work may be booked for.
const BOOKED: [f64; 2] = [0.97, 1.03];
/// The largest part of the time that measuring may take.
const MAX_MEASURING: f64 = 0.03;

/// Renders some scenes on one thread with the ledger on.
pub(crate) fn run(limits: &mut Limits) {
    let pool = one_thread();
    for name in SCENES {
        let filed = load(name);
        let accel = accel::build(
            filed.scene.validate().unwrap(),
            Backend::default(),
            &AccelOptions::default(),
        )
        .unwrap();
        let ledger = pool.install(|| ledger(&filed, &*accel, &filed.settings(WIDTH, SPP)));
        let booked = 1.0 - ledger.of(Category::Idle).seconds / ledger.seconds;
        let measuring = ledger.seconds_of_measuring() / ledger.seconds;
        println!(
            "{name}: of {:.3} s, {booked:.4} are accounted for, {}; of that measuring {measuring:.4}, {}",
            ledger.seconds,
            limits.between(booked, BOOKED[0], BOOKED[1]),
            limits.at_most(measuring, MAX_MEASURING)
        );
    }
}
