//! Area light of triangles: one is chosen in proportion to its area, then a point on it.
//!
//! The choice inverts the cumulative sum of the areas, and the remainder of the first number within its triangle is
//! reused: neighbouring numbers give neighbouring points, so stratified numbers stay stratified, which an alias table
//! would destroy.

use glam::DVec3;

use super::{AreaLightError, LightSample, SurfacePoint, is_density, sample_of_area};
use crate::numeric::cumulative::{self, ChosenSteps};
use crate::numeric::{Lanes, warp};

/// Triangle of a mesh light, in world space.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightTriangle {
    /// Position of the first corner.
    pub(crate) corner: DVec3,
    /// Vectors from the first corner to the second and to the third.
    pub(crate) edges: [DVec3; 2],
    /// Unit normal on the front; NaN without an area.
    pub(crate) normal: DVec3,
}

impl LightTriangle {
    fn new([a, b, c]: [DVec3; 3]) -> LightTriangle {
        let edges = [b - a, c - a];
        let across = edges[0].cross(edges[1]);
        LightTriangle {
            corner: a,
            edges,
            normal: across / across.length(),
        }
    }

    /// Returns the point of these barycentric coordinates of the second and the third corner.
    fn point(&self, [to_b, to_c]: [f64; 2]) -> DVec3 {
        self.corner + to_b * self.edges[0] + to_c * self.edges[1]
    }
}

/// Mesh light of triangles in world space, 108 bytes each; their fronts are where their corners run counter-clockwise.
#[derive(Clone, Debug)]
pub struct MeshLight {
    triangles: Vec<LightTriangle>,
    /// Cumulative area up to and including each triangle.
    cumulative_area: Vec<f64>,
    /// First triangles of the searches in `cumulative_area`: see [`cumulative::guide`].
    guide: Vec<u32>,
}

impl MeshLight {
    /// Creates the light of `triangles`, in metres. Triangles without an area are never chosen.
    pub fn new(triangles: impl IntoIterator<Item = [DVec3; 3]>) -> Result<MeshLight, AreaLightError> {
        let triangles: Vec<LightTriangle> = triangles.into_iter().map(LightTriangle::new).collect();
        if u32::try_from(triangles.len()).is_err() {
            return Err(AreaLightError::TooManyTriangles);
        }
        // Accumulate the areas
        let mut area = 0.0;
        let cumulative_area: Vec<f64> = triangles
            .iter()
            .map(|LightTriangle { edges: [e1, e2], .. }| {
                area += 0.5 * e1.cross(*e2).length();
                area
            })
            .collect();
        // A NaN area makes the sum NaN.
        if !(is_density(area) && is_density(area.recip())) {
            return Err(AreaLightError::NoArea);
        }
        let mut guide = Vec::with_capacity(triangles.len());
        cumulative::guide(&cumulative_area, &mut guide);
        Ok(MeshLight {
            triangles,
            cumulative_area,
            guide,
        })
    }

    /// Returns the triangle that `u` selects by its area, and the position of `u` within the range of that triangle.
    #[inline(always)]
    pub(crate) fn choose(&self, u: f64) -> (usize, f64) {
        cumulative::invert(&self.cumulative_area, &self.guide, u)
    }

    /// Returns the triangles that sixteen numbers select, as [`MeshLight::choose`] does.
    pub(crate) fn choose_packet(&self, u: &Lanes<f64>) -> ChosenSteps {
        cumulative::invert_packet(&self.cumulative_area, &self.guide, u)
    }

    /// Returns one of the triangles.
    #[inline(always)]
    pub(crate) fn triangle(&self, index: usize) -> &LightTriangle {
        &self.triangles[index]
    }

