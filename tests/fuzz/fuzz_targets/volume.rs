//! Reads a volume: NRRD, NumPy, or raw numbers after a description of ten bytes.
//!
//! An input in NRRD may name `input.nrrd` as its data file, or `data.raw`, which holds the bytes of the input, too.

#![no_main]

use libfuzzer_sys::fuzz_target;
use whit::volume::read::{ByteOrder, Element, RawHeader, read, read_raw};
use whit_fuzz::{InputFolder, MAX_VOLUME_BYTES, start};

const ELEMENTS: [Element; 5] = [
    Element::U8,
    Element::I16,
    Element::F16,
    Element::U64,
    Element::F64,
];

fuzz_target!(init: start(), |data: &[u8]| {
    let folder = InputFolder::new();
    let volume = if data.starts_with(b"NRRD") {
        folder.write("data.raw", data);
        read(&folder.write("input.nrrd", data), MAX_VOLUME_BYTES)
    } else if data.starts_with(b"\x93NUMPY") {
        read(&folder.write("input.npy", data), MAX_VOLUME_BYTES)
    } else {
        let Some((&[element, order, channels, skip, sides @ ..], numbers)) = data.split_first_chunk::<10>() else {
            return;
        };
        let [x, y, z] = [0, 2, 4].map(|at| usize::from(u16::from_le_bytes([sides[at], sides[at + 1]])));
        let header = RawHeader {
            size: [x, y, z],
            channels: usize::from(channels),
            element: ELEMENTS[usize::from(element) % ELEMENTS.len()],
            order: if order == 0 { ByteOrder::Little } else { ByteOrder::Big },
            skip: u64::from(skip),
        };
        read_raw(&folder.write("data.raw", numbers), &header, MAX_VOLUME_BYTES)
    };
    if let Ok(volume) = volume {
        assert!((1..=4).contains(&volume.channels.len()), "{} channels", volume.channels.len());
    }
});
