//! Writes the project's first scene, `scenes/first_light.gltf`: a studio under an evening sky with a perfect mirror, a
//! golden one, plastics, a torus knot and many instances, small enough to be committed as text.
//!
//! ```text
//! cargo run --example first-light -- scenes/first_light.gltf
//! ```

mod png;
mod shapes;

use std::f64::consts::{PI, TAU};
use std::process::ExitCode;

use base64::Engine;
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};

use png::png;
use shapes::{Tessellation, block, floor, sky, sphere, trefoil, tube};

fn main() -> ExitCode {
    let Some(target) = std::env::args().nth(1) else {
        eprintln!("usage: first-light OUT.gltf");
        return ExitCode::from(2);
    };
    if let Err(error) = std::fs::write(&target, first_light()) {
        eprintln!("{target}: cannot be written ({error}): choose another place");
        return ExitCode::from(2);
    }
    ExitCode::SUCCESS
}

/// A glTF document in the making.
#[derive(Default)]
struct Writer {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    nodes: Vec<Value>,
}

/// Accessor numbers of a tessellated shape.
#[derive(Clone, Copy)]
struct Shape {
    position: usize,
    normal: usize,
    tex_coord: Option<usize>,
    index: usize,
}

/// The whole file.
fn first_light() -> String {
    let mut w = Writer::default();
    let sphere = w.shape(&sphere());
    let block = w.shape(&block());
    let torus = w.shape(&tube(40, 16, 0.34, |t| DVec3::new(t.cos(), 0.0, t.sin())));
    let knot = w.shape(&tube(128, 10, 0.26, trefoil));
    let floor = w.shape(&floor());
    let sky = w.shape(&sky());

    let checker = w.material("checker", [1.0; 3], 0.0, 0.8, Some(("baseColorTexture", 0)));
    let ground = w.mesh("ground", floor, checker);
    w.node("ground", ground, DVec3::ZERO, DVec3::ONE);
    let dusk = w.emissive("sky", 1);
    let dome = w.mesh("sky", sky, dusk);
    w.node("sky", dome, DVec3::ZERO, DVec3::splat(18.0));

    w.ball(
        sphere,
        "mirror",
        [0.97, 0.97, 0.97],
        [1.0, 0.0],
        DVec3::new(0.0, 1.0, 0.0),
        1.0,
    );
    w.ball(
        sphere,
        "gold",
        [1.0, 0.77, 0.34],
        [1.0, 0.0],
        DVec3::new(-1.75, 0.55, 1.15),
        0.55,
    );
    w.ball(
        sphere,
        "red plastic",
        [0.75, 0.06, 0.05],
        [0.0, 0.25],
        DVec3::new(1.65, 0.5, 1.3),
        0.5,
    );
    w.ball(
        sphere,
        "chalk",
        [0.72, 0.69, 0.63],
        [0.0, 1.0],
        DVec3::new(0.35, 0.3, 1.9),
        0.3,
    );

    let teal = w.material("teal plastic", [0.03, 0.42, 0.42], 0.0, 0.3, None);
    let teal_knot = w.mesh("knot", knot, teal);
    w.turned(
        "knot",
        teal_knot,
        DVec3::new(2.2, 1.2, -0.9),
        DVec3::splat(0.36),
        DQuat::from_rotation_y(0.5),
    );
    let copper = w.material("copper", [0.95, 0.50, 0.35], 1.0, 0.35, None);
    let copper_ring = w.mesh("ring", torus, copper);
    let lean = DQuat::from_rotation_z(0.35) * DQuat::from_rotation_x(1.25);
    w.turned(
        "ring",
        copper_ring,
        DVec3::new(-2.15, 1.02, -0.9),
        DVec3::splat(0.78),
        lean,
    );

    let slate = w.material("slate", [0.30, 0.34, 0.42], 0.0, 0.5, None);
    let pillar = w.mesh("pillar", block, slate);
    const PILLARS: u32 = 17;
    for i in 0..PILLARS {
        // An arc behind the spheres; heights like an organ's pipes. The middle one is mirrored left to right.
        let s = f64::from(i) / f64::from(PILLARS - 1);
        let angle = PI * (1.0 - s);
        let height = 0.9 + 1.3 * (PI * s).sin().powi(2) + 0.25 * (7.0 * s * PI).cos();
        let place = DVec3::new(4.4 * angle.cos(), 0.5 * height, -0.8 - 3.4 * angle.sin().abs());
        let side = if i == PILLARS / 2 { -0.2 } else { 0.2 };
        let turn = DQuat::from_rotation_y(angle - 0.5 * PI);
        w.turned(
            &format!("pillar {i}"),
            pillar,
            place,
            DVec3::new(side, 0.5 * height, 0.12),
            turn,
        );
    }
    let amber = w.material("amber plastic", [0.90, 0.42, 0.06], 0.0, 0.2, None);
    let bead = w.mesh("bead", sphere, amber);
    const BEADS: u32 = 24;
    for i in 0..BEADS {
        let angle = TAU * f64::from(i) / f64::from(BEADS);
        // Every other bead is a flat one.
        let size = if i % 2 == 0 {
            DVec3::splat(0.09)
        } else {
            DVec3::new(0.11, 0.05, 0.11)
        };
        let place = DVec3::new(1.3 * angle.cos(), size.y, 1.3 * angle.sin());
        w.node(&format!("bead {i}"), bead, place, size);
    }
    w.light("key", 0, DVec3::new(3.6, 5.2, 4.4), DVec3::ZERO);
    w.light("fill", 1, DVec3::new(-5.0, 4.4, 3.0), DVec3::new(-0.3, 0.6, 0.0));
    w.light("rim", 2, DVec3::new(0.6, 3.4, -2.6), DVec3::ZERO);
    w.camera(DVec3::new(0.9, 2.15, 7.3), DVec3::new(0.05, 0.82, 0.0));
    w.finish()
}

