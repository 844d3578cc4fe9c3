//! Tests on complete files: correct content, clear errors, and no panic for damaged files.

use std::io::Write;
use std::path::PathBuf;

use flate2::Compression;
use flate2::write::GzEncoder;
use glam::DVec3;

use super::*;

/// Memory limit that is sufficient for all arrays here.
const MEMORY: u64 = 1 << 20;

fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

fn read_bytes(name: &str, bytes: &[u8]) -> Result<ReadVolume, ReadError> {
    let (_folder, path) = file(name, bytes);
    read(&path, MEMORY)
}

/// Returns the bytes of samples 0 to 23 of 4 x 3 x 2.
fn counted<T>(to_bytes: impl Fn(u8) -> T) -> Vec<u8>
where
    T: IntoIterator<Item = u8>,
{
    (0..24).flat_map(to_bytes).collect()
}

fn npy(descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

fn nrrd(fields: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = format!("NRRD0004\n# a comment\n{fields}\n\n").into_bytes();
    bytes.extend(data);
    bytes
}

fn gzip(data: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(data).unwrap();
    encoder.finish().unwrap()
}

const RAW_FLOATS: &str = "type: float\ndimension: 3\nsizes: 4 3 2\nendian: big\nencoding: raw";
const GZIP_BYTES: &str = "type: uchar\ndimension: 3\nsizes: 4 3 2\nencoding: gzip";
const TEXT: &str = "type: short\ndimension: 3\nsizes: 4 3 2\nencoding: ascii";

/// Asserts that sample (x, y, z) of 4 x 3 x 2 is x + 4 y + 12 z.
fn assert_counted(volume: &ReadVolume) {
    let [grid] = &volume.channels[..] else {
        panic!("{} channels", volume.channels.len());
    };
    assert_eq!(grid.size(), [4, 3, 2]);
    for i in 0..24 {
        let p = DVec3::new((i % 4) as f64, (i / 4 % 3) as f64, (i / 12) as f64);
        assert_eq!(grid.sample(p), f64::from(i), "{p}");
    }
}

#[test]
fn same_array_is_read_from_every_format() {
    let big = counted(|i| f32::from(i).to_be_bytes());
    let text: String = (0..24).map(|i| format!("{i}\n")).collect();
    for (name, bytes) in [
        (
            "a.npy",
            npy(
                "<f4",
                "False",
                "(2, 3, 4)",
                &counted(|i| f32::from(i).to_le_bytes()),
            ),
        ),
        (
            "b.npy",
            npy(
                ">f8",
                "False",
                "(2, 3, 4)",
                &counted(|i| f64::from(i).to_be_bytes()),
            ),
        ),
        ("c.npy", npy("|u1", "False", "(2, 3, 4, 1)", &counted(|i| [i]))),
        ("d.nrrd", nrrd(RAW_FLOATS, &big)),
        ("e.nrrd", nrrd(GZIP_BYTES, &gzip(&counted(|i| [i])))),
        ("f.nrrd", nrrd(TEXT, text.as_bytes())),
    ] {
        assert_counted(&read_bytes(name, &bytes).unwrap_or_else(|error| panic!("{error}")));
    }
}

#[test]
fn fortran_order_is_transposed() {
    // The element [z, y, x] is at z + 2 y + 6 x.
    let data: Vec<u8> = (0..24)
        .map(|at| (at / 6) + 4 * (at / 2 % 3) + 12 * (at % 2))
        .collect();
    assert_counted(&read_bytes("a.npy", &npy("|u1", "True", "(2, 3, 4)", &data)).unwrap());
}

#[test]
fn raw_numbers_are_read_as_their_header_says() {
    // Write a file with five leading bytes
    let mut bytes = vec![9; 5];
    bytes.extend(counted(|i| u16::from(i).to_be_bytes()));
    let (_folder, path) = file("a.raw", &bytes);
    let header = RawHeader {
        size: [4, 3, 2],
        channels: 1,
        element: Element::U16,
        order: ByteOrder::Big,
        skip: 5,
    };
    assert_counted(&read_raw(&path, &header, MEMORY).unwrap());
    // Try headers that do not fit the file or overflow
    for bad in [
        RawHeader { skip: 6, ..header },
        RawHeader {
            skip: u64::MAX,
            ..header
        },
        RawHeader {
            size: [4, 3, 3],
            ..header
        },
        RawHeader {
            size: [usize::MAX; 3],
            ..header
        },
        RawHeader {
            size: [4, 0, 3],
            ..header
        },
        RawHeader {
            channels: 0,
            ..header
        },
    ] {
        assert!(read_raw(&path, &bad, MEMORY).is_err(), "{bad:?}");
    }
}

#[test]
fn colours_become_channels() {
    let data: Vec<u8> = (0..8).flat_map(|i| [i, 10 + i, 20 + i, 30 + i]).collect();
    let fields =
        "type: uint8\ndimension: 4\nsizes: 4 2 2 2\nencoding: raw\nkinds: RGBA-color space space space";
    for (name, bytes) in [
        ("a.npy", npy("|u1", "False", "(2, 2, 2, 4)", &data)),
        ("b.nrrd", nrrd(fields, &data)),
    ] {
        let volume = read_bytes(name, &bytes).unwrap();
        let at_far_corner: Vec<_> = volume
            .channels
            .iter()
            .map(|grid| grid.sample(DVec3::ONE))
            .collect();
        assert_eq!(at_far_corner, [7.0, 17.0, 27.0, 37.0]);
    }
}

#[test]
fn data_may_be_in_a_separate_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut data = b"first line\nsecond\nxx".to_vec();
    data.extend(counted(|i| [i]));
    std::fs::write(folder.path().join("a.raw"), data).unwrap();
    let fields = "type: uchar\ndimension: 3\nsizes: 4 3 2\nencoding: raw\nline skip: 2\nbyte skip: 2\ndata file: a.raw";
    let header = folder.path().join("a.nhdr");
    std::fs::write(&header, nrrd(fields, b"")).unwrap();
    assert_counted(&read(&header, MEMORY).unwrap());
    std::fs::write(
        &header,
        nrrd(
            &fields.replace("line skip: 2\nbyte skip: 2", "byte skip: -1"),
            b"",
        ),
    )
    .unwrap();
    assert_counted(&read(&header, MEMORY).unwrap());
    std::fs::write(&header, nrrd(&fields.replace("a.raw", "b.raw"), b"")).unwrap();
    assert!(matches!(read(&header, MEMORY), Err(ReadError::Unreadable { .. })));
}

