//! Procedural textures, averaged over the ray's footprint: a box around the point, along the axes of the pattern's
//! space.
//!
//! Checker and gradient are averaged exactly, by the integral of the pattern (Heckbert, "Filtering by repeated
//! integration", SIGGRAPH 1986). The sine of marble and wood is damped by the exact factor sinc of the phase that the
//! box spans, as if the phase were linear there. Noise drops the octaves that the box cannot resolve
//! ([`crate::numeric::noise`]).

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use multiversion::multiversion;

use super::{MAX_PROBES, UvPacket};
use crate::numeric::lane_math::sin_cos;
use crate::numeric::noise::{fractal, lone, noise_at, remaining_amplitude, turbulence};
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Pattern, Procedural, Space, UvTransform};

/// Points of sixteen lookups in the space of a pattern, before its scale.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PatternPacket {
    /// Points that are looked up.
    pub(crate) p: Lanes3<f64>,
    /// Axes of the rays' footprints as full lengths, the longer first.
    pub(crate) axes: [Lanes3<f64>; 2],
}

impl PatternPacket {
    /// Points at the origin, without footprints.
    pub(crate) const ZERO: PatternPacket = PatternPacket {
        p: [[0.0; LANES]; 3],
        axes: [[[0.0; LANES]; 3]; 2],
    };

    /// Sets the points to those of texture coordinates after `transform`.
    #[inline(always)]
    pub(crate) fn set_coordinates(&mut self, points: &UvPacket, transform: &UvTransform) {
        let points = points.transformed(transform);
        self.p = wide(&points.uv);
        self.axes = points.axes.each_ref().map(wide);
    }
}

/// Returns texture coordinates as points of the plane z = 0.
#[inline(always)]
fn wide([u, v]: &[Lanes<f32>; 2]) -> Lanes3<f64> {
    [u.map(f64::from), v.map(f64::from), [0.0; LANES]]
}

/// Returns the linear RGBA at `p`, in the pattern's space but before its scale, averaged over a box of sides `width`
/// there.
#[inline]
pub(super) fn sample(procedural: &Procedural, p: DVec3, width: DVec3) -> [f32; 4] {
    let [second] = scaled_weights(procedural, &lone(p), &lone(width));
    let [a, b] = procedural.colors;
    std::array::from_fn(|i| (1.0 - second) * a[i] + second * b[i])
}

/// Sets the linear RGBA of the lanes in `mask` to means over the footprints of `points`; other lanes get any values. Each
/// is the mean of several boxes along the longer axis, as in [`super::TextureSet::sample_footprint`], the scalar referee.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn sample_packet(
    procedural: &Procedural,
    points: &PatternPacket,
    mask: &Lanes<bool>,
    texels: &mut Lanes<[f32; 4]>,
) {
    let [longer, shorter] = &points.axes;
    // Count the boxes along the longer axes, and choose their widths
    let mut counts = [1.0; LANES];
    for l in 0..LANES {
        let length = |axis: &Lanes3<f64>| {
            (axis[0][l] * axis[0][l] + axis[1][l] * axis[1][l] + axis[2][l] * axis[2][l]).sqrt()
        };
        let ratio = (length(longer) / length(shorter)).ceil();
        // An axis of zero length gives an infinite ratio; NaN means that both are zero
        counts[l] = if ratio > 1.0 { ratio.min(MAX_PROBES) } else { 1.0 };
    }
    // Cover the footprint by the widths of the boxes
    let mut width = [[0.0; LANES]; 3];
    for axis in 0..3 {
        for l in 0..LANES {
            width[axis][l] = shorter[axis][l].abs() + longer[axis][l].abs() / counts[l];
        }
    }
    // List the lane of each box, as some lanes have many and others few
    let mut lanes = [0u8; LANES * MAX_PROBES as usize];
    let mut box_count = 0;
    for l in (0..LANES).filter(|&l| mask[l]) {
        let end = box_count + counts[l] as usize;
        lanes[box_count..end].fill(l as u8);
        box_count = end;
    }
    // Add up the colours of the boxes, sixteen at a time
    let [a, b] = procedural.colors;
    let (mut sums, mut begun) = ([[0.0; 4]; LANES], [0.0; LANES]);
    for lanes in lanes[..box_count].chunks(LANES) {
        let (mut p, mut sides) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        for (k, &l) in lanes.iter().enumerate() {
            let l = usize::from(l) % LANES;
            let along = (begun[l] + 0.5) / counts[l] - 0.5;
            begun[l] += 1.0;
            for axis in 0..3 {
                p[axis][k] = points.p[axis][l] + longer[axis][l] * along;
                sides[axis][k] = width[axis][l];
            }
        }
        let weights = scaled_weights(procedural, &p, &sides);
        for (&l, weight) in lanes.iter().zip(weights) {
            let sum = &mut sums[usize::from(l) % LANES];
            for channel in 0..4 {
                sum[channel] += (1.0 - weight) * a[channel] + weight * b[channel];
            }
        }
    }
    // Divide by their number
    for l in 0..LANES {
        for channel in 0..4 {
            texels[l][channel] = sums[l][channel] / counts[l] as f32;
        }
    }
}

