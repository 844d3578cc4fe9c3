//! Command `whit compare`: metrics, output files and rejected input.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::browser::{chromium, is_clean, looked_at};
use crate::support::cli_program::{fails_with, first_light, whit};
use serde_json::{Value, json};
use whit::image::{ImageFormat, LinearImage, ToneMap, load_image, write};

/// Renders two images of the same scene with different numbers of samples, as EXR or PNG.
fn pair(folder: &Path, ending: &str) -> [PathBuf; 2] {
    [(1, "rough"), (16, "fine")].map(|(spp, name)| {
        let path = folder.join(format!("{name}.{ending}"));
        let run = whit(&[
            "render",
            &first_light(),
            "-o",
            &path.display().to_string(),
            "--size",
            "64x48",
            "--spp",
            &spp.to_string(),
            "--exposure",
            "0",
        ]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        path
    })
}

/// Returns the JSON of `whit compare` for two images and additional flags.
fn compared([reference, image]: [&Path; 2], flags: &[&str]) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("metrics.json");
    let [reference, image, json_path] = [reference, image, &json].map(|path| path.display().to_string());
    let mut words = vec!["compare", &reference, &image, "--json", &json_path];
    words.extend(flags);
    let run = whit(&words);
    assert_eq!(run.code, 0, "{}", run.stderr);
    serde_json::from_slice(&fs::read(json).unwrap()).unwrap()
}

#[test]
fn equal_images_have_zero_error_and_others_do_not() {
    let folder = tempfile::tempdir().unwrap();
    for ending in ["exr", "png"] {
        let [rough, fine] = pair(folder.path(), ending);
        let same = compared([&fine, &fine], &[]);
        for key in ["flip", "rel_mse", "changed_share"] {
            assert_eq!(same[key], 0.0, "{key} in {same}");
        }
        assert!(same["psnr"].is_null(), "{same}");
        let is_radiance = ending == "exr";
        assert_eq!(same["is_radiance"], is_radiance);
        assert_eq!(
            same["flip_hdr"],
            if is_radiance { json!(0.0) } else { Value::Null }
        );
        let other = compared([&fine, &rough], &[]);
        for key in ["flip", "rel_mse", "changed_share", "psnr"] {
            assert!(other[key].as_f64().unwrap() > 0.0, "{key} in {other}");
        }
        let ssim = |report: &Value| report["ssim"].as_f64().unwrap();
        assert!(
            (ssim(&same) - 1.0).abs() < 1e-12 && ssim(&other) < 0.999,
            "{other}"
        );
        assert_eq!(other["radiance"], compared([&rough, &fine], &[])["radiance"]);
    }
}

#[test]
fn png_of_the_renderer_equals_the_displayed_radiance() {
    let folder = tempfile::tempdir().unwrap();
    let [[exr, _], [png, _]] = ["exr", "png"].map(|ending| pair(folder.path(), ending));
    let report = compared([&exr, &png], &[]);
    // Rounding to 8-bit codes changes a value by at most half a code.
    assert!(
        report["displayed"]["max"].as_f64().unwrap() <= 0.5 / 255.0 + 1e-6,
        "{report}"
    );
    assert_eq!(report["changed_share"], 0.0);
}

#[test]
fn non_finite_pixels_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let mut image = LinearImage::black(12, 12);
    let paths = ["a.exr", "b.exr"].map(|name| folder.path().join(name));
    write(&image, &paths[0], ImageFormat::Exr, ToneMap::default()).unwrap();
    image.pixels[7] = [0.0, f32::NAN, 0.0];
    write(&image, &paths[1], ImageFormat::Exr, ToneMap::default()).unwrap();
    let [a, b] = [&paths[0], &paths[1]].map(|path| path.display().to_string());
    let run = whit(&["compare", &a, &b]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(
        run.stdout
            .contains("0 pixels of the reference and 1 of the image hold a NaN"),
        "{}",
        run.stdout
    );
}

