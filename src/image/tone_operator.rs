//! Tone mapping operators: compression of exposed radiance into the displayable range of 0 to 1, in linear Rec. 709.
//!
//! Sources of the formulas:
//!
//! * `neutral`: Khronos Group, "Khronos PBR Neutral Tone Mapper" (2024).
//! * `aces`: Stephen Hill's fit of the ACES reference rendering transform and output transform for sRGB displays, with
//!   the factor 1 / 0.6 on exposure of three.js' `ACESFilmicToneMapping`.
//! * `agx`: Benjamin Wrensch, "Minimal AgX Implementation" (2024), the approximation of Troy Sobotka's AgX by a
//!   polynomial of order six.

use super::tonemap::ToneMap;
use crate::parallel;

/// Operator that compresses exposed radiance into the displayable range.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
#[schemars(rename = "ToneMap")]
pub enum ToneOperator {
    /// Radiance above 1 is white in each channel, all else is unchanged
    #[default]
    Clip,
    /// Khronos PBR Neutral: base colours stay as they are, highlights lose saturation
    Neutral,
    /// AgX: strong highlights go to white with little shift of hue
    Agx,
    /// ACES filmic curve by Stephen Hill: strong contrast
    Aces,
}

impl ToneOperator {
    /// Returns the displayed colour of exposed linear radiance, each channel from 0 to 1.
    ///
    /// Channels below 0 and NaN count as 0, infinite ones as the largest f32.
    pub fn displayed(self, radiance: [f32; 3]) -> [f32; 3] {
        // The comparison is false for NaN
        let valid = |channel: f32| if channel > 0.0 { channel.min(f32::MAX) } else { 0.0 };
        let color = radiance.map(|channel| f64::from(valid(channel)));
        let mapped = match self {
            ToneOperator::Clip => color,
            ToneOperator::Neutral => neutral(color),
            ToneOperator::Agx => agx(color),
            ToneOperator::Aces => aces(color),
        };
        mapped.map(|channel| channel.clamp(0.0, 1.0) as f32)
    }

    /// Returns the displayed colours of `pixels` after the exposure of `tone`.
    pub(super) fn displayed_pixels(self, pixels: &[[f32; 3]], tone: ToneMap) -> Vec<[f32; 3]> {
        let gain = tone.exposure_ev.exp2();
        parallel::generate(pixels.len(), |index| {
            self.displayed(pixels[index].map(|channel| channel * gain))
        })
    }
}

/// Returns the product of a matrix, given by its rows, and a colour.
fn product(rows: &[[f64; 3]; 3], color: [f64; 3]) -> [f64; 3] {
    rows.map(|row| row[0] * color[0] + row[1] * color[1] + row[2] * color[2])
}

/// Peak from which on the neutral operator compresses.
const NEUTRAL_START: f64 = 0.8 - 0.04;
/// Rate at which compressed colours of the neutral operator lose saturation.
const NEUTRAL_DESATURATION: f64 = 0.15;

fn neutral(color: [f64; 3]) -> [f64; 3] {
    // Subtract the Fresnel reflection of a dielectric, 0.04, with a smooth toe
    let smallest = color[0].min(color[1]).min(color[2]);
    let offset = if smallest < 0.08 {
        smallest - 6.25 * smallest * smallest
    } else {
        0.04
    };
    let color = color.map(|channel| channel - offset);
    let peak = color[0].max(color[1]).max(color[2]);
    if peak < NEUTRAL_START {
        return color;
    }
    // Compress the peak, then mix with white
    let range = 1.0 - NEUTRAL_START;
    let new_peak = 1.0 - range * range / (peak + range - NEUTRAL_START);
    let share = (NEUTRAL_DESATURATION * (peak - new_peak) + 1.0).recip();
    color.map(|channel| channel * (new_peak / peak) * share + new_peak * (1.0 - share))
}

/// Factor on radiance before the ACES fit, with which three.js matches the brightness of other operators.
const ACES_GAIN: f64 = 1.0 / 0.6;
/// Rows of the matrix from linear Rec. 709 to the primaries AP1 with reduced saturation.
const ACES_INPUT: [[f64; 3]; 3] = [
    [0.59719, 0.35458, 0.04823],
    [0.07600, 0.90834, 0.01566],
    [0.02840, 0.13383, 0.83777],
];
/// Rows of the matrix from the output of the fit to linear Rec. 709.
const ACES_OUTPUT: [[f64; 3]; 3] = [
    [1.60475, -0.53108, -0.07367],
    [-0.10208, 1.10813, -0.00605],
    [-0.00327, -0.07276, 1.07602],
];

fn aces(color: [f64; 3]) -> [f64; 3] {
    let fit = |v: f64| {
        let over = v * (v + 0.024_578_6) - 0.000_090_537;
        over / (v * (0.983_729 * v + 0.432_951_0) + 0.238_081)
    };
    // Convert the primaries, apply the fit, and convert back
    let input = product(&ACES_INPUT, color.map(|channel| channel * ACES_GAIN));
    product(&ACES_OUTPUT, input.map(fit))
}

