//! Batches that are killed, interrupted, or out of memory or disk space: after resuming, the images equal those of an
//! undisturbed run to the byte.

use std::collections::HashMap;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};

const WHIT: &str = env!("CARGO_BIN_EXE_whit");

/// Number of times that a batch is ended.
const ENDS: usize = 50;

/// Limit of the address space in kilobytes: enough for small images, but not for a large one.
const LITTLE_MEMORY: u32 = 200_000;

pub(super) fn whit(arguments: &[&str]) -> Command {
    let mut command = Command::new(WHIT);
    command.args(arguments).stdin(Stdio::null());
    command
}

pub(super) fn run(arguments: &[&str]) -> Output {
    whit(arguments).output().unwrap()
}

pub(super) fn assert_done(output: &Output) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
}

/// Temporary folder with a scene.
pub(super) struct Place(tempfile::TempDir);

impl Place {
    pub(super) fn new() -> Place {
        let place = Place(tempfile::tempdir().unwrap());
        // Use few wavelengths, as dispersion takes most of the time.
        let scene = "ambient = 0.1\nbackground = 0.5\n[output]\nwavelengths = 2\n[camera]\nfrom = [0, 1, 4]\nat = [0, 0, 0]\n\
                     [[light]]\nkind = \"point\"\nposition = [3, 5, 4]\nintensity = 80\n\
                     [material.glass]\nmodel = \"lecture\"\nglass = \"bk7\"\ndiffuse = 0.1\n\
                     [[object]]\nshape = \"plane\"\ntransform = [{ z-to = [0, 1, 0] }, { translate = [0, -1, 0] }]\n\
                     [[object]]\nname = \"ball\"\nshape = { sphere = { radius = 1 } }\nmaterial = \"glass\"\n";
        fs::write(place.path("scene.toml"), scene).unwrap();
        place
    }

    /// Returns a folder whose scene has no glass, for frames that take memory and not time.
    pub(super) fn without_glass() -> Place {
        let place = Place::new();
        let scene = fs::read_to_string(place.path("scene.toml")).unwrap();
        fs::write(place.path("scene.toml"), scene.replace("glass = \"bk7\"\n", "")).unwrap();
        place
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a job file and returns its path.
    pub(super) fn jobs(&self, text: &str) -> String {
        let path = self.path("test.jobs.toml");
        fs::write(&path, text).unwrap();
        path.display().to_string()
    }

    pub(super) fn out(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }
}

/// Returns all images of a folder, by name.
pub(super) fn images(folder: &str) -> HashMap<String, Vec<u8>> {
    let Ok(entries) = fs::read_dir(folder) else {
        return HashMap::new();
    };
    let is_image = |path: &PathBuf| {
        path.extension()
            .is_some_and(|kind| kind == "png" || kind == "exr")
    };
    entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| is_image(path) && !name(path).starts_with('.'))
        .map(|path| (name(&path), fs::read(&path).unwrap()))
        .collect()
}

pub(super) fn name(path: &Path) -> String {
    path.file_name().unwrap().to_string_lossy().into_owned()
}

/// Returns the images that the manifests of a folder list, in the order of their lines.
fn noted(folder: &str) -> Vec<String> {
    let Ok(entries) = fs::read_dir(folder) else {
        return Vec::new();
    };
    let paths = entries.map(|entry| entry.unwrap().path());
    let texts = paths
        .filter(|path| path.extension().is_some_and(|kind| kind == "jsonl"))
        .map(|path| fs::read_to_string(path).unwrap());
    texts
        .flat_map(|text| text.lines().map(str::to_owned).collect::<Vec<_>>())
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(&line).ok())
        .map(|line| line["image"].as_str().unwrap().to_owned())
        .collect()
}

/// 64-bit linear congruential generator (Knuth's multiplier) of numbers in [0, 1).
struct SplitMix64(u64);

