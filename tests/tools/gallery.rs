//! The subcommand `gallery`: writes a benchmark scene of many images, spheres in rows before a wall, each with a base
//! colour, a roughness and metalness, and a normal map of its own, as `.gltf` with PNG files beside it.

use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};

use base64::Engine;
use glam::DVec3;
use image::RgbImage;
use serde_json::{Value, json};
use whit::numeric::SplitMix64;
use whit::numeric::noise::noise;
use whit::parallel;

/// Number of images of each sphere.
const MAPS: usize = 3;
/// Distance between the centres of neighbouring spheres of radius 1.
const SPACING: f64 = 2.25;
/// Vertical angle of view in radians.
const FIELD_OF_VIEW: f64 = 0.6;
/// Numbers of quads around a sphere and from pole to pole.
const QUADS: [u16; 2] = [96, 48];
/// Height of the reliefs, as a fraction of the radius.
const RELIEF: f64 = 0.03;

/// Arguments of `gallery`.
#[derive(clap::Args)]
#[command(after_long_help = "Example:
  cargo run --release --example tools -- gallery gallery.gltf --images 64 --size 1024")]
pub(crate) struct Arguments {
    /// Least number of images: three for each sphere
    #[arg(long, value_name = "N", default_value = "64", value_parser = clap::value_parser!(u16).range(1..=3000))]
    images: u16,

    /// Side of the square images
    #[arg(long, value_name = "PIXELS", default_value = "1024", value_parser = clap::value_parser!(u32).range(4..=8192))]
    size: u32,

    /// The .gltf file to write, beside a folder of its images
    #[arg(value_name = "OUT.gltf")]
    output: PathBuf,
}

/// Writes the scene and its images.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    let output = &arguments.output;
    let stem = output
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let folder = output.with_file_name(format!("{stem}_images"));
    let failed = |path: &Path, error: &dyn std::fmt::Display| {
        format!(
            "{}: cannot be written ({error}): choose another place",
            path.display()
        )
    };
    std::fs::create_dir_all(&folder).map_err(|error| failed(&folder, &error))?;
    // Write the images of all spheres in parallel
    let sphere_count = usize::from(arguments.images).div_ceil(MAPS);
    parallel::try_map(sphere_count, &|sphere| {
        for (map, image) in Stone::new(sphere).maps(arguments.size).iter().enumerate() {
            let path = folder.join(image_name(MAPS * sphere + map));
            image.save(&path).map_err(|error| failed(&path, &error))?;
        }
        Ok::<_, String>(())
    })?;
    let document = document(sphere_count, &format!("{stem}_images"));
    std::fs::write(output, format!("{document:#}\n")).map_err(|error| failed(output, &error))
}

fn image_name(number: usize) -> String {
    format!("{number:04}.png")
}

/// Pattern and colours of a sphere.
struct Stone {
    /// Position in the space of the noise.
    offset: DVec3,
    /// Kind of pattern: veins, grain or tiles.
    kind: usize,
    frequency: f64,
    colors: [DVec3; 2],
    is_gilded: bool,
}

impl Stone {
    fn new(number: usize) -> Stone {
        let mut random = SplitMix64::new(1, number as u64);
        let hue = random.unit();
        let color = |hue: f64, value: f64| {
            value * DVec3::new(hue, hue + 0.33, hue + 0.67).map(|phase| 0.55 + 0.45 * (TAU * phase).cos())
        };
        Stone {
            offset: 100.0 * random.in_cube(),
            kind: number % 3,
            frequency: random.within(1.5, 3.5),
            colors: [color(hue, 0.95), color(hue + random.within(0.05, 0.3), 0.45)],
            is_gilded: random.unit() < 0.4,
        }
    }

