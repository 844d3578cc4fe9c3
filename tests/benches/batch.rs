//! Cost of a batch beyond its tracing, and of AOVs beside colours:
//! `cargo bench --bench batch -- [SCENE] [FRAMES]`.
//!
//! **Throughput.** FRAMES (100) turntable frames of SCENE (`scenes/first_light.gltf`), 512x512 pixels with 16 samples, by
//! one `whit batch`, against FRAMES times the render phase of a frame by itself: the median of five that stand around the
//! same turntable, each made by a process of its own. The part is that product over the seconds of the whole batch:
//! loading, building and writing are the rest. Busy is the processor time of the whole process over threads times
//! seconds. Batches and single frames take turns; medians of the turns are printed.
//!
//! **Layers.** The render phase of `whit render` with `--aov depth,normal,albedo,ids` over that without, in turns: the
//! median of the ratios of neighbours with the range of their middle half, on SCENE and three of the repository's own,
//! 1024x768 pixels with 16 samples, and with one.
//!
//! Scenes are rendered as their files say, with as many threads as there are processors.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

const WHIT: &str = env!("CARGO_BIN_EXE_whit");

/// Batches that are timed.
const BATCHES: usize = 3;
/// Single frames that are timed beside each.
const SINGLES: usize = 5;
/// Pairs of renders with and without layers.
const PAIRS: usize = 11;

const LAYERS: &str = "depth,normal,albedo,ids";

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Outcome<()> {
    let words: Vec<String> = std::env::args()
        .skip(1)
        .filter(|a| !a.starts_with("--"))
        .collect();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let first_light = root.join("scenes/first_light.gltf");
    let scene = words.first().map_or(first_light.clone(), |word| word.into());
    let scene = fs::canonicalize(&scene)?;
    let frames: usize = words.get(1).map_or(Ok(100), |word| word.parse())?;
    throughput(&scene, frames)?;
    let mut scenes = vec![scene];
    for own in ["first_light.gltf", "textured.toml", "whitted_1980.toml"] {
        let own = fs::canonicalize(root.join("scenes").join(own))?;
        if !scenes.contains(&own) {
            scenes.push(own);
        }
    }
    for spp in ["16", "1"] {
        for scene in &scenes {
            layers(scene, spp)?;
        }
    }
    Ok(())
}

fn throughput(scene: &Path, frames: usize) -> Outcome<()> {
    let folder = tempfile::tempdir()?;
    let jobs = |count: usize, name: &str| -> Outcome<String> {
        let text = format!(
            "[[job]]\nscene = '{}'\nframes = {count}\nturntable = {{}}\n\
             settings = {{ size = \"512x512\", spp = 16 }}\nimage = \"{{frame:04}}.png\"\n",
            scene.display()
        );
        let path = folder.path().join(name);
        fs::write(&path, text)?;
        Ok(path.display().to_string())
    };
    let all = jobs(frames, "all.jobs.toml")?;
    let few = jobs(SINGLES, "few.jobs.toml")?;
    let threads = std::thread::available_parallelism()?.get() as f64;
    let (mut parts, mut busy, mut seconds) = (Vec::new(), Vec::new(), Vec::new());
    for turn in 0..BATCHES {
        let out = folder.path().join(format!("{turn}")).display().to_string();
        let [wall, processors] = timed(&["batch", &all, "--out", &out, "--quiet"])?;
        let mut alone = Vec::new();
        for number in 1..=SINGLES {
            let out = format!("{out}.{number}");
            let shard = format!("{number}/{SINGLES}");
            timed(&["batch", &few, "--out", &out, "--shard", &shard, "--quiet"])?;
            alone.push(render_seconds(&out)?);
        }
        parts.push(frames as f64 * median(&mut alone) / wall);
        busy.push(processors / (threads * wall));
        seconds.push(wall);
    }
    let name = scene.file_name().unwrap_or_default().display();
    println!(
        "{name}: {frames} frames in {:.2} s, tracing alone is {:.3} of that; processors {:.1} % busy",
        median(&mut seconds),
        median(&mut parts),
        100.0 * median(&mut busy)
    );
    Ok(())
}

/// The render phase of the only frame that was made in a folder.
fn render_seconds(out: &str) -> Outcome<f64> {
    for entry in fs::read_dir(out)? {
        let path = entry?.path();
        if path.extension().is_some_and(|kind| kind == "jsonl") {
            let text = fs::read_to_string(path)?;
            let done: serde_json::Value = serde_json::from_str(text.trim())?;
            return done["render_seconds"].as_f64().ok_or_else(|| "no seconds".into());
        }
    }
    Err("nothing is noted".into())
}

/// Seconds by the clock and of the processors that a run of whit takes.
fn timed(arguments: &[&str]) -> Outcome<[f64; 2]> {
    // The shell knows what its children took.
    let output = Command::new("bash")
        .args(["-c", "TIMEFORMAT='%R %U %S'; time \"$@\"", "bash", WHIT])
        .args(arguments)
        .stdin(Stdio::null())
        .output()?;
    let report = String::from_utf8(output.stderr)?;
    if !output.status.success() {
        return Err(report.into());
    }
    let numbers: Vec<f64> = report
        .lines()
        .last()
        .unwrap_or_default()
        .split(' ')
        .map(str::parse)
        .collect::<Result<_, _>>()?;
    match numbers[..] {
        [wall, user, system] => Ok([wall, user + system]),
        _ => Err(report.into()),
    }
}

fn layers(scene: &Path, spp: &str) -> Outcome<()> {
    let folder = tempfile::tempdir()?;
    let path = |name: &str| folder.path().join(name).display().to_string();
    let render = |more: &[&str]| -> Outcome<f64> {
        let (stats, image) = (path("stats.json"), path("picture.exr"));
        let scene = scene.display().to_string();
        let words = [
            "render", &scene, "-o", &image, "--size", "1024x768", "--spp", spp, "--stats", &stats, "--quiet",
        ];
        timed(&[&words[..], more].concat())?;
        let stats: serde_json::Value = serde_json::from_slice(&fs::read(stats)?)?;
        stats["seconds"]["render"]
            .as_f64()
            .ok_or_else(|| "no seconds".into())
    };
    let mut ratios = Vec::new();
    for pair in 0..PAIRS {
        // By turns which comes first.
        let (with, without) = if pair % 2 == 0 {
            let with = render(&["--aov", LAYERS])?;
            (with, render(&[])?)
        } else {
            let without = render(&[])?;
            (render(&["--aov", LAYERS])?, without)
        };
        ratios.push(with / without);
    }
    let middle = median(&mut ratios);
    let (low, high) = (ratios[PAIRS / 4], ratios[PAIRS - 1 - PAIRS / 4]);
    let percent = |ratio: f64| 100.0 * (ratio - 1.0);
    println!(
        "{}, {spp} samples: {LAYERS} take {:+.1} % ({:+.1} to {:+.1} %)",
        scene.file_name().unwrap_or_default().display(),
        percent(middle),
        percent(low),
        percent(high)
    );
    Ok(())
}

/// The middle one; sorts them.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
