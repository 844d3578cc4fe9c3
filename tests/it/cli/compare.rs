//! `whit compare`: what it tells, what it writes, and what it refuses.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::browser::{chromium, is_clean, looked_at};
use crate::support::cli_program::{fails_with, first_light, whit};
use serde_json::{Value, json};
use whit::image::{ImageFormat, LinearImage, ToneMap, read_picture, write};

/// Two pictures of the project's own scene that differ by their samples, as EXR or PNG.
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
        ]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        path
    })
}

/// What `whit compare` writes as JSON of two pictures, with more flags.
fn compared([reference, picture]: [&Path; 2], flags: &[&str]) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("metrics.json");
    let [reference, picture, told] = [reference, picture, &json].map(|path| path.display().to_string());
    let mut words = vec!["compare", &reference, &picture, "--json", &told];
    words.extend(flags);
    let run = whit(&words);
    assert_eq!(run.code, 0, "{}", run.stderr);
    serde_json::from_slice(&fs::read(json).unwrap()).unwrap()
}

#[test]
fn equal_pictures_have_no_error_and_others_have() {
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
fn a_picture_displayed_by_the_renderer_is_the_radiance_as_displayed() {
    let folder = tempfile::tempdir().unwrap();
    let [[exr, _], [png, _]] = ["exr", "png"].map(|ending| pair(folder.path(), ending));
    let report = compared([&exr, &png], &[]);
    // The width of a code is the most that rounding to codes takes.
    assert!(
        report["displayed"]["max"].as_f64().unwrap() <= 0.5 / 255.0 + 1e-6,
        "{report}"
    );
    assert_eq!(report["changed_share"], 0.0);
}

#[test]
fn pixels_that_are_no_numbers_are_told() {
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
            .contains("0 pixels of the reference and 1 of the picture hold a NaN"),
        "{}",
        run.stdout
    );
}

#[test]
fn pictures_of_differences_have_the_pictures_size() {
    let folder = tempfile::tempdir().unwrap();
    let [rough, fine] = pair(folder.path(), "exr");
    let [signed, heat] = ["signed.png", "heat.png"].map(|name| folder.path().join(name));
    let [to_signed, to_heat] = [&signed, &heat].map(|path| path.display().to_string());
    compared([&fine, &rough], &["--difference", &to_signed, "--heat", &to_heat]);
    for path in [signed, heat] {
        let image = read_picture(&path).unwrap().image;
        assert_eq!([image.width, image.height], [64, 48]);
        assert!(
            image.pixels.iter().any(|&pixel| pixel != image.pixels[0]),
            "{}",
            path.display()
        );
    }
}

#[test]
fn what_cannot_be_compared_is_refused_in_one_sentence() {
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
    fs::write(path("c.png"), "no picture").unwrap();
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

/// Goes through all ways to look, and writes down which pictures are shown.
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
fn the_page_slides_pictures_and_shows_them_in_turns() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let [rough, fine] = pair(folder.path(), "exr");
    let page = folder.path().join("page.html");
    compared([&fine, &rough], &["--html", &page.display().to_string()]);
    let found = looked_at(browser, &page, PROBE, &["--window-size=1200,900"]);
    is_clean(&found);
    let all = ["slide", "turns", "reference", "picture", "difference", "FLIP"];
    assert_eq!(found["views"], json!(all));
    for name in &all[2..] {
        assert_eq!(found["shown"][name], json!([name]), "{found}");
    }
    assert_eq!(found["shown"]["slide"], json!(["reference", "picture"]));
    // As it opens, after a click, and after a while.
    let turns = json!([["reference"], ["picture"], ["reference"]]);
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