    /// Returns the height of the relief, 0 to 1, at a point of the unit sphere in longitude and latitude.
    fn height(&self, p: DVec3, [longitude, latitude]: [f64; 2]) -> f64 {
        let octave = |octave: i32| {
            let scale = 2f64.powi(octave);
            noise(scale * self.frequency * p + self.offset) / scale
        };
        let sum: f64 = (0..6).map(octave).sum();
        match self.kind {
            0 => 0.5 + 0.5 * (6.0 * self.frequency * p.y + 9.0 * sum).sin(),
            1 => 1.0 - (1.6 * sum).abs().min(1.0),
            _ => {
                let grooves = (8.0 * longitude).sin().abs().min((8.0 * latitude).sin().abs());
                (6.0 * grooves).min(1.0) * (0.8 + 0.2 * sum)
            }
        }
    }

    /// Returns base colour, roughness with metalness, and normal map: squares of this side.
    fn maps(&self, side: u32) -> [RgbImage; MAPS] {
        let count = side as usize;
        let step = PI / f64::from(side);
        let angles = |x: usize, y: usize| [2.0 * step * (x as f64 + 0.5), step * (y as f64 + 0.5)];
        let height = |index: usize| {
            let angles = angles(index % count, index / count);
            self.height(point(angles), angles)
        };
        let heights: Vec<f64> = (0..count * count).map(height).collect();
        let at = |x: usize, y: usize| heights[y.min(count - 1) * count + x % count];
        let mut maps = [0; MAPS].map(|_| RgbImage::new(side, side));
        for (x, y) in (0..count).flat_map(|y| (0..count).map(move |x| (x, y))) {
            let h = at(x, y);
            let is_metal = self.is_gilded && h > 0.6;
            // Slopes along the parallel, which is shorter near the poles, and along the meridian
            let east = (at(x + 1, y) - at(x + count - 1, y)) / (4.0 * step * angles(x, y)[1].sin());
            let south = (at(x, y + 1) - at(x, y.saturating_sub(1))) / (2.0 * step);
            let normal = DVec3::new(-RELIEF * east, RELIEF * south, 1.0).normalize();
            let texels = [
                self.colors[1].lerp(self.colors[0], h),
                DVec3::new(1.0, 0.75 - 0.45 * h, f64::from(u8::from(is_metal))),
                0.5 + 0.5 * normal,
            ];
            for (map, texel) in maps.iter_mut().zip(texels) {
                let codes = (255.0 * texel).round().to_array().map(|code| code as u8);
                map.put_pixel(x as u32, y as u32, image::Rgb(codes));
            }
        }
        maps
    }
}

/// Returns the point of the unit sphere at a longitude and an angle from the north pole.
fn point([longitude, polar]: [f64; 2]) -> DVec3 {
    DVec3::new(
        -longitude.cos() * polar.sin(),
        polar.cos(),
        longitude.sin() * polar.sin(),
    )
}

