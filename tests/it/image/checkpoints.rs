//! Tests of checkpoints of adaptive sampling: interrupted renders give the bits of uninterrupted ones.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use crate::support::scene_folder;
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::render::{
    Adaptive, Cancelled, Checkpoints, FinishedTile, Monitor, Pattern, RenderSettings, Rendering, Rounds,
    render_on,
};
use whit::scene::Scene;

/// Limit on the number of runs, above which rendering must have restarted.
const MAX_RUNS: usize = 1000;

fn settings(size: [u32; 2], spp: u32) -> RenderSettings {
    RenderSettings {
        width: size[0],
        height: size[1],
        spp,
        pattern: Pattern::Sobol,
        adaptive: Some(Adaptive {
            error: 0.01,
            gain: 1.0,
        }),
        sample_aovs: true,
        ..RenderSettings::default()
    }
}

fn by(
    scene: &Scene,
    accel: &dyn Accel,
    settings: &RenderSettings,
    checkpoints: Option<&mut Checkpoints>,
) -> Result<Rendering, Cancelled> {
    let monitor = Monitor {
        progress: &|part| assert!((0.0..=1.0).contains(&part), "{part}"),
        cancel: &AtomicBool::new(false),
        tiles: None,
    };
    render_on(
        scene.validate().unwrap(),
        &scene.cameras[0],
        accel,
        settings,
        &monitor,
        checkpoints,
    )
}

/// Returns the state after writing and reading a checkpoint.
fn written(rounds: &Rounds, [width, height]: [usize; 2]) -> Rounds {
    let mut read = Rounds::new([width, height]);
    read.set_rest(&rounds.rest()).unwrap();
    let rows = 0..height;
    let words = rounds.words(&rows);
    let planes: Vec<&[u32]> = words.iter().map(|plane| &plane[..]).collect();
    read.set_words(&rows, &planes).unwrap();
    read
}

fn bits(rendering: &Rendering) -> Vec<u32> {
    let colors = rendering.image.pixels.iter().flatten();
    let aovs = rendering.aovs.as_ref().unwrap();
    let aovs = aovs.samples.iter().chain(&aovs.variance);
    colors.chain(aovs).map(|value| value.to_bits()).collect()
}

#[test]
fn resumed_render_has_the_bits_of_one_run_without_repeated_work() {
    for (name, spp) in [
        ("whitted_1980.toml", 128),
        ("textured.toml", 64),
        ("soft_shadows.toml", 64),
    ] {
        let scene = scene_folder::named(name).scene;
        let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
        let settings = settings([90, 70], spp);
        // Render without interruption
        let whole = by(&scene, &*accel, &settings, None).unwrap();
        assert!(whole.samples.mean > 16.0, "{name}: one round only");
        let mut start = None;
        let mut goes = 0;
        // Render in runs that stop at each checkpoint
        let last = loop {
            goes += 1;
            assert!(goes < MAX_RUNS, "{name}");
            // Each run is interrupted one checkpoint later than the previous one.
            let mut kept = None;
            let mut keep = |rounds: &Rounds| {
                kept = Some(written(rounds, [90, 70]));
                ControlFlow::Break(())
            };
            let mut checkpoints = Checkpoints {
                start: start.take(),
                seconds: 0.0,
                keep: &mut keep,
            };
            let made = by(&scene, &*accel, &settings, Some(&mut checkpoints));
            match made {
                Ok(rendering) => break rendering,
                Err(Cancelled) => start = kept,
            }
        };
        // The last run gives the whole image, and repeats no work
        assert!(goes > 2, "{name}: {goes} goes");
        assert_eq!(bits(&last), bits(&whole), "{name}");
        let [rest, all] = [&last, &whole].map(|rendering| rendering.ledger.camera_rays());
        assert!(
            rest < all / 2,
            "{name}: the last go took {rest} camera rays of {all}"
        );
    }
}

#[test]
fn cancelled_render_keeps_its_checkpoint() {
    let scene = scene_folder::named("whitted_1980.toml").scene;
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    let settings = settings([200, 150], 64);
    let cancel = AtomicBool::new(false);
    // Cancel as soon as the first tiles are finished.
    let seen = AtomicUsize::new(0);
    let tiles = |_: FinishedTile| {
        if seen.fetch_add(1, Ordering::Relaxed) == 3 {
            cancel.store(true, Ordering::Relaxed);
        }
    };
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &cancel,
        tiles: Some(&tiles),
    };
    let mut kept = None;
    let mut keep = |rounds: &Rounds| {
        kept = Some(rounds.clone());
        ControlFlow::Continue(())
    };
    let mut checkpoints = Checkpoints {
        start: None,
        seconds: 1e6,
        keep: &mut keep,
    };
    let camera = &scene.cameras[0];
    // Render until cancelled
    let ended = render_on(
        scene.validate().unwrap(),
        camera,
        &*accel,
        &settings,
        &monitor,
        Some(&mut checkpoints),
    );
    assert_eq!(ended.err(), Some(Cancelled));
    let start = kept.expect("what was finished is kept");
    // Resume from the checkpoint
    let mut keep = |_: &Rounds| ControlFlow::Continue(());
    let mut checkpoints = Checkpoints {
        start: Some(start),
        seconds: 1e6,
        keep: &mut keep,
    };
    let gone_on = by(&scene, &*accel, &settings, Some(&mut checkpoints)).unwrap();
    // Compare with an uninterrupted render
    let whole = by(&scene, &*accel, &settings, None).unwrap();
    assert_eq!(bits(&gone_on), bits(&whole));
    assert!(gone_on.ledger.camera_rays() < whole.ledger.camera_rays());
}

#[test]
fn checkpoint_of_another_image_is_discarded() {
    let scene = scene_folder::named("whitted_1980.toml").scene;
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    let settings = settings([48, 40], 64);
    let whole = by(&scene, &*accel, &settings, None).unwrap();
    let mut keep = |_: &Rounds| ControlFlow::Continue(());
    let mut checkpoints = Checkpoints {
        start: Some(Rounds::new([40, 48])),
        seconds: 0.0,
        keep: &mut keep,
    };
    let made = by(&scene, &*accel, &settings, Some(&mut checkpoints)).unwrap();
    assert_eq!(bits(&made), bits(&whole));
}
