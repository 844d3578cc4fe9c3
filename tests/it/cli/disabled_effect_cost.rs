//! Disabled effects cost no time, measured in instructions.
//!
//! Runs three builds of `whit` under `valgrind --tool=callgrind`: the normal build, one with the code of shadows and
//! mirrors only, and in the slow tier one without the code of any effect (`WHIT_WITHOUT` in the compiler's environment,
//! see `scene::Effect`). For scenes with only shadows and mirrors enabled, only shadows, or nothing, the first two
//! builds must take equally many instructions, to 0.1 %; for the scene with nothing enabled, so must the first and the
//! third.
//!
//! As this holds for the absence of all these effects together, it holds for each: removing code never adds
//! instructions, so the cost of one effect's code is at most that of all. The scenes are the worst case: they have few
//! objects, one light and short paths, so that tests per packet or per light are a larger share of their instructions
//! than in any scene with more effects. Energy conservation, which every rough or diffuse material of glTF's model has, is
//! switched off by the flag.
//!
//! The counts are of rendering alone: the count at one sample per pixel is subtracted from that at more. Each count is
//! the smallest of three, as some runs take about ten thousand more instructions before rendering. Embree is restricted
//! to one instruction set, and there is one thread. Both builds must have equally many Embree callbacks, and none for
//! disabled effects; `tests/it/scenes/effect_plan.rs` checks for random scenes that disabled effects trace no rays.
//!
//! `tests/ci/disabled_effects.sh` makes the builds and runs this test; without them it prints a note and passes.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::thread;

/// Flag that switches off what all materials of the scenes have.
const WITHOUT_CONSERVATION: &str = "--effects=-energy-conservation";

/// Largest accepted relative difference in instructions.
const MAX_COST: f64 = 1e-3;

const OBJECTS: &str = r#"
camera = { from = [0, 2, 6], at = [0, 0.5, 0], fov = 40 }

[material.chalk]
base_color = [0.7, 0.6, 0.5]
metallic = 0
roughness = 0.8

[material.ball]
base_color = [0.7, 0.6, 0.5]
metallic = METALLIC
roughness = ROUGHNESS

[[object]]
shape = "cube"
transform = [{ rotate = [0, 1, 0, 30] }]
material = "chalk"

[[object]]
shape = "sphere"
transform = [{ translate = [1.6, 0, 1] }]
material = "ball"

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

/// Returns the objects with a diffuse ball.
fn dull() -> String {
    OBJECTS.replace("METALLIC", "0").replace("ROUGHNESS", "0.8")
}

/// Returns the objects with a mirror ball.
fn polished() -> String {
    OBJECTS.replace("METALLIC", "1").replace("ROUGHNESS", "0")
}

/// Counts of one run.
struct Count {
    instructions: f64,
    /// Calls of the Embree callbacks for shapes and instances: of intersection queries, and of occlusion queries.
    callbacks: [u64; 2],
}

impl Count {
    /// Parses the output file of callgrind.
    fn of(profile: &str) -> Count {
        let summary = profile.lines().find_map(|line| line.strip_prefix("summary: "));
        Count {
            instructions: summary.unwrap().trim().parse().unwrap(),
            callbacks: ["::on_intersect", "::on_occluded"].map(|name| calls(profile, name)),
        }
    }
}

/// Returns the number of calls of functions whose name contains `function`.
fn calls(profile: &str, function: &str) -> u64 {
    let (mut callee, mut sum) = ("", 0);
    for line in profile.lines() {
        if let Some(name) = line.strip_prefix("cfn=") {
            callee = name;
        } else if let Some(calls) = line.strip_prefix("calls=").filter(|_| callee.contains(function)) {
            sum += calls.split(' ').next().unwrap().parse::<u64>().unwrap();
        }
    }
    sum
}

