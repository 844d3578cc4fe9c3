//! Textures averaged over the width of the ray: one sample a pixel shows what 256 show.
//!
//! The board is a checkerboard of black and white squares up to the horizon, seen without light, from one metre above,
//! so that its squares become smaller than a pixel half-way up to it. The horizon lies between two rows, and the sky is
//! the board's mean, as this is about textures and not about silhouettes. The board comes in three kinds: a procedure,
//! an image with mipmaps, and, not filtered, an image of four texels of which the nearest counts.
//!
//! What it costs: `cargo test --release --test mip_filtering -- --ignored --nocapture`.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use image::{Luma, imageops::FilterType};
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::gltf::LoadOptions;
use whit::image::LinearImage;
use whit::render::{Monitor, RenderSettings, render};
use whit::scene::Scene;
use whit::scene_file;

/// Squares have sides of half a metre, two a unit of texture coordinates.
const PROCEDURE: &str = "pattern = 'checker'\nspace = 'uv'\nscale = 2";
const MIPMAPPED: &str = "image = 'fine.png'\nfilter = 'mipmap'";
const SHARP: &str = "image = 'coarse.png'\nfilter = 'nearest'";

/// Nothing stands on the board.
const EMPTY: &str = "";
/// A ball that fills the picture of the near camera.
const MIRROR: &str = "base_color = 1\nmetallic = 1\nroughness = 0";
const GLASS: &str = "ior = 1.5\ntransmission = 1\nroughness = 0";

/// The board, with a ball of some material in front of a closer camera unless it is [`EMPTY`].
fn scene(texture: &str, ball: &str) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let coarse = image::ImageBuffer::from_fn(2, 2, |x, y| Luma([255 * ((x + y) % 2) as u8]));
    coarse.save(folder.path().join("coarse.png")).unwrap();
    let fine = image::imageops::resize(&coarse, 128, 128, FilterType::Nearest);
    fine.save(folder.path().join("fine.png")).unwrap();
    let view = match ball {
        EMPTY => "from = [0, 1, 0]\nat = [0, 1, -1]\nfov = 50".to_owned(),
        material => format!(
            "from = [0, 1.3, 6]\nat = [0, 1.1, 0]\nfov = 12\n\
             [material.ball]\n{material}\n\
             [[object]]\nshape = {{ sphere = {{ center = [0, 1.1, 0] }} }}\nmaterial = 'ball'"
        ),
    };
    // Neither along the view nor along a diagonal, and no square's edge under the camera.
    let board = "shape = 'plane'\ntransform = [{ rotate = [0, 0, 1, 27] }, { z-to = [0, 1, 0] }, \
                 { translate = [0.13, 0, 0.07] }]";
    let text = format!(
        "background = 0.5\n[camera]\n{view}\n[texture.board]\n{texture}\n\
         [material.board]\nmodel = 'unlit'\nbase_color = {{ texture = 'board' }}\n\
         [[object]]\n{board}\nmaterial = 'board'\n"
    );
    load(folder.path(), &text)
}

fn load(folder: &Path, text: &str) -> Scene {
    let file = folder.join("board.toml");
    std::fs::write(&file, text).unwrap();
    let loaded = scene_file::load(&file, &LoadOptions::default());
    loaded.unwrap_or_else(|fault| panic!("{fault}")).scene
}

fn picture(scene: &Scene, accel: &dyn Accel, width: u32, spp: u32) -> LinearImage {
    let settings = RenderSettings {
        width,
        height: width / 4 * 3,
        spp,
        ..RenderSettings::default()
    };
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(false),
        tiles: None,
    };
    render(scene, &scene.cameras[0], accel, &settings, &monitor)
        .unwrap()
        .image
}

fn bsp(scene: &Scene) -> Box<dyn Accel + '_> {
    accel::build(scene, Backend::Bsp, &AccelOptions::default()).unwrap()
}

