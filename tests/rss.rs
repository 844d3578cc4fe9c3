//! Images larger than the memory that holds their rows: memory does not grow with the image.

use whit::image::rows::{
    Compression, ExrChannel, ExrLayout, ExrScanlineReader, ExrScanlineWriter, SampleType, Samples,
};
use whit::report::memory;

const WIDTH: u32 = 8192;
const HEIGHT: u32 = 4096;
/// Rows that are given and taken at once.
const ROWS: u32 = 64;

/// The image has 400 MB; a third of that is room for what waits to be packed and for the threads that do it.
const MAX_BYTES: u64 = 128 << 20;

#[test]
fn large_image_is_written_and_read_in_part_of_its_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.exr");
    let channels = ["R", "G", "B"].map(|name| ExrChannel::new(name, SampleType::Float));
    let layout = ExrLayout {
        compression: Compression::Zips,
        ..ExrLayout::of_size([WIDTH, HEIGHT], channels.to_vec())
    };
    let mut writer = ExrScanlineWriter::create(&path, &layout).unwrap();
    for first_row in (0..HEIGHT).step_by(ROWS as usize) {
        let plane = vec![first_row as f32; (WIDTH * ROWS) as usize];
        let plane = Samples::from(&plane[..]);
        writer.write_rows(&[plane.clone(), plane.clone(), plane]).unwrap();
    }
    writer.finish().unwrap();

    let mut reader = ExrScanlineReader::open(&path).unwrap();
    for first_row in (0..HEIGHT).step_by(ROWS as usize) {
        for plane in reader.read_rows(first_row..first_row + ROWS).unwrap() {
            let Samples::Floats(values) = plane else {
                panic!("{plane:?}");
            };
            assert!(values.iter().all(|&value| value == first_row as f32));
        }
    }
    match memory::peak_bytes() {
        Some(peak) => {
            println!("{} at most", memory::in_words(peak));
            assert!(peak < MAX_BYTES, "{peak} bytes");
        }
        None => println!("skipped: the system does not report the memory of a process"),
    }
}
