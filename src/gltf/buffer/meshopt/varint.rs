//! Numbers of variable length: 7 bits a byte, least significant first (unsigned LEB128).

/// Reason why a number cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum VarintFault {
    /// The bytes end inside the number.
    Truncated,
    /// The fifth byte says that another follows.
    Long,
}

/// Most bytes of a number: five times 7 bits hold 32.
const MAX_LENGTH: u32 = 5;

/// Bit that says that another byte follows.
const CONTINUATION: u8 = 0x80;

/// Reads a number and moves the start of `bytes` behind it; bits above the 32nd are dropped.
#[inline(always)]
pub(super) fn read(bytes: &mut &[u8]) -> Result<u32, VarintFault> {
    let Some((&first, rest)) = bytes.split_first() else {
        return Err(VarintFault::Truncated);
    };
    *bytes = rest;
    if first < CONTINUATION {
        return Ok(u32::from(first));
    }
    read_more(u32::from(first & !CONTINUATION), bytes)
}

/// Reads the second and further bytes of a number whose first has the given 7 bits.
#[inline(always)]
fn read_more(first: u32, bytes: &mut &[u8]) -> Result<u32, VarintFault> {
    let mut number = first;
    for place in 1..MAX_LENGTH {
        let Some((&byte, rest)) = bytes.split_first() else {
            return Err(VarintFault::Truncated);
        };
        *bytes = rest;
        number |= u32::from(byte & !CONTINUATION) << (7 * place);
        if byte < CONTINUATION {
            return Ok(number);
        }
    }
    Err(VarintFault::Long)
}

/// Returns the difference that a zigzag code stands for: 0, -1, 1, -2 and so on, modulo 2^32.
#[inline(always)]
pub(super) fn unzigzag(code: u32) -> u32 {
    (code >> 1) ^ (code & 1).wrapping_neg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lower_groups_of_bits_come_first() {
        for (bytes, expected) in [
            (&[0x7f][..], 0x7f),
            (&[0x81, 0x04], 0x201),
            // 0x7f + (0x20 << 7) + (5 << 14); the specification's own value joins these groups in reverse
            (&[0xff, 0xa0, 0x05], 0x1_507f),
        ] {
            let mut rest = bytes;
            assert_eq!(read(&mut rest), Ok(expected));
            assert!(rest.is_empty());
        }
    }

    #[test]
    fn bits_above_the_32nd_are_dropped() {
        assert_eq!(read(&mut &[0xff, 0xff, 0xff, 0xff, 0x7f][..]), Ok(u32::MAX));
    }

    #[test]
    fn numbers_have_five_bytes_at_most_and_end() {
        assert_eq!(
            read(&mut &[0x80, 0x80, 0x80, 0x80, 0x80, 0][..]),
            Err(VarintFault::Long)
        );
        assert_eq!(read(&mut &[0x80, 0x80][..]), Err(VarintFault::Truncated));
        assert_eq!(read(&mut &[][..]), Err(VarintFault::Truncated));
    }

    #[test]
    fn zigzag_codes_alternate_in_sign() {
        assert_eq!([0, 1, 2, 3].map(|code| unzigzag(code) as i32), [0, -1, 1, -2]);
    }
}
