//! Clear sky above a grey ground, and the sun.
//!
//! The sky is the model of A. J. Preetham, P. Shirley and B. Smits, "A Practical Analytic Model for Daylight", SIGGRAPH
//! 1999, appendix A.2: luminance and chromaticity by Perez' function of the angles from the zenith and from the sun. Only
//! the ratios of its luminances are used; [`SKY`] and [`SUN`] set the brightness.
//!
//! The sun is a directional light and not in the map: few rays into the lobes of rough surfaces would hit so small and
//! bright a disk, and those that did would leave white dots.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use super::integral;
use crate::scene::{Light, LightKind};

/// Turbidity of the air: 2 is very clear, 10 hazy.
const TURBIDITY: f64 = 3.0;
/// Elevation of the sun in degrees.
const SUN_ELEVATION: f64 = 45.0;
/// Direction to the sun along the ground: behind the left shoulder of the default camera, as the default light.
const SUN_SIDE: DVec3 = DVec3::new(-0.5, 0.0, 1.0);
/// Radiance that the sky alone gives to a white level surface.
const SKY: f64 = 0.25;
/// Radiance that the sun alone gives to a white surface that faces it, by channel; on a clear day it is about four times
/// that of the sky, and slightly warm.
const SUN: [f64; 3] = [0.75, 0.71, 0.63];
/// Albedo of the ground, that of dry soil and stone.
const GROUND: [f64; 3] = [0.30, 0.28, 0.25];
/// Smallest cosine of the angle from the zenith at which the sky is evaluated: half a texel above the horizon.
const MIN_COS_ZENITH: f64 = 0.006;
/// Linear RGB of ITU-R BT.709 from CIE XYZ with white D65; the columns belong to X, Y and Z.
const RGB_FROM_XYZ: DMat3 = DMat3::from_cols(
    DVec3::new(3.2406, -0.9689, 0.0557),
    DVec3::new(-1.5372, 1.8758, -0.2040),
    DVec3::new(-0.4986, 0.0415, 1.0570),
);

/// Coefficients A to E of Perez' function.
struct Perez([f64; 5]);

impl Perez {
    /// Returns the function at a direction, given the cosine of its angle from the zenith and its angle from the sun.
    fn at(&self, cos_zenith: f64, from_sun: f64) -> f64 {
        let [a, b, c, d, e] = self.0;
        (1.0 + a * (b / cos_zenith).exp()) * (1.0 + c * (d * from_sun).exp() + e * from_sun.cos().powi(2))
    }
}

/// Quantity of the sky: luminance or a chromaticity coordinate.
struct Distribution {
    perez: Perez,
    /// Value at the zenith over Perez' function there.
    factor: f64,
}

impl Distribution {
    fn new(perez: Perez, zenith: f64, sun_zenith: f64) -> Distribution {
        let factor = zenith / perez.at(1.0, sun_zenith);
        Distribution { perez, factor }
    }

    fn at(&self, cos_zenith: f64, from_sun: f64) -> f64 {
        self.factor * self.perez.at(cos_zenith, from_sun)
    }
}

/// Returns the unit vector to the sun.
fn to_sun() -> DVec3 {
    let (sin, cos) = SUN_ELEVATION.to_radians().sin_cos();
    SUN_SIDE.normalize() * cos + DVec3::Y * sin
}

/// Returns the light of the sun.
pub(super) fn sun() -> Light {
    Light {
        name: "sun".into(),
        // A white surface that faces an illuminance of π has radiance 1.
        intensity: SUN.map(|radiance| (PI * radiance) as f32),
        kind: LightKind::Directional { to_light: to_sun() },
    }
}

/// Clear sky and the ground below.
pub(super) struct ClearSky {
    to_sun: DVec3,
    luminance: Distribution,
    x: Distribution,
    y: Distribution,
    /// Factor from the model's luminances to radiance.
    scale: f64,
    /// Radiance of the ground, linear RGB.
    ground: [f64; 3],
}

impl ClearSky {
    pub(super) fn new() -> ClearSky {
        let sun_zenith = 0.5 * PI - SUN_ELEVATION.to_radians();
        let mut sky = ClearSky {
            to_sun: to_sun(),
            luminance: Distribution::new(luminance_coefficients(), 1.0, sun_zenith),
            x: Distribution::new(
                x_coefficients(),
                zenith_chromaticity(&ZENITH_X, sun_zenith),
                sun_zenith,
            ),
            y: Distribution::new(
                y_coefficients(),
                zenith_chromaticity(&ZENITH_Y, sun_zenith),
                sun_zenith,
            ),
            scale: 1.0,
            ground: [0.0; 3],
        };
        // Scale the sky to the given irradiance of a level surface
        let light =
            |channel: usize| integral(|direction| direction.y.max(0.0) * sky.sky(direction)[channel]) / PI;
        let [r, g, b] = [0, 1, 2].map(light);
        sky.scale = SKY / (0.2126 * r + 0.7152 * g + 0.0722 * b);
        // Light the ground by the sky and the sun
        for (channel, light) in [r, g, b].into_iter().enumerate() {
            sky.ground[channel] = GROUND[channel] * (light * sky.scale + SUN[channel] * sky.to_sun.y);
        }
        sky
    }

