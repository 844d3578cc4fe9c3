//! Identifiers of Cryptomatte: names hashed to 32 bits, and those bits as numbers that every picture file keeps.
//!
//! Source: J. Friedman and A. Jones, "Cryptomatte Specification", 2015; the hash is A. Appleby's MurmurHash3_x86_32.

use std::collections::BTreeMap;

/// The number that stands for `name` in a Cryptomatte layer: its hash, as a finite and normal f32.
///
/// Exponents of zero and of all ones would be denormal, infinite or NaN; their lowest bit is flipped.
pub fn id_of(name: &str) -> f32 {
    let hash = murmur3(name.as_bytes());
    let exponent = hash >> 23 & 0xff;
    let is_special = exponent == 0 || exponent == 0xff;
    f32::from_bits(if is_special { hash ^ 1 << 23 } else { hash })
}

/// What a file says of a layer of mattes called `layer`, which shows things called `names`: attributes by their names.
pub fn attributes<'n>(layer: &str, names: impl IntoIterator<Item = &'n str>) -> [(String, String); 4] {
    let manifest: BTreeMap<&str, String> = names
        .into_iter()
        .map(|name| (name, format!("{:08x}", id_of(name).to_bits())))
        .collect();
    // Names and digits, which JSON can say.
    let manifest = serde_json::to_string(&manifest).unwrap_or_default();
    let key = format!("{:08x}", murmur3(layer.as_bytes()));
    let attribute = |what: &str, value: String| (format!("cryptomatte/{}/{what}", &key[..7]), value);
    [
        attribute("name", layer.to_owned()),
        attribute("hash", "MurmurHash3_32".to_owned()),
        attribute("conversion", "uint32_to_float32".to_owned()),
        attribute("manifest", ascii(&manifest)),
    ]
}

/// JSON whose letters are all ASCII, as those of attributes are.
fn ascii(json: &str) -> String {
    let mut units = [0; 2];
    json.chars()
        .fold(String::with_capacity(json.len()), |mut text, letter| {
            match letter.is_ascii() {
                true => text.push(letter),
                false => {
                    let units = letter.encode_utf16(&mut units).iter();
                    text.extend(units.map(|unit| format!("\\u{unit:04x}")));
                }
            }
            text
        })
}

/// MurmurHash3_x86_32 with seed 0.
pub fn murmur3(bytes: &[u8]) -> u32 {
    let blocks = bytes.chunks(4).map(|chunk| {
        let word = chunk
            .iter()
            .rev()
            .fold(0, |word, &byte| word << 8 | u32::from(byte));
        (scrambled(word), chunk.len() == 4)
    });
    let hash = blocks.fold(0, |hash: u32, (word, is_whole)| match is_whole {
        true => (hash ^ word)
            .rotate_left(13)
            .wrapping_mul(5)
            .wrapping_add(0xe654_6b64),
        false => hash ^ word,
    });
    finished(hash ^ bytes.len() as u32)
}

fn scrambled(word: u32) -> u32 {
    word.wrapping_mul(0xcc9e_2d51)
        .rotate_left(15)
        .wrapping_mul(0x1b87_3593)
}

/// Every bit of the hash then depends on all of them.
fn finished(mut hash: u32) -> u32 {
    hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
    hash ^ hash >> 16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_the_reference_code() {
        assert_eq!(murmur3(b""), 0);
        assert_eq!(murmur3(b"hello"), 0x248b_fa47);
        assert_eq!(murmur3(b"hello, world"), 0x149b_bb7f);
        assert_eq!(
            murmur3(b"The quick brown fox jumps over the lazy dog"),
            0x2e4f_f723
        );
    }

    #[test]
    fn every_identifier_is_a_normal_number() {
        // "" hashes to 0, whose exponent of zero becomes one.
        assert_eq!(id_of("").to_bits(), 1 << 23);
        for number in 0..10_000 {
            assert!(id_of(&number.to_string()).is_normal());
        }
    }

    #[test]
    fn a_manifest_has_each_name_once_in_letters_that_attributes_have() {
        let [name, hash, conversion, manifest] = attributes("CryptoObject", ["hello", "Grün \"𝄞\"", "hello"]);
        let key = format!("{:08x}", murmur3(b"CryptoObject"));
        assert_eq!(
            name,
            (format!("cryptomatte/{}/name", &key[..7]), "CryptoObject".into())
        );
        assert_eq!(
            (&*hash.1, &*conversion.1),
            ("MurmurHash3_32", "uint32_to_float32")
        );
        assert!(manifest.1.is_ascii());
        let read: BTreeMap<String, String> = serde_json::from_str(&manifest.1).unwrap();
        assert_eq!(read.len(), 2);
        assert_eq!(read["hello"], "248bfa47");
        let other = id_of("Grün \"𝄞\"").to_bits();
        assert_eq!(read["Grün \"𝄞\""], format!("{other:08x}"));
    }
}
