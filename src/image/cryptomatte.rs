//! Cryptomatte ids and metadata: names hashed to 32 bits, and the hash's bits stored as f32.
//!
//! Objects with equal names have one id. Objects without a name are called [`UNNAMED`], as the hash of the empty
//! string, 0, means the background.
//!
//! Source: J. Friedman and A. Jones, "Cryptomatte Specification"; the hash is A. Appleby's MurmurHash3_x86_32.

use std::collections::BTreeMap;
use std::fmt::Write;

/// Name given to objects without one.
pub const UNNAMED: &str = "unnamed";

/// Hexadecimal digits of a layer's key in attribute names: more would make the names too long.
const KEY_DIGITS: usize = 7;

/// Returns the id of `name` in a Cryptomatte layer: its hash, reinterpreted as a finite and normal f32.
///
/// Exponents of all zeros or all ones would be denormal, infinite or NaN; one exponent bit is flipped to avoid them.
pub fn id_of(name: &str) -> f32 {
    let hash = murmur3(name_or_unnamed(name).as_bytes());
    let exponent = hash >> 23 & 0xff;
    let is_special = exponent == 0 || exponent == 0xff;
    f32::from_bits(if is_special { hash ^ 1 << 23 } else { hash })
}

/// Returns the name, or [`UNNAMED`] if it is empty.
fn name_or_unnamed(name: &str) -> &str {
    if name.is_empty() { UNNAMED } else { name }
}

/// Returns the file attributes of the layers `layer`00, `layer`01 ... and their manifest of `names`, as pairs of
/// attribute name and ASCII text.
pub fn attributes<'n>(layer: &str, names: impl IntoIterator<Item = &'n str>) -> [(String, String); 4] {
    let key = format!("{:08x}", murmur3(layer.as_bytes()));
    let attribute = |name: &str, text: String| (format!("cryptomatte/{}/{name}", &key[..KEY_DIGITS]), text);
    [
        attribute("name", layer.into()),
        attribute("hash", "MurmurHash3_32".into()),
        attribute("conversion", "uint32_to_float32".into()),
        attribute("manifest", manifest(names)),
    ]
}

/// Returns the manifest as JSON: names with the hexadecimal bits of their ids, sorted by name.
fn manifest<'n>(names: impl IntoIterator<Item = &'n str>) -> String {
    let ids: BTreeMap<&str, String> = names
        .into_iter()
        .map(|name| (name_or_unnamed(name), format!("{:08x}", id_of(name).to_bits())))
        .collect();
    // Serialisation of a map of strings cannot fail.
    ascii(&serde_json::to_string(&ids).unwrap_or_default())
}

/// Escapes the non-ASCII characters of JSON, which occur only inside its strings.
fn ascii(json: &str) -> String {
    let mut text = String::with_capacity(json.len());
    for letter in json.chars() {
        if letter.is_ascii() {
            text.push(letter);
            continue;
        }
        for unit in letter.encode_utf16(&mut [0; 2]) {
            // Writing to a string cannot fail.
            let _ = write!(text, "\\u{unit:04x}");
        }
    }
    text
}

/// Returns the hash MurmurHash3_x86_32 of `bytes` with seed 0.
pub fn murmur3(bytes: &[u8]) -> u32 {
    // Read little-endian words of four bytes; the last may be shorter
    let blocks = bytes.chunks(4).map(|chunk| {
        let word = chunk
            .iter()
            .rev()
            .fold(0, |word, &byte| word << 8 | u32::from(byte));
        (scramble(word), chunk.len() == 4)
    });
    // Mix the words into the hash
    let hash = blocks.fold(0, |hash: u32, (word, is_whole)| match is_whole {
        true => (hash ^ word)
            .rotate_left(13)
            .wrapping_mul(5)
            .wrapping_add(0xe654_6b64),
        false => hash ^ word,
    });
    finalize(hash ^ bytes.len() as u32)
}

/// Scrambles one word of the input.
fn scramble(word: u32) -> u32 {
    word.wrapping_mul(0xcc9e_2d51)
        .rotate_left(15)
        .wrapping_mul(0x1b87_3593)
}

/// Finalises the hash, so that every bit depends on all others (avalanche).
fn finalize(mut hash: u32) -> u32 {
    hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
    hash ^ hash >> 16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_match_the_reference_code() {
        assert_eq!(murmur3(b""), 0);
        assert_eq!(murmur3(b"hello"), 0x248b_fa47);
        assert_eq!(murmur3(b"hello, world"), 0x149b_bb7f);
        assert_eq!(
            murmur3(b"The quick brown fox jumps over the lazy dog"),
            0x2e4f_f723
        );
    }

    #[test]
    fn every_identifier_is_a_normal_float() {
        for number in 0..10_000 {
            assert!(id_of(&number.to_string()).is_normal());
        }
        assert_eq!(id_of(""), id_of(UNNAMED));
    }

    #[test]
    fn identifiers_match_the_specification() {
        // Examples of manifests in the specification.
        for (name, bits) in [
            ("bunny", 0x1385_1a76),
            ("default", 0x42c9_679f),
            ("bunny_porcelain_mat", 0xb24b_26d4),
        ] {
            assert_eq!(id_of(name).to_bits(), bits, "{name}");
        }
    }

    #[test]
    fn attributes_name_a_layer_by_hash_and_list_each_name_once() {
        let text = |pair: &(String, String)| format!("{} {}", pair.0, pair.1);
        let described = attributes("CryptoObject", ["default", "bunny", "default"])
            .each_ref()
            .map(text);
        // The hash of `CryptoObject` is 3ae39a58.
        assert_eq!(
            described,
            [
                "cryptomatte/3ae39a5/name CryptoObject",
                "cryptomatte/3ae39a5/hash MurmurHash3_32",
                "cryptomatte/3ae39a5/conversion uint32_to_float32",
                r#"cryptomatte/3ae39a5/manifest {"bunny":"13851a76","default":"42c9679f"}"#,
            ]
        );
    }

    #[test]
    fn manifests_are_ascii_for_all_names() {
        let names = ["Käse \"𝄞\"", "", "a\\b\n"];
        let text = manifest(names);
        assert!(text.is_ascii(), "{text}");
        let read: BTreeMap<String, String> = serde_json::from_str(&text).unwrap();
        let expected = names.map(|name| {
            let id = format!("{:08x}", id_of(name).to_bits());
            (
                if name.is_empty() {
                    "unnamed".to_owned()
                } else {
                    name.to_owned()
                },
                id,
            )
        });
        assert_eq!(read, BTreeMap::from(expected));
    }
}
