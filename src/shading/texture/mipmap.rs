//! Mip maps: an image halved repeatedly (Williams, "Pyramidal parametrics", SIGGRAPH 1983).
//!
//! Every level is the exact area average of the next finer one, in linear light. A side of 2m + 1 texels becomes m, of
//! which texel i covers the sources 2i, 2i + 1 and 2i + 2 with weights (m - i, m, i + 1) / (2m + 1): each source has
//! the total weight m / (2m + 1), so the mean is preserved.
//!
//! Levels of images of bytes are linear words, fractions of 65535: lookups mostly wait for memory. Each level rounds by
//! half a word, which is a fortieth of the darkest sRGB code. Levels of images of floats are floats. They take a third
//! of 8 or 16 bytes per texel of the image; the finest level is the image itself.
//!
//! Colours (sRGB) are averaged with their alpha as weight, so that invisible texels do not bleed into visible ones;
//! where all alphas are zero, the weights are equal. In linear images the channels are averaged independently.

use bytemuck::Pod;
use glam::Vec4;

use super::mip_level::{Decoder, MipLevel, mix};
use crate::buffer::{Buffer, BufferMut};
use crate::parallel;
use crate::scene::{Encoding, Sampler};

/// Mip levels of an image, except for the finest one.
#[derive(Clone, Debug, Default)]
pub(super) struct MipMap {
    levels: Vec<StoredLevel>,
}

#[derive(Clone, Debug)]
struct StoredLevel {
    width: u32,
    height: u32,
    texels: LevelTexels,
}

/// Linear texels of a level.
#[derive(Clone, Debug)]
pub(super) enum LevelTexels {
    /// Linear fractions of 65535.
    Words(Buffer<[u16; 4]>),
    Floats(Buffer<[f32; 4]>),
}

impl StoredLevel {
    fn grid(&self) -> MipLevel<'_> {
        MipLevel {
            width: self.width,
            height: self.height,
            texels: match &self.texels {
                LevelTexels::Words(texels) => Decoder::Words(texels),
                LevelTexels::Floats(texels) => Decoder::Floats(texels),
            },
        }
    }
}

impl MipMap {
    /// Returns the bytes of all levels except for the finest, which is the image.
    pub(super) fn byte_count(&self) -> usize {
        self.levels
            .iter()
            .map(|level| match &level.texels {
                LevelTexels::Words(texels) => size_of_val(&texels[..]),
                LevelTexels::Floats(texels) => size_of_val(&texels[..]),
            })
            .sum()
    }

    /// Returns the linear texels of a level above 0, the finest, in row-major order. A side of level i has 2^-i times
    /// the texels of the image's, rounded down but at least one.
    ///
    /// # Panics
    /// If there is no such level.
    #[inline(always)]
    pub(super) fn level_texels(&self, level: usize) -> &LevelTexels {
        &self.levels[level - 1].texels
    }

    /// Builds the levels by halving `finest` until one texel is left.
    pub(super) fn new(finest: MipLevel, encoding: Encoding) -> MipMap {
        let mut levels: Vec<StoredLevel> = Vec::new();
        loop {
            let source = levels.last().map_or(finest, StoredLevel::grid);
            if source.width == 1 && source.height == 1 {
                return MipMap { levels };
            }
            levels.push(halved(source, encoding));
        }
    }

    /// Returns the trilinear lookup for a ray that is `width` texels of the finest level wide: the level is log2 of
    /// that width.
    pub(super) fn trilinear(&self, finest: MipLevel, sampler: Sampler, uv: [f64; 2], width: f64) -> [f32; 4] {
        // Select the level by the width of the ray
        let level = width.log2();
        if !(level > 0.0) || self.levels.is_empty() {
            return finest.bilinear(sampler, uv);
        }
        let at = |level: usize| match level.checked_sub(1) {
            None => finest.bilinear(sampler, uv),
            Some(above) => self.levels[above].grid().bilinear(sampler, uv),
        };
        // Blend the two nearest levels
        let coarsest = self.levels.len();
        if level >= coarsest as f64 {
            return at(coarsest);
        }
        let below = level as usize;
        mix(at(below), at(below + 1), level.fract() as f32)
    }
}

