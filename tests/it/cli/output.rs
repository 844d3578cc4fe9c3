//! Encoding flags of `whit render`, and the metadata of image files.

use std::fs;
use std::path::Path;

use crate::support::cli_program::{self, first_light, names_in, whit};
use whit::image::rows::{ExrScanlineReader, SampleType};

/// Renders a small image to `out` with additional `flags`.
fn render(out: &Path, flags: &[&str]) -> cli_program::Run {
    let scene = first_light();
    let out = out.to_str().unwrap();
    let fixed = [
        "render",
        &scene,
        "-o",
        out,
        "--size",
        "40x30",
        "--spp",
        "2",
        "--backend",
        "bsp",
    ];
    whit(&[&fixed[..], flags].concat())
}

fn types(path: &Path) -> Vec<(String, SampleType)> {
    let reader = ExrScanlineReader::open(path).unwrap();
    let channels = reader.channels().iter();
    channels
        .map(|channel| (channel.name.clone(), channel.sample))
        .collect()
}

#[test]
fn half_type_rounds_colours_but_not_counts() {
    let folder = tempfile::tempdir().unwrap();
    let [float, half] = ["float.exr", "half.exr"].map(|name| folder.path().join(name));
    assert_eq!(render(&float, &["--aov", "samples"]).code, 0);
    let run = render(
        &half,
        &["--aov", "samples", "--exr-type", "half", "--compression", "zip"],
    );
    assert_eq!(run.code, 0, "{}", run.stderr);
    let channel = |name: &str, sample| (name.to_owned(), sample);
    let expected = |color| {
        [
            channel("B", color),
            channel("G", color),
            channel("R", color),
            channel("samples", SampleType::Float),
            channel("variance", SampleType::Float),
        ]
    };
    assert_eq!(types(&float), expected(SampleType::Float));
    assert_eq!(types(&half), expected(SampleType::Half));
    let [exact, rounded] = [&float, &half].map(|path| whit::image::read_exr(path).unwrap());
    for (exact, rounded) in exact
        .pixels
        .as_flattened()
        .iter()
        .zip(rounded.pixels.as_flattened())
    {
        // Half a unit in the last of 11 significant bits; the image has no subnormal values.
        assert!(
            (exact - rounded).abs() <= exact.abs() / 2048.0,
            "{exact} {rounded}"
        );
    }
}

#[test]
fn compression_changes_file_size_but_no_pixel() {
    let folder = tempfile::tempdir().unwrap();
    let sizes = ["none", "rle", "zips", "zip", "piz"].map(|compression| {
        let path = folder.path().join(format!("{compression}.exr"));
        let run = render(&path, &["--compression", compression]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        let plain = whit::image::read_exr(&folder.path().join("none.exr")).unwrap();
        assert_eq!(whit::image::read_exr(&path).unwrap(), plain, "{compression}");
        fs::metadata(path).unwrap().len()
    });
    assert!(sizes[3] < sizes[0], "{sizes:?}");
}

#[test]
fn sixteen_bit_png_is_finer_than_eight_bit() {
    let folder = tempfile::tempdir().unwrap();
    let [wide, narrow] = ["wide.png", "narrow.png"].map(|name| folder.path().join(name));
    assert_eq!(render(&narrow, &[]).code, 0);
    let run = render(&wide, &["--png-bits", "16"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let [wide, narrow] = [wide, narrow].map(|path| image::open(path).unwrap());
    assert_eq!(wide.color(), image::ColorType::Rgb16);
    let (wide, narrow) = (wide.into_rgb16(), narrow.into_rgb8());
    assert!(wide.iter().any(|code| code % 257 != 0));
    for (wide, narrow) in wide.iter().zip(narrow.iter()) {
        // Half a code of each.
        assert!((f64::from(*wide) / 257.0 - f64::from(*narrow)).abs() <= 0.5 + 0.5 / 257.0);
    }
}

#[test]
fn encoding_flags_for_another_format_are_rejected_before_rendering() {
    let folder = tempfile::tempdir().unwrap();
    let refused = [
        ("a.png", ["--exr-type", "half"], "write an .exr"),
        ("a.png", ["--compression", "zip"], "write an .exr"),
        ("a.exr", ["--png-bits", "16"], "write a .png"),
    ];
    for (name, flags, remedy) in refused {
        let run = render(&folder.path().join(name), &flags);
        assert_eq!(run.code, 2, "{}", run.stderr);
        assert!(
            run.stderr.contains(flags[0]) && run.stderr.contains(remedy),
            "{}",
            run.stderr
        );
        assert_eq!(run.stderr.trim_end().lines().count(), 1, "{}", run.stderr);
    }
    assert_eq!(names_in(folder.path()), Vec::<String>::new());
}

#[test]
fn files_record_their_settings_and_are_reproducible() {
    let folder = tempfile::tempdir().unwrap();
    let [png, exr, again] = ["a.png", "a.exr", "b.exr"].map(|name| folder.path().join(name));
    for (path, threads) in [(&png, "1"), (&exr, "1"), (&again, "2")] {
        let run = render(path, &["--seed", "7", "--threads", threads]);
        assert_eq!(run.code, 0, "{}", run.stderr);
    }
    assert_eq!(fs::read(&exr).unwrap(), fs::read(&again).unwrap());
    let reader = ExrScanlineReader::open(&exr).unwrap();
    let plan = reader.note("whit.plan").unwrap();
    assert!(plan.contains("shadow"), "{plan}");
    let settings = reader.note("whit.settings").unwrap();
    let made: serde_json::Value = serde_json::from_str(&settings).unwrap();
    assert_eq!(made["size"], serde_json::json!([40, 30]));
    assert_eq!(
        (&made["seed"], &made["spp"], &made["backend"]),
        (&7.into(), &2.into(), &"bsp".into())
    );
    assert_eq!(reader.note("whit.embree"), None);

    let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(&png).unwrap()));
    let reader = decoder.read_info().unwrap();
    let text = |name: &str| {
        let texts = &reader.info().uncompressed_latin1_text;
        texts
            .iter()
            .find(|text| text.keyword == name)
            .map(|text| text.text.clone())
    };
    assert_eq!(text("whit.settings").unwrap(), settings);
    assert_eq!(text("whit.plan").unwrap(), plan);
    assert!(text("Software").unwrap().starts_with("whit "));
}
