//! Content hash of a frame's inputs: frames with equal keys have equal images.

use std::fs::File;
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

/// BLAKE3 hash of all inputs of a frame, or of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Fingerprint([u8; 32]);

impl Fingerprint {
    /// Returns the hash of a file's bytes.
    pub(crate) fn of_file(path: &Path) -> io::Result<Fingerprint> {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(File::open(path)?)?;
        Ok(Fingerprint(*hasher.finalize().as_bytes()))
    }

    /// Returns the hash as hexadecimal digits, two per byte.
    pub(crate) fn digits(&self) -> String {
        blake3::Hash::from_bytes(self.0).to_hex().to_string()
    }

    /// Returns the first 16 hexadecimal digits, which names of files contain: 64 bits distinguish a few million frames.
    pub(crate) fn short(&self) -> String {
        const DIGITS: usize = 16;
        self.digits()[..DIGITS].to_owned()
    }
}

impl Serialize for Fingerprint {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.digits())
    }
}

impl<'de> Deserialize<'de> for Fingerprint {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Fingerprint, D::Error> {
        let digits = String::deserialize(deserializer)?;
        let hash = blake3::Hash::from_hex(digits).map_err(serde::de::Error::custom)?;
        Ok(Fingerprint(*hash.as_bytes()))
    }
}

/// Incremental hasher of the named inputs of a frame.
#[derive(Clone, Default)]
pub(crate) struct FingerprintHasher(blake3::Hasher);

impl FingerprintHasher {
    /// Adds an input by its name and value. Two hashers agree only if all inputs of both do, in the same order.
    pub(crate) fn add(&mut self, name: &str, value: impl AsRef<[u8]>) -> &mut FingerprintHasher {
        for part in [name.as_bytes(), value.as_ref()] {
            // The length prefix keeps different sequences of inputs from having the same bytes.
            self.0.update(&(part.len() as u64).to_le_bytes());
            self.0.update(part);
        }
        self
    }

    /// Returns the hash of all inputs added so far.
    pub(crate) fn key(&self) -> Fingerprint {
        Fingerprint(*self.0.finalize().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_differ_if_any_input_differs() {
        let key = |things: &[(&str, &str)]| {
            let mut ring = FingerprintHasher::default();
            for (name, value) in things {
                ring.add(name, value);
            }
            ring.key()
        };
        let base = key(&[("spp", "16"), ("size", "8x8")]);
        assert_eq!(base, key(&[("spp", "16"), ("size", "8x8")]));
        assert_ne!(base, key(&[("spp", "17"), ("size", "8x8")]));
        // The order of inputs and the split into name and value are part of the hash
        assert_ne!(base, key(&[("size", "8x8"), ("spp", "16")]));
        assert_ne!(key(&[("ab", "c")]), key(&[("a", "bc")]));
    }

    #[test]
    fn key_is_parsed_back_from_its_digits() {
        let mut ring = FingerprintHasher::default();
        let key = ring.add("a", "b").key();
        let text = serde_json::to_string(&key).unwrap();
        assert_eq!(text.len(), 66);
        assert_eq!(serde_json::from_str::<Fingerprint>(&text).unwrap(), key);
        assert!(serde_json::from_str::<Fingerprint>("\"12\"").is_err());
    }

    #[test]
    fn hash_of_an_empty_file_is_the_published_value() {
        // BLAKE3 of the empty input, from the test vectors of its specification.
        let file = tempfile::NamedTempFile::new().unwrap();
        let digits = Fingerprint::of_file(file.path()).unwrap().digits();
        assert!(digits.starts_with("af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262"));
    }
}
