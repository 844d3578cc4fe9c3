//! Every scene of the folder `scenes` looks as it did when somebody last looked at it.
//!
//! `tests/golden` holds a picture of each, 80 pixels a row and of one sample a pixel, by the BSP, which is Rust all
//! through: the same everywhere but for what the system's mathematical functions round. Values are halves, zipped.
//!
//! A change that is meant to change pictures makes them anew: run
//! `WHIT_WRITE_GOLDENS=1 cargo test --release --test it goldens`, and look at the new files before they are
//! committed.

use std::path::{Path, PathBuf};

use crate::support::scene_folder::{FiledScene, files, load};
use exr::prelude::{Encoding, Image, Layer, LayerAttributes, SpecificChannels, Vec2, WritableImage, f16};
use whit::accel::Backend;
use whit::image::{LinearImage, read_exr};

/// Set to anything, it has the pictures written instead of compared.
const WRITE: &str = "WHIT_WRITE_GOLDENS";
/// Pixels a row.
const WIDTH: u32 = 80;
/// Difference of a channel, of 1 more than its value, from which on a pixel counts as different: four roundings to half
/// precision (2^-11), of which the file holds one.
const TOLERANCE: f32 = 4.0 / 2048.0;
/// One pixel in this many may be different: other mathematical functions may turn an edge's pixel or two.
const DIFFERENT: usize = 500;
/// Mean difference allowed, of 1 more than the value: half of what the rounding of the files may do.
const MEAN: f64 = 1.0 / 4096.0;
/// Bytes of all files together.
const MAX_BYTES: u64 = 1_200_000;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden")
}

fn golden(name: &str) -> PathBuf {
    folder().join(format!("{name}.exr"))
}

fn picture(filed: &FiledScene) -> LinearImage {
    filed.picture(Backend::Bsp, &filed.settings(WIDTH, 1))
}

fn write(image: &LinearImage, path: &Path) {
    let channels = SpecificChannels::rgb(|position: Vec2<usize>| {
        let [r, g, b] = image
            .pixel(position.x() as u32, position.y() as u32)
            .map(f16::from_f32);
        (r, g, b)
    });
    let size = (image.width as usize, image.height as usize);
    let layer = Layer::new(
        size,
        LayerAttributes::default(),
        Encoding::SMALL_LOSSLESS,
        channels,
    );
    Image::from_layer(layer).write().to_file(path).unwrap();
}

/// How far two pixels are apart: the worst channel's difference, of 1 more than its value; infinite if one is not
/// finite.
fn distance(found: [f32; 3], expected: [f32; 3]) -> f32 {
    let channel = |c: usize| (found[c] - expected[c]).abs() / (1.0 + expected[c].abs());
    let channels = [0, 1, 2].map(channel);
    if channels.iter().all(|d| d.is_finite()) {
        channels.into_iter().fold(0.0, f32::max)
    } else {
        f32::INFINITY
    }
}

/// What is wrong with a picture, if anything.
fn fault(found: &LinearImage, expected: &LinearImage) -> Option<String> {
    if (found.width, found.height) != (expected.width, expected.height) {
        let [a, b] = [found, expected].map(|image| format!("{} x {}", image.width, image.height));
        return Some(format!("is {a}, not {b}"));
    }
    let pairs = found.pixels.iter().zip(&expected.pixels);
    let distances: Vec<f32> = pairs.map(|(a, b)| distance(*a, *b)).collect();
    let different = distances.iter().filter(|d| **d > TOLERANCE).count();
    // What is not finite is among the different already.
    let finite = distances.iter().filter(|d| d.is_finite());
    let mean = finite.map(|d| f64::from(*d)).sum::<f64>() / distances.len() as f64;
    let fine = different * DIFFERENT <= distances.len() && mean <= MEAN;
    (!fine).then(|| format!("has {different} different pixels, a mean difference of {mean:.2e}"))
}

#[test]
fn every_scene_looks_as_it_did() {
    let writes = std::env::var_os(WRITE).is_some();
    let mut faults = Vec::new();
    for file in files() {
        let filed = load(&file);
        let (image, path) = (picture(&filed), golden(&filed.name));
        if writes {
            write(&image, &path);
        }
        let expected = read_exr(&path).unwrap_or_else(|e| panic!("{e}: see the head of this test"));
        faults.extend(fault(&image, &expected).map(|fault| format!("{} {fault}", filed.name)));
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn every_golden_picture_is_that_of_a_scene_and_all_are_small() {
    let stem = |file: PathBuf| file.file_stem().unwrap().to_string_lossy().into_owned();
    let names: Vec<PathBuf> = files().into_iter().map(|file| golden(&stem(file))).collect();
    let entries = folder().read_dir().unwrap();
    let mut bytes = 0;
    for entry in entries.map(|entry| entry.unwrap()) {
        assert!(
            names.contains(&entry.path()),
            "{} has no scene",
            entry.path().display()
        );
        bytes += entry.metadata().unwrap().len();
    }
    println!("{bytes} bytes");
    assert!(bytes < MAX_BYTES, "{bytes} bytes");
}

#[test]
fn a_picture_with_a_patch_of_other_pixels_or_another_brightness_is_found_out() {
    let mut expected = LinearImage::black(80, 60);
    expected
        .pixels
        .iter_mut()
        .enumerate()
        .for_each(|(i, pixel)| *pixel = [i as f32 / 4800.0; 3]);
    assert_eq!(fault(&expected, &expected), None);
    let changed = |change: &dyn Fn(usize, &mut [f32; 3])| {
        let mut image = expected.clone();
        image
            .pixels
            .iter_mut()
            .enumerate()
            .for_each(|(i, pixel)| change(i, pixel));
        fault(&image, &expected)
    };
    // 4800 / 500 = 9.6
    assert_eq!(
        changed(&|i, pixel| pixel[1] += if i < 9 { 0.01 } else { 0.0 }),
        None
    );
    assert!(changed(&|i, pixel| pixel[1] += if i < 10 { 0.01 } else { 0.0 }).is_some());
    assert!(changed(&|i, pixel| pixel[2] = if i < 10 { f32::NAN } else { pixel[2] }).is_some());
    assert!(changed(&|_, pixel| *pixel = pixel.map(|c| c * 1.001)).is_some());
    assert!(fault(&LinearImage::black(60, 80), &expected).is_some());
}
