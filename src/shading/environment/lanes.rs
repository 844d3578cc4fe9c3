//! Look-up and sampling of an environment map in sixteen lanes at once, with the bits of single directions.
//!
//! Only the reads of tables and texels go lane by lane. Closures are few: one that is not inlined would be compiled for the
//! lowest instruction set.

use multiversion::multiversion;

use super::{EnvironmentMap, bilinear, luminance};
use crate::numeric::{LANES, Lanes, Lanes3, warp};

/// Radiance from sixteen directions, and the densities with which they are sampled.
pub struct EnvironmentLanes {
    /// Radiance from each direction, linear RGB.
    pub radiance: Lanes3<f32>,
    /// Densities per steradian; see [`EnvironmentMap::pdf`].
    pub pdf: Lanes<f64>,
}

/// Sixteen directions sampled from an environment map, with their radiance and density.
pub struct EnvironmentSamples {
    /// Unit vectors toward the light, in world space.
    pub direction: Lanes3<f64>,
    /// Radiance from the directions, linear RGB.
    pub radiance: Lanes3<f32>,
    /// Densities of the directions per steradian; 0 in lanes without a sample.
    pub pdf: Lanes<f64>,
}

/// Four texels around a position in each lane, in the order of [`EnvironmentMap::corner_indices`].
type TexelLanes = [Lanes3<f32>; 4];

impl EnvironmentMap {
    /// Returns the radiance from `directions`, which are in world space and of any length.
    pub fn look_up_radiance(&self, directions: &Lanes3<f32>) -> Lanes3<f32> {
        let mut radiance = [[0.0; LANES]; 3];
        look_up_radiance_lanes(self, directions, &mut radiance);
        radiance
    }

    /// Returns the radiance from `directions`, which are in world space and of any length, and their densities.
    pub fn look_up(&self, directions: &Lanes3<f32>) -> EnvironmentLanes {
        let mut found = EnvironmentLanes {
            radiance: [[0.0; LANES]; 3],
            pdf: [0.0; LANES],
        };
        look_up_lanes(self, directions, &mut found);
        found
    }

    /// Samples directions with the random numbers `u`: see [`EnvironmentMap::sample`].
    pub fn sample_packet(&self, u: &[Lanes<f64>; 2]) -> EnvironmentSamples {
        let mut samples = EnvironmentSamples {
            direction: [[0.0; LANES]; 3],
            radiance: [[0.0; LANES]; 3],
            pdf: [0.0; LANES],
        };
        if self.total() > 0.0 {
            sample_lanes(self, u, &mut samples);
        }
        samples
    }

    /// Reads the texels around the positions.
    #[inline(always)]
    fn texels(&self, column: &Lanes<u32>, row: &Lanes<u32>) -> TexelLanes {
        let mut texels = [[[0.0; LANES]; 3]; 4];
        for l in 0..LANES {
            let indices = self.corner_indices(column[l] as usize, row[l] as usize);
            for (lanes, index) in texels.iter_mut().zip(indices) {
                let texel = self.texels[index];
                (0..3).for_each(|channel| lanes[channel][l] = texel[channel]);
            }
        }
        texels
    }