/// Returns the derivative of the red channel by `p`, averaged over a box of sides `width`: central differences over the
/// box, or over the step with the least rounding error where the box has no width.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn gradient(procedural: &Procedural, p: DVec3, width: DVec3) -> DVec3 {
    /// Relative step of the difference: the cube root of f64's epsilon, 2^-52. It balances the error of the difference,
    /// step², and its rounding, which grows with the coordinate: epsilon |p| / step.
    const STEP: f64 = 1.0 / (1 << 17) as f64;
    let scale = procedural.scale;
    let mut steps = [0.0; 3];
    // Place two points along each axis; the last pair fills the lanes
    let mut points = [[0.0; 8]; 3];
    let mut sides = [[0.0; 8]; 3];
    for axis in 0..3 {
        let center = finite(scale[axis] * p[axis]);
        let side = finite_width(scale[axis] * width[axis]);
        let half = 0.5 * side;
        // A root of a number beyond 1 is smaller than the number
        let is_wide = half >= STEP * center.abs().max(1.0);
        steps[axis] = if is_wide {
            half
        } else {
            half.max(STEP * center.abs().cbrt().max(1.0))
        };
        points[axis] = [center; 8];
        points[axis][2 * axis] += steps[axis];
        points[axis][2 * axis + 1] -= steps[axis];
        sides[axis] = [side; 8];
    }
    let weights = second_color_weights(procedural.pattern, &points, &sides);
    // Take central differences
    let [a, b] = procedural.colors;
    let range = f64::from(b[0]) - f64::from(a[0]);
    let mut gradient = DVec3::ZERO;
    for axis in 0..3 {
        let difference = weights[2 * axis].clamp(0.0, 1.0) - weights[2 * axis + 1].clamp(0.0, 1.0);
        gradient[axis] = scale[axis] * range * difference / (2.0 * steps[axis]);
    }
    gradient
}

/// Returns the sides of the box for a ray of which only its `width` is given.
///
/// A surface that lies in a face of a three-dimensional checker has coordinates exactly on the face. A box across that
/// face would blend both sides all over the surface, so it has zero width there.
pub(super) fn isotropic(procedural: &Procedural, p: DVec3, width: f64) -> DVec3 {
    if procedural.space == Space::Uv {
        return DVec3::new(width, width, 0.0);
    }
    let across = DVec3::from_array(procedural.scale) * p;
    DVec3::from_array(across.to_array().map(|x| {
        let in_face = procedural.pattern == Pattern::Checker && x == x.floor();
        if in_face { 0.0 } else { width }
    }))
}

