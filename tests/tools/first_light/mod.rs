//! The subcommand `first-light`: writes the project's first scene, `scenes/first_light.gltf`, a studio under an evening
//! sky with a perfect mirror, a golden one, plastics, a torus knot and many instances, small enough to be committed as
//! text.

mod png;
mod shapes;

use std::f64::consts::{PI, TAU};
use std::path::PathBuf;

use base64::Engine;
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};

use shapes::{Tessellation, block, floor, sky, sphere, trefoil, tube};

/// Arguments of `first-light`.
#[derive(clap::Args)]
#[command(after_long_help = "\
Example:
  cargo run --example tools -- first-light scenes/first_light.gltf")]
pub(crate) struct Arguments {
    /// The .gltf file to write
    #[arg(value_name = "OUT.gltf")]
    output: PathBuf,
}

/// Writes the file.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    let path = &arguments.output;
    std::fs::write(path, first_light()).map_err(|error| {
        format!(
            "{}: cannot be written ({error}): choose another place",
            path.display()
        )
    })
}

/// Lists of a glTF document and its binary buffer.
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

/// Returns the whole file.
fn first_light() -> String {
    let mut w = Writer::default();
    let sphere = w.push_shape(&sphere());
    let block = w.push_shape(&block());
    let torus = w.push_shape(&tube(40, 16, 0.34, |t| DVec3::new(t.cos(), 0.0, t.sin())));
    let knot = w.push_shape(&tube(128, 10, 0.26, trefoil));
    let floor = w.push_shape(&floor());
    let sky = w.push_shape(&sky());

    push_ground_and_sky(&mut w, floor, sky);
    push_spheres(&mut w, sphere);
    push_knot_and_ring(&mut w, knot, torus);
    push_pillars(&mut w, block);
    push_beads(&mut w, sphere);
    w.push_light("key", 0, DVec3::new(3.6, 5.2, 4.4), DVec3::ZERO);
    w.push_light("fill", 1, DVec3::new(-5.0, 4.4, 3.0), DVec3::new(-0.3, 0.6, 0.0));
    w.push_light("rim", 2, DVec3::new(0.6, 3.4, -2.6), DVec3::ZERO);
    w.push_camera(DVec3::new(0.9, 2.15, 7.3), DVec3::new(0.05, 0.82, 0.0));
    w.finish()
}

/// Adds the chequered ground and the dome of the sky.
fn push_ground_and_sky(w: &mut Writer, floor: Shape, sky: Shape) {
    let checker = w.push_material("checker", [1.0; 3], 0.0, 0.8, Some(("baseColorTexture", 0)));
    let ground = w.push_mesh("ground", floor, checker);
    w.push_node("ground", ground, DVec3::ZERO, DVec3::ONE);
    let dusk = w.push_emissive_material("sky", 1);
    let dome = w.push_mesh("sky", sky, dusk);
    w.push_node("sky", dome, DVec3::ZERO, DVec3::splat(18.0));
}

/// Adds the mirror and three more spheres.
fn push_spheres(w: &mut Writer, sphere: Shape) {
    w.push_sphere(
        sphere,
        "mirror",
        [0.97, 0.97, 0.97],
        [1.0, 0.0],
        DVec3::new(0.0, 1.0, 0.0),
        1.0,
    );
    w.push_sphere(
        sphere,
        "gold",
        [1.0, 0.77, 0.34],
        [1.0, 0.0],
        DVec3::new(-1.75, 0.55, 1.15),
        0.55,
    );
    w.push_sphere(
        sphere,
        "red plastic",
        [0.75, 0.06, 0.05],
        [0.0, 0.25],
        DVec3::new(1.65, 0.5, 1.3),
        0.5,
    );
    w.push_sphere(
        sphere,
        "chalk",
        [0.72, 0.69, 0.63],
        [0.0, 1.0],
        DVec3::new(0.35, 0.3, 1.9),
        0.3,
    );
}

