//! Tone mapping of linear radiance to 8- or 16-bit sRGB: exposure, the exact curve, rounding to the nearest code.
//!
//! For eight bits the curve of IEC 61966-2-1 is inverted: a code is the number of thresholds, out of the 255 radiances
//! at which the rounded curve steps, that are not above the radiance. No power is computed per pixel, and the result is
//! exact. The exponent and leading mantissa bits of the float index a table of starting codes at most two steps too
//! low.

use std::sync::LazyLock;

use super::LinearImage;
use crate::parallel;

/// Mapping of radiance to displayed values: exposure and the sRGB curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ToneMap {
    /// Exposure in stops: radiance is multiplied by 2 to this power; 1 is then white.
    pub exposure_ev: f32,
}

impl ToneMap {
    /// Returns the 8-bit sRGB pixels of `image`, three bytes each, top row first.
    ///
    /// Radiance above 1 is white, below 0 and NaN black.
    pub fn srgb_bytes(&self, image: &LinearImage) -> Vec<u8> {
        self.srgb_codes(&image.pixels)
    }

    /// Returns the 8-bit sRGB codes of `pixels`, three bytes each.
    pub(super) fn srgb_codes(&self, pixels: &[[f32; 3]]) -> Vec<u8> {
        let gain = self.exposure_ev.exp2();
        let curve = &*CURVE;
        let mut bytes = vec![0; 3 * pixels.len()];
        let values = pixels.as_flattened();
        parallel::for_each_chunk_mut(&mut bytes, CHUNK, &|chunk, bytes| {
            for (byte, &value) in bytes.iter_mut().zip(&values[chunk * CHUNK..]) {
                *byte = curve.code(value * gain);
            }
        });
        bytes
    }

    /// Returns the 16-bit sRGB codes of `pixels`, three codes each, in big-endian order.
    pub(super) fn srgb_codes16(&self, pixels: &[[f32; 3]]) -> Vec<u8> {
        let gain = self.exposure_ev.exp2();
        let mut bytes = vec![[0; 2]; 3 * pixels.len()];
        let values = pixels.as_flattened();
        parallel::for_each_chunk_mut(&mut bytes, CHUNK, &|chunk, codes| {
            for (code, &value) in codes.iter_mut().zip(&values[chunk * CHUNK..]) {
                *code = code16(value * gain).to_be_bytes();
            }
        });
        bytes.into_flattened()
    }
}

/// Number of channel values that a thread processes as one unit of work.
const CHUNK: usize = 3 << 14;

/// Returns the 16-bit sRGB code of a radiance, rounded to nearest; NaN is black.
fn code16(radiance: f32) -> u16 {
    let encoded = srgb_from_linear(f64::from(radiance));
    // The cast saturates, and converts NaN to zero.
    (encoded * f64::from(u16::MAX)).round() as u16
}

/// Returns the sRGB value of a radiance: the inverse of [`linear_from_srgb`].
fn srgb_from_linear(radiance: f64) -> f64 {
    let encoded = 12.92 * radiance;
    if encoded <= 0.040_45 {
        encoded
    } else {
        1.055 * radiance.powf(1.0 / 2.4) - 0.055
    }
}

/// Returns the radiance of an sRGB value in [0, 1] (IEC 61966-2-1).
pub fn linear_from_srgb(encoded: f64) -> f64 {
    if encoded <= 0.040_45 {
        encoded / 12.92
    } else {
        ((encoded + 0.055) / 1.055).powf(2.4)
    }
}

/// Mantissa bits of the table's index: 2^-7 of a value is less than one code's width where codes are narrow.
const MANTISSA_BITS: u32 = 7;
const SHIFT: u32 = f32::MANTISSA_DIGITS - 1 - MANTISSA_BITS;
/// Bit pattern of 2^-13, the table's first value, below the first step at 1/(2·255·12.92) = 2^-12.7.
const FIRST_BITS: u32 = (127 - 13) << (f32::MANTISSA_DIGITS - 1);
const LAST_BITS: u32 = 1f32.to_bits();

/// Threshold radiances and the table of starting codes for the search.
struct ToneCurve {
    /// Threshold `steps[c]`: smallest f32 whose code is more than `c`.
    steps: [f32; 255],
    start: Vec<u8>,
}

