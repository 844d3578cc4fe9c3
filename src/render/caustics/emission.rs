//! Emission of photons: rays from lights to the spheres around sharp objects, with the power that each carries.
//!
//! A target is chosen in proportion to the solid angle, or the area of the disc, in which the light sees it, and a direction
//! or point uniformly in it. Where several targets hold the same ray, its power is divided by their number.

use glam::DVec3;

use super::source::{CausticTarget, PhotonSource};
use crate::numeric::{Ray, warp};
use crate::scene::LightKind;
use crate::shape::tangents;

/// Photon that leaves a light.
pub(super) struct EmittedPhoton {
    pub(super) origin: DVec3,
    /// Unit vector along the ray.
    pub(super) direction: DVec3,
    /// Power in watts, linear RGB.
    pub(super) power: [f64; 3],
}

impl EmittedPhoton {
    /// Photon that carries no power.
    pub(super) const NONE: EmittedPhoton = EmittedPhoton {
        origin: DVec3::ZERO,
        direction: DVec3::Z,
        power: [0.0; 3],
    };

    /// Returns what separates the photon from others of a light without extent: its point on a plane across parallel light, or
    /// its direction. `None` for area lights.
    pub(super) fn of(&self, source: &PhotonSource) -> Option<[f32; 3]> {
        match source.light.kind {
            LightKind::Directional { .. } => Some(self.origin.as_vec3().to_array()),
            LightKind::Point { .. } | LightKind::Spot { .. } => Some(self.direction.as_vec3().to_array()),
            LightKind::Area { .. } => None,
        }
    }

    /// Returns the ray of the photon at `time`.
    pub(super) fn ray(&self, time: f32) -> Ray {
        Ray {
            time,
            ..Ray::new(self.origin.as_vec3(), self.direction.as_vec3())
        }
    }
}

/// Returns the photon that the pairs `u` of numbers in [0, 1) select: one for the direction, one for the point on an area
/// light. `None` if it has no power. Directional light starts `far` before the targets.
pub(super) fn emit(
    source: &PhotonSource,
    targets: &[CausticTarget],
    u: [[f64; 2]; 2],
    far: f64,
) -> Option<EmittedPhoton> {
    let count = f64::from(source.count);
    let intensity = source.light.intensity.map(f64::from);
    let squared_ior = source.ior * source.ior;
    // Multiply intensity or radiance by the reciprocal densities of direction and point
    match source.light.kind {
        LightKind::Directional { to_light } => {
            let (origin, area) = parallel(targets, to_light, u[0], far)?;
            Some(EmittedPhoton {
                origin,
                direction: -to_light,
                power: intensity.map(|channel| channel * area / count),
            })
        }
        LightKind::Point { position, .. } => {
            let (direction, solid_angle) = toward(targets, position, u[0])?;
            let power = intensity.map(|channel| channel * squared_ior * solid_angle / count);
            Some(EmittedPhoton {
                origin: position,
                direction,
                power,
            })
        }
        LightKind::Spot { position, .. } => {
            let (direction, solid_angle) = toward(targets, position, u[0])?;
            let fade = f64::from(source.light.spot_fade(direction));
            let power = intensity.map(|channel| channel * fade * squared_ior * solid_angle / count);
            (fade > 0.0).then_some(EmittedPhoton {
                origin: position,
                direction,
                power,
            })
        }
        LightKind::Area { .. } => {
            let surface = source.surface?;
            let point = surface.surface_point(u[1])?;
            let (direction, solid_angle) = toward(targets, point.position, u[0])?;
            let emitted = surface.emitted(&point, direction)?;
            let scale = emitted.cosine * squared_ior * surface.area() * solid_angle / count;
            Some(EmittedPhoton {
                origin: emitted.origin,
                direction,
                power: std::array::from_fn(|c| intensity[c] * scale),
            })
        }
    }
}

/// Returns a direction from `p` to a target, and the reciprocal of its density per steradian.
fn toward(targets: &[CausticTarget], p: DVec3, [first, second]: [f64; 2]) -> Option<(DVec3, f64)> {
    let angle = |target: &CausticTarget| target.solid_angle(p);
    let (target, within, whole) = chosen(targets, angle, first)?;
    // Sample the cone uniformly
    let to_center = target.center - p;
    let below = angle(target) / std::f64::consts::TAU;
    let local = warp::direction(within * below, second);
    let axis = to_center.try_normalize().unwrap_or(DVec3::Z);
    let [right, up] = tangents(axis);
    let direction = (local.x * right + local.y * up + local.z * axis).normalize();
    let holding = targets.iter().filter(|target| target.holds(p, direction)).count();
    Some((direction, whole / holding.max(1) as f64))
}

/// Returns the origin of a ray of parallel light to a target, and the reciprocal of its density per square metre.
fn parallel(
    targets: &[CausticTarget],
    to_light: DVec3,
    [first, second]: [f64; 2],
    far: f64,
) -> Option<(DVec3, f64)> {
    let (target, within, whole) = chosen(targets, CausticTarget::disc_area, first)?;
    // Sample the disc of the target uniformly
    let offset = target.radius * warp::disk([within, second]);
    let [right, up] = tangents(to_light);
    let point = target.center + offset.x * right + offset.y * up;
    // Divide by the density of all discs that hold the point
    let holding = targets.iter().filter(|other| {
        let beside = point - other.center;
        let across = beside - to_light * beside.dot(to_light);
        across.length_squared() <= other.radius * other.radius
    });
    Some((point + far * to_light, whole / holding.count().max(1) as f64))
}

/// Returns the target that `u` selects in proportion to `size`, the position of `u` within its range, and the sum of all
/// sizes.
fn chosen(
    targets: &[CausticTarget],
    size: impl Fn(&CausticTarget) -> f64,
    u: f64,
) -> Option<(&CausticTarget, f64, f64)> {
    // Search the target in which the part of the sum lies
    let whole: f64 = targets.iter().map(&size).sum();
    let mut rest = u * whole;
    for target in targets {
        let own = size(target);
        if rest < own {
            return Some((target, rest / own, whole));
        }
        rest -= own;
    }
    // Rounding may leave a remainder behind the last target
    let last = targets.last()?;
    Some((last, 1.0 - f64::EPSILON, whole))
}