    /// Returns the radiance from `direction`, a unit vector; linear RGB.
    pub(super) fn radiance(&self, direction: DVec3) -> [f64; 3] {
        if direction.y < 0.0 {
            return self.ground;
        }
        self.sky(direction)
    }

    /// Returns the radiance of the sky; not negative.
    fn sky(&self, direction: DVec3) -> [f64; 3] {
        let cos_zenith = direction.y.max(MIN_COS_ZENITH);
        let from_sun = direction.angle_between(self.to_sun);
        let [luminance, x, y] =
            [&self.luminance, &self.x, &self.y].map(|distribution| distribution.at(cos_zenith, from_sun));
        // Convert luminance and chromaticity to linear RGB
        let xyz = DVec3::new(x / y, 1.0, (1.0 - x - y) / y) * (luminance * self.scale);
        (RGB_FROM_XYZ * xyz).max(DVec3::ZERO).to_array()
    }
}

/// Coefficients of the zenith's chromaticity x: rows by falling powers of the turbidity from 2, columns by falling powers
/// of the sun's angle from the zenith from 3.
const ZENITH_X: [[f64; 4]; 3] = [
    [0.00166, -0.00375, 0.00209, 0.0],
    [-0.02903, 0.06377, -0.03202, 0.00394],
    [0.11693, -0.21196, 0.06052, 0.25886],
];
/// Coefficients of the zenith's chromaticity y, in the order of [`ZENITH_X`].
const ZENITH_Y: [[f64; 4]; 3] = [
    [0.00275, -0.00610, 0.00317, 0.0],
    [-0.04214, 0.08970, -0.04153, 0.00516],
    [0.15346, -0.26756, 0.06670, 0.26688],
];

/// Evaluates the polynomial in turbidity and the sun's angle from the zenith in radians.
fn zenith_chromaticity(rows: &[[f64; 4]; 3], sun_zenith: f64) -> f64 {
    rows.iter().fold(0.0, |sum, row| {
        let cubic = row
            .iter()
            .fold(0.0, |sum, coefficient| sum * sun_zenith + coefficient);
        sum * TURBIDITY + cubic
    })
}

fn luminance_coefficients() -> Perez {
    Perez([
        0.1787 * TURBIDITY - 1.4630,
        -0.3554 * TURBIDITY + 0.4275,
        -0.0227 * TURBIDITY + 5.3251,
        0.1206 * TURBIDITY - 2.5771,
        -0.0670 * TURBIDITY + 0.3703,
    ])
}

fn x_coefficients() -> Perez {
    Perez([
        -0.0193 * TURBIDITY - 0.2592,
        -0.0665 * TURBIDITY + 0.0008,
        -0.0004 * TURBIDITY + 0.2125,
        -0.0641 * TURBIDITY - 0.8989,
        -0.0033 * TURBIDITY + 0.0452,
    ])
}

fn y_coefficients() -> Perez {
    Perez([
        -0.0167 * TURBIDITY - 0.2608,
        -0.0950 * TURBIDITY + 0.0092,
        -0.0079 * TURBIDITY + 0.2102,
        -0.0441 * TURBIDITY - 1.6537,
        -0.0109 * TURBIDITY + 0.0529,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zenith_chromaticity_is_that_of_the_published_polynomial() {
        // With the sun at the zenith only the last column counts: 3 · 0.00394 + 0.25886 and 3 · 0.00516 + 0.26688.
        assert!((zenith_chromaticity(&ZENITH_X, 0.0) - 0.27068).abs() < 1e-12);
        assert!((zenith_chromaticity(&ZENITH_Y, 0.0) - 0.28236).abs() < 1e-12);
    }

    #[test]
    fn sky_lights_level_surfaces_as_stated() {
        let sky = ClearSky::new();
        let weights = [0.2126, 0.7152, 0.0722];
        let of_sky = |direction: DVec3| -> f64 {
            sky.sky(direction)
                .iter()
                .zip(weights)
                .map(|(channel, weight)| channel * weight)
                .sum()
        };
        let level = integral(|direction| direction.y.max(0.0) * of_sky(direction)) / PI;
        assert!((level - SKY).abs() < 1e-9, "{level}");
    }

    #[test]
    fn sky_is_blue_away_from_the_sun_and_bright_around_it() {
        let sky = ClearSky::new();
        let away = DVec3::new(-sky.to_sun.x, sky.to_sun.y, -sky.to_sun.z);
        let [r, g, b] = sky.sky(away);
        assert!(b > g && g > r && r > 0.0, "{r} {g} {b}");
        assert!(sky.sky(sky.to_sun)[1] > 2.0 * g);
    }
}
