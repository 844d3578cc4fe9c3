//! The shares of time that `whit info` forecasts from a few strips against those of the whole image.

use whit::accel::{self, AccelOptions, Backend};
use whit::render::{Category, Monitor, RenderProfile, probe};
use whit::report::forecast::Forecast;

use crate::ledgers::{ledger, load, one_thread};
use crate::limits::Limits;

/// Mirrors and glass; wavelengths; look-ups; soft shadows; a march; light within bodies.
const SCENES: [&str; 6] = [
    "whitted_1980",
    "prism",
    "textured",
    "soft_shadows",
    "fog_beam",
    "wax",
];
const WIDTH: u32 = 400;
const SPP: u32 = 16;
/// By how much a forecast share may differ from the true one.
const MAX_ERROR: f64 = 0.1;

/// Forecasts and renders some scenes on one thread.
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
        let settings = filed.settings(WIDTH, SPP);
        let view = (filed.scene.validate().unwrap(), &filed.scene.cameras[0]);
        let (forecast, ledger) = pool.install(|| {
            let probe = probe(view, &*accel, &settings, &Monitor::default()).unwrap();
            let forecast = Forecast::of(&probe, &settings, Backend::default());
            (forecast, ledger(&filed, &*accel, &settings))
        });
        let (error, account) = largest_error(&forecast, &ledger);
        println!(
            "{name}: shares are wrong by up to {error:.3} ({}), {}; {:.2} s forecast, {:.2} s taken; {} rays probed",
            account.name(),
            limits.at_most(error, MAX_ERROR),
            forecast.seconds,
            seconds_of_work(&ledger),
            forecast.rays
        );
    }
}

/// Returns by how much the forecast share of an account differs from the true one at most, and which account that is.
fn largest_error(forecast: &Forecast, ledger: &RenderProfile) -> (f64, Category) {
    let error = |account: Category| {
        let share = ledger.of(account).seconds / seconds_of_work(ledger);
        let shares = forecast.accounts.get(account.name());
        (shares.map_or(0.0, |shares| shares.time) - share).abs()
    };
    let accounts = Category::ALL.into_iter();
    accounts
        .filter(|&account| account != Category::Idle)
        .map(|account| (error(account), account))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap()
}

fn seconds_of_work(ledger: &RenderProfile) -> f64 {
    ledger.total().seconds - ledger.of(Category::Idle).seconds
}
