//! Procedural clouds: fractal noise modulates a shape, and the density is baked into a grid.
//!
//! The density at a point is the excess of the shape's own density, perturbed by noise, over a threshold, so that
//! clouds have billows and clear sky between them (D. Ebert et al., "Texturing and Modeling: A Procedural Approach",
//! 3rd ed., 2003, ch. 9: "hypertexture" and "puffy clouds"). Below the threshold the density is exactly 0, hence empty
//! space.

use glam::DVec3;
use multiversion::multiversion;

use super::{Grid, GridSamples, VolumeError};
use crate::numeric::LANES;
use crate::numeric::noise::{fractal, lone, turbulence};
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
        let [density] = self.densities(&lone(p));
        density
    }

    /// Bakes the cloud into a grid of `size` samples along x, y, z; at least one each.
    pub fn bake(&self, size: [usize; 3]) -> Result<Grid, VolumeError> {
        let [nx, ny, nz] = size;
        // Evaluate densities at voxel centres, one row a task
        let row = |j: usize| {
            let [y, z] = [middle(j % ny, ny), middle(j / ny, nz)];
            let mut densities = vec![0.0; nx];
            fill_row(self, [y, z], &mut densities);
            densities
        };
        let rows = ny.checked_mul(nz).unwrap_or(0);
        Grid::new(size, GridSamples::Floats(parallel::map(rows, &row).concat()))
    }

    /// Returns the densities at `N` points in the cube [-1, 1]³, given as x, y and z.
    #[inline(always)]
    fn densities<const N: usize>(&self, p: &[[f64; N]; 3]) -> [f64; N] {
        // Noise repeats after 256 cells: seeds start at different positions of it
        let start = DVec3::new(17.0, 31.0, 59.0) * f64::from(self.seed % 251) + 0.37;
        let mut q = [[0.0; N]; 3];
        for axis in 0..3 {
            for l in 0..N {
                q[axis][l] = p[axis][l] * self.frequency + start[axis];
            }
        }
        // Return early where no noise can raise the density above 0
        let means = self.shape.means(p, &q);
        if means.iter().all(|&mean| mean <= 0.0) {
            return [0.0; N];
        }
        // Evaluate the noise
        let unfiltered = [0.0; N];
        let (noise, offset) = match self.shape {
            CloudShape::Plume => (turbulence(&q, self.octaves, &unfiltered), -0.5),
            _ => (fractal(&q, self.octaves, &unfiltered), 0.0),
        };
        // Subtract the threshold and rescale
        let mut densities = [0.0; N];
        for l in 0..N {
            let noise = 2.0 * noise[l] + offset;
            let rough = means[l] * (1.0 + self.roughness * noise) - self.threshold;
            let density = (rough / (1.0 - self.threshold).max(f64::EPSILON)).clamp(0.0, 1.0);
            densities[l] = if means[l] <= 0.0 { 0.0 } else { density };
        }
        densities
    }
}

impl CloudShape {
    /// Returns the mean densities at the points `p`; `q` is `p` in cells of noise.
    #[inline(always)]
    fn means<const N: usize>(self, p: &[[f64; N]; 3], q: &[[f64; N]; 3]) -> [f64; N] {
        // A layer has one density everywhere
        let mut means = [0.5; N];
        match self {
            CloudShape::Layer => {}
            CloudShape::Puff => {
                for l in 0..N {
                    let [x, y, z] = [p[0][l], p[1][l], p[2][l]];
                    means[l] = 1.0 - (x * x + y * y + z * z);
                }
            }
            CloudShape::Plume => {
                // Low-frequency noise, stretched along y, displaces the axis in proportion to the height
                let mut stretched = [0.0; N];
                for l in 0..N {
                    stretched[l] = 0.35 * q[1][l];
                }
                let (near, far) = ([3.5; N], [7.5; N]);
                let unfiltered = [0.0; N];
                let sway_x = fractal(&[far, stretched, near], 2, &unfiltered);
                let sway_z = fractal(&[near, stretched, far], 2, &unfiltered);
                for l in 0..N {
                    let height = 0.5 * (p[1][l] + 1.0);
                    let x = p[0][l] - 1.2 * height * sway_x[l];
                    let z = p[2][l] - 1.2 * height * sway_z[l];
                    let radius = 0.07 + 0.33 * height;
                    let across = 1.0 - (x * x + z * z) / (radius * radius);
                    // Fade out over the topmost fifth
                    means[l] = across * (5.0 * (1.0 - height)).min(1.0) * (1.0 - 0.4 * height);
                }
            }
        }
        means
    }
}

/// Returns the coordinate of the centre of voxel `i` of `count` along an axis of the cube.
#[inline(always)]
fn middle(i: usize, count: usize) -> f64 {
    2.0 * (i as f64 + 0.5) / count as f64 - 1.0
}

/// Sets the densities of a row of voxels along x, with these coordinates y and z.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn fill_row(cloud: &Cloud, [y, z]: [f64; 2], row: &mut [f32]) {
    // Take sixteen voxels at a time, the last ones with lanes that are not stored
    let count = row.len();
    for (first, voxels) in row.chunks_mut(LANES).enumerate() {
        let mut p = [[0.0; LANES], [y; LANES], [z; LANES]];
        for l in 0..LANES {
            p[0][l] = middle(first * LANES + l, count);
        }
        let densities = cloud.densities(&p);
        for (voxel, density) in voxels.iter_mut().zip(densities) {
            *voxel = density as f32;
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
