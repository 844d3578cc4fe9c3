//! Command `whit render`, run as a process: exit codes, output and files.

use std::fs;
use std::path::Path;

use crate::support::cli_program::{fails_with, first_light, names_in, whit};

#[test]
fn render_writes_a_png_and_prints_a_line_on_it_and_one_on_its_error() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.png");
    let run = whit(&[
        "render",
        &first_light(),
        "-o",
        path(&out),
        "--size",
        "40x30",
        "--spp",
        "1",
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(
        run.stdout.starts_with(&format!("{}: 40x30, ", out.display())),
        "{}",
        run.stdout
    );
    let lines: Vec<&str> = run.stdout.lines().collect();
    assert!(
        lines.len() == 2 && lines[1].starts_with("estimated error: "),
        "{lines:?}"
    );
    assert!(!run.stderr.contains("40x30"), "{}", run.stderr);
    let image = image::open(&out).unwrap().into_rgb8();
    assert_eq!((image.width(), image.height()), (40, 30));
    let first = *image.get_pixel(0, 0);
    assert!(image.pixels().any(|p| *p != first), "every pixel is {first:?}");
    assert_eq!(names_in(folder.path()), ["a.png"]);
}

#[test]
fn quiet_renders_print_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.exr");
    let run = whit(&[
        "render",
        &first_light(),
        "-o",
        path(&out),
        "--size",
        "8x8",
        "--quiet",
    ]);
    assert_eq!((run.code, &*run.stdout, &*run.stderr), (0, "", ""));
    assert!(out.exists());
}

#[test]
fn png_equals_exr_after_exposure_and_srgb_encoding() {
    let folder = tempfile::tempdir().unwrap();
    let (png, exr) = (folder.path().join("a.png"), folder.path().join("a.exr"));
    for out in [&png, &exr] {
        let args = ["--size", "64x48", "--spp", "4", "--exposure", "-0.5", "--quiet"];
        let run = whit(&[&["render", &first_light(), "-o", path(out)], &args[..]].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
    }
    let shown = image::open(&png).unwrap().into_rgb8();
    let linear = whit::image::read_exr(&exr).unwrap();
    assert_eq!((linear.width, linear.height), shown.dimensions());
    let encode = |radiance: f32| {
        let exposed = f64::from(radiance) * (-0.5f64).exp2();
        let encoded = if exposed <= 0.003_130_8 {
            12.92 * exposed
        } else {
            1.055 * exposed.powf(1.0 / 2.4) - 0.055
        };
        255.0 * encoded.clamp(0.0, 1.0)
    };
    for (pixel, radiance) in shown.pixels().zip(&linear.pixels) {
        for channel in 0..3 {
            // Half a code, and the rounding of the f32 gain (2^-24 of at most 255).
            let difference = (f64::from(pixel[channel]) - encode(radiance[channel])).abs();
            assert!(difference <= 0.5 + 2e-5, "{pixel:?} for {radiance:?}");
        }
    }
}

#[test]
fn failing_scene_does_not_stop_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let bad = folder.path().join("bad.glb");
    fs::write(&bad, b"no scene").unwrap();
    let images = folder.path().join("images");
    fs::create_dir(&images).unwrap();
    let stats = folder.path().join("stats.json");
    let other = folder.path().join("other.gltf");
    fs::copy(first_light(), &other).unwrap();
    let scenes = [path(&bad), &first_light(), path(&other)].map(str::to_owned);
    let flags = [
        "--out",
        path(&images),
        "--size",
        "8x8",
        "--spp",
        "1",
        "--stats",
        path(&stats),
    ];
    let run = whit(&[&["render", &scenes[0], &scenes[1], &scenes[2]], &flags[..]].concat());
    assert_eq!(run.code, 1, "{}", run.stderr);
    assert!(run.stderr.contains("bad.glb"), "{}", run.stderr);
    assert!(
        run.stderr.ends_with("whit: 1 of 3 scenes failed\n"),
        "{}",
        run.stderr
    );
    assert_eq!(names_in(&images), ["first_light.png", "other.png"]);
    // Two lines for each of the two images
    assert_eq!(run.stdout.lines().count(), 4);
    let stats: serde_json::Value = serde_json::from_slice(&fs::read(&stats).unwrap()).unwrap();
    assert_eq!(stats.as_array().unwrap().len(), 2);
}

