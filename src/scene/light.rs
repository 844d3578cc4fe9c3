//! Punctual lights, as `KHR_lights_punctual` defines them.

use glam::DVec3;

/// A light without extent, in world space.
#[derive(Clone, Debug)]
pub struct Light {
    /// What messages call it.
    pub name: String,
    /// Linear RGB times intensity: candela for point and spot lights, lux for directional ones.
    pub intensity: [f32; 3],
    /// Where or from where it shines.
    pub kind: LightKind,
}

/// The kinds of punctual light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// Parallel light from far away.
    Directional {
        /// Unit vector from surfaces to the light.
        to_light: DVec3,
    },
    /// Light from a point, falling with the square of the distance.
    Point {
        /// Where it stands.
        position: DVec3,
        /// Distance at which it fades to nothing, if it does.
        range: Option<f64>,
    },
    /// Light from a point into a cone.
    Spot {
        /// Where it stands.
        position: DVec3,
        /// Unit vector along which it shines.
        direction: DVec3,
        /// Cosine of the angle within which it is full.
        cos_inner: f64,
        /// Cosine of the angle outside which it is dark; less than `cos_inner`.
        cos_outer: f64,
        /// Distance at which it fades to nothing, if it does.
        range: Option<f64>,
    },
}
