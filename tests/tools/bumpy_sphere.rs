//! Writes a benchmark mesh of any size: a closed, displaced sphere above a ground plane, with one point light and a
//! camera, as `.glb`.
//!
//! ```text
//! cargo run --release --example bumpy-sphere -- --triangles 2000000 bumpy.glb
//! ```
//!
//! The sphere is a cube of n by n squares a face, blown up: its vertices are shared across all edges, so it is closed,
//! it has no poles, and no triangle is degenerate. `--mirror` makes it a perfect mirror.

use std::f64::consts::FRAC_PI_4;
use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

type Vector = [f64; 3];

/// Bumps: direction and frequency of a plane wave, and its height. Few enough to be quick, with no common period.
const WAVES: [(Vector, f64); 6] = [
    ([4.1, 1.7, -2.3], 0.022),
    ([-2.9, 5.3, 3.1], 0.016),
    ([7.9, -6.1, 4.7], 0.010),
    ([-11.3, 3.7, 13.9], 0.006),
    ([19.1, 23.3, -9.7], 0.0035),
    ([-31.7, -17.9, 37.1], 0.002),
];
/// Half the edge of the ground plane.
const GROUND: f32 = 6.0;
/// Height of the ground: under the lowest bump.
const GROUND_HEIGHT: f32 = -1.02;
/// A `.glb` counts its bytes in 32 bits; this many triangles stay under that.
const MOST_TRIANGLES: u64 = 150_000_000;

struct Arguments {
    triangles: u64,
    mirror: bool,
    output: PathBuf,
}

fn main() -> ExitCode {
    let result = parse_arguments(std::env::args().skip(1)).and_then(|arguments| {
        let glb = container(&arguments);
        write_atomically(&arguments.output, &glb).map_err(|e| {
            format!(
                "{}: cannot be written ({e}): choose another place",
                arguments.output.display()
            )
        })
    });
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(sentence) => {
            eprintln!("{sentence}");
            ExitCode::from(2)
        }
    }
}

fn parse_arguments(mut words: impl Iterator<Item = String>) -> Result<Arguments, String> {
    const USAGE: &str = "usage: bumpy-sphere [--triangles N] [--mirror] OUT.glb";
    let mut triangles = 2_000_000;
    let mut mirror = false;
    let mut output = None;
    while let Some(word) = words.next() {
        match word.as_str() {
            "--triangles" => {
                let number = words.next().and_then(|n| n.replace('_', "").parse().ok());
                triangles = number
                    .filter(|n| (12..=MOST_TRIANGLES).contains(n))
                    .ok_or(format!(
                        "--triangles takes a number from 12 to {MOST_TRIANGLES}: {USAGE}"
                    ))?;
            }
            "--mirror" => mirror = true,
            _ if word.starts_with('-') => return Err(format!("`{word}` is not an option: {USAGE}")),
            _ if output.is_some() => return Err(format!("`{word}` is one file too many: {USAGE}")),
            _ => output = Some(PathBuf::from(word)),
        }
    }
    Ok(Arguments {
        triangles,
        mirror,
        output: output.ok_or(format!("no file to write: {USAGE}"))?,
    })
}

/// The whole `.glb`.
fn container(arguments: &Arguments) -> Vec<u8> {
    let edge = ((arguments.triangles as f64 / 12.0).sqrt().round() as u32).max(1);
    let sphere = Sphere::tessellated(edge);
    let ground = ground();
    let mut binary = Vec::new();
    let mut views = Vec::new();
    for bytes in [
        &sphere.positions,
        &sphere.normals,
        &sphere.indices,
        &ground.positions,
        &ground.normals,
        &ground.indices,
    ] {
        views.push((binary.len(), bytes.len()));
        binary.extend_from_slice(bytes);
    }
    let mut json = document(&[sphere, ground], &views, arguments.mirror);
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

/// A mesh as the bytes of its accessors.
#[derive(Default)]
struct Bytes {
    positions: Vec<u8>,
    normals: Vec<u8>,
    indices: Vec<u8>,
    low: [f32; 3],
    high: [f32; 3],
}

impl Bytes {
    fn push_vertex(&mut self, position: [f32; 3], normal: [f32; 3]) {
        if self.positions.is_empty() {
            (self.low, self.high) = (position, position);
        }
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(position[axis]);
            self.high[axis] = self.high[axis].max(position[axis]);
            self.positions.extend_from_slice(&position[axis].to_le_bytes());
            self.normals.extend_from_slice(&normal[axis].to_le_bytes());
        }
    }

    fn push_triangle(&mut self, triangle: [u32; 3]) {
        for vertex in triangle {
            self.indices.extend_from_slice(&vertex.to_le_bytes());
        }
    }
}