/// Returns the next coarser level of `source`.
fn halved(source: MipLevel, encoding: Encoding) -> StoredLevel {
    let [width, height] = [source.width, source.height].map(|side| (side / 2).max(1));
    StoredLevel {
        width,
        height,
        texels: match source.texels {
            Decoder::Floats(_) => LevelTexels::Floats(halved_texels(source, encoding)),
            Decoder::Bytes(_) | Decoder::SrgbBytes(..) | Decoder::Words(_) => {
                LevelTexels::Words(halved_texels(source, encoding))
            }
        },
    }
}

/// Returns the texels of the next coarser level of `source`.
fn halved_texels<T: StoredTexel>(source: MipLevel, encoding: Encoding) -> Buffer<T> {
    let [width, height] = [source.width, source.height].map(|side| (side as usize / 2).max(1));
    let mut texels = BufferMut::zeroed(width * height);
    parallel::for_each_chunk_mut(&mut texels, width, &|y, row: &mut [T]| {
        if source.width.is_multiple_of(2) && source.height.is_multiple_of(2) {
            return halve_row(source, y, encoding, row);
        }
        let down = Taps::new(y, source.height as usize);
        for (x, texel) in row.iter_mut().enumerate() {
            let taps = Taps::new(x, source.width as usize);
            *texel = T::of_linear(average(source, taps, down, encoding));
        }
    });
    texels.freeze()
}

/// Storage of a texel in a level.
trait StoredTexel: Pod + Send + Sync {
    fn of_linear(value: Vec4) -> Self;

    /// Returns the mean of four texels from the sums of their codes, which are fractions of `MAX`.
    fn of_code_sums<const MAX: u32>(sums: [u32; 4]) -> Self;
}

impl StoredTexel for [f32; 4] {
    #[inline(always)]
    fn of_linear(value: Vec4) -> [f32; 4] {
        value.to_array()
    }

    #[inline(always)]
    fn of_code_sums<const MAX: u32>(sums: [u32; 4]) -> [f32; 4] {
        sums.map(|sum| sum as f32 / (4 * MAX) as f32)
    }
}

impl StoredTexel for [u16; 4] {
    /// Rounds fractions of 1 to the nearest word.
    #[inline(always)]
    fn of_linear(value: Vec4) -> [u16; 4] {
        // Above 2^23 floats are integers, which the low bits of their mantissa number.
        const INTEGERS: f32 = (1 << 23) as f32;
        let words = value * f32::from(u16::MAX) + INTEGERS;
        words.to_array().map(|word| word.to_bits() as u16)
    }

    #[inline(always)]
    fn of_code_sums<const MAX: u32>(sums: [u32; 4]) -> [u16; 4] {
        let words_per_code = const { u16::MAX as u32 / MAX };
        sums.map(|sum| ((sum * words_per_code + 2) >> 2) as u16)
    }
}

/// Writes row `y` of the next coarser level of a source with even sides, of which each texel covers two by two of the
/// source with equal weights.
fn halve_row<T: StoredTexel>(source: MipLevel, y: usize, encoding: Encoding, row: &mut [T]) {
    let width = source.width as usize;
    let first = 2 * y * width;
    let rows = [first..first + width, first + width..first + 2 * width];
    match source.texels {
        Decoder::Bytes(texels) => {
            average_codes::<_, T, { u8::MAX as u32 }>(rows.map(|row| &texels[row]), encoding, row);
        }
        Decoder::SrgbBytes(texels, linear) => {
            let decode = |[r, g, b, a]: [u8; 4]| {
                let code = |code: u8| linear[code as usize];
                Vec4::new(code(r), code(g), code(b), f32::from(a) / 255.0)
            };
            average_pairs(rows.map(|row| &texels[row]), decode, encoding, row);
        }
        Decoder::Words(texels) => {
            average_codes::<_, T, { u16::MAX as u32 }>(rows.map(|row| &texels[row]), encoding, row);
        }
        Decoder::Floats(texels) => {
            average_pairs(rows.map(|row| &texels[row]), Vec4::from_array, encoding, row);
        }
    }
}

