//! Tests of Cryptomatte against its specification: files are read as a compositor reads them, ids are hashed by a
//! second implementation, coverages are compared with images of single samples and with a known silhouette; and other
//! readers return equal values.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::support::cli_program::whit;
use crate::support::exr_tools::tool;
use crate::support::images::{add, rendered, settings};
use glam::{DAffine3, DVec3};
use whit::image::rows::{ExrScanlineReader, SampleType, Samples};
use whit::render::{AovKind, Pattern, RenderSettings, Rendering};
use whit::scene::{Camera, Geometry, Material, Projection, Scene};
use whit::shape::{Shape, Sphere};

/// Number of ranks of a pixel, stored in pairs of channels.
const RANKS: usize = 6;

/// Layers with the keys of their attributes: seven digits of the hashes of their names, computed by another program.
const LAYERS: [(&str, &str); 2] = [("CryptoObject", "3ae39a5"), ("CryptoMaterial", "be359d6")];

/// Returns MurmurHash3_x86_32 with seed 0, as its author describes it: whole words, then the rest, then the avalanche.
fn murmur3(text: &str) -> u32 {
    let bytes = text.as_bytes();
    let mix = |word: u32| {
        let word = word.wrapping_mul(0xcc9e_2d51);
        word.rotate_left(15).wrapping_mul(0x1b87_3593)
    };
    let mut hash = 0u32;
    let words = bytes.len() / 4;
    for word in 0..words {
        hash ^= mix(u32::from_le_bytes(
            bytes[4 * word..4 * word + 4].try_into().unwrap(),
        ));
        hash = hash.rotate_left(13).wrapping_mul(5).wrapping_add(0xe654_6b64);
    }
    let mut left = 0u32;
    for (place, &byte) in bytes[4 * words..].iter().enumerate() {
        left |= u32::from(byte) << (8 * place);
    }
    if left != 0 {
        hash ^= mix(left);
    }
    hash ^= bytes.len() as u32;
    hash ^= hash >> 16;
    hash = hash.wrapping_mul(0x85eb_ca6b);
    hash ^= hash >> 13;
    hash = hash.wrapping_mul(0xc2b2_ae35);
    hash ^ hash >> 16
}

/// Returns the specification's f32 of a hash: sign and mantissa are kept, the exponent is clamped to 1 to 254.
fn id(name: &str) -> f32 {
    let hash = murmur3(name);
    let exponent = (hash >> 23 & 0xff).clamp(1, 254);
    f32::from_bits(hash & 0x807f_ffff | exponent << 23)
}

#[test]
fn independent_hash_matches_published_values() {
    // Values of the reference implementation, and of manifests in the specification.
    for (text, hash) in [
        ("", 0),
        ("hello", 0x248b_fa47),
        ("hello, world", 0x149b_bb7f),
        ("The quick brown fox jumps over the lazy dog", 0x2e4f_f723),
        ("bunny", 0x1385_1a76),
        ("default", 0x42c9_679f),
        ("bunny_porcelain_mat", 0xb24b_26d4),
    ] {
        assert_eq!(murmur3(text), hash, "{text}");
    }
}

/// Channels and attributes of a file.
struct File {
    reader: ExrScanlineReader,
    width: usize,
    channels: BTreeMap<String, Vec<f32>>,
}

impl File {
    fn open(path: &Path) -> File {
        let mut reader = ExrScanlineReader::open(path).unwrap();
        let [width, height] = reader.data_window().size;
        let names: Vec<String> = reader
            .channels()
            .iter()
            .map(|channel| channel.name.clone())
            .collect();
        let values = reader
            .read_rows(0..height)
            .unwrap()
            .into_iter()
            .map(|samples| match samples {
                Samples::Floats(values) => values.into_owned(),
                Samples::Integers(_) => panic!("integers"),
            });
        File {
            channels: names.into_iter().zip(values).collect(),
            width: width as usize,
            reader,
        }
    }

    /// Returns the ids and coverages of a pixel.
    fn ranks(&self, layer: &str, pixel: usize) -> Vec<(f32, f32)> {
        ranks(|name| self.channels[name][pixel], layer)
    }

    fn attribute(&self, key: &str, name: &str) -> String {
        let name = format!("cryptomatte/{key}/{name}");
        self.reader
            .note(&name)
            .unwrap_or_else(|| panic!("{name} is missing"))
    }

