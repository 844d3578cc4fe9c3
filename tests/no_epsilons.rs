//! No fixed tolerance decides anything: what is small is told by the values at hand, as a bound on their rounding.
//!
//! A tolerance of, say, 1e-4 is wrong for scenes of a thousandth and of a million metres. So every number below a thousandth
//! in the sources is listed here with the reason why it is none, and a new one fails until it is.

use std::fs;
use std::path::{Path, PathBuf};

/// Numbers below this look like tolerances.
const SMALL: f64 = 1e-3;

/// The folder whose numbers are asked for: hard cases and how right their answers must be. No picture depends on them.
const PROOFS: &str = "verify/";

/// The file under `src`, the number, and what it is.
const ALLOWED: &[(&str, &str, &str)] = &[
    (
        "accel/agreement.rs",
        "5.960_464_477_539_063e-8",
        "2^-24, the rounding of f32, of values at hand",
    ),
    (
        "accel/bsp/slack.rs",
        "5.960_464_5e-8",
        "2^-24, the rounding of f32, of values at hand",
    ),
    (
        "accel/bsp/slack.rs",
        "7.888_609e-31",
        "2^-100, whose reciprocal f32 still holds",
    ),
    (
        "accel/embree/lanes.rs",
        "1e-17",
        "Embree's own limit of direction components",
    ),
    ("accel/extents/hull.rs", "1e-5", "of the map's own scale"),
    (
        "accel/extents/rays.rs",
        "1.972_152_3e-31",
        "2^-102, whose reciprocal f32 still holds",
    ),
    (
        "render/adaptive/mod.rs",
        "1e-6",
        "the least target that the command line takes",
    ),
    ("cli/bench.rs", "1e-6", "rays in millions"),
    (
        "cost/knob.rs",
        "1e-7",
        "a place of a knob that shows what such offsets do",
    ),
    (
        "cost/knob.rs",
        "1e-5",
        "a place of a knob that shows what such offsets do",
    ),
    (
        "numeric/motion.rs",
        "1e-9",
        "an iteration's step, of a matrix whose scale was taken out",
    ),
    (
        "numeric/spawn.rs",
        "1.788_139_4e-7",
        "3 · 2^-24, of values at hand",
    ),
    (
        "numeric/spawn.rs",
        "5.960_464_5e-8",
        "2^-24, the rounding of f32, of values at hand",
    ),
    (
        "numeric/wide.rs",
        "2.319_046_813_846_299_6e-17",
        "the low part of ln 2",
    ),
    (
        "optics/dispersion.rs",
        "1e-6",
        "square nanometres in square micrometres",
    ),
    (
        "optics/subsurface/dipole.rs",
        "1e-15",
        "coefficients in the unit of the scene's size, under which nothing scatters",
    ),
    (
        "optics/subsurface/exponential.rs",
        "1.428_606_8e-6",
        "the low part of ln 2",
    ),
    ("optics/subsurface/presets.rs", "0.0002", "a measured coefficient"),
    ("render/sample.rs", "1e-9", "nanoseconds in seconds"),
    ("report/bench.rs", "1e-6", "rays in millions"),
    ("shape/torus.rs", "1.1e-8", "√2^-53, of a torus of radius 1"),
    (
        "volume/depth.rs",
        "1.908_214_929_270_587_7e-10",
        "the low part of ln 2",
    ),
    (
        "volume/march.rs",
        "1e-7",
        "the default of a setting: the share of light that a march may lose",
    ),
];

fn source_files(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            source_files(&path, files);
        } else if path.extension().is_some_and(|ending| ending == "rs") && !is_for_tests(&path) {
            files.push(path);
        }
    }
}

