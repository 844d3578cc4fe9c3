//! Scenes that are translated, scaled, rotated or reordered give the same images.
//!
//! These tests need no reference image: both images come from one file, which is edited before it is loaded. A rotation
//! about the camera, or a factor on all lengths with its square on the intensity of lights, does not change the image.
//! If coordinates round differently, a ray may fall on the other side of an edge, so one pixel in ten thousand may
//! differ by more than a step of an 8-bit image. Powers of two cause no rounding, so they must not change any bit.

use std::fs;
use std::path::Path;

use crate::support::scene_folder::{FiledScene, load};
use glam::{DMat3, DVec3};
use toml::Value;
use whit::accel::Backend;
use whit::image::{LinearImage, ToneMap};

const BACKENDS: &[Backend] = if cfg!(feature = "embree") {
    &[Backend::Embree, Backend::Native, Backend::Bsp]
} else {
    &[Backend::Native, Backend::Bsp]
};

/// Similarity transform that maps a point p to `factor * turn * p + offset`.
#[derive(Clone, Copy, Debug)]
struct UniformScale {
    turn: DMat3,
    factor: f64,
    offset: DVec3,
}

impl UniformScale {
    const NONE: UniformScale = UniformScale {
        turn: DMat3::IDENTITY,
        factor: 1.0,
        offset: DVec3::ZERO,
    };

    fn scaled(factor: f64) -> UniformScale {
        UniformScale {
            factor,
            ..UniformScale::NONE
        }
    }

    fn moved(offset: DVec3) -> UniformScale {
        UniformScale {
            offset,
            ..UniformScale::NONE
        }
    }

    fn vector(&self, v: DVec3) -> DVec3 {
        self.turn * v * self.factor
    }

    fn point(&self, p: DVec3) -> DVec3 {
        self.vector(p) + self.offset
    }

    /// Returns the TOML scene file transformed by this map.
    fn carry_scene_file(&self, scene: &mut toml::Table) {
        let camera = scene["camera"].as_table_mut().unwrap();
        camera.entry("up").or_insert(numbers(DVec3::Y));
        change(camera, &["from", "at"], |p| self.point(p));
        change(camera, &["up"], |v| self.turn * v);
        for light in tables(scene, "light") {
            change(light, &["position", "at"], |p| self.point(p));
            change(light, &["direction"], |v| self.turn * v);
            if light["kind"].as_str() != Some("directional") {
                let intensity = number(&light["intensity"]) * self.factor * self.factor;
                light.insert("intensity".into(), intensity.into());
            }
        }
        for material in scene.get_mut("material").into_iter().flat_map(named) {
            if let Some(distance) = material.get_mut("attenuation_distance") {
                *distance = (number(distance) * self.factor).into();
            }
        }
        for object in tables(scene, "object") {
            let steps = object
                .entry("transform")
                .or_insert_with(|| Value::Array(Vec::new()));
            let turn = self.turn * self.factor;
            let row = |r: usize| {
                let [x, y, z] = turn.row(r).to_array();
                Value::from(vec![x, y, z, self.offset[r]])
            };
            let step = toml::Table::from_iter([("matrix".into(), Value::from(vec![row(0), row(1), row(2)]))]);
            steps.as_array_mut().unwrap().push(step.into());
        }
    }

    /// Returns the glTF file transformed by this map, which must not rotate.
    fn carry_gltf(&self, document: &mut serde_json::Value) {
        let roots = document["scenes"][0]["nodes"].take();
        let nodes = document["nodes"].as_array_mut().unwrap();
        nodes.push(serde_json::json!({
            "name": "all",
            "children": roots,
            "scale": [self.factor, self.factor, self.factor],
            "translation": self.offset.to_array(),
        }));
        document["scenes"][0]["nodes"] = vec![nodes.len() - 1].into();
        let lights = &mut document["extensions"]["KHR_lights_punctual"]["lights"];
        for light in lights.as_array_mut().unwrap() {
            assert_ne!(light["type"], "directional");
            let intensity = light["intensity"].as_f64().unwrap() * self.factor * self.factor;
            light["intensity"] = intensity.into();
        }
        for camera in document["cameras"].as_array_mut().unwrap() {
            let near = &mut camera["perspective"]["znear"];
            *near = (near.as_f64().unwrap() * self.factor).into();
        }
    }
}

