//! `whit info --prices`: sampled tiles equal the image; text and JSON contain all measurements.

use std::sync::atomic::AtomicBool;

use crate::support::cli_program::{fails_with, first_light, whit};
use serde_json::Value;
use whit::accel::brute::BruteAccel;
use whit::render::{self, FilterKind, Monitor, PixelFilter, RenderSettings};

/// Scene of an absorbing glass ball over a checkered floor in sunlight: refraction, shadows, textures and their
/// dependent effects. The emissive sphere behind the camera is hit by no ray.
const SCENE: &str = r##"
background = "#9fc4f0"
camera = { from = [0, 2, 6], at = [0, 1, 0], fov = 40 }

[[light]]
kind = "directional"
direction = [-1, -2, -1]
intensity = 3

[texture.checks]
pattern = "checker"
colors = ["#802020", "#f0e0c0"]

[material.floor]
base_color = { texture = "checks" }
roughness = 0.9

[material.glass]
transmission = 1
roughness = 0
ior = 1.5

[material.hidden]
emission = 1

[[object]]
shape = "plane"
transform = [{ z-to = [0, 1, 0] }]
material = "floor"

[[object]]
shape = "sphere"
transform = [{ translate = [0, 1, 0] }]
material = "glass"

[[object]]
shape = "sphere"
transform = [{ scale = 0.1 }, { translate = [0, 0, 900] }]
material = "hidden"
"##;

/// Writes the scene to a temporary folder and returns the folder and the path.
fn scene() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, SCENE).unwrap();
    let path = path.display().to_string();
    (folder, path)
}

fn prices(more: &[&str]) -> Value {
    let (_folder, path) = scene();
    let args = [
        "info", &path, "--json", "--prices", "--size", "96x64", "--spp", "1", "--budget", "0",
    ];
    let run = whit(&[&args[..], more].concat());
    assert_eq!((run.code, &*run.stderr), (0, ""));
    let info: Value = serde_json::from_str(&run.stdout).unwrap();
    info["prices"].clone()
}

#[test]
fn sampled_tiles_equal_the_whole_image_to_the_bit() {
    let (_folder, path) = scene();
    let scene = whit::scene_file::load(path.as_ref(), &Default::default())
        .unwrap()
        .scene;
    let camera = &scene.cameras[0];
    let accel = BruteAccel::new(&scene);
    let cancel = AtomicBool::new(false);
    let monitor = Monitor {
        cancel: &cancel,
        ..Monitor::default()
    };
    for (kind, spp) in [
        (FilterKind::Box, 1),
        (FilterKind::Box, 16),
        (FilterKind::Mitchell, 4),
    ] {
        let settings = RenderSettings {
            width: 150,
            height: 90,
            spp,
            filter: PixelFilter::of_kind(kind),
            ..RenderSettings::default()
        };
        let whole = render::render(scene.validate().unwrap(), camera, &accel, &settings, &monitor).unwrap();
        for count in [3, 100] {
            let sample = render::render_sample(
                (scene.validate().unwrap(), camera),
                &accel,
                &settings,
                count,
                &monitor,
            )
            .unwrap();
            assert_eq!(sample.tiles.len(), count.min(render::tile_count(150, 90)));
            for tile in &sample.tiles {
                for (index, pixel) in tile.image.pixels.iter().enumerate() {
                    let (x, y) = (index as u32 % tile.image.width, index as u32 / tile.image.width);
                    let expected = whole.image.pixel(tile.x + x, tile.y + y);
                    assert_eq!(
                        pixel.map(f32::to_bits),
                        expected.map(f32::to_bits),
                        "{kind:?} {}, {}",
                        tile.x + x,
                        tile.y + y
                    );
                }
            }
            if count == 100 && kind == FilterKind::Box {
                assert_eq!(sample.ledger.camera_rays(), whole.ledger.camera_rays());
                assert_eq!(sample.ledger.shadow_rays(), whole.ledger.shadow_rays());
            }
        }
    }
}