/// Returns the counts of `whit` for a render of `scene` with `spp` samples per pixel.
fn count(whit: &str, scene: &Path, backend: &str, spp: u32) -> Count {
    let folder = tempfile::tempdir().unwrap();
    let profile = folder.path().join("profile");
    let mut command = Command::new("valgrind");
    command
        .args(["--tool=callgrind", "--compress-strings=no"])
        .arg(format!("--callgrind-out-file={}", profile.display()))
        .args([whit, "render"])
        .arg(scene)
        .arg("-o")
        .arg(folder.path().join("picture.exr"))
        .args([
            "--quiet",
            "--size",
            "64x48",
            "--threads",
            "1",
            "--backend",
            backend,
        ])
        .args(["--spp", &spp.to_string(), WITHOUT_CONSERVATION]);
    if backend == "embree" {
        command.args(["--isa", "avx2"]);
    }
    let run = command.output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    // Function names of other libraries may not be UTF-8.
    Count::of(&String::from_utf8_lossy(&fs::read(profile).unwrap()))
}

/// Returns the counts of rendering alone.
fn rendering(whit: &str, scene: &Path, backend: &str) -> Count {
    let [more, one] = [17, 1].map(|spp| {
        let counts = (0..3).map(|_| count(whit, scene, backend, spp));
        counts
            .min_by(|a, b| a.instructions.total_cmp(&b.instructions))
            .unwrap()
    });
    Count {
        instructions: more.instructions - one.instructions,
        callbacks: more.callbacks,
    }
}

/// Returns the effects that `whit info` lists as enabled.
fn effects_on(whit: &str, scene: &Path) -> Vec<String> {
    let info = Command::new(whit)
        .arg("info")
        .arg(scene)
        .arg(WITHOUT_CONSERVATION)
        .output();
    let run = info.unwrap();
    assert!(run.status.success());
    let said = String::from_utf8_lossy(&run.stdout).into_owned();
    let on = said.lines().filter_map(|line| {
        let (name, state) = line.strip_prefix("effect")?.trim().split_once(' ')?;
        state.starts_with("on:").then(|| name.to_owned())
    });
    on.collect()
}

#[test]
fn disabled_effects_take_no_instructions() {
    let builds = ["WHIT_WHOLE", "WHIT_MIRRORS", "WHIT_BARE"].map(|name| std::env::var(name).ok());
    let [Some(whole), Some(mirrors), bare] = builds else {
        eprintln!("skipped: tests/ci/disabled_effects.sh makes the builds that this compares");
        return;
    };
    let bare = bare.as_ref().unwrap_or(&mirrors);
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        ("dark.toml", dull(), bare, vec![]),
        ("lit.toml", dull() + LIGHT, &mirrors, vec!["shadow"]),
        (
            "mirror.toml",
            polished() + LIGHT,
            &mirrors,
            vec!["shadow", "reflection"],
        ),
    ];
    let mut faults = Vec::new();
    for (name, text, without, on) in cases {
        let scene = folder.path().join(name);
        fs::write(&scene, text).unwrap();
        assert_eq!(effects_on(&whole, &scene), on, "{name}");
        for backend in ["embree", "bsp"] {
            let [there, absent] = thread::scope(|scope| {
                let scene = scene.as_path();
                let of = |whit| scope.spawn(move || rendering(whit, scene, backend));
                [of(&whole), of(without)].map(|run| run.join().unwrap())
            });
            let more = there.instructions / absent.instructions - 1.0;
            let line = format!(
                "{name} through {backend}: {} instructions, without the code of what is off {}: {:+.4} %",
                there.instructions,
                absent.instructions,
                100.0 * more
            );
            println!("{line}");
            if more.abs() > MAX_COST {
                faults.push(line);
            }
            assert_eq!(there.callbacks, absent.callbacks, "{name} through {backend}");
            let [nearest, any] = there.callbacks.map(|calls| calls > 0);
            assert_eq!(nearest, backend == "embree", "{name} through {backend}");
            assert_eq!(any, nearest && on.contains(&"shadow"), "{name} through {backend}");
        }
    }
    assert!(faults.is_empty(), "{faults:#?}");
}
