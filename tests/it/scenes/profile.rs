//! Tests of the ray counts: every ray query of a backend counts in exactly one account, and counting changes no bit.
//!
//! `cargo bench --bench timing -- profile_seconds` checks the seconds as well, which needs a quiet machine.

use crate::support::images;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::support::{random_scenes, scene_folder};
use whit::accel::{self, Accel, AccelOptions, AccelReport, Backend, Coherence, RayEnd, RayPacket};
use whit::render::{Adaptive, Category, RenderProfile, RenderSettings, Rendering, Tally};
use whit::scene::Scene;

/// Backend wrapper that counts the rays of all queries.
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
    fn intersect(&self, packets: &mut [RayPacket], order: Coherence) {
        self.count(packets);
        self.accel.intersect(packets, order);
    }

    fn occluded(&self, packets: &mut [RayPacket], order: Coherence) {
        self.count(packets);
        self.accel.occluded(packets, order);
    }

    fn occluded_towards(&self, packets: &mut [RayPacket], end: RayEnd) {
        self.count(packets);
        self.accel.occluded_towards(packets, end);
    }

    fn gains_from_ends(&self) -> bool {
        self.accel.gains_from_ends()
    }

    fn batch(&self) -> usize {
        self.accel.batch()
    }

    fn report(&self) -> AccelReport {
        self.accel.report()
    }
}

fn rendered(scene: &Scene, accel: &dyn Accel, settings: &RenderSettings) -> Rendering {
    images::rendered_with(scene, accel, settings)
}