/// Writes the means of squares of two by two texels of two rows, whose codes are fractions of `MAX`.
fn average_codes<C: Copy + Into<u32>, T: StoredTexel, const MAX: u32>(
    [upper, lower]: [&[[C; 4]]; 2],
    encoding: Encoding,
    row: &mut [T],
) {
    let (upper, lower) = (upper.as_chunks::<2>().0, lower.as_chunks::<2>().0);
    for (mean, ([a, b], [c, d])) in row.iter_mut().zip(upper.iter().zip(lower)) {
        let texels = [*a, *b, *c, *d].map(|texel| texel.map(Into::<u32>::into));
        let mut sums = [0; 4];
        for channel in 0..4 {
            sums[channel] = texels.iter().map(|texel| texel[channel]).sum();
        }
        let alpha = sums[3];
        *mean = match encoding {
            // Weigh colours by alpha, unless all are equal
            Encoding::Srgb if alpha > 0 && alpha != 4 * MAX => {
                let unit = |code: u32| code as f32 / MAX as f32;
                weighted_mean(texels.map(|texel| Vec4::from_array(texel.map(unit))))
            }
            _ => T::of_code_sums::<MAX>(sums),
        };
    }
}

/// Writes the means of squares of two by two texels of two rows, which `decode` converts to linear values.
fn average_pairs<S: Copy, T: StoredTexel>(
    [upper, lower]: [&[S]; 2],
    decode: impl Fn(S) -> Vec4,
    encoding: Encoding,
    row: &mut [T],
) {
    let (upper, lower) = (upper.as_chunks::<2>().0, lower.as_chunks::<2>().0);
    for (mean, ([a, b], [c, d])) in row.iter_mut().zip(upper.iter().zip(lower)) {
        let texels = [decode(*a), decode(*b), decode(*c), decode(*d)];
        let sum = texels[0] + texels[1] + (texels[2] + texels[3]);
        *mean = match encoding {
            // Weigh colours by alpha, unless all are equal
            Encoding::Srgb if sum.w > 0.0 && sum.w != 4.0 => weighted_mean(texels),
            _ => T::of_linear(0.25 * sum),
        };
    }
}

/// Returns the mean of four texels whose colours are weighted by their alphas, of which some are above zero.
fn weighted_mean<T: StoredTexel>(texels: [Vec4; 4]) -> T {
    let weighted = texels.map(|texel| (texel * texel.w).with_w(texel.w));
    let sum = weighted[0] + weighted[1] + (weighted[2] + weighted[3]);
    T::of_linear((sum / sum.w).with_w(0.25 * sum.w))
}

/// Up to three neighbouring source texels that one texel of the next level covers, with their weights.
#[derive(Clone, Copy)]
struct Taps {
    first: usize,
    count: usize,
    weights: [f64; 3],
}

impl Taps {
    /// Returns the source texels that texel `i` of the next level covers on a side of `size` texels.
    fn new(i: usize, size: usize) -> Taps {
        if size == 1 {
            return Taps {
                first: 0,
                count: 1,
                weights: [1.0, 0.0, 0.0],
            };
        }
        if size.is_multiple_of(2) {
            return Taps {
                first: 2 * i,
                count: 2,
                weights: [0.5, 0.5, 0.0],
            };
        }
        let half = size / 2;
        Taps {
            first: 2 * i,
            count: 3,
            weights: [half - i, half, i + 1].map(|share| share as f64 / size as f64),
        }
    }
}

