//! Lights: punctual ones, as in Phong and Whitted's model and `KHR_lights_punctual`, and area lights.

use glam::DVec3;

use crate::numeric::Bounds;

/// Default number of samples of an area light or an environment map per shading point: enough for a shadow to look soft.
pub const DEFAULT_LIGHT_SAMPLES: u32 = 4;

/// A light in world space.
#[derive(Clone, Debug)]
pub struct Light {
    /// Name of the light in messages.
    pub name: String,
    /// Linear RGB times intensity: candela for point and spot lights, lux for directional ones; for area lights
    /// radiance, candela per square metre of projected area.
    pub intensity: [f32; 3],
    /// Type of the light with its position, direction and shape.
    pub kind: LightKind,
}

impl Light {
    /// Returns the instance that the light lies on; `None` unless it is the light of an emissive object.
    pub fn emissive_instance(&self) -> Option<u32> {
        match self.kind {
            LightKind::Area {
                shape: AreaShape::Object { instance },
                ..
            } => Some(instance),
            _ => None,
        }
    }

    /// Returns the point in world space that all light comes from; `None` for light from a direction or an area.
    pub fn position(&self) -> Option<DVec3> {
        match self.kind {
            LightKind::Point { position, .. } | LightKind::Spot { position, .. } => Some(position),
            LightKind::Directional { .. } | LightKind::Area { .. } => None,
        }
    }
}

/// Types of light with their parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// Parallel light from far away.
    Directional {
        /// Unit vector from surfaces to the light.
        to_light: DVec3,
    },
    /// Light from a point in all directions.
    Point {
        /// Position in world space.
        position: DVec3,
        /// Attenuation with the distance.
        falloff: Falloff,
    },
    /// Light from a point into a cone.
    Spot {
        /// Position in world space.
        position: DVec3,
        /// Unit vector along the axis of the cone, away from the light.
        direction: DVec3,
        /// Cosine of the angle within which the intensity is full.
        cos_inner: f64,
        /// Cosine of the angle outside which there is no light; less than `cos_inner`.
        cos_outer: f64,
        /// Attenuation with the distance.
        falloff: Falloff,
    },
    /// Light from a surface, with equal radiance in all directions. Its surface is invisible and only its illumination
    /// is seen, except for an emissive object's.
    Area {
        /// Shape of the emitting surface.
        shape: AreaShape,
        /// Points on the light that each shading point samples, at least 1. More reduce the noise of each sample; the
        /// samples of a pixel use different points, so one is enough for images with many samples.
        samples: u32,
    },
}

/// Shape of an emitting surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AreaShape {
    /// A parallelogram that emits to the side of half_u × half_v.
    Quad {
        /// Centre of the parallelogram in world space.
        center: DVec3,
        /// Vector from the centre to the middle of one side.
        half_u: DVec3,
        /// Vector from the centre to the middle of the next side.
        half_v: DVec3,
    },
    /// An ellipse that emits to the side of half_u × half_v.
    Disk {
        /// Centre of the ellipse in world space.
        center: DVec3,
        /// First of two conjugate half axes; for a circle they are orthogonal and as long as the radius.
        half_u: DVec3,
        /// Second of the two conjugate half axes.
        half_v: DVec3,
    },
    /// A sphere that emits outward.
    Sphere {
        /// Centre of the sphere in world space.
        center: DVec3,
        /// Radius of the sphere in metres.
        radius: f64,
    },
    /// The surface of an emissive object, which emits on both sides, as it is visible from both; see
    /// [`super::Scene::add_emissive_light`].
    Object {
        /// Index of the object into [`Scene::instances`](super::Scene::instances).
        instance: u32,
    },
}

impl AreaShape {
    /// Returns the bounding box; `None` for an emissive object, whose instance has one.
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
                // Half extent of an ellipse with conjugate half axes
            } => (center, (half_u * half_u + half_v * half_v).map(f64::sqrt)),
            // The half extent of a sphere is its radius
            AreaShape::Sphere { center, radius } => (center, DVec3::splat(radius)),
            AreaShape::Object { .. } => return None,
        };
        Some(Bounds {
            min: center - reach,
            max: center + reach,
        })
    }

    /// Returns the shape with its centre mapped by `to` and its lengths multiplied by `scale`; an emissive object moves
    /// with its instance and is returned unchanged.
    pub(super) fn transformed(self, to: impl Fn(DVec3) -> DVec3, scale: f64) -> AreaShape {
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

/// Attenuation of a light with the distance d.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Falloff {
    /// Factor 1 / d², which is physical; with a range it is windowed to reach zero there (`KHR_lights_punctual`).
    InverseSquare {
        /// Distance at which the light has faded to zero; `None` for no limit.
        range: Option<f64>,
    },
    /// Factor 1 / (constant + linear d + quadratic d²), as in Phong and Whitted's model; (1, 0, 0) is no attenuation.
    Polynomial {
        /// Constant coefficient, without unit.
        constant: f64,
        /// Linear coefficient, per metre.
        linear: f64,
        /// Quadratic coefficient, per square metre.
        quadratic: f64,
    },
}

impl Falloff {
    /// Inverse-square attenuation without a range.
    pub const PHYSICAL: Falloff = Falloff::InverseSquare { range: None };
    /// No attenuation: the light is as strong far away as near.
    pub const NONE: Falloff = Falloff::Polynomial {
        constant: 1.0,
        linear: 0.0,
        quadratic: 0.0,
    };
}
