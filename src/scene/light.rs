//! Lights: without extent, as the lecture and `KHR_lights_punctual` have them, and with one.

use glam::DVec3;

use crate::numeric::Bounds;

/// A light, in world space.
#[derive(Clone, Debug)]
pub struct Light {
    /// What messages call it.
    pub name: String,
    /// Linear RGB times intensity: candela for point and spot lights, lux for directional ones; radiance
    /// for lights with an extent, candela per square metre of what is seen of them.
    pub intensity: [f32; 3],
    /// Where or from where it shines.
    pub kind: LightKind,
}

impl Light {
    /// The instance that it lies on, if it is a lamp's light.
    pub fn lamp(&self) -> Option<u32> {
        match self.kind {
            LightKind::Area {
                shape: AreaShape::Object { instance },
                ..
            } => Some(instance),
            _ => None,
        }
    }
}

/// The kinds of light.
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
    /// Light from a surface, the same in all directions. Only what it lights is seen, not the surface, unless that is
    /// an object's.
    Area {
        /// What shines.
        shape: AreaShape,
        /// Points of it that each surface asks for light, at least 1. More make each sample less noisy; the samples of
        /// a pixel ask for different points, so one is enough for pictures of many.
        samples: u32,
    },
}

/// A surface that shines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AreaShape {
    /// A parallelogram that shines to the side of half_u × half_v.
    Quad {
        /// Its middle.
        center: DVec3,
        /// From there to the middle of one side.
        half_u: DVec3,
        /// From there to the middle of the next.
        half_v: DVec3,
    },
    /// An ellipse that shines to the side of half_u × half_v.
    Disk {
        /// Its middle.
        center: DVec3,
        /// Conjugate half axes: for a circle orthogonal and as long as the radius.
        half_u: DVec3,
        /// The other one.
        half_v: DVec3,
    },
    /// A sphere that shines outward.
    Sphere {
        /// Its middle.
        center: DVec3,
        /// In metres.
        radius: f64,
    },
    /// What shines of an instance, on both sides as it is seen to: see [`Scene::add_emissive_light`](super::Scene::add_lamp).
    Object {
        /// Which; an index into [`Scene::instances`](super::Scene::instances).
        instance: u32,
    },
}

impl AreaShape {
    /// The smallest box around it; `None` for an object's, whose instance has one.
    pub fn bounds(&self) -> Option<Bounds> {
        let (center, reach) = match *self {
            AreaShape::Quad {
                center,
                half_u,
                half_v,
            } => (center, half_u.abs() + half_v.abs()),
            AreaShape::Disk {
                center,
                half_u,
                half_v,
            } => (center, (half_u * half_u + half_v * half_v).map(f64::sqrt)),
            AreaShape::Sphere { center, radius } => (center, DVec3::splat(radius)),
            AreaShape::Object { .. } => return None,
        };
        Some(Bounds {
            min: center - reach,
            max: center + reach,
        })
    }

    /// Its middle moved to `to` and its lengths multiplied by `scale`; an object moves by itself.
    pub(super) fn moved(self, to: impl Fn(DVec3) -> DVec3, scale: f64) -> AreaShape {
        match self {
            AreaShape::Quad {
                center,
                half_u,
                half_v,
            } => AreaShape::Quad {
                center: to(center),
                half_u: half_u * scale,
                half_v: half_v * scale,
            },
            AreaShape::Disk {
                center,
                half_u,
                half_v,
            } => AreaShape::Disk {
                center: to(center),
                half_u: half_u * scale,
                half_v: half_v * scale,
            },
            AreaShape::Sphere { center, radius } => AreaShape::Sphere {
                center: to(center),
                radius: radius * scale,
            },
            AreaShape::Object { .. } => self,
        }
    }
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
