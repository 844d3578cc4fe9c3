//! Tests of EXR files with other readers: OpenEXR's own tools and OpenImageIO's, if they are installed (Debian's
//! packages `openexr` and `openimageio-tools`).

use std::path::Path;

use crate::support::cli_program::{first_light, whit};
use crate::support::exr_tools::tool;
use whit::image::Attribute;
use whit::image::rows::{
    Compression, ExrChannel, ExrLayout, ExrScanlineWriter, RowWindow, SampleType, Samples,
};

/// Compression methods with their names in OpenEXR's `exrinfo` and in OpenImageIO.
const PACKED: [(Compression, &str, &str); 5] = [
    (Compression::None, "none", "none"),
    (Compression::Rle, "rle", "rle"),
    (Compression::Zips, "zips", "zips"),
    (Compression::Zip, "zip", "zip"),
    (Compression::Piz, "piz", "piz"),
];

const WIDTH: u32 = 21;
const HEIGHT: u32 = 70;

/// Returns the value of a channel: numbers that halves represent, and a float that they do not.
fn value(channel: &str, column: u32, row: u32) -> f32 {
    match channel {
        "depth.Z" => 0.1 + (row * WIDTH + column) as f32,
        "R" => column as f32 / 8.0,
        _ => row as f32 / 4.0,
    }
}

/// Returns the value of the integer channel, of which the last is near the largest u32.
fn integer(column: u32, row: u32) -> u32 {
    (row * WIDTH + column) * 2_900_000
}

/// Writes a cropped image with each kind of channel.
fn write_part(path: &Path, compression: Compression) {
    // Lay out a cropped image
    let layout = ExrLayout {
        data_window: RowWindow {
            origin: [5, 40],
            size: [WIDTH, HEIGHT],
        },
        display_window: RowWindow::of_size([200, 150]),
        channels: vec![
            ExrChannel::new("R", SampleType::Half),
            ExrChannel::new("G", SampleType::Half),
            ExrChannel::new("depth.Z", SampleType::Float),
            ExrChannel::new("sum.upper", SampleType::Uint),
        ],
        compression,
        notes: &[Attribute {
            name: "whit.plan",
            text: "shadow on",
        }],
    };
    // Write it row by row
    let mut writer = ExrScanlineWriter::create(path, &layout).unwrap();
    for row in 0..HEIGHT {
        let plane = |name: &str| {
            (0..WIDTH)
                .map(|column| value(name, column, row))
                .collect::<Vec<f32>>()
        };
        let integers: Vec<u32> = (0..WIDTH).map(|column| integer(column, row)).collect();
        let planes = [plane("R"), plane("G"), plane("depth.Z")].map(Samples::from);
        let [r, g, z] = planes;
        writer.write_rows(&[r, g, z, integers.into()]).unwrap();
    }
    writer.finish().unwrap();
}

