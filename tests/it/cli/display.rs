//! Mapping from radiance to displayed colours by `whit render`: tone mapping operators, background and exposure.

use std::fs;
use std::path::Path;

use whit::image::rows::ExrScanlineReader;
use whit::image::{ImageFormat, LinearImage, ToneMap, ToneOperator, read_exr, write};

use crate::support::cli_program::{fails_with, first_light, whit};

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

/// Scene of one sphere in the middle, which leaves the corners empty.
const SPHERE: &str = "
background = 2
camera = { from = [0, 0, 4], at = [0, 0, 0], fov = 40 }
light = [{ kind = \"directional\", direction = [-1, -1, -2], intensity = 2 }]
object = [{ shape = \"sphere\" }]
";

#[test]
fn transparent_background_gives_files_an_alpha_channel() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("a.toml");
    fs::write(&scene, SPHERE).unwrap();
    let [png, wide, exr] = ["a.png", "wide.png", "a.exr"].map(|name| folder.path().join(name));
    let clear = ["--quiet", "--background", "transparent"];
    render(path(&scene), &png, &clear);
    render(path(&scene), &wide, &[&clear[..], &["--png-bits", "16"]].concat());
    render(path(&scene), &exr, &clear);
    let shown = image::open(&png).unwrap();
    assert_eq!(shown.color(), image::ColorType::Rgba8);
    assert_eq!(image::open(&wide).unwrap().color(), image::ColorType::Rgba16);
    let shown = shown.into_rgba8();
    assert_eq!(shown.get_pixel(0, 0).0, [0; 4]);
    assert_eq!(shown.get_pixel(32, 24)[3], 255);
    let reader = ExrScanlineReader::open(&exr).unwrap();
    let names: Vec<&str> = reader
        .channels()
        .iter()
        .map(|channel| &channel.name[..])
        .collect();
    assert_eq!(names, ["A", "B", "G", "R"]);
    // Straight colours of the PNG are those of the EXR, divided by alpha
    let linear = read_exr(&exr).unwrap();
    assert_eq!(linear.pixel(0, 0), [0.0; 3]);
    let edge = shown
        .enumerate_pixels()
        .find(|(_, _, pixel)| pixel[3] == 191)
        .unwrap();
    let straight = linear.pixel(edge.0, edge.1).map(|channel| channel / 0.75);
    let code = ToneMap::default().srgb_bytes(&LinearImage {
        width: 1,
        height: 1,
        pixels: vec![straight],
    });
    assert_eq!(code, edge.2.0[..3]);
}

#[test]
fn scene_file_gives_the_visible_background() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("a.toml");
    let [of_file, of_flag] = ["file.png", "flag.png"].map(|name| folder.path().join(name));
    fs::write(&scene, format!("{SPHERE}[output]\nbackground = [0, 1, 0]\n")).unwrap();
    render(path(&scene), &of_file, &["--quiet"]);
    assert_eq!(
        image::open(&of_file).unwrap().into_rgb8().get_pixel(0, 0).0,
        [0, 255, 0]
    );
    render(
        path(&scene),
        &of_flag,
        &["--quiet", "--background", "environment"],
    );
    assert_eq!(
        image::open(&of_flag).unwrap().into_rgb8().get_pixel(0, 0).0,
        [255; 3]
    );
}

#[test]
fn transparent_background_is_refused_where_samples_differ() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.png");
    for flags in [["--adaptive", "0.01"], ["--error", "0.01"], ["--max-time", "9"]] {
        let scene = first_light();
        let fixed = ["render", &scene, "-o", path(&out), "--background", "transparent"];
        fails_with(2, "transparent background", &[&fixed[..], &flags].concat());
    }
    assert!(!out.exists());
}

/// Writes the scene `first_light` with a key light of 100,000 candela, which lights it alone, and returns its path.
fn bright_light(folder: &Path) -> std::path::PathBuf {
    let text = fs::read_to_string(first_light()).unwrap();
    let bright = text
        .replace("\"intensity\":165", "\"intensity\":100000")
        .replace("\"intensity\":110,", "\"intensity\":0,")
        .replace("\"intensity\":18,", "\"intensity\":0,");
    assert_eq!(bright.matches("\"intensity\":0,").count(), 2);
    assert!(bright.contains("\"intensity\":100000"));
    let scene = folder.join("bright.gltf");
    fs::write(&scene, bright).unwrap();
    scene
}

/// Returns the stops that a render printed.
fn printed_stops(printed: &str) -> f64 {
    let line = printed.lines().next().unwrap();
    let (_, exposure) = line
        .split_once(", exposure ")
        .unwrap_or_else(|| panic!("{printed}"));
    exposure.strip_suffix(" stops").unwrap().parse().unwrap()
}

#[test]
fn lights_in_candela_are_shown_around_middle_grey() {
    let folder = tempfile::tempdir().unwrap();
    let scene = bright_light(folder.path());
    let [png, again, exr] = ["a.png", "b.png", "a.exr"].map(|name| folder.path().join(name));
    // A light of 100,000 cd some metres away is about ten stops brighter than white
    let stops = printed_stops(&render(path(&scene), &png, &["--threads", "1"]));
    assert!((-14.0..-6.0).contains(&stops), "{stops}");
    render(path(&scene), &exr, &["--quiet"]);
    let gain = stops.exp2();
    let mut levels: Vec<f64> = read_exr(&exr)
        .unwrap()
        .pixels
        .iter()
        .map(|[r, g, b]| 0.2126 * f64::from(*r) + 0.7152 * f64::from(*g) + 0.0722 * f64::from(*b))
        .filter(|&level| level > 0.0)
        .map(|level| gain * level)
        .collect();
    levels.sort_by(f64::total_cmp);
    let mean = levels.iter().sum::<f64>() / levels.len() as f64;
    assert!((0.09..0.36).contains(&mean), "{mean}");
    // A hundredth of a stop changes values by 0.7 %
    assert!(levels[levels.len() * 99 / 100 - 1] < 1.01);
    // Threads do not matter, and the printed number gives the same image
    assert_eq!(
        printed_stops(&render(path(&scene), &again, &["--threads", "2"])),
        stops
    );
    assert_eq!(fs::read(&png).unwrap(), fs::read(&again).unwrap());
    render(path(&scene), &again, &["--exposure", &stops.to_string()]);
    assert_eq!(codes(&png), codes(&again));
}

#[test]
fn given_exposure_wins_over_the_automatic_one() {
    let folder = tempfile::tempdir().unwrap();
    let scene = bright_light(folder.path());
    let out = folder.path().join("a.png");
    let printed = render(path(&scene), &out, &["--exposure", "0"]);
    assert!(!printed.contains("exposure"), "{printed}");
    let white = codes(&out).iter().filter(|&&code| code == 255).count();
    assert!(white > codes(&out).len() / 3, "{white}");
    // Files without lights and scene files have no automatic exposure unless it is requested
    let plain = folder.path().join("a.toml");
    fs::write(&plain, SPHERE).unwrap();
    assert!(!render(path(&plain), &out, &[]).contains("exposure"));
    let printed = render(path(&plain), &out, &["--exposure", "auto"]);
    assert!((-4.0..1.0).contains(&printed_stops(&printed)), "{printed}");
}

#[test]
fn automatic_exposure_is_refused_where_it_is_needed_beforehand() {
    let folder = tempfile::tempdir().unwrap();
    let scene = bright_light(folder.path());
    let out = folder.path().join("a.png");
    for flags in [
        ["--adaptive", "0.01"],
        ["--error", "0.01"],
        ["--max-time", "9"],
        ["--crop", "0,0,8,8"],
    ] {
        let fixed = ["render", path(&scene), "-o", path(&out), "--exposure", "auto"];
        fails_with(2, "needs the finished image", &[&fixed[..], &flags].concat());
    }
    // As the default, it gives way with a warning
    let args = [
        "render",
        path(&scene),
        "-o",
        path(&out),
        "--size",
        "32x32",
        "--crop",
        "0,0,8,8",
    ];
    let run = whit(&args);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stderr.contains("give `--exposure`"), "{}", run.stderr);
}