    fn manifest(&self, key: &str) -> BTreeMap<String, String> {
        serde_json::from_str(&self.attribute(key, "manifest")).unwrap()
    }
}

/// Returns the ids and coverages of a pixel from its channels, given by `value`.
fn ranks(value: impl Fn(&str) -> f32, layer: &str) -> Vec<(f32, f32)> {
    let channel = |rank: usize, letters: [&str; 2]| {
        let name = format!("{layer}{:02}.{}", rank / 2, letters[rank % 2]);
        value(&name)
    };
    let pair = |rank| (channel(rank, ["R", "B"]), channel(rank, ["G", "A"]));
    (0..RANKS).map(pair).collect()
}

/// Scene of a wall with two spheres in front of it, of which one has a non-ASCII name and one has none.
const SCENE: &str = "[camera]\nfrom = [0, 0, 5]\nat = [0, 0, 0]\n\n[[light]]\nkind = \"directional\"\n\
                     direction = [0, 0, -1]\n\n[material.red]\nbase_color = [0.8, 0.1, 0.1]\n\n[material.wall]\n\n\
                     [[object]]\nname = \"Käse \\\"𝄞\\\"\"\nshape = \"sphere\"\nmaterial = \"red\"\n\
                     transform = [{ scale = 0.5 }]\n\n[[object]]\nname = \"wall\"\nshape = \"quad\"\n\
                     material = \"wall\"\ntransform = [{ translate = [0.2, 0, -2] }]\n\n[[object]]\n\
                     shape = \"sphere\"\nmaterial = \"red\"\ntransform = [{ scale = 0.3 }, { translate = [0.4, 0.3, 0.5] }]\n";

const AOVS: &str = "depth,normal,ids,motion,crypto-object,crypto-material";

