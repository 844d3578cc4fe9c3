//! Binary glTF: files of meshes with a point light and a camera for the tools that
//! write benchmark meshes.

use std::fmt::Write as _;
use std::fs;
use std::io::{self, Write as _};
use std::path::Path;

use whit::gltf::write_glb;

/// A position or a direction.
pub(crate) type Vector = [f64; 3];

/// A mesh as the bytes of its accessors.
#[derive(Default)]
pub(crate) struct Mesh {
    positions: Vec<u8>,
    /// None, or one per vertex.
    normals: Vec<u8>,
    indices: Vec<u8>,
    low: [f32; 3],
    high: [f32; 3],
}

impl Mesh {
    /// Adds a vertex and returns its index.
    pub(crate) fn push_vertex(&mut self, position: Vector) -> u32 {
        let position = position.map(|x| x as f32);
        if self.positions.is_empty() {
            (self.low, self.high) = (position, position);
        }
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(position[axis]);
            self.high[axis] = self.high[axis].max(position[axis]);
            self.positions.extend_from_slice(&position[axis].to_le_bytes());
        }
        self.vertex_count() - 1
    }

    /// Adds the normal of the next vertex that has none.
    pub(crate) fn push_normal(&mut self, normal: Vector) {
        for x in normal {
            self.normals.extend_from_slice(&(x as f32).to_le_bytes());
        }
    }

    /// Adds a triangle, given by the indices of its vertices.
    pub(crate) fn push_triangle(&mut self, triangle: [u32; 3]) {
        for vertex in triangle {
            self.indices.extend_from_slice(&vertex.to_le_bytes());
        }
    }

    /// Returns the number of vertices.
    pub(crate) fn vertex_count(&self) -> u32 {
        (self.positions.len() / 12) as u32
    }

    /// Returns the number of triangles.
    pub(crate) fn triangle_count(&self) -> usize {
        self.indices.len() / 12
    }
}

/// A mesh with its material.
pub(crate) struct Part {
    pub(crate) name: &'static str,
    pub(crate) mesh: Mesh,
    /// Linear RGB base colour.
    pub(crate) color: [f64; 3],
    pub(crate) metallic: f64,
    pub(crate) roughness: f64,
}

/// Meshes with a point light and a camera.
pub(crate) struct GlbScene {
    pub(crate) parts: Vec<Part>,
    /// Position of the camera.
    pub(crate) eye: Vector,
    /// Point that the camera looks at.
    pub(crate) target: Vector,
    /// Position of the light.
    pub(crate) light: Vector,
    /// Intensity of the light in candela.
    pub(crate) intensity: f64,
}

/// Range of bytes in the binary chunk.
struct BufferView {
    offset: usize,
    length: usize,
    /// OpenGL's number for vertex or index data.
    target: u32,
}

/// OpenGL's `ARRAY_BUFFER`.
const VERTEX_DATA: u32 = 34962;
/// OpenGL's `ELEMENT_ARRAY_BUFFER`.
const INDEX_DATA: u32 = 34963;

impl GlbScene {
    /// Writes the scene beside the target and renames it, so that the target is never an incomplete file.
    pub(crate) fn write(&self, target: &Path) -> Result<(), String> {
        let written = self.to_bytes().and_then(|bytes| write_atomically(target, &bytes));
        written.map_err(|e| {
            format!(
                "{}: cannot be written ({e}): choose another place",
                target.display()
            )
        })
    }

    /// Returns the whole `.glb`.
    fn to_bytes(&self) -> io::Result<Vec<u8>> {
        let mut binary = Vec::new();
        let mut views = Vec::new();
        for Part { mesh, .. } in &self.parts {
            for (bytes, target) in [
                (&mesh.positions, VERTEX_DATA),
                (&mesh.normals, VERTEX_DATA),
                (&mesh.indices, INDEX_DATA),
            ] {
                if !bytes.is_empty() {
                    views.push(BufferView {
                        offset: binary.len(),
                        length: bytes.len(),
                        target,
                    });
                    binary.extend_from_slice(bytes);
                }
            }
        }
        let mut glb = Vec::new();
        write_glb(&self.document(&views), &binary, &mut glb)?;
        Ok(glb)
    }