/// The lattice points of the surface of a cube of `edge` squares an edge, numbered.
struct Sphere {
    edge: u32,
}

impl Sphere {
    /// All vertices and triangles.
    fn tessellated(edge: u32) -> Bytes {
        let sphere = Sphere { edge };
        let mut bytes = Bytes::default();
        sphere.for_each_point(|point| {
            let (position, normal) = bumpy(sphere.direction(point));
            bytes.push_vertex(position.map(|x| x as f32), normal.map(|x| x as f32));
        });
        // Each face by its fixed axis and side; the other two axes follow in cyclic order, so that u x v points along
        // the axis and the winding is outward on the far side.
        for axis in 0..3 {
            for far in [false, true] {
                for v in 0..edge {
                    for u in 0..edge {
                        let corner = |du: u32, dv: u32| {
                            let mut point = [0; 3];
                            point[axis] = if far { edge } else { 0 };
                            point[(axis + 1) % 3] = u + du;
                            point[(axis + 2) % 3] = v + dv;
                            sphere.number(point)
                        };
                        let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                        let (first, second) = ([a, b, c], [a, c, d]);
                        let turned = |[a, b, c]: [u32; 3]| if far { [a, b, c] } else { [a, c, b] };
                        bytes.push_triangle(turned(first));
                        bytes.push_triangle(turned(second));
                    }
                }
            }
        }
        bytes
    }

    /// Every surface point once, in the order of [`Sphere::number`].
    fn for_each_point(&self, mut visit: impl FnMut([u32; 3])) {
        let n = self.edge;
        for z in [0, n] {
            for y in 0..=n {
                for x in 0..=n {
                    visit([x, y, z]);
                }
            }
        }
        for z in 1..n {
            (0..n).for_each(|i| visit([i, 0, z]));
            (0..n).for_each(|i| visit([n, i, z]));
            (0..n).for_each(|i| visit([n - i, n, z]));
            (0..n).for_each(|i| visit([0, n - i, z]));
        }
    }

    /// The number of a surface point: bottom, top, then rings around the sides.
    fn number(&self, [x, y, z]: [u32; 3]) -> u32 {
        let n = self.edge;
        let lid = (n + 1) * (n + 1);
        if z == 0 {
            return y * (n + 1) + x;
        }
        if z == n {
            return lid + y * (n + 1) + x;
        }
        let around = if y == 0 && x < n {
            x
        } else if x == n && y < n {
            n + y
        } else if y == n && x > 0 {
            2 * n + (n - x)
        } else {
            3 * n + (n - y)
        };
        2 * lid + (z - 1) * 4 * n + around
    }

    /// The direction of a surface point; the tangent evens out the triangles.
    fn direction(&self, point: [u32; 3]) -> Vector {
        let warped = point.map(|i| (FRAC_PI_4 * (2.0 * f64::from(i) / f64::from(self.edge) - 1.0)).tan());
        normalized(warped)
    }
}

/// Point and normal of the surface p = r(d) d: the normal is r d minus the tangential gradient of r.
fn bumpy(d: Vector) -> (Vector, Vector) {
    let mut radius = 1.0;
    let mut gradient = [0.0; 3];
    for (k, height) in WAVES {
        let phase = dot(k, d);
        radius += height * phase.sin();
        for axis in 0..3 {
            gradient[axis] += height * phase.cos() * k[axis];
        }
    }
    let along = dot(gradient, d);
    let normal = [0, 1, 2].map(|axis| radius * d[axis] - (gradient[axis] - along * d[axis]));
    (d.map(|x| radius * x), normalized(normal))
}