/// Returns the weights of the second colour at `N` points before the pattern's scale, within [0, 1].
#[inline(always)]
fn scaled_weights<const N: usize>(
    procedural: &Procedural,
    p: &[[f64; N]; 3],
    width: &[[f64; N]; 3],
) -> [f32; N] {
    // Scale points and boxes, and keep both in the range of the patterns
    let mut scaled = [[0.0; N]; 3];
    let mut sides = [[0.0; N]; 3];
    for axis in 0..3 {
        let scale = procedural.scale[axis];
        for l in 0..N {
            scaled[axis][l] = finite(scale * p[axis][l]);
            sides[axis][l] = finite_width(scale * width[axis][l]);
        }
    }
    let weights = second_color_weights(procedural.pattern, &scaled, &sides);
    let mut clamped = [0.0; N];
    for l in 0..N {
        clamped[l] = weights[l].clamp(0.0, 1.0) as f32;
    }
    clamped
}

/// Returns the weights of the second colour at `N` points, averaged over boxes of sides `width`.
#[inline(always)]
fn second_color_weights<const N: usize>(
    pattern: Pattern,
    p: &[[f64; N]; 3],
    width: &[[f64; N]; 3],
) -> [f64; N] {
    let mut weights = [0.0; N];
    match pattern {
        Pattern::Checker => {
            for l in 0..N {
                let square = |axis: usize| mean_square_wave(p[axis][l], width[axis][l]);
                weights[l] = 0.5 - 0.5 * square(0) * square(1) * square(2);
            }
        }
        Pattern::Gradient => {
            for l in 0..N {
                weights[l] = mean_ramp(p[0][l], width[0][l]);
            }
        }
        Pattern::Noise { octaves } => {
            let noise = fractal(p, octaves, &widest_sides(width));
            for l in 0..N {
                weights[l] = 0.5 + 0.5 * noise[l];
            }
        }
        Pattern::Marble { .. } => {
            let wave = Wave::of(pattern, p, width);
            for l in 0..N {
                weights[l] = 0.5 + 0.5 * sine(wave.phase[l]) * wave.damping[l];
            }
        }
        Pattern::Wood { .. } => {
            let wave = Wave::of(pattern, p, width);
            for l in 0..N {
                weights[l] = 0.5 - 0.5 * cosine(wave.phase[l]) * wave.damping[l];
            }
        }
    }
    weights
}

/// Waves of period 1 at `N` points, averaged over boxes.
struct Wave<const N: usize> {
    phase: [f64; N],
    /// Amplitudes that remain after averaging over the boxes: exact where the phase is linear.
    damping: [f64; N],
}

impl<const N: usize> Wave<N> {
    /// Returns the waves of marble or wood, averaged over boxes of sides `width`.
    #[inline(always)]
    fn of(pattern: Pattern, p: &[[f64; N]; 3], width: &[[f64; N]; 3]) -> Wave<N> {
        let widest = widest_sides(width);
        let mut wave = Wave {
            phase: [0.0; N],
            damping: [1.0; N],
        };
        // Evaluate the phase at the points, then a box's width beyond along each axis
        for step in 0..4 {
            let mut moved = *p;
            if step > 0 {
                let width = &width[step - 1];
                if width.iter().all(|&side| side == 0.0) {
                    continue;
                }
                for l in 0..N {
                    moved[step - 1][l] += width[l];
                }
            }
            let phases = phases(pattern, &moved, &widest);
            if step == 0 {
                wave.phase = phases;
                continue;
            }
            // Multiply the sinc factor of the axis; a side of zero length has none
            for l in 0..N {
                let factor = sinc(phases[l] - wave.phase[l]);
                wave.damping[l] *= if width[step - 1][l] == 0.0 { 1.0 } else { factor };
            }
        }
        wave
    }
}

