//! Meshes, a lamp and a camera as a `.glb`, for the tools that write meshes to measure with.

#![allow(dead_code, unreachable_pub, reason = "each tool uses a part of it")]

use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::Path;

/// A place or a direction.
pub type Vector = [f64; 3];

/// A mesh as the bytes of its accessors.
#[derive(Default)]
pub struct Mesh {
    pub positions: Vec<u8>,
    /// None, or one a vertex.
    pub normals: Vec<u8>,
    pub indices: Vec<u8>,
    low: [f32; 3],
    high: [f32; 3],
}

impl Mesh {
    /// Adds a vertex and says which it is.
    pub fn push_vertex(&mut self, position: Vector) -> u32 {
        let position = position.map(|x| x as f32);
        if self.positions.is_empty() {
            (self.low, self.high) = (position, position);
        }
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(position[axis]);
            self.high[axis] = self.high[axis].max(position[axis]);
            self.positions.extend_from_slice(&position[axis].to_le_bytes());
        }
        (self.positions.len() / 12 - 1) as u32
    }

    /// Adds the normal of a vertex.
    pub fn push_normal(&mut self, normal: Vector) {
        for x in normal {
            self.normals.extend_from_slice(&(x as f32).to_le_bytes());
        }
    }

    /// Adds a triangle.
    pub fn push_triangle(&mut self, triangle: [u32; 3]) {
        for vertex in triangle {
            self.indices.extend_from_slice(&vertex.to_le_bytes());
        }
    }

    /// How many triangles there are.
    pub fn triangle_count(&self) -> usize {
        self.indices.len() / 12
    }
}

/// A mesh and how it looks.
pub struct Part {
    pub name: &'static str,
    pub mesh: Mesh,
    pub color: [f64; 3],
    pub metallic: f64,
    pub roughness: f64,
}

/// What is seen, from where, in what light.
pub struct Picture {
    pub parts: Vec<Part>,
    pub eye: Vector,
    pub target: Vector,
    /// Where a point light is.
    pub lamp: Vector,
    /// In candela.
    pub intensity: f64,
}

impl Picture {
    /// The whole `.glb`.
    pub fn container(&self) -> Vec<u8> {
        let mut binary = Vec::new();
        let mut views = Vec::new();
        for Part { mesh, .. } in &self.parts {
            let [positions, normals, indices] = [&mesh.positions, &mesh.normals, &mesh.indices];
            for (bytes, target) in [(positions, 34962), (normals, 34962), (indices, 34963)] {
                if !bytes.is_empty() {
                    views.push((binary.len(), bytes.len(), target));
                    binary.extend_from_slice(bytes);
                }
            }
        }
        let mut json = self.document(&views);
        json.push_str(&" ".repeat(json.len().next_multiple_of(4) - json.len()));
        let total = 12 + 8 + json.len() + 8 + binary.len();
        let mut glb = Vec::with_capacity(total);
        let word = |glb: &mut Vec<u8>, n: usize| glb.extend_from_slice(&(n as u32).to_le_bytes());
        glb.extend_from_slice(b"glTF");
        word(&mut glb, 2);
        word(&mut glb, total);
        word(&mut glb, json.len());
        glb.extend_from_slice(b"JSON");
        glb.extend_from_slice(json.as_bytes());
        word(&mut glb, binary.len());
        glb.extend_from_slice(b"BIN\0");
        glb.extend_from_slice(&binary);
        glb
    }

