//! Images by their number in the file and the conversion of their texels.

use crate::buffer::{Buffer, BufferMut};

/// Image of the file, and the conversion that a material requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::gltf) struct ImageSource {
    /// Number of the image in the file.
    pub(in crate::gltf) number: usize,
    pub(in crate::gltf) conversion: ImageConversion,
}

/// Conversion of an image's texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::gltf) enum ImageConversion {
    /// The texels as the file has them.
    None,
    /// Roughness in R, which is 1 minus the glossiness in A times a factor.
    RoughnessFromAlpha {
        /// Factor in fractions of 65535.
        glossiness: u16,
    },
}

impl ImageConversion {
    /// Returns the converted texels.
    pub(in crate::gltf) fn apply(self, texels: Buffer<[u8; 4]>) -> Buffer<[u8; 4]> {
        let ImageConversion::RoughnessFromAlpha { glossiness } = self else {
            return texels;
        };
        // A table of the codes of roughness by those of glossiness
        let factor = f64::from(glossiness) / f64::from(u16::MAX);
        let codes: [u8; 256] =
            std::array::from_fn(|code| (f64::from(u8::MAX) - factor * code as f64).round() as u8);
        let mut converted = BufferMut::zeroed(texels.len());
        for (roughness, texel) in converted.iter_mut().zip(texels.iter()) {
            let code = codes[usize::from(texel[3])];
            *roughness = [code, code, code, u8::MAX];
        }
        converted.freeze()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roughness_is_one_minus_the_factor_times_alpha() {
        let texels = Buffer::from(vec![[9, 9, 9, 0], [0, 0, 0, 100], [1, 2, 3, 255]]);
        let red = |glossiness| {
            let conversion = ImageConversion::RoughnessFromAlpha { glossiness };
            let converted = conversion.apply(texels.clone());
            converted.iter().map(|texel| texel[0]).collect::<Vec<u8>>()
        };
        assert_eq!(red(u16::MAX), [255, 155, 0]);
        // 0.2 of 65535 is 13107: 255 - 20 and 255 - 51.
        assert_eq!(red(13107), [255, 235, 204]);
        assert_eq!(ImageConversion::None.apply(texels.clone()), texels);
    }
}
