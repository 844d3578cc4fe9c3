//! Point clouds: spheres of one radius, of which only the centres and colours are stored.

use glam::{DVec3, Vec3, Vec3A};

use crate::buffer::Buffer;
use crate::numeric::Bounds;
use crate::parallel;
use crate::shape::{Shape, Sphere};

/// Point cloud in object space, each point of which is a sphere. The primitives are numbered as the points.
///
/// After [`crate::scene::Scene::validate`] every position is finite and the radius is positive.
#[derive(Clone, Debug, Default)]
pub struct PointCloud {
    /// Centres of the spheres in object space.
    pub positions: Buffer<[f32; 3]>,
    /// Radius of all spheres in object space.
    pub radius: f64,
    /// Linear RGBA per point that multiplies the base colour.
    pub colors: Option<Buffer<[f32; 4]>>,
}

/// Number of points per parallel task.
const CHUNK: usize = 1 << 14;

impl PointCloud {
    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Returns whether the cloud has no points.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Returns the centre of a point, converted to f64 without rounding.
    #[inline(always)]
    pub fn center(&self, point: u32) -> DVec3 {
        Vec3::from(self.positions[point as usize]).as_dvec3()
    }

    /// Returns the sphere of a point as an analytic shape, by which it is intersected and shaded.
    #[inline(always)]
    pub fn shape(&self, point: u32) -> Shape {
        self.sphere_at(self.center(point))
    }

    /// Returns the sphere of a point at `center` as an analytic shape.
    #[inline(always)]
    pub(crate) fn sphere_at(&self, center: DVec3) -> Shape {
        Shape::Sphere(Sphere {
            center,
            radius: self.radius,
        })
    }

    /// Returns the smallest box around all spheres.
    pub fn bounds(&self) -> Bounds {
        let around = position_bounds(&self.positions);
        if around.is_empty() {
            return around;
        }
        Bounds {
            min: around.min - DVec3::splat(self.radius),
            max: around.max + DVec3::splat(self.radius),
        }
    }

    /// Returns the size of all arrays in bytes, shared or owned.
    pub fn byte_count(&self) -> usize {
        size_of_val(&self.positions[..]) + self.colors.as_ref().map_or(0, |colors| size_of_val(&colors[..]))
    }
}

/// Returns the smallest box around positions, computed in parallel.
pub fn position_bounds(positions: &[[f32; 3]]) -> Bounds {
    let chunks = parallel::map_chunks(positions, CHUNK, &|_, positions| {
        box_around(positions.iter().copied())
    });
    chunks.into_iter().fold(Bounds::EMPTY, Bounds::union)
}

/// Returns the smallest box around some positions.
#[inline(always)]
pub(super) fn box_around(positions: impl Iterator<Item = [f32; 3]>) -> Bounds {
    let mut low = Vec3A::INFINITY;
    let mut high = Vec3A::NEG_INFINITY;
    for position in positions {
        let p = Vec3A::from(position);
        low = low.min(p);
        high = high.max(p);
    }
    Bounds {
        min: low.as_dvec3(),
        max: high.as_dvec3(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_contain_the_spheres_and_not_only_their_centres() {
        let cloud = PointCloud {
            positions: vec![[0.0; 3], [4.0, -2.0, 1.0]].into(),
            radius: 0.5,
            colors: None,
        };
        let bounds = cloud.bounds();
        assert_eq!(bounds.min, DVec3::new(-0.5, -2.5, -0.5));
        assert_eq!(bounds.max, DVec3::new(4.5, 0.5, 1.5));
        assert!(PointCloud::default().bounds().is_empty());
    }

    #[test]
    fn point_without_colour_takes_twelve_bytes() {
        let cloud = PointCloud {
            positions: vec![[0.0; 3]; 100].into(),
            radius: 1.0,
            colors: None,
        };
        assert_eq!(cloud.byte_count(), 1200);
    }
}
