//! Procedural clouds: fractal noise modulates a shape, and the density is baked into a grid.
//!
//! The density at a point is the excess of the shape's own density, perturbed by noise, over a threshold, so that
//! clouds have billows and clear sky between them (D. Ebert et al., "Texturing and Modeling: A Procedural Approach",
//! 3rd ed., 2003, ch. 9: "hypertexture" and "puffy clouds"). Below the threshold the density is exactly 0, hence empty
//! space.

use glam::{DVec3, Vec3Swizzles};

use super::{Grid, GridSamples, VolumeError};
use crate::numeric::noise::{fractal, turbulence};
use crate::parallel;

/// Procedural cloud in the cube [-1, 1]³, with densities from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cloud {
    /// Mean density, which the noise perturbs.
    pub shape: CloudShape,
    /// Number of cells of the coarsest noise along half the cube's side; positive.
    pub frequency: f64,
    /// Number of octaves of noise, each with twice the frequency and half the amplitude of the previous.
    pub octaves: u32,
    /// Amplitude of the noise relative to the mean density, from 0 (the plain shape) up; 1 makes both about equal.
    pub roughness: f64,
    /// Density threshold of the cloud, from 0; the excess is rescaled to [0, 1].
    pub threshold: f64,
    /// Seed of the noise: clouds of different seeds look similar but are uncorrelated.
    pub seed: u32,
}

/// Mean density of a [`Cloud`] as a function of position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloudShape {
    /// Constant density throughout the cube.
    Layer,
    /// Ball with density 1 in the centre, falling to 0 at the unit sphere.
    Puff,
    /// Column of smoke that rises along +y from the cube's bottom, widens, sways and thins out.
    Plume,
}

impl Cloud {
    /// Smoke that rises from a chimney: mostly empty space.
    pub const SMOKE: Cloud = Cloud {
        shape: CloudShape::Plume,
        frequency: 3.0,
        octaves: 6,
        roughness: 0.9,
        threshold: 0.25,
        seed: 1,
    };

    /// Returns the density at `p` in the cube [-1, 1]³.
    pub fn density(&self, p: DVec3) -> f64 {
        // Noise repeats after 256 cells: seeds start at different positions of it.
        let start = DVec3::new(17.0, 31.0, 59.0) * f64::from(self.seed % 251) + 0.37;
        let q = p * self.frequency + start;
        let mean = self.shape.mean(p, q);
        // Return early where the noise cannot raise the density above 0
        if mean <= 0.0 {
            return 0.0;
        }
        // Evaluate the noise
        let noise = match self.shape {
            CloudShape::Plume => 2.0 * turbulence(q, self.octaves, 0.0) - 0.5,
            _ => 2.0 * fractal(q, self.octaves, 0.0),
        };
        // Subtract the threshold and rescale
        let rough = mean * (1.0 + self.roughness * noise) - self.threshold;
        (rough / (1.0 - self.threshold).max(f64::EPSILON)).clamp(0.0, 1.0)
    }

    /// Bakes the cloud into a grid of `size` samples along x, y, z; at least one each.
    pub fn bake(&self, size: [usize; 3]) -> Result<Grid, VolumeError> {
        let [nx, ny, nz] = size;
        let middle = |i: usize, count: usize| 2.0 * (i as f64 + 0.5) / count as f64 - 1.0;
        // Evaluate densities at voxel centres, one row a task
        let row = |j: usize| {
            let [y, z] = [middle(j % ny, ny), middle(j / ny, nz)];
            let density = |i: usize| self.density(DVec3::new(middle(i, nx), y, z)) as f32;
            (0..nx).map(density).collect::<Vec<f32>>()
        };
        let rows = ny.checked_mul(nz).unwrap_or(0);
        Grid::new(size, GridSamples::Floats(parallel::map(rows, &row).concat()))
    }
}

impl CloudShape {
    /// Returns the mean density at `p`; `q` is `p` in cells of noise.
    fn mean(self, p: DVec3, q: DVec3) -> f64 {
        match self {
            CloudShape::Layer => 0.5,
            CloudShape::Puff => 1.0 - p.length_squared(),
            CloudShape::Plume => {
                let height = 0.5 * (p.y + 1.0);
                // Low-frequency noise, stretched along y, displaces the axis in proportion to the height.
                let slow = DVec3::new(7.5, 0.35 * q.y, 3.5);
                let sway = DVec3::new(fractal(slow, 2, 0.0), 0.0, fractal(slow.zyx(), 2, 0.0));
                let away = (p - 1.2 * height * sway) * DVec3::new(1.0, 0.0, 1.0);
                let radius = 0.07 + 0.33 * height;
                let across = 1.0 - away.length_squared() / (radius * radius);
                // Fade out over the topmost fifth.
                across * (5.0 * (1.0 - height)).min(1.0) * (1.0 - 0.4 * height)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoke_is_mostly_empty_and_spans_the_height() {
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
    fn densities_are_in_the_unit_interval_and_depend_on_the_seed() {
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
    fn smooth_puff_is_a_paraboloid() {
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
    fn zero_samples_are_rejected() {
        for size in [[0, 4, 4], [4, 0, 4], [4, 4, 0], [1, usize::MAX, usize::MAX]] {
            assert!(Cloud::SMOKE.bake(size).is_err(), "{size:?}");
        }
    }
}
