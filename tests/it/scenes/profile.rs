//! The ledger: every ray that a backend is asked for stands under exactly one account, and keeping it changes no bit.
//!
//! `cargo bench --bench timing -- profile_seconds` checks the seconds as well, which needs a quiet machine.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::support::{random_scenes, scene_folder};
use whit::accel::{self, Accel, AccelOptions, AccelReport, Backend, RayOrder, RayPacket};
use whit::render::{Account, Adaptive, Ledger, Monitor, RenderSettings, Rendering, Tally, render};
use whit::scene::Scene;

/// A backend that counts the rays that another one is asked for.
struct Counter<'a> {
    accel: &'a dyn Accel,
    rays: AtomicU64,
}

impl Counter<'_> {
    fn count(&self, packets: &[RayPacket]) {
        let lanes = packets.iter().flat_map(|packet| packet.active);
        let active = lanes.filter(|&active| active != 0).count();
        self.rays.fetch_add(active as u64, Ordering::Relaxed);
    }
}

impl Accel for Counter<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: RayOrder) {
        self.count(packets);
        self.accel.intersect(packets, order);
    }

    fn occluded(&self, packets: &mut [RayPacket], order: RayOrder) {
        self.count(packets);
        self.accel.occluded(packets, order);
    }

    fn report(&self) -> AccelReport {
        self.accel.report()
    }
}

fn rendered(scene: &Scene, accel: &dyn Accel, settings: &RenderSettings) -> Rendering {
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(false),
        tiles: None,
    };
    render(scene, &scene.cameras[0], accel, settings, &monitor).unwrap()
}

/// A picture and the number of rays that the backend was asked for.
fn counted(scene: &Scene, backend: Backend, settings: &RenderSettings) -> (Rendering, u64) {
    let accel = accel::build(scene, backend, &AccelOptions::default()).unwrap();
    let counter = Counter {
        accel: &*accel,
        rays: AtomicU64::new(0),
    };
    let rendering = rendered(scene, &counter, settings);
    (rendering, counter.rays.into_inner())
}

fn bits(rendering: &Rendering) -> Vec<u32> {
    let values = rendering.image.pixels.as_flattened().iter();
    values.map(|value| value.to_bits()).collect()
}

fn rays(ledger: &Ledger) -> Vec<u64> {
    ledger.tallies().map(|(_, tally)| tally.rays).collect()
}

/// Holds the books of a scene against the counts of its backend, with the clock running and without.
fn audit(name: &str, scene: &Scene, backend: Backend, settings: &RenderSettings) -> Ledger {
    let (off, asked) = counted(scene, backend, settings);
    assert_eq!(off.ledger.total().rays, asked, "{name}");
    let booked = off.ledger.total();
    assert_eq!((booked.seconds, booked.trace_seconds), (0.0, 0.0), "{name}");
    assert_eq!(off.ledger.clock_reads, 0, "{name}");
    let with = RenderSettings {
        ledger: true,
        ..*settings
    };
    let (on, asked_again) = counted(scene, backend, &with);
    assert_eq!(
        (asked_again, rays(&on.ledger)),
        (asked, rays(&off.ledger)),
        "{name}"
    );
    assert_eq!(bits(&on), bits(&off), "{name}");
    check_seconds(name, &on.ledger);
    on.ledger
}

/// What holds whatever the clock says.
fn check_seconds(name: &str, ledger: &Ledger) {
    let sum: f64 = ledger.tallies().map(|(_, tally)| tally.seconds).sum();
    let whole = ledger.threads as f64 * ledger.seconds;
    // Idle time fills the sum up; rounding errors of so many positive terms are far below a millionth.
    assert!((sum / whole - 1.0).abs() < 1e-6, "{name}: {sum} of {whole}");
    for (
        account,
        Tally {
            seconds,
            trace_seconds,
            ..
        },
    ) in ledger.tallies()
    {
        let sound = seconds >= 0.0 && trace_seconds >= 0.0 && trace_seconds <= seconds * (1.0 + 1e-9);
        assert!(sound, "{name}: {} {trace_seconds} of {seconds}", account.name());
    }
    assert!(
        ledger.clock_reads > 0 && ledger.clock_read_seconds > 0.0,
        "{name}"
    );
}

