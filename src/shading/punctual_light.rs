//! Punctual lights (`KHR_lights_punctual`): directions and attenuation for packets of sixteen points.

use glam::DVec3;

use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Falloff, Light, LightKind};

/// Unshadowed illumination of sixteen points by one punctual light.
#[derive(Clone, Debug)]
pub struct PunctualSample {
    /// Unit vectors toward the light.
    pub wi: Lanes3<f32>,
    /// Factor that turns the light's intensity into the irradiance on a surface that faces it.
    pub attenuation: Lanes<f32>,
}

/// Lower bound of `KHR_lights_punctual` on the cosine difference over which a spot light fades.
const MIN_CONE_FADE: f64 = 0.001;

impl Light {
    /// Returns the factor on the intensity of a spot light in `direction`, a unit vector away from it; 1 for other lights.
    pub(crate) fn spot_fade(&self, direction: DVec3) -> f32 {
        let LightKind::Spot {
            direction: axis,
            cos_inner,
            cos_outer,
            ..
        } = self.kind
        else {
            return 1.0;
        };
        let scale = (cos_inner - cos_outer).max(MIN_CONE_FADE).recip();
        let fade = ((axis.dot(direction) - cos_outer) * scale).clamp(0.0, 1.0) as f32;
        fade * fade
    }
}

/// Computes the directions to `light` and its attenuation at the points `p`.
#[inline(always)]
pub fn sample_punctual_light(light: &Light, p: &Lanes3<f64>) -> PunctualSample {
    match light.kind {
        // A directional light is not attenuated
        LightKind::Directional { to_light } => PunctualSample {
            wi: to_light.as_vec3().to_array().map(|axis| [axis; LANES]),
            attenuation: [1.0; LANES],
        },
        LightKind::Point { position, falloff } => {
            let (wi, inverse_distance) = direction_to(position, p);
            PunctualSample {
                wi,
                attenuation: attenuate(&inverse_distance, falloff),
            }
        }
        // Area lights are sampled point by point elsewhere.
        LightKind::Area { .. } => PunctualSample {
            wi: [[0.0; LANES]; 3],
            attenuation: [0.0; LANES],
        },
        LightKind::Spot {
            position,
            direction,
            cos_inner,
            cos_outer,
            falloff,
        } => {
            let (wi, inverse_distance) = direction_to(position, p);
            let mut attenuation = attenuate(&inverse_distance, falloff);
            // Fade the light between the inner and the outer cone
            let scale = (cos_inner - cos_outer).max(MIN_CONE_FADE).recip() as f32;
            let direction = direction.as_vec3();
            for l in 0..LANES {
                let cosine = -(direction.x * wi[0][l] + direction.y * wi[1][l] + direction.z * wi[2][l]);
                let fade = ((cosine - cos_outer as f32) * scale).clamp(0.0, 1.0);
                attenuation[l] *= fade * fade;
            }
            PunctualSample { wi, attenuation }
        }
    }
}

/// Returns the unit vectors from `p` to `position`, and the inverse distances.
#[inline(always)]
fn direction_to(position: DVec3, p: &Lanes3<f64>) -> (Lanes3<f32>, Lanes<f32>) {
    let mut wi = [[0.0; LANES]; 3];
    let mut inverse_distance = [0.0; LANES];
    for l in 0..LANES {
        let d = [
            (position.x - p[0][l]) as f32,
            (position.y - p[1][l]) as f32,
            (position.z - p[2][l]) as f32,
        ];
        let squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
        let scale = 1.0 / squared.sqrt();
        for axis in 0..3 {
            wi[axis][l] = d[axis] * scale;
        }
        inverse_distance[l] = scale;
    }
    (wi, inverse_distance)
}

