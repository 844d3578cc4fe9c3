//! Binary glTF containers: assembly from JSON and bytes, and the reverse.

use serde_json::{Value, json};

/// Types of the chunks: JSON, and binary data.
const CHUNK_TYPES: [&[u8; 4]; 2] = [b"JSON", b"BIN\0"];
/// Number of bytes of the container's header, and of that of a chunk.
const HEADER_BYTES: [usize; 2] = [12, 8];

/// Chunks of a container.
pub struct Glb {
    /// Text of the document.
    pub json: Vec<u8>,
    /// Contents of the first buffer.
    pub binary: Vec<u8>,
}

impl Glb {
    /// Returns the container with a document and its first buffer.
    pub fn new(document: &Value, binary: &[u8]) -> Glb {
        Glb {
            json: document.to_string().into_bytes(),
            binary: binary.to_vec(),
        }
    }

    /// Returns the bytes of the file; the lengths in its headers are right.
    pub fn bytes(mut self) -> Vec<u8> {
        self.json.resize(self.json.len().next_multiple_of(4), b' ');
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let [header, chunk_header] = HEADER_BYTES;
        let length = header + 2 * chunk_header + self.json.len() + self.binary.len();
        let mut bytes = b"glTF".to_vec();
        bytes.extend(2u32.to_le_bytes());
        bytes.extend((length as u32).to_le_bytes());
        for (kind, chunk) in CHUNK_TYPES.into_iter().zip([self.json, self.binary]) {
            bytes.extend((chunk.len() as u32).to_le_bytes());
            bytes.extend(kind);
            bytes.extend(chunk);
        }
        bytes
    }

    /// Returns the chunks of a file; `None` if it does not begin with a chunk of JSON.
    pub fn parse(bytes: &[u8]) -> Option<Glb> {
        let [header, _] = HEADER_BYTES;
        let (json, rest) = chunk(bytes.get(header..)?, CHUNK_TYPES[0])?;
        Some(Glb {
            json: json.to_vec(),
            binary: chunk(rest, CHUNK_TYPES[1]).map_or_else(Vec::new, |(binary, _)| binary.to_vec()),
        })
    }
}

/// Splits off the contents of the first chunk, which must be of type `kind`.
fn chunk<'a>(bytes: &'a [u8], kind: &[u8; 4]) -> Option<(&'a [u8], &'a [u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    let content = rest.strip_prefix(kind)?;
    content.split_at_checked(u32::from_le_bytes(*length) as usize)
}

/// Returns a document with one mesh of one primitive, at one node.
pub fn document_of(primitive: Value, accessors: Value, views: Value, lengths: &[usize]) -> Value {
    let buffers: Vec<Value> = lengths
        .iter()
        .map(|length| json!({"byteLength": length}))
        .collect();
    json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": buffers,
    })
}
