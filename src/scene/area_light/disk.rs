//! Area light in the shape of a disk, or of an ellipse where its axes differ; points are uniform in area.

use std::f64::consts::PI;

use glam::DVec3;

use super::{AreaLightError, LightSample, LightVector, SurfacePoint, area_and_normal};
use crate::numeric::warp;

/// Disk light: the points `center` + x `half_u` + y `half_v` with x² + y² <= 1; its front is to the side of `half_u` ×
/// `half_v`.
///
/// It is the image of the unit disk under any affine map: such a map scales all areas equally, so uniform points stay
/// uniform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiskLight {
    center: DVec3,
    half_u: DVec3,
    half_v: DVec3,
    normal: DVec3,
    area: f64,
}

impl DiskLight {
    /// Creates the ellipse of these conjugate half axes around `center`, in metres.
    pub fn new(center: DVec3, half_u: DVec3, half_v: DVec3) -> Result<DiskLight, AreaLightError> {
        let (square, normal) = area_and_normal(half_u, half_v)?;
        Ok(DiskLight {
            center,
            half_u,
            half_v,
            normal,
            area: PI * square,
        })
    }

    /// Samples the point that `u` in [0, 1)² selects for `p`; `None` in the disk's plane.
    #[inline(always)]
    pub fn sample(&self, p: DVec3, u: [f64; 2]) -> Option<LightSample> {
        self.sample_vector(p, u).sample_of_flat(p, self.normal)
    }

    /// Samples the vector from `p` to the point that `u` selects, without branches.
    #[inline(always)]
    pub(super) fn sample_vector(&self, p: DVec3, u: [f64; 2]) -> LightVector {
        let offset = warp::disk(u);
        let position = self.center + offset.x * self.half_u + offset.y * self.half_v;
        LightVector::of_area(position - p, self.normal, self.area)
    }

    /// Returns the point that `u` selects uniformly from the disk.
    pub(super) fn surface_point(&self, u: [f64; 2]) -> SurfacePoint {
        let offset = warp::disk(u);
        SurfacePoint {
            position: self.center + offset.x * self.half_u + offset.y * self.half_v,
            normal: self.normal,
            primitive: 0,
        }
    }

    /// Returns the area of one side in square metres.
    pub fn area(&self) -> f64 {
        self.area
    }
}

#[cfg(test)]
mod tests {
    use super::super::AreaLight;
    use super::super::tests::mean;
    use super::*;

    fn disk(center: DVec3, radius: f64) -> AreaLight {
        AreaLight::Disk(DiskLight::new(center, DVec3::X * radius, DVec3::Y * -radius).unwrap())
    }

    #[test]
    fn a_disk_seen_from_its_axis_has_the_solid_angle_of_its_cone() {
        for (height, radius) in [(1.0, 1.0), (1.0, 0.1), (5.0, 3.0), (1e3, 1e-3)] {
            let found = mean(&disk(DVec3::Z * height, radius), DVec3::ZERO, 512, |s| {
                s.pdf.recip()
            });
            // Solid angle 2π (1 - cos) with tan = radius / height, as 2π sin² / (1 + cos).
            let cos = height / height.hypot(radius);
            let exact = 2.0 * PI * (radius / height.hypot(radius)).powi(2) / (1.0 + cos);
            assert!(
                (found / exact - 1.0).abs() < 1e-5,
                "{height} {radius}: {found}, not {exact}"
            );
        }
    }

    #[test]
    fn a_disk_beside_the_axis_lights_a_parallel_plane_by_its_form_factor() {
        for (height, radius, aside) in [
            (1.0, 1.0, 0.0),
            (1.0, 0.5, 0.8),
            (2.0, 3.0, 1.0),
            (0.5, 1.0, 2.5f64),
        ] {
            let light = disk(DVec3::new(aside, 0.0, height), radius);
            let found = mean(&light, DVec3::ZERO, 512, |s| s.direction.z / s.pdf) / PI;
            // Nusselt's analogue of a disk from a parallel element (E. Sparrow, R. Cess, "Radiation Heat Transfer",
            // 1978): (1 - (h² + a² - r²) / sqrt((h² + a² + r²)² - 4 a² r²)) / 2.
            let [h2, r2, a2] = [height * height, radius * radius, aside * aside];
            let exact = 0.5 * (1.0 - (h2 + a2 - r2) / ((h2 + a2 + r2).powi(2) - 4.0 * a2 * r2).sqrt());
            assert!(
                (found / exact - 1.0).abs() < 1e-5,
                "{height} {radius} {aside}: {found}, not {exact}"
            );
        }
    }

    #[test]
    fn a_disk_emits_on_the_side_of_its_normal() {
        // X × -Y is -Z: a disk above the point faces down.
        let front = |z: f64| {
            disk(DVec3::ZERO, 1.0)
                .sample(DVec3::Z * z, [0.3, 0.3])
                .unwrap()
                .is_front()
        };
        assert!(front(-1.0) && !front(1.0));
    }
}
