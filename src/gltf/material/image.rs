//! Decoding of the images that simulated effects use, in parallel and within a budget.

use std::collections::HashSet;
use std::io::Cursor;

use image::{ColorType, DynamicImage, ImageDecoder, ImageReader, Limits};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::buffer::{Buffer, BufferMut};
use crate::gltf::buffer::bytes::Bytes;
use crate::gltf::document::GltfDocument;
use crate::gltf::material::image_source::ImageSource;
use crate::gltf::material::ktx2;
use crate::gltf::{GltfError, LoadOptions};
use crate::parallel;
use crate::scene::{CachedImage, Image, ImageCache, Texels};

impl GltfDocument {
    /// Reads these images, decoding those whose index is in `wanted`.
    pub(in crate::gltf) fn read_images(
        &self,
        images: &[ImageSource],
        wanted: &HashSet<u32>,
        options: &LoadOptions,
    ) -> Result<Vec<Image>, GltfError> {
        let is_wanted = |index: usize| wanted.contains(&(index as u32));
        // Sizes first: nothing is decoded before all images are known to fit.
        let sources: Vec<ImageBytes> = images
            .iter()
            .map(|image| self.image_bytes(image.number))
            .collect::<Result<_, _>>()?;
        // Check every size, and the sum of those that are decoded
        let mut total = 0u64;
        let mut sizes = Vec::with_capacity(images.len());
        for (index, (&ImageSource { number, .. }, source)) in images.iter().zip(&sources).enumerate() {
            let (width, height) = self.image_size(number, source)?;
            sizes.push((width, height));
            let texel_count = u64::from(width) * u64::from(height);
            total += if is_wanted(index) { texel_count } else { 0 };
            if texel_count == 0 || total > options.max_texels {
                let fault = format!(
                    "is {width} x {height}; with it the images have {total} texels of {} allowed",
                    options.max_texels
                );
                return Err(self.fault(self.image_item(number), fault, "make the image smaller"));
            }
        }
        // Decode in parallel; other images keep only their size
        let read = |index: usize| {
            let (image, source) = (images[index], &sources[index]);
            let (width, height) = sizes[index];
            match is_wanted(index) {
                true => self.decode_image(image, source, &options.image_cache),
                false => Ok(Image {
                    name: self.image_name(image.number),
                    width,
                    height,
                    texels: Texels::Unread,
                }),
            }
        };
        let sizes: Vec<usize> = sources.iter().map(|source| source.as_slice().len()).collect();
        parallel::map_largest_first(&sizes, &read).into_iter().collect()
    }

    fn decode_image(
        &self,
        image: ImageSource,
        source: &ImageBytes,
        image_cache: &ImageCache,
    ) -> Result<Image, GltfError> {
        let number = image.number;
        let decoded = image_cache.image(source.as_slice(), || self.decode_texels(number, source))?;
        let [width, height] = decoded.size;
        Ok(Image {
            name: self.image_name(number),
            width,
            height,
            texels: match decoded.texels {
                Texels::Bytes(texels) => Texels::Bytes(image.conversion.apply(texels)),
                other => other,
            },
        })
    }

    fn decode_texels(&self, number: usize, source: &ImageBytes) -> Result<CachedImage, GltfError> {
        let (width, height) = self.image_size(number, source)?;
        let texels = if ktx2::size(source.as_slice()).is_some() {
            let texels = ktx2::texels(source.as_slice()).map_err(|e| self.bad_image(number, &e))?;
            match texels.len() as u64 == u64::from(width) * u64::from(height) {
                true => texels,
                false => return Err(self.bad_image(number, &"it has more or fewer texels than its size")),
            }
        } else if let Some(texels) = rgba_of_jpeg(source.as_slice(), [width, height]) {
            texels
        } else {
            let decoder = self.image_decoder(number, source)?;
            rgba_texels(decoder).map_err(|e| self.bad_image(number, &e))?
        };
        Ok(CachedImage {
            size: [width, height],
            texels: Texels::Bytes(texels),
        })
    }

    fn image_size(&self, number: usize, source: &ImageBytes) -> Result<(u32, u32), GltfError> {
        if let Some([width, height]) = ktx2::size(source.as_slice()) {
            return Ok((width, height));
        }
        Ok(self.image_decoder(number, source)?.dimensions())
    }

    fn image_decoder<'b>(
        &self,
        number: usize,
        source: &'b ImageBytes,
    ) -> Result<impl ImageDecoder + use<'b>, GltfError> {
        let bytes: &'b [u8] = source.as_slice();
        let mut reader = ImageReader::new(Cursor::new(bytes))
            .with_guessed_format()
            .map_err(|e| self.bad_image(number, &e))?;
        // The texel budget is checked above; the decoder's own allocations need a limit, too.
        let mut limits = Limits::no_limits();
        limits.max_alloc = Some(MAX_DECODER_BYTES);
        reader.limits(limits);
        reader.into_decoder().map_err(|e| self.bad_image(number, &e))
    }

    fn image_bytes(&self, number: usize) -> Result<ImageBytes<'_>, GltfError> {
        let source = &self.root.images[number];
        match (&source.uri, source.buffer_view) {
            (Some(uri), _) => Ok(ImageBytes::Own(self.resolve(uri, &self.image_item(number))?)),
            (None, Some(view)) => Ok(ImageBytes::Shared(self.view(view.value())?.bytes)),
            (None, None) => {
                let fault = "has neither a URI nor a buffer view";
                Err(self.fault(self.image_item(number), fault, crate::gltf::error::EXPORT_AGAIN))
            }
        }
    }

    fn image_item(&self, number: usize) -> String {
        let name = self.image_name(number);
        if name == format!("image {number}") {
            name
        } else {
            format!("image {number} `{name}`")
        }
    }

    fn image_name(&self, number: usize) -> String {
        let source = &self.root.images[number];
        // A data URI is too long for a name
        let uri = source.uri.as_deref().filter(|uri| !uri.starts_with("data:"));
        let name = source.name.as_deref().filter(|name| !name.is_empty());
        name.or(uri)
            .map_or_else(|| format!("image {number}"), str::to_owned)
    }

    fn bad_image(&self, number: usize, error: &dyn std::fmt::Display) -> GltfError {
        let fault = format!("cannot be decoded ({error})");
        self.fault(self.image_item(number), fault, "save it as PNG, JPEG or WebP")
    }
}

