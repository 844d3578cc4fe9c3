//! What a scene does not call for costs nothing by being there, counted in instructions.
//!
//! Builds of `whit` are run under `valgrind --tool=callgrind`: as it is, without the code of all effects but shadows and
//! mirrors, and in the slow tier without the code of all effects (`WHIT_WITHOUT` in the compiler's environment, see
//! `scene::Effect`). A scene in which nothing but shadows and mirrors is on, shadows alone, or nothing, must take the first
//! two equally many instructions, to 0.1 %, and a scene in which nothing is on the first and the third.
//!
//! As that holds for the absence of all these effects together, it holds for each: code that is absent takes no more
//! instructions than code that is there, so what one effect's code takes is at most what all take. And it is the hardest
//! of cases: the scenes have few objects, one light and rays that end soon, so that whatever is asked once a packet or
//! once a light is a larger share of their instructions than of those of any scene that calls for more.
//!
//! Instructions are those of rendering alone: the count at one sample a pixel is subtracted from that at more. Each count
//! is the least of three, as now and then a run takes some ten thousand more before it renders. Embree is held to one
//! instruction set, and there is one thread. Embree calls back equally often in both builds, and never for what is off;
//! that rays of effects that are off are none is held by `tests/it/scenes/effect_plan.rs` for random scenes.
//!
//! `tests/ci/disabled_effects.sh` makes the builds and runs this; without them the test says so and passes.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::thread;

/// Share of the instructions that may differ.
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

/// The objects, with a ball of chalk.
fn dull() -> String {
    OBJECTS.replace("METALLIC", "0").replace("ROUGHNESS", "0.8")
}

/// The objects, with a ball that is a mirror.
fn polished() -> String {
    OBJECTS.replace("METALLIC", "1").replace("ROUGHNESS", "0")
}

/// What was counted of a run.
struct Count {
    instructions: f64,
    /// Calls of what answers Embree on shapes and placed meshes: for nearest hits, and for any.
    callbacks: [u64; 2],
}

impl Count {
    /// From what callgrind has written.
    fn of(profile: &str) -> Count {
        let summary = profile.lines().find_map(|line| line.strip_prefix("summary: "));
        Count {
            instructions: summary.unwrap().trim().parse().unwrap(),
            callbacks: ["::on_intersect", "::on_occluded"].map(|name| calls(profile, name)),
        }
    }
}

/// How often functions whose name contains `function` were called.
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

/// What `whit` takes to render `scene` with so many samples a pixel.
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
        .args(["--size", "64x48", "--threads", "1", "--backend", backend])
        .args(["--spp", &spp.to_string()]);
    if backend == "embree" {
        command.args(["--isa", "avx2"]);
    }
    let run = command.output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    // Names of other libraries' functions may be anything.
    Count::of(&String::from_utf8_lossy(&fs::read(profile).unwrap()))
}

/// What rendering alone takes.
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
            let told = format!(
                "{name} through {backend}: {} instructions, without the code of what is off {}: {:+.4} %",
                there.instructions,
                absent.instructions,
                100.0 * more
            );
            println!("{told}");
            if more.abs() > MAX_COST {
                faults.push(told);
            }
            assert_eq!(there.callbacks, absent.callbacks, "{name} through {backend}");
            let [nearest, any] = there.callbacks.map(|calls| calls > 0);
            assert_eq!(nearest, backend == "embree", "{name} through {backend}");
            assert_eq!(any, nearest && on.contains(&"shadow"), "{name} through {backend}");
        }
    }
    assert!(faults.is_empty(), "{faults:#?}");
}