/// Whether the file is a module of tests, by its name or by what its parent says.
fn is_for_tests(path: &Path) -> bool {
    if path.ends_with("tests.rs") {
        return true;
    }
    let parent = path.with_file_name("mod.rs");
    let Ok(text) = fs::read_to_string(parent) else {
        return false;
    };
    let name = path.file_stem().unwrap().to_str().unwrap();
    text.contains(&format!("#[cfg(test)]\nmod {name};"))
        || text.contains(&format!("#[cfg(test)]\npub(crate) mod {name};"))
        || text.contains(&format!("#[cfg(test)]\npub(super) mod {name};"))
}

/// What is compiled without tests, line by line, without comments.
fn code(text: &str) -> impl Iterator<Item = &str> {
    let heads = ["#[cfg(test)]\nmod tests", "#[cfg(test)]\npub(super) mod tests"];
    let end = heads
        .iter()
        .filter_map(|head| text.find(head))
        .min()
        .unwrap_or(text.len());
    text[..end].lines().map(|line| line.split("//").next().unwrap())
}

/// The positive numbers of a line that are less than [`SMALL`], as they are written, without their type.
fn small_numbers(line: &str) -> Vec<&str> {
    let bytes = line.as_bytes();
    let mut found = Vec::new();
    let mut in_text = false;
    let mut at = 0;
    while at < bytes.len() {
        in_text ^= bytes[at] == b'"';
        let after_name = at > 0 && (bytes[at - 1].is_ascii_alphanumeric() || b"_.".contains(&bytes[at - 1]));
        if in_text || after_name || !bytes[at].is_ascii_digit() {
            at += 1;
            continue;
        }
        let start = at;
        while at < bytes.len() {
            let is_exponents_sign = b"+-".contains(&bytes[at]) && bytes[at - 1] == b'e';
            if !(bytes[at].is_ascii_digit() || b"_.e".contains(&bytes[at]) || is_exponents_sign) {
                break;
            }
            at += 1;
        }
        let number = line[start..at].trim_end_matches('_');
        let value = number.replace('_', "").parse::<f64>().unwrap_or(0.0);
        if value > 0.0 && value < SMALL {
            found.push(number);
        }
    }
    found
}

#[test]
fn every_small_number_is_known_to_be_no_tolerance() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    source_files(&root, &mut files);
    assert!(files.len() > 100, "only {} files were read", files.len());
    let mut met = vec![false; ALLOWED.len()];
    let mut unknown = Vec::new();
    for file in files {
        let name = file.strip_prefix(&root).unwrap().to_str().unwrap().to_owned();
        if name.starts_with(PROOFS) {
            continue;
        }
        let text = fs::read_to_string(&file).unwrap();
        for (number, line) in code(&text).enumerate() {
            for small in small_numbers(line) {
                match ALLOWED
                    .iter()
                    .position(|(file, value, _)| *file == name && *value == small)
                {
                    Some(index) => met[index] = true,
                    None => unknown.push(format!("src/{name}:{}: {small}", number + 1)),
                }
            }
        }
    }
    assert!(
        unknown.is_empty(),
        "derive these from the values at hand, or say in this test why they are no tolerances: {unknown:#?}"
    );
    let gone: Vec<_> = ALLOWED.iter().zip(&met).filter(|(_, met)| !**met).collect();
    assert!(gone.is_empty(), "no longer there: {gone:#?}");
}

#[test]
fn small_numbers_are_found_however_they_are_written() {
    assert_eq!(small_numbers("if x < 1e-4 { 0.000_5 }"), ["1e-4", "0.000_5"]);
    assert_eq!(small_numbers("const E: f32 = 1e-6_f32;"), ["1e-6"]);
    assert_eq!(small_numbers("x1e * 0.5 + 3.0 - 0.0 + a.0 * 1e-3"), [""; 0]);
    assert_eq!(small_numbers("warn(\"less than 1e-4\", 2e-4)"), ["2e-4"]);
    assert_eq!(
        code("a // 1e-9\n#[cfg(test)]\nmod tests {}").collect::<Vec<_>>(),
        ["a "]
    );
}
