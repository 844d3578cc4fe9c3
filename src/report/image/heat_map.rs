//! Heat map of the cost of each pixel, on a logarithmic scale with a colour bar below.
//!
//! The colours are evenly spaced in OKLab (B. Ottosson, A perceptual color space for image processing, 2020): lightness
//! rises with the logarithm of the cost while the hue turns from violet over teal to yellow, so that the map is also
//! readable in grey.

use crate::image::LinearImage;

/// Fraction of pixels at either end that may lie beyond the scale: a packet that the system interrupted would stretch
/// it.
const CLIPPED_FRACTION: f64 = 0.001;
/// Chroma in OKLab, the largest that sRGB has for nearly all lightnesses and hues in use.
const CHROMA: f64 = 0.11;
/// OKLab lightness at the ends of the scale.
const LIGHTNESS: [f64; 2] = [0.22, 0.95];
/// OKLab hue at the ends of the scale, in degrees.
const HUE: [f64; 2] = [300.0, 100.0];
/// Height of the colour bar: the image's height over this number, and at least [`MIN_BAR`] rows.
const BAR_PART: u32 = 24;
const MIN_BAR: u32 = 8;

/// Heat map image with its scale.
#[derive(Clone, Debug)]
pub struct HeatMap {
    /// Map with a black row and the colour bar below, whose notches are powers of ten.
    pub image: LinearImage,
    /// Costs at the left and the right end of the bar.
    pub range: [f32; 2],
}

/// Returns the heat map of `costs` in row-major order, `width` to a row. Pixels without cost are black.
pub fn map(costs: &[f32], width: u32) -> HeatMap {
    // Choose the scale and colour each pixel
    let range = scale(costs);
    let [low, high] = range.map(|end| f64::from(end).ln());
    let place = |cost: f32| {
        if high > low {
            ((f64::from(cost).ln() - low) / (high - low)).clamp(0.0, 1.0)
        } else {
            0.5
        }
    };
    let color = |&cost: &f32| {
        if cost > 0.0 { color(place(cost)) } else { [0.0; 3] }
    };
    let mut pixels: Vec<[f32; 3]> = costs.iter().map(color).collect();
    let height = (costs.len() / width.max(1) as usize) as u32;
    // Append a black row and the colour bar
    let bar_height = (height / BAR_PART).max(MIN_BAR);
    pixels.resize(pixels.len() + width as usize, [0.0; 3]);
    for row in 0..bar_height {
        pixels.extend((0..width).map(|x| bar_pixel((x, width), row < bar_height / 3, [low, high])));
    }
    let image = LinearImage {
        width,
        height: height + 1 + bar_height,
        pixels,
    };
    HeatMap { image, range }
}

/// Returns the bar's pixel in column `x` of `width`; if `notched`, columns at powers of ten are black.
fn bar_pixel((x, width): (u32, u32), notched: bool, [low, high]: [f64; 2]) -> [f32; 3] {
    let decade = |x: u32| {
        let at = f64::from(x) / f64::from(width);
        ((low + (high - low) * at) / std::f64::consts::LN_10).floor()
    };
    if notched && decade(x) != decade(x + 1) {
        return [0.0; 3];
    }
    color((f64::from(x) + 0.5) / f64::from(width))
}

/// Returns the smallest and the largest cost of the scale.
fn scale(costs: &[f32]) -> [f32; 2] {
    let mut sorted: Vec<f32> = costs.iter().copied().filter(|&cost| cost > 0.0).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let beyond = (sorted.len() as f64 * CLIPPED_FRACTION) as usize;
    match sorted.len() {
        0 => [1.0; 2],
        n => [sorted[beyond], sorted[n - 1 - beyond]],
    }
}

/// Returns the colour at `place` from 0 to 1 on the scale, in linear RGB.
pub(super) fn color(place: f64) -> [f32; 3] {
    let along = |[from, to]: [f64; 2]| from + (to - from) * place;
    let hue = along(HUE).to_radians();
    let lightness = along(LIGHTNESS);
    let (a, b) = (CHROMA * hue.cos(), CHROMA * hue.sin());
    // Convert OKLab to LMS, and then to linear sRGB
    let l = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let m = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let s = (lightness - 0.089_484_177_5 * a - 1.291_485_548 * b).powi(3);
    [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701 * s,
    ]
    .map(|channel| channel.clamp(0.0, 1.0) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn luminance([r, g, b]: [f32; 3]) -> f32 {
        0.2126 * r + 0.7152 * g + 0.0722 * b
    }

    #[test]
    fn lightness_increases_with_cost() {
        let ramp: Vec<f32> = (0..=50).map(|i| luminance(color(f64::from(i) / 50.0))).collect();
        assert!(ramp.windows(2).all(|pair| pair[0] < pair[1]), "{ramp:?}");
    }

    #[test]
    fn scale_is_logarithmic_and_bar_spans_its_colours() {
        let costs = [1.0, 10.0, 100.0, 0.0];
        let heat = map(&costs, 4);
        assert_eq!(heat.range, [1.0, 100.0]);
        let pixel = |x| heat.image.pixel(x, 0);
        assert_eq!(
            (pixel(0), pixel(1), pixel(2)),
            (color(0.0), color(0.5), color(1.0))
        );
        assert_eq!(pixel(3), [0.0; 3]);
        assert_eq!((heat.image.width, heat.image.height), (4, 1 + 1 + MIN_BAR));
        assert_eq!(heat.image.pixels.len(), 4 * heat.image.height as usize);
        // The centre of the first bar pixel is at 1/8 of the scale.
        assert_eq!(heat.image.pixel(0, heat.image.height - 1), color(0.125));
        // The cost 10 is in the middle of the bar: the notch is where the decade changes.
        assert_eq!(heat.image.pixel(1, 2), [0.0; 3]);
        assert_eq!(heat.image.pixel(1, heat.image.height - 1), color(0.375));
    }

    #[test]
    fn images_of_zero_or_constant_cost_have_a_map() {
        assert_eq!(map(&[0.0; 4], 2).image.pixel(0, 0), [0.0; 3]);
        assert_eq!(map(&[7.0; 4], 2).image.pixel(1, 1), color(0.5));
    }
}
