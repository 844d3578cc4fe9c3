//! Reader for NumPy's `.npy` (NEP 1, "A simple file format for NumPy arrays"; versions 1 to 3): a Python dictionary,
//! then numbers.

use super::dtype::{ArrayAxis, ArrayLayout, ByteOrder, Element};
use super::fault::{SAVE_AGAIN, THREE_AXES, VolumeFault};

/// First bytes of every `.npy` file.
const MAGIC: &[u8] = b"\x93NUMPY";
/// Largest length of the dictionary in bytes: NumPy itself rejects longer ones.
const MAX_HEADER: usize = 10_000;

/// Layout of an array and the offset of its numbers in the file.
#[derive(Debug)]
pub(super) struct Array {
    pub(super) layout: ArrayLayout,
    pub(super) data_start: usize,
}

/// Entries of the header's dictionary.
#[derive(Debug, Default)]
struct NpyHeader<'h> {
    descr: Option<&'h str>,
    fortran: Option<bool>,
    shape: Option<Vec<u64>>,
}

/// Parses the header of `bytes`.
pub(super) fn parse(bytes: &[u8]) -> Result<Array, VolumeFault> {
    let broken = || {
        VolumeFault::new(
            "is not a complete .npy file",
            "save the array again with numpy.save",
        )
    };
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(broken)?;
    // Read the version and the length of the dictionary
    let (length, start) = match rest {
        [1, _, a, b, ..] => (usize::from(u16::from_le_bytes([*a, *b])), MAGIC.len() + 4),
        [2 | 3, _, a, b, c, d, ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, MAGIC.len() + 6),
        [version, _, ..] if *version > 3 => {
            let fault = format!("is of version {version} of the .npy format");
            return Err(VolumeFault::new(fault, "save it with version 1, 2 or 3"));
        }
        _ => return Err(broken()),
    };
    if length > MAX_HEADER {
        return Err(VolumeFault::new("has a header of implausible length", SAVE_AGAIN));
    }
    // Parse the dictionary
    let text = bytes.get(start..start + length).ok_or_else(broken)?;
    let text = std::str::from_utf8(text).map_err(|_| broken())?;
    let header = dictionary(text).ok_or_else(broken)?;
    let (Some(descr), Some(fortran), Some(mut shape)) = (header.descr, header.fortran, header.shape) else {
        return Err(broken());
    };
    let (element, order) = element(descr)?;
    // Assign roles to axes; NumPy indexes [z, y, x] or [z, y, x, c]
    let mut axes = match shape.len() {
        3 => vec![ArrayAxis::Z, ArrayAxis::Y, ArrayAxis::X],
        4 => vec![ArrayAxis::Z, ArrayAxis::Y, ArrayAxis::X, ArrayAxis::Channel],
        rank => return Err(VolumeFault::new(format!("has {rank} axes"), THREE_AXES)),
    };
    // Order axes from the fastest; C order stores the last index fastest
    if !fortran {
        axes.reverse();
        shape.reverse();
    }
    let axes: Vec<_> = axes.into_iter().zip(shape).collect();
    Ok(Array {
        layout: ArrayLayout::new(element, order, &axes)?,
        data_start: start + length,
    })
}

/// Parses the type string of NumPy, such as `<f4`.
fn element(descr: &str) -> Result<(Element, ByteOrder), VolumeFault> {
    let mut chars = descr.chars();
    let order = match chars.next() {
        Some('>') => ByteOrder::Big,
        _ => ByteOrder::Little,
    };
    let element = match chars.as_str() {
        "u1" | "b1" => Element::U8,
        "i1" => Element::I8,
        "u2" => Element::U16,
        "i2" => Element::I16,
        "u4" => Element::U32,
        "i4" => Element::I32,
        "u8" => Element::U64,
        "i8" => Element::I64,
        "f2" => Element::F16,
        "f4" => Element::F32,
        "f8" => Element::F64,
        _ => {
            let fault = format!("holds elements of the type {descr:?}");
            return Err(VolumeFault::new(
                fault,
                "save real numbers, as by array.astype('float32')",
            ));
        }
    };
    Ok((element, order))
}

