//! Tests of job files as users write them: the example file expands to its frames, and every error is one sentence with
//! file, line, item and remedy.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use crate::gltf::LoadOptions;
use crate::jobs::{Jobs, OrbitView};
use crate::scene_file::{self, Edit};
use glam::DVec3;

fn example() -> Jobs {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/turntable.jobs.toml");
    Jobs::load(&path).unwrap()
}

#[test]
fn the_example_is_a_turn_of_24_frames() {
    let jobs = example();
    let images: BTreeSet<&Path> = jobs.frames.iter().map(|frame| frame.image.as_path()).collect();
    assert_eq!(images.len(), 24);
    assert!(images.contains(Path::new("turntable.0024.png")));
    for (k, frame) in jobs.frames.iter().enumerate() {
        let OrbitView::Turn { turns, axis, .. } = frame.view else {
            panic!("{:?}", frame.view)
        };
        assert_eq!((turns, axis), (k as f64 / 24.0, DVec3::Y));
    }
}

/// Tolerance of rotated points: they are rounded in the last digits of numbers below 8.
const NEAR: f64 = 1e-13;

#[test]
fn the_examples_camera_keeps_its_height_and_its_distance_to_the_axis() {
    let jobs = example();
    // Load the scene, with the turntable's centre in normalised coordinates
    let scene = scene_file::load(&jobs.frames[0].scene, &LoadOptions::default())
        .unwrap()
        .scene;
    let OrbitView::Turn {
        center: Some(center), ..
    } = jobs.frames[0].view
    else {
        panic!("{:?}", jobs.frames[0].view)
    };
    let center = scene.normalisation.point(center);
    // Compute the camera positions of all frames
    let places: Vec<DVec3> = jobs
        .frames
        .iter()
        .map(|frame| {
            frame
                .view
                .of(&scene.cameras[0], &scene, DVec3::ZERO)
                .world_from_camera
                .translation
        })
        .collect();
    // Check that distance to and height along the axis stay the same
    let first = places[0] - center;
    assert!((first - (scene.cameras[0].world_from_camera.translation - center)).length() < NEAR);
    for place in &places {
        let from_axis = *place - center;
        assert!((from_axis.y - first.y).abs() < NEAR);
        assert!((from_axis.length() - first.length()).abs() < NEAR);
    }
    // Half a turn later the camera is on the opposite side.
    let across = places[12] - center;
    assert!((across.x + first.x).abs() < NEAR && (across.z + first.z).abs() < NEAR);
}

#[test]
fn the_formats_own_example_is_read() {
    let source = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/jobs/mod.rs")).unwrap();
    let lines = source.lines().map_while(|line| line.strip_prefix("//!"));
    let code = lines
        .skip_while(|line| *line != " ```toml")
        .skip(1)
        .take_while(|line| *line != " ```");
    let text: Vec<&str> = code.map(|line| line.strip_prefix(' ').unwrap_or(line)).collect();
    let jobs = read(&text.join("\n")).unwrap();
    // 24 frames of the turntable; 48 with two cameras; 60 of the path; 3 values by 4.
    assert_eq!(jobs.frames.len(), 24 + 2 * 48 + 60 + 3 * 4);
}

/// Loads a job file from a folder that contains a few (empty) scene files.
fn read(text: &str) -> Result<Jobs, String> {
    let folder = tempfile::tempdir().unwrap();
    for scene in [
        "a.toml",
        "b.glb",
        "whitted_1980.toml",
        "walk.glb",
        "gems.toml",
        "metals.toml",
    ] {
        fs::write(folder.path().join(scene), b"").unwrap();
    }
    let path = folder.path().join("x.jobs.toml");
    fs::write(&path, text).unwrap();
    Jobs::load(&path).map_err(|error| error.to_string())
}

/// Checks that the job file `text` is rejected with an error that contains `words`.
#[track_caller]
fn refused(text: &str, words: &str) {
    let message = read(text).expect_err(text);
    assert!(message.contains(words), "{text}: {message}");
    assert!(
        message.contains("x.jobs.toml") && !message.contains('\n'),
        "{message}"
    );
}

