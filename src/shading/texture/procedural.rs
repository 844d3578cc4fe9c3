//! Procedural textures, averaged over the ray's footprint: a box around the point, along the axes of the pattern's
//! space.
//!
//! Checker and gradient are averaged exactly, by the integral of the pattern (Heckbert, "Filtering by repeated
//! integration", SIGGRAPH 1986). The sine of marble and wood is damped by the exact factor sinc of the phase that the
//! box spans, as if the phase were linear there. Noise drops the octaves that the box cannot resolve
//! ([`crate::numeric::noise`]).

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::numeric::noise::{fractal, noise, remaining_amplitude, turbulence};
use crate::scene::{Pattern, Procedural, Space};

/// Returns the linear RGBA at `p`, in the pattern's space but before its scale, averaged over a box of sides `width`
/// there.
#[inline]
pub(super) fn sample(procedural: &Procedural, p: DVec3, width: DVec3) -> [f32; 4] {
    let scale = DVec3::from_array(procedural.scale);
    let second = second_color_weight(procedural.pattern, finite(scale * p), finite_width(scale * width));
    let second = second.clamp(0.0, 1.0) as f32;
    let [a, b] = procedural.colors;
    std::array::from_fn(|i| (1.0 - second) * a[i] + second * b[i])
}

/// Returns the derivative of the red channel by `p`, averaged over a box of sides `width`: central differences over the
/// box, or over the step with the least rounding error where the box has no width.
pub(super) fn gradient(procedural: &Procedural, p: DVec3, width: DVec3) -> DVec3 {
    /// Relative step of the difference: the cube root of f64's epsilon, 2^-52. It balances the error of the difference,
    /// step², and its rounding, which grows with the coordinate: epsilon |p| / step.
    const STEP: f64 = 1.0 / (1 << 17) as f64;
    let scale = DVec3::from_array(procedural.scale);
    let (p, width) = (finite(scale * p), finite_width(scale * width));
    let second = |p: DVec3| second_color_weight(procedural.pattern, p, width).clamp(0.0, 1.0);
    let [a, b] = procedural.colors.map(|color| f64::from(color[0]));
    // Take central differences along each axis
    let mut gradient = DVec3::ZERO;
    for axis in 0..3 {
        let step = (0.5 * width[axis]).max(STEP * p[axis].abs().cbrt().max(1.0));
        let offset = DVec3::AXES[axis] * step;
        gradient[axis] = scale[axis] * (b - a) * (second(p + offset) - second(p - offset)) / (2.0 * step);
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

/// Returns the weight of the second colour at `p`, averaged over a box of sides `width`.
fn second_color_weight(pattern: Pattern, p: DVec3, width: DVec3) -> f64 {
    match pattern {
        Pattern::Checker => {
            let square = |axis: usize| mean_square_wave(p[axis], width[axis]);
            0.5 - 0.5 * square(0) * square(1) * square(2)
        }
        Pattern::Gradient => mean_ramp(p.x, width.x),
        Pattern::Noise { octaves } => 0.5 + 0.5 * fractal(p, octaves, width.max_element()),
        Pattern::Marble {
            octaves,
            turbulence: shift,
        } => {
            let phase = |p: DVec3| p.x + shift * turbulence(p, octaves, width.max_element());
            0.5 + 0.5 * (TAU * phase(p)).sin() * damping(phase, p, width)
        }
        Pattern::Wood { turbulence: shift } => {
            let phase =
                |p: DVec3| p.x.hypot(p.y) + shift * remaining_amplitude(width.max_element()) * noise(p);
            0.5 - 0.5 * (TAU * phase(p)).cos() * damping(phase, p, width)
        }
    }
}

/// Returns the mean over [x - width/2, x + width/2] of the square wave that is 1 on [0, 1), -1 on [1, 2), and so on.
fn mean_square_wave(x: f64, width: f64) -> f64 {
    let x = x - 2.0 * (0.5 * x).floor();
    let (low, high) = (x - 0.5 * width, x + 0.5 * width);
    let cell = low.floor();
    if cell == high.floor() {
        let is_even = 0.5 * cell == (0.5 * cell).floor();
        return if is_even { 1.0 } else { -1.0 };
    }
    // The integral of the square wave is a triangle wave of height 1.
    let integral = |x: f64| 1.0 - (x.rem_euclid(2.0) - 1.0).abs();
    ((integral(high) - integral(low)) / width).clamp(-1.0, 1.0)
}

/// Returns the mean over [x - width/2, x + width/2] of x clamped to [0, 1].
fn mean_ramp(x: f64, width: f64) -> f64 {
    let (low, high) = (x - 0.5 * width, x + 0.5 * width);
    if !(low < 0.0 && high > 0.0 || low < 1.0 && high > 1.0) {
        return x.clamp(0.0, 1.0);
    }
    // Integral from 0 to x: half the square up to 1, then x - 1 more.
    let integral = |x: f64| 0.5 * x.clamp(0.0, 1.0).powi(2) + (x - 1.0).max(0.0);
    (integral(high) - integral(low)) / width
}

/// Returns the amplitude that a wave of period 1 keeps after averaging over the box: exact where `phase` is linear.
fn damping(phase: impl Fn(DVec3) -> f64, p: DVec3, width: DVec3) -> f64 {
    let mut left = 1.0;
    let mut here = None;
    // Multiply the sinc factors of the box's three axes
    for axis in DVec3::AXES {
        let across = axis * width;
        if across != DVec3::ZERO {
            let here = *here.get_or_insert_with(|| phase(p));
            left *= sinc(phase(p + across) - here);
        }
    }
    left
}

/// Returns sin(πx) / (πx), and 1 at 0.
fn sinc(x: f64) -> f64 {
    let y = PI * x;
    if y == 0.0 { 1.0 } else { y.sin() / y }
}

/// Replaces coordinates by 0 that are not finite, or so large that they have no fractional bits.
fn finite(p: DVec3) -> DVec3 {
    const NO_FRACTION: f64 = (1u64 << 52) as f64;
    DVec3::from_array(p.to_array().map(|x| if x.abs() < NO_FRACTION { x } else { 0.0 }))
}

/// Returns the absolute widths; NaN counts as 0, and an infinite width as far more than any pattern's period.
fn finite_width(width: DVec3) -> DVec3 {
    const BOUNDLESS: f64 = 1e30;
    let bounded = |x: f64| if x.is_nan() { 0.0 } else { x.abs().min(BOUNDLESS) };
    DVec3::from_array(width.to_array().map(bounded))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns one pattern of each kind.
    fn patterns() -> [Pattern; 5] {
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
