//! Parsing of glTF documents: the container, the JSON and the version.
//!
//! The content decides the kind of file, not its name. JSON is parsed into the `gltf` crate's types; that crate's
//! importer and validation are not used, and no number in the file is trusted.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use gltf::json;
use serde_json::Value;

use super::GltfError;
use super::buffer::bytes::{Bytes, DecodedAccessor, DecodedView};
use super::buffer::whole_file::read_file;

/// A parsed file with access to its buffers.
pub(super) struct GltfDocument {
    /// Path of the file as the user gave it.
    pub(super) file: PathBuf,
    pub(super) root: json::Root,
    pub(super) binary_chunk: Option<Bytes>,
    pub(super) buffers: Vec<OnceLock<Result<Bytes, GltfError>>>,
    /// Number of the chosen variant of materials; `None` for the materials of the primitives themselves.
    pub(super) variant: Option<usize>,
    /// True if buffers and images may be outside of the folder of the file.
    pub(super) allows_outside: bool,
    /// Contents of compressed buffer views, by their numbers; empty if none is compressed.
    pub(super) decoded_views: Vec<DecodedView>,
    /// Contents of accessors whose meshes are compressed, by the accessors' numbers.
    pub(super) decoded_accessors: HashMap<usize, DecodedAccessor>,
}

impl GltfDocument {
    /// Maps and parses a file. Faults that can be ignored are added to `warnings`.
    pub(super) fn open(file: &Path, warnings: &mut Vec<String>) -> Result<GltfDocument, GltfError> {
        let whole = Bytes::whole(read_file(file)?);
        let (json, binary_chunk) = if whole.starts_with(b"glTF") {
            split_container(&whole).map_err(|fault| not_gltf(file, fault))?
        } else {
            (whole, None)
        };
        let root = parse(&json, warnings).map_err(|fault| not_gltf(file, fault))?;
        let document = GltfDocument {
            file: file.to_owned(),
            buffers: root.buffers.iter().map(|_| OnceLock::new()).collect(),
            root,
            binary_chunk,
            variant: None,
            allows_outside: false,
            decoded_views: Vec::new(),
            decoded_accessors: HashMap::new(),
        };
        document.check_version()?;
        Ok(document)
    }

    /// Returns an error about one item of this file.
    pub(super) fn fault(
        &self,
        item: impl Into<String>,
        fault: impl Into<String>,
        remedy: &'static str,
    ) -> GltfError {
        GltfError::Item {
            file: self.file.clone(),
            item: item.into(),
            fault: fault.into(),
            remedy,
        }
    }

    /// Returns an error about a reference to an item that does not exist.
    pub(super) fn missing(&self, kind: &str, number: usize, count: usize) -> GltfError {
        let fault = format!("does not exist, because the file has {count} of them");
        self.fault(format!("{kind} {number}"), fault, super::error::EXPORT_AGAIN)
    }

    fn check_version(&self) -> Result<(), GltfError> {
        let asset = &self.root.asset;
        let is_two = |version: &str| version.split('.').next() == Some("2");
        let min_is_two = asset.min_version.as_deref().is_none_or(|v| v.trim() == "2.0");
        if is_two(&asset.version) && min_is_two {
            return Ok(());
        }
        let version = match &asset.min_version {
            Some(min) if is_two(&asset.version) => min.clone(),
            _ => asset.version.clone(),
        };
        Err(GltfError::Version {
            file: self.file.clone(),
            version,
        })
    }
}

fn not_gltf(file: &Path, fault: String) -> GltfError {
    GltfError::NotGltf {
        file: file.to_owned(),
        fault,
    }
}

/// Splits a `.glb` into its JSON chunk and its binary chunk (glTF 2.0, section 4.4).
fn split_container(whole: &Bytes) -> Result<(Bytes, Option<Bytes>), String> {
    const HEADER: usize = 12;
    const CHUNK_HEADER: usize = 8;
    const JSON: u32 = u32::from_le_bytes(*b"JSON");
    const BIN: u32 = u32::from_le_bytes(*b"BIN\0");
    let Some((map, start)) = whole.file() else {
        return Err("it is not a file".into());
    };
    // Check the header
    let word = |at: usize| -> Option<u32> {
        let bytes = whole.get(at..at.checked_add(4)?)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?))
    };
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err("it ends within its header".into());
    };
    if version != 2 {
        return Err(format!("its container has version {version}, not 2"));
    }
    let end = length as usize;
    if end > whole.len() {
        return Err(format!(
            "it is truncated: {} bytes of {length} are there",
            whole.len()
        ));
    }
    // Collect the chunks, checking that each ends within the file
    let mut chunks = Vec::new();
    let mut at = HEADER;
    while at + CHUNK_HEADER <= end {
        let (Some(size), Some(kind)) = (word(at), word(at + 4)) else {
            break;
        };
        let content = at + CHUNK_HEADER;
        let Some(next) = content.checked_add(size as usize).filter(|&next| next <= end) else {
            return Err(format!("chunk {} reaches past the end", chunks.len()));
        };
        let range = start + content..start + next;
        chunks.push((
            kind,
            Bytes::File {
                map: map.clone(),
                range,
            },
        ));
        at = next;
    }
    // The first chunk is JSON, the second may be the binary one
    let mut chunks = chunks.into_iter();
    let Some((JSON, json)) = chunks.next() else {
        return Err("its first chunk is not JSON".into());
    };
    let binary = chunks
        .next()
        .filter(|(kind, _)| *kind == BIN)
        .map(|(_, bytes)| bytes);
    Ok((json, binary))
}