/// Returns the phases of marble or wood in turns; zero for other patterns.
#[inline(always)]
fn phases<const N: usize>(pattern: Pattern, p: &[[f64; N]; 3], widest: &[f64; N]) -> [f64; N] {
    let mut phases = [0.0; N];
    match pattern {
        Pattern::Marble {
            octaves,
            turbulence: shift,
        } => {
            let turbulence = turbulence(p, octaves, widest);
            for l in 0..N {
                phases[l] = p[0][l] + shift * turbulence[l];
            }
        }
        Pattern::Wood { turbulence: shift } => {
            let noise = noise_at(p);
            for l in 0..N {
                let radius = (p[0][l] * p[0][l] + p[1][l] * p[1][l]).sqrt();
                phases[l] = radius + shift * remaining_amplitude(widest[l]) * noise[l];
            }
        }
        Pattern::Checker | Pattern::Gradient | Pattern::Noise { .. } => {}
    }
    phases
}

/// Returns the longest sides of `N` boxes.
#[inline(always)]
fn widest_sides<const N: usize>(width: &[[f64; N]; 3]) -> [f64; N] {
    let mut widest = [0.0; N];
    for l in 0..N {
        widest[l] = width[0][l].max(width[1][l].max(width[2][l]));
    }
    widest
}

/// Returns the mean over [x - width/2, x + width/2] of the square wave that is 1 on [0, 1), -1 on [1, 2), and so on.
#[inline(always)]
fn mean_square_wave(x: f64, width: f64) -> f64 {
    let periodic = |x: f64| x - 2.0 * (0.5 * x).floor();
    let x = periodic(x);
    let (low, high) = (x - 0.5 * width, x + 0.5 * width);
    // The integral of the square wave is a triangle wave of height 1
    let integral = |x: f64| 1.0 - (periodic(x) - 1.0).abs();
    let mean = ((integral(high) - integral(low)) / width).clamp(-1.0, 1.0);
    // Within one cell the wave is constant
    let cell = low.floor();
    let is_even = 0.5 * cell == (0.5 * cell).floor();
    let constant = if is_even { 1.0 } else { -1.0 };
    if cell == high.floor() { constant } else { mean }
}

/// Returns the mean over [x - width/2, x + width/2] of x clamped to [0, 1].
#[inline(always)]
fn mean_ramp(x: f64, width: f64) -> f64 {
    let (low, high) = (x - 0.5 * width, x + 0.5 * width);
    // Integral from 0 to x: half the square up to 1, then x - 1 more.
    let integral = |x: f64| {
        let inside = x.clamp(0.0, 1.0);
        0.5 * (inside * inside) + (x - 1.0).max(0.0)
    };
    let mean = (integral(high) - integral(low)) / width;
    // Without a bend in the interval it is the middle
    let bends = (low < 0.0) & (high > 0.0) | (low < 1.0) & (high > 1.0);
    if bends { mean } else { x.clamp(0.0, 1.0) }
}

/// Returns sin(πx) / (πx), and 1 at 0.
#[inline(always)]
fn sinc(x: f64) -> f64 {
    let factor = sine(0.5 * x) / (PI * x);
    if x == 0.0 { 1.0 } else { factor }
}

/// Returns the sine of an angle in turns, with full relative accuracy near 0.
#[inline(always)]
fn sine(turns: f64) -> f64 {
    sin_cos(TAU * (turns - turns.round_ties_even()))[0]
}

/// Returns the cosine of an angle in turns.
#[inline(always)]
fn cosine(turns: f64) -> f64 {
    sin_cos(TAU * (turns - turns.round_ties_even()))[1]
}

/// Replaces a coordinate by 0 that is not finite, or so large that it has no fractional bits.
#[inline(always)]
fn finite(x: f64) -> f64 {
    const NO_FRACTION: f64 = (1u64 << 52) as f64;
    if x.abs() < NO_FRACTION { x } else { 0.0 }
}