#[test]
fn ray_that_misses_everything_gets_the_ambient_radiance() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.exr");
    let scene = folder.path().join("behind.gltf");
    fs::write(&scene, TRIANGLE_BEHIND_THE_CAMERA).unwrap();
    let run = whit(&[
        "render",
        path(&scene),
        "-o",
        path(&out),
        "--size",
        "4x4",
        "--ambient",
        "0.25,0.5,2",
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let image = whit::image::read_exr(&out).unwrap();
    assert!(
        image.pixels.iter().all(|p| *p == [0.25, 0.5, 2.0]),
        "{:?}",
        image.pixels
    );
}

#[test]
fn rough_rays_flag_overrides_the_material() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("ball.toml");
    let ball = "background = 1\n[material.m]\nmetal = 'gold'\nroughness = 0.4\nrough_rays = 3\n\
                [[object]]\nshape = 'sphere'\nmaterial = 'm'\n";
    fs::write(&scene, ball).unwrap();
    let render = |flags: &[&str]| {
        let out = folder.path().join("a.exr");
        let common = [
            "render",
            path(&scene),
            "-o",
            path(&out),
            "--size",
            "8x8",
            "--spp",
            "1",
        ];
        let run = whit(&[&common, flags].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        whit::image::read_exr(&out).unwrap().pixels
    };
    let own = render(&[]);
    assert!(own == render(&["--rough-rays", "3"]));
    let none = render(&["--rough-rays", "0"]);
    assert!(own != none && none == render(&["--effects=-rough-reflection"]));
}

#[test]
fn invalid_scenes_give_one_sentence_and_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.png");
    let garbage = folder.path().join("garbage.glb");
    fs::write(&garbage, b"this is no scene").unwrap();
    let missing = folder.path().join("missing.glb");
    for scene in [&garbage, &missing, &folder.path().to_owned()] {
        fails_with(2, path(scene), &["render", path(scene), "-o", path(&out)]);
    }
    assert_eq!(names_in(folder.path()), ["garbage.glb"]);
}

#[test]
fn unknown_camera_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.png");
    fails_with(
        2,
        "has no camera `back`",
        &["render", &first_light(), "-o", path(&out), "--camera", "back"],
    );
    assert_eq!(names_in(folder.path()), Vec::<String>::new());
}

#[test]
fn unwritable_output_is_reported_before_opening_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let there = |name: &str| folder.path().join(name).display().to_string();
    let refused = |out: &str, words: &str| fails_with(2, words, &["render", "no-such-scene.glb", "-o", out]);
    refused(&there("no/a.png"), "there is no folder");
    refused(&there("a.jpg"), "ends in .png or .exr");
    refused(&there("a"), "ends in .png or .exr");
    fs::create_dir(there("b.png")).unwrap();
    refused(&there("b.png"), "is a folder");
    if Path::new("/sys/kernel").is_dir() {
        // A folder in which not even root can create files.
        refused("/sys/kernel/a.png", "cannot write into the folder /sys/kernel");
    }
    let out = there("c.png");
    let stats = there("no/c.json");
    fails_with(
        2,
        "there is no folder",
        &["render", "no-such-scene.glb", "-o", &out, "--stats", &stats],
    );
    fails_with(
        2,
        "there is no folder",
        &["render", "no-such-scene.glb", "--out", &there("no")],
    );
    assert_eq!(names_in(folder.path()), ["b.png"]);
}

#[test]
fn numbers_out_of_range_are_rejected_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.png");
    for (flag, value, words) in [
        ("--size", "0x480", "at least one pixel"),
        ("--size", "640x0", "at least one pixel"),
        ("--size", "640", "as in 640x480"),
        ("--size", "70000x70000", "at most 2^31 pixels"),
        ("--size", "99999999999999999999x1", "as in 640x480"),
        ("--spp", "0", "1..=65536"),
        ("--spp", "-3", "1..=65536"),
        ("--spp", "many", "'many'"),
        ("--depth", "256", "0..=255"),
        ("--threads", "100000", "0..=1024"),
        ("--filter-radius", "0.5", "a radius from 1 to 4"),
        ("--adaptive", "0", "as in 0.004 for one 8-bit code"),
        ("--edge-contrast", "0", "as in 0.04 for ten 8-bit codes"),
        ("--adaptive", "nan", "as in 0.004 for one 8-bit code"),
        ("--exposure", "nan", "stops from -100 to 100"),
        ("--ambient", "-1", "zero or more"),
        ("--rough-rays", "257", "0..=256"),
    ] {
        let flag_and_value = format!("{flag}={value}");
        fails_with(
            2,
            words,
            &["render", &first_light(), "-o", path(&out), &flag_and_value],
        );
    }
    assert_eq!(names_in(folder.path()), Vec::<String>::new());
}

