//! Textures averaged over the width of the ray: one sample a pixel shows what 256 show.
//!
//! The board is a checkerboard of black and white squares up to the horizon, seen without light, from one metre above,
//! so that its squares become smaller than a pixel half-way up to it. The horizon lies between two rows, and the sky is
//! the board's mean, as this is about textures and not about silhouettes. The board comes in three kinds: a procedure,
//! an image with mipmaps, and, not filtered, an image of four texels of which the nearest counts.
//!
//! Benchmark of its cost: `cargo bench --bench timing -- texture_filtering`.

use crate::support::checkerboards::{
    EMPTY, GLASS, MIPMAPPED, MIRROR, PROCEDURE, SHARP, bsp, render_image, scene,
};
use whit::image::LinearImage;

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

/// Returns the error of one sample per pixel of the board against 256 samples.
fn error_of_one_sample(texture: &str) -> f64 {
    let scene = scene(texture, EMPTY);
    let accel = bsp(&scene);
    let [one, many] = [1, 256].map(|spp| render_image(&scene, &*accel, 192, spp));
    rmse(&one, &many)
}

/// A small image of the board with a ball or without.
fn small(texture: &str, ball: &str, spp: u32) -> LinearImage {
    let scene = scene(texture, ball);
    render_image(&scene, &*bsp(&scene), 64, spp)
}

#[test]
fn filtered_checkerboard_at_1_sample_matches_256() {
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
fn filtering_halves_the_error_in_mirror_and_glass_balls() {
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
fn all_three_checkerboards_show_equal_squares() {
    let sharp = small(SHARP, EMPTY, 64);
    for (kind, texture) in [("procedure", PROCEDURE), ("image", MIPMAPPED)] {
        let error = rmse(&small(texture, EMPTY, 64), &sharp);
        println!("{kind}: {error:.4}");
        assert!(error < 0.05, "{kind}: {error}");
    }
}