    /// Returns the JSON document.
    fn document(&self, views: &[BufferView]) -> String {
        let mut lists = Lists::default();
        for part in &self.parts {
            lists.push_part(part);
        }
        let [x, y, z] = self.light;
        lists.nodes.push(format!(
            r#"{{"name":"lamp","translation":[{x},{y},{z}],"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}}"#
        ));
        lists.nodes.push(format!(
            r#"{{"name":"camera","camera":0,"matrix":{}}}"#,
            look_at(self.eye, self.target)
        ));
        let numbers: Vec<String> = (0..lists.nodes.len()).map(|n| n.to_string()).collect();
        let buffer_views = views.iter().map(|view| {
            let (offset, length, target) = (view.offset, view.length, view.target);
            format!(r#"{{"buffer":0,"byteOffset":{offset},"byteLength":{length},"target":{target}}}"#)
        });
        let total: usize = views.iter().map(|view| view.length).sum();
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
            lists.nodes.join(",\n"),
            lists.materials.join(",\n"),
            lists.meshes.join(",\n"),
            lists.accessors.join(","),
            buffer_views.collect::<Vec<_>>().join(","),
        )
    }
}

/// Items of the document's lists, each as JSON.
#[derive(Default)]
struct Lists {
    nodes: Vec<String>,
    accessors: Vec<String>,
    materials: Vec<String>,
    meshes: Vec<String>,
}

impl Lists {
    /// Adds a node with its mesh, material and accessors.
    fn push_part(&mut self, part: &Part) {
        let Part {
            name,
            mesh,
            color: [r, g, b],
            metallic,
            roughness,
        } = part;
        let number = self.nodes.len();
        let count = mesh.vertex_count();
        let first = self.accessors.len();
        let mut attributes = format!(r#""POSITION":{first}"#);
        self.accessors.push(format!(
            r#"{{"bufferView":{first},"componentType":5126,"count":{count},"type":"VEC3","min":{:?},"max":{:?}}}"#,
            mesh.low, mesh.high
        ));
        if !mesh.normals.is_empty() {
            let view = self.accessors.len();
            // Writing into a string cannot fail.
            let _ = write!(attributes, r#","NORMAL":{view}"#);
            self.accessors.push(format!(
                r#"{{"bufferView":{view},"componentType":5126,"count":{count},"type":"VEC3"}}"#
            ));
        }
        let view = self.accessors.len();
        let index_count = mesh.indices.len() / 4;
        self.accessors.push(format!(
            r#"{{"bufferView":{view},"componentType":5125,"count":{index_count},"type":"SCALAR"}}"#
        ));
        self.nodes.push(format!(r#"{{"name":"{name}","mesh":{number}}}"#));
        self.materials.push(format!(
            r#"{{"name":"{name}","pbrMetallicRoughness":{{"baseColorFactor":[{r},{g},{b},1],"metallicFactor":{metallic},"roughnessFactor":{roughness}}}}}"#
        ));
        self.meshes.push(format!(
            r#"{{"name":"{name}","primitives":[{{"attributes":{{{attributes}}},"indices":{view},"material":{number}}}]}}"#
        ));
    }
}

/// Returns the column-major matrix of a camera at `eye` that looks at `target`, as JSON.
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

/// Writes a temporary file beside the target and renames it.
fn write_atomically(target: &Path, bytes: &[u8]) -> io::Result<()> {
    let name = target.file_name().ok_or(io::ErrorKind::InvalidInput)?;
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

/// Returns the dot product.
fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the cross product.
pub(crate) fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Returns the vector of length 1 in the direction of `a`.
pub(crate) fn normalized(a: Vector) -> Vector {
    let length = dot(a, a).sqrt();
    a.map(|x| x / length)
}