#[test]
fn conflicting_flags_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let (out, there) = (folder.path().join("a.png"), path(folder.path()));
    let scene = first_light();
    fails_with(2, "a single image", &["render", &scene, &scene, "-o", path(&out)]);
    fails_with(
        2,
        "would both be written to",
        &["render", &scene, &scene, "--out", there],
    );
    fails_with(
        2,
        "`--compact` applies to Embree only",
        &["render", &scene, "-o", path(&out), "--backend=bsp", "--compact"],
    );
    let render = ["render", &scene, "-o", path(&out)];
    for (flags, words) in [
        (&["--aov=samples"][..], "write an .exr"),
        (&["--filter-radius=2"], "leave out `--filter-radius`"),
        (&["--adaptive=0.01", "--filter=tent"], "leave out `--filter`"),
        (
            &["--adaptive=0.01", "--pattern=regular"],
            "choose another `--pattern`",
        ),
        (
            &["--edge-contrast=0.03", "--filter=tent"],
            "`--edge-contrast` gives pixels different numbers of samples",
        ),
        (
            &["--edge-contrast=0.03", "--background=transparent"],
            "leave out `--edge-contrast`",
        ),
    ] {
        fails_with(2, words, &[&render, flags].concat());
    }
    if cfg!(not(feature = "embree")) {
        fails_with(
            2,
            "without Embree",
            &["render", &scene, "-o", path(&out), "--backend=embree"],
        );
    }
    for args in [
        &["render", &scene][..],
        &["render", &scene, "-o", path(&out), "--no-such-flag"],
        &["render", &scene, "-o", path(&out), "--out", there],
        &[
            "render",
            &scene,
            "-o",
            path(&out),
            "--edge-contrast=0.03",
            "--adaptive=0.01",
        ],
        &["render", "-o", path(&out)],
        &["paint", &scene],
        &[],
    ] {
        let run = whit(args);
        assert_eq!((run.code, &*run.stdout), (2, ""), "{args:?}: {}", run.stderr);
    }
    assert_eq!(names_in(folder.path()), Vec::<String>::new());
}

#[test]
fn help_and_version_go_to_standard_output() {
    for args in [
        &["--help"][..],
        &["render", "--help"],
        &["info", "--help"],
        &["bench", "--help"],
        &["--version"],
    ] {
        let run = whit(args);
        assert_eq!((run.code, &*run.stderr), (0, ""), "{args:?}");
        assert!(!run.stdout.is_empty());
    }
    let version = whit(&["--version"]).stdout;
    let embree = if cfg!(feature = "embree") {
        "(Embree "
    } else {
        "(without Embree)"
    };
    assert!(version.starts_with(concat!("whit ", env!("CARGO_PKG_VERSION"))) && version.contains(embree));
    let help = whit(&["render", "--help"]).stdout;
    for words in [
        "Examples:",
        "--pattern sobol --filter mitchell",
        "--adaptive 0.005 --spp 1024 --aov samples",
    ] {
        assert!(help.contains(words), "{words} in {help}");
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_exits_with_130_and_leaves_no_file() {
    use std::process::{Command, Stdio};
    use std::thread::sleep;
    use std::time::Duration;

    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.png");
    let mut child = Command::new(env!("CARGO_BIN_EXE_whit"))
        .args([
            "render",
            &first_light(),
            "-o",
            path(&out),
            "--size",
            "2048x2048",
            "--spp",
            "65536",
        ])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    // Wait until the render runs; the whole frame would take hours.
    sleep(Duration::from_millis(700));
    // Use the shell's built-in `kill`, as not every machine has the program.
    let kill = Command::new("sh")
        .args(["-c", "kill -INT \"$0\"", &child.id().to_string()])
        .status()
        .unwrap();
    assert!(kill.success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(names_in(folder.path()), Vec::<String>::new());
}

/// Scene of one triangle in the plane z = 5; the camera at the origin looks along -z.
const TRIANGLE_BEHIND_THE_CAMERA: &str = r#"{
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0, 1]}],
    "nodes": [{"mesh": 0}, {"camera": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "cameras": [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.01}}],
    "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAKBAAACAPwAAAAAAAKBAAAAAAAAAgD8AAKBA"}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
        "min": [0, 0, 5], "max": [1, 1, 5]}]
}"#;

fn path(path: &Path) -> &str {
    path.to_str().unwrap()
}