#[test]
fn rays_add_up_exactly_in_random_scenes() {
    let settings = RenderSettings {
        width: 12,
        height: 9,
        wavelengths: 4,
        ..RenderSettings::default()
    };
    let mut ever = [0; Account::ALL.len()];
    for seed in 0..300 {
        let scene = random_scenes::scene(seed);
        let backend = if seed % 2 == 0 {
            Backend::default()
        } else {
            Backend::Bsp
        };
        let ledger = audit(&format!("scene {seed}"), &scene, backend, &settings);
        for (sum, rays) in ever.iter_mut().zip(rays(&ledger)) {
            *sum += rays;
        }
    }
    for account in [
        Account::Camera,
        Account::Shadow,
        Account::TransparentShadow,
        Account::Reflection,
        Account::Refraction,
        Account::RoughReflection,
        Account::RoughRefraction,
        Account::Dispersion,
        Account::Other,
    ] {
        assert!(ever[account as usize] > 0, "no ray of {}", account.name());
    }
}

#[test]
fn rays_add_up_exactly_in_the_scenes_of_the_repository() {
    for file in scene_folder::files() {
        let filed = scene_folder::load(&file);
        audit(&filed.name, &filed.scene, Backend::Bsp, &filed.settings(48, 2));
    }
}

#[test]
fn rays_add_up_exactly_where_pixels_take_unequal_numbers_of_samples() {
    let filed = scene_folder::named("prism.toml");
    let settings = RenderSettings {
        adaptive: Some(Adaptive {
            error: 0.01,
            gain: 1.0,
        }),
        ..filed.settings(40, 64)
    };
    let ledger = audit(&filed.name, &filed.scene, Backend::Bsp, &settings);
    assert!(ledger.of(Account::Dispersion).rays > 0);
}

#[test]
fn sorts_of_rays_are_the_sum_of_their_accounts() {
    let filed = scene_folder::named("prism.toml");
    let ledger = audit(&filed.name, &filed.scene, Backend::Bsp, &filed.settings(64, 1));
    let of = |account| ledger.of(account).rays;
    assert_eq!(
        ledger.reflection_rays() + ledger.refraction_rays(),
        of(Account::Reflection) + of(Account::Refraction) + of(Account::Dispersion)
    );
    assert!(ledger.refraction_rays() > of(Account::Refraction));
}

/// Counts rays pixel by pixel: nothing of the picture changes, and they add up to the ledger's.
fn audit_pixels(name: &str, scene: &Scene, backend: Backend, settings: &RenderSettings) {
    let (plain, asked) = counted(scene, backend, settings);
    assert!(plain.costs.is_none(), "{name}");
    let with = RenderSettings {
        ledger: true,
        cost_aovs: true,
        ..*settings
    };
    let (told, asked_again) = counted(scene, backend, &with);
    assert_eq!((asked_again, bits(&told)), (asked, bits(&plain)), "{name}");
    let costs = told.costs.unwrap();
    let sum = |values: Vec<f32>| values.into_iter().map(f64::from).sum::<f64>();
    for (account, tally) in told
        .ledger
        .tallies()
        // What is traced before the first pixel belongs to none.
        .filter(|(account, _)| !matches!(account, Account::Other | Account::Subsurface))
    {
        let name = format!("{name}: {}", account.name());
        assert_eq!(sum(costs.rays(account)), tally.rays as f64, "{name}");
        // Shares are rounded to f32 and summed in it.
        let spent = 1e-9 * sum(costs.nanoseconds(account));
        if account == Account::Camera {
            assert!(
                spent > 0.0 && spent < tally.seconds * 1.01,
                "{name}: {spent} of {}",
                tally.seconds
            );
        }
    }
    let spent = 1e-9 * sum(costs.all_nanoseconds());
    assert!(spent < told.ledger.total().seconds * 1.01, "{name}: {spent}");
}

#[test]
fn rays_of_pixels_add_up_to_the_ledgers() {
    let settings = RenderSettings {
        width: 12,
        height: 9,
        wavelengths: 4,
        ..RenderSettings::default()
    };
    for seed in 0..100 {
        let scene = random_scenes::scene(seed);
        let backend = if seed % 2 == 0 {
            Backend::default()
        } else {
            Backend::Bsp
        };
        audit_pixels(&format!("scene {seed}"), &scene, backend, &settings);
    }
    let filed = scene_folder::named("prism.toml");
    for (spp, adaptive) in [(1, None), (3, None), (64, Some(0.01))] {
        let settings = RenderSettings {
            adaptive: adaptive.map(|error| Adaptive { error, gain: 1.0 }),
            sample_aovs: spp == 3,
            ..filed.settings(40, spp)
        };
        audit_pixels(&filed.name, &filed.scene, Backend::Bsp, &settings);
    }
}
