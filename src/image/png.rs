//! PNG encoder: sRGB of 8 or 16 bits, compressed for speed.

use std::io::{self, Write};

use ::png::{BitDepth, ColorType, Compression, EncodingError, Filter, SrgbRenderingIntent, Writer};

use super::{Attribute, LinearImage, SOFTWARE, ToneMap, ToneOperator};

/// Writer of the encoder's bytes; boxed, so that the encoder is compiled for one type only.
pub(super) type Sink<'w> = Box<dyn Write + Send + 'w>;

/// Tone mapping and bit depth of a PNG.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PngEncoding {
    /// Exposure and tone curve of the codes.
    pub tone: ToneMap,
    /// Operator between exposure and curve.
    #[serde(default)]
    pub operator: ToneOperator,
    /// Bit depth of each code.
    pub bits: PngBits,
}

/// Bits per channel of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum PngBits {
    /// Eight bits, as screens show.
    #[default]
    #[cfg_attr(feature = "cli", value(name = "8"))]
    Eight,
    /// Sixteen bits, for further processing: 257 steps for each one of eight bits.
    #[cfg_attr(feature = "cli", value(name = "16"))]
    Sixteen,
}

impl PngBits {
    /// Returns the bytes of one channel of a pixel.
    fn sample_bytes(self) -> usize {
        match self {
            PngBits::Eight => size_of::<u8>(),
            PngBits::Sixteen => size_of::<u16>(),
        }
    }
}

/// Channels of the pixels of a PNG.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PngChannels {
    /// Red, green and blue.
    #[default]
    Rgb,
    /// Red, green, blue and straight alpha.
    Rgba,
}

impl PngEncoding {
    /// Tone-maps `pixels` to the sample bytes of a PNG.
    pub(super) fn codes(&self, pixels: &[[f32; 3]]) -> Vec<u8> {
        if self.operator == ToneOperator::Clip {
            return self.codes_after(self.tone, pixels);
        }
        // The operator's colours are exposed already
        let displayed = self.operator.displayed_pixels(pixels, self.tone);
        self.codes_after(ToneMap::default(), &displayed)
    }

    /// Returns the codes of `pixels` after the exposure and curve of `tone`.
    fn codes_after(&self, tone: ToneMap, pixels: &[[f32; 3]]) -> Vec<u8> {
        match self.bits {
            PngBits::Eight => tone.srgb_codes(pixels),
            PngBits::Sixteen => tone.srgb_codes16(pixels),
        }
    }

    /// Tone-maps premultiplied `pixels` to the sample bytes of a PNG with straight alpha.
    ///
    /// Colours are divided by their alpha before tone mapping, and are black where it is 0.
    pub(super) fn codes_with_alpha(&self, pixels: &[[f32; 3]], alpha: &[f32]) -> Vec<u8> {
        // Divide the colours by their coverage
        let straight: Vec<[f32; 3]> = pixels
            .iter()
            .zip(alpha)
            .map(|(pixel, &alpha)| match alpha > 0.0 {
                true => pixel.map(|channel| channel / alpha),
                false => [0.0; 3],
            })
            .collect();
        let colors = self.codes(&straight);
        // Interleave the codes of colours and alpha, which is linear
        let sample_bytes = self.bits.sample_bytes();
        let mut codes = Vec::with_capacity(4 * sample_bytes * alpha.len());
        for (color, &alpha) in colors.chunks(3 * sample_bytes).zip(alpha) {
            codes.extend_from_slice(color);
            let code = |most: u32| (f64::from(alpha.clamp(0.0, 1.0)) * f64::from(most)).round();
            match self.bits {
                PngBits::Eight => codes.push(code(u8::MAX.into()) as u8),
                PngBits::Sixteen => codes.extend((code(u16::MAX.into()) as u16).to_be_bytes()),
            }
        }
        codes
    }

    /// Writes the header and text chunks of an image of `size`, width and height.
    pub(super) fn begin<'w>(
        &self,
        out: Sink<'w>,
        size: [u32; 2],
        channels: PngChannels,
        notes: &[Attribute],
    ) -> io::Result<Writer<Sink<'w>>> {
        let [width, height] = size;
        // Set colour type, depth and fast compression
        let mut encoder = ::png::Encoder::new(out, width, height);
        encoder.set_color(match channels {
            PngChannels::Rgb => ColorType::Rgb,
            PngChannels::Rgba => ColorType::Rgba,
        });
        encoder.set_depth(match self.bits {
            PngBits::Eight => BitDepth::Eight,
            PngBits::Sixteen => BitDepth::Sixteen,
        });
        encoder.set_source_srgb(SrgbRenderingIntent::Perceptual);
        encoder.set_compression(Compression::Fast);
        encoder.set_filter(Filter::Sub);
        // Write text chunks, with the software's name first
        let maker = Attribute {
            name: "Software",
            text: SOFTWARE,
        };
        for Attribute { name, text } in [&maker].into_iter().chain(notes) {
            let (name, text) = ((*name).to_owned(), (*text).to_owned());
            // Use tEXt for ASCII, as every reader supports it; it is limited to Latin-1.
            let added = match text.is_ascii() {
                true => encoder.add_text_chunk(name, text),
                false => encoder.add_itxt_chunk(name, text),
            };
            added.map_err(io_error)?;
        }
        encoder.write_header().map_err(io_error)
    }
}

