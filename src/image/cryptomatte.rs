//! Identifiers of Cryptomatte: names hashed to 32 bits, and those bits as numbers that every picture file keeps.
//!
//! Source: J. Friedman and A. Jones, "Cryptomatte Specification", 2015; the hash is A. Appleby's MurmurHash3_x86_32.

/// The number that stands for `name` in a Cryptomatte layer: its hash, as a finite and normal f32.
///
/// Exponents of zero and of all ones would be denormal, infinite or NaN; their lowest bit is flipped.
pub fn id_of(name: &str) -> f32 {
    let hash = murmur3(name.as_bytes());
    let exponent = hash >> 23 & 0xff;
    let is_special = exponent == 0 || exponent == 0xff;
    f32::from_bits(if is_special { hash ^ 1 << 23 } else { hash })
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
}