/// Returns the absolute width; NaN counts as 0, and an infinite width as far more than any pattern's period.
#[inline(always)]
fn finite_width(width: f64) -> f64 {
    const BOUNDLESS: f64 = 1e30;
    if width.is_nan() {
        0.0
    } else {
        width.abs().min(BOUNDLESS)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Returns the weight of the second colour at `p`, averaged over a box of sides `width`.
    fn second_color_weight(pattern: Pattern, p: DVec3, width: DVec3) -> f64 {
        let [weight] = second_color_weights(pattern, &lone(p), &lone(width));
        weight
    }

    /// Returns one pattern of each kind.
    pub(in super::super) fn patterns() -> [Pattern; 5] {
        [
            Pattern::Checker,
            Pattern::Gradient,
            Pattern::Noise { octaves: 5 },
            Pattern::Marble {
                octaves: 4,
                turbulence: 2.0,
            },
            Pattern::Wood { turbulence: 0.3 },
        ]
    }

    /// Returns the mean of `pattern` over the box, by `steps`³ points.
    fn numeric(pattern: Pattern, p: DVec3, width: DVec3, steps: usize) -> f64 {
        let at = |i: usize| (i as f64 + 0.5) / steps as f64 - 0.5;
        let mut sum = 0.0;
        for i in 0..steps {
            for j in 0..steps {
                for k in 0..steps {
                    sum += second_color_weight(
                        pattern,
                        p + width * DVec3::new(at(i), at(j), at(k)),
                        DVec3::ZERO,
                    );
                }
            }
        }
        sum / (steps as f64).powi(3)
    }

    /// Returns a few hundred boxes of various sizes and positions.
    fn boxes() -> impl Iterator<Item = (DVec3, DVec3)> {
        const STEP: [f64; 3] = [
            0.819_172_513_396_164_4,
            0.671_043_606_703_789_2,
            0.549_700_477_901_975_9,
        ];
        (1..200).map(|i| {
            let r = DVec3::from_array(STEP.map(|s| (f64::from(i) * s).fract()));
            let s = DVec3::from_array(STEP.map(|s| (f64::from(7 * i) * s).fract()));
            (8.0 * r - 4.0, s * 2f64.powi(i % 7 - 4))
        })
    }

    #[test]
    fn the_filtered_checker_is_its_integral_over_the_box() {
        const STEPS: usize = 48;
        for (p, width) in boxes() {
            let exact = second_color_weight(Pattern::Checker, p, width);
            let sum = numeric(Pattern::Checker, p, width, STEPS);
            // Each axis is off by at most one step per edge, and a box has width + 1 edges.
            let edges = width.element_sum() + 3.0;
            assert!((exact - sum).abs() <= edges / STEPS as f64, "{p} {width}");
        }
    }

    #[test]
    fn the_filtered_gradient_and_a_straight_marble_are_their_integrals_over_the_box() {
        const STEPS: usize = 64;
        let straight = Pattern::Marble {
            octaves: 1,
            turbulence: 0.0,
        };
        for (p, width) in boxes() {
            let (p, width) = (p * DVec3::X, width * DVec3::X);
            for (pattern, curvature) in [(Pattern::Gradient, 0.0), (straight, 0.5 * TAU * TAU)] {
                let step = width.x / STEPS as f64;
                // Midpoint rule: step²/24 of the second derivative; at a kink of slope 1, step²/8 of one step.
                let tolerance = step * step / 24.0 * curvature + step / 4.0 / STEPS as f64 + 1e-12;
                let mut sum = 0.0;
                for i in 0..STEPS {
                    let x = (i as f64 + 0.5) * step - 0.5 * width.x;
                    sum += second_color_weight(pattern, p + x * DVec3::X, DVec3::ZERO) / STEPS as f64;
                }
                assert!(
                    (second_color_weight(pattern, p, width) - sum).abs() <= tolerance,
                    "{pattern:?} {p} {width}"
                );
            }
        }
    }

    #[test]
    fn patterns_converge_to_sharp_and_to_mean_colour() {
        for pattern in patterns() {
            for (p, _) in boxes() {
                let [sharp, narrow] = [0.0, 1e-9].map(|w| second_color_weight(pattern, p, DVec3::splat(w)));
                assert!((sharp - narrow).abs() < 1e-6, "{pattern:?} {p}");
                let wide = second_color_weight(pattern, p, DVec3::splat(1e9));
                assert!((wide - 0.5).abs() < 1e-3, "{pattern:?} {p}: {wide}");
            }
        }
    }

    #[test]
    fn filtering_is_closer_to_the_mean_than_point_sampling() {
        for pattern in patterns() {
            for size in [0.3, 1.0, 3.0] {
                let (mut filtered, mut single) = (0.0, 0.0);
                for (p, _) in boxes().take(60) {
                    let width = DVec3::new(size, size, 0.0);
                    let mean = numeric(pattern, p, width, 12);
                    filtered += (second_color_weight(pattern, p, width) - mean).powi(2);
                    single += (second_color_weight(pattern, p, DVec3::ZERO) - mean).powi(2);
                }
                assert!(filtered <= single, "{pattern:?} {size}: {filtered} > {single}");
            }
        }
    }

    #[test]
    fn checkers_alternate_from_the_first_colour_at_origin() {
        let checker = Procedural {
            pattern: Pattern::Checker,
            colors: [[0.1, 0.2, 0.3, 1.0], [0.7, 0.8, 0.9, 0.5]],
            space: Space::Object,
            scale: [2.0, 1.0, 1.0],
        };
        let at = |x: f64, y: f64, z: f64| sample(&checker, DVec3::new(x, y, z), DVec3::ZERO);
        assert_eq!(at(0.1, 0.1, 0.1), checker.colors[0]);
        assert_eq!(at(0.6, 0.1, 0.1), checker.colors[1]);
        assert_eq!(at(0.6, 0.1, -0.1), checker.colors[0]);
        assert_eq!(at(-0.1, -0.1, -0.1), checker.colors[1]);
        assert_eq!(at(0.5, 1.0, 1.0), checker.colors[1]);
    }

    #[test]
    fn the_gradient_of_a_wave_is_its_cosine() {
        let marble = Procedural {
            pattern: Pattern::Marble {
                octaves: 1,
                turbulence: 0.0,
            },
            colors: [[1.0; 4], [3.0; 4]],
            space: Space::Object,
            scale: [0.5, 7.0, 7.0],
        };
        for x in [0.0, 0.3, -17.9] {
            // 1 + 2 (½ + ½ sin(2π x / 2)), differentiated by x.
            let exact = PI * (PI * x).cos();
            let computed = gradient(&marble, DVec3::new(x, 1.0, 2.0), DVec3::ZERO);
            // 2^-34 |x|^⅔ / 6 of the third derivative, π³, and as much rounding.
            assert!((computed - exact * DVec3::X).length() < 1e-8, "{x}: {computed}");
        }
    }

    #[test]
    fn a_floor_in_a_face_of_the_cubes_keeps_their_colours() {
        let checker = Procedural {
            pattern: Pattern::Checker,
            colors: [[0.0; 4], [1.0; 4]],
            space: Space::Object,
            scale: [2.0; 3],
        };
        let p = DVec3::new(0.3, 0.2, 1.5);
        let width = isotropic(&checker, p, 0.1);
        assert_eq!(width, DVec3::new(0.1, 0.1, 0.0));
        assert_eq!(sample(&checker, p, width), [1.0; 4]);
        assert_eq!(sample(&checker, p, DVec3::splat(0.1)), [0.5; 4]);
    }

    #[test]
    fn extreme_points_and_widths_give_colours_in_range() {
        let absurd = [f64::NAN, f64::INFINITY, -f64::MAX, 1e300, 1e-320, -0.0];
        for pattern in patterns() {
            for x in absurd {
                for w in absurd {
                    let procedural = Procedural {
                        pattern,
                        colors: [[0.0; 4], [1.0; 4]],
                        space: Space::Uv,
                        scale: [1e9, -1.0, 1.0],
                    };
                    let color = sample(&procedural, DVec3::new(x, 1.0, x), DVec3::splat(w));
                    assert!(
                        color.iter().all(|c| (0.0..=1.0).contains(c)),
                        "{pattern:?} {x} {w}"
                    );
                }
            }
        }
    }
}
