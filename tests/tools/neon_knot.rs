//! Bends the neon tube of `scenes/glow.toml`: a trefoil knot that shines.
//!
//! `cargo run --release --example neon-knot -- scenes/meshes/neon_knot.glb` writes it as binary glTF. The middle of the
//! tube runs on a torus, three times around its own ring while twice around its axis; there the torus' normal is at a
//! right angle to the way, so that with it the rings of corners close without a twist.

use std::f64::consts::TAU;
use std::fs;

use glam::DVec3;

/// Rings of corners along the tube.
const RINGS: u16 = 128;
/// Corners around it.
const SIDES: u16 = 8;
/// Radii of the torus, and of the tube, in metres.
const RADII: [f64; 3] = [0.62, 0.3, 0.055];
/// Emitted radiance: the colour times the strength.
const COLOR: [f32; 3] = [1.0, 0.16, 0.3];
const STRENGTH: f32 = 4.0;

fn main() {
    let Some(path) = std::env::args_os().nth(1) else {
        eprintln!("give the file to write: cargo run --example neon-knot -- neon_knot.glb");
        std::process::exit(2);
    };
    if let Err(error) = fs::write(&path, container()) {
        eprintln!("{} cannot be written ({error})", path.display());
        std::process::exit(1);
    }
}

/// The middle of the tube at the turn `t`, and the torus' normal there.
fn middle(t: f64) -> (DVec3, DVec3) {
    let [major, minor, _] = RADII;
    let (sin, cos) = (TAU * 3.0 * t).sin_cos();
    let (side, ahead) = (TAU * 2.0 * t).sin_cos();
    let out = DVec3::new(cos * ahead, cos * side, sin);
    (major * DVec3::new(ahead, side, 0.0) + minor * out, out)
}

/// Positions and normals of all corners, ring by ring.
fn corners() -> Vec<[DVec3; 2]> {
    let ring = |ring: u16| {
        let at = |step: f64| middle((f64::from(ring) + step) / f64::from(RINGS));
        let (p, out) = at(0.0);
        // By differences to both sides, which are off by a part in some thousands.
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

/// Two triangles a face, their fronts outside.
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

/// The whole `.glb`.
fn container() -> Vec<u8> {
    let corners = corners();
    let triangles = triangles();
    let mut binary = Vec::new();
    for which in 0..2 {
        for corner in &corners {
            let floats = corner[which].as_vec3().to_array();
            binary.extend(floats.into_iter().flat_map(f32::to_le_bytes));
        }
    }
    binary.extend(triangles.as_flattened().iter().flat_map(|i| i.to_le_bytes()));
    let mut json = document(&corners, triangles.len(), binary.len());
    json.push_str(&" ".repeat(json.len().next_multiple_of(4) - json.len()));
    binary.resize(binary.len().next_multiple_of(4), 0);
    let total = 12 + 8 + json.len() + 8 + binary.len();
    let mut glb = b"glTF".to_vec();
    for word in [2, total as u32] {
        glb.extend_from_slice(&word.to_le_bytes());
    }
    push_chunk(&mut glb, b"JSON", json.as_bytes());
    push_chunk(&mut glb, b"BIN\0", &binary);
    glb
}

fn push_chunk(glb: &mut Vec<u8>, name: &[u8; 4], bytes: &[u8]) {
    glb.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
    glb.extend_from_slice(name);
    glb.extend_from_slice(bytes);
}

fn document(corners: &[[DVec3; 2]], triangles: usize, bytes: usize) -> String {
    let (low, high) = corners
        .iter()
        .fold((DVec3::MAX, DVec3::MIN), |(low, high), [p, _]| {
            (low.min(*p), high.max(*p))
        });
    let [low, high] = [low, high].map(|p| p.as_vec3().to_array());
    let count = corners.len();
    let (indices, size) = (3 * triangles, 12 * count);
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"name":"knot","mesh":0}}],"extensionsUsed":["KHR_materials_emissive_strength"],"materials":[{{"name":"neon","pbrMetallicRoughness":{{"baseColorFactor":[0,0,0,1],"metallicFactor":0}},"emissiveFactor":{COLOR:?},"extensions":{{"KHR_materials_emissive_strength":{{"emissiveStrength":{STRENGTH:?}}}}}}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1}},"indices":2,"material":0}}]}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3","min":{low:?},"max":{high:?}}},{{"bufferView":1,"componentType":5126,"count":{count},"type":"VEC3"}},{{"bufferView":2,"componentType":5123,"count":{indices},"type":"SCALAR"}}],"bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":{size}}},{{"buffer":0,"byteOffset":{size},"byteLength":{size}}},{{"buffer":0,"byteOffset":{},"byteLength":{}}}],"buffers":[{{"byteLength":{bytes}}}]}}"#,
        2 * size,
        2 * indices,
    )
}