/// Root mean square difference of radiance, black 0 and white 1.
fn rmse(image: &LinearImage, reference: &LinearImage) -> f64 {
    let pairs = image
        .pixels
        .as_flattened()
        .iter()
        .zip(reference.pixels.as_flattened());
    let squares: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
    (squares / (3 * image.pixels.len()) as f64).sqrt()
}

/// How far one sample a pixel of the board is from 256 of it.
fn error_of_one_sample(texture: &str) -> f64 {
    let scene = scene(texture, EMPTY);
    let accel = bsp(&scene);
    let [one, many] = [1, 256].map(|spp| picture(&scene, &*accel, 192, spp));
    rmse(&one, &many)
}

/// A small picture of the board with a ball or without.
fn small(texture: &str, ball: &str, spp: u32) -> LinearImage {
    let scene = scene(texture, ball);
    picture(&scene, &*bsp(&scene), 64, spp)
}

#[test]
fn a_checkerboard_up_to_the_horizon_looks_at_one_sample_a_pixel_as_at_256() {
    for (kind, texture) in [("procedure", PROCEDURE), ("image", MIPMAPPED)] {
        let error = error_of_one_sample(texture);
        println!("{kind}: {error:.4}");
        assert!(error < 0.02, "{kind}: {error}");
    }
    let error = rmse(&small(SHARP, EMPTY, 1), &small(SHARP, EMPTY, 64));
    println!("not filtered: {error:.4}");
    assert!(error > 0.1, "nothing had to be filtered: {error}");
}

#[test]
fn in_a_mirroring_ball_and_through_a_glass_ball_filtering_takes_away_half_of_the_error_at_least() {
    for (name, ball) in [("mirror", MIRROR), ("glass", GLASS)] {
        let truth = small(SHARP, ball, 256);
        let [procedure, image, sharp] =
            [PROCEDURE, MIPMAPPED, SHARP].map(|texture| rmse(&small(texture, ball, 1), &truth));
        println!("{name}: procedure {procedure:.4}, image {image:.4}, not filtered {sharp:.4}");
        assert!(procedure < 0.5 * sharp, "{name}: {procedure} {sharp}");
        assert!(image < 0.5 * sharp, "{name}: {image} {sharp}");
    }
}

#[test]
fn all_three_boards_show_the_same_squares() {
    let sharp = small(SHARP, EMPTY, 64);
    for (kind, texture) in [("procedure", PROCEDURE), ("image", MIPMAPPED)] {
        let error = rmse(&small(texture, EMPTY, 64), &sharp);
        println!("{kind}: {error:.4}");
        assert!(error < 0.05, "{kind}: {error}");
    }
}

/// Prints medians of turns taken one after another, so that whatever else the machine does falls on all alike.
#[test]
#[ignore = "it measures time"]
fn what_filtering_costs() {
    const TURNS: usize = 5;
    let kinds = [
        ("not filtered", SHARP),
        ("image, mipmaps", MIPMAPPED),
        ("procedure", PROCEDURE),
    ];
    for (name, ball) in [("empty", EMPTY), ("mirror", MIRROR), ("glass", GLASS)] {
        let scenes = kinds.map(|(_, texture)| scene(texture, ball));
        let accels = scenes.each_ref().map(bsp);
        let mut seconds = [const { Vec::new() }; 3];
        for _ in 0..TURNS {
            for (kind, seconds) in seconds.iter_mut().enumerate() {
                let start = Instant::now();
                picture(&scenes[kind], &*accels[kind], 640, 4);
                seconds.push(start.elapsed().as_secs_f64());
            }
        }
        for ((kind, _), seconds) in kinds.iter().zip(&mut seconds) {
            seconds.sort_by(f64::total_cmp);
            let [least, median, most] = [0, TURNS / 2, TURNS - 1].map(|i| 1e3 * seconds[i]);
            println!("{name}, {kind}: {median:.1} ms ({least:.1} to {most:.1})");
        }
    }
}
