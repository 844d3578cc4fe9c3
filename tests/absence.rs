//! What a scene does not call for costs nothing by being there, counted in instructions.
//!
//! Three builds of `whit` are run under `valgrind --tool=callgrind`: as it is, without the code of all effects but shadows,
//! and without the code of all effects (`WHIT_WITHOUT` in the compiler's environment, see `scene::Effect`). A scene in
//! which nothing but shadows is on must take the first two equally many instructions, to 0.1 %, and a scene in which
//! nothing is on the first and the third. As that holds for the absence of all these effects together, it holds for
//! each: code that is absent never takes more instructions than code that is there.
//!
//! Instructions are those of rendering alone: the count at one sample a pixel is subtracted from that at more. Embree is
//! held to one instruction set, and there is one thread.
//!
//! `tests/absence.sh` makes the builds and runs this; without them the test says so and passes.

use std::fs;
use std::path::Path;
use std::process::Command;

/// Share of the instructions that may differ.
const MOST: f64 = 1e-3;

const OBJECTS: &str = r#"
camera = { from = [0, 2, 6], at = [0, 0.5, 0], fov = 40 }

[material.chalk]
base_color = [0.7, 0.6, 0.5]
metallic = 0
roughness = 0.8

[[object]]
shape = "cube"
transform = [{ rotate = [0, 1, 0, 30] }]
material = "chalk"

[[object]]
shape = "sphere"
transform = [{ translate = [1.6, 0, 1] }]
material = "chalk"

[[object]]
shape = "plane"
transform = [{ z-to = [0, 1, 0] }, { translate = [0, -1, 0] }]
material = "chalk"

[shape.wedge.mesh]
vertices = [[-2, -1, 0], [-1, -1, 1], [-1.5, 1.5, 0.5], [-2.5, -1, 1]]
faces = [[0, 1, 2], [1, 3, 2], [3, 0, 2], [0, 3, 1]]

[[object]]
shape = "wedge"
material = "chalk"
"#;

const LIGHT: &str = r#"
[[light]]
kind = "point"
position = [3, 5, 4]
intensity = 60
"#;

/// Instructions of `whit` when it renders `scene` with so many samples a pixel.
fn instructions(whit: &str, scene: &Path, backend: &str, spp: u32) -> f64 {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new("valgrind");
    command
        .args([
            "--tool=callgrind",
            "--callgrind-out-file=/dev/null",
            whit,
            "render",
        ])
        .arg(scene)
        .arg("-o")
        .arg(folder.path().join("picture.exr"))
        .args(["--size", "64x48", "--threads", "1", "--backend", backend])
        .args(["--spp", &spp.to_string()]);
    if backend == "embree" {
        command.args(["--isa", "avx2"]);
    }
    let run = command.output().unwrap();
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{said}");
    let counted = said.lines().find_map(|line| line.split("Collected :").nth(1));
    counted
        .unwrap_or_else(|| panic!("{said}"))
        .trim()
        .parse()
        .unwrap()
}

/// Instructions for rendering alone.
fn rendering(whit: &str, scene: &Path, backend: &str) -> f64 {
    instructions(whit, scene, backend, 17) - instructions(whit, scene, backend, 1)
}

/// The effects that `whit info` says are on.
fn effects_on(whit: &str, scene: &Path) -> Vec<String> {
    let run = Command::new(whit).arg("info").arg(scene).output().unwrap();
    assert!(run.status.success());
    let said = String::from_utf8_lossy(&run.stdout).into_owned();
    let on = said.lines().filter_map(|line| {
        let (name, state) = line.strip_prefix("effect")?.trim().split_once(' ')?;
        state.starts_with("on:").then(|| name.to_owned())
    });
    on.collect()
}

#[test]
fn effects_that_a_scene_does_not_call_for_take_no_instructions_by_being_there() {
    let builds = ["WHIT_WHOLE", "WHIT_SHADOW_ONLY", "WHIT_BARE"].map(|name| std::env::var(name).ok());
    let [Some(whole), Some(shadow_only), Some(bare)] = builds else {
        eprintln!("skipped: tests/absence.sh makes the builds that this compares");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        (
            "lit.toml",
            format!("{OBJECTS}{LIGHT}"),
            shadow_only,
            vec!["shadow"],
        ),
        ("dark.toml", OBJECTS.into(), bare, vec![]),
    ];
    for (name, text, without, on) in cases {
        let scene = folder.path().join(name);
        fs::write(&scene, text).unwrap();
        assert_eq!(effects_on(&whole, &scene), on, "{name}");
        for backend in ["embree", "bsp"] {
            let [there, absent] = [&whole, &without].map(|whit| rendering(whit, &scene, backend));
            let more = there / absent - 1.0;
            println!(
                "{name} through {backend}: {there} instructions, without the code {absent}: {:+.4} %",
                100.0 * more
            );
            assert!(
                more.abs() <= MOST,
                "{name} through {backend}: {there} against {absent}"
            );
        }
    }
}