/// Returns the rendering and the number of rays that the backend traced.
fn counted(scene: &Scene, backend: Backend, settings: &RenderSettings) -> (Rendering, u64) {
    let accel = accel::build(scene.validate().unwrap(), backend, &AccelOptions::default()).unwrap();
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

fn rays(ledger: &RenderProfile) -> Vec<u64> {
    ledger.tallies().map(|(_, tally)| tally.rays).collect()
}

/// Compares the ray counts of a render with those of its backend, with and without timing.
fn audit(name: &str, scene: &Scene, backend: Backend, settings: &RenderSettings) -> RenderProfile {
    let (off, query_count) = counted(scene, backend, settings);
    assert_eq!(off.ledger.total().rays, query_count, "{name}");
    let booked = off.ledger.total();
    assert_eq!((booked.seconds, booked.trace_seconds), (0.0, 0.0), "{name}");
    assert_eq!(off.ledger.clock_reads, 0, "{name}");
    let with = RenderSettings {
        ledger: true,
        ..*settings
    };
    let (on, second_query_count) = counted(scene, backend, &with);
    assert_eq!(
        (second_query_count, rays(&on.ledger)),
        (query_count, rays(&off.ledger)),
        "{name}"
    );
    assert_eq!(bits(&on), bits(&off), "{name}");
    check_seconds(name, &on.ledger);
    on.ledger
}

/// Asserts the properties of the times that hold for any measurement.
fn check_seconds(name: &str, ledger: &RenderProfile) {
    let sum: f64 = ledger.tallies().map(|(_, tally)| tally.seconds).sum();
    let whole = ledger.threads as f64 * ledger.seconds;
    // Idle time completes the sum; rounding errors of so many positive terms are far below a millionth.
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
fn ray_counts_add_up_in_random_scenes() {
    let settings = RenderSettings {
        width: 12,
        height: 9,
        wavelengths: 4,
        ..RenderSettings::default()
    };
    let backends = [Backend::default(), Backend::Bsp, Backend::Native];
    let mut ever = [0; Category::ALL.len()];
    for seed in 0..300 {
        let scene = random_scenes::scene(seed);
        let backend = backends[seed as usize % backends.len()];
        let ledger = audit(&format!("scene {seed}"), &scene, backend, &settings);
        for (sum, rays) in ever.iter_mut().zip(rays(&ledger)) {
            *sum += rays;
        }
    }
    for account in [
        Category::Camera,
        Category::Shadow,
        Category::TransparentShadow,
        Category::Reflection,
        Category::Refraction,
        Category::RoughReflection,
        Category::RoughRefraction,
        Category::Dispersion,
        Category::Other,
    ] {
        assert!(ever[account as usize] > 0, "no ray of {}", account.name());
    }
}

#[test]
fn ray_counts_add_up_in_repository_scenes() {
    for file in scene_folder::files() {
        let filed = scene_folder::load(&file);
        audit(&filed.name, &filed.scene, Backend::Bsp, &filed.settings(48, 2));
    }
}

#[test]
fn ray_counts_add_up_with_unequal_sample_counts() {
    let filed = scene_folder::named("prism.toml");
    let settings = RenderSettings {
        adaptive: Some(Adaptive {
            error: 0.01,
            gain: 1.0,
        }),
        ..filed.settings(40, 64)
    };
    let ledger = audit(&filed.name, &filed.scene, Backend::Bsp, &settings);
    assert!(ledger.of(Category::Dispersion).rays > 0);
}

#[test]
fn ray_kinds_are_sums_of_their_accounts() {
    let filed = scene_folder::named("prism.toml");
    let ledger = audit(&filed.name, &filed.scene, Backend::Bsp, &filed.settings(64, 1));
    let of = |account| ledger.of(account).rays;
    assert_eq!(
        ledger.reflection_rays() + ledger.refraction_rays(),
        of(Category::Reflection) + of(Category::Refraction) + of(Category::Dispersion)
    );
    assert!(ledger.refraction_rays() > of(Category::Refraction));
}

/// Asserts that counting rays per pixel does not change the image, and that the counts add up to the totals.
fn audit_pixels(name: &str, scene: &Scene, backend: Backend, settings: &RenderSettings) {
    let (plain, query_count) = counted(scene, backend, settings);
    assert!(plain.costs.is_none(), "{name}");
    let with = RenderSettings {
        ledger: true,
        cost_aovs: true,
        ..*settings
    };
    let (with_costs, second_query_count) = counted(scene, backend, &with);
    assert_eq!(
        (second_query_count, bits(&with_costs)),
        (query_count, bits(&plain)),
        "{name}"
    );
    let costs = with_costs.costs.unwrap();
    let sum = |values: Vec<f32>| values.into_iter().map(f64::from).sum::<f64>();
    for (account, tally) in with_costs
        .ledger
        .tallies()
        // Rays traced before the first pixel belong to no pixel.
        .filter(|(account, _)| {
            !matches!(
                account,
                Category::Other | Category::Subsurface | Category::Caustics
            )
        })
    {
        let name = format!("{name}: {}", account.name());
        assert_eq!(sum(costs.rays(account)), tally.rays as f64, "{name}");
        // Shares are rounded and summed in f32.
        let spent = 1e-9 * sum(costs.nanoseconds(account));
        if account == Category::Camera {
            assert!(
                spent > 0.0 && spent < tally.seconds * 1.01,
                "{name}: {spent} of {}",
                tally.seconds
            );
        }
    }
    let spent = 1e-9 * sum(costs.all_nanoseconds());
    assert!(
        spent < with_costs.ledger.total().seconds * 1.01,
        "{name}: {spent}"
    );
}

#[test]
fn ray_counts_of_pixels_add_up_to_the_totals() {
    let settings = RenderSettings {
        width: 12,
        height: 9,
        wavelengths: 4,
        ..RenderSettings::default()
    };
    let backends = [Backend::default(), Backend::Bsp, Backend::Native];
    for seed in 0..100 {
        let scene = random_scenes::scene(seed);
        let backend = backends[seed as usize % backends.len()];
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
    // Trace shadow rays to three lights, whose packets have ends of their own
    let filed = scene_folder::named("first_light.gltf");
    audit_pixels(&filed.name, &filed.scene, Backend::Native, &filed.settings(64, 2));
}
