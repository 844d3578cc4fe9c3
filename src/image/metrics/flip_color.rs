//! Colour spaces of FLIP: opponent colours for filtering, and perceptually uniform ones for distances.
//!
//! P. Andersson, J. Nilsson, T. Akenine-Möller, M. Oskarsson, K. Åström and M. D. Fairchild, "FLIP: A Difference
//! Evaluator for Alternating Images", HPG 2020, sections 4.1.1 and 4.1.2. The white point is that of sRGB, the colour
//! of linear RGB (1, 1, 1).

use glam::{DMat3, DVec3};

/// Matrix from linear sRGB to XYZ, relative to white in every component, and its inverse.
pub(super) struct Colors {
    white_from_linear: DMat3,
    linear_from_white: DMat3,
}

impl Colors {
    /// Computes both matrices from the primaries of sRGB.
    pub(super) fn new() -> Colors {
        let xyz_from_linear = xyz_from_linear();
        let white = xyz_from_linear * DVec3::ONE;
        let white_from_linear = DMat3::from_diagonal(white.recip()) * xyz_from_linear;
        Colors {
            white_from_linear,
            linear_from_white: white_from_linear.inverse(),
        }
    }

    /// Converts linear RGB to YCxCz: lightness and opponent chroma, all linear in radiance.
    pub(super) fn opponent(&self, linear: DVec3) -> DVec3 {
        let xyz = self.white_from_linear * linear;
        DVec3::new(
            116.0 * xyz.y - 16.0,
            500.0 * (xyz.x - xyz.y),
            200.0 * (xyz.y - xyz.z),
        )
    }

    /// Converts YCxCz to linear RGB.
    pub(super) fn linear(&self, opponent: DVec3) -> DVec3 {
        let y = luminance(opponent.x);
        let xyz = DVec3::new(y + opponent.y / 500.0, y, y - opponent.z / 200.0);
        self.linear_from_white * xyz
    }

    /// Converts linear RGB to L*a*b*, with chroma adjusted for the Hunt effect: colours look less colourful in the
    /// dark.
    pub(super) fn perceived(&self, linear: DVec3) -> DVec3 {
        let xyz = (self.white_from_linear * linear).to_array().map(lab_curve);
        let lightness = 116.0 * xyz[1] - 16.0;
        let (a, b) = (500.0 * (xyz[0] - xyz[1]), 200.0 * (xyz[1] - xyz[2]));
        let hunt = 0.01 * lightness;
        DVec3::new(lightness, hunt * a, hunt * b)
    }
}

/// Returns the luminance of YCxCz's first component, 0 for black to 1 for white.
pub(super) fn luminance(opponent_y: f64) -> f64 {
    (opponent_y + 16.0) / 116.0
}

/// Returns the HyAB distance of two perceived colours: lightness and chroma separately, as suits large differences.
pub(super) fn hyab(a: DVec3, b: DVec3) -> f64 {
    let difference = a - b;
    difference.x.abs() + difference.y.hypot(difference.z)
}

/// Returns the matrix from linear sRGB (IEC 61966-2-1) to CIE 1931 XYZ, without rounded coefficients: from the
/// chromaticities of the primaries, (0.64, 0.33), (0.30, 0.60) and (0.15, 0.06), and of white, (0.3127, 0.3290).
fn xyz_from_linear() -> DMat3 {
    let xyz = |x: f64, y: f64| DVec3::new(x / y, 1.0, (1.0 - x - y) / y);
    let primaries = DMat3::from_cols(xyz(0.64, 0.33), xyz(0.30, 0.60), xyz(0.15, 0.06));
    let strengths = primaries.inverse() * xyz(0.3127, 0.3290);
    primaries * DMat3::from_diagonal(strengths)
}

/// Evaluates the cube-root curve of CIE L*a*b*, with its linear piece near black.
fn lab_curve(t: f64) -> f64 {
    const DELTA: f64 = 6.0 / 29.0;
    if t > DELTA * DELTA * DELTA {
        t.cbrt()
    } else {
        t / (3.0 * DELTA * DELTA) + 4.0 / 29.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_has_full_lightness_and_no_chroma() {
        let colors = Colors::new();
        let white = DVec3::new(100.0, 0.0, 0.0);
        // Tolerance for a few roundings of numbers up to 500.
        assert!(colors.opponent(DVec3::ONE).abs_diff_eq(white, 1e-12));
        assert!(colors.perceived(DVec3::ONE).abs_diff_eq(white, 1e-12));
        assert!(colors.perceived(DVec3::ZERO).abs_diff_eq(DVec3::ZERO, 1e-12));
    }

    #[test]
    fn opponent_colour_conversion_is_invertible() {
        let colors = Colors::new();
        let linear = DVec3::new(0.2, 0.7, 0.05);
        assert!(colors.linear(colors.opponent(linear)).abs_diff_eq(linear, 1e-13));
    }

    #[test]
    fn luminance_uses_rec_709_weights() {
        // 0.2126 R + 0.7152 G + 0.0722 B, as rounded in the standard.
        let y = |linear| luminance(Colors::new().opponent(linear).x);
        for (linear, expected) in [(DVec3::X, 0.2126), (DVec3::Y, 0.7152), (DVec3::Z, 0.0722)] {
            assert!((y(linear) - expected).abs() < 1e-4);
        }
    }
}
