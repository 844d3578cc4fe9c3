//! Procedural textures in f64, directly from their definitions: at a point, or filtered over a ray's footprint.
//!
//! Errors are propagated by differences: each input is moved by its bound in both directions, and the resulting change
//! is doubled to cover the curvature in between.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use whit::scene::{Pattern, Procedural};

use super::approx::{Approx, Approx3, ROUNDING};

/// Permutation table of Ken Perlin ("Improving noise", 2002), which defines the noise.
#[rustfmt::skip]
const PERLIN: [usize; 256] = [
    151, 160, 137, 91, 90, 15, 131, 13, 201, 95, 96, 53, 194, 233, 7, 225, 140, 36, 103, 30, 69, 142, 8, 99, 37, 240,
    21, 10, 23, 190, 6, 148, 247, 120, 234, 75, 0, 26, 197, 62, 94, 252, 219, 203, 117, 35, 11, 32, 57, 177, 33, 88,
    237, 149, 56, 87, 174, 20, 125, 136, 171, 168, 68, 175, 74, 165, 71, 134, 139, 48, 27, 166, 77, 146, 158, 231, 83,
    111, 229, 122, 60, 211, 133, 230, 220, 105, 92, 41, 55, 46, 245, 40, 244, 102, 143, 54, 65, 25, 63, 161, 1, 216,
    80, 73, 209, 76, 132, 187, 208, 89, 18, 169, 200, 196, 135, 130, 116, 188, 159, 86, 164, 100, 109, 198, 173, 186,
    3, 64, 52, 217, 226, 250, 124, 123, 5, 202, 38, 147, 118, 126, 255, 82, 85, 212, 207, 206, 59, 227, 47, 16, 58,
    17, 182, 189, 28, 42, 223, 183, 170, 213, 119, 248, 152, 2, 44, 154, 163, 70, 221, 153, 101, 155, 167, 43, 172, 9,
    129, 22, 39, 253, 19, 98, 108, 110, 79, 113, 224, 232, 178, 185, 112, 104, 218, 246, 97, 228, 251, 34, 242, 193,
    238, 210, 144, 12, 191, 179, 162, 241, 81, 51, 145, 235, 249, 14, 239, 107, 49, 192, 214, 31, 181, 199, 106, 157,
    184, 84, 204, 176, 115, 121, 50, 45, 127, 4, 150, 254, 138, 236, 205, 93, 222, 114, 67, 29, 24, 72, 243, 141, 128,
    195, 78, 66, 215, 61, 156, 180,
];

/// Gradient directions: the twelve midpoints of a cube's edges, four of them twice, as in that paper.
#[rustfmt::skip]
const DIRECTIONS: [[f64; 3]; 16] = [
    [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0],
    [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 0.0, -1.0],
    [0.0, 1.0, 1.0], [0.0, -1.0, 1.0], [0.0, 1.0, -1.0], [0.0, -1.0, -1.0],
    [1.0, 1.0, 0.0], [0.0, -1.0, 1.0], [-1.0, 1.0, 0.0], [0.0, -1.0, -1.0],
];

/// Footprint width in cells from which on an octave has faded out; it fades by a smooth step up to there.
const FADED: f64 = 2.25;
/// Mean magnitude of noise, which replaces an octave of turbulence that has faded out.
const MEAN_MAGNITUDE: f64 = 0.2204;
/// Largest number of samples along a long footprint.
const MAX_POINTS: f64 = 16.0;

/// Returns gradient noise: Σ over the corners of the cell of quintic weight times gradient.
fn noise(p: DVec3) -> f64 {
    let cell = p.floor();
    let at = (p - cell).to_array();
    let lattice = cell.to_array().map(|c| c.rem_euclid(256.0) as usize);
    let fade = at.map(|t| 6.0 * t.powi(5) - 15.0 * t.powi(4) + 10.0 * t.powi(3));
    let mut sum = 0.0;
    for corner in 0..8usize {
        let bit = [corner & 1, corner >> 1 & 1, corner >> 2 & 1];
        let [i, j, k] = [0, 1, 2].map(|axis| (lattice[axis] + bit[axis]) % 256);
        let hash = PERLIN[(PERLIN[(PERLIN[i] + j) % 256] + k) % 256];
        let direction = DIRECTIONS[hash % 16];
        let (mut weight, mut rise) = (1.0, 0.0);
        for axis in 0..3 {
            weight *= if bit[axis] == 1 {
                fade[axis]
            } else {
                1.0 - fade[axis]
            };
            rise += direction[axis] * (at[axis] - bit[axis] as f64);
        }
        sum += weight * rise;
    }
    sum
}