#[test]
fn every_effect_and_every_bounce_has_a_cost() {
    let prices = prices(&["--depth", "3", "--backend", "bsp", "--threads", "1"]);
    let key = |key: &str| prices[key].as_u64().unwrap();
    assert_eq!(
        (key("width"), key("height"), key("spp"), key("depth")),
        (96, 64, 1, 3)
    );
    assert_eq!(
        (key("tiles"), key("tiles_in_all"), key("runs"), key("threads")),
        (6, 6, 5, 1)
    );
    assert_eq!(prices["backend"], "bsp");
    assert!(prices["seconds_forecast"].as_f64().unwrap() > 0.0);
    let list = prices["list"].as_array().unwrap();
    let effects: Vec<&str> = list
        .iter()
        .filter_map(|price| price["without"].as_str())
        .collect();
    for effect in ["shadow", "refraction", "texture", "emission", "background"] {
        assert!(effects.contains(&effect), "{effect} in {effects:?}");
    }
    let mut depths: Vec<u64> = list.iter().filter_map(|price| price["depth"].as_u64()).collect();
    depths.sort_unstable();
    assert_eq!(depths, [0, 1, 2]);
    for price in list {
        let time = |key: &str| price["time"][key].as_f64().unwrap();
        assert!(
            time("low") <= time("median") && time("median") <= time("high"),
            "{price}"
        );
        assert!(time("median") > -1.0 && time("noise") >= 0.0, "{price}");
        let flip = price["picture"]["flip"].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&flip), "{price}");
    }
}

#[test]
fn effect_that_no_ray_hits_changes_no_pixel() {
    let prices = prices(&[]);
    let list = prices["list"].as_array().unwrap();
    let price = |effect: &str| list.iter().find(|price| price["without"] == effect).unwrap();
    let emission = price("emission");
    assert_eq!(emission["changes_picture"], false);
    assert_eq!(emission["picture"]["flip"], 0.0);
    assert_eq!(emission["picture"]["radiance"]["max"], 0.0);
    for effect in ["shadow", "refraction", "texture", "background"] {
        let price = price(effect);
        assert_eq!(price["changes_picture"], true, "{price}");
        assert!(
            price["picture"]["changed_share"].as_f64().unwrap() > 0.0,
            "{price}"
        );
    }
}

#[test]
fn costs_are_sorted_with_noise_last() {
    let prices = prices(&[]);
    let list = prices["list"].as_array().unwrap();
    let key = |price: &Value| match price["time"]["within_noise"].as_bool().unwrap() {
        true => f64::INFINITY,
        false => price["time"]["median"].as_f64().unwrap(),
    };
    assert!(list.iter().map(key).is_sorted(), "{prices}");
}

#[test]
fn removed_effect_lists_its_dependent_effects() {
    let prices = prices(&["--effects=+absorption"]);
    let list = prices["list"].as_array().unwrap();
    let refraction = list
        .iter()
        .find(|price| price["without"] == "refraction")
        .unwrap();
    let along = refraction["takes_along"].as_array().unwrap();
    assert!(along.contains(&"absorption".into()), "{refraction}");
}

#[test]
fn depths_that_no_ray_reaches_are_omitted() {
    // Paths pass through the ball and end at the floor, so they have few bounces.
    let prices = prices(&["--depth", "255"]);
    let reached = prices["depth_reached"].as_u64().unwrap();
    let steps = prices["list"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|price| price["depth"].is_u64());
    assert!(reached < 16);
    assert_eq!(steps.count() as u64, reached);
}

#[test]
fn text_has_a_line_per_cost_and_time_shares_of_effects() {
    let args = ["--prices", "--size", "64x64", "--spp", "1", "--budget", "0"];
    let run = whit(&[&["info", &*first_light()], &args[..]].concat());
    assert_eq!((run.code, &*run.stderr), (0, ""));
    let starting = |words: &str| run.stdout.lines().filter(|line| line.starts_with(words)).count();
    assert_eq!(
        starting("prices         by 4 of 4 tiles of 64x64 pixels"),
        1,
        "{}",
        run.stdout
    );
    assert_eq!(
        starting("price          shadow: without it: "),
        1,
        "{}",
        run.stdout
    );
    let share = |line: &str| line.starts_with("effect         shadow on") && line.contains("time");
    assert!(run.stdout.lines().any(share), "{}", run.stdout);
    let quick = whit(&["info", &first_light()]);
    assert!(
        !quick.stdout.lines().any(|line| line.starts_with("price")),
        "{}",
        quick.stdout
    );
}

#[test]
fn cost_flags_require_the_prices_flag() {
    let (_folder, path) = scene();
    let run = whit(&["info", &path, "--spp", "4"]);
    assert_eq!((run.code, &*run.stdout), (2, ""));
    assert!(run.stderr.contains("--prices"), "{}", run.stderr);
    fails_with(2, "give seconds", &["info", &path, "--prices", "--budget=-1"]);
}