    /// Samples the point that `u` in [0, 1)² selects for `p`; `None` in the plane of the chosen triangle.
    ///
    /// Of the 32 bits of a sampler's number, the choice among n triangles uses about log2 n.
    #[inline]
    pub fn sample(&self, p: DVec3, u: [f64; 2]) -> Option<LightSample> {
        // Choose a triangle by its area, then sample a point uniformly on it
        let (chosen, within) = self.choose(u[0]);
        let triangle = &self.triangles[chosen];
        let position = triangle.point(warp::triangle([within, u[1]]));
        let sample = sample_of_area(p, position, triangle.normal, self.area())?;
        Some(LightSample {
            primitive: chosen as u32,
            ..sample
        })
    }

    /// Returns the point that `u` selects uniformly from the triangles.
    pub(super) fn surface_point(&self, u: [f64; 2]) -> SurfacePoint {
        let (chosen, within) = self.choose(u[0]);
        let triangle = &self.triangles[chosen];
        SurfacePoint {
            position: triangle.point(warp::triangle([within, u[1]])),
            normal: triangle.normal,
            primitive: chosen as u32,
        }
    }

    /// Returns the area of all triangles, of one side, in square metres.
    #[inline(always)]
    pub fn area(&self) -> f64 {
        self.cumulative_area[self.cumulative_area.len() - 1]
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::super::AreaLight;
    use super::super::tests::mean;
    use super::*;

    /// Returns the cube of half-width 1 around `center`, its fronts outside, in triangles of two sizes and a degenerate
    /// one.
    fn cube(center: DVec3) -> Vec<[DVec3; 3]> {
        let mut triangles = vec![[center, center + DVec3::X, center + 2.0 * DVec3::X]];
        for (n, u) in [(DVec3::X, DVec3::Y), (DVec3::Y, DVec3::Z), (DVec3::Z, DVec3::X)] {
            for n in [n, -n] {
                let v = n.cross(u);
                let [a, b, c, d] = [-u - v, u - v, u + v, v - u].map(|corner| center + n + corner);
                let middle = c + 0.25 * (d - c);
                triangles.extend([[a, b, c], [a, c, middle], [a, middle, d]]);
            }
        }
        triangles
    }

    #[test]
    fn inside_a_closed_mesh_light_comes_from_the_whole_sphere() {
        let light = AreaLight::Mesh(MeshLight::new(cube(DVec3::ZERO)).unwrap());
        assert!((light.area() - 24.0).abs() < 1e-13);
        let p = DVec3::new(0.2, -0.1, 0.3);
        let solid_angle = mean(&light, p, 1024, |s| {
            assert!(!s.is_front() && s.primitive > 0);
            s.pdf.recip()
        });
        assert!((solid_angle / (4.0 * PI) - 1.0).abs() < 5e-4, "{solid_angle}");
        let irradiance = mean(&light, p, 1024, |s| s.direction.y.max(0.0) / s.pdf);
        assert!((irradiance / PI - 1.0).abs() < 1e-3, "{irradiance}");
    }

    #[test]
    fn triangles_are_sampled_in_proportion_to_area() {
        let light = MeshLight::new(cube(DVec3::ZERO)).unwrap();
        let mut count = vec![0.0; light.triangles.len()];
        for step in 0..2400 {
            let u = [(f64::from(step) + 0.5) / 2400.0, 0.5];
            count[light.sample(DVec3::splat(9.0), u).unwrap().primitive as usize] += 0.01;
        }
        // 24 square metres in 2400 steps: each count is the area to within one step.
        for (triangle, &count) in light.triangles.iter().zip(&count) {
            let [e1, e2] = triangle.edges;
            let area = 0.5 * e1.cross(e2).length();
            assert!((count - area).abs() < 0.0101, "{count}, not {area}");
        }
    }

    #[test]
    fn extreme_samples_select_first_and_last_nondegenerate_triangle() {
        let mut triangles = cube(DVec3::ZERO);
        triangles.push([DVec3::ONE; 3]);
        let light = MeshLight::new(triangles).unwrap();
        let pick = |u: f64| light.sample(DVec3::splat(9.0), [u, 0.5]).unwrap().primitive;
        assert_eq!((pick(0.0), pick(1.0 - f64::EPSILON / 2.0)), (1, 18));
    }
}
