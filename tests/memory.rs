//! The bytes of the ledger: they add up, what is off holds none, and together they are what an allocator counts.
//!
//! One test runs at a time, as the allocator counts for the whole program.

#[path = "it/support"]
mod support {
    #![allow(dead_code, unreachable_pub, reason = "this program uses a part of it")]

    pub mod meshes;
    pub mod random_scenes;
    pub mod scene_folder;
    pub mod scenes;
}

use std::alloc::{GlobalAlloc, Layout, System};
use std::collections::HashSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use support::{random_scenes, scene_folder};
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::render::{
    Adaptive, AovKind, Category, LightAovs, Memory, Monitor, RenderSettings, Rendering, render,
};
use whit::scene::{Effect, Scene};

/// The system's allocator, which keeps count.
struct Counting;

static NOW: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

fn grow(bytes: usize) {
    let now = NOW.fetch_add(bytes, Ordering::Relaxed) + bytes;
    PEAK.fetch_max(now, Ordering::Relaxed);
}

// SAFETY: every call is handed on to the system's allocator as it came; counting touches no memory of it.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: the caller's promise is the system's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }

    // Unlike the trait's own, which copies what shrinks, too
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        // SAFETY: as above.
        let moved = unsafe { System.realloc(pointer, layout, new_size) };
        // Count both blocks of a move, and what is added in place
        if moved != pointer {
            grow(new_size);
            NOW.fetch_sub(layout.size(), Ordering::Relaxed);
        } else if new_size > layout.size() {
            grow(new_size - layout.size());
        } else {
            NOW.fetch_sub(layout.size() - new_size, Ordering::Relaxed);
        }
        moved
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Held by the test that runs.
fn alone() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

fn rendered(scene: &Scene, accel: &dyn Accel, settings: &RenderSettings) -> Rendering {
    let monitor = Monitor::default();
    render(
        scene.validate().unwrap(),
        &scene.cameras[0],
        accel,
        settings,
        &monitor,
    )
    .unwrap()
}

fn with_ledger(settings: RenderSettings) -> RenderSettings {
    RenderSettings {
        ledger: true,
        ..settings
    }
}

/// Holders of memory that are neither an effect nor a category of the profile.
const STRUCTURES: [&str; 7] = [
    "geometry",
    "instances",
    "triangles",
    "user-geometry",
    "tree",
    "extents",
    "unused",
];

fn check_sum(name: &str, memory: &Memory) {
    let effects = Effect::ALL.into_iter().map(Effect::name);
    let accounts = Category::ALL.into_iter().map(Category::name);
    let holders: HashSet<&str> = effects.chain(accounts).chain(STRUCTURES).collect();
    let sum: u64 = holders.iter().map(|holder| memory.of(holder)).sum();
    assert_eq!(sum, memory.total(), "{name}: {:?}", memory.holdings());
    assert!(memory.at_once() > 0 && memory.at_once() <= sum, "{name}");
    let mut seen = HashSet::new();
    for holding in memory.holdings() {
        assert!(
            holding.bytes > 0 && seen.insert((holding.holder, holding.what)),
            "{name}: {holding:?}"
        );
    }
}

#[test]
fn inactive_effects_hold_no_bytes_and_sums_match() {
    let _turn = alone();
    let settings = with_ledger(RenderSettings {
        width: 12,
        height: 9,
        wavelengths: 4,
        ..RenderSettings::default()
    });
    let mut held = HashSet::new();
    for seed in 0..300 {
        let scene = random_scenes::scene(seed);
        let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
        let Rendering { memory, plan, .. } = rendered(&scene, &*accel, &settings);
        check_sum(&format!("scene {seed}"), &memory);
        for effect in Effect::ALL {
            let bytes = memory.of(effect.name());
            if plan.effects().has(effect) {
                held.extend((bytes > 0).then_some(effect));
            } else {
                assert_eq!(bytes, 0, "scene {seed}: {effect}");
            }
        }
    }
    for effect in [
        Effect::Shadow,
        Effect::TransparentShadow,
        Effect::Reflection,
        Effect::Refraction,
        Effect::NestedMedia,
        Effect::Dispersion,
        Effect::Texture,
        Effect::TextureFilter,
        Effect::SmoothNormals,
        Effect::VertexColor,
        Effect::Volume,
        Effect::Environment,
        Effect::RoughReflection,
        Effect::MotionBlur,
        Effect::Subsurface,
    ] {
        assert!(held.contains(&effect), "{effect} never held anything");
    }
}