impl SplitMix64 {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn signal(child: &Child, signal: &str) {
    let done = Command::new("kill")
        .args([signal, &child.id().to_string()])
        .status()
        .unwrap();
    assert!(done.success());
}

const FORTY: &str = "[[job]]\nscene = \"scene.toml\"\nframes = 40\nturntable = {}\n\
                     settings = { size = \"48x36\", spp = 8, backend = \"bsp\" }\nimage = \"{frame:02}.png\"\n";

#[test]
fn batch_killed_fifty_times_equals_an_undisturbed_one() {
    interrupt_fifty_times("-KILL", None);
}

#[test]
fn batch_terminated_fifty_times_equals_an_undisturbed_one() {
    interrupt_fifty_times("-TERM", Some(130));
}

/// Ends a batch at random times with the signal `how`, and checks that its exit code is `exit_code`.
fn interrupt_fifty_times(how: &str, exit_code: Option<i32>) {
    let place = Place::new();
    let jobs = place.jobs(FORTY);
    let reference = place.out("reference");
    assert_done(&run(&["batch", &jobs, "--out", &reference, "--quiet"]));
    let expected = images(&reference);
    assert_eq!(expected.len(), 40);
    let seed = u64::from(std::process::id());
    println!("seed {seed}");
    let mut random = SplitMix64(seed);
    let out = place.out("ended");
    let batch = ["batch", &jobs, "--out", &out, "--resume", "--quiet"];
    // Record the inode of each finished image, which must not be rendered again.
    let mut files: HashMap<String, u64> = HashMap::new();
    let mut ends = 0;
    while ends < ENDS {
        let mut child = whit(&batch).stderr(Stdio::null()).spawn().unwrap();
        // Meanwhile every visible image must be complete.
        let end = Instant::now() + Duration::from_secs_f64(0.15 * random.next());
        while Instant::now() < end {
            assert_whole(&images(&out), &expected);
            thread::sleep(Duration::from_millis(1));
        }
        let has_ended = child.try_wait().unwrap().is_some();
        if !has_ended {
            signal(&child, how);
            let code = child.wait().unwrap().code();
            // The batch may have finished at that moment, or not have installed its signal handler.
            assert!([exit_code, Some(0), None].contains(&code), "{code:?}");
            ends += 1;
        }
        assert_whole(&images(&out), &expected);
        let noted = noted(&out);
        for name in &noted {
            let file = fs::metadata(place.path("ended").join(name)).unwrap().ino();
            assert_eq!(
                *files.entry(name.clone()).or_insert(file),
                file,
                "{name} was made again"
            );
        }
        if noted.len() == 40 && ends < ENDS {
            // The batch finished before it was ended fifty times: start again.
            fs::remove_dir_all(&out).unwrap();
            files.clear();
        }
    }
    assert_done(&run(&batch));
    assert_eq!(images(&out), expected);
    let mut noted = noted(&out);
    noted.sort();
    noted.dedup();
    assert_eq!(noted.len(), 40);
    let left: Vec<String> = fs::read_dir(&out)
        .unwrap()
        .map(|entry| name(&entry.unwrap().path()))
        .collect();
    assert!(!left.iter().any(|name| name.ends_with(".tmp")), "{left:?}");
}

fn assert_whole(found: &HashMap<String, Vec<u8>>, expected: &HashMap<String, Vec<u8>>) {
    for (name, bytes) in found {
        assert!(bytes == &expected[name], "{name} is not whole");
    }
}

/// Returns the exit code of a child; kills the child and panics after `seconds`.
fn wait_within(child: &mut Child, seconds: u64) -> Option<i32> {
    let end = Instant::now() + Duration::from_secs(seconds);
    while Instant::now() < end {
        if let Some(status) = child.try_wait().unwrap() {
            return status.code();
        }
        thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    panic!("it has not ended within {seconds} s");
}

#[test]
fn concurrently_compressed_frames_do_not_deadlock() {
    // Threads that wait for the compression of one file take up the next frame, which is written too.
    let place = Place::new();
    let jobs = place.jobs(
        "[[job]]\nscene = \"scene.toml\"\nframes = 100\nturntable = {}\n\
         settings = { size = \"16x512\", spp = 1, backend = \"bsp\", compression = \"zip\" }\nimage = \"{frame:03}.exr\"\n",
    );
    let out = place.out("out");
    let mut child = whit(&["batch", &jobs, "--out", &out, "--threads", "8", "--quiet"])
        .spawn()
        .unwrap();
    assert_eq!(wait_within(&mut child, 300), Some(0));
    assert_eq!(images(&out).len(), 100);
}

#[test]
fn batch_that_ran_out_of_memory_resumes_with_more() {
    let place = Place::without_glass();
    let job = |frames: u32, size: &str, image: &str| {
        format!(
            "[[job]]\nscene = \"scene.toml\"\nframes = {frames}\nturntable = {{}}\nimage = \"{image}\"\n\
             settings = {{ size = \"{size}\", spp = 1, backend = \"bsp\", aov = \"position,normal,albedo,uv\" }}\n"
        )
    };
    let small_jobs = place.jobs(&job(40, "16x16", "{frame}.exr"));
    let [reference, out] = ["reference", "out"].map(|name| place.out(name));
    let batch = |jobs| ["batch", jobs, "--out", &out, "--resume", "--quiet"];
    // Use a single malloc arena: one per thread would take far more address space than memory.
    let with_little_memory = |jobs| {
        let command = format!("ulimit -v {LITTLE_MEMORY}; exec \"$@\"");
        Command::new("bash")
            .args(["-c", &command, "bash", WHIT])
            .args(batch(jobs))
            .args(["--threads", "1"])
            .env("MALLOC_ARENA_MAX", "1")
            .stdin(Stdio::null())
            .output()
            .unwrap()
    };
    // Render the small frames first, as jobs of one batch overlap
    assert_done(&with_little_memory(small_jobs.as_str()));
    let jobs = place.jobs(&(job(40, "16x16", "{frame}.exr") + &job(1, "1280x1280", "large.exr")));
    assert_done(&run(&["batch", &jobs, "--out", &reference, "--quiet"]));
    let expected = images(&reference);
    let first = with_little_memory(jobs.as_str());
    let said = String::from_utf8_lossy(&first.stderr);
    assert!(!first.status.success(), "{said}");
    let found = images(&out);
    assert_eq!(found.len(), 40, "{:?}: {said}", found.keys());
    assert_whole(&found, &expected);
    assert_done(&run(&batch(&jobs)));
    assert!(images(&out) == expected);
}

/// Job of one long frame in many steps.
const LONG: &str = "[[job]]\nscene = \"scene.toml\"\nsettings = { size = \"64x512\", spp = 16, backend = \"bsp\", \
                    aov = \"samples\" }\nimage = \"long.exr\"\n";

/// Job of one long frame with adaptive sampling.
const LONG_ADAPTIVE: &str = "[[job]]\nscene = \"scene.toml\"\nsettings = { size = \"64x128\", spp = 64, backend = \"bsp\", \
                             pattern = \"sobol\", adaptive = 0.002, aov = \"samples\" }\nimage = \"long.exr\"\n";

#[test]
fn interrupted_long_frame_resumes_from_its_checkpoint() {
    // Rows are saved in many files; rounds in a single one, which is replaced.
    interrupt_and_resume(LONG, 3, &["-INT", "-KILL"]);
    interrupt_and_resume(LONG_ADAPTIVE, 1, &["-TERM", "-KILL"]);
}

fn interrupt_and_resume(job: &str, files: usize, signals: &[&str]) {
    let place = Place::new();
    let jobs = place.jobs(job);
    let reference = place.out("reference");
    assert_done(&run(&["batch", &jobs, "--out", &reference, "--quiet"]));
    let expected = images(&reference);
    for (number, &how) in signals.iter().enumerate() {
        let out = place.out(&format!("ended{number}"));
        let batch = [
            "batch",
            &jobs,
            "--out",
            &out,
            "--resume",
            "--checkpoint",
            "0",
            "--quiet",
        ];
        let mut child = whit(&batch).stderr(Stdio::null()).spawn().unwrap();
        let pieces = place.path(&format!("ended{number}")).join(".whit-pieces");
        let start = Instant::now();
        let is_piece = |path: std::io::Result<fs::DirEntry>| name(&path.unwrap().path()).ends_with(".exr");
        let has_pieces = || {
            fs::read_dir(&pieces).is_ok_and(|mut entries| {
                entries.next().is_some_and(|frame| {
                    fs::read_dir(frame.unwrap().path())
                        .is_ok_and(|found| found.map(is_piece).filter(|&is| is).count() >= files)
                })
            })
        };
        while !has_pieces() && child.try_wait().unwrap().is_none() {
            assert!(start.elapsed() < Duration::from_secs(120), "no pieces are kept");
            thread::sleep(Duration::from_millis(2));
        }
        assert!(child.try_wait().unwrap().is_none(), "it has ended by itself");
        signal(&child, how);
        let code = child.wait().unwrap().code();
        assert_eq!(code, if how == "-KILL" { None } else { Some(130) });
        assert!(images(&out).is_empty());
        assert!(has_pieces());
        assert_done(&run(&batch));
        assert_eq!(images(&out), expected, "after {how}");
        assert!(!pieces.exists());
    }
}

#[test]
fn second_process_in_the_same_folder_is_rejected() {
    let place = Place::new();
    let jobs = place.jobs(FORTY);
    let out = place.out("out");
    let mut first = whit(&["batch", &jobs, "--out", &out, "--quiet"]).spawn().unwrap();
    let start = Instant::now();
    while noted(&out).is_empty() {
        assert!(start.elapsed() < Duration::from_secs(120), "nothing is rendered");
        thread::sleep(Duration::from_millis(2));
    }
    let second = run(&["batch", &jobs, "--out", &out, "--resume"]);
    let said = String::from_utf8_lossy(&second.stderr);
    assert_eq!(second.status.code(), Some(1), "{said}");
    assert!(
        said.contains("another whit (process") && said.contains("is rendering into"),
        "{said}"
    );
    assert!(first.wait().unwrap().success());
    assert_eq!(images(&out).len(), 40);
}

#[test]
fn failure_of_one_frame_does_not_stop_the_rest() {
    let place = Place::new();
    let text = "[[job]]\nscene = \"scene.toml\"\nsweep = { \"camera.fov\" = [40, 400, 50] }\n\
                settings = { size = \"16x16\", backend = \"bsp\" }\nimage = \"{fov}.png\"\n";
    let jobs = place.jobs(text);
    let out = place.out("out");
    let output = run(&["batch", &jobs, "--out", &out]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("camera.fov = 400") && said.contains("1 of 3 frames failed"),
        "{said}"
    );
    let mut names: Vec<String> = images(&out).into_keys().collect();
    names.sort();
    assert_eq!(names, ["40.png", "50.png"]);
}

#[test]
fn frame_is_rendered_again_if_scene_or_settings_change() {
    let place = Place::new();
    let job = |spp: u32| {
        format!(
            "[[job]]\nscene = \"scene.toml\"\nsettings = {{ size = \"16x16\", spp = {spp}, backend = \"bsp\" }}\nimage = \"a.png\"\n"
        )
    };
    let jobs = place.jobs(&job(1));
    let out = place.out("out");
    let resumed = || {
        let output = run(&["batch", &jobs, "--out", &out, "--resume"]);
        assert_done(&output);
        String::from_utf8_lossy(&output.stdout).contains("1 existed already")
    };
    assert!(!resumed());
    assert!(resumed());
    place.jobs(&job(4));
    assert!(!resumed());
    assert!(resumed());
    let scene = place.path("scene.toml");
    let text = fs::read_to_string(&scene).unwrap();
    fs::write(&scene, text.replace("ambient = 0.1", "ambient = 0.2")).unwrap();
    assert!(!resumed());
    // A damaged image is rendered again, too.
    fs::write(place.path("out/a.png"), b"short").unwrap();
    assert!(!resumed());
    let again = run(&["batch", &jobs, "--out", &out]);
    assert_eq!(again.status.code(), Some(2));
}

#[test]
fn invalid_batches_are_rejected_in_one_sentence_before_rendering() {
    let place = Place::new();
    fs::write(place.path("file"), b"").unwrap();
    let job = |more: &str| format!("[[job]]\nscene = \"scene.toml\"\n{more}\n");
    for (text, out, words) in [
        ("[[job".to_owned(), "out", "is not TOML"),
        (job("scene = 1"), "out", "given twice"),
        (job("image = \"a.gif\""), "out", "end `image` in .png or .exr"),
        (
            job("frames = 3\nimage = \"a.png\""),
            "out",
            "would both be written to a.png",
        ),
        (job("settings = { spp = 0 }"), "out", "settings of job 1"),
        (job("settings = { colour = 1 }"), "out", "settings of job 1"),
        (
            job("settings = { threads = 1 }"),
            "out",
            "`threads` is not a setting of a job",
        ),
        (
            job("image = \"a.exr\"\nsplit = { shares = 2 }\nsettings = { spp = 32, aov = \"depth\" }"),
            "out",
            "support only `aov = \"samples\"`",
        ),
        (
            job("split = { bands = 2 }\nsettings = { spp = 32, adaptive = 0.01 }"),
            "out",
            "require rendering the whole frame at once",
        ),
        (job(""), "file", "cannot create the folder"),
        (job(""), "file/in", "cannot create the folder"),
    ] {
        let jobs = place.jobs(&text);
        let output = run(&["batch", &jobs, "--out", &place.out(out)]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{text}: {said}");
        assert!(said.contains(words), "{text}: {said}");
        assert_eq!(said.trim_end().lines().count(), 1, "{said}");
        assert!(images(&place.out("out")).is_empty());
    }
    let output = run(&["batch", &place.out("none.toml"), "--out", &place.out("out")]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn time_limit_gives_an_image_of_fewer_samples() {
    let place = Place::new();
    let jobs = place.jobs(
        "[[job]]\nscene = \"scene.toml\"\nsettings = { size = \"96x96\", spp = 65536, pattern = \"sobol\", backend = \"bsp\", \
         aov = \"samples\" }\nimage = \"a.exr\"\n",
    );
    let out = place.out("out");
    let start = Instant::now();
    let output = run(&["batch", &jobs, "--out", &out, "--time", "0.5"]);
    assert_done(&output);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        said.contains("the time limit was reached after ") && said.contains(" of 65536 samples per pixel"),
        "{said}"
    );
    assert_eq!(images(&out).len(), 1);
    println!("{:?}", start.elapsed());
    let coarse = place.jobs("[[job]]\nscene = \"scene.toml\"\nsettings = { spp = 64, pattern = \"regular\" }\nimage = \"b.png\"\n");
    let output = run(&["batch", &coarse, "--out", &out, "--time", "1", "--resume"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("choose `pattern = \"sobol\"`"), "{said}");
}

#[test]
fn frame_beyond_the_memory_limit_is_not_started() {
    let place = Place::new();
    let jobs = place.jobs(
        "[[job]]\nscene = \"scene.toml\"\nimage = \"{frame}.png\"\nframes = 2\nturntable = {}\n\
         settings = { size = \"2048x2048\", spp = 1, backend = \"bsp\" }\n",
    );
    let out = place.out("out");
    let output = run(&["batch", &jobs, "--out", &out, "--max-memory", "8M"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("of memory and may take 8.4 MB: give a larger `--max-memory` or a smaller `size`"),
        "{said}"
    );
    assert!(images(&out).is_empty());
}

#[test]
fn full_disk_keeps_finished_frames_and_allows_resuming() {
    let place = Place::new();
    let jobs = place.jobs(FORTY);
    let reference = place.out("reference");
    assert_done(&run(&["batch", &jobs, "--out", &reference, "--quiet"]));
    let small = place.path("small");
    fs::create_dir(&small).unwrap();
    let mount = |size: &str| {
        let options = format!("{size},mode=777");
        let arguments = ["-t", "tmpfs", "-o", &options, "none", small.to_str().unwrap()];
        Command::new("mount")
            .args(arguments)
            .stderr(Stdio::null())
            .status()
            .is_ok_and(|status| status.success())
    };
    if !mount("size=80k") {
        println!("skipped: no small file system can be mounted here");
        return;
    }
    let out = small.join("out").display().to_string();
    let first = run(&["batch", &jobs, "--out", &out, "--resume"]);
    let said = String::from_utf8_lossy(&first.stderr);
    let found = images(&out);
    let expected = images(&reference);
    let are_right = found.iter().all(|(name, bytes)| *bytes == expected[name]);
    let has_room = mount("remount,size=16m");
    let second = run(&["batch", &jobs, "--out", &out, "--resume", "--quiet"]);
    let all = images(&out);
    assert!(Command::new("umount").arg(&small).status().unwrap().success());
    assert_eq!(first.status.code(), Some(1), "{said}");
    assert!(
        said.contains("free some space and continue with `--resume`"),
        "{said}"
    );
    assert!(
        are_right && !found.is_empty() && found.len() < 40,
        "{} images",
        found.len()
    );
    assert!(has_room);
    assert_done(&second);
    assert_eq!(all, expected);
}