/// Renders [`SCENE`] to a file in `folder`.
fn render(folder: &Path, size: &str, flags: &[&str]) -> PathBuf {
    let (scene, image) = (folder.join("scene.toml"), folder.join("image.exr"));
    std::fs::write(&scene, SCENE).unwrap();
    let fixed = ["--size", size, "--spp", "4", "--backend", "bsp", "--aov", AOVS];
    let run = whit(&[&["render", word(&scene), "-o", word(&image)], &fixed[..], flags].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    image
}

fn word(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn files_follow_the_specification_and_manifests_list_every_id() {
    let folder = tempfile::tempdir().unwrap();
    for flags in [&[][..], &["--exr-type", "half", "--compression", "zip"]] {
        let file = File::open(&render(folder.path(), "41x33", flags));
        for (layer, key) in LAYERS {
            // Check the metadata of the layer
            assert!(format!("{:08x}", murmur3(layer)).starts_with(key));
            assert_eq!(file.attribute(key, "name"), layer);
            assert_eq!(file.attribute(key, "hash"), "MurmurHash3_32");
            assert_eq!(file.attribute(key, "conversion"), "uint32_to_float32");
            // Check the ids in the manifest
            let manifest = file.manifest(key);
            for (name, digits) in &manifest {
                assert_eq!(*digits, format!("{:08x}", id(name).to_bits()), "{name}");
            }
            // Ids must be 32-bit floats, even in files of halves
            let is_float = |name: &str| {
                let mut channels = file.reader.channels().iter();
                channels.any(|channel| channel.name == name && channel.sample == SampleType::Float)
            };
            let described =
                ["R", "G", "B", "A"].map(|letter| (0..3).all(|n| is_float(&format!("{layer}0{n}.{letter}"))));
            assert_eq!(described, [true; 4]);
            // Check order, sum and ids of the ranks of each pixel
            let known: Vec<u32> = manifest.keys().map(|name| id(name).to_bits()).collect();
            for pixel in 0..file.width * 33 {
                let ranks = file.ranks(layer, pixel);
                assert!(ranks.is_sorted_by(|a, b| a.1 >= b.1), "{ranks:?}");
                let sum: f32 = ranks.iter().map(|rank| rank.1).sum();
                assert!((0.0..=1.0).contains(&sum), "{ranks:?}");
                for (id, coverage) in ranks {
                    let is_right = if coverage > 0.0 {
                        known.contains(&id.to_bits())
                    } else {
                        id == 0.0
                    };
                    assert!(is_right, "{id} with {coverage}");
                }
            }
        }
        let objects = file.manifest(LAYERS[0].1);
        assert!(objects.contains_key("Käse \"𝄞\"") && objects.contains_key("wall") && objects.len() == 3);
        let materials: Vec<String> = file.manifest(LAYERS[1].1).into_keys().collect();
        assert_eq!(materials, ["red", "wall"]);
    }
}

#[test]
fn files_without_cryptomattes_have_no_cryptomatte_attributes() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, image) = (folder.path().join("scene.toml"), folder.path().join("plain.exr"));
    std::fs::write(&scene, SCENE).unwrap();
    let run = whit(&[
        "render",
        word(&scene),
        "-o",
        word(&image),
        "--size",
        "4x4",
        "--aov",
        "depth",
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert_eq!(File::open(&image).reader.note("cryptomatte/3ae39a5/name"), None);
}

/// Returns a camera at z = 5 that looks along -z; an image shows -1 to 1 in each direction.
fn camera() -> Camera {
    Camera {
        world_from_camera: DAffine3::from_translation(5.0 * DVec3::Z),
        projection: Projection::Orthographic {
            y_mag: 1.0,
            x_mag: None,
        },
        ..Camera::default()
    }
}

fn ball(x: f64, y: f64, radius: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(x, y, 0.0)) * DAffine3::from_scale(DVec3::splat(radius))
}

/// Returns spheres so small that pixels of a small image contain many; names repeat, and some are empty.
fn crowd() -> Scene {
    let mut scene = Scene::default();
    for number in 0..400u32 {
        let [x, y] = [number % 20, number / 20].map(|n| (f64::from(n) + 0.5) / 10.0 - 1.0);
        let radius = 0.02 + 0.0009 * f64::from(number * 7 % 40);
        let name = match number % 11 {
            0 => String::new(),
            1 => "twin".into(),
            _ => format!("ball {number}"),
        };
        let material = Material {
            name: format!("material {}", number % 3),
            ..Material::default()
        };
        let sphere = Geometry::Shape(Shape::Sphere(Sphere::UNIT));
        add(&mut scene, &name, sphere, material, ball(x, y, radius));
    }
    scene
}

fn with(layers: &[AovKind], size: u32, spp: u32) -> RenderSettings {
    RenderSettings {
        layers: layers.iter().copied().collect(),
        pattern: Pattern::Regular,
        ..settings(size, spp)
    }
}

fn plane<'r>(rendering: &'r Rendering, name: &str) -> &'r [f32] {
    let mut layers = rendering.layers.iter();
    &layers.find(|layer| layer.name == name).unwrap().values
}

#[test]
fn coverages_match_an_image_of_single_samples() {
    // A pixel of 8 x 8 regular samples is 8 x 8 pixels with one sample in the middle; a pixel shows some nine spheres.
    let (size, side) = (7, 8);
    let scene = crowd();
    let mattes = [AovKind::CryptoObject, AovKind::CryptoMaterial];
    let seen = rendered(&scene, &camera(), &with(&mattes, size, side * side));
    let single = rendered(&scene, &camera(), &with(&[AovKind::Ids], size * side, 1));
    let object_name = |number: f32| match &*scene.instances[number as usize].name {
        "" => "unnamed".to_owned(),
        name => name.to_owned(),
    };
    let material_name = |number: f32| scene.materials[number as usize].name.clone();
    let mut most = 0;
    for (layer, numbers) in [("CryptoObject", "id.object"), ("CryptoMaterial", "id.material")] {
        let name = |number: f32| match layer {
            "CryptoObject" => object_name(number),
            _ => material_name(number),
        };
        let numbers = plane(&single, numbers);
        for pixel in 0..(size * size) as usize {
            let [column, row] = [pixel % size as usize, pixel / size as usize];
            let mut counts = BTreeMap::<u32, u32>::new();
            for sample in 0..(side * side) as usize {
                let [x, y] = [column * 8 + sample % 8, row * 8 + sample / 8];
                let number = numbers[y * 56 + x];
                if number >= 0.0 {
                    *counts.entry(id(&name(number)).to_bits()).or_default() += 1;
                }
            }
            most = most.max(counts.len());
            let mut expected: Vec<(u32, u32)> = counts.into_iter().collect();
            // Entries of equal coverage are already in the order of their ids.
            expected.sort_by_key(|&(_, count)| std::cmp::Reverse(count));
            let expected = expected.into_iter().take(RANKS);
            let mut expected: Vec<(f32, f32)> = expected
                .map(|(id, count)| (f32::from_bits(id), count as f32 / 64.0))
                .collect();
            expected.resize(RANKS, (0.0, 0.0));
            assert_eq!(
                ranks(|name| plane(&seen, name)[pixel], layer),
                expected,
                "{layer}"
            );
        }
    }
    assert!(most > RANKS, "no pixel has more than {most}");
}

