//! The subcommand `neon-knot`: writes the neon tube of `scenes/glow.toml`, a trefoil knot that emits light, as binary
//! glTF.
//!
//! The centre line of the tube runs on a torus, three times around its ring while twice around its axis; the torus'
//! normal is perpendicular to the centre line, so that with it the rings of vertices close without a twist.

use std::f64::consts::TAU;
use std::fs;
use std::io;
use std::path::PathBuf;

use glam::DVec3;

use whit::gltf::write_glb;

/// Rings of vertices along the tube.
const RINGS: u16 = 128;
/// Vertices in a ring.
const SIDES: u16 = 8;
/// Radii of the torus, and of the tube, in metres.
const RADII: [f64; 3] = [0.62, 0.3, 0.055];
/// Emitted radiance, divided by `STRENGTH`.
const COLOR: [f32; 3] = [1.0, 0.16, 0.3];
/// Factor of the emitted radiance.
const STRENGTH: f32 = 4.0;

/// Arguments of `neon-knot`.
#[derive(clap::Args)]
#[command(after_long_help = "\
Example:
  cargo run --release --example tools -- neon-knot scenes/meshes/neon_knot.glb")]
pub(crate) struct Arguments {
    /// The .glb file to write
    #[arg(value_name = "OUT.glb")]
    output: PathBuf,
}

/// Writes the file.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    let path = &arguments.output;
    let written = to_bytes().and_then(|bytes| fs::write(path, bytes));
    written.map_err(|error| {
        format!(
            "{}: cannot be written ({error}): choose another place",
            path.display()
        )
    })
}

/// Returns the point of the centre line at `t` in [0, 1), and the torus' normal there.
fn center_line(t: f64) -> (DVec3, DVec3) {
    let [major, minor, _] = RADII;
    let (sin, cos) = (TAU * 3.0 * t).sin_cos();
    let (side, ahead) = (TAU * 2.0 * t).sin_cos();
    let out = DVec3::new(cos * ahead, cos * side, sin);
    (major * DVec3::new(ahead, side, 0.0) + minor * out, out)
}

/// Returns positions and normals of all vertices, ring by ring.
fn vertices() -> Vec<[DVec3; 2]> {
    let ring = |ring: u16| {
        let at = |step: f64| center_line((f64::from(ring) + step) / f64::from(RINGS));
        let (p, out) = at(0.0);
        // Central differences: their relative error is a few parts in ten thousand.
        let along = (at(0.05).0 - at(-0.05).0).normalize();
        let across = along.cross(out).normalize();
        let out = across.cross(along);
        (0..SIDES).map(move |side| {
            let (sin, cos) = (TAU * f64::from(side) / f64::from(SIDES)).sin_cos();
            let n = cos * out + sin * across;
            [p + RADII[2] * n, n]
        })
    };
    (0..RINGS).flat_map(ring).collect()
}

/// Returns two triangles per face, counter-clockwise as seen from outside.
fn triangles() -> Vec<[u16; 3]> {
    let index = |ring: u16, side: u16| ring % RINGS * SIDES + side % SIDES;
    let face = |ring: u16, side: u16| {
        let [a, b] = [index(ring, side), index(ring + 1, side)];
        let [c, d] = [index(ring + 1, side + 1), index(ring, side + 1)];
        [[a, b, c], [a, c, d]]
    };
    let faces = (0..RINGS).flat_map(|ring| (0..SIDES).map(move |side| (ring, side)));
    faces.flat_map(|(ring, side)| face(ring, side)).collect()
}

/// Returns the whole `.glb`.
fn to_bytes() -> io::Result<Vec<u8>> {
    let vertices = vertices();
    let triangles = triangles();
    let mut binary = Vec::new();
    for attribute in 0..2 {
        for vertex in &vertices {
            let floats = vertex[attribute].as_vec3().to_array();
            binary.extend(floats.into_iter().flat_map(f32::to_le_bytes));
        }
    }
    binary.extend(triangles.as_flattened().iter().flat_map(|i| i.to_le_bytes()));
    let mut glb = Vec::new();
    let document = document(&vertices, triangles.len(), binary.len());
    write_glb(&document, &binary, &mut glb)?;
    Ok(glb)
}

/// Returns the JSON document.
fn document(vertices: &[[DVec3; 2]], triangle_count: usize, byte_count: usize) -> String {
    let (low, high) = vertices
        .iter()
        .fold((DVec3::MAX, DVec3::MIN), |(low, high), [p, _]| {
            (low.min(*p), high.max(*p))
        });
    let [low, high] = [low, high].map(|p| p.as_vec3().to_array());
    let count = vertices.len();
    let (indices, size) = (3 * triangle_count, 12 * count);
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"name":"knot","mesh":0}}],"extensionsUsed":["KHR_materials_emissive_strength"],"materials":[{{"name":"neon","pbrMetallicRoughness":{{"baseColorFactor":[0,0,0,1],"metallicFactor":0}},"emissiveFactor":{COLOR:?},"extensions":{{"KHR_materials_emissive_strength":{{"emissiveStrength":{STRENGTH:?}}}}}}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1}},"indices":2,"material":0}}]}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3","min":{low:?},"max":{high:?}}},{{"bufferView":1,"componentType":5126,"count":{count},"type":"VEC3"}},{{"bufferView":2,"componentType":5123,"count":{indices},"type":"SCALAR"}}],"bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":{size}}},{{"buffer":0,"byteOffset":{size},"byteLength":{size}}},{{"buffer":0,"byteOffset":{},"byteLength":{}}}],"buffers":[{{"byteLength":{byte_count}}}]}}"#,
        2 * size,
        2 * indices,
    )
}