/// Writes `image` as a PNG to `out`, with the coverage of its pixels if `alpha` gives it.
pub(super) fn encode(
    image: &LinearImage,
    alpha: Option<&[f32]>,
    encoding: &PngEncoding,
    notes: &[Attribute],
    out: &mut (dyn Write + Send),
) -> io::Result<()> {
    let (channels, codes) = match alpha {
        None => (PngChannels::Rgb, encoding.codes(&image.pixels)),
        Some(alpha) => (PngChannels::Rgba, encoding.codes_with_alpha(&image.pixels, alpha)),
    };
    let mut writer = encoding.begin(Box::new(out), [image.width, image.height], channels, notes)?;
    writer.write_image_data(&codes).map_err(io_error)?;
    writer.finish().map_err(io_error)
}

/// Converts an encoder error; errors of the operating system are passed through.
pub(super) fn io_error(error: EncodingError) -> io::Error {
    match error {
        EncodingError::IoError(error) => error,
        other => io::Error::other(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> LinearImage {
        let mut image = LinearImage::black(5, 3);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [0.01 * i as f32, 0.07 * i as f32, 0.5];
        }
        image
    }

    #[test]
    fn png_reads_back_as_tone_mapped_codes() {
        let image = ramp();
        let mut file = Vec::new();
        encode(&image, None, &PngEncoding::default(), &[], &mut file).unwrap();
        let read = image::load_from_memory(&file).unwrap();
        assert_eq!(read.color(), image::ColorType::Rgb8);
        assert_eq!((read.width(), read.height()), (5, 3));
        assert_eq!(read.into_rgb8().into_raw(), ToneMap::default().srgb_bytes(&image));
    }

    #[test]
    fn sixteen_bit_codes_are_the_srgb_curve_in_65535_steps() {
        let mut file = Vec::new();
        let encoding = PngEncoding {
            bits: PngBits::Sixteen,
            ..PngEncoding::default()
        };
        encode(&ramp(), None, &encoding, &[], &mut file).unwrap();
        let read = image::load_from_memory(&file).unwrap();
        assert_eq!(read.color(), image::ColorType::Rgb16);
        let codes = read.into_rgb16().into_raw();
        // 1.055 · 0.01^(1/2.4) - 0.055 = 0.0998528 -> 6543.9; 0.07 -> 0.2933721 -> 19226.1; 0.5 -> 0.7353570 -> 48191.6
        assert_eq!(codes[3..6], [6544, 19226, 48192]);
    }

    #[test]
    fn text_metadata_is_stored_in_any_script() {
        let notes = [
            Attribute {
                name: "whit.plan",
                text: "shadow on\n",
            },
            Attribute {
                name: "whit.scene",
                text: "Ü",
            },
        ];
        let mut file = Vec::new();
        encode(&ramp(), None, &PngEncoding::default(), &notes, &mut file).unwrap();
        let reader = ::png::Decoder::new(io::Cursor::new(&file)).read_info().unwrap();
        let info = reader.info();
        let texts: Vec<(&str, &str)> = info
            .uncompressed_latin1_text
            .iter()
            .map(|chunk| (&chunk.keyword[..], &chunk.text[..]))
            .collect();
        assert_eq!(texts, [("Software", SOFTWARE), ("whit.plan", "shadow on\n")]);
        assert_eq!(info.utf8_text[0].keyword, "whit.scene");
        assert_eq!(info.utf8_text[0].get_text().unwrap(), "Ü");
        assert_eq!(info.srgb, Some(SrgbRenderingIntent::Perceptual));
    }

    #[test]
    fn alpha_is_straight_and_divided_out_of_the_colours() {
        let image = LinearImage {
            width: 4,
            height: 1,
            pixels: vec![[0.125, 0.25, 0.5], [0.3, 0.2, 0.1], [0.5; 3], [0.5; 3]],
        };
        let alpha = [0.5, 0.0, 1.0, 1.25];
        for bits in [PngBits::Eight, PngBits::Sixteen] {
            let encoding = PngEncoding {
                bits,
                ..PngEncoding::default()
            };
            let mut file = Vec::new();
            encode(&image, Some(&alpha), &encoding, &[], &mut file).unwrap();
            let read = image::load_from_memory(&file).unwrap();
            assert_eq!(read.color().channel_count(), 4);
            let codes = read.into_rgba16().into_raw();
            // Colours 0.25, 0.5 and 1 have the codes 137, 188 and 255 of 255, 35199, 48192 and 65535 of 65535.
            let expected = match bits {
                PngBits::Eight => [137 * 257, 188 * 257, 65535, 128 * 257],
                PngBits::Sixteen => [35199, 48192, 65535, 32768],
            };
            assert_eq!(codes[..4], expected);
            assert_eq!(codes[4..8], [0; 4]);
            assert_eq!([codes[11], codes[15]], [65535; 2]);
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn full_disk_is_a_system_error() {
        // This device is always full.
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let mut out = io::BufWriter::new(full);
        let error = encode(&ramp(), None, &PngEncoding::default(), &[], &mut out).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
    }
}