fn ground() -> Bytes {
    let mut bytes = Bytes::default();
    for [x, z] in [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]] {
        bytes.push_vertex([GROUND * x, GROUND_HEIGHT, GROUND * z], [0.0, 1.0, 0.0]);
    }
    bytes.push_triangle([0, 1, 2]);
    bytes.push_triangle([0, 2, 3]);
    bytes
}

fn document(meshes: &[Bytes], views: &[(usize, usize)], mirror: bool) -> String {
    let (metallic, roughness, color) = if mirror {
        (1, "0", "[0.95, 0.93, 0.88, 1]")
    } else {
        (0, "0.6", "[0.80, 0.42, 0.25, 1]")
    };
    let mut accessors = String::new();
    for (i, mesh) in meshes.iter().enumerate() {
        let vertices = mesh.positions.len() / 12;
        let indices = mesh.indices.len() / 4;
        let first = 3 * i;
        let comma = if i == 0 { "" } else { "," };
        // Writing into a string cannot fail.
        let _ = write!(
            accessors,
            r#"{comma}{{"bufferView":{first},"componentType":5126,"count":{vertices},"type":"VEC3","min":{:?},"max":{:?}}},"#,
            mesh.low, mesh.high
        );
        let _ = write!(
            accessors,
            r#"{{"bufferView":{},"componentType":5126,"count":{vertices},"type":"VEC3"}},{{"bufferView":{},"componentType":5125,"count":{indices},"type":"SCALAR"}}"#,
            first + 1,
            first + 2
        );
    }
    let buffer_views: Vec<String> = views
        .iter()
        .enumerate()
        .map(|(i, (offset, length))| {
            let target = if i % 3 == 2 { 34963 } else { 34962 };
            format!(r#"{{"buffer":0,"byteOffset":{offset},"byteLength":{length},"target":{target}}}"#)
        })
        .collect();
    let total: usize = views.iter().map(|(_, length)| length).sum();
    let mesh = |first: usize, material: usize, name: &str| {
        format!(
            r#"{{"name":"{name}","primitives":[{{"attributes":{{"POSITION":{first},"NORMAL":{}}},"indices":{},"material":{material}}}]}}"#,
            first + 1,
            first + 2
        )
    };
    format!(
        r#"{{"asset":{{"version":"2.0","generator":"bumpy-sphere"}},
"extensionsUsed":["KHR_lights_punctual"],
"extensions":{{"KHR_lights_punctual":{{"lights":[{{"name":"lamp","type":"point","color":[1,0.96,0.9],"intensity":75}}]}}}},
"scene":0,"scenes":[{{"nodes":[0,1,2,3]}}],
"nodes":[{{"name":"sphere","mesh":0}},{{"name":"ground","mesh":1}},
{{"name":"lamp","translation":[2.6,3.6,3.2],"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}},
{{"name":"camera","camera":0,"matrix":{}}}],
"cameras":[{{"name":"camera","type":"perspective","perspective":{{"yfov":0.7,"znear":0.01}}}}],
"materials":[{{"name":"sphere","pbrMetallicRoughness":{{"baseColorFactor":{color},"metallicFactor":{metallic},"roughnessFactor":{roughness}}}}},
{{"name":"ground","pbrMetallicRoughness":{{"baseColorFactor":[0.45,0.50,0.55,1],"metallicFactor":0,"roughnessFactor":0.9}}}}],
"meshes":[{},{}],
"accessors":[{accessors}],
"bufferViews":[{}],
"buffers":[{{"byteLength":{total}}}]}}"#,
        look_at([1.1, 1.3, 3.9], [0.05, -0.12, 0.0]),
        mesh(0, 0, "bumpy sphere"),
        mesh(3, 1, "ground"),
        buffer_views.join(",")
    )
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

/// Writes beside the target and renames, so that the target is never half a file.
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

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn normalized(a: Vector) -> Vector {
    let length = dot(a, a).sqrt();
    a.map(|x| x / length)
}
