//! Procedural clouds: fractal noise in a shape, baked into a grid.
//!
//! The density at a point is how far the shape's own density, roughened by noise, exceeds a threshold, so that clouds
//! have billows and clear sky between them (D. Ebert et al., "Texturing and Modeling: A Procedural Approach", 3rd ed.,
//! 2003, ch. 9: "hypertexture" and "puffy clouds"). What is under the threshold is exactly 0, hence empty space.

use glam::{DVec3, Vec3Swizzles};

use super::{Grid, Samples, VolumeError};
use crate::numeric::noise::{fractal, turbulence};
use crate::parallel;

/// A cloud in the cube [-1, 1]³, with densities from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cloud {
    /// What the noise roughens.
    pub shape: CloudShape,
    /// Cells of the coarsest noise along half the cube's side; positive.
    pub frequency: f64,
    /// Octaves of noise, each twice as fine and half as strong as the one before.
    pub octaves: u32,
    /// How much of the density is the noise's, from 0 (the plain shape) up; 1 is about as much as the shape's.
    pub roughness: f64,
    /// Density at which the cloud begins, from 0; what is over it is stretched to [0, 1].
    pub threshold: f64,
    /// Clouds of other seeds look alike but have nothing in common.
    pub seed: u32,
}

/// The mean density of a [`Cloud`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloudShape {
    /// The same all over the cube.
    Layer,
    /// 1 in the middle, 0 from the unit sphere on.
    Puff,
    /// A column of smoke that rises along +y from the cube's bottom, widens, sways and thins out.
    Plume,
}

impl Cloud {
    /// The smoke that rises from a chimney: mostly empty space.
    pub const SMOKE: Cloud = Cloud {
        shape: CloudShape::Plume,
        frequency: 3.0,
        octaves: 6,
        roughness: 0.9,
        threshold: 0.25,
        seed: 1,
    };

    /// The density at `p` in the cube [-1, 1]³.
    pub fn density(&self, p: DVec3) -> f64 {
        // Noise repeats after 256 cells: seeds start at other places of it.
        let start = DVec3::new(17.0, 31.0, 59.0) * f64::from(self.seed % 251) + 0.37;
        let q = p * self.frequency + start;
        let mean = self.shape.mean(p, q);
        if mean <= 0.0 {
            return 0.0;
        }
        let noise = match self.shape {
            CloudShape::Plume => 2.0 * turbulence(q, self.octaves, 0.0) - 0.5,
            _ => 2.0 * fractal(q, self.octaves, 0.0),
        };
        let rough = mean * (1.0 + self.roughness * noise) - self.threshold;
        (rough / (1.0 - self.threshold).max(f64::EPSILON)).clamp(0.0, 1.0)
    }

    /// The cloud as a grid of `size` samples along x, y, z; at least one each.
    pub fn bake(&self, size: [usize; 3]) -> Result<Grid, VolumeError> {
        let [nx, ny, nz] = size;
        let middle = |i: usize, count: usize| 2.0 * (i as f64 + 0.5) / count as f64 - 1.0;
        let row = |j: usize| {
            let [y, z] = [middle(j % ny, ny), middle(j / ny, nz)];
            let density = |i: usize| self.density(DVec3::new(middle(i, nx), y, z)) as f32;
            (0..nx).map(density).collect::<Vec<f32>>()
        };
        let rows = ny.checked_mul(nz).unwrap_or(0);
        Grid::new(size, Samples::Floats(parallel::map(rows, &row).concat()))
    }
}

impl CloudShape {
    /// The mean density at `p`; `q` is the same point in cells of noise.
    fn mean(self, p: DVec3, q: DVec3) -> f64 {
        match self {
            CloudShape::Layer => 0.5,
            CloudShape::Puff => 1.0 - p.length_squared(),
            CloudShape::Plume => {
                let height = 0.5 * (p.y + 1.0);
                // Slow, tall noise sways the axis, more the higher it is.
                let slow = DVec3::new(7.5, 0.35 * q.y, 3.5);
                let sway = DVec3::new(fractal(slow, 2, 0.0), 0.0, fractal(slow.zyx(), 2, 0.0));
                let away = (p - 1.2 * height * sway) * DVec3::new(1.0, 0.0, 1.0);
                let radius = 0.07 + 0.33 * height;
                let across = 1.0 - away.length_squared() / (radius * radius);
                // Thins out over the topmost fifth.
                across * (5.0 * (1.0 - height)).min(1.0) * (1.0 - 0.4 * height)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoke_is_mostly_empty_and_reaches_from_bottom_to_top() {
        let size = 48;
        let grid = Cloud::SMOKE.bake([size; 3]).unwrap();
        let [mut full, mut layers] = [0, 0];
        for y in 0..size {
            let layer = (0..size * size).filter(|i| {
                let p = DVec3::new((i % size) as f64, y as f64, (i / size) as f64);
                grid.sample(p) > 0.0
            });
            let count = layer.count();
            full += count;
            layers += usize::from(count > 0);
        }
        let share = full as f64 / (size * size * size) as f64;
        assert!((0.01..0.15).contains(&share), "{share}");
        assert!(layers > size * 4 / 5, "{layers}");
    }

    #[test]
    fn densities_stay_in_the_unit_interval_and_seeds_differ() {
        for shape in [CloudShape::Layer, CloudShape::Puff, CloudShape::Plume] {
            let cloud = Cloud {
                shape,
                roughness: 3.0,
                threshold: 0.1,
                ..Cloud::SMOKE
            };
            let other = Cloud { seed: 2, ..cloud };
            let mut differ = false;
            for i in 0..2000 {
                let t = f64::from(i);
                let p = DVec3::new((0.618 * t).fract(), (0.755 * t).fract(), (0.57 * t).fract()) * 2.0 - 1.0;
                let density = cloud.density(p);
                assert!((0.0..=1.0).contains(&density));
                differ |= density != other.density(p);
            }
            assert!(differ, "{shape:?}");
        }
    }

    #[test]
    fn a_smooth_puff_is_a_paraboloid() {
        let puff = Cloud {
            shape: CloudShape::Puff,
            roughness: 0.0,
            threshold: 0.0,
            ..Cloud::SMOKE
        };
        assert_eq!(puff.density(DVec3::new(0.5, 0.0, 0.0)), 0.75);
        assert_eq!(puff.density(DVec3::ONE), 0.0);
    }

    #[test]
    fn no_sample_is_no_grid() {
        for size in [[0, 4, 4], [4, 0, 4], [4, 4, 0], [1, usize::MAX, usize::MAX]] {
            assert!(Cloud::SMOKE.bake(size).is_err(), "{size:?}");
        }
    }
}
