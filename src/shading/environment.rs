//! Environment map: radiance lookup by direction and importance sampling by luminance.
//!
//! The image is equirectangular. Its rows run from +y at the top to -y at the bottom, evenly in the angle from +y; its
//! columns run evenly around +y, with -z in the middle of the image and +x to the right of it, as a camera that looks
//! along -z sees them. Texels are point samples at the centres of their cells. Radiance is interpolated bilinearly
//! between them, also across the seam; beyond the first and last row the texels of that row are used.
//!
//! Directions are sampled with a density in proportion to the luminance of the bilinear image: first a row and then a
//! column of the cells between texel centres, by inverting cumulative sums (M. Pharr, W. Jakob, G. Humphreys,
//! "Physically Based Rendering", 4th ed. 2023, A.4 and A.5), then a position within the cell by inverting its linear
//! densities. The remainder of each random number after the choice of a cell is reused for the position within the
//! cell, so stratified numbers give stratified directions. The density is positive wherever radiance is, and L / pdf is
//! constant within a row of cells except for colour and sin θ.

mod lanes;

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::image::LinearImage;
use crate::numeric::{cumulative, lane_math, warp};

pub use lanes::{EnvironmentLanes, EnvironmentSamples};

/// Equirectangular environment map with sampling tables; they take 12 bytes per texel in addition to the image.
#[derive(Clone, Debug)]
pub struct EnvironmentMap {
    width: usize,
    height: usize,
    texels: Vec<[f32; 3]>,
    /// Sine and cosine of the map's rotation about +y.
    turned: [f64; 2],
    /// Cumulative sums, along each row of cells, of luminance times solid angle (up to a constant factor).
    cumulative_cells: Vec<f64>,
    /// First steps of the searches in `cumulative_cells`: see [`cumulative::guide`].
    cell_guide: Vec<u32>,
    /// Cumulative sums of the totals of the rows of cells.
    cumulative_rows: Vec<f64>,
    /// First steps of the searches in `cumulative_rows`.
    row_guide: Vec<u32>,
    /// Densities per steradian of the rows of cells, per unit of luminance over the sine of the angle from +y.
    row_densities: Vec<f64>,
}

/// Direction sampled from an environment map, with its radiance and density.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvironmentSample {
    /// Unit vector toward the light, in world space.
    pub direction: DVec3,
    /// Radiance from that direction, linear RGB.
    pub radiance: [f32; 3],
    /// Density of the direction per steradian; positive and finite.
    pub pdf: f64,
}

/// Reason why an image cannot be used as an environment map, worded as advice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EnvironmentError {
    /// Pixel count that is zero or differs from width times height.
    #[error(
        "the environment map of {width}x{height} has {pixels} pixels: give width times height pixels, at least one"
    )]
    Size {
        /// Width of the image in pixels.
        width: u32,
        /// Height of the image in pixels.
        height: u32,
        /// Number of pixels that were given.
        pixels: usize,
    },
    /// Pixel of the image that is infinite or NaN.
    #[error("the environment map's pixel in column {x}, row {y} is not finite: repair the image")]
    NotFinite {
        /// Column of the bad pixel, counted from the left.
        x: u32,
        /// Row of the bad pixel, counted from the top.
        y: u32,
    },
    /// Rotation angle that is infinite or NaN.
    #[error("the environment map's rotation is not finite: give an angle in radians")]
    Rotation,
}

/// Weights of linear red, green and blue in luminance, by ITU-R BT.709.
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Position in the image: a cell between four texel centres, and fractions within it.
#[derive(Clone, Copy, Debug)]
struct ImagePosition {
    /// Column of the cell, counted from 0 at the first texel's centre; the last column lies across the seam.
    column: usize,
    /// Row of the cell, counted from 0 above the centres of the first texels to `height` below those of the last ones.
    row: usize,
    /// Fractions of the cell to the left of the position and above it.
    fraction: [f64; 2],
}

impl EnvironmentMap {
    /// Returns the bytes that the image and its sampling tables take.
    pub fn byte_count(&self) -> usize {
        size_of_val(&self.texels[..])
            + size_of_val(&self.cumulative_cells[..])
            + size_of_val(&self.cell_guide[..])
            + size_of_val(&self.cumulative_rows[..])
            + size_of_val(&self.row_guide[..])
            + size_of_val(&self.row_densities[..])
    }