impl Writer {
    fn shape(&mut self, t: &Tessellation) -> Shape {
        let flat = |vectors: &[DVec3]| -> Vec<f32> {
            vectors.iter().flat_map(|v| v.to_array()).map(rounded).collect()
        };
        let tex_coords: Vec<f32> = t.tex_coords.iter().flatten().map(|&x| rounded(x)).collect();
        let position = self.floats(&flat(&t.positions), 3);
        let normal = self.floats(&flat(&t.normals), 3);
        let tex_coord = (!tex_coords.is_empty()).then(|| self.floats(&tex_coords, 2));
        let indices: Vec<u8> = t
            .triangles
            .iter()
            .flatten()
            .flat_map(|i| i.to_le_bytes())
            .collect();
        let index = self.accessor(
            &indices,
            json!({"componentType": 5123, "count": 3 * t.triangles.len(), "type": "SCALAR"}),
        );
        Shape {
            position,
            normal,
            tex_coord,
            index,
        }
    }

    fn floats(&mut self, values: &[f32], width: usize) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        let mut accessor = json!({
            "componentType": 5126, "count": values.len() / width, "type": format!("VEC{width}")
        });
        if width == 3 {
            let axis = |i: usize| values.iter().skip(i).step_by(3).copied();
            accessor["min"] = json!([0, 1, 2].map(|i| axis(i).fold(f32::INFINITY, f32::min)));
            accessor["max"] = json!([0, 1, 2].map(|i| axis(i).fold(f32::NEG_INFINITY, f32::max)));
        }
        self.accessor(&bytes, accessor)
    }

    fn accessor(&mut self, bytes: &[u8], mut accessor: Value) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        accessor["bufferView"] = json!(self.views.len());
        self.views
            .push(json!({"buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len()}));
        self.binary.extend_from_slice(bytes);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn material(
        &mut self,
        name: &str,
        color: [f64; 3],
        metallic: f64,
        roughness: f64,
        texture: Option<(&str, usize)>,
    ) -> usize {
        let [r, g, b] = color;
        let mut pbr = json!({"baseColorFactor": [r, g, b, 1.0], "metallicFactor": metallic, "roughnessFactor": roughness});
        if let Some((parameter, number)) = texture {
            pbr[parameter] = json!({"index": number});
        }
        self.materials
            .push(json!({"name": name, "pbrMetallicRoughness": pbr}));
        self.materials.len() - 1
    }

    fn emissive(&mut self, name: &str, texture: usize) -> usize {
        let material = self.material(name, [0.0; 3], 0.0, 1.0, None);
        self.materials[material]["emissiveFactor"] = json!([1, 1, 1]);
        self.materials[material]["emissiveTexture"] = json!({"index": texture});
        material
    }

    fn mesh(&mut self, name: &str, shape: Shape, material: usize) -> usize {
        let mut attributes = json!({"POSITION": shape.position, "NORMAL": shape.normal});
        if let Some(tex_coord) = shape.tex_coord {
            attributes["TEXCOORD_0"] = json!(tex_coord);
        }
        let primitive = json!({"attributes": attributes, "indices": shape.index, "material": material});
        self.meshes.push(json!({"name": name, "primitives": [primitive]}));
        self.meshes.len() - 1
    }

    fn ball(
        &mut self,
        sphere: Shape,
        name: &str,
        color: [f64; 3],
        surface: [f64; 2],
        place: DVec3,
        radius: f64,
    ) {
        let material = self.material(name, color, surface[0], surface[1], None);
        let mesh = self.mesh(name, sphere, material);
        self.node(name, mesh, place, DVec3::splat(radius));
    }

    fn node(&mut self, name: &str, mesh: usize, place: DVec3, size: DVec3) {
        self.turned(name, mesh, place, size, DQuat::IDENTITY);
    }

    fn turned(&mut self, name: &str, mesh: usize, place: DVec3, size: DVec3, turn: DQuat) {
        let mut node = json!({"name": name, "mesh": mesh});
        let rounded = |v: &[f64]| v.iter().map(|&x| (x * 1e6).round() / 1e6).collect::<Vec<_>>();
        if place != DVec3::ZERO {
            node["translation"] = json!(rounded(&place.to_array()));
        }
        if turn != DQuat::IDENTITY {
            node["rotation"] = json!(rounded(&turn.to_array()));
        }
        if size != DVec3::ONE {
            node["scale"] = json!(rounded(&size.to_array()));
        }
        self.nodes.push(node);
    }

    fn light(&mut self, name: &str, light: usize, place: DVec3, target: DVec3) {
        let mut node = json!({"name": name, "extensions": {"KHR_lights_punctual": {"light": light}}});
        place_looking(&mut node, place, target);
        self.nodes.push(node);
    }

    fn camera(&mut self, place: DVec3, target: DVec3) {
        let mut node = json!({"name": "camera", "camera": 0});
        place_looking(&mut node, place, target);
        self.nodes.push(node);
    }

    fn finish(self) -> String {
        let data = |kind: &str, bytes: &[u8]| {
            let text = base64::engine::general_purpose::STANDARD.encode(bytes);
            format!("data:{kind};base64,{text}")
        };
        let checker = png(
            2,
            &[[196, 190, 178], [92, 104, 122], [92, 104, 122], [196, 190, 178]],
        );
        let extras = json!({
            "shows": "First light: a mirror, a golden one and plastics under an evening sky",
            "effects": ["shadows", "mirror reflection", "textures", "emission", "instances"],
            "made_by": "cargo run --example first-light -- scenes/first_light.gltf"
        });
        let asset = json!({"version": "2.0", "generator": "whit first-light", "extras": extras});
        let lights = json!({"KHR_lights_punctual": {"lights": [
            {"name": "key", "type": "point", "color": [1.0, 0.93, 0.82], "intensity": 165},
            {"name": "fill", "type": "spot", "color": [0.62, 0.76, 1.0], "intensity": 110,
                "spot": {"innerConeAngle": 0.25, "outerConeAngle": 0.6}},
            {"name": "rim", "type": "point", "color": [1.0, 0.62, 0.38], "intensity": 18}
        ]}});
        let perspective = json!({"yfov": 0.6, "znear": 0.1});
        let parts = [
            ("asset", json!(asset)),
            ("extensionsUsed", json!(["KHR_lights_punctual"])),
            ("extensions", lights),
            ("scene", json!(0)),
            (
                "scenes",
                json!([{"nodes": (0..self.nodes.len()).collect::<Vec<_>>()}]),
            ),
            ("nodes", json!(self.nodes)),
            (
                "cameras",
                json!([{"name": "camera", "type": "perspective", "perspective": perspective}]),
            ),
            ("materials", json!(self.materials)),
            (
                "textures",
                json!([{"source": 0, "sampler": 0}, {"source": 1, "sampler": 1}]),
            ),
            (
                "samplers",
                json!([{"magFilter": 9728, "minFilter": 9728}, {"wrapS": 33071, "wrapT": 33071}]),
            ),
            (
                "images",
                json!([{"name": "checker", "uri": data("image/png", &checker)},
                {"name": "dusk", "uri": data("image/png", &dusk())}]),
            ),
            ("meshes", json!(self.meshes)),
            ("accessors", json!(self.accessors)),
            ("bufferViews", json!(self.views)),
            (
                "buffers",
                json!([{"byteLength": self.binary.len(),
                "uri": data("application/octet-stream", &self.binary)}]),
            ),
        ];
        // One item a line: text that can be read and compared.
        let lines = parts.map(|(key, value)| match value {
            Value::Array(items) => {
                let items: Vec<String> = items.iter().map(|item| format!("    {item}")).collect();
                format!("  \"{key}\": [\n{}\n  ]", items.join(",\n"))
            }
            other => format!("  \"{key}\": {other}"),
        });
        format!("{{\n{}\n}}\n", lines.join(",\n"))
    }
}

/// A value on a grid of 2^-16, so that the last bits of the system's sine do not reach the file.
fn rounded(x: f64) -> f32 {
    ((x * 65536.0).round() / 65536.0) as f32
}

/// Looking along -z, as cameras and spot lights do.
fn place_looking(node: &mut Value, place: DVec3, target: DVec3) {
    let back = (place - target).normalize();
    let right = DVec3::Y.cross(back).normalize();
    let turn = DQuat::from_mat3(&DMat3::from_cols(right, back.cross(right), back));
    node["translation"] = json!(place.to_array());
    node["rotation"] = json!(turn.to_array().map(|x| (x * 1e9).round() / 1e9));
}

/// A column of sky: deep blue above, a warm band at the horizon.
fn dusk() -> Vec<u8> {
    const COLORS: [[f64; 3]; 4] = [
        [8.0, 12.0, 34.0],
        [26.0, 40.0, 84.0],
        [96.0, 92.0, 120.0],
        [196.0, 138.0, 104.0],
    ];
    const HEIGHT: usize = 32;
    let texels: Vec<[u8; 3]> = (0..HEIGHT)
        .map(|row| {
            let s = row as f64 / (HEIGHT - 1) as f64 * (COLORS.len() - 1) as f64;
            let below = (s as usize).min(COLORS.len() - 2);
            let t = s - below as f64;
            [0, 1, 2].map(|c| (COLORS[below][c] * (1.0 - t) + COLORS[below + 1][c] * t).round() as u8)
        })
        .collect();
    png(1, &texels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_committed_scene_is_what_the_generator_writes() {
        let committed = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/first_light.gltf");
        let committed = std::fs::read_to_string(committed).unwrap();
        assert!(committed == first_light(), "run the generator again");
        assert!(committed.len() < 200_000);
    }
}