/// Returns the glTF document of so many spheres, whose images are in `folder`.
fn document(sphere_count: usize, folder: &str) -> Value {
    let columns = (sphere_count as f64).sqrt().ceil() as usize;
    let rows = sphere_count.div_ceil(columns);
    let place = |sphere: usize| {
        let x = (sphere % columns) as f64 - 0.5 * (columns - 1) as f64;
        let y = 0.5 * (rows - 1) as f64 - (sphere / columns) as f64;
        [SPACING * x, SPACING * y, 0.0]
    };
    let half = 0.5 * SPACING * columns as f64;
    let distance = half / (0.5 * FIELD_OF_VIEW).tan() + 1.0;
    let image_count = MAPS * sphere_count;
    let (binary, vertex_count, index_count) = sphere_mesh();
    let list = |count: usize, item: &dyn Fn(usize) -> Value| -> Vec<Value> { (0..count).map(item).collect() };
    let mut nodes = list(sphere_count, &|i| {
        // Each sphere shows another side
        let turn = 0.5 * i as f64;
        json!({"mesh": i, "translation": place(i), "rotation": [0.0, turn.sin(), 0.0, turn.cos()]})
    });
    let light = |light: usize, at: [f64; 3]| json!({"translation": at, "extensions": {"KHR_lights_punctual": {"light": light}}});
    // A wall behind the spheres, two lights and the camera
    let wall = sphere_count;
    nodes.push(
        json!({"mesh": wall, "translation": [0.0, 0.0, -2.0 - 20.0 * half], "scale": ([20.0 * half; 3])}),
    );
    nodes.push(light(0, [-half, 1.5 * half, 1.5 * half]));
    nodes.push(light(1, [1.5 * half, 0.2 * half, half]));
    nodes.push(json!({"camera": 0, "translation": [0.0, 0.0, distance]}));
    let mesh = |material: usize| {
        let attributes = json!({"POSITION": 0, "NORMAL": 0, "TEXCOORD_0": 1});
        json!({"primitives": [{"attributes": attributes, "indices": 2, "material": material}]})
    };
    let mut materials = list(sphere_count, &|i| {
        let texture = |map: usize| json!({"index": MAPS * i + map});
        json!({
            "pbrMetallicRoughness": {"baseColorTexture": texture(0), "metallicRoughnessTexture": texture(1)},
            "normalTexture": texture(2)
        })
    });
    materials.push(
        json!({"pbrMetallicRoughness": {"baseColorFactor": [0.4, 0.42, 0.45, 1.0], "metallicFactor": 0.0}}),
    );
    let lamp = |intensity: f64| json!({"type": "point", "intensity": intensity * half * half});
    let indices_at = 20 * vertex_count;
    json!({
        "asset": {"version": "2.0", "generator": "whit's tools"},
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": [lamp(9.0), lamp(3.0)]}},
        "scene": 0,
        "scenes": [{"nodes": (0..nodes.len()).collect::<Vec<_>>()}],
        "nodes": nodes,
        "cameras": [{"type": "perspective", "perspective": {"yfov": FIELD_OF_VIEW, "znear": 0.1}}],
        "meshes": list(sphere_count + 1, &mesh),
        "materials": materials,
        "textures": list(image_count, &|i| json!({"source": i})),
        "images": list(image_count, &|i| json!({"uri": format!("{folder}/{}", image_name(i))})),
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": vertex_count, "type": "VEC3",
                "min": [-1, -1, -1], "max": [1, 1, 1]},
            {"bufferView": 1, "componentType": 5126, "count": vertex_count, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": index_count, "type": "SCALAR"}
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 12 * vertex_count},
            {"buffer": 0, "byteOffset": 12 * vertex_count, "byteLength": 8 * vertex_count},
            {"buffer": 0, "byteOffset": indices_at, "byteLength": 2 * index_count}
        ],
        "buffers": [{
            "byteLength": binary.len(),
            "uri": format!(
                "data:application/octet-stream;base64,{}",
                base64::engine::general_purpose::STANDARD.encode(&binary)
            )
        }]
    })
}

/// Returns positions, texture coordinates and indices of the unit sphere, and the numbers of vertices and indices.
fn sphere_mesh() -> (Vec<u8>, usize, usize) {
    let [columns, rows] = QUADS;
    let mut floats: [Vec<f32>; 2] = Default::default();
    let mut indices: Vec<u16> = Vec::new();
    for (row, column) in (0..=rows).flat_map(|row| (0..=columns).map(move |column| (row, column))) {
        let uv = [
            f64::from(column) / f64::from(columns),
            f64::from(row) / f64::from(rows),
        ];
        let position = point([TAU * uv[0], PI * uv[1]]);
        floats[0].extend(position.to_array().map(|x| x as f32));
        floats[1].extend(uv.map(|x| x as f32));
        if row < rows && column < columns {
            let a = row * (columns + 1) + column;
            let [b, c, d] = [a + columns + 1, a + columns + 2, a + 1];
            // Quads at the poles are triangles
            if row > 0 {
                indices.extend([a, c, d]);
            }
            if row + 1 < rows {
                indices.extend([a, b, c]);
            }
        }
    }
    let mut bytes: Vec<u8> = floats.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    bytes.extend(indices.iter().flat_map(|index| index.to_le_bytes()));
    (bytes, floats[0].len() / 3, indices.len())
}