/// Adds the torus knot and the ring.
fn push_knot_and_ring(w: &mut Writer, knot: Shape, torus: Shape) {
    let teal = w.push_material("teal plastic", [0.03, 0.42, 0.42], 0.0, 0.3, None);
    let teal_knot = w.push_mesh("knot", knot, teal);
    w.push_rotated_node(
        "knot",
        teal_knot,
        DVec3::new(2.2, 1.2, -0.9),
        DVec3::splat(0.36),
        DQuat::from_rotation_y(0.5),
    );
    let copper = w.push_material("copper", [0.95, 0.50, 0.35], 1.0, 0.35, None);
    let copper_ring = w.push_mesh("ring", torus, copper);
    w.push_rotated_node(
        "ring",
        copper_ring,
        DVec3::new(-2.15, 1.02, -0.9),
        DVec3::splat(0.78),
        DQuat::from_rotation_z(0.35) * DQuat::from_rotation_x(1.25),
    );
}

/// Adds an arc of pillars of different heights behind the spheres.
fn push_pillars(w: &mut Writer, block: Shape) {
    const PILLARS: u32 = 17;
    let slate = w.push_material("slate", [0.30, 0.34, 0.42], 0.0, 0.5, None);
    let pillar = w.push_mesh("pillar", block, slate);
    for i in 0..PILLARS {
        let s = f64::from(i) / f64::from(PILLARS - 1);
        let angle = PI * (1.0 - s);
        let height = 0.9 + 1.3 * (PI * s).sin().powi(2) + 0.25 * (7.0 * s * PI).cos();
        let position = DVec3::new(4.4 * angle.cos(), 0.5 * height, -0.8 - 3.4 * angle.sin().abs());
        // The middle one is mirrored: an instance whose transform has a negative determinant.
        let half_width = if i == PILLARS / 2 { -0.2 } else { 0.2 };
        w.push_rotated_node(
            &format!("pillar {i}"),
            pillar,
            position,
            DVec3::new(half_width, 0.5 * height, 0.12),
            DQuat::from_rotation_y(angle - 0.5 * PI),
        );
    }
}

/// Adds a circle of small spheres around the mirror.
fn push_beads(w: &mut Writer, sphere: Shape) {
    const BEADS: u32 = 24;
    let amber = w.push_material("amber plastic", [0.90, 0.42, 0.06], 0.0, 0.2, None);
    let bead = w.push_mesh("bead", sphere, amber);
    for i in 0..BEADS {
        let angle = TAU * f64::from(i) / f64::from(BEADS);
        // Every other one is flattened.
        let radii = if i % 2 == 0 {
            DVec3::splat(0.09)
        } else {
            DVec3::new(0.11, 0.05, 0.11)
        };
        let position = DVec3::new(1.3 * angle.cos(), radii.y, 1.3 * angle.sin());
        w.push_node(&format!("bead {i}"), bead, position, radii);
    }
}