static CURVE: LazyLock<ToneCurve> = LazyLock::new(|| {
    // Round each threshold up to the next f32
    let steps = std::array::from_fn(|code| {
        let step = linear_from_srgb((code as f64 + 0.5) / 255.0);
        let rounded = step as f32;
        if f64::from(rounded) < step {
            rounded.next_up()
        } else {
            rounded
        }
    });
    // Count the thresholds below each table entry
    let start = (FIRST_BITS >> SHIFT..=LAST_BITS >> SHIFT)
        .map(|index| {
            let low = f32::from_bits(index << SHIFT);
            steps.partition_point(|&step| step <= low) as u8
        })
        .collect();
    ToneCurve { steps, start }
});

impl ToneCurve {
    /// Returns the code of a radiance: the number of thresholds at or below it.
    #[inline(always)]
    fn code(&self, radiance: f32) -> u8 {
        // The negated comparison makes NaN black.
        if !(radiance >= self.steps[0]) {
            return 0;
        }
        if radiance >= self.steps[254] {
            return 255;
        }
        let mut code = self.start[((radiance.to_bits() - FIRST_BITS) >> SHIFT) as usize];
        while radiance >= self.steps[code as usize] {
            code += 1;
        }
        code
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the code by the standard's formula with rounding.
    fn code_by_the_book(radiance: f64) -> u8 {
        let encoded = if radiance <= 0.003_130_8 {
            12.92 * radiance
        } else {
            1.055 * radiance.powf(1.0 / 2.4) - 0.055
        };
        (255.0 * encoded.clamp(0.0, 1.0)).round() as u8
    }

    #[test]
    fn every_radiance_gets_the_srgb_code() {
        // The standard's two pieces agree at their border only within 1e-7, far less than the half code that separates
        // steps: no tolerance is needed at points which are not themselves steps.
        let curve = &*CURVE;
        for bits in (1e-6f32.to_bits()..2f32.to_bits()).step_by(97) {
            let radiance = f32::from_bits(bits);
            assert_eq!(
                curve.code(radiance),
                code_by_the_book(f64::from(radiance)),
                "radiance {radiance}"
            );
        }
    }

    #[test]
    fn codes_step_exactly_at_their_thresholds() {
        let curve = &*CURVE;
        for (code, &step) in curve.steps.iter().enumerate() {
            assert_eq!(usize::from(curve.code(step.next_down())), code);
            assert_eq!(usize::from(curve.code(step)), code + 1);
        }
    }

    #[test]
    fn invalid_radiance_is_black_and_overflow_is_white() {
        let curve = &*CURVE;
        let dark = [f32::NAN, -f32::NAN, -1.0, f32::NEG_INFINITY, -0.0, 1e-40];
        assert_eq!(dark.map(|r| curve.code(r)), [0; 6]);
        assert_eq!([1.0, 7.0, f32::INFINITY].map(|r| curve.code(r)), [255; 3]);
    }

    #[test]
    fn sixteen_bit_codes_resolve_the_curve_and_clamp() {
        for code in 0..=u16::MAX {
            let radiance = linear_from_srgb(f64::from(code) / 65535.0);
            assert_eq!(code16(radiance as f32), code);
        }
        let beyond = [f32::NAN, -1.0, f32::NEG_INFINITY, 7.0, f32::INFINITY];
        assert_eq!(beyond.map(code16), [0, 0, 0, u16::MAX, u16::MAX]);
        let pixel = [[0.25, 0.5, 1.0]];
        let stop = ToneMap { exposure_ev: 1.0 };
        let brighter = stop.srgb_codes16(&pixel);
        // 1.055 · 0.5^(1/2.4) - 0.055 = 0.7353570 -> 48191.6 = 0xbc40
        assert_eq!(brighter, [0xbc, 0x40, 0xff, 0xff, 0xff, 0xff]);
    }

    #[test]
    fn one_stop_doubles_the_radiance() {
        let image = |radiance| LinearImage {
            width: 1,
            height: 1,
            pixels: vec![[radiance, 2.0 * radiance, 0.0]],
        };
        let brighter = ToneMap { exposure_ev: 1.0 }.srgb_bytes(&image(0.2));
        assert_eq!(brighter, ToneMap::default().srgb_bytes(&image(0.4)));
        // 0.4 -> 1.055 · 0.4^(1/2.4) - 0.055 = 0.66519 -> 169.6, 0.8 -> 0.90633 -> 231.1
        assert_eq!(brighter, [170, 231, 0]);
    }
}