    /// Creates the map of `image`, in linear RGB radiance, rotated by `rotation` radians about +y, counter-clockwise as
    /// seen from above. Negative values, which reconstruction filters leave in images, count as 0.
    pub fn new(image: LinearImage, rotation: f64) -> Result<EnvironmentMap, EnvironmentError> {
        let LinearImage {
            width,
            height,
            mut pixels,
        } = image;
        // Validate size, rotation and pixels
        if pixels.is_empty() || pixels.len() as u64 != u64::from(width) * u64::from(height) {
            let pixels = pixels.len();
            return Err(EnvironmentError::Size {
                width,
                height,
                pixels,
            });
        }
        if !rotation.is_finite() {
            return Err(EnvironmentError::Rotation);
        }
        if let Some(bad) = pixels.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
            let (x, y) = (bad % width as usize, bad / width as usize);
            return Err(EnvironmentError::NotFinite {
                x: x as u32,
                y: y as u32,
            });
        }
        // Clamp negative radiance
        for pixel in &mut pixels {
            *pixel = pixel.map(|c| c.max(0.0));
        }
        // Build the sampling tables
        let mut map = EnvironmentMap {
            width: width as usize,
            height: height as usize,
            texels: pixels,
            turned: [rotation.sin(), rotation.cos()],
            cumulative_cells: Vec::new(),
            cell_guide: Vec::new(),
            cumulative_rows: Vec::new(),
            row_guide: Vec::new(),
            row_densities: Vec::new(),
        };
        map.build_tables();
        Ok(map)
    }

    /// Builds the cumulative sums over cells and rows that sampling inverts, and the densities of the rows.
    fn build_tables(&mut self) {
        let mut cumulative_cells = Vec::with_capacity(self.width * (self.height + 1));
        let mut cumulative_rows = Vec::with_capacity(self.height + 1);
        let mut total = 0.0;
        // Accumulate luminance times solid angle, cell by cell and row by row
        for row in 0..=self.height {
            let weight = self.row_weight(row);
            let mut sum = 0.0;
            for column in 0..self.width {
                sum += weight * self.corners(column, row).into_iter().sum::<f64>();
                cumulative_cells.push(sum);
            }
            total += sum;
            cumulative_rows.push(total);
        }
        self.cell_guide = Vec::with_capacity(cumulative_cells.len());
        for row in cumulative_cells.chunks_exact(self.width) {
            cumulative::guide(row, &mut self.cell_guide);
        }
        cumulative::guide(&cumulative_rows, &mut self.row_guide);
        (self.cumulative_cells, self.cumulative_rows) = (cumulative_cells, cumulative_rows);
        // Divide the density of each row over the unit square of its cells, weight · L / (total / 4), by Δφ Δθ
        let density = |row: usize| {
            let [above, below] = self.row_angles(row as f64);
            4.0 * self.row_weight(row) / (total * (TAU / self.width as f64 * (below - above)))
        };
        self.row_densities = (0..=self.height).map(density).collect();
    }

    /// Returns the radiance from `direction`, a unit vector in world space.
    #[inline]
    pub fn radiance(&self, direction: DVec3) -> [f32; 3] {
        self.radiance_at(self.image_position(direction))
    }

    /// Samples a direction with the random numbers `u` in [0, 1)². Returns `None` if the map is black, and exactly at a
    /// pole.
    #[inline]
    pub fn sample(&self, u: [f64; 2]) -> Option<EnvironmentSample> {
        let total = self.total();
        if !(total > 0.0) {
            return None;
        }
        // Sample a row of cells, then a cell within the row
        let (row, down) = self.sample_row(u[1]);
        let (column, across) = self.sample_column(row, u[0]);
        // Sample the position within the cell by its bilinear luminance
        let [a, b, c, d] = self.corners(column, row);
        let t = warp::linear(a + b, c + d, down);
        let s = warp::linear(a + t * (c - a), b + t * (d - b), across);
        let image_position = ImagePosition {
            column,
            row,
            fraction: [s, t],
        };
        // Convert the position into a direction, and the density into solid angle
        let (direction, sin) = self.direction(image_position);
        let radiance = self.radiance_at(image_position);
        let pdf = self.pdf_at(row, sin, radiance);
        (pdf > 0.0 && pdf < f64::INFINITY).then_some(EnvironmentSample {
            direction,
            radiance,
            pdf,
        })
    }

    /// Returns the density per steradian with which [`EnvironmentMap::sample`] samples the unit vector `direction`; 0
    /// where the radiance is 0 and exactly at a pole.
    #[inline]
    pub fn pdf(&self, direction: DVec3) -> f64 {
        let image_position = self.image_position(direction);
        let sin = (direction.x * direction.x + direction.z * direction.z).sqrt();
        let pdf = self.pdf_at(image_position.row, sin, self.radiance_at(image_position));
        if pdf < f64::INFINITY { pdf } else { 0.0 }
    }

    /// Samples a row of cells, and the position within the row's share of the random number.
    #[inline(always)]
    fn sample_row(&self, u: f64) -> (usize, f64) {
        cumulative::invert(&self.cumulative_rows, &self.row_guide, u)
    }

    /// Samples a cell of a row like [`EnvironmentMap::sample_row`].
    #[inline(always)]
    fn sample_column(&self, row: usize, u: f64) -> (usize, f64) {
        let cells = row * self.width..(row + 1) * self.width;
        cumulative::invert(&self.cumulative_cells[cells.clone()], &self.cell_guide[cells], u)
    }

    /// Returns four times the sum over all cells of mean luminance times [`EnvironmentMap::row_weight`].
    #[inline(always)]
    fn total(&self) -> f64 {
        self.cumulative_rows[self.height]
    }

    /// Returns the density per steradian of a position in cell row `row` with the given radiance and sine of the angle
    /// from +y: a unit of the unit square of a cell is Δφ Δθ sin θ steradian.
    #[inline(always)]
    fn pdf_at(&self, row: usize, sin: f64, radiance: [f32; 3]) -> f64 {
        let radiance_luminance = luminance(radiance);
        if radiance_luminance > 0.0 {
            self.row_densities[row] * radiance_luminance / sin
        } else {
            0.0
        }
    }

    /// Returns the two angles from +y between which a row of cells lies.
    #[inline(always)]
    fn row_angles(&self, row: f64) -> [f64; 2] {
        let angle = |middle: f64| PI * (middle / self.height as f64).clamp(0.0, 1.0);
        [angle(row - 0.5), angle(row + 0.5)]
    }

    /// Returns the solid angle of a row of cells divided by 2π: a difference of cosines, computed as a product.
    #[inline(always)]
    fn row_weight(&self, row: usize) -> f64 {
        let [above, below] = self.row_angles(row as f64);
        2.0 * (0.5 * (above + below)).sin() * (0.5 * (below - above)).sin()
    }

    /// Returns the indices of a cell's four texels: left and right above, left and right below.
    #[inline(always)]
    fn corner_indices(&self, column: usize, row: usize) -> [usize; 4] {
        let right = if column + 1 == self.width { 0 } else { column + 1 };
        let above = row.saturating_sub(1) * self.width;
        let below = row.min(self.height - 1) * self.width;
        [above + column, above + right, below + column, below + right]
    }

    /// Returns the luminances of a cell's four texels, in the order of [`EnvironmentMap::corner_indices`].
    #[inline(always)]
    fn corners(&self, column: usize, row: usize) -> [f64; 4] {
        self.corner_indices(column, row)
            .map(|index| luminance(self.texels[index]))
    }

    /// Returns the bilinearly interpolated radiance at a position in the image.
    #[inline(always)]
    fn radiance_at(&self, image_position: ImagePosition) -> [f32; 3] {
        let [a, b, c, d] = self
            .corner_indices(image_position.column, image_position.row)
            .map(|index| self.texels[index]);
        let [s, t] = image_position.fraction;
        std::array::from_fn(|channel| bilinear([a, b, c, d].map(|texel| texel[channel]), [s, t]))
    }

    /// Returns the position in the image that a unit vector in world space points to.
    #[inline(always)]
    fn image_position(&self, direction: DVec3) -> ImagePosition {
        self.position_at(self.cell_coordinates(direction.to_array()))
    }

    /// Returns the coordinates of a unit vector in world space in cells: from the centre of the first column, and from half
    /// a row above the image. Columns before the first centre belong to the last cell, across the seam.
    #[inline(always)]
    fn cell_coordinates(&self, [x, y, z]: [f64; 3]) -> [f64; 2] {
        // Rotate the direction into the map's frame
        let [sin, cos] = self.turned;
        let (x, z) = (cos * x - sin * z, sin * x + cos * z);
        // Scale the angles around +y and from it
        let (width, height) = (self.width as f64, self.height as f64);
        let across = (0.5 + lane_math::atan2(x, -z) / TAU) * width - 0.5;
        let across = if across < 0.0 { across + width } else { across };
        let angle = lane_math::atan2((x * x + z * z).sqrt(), y);
        [across, angle / PI * height + 0.5]
    }

    /// Returns the cell at these coordinates and the position within it. In the first and the last row, which are half as
    /// high, the fraction of the height is of a whole cell: both their texels above and below are the same.
    #[inline(always)]
    fn position_at(&self, [across, down]: [f64; 2]) -> ImagePosition {
        // Rounding may carry a coordinate to the end
        let column = (across as usize).min(self.width - 1);
        let row = (down as usize).min(self.height);
        let fraction = [across - column as f64, down - row as f64];
        ImagePosition {
            column,
            row,
            fraction: fraction.map(|fraction| fraction.clamp(0.0, 1.0)),
        }
    }

    /// Returns the unit vector toward a position in the image, and the sine of its angle from +y.
    #[inline(always)]
    fn direction(&self, position: ImagePosition) -> (DVec3, f64) {
        let (direction, sine) =
            self.direction_at([position.column as f64, position.row as f64], position.fraction);
        (direction.into(), sine)
    }

    /// Returns the unit vector toward a position in a cell, and the sine of its angle from +y.
    #[inline(always)]
    fn direction_at(&self, [column, row]: [f64; 2], fraction: [f64; 2]) -> ([f64; 3], f64) {
        let [above, below] = self.row_angles(row);
        let [sin_angle, cos_angle] = lane_math::sin_cos(above + fraction[1] * (below - above));
        let across = (column + 0.5 + fraction[0]) / self.width as f64;
        let [sin_turn, cos_turn] = lane_math::sin_cos(TAU * (across - 0.5));
        let (x, z) = (sin_angle * sin_turn, -sin_angle * cos_turn);
        let [sin, cos] = self.turned;
        ([cos * x + sin * z, cos_angle, cos * z - sin * x], sin_angle)
    }
}