/// Parses the JSON; if an optional part of it is invalid, without that part.
fn parse(json: &[u8], warnings: &mut Vec<String>) -> Result<json::Root, String> {
    const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";
    let json = json.strip_prefix(BYTE_ORDER_MARK).unwrap_or(json);
    let first = json.iter().find(|b| !b.is_ascii_whitespace());
    if first != Some(&b'{') {
        return Err("it starts neither with `glTF` nor with a JSON object".into());
    }
    // Retry without parts that are not needed, and with repairs
    json::Root::from_slice(json).or_else(|strict| {
        parse_leniently(json, &["extras"])
            .or_else(|| {
                let root = parse_leniently(json, &["extras", "animations", "skins"])?;
                warnings.push("its animations and skins cannot be read and were ignored".into());
                Some(root)
            })
            .ok_or_else(|| strict.to_string())
    })
}

/// Image index of a texture that has no image, or one in an extension only.
pub(super) const NO_IMAGE: u32 = u32::MAX;

/// Parses the JSON with repairs: the parts in `omitted` are removed, whole numbers may be written with a decimal point,
/// and absent values with a sensible default get it.
fn parse_leniently(json: &[u8], omitted: &[&str]) -> Option<json::Root> {
    let mut root: Value = serde_json::from_slice(json).ok()?;
    let object = root.as_object_mut()?;
    // Remove the parts to spare, and references to them
    for &part in omitted {
        object.remove(part);
    }
    if !object.contains_key("skins") {
        let nodes = object.get_mut("nodes").and_then(Value::as_array_mut);
        for node in nodes.into_iter().flatten().filter_map(Value::as_object_mut) {
            node.remove("skin");
        }
    }
    // Insert defaults that exporters omit
    let defaults = [
        ("scenes", "nodes", Value::Array(Vec::new())),
        ("textures", "source", NO_IMAGE.into()),
    ];
    for (list, key, default) in defaults {
        let items = object.get_mut(list).and_then(Value::as_array_mut);
        for item in items.into_iter().flatten().filter_map(Value::as_object_mut) {
            item.entry(key).or_insert_with(|| default.clone());
        }
    }
    integers_from_floats(&mut root);
    // The document is printed and parsed again, because the `gltf` crate's types hold raw JSON.
    json::Root::from_slice(&serde_json::to_vec(&root).ok()?).ok()
}

/// Replaces `3.0` by `3`, which JSON does not distinguish but the parser's types do. The parser limits the depth.
fn integers_from_floats(value: &mut Value) {
    const EXACT: f64 = 9_007_199_254_740_992.0;
    match value {
        Value::Number(number) => {
            // Beyond 2^53 not every whole number is exact in f64
            let whole = number.as_f64().filter(|x| x.fract() == 0.0 && x.abs() < EXACT);
            if let Some(x) = whole.filter(|_| number.is_f64()) {
                *value = Value::from(x as i64);
            }
        }
        Value::Array(items) => items.iter_mut().for_each(integers_from_floats),
        Value::Object(object) => object.values_mut().for_each(integers_from_floats),
        _ => {}
    }
}

/// Returns a document for tests from its JSON, as if read from `test.gltf`.
#[cfg(test)]
pub(super) fn of_json(root: &Value) -> GltfDocument {
    let root = parse(root.to_string().as_bytes(), &mut Vec::new()).unwrap();
    GltfDocument {
        file: "test.gltf".into(),
        buffers: root.buffers.iter().map(|_| OnceLock::new()).collect(),
        root,
        binary_chunk: None,
        variant: None,
        allows_outside: false,
        decoded_views: Vec::new(),
        decoded_accessors: HashMap::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unused_invalid_part_does_not_reject_the_file() {
        let json = br#"{"asset": {"version": "2.0"}, "animations": 7, "scenes": [{}],
            "textures": [{}], "buffers": [{"byteLength": 12.0}], "nodes": [{"mesh": 0, "skin": 0}]}"#;
        let mut warnings = Vec::new();
        let root = parse(json, &mut warnings).unwrap();
        assert_eq!(
            warnings,
            ["its animations and skins cannot be read and were ignored"]
        );
        assert!(root.nodes[0].skin.is_none());
        assert_eq!(root.buffers[0].byte_length.0, 12);
        assert_eq!(root.textures[0].source.value(), NO_IMAGE as usize);
        assert!(root.scenes[0].nodes.is_empty());
    }

    #[test]
    fn texture_without_image_keeps_animations_and_skins() {
        let json = br#"{"asset": {"version": "2.0"}, "textures": [{}], "skins": [{"joints": [0]}],
            "animations": [{"channels": [], "samplers": []}]}"#;
        let mut warnings = Vec::new();
        let root = parse(json, &mut warnings).unwrap();
        assert_eq!((root.skins.len(), root.animations.len()), (1, 1));
        assert!(warnings.is_empty(), "{warnings:?}");
    }

    #[test]
    fn deeply_nested_json_is_rejected() {
        let json = format!("{{\"asset\": {}", "[".repeat(1_000_000));
        assert!(parse(json.as_bytes(), &mut Vec::new()).is_err());
    }

    #[test]
    fn byte_order_mark_is_skipped() {
        assert!(
            parse(
                b"\xef\xbb\xbf {\"asset\": {\"version\": \"2.0\"}}",
                &mut Vec::new()
            )
            .is_ok()
        );
    }
}