/// Returns the weighted mean of the texels that `across` and `down` cover. The sum is in f64, so equal texels keep
/// their value.
fn average(source: MipLevel, across: Taps, down: Taps, encoding: Encoding) -> Vec4 {
    let mut sum = [0.0; 4];
    let mut seen = [0.0; 3];
    // Sum the texels, also weighted by alpha
    for j in 0..down.count {
        for i in 0..across.count {
            let weight = across.weights[i] * down.weights[j];
            let texel = source.texel(across.first + i, down.first + j).map(f64::from);
            for channel in 0..3 {
                sum[channel] += weight * texel[channel];
                seen[channel] += weight * texel[3] * texel[channel];
            }
            sum[3] += weight * texel[3];
        }
    }
    // Divide colours by the mean alpha
    if encoding == Encoding::Srgb && sum[3] > 0.0 {
        for channel in 0..3 {
            sum[channel] = seen[channel] / sum[3];
        }
    }
    Vec4::from_array(sum.map(|x| x as f32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Filter, Image, Texels, Wrap};

    const CLAMPED: Sampler = Sampler {
        wrap_u: Wrap::ClampToEdge,
        wrap_v: Wrap::ClampToEdge,
        filter: Filter::Mipmap,
    };

    fn image(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> Image {
        let texels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        Image {
            name: String::new(),
            width,
            height,
            texels: Texels::Bytes(texels.map(|(x, y)| texel(x, y)).collect::<Vec<_>>().into()),
        }
    }

    /// Returns an opaque image of pseudo-random texels.
    fn scrambled(width: u32, height: u32) -> Image {
        image(width, height, |x, y| {
            let h = (x * 73 + y * 151).wrapping_mul(2_654_435_761);
            [(h >> 24) as u8, (h >> 16) as u8, (h >> 8) as u8, 255]
        })
    }

    #[test]
    fn a_constant_image_is_the_same_on_every_level() {
        for (width, height) in [(1, 1), (2, 2), (7, 5), (1, 9), (33, 6), (255, 3)] {
            let image = image(width, height, |_, _| [200, 100, 3, 77]);
            let finest = MipLevel::of_image(&image, Encoding::Srgb);
            let expected = finest.texel(0, 0);
            for level in MipMap::new(finest, Encoding::Srgb).levels {
                for index in 0..(level.width * level.height) as usize {
                    let texel = level.grid().texel(index, 0);
                    for channel in 0..4 {
                        let difference = (texel[channel] - expected[channel]).abs();
                        // Half a word, and the rounding of f32
                        let tolerance = 0.5 / 65535.0 + f32::EPSILON;
                        assert!(
                            difference <= tolerance,
                            "{width} x {height}: {texel:?}, not {expected:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn the_coarsest_level_is_the_mean_of_the_image_in_linear_light() {
        for (width, height) in [(64, 64), (63, 65), (100, 7), (1, 31), (5, 3)] {
            let image = scrambled(width, height);
            let finest = MipLevel::of_image(&image, Encoding::Srgb);
            let mut mean = [0.0; 4];
            for y in 0..height as usize {
                for x in 0..width as usize {
                    let texel = finest.texel(x, y);
                    (0..4).for_each(|c| mean[c] += f64::from(texel[c]) / f64::from(width * height));
                }
            }
            let mip_map = MipMap::new(finest, Encoding::Srgb);
            let coarsest = mip_map.levels.last().unwrap();
            assert_eq!((coarsest.width, coarsest.height), (1, 1));
            for c in 0..4 {
                // Half a word and one f32 rounding per level, of a number below 1.
                let rounding = 0.5 / 65535.0 + f64::from(f32::EPSILON);
                let tolerance = mip_map.levels.len() as f64 * rounding;
                assert!(
                    (f64::from(coarsest.grid().texel(0, 0)[c]) - mean[c]).abs() <= tolerance,
                    "{width} x {height}"
                );
            }
        }
    }

    #[test]
    fn odd_sizes_are_reduced_with_equal_weights() {
        assert_eq!(Taps::new(0, 3).weights, [1.0 / 3.0; 3]);
        // 2½ source texels each: weights (1, 1, ½) and (½, 1, 1) over 2½.
        assert_eq!(Taps::new(0, 5).weights, [0.4, 0.4, 0.2]);
        assert_eq!(Taps::new(1, 5).weights, [0.2, 0.4, 0.4]);
        assert_eq!(Taps::new(1, 5).first, 2);
    }

    #[test]
    fn colour_is_continuous_in_ray_width() {
        let image = scrambled(61, 35);
        let finest = MipLevel::of_image(&image, Encoding::Srgb);
        let mip_map = MipMap::new(finest, Encoding::Srgb);
        let look = |width: f64| mip_map.trilinear(finest, CLAMPED, [0.37, 0.61], width);
        const STEPS: usize = 4000;
        let widths = |i: usize| 0.05 * 4000f64.powf(i as f64 / STEPS as f64);
        for i in 0..STEPS {
            let (a, b) = (look(widths(i)), look(widths(i + 1)));
            // log2(4000) = 12 levels in 4000 steps: no step is more than 0.003 levels, and levels differ by at most 1.
            assert!(
                (0..4).all(|c| (a[c] - b[c]).abs() <= 0.0031),
                "width {}",
                widths(i)
            );
        }
        assert_eq!(look(0.0), finest.bilinear(CLAMPED, [0.37, 0.61]));
        assert_eq!(
            look(f64::INFINITY),
            mip_map.levels.last().unwrap().grid().texel(0, 0)
        );
        assert_eq!(look(f64::NAN), look(0.0));
    }

    #[test]
    fn power_of_two_footprint_selects_a_whole_level() {
        let image = scrambled(64, 64);
        let finest = MipLevel::of_image(&image, Encoding::Linear);
        let mip_map = MipMap::new(finest, Encoding::Linear);
        let second = mip_map.levels[1].grid().bilinear(CLAMPED, [0.3, 0.8]);
        assert_eq!(mip_map.trilinear(finest, CLAMPED, [0.3, 0.8], 4.0), second);
    }

    #[test]
    fn transparent_texels_do_not_affect_visible_colour() {
        let image = image(
            2,
            1,
            |x, _| {
                if x == 0 { [255, 0, 0, 255] } else { [0, 255, 0, 0] }
            },
        );
        let coarsest = |encoding| {
            let mip_map = MipMap::new(MipLevel::of_image(&image, encoding), encoding);
            mip_map.levels[0].grid().texel(0, 0)
        };
        // One half lies between two words, of which the upper one is even.
        let half = 32768.0 / 65535.0;
        assert_eq!(coarsest(Encoding::Srgb), [1.0, 0.0, 0.0, half]);
        assert_eq!(coarsest(Encoding::Linear), [half, half, 0.0, half]);
    }

    #[test]
    fn words_keep_one_and_zero_exactly_and_images_of_floats_stay_floats() {
        let image = image(4, 4, |_, _| [255, 0, 255, 255]);
        let mip_map = MipMap::new(MipLevel::of_image(&image, Encoding::Srgb), Encoding::Srgb);
        assert_eq!(mip_map.levels[1].grid().texel(0, 0), [1.0, 0.0, 1.0, 1.0]);
        assert_eq!(mip_map.byte_count(), (4 + 1) * 8);
        let bright = MipLevel::of_floats(2, 1, &[[1e6, -2.0, 0.0, 1.0]; 2]);
        let mip_map = MipMap::new(bright, Encoding::Linear);
        assert_eq!(mip_map.levels[0].grid().texel(0, 0), [1e6, -2.0, 0.0, 1.0]);
    }
}
