//! Flags of the encoding of images in their files.

use clap::Args as ArgGroup;

use whit::image::PngBits;
use whit::image::rows::{Compression, SampleType};

/// Flags of the encoding of images in their files.
#[derive(Clone, Copy, Debug, Default, ArgGroup)]
pub(in crate::cli) struct OutputArgs {
    /// Sample type of an EXR's colours: 32-bit floats, or halves with 11 significant bits, infinite beyond 65504;
    /// counts, distances and ids stay floats [default: float]
    #[arg(long, value_enum, hide_possible_values = true, value_name = "half|float")]
    pub(in crate::cli) exr_type: Option<SampleType>,

    /// Lossless compression of an EXR: rle by run lengths, zips and zip by deflate in blocks of 1 and 16 rows, piz by
    /// wavelets in blocks of 32 [default: none]
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "none|rle|zips|zip|piz"
    )]
    pub(in crate::cli) compression: Option<Compression>,

    /// Bits of each colour channel of a PNG [default: 8]
    #[arg(long, value_enum, hide_possible_values = true, value_name = "8|16")]
    pub(in crate::cli) png_bits: Option<PngBits>,
}