fn word(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn openexr_reads_channels_types_compression_and_data_window() {
    let folder = tempfile::tempdir().unwrap();
    for (compression, name, _) in PACKED {
        let path = folder.path().join(format!("{name}.exr"));
        write_part(&path, compression);
        let Some((is_well, output)) = tool("exrinfo", &["-v", "-s", word(&path)]) else {
            return;
        };
        assert!(is_well, "{output}");
        for expected in [
            "'G': half samp 1 1",
            "'R': half samp 1 1",
            "'depth.Z': float samp 1 1",
            "'sum.upper': uint samp 1 1",
            &format!("compression '{name}'"),
            "displayWindow: box2i [ 0, 0 - 199 149 ]",
            "dataWindow: box2i [ 5, 40 - 25 109 ]",
            "lineOrder 0 (increasing)",
            "whit.plan: string 'shadow on'",
        ] {
            assert!(output.contains(expected), "{expected} is not in {output}");
        }
        let Some((is_well, output)) = tool("exrheader", &[word(&path)]) else {
            return;
        };
        assert!(
            is_well && output.contains("sum.upper, 32-bit unsigned integer"),
            "{output}"
        );
    }
}

#[test]
fn openimageio_reads_channels_and_every_value() {
    let folder = tempfile::tempdir().unwrap();
    for (compression, _, name) in PACKED {
        let path = folder.path().join(format!("{name}.exr"));
        write_part(&path, compression);
        let Some((is_well, output)) = tool("iinfo", &["-v", word(&path)]) else {
            return;
        };
        assert!(is_well, "{output}");
        for expected in [
            "R (half), G (half), depth.Z (float), sum.upper (uint)",
            &format!("compression: \"{name}\""),
            "pixel data origin: x=5, y=40",
            "full/display size: 200 x 150",
        ] {
            assert!(output.contains(expected), "{expected} is not in {output}");
        }
        let Some((is_well, output)) = tool("oiiotool", &["--dumpdata", word(&path)]) else {
            return;
        };
        assert!(is_well, "{output}");
        assert_values(&output);
    }
}

/// Compares the dump of a cropped image, one line per pixel, with the written values.
#[track_caller]
fn assert_values(dump: &str) {
    let mut pixel_count = 0;
    for line in dump.lines().filter(|line| line.contains("Pixel (")) {
        let (place, values) = line.split_once("):").unwrap();
        let number = |text: &str| text.trim().parse::<f64>().unwrap();
        let (_, place) = place.split_once('(').unwrap();
        let place: Vec<u32> = place.split(',').map(|n| n.trim().parse().unwrap()).collect();
        let (column, row) = (place[0] - 5, place[1] - 40);
        let values: Vec<f64> = values.split_whitespace().map(number).collect();
        for (channel, &output) in ["R", "G", "depth.Z"].iter().zip(&values) {
            // The dump has nine digits.
            let written = f64::from(value(channel, column, row));
            assert!(
                (output - written).abs() <= written.abs() / 1e6,
                "{line}: {channel} is {written}"
            );
        }
        // Integers are printed as fractions of the largest, in f32.
        let part = f64::from(integer(column, row)) / f64::from(u32::MAX);
        assert!((values[3] - part).abs() <= 1e-7, "{line}: sum.upper is {part}");
        pixel_count += 1;
    }
    assert_eq!(pixel_count, WIDTH * HEIGHT);
}

#[test]
fn openimageio_diff_ignores_compression_and_finds_changes() {
    let folder = tempfile::tempdir().unwrap();
    let scene = first_light();
    let render = |name: &str, flags: &[&str]| {
        let path = folder.path().join(name);
        let fixed = [
            "render",
            &scene,
            "-o",
            word(&path),
            "--size",
            "64x48",
            "--spp",
            "2",
        ];
        let run = whit(&[&fixed[..], &["--backend", "bsp", "--aov", "samples"], flags].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        path
    };
    // Compare lossless compressions by OpenImageIO
    let plain = render("none.exr", &[]);
    for compression in ["rle", "zips", "zip", "piz"] {
        let packed = render(&format!("{compression}.exr"), &["--compression", compression]);
        let exact = ["-fail", "0", "-warn", "0", word(&plain), word(&packed)];
        let Some((is_same, output)) = tool("idiff", &exact) else {
            return;
        };
        assert!(is_same, "{compression}: {output}");
    }
    // Half floats must differ
    let half = render("half.exr", &["--exr-type", "half"]);
    let Some((is_same, output)) = tool("idiff", &["-fail", "0", "-warn", "0", word(&plain), word(&half)])
    else {
        return;
    };
    assert!(!is_same, "{output}");
    // Only colours are halves
    let Some((_, output)) = tool("exrheader", &[word(&half)]) else {
        return;
    };
    for expected in [
        "R, 16-bit floating-point",
        "samples, 32-bit floating-point",
        "whit.settings (type string)",
    ] {
        assert!(output.contains(expected), "{expected} is not in {output}");
    }
}