#[test]
fn difference_images_have_the_size_of_the_input() {
    let folder = tempfile::tempdir().unwrap();
    let [rough, fine] = pair(folder.path(), "exr");
    let [signed, heat] = ["signed.png", "heat.png"].map(|name| folder.path().join(name));
    let [to_signed, to_heat] = [&signed, &heat].map(|path| path.display().to_string());
    compared([&fine, &rough], &["--difference", &to_signed, "--heat", &to_heat]);
    for path in [signed, heat] {
        let image = load_image(&path).unwrap().image;
        assert_eq!([image.width, image.height], [64, 48]);
        assert!(
            image.pixels.iter().any(|&pixel| pixel != image.pixels[0]),
            "{}",
            path.display()
        );
    }
}

#[test]
fn incomparable_images_are_rejected_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    for (name, width) in [("a.exr", 12), ("b.exr", 13)] {
        let image = LinearImage::black(width, 12);
        write(
            &image,
            Path::new(&path(name)),
            ImageFormat::Exr,
            ToneMap::default(),
        )
        .unwrap();
    }
    fs::write(path("c.png"), "not an image").unwrap();
    let [a, b, c, none] = ["a.exr", "b.exr", "c.png", "none.png"].map(path);
    fails_with(2, "12x12 and 13x12", &["compare", &a, &b]);
    fails_with(2, "c.png", &["compare", &a, &c]);
    fails_with(2, "none.png", &["compare", &none, &a]);
    fails_with(
        2,
        "no folder",
        &["compare", &a, &a, "--html", "/no-such-folder/a.html"],
    );
    fails_with(2, "1 to 1000", &["compare", &a, &a, "--pixels-per-degree", "0.5"]);
}

/// Script that selects every view of the page and records the visible images.
const PROBE: &str = r#"
  const form = document.querySelector(".viewer form");
  const names = () => shown(".viewer figure").map((figure) => figure.dataset.view);
  const views = [...form.elements.view].map((button) => button.value);
  const found = { views, shown: {} };
  for (const view of views) {
    form.elements.view.value = view;
    form.dispatchEvent(new Event("input"));
    found.shown[view] = names();
  }
  form.elements.view.value = "turns";
  form.dispatchEvent(new Event("input"));
  const first = names();
  document.querySelector(".stage").click();
  const clicked = names();
  for (let wait = 0; wait < 60 && names()[0] === clicked[0]; wait += 1) {
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
  found.turns = [first, clicked, names()];
  form.elements.view.value = "slide";
  form.elements.cut.value = 25;
  form.dispatchEvent(new Event("input"));
  found.clip = getComputedStyle(document.querySelectorAll(".viewer img")[1]).clipPath;
  const image = document.querySelectorAll(".viewer img")[1].getBoundingClientRect();
  document.querySelector(".stage").dispatchEvent(new MouseEvent("click", { clientX: image.left + 0.75 * image.width, clientY: image.top + 9 }));
  found.cut = Number(form.elements.cut.value);
  found.sizes = [...document.querySelectorAll(".viewer img")].map((image) => [image.naturalWidth, image.naturalHeight]);
  return found;
"#;

#[test]
fn page_has_a_slider_and_alternates_the_images() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let [rough, fine] = pair(folder.path(), "exr");
    let page = folder.path().join("page.html");
    compared([&fine, &rough], &["--html", &page.display().to_string()]);
    let found = looked_at(browser, &page, PROBE, &["--window-size=1200,900"]);
    is_clean(&found);
    let all = ["slide", "turns", "reference", "image", "difference", "FLIP"];
    assert_eq!(found["views"], json!(all));
    for name in &all[2..] {
        assert_eq!(found["shown"][name], json!([name]), "{found}");
    }
    assert_eq!(found["shown"]["slide"], json!(["reference", "image"]));
    // Visible images at the start, after a click, and after a delay.
    let turns = json!([["reference"], ["image"], ["reference"]]);
    assert_eq!(found["turns"], turns, "{found}");
    assert!(found["clip"].as_str().unwrap().contains("25%"), "{found}");
    assert!((found["cut"].as_f64().unwrap() - 75.0).abs() < 0.5, "{found}");
    assert_eq!(found["sizes"], json!(vec![[64, 48]; 4]));
    let narrow = looked_at(browser, &page, PROBE, &["--window-size=400,800"]);
    assert!(
        narrow["width"][0].as_u64() <= narrow["width"][1].as_u64(),
        "{narrow}"
    );
}
