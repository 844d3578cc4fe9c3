//! Frames with different scenes share decoded images and built meshes, and equal those rendered alone to the byte.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::cli_program::whit;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};

fn backends() -> &'static [&'static str] {
    match cfg!(feature = "embree") {
        true => &["bsp", "embree"],
        false => &["bsp"],
    }
}

/// Adds an animation of one second to a glTF scene of the repository, in which the mirror rises.
fn animated(folder: &Path) -> PathBuf {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/first_light.gltf");
    let mut gltf: Value = serde_json::from_slice(&fs::read(scene).unwrap()).unwrap();
    let [times, places] = [vec![0f32, 1.0], vec![0.0, 1.0, 0.0, 0.0, 2.0, 0.0]];
    let bytes: Vec<u8> = times
        .iter()
        .chain(&places)
        .flat_map(|number| number.to_le_bytes())
        .collect();
    let mut push = |list: &str, value: Value| {
        let list = gltf[list].as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    };
    let uri = format!(
        "data:application/octet-stream;base64,{}",
        BASE64_STANDARD.encode(&bytes)
    );
    let buffer = push("buffers", json!({"uri": uri, "byteLength": bytes.len()}));
    let mut accessor = |kind: &str, offset: usize, length: usize| {
        let view = json!({"buffer": buffer, "byteOffset": offset, "byteLength": length});
        let view = push("bufferViews", view);
        push(
            "accessors",
            json!({"bufferView": view, "componentType": 5126, "count": 2, "type": kind, "min": [0], "max": [1]}),
        )
    };
    let (input, output) = (accessor("SCALAR", 0, 8), accessor("VEC3", 8, 24));
    let is_mirror = |node: &Value| node["name"] == "mirror";
    let node = gltf["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .position(is_mirror)
        .unwrap();
    gltf["animations"] = json!([{
        "samplers": [{"input": input, "output": output}],
        "channels": [{"sampler": 0, "target": {"node": node, "path": "translation"}}]
    }]);
    let path = folder.join("animated.gltf");
    fs::write(&path, gltf.to_string()).unwrap();
    path
}

/// Renders the frames of a job in one process, and each in its own process; returns the output of the former.
fn render_together_and_alone(folder: &Path, job: &str, backend: &str, names: &[&str]) -> String {
    let folder = &folder.join(backend);
    fs::create_dir(folder).unwrap();
    let settings = format!("settings = {{ size = \"32x24\", spp = 2, backend = \"{backend}\" }}");
    let [jobs, at_once, alone] = ["test.jobs.toml", "at once", "alone"].map(|name| folder.join(name));
    fs::write(&jobs, format!("[[job]]\n{settings}\n{job}\n")).unwrap();
    let run = |out: &Path, shard: &str| {
        let [jobs, out] = [&jobs, out].map(|path| path.to_str().unwrap());
        let run = whit(&["batch", jobs, "--out", out, "--shard", shard]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        run.stdout
    };
    let said = run(&at_once, "1/1");
    for shard in 1..=names.len() {
        let stdout = run(&alone, &format!("{shard}/{}", names.len()));
        assert!(!stdout.contains("images were reused"), "{stdout}");
    }
    let bytes: Vec<Vec<u8>> = names
        .iter()
        .map(|name| fs::read(at_once.join(name)).unwrap())
        .collect();
    for (name, bytes) in names.iter().zip(&bytes) {
        assert!(*bytes == fs::read(alone.join(name)).unwrap(), "{name}");
    }
    // The images differ, so the frames themselves were not reused.
    assert!(bytes.windows(2).all(|pair| pair[0] != pair[1]));
    said
}

/// Returns the two numbers of the line that contains `words`; zeros if there is none.
fn numbers(said: &str, words: &str) -> [usize; 2] {
    let line = said.lines().find(|line| line.contains(words)).unwrap_or_default();
    let mut numbers = line.split(' ').filter_map(|word| word.parse().ok());
    [(); 2].map(|()| numbers.next().unwrap_or_default())
}

#[test]
fn animation_frames_share_decoded_images_and_static_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let scene = animated(folder.path());
    for backend in backends() {
        let job = format!(
            "scene = '{}'\nanimation = {{ fps = 2, from = 0, to = 1 }}\nimage = \"{{frame}}.png\"",
            scene.display()
        );
        let said = render_together_and_alone(folder.path(), &job, backend, &["1.png", "2.png", "3.png"]);
        // There are two images and three frames, of which the first two may be loaded concurrently.
        let [found, requested] = numbers(&said, "images were reused");
        assert!(requested == 6 && (2..=4).contains(&found), "{said}");
        let [found, requested] = numbers(&said, "built meshes were reused");
        match *backend {
            // One of the meshes moves from frame to frame.
            "embree" => {
                let still = requested / 3 - 1;
                assert!(still > 0 && (still..=2 * still).contains(&found), "{said}");
            }
            _ => assert_eq!(requested, 0, "{said}"),
        }
    }
}

#[test]
fn sweep_frames_share_decoded_images() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let job = format!(
        "scene = '{}'\nsweep = {{ \"light.0.intensity\" = [1, 2, 3] }}\nimage = \"{{intensity}}.png\"",
        scenes.join("textured.toml").display()
    );
    let said = render_together_and_alone(folder.path(), &job, "bsp", &["1.png", "2.png", "3.png"]);
    let [found, requested] = numbers(&said, "images were reused");
    // The first two frames may be loaded concurrently.
    assert!(
        3 * found >= requested && 3 * found <= 2 * requested && found > 0,
        "{said}"
    );
}