/// Interpolates between four texels: left and right above, left and right below.
#[inline(always)]
fn bilinear(texels: [f32; 4], [s, t]: [f64; 2]) -> f32 {
    let [a, b, c, d] = texels.map(f64::from);
    ((1.0 - t) * ((1.0 - s) * a + s * b) + t * ((1.0 - s) * c + s * d)) as f32
}

/// Returns the luminance of a linear RGB colour.
#[inline(always)]
fn luminance(color: [f32; 3]) -> f64 {
    (0..3)
        .map(|channel| LUMINANCE[channel] * f64::from(color[channel]))
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn map(
        width: u32,
        height: u32,
        rotation: f64,
        texel: impl Fn(u32, u32) -> [f32; 3],
    ) -> EnvironmentMap {
        let pixels = (0..width * height).map(|i| texel(i % width, i / width)).collect();
        EnvironmentMap::new(
            LinearImage {
                width,
                height,
                pixels,
            },
            rotation,
        )
        .unwrap()
    }

    /// Returns a test map that is black except for some texels, one of them at the seam and one at each pole.
    pub(super) fn speckled_map() -> EnvironmentMap {
        map(12, 7, 0.7, |x, y| match (x, y) {
            (0, 3) => [5.0, 0.0, 0.0],
            (11, 2) | (4, 0) => [0.0, 0.1, 2.0],
            (7, 6) => [1.0; 3],
            (5, 4) => [100.0, 90.0, 80.0],
            _ => [0.0; 3],
        })
    }

    pub(super) fn midpoints(cells: u32) -> impl Iterator<Item = [f64; 2]> {
        let middle = move |i: u32| (f64::from(i) + 0.5) / f64::from(cells);
        (0..cells * cells).map(move |i| [middle(i % cells), middle(i / cells)])
    }

    /// Integrates `value` over all directions by the midpoint rule in both angles, with `cells` by `cells` cells.
    fn integral(cells: u32, value: impl Fn(DVec3) -> f64) -> f64 {
        let steradian = PI * TAU / f64::from(cells * cells);
        midpoints(cells)
            .map(|[a, b]| {
                let ((sin, cos), (sin_turn, cos_turn)) = ((PI * b).sin_cos(), (TAU * a).sin_cos());
                value(DVec3::new(sin * cos_turn, cos, sin * sin_turn)) * sin * steradian
            })
            .sum()
    }

    #[test]
    fn environment_axes_follow_the_convention() {
        let sides = map(4, 2, 0.0, |x, y| [x as f32, y as f32, 0.0]);
        // Columns 0 to 3 have their centres at 1/8, 3/8, 5/8 and 7/8 of the width: -z is at 1/2, half-way between
        // columns 1 and 2, and +x at 3/4.
        let close = |d: DVec3, r: f32| assert!((sides.radiance(d)[0] - r).abs() < 1e-6, "{d}");
        close(DVec3::NEG_Z, 1.5);
        close(DVec3::X, 2.5);
        close(DVec3::NEG_X, 0.5);
        // Seam at +z: half-way from column 3 back to column 0.
        close(DVec3::Z, 1.5);
        assert_eq!(
            (sides.radiance(DVec3::Y)[1], sides.radiance(DVec3::NEG_Y)[1]),
            (0.0, 1.0)
        );
    }

    #[test]
    fn rotation_turns_the_environment_to_the_left() {
        let (plain, turned) = (
            speckled_map(),
            map(12, 7, 0.0, |x, y| speckled_map().texels[(y * 12 + x) as usize]),
        );
        for [a, b] in midpoints(20) {
            let d = warp::direction(2.0 * a, b);
            let rotated = glam::DQuat::from_rotation_y(0.7) * d;
            let (there, here) = (plain.radiance(rotated), turned.radiance(d));
            assert!((0..3).all(|c| (there[c] - here[c]).abs() < 1e-4), "{d}");
        }
    }

    #[test]
    fn the_density_integrates_to_one() {
        for map in [
            speckled_map(),
            map(1, 1, 0.0, |_, _| [2.0; 3]),
            map(5, 1, 1.0, |x, _| [x as f32; 3]),
        ] {
            let found = integral(2000, |d| map.pdf(d));
            // Kinks at cell borders: the midpoint rule is off by the square of (cells of the map / cells), and by a
            // cell in θ where the density jumps from row to row.
            assert!((found - 1.0).abs() < 1e-3, "{found}");
        }
    }

    #[test]
    fn every_sample_has_the_radiance_and_density_of_its_direction() {
        let map = speckled_map();
        let mut count = 0;
        for u in midpoints(100) {
            let sample = map.sample(u).unwrap();
            assert!((sample.direction.length() - 1.0).abs() < 4.0 * f64::EPSILON);
            let radiance = map.radiance(sample.direction);
            // A direction determines its position in the image to about 2^-50 of a cell, and colours change by 100
            // within one.
            assert!((0..3).all(|c| (radiance[c] - sample.radiance[c]).abs() <= 1e-6 * radiance[c] + 1e-9));
            let pdf = map.pdf(sample.direction);
            count += u32::from((pdf / sample.pdf - 1.0).abs() > 1e-6);
        }
        assert_eq!(count, 0);
    }

    #[test]
    fn sampled_moments_equal_those_of_the_environment() {
        let map = speckled_map();
        let exact =
            |value: &dyn Fn(DVec3) -> f64| integral(1600, |d| f64::from(map.radiance(d)[2]) * value(d));
        // Roberts' R2 sequence: a number that selects a row would, on a regular grid, be off by a whole row of points.
        let count = 500_000;
        let point = |i: u32| {
            [0.754_877_666_246_692_7, 0.569_840_290_998_053_2].map(|step| (f64::from(i) * step).fract())
        };
        let sampled_mean = |value: &dyn Fn(DVec3) -> f64| {
            let sum: f64 = (0..count)
                .filter_map(|i| map.sample(point(i)))
                .map(|s| f64::from(s.radiance[2]) * value(s.direction) / s.pdf)
                .sum();
            sum / f64::from(count)
        };
        let all = exact(&|_| 1.0);
        let values: [&dyn Fn(DVec3) -> f64; 4] = [&|_| 1.0, &|d| d.x, &|d| d.y, &|d| d.z];
        for (index, value) in values.into_iter().enumerate() {
            let (exact, found) = (exact(value), sampled_mean(value));
            assert!(
                (found - exact).abs() < 1e-3 * all,
                "{index}: {found}, not {exact}"
            );
        }
    }

    #[test]
    fn uniform_map_is_sampled_uniformly() {
        let map = map(64, 32, 0.3, |_, _| [1.0, 2.0, 3.0]);
        for u in midpoints(32) {
            let sample = map.sample(u).unwrap();
            // Within a row of cells sin θ varies by half a cell's cotangent; the outermost rows reach the pole.
            let sin = sample.direction.x.hypot(sample.direction.z);
            let bound = 0.5 * PI / 32.0 / sin * 1.1;
            assert!(
                (sample.pdf * 4.0 * PI - 1.0).abs() < bound + 0.01,
                "{u:?} {}",
                sample.pdf * 4.0 * PI
            );
            assert_eq!(sample.radiance, [1.0, 2.0, 3.0]);
        }
    }

    #[test]
    fn black_map_gives_no_samples_and_single_texel_gets_all() {
        let black = map(8, 4, 0.0, |_, _| [0.0, -3.0, 0.0]);
        assert!(black.sample([0.5; 2]).is_none());
        assert_eq!((black.pdf(DVec3::X), black.radiance(DVec3::X)), (0.0, [0.0; 3]));
        for value in [1e-45, 1.0, f32::MAX] {
            let bright_texel_map = map(
                64,
                32,
                0.0,
                |x, y| if (x, y) == (48, 8) { [value; 3] } else { [0.0; 3] },
            );
            // Centre of the bright texel: column 48.5 of 64, row 8.5 of 32.
            let (turn, angle) = (TAU * (48.5 / 64.0 - 0.5), PI * 8.5 / 32.0);
            let toward = DVec3::new(angle.sin() * turn.sin(), angle.cos(), -angle.sin() * turn.cos());
            for u in midpoints(16).chain([[0.0, 0.0], [1.0 - f64::EPSILON / 2.0; 2]]) {
                // The bilinear tent reaches to the neighbouring texel centres: 2π/64 around and π/32 down; it is zero
                // at its border.
                let Some(sample) = bright_texel_map.sample(u) else {
                    continue;
                };
                assert!(sample.direction.dot(toward) > (0.15f64).cos(), "{value}: {u:?}");
                assert!(sample.pdf.is_finite() && sample.pdf > 0.0);
            }
        }
    }

    #[test]
    fn invalid_maps_are_rejected_with_the_position_of_the_fault() {
        let image = |width, height, pixels: Vec<[f32; 3]>| LinearImage {
            width,
            height,
            pixels,
        };
        let error = |image, rotation| EnvironmentMap::new(image, rotation).unwrap_err();
        // Pixels missing
        assert_eq!(
            error(image(0, 0, vec![]), 0.0),
            EnvironmentError::Size {
                width: 0,
                height: 0,
                pixels: 0
            }
        );
        let short = image(u32::MAX, u32::MAX, vec![[0.0; 3]]);
        assert!(matches!(
            error(short, 0.0),
            EnvironmentError::Size { pixels: 1, .. }
        ));
        // Pixels that are not finite
        for bad in [f32::NAN, f32::INFINITY] {
            let mut pixels = vec![[0.0; 3]; 12];
            pixels[7][1] = bad;
            assert_eq!(
                error(image(4, 3, pixels), 0.0),
                EnvironmentError::NotFinite { x: 3, y: 1 }
            );
        }
        // Rotation that is not finite
        assert_eq!(
            error(image(1, 1, vec![[1.0; 3]]), f64::NAN),
            EnvironmentError::Rotation
        );
    }
}
