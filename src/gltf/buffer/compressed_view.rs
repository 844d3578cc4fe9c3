//! Buffer views that are compressed with meshoptimizer's codecs: `EXT_meshopt_compression` and
//! `KHR_meshopt_compression`, which differ in the versions of their streams only.

use std::sync::Arc;

use serde_json::{Map, Value};

use crate::gltf::GltfError;
use crate::gltf::buffer::BufferRange;
use crate::gltf::buffer::bytes::Bytes;
use crate::gltf::buffer::meshopt::{self, ElementFilter, StreamLayout, StreamMode};
use crate::gltf::document::GltfDocument;
use crate::gltf::error::EXPORT_AGAIN;
use crate::parallel;

/// Names of the extensions.
const NAMES: [&str; 2] = ["KHR_meshopt_compression", "EXT_meshopt_compression"];

impl GltfDocument {
    /// Decodes all compressed views, in parallel. A fault is reported where the view is used.
    pub(in crate::gltf) fn decode_views(&mut self) {
        let views = &self.root.buffer_views;
        let extensions: Vec<Option<&Map<String, Value>>> = views.iter().map(extension).collect();
        if extensions.iter().all(Option::is_none) {
            return;
        }
        let sizes: Vec<usize> = extensions
            .iter()
            .map(|extension| extension.map_or(0, |members| size(members).unwrap_or(0)))
            .collect();
        let decode = |number: usize| extensions[number].map(|members| self.decode_view(number, members));
        self.decoded_views = parallel::map_largest_first(&sizes, &decode);
    }

    fn decode_view(&self, number: usize, members: &Map<String, Value>) -> Result<Bytes, GltfError> {
        let fault = |fault: String| self.fault(format!("buffer view {number}"), fault, EXPORT_AGAIN);
        let Some((layout, range)) = layout(members).zip(range(members)) else {
            return Err(fault("has a compression whose members are invalid".into()));
        };
        let stream = self.range(range, number)?;
        let decoded = meshopt::decode(&layout, stream.bytes).map_err(|error| fault(error.to_string()))?;
        Ok(Bytes::Decoded(Arc::new(decoded)))
    }
}

/// Returns the extension object of a view's compression.
fn extension(view: &gltf::json::buffer::View) -> Option<&Map<String, Value>> {
    let all = &view.extensions.as_ref()?.others;
    NAMES.iter().find_map(|&name| all.get(name)?.as_object())
}

/// Returns the size in bytes of the decoded view as the file states it.
fn size(members: &Map<String, Value>) -> Option<usize> {
    let layout = layout(members)?;
    layout.count.checked_mul(layout.stride)
}

/// Returns the codec, the filter, the number of elements and their size; `None` if a member is invalid.
fn layout(members: &Map<String, Value>) -> Option<StreamLayout> {
    let mode = match members.get("mode")?.as_str()? {
        "ATTRIBUTES" => StreamMode::Attributes,
        "TRIANGLES" => StreamMode::Triangles,
        "INDICES" => StreamMode::Indices,
        _ => return None,
    };
    let filter = match members.get("filter").map_or(Some("NONE"), Value::as_str)? {
        "NONE" => ElementFilter::None,
        "OCTAHEDRAL" => ElementFilter::Octahedral,
        "QUATERNION" => ElementFilter::Quaternion,
        "EXPONENTIAL" => ElementFilter::Exponential,
        "COLOR" => ElementFilter::Color,
        _ => return None,
    };
    let number = |name: &str| usize::try_from(members.get(name)?.as_u64()?).ok();
    Some(StreamLayout {
        mode,
        filter,
        count: number("count")?,
        stride: number("byteStride")?,
    })
}

/// Returns where the compressed bytes are; `None` if a member is invalid.
fn range(members: &Map<String, Value>) -> Option<BufferRange> {
    let number = |name: &str| members.get(name)?.as_u64();
    Some(BufferRange {
        buffer: usize::try_from(number("buffer")?).ok()?,
        offset: match members.contains_key("byteOffset") {
            true => number("byteOffset")?,
            false => 0,
        },
        length: number("byteLength")?,
    })
}

#[cfg(test)]
mod tests {
    use base64::Engine;
    use serde_json::json;

    use super::*;
    use crate::gltf::document::of_json;

    /// Triangles (0, 1, 2) and (0, 2, 3) as a stream of triangles: header; a code of three new vertices and one of a new
    /// vertex on the last edge; table of 16 bytes.
    const TRIANGLES: [u8; 19] = [0xe1, 0xf0, 0, 0, 0x12, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];

    fn document(extension: Value) -> GltfDocument {
        let data = base64::engine::general_purpose::STANDARD.encode(TRIANGLES);
        let mut document = of_json(&json!({
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": TRIANGLES.len(), "uri": format!("data:;base64,{data}")}, {"byteLength": 24}],
            "bufferViews": [{"buffer": 1, "byteLength": 24, "extensions": extension}],
            "accessors": [{"bufferView": 0, "componentType": 5125, "count": 6, "type": "SCALAR"}]
        }));
        document.decode_views();
        document
    }

    fn stream(member: &str, value: Value) -> Value {
        let mut stream = json!({
            "buffer": 0, "byteLength": TRIANGLES.len(), "byteStride": 4, "count": 6, "mode": "TRIANGLES"
        });
        stream[member] = value;
        stream
    }

    #[test]
    fn accessor_of_a_compressed_view_reads_the_decoded_elements() {
        for name in NAMES {
            let document = document(json!({name: stream("filter", json!("NONE"))}));
            let indices = document.accessor(0).unwrap().indices().unwrap();
            assert_eq!(indices, [0, 1, 2, 0, 2, 3]);
        }
    }

    #[test]
    fn fault_of_a_compressed_view_is_reported_on_use() {
        for (member, value, expected) in [
            ("mode", json!("POINTS"), "members are invalid"),
            ("filter", json!(3), "members are invalid"),
            ("byteOffset", json!(-1), "members are invalid"),
            ("byteOffset", json!(1), "past the end of buffer 0"),
            ("buffer", json!(7), "buffer 7"),
            ("count", json!(u64::MAX), "buffer view 0"),
            ("byteStride", json!(3), "buffer view 0"),
            ("byteLength", json!(5), "buffer view 0"),
        ] {
            let document = document(json!({NAMES[0]: stream(member, value)}));
            let fault = document.accessor(0).err().unwrap().to_string();
            assert!(fault.contains(expected), "{member}: {fault}");
        }
    }
}