fn number(value: &Value) -> f64 {
    let whole = value.as_integer().map(|whole| whole as f64);
    value.as_float().or(whole).unwrap()
}

fn numbers(v: DVec3) -> Value {
    v.to_array().to_vec().into()
}

/// Changes the named vectors of a table where they exist.
fn change(table: &mut toml::Table, keys: &[&str], map: impl Fn(DVec3) -> DVec3) {
    for &key in keys {
        if let Some(value) = table.get_mut(key) {
            let old = value.as_array().unwrap();
            *value = numbers(map(DVec3::from_array([0, 1, 2].map(|axis| number(&old[axis])))));
        }
    }
}

/// Changes the named vectors of the tables in a list, `[[key]]`.
fn tables<'t>(document: &'t mut toml::Table, key: &str) -> impl Iterator<Item = &'t mut toml::Table> {
    let list = document.get_mut(key).and_then(Value::as_array_mut);
    list.into_iter().flatten().filter_map(Value::as_table_mut)
}

/// Changes the named vectors of named tables, `[key.name]`.
fn named(value: &mut Value) -> impl Iterator<Item = &mut toml::Table> {
    let tables = value.as_table_mut().unwrap().iter_mut();
    tables.filter_map(|(_, table)| table.as_table_mut())
}

/// Loads the scene of a file after changing its text.
fn changed_scene_file(name: &str, change: impl Fn(&mut toml::Table)) -> FiledScene {
    let mut document: toml::Table = source(name).parse().unwrap();
    // A background gradient does not rotate with the scene.
    document.insert("background".into(), "#9cc4f0".into());
    change(&mut document);
    let text = toml::to_string(&document).unwrap();
    loaded(name, &text)
}

/// Loads the scene of a file, transformed by `map`.
fn carried(name: &str, map: &UniformScale) -> FiledScene {
    if name.ends_with(".toml") {
        return changed_scene_file(name, |document| map.carry_scene_file(document));
    }
    let mut document = serde_json::from_str(&source(name)).unwrap();
    map.carry_gltf(&mut document);
    loaded(name, &document.to_string())
}

fn source(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    fs::read_to_string(folder.join(name)).unwrap()
}

fn loaded(name: &str, text: &str) -> FiledScene {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(name);
    fs::write(&file, text).unwrap();
    load(&file)
}

/// Scenes of one file each: shapes, nested glass and water, and a glTF file of meshes.
const SCENES: [&str; 3] = ["table_of_shapes.toml", "glass_of_water.toml", "first_light.gltf"];

fn render_image(scene: &FiledScene, backend: Backend) -> LinearImage {
    /// Number of pixels per row.
    const WIDTH: u32 = 192;
    scene.rendered(backend, &scene.settings(WIDTH, 1))
}

/// Returns the number of pixels that differ by more than a step of an 8-bit image.
fn differing_count(a: &LinearImage, b: &LinearImage) -> usize {
    let [a, b] = [a, b].map(|image| ToneMap::default().srgb_bytes(image));
    assert_eq!(a.len(), b.len());
    let differs = |(a, b): (&[u8], &[u8])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 1);
    a.chunks(3).zip(b.chunks(3)).filter(|&pair| differs(pair)).count()
}

/// Asserts that the maps change at most one pixel in ten thousand.
fn assert_images_stay(name: &str, maps: &[UniformScale]) {
    let plain = carried(name, &UniformScale::NONE);
    for &backend in BACKENDS {
        let expected = render_image(&plain, backend);
        for map in maps {
            let found = render_image(&carried(name, map), backend);
            assert_eq!(found.non_finite_count(), 0, "{name}, {backend}, {map:?}");
            let differing = differing_count(&found, &expected);
            println!(
                "{name}, {backend}, {map:?}: {differing} of {} pixels differ",
                expected.pixels.len()
            );
            assert!(
                differing * 10_000 <= expected.pixels.len(),
                "{name}, {backend}, {map:?}: {differing}"
            );
        }
    }
}