/// Returns the weight of an octave for a footprint of this width in cells.
fn kept(width: f64) -> f64 {
    let x = (width / FADED).clamp(0.0, 1.0);
    1.0 - (3.0 * x.powi(2) - 2.0 * x.powi(3))
}

/// Returns a sum of octaves: octave i has 2^i times the frequency and 2^-i times the amplitude; relative to the sum of
/// the amplitudes.
fn octaves(p: DVec3, count: u32, width: f64, of: fn(f64) -> f64, mean: f64) -> f64 {
    let octave = |i: u32| {
        let frequency = f64::from(1u32 << i);
        let sharp = of(noise(frequency * p));
        (mean + kept(frequency * width) * (sharp - mean)) / frequency
    };
    let heights: f64 = (0..count).map(|i| f64::from(1u32 << i).recip()).sum();
    (0..count).map(octave).sum::<f64>() / heights
}

/// Returns the mean over an interval around `x` of the wave that is 1 from 0 to 1, -1 from 1 to 2, and so on: its
/// integral is the distance from the nearest even number.
fn square_wave(x: f64, width: f64) -> f64 {
    let (low, high) = (x - 0.5 * width, x + 0.5 * width);
    if low.floor() == high.floor() {
        return if low.floor().rem_euclid(2.0) == 0.0 {
            1.0
        } else {
            -1.0
        };
    }
    let integral = |x: f64| (x - 2.0 * (0.5 * x).round()).abs();
    (integral(high) - integral(low)) / width
}

/// Returns the mean over an interval around `x` of x clamped to [0, 1].
fn ramp(x: f64, width: f64) -> f64 {
    let (low, high) = (x - 0.5 * width, x + 0.5 * width);
    if high <= 0.0 || low >= 1.0 || low >= 0.0 && high <= 1.0 {
        return x.clamp(0.0, 1.0);
    }
    // Parts of the interval within the slope and above it.
    let (a, b) = (low.clamp(0.0, 1.0), high.clamp(0.0, 1.0));
    (0.5 * (b - a) * (b + a) + (high - 1.0).max(0.0)) / width
}

/// Returns the factor by which the mean over a box damps a wave with this phase: a sinc for each axis.
fn damping(phase: impl Fn(DVec3) -> f64, p: DVec3, width: DVec3) -> f64 {
    let axes = DVec3::AXES.map(|axis| {
        let y = PI * (phase(p + axis * width) - phase(p));
        if y == 0.0 { 1.0 } else { y.sin() / y }
    });
    axes.into_iter().product()
}

/// Returns the fraction of the second colour in a box of sides `width` around `p`, both in cells.
fn share(pattern: Pattern, p: DVec3, width: DVec3) -> f64 {
    let widest = width.max_element();
    let wave = |phase: &dyn Fn(DVec3) -> f64, of: fn(f64) -> f64| {
        0.5 + 0.5 * of(TAU * phase(p)) * damping(phase, p, width)
    };
    match pattern {
        Pattern::Checker => {
            let waves = [0, 1, 2].map(|axis| square_wave(p[axis], width[axis]));
            0.5 * (1.0 - waves.into_iter().product::<f64>())
        }
        Pattern::Gradient => ramp(p.x, width.x),
        Pattern::Noise { octaves: count } => 0.5 + 0.5 * octaves(p, count, widest, |n| n, 0.0),
        Pattern::Marble {
            octaves: count,
            turbulence,
        } => wave(
            &|p| p.x + turbulence * octaves(p, count, widest, f64::abs, MEAN_MAGNITUDE),
            f64::sin,
        ),
        Pattern::Wood { turbulence } => wave(
            &|p| p.truncate().length() + turbulence * kept(widest) * noise(p),
            |phase| -phase.cos(),
        ),
    }
}

