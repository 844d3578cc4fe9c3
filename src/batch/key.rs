//! What a frame is made of, as one number: if that is the same, so is the picture.

use std::fs::File;
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

/// A hash (BLAKE3) of all that a frame depends on, or of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Key([u8; 32]);

impl Key {
    /// Of a file's bytes.
    pub fn of_file(path: &Path) -> io::Result<Key> {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(File::open(path)?)?;
        Ok(Key(*hasher.finalize().as_bytes()))
    }

    /// In digits, two a byte.
    pub fn digits(&self) -> String {
        blake3::Hash::from_bytes(self.0).to_hex().to_string()
    }

    /// The first digits, which names of files have: enough to tell a few million frames apart.
    pub fn short(&self) -> String {
        const DIGITS: usize = 16;
        self.digits()[..DIGITS].to_owned()
    }
}

impl Serialize for Key {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.digits())
    }
}

impl<'de> Deserialize<'de> for Key {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Key, D::Error> {
        let digits = String::deserialize(deserializer)?;
        let hash = blake3::Hash::from_hex(digits).map_err(serde::de::Error::custom)?;
        Ok(Key(*hash.as_bytes()))
    }
}

/// Takes one thing after the other that a frame depends on.
#[derive(Clone, Default)]
pub struct Keyring(blake3::Hasher);

impl Keyring {
    /// Adds a thing by what it is and its value. Two rings are the same only if all of both are, in the same order.
    pub fn add(&mut self, name: &str, value: impl AsRef<[u8]>) -> &mut Keyring {
        for part in [name.as_bytes(), value.as_ref()] {
            // With its length, so that no two rows of things run into the same bytes.
            self.0.update(&(part.len() as u64).to_le_bytes());
            self.0.update(part);
        }
        self
    }

    /// The hash of all that was added.
    pub fn key(&self) -> Key {
        Key(*self.0.finalize().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_differ_where_anything_does() {
        let key = |things: &[(&str, &str)]| {
            let mut ring = Keyring::default();
            for (name, value) in things {
                ring.add(name, value);
            }
            ring.key()
        };
        let base = key(&[("spp", "16"), ("size", "8x8")]);
        assert_eq!(base, key(&[("spp", "16"), ("size", "8x8")]));
        assert_ne!(base, key(&[("spp", "17"), ("size", "8x8")]));
        assert_ne!(base, key(&[("size", "8x8"), ("spp", "16")]));
        assert_ne!(key(&[("ab", "c")]), key(&[("a", "bc")]));
    }

    #[test]
    fn a_key_comes_back_from_its_digits() {
        let mut ring = Keyring::default();
        let key = ring.add("a", "b").key();
        let text = serde_json::to_string(&key).unwrap();
        assert_eq!(text.len(), 66);
        assert_eq!(serde_json::from_str::<Key>(&text).unwrap(), key);
        assert!(serde_json::from_str::<Key>("\"12\"").is_err());
    }

    #[test]
    fn the_hash_of_a_file_is_the_published_one() {
        // BLAKE3 of nothing, from its specification's test vectors.
        let file = tempfile::NamedTempFile::new().unwrap();
        let digits = Key::of_file(file.path()).unwrap().digits();
        assert!(digits.starts_with("af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262"));
    }
}