#[test]
fn directions_and_origin_place_sample_centres() {
    let fields =
        format!("{RAW_FLOATS}\nspace directions: (2,0,0) (0,0,3) (0,-1,0)\nspace origin: (10,20,30)");
    let volume = read_bytes("a.nrrd", &nrrd(&fields, &[0; 96])).unwrap();
    let map = volume.world_from_cube.unwrap();
    // Compare the centre of the first of 4 x 3 x 2 samples, and those of its neighbours along each axis.
    let first = DVec3::new(-0.75, -2.0 / 3.0, -0.5);
    let near =
        |p: DVec3, expected: DVec3| (map.transform_point3(p) - expected).length() <= 64.0 * f64::EPSILON;
    assert!(near(first, DVec3::new(10.0, 20.0, 30.0)));
    assert!(near(first + 0.5 * DVec3::X, DVec3::new(12.0, 20.0, 30.0)));
    assert!(near(first + 2.0 / 3.0 * DVec3::Y, DVec3::new(10.0, 20.0, 33.0)));
    assert!(near(first + DVec3::Z, DVec3::new(10.0, 19.0, 30.0)));

    let fields = format!("{RAW_FLOATS}\nspacings: 1 1 5");
    let map = read_bytes("a.nrrd", &nrrd(&fields, &[0; 96]))
        .unwrap()
        .world_from_cube
        .unwrap();
    assert_eq!(map.transform_point3(DVec3::ONE), DVec3::new(4.0, 3.0, 10.0));
    assert_eq!(map.transform_point3(-DVec3::ONE), DVec3::ZERO);
}

