//! Conversion of glTF primitives of points to point clouds.

use gltf::json;
use json::mesh::Semantic;

use super::PrimitiveReader;
use crate::buffer::Buffer;
use crate::gltf::GltfError;
use crate::mesh::{PointCloud, position_bounds};
use crate::parallel;
use crate::scene::mesh_cleanup;

/// Default diameter of a point, in spacings of as many points on a square as large as the bounding box's diagonal. Points
/// on a surface are about that far apart on average, and spheres of twice that diameter leave few holes in it.
const SPACINGS_PER_POINT: f64 = 2.0;
/// Largest default diameter relative to the diagonal of the bounding box, so that few points stay apart.
const MAX_RELATIVE_SIZE: f64 = 1.0 / 32.0;
/// Default diameter of points that all coincide, such as a single one.
const SIZE_WITHOUT_EXTENT: f64 = 1.0;

impl PrimitiveReader<'_> {
    /// Reads the points at `positions`, with their colours; `size` is the diameter of a point, if it is given.
    pub(super) fn points(
        &mut self,
        positions: Buffer<[f32; 3]>,
        size: Option<f64>,
    ) -> Result<PointCloud, GltfError> {
        let colors = match self.attribute(Semantic::Colors(0)) {
            Some(accessor) => Some(self.colors(accessor, positions.len())?),
            None => None,
        };
        let all = PointCloud {
            positions,
            radius: 0.0,
            colors,
        };
        // Select the points that the indices name, without those that are nowhere
        let selected = match self.selection(all.len())? {
            Some(selection) => all.selected(&selection),
            None => all,
        };
        let cloud = self.finite_points(selected);
        // Derive the size from the density of the points
        Ok(PointCloud {
            radius: 0.5 * size.unwrap_or_else(|| default_size(&cloud.positions)),
            ..cloud
        })
    }

    /// Returns the indices of the primitive; `None` if it has none, so that every vertex is a point.
    fn selection(&self, vertex_count: usize) -> Result<Option<Vec<u32>>, GltfError> {
        let Some(indices) = self.document.primitive(self.id).indices else {
            return Ok(None);
        };
        let indices = self.document.accessor(indices.value())?.indices()?;
        match indices.iter().find(|&&index| index as usize >= vertex_count) {
            Some(bad) => Err(self.fault(format!("has the index {bad}, but {vertex_count} vertices"))),
            None => Ok(Some(indices)),
        }
    }

    /// Returns the cloud without points whose positions are not finite.
    fn finite_points(&mut self, cloud: PointCloud) -> PointCloud {
        if mesh_cleanup::all_finite(bytemuck::cast_slice(&cloud.positions)) {
            return cloud;
        }
        let is_finite = |point: &u32| cloud.center(*point).is_finite();
        let kept: Vec<u32> = (0..cloud.len() as u32).filter(is_finite).collect();
        let removed = cloud.len() - kept.len();
        self.warn(&format!(
            "has {removed} points that are not finite and were skipped"
        ));
        cloud.selected(&kept)
    }
}

/// Returns the default diameter of points at these positions.
fn default_size(positions: &[[f32; 3]]) -> f64 {
    let bounds = position_bounds(positions);
    let diagonal = if bounds.is_empty() {
        0.0
    } else {
        bounds.extent().length()
    };
    if diagonal == 0.0 {
        return SIZE_WITHOUT_EXTENT;
    }
    let spacing = diagonal / (positions.len() as f64).sqrt();
    (SPACINGS_PER_POINT * spacing).min(MAX_RELATIVE_SIZE * diagonal)
}

impl PointCloud {
    /// Returns the points with these indices.
    fn selected(&self, points: &[u32]) -> PointCloud {
        let colors = self.colors.as_ref().map(|colors| {
            let color = |i: usize| colors[points[i] as usize];
            Buffer::from(parallel::generate(points.len(), color))
        });
        let position = |i: usize| self.positions[points[i] as usize];
        PointCloud {
            positions: Buffer::from(parallel::generate(points.len(), position)),
            colors,
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_size_follows_the_spacing_and_has_a_largest_value() {
        // A square of 100 x 100 points with a diagonal of √2: two spacings of √2 / 100.
        let at = |i: u32| [(i % 100) as f32 / 99.0, (i / 100) as f32 / 99.0, 0.0];
        let square: Vec<[f32; 3]> = (0..10_000).map(at).collect();
        assert!((default_size(&square) - 2.0 * 2f64.sqrt() / 100.0).abs() < 1e-12);
        // Two points 8 apart: a 32nd of the diagonal.
        assert_eq!(default_size(&[[0.0; 3], [0.0, 8.0, 0.0]]), 0.25);
        assert_eq!(default_size(&[[5.0; 3]]), SIZE_WITHOUT_EXTENT);
    }
}