/// Returns the attenuation at the given inverse distances; a range applies the extension's window to the inverse square
/// law.
#[inline(always)]
fn attenuate(inverse_distance: &Lanes<f32>, falloff: Falloff) -> Lanes<f32> {
    let mut attenuation = [0.0; LANES];
    // A light exactly at the shaded point has no direction: it contributes zero rather than infinity.
    let square = |x: f32| if x < f32::INFINITY { x * x } else { 0.0 };
    match falloff {
        Falloff::InverseSquare { range: None } => {
            for l in 0..LANES {
                attenuation[l] = square(inverse_distance[l]);
            }
        }
        Falloff::InverseSquare { range: Some(range) } => {
            // Multiply by the extension's window 1 - (distance / range)⁴
            let inverse_square = (range * range).recip() as f32;
            for l in 0..LANES {
                let nearness = square(inverse_distance[l]);
                let ratio = inverse_square / nearness;
                let within = nearness * (1.0 - ratio * ratio).clamp(0.0, 1.0);
                attenuation[l] = if nearness > 0.0 { within } else { 0.0 };
            }
        }
        // Divide by a polynomial in the distance
        Falloff::Polynomial {
            constant,
            linear,
            quadratic,
        } => {
            let (constant, linear, quadratic) = (constant as f32, linear as f32, quadratic as f32);
            for l in 0..LANES {
                let distance = 1.0 / inverse_distance[l];
                let below = constant + distance * (linear + distance * quadratic);
                let lit = (inverse_distance[l] < f32::INFINITY) & (below > 0.0);
                attenuation[l] = if lit { 1.0 / below } else { 0.0 };
            }
        }
    }
    attenuation
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(light: LightKind, p: DVec3) -> (DVec3, f32) {
        let light = Light {
            name: String::new(),
            intensity: [1.0; 3],
            kind: light,
        };
        let sample = sample_punctual_light(&light, &p.to_array().map(|axis| [axis; LANES]));
        (
            DVec3::new(
                sample.wi[0][3].into(),
                sample.wi[1][3].into(),
                sample.wi[2][3].into(),
            ),
            sample.attenuation[3],
        )
    }

    #[test]
    fn point_light_falls_off_with_squared_distance() {
        let light = LightKind::Point {
            position: DVec3::new(0.0, 4.0, 0.0),
            falloff: Falloff::PHYSICAL,
        };
        assert_eq!(at(light, DVec3::ZERO), (DVec3::Y, 1.0 / 16.0));
    }

    #[test]
    fn range_fades_to_zero_by_the_fourth_power() {
        let light = LightKind::Point {
            position: DVec3::Y,
            falloff: Falloff::InverseSquare { range: Some(2.0) },
        };
        // At half the range: 1 - (1/2)^4 = 15/16.
        assert_eq!(at(light, DVec3::ZERO).1, 15.0 / 16.0);
        assert_eq!(at(light, DVec3::new(0.0, -1.5, 0.0)).1, 0.0);
    }

    #[test]
    fn spot_light_fades_from_inner_to_outer_cone() {
        let spot = |degrees: f64| {
            let angle = degrees.to_radians();
            let kind = LightKind::Spot {
                position: DVec3::ZERO,
                direction: DVec3::NEG_Y,
                cos_inner: 0.9,
                cos_outer: 0.7,
                falloff: Falloff::PHYSICAL,
            };
            at(kind, DVec3::new(angle.sin(), -angle.cos(), 0.0)).1
        };
        assert!((spot(10.0) - 1.0).abs() < 1e-6);
        // cos = 0.8 is half-way: (1/2)² = 1/4.
        assert!((spot(0.8f64.acos().to_degrees()) - 0.25).abs() < 1e-5);
        assert_eq!(spot(60.0), 0.0);
    }

    #[test]
    fn point_at_the_light_receives_nothing() {
        let light = LightKind::Point {
            position: DVec3::Y,
            falloff: Falloff::PHYSICAL,
        };
        assert_eq!(at(light, DVec3::Y).1, 0.0);
    }
}