/// Returns the number of parts of a footprint's longer axis, each about as long as the footprint is wide.
pub fn parts(ratio: f64) -> f64 {
    if ratio > 1.0 {
        ratio.ceil().min(MAX_POINTS)
    } else {
        1.0
    }
}

/// Returns the midpoints of `count` parts of an axis of length 1.
pub fn middles(count: f64) -> impl Iterator<Item = f64> {
    (0..count as u32).map(move |i| (f64::from(i) + 0.5) / count - 0.5)
}

/// Returns the mean fraction of the second colour over a footprint: boxes of its width along its longer axis.
fn mean_share(procedural: &Procedural, p: DVec3, [longer, shorter]: [DVec3; 2], ratio: f64) -> f64 {
    let scale = DVec3::from_array(procedural.scale);
    let count = parts(ratio);
    let width = scale.abs() * (longer.abs() / count + shorter.abs());
    let at = |aside: f64| {
        let share = share(procedural.pattern, scale * (p + aside * longer), width);
        share.clamp(0.0, 1.0)
    };
    middles(count).map(at).sum::<f64>() / count
}

/// Evaluates `f` and propagates the errors of its inputs.
fn propagated<const N: usize>(inputs: [Approx; N], f: impl Fn([f64; N]) -> f64) -> Approx {
    let values = inputs.map(|x| x.value);
    let value = f(values);
    let mut error = 0.0;
    for i in 0..N {
        let moved = |by: f64| {
            let mut moved = values;
            moved[i] += by;
            (f(moved) - value).abs()
        };
        if inputs[i].error != 0.0 {
            error += 2.0 * moved(inputs[i].error).max(moved(-inputs[i].error));
        }
    }
    Approx { value, error }
}

/// Returns the fraction of the second colour over a footprint around `p`, all in the pattern's space before its scale.
pub fn second_share(procedural: &Procedural, p: Approx3, axes: [Approx3; 2]) -> Approx {
    let [longer, shorter] = axes.map(|axis| axis.value());
    let ratio = axes[0].length() / axes[1].length();
    let ([px, py, pz], [lx, ly, lz], [sx, sy, sz]) = (p.to_array(), axes[0].to_array(), axes[1].to_array());
    let found = propagated(
        [px, py, pz, lx, ly, lz, sx, sy, sz],
        |[a, b, c, d, e, f, g, h, i]| {
            let axes = [DVec3::new(d, e, f), DVec3::new(g, h, i)];
            mean_share(procedural, DVec3::new(a, b, c), axes, ratio.value)
        },
    );
    // The number of parts may round to the adjacent one.
    let [low, high] = [-1.0, 1.0].map(|side| {
        let ratio = ratio.value + side * ratio.error;
        mean_share(procedural, p.value(), [longer, shorter], ratio)
    });
    found.widened((high - low).abs() + (MAX_POINTS + 4.0) * ROUNDING)
}

/// Returns the derivatives of the red channel by the three coordinates of the pattern's space, for a ray of zero width.
pub fn gradient(procedural: &Procedural, p: Approx3) -> Approx3 {
    let scale = DVec3::from_array(procedural.scale);
    let [first, second] = procedural.colors.map(|color| f64::from(color[0]));
    let slope = |p: DVec3, axis: usize, step: f64| {
        let at = |by: f64| {
            let p = scale * p + by * DVec3::AXES[axis];
            share(procedural.pattern, p, DVec3::ZERO).clamp(0.0, 1.0)
        };
        scale[axis] * (second - first) * (at(step) - at(-step)) / (2.0 * step)
    };
    // The truncation error of the difference falls with the square of the step, and its rounding error grows.
    const STEP: f64 = 1e-5;
    let along = |axis: usize| {
        let found = propagated(p.to_array(), |p| slope(DVec3::from_array(p), axis, STEP));
        let coarser = slope(p.value(), axis, 2.0 * STEP);
        found.widened(2.0 * (coarser - found.value).abs())
    };
    Approx3::from([0, 1, 2].map(along))
}
