//! Decodes a Draco stream, wrapped into a binary glTF file as a compressed primitive.
//!
//! The first twelve bytes of an input are the numbers of points and of indices that the accessors state, in
//! little-endian order, and the identities of the attributes; the stream follows.

#![no_main]

use libfuzzer_sys::fuzz_target;
use serde_json::{Map, Value, json};
use whit_fuzz::glb::{Glb, document_of};
use whit_fuzz::{InputFolder, expect_valid, load_options, start};

/// Attributes of the primitive, with the types and components of their accessors.
const ATTRIBUTES: [(&str, &str, u32); 4] = [
    ("POSITION", "VEC3", 5126),
    ("NORMAL", "VEC3", 5126),
    ("TEXCOORD_0", "VEC2", 5126),
    ("COLOR_0", "VEC4", 5121),
];
/// Identity that leaves an attribute out.
const ABSENT: u8 = 0xff;

fuzz_target!(init: start(), |data: &[u8]| {
    let Some((header, stream)) = data.split_first_chunk::<12>() else {
        return;
    };
    let &[points, indices, ids] = header.as_chunks::<4>().0 else {
        return;
    };
    let [point_count, index_count] = [points, indices].map(u32::from_le_bytes);
    // List the attributes that are present
    let mut accessors = vec![json!({"componentType": 5125, "count": index_count, "type": "SCALAR"})];
    let (mut attributes, mut unique_ids) = (Map::new(), Map::new());
    for ((name, kind, component), id) in ATTRIBUTES.into_iter().zip(ids) {
        if id == ABSENT {
            continue;
        }
        attributes.insert(name.into(), json!(accessors.len()));
        unique_ids.insert(name.into(), json!(id));
        accessors.push(json!({
            "componentType": component, "count": point_count, "type": kind, "normalized": component == 5121,
        }));
    }
    let primitive = json!({"attributes": attributes, "indices": 0, "extensions": {
        "KHR_draco_mesh_compression": {"bufferView": 0, "attributes": unique_ids},
    }});
    let views = json!([{"buffer": 0, "byteLength": stream.len()}]);
    let document = document_of(primitive, Value::Array(accessors), views, &[stream.len()]);
    let folder = InputFolder::new();
    let path = folder.write("input.glb", &Glb::new(&document, stream).bytes());
    if let Ok(scene) = whit::gltf::load(&path, &load_options()) {
        expect_valid(&scene);
    }
});
