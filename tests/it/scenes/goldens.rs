//! Compares every scene of the folder `scenes` with its stored golden image.
//!
//! `tests/golden` holds an image of each scene with 80 pixels per row and one sample per pixel. The BSP renders them,
//! which is pure Rust: the images differ between systems only by the rounding of their mathematical functions. Values
//! are half floats with ZIP compression.
//!
//! After an intended change of images, run `WHIT_WRITE_GOLDENS=1 cargo test --release --test it goldens`, and look at
//! the new files before you commit them.

use std::path::{Path, PathBuf};

use crate::support::scene_folder::{FiledScene, files, load};
use exr::prelude::{Encoding, Image, Layer, LayerAttributes, SpecificChannels, Vec2, WritableImage, f16};
use whit::accel::Backend;
use whit::image::{LinearImage, read_exr};

/// Environment variable that makes the test write the images instead of comparing them.
const WRITE: &str = "WHIT_WRITE_GOLDENS";
/// Number of pixels per row.
const WIDTH: u32 = 80;
/// Difference of a channel, relative to 1 plus its value, above which a pixel counts as different: four roundings to
/// half precision (2^-11), one of which is in the file.
const TOLERANCE: f32 = 4.0 / 2048.0;
/// One pixel in this many may differ: other mathematical functions may change a pixel or two at edges.
const DIFFERENT: usize = 500;
/// Allowed mean difference, relative to 1 plus the value: half of the maximum rounding error of the files.
const MEAN: f64 = 1.0 / 4096.0;
/// Limit on the size of all files together, in bytes.
const MAX_BYTES: u64 = 1_200_000;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden")
}

fn golden(name: &str) -> PathBuf {
    folder().join(format!("{name}.exr"))
}

fn render_image(filed: &FiledScene) -> LinearImage {
    filed.rendered(Backend::Bsp, &filed.settings(WIDTH, 1))
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

/// Returns the largest difference of the channels of two pixels, relative to 1 plus the value; infinite if a channel is
/// not finite.
fn distance(found: [f32; 3], expected: [f32; 3]) -> f32 {
    let channel = |c: usize| (found[c] - expected[c]).abs() / (1.0 + expected[c].abs());
    let channels = [0, 1, 2].map(channel);
    if channels.iter().all(|d| d.is_finite()) {
        channels.into_iter().fold(0.0, f32::max)
    } else {
        f32::INFINITY
    }
}

/// Returns a description of the difference between two images, if it exceeds the tolerances.
fn fault(found: &LinearImage, expected: &LinearImage) -> Option<String> {
    if (found.width, found.height) != (expected.width, expected.height) {
        let [a, b] = [found, expected].map(|image| format!("{} x {}", image.width, image.height));
        return Some(format!("is {a}, not {b}"));
    }
    let pairs = found.pixels.iter().zip(&expected.pixels);
    let distances: Vec<f32> = pairs.map(|(a, b)| distance(*a, *b)).collect();
    let different = distances.iter().filter(|d| **d > TOLERANCE).count();
    // Non-finite pixels are already counted as different.
    let finite = distances.iter().filter(|d| d.is_finite());
    let mean = finite.map(|d| f64::from(*d)).sum::<f64>() / distances.len() as f64;
    let fine = different * DIFFERENT <= distances.len() && mean <= MEAN;
    (!fine).then(|| format!("has {different} different pixels, a mean difference of {mean:.2e}"))
}

#[test]
fn every_scene_matches_its_golden_image() {
    let writes = std::env::var_os(WRITE).is_some();
    let mut faults = Vec::new();
    for file in files() {
        let filed = load(&file);
        let (image, path) = (render_image(&filed), golden(&filed.name));
        if writes {
            write(&image, &path);
        }
        let expected = read_exr(&path).unwrap_or_else(|e| panic!("{e}: see the head of this test"));
        faults.extend(fault(&image, &expected).map(|fault| format!("{} {fault}", filed.name)));
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn every_golden_image_belongs_to_a_scene_and_is_small() {
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
fn golden_comparison_detects_patches_and_brightness_changes() {
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