/// Parses a dictionary of the three known keys; `None` if it is anything else.
fn dictionary(text: &str) -> Option<NpyHeader<'_>> {
    let mut header = NpyHeader::default();
    let mut rest = text.trim().strip_prefix('{')?.trim_start();
    while !rest.starts_with('}') {
        // Split off the next key
        let (key, after) = quoted(rest)?;
        let value = after.trim_start().strip_prefix(':')?.trim_start();
        // Parse the value of a known key
        rest = match key {
            "descr" if value.starts_with(['\'', '"']) => {
                let (descr, after) = quoted(value)?;
                header.descr = Some(descr);
                after
            }
            // A structured type: skip the list of fields.
            "descr" => {
                header.descr = Some("record");
                let end = value.find(']')?;
                &value[end + 1..]
            }
            "fortran_order" => {
                let (fortran, after) = match value.strip_prefix("True") {
                    Some(after) => (true, after),
                    None => (false, value.strip_prefix("False")?),
                };
                header.fortran = Some(fortran);
                after
            }
            "shape" => {
                let (inside, after) = value.strip_prefix('(')?.split_once(')')?;
                let lengths = inside
                    .split(',')
                    .map(str::trim)
                    .filter(|length| !length.is_empty());
                // Python 2 marked long integers with L.
                let lengths = lengths.map(|length| length.trim_end_matches('L').parse().ok());
                header.shape = Some(lengths.collect::<Option<_>>()?);
                after
            }
            _ => return None,
        };
        rest = rest.trim_start();
        rest = rest.strip_prefix(',').unwrap_or(rest).trim_start();
    }
    Some(header)
}

/// Splits off a quoted string at the start of `text`; returns it and the rest.
fn quoted(text: &str) -> Option<(&str, &str)> {
    let quote = text.chars().next().filter(|quote| matches!(quote, '\'' | '"'))?;
    text[1..].split_once(quote)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes
    }

    fn fault(header: &str) -> String {
        parse(&file(header)).unwrap_err().fault
    }

    #[test]
    fn array_is_indexed_z_y_x_in_either_order() {
        let c = parse(&file(
            "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3, 4), }   \n",
        ))
        .unwrap();
        assert_eq!(c.layout.size, [4, 3, 2]);
        let x_fastest = [(ArrayAxis::X, 4), (ArrayAxis::Y, 3), (ArrayAxis::Z, 2)];
        assert_eq!(
            c.layout,
            ArrayLayout::new(Element::F32, ByteOrder::Little, &x_fastest).unwrap()
        );
        let f = parse(&file("{\"shape\":(2,3,4,3),'descr':'>i2','fortran_order':True}")).unwrap();
        let z_fastest = [
            (ArrayAxis::Z, 2),
            (ArrayAxis::Y, 3),
            (ArrayAxis::X, 4),
            (ArrayAxis::Channel, 3),
        ];
        assert_eq!(
            f.layout,
            ArrayLayout::new(Element::I16, ByteOrder::Big, &z_fastest).unwrap()
        );
    }

    #[test]
    fn non_volume_arrays_are_rejected_by_type() {
        let with = |descr: &str, shape: &str| {
            fault(&format!(
                "{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}"
            ))
        };
        assert!(with("'<f4'", "(2, 3)").contains("2 axes"));
        assert!(with("'<f4'", "()").contains("0 axes"));
        assert!(with("'<c8'", "(2, 3, 4)").contains("<c8"));
        assert!(with("'|O'", "(2, 3, 4)").contains("|O"));
        assert!(with("[('a', '<f4')]", "(2, 3, 4)").contains("record"));
        assert!(with("'<f4'", "(2, 3, 4, 9)").contains("9 channels"));
        assert!(with("'<f4'", "(2, 0, 4)").contains("length 0"));
        assert!(with("'<f4'", "(4294967296, 4294967296, 4)").contains("memory"));
    }

    #[test]
    fn invalid_headers_are_rejected() {
        for header in [
            "",
            "{",
            "{'descr': '<f4'}",
            "{'shape': (1,-2,3)}",
            "{'descr'",
            "{'other': 1}",
            "[]",
            "{é",
            "'",
        ] {
            assert!(parse(&file(header)).is_err(), "{header}");
        }
        assert!(parse(b"").is_err());
        assert!(parse(b"\x93NUMPY").is_err());
        assert!(
            parse(b"\x93NUMPY\x09\x00\x00\x00")
                .unwrap_err()
                .fault
                .contains("version 9")
        );
        assert!(
            parse(b"\x93NUMPY\x02\x00\xff\xff\xff\xff")
                .unwrap_err()
                .fault
                .contains("implausible")
        );
    }
}