#[test]
fn matte_by_name_has_the_area_of_the_silhouette() {
    let mut scene = Scene::default();
    // Build a sphere in front of a wall
    let (size, side, radius) = (20, 4, 0.7);
    let sphere = Geometry::Shape(Shape::Sphere(Sphere::UNIT));
    add(
        &mut scene,
        "ball",
        sphere,
        Material::default(),
        ball(0.0, 0.0, radius),
    );
    let wall = DAffine3::from_translation(-3.0 * DVec3::Z) * DAffine3::from_scale(DVec3::splat(4.0));
    add(
        &mut scene,
        "wall",
        Geometry::Shape(Shape::Quad),
        Material::default(),
        wall,
    );
    let seen = rendered(
        &scene,
        &camera(),
        &with(&[AovKind::CryptoObject], size, side * side),
    );
    // Sum the coverage of a name, as a compositor does
    let matte = |name: &str, pixel: usize| -> f64 {
        let ranks = ranks(|channel| plane(&seen, channel)[pixel], "CryptoObject");
        let ours = ranks
            .into_iter()
            .filter(|rank| rank.0.to_bits() == id(name).to_bits());
        ours.map(|rank| f64::from(rank.1)).sum()
    };
    // Compare each pixel with its regular samples
    let mut area = 0.0;
    for pixel in 0..(size * size) as usize {
        let corner = [pixel as u32 % size, pixel as u32 / size];
        let samples = (0..side * side).filter(|sample| {
            let place = [sample % side, sample / side];
            let at = |axis: usize| {
                f64::from(corner[axis] * side + place[axis]) / f64::from(size * side) * 2.0 - 1.0
                    + 1.0 / f64::from(size * side)
            };
            at(0).hypot(at(1)) < radius
        });
        let inside = samples.count() as f64 / f64::from(side * side);
        assert_eq!(matte("ball", pixel), inside);
        assert_eq!(matte("wall", pixel), 1.0 - inside);
        area += matte("ball", pixel) * 4.0 / f64::from(size * size);
    }
    // Samples whose squares the circle crosses have an error of at most half a square: 8 r / s squares of side s.
    let step = 2.0 / f64::from(size * side);
    let bound = 0.5 * 8.0 * radius / step * step * step;
    assert!(
        (area - std::f64::consts::PI * radius * radius).abs() < bound,
        "{area}"
    );
}

#[test]
fn sharded_batches_have_the_channels_and_attributes_of_one_render() {
    let folder = tempfile::tempdir().unwrap();
    let alone = File::open(&render(folder.path(), "24x70", &[]));
    for (split, shards) in [
        ("", &["1/1"][..]),
        ("split = { bands = 3 }", &["3/3", "1/3", "2/3"]),
    ] {
        let out = folder.path().join(format!("of {}", shards.len()));
        let jobs = folder.path().join("test.jobs.toml");
        // Render as a batch, whole or in bands
        let text = format!(
            "[[job]]\nscene = \"scene.toml\"\n{split}\nimage = \"a.exr\"\n\
             settings = {{ size = \"24x70\", spp = 4, backend = \"bsp\", aov = \"{AOVS}\" }}\n"
        );
        std::fs::write(&jobs, text).unwrap();
        for shard in shards {
            let batch = ["batch", word(&jobs), "--out", word(&out), "--quiet"];
            let run = whit(&[&batch[..], &["--shard", shard]].concat());
            assert_eq!(run.code, 0, "{}", run.stderr);
        }
        // Compare with the single render
        let file = File::open(&out.join("a.exr"));
        assert_eq!(file.channels.len(), 3 + 1 + 3 + 3 + 2 + 24);
        for (channel, values) in &alone.channels {
            let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&file.channels[channel]), bits(values), "{channel} {split}");
        }
        for (_, key) in LAYERS {
            for attribute in ["name", "hash", "conversion", "manifest"] {
                assert_eq!(file.attribute(key, attribute), alone.attribute(key, attribute));
            }
        }
    }
}