/// Rows of the matrix that moves the primaries inwards before the curve of AgX.
const AGX_INSET: [[f64; 3]; 3] = [
    [
        0.842_479_062_253_094,
        0.078_433_599_999_999_2,
        0.079_223_745_147_764_3,
    ],
    [
        0.042_328_242_261_012_3,
        0.878_468_636_469_772,
        0.079_166_127_460_544_3,
    ],
    [0.042_375_654_905_705_1, 0.078_433_6, 0.879_142_973_793_104],
];
/// Rows of the matrix that moves the primaries back after the curve of AgX.
const AGX_OUTSET: [[f64; 3]; 3] = [
    [
        1.196_879_005_120_17,
        -0.098_020_881_140_136_8,
        -0.099_029_744_079_720_5,
    ],
    [
        -0.052_896_851_757_456_2,
        1.151_903_129_904_17,
        -0.098_961_176_844_843_3,
    ],
    [
        -0.052_971_635_514_443_8,
        -0.098_043_450_117_124_1,
        1.151_073_672_641_16,
    ],
];
/// Range of the logarithmic encoding of AgX: -10 to 6.5 stops around middle grey, 0.18.
const AGX_STOPS: [f64; 2] = [-12.473_93, 4.026_069];
/// Smallest radiance of which the logarithm is taken.
const AGX_SMALLEST: f64 = 1e-10;
/// Coefficients of the curve of AgX, beginning with that of the sixth power.
const AGX_CURVE: [f64; 7] = [15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232];
/// Exponent of the display that AgX encodes for.
const AGX_GAMMA: f64 = 2.2;

fn agx(color: [f64; 3]) -> [f64; 3] {
    let [low, high] = AGX_STOPS;
    let curve = |v: f64| {
        let stops = v.max(AGX_SMALLEST).log2().clamp(low, high);
        let x = (stops - low) / (high - low);
        AGX_CURVE
            .iter()
            .fold(0.0, |sum, coefficient| sum * x + coefficient)
    };
    // Apply the curve between primaries that are moved inwards and back
    let encoded = product(&AGX_OUTSET, product(&AGX_INSET, color).map(curve));
    // Make the display-encoded values linear
    encoded.map(|v| v.max(0.0).powf(AGX_GAMMA))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [ToneOperator; 4] = [
        ToneOperator::Clip,
        ToneOperator::Neutral,
        ToneOperator::Agx,
        ToneOperator::Aces,
    ];

    #[test]
    fn operators_give_the_values_of_their_published_formulas() {
        // The published formulas evaluated in Python with 40 decimal digits (`decimal`), rounded to seven.
        use ToneOperator::{Aces, Agx, Neutral};
        let expected = [
            (Neutral, [0.01, 0.01, 0.01], [0.000_625, 0.000_625, 0.000_625]),
            (Agx, [0.01, 0.01, 0.01], [0.005_994_7, 0.005_995_3, 0.005_995_3]),
            (Aces, [0.01, 0.01, 0.01], [0.002_430_6, 0.002_430_6, 0.002_430_6]),
            (Neutral, [0.18, 0.18, 0.18], [0.14, 0.14, 0.14]),
            (Agx, [0.18, 0.18, 0.18], [0.214_467_4, 0.214_532_7, 0.214_536_7]),
            (Aces, [0.18, 0.18, 0.18], [0.213_105_4, 0.213_105_4, 0.213_103_3]),
            (Neutral, [0.5, 0.25, 0.125], [0.46, 0.21, 0.085]),
            (Agx, [0.5, 0.25, 0.125], [0.441_498_9, 0.279_311_2, 0.168_905_3]),
            (Aces, [0.5, 0.25, 0.125], [0.567_158_6, 0.320_864_7, 0.158_905_3]),
            (
                Neutral,
                [4.0, 0.5, 0.0625],
                [0.983_265_1, 0.382_885_5, 0.307_838_1],
            ),
            (Agx, [4.0, 0.5, 0.0625], [0.953_640_9, 0.478_343_5, 0.249_776_3]),
            (Aces, [4.0, 0.5, 0.0625], [1.0, 0.670_750_7, 0.257_473_5]),
            (
                Neutral,
                [0.0625, 2.0, 16.0],
                [0.689_708_1, 0.726_976_4, 0.996_269_9],
            ),
            (Agx, [0.0625, 2.0, 16.0], [0.639_848_3, 0.811_111_0, 1.0]),
            (Aces, [0.0625, 2.0, 16.0], [0.812_066_8, 0.895_931_7, 1.0]),
        ];
        for (operator, radiance, wanted) in expected {
            let displayed = operator.displayed(radiance);
            for channel in 0..3 {
                // Seven decimals, and an f32 input and output with errors of 2^-24 each.
                let difference = f64::from(displayed[channel]) - wanted[channel];
                assert!(
                    difference.abs() < 3e-7,
                    "{operator:?} {radiance:?}: {displayed:?}"
                );
            }
        }
    }

    #[test]
    fn brighter_grey_is_never_displayed_darker() {
        for operator in ALL {
            let mut before = [0.0; 3];
            for step in -200..200 {
                let displayed = operator.displayed([(0.1 * step as f32).exp2(); 3]);
                for channel in 0..3 {
                    assert!(displayed[channel] >= before[channel], "{operator:?} 2^{step}/10");
                }
                before = displayed;
            }
            assert!(
                before.iter().all(|&channel| channel > 0.99),
                "{operator:?} {before:?}"
            );
        }
    }

    #[test]
    fn any_radiance_is_displayed_between_black_and_white() {
        let levels = [
            f32::NAN,
            -1.0,
            0.0,
            1e-40,
            0.02,
            0.7,
            3.0,
            1e9,
            f32::MAX,
            f32::INFINITY,
        ];
        for operator in ALL {
            for (r, g, b) in levels.iter().flat_map(|&r| {
                let pairs = levels.iter().flat_map(|&g| levels.iter().map(move |&b| (g, b)));
                pairs.map(move |(g, b)| (r, g, b))
            }) {
                let displayed = operator.displayed([r, g, b]);
                let is_valid = displayed.iter().all(|channel| (0.0..=1.0).contains(channel));
                assert!(is_valid, "{operator:?} of {r} {g} {b}: {displayed:?}");
            }
        }
    }
}