    fn document(&self, views: &[(usize, usize, u32)]) -> String {
        let (mut nodes, mut accessors) = (Vec::new(), Vec::new());
        let (mut materials, mut meshes) = (Vec::new(), Vec::new());
        for (number, part) in self.parts.iter().enumerate() {
            let Part {
                name,
                mesh,
                color: [r, g, b],
                metallic,
                roughness,
            } = part;
            let count = mesh.positions.len() / 12;
            let first = accessors.len();
            let mut attributes = format!(r#""POSITION":{first}"#);
            accessors.push(format!(
                r#"{{"bufferView":{first},"componentType":5126,"count":{count},"type":"VEC3","min":{:?},"max":{:?}}}"#,
                mesh.low, mesh.high
            ));
            if !mesh.normals.is_empty() {
                let view = accessors.len();
                // Writing into a string cannot fail.
                let _ = write!(attributes, r#","NORMAL":{view}"#);
                accessors.push(format!(
                    r#"{{"bufferView":{view},"componentType":5126,"count":{count},"type":"VEC3"}}"#
                ));
            }
            let view = accessors.len();
            let index_count = mesh.indices.len() / 4;
            accessors.push(format!(
                r#"{{"bufferView":{view},"componentType":5125,"count":{index_count},"type":"SCALAR"}}"#
            ));
            nodes.push(format!(r#"{{"name":"{name}","mesh":{number}}}"#));
            materials.push(format!(
                r#"{{"name":"{name}","pbrMetallicRoughness":{{"baseColorFactor":[{r},{g},{b},1],"metallicFactor":{metallic},"roughnessFactor":{roughness}}}}}"#
            ));
            meshes.push(format!(
                r#"{{"name":"{name}","primitives":[{{"attributes":{{{attributes}}},"indices":{view},"material":{number}}}]}}"#
            ));
        }
        let [x, y, z] = self.lamp;
        nodes.push(format!(
            r#"{{"name":"lamp","translation":[{x},{y},{z}],"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}}"#
        ));
        nodes.push(format!(
            r#"{{"name":"camera","camera":0,"matrix":{}}}"#,
            look_at(self.eye, self.target)
        ));
        let numbers: Vec<String> = (0..nodes.len()).map(|n| n.to_string()).collect();
        let buffer_views = views.iter().map(|(offset, length, target)| {
            format!(r#"{{"buffer":0,"byteOffset":{offset},"byteLength":{length},"target":{target}}}"#)
        });
        let total: usize = views.iter().map(|(_, length, _)| length).sum();
        format!(
            r#"{{"asset":{{"version":"2.0","generator":"whit's tools"}},
"extensionsUsed":["KHR_lights_punctual"],
"extensions":{{"KHR_lights_punctual":{{"lights":[{{"name":"lamp","type":"point","color":[1,0.96,0.9],"intensity":{}}}]}}}},
"scene":0,"scenes":[{{"nodes":[{}]}}],
"nodes":[{}],
"cameras":[{{"name":"camera","type":"perspective","perspective":{{"yfov":0.7,"znear":0.01}}}}],
"materials":[{}],
"meshes":[{}],
"accessors":[{}],
"bufferViews":[{}],
"buffers":[{{"byteLength":{total}}}]}}"#,
            self.intensity,
            numbers.join(","),
            nodes.join(",\n"),
            materials.join(",\n"),
            meshes.join(",\n"),
            accessors.join(","),
            buffer_views.collect::<Vec<_>>().join(","),
        )
    }

    /// Writes the `.glb` beside the target and renames it, so that the target is never half a file.
    ///
    /// # Errors
    ///
    /// A sentence, where it cannot be written.
    pub fn write(&self, target: &Path) -> Result<(), String> {
        write_atomically(target, &self.container()).map_err(|e| {
            format!(
                "{}: cannot be written ({e}): choose another place",
                target.display()
            )
        })
    }
}

/// The column-major matrix of a camera at `eye` that looks at `target`.
fn look_at(eye: Vector, target: Vector) -> String {
    let back = normalized([0, 1, 2].map(|i| eye[i] - target[i]));
    let right = normalized(cross([0.0, 1.0, 0.0], back));
    let up = cross(back, right);
    let columns = [(right, 0), (up, 0), (back, 0), (eye, 1)];
    let words: Vec<String> = columns
        .iter()
        .map(|([x, y, z], w)| format!("{x:.9},{y:.9},{z:.9},{w}"))
        .collect();
    format!("[{}]", words.join(","))
}

fn write_atomically(target: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let name = target.file_name().ok_or(std::io::ErrorKind::InvalidInput)?;
    let mut temporary = name.to_owned();
    temporary.push(format!(".{}.part", std::process::id()));
    let temporary = target.with_file_name(temporary);
    let written = fs::File::create(&temporary)
        .and_then(|mut file| file.write_all(bytes))
        .and_then(|()| fs::rename(&temporary, target));
    if written.is_err() {
        // The first error is the one to report.
        let _ = fs::remove_file(&temporary);
    }
    written
}

pub fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

pub fn normalized(a: Vector) -> Vector {
    let length = dot(a, a).sqrt();
    a.map(|x| x / length)
}