/// Returns the output of a tool that must succeed, or `None` if it is not installed.
fn words(name: &str, arguments: &[&str]) -> Option<String> {
    let (is_well, words) = tool(name, arguments)?;
    assert!(is_well, "{name}: {words}");
    Some(words)
}

#[test]
fn other_readers_find_channels_and_attributes() {
    let folder = tempfile::tempdir().unwrap();
    let path = render(folder.path(), "41x33", &[]);
    let file = File::open(&path);
    // Print the header with each installed tool
    let Some(header) = words("exrheader", &[word(&path)]) else {
        return;
    };
    let Some(info) = words("exrinfo", &["-v", "-s", word(&path)]) else {
        return;
    };
    let Some(image) = words("iinfo", &["-v", word(&path)]) else {
        return;
    };
    // Check the channels
    for name in file.channels.keys() {
        assert!(
            header.contains(&format!("    {name}, 32-bit floating-point")),
            "{name}: {header}"
        );
        assert!(
            info.contains(&format!("'{name}': float samp 1 1")),
            "{name}: {info}"
        );
        assert!(image.contains(&format!(" {name}")), "{name}: {image}");
    }
    // Check the attributes
    for (_, key) in LAYERS {
        for attribute in ["name", "hash", "conversion", "manifest"] {
            let (name, text) = (
                format!("cryptomatte/{key}/{attribute}"),
                file.attribute(key, attribute),
            );
            let described = format!("{name} (type string): \"{text}\"");
            assert!(header.contains(&described), "{described}: {header}");
            assert!(
                info.contains(&format!("{name}: string '{text}'")),
                "{name}: {info}"
            );
            assert!(image.contains(&name), "{name}: {image}");
        }
    }
}

#[test]
fn openimageio_reads_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let path = render(folder.path(), "41x33", &["--compression", "zip"]);
    let file = File::open(&path);
    let names = [
        "Z",
        "normal.X",
        "normal.Y",
        "normal.Z",
        "CryptoObject00.R",
        "CryptoObject00.G",
        "CryptoObject00.B",
        "CryptoObject00.A",
    ];
    // Choose a pixel that shows two objects: its ids are those of an edge.
    let edge = (0..file.width * 33)
        .find(|&pixel| file.ranks("CryptoObject", pixel)[1].1 > 0.0)
        .unwrap();
    let tiff = folder.path().join("pixel.tif");
    let cut = format!("1x1+{}+{}", edge % file.width, edge / file.width);
    let to_tiff = ["-d", "float", "--compression", "none", "-o", word(&tiff)];
    let from = [word(&path), "--ch", &names.join(","), "--cut", &cut];
    let Some(_) = words("oiiotool", &[&from[..], &to_tiff].concat()) else {
        return;
    };
    let expected = names.map(|name| file.channels[name][edge].to_bits());
    assert_eq!(only_pixel(&std::fs::read(&tiff).unwrap(), names.len()), expected);
}

/// Returns the bits of the values of an uncompressed TIFF's only pixel.
fn only_pixel(tiff: &[u8], channels: usize) -> Vec<u32> {
    let word = |at: usize| u32::from_le_bytes(tiff[at..at + 4].try_into().unwrap());
    let short = |at: usize| usize::from(u16::from_le_bytes(tiff[at..at + 2].try_into().unwrap()));
    assert_eq!(&tiff[..4], b"II*\0");
    let directory = word(4) as usize;
    // Each entry has a tag, a type, a count and a value; tag 273 gives the offset of the strip.
    let entries = (0..short(directory)).map(|entry| directory + 2 + 12 * entry);
    let strip = entries
        .filter(|&at| short(at) == 273)
        .map(|at| word(at + 8))
        .next()
        .unwrap();
    (0..channels)
        .map(|channel| word(strip as usize + 4 * channel))
        .collect()
}
