//! One frame in many shards: same bytes as by one process, and each process holds only its own part in memory.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

const WHIT: &str = env!("CARGO_BIN_EXE_whit");
const SHARDS: usize = 16;

#[test]
fn large_frame_in_shards_equals_one_process_in_bounded_memory() {
    by_shards(1024);
}

/// Slow (`tests/ci/slow huge_frame`): takes some minutes and 10 GB of disk space.
#[test]
#[ignore = "slow: 10 GB of disk space"]
fn huge_frame_in_shards_equals_one_process_in_bounded_memory() {
    by_shards(16384);
}

fn by_shards(side: u32) {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/first_light.gltf");
    let jobs = path("huge.jobs.toml");
    let text = format!(
        "[[job]]\nscene = '{}'\nsplit = {{ bands = {SHARDS} }}\nimage = \"huge.exr\"\n\
         settings = {{ size = \"{side}x{side}\", spp = 1, backend = \"bsp\" }}\n",
        scene.display()
    );
    fs::write(&jobs, text).unwrap();
    let [one, many] = ["one", "many"].map(path);
    let whole = peak(&["batch", &jobs, "--out", &one, "--quiet"]);
    let peaks: Vec<u64> = (1..=SHARDS)
        .map(|shard| {
            let shard = format!("{shard}/{SHARDS}");
            peak(&["batch", &jobs, "--out", &many, "--shard", &shard, "--quiet"])
        })
        .collect();
    // The last shard also merges the frame.
    let [of_shard, of_last] = [peaks[0], peaks[SHARDS - 1]];
    println!(
        "{side}x{side}: {} MB by one process, {} MB by a shard, {} MB by the one that merges it",
        whole >> 20,
        of_shard >> 20,
        of_last >> 20
    );
    assert!(peaks.iter().all(|&peak| peak < 2 * of_shard), "{peaks:?}");
    let [one, many] = [&one, &many].map(|out| Path::new(out).join("huge.exr"));
    assert_same(&one, &many);
    assert!(!many.with_file_name(".whit-pieces").exists());
}

/// Runs whit to its end and returns its peak memory in bytes.
fn peak(arguments: &[&str]) -> u64 {
    let mut child = Command::new(WHIT)
        .args(arguments)
        .stdin(Stdio::null())
        .spawn()
        .unwrap();
    let mut peak = 0;
    let status = loop {
        // Poll the peak so far; the last value is close to the peak of the whole run.
        peak = peak.max(peak_so_far(&child).unwrap_or(0));
        match child.try_wait().unwrap() {
            Some(status) => break status,
            None => thread::sleep(Duration::from_millis(2)),
        }
    };
    assert!(status.success(), "{arguments:?}");
    peak
}

fn peak_so_far(child: &Child) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024 * kilobytes)
}

/// Compares two files of several gigabytes with `cmp`.
fn assert_same(one: &Path, other: &Path) {
    let status = Command::new("cmp").args([one, other]).status().unwrap();
    assert!(status.success());
}
