//! One mip level: wrap modes, nearest and bilinear lookup, and sRGB decoding.

use std::sync::LazyLock;

use crate::image::linear_from_srgb;
use crate::scene::{Encoding, Image, Sampler, Texels, Wrap};

/// Colour that images have which were not read.
pub(super) const WHITE: [f32; 4] = [1.0; 4];

/// Table of the linear values of the 256 sRGB codes (IEC 61966-2-1).
pub(super) static LINEAR_FROM_SRGB: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|code| linear_from_srgb(code as f64 / 255.0) as f32));

/// Rectangle of texels in row-major order, the top row first.
#[derive(Clone, Copy, Debug)]
pub(super) struct MipLevel<'a> {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) texels: Decoder<'a>,
}

/// Stored texels and the conversion to linear values.
#[derive(Clone, Copy, Debug)]
pub(super) enum Decoder<'a> {
    Bytes(&'a [[u8; 4]]),
    SrgbBytes(&'a [[u8; 4]], &'static [f32; 256]),
    /// Linear fractions of 65535.
    Words(&'a [[u16; 4]]),
    Floats(&'a [[f32; 4]]),
}

impl<'a> MipLevel<'a> {
    /// Creates the finest level from an image as it was read; `encoding` gives the meaning of its bytes.
    pub(super) fn of_image(image: &'a Image, encoding: Encoding) -> MipLevel<'a> {
        let texels = match (&image.texels, encoding) {
            (Texels::Bytes(texels), Encoding::Linear) => Decoder::Bytes(texels),
            (Texels::Bytes(texels), Encoding::Srgb) => Decoder::SrgbBytes(texels, &LINEAR_FROM_SRGB),
            (Texels::Floats(texels), _) => Decoder::Floats(texels),
            (Texels::Unread, _) => return MipLevel::of_floats(1, 1, &[WHITE]),
        };
        MipLevel {
            width: image.width,
            height: image.height,
            texels,
        }
    }

    /// Creates a level of linear floats.
    pub(super) fn of_floats(width: u32, height: u32, texels: &'a [[f32; 4]]) -> MipLevel<'a> {
        MipLevel {
            width,
            height,
            texels: Decoder::Floats(texels),
        }
    }

    /// Returns the linear texel in column `x` and row `y`, both within the level.
    #[inline(always)]
    pub(super) fn texel(&self, x: usize, y: usize) -> [f32; 4] {
        let index = y * self.width as usize + x;
        let unit = |byte: u8| f32::from(byte) / 255.0;
        match self.texels {
            Decoder::Bytes(texels) => texels[index].map(unit),
            Decoder::SrgbBytes(texels, linear) => {
                let [r, g, b, a] = texels[index];
                [
                    linear[r as usize],
                    linear[g as usize],
                    linear[b as usize],
                    unit(a),
                ]
            }
            Decoder::Words(texels) => texels[index].map(|word| f32::from(word) / f32::from(u16::MAX)),
            Decoder::Floats(texels) => texels[index],
        }
    }

    /// Returns the texel that contains (`u`, `v`).
    pub(super) fn nearest(&self, sampler: Sampler, [u, v]: [f64; 2]) -> [f32; 4] {
        let x = (u * f64::from(self.width)).floor();
        let y = (v * f64::from(self.height)).floor();
        self.texel(
            wrap(sampler.wrap_u, x, self.width),
            wrap(sampler.wrap_v, y, self.height),
        )
    }

    /// Returns the bilinear blend of the four texels around (`u`, `v`), whose samples lie at texel centres. Texels are
    /// decoded to linear values before they are blended.
    pub(super) fn bilinear(&self, sampler: Sampler, [u, v]: [f64; 2]) -> [f32; 4] {
        let (x, y) = (u * f64::from(self.width) - 0.5, v * f64::from(self.height) - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let (across, down) = ((x - left) as f32, (y - top) as f32);
        // Wrap the neighbouring columns and rows into the image
        let columns = [left, left + 1.0].map(|x| wrap(sampler.wrap_u, x, self.width));
        let rows = [top, top + 1.0].map(|y| wrap(sampler.wrap_v, y, self.height));
        let row = |y: usize| mix(self.texel(columns[0], y), self.texel(columns[1], y), across);
        mix(row(rows[0]), row(rows[1]), down)
    }
}

/// Interpolates linearly from `a` at 0 to `b` at 1.
#[inline(always)]
pub(super) fn mix(a: [f32; 4], b: [f32; 4], t: f32) -> [f32; 4] {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * t)
}

/// Returns the texel index in 0..size that the integer coordinate `i` wraps to.
fn wrap(mode: Wrap, i: f64, size: u32) -> usize {
    let size = f64::from(size);
    let inside = match mode {
        // Avoid the division in the common case.
        _ if i >= 0.0 && i < size => i,
        Wrap::Repeat => i.rem_euclid(size),
        Wrap::MirroredRepeat => {
            let j = i.rem_euclid(2.0 * size);
            if j < size { j } else { 2.0 * size - 1.0 - j }
        }
        Wrap::ClampToEdge => i,
    };
    // `rem_euclid` may round up to its divisor.
    inside.clamp(0.0, size - 1.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Filter;

    fn black_and_white(white: u8) -> Image {
        Image {
            name: String::new(),
            width: 2,
            height: 1,
            texels: Texels::Bytes(vec![[0, 0, 0, 255], [white; 4]].into()),
        }
    }

    fn sampler(wrap: Wrap) -> Sampler {
        Sampler {
            wrap_u: wrap,
            wrap_v: wrap,
            filter: Filter::Linear,
        }
    }

    #[test]
    fn wrap_modes_repeat_mirror_and_clamp() {
        let image = black_and_white(255);
        let grid = MipLevel::of_image(&image, Encoding::Linear);
        let red = |wrap, u: f64| grid.nearest(sampler(wrap), [u, 0.5])[0];
        // Texels: black on [0, ½), white on [½, 1).
        assert_eq!([red(Wrap::Repeat, 1.25), red(Wrap::Repeat, -0.25)], [0.0, 1.0]);
        assert_eq!(
            [red(Wrap::MirroredRepeat, 1.25), red(Wrap::MirroredRepeat, -0.25)],
            [1.0, 0.0]
        );
        assert_eq!(
            [red(Wrap::ClampToEdge, 7.0), red(Wrap::ClampToEdge, -7.0)],
            [1.0, 0.0]
        );
    }

    #[test]
    fn bilinear_filtering_interpolates_texel_centres() {
        let image = black_and_white(255);
        let grid = MipLevel::of_image(&image, Encoding::Linear);
        let red = |u: f64| grid.bilinear(sampler(Wrap::ClampToEdge), [u, 0.5])[0];
        assert_eq!([red(0.25), red(0.5), red(0.75)], [0.0, 0.5, 1.0]);
    }

    #[test]
    fn srgb_is_decoded_before_mixing() {
        let image = black_and_white(188);
        let red = |u: f64| {
            MipLevel::of_image(&image, Encoding::Srgb).bilinear(sampler(Wrap::ClampToEdge), [u, 0.5])[0]
        };
        // Code 188 is linear 0.5029; half of it is half-way between black and white.
        assert!((red(0.75) - 0.502_886_5).abs() < 1e-6);
        assert!((red(0.5) - 0.251_443_2).abs() < 1e-6);
    }
}
