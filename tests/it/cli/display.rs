//! Mapping from radiance to displayed colours by `whit render`: tone mapping operators, background and exposure.

use std::fs;
use std::path::Path;

use whit::image::{ImageFormat, ToneMap, ToneOperator, read_exr, write};

use crate::support::cli_program::{first_light, whit};

/// Renders a scene to `out` with few samples and further flags, which must succeed; returns standard output.
fn render(scene: &str, out: &Path, flags: &[&str]) -> String {
    let fixed = ["render", scene, "-o", path(out), "--size", "64x48", "--spp", "4"];
    let run = whit(&[&fixed[..], flags].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    run.stdout
}

fn path(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Returns the bytes of a PNG's pixels.
fn codes(path: &Path) -> Vec<u8> {
    image::open(path).unwrap().into_rgb8().into_raw()
}

#[test]
fn tone_map_applies_to_png_alone_after_exposure() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let [plain, clip, neutral, wanted] = ["a.png", "clip.png", "neutral.png", "wanted.png"].map(file);
    let [linear, mapped] = ["a.exr", "neutral.exr"].map(file);
    let exposure = ["--quiet", "--exposure", "2"];
    render(&first_light(), &plain, &exposure);
    render(
        &first_light(),
        &clip,
        &[&exposure[..], &["--tone-map", "clip"]].concat(),
    );
    assert_eq!(fs::read(&plain).unwrap(), fs::read(&clip).unwrap());
    let with_neutral = [&exposure[..], &["--tone-map", "neutral"]].concat();
    render(&first_light(), &neutral, &with_neutral);
    render(&first_light(), &mapped, &with_neutral);
    render(&first_light(), &linear, &exposure);
    let mut image = read_exr(&linear).unwrap();
    assert_eq!(image, read_exr(&mapped).unwrap());
    // Two stops are a factor of four, without rounding
    for pixel in &mut image.pixels {
        *pixel = ToneOperator::Neutral.displayed(pixel.map(|channel| 4.0 * channel));
    }
    write(&image, &wanted, ImageFormat::Png, ToneMap::default()).unwrap();
    assert_eq!(codes(&neutral), codes(&wanted));
    assert_ne!(codes(&neutral), codes(&plain));
}

#[test]
fn scene_file_gives_the_tone_map_and_a_flag_overrides_it() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("a.toml");
    let text = "ambient = 4\nobject = [{ shape = \"sphere\" }]\n[output]\ntone_map = \"aces\"\n";
    fs::write(&scene, text).unwrap();
    let [of_file, of_flag, aces] = ["file.png", "flag.png", "aces.png"].map(|name| folder.path().join(name));
    render(path(&scene), &of_file, &["--quiet"]);
    render(path(&scene), &of_flag, &["--quiet", "--tone-map", "clip"]);
    render(path(&scene), &aces, &["--quiet", "--tone-map", "aces"]);
    assert_eq!(codes(&of_file), codes(&aces));
    assert_ne!(codes(&of_file), codes(&of_flag));
}