#[test]
fn far_scenes_look_like_scenes_at_the_origin() {
    let maps = [1e6, 1e8].map(|far| UniformScale::moved(DVec3::new(far, -0.5 * far, 2.0 * far)));
    SCENES.iter().for_each(|name| assert_images_stay(name, &maps));
}

#[test]
fn tiny_scenes_look_like_full_size_scenes() {
    let maps = [1e-6, 1e-9].map(UniformScale::scaled);
    SCENES.iter().for_each(|name| assert_images_stay(name, &maps));
}

#[test]
fn scaling_by_a_power_of_two_changes_no_bit() {
    for name in SCENES {
        let plain = carried(name, &UniformScale::NONE);
        for &backend in BACKENDS {
            let expected = render_image(&plain, backend);
            for exponent in [-60, -13, 1, 60] {
                let found = render_image(
                    &carried(name, &UniformScale::scaled(2f64.powi(exponent))),
                    backend,
                );
                let unlike = |(a, b): (&[f32; 3], &[f32; 3])| a.map(f32::to_bits) != b.map(f32::to_bits);
                let differing = found
                    .pixels
                    .iter()
                    .zip(&expected.pixels)
                    .filter(|&pair| unlike(pair))
                    .count();
                println!("{name}, {backend}, 2^{exponent}: {differing}");
                assert_eq!(differing, 0, "{name}, {backend}, 2^{exponent}");
            }
        }
    }
}

/// Returns the rotations that map a cube to itself.
fn rotations_of_a_cube() -> Vec<DMat3> {
    let axes = [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z];
    let pairs = axes.iter().flat_map(|&x| axes.iter().map(move |&y| (x, y)));
    pairs
        .filter(|(x, y)| x.dot(*y) == 0.0)
        .map(|(x, y)| DMat3::from_cols(x, y, x.cross(y)))
        .collect()
}

#[test]
fn rotated_scenes_look_alike_from_some_cube_sides() {
    assert_images_stay_from_sides(5);
}

#[test]
#[ignore = "slow: all 24 rotations"]
fn rotated_scenes_look_alike_from_all_cube_sides() {
    assert_images_stay_from_sides(1);
}

/// Asserts that two scenes look alike under every `step`th of the 24 rotations of a cube.
fn assert_images_stay_from_sides(step: usize) {
    let rotations = rotations_of_a_cube();
    assert_eq!(rotations.len(), 24);
    let maps: Vec<UniformScale> = rotations
        .into_iter()
        .step_by(step)
        .map(|turn| UniformScale {
            turn,
            ..UniformScale::NONE
        })
        .collect();
    assert_images_stay("table_of_shapes.toml", &maps);
    assert_images_stay("glass_of_water.toml", &maps);
}

#[test]
fn object_order_does_not_matter() {
    for name in ["table_of_shapes.toml", "glass_of_water.toml"] {
        let [forward, backward] = [false, true].map(|is_reversed| {
            changed_scene_file(name, |document| {
                let objects = document["object"].as_array_mut().unwrap();
                if is_reversed {
                    objects.reverse();
                }
            })
        });
        for &backend in BACKENDS {
            let [a, b] = [&forward, &backward].map(|scene| render_image(scene, backend));
            let unlike = a.pixels.iter().zip(&b.pixels).filter(|(a, b)| a != b).count();
            println!("{name}, {backend}: {unlike} pixels have other bits in reverse order");
            let differing = differing_count(&a, &b);
            assert!(
                differing * 10_000 <= a.pixels.len(),
                "{name}, {backend}: {differing} pixels differ"
            );
        }
    }
}