/// Returns the texels of a JPEG image, opaque; `None` for other images, and where it cannot be decoded.
fn rgba_of_jpeg(bytes: &[u8], [width, height]: [u32; 2]) -> Option<Buffer<[u8; 4]>> {
    let options = DecoderOptions::default()
        .set_strict_mode(false)
        .set_max_width(usize::MAX)
        .set_max_height(usize::MAX)
        .jpeg_set_out_colorspace(ColorSpace::RGBA);
    let is_jpeg = image::guess_format(bytes).ok()? == image::ImageFormat::Jpeg;
    let mut decoder = is_jpeg.then(|| JpegDecoder::new_with_options(ZCursor::new(bytes), options))?;
    decoder.decode_headers().ok()?;
    // Other colours are left to the general conversion
    if decoder.input_colorspace()? != ColorSpace::YCbCr {
        return None;
    }
    let mut texels = BufferMut::zeroed(width as usize * height as usize);
    decoder.decode_into(texels.as_flattened_mut()).ok()?;
    Some(texels.freeze())
}

/// Decodes an image to 8 bits per channel, opaque where it has no alpha.
fn rgba_texels(decoder: impl ImageDecoder) -> image::ImageResult<Buffer<[u8; 4]>> {
    let (width, height) = decoder.dimensions();
    let mut texels = BufferMut::zeroed(width as usize * height as usize);
    // Decode in place, or convert
    if decoder.color_type() == ColorType::Rgba8 {
        decoder.read_image(texels.as_flattened_mut())?;
        return Ok(texels.freeze());
    }
    match DynamicImage::from_decoder(decoder)? {
        // Most other images; the general conversion takes as long as decoding
        DynamicImage::ImageRgb8(rgb) => {
            for (texel, rgb) in texels.iter_mut().zip(rgb.as_raw().as_chunks::<3>().0) {
                let [r, g, b] = *rgb;
                *texel = [r, g, b, u8::MAX];
            }
        }
        other => texels
            .as_flattened_mut()
            .copy_from_slice(other.into_rgba8().as_raw()),
    }
    Ok(texels.freeze())
}

/// Largest allocation of a decoder for one image: 8 bytes per texel of the largest image allowed by default.
const MAX_DECODER_BYTES: u64 = 8 * LoadOptions::DEFAULT_MAX_TEXELS;

/// Bytes of an encoded image, of a file of its own or of a buffer view.
enum ImageBytes<'a> {
    Own(Bytes),
    Shared(&'a [u8]),
}

impl ImageBytes<'_> {
    fn as_slice(&self) -> &[u8] {
        match self {
            ImageBytes::Own(bytes) => bytes,
            ImageBytes::Shared(bytes) => bytes,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the bytes of an image file.
    fn encoded(image: &DynamicImage, format: image::ImageFormat) -> Vec<u8> {
        let mut bytes = Vec::new();
        image.write_to(&mut Cursor::new(&mut bytes), format).unwrap();
        bytes
    }

    #[test]
    fn opaque_images_convert_as_the_general_conversion_does() {
        let codes: Vec<u8> = (0..3 * 35).map(|i| (i * 37 % 256) as u8).collect();
        let rgb = image::RgbImage::from_raw(7, 5, codes).unwrap();
        let gray = image::GrayImage::from_raw(3, 1, vec![0, 7, 255]).unwrap();
        for image in [
            DynamicImage::from(rgb.clone()),
            gray.into(),
            DynamicImage::from(rgb).to_rgba8().into(),
        ] {
            let expected = image.to_rgba8();
            let bytes = encoded(&image, image::ImageFormat::Png);
            let decoder = image::codecs::png::PngDecoder::new(Cursor::new(&bytes)).unwrap();
            assert_eq!(rgba_texels(decoder).unwrap().as_flattened(), expected.as_raw());
        }
    }

    #[test]
    fn jpeg_images_have_the_codes_of_the_general_decoder() {
        // Sides that are no multiples of the blocks of 8 and 16 pixels
        let image = image::RgbImage::from_fn(61, 45, |x, y| {
            image::Rgb([(4 * x) as u8, (5 * y) as u8, (x * y % 251) as u8])
        });
        let image = DynamicImage::from(image);
        let bytes = encoded(&image, image::ImageFormat::Jpeg);
        let expected = image::load_from_memory(&bytes).unwrap().into_rgba8();
        let texels = rgba_of_jpeg(&bytes, [61, 45]).unwrap();
        assert_eq!(texels.as_flattened(), expected.as_raw());
        // What is no colour JPEG is left to others
        let gray = encoded(&image.to_luma8().into(), image::ImageFormat::Jpeg);
        let png = encoded(&image, image::ImageFormat::Png);
        for bytes in [&gray[..], &png, &bytes[..20], &[]] {
            assert_eq!(rgba_of_jpeg(bytes, [61, 45]), None);
        }
    }
}
