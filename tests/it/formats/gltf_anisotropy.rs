//! Anisotropy of glTF materials without textures: the tangents of their lobes come from the file or from texture
//! coordinates.

use std::f64::consts::{PI, TAU};
use std::fs;
use std::path::Path;

use whit::gltf::{self, DefaultLight, LoadOptions};
use whit::render::RenderSettings;
use whit::scene::Scene;

use crate::support::images::{rendered, settings};

/// Source of the directions of tangents.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Tangents {
    File,
    TextureCoordinates,
}

/// Quads of the sphere from pole to pole, and twice as many around it.
const BANDS: u32 = 48;

/// Loads a white metal sphere of this roughness and strength, whose tangents point east.
fn sphere(folder: &Path, (roughness, strength): (f32, f32), tangents: Tangents) -> Scene {
    // Lay out vertices by latitude and longitude
    let (mut places, mut extra, mut indices) = (Vec::new(), Vec::new(), Vec::new());
    let columns = 2 * BANDS;
    for row in 0..=BANDS {
        for column in 0..=columns {
            let (v, u) = (
                f64::from(row) / f64::from(BANDS),
                f64::from(column) / f64::from(columns),
            );
            let ((sin, cos), (sin_east, cos_east)) = ((PI * v).sin_cos(), (TAU * u).sin_cos());
            places.extend([sin * sin_east, cos, sin * cos_east].map(|x| x as f32));
            match tangents {
                Tangents::File => extra.extend([cos_east, 0.0, -sin_east, 1.0].map(|x| x as f32)),
                Tangents::TextureCoordinates => extra.extend([u as f32, v as f32]),
            }
            if row < BANDS && column < columns {
                let first = row * (columns + 1) + column;
                let below = first + columns + 1;
                indices.extend([first, below, first + 1, first + 1, below, below + 1]);
            }
        }
    }
    // Write positions, which are normals as well, then the tangents or coordinates, then the indices
    let mut bytes: Vec<u8> = places.iter().flat_map(|x| x.to_le_bytes()).collect();
    bytes.extend(extra.iter().flat_map(|x| x.to_le_bytes()));
    bytes.extend(indices.iter().flat_map(|i: &u32| i.to_le_bytes()));
    fs::write(folder.join("sphere.bin"), &bytes).unwrap();
    let (count, offset) = (places.len() / 3, 4 * places.len());
    let (name, kind) = match tangents {
        Tangents::File => ("TANGENT", "VEC4"),
        Tangents::TextureCoordinates => ("TEXCOORD_0", "VEC2"),
    };
    let (extra_bytes, index_bytes) = (4 * extra.len(), 4 * indices.len());
    let json = format!(
        r#"{{"asset": {{"version": "2.0"}}, "nodes": [{{"mesh": 0}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "NORMAL": 0, "{name}": 1}}, "indices": 2,
          "material": 0}}]}}],
        "buffers": [{{"uri": "sphere.bin", "byteLength": {}}}],
        "bufferViews": [{{"buffer": 0, "byteLength": {offset}}},
          {{"buffer": 0, "byteOffset": {offset}, "byteLength": {extra_bytes}}},
          {{"buffer": 0, "byteOffset": {}, "byteLength": {index_bytes}}}],
        "accessors": [{{"bufferView": 0, "componentType": 5126, "count": {count}, "type": "VEC3"}},
          {{"bufferView": 1, "componentType": 5126, "count": {count}, "type": "{kind}"}},
          {{"bufferView": 2, "componentType": 5125, "count": {}, "type": "SCALAR"}}],
        "extensionsUsed": ["KHR_materials_anisotropy"],
        "materials": [{{"pbrMetallicRoughness": {{"roughnessFactor": {roughness}}},
          "extensions": {{"KHR_materials_anisotropy": {{"anisotropyStrength": {strength}}}}}}}]}}"#,
        bytes.len(),
        offset + extra_bytes,
        indices.len()
    );
    let file = folder.join("sphere.gltf");
    fs::write(&file, json).unwrap();
    let options = LoadOptions {
        default_light: DefaultLight::Sunlight,
        ..LoadOptions::default()
    };
    gltf::load(&file, &options).unwrap()
}

/// Returns the extent of the highlight across the image over that down the image: of the pixels that are at least half as
/// bright as the brightest.
fn stretch(scene: &Scene) -> f64 {
    const SIZE: usize = 96;
    let settings = RenderSettings {
        width: SIZE as u32,
        height: SIZE as u32,
        ..settings(SIZE as u32, 4)
    };
    let image = rendered(scene, &scene.cameras[0], &settings).image;
    let brightest = image.pixels.iter().map(|pixel| pixel[1]).fold(0.0, f32::max);
    let bright: Vec<[f64; 2]> = (0..SIZE * SIZE)
        .filter(|&index| image.pixels[index][1] > 0.5 * brightest)
        .map(|index| [(index % SIZE) as f64, (index / SIZE) as f64])
        .collect();
    let deviation = |axis: usize| {
        let count = bright.len() as f64;
        let mean = bright.iter().map(|place| place[axis]).sum::<f64>() / count;
        // A pixel has an extent of its own
        let variance = bright
            .iter()
            .map(|place| (place[axis] - mean).powi(2))
            .sum::<f64>()
            / count;
        (variance + 1.0 / 12.0).sqrt()
    };
    deviation(0) / deviation(1)
}

#[test]
fn highlight_is_stretched_along_the_tangent_without_any_texture() {
    let folder = tempfile::tempdir().unwrap();
    for tangents in [Tangents::File, Tangents::TextureCoordinates] {
        let round = stretch(&sphere(folder.path(), (0.35, 0.0), tangents));
        assert!((0.6..1.6).contains(&round), "{tangents:?}: {round}");
        for roughness in [0.0, 0.35] {
            let stretched = stretch(&sphere(folder.path(), (roughness, 0.7), tangents));
            assert!(
                stretched > 2.5,
                "{tangents:?}, roughness {roughness}: {stretched}"
            );
        }
    }
}
