//! The forecast of `whit info`: a probe of a few strips sees what the whole picture takes.
//!
//! `cargo bench --bench timing -- forecast_shares` holds the shares of time against a render's ledger, which needs a
//! quiet machine.

use crate::support::scene_folder::{self, FiledScene};
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::render::{Category, Monitor, RenderProfile, RenderSettings, probe, render};
use whit::report::forecast::Forecast;

/// Largest error of the shares of a forecast.
const OFF_BY: f64 = 0.1;

/// Mirrors and glass; wavelengths; look-ups; soft shadows; a march; light within bodies.
const SCENES: [&str; 6] = [
    "whitted_1980",
    "prism",
    "textured",
    "soft_shadows",
    "fog_beam",
    "wax",
];

fn filed(name: &str) -> FiledScene {
    scene_folder::named(&format!("{name}.toml"))
}

fn forecast(filed: &FiledScene, accel: &dyn Accel, settings: &RenderSettings) -> Forecast {
    let probe = probe(
        (filed.scene.validate().unwrap(), &filed.scene.cameras[0]),
        accel,
        settings,
        &Monitor::default(),
    )
    .unwrap();
    Forecast::of(&probe, settings, Backend::default())
}

fn ledger(filed: &FiledScene, accel: &dyn Accel, settings: &RenderSettings) -> RenderProfile {
    let settings = RenderSettings {
        ledger: true,
        ..*settings
    };
    let camera = &filed.scene.cameras[0];
    render(
        filed.scene.validate().unwrap(),
        camera,
        accel,
        &settings,
        &Monitor::default(),
    )
    .unwrap()
    .ledger
}

#[test]
fn ray_shares_are_forecast_within_ten_points() {
    for name in SCENES {
        let filed = filed(name);
        let accel = accel::build(
            filed.scene.validate().unwrap(),
            Backend::default(),
            &AccelOptions::default(),
        )
        .unwrap();
        // As many tiles as strips, so that the probe still leaves most of the picture out.
        let settings = filed.settings(256, 4);
        let predicted = forecast(&filed, &*accel, &settings);
        let ledger = ledger(&filed, &*accel, &settings);
        let whole = ledger.total().rays as f64;
        assert!(
            predicted.samples < ledger.camera_rays() / 2,
            "{name}: {predicted:?}"
        );
        for account in Category::ALL {
            let share = ledger.of(account).rays as f64 / whole;
            let forecast = predicted
                .accounts
                .get(account.name())
                .map_or(0.0, |shares| shares.rays);
            println!("{name}: {} {forecast:.3}, and is {share:.3}", account.name());
            assert!(
                (forecast - share).abs() <= OFF_BY,
                "{name}: {} {forecast:.3}, and is {share:.3}",
                account.name()
            );
        }
    }
}

#[test]
fn probe_is_deterministic_and_limited_to_its_share() {
    let filed = filed("gems");
    let accel = accel::build(
        filed.scene.validate().unwrap(),
        Backend::default(),
        &AccelOptions::default(),
    )
    .unwrap();
    let settings = filed.settings(1024, 16);
    let camera = &filed.scene.cameras[0];
    let runs = [(); 2].map(|()| {
        let probe = probe(
            (filed.scene.validate().unwrap(), camera),
            &*accel,
            &settings,
            &Monitor::default(),
        )
        .unwrap();
        let rays: Vec<u64> = probe.ledger.tallies().map(|(_, tally)| tally.rays).collect();
        (probe.strips, probe.samples, rays)
    });
    assert_eq!(runs[0], runs[1]);
    let (strips, samples, rays) = &runs[0];
    assert!(
        (48..=128).contains(strips) && *samples <= 128 * 512,
        "{strips} {samples}"
    );
    assert!(rays.iter().sum::<u64>() > 10_000);
}

#[test]
fn shares_add_up_to_one() {
    let filed = filed("whitted_1980");
    let accel = accel::build(
        filed.scene.validate().unwrap(),
        Backend::Bsp,
        &AccelOptions::default(),
    )
    .unwrap();
    let predicted = forecast(&filed, &*accel, &filed.settings(64, 16));
    let sum =
        |part: fn(&whit::report::forecast::Shares) -> f64| predicted.accounts.values().map(part).sum::<f64>();
    // Rounding errors of so few terms are far below a millionth.
    assert!((sum(|shares| shares.time) - 1.0).abs() < 1e-6);
    assert!((sum(|shares| shares.rays) - 1.0).abs() < 1e-6);
}
