//! Denoising by Open Image Denoise, of the library in the folder that the environment variable `WHIT_OIDN` names; without
//! it these tests are skipped.

use std::path::{Path, PathBuf};

use exr::prelude::{ReadChannels, ReadLayers, read};
use whit::image::{DenoiseGuides, Denoiser, LinearImage};
use whit::render::{AovKind, AovSet, RenderSettings};

use crate::support::cli_program::{fails_with, whit};
use crate::support::images::{rendered, settings};
use crate::support::scene_folder;

const CORNELL_BOX: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cornell_box.toml");

/// Returns the folder of the library, or says that a test is skipped.
fn library() -> Option<PathBuf> {
    let folder = std::env::var_os("WHIT_OIDN").map(PathBuf::from);
    if folder.is_none() {
        println!("skipped: WHIT_OIDN names no folder of Open Image Denoise");
    }
    folder
}

fn rmse(a: &LinearImage, b: &LinearImage) -> f64 {
    let pairs = a.pixels.iter().flatten().zip(b.pixels.iter().flatten());
    let squares = pairs.map(|(a, b)| f64::from(a.min(1.0) - b.min(1.0)).powi(2));
    (squares.sum::<f64>() / (3 * a.pixels.len()) as f64).sqrt()
}

#[test]
fn denoised_image_is_nearer_to_the_converged_one() {
    let Some(folder) = library() else { return };
    let denoiser = Denoiser::load(Some(&folder)).unwrap();
    assert!(
        denoiser.name().starts_with("Open Image Denoise 2."),
        "{}",
        denoiser.name()
    );
    let scene = scene_folder::named("cornell_box.toml").scene;
    let camera = &scene.cameras[0];
    let converged = rendered(&scene, camera, &settings(64, 512)).image;
    let noisy = rendered(&scene, camera, &settings(64, 4).with_guides());
    let mut guided = noisy.clone();
    guided.denoise(&denoiser, AovSet::NONE).unwrap();
    assert!(guided.layers.is_empty());
    let mut blind = noisy.image.clone();
    denoiser.denoise(&mut blind, None).unwrap();
    let [before, after, unguided] =
        [&noisy.image, &guided.image, &blind].map(|image| rmse(image, &converged));
    assert!(after < 0.7 * before, "{before} before, {after} after");
    assert!(unguided < 0.7 * before, "{before} before, {unguided} after");
    assert!(guided.image.non_finite_count() == 0);
}

#[test]
fn guides_stay_where_they_are_requested() {
    let Some(folder) = library() else { return };
    let denoiser = Denoiser::load(Some(&folder)).unwrap();
    let scene = scene_folder::named("first_light.gltf").scene;
    let albedo = AovSet::NONE.with(AovKind::Albedo);
    let requested = RenderSettings {
        layers: albedo,
        ..settings(24, 1)
    };
    let plain = rendered(&scene, &scene.cameras[0], &requested);
    let mut denoised = rendered(&scene, &scene.cameras[0], &requested.with_guides());
    denoised.denoise(&denoiser, albedo).unwrap();
    assert!(!plain.layers.is_empty());
    assert_eq!(plain.layers, denoised.layers);
}

#[test]
fn guides_of_another_size_are_refused() {
    let Some(folder) = library() else { return };
    let denoiser = Denoiser::load(Some(&folder)).unwrap();
    let mut image = LinearImage::black(8, 8);
    let error = denoiser
        .denoise(&mut image, Some(&DenoiseGuides::default()))
        .unwrap_err();
    assert!(error.to_string().contains("size"), "{error}");
    denoiser.denoise(&mut image, None).unwrap();
    assert!(
        image.pixels.iter().flatten().all(|value| value.abs() < 1e-3),
        "{:?}",
        image.pixels
    );
}

#[test]
fn command_line_denoises_and_names_the_library() {
    let Some(library) = library() else { return };
    let folder = tempfile::tempdir().unwrap();
    let [plain, denoised] = ["plain.exr", "denoised.exr"].map(|name| folder.path().join(name));
    let scene = Path::new(CORNELL_BOX);
    let render = |out: &Path, flags: &[&str]| {
        let fixed = [
            scene.to_str().unwrap(),
            "-o",
            out.to_str().unwrap(),
            "--size",
            "32x32",
            "--spp",
            "4",
        ];
        let run = whit(&[&["render", "--backend", "bsp"][..], &fixed, flags].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        run.stdout
    };
    let words = render(&plain, &[]);
    assert!(words.contains("estimated error"), "{words}");
    let words = render(&denoised, &["--denoise", "--oidn", library.to_str().unwrap()]);
    assert!(!words.contains("estimated error"), "{words}");
    // The file has the colours alone, and the library's name
    let read = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(&denoised)
        .unwrap();
    assert_eq!(read.layer_data.channel_data.list.len(), 3);
    let attributes = format!("{:?}", read.layer_data.attributes.other);
    assert!(attributes.contains("Open Image Denoise"), "{attributes}");
    fails_with(
        2,
        "--crop",
        &[
            "render",
            scene.to_str().unwrap(),
            "-o",
            plain.to_str().unwrap(),
            "--denoise",
            "--oidn",
            library.to_str().unwrap(),
            "--crop",
            "0,0,8,8",
        ],
    );
}

#[test]
fn absent_library_is_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(CORNELL_BOX);
    let out = folder.path().join("out.png");
    let [scene, out, empty] = [scene, &out, folder.path()].map(|path| path.to_str().unwrap());
    let flags = ["render", scene, "-o", out, "--denoise", "--oidn", empty];
    fails_with(2, "pip install pyoidn", &flags);
    // Flags that say nothing together
    fails_with(
        2,
        "give `--denoise`",
        &["render", scene, "-o", out, "--oidn", empty],
    );
}