impl Writer {
    /// Adds the accessors of a shape.
    fn push_shape(&mut self, t: &Tessellation) -> Shape {
        let flat = |vectors: &[DVec3]| -> Vec<f32> {
            vectors.iter().flat_map(|v| v.to_array()).map(rounded).collect()
        };
        let tex_coords: Vec<f32> = t.tex_coords.iter().flatten().map(|&x| rounded(x)).collect();
        let position = self.push_floats(&flat(&t.positions), 3);
        let normal = self.push_floats(&flat(&t.normals), 3);
        let tex_coord = (!tex_coords.is_empty()).then(|| self.push_floats(&tex_coords, 2));
        let indices: Vec<u8> = t
            .triangles
            .iter()
            .flatten()
            .flat_map(|i| i.to_le_bytes())
            .collect();
        let index = self.push_accessor(
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

    /// Adds an accessor of vectors of `width` numbers and returns its index.
    fn push_floats(&mut self, values: &[f32], width: usize) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        let mut accessor = json!({
            "componentType": 5126, "count": values.len() / width, "type": format!("VEC{width}")
        });
        if width == 3 {
            let axis = |i: usize| values.iter().skip(i).step_by(3).copied();
            accessor["min"] = json!([0, 1, 2].map(|i| axis(i).fold(f32::INFINITY, f32::min)));
            accessor["max"] = json!([0, 1, 2].map(|i| axis(i).fold(f32::NEG_INFINITY, f32::max)));
        }
        self.push_accessor(&bytes, accessor)
    }

    /// Adds an accessor of these bytes and returns its index.
    fn push_accessor(&mut self, bytes: &[u8], mut accessor: Value) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        accessor["bufferView"] = json!(self.views.len());
        self.views
            .push(json!({"buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len()}));
        self.binary.extend_from_slice(bytes);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Adds a material and returns its index; `texture` is the name of its parameter and the index of the texture.
    fn push_material(
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

    /// Adds a black material whose emitted radiance is a texture, and returns its index.
    fn push_emissive_material(&mut self, name: &str, texture: usize) -> usize {
        let material = self.push_material(name, [0.0; 3], 0.0, 1.0, None);
        self.materials[material]["emissiveFactor"] = json!([1, 1, 1]);
        self.materials[material]["emissiveTexture"] = json!({"index": texture});
        material
    }

    /// Adds a mesh and returns its index.
    fn push_mesh(&mut self, name: &str, shape: Shape, material: usize) -> usize {
        let mut attributes = json!({"POSITION": shape.position, "NORMAL": shape.normal});
        if let Some(tex_coord) = shape.tex_coord {
            attributes["TEXCOORD_0"] = json!(tex_coord);
        }
        let primitive = json!({"attributes": attributes, "indices": shape.index, "material": material});
        self.meshes.push(json!({"name": name, "primitives": [primitive]}));
        self.meshes.len() - 1
    }

    /// Adds a sphere with a material of its own, of which `surface` is metallic and roughness.
    fn push_sphere(
        &mut self,
        sphere: Shape,
        name: &str,
        color: [f64; 3],
        surface: [f64; 2],
        position: DVec3,
        radius: f64,
    ) {
        let material = self.push_material(name, color, surface[0], surface[1], None);
        let mesh = self.push_mesh(name, sphere, material);
        self.push_node(name, mesh, position, DVec3::splat(radius));
    }

    /// Adds a node without rotation.
    fn push_node(&mut self, name: &str, mesh: usize, position: DVec3, scale: DVec3) {
        self.push_rotated_node(name, mesh, position, scale, DQuat::IDENTITY);
    }

    /// Adds a node.
    fn push_rotated_node(&mut self, name: &str, mesh: usize, position: DVec3, scale: DVec3, rotation: DQuat) {
        let mut node = json!({"name": name, "mesh": mesh});
        let rounded = |v: &[f64]| v.iter().map(|&x| (x * 1e6).round() / 1e6).collect::<Vec<_>>();
        if position != DVec3::ZERO {
            node["translation"] = json!(rounded(&position.to_array()));
        }
        if rotation != DQuat::IDENTITY {
            node["rotation"] = json!(rounded(&rotation.to_array()));
        }
        if scale != DVec3::ONE {
            node["scale"] = json!(rounded(&scale.to_array()));
        }
        self.nodes.push(node);
    }

    /// Adds a node with a light, turned to `target`.
    fn push_light(&mut self, name: &str, light: usize, position: DVec3, target: DVec3) {
        let mut node = json!({"name": name, "extensions": {"KHR_lights_punctual": {"light": light}}});
        look_at(&mut node, position, target);
        self.nodes.push(node);
    }

    /// Adds a node with the camera, turned to `target`.
    fn push_camera(&mut self, position: DVec3, target: DVec3) {
        let mut node = json!({"name": "camera", "camera": 0});
        look_at(&mut node, position, target);
        self.nodes.push(node);
    }

    /// Returns the document as JSON.
    fn finish(self) -> String {
        let perspective = json!({"yfov": 0.6, "znear": 0.1});
        let node_numbers: Vec<usize> = (0..self.nodes.len()).collect();
        let binary = data_uri("application/octet-stream", &self.binary);
        let members = [
            ("asset", asset()),
            ("extensionsUsed", json!(["KHR_lights_punctual"])),
            ("extensions", json!({"KHR_lights_punctual": {"lights": lights()}})),
            ("scene", json!(0)),
            ("scenes", json!([{"nodes": node_numbers}])),
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
            ("images", images()),
            ("meshes", json!(self.meshes)),
            ("accessors", json!(self.accessors)),
            ("bufferViews", json!(self.views)),
            (
                "buffers",
                json!([{"byteLength": self.binary.len(), "uri": binary}]),
            ),
        ];
        // One item per line, for readable differences between versions.
        let lines = members.map(|(key, value)| match value {
            Value::Array(items) => {
                let items: Vec<String> = items.iter().map(|item| format!("    {item}")).collect();
                format!("  \"{key}\": [\n{}\n  ]", items.join(",\n"))
            }
            other => format!("  \"{key}\": {other}"),
        });
        format!("{{\n{}\n}}\n", lines.join(",\n"))
    }
}

/// Returns the document's `asset`.
fn asset() -> Value {
    let extras = json!({
        "shows": "First light: a mirror, a golden one and plastics under an evening sky",
        "effects": ["shadows", "mirror reflection", "textures", "emission", "instances"],
        "made_by": "cargo run --example tools -- first-light scenes/first_light.gltf"
    });
    json!({"version": "2.0", "generator": "whit first-light", "extras": extras})
}

/// Returns the lights of `KHR_lights_punctual`.
fn lights() -> Value {
    json!([
        {"name": "key", "type": "point", "color": [1.0, 0.93, 0.82], "intensity": 165},
        {"name": "fill", "type": "spot", "color": [0.62, 0.76, 1.0], "intensity": 110,
            "spot": {"innerConeAngle": 0.25, "outerConeAngle": 0.6}},
        {"name": "rim", "type": "point", "color": [1.0, 0.62, 0.38], "intensity": 18}
    ])
}

/// Returns the images of the ground and the sky.
fn images() -> Value {
    let checker = png::encode(
        2,
        &[[196, 190, 178], [92, 104, 122], [92, 104, 122], [196, 190, 178]],
    );
    json!([
        {"name": "checker", "uri": data_uri("image/png", &checker)},
        {"name": "dusk", "uri": data_uri("image/png", &dusk())}
    ])
}

/// Returns bytes of a media type as a URI.
fn data_uri(media_type: &str, bytes: &[u8]) -> String {
    let text = base64::engine::general_purpose::STANDARD.encode(bytes);
    format!("data:{media_type};base64,{text}")
}

/// Rounds to a multiple of 2^-16, so that the last bits of the system's sine do not reach the file.
fn rounded(x: f64) -> f32 {
    ((x * 65536.0).round() / 65536.0) as f32
}

/// Puts a node at `position` and turns its -z, along which cameras and spot lights look, to `target`.
fn look_at(node: &mut Value, position: DVec3, target: DVec3) {
    let back = (position - target).normalize();
    let right = DVec3::Y.cross(back).normalize();
    let rotation = DQuat::from_mat3(&DMat3::from_cols(right, back.cross(right), back));
    node["translation"] = json!(position.to_array());
    node["rotation"] = json!(rotation.to_array().map(|x| (x * 1e9).round() / 1e9));
}

/// Returns the image of the sky, one texel wide: deep blue above, a warm band at the horizon.
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
    png::encode(1, &texels)
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