#[test]
fn each_fault_is_one_sentence_with_file_and_remedy() {
    // Prepare valid data, and a copy with NaN at (1, 0, 1)
    let floats = counted(|i| f32::from(i).to_le_bytes());
    let mut nan = floats.clone();
    nan[4 * 13..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    let shape = "(2, 3, 4)";
    // Read invalid files of each format
    for (name, bytes, words) in [
        ("a.vdb", vec![], "OpenVDB"),
        ("a.txt", vec![], "\"txt\""),
        ("a.npy", vec![], "complete .npy"),
        ("a.npy", npy("<f4", "False", shape, &floats[..95]), "truncated"),
        ("a.npy", npy("<f4", "False", shape, &nan), "[1, 0, 1]"),
        (
            "a.npy",
            npy("<f8", "False", "(1, 1, 1)", &1e300f64.to_le_bytes()),
            "finite",
        ),
        (
            "a.npy",
            npy("<f4", "False", "(200, 200, 200)", &floats),
            "truncated",
        ),
        ("a.nrrd", b"NRRD0004\n".to_vec(), "\"type\""),
        ("a.nrrd", b"GIF89a".to_vec(), "not an NRRD"),
        (
            "a.nrrd",
            nrrd(&RAW_FLOATS.replace("endian: big\n", ""), &floats),
            "\"endian\"",
        ),
        (
            "a.nrrd",
            nrrd(&RAW_FLOATS.replace("raw", "bzip2"), &floats),
            "bzip2",
        ),
        (
            "a.nrrd",
            nrrd(&RAW_FLOATS.replace("float", "block"), &floats),
            "block",
        ),
        (
            "a.nrrd",
            nrrd(&RAW_FLOATS.replace("4 3 2", "4 3"), &floats),
            "\"sizes\"",
        ),
        (
            "a.nrrd",
            nrrd(&GZIP_BYTES.replace("4 3 2", "4000 300 200"), &gzip(&floats)),
            "bytes of memory",
        ),
        (
            "a.nrrd",
            nrrd(&GZIP_BYTES.replace("4 3 2", "40 50 50"), &gzip(&floats)),
            "truncated",
        ),
        ("a.nrrd", nrrd(GZIP_BYTES, &floats), "gzip"),
        ("a.nrrd", nrrd(TEXT, &b"1 two 3 ".repeat(8)), "\"two\""),
        ("a.nrrd", nrrd(TEXT, b"1 2 3"), "truncated"),
    ] {
        let sentence = read_bytes(name, &bytes).unwrap_err().to_string();
        assert!(sentence.contains(words) && sentence.contains(name), "{sentence}");
        assert!(!sentence.contains('\n') && sentence.contains(": "), "{sentence}");
    }
    // Read a file that does not exist
    let missing = read(Path::new("/nowhere/a.npy"), MEMORY).unwrap_err().to_string();
    assert!(missing.contains("check the path"), "{missing}");
}

#[test]
fn memory_limit_is_enforced() {
    let bytes = npy("|u1", "False", "(2, 3, 4)", &counted(|i| [i]));
    let (_folder, path) = file("a.npy", &bytes);
    assert!(read(&path, bytes.len() as u64).is_ok());
    let sentence = read(&path, bytes.len() as u64 - 1).unwrap_err().to_string();
    assert!(sentence.contains("allowed"), "{sentence}");
}

/// Returns a pseudo-random number (G. Marsaglia, "Xorshift RNGs", 2003).
fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

#[test]
fn damaged_files_never_panic() {
    let big = counted(|i| f32::from(i).to_be_bytes());
    let placed =
        format!("{RAW_FLOATS}\nspace directions: (2,0,0) (0,0,3) none\nspace origin: (1,2,3)\nbyte skip: -1");
    // Build one valid file for each format and encoding
    let whole = [
        (
            "a.npy",
            npy(
                "<f4",
                "False",
                "(2, 3, 4)",
                &counted(|i| f32::from(i).to_le_bytes()),
            ),
        ),
        ("b.npy", npy("|u1", "True", "(2, 3, 2, 2)", &counted(|i| [i]))),
        ("c.nrrd", nrrd(&placed, &big)),
        ("d.nrrd", nrrd(GZIP_BYTES, &gzip(&counted(|i| [i])))),
        ("e.nrrd", nrrd(TEXT, &b"1 2 3 ".repeat(8))),
    ];
    let folder = tempfile::tempdir().unwrap();
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    // Damage each file at random bytes and read it
    for (name, bytes) in &whole {
        let path = folder.path().join(name);
        for round in 0..600 {
            let mut damaged = bytes.clone();
            for _ in 0..1 + round % 4 {
                let at = random(&mut state) as usize % damaged.len();
                // Flip bits, or insert digits and separators, which are likely to pass the parser's first checks.
                damaged[at] = match random(&mut state) % 3 {
                    0 => damaged[at] ^ 1 << (random(&mut state) % 8),
                    1 => b"0123456789-"[random(&mut state) as usize % 11],
                    _ => b"(),:'\n {}"[random(&mut state) as usize % 9],
                };
            }
            if round % 3 == 0 {
                damaged.truncate(random(&mut state) as usize % damaged.len());
            }
            std::fs::write(&path, &damaged).unwrap();
            if let Ok(volume) = read(&path, MEMORY) {
                for grid in &volume.channels {
                    let p = DVec3::from_array(grid.size().map(|side| side as f64));
                    assert!(grid.sample(0.4 * p).is_finite(), "{name}, round {round}");
                    assert!(grid.memory() as u64 <= MEMORY);
                }
            }
        }
    }
}