#[test]
fn invalid_job_files_are_rejected_in_one_sentence() {
    // Each entry is a job file and a part of its error message
    for (text, words) in [
        ("", "has no jobs: add a [[job]]"),
        ("[[job]]\n", "lacks"),
        ("[[job]]\nscene = \"d.toml\"\n", "there is no file"),
        ("[[job]]\nscene = []\n", "has no scene"),
        ("[[job]]\nscene = \"a.toml\"\nframes = 0\n", "has no frames"),
        (
            "[[job]]\nscene = \"a.toml\"\nframes = 2000000\n",
            "more than 1000000 frames",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nturntable = {}\n",
            "has a turntable but no frames",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nframes = 2\nturntable = { axis = [0, 0, 0] }\n",
            "an `axis` of no direction",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\ncolour = 2\n",
            "`colour` is not known here",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nimage = \"../x.png\"\n",
            "outside the output folder",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nsweep = { \"a.b\" = [] }\n",
            "has no values",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nsweep = { \"a..b\" = [1] }\n",
            "is no key",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nsweep = { a = { from = 0, to = 1, steps = 1 } }\n",
            "has no valid steps",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nsplit = { bands = 0 }\n",
            "into 0 pieces",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nsplit = { bands = 99999, shares = 99999 }\n",
            "splits a frame into",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nanimation = { fps = 0, to = 1 }\n",
            "has no",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nanimation = {}\n",
            "has no valid end",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nsettings = { spp = { a = 1 } }\n",
            "is not a valid setting",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\npath = [{ frame = 1, from = [0, 0, 0], at = [0, 0, 0] }]\n",
            "is not a valid view",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\npath = [{ frame = 1, from = [0, 0, 5], at = [0, 0, 0] }, \
                 { frame = 1, from = [0, 0, 5], at = [0, 0, 0] }]\n",
            "order the keys",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nframse = 2\n",
            ":3:1: job 1.framse: `framse` is not known here: did you mean `frames`?",
        ),
        ("[[job]]\nscene = \"a.toml\"\nframes = \"1-\"\n", "as in \"1-24\""),
        (
            "[[job]]\nscene = \"a.toml\"\nframes = 1.5\n",
            "a number of frames",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nframes = \"0-4294967295\"\n",
            "more than 1000000 frames",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nframes = 2\nimage = \"x.png\"\n",
            "image 1 of job 1 (of a.toml) and image 2 of job 1 (of a.toml) would both be written to x.png",
        ),
        (
            "[[job]]\nname = \"p\"\nscene = \"a.toml\"\nimage = \"x.png\"\n[[job]]\nscene = \"a.toml\"\nimage = \"x.png/y.png\"\n",
            "image 1 of job p (of a.toml) would be written to x.png, which is also the folder of image 1 of job 2",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nimage = \"x.jpg\"\n",
            "end `image` in .png or .exr",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nimage = \"{hue}.png\"\n",
            "unknown field `{hue}`",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nimage = \"/x.png\"\n",
            "outside the output folder",
        ),
        (
            "[[job]]\nscene = \"b.glb\"\nsweep = { a = [1] }\n",
            "sweeps change scene files, which b.glb is not",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nsweep = { a = 3 }\n",
            "give a list of values",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nsweep = { a = { from = 1, to = 2, step = 3 } }\n",
            "did you mean `steps`?",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nzip = true\nsweep = { a = [1, 2], b = [3] }\n",
            ":4:",
        ),
        ("[[job]]\nscene = \"a.toml\"\nzip = true\n", "no `sweep`"),
        (
            "[[job]]\nscene = \"a.toml\"\ninterpolation = \"linear\"\n",
            "requires a `path`",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\ninterpolation = \"cubic\"\n",
            "`cubic` is not known here: give one of `linear`, `smooth`",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\nframes = 2\nturntable = {}\n\
                 path = [{ frame = 1, from = [0, 0, 5], at = [0, 0, 0] }]\n",
            "keep one of them",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\ninterpolation = \"linear\"\n\
                 path = [{ frame = 1, from = [0, 0, 5], at = [0, 0, 0] }, { frame = 3, from = [0, 0, 0], at = [0, 0, 5] }]\n",
            "no valid view at frame 2",
        ),
        (
            "[[job]]\nscene = \"a.toml\"\n\
                 path = [{ frame = 1, from = [0, 0, 5], at = [0, 0, 0], fov = 40 }, { frame = 3, from = [0, 0, 6], at = [0, 0, 0] }]\n",
            "give one to all keys or to none",
        ),
        (
            "[[job]]\nscene = \"b.glb\"\nframes = 3\nanimation = { to = 1 }\n",
            "in addition to `frames`",
        ),
    ] {
        refused(text, words);
    }
}

/// Loads a scene file with a ball of roughness 0.5 after one edit; returns the number of instances or the error.
fn edited(key: &[&str], value: toml::Value) -> Result<f32, String> {
    let text = "camera = { from = [0, 0, 5], at = [0, 0, 0] }\n[material.ball]\nroughness = 0.5\n\
                [[object]]\nname = 'ball'\nshape = 'sphere'\nmaterial = 'ball'\n";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.toml");
    fs::write(&path, text).unwrap();
    let edit = Edit {
        key: key.iter().map(|&word| word.to_owned()).collect(),
        value,
    };
    let loaded = scene_file::load_edited(&path, &[edit], &LoadOptions::default());
    loaded
        .map(|file| file.scene.instances.len() as f32)
        .map_err(|error| error.to_string())
}

#[test]
fn edited_scenes_are_parsed_like_written_ones() {
    let value = |x: f64| toml::Value::Float(x);
    assert_eq!(edited(&["material", "ball", "roughness"], value(0.25)), Ok(1.0));
    // Misspelt keys and invalid values are reported in terms of the edit
    for (key, x, words) in [
        (
            ["material", "ball", "ruoghness"],
            0.5,
            "did you mean `roughness`?",
        ),
        (
            ["material", "ball", "roughness"],
            -1.0,
            "with the swept material.ball.roughness = -1.0",
        ),
        (["material", "bell", "roughness"], 0.5, "did you mean `ball`?"),
        (
            ["object", "1", "name"],
            0.5,
            "`object` of the scene has no `1`: give one of `ball`",
        ),
    ] {
        let message = edited(&key, value(x)).unwrap_err();
        assert!(message.contains(words) && message.contains("a.toml"), "{message}");
        assert!(!message.contains('\n'), "{message}");
    }
}
