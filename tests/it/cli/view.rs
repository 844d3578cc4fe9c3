//! Camera, environment and crop flags of `whit render`, run as a process.

use std::path::Path;

use whit::image::{LinearImage, read_exr};

use crate::support::cli_program::{first_light, whit};

/// A triangle with the corners (0, 0, 0), (1, 0, 0) and (0, 1, 0), without lights and cameras.
const TRIANGLE: &str = r#"{
    "asset": { "version": "2.0" },
    "scene": 0,
    "scenes": [{ "nodes": [0] }],
    "nodes": [{ "mesh": 0 }],
    "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
    "accessors": [{
        "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]
    }],
    "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
    "buffers": [{
        "byteLength": 36,
        "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"
    }]
}"#;

/// Renders [`TRIANGLE`] at 24x24 with `flags`.
fn rendered(flags: &[&str]) -> LinearImage {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.exr");
    let scene = folder.path().join("a.gltf");
    std::fs::write(&scene, TRIANGLE).unwrap();
    let fixed = [
        "render",
        path(&scene),
        "-o",
        path(&out),
        "--size",
        "24x24",
        "--spp",
        "4",
        "--quiet",
    ];
    let run = whit(&[&fixed, flags].concat());
    assert_eq!((run.code, &*run.stderr), (0, ""), "{flags:?}");
    read_exr(&out).unwrap()
}

fn path(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Asserts that rendering the README's scene with `flags` ends with 2, and that its message contains `words`.
#[track_caller]
fn refused(words: &str, flags: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.png");
    let run = whit(&[&["render", &first_light(), "-o", path(&out)], flags].concat());
    assert_eq!((run.code, &*run.stdout), (2, ""), "{flags:?}: {}", run.stderr);
    assert!(run.stderr.starts_with("whit: "), "{flags:?}: {}", run.stderr);
    assert!(run.stderr.contains(words), "{flags:?}: {}", run.stderr);
    assert!(!out.exists());
}

#[test]
fn camera_flags_place_the_camera() {
    let plain = rendered(&[]);
    let front = rendered(&["--view", "front", "--ambient", "0"]);
    assert_ne!(plain.pixels, front.pixels);
    // The triangle fills 0.8 of 24 pixels, 2.4 to 21.6, with its right angle at the lower left
    let is_lit = |column: usize, row: usize| front.pixels[24 * row + column] != [0.0; 3];
    assert!(is_lit(2, 21) && is_lit(3, 3) && is_lit(20, 20) && is_lit(20, 21));
    assert!((0..24).all(|i| !is_lit(1, i)
        && !is_lit(22, i)
        && !is_lit(i, 1)
        && !is_lit(i, 22)
        && !is_lit(20, i.min(15))));
    // Up given in another length is the same camera
    let placed = ["--from", "-1,1,3", "--at", "0,0.5,0", "--fov", "30"];
    let above = rendered(&placed);
    assert_eq!(
        above.pixels,
        rendered(&[&placed[..], &["--up", "0,2,0"]].concat()).pixels
    );
    assert_ne!(above.pixels, front.pixels);
}

#[test]
fn wrong_camera_flags_are_refused() {
    for (words, flags) in [
        ("--from", &["--from", "1,2"][..]),
        ("give three numbers", &["--from", "1,2"]),
        ("between 0 and 180", &["--view", "top", "--fov", "180"]),
        ("--view", &["--view", "above"]),
        ("--camera", &["--view", "top", "--camera", "0"]),
        ("--view", &["--view", "top", "--from", "1,2,3"]),
        ("no viewing direction", &["--from", "1,2,3", "--at", "1,2,3"]),
        ("no viewing direction", &["--from", "0,9,0", "--at", "0,0,0"]),
    ] {
        refused(words, flags);
    }
}

#[test]
fn environment_flag_lights_the_scene() {
    let studio = rendered(&["--environment", "studio"]);
    assert_ne!(studio.pixels, rendered(&["--environment", "sky"]).pixels);
    assert_ne!(
        studio.pixels,
        rendered(&["--environment", "studio", "--environment-turn", "90"]).pixels
    );
    // Twice the radiance is exactly twice the light, as there is no other
    let twice = rendered(&["--environment", "studio", "--environment-scale", "2"]);
    for (one, two) in studio.pixels.iter().zip(&twice.pixels) {
        assert_eq!(one.map(|channel| 2.0 * channel), *two);
    }
}

#[test]
fn environment_map_is_read_from_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("grey.exr");
    let grey = LinearImage {
        width: 4,
        height: 2,
        pixels: vec![[0.5; 3]; 8],
    };
    whit::image::write(
        &grey,
        &map,
        whit::image::ImageFormat::Exr,
        whit::image::ToneMap::default(),
    )
    .unwrap();
    let image = rendered(&["--environment", path(&map), "--view", "front"]);
    assert_eq!(image.pixels[0], [0.5; 3]);
}

#[test]
fn wrong_environment_flags_are_refused() {
    for (words, flags) in [
        ("`studio` or `sky`", &["--environment", "night"][..]),
        ("missing.hdr", &["--environment", "missing.hdr"]),
        ("--ambient", &["--environment", "sky", "--ambient", "1"]),
        (
            "0 or more",
            &["--environment", "sky", "--environment-scale", "-1"],
        ),
        ("--environment", &["--environment-turn", "3"]),
    ] {
        refused(words, flags);
    }
}

#[test]
fn crop_has_the_bits_of_the_whole_image() {
    for flags in [
        &["--environment", "studio", "--filter", "tent"][..],
        &["--edge-contrast", "0.03", "--exposure", "0"],
    ] {
        let whole = rendered(flags);
        let part = rendered(&[flags, &["--crop", "5,7,11,13"]].concat());
        assert_eq!((part.width, part.height), (11, 13));
        for y in 0..13 {
            for x in 0..11 {
                assert_eq!(
                    part.pixels[11 * y + x],
                    whole.pixels[24 * (y + 7) + x + 5],
                    "{flags:?} {x} {y}"
                );
            }
        }
    }
}

#[test]
fn wrong_crop_is_refused() {
    for (words, flags) in [
        ("give the left column", &["--crop", "1,2,3"][..]),
        (
            "beyond the image of 24x24",
            &["--size", "24x24", "--crop", "20,0,5,5"],
        ),
        ("`--adaptive`", &["--crop", "0,0,5,5", "--adaptive", "0.01"]),
        ("--error", &["--crop", "0,0,5,5", "--error", "0.01"]),
    ] {
        refused(words, flags);
    }
}
