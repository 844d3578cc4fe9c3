//! Ray cones: the width and the spread of a ray (Amanatides, SIGGRAPH 1984; Ray Tracing Gems, 2019, ch. 20), and its
//! footprint on a surface.

use glam::{DMat3, DVec3};
use whit::scene::CameraView;

use super::approx::{Approx, Approx3};
use super::hits::transform_vector;

/// A width where the ray starts, and the change of it along a unit of length.
#[derive(Clone, Copy, Debug)]
pub struct Cone {
    pub width: Approx,
    pub spread: Approx,
}

impl Cone {
    /// Of a ray without width.
    pub const NONE: Cone = Cone {
        width: Approx::ZERO,
        spread: Approx::ZERO,
    };

    /// The square root of the area, and of the solid angle, that one of `spp` samples of the middle pixel stands for.
    pub fn of_sample(view: &CameraView, [width, height]: [u32; 2], spp: u32) -> Cone {
        let middle = view.ray(0.5, 0.5);
        let right = view.ray(0.5 + 1.0 / f64::from(width), 0.5);
        let below = view.ray(0.5, 0.5 + 1.0 / f64::from(height));
        let length = middle.direction.length();
        let area = |a: DVec3, b: DVec3| middle.direction.dot(a.cross(b)).abs() / length;
        let starts = area(right.origin - middle.origin, below.origin - middle.origin);
        let ways = area(
            right.direction - middle.direction,
            below.direction - middle.direction,
        );
        let side = |area: f64| Approx::rounded((area / f64::from(spp)).sqrt());
        Cone {
            width: side(starts),
            spread: side(ways / (length * length)),
        }
    }

    /// Returns the cone after a further `distance` along the ray.
    pub fn after(self, distance: Approx) -> Cone {
        Cone {
            width: self.width + self.spread * distance,
            ..self
        }
    }

    /// Behind a mirror of mean curvature 1 / r, positive where it bulges to the ray: its focus is at half of r.
    pub fn mirrored(self, curvature: Approx) -> Cone {
        Cone {
            spread: self.spread + (curvature + curvature) * self.width,
            ..self
        }
    }

    /// Behind a boundary: the geometric mean of Coddington's equations in the plane of incidence and across it.
    pub fn refracted(
        self,
        [eta_i, eta_t]: [Approx; 2],
        [cos_i, cos_t]: [Approx; 2],
        curvature: Approx,
    ) -> Cone {
        let eta = eta_t / eta_i;
        let squeeze = (cos_t / cos_i).sqrt();
        let power = (eta * cos_t - cos_i) / (eta * (cos_t * cos_i).sqrt());
        Cone {
            width: self.width * squeeze,
            spread: self.spread / (eta * squeeze) - curvature * self.width * power,
        }
    }

    /// The axes of the ellipse that a ray of unit direction `d` and of this width cuts out of a plane with the normal
    /// `n`, in full length, the longer first.
    pub fn footprint(self, d: Approx3, n: Approx3) -> [Approx3; 2] {
        let cos = d.dot(n);
        let width = self.width.abs();
        let within_one = |v: Approx3| Approx3::from(v.to_array().map(|x| x.known_within(-1.0, 1.0)));
        let along = within_one((d - n * cos).normalize());
        let across = within_one(n.cross(along));
        [along * (width / cos.abs()), across * width]
    }
}

/// A step on the surface as a change of u and v: the normal equations of step = du dpdu + dv dpdv.
pub fn uv_of(step: Approx3, [dpdu, dpdv]: [Approx3; 2]) -> [Approx; 2] {
    if dpdu.value() == DVec3::ZERO || dpdv.value() == DVec3::ZERO {
        return [Approx::ZERO; 2];
    }
    let (uu, uv, vv) = (dpdu.dot(dpdu), dpdu.dot(dpdv), dpdv.dot(dpdv));
    let (su, sv) = (dpdu.dot(step), dpdv.dot(step));
    let determinant = uu * vv - uv.squared();
    [
        (vv * su - uv * sv) / determinant,
        (uu * sv - uv * su) / determinant,
    ]
}

/// Axes in object space.
pub fn in_object(object_from_world: &DMat3, axes: [Approx3; 2]) -> [Approx3; 2] {
    axes.map(|axis| transform_vector(object_from_world, axis))
}

/// The mean curvature 1 / r that the corner normals of a smooth triangle imply, by the mean of its edges (Reed, 2014).
pub fn curvature_of(p: [DVec3; 3], n: [DVec3; 3]) -> f64 {
    let edge = |a: usize, b: usize| {
        let e = p[b] - p[a];
        (n[b] - n[a]).dot(e) / e.dot(e)
    };
    (edge(0, 1) + edge(1, 2) + edge(2, 0)) / 3.0
}