    /// Reads the densities of rows.
    #[inline(always)]
    fn row_densities_at(&self, row: &Lanes<u32>) -> Lanes<f64> {
        let mut densities = [0.0; LANES];
        for l in 0..LANES {
            densities[l] = self.row_densities[row[l] as usize];
        }
        densities
    }
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn look_up_radiance_lanes(map: &EnvironmentMap, directions: &Lanes3<f32>, radiance: &mut Lanes3<f32>) {
    let cells = CellLanes::at(map, directions);
    interpolate(&map.texels(&cells.column, &cells.row), &cells.fraction, radiance);
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn look_up_lanes(map: &EnvironmentMap, directions: &Lanes3<f32>, found: &mut EnvironmentLanes) {
    // Interpolate between texels
    let cells = CellLanes::at(map, directions);
    let texels = map.texels(&cells.column, &cells.row);
    interpolate(&texels, &cells.fraction, &mut found.radiance);
    // Compute the densities
    let row_density = map.row_densities_at(&cells.row);
    let mut sines = [0.0; LANES];
    for l in 0..LANES {
        let [x, y, z] = wide([directions[0][l], directions[1][l], directions[2][l]]);
        let horizontal = x * x + z * z;
        sines[l] = (horizontal / (horizontal + y * y)).sqrt();
    }
    densities(&row_density, &sines, &found.radiance, &mut found.pdf);
}

/// Cells of the map in each lane, and positions within them.
struct CellLanes {
    column: Lanes<u32>,
    row: Lanes<u32>,
    fraction: [Lanes<f64>; 2],
}

impl CellLanes {
    #[inline(always)]
    fn at(map: &EnvironmentMap, directions: &Lanes3<f32>) -> CellLanes {
        let mut cells = CellLanes {
            column: [0; LANES],
            row: [0; LANES],
            fraction: [[0.0; LANES]; 2],
        };
        for l in 0..LANES {
            let direction = wide([directions[0][l], directions[1][l], directions[2][l]]);
            let position = map.position_at(map.cell_coordinates(direction));
            (cells.column[l], cells.row[l]) = (position.column as u32, position.row as u32);
            (0..2).for_each(|axis| cells.fraction[axis][l] = position.fraction[axis]);
        }
        cells
    }
}

#[inline(always)]
fn wide([x, y, z]: [f32; 3]) -> [f64; 3] {
    [x.into(), y.into(), z.into()]
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn sample_lanes(map: &EnvironmentMap, u: &[Lanes<f64>; 2], samples: &mut EnvironmentSamples) {
    // Sample a row of cells, then a cell within the row
    let (mut column, mut row) = ([0; LANES], [0; LANES]);
    let (mut across, mut down) = ([0.0; LANES], [0.0; LANES]);
    for l in 0..LANES {
        let (chosen, within) = map.sample_row(u[1][l]);
        (row[l], down[l]) = (chosen as u32, within);
    }
    for l in 0..LANES {
        let (chosen, within) = map.sample_column(row[l] as usize, u[0][l]);
        (column[l], across[l]) = (chosen as u32, within);
    }
    let texels = map.texels(&column, &row);
    let row_density = map.row_densities_at(&row);
    // Sample the positions within the cells by their bilinear luminance
    let mut fraction = [[0.0; LANES]; 2];
    for l in 0..LANES {
        let [a, b, c, d] = &texels;
        let (a, b) = (luminance(lane(a, l)), luminance(lane(b, l)));
        let (c, d) = (luminance(lane(c, l)), luminance(lane(d, l)));
        let t = warp::linear(a + b, c + d, down[l]);
        fraction[0][l] = warp::linear(a + t * (c - a), b + t * (d - b), across[l]);
        fraction[1][l] = t;
    }
    interpolate(&texels, &fraction, &mut samples.radiance);
    // Convert the positions into directions, and the densities into solid angle
    let mut sines = [0.0; LANES];
    for l in 0..LANES {
        let (column, row) = (f64::from(column[l]), f64::from(row[l]));
        let (direction, sine) = map.direction_at([column, row], [fraction[0][l], fraction[1][l]]);
        for axis in 0..3 {
            samples.direction[axis][l] = direction[axis];
        }
        sines[l] = sine;
    }
    densities(&row_density, &sines, &samples.radiance, &mut samples.pdf);
}

/// Interpolates the radiance between the texels of all lanes.
#[inline(always)]
fn interpolate(texels: &TexelLanes, fraction: &[Lanes<f64>; 2], radiance: &mut Lanes3<f32>) {
    for channel in 0..3 {
        for l in 0..LANES {
            let [a, b, c, d] = texels;
            let corners = [a[channel][l], b[channel][l], c[channel][l], d[channel][l]];
            radiance[channel][l] = bilinear(corners, [fraction[0][l], fraction[1][l]]);
        }
    }
}

/// Sets the densities per steradian of directions with these sines to +y; 0 where there is none.
#[inline(always)]
fn densities(row_density: &Lanes<f64>, sines: &Lanes<f64>, radiance: &Lanes3<f32>, pdf: &mut Lanes<f64>) {
    for l in 0..LANES {
        let luminance = luminance(lane(radiance, l));
        let density = row_density[l] * luminance / sines[l];
        let is_density = (luminance > 0.0) & (density > 0.0) & (density < f64::INFINITY);
        pdf[l] = if is_density { density } else { 0.0 };
    }
}

#[inline(always)]
fn lane(vectors: &Lanes3<f32>, l: usize) -> [f32; 3] {
    [vectors[0][l], vectors[1][l], vectors[2][l]]
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::super::tests::{map, midpoints, speckled_map};
    use super::*;

    #[test]
    fn lanes_have_the_radiance_and_density_of_single_directions() {
        let map = speckled_map();
        // Of lengths from 2^-20 to 2^20
        let directions: Vec<Vec3> = midpoints(64)
            .zip((-20..=20).cycle())
            .map(|([a, b], exponent)| warp::direction(2.0 * a, b).as_vec3() * f32::powi(2.0, exponent))
            .collect();
        for packet in directions.chunks_exact(LANES) {
            let lanes = [0, 1, 2].map(|axis| std::array::from_fn(|l| packet[l][axis]));
            let found = map.look_up(&lanes);
            assert_eq!(map.look_up_radiance(&lanes), found.radiance);
            for (l, direction) in packet.iter().enumerate() {
                let direction = direction.as_dvec3().normalize();
                let radiance = [0, 1, 2].map(|channel| found.radiance[channel][l]);
                let (expected, pdf) = (map.radiance(direction), map.pdf(direction));
                // Fused operations round otherwise
                assert!((0..3).all(|c| (radiance[c] - expected[c]).abs() <= 1e-6 * expected[c] + 1e-9));
                assert!((found.pdf[l] - pdf).abs() <= 1e-6 * pdf + 1e-9, "{direction}");
            }
        }
    }

    #[test]
    fn sixteen_samples_have_the_bits_of_single_ones() {
        for map in [
            speckled_map(),
            map(1, 1, 0.3, |_, _| [0.5; 3]),
            map(5, 1, 0.0, |x, _| [x as f32, 0.0, 1.0]),
            map(64, 33, 2.0, |x, y| [(x * y % 7) as f32, (x % 3) as f32, 0.25]),
            map(3, 2, 0.0, |_, _| [0.0; 3]),
        ] {
            // Both ends, the steps of the speckled map, and even numbers
            let ends = [0.0, 0.25, 0.5, 0.75, 1.0 - 0.5 * f64::EPSILON];
            let pairs = ends.into_iter().flat_map(|a| ends.map(|b| [a, b]));
            let pairs: Vec<[f64; 2]> = pairs.chain(midpoints(20)).collect();
            for packet in pairs.chunks_exact(LANES) {
                let u: [Lanes<f64>; 2] = [0, 1].map(|axis| std::array::from_fn(|l| packet[l][axis]));
                let found = map.sample_packet(&u);
                for l in 0..LANES {
                    let Some(single) = map.sample(packet[l]) else {
                        assert_eq!(found.pdf[l], 0.0);
                        continue;
                    };
                    let direction = DVec3::from([0, 1, 2].map(|axis| found.direction[axis][l]));
                    let radiance = [0, 1, 2].map(|channel| found.radiance[channel][l]);
                    assert_eq!((direction, radiance), (single.direction, single.radiance));
                    assert_eq!(found.pdf[l], single.pdf, "{:?}", packet[l]);
                }
            }
        }
    }
}
