//! Lights without extent, as the lecture and `KHR_lights_punctual` have them.

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
    /// Light from a point.
    Point {
        /// Where it stands.
        position: DVec3,
        /// How it weakens with the distance.
        falloff: Falloff,
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
        /// How it weakens with the distance.
        falloff: Falloff,
    },
}

/// How a light weakens with the distance d.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Falloff {
    /// By 1 / d², as light does; faded to nothing at a range, if there is one (`KHR_lights_punctual`).
    InverseSquare {
        /// Distance at which nothing is left.
        range: Option<f64>,
    },
    /// By 1 / (constant + linear d + quadratic d²), the lecture's option; (1, 0, 0) is none.
    Polynomial {
        /// At no distance.
        constant: f64,
        /// Per metre.
        linear: f64,
        /// Per square metre.
        quadratic: f64,
    },
}

impl Falloff {
    /// Physical, without a range.
    pub const PHYSICAL: Falloff = Falloff::InverseSquare { range: None };
    /// None: as strong far away as near.
    pub const NONE: Falloff = Falloff::Polynomial {
        constant: 1.0,
        linear: 0.0,
        quadratic: 0.0,
    };
}
