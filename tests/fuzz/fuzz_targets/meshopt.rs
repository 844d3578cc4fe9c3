//! Decodes a stream of meshoptimizer's codecs, wrapped into a binary glTF file as the positions or indices of a mesh.
//!
//! The first eight bytes of an input are the mode, the filter, the distance between elements, the version of the
//! extension, and the number of elements in little-endian order; the stream follows.

#![no_main]

use libfuzzer_sys::fuzz_target;
use serde_json::json;
use whit_fuzz::glb::{Glb, document_of};
use whit_fuzz::{InputFolder, expect_valid, load_options, start};

const MODES: [&str; 3] = ["ATTRIBUTES", "TRIANGLES", "INDICES"];
const FILTERS: [&str; 5] = ["NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"];
const EXTENSIONS: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];
/// Largest number of elements, so that all of a mesh's indices can be loaded in time.
const MAX_COUNT: u32 = 1 << 20;
/// Positions that indices refer to: 64 points on a parabola, as three floats each.
const POSITION_COUNT: usize = 64;

fuzz_target!(init: start(), |data: &[u8]| {
    let Some((&[mode, filter, stride, version, a, b, c, d], stream)) = data.split_first_chunk() else {
        return;
    };
    let stride = usize::from(stride);
    let count = u32::from_le_bytes([a, b, c, d]) % MAX_COUNT;
    let mode = MODES[usize::from(mode) % MODES.len()];
    let positions = (0..POSITION_COUNT).flat_map(|i| [i as f32, (i * i) as f32, 0.0]);
    let positions: Vec<u8> = positions.flat_map(f32::to_le_bytes).collect();
    // Name the view's elements as the mode requires: positions, or indices of two or four bytes
    let size = count as usize * stride;
    let view = json!({"buffer": 1, "byteLength": size, "extensions": {
        EXTENSIONS[usize::from(version) % EXTENSIONS.len()]: {
            "buffer": 0, "byteOffset": positions.len(), "byteLength": stream.len(), "byteStride": stride,
            "count": count, "mode": mode, "filter": FILTERS[usize::from(filter) % FILTERS.len()],
        },
    }});
    let points = json!({
        "bufferView": 0, "componentType": 5126, "count": POSITION_COUNT, "type": "VEC3",
    });
    let document = if mode == "ATTRIBUTES" {
        let mut view = view;
        view["byteStride"] = json!(stride);
        // Elements of eight bytes hold shorts, which are positions with quantisation
        let component = if stride < 12 { 5122 } else { 5126 };
        let accessor = json!({"bufferView": 0, "componentType": component, "count": count, "type": "VEC3"});
        let primitive = json!({"attributes": {"POSITION": 0}});
        document_of(primitive, json!([accessor]), json!([view]), &[positions.len() + stream.len(), size])
    } else {
        let component = if stride == 2 { 5123 } else { 5125 };
        let indices = json!({"bufferView": 1, "componentType": component, "count": count, "type": "SCALAR"});
        let primitive = json!({"attributes": {"POSITION": 0}, "indices": 1});
        let positions_view = json!({"buffer": 0, "byteLength": positions.len()});
        let views = json!([positions_view, view]);
        document_of(primitive, json!([points, indices]), views, &[positions.len() + stream.len(), size])
    };
    let glb = Glb::new(&document, &[&positions, stream].concat());
    let folder = InputFolder::new();
    let path = folder.write("input.glb", &glb.bytes());
    if let Ok(scene) = whit::gltf::load(&path, &load_options()) {
        expect_valid(&scene);
    }
});
