//! Statistics of `whit render`, run as a process, beside the channels of samples and costs that they agree with.

use std::fs;
use std::path::Path;

use crate::support::cli_program::{fails_with, first_light, whit};
use whit::image::rows::ExrScanlineReader;

#[test]
fn stats_dash_prints_a_table_after_the_image_line() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.png");
    let flags = ["--size", "32x16", "--spp", "1", "--stats", "-"];
    let run = whit(&[&["render", &first_light(), "-o", path(&out)], &flags[..]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    let lines: Vec<&str> = run.stdout.lines().collect();
    assert!(lines[0].contains("a.png: 32x16"), "{}", run.stdout);
    let camera = lines.iter().find(|line| line.starts_with("camera ")).unwrap();
    assert_eq!(camera.split_whitespace().nth(1), Some("512"), "{camera}");
    assert!(run.stdout.contains("readings of the clock"), "{}", run.stdout);
    assert!(!Path::new("-").exists());
}

#[test]
fn pixel_costs_are_written_as_channels_and_heat_map() {
    let folder = tempfile::tempdir().unwrap();
    let [out, heat] = ["a.exr", "heat.png"].map(|name| folder.path().join(name));
    let flags = [
        "--size",
        "32x16",
        "--spp",
        "1",
        "--aov",
        "rays,time",
        "--heat",
        path(&heat),
    ];
    let run = whit(&[&["render", &first_light(), "-o", path(&out)], &flags[..]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stdout.contains("ns per pixel"), "{}", run.stdout);
    let meta = exr::meta::MetaData::read_from_file(&out, true).unwrap();
    let channels = &meta.headers[0].channels.list;
    let names: Vec<String> = channels.iter().map(|channel| channel.name.to_string()).collect();
    for name in [
        "rays",
        "rays.camera",
        "rays.shadow",
        "time",
        "time.camera",
        "time.surface",
    ] {
        assert!(names.iter().any(|n| n == name), "{name} in {names:?}");
    }
    assert!(names.iter().all(|name| name != "rays.film"), "{names:?}");
    let map = image::open(&heat).unwrap();
    assert_eq!((map.width(), map.height()), (32, 16 + 1 + 8));
    let args = ["render", &first_light(), "-o", path(&out), "--heat", "heat.exr"];
    fails_with(2, "change the file name heat.exr to end in .png", &args);
}

#[test]
fn statistics_have_all_documented_keys() {
    let folder = tempfile::tempdir().unwrap();
    let (out, stats) = (folder.path().join("a.png"), folder.path().join("a.json"));
    let flags = [
        "--size",
        "32x16",
        "--spp",
        "2",
        "--threads",
        "2",
        "--stats",
        path(&stats),
    ];
    let run = whit(&[&["render", &first_light(), "-o", path(&out)], &flags[..]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    let stats: serde_json::Value = serde_json::from_slice(&fs::read(&stats).unwrap()).unwrap();
    for key in [
        "triangles",
        "shapes",
        "instances",
        "lights",
        "textures",
        "volumes",
        "volume_bytes",
    ] {
        assert!(stats["scene"][key].is_u64(), "scene.{key} in {stats}");
    }
    for key in ["load", "build", "render", "write", "total", "trace"] {
        assert!(stats["seconds"][key].is_f64(), "seconds.{key} in {stats}");
    }
    for effect in ["shadow", "reflection", "refraction"] {
        assert!(stats["rays"][effect].is_u64(), "rays.{effect} in {stats}");
        assert_eq!(stats["effects"][effect]["rays"], stats["rays"][effect]);
        assert!(
            stats["effects"][effect]["seconds"].is_f64(),
            "effects.{effect} in {stats}"
        );
        assert!(
            stats["effects"][effect]["reason"].is_string(),
            "effects.{effect} in {stats}"
        );
    }
    let ledger = &stats["ledger"];
    let rays: u64 = ledger["accounts"]
        .as_object()
        .unwrap()
        .values()
        .map(|account| account["rays"].as_u64().unwrap())
        .sum();
    let sorts = ["camera", "shadow", "reflection", "refraction"];
    let sum: u64 = sorts
        .iter()
        .map(|sort| stats["rays"][sort].as_u64().unwrap())
        .sum();
    assert_eq!(rays, sum + ledger["accounts"]["other"]["rays"].as_u64().unwrap());
    assert!(ledger["clock_reads"].as_u64().unwrap() > 0, "{ledger}");
    for key in ["thread_seconds", "clock_read_seconds", "seconds_of_measuring"] {
        assert!(ledger[key].as_f64().unwrap() > 0.0, "ledger.{key} in {stats}");
    }
    assert_eq!(stats["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(
        (&stats["image"]["width"], &stats["image"]["height"]),
        (&32.into(), &16.into())
    );
    assert_eq!((&stats["spp"], &stats["threads"]), (&2.into(), &2.into()));
    assert_eq!(stats["rays"]["camera"], 32 * 16 * 2);
    let cutoff = &stats["cutoff"];
    for part in [cutoff, &cutoff["depth_limit"], &cutoff["weight_cutoff"]] {
        assert!(part["rays"].is_u64(), "{cutoff}");
        assert!(
            part["mean_weight"].as_f64() <= part["max_weight"].as_f64(),
            "{cutoff}"
        );
    }
    assert_eq!(stats["samples"]["total"], 32 * 16 * 2);
    assert_eq!(
        (&stats["samples"]["mean"], &stats["samples"]["max"]),
        (&2.0.into(), &2.into())
    );
    assert!(stats["precision"].is_string());
    match stats["backend"].as_str() {
        Some("embree") => {
            assert!(
                stats["embree"]["version"].is_string() && stats["embree"]["isa"].is_string(),
                "{stats}"
            );
        }
        Some("bsp") => assert!(stats["embree"].is_null(), "{stats}"),
        other => panic!("backend {other:?}"),
    }
    if cfg!(target_os = "linux") {
        assert!(stats["peak_memory_bytes"].as_u64().unwrap() > 1 << 20, "{stats}");
    }
}

#[test]
fn only_pixels_with_contrast_take_all_samples() {
    let folder = tempfile::tempdir().unwrap();
    let (out, stats) = (folder.path().join("a.exr"), folder.path().join("a.json"));
    let flags = [
        "--size=64x48",
        "--edge-contrast=0.03",
        "--aov=samples",
        "--stats",
        path(&stats),
    ];
    let run = whit(&[&["render", &first_light(), "-o", path(&out)], &flags[..]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    // Count the pixels at edges in the file
    let file = exr::prelude::read_first_flat_layer_from_file(&out).unwrap();
    let channels = &file.layer_data.channel_data.list;
    let counts: Vec<f32> = channels[3].sample_data.values_as_f32().collect();
    let edge_count = counts.iter().filter(|&&count| count == 16.0).count() as u64;
    assert!(counts.iter().all(|&count| count == 1.0 || count == 16.0));
    assert!((500..2500).contains(&edge_count), "{edge_count}");
    // Compare with the statistics and the record in the file
    let stats: serde_json::Value = serde_json::from_slice(&fs::read(&stats).unwrap()).unwrap();
    assert_eq!(stats["samples"]["total"], 64 * 48 + 15 * edge_count);
    assert_eq!(stats["rays"]["camera"], 64 * 48 + 16 * edge_count);
    let settings = ExrScanlineReader::open(&out)
        .unwrap()
        .note("whit.settings")
        .unwrap();
    assert!(settings.contains("\"edge_contrast\":0.03"), "{settings}");
}

#[test]
fn adaptive_sample_counts_are_in_statistics_and_channels() {
    let folder = tempfile::tempdir().unwrap();
    let (out, stats) = (folder.path().join("a.exr"), folder.path().join("a.json"));
    let flags = [
        "--size=64x48",
        "--spp=64",
        "--adaptive=0.01",
        "--pattern=sobol",
        "--aov=samples",
        "--stats",
        path(&stats),
    ];
    let run = whit(&[&["render", &first_light(), "-o", path(&out)], &flags[..]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    let stats: serde_json::Value = serde_json::from_slice(&fs::read(&stats).unwrap()).unwrap();
    let file = exr::prelude::read_first_flat_layer_from_file(&out).unwrap();
    let channels = &file.layer_data.channel_data.list;
    let names: Vec<String> = channels.iter().map(|c| c.name.to_string()).collect();
    assert_eq!(names, ["B", "G", "R", "samples", "variance"]);
    let counts: Vec<f32> = channels[3].sample_data.values_as_f32().collect();
    let total: f32 = counts.iter().sum();
    assert_eq!(stats["samples"]["total"].as_f64().unwrap(), f64::from(total));
    // Probe rays estimate the footprint at one pixel in 8 x 8, sixteen rays at a time.
    let probe_rays = stats["rays"]["camera"].as_f64().unwrap() - f64::from(total);
    let round = f64::from(16 * 64 / 8 * 48 / 8);
    assert!(
        probe_rays >= 0.0 && probe_rays <= 4.0 * round && probe_rays % round == 0.0,
        "{probe_rays}"
    );
    assert_eq!(
        (&stats["samples"]["max"], &stats["spp"]),
        (&64.into(), &64.into())
    );
    assert!(counts.contains(&16.0) && counts.contains(&64.0));
    assert_eq!(whit::image::read_exr(&out).unwrap().pixels.len(), 64 * 48);
}

fn path(path: &Path) -> &str {
    path.to_str().unwrap()
}