#[test]
fn with_the_ledger_off_nothing_is_counted() {
    let _turn = alone();
    let scene = random_scenes::scene(1);
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    let settings = RenderSettings {
        width: 4,
        height: 4,
        ..RenderSettings::default()
    };
    assert_eq!(rendered(&scene, &*accel, &settings).memory, Memory::default());
}

#[test]
fn the_parts_of_every_structure_add_up_to_its_bytes() {
    let _turn = alone();
    for file in scene_folder::files() {
        let filed = scene_folder::load(&file);
        for backend in [Backend::default(), Backend::Bsp, Backend::Brute] {
            let accel =
                accel::build(filed.scene.validate().unwrap(), backend, &AccelOptions::default()).unwrap();
            let report = accel.report();
            let sum: u64 = report.parts.iter().map(|part| part.bytes).sum();
            assert_eq!(sum, report.bytes, "{} {backend}: {:?}", filed.name, report.parts);
        }
    }
}

/// The ledger's bytes at once over those that the allocator counted, from before the scene was loaded to the render's
/// peak.
fn share_of_counted(name: &str, threads: usize, change: fn(RenderSettings) -> RenderSettings) -> f64 {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    pool.install(|| {
        let file = format!("{name}.toml");
        // What is made once, by whoever comes first, is no scene's.
        drop(scene_folder::named(&file));
        let before = NOW.load(Ordering::Relaxed);
        let filed = scene_folder::named(&file);
        let accel = accel::build(
            filed.scene.validate().unwrap(),
            Backend::Bsp,
            &AccelOptions::default(),
        )
        .unwrap();
        let settings = change(with_ledger(filed.settings(640, 4)));
        PEAK.store(NOW.load(Ordering::Relaxed), Ordering::Relaxed);
        let rendering = rendered(&filed.scene, &*accel, &settings);
        let counted = PEAK.load(Ordering::Relaxed) - before;
        let total = rendering.memory.at_once();
        check_sum(name, &rendering.memory);
        let share = total as f64 / counted as f64;
        println!("{name}, {threads} threads: {total} of {counted} bytes, {share:.4}");
        if (share - 1.0).abs() > 0.05 {
            println!("{:#?}", rendering.memory.holdings());
        }
        share
    })
}

#[test]
fn reported_bytes_match_the_allocator_within_five_percent() {
    let _turn = alone();
    for (name, threads) in [
        ("textured", 1),
        ("sun_and_sky", 2),
        ("smoke", 2),
        ("forest", 2),
        ("model_among_shapes", 1),
        ("glass_of_water", 2),
    ] {
        let share = || share_of_counted(name, threads, |settings| RenderSettings { spp: 1, ..settings });
        // What two threads hold at once differs from run to run: the middle of three.
        let mut shares = vec![share()];
        if threads > 1 {
            shares.extend([share(), share()]);
            shares.sort_by(f64::total_cmp);
        }
        let share = shares[shares.len() / 2];
        assert!((0.95..=1.05).contains(&share), "{name}: {share}");
    }
    let adaptive = share_of_counted("lecture_lighting", 1, |settings| RenderSettings {
        spp: 16,
        adaptive: Some(Adaptive {
            error: 0.02,
            gain: 1.0,
        }),
        ..settings
    });
    let with_aovs = share_of_counted("lecture_lighting", 1, |settings| RenderSettings {
        sample_aovs: true,
        cost_aovs: true,
        ..settings
    });
    let layered = share_of_counted("lecture_lighting", 1, |settings| RenderSettings {
        layers: AovKind::ALL.into_iter().collect(),
        ..settings
    });
    let divided = |name: &str| {
        share_of_counted(name, 1, |settings| RenderSettings {
            spp: 1,
            light_layers: LightAovs {
                lights: true,
                effects: true,
            },
            ..settings
        })
    };
    let (lit, smoky) = (divided("glass_of_water"), divided("smoke"));
    for (name, share) in [
        ("adaptive", adaptive),
        ("AOVs", with_aovs),
        ("layers", layered),
        ("layers of light", lit),
        ("layers of light in smoke", smoky),
    ] {
        assert!((0.95..=1.05).contains(&share), "{name}: {share}");
    }
}
