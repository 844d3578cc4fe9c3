//! Points spread evenly over a triangle mesh.
//!
//! The surface is divided into as many pieces of equal area as there are points, along the Morton curve through its
//! triangles, and each piece has its point in the triangle that contains the middle of the piece. Triangles much
//! smaller than a piece thus share points with their neighbours; a much larger one gets the first points of a lattice
//! over it (Roberts' R2 sequence), started at its centroid. Points depend on the triangles only, not on the number of
//! threads.
//!
//! For uniform light and the dipole of white marble, points [`Dipole::sample_spacing`](super::Dipole::sample_spacing)
//! apart cause noise of 0.7 % (root mean square) where triangles are large and of 1.8 % where they are small.

use glam::DVec3;

use crate::numeric::morton::sorted_keys;
use crate::parallel;

/// Largest number of points on one surface: about 400 megabytes with their irradiance and their octree.
pub const MAX_SAMPLES: usize = 1 << 21;

/// Number of triangles per task of a thread.
const CHUNK: usize = 1 << 12;

/// Point that represents a piece of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceSample {
    /// Position of the point on the surface.
    pub position: DVec3,
    /// Unit normal of its triangle, on the side from which the corners are counter-clockwise.
    pub normal: DVec3,
    /// Area of the piece that the point represents.
    pub area: f64,
    /// Index of the triangle that it lies on, or of the part of a shape.
    pub triangle: u32,
    /// Barycentric weights of the triangle's second and third corner.
    pub uv: [f64; 2],
}

/// Points spread over a surface, with their spacing.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceSamples {
    /// Points that all represent equal areas; empty if the surface has no area.
    pub samples: Vec<SurfaceSample>,
    /// Edge of a square of that area; larger than requested if that would have taken more than [`MAX_SAMPLES`].
    pub spacing: f64,
}

/// Returns points on the triangles `corners(0..triangle_count)`, one per square of edge `spacing` (positive).
///
/// Pass [`Dipole::sample_spacing`](super::Dipole::sample_spacing) as `spacing`, and afterwards evaluate the dipole that
/// [`Dipole::widened_for_spacing`](super::Dipole::widened_for_spacing) returns for the resulting spacing. There are at most
/// [`MAX_SAMPLES`] points; on a surface that would take more they are farther apart. Triangles without a finite area
/// get none. There must be fewer than 2^32 triangles. For shapes that can be intersected with lines use
/// [`lattice_samples`](super::lattice_samples).
pub fn surface_samples(
    triangle_count: usize,
    corners: impl Fn(usize) -> [DVec3; 3] + Sync,
    spacing: f64,
) -> SurfaceSamples {
    // Sort the triangles along the Morton curve
    let order = morton_order(triangle_count, &corners);
    // Accumulate areas: the end of each triangle along the curve, measured by area.
    let mut ends = parallel::generate(triangle_count, |slot| area(corners(order[slot] as usize)));
    let mut total = 0.0;
    for end in &mut ends {
        total += *end;
        *end = total;
    }
    if total == 0.0 {
        return SurfaceSamples {
            samples: Vec::new(),
            spacing,
        };
    }
    // Divide the surface into pieces of equal area
    let count = (total / (spacing * spacing))
        .round()
        .clamp(1.0, MAX_SAMPLES as f64);
    let piece = total / count;
    // Number of pieces whose middles come before a position along the curve.
    let before = |end: f64| (end / piece - 0.5).ceil().clamp(0.0, count) as usize;
    let on_triangle = |slot: usize| {
        let first = if slot == 0 { 0 } else { before(ends[slot - 1]) };
        let triangle = order[slot];
        let points = points(corners(triangle as usize), before(ends[slot]) - first);
        points.map(move |(position, normal, uv)| SurfaceSample {
            position,
            normal,
            area: piece,
            triangle,
            uv,
        })
    };
    // Place the points of each triangle, in parallel chunks
    let in_chunk = |chunk: usize| -> Vec<SurfaceSample> {
        let first = chunk * CHUNK;
        (first..triangle_count.min(first + CHUNK))
            .flat_map(on_triangle)
            .collect()
    };
    SurfaceSamples {
        samples: parallel::map(triangle_count.div_ceil(CHUNK), &in_chunk).concat(),
        spacing: piece.sqrt(),
    }
}

/// Returns the triangles in the order of their centroids along the Morton curve.
fn morton_order(triangle_count: usize, corners: &(impl Fn(usize) -> [DVec3; 3] + Sync)) -> Vec<u32> {
    let centroid = |t: usize| {
        let [a, b, c] = corners(t);
        let middle = (a + b + c) / 3.0;
        if middle.is_finite() { middle } else { DVec3::ZERO }
    };
    let (_, keys) = sorted_keys(triangle_count, centroid);
    keys.into_iter().map(|key| key.1).collect()
}

/// Returns the area of a triangle; 0 if it is not finite.
fn area([a, b, c]: [DVec3; 3]) -> f64 {
    let area = 0.5 * (b - a).cross(c - a).length();
    if area.is_finite() { area } else { 0.0 }
}

/// Returns `count` points of a triangle, each with its normal and its barycentric weights of the second and third
/// corner.
fn points([a, b, c]: [DVec3; 3], count: usize) -> impl Iterator<Item = (DVec3, DVec3, [f64; 2])> {
    /// Steps of the two-dimensional analogue of the golden ratio (M. Roberts 2018).
    const STEP: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];
    let normal = (b - a).cross(c - a).normalize_or_zero();
    (0u32..)
        .map(|k| STEP.map(|step| (1.0 / 3.0 + f64::from(k) * step).fract()))
        // The lattice fills a parallelogram; keep the half that is the triangle.
        .filter(|[u, v]| u + v < 1.0)
        .take(count)
        .map(move |[u, v]| (a + u * (b - a) + v * (c - a), normal, [u, v]))
}

#[cfg(test)]
mod tests {
    use super::super::{Dipole, Scattering};
    use super::*;

    /// Returns a square of edge 2 `half` around the origin in z = 0, of 2 `cells`² triangles.
    fn square(half: f64, cells: usize) -> (usize, impl Fn(usize) -> [DVec3; 3] + Sync) {
        let corner = move |i: usize, j: usize| {
            let at = |k: usize| half * (2.0 * k as f64 / cells as f64 - 1.0);
            DVec3::new(at(i), at(j), 0.0)
        };
        let corners = move |t: usize| {
            let (i, j) = (t / 2 % cells, t / 2 / cells);
            if t.is_multiple_of(2) {
                [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1)]
            } else {
                [corner(i, j), corner(i + 1, j + 1), corner(i, j + 1)]
            }
        };
        (2 * cells * cells, corners)
    }

    #[test]
    fn points_lie_on_their_triangles_and_share_the_surfaces_area() {
        for cells in [1, 7, 100] {
            let (count, corners) = square(3.0, cells);
            let found = surface_samples(count, &corners, 0.1);
            assert_eq!(found.samples.len(), 3600);
            assert!((found.spacing - 0.1).abs() <= 1e-12);
            let total: f64 = found.samples.iter().map(|sample| sample.area).sum();
            assert!((total - 36.0).abs() <= 1e-11);
            for sample in &found.samples {
                let [a, b, c] = corners(sample.triangle as usize);
                let p = sample.position;
                let twice = (b - a).cross(c - a).z;
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    assert!((to - from).cross(p - from).z >= -1e-12 * twice, "{sample:?}");
                }
                assert!((sample.normal - DVec3::Z).length() <= 2.0 * f64::EPSILON);
            }
        }
    }

    #[test]
    fn samples_are_uniform_for_any_tessellation() {
        for cells in [1, 7, 100, 211] {
            let (count, corners) = square(3.0, cells);
            let found = surface_samples(count, corners, 0.1);
            let mut counts = [0i32; 36];
            for sample in &found.samples {
                let cell = |x: f64| ((x + 3.0) as usize).min(5);
                counts[cell(sample.position.x) + 6 * cell(sample.position.y)] += 1;
            }
            // Each of the 36 cells should have 100 points; random ones would scatter by 10, and one of the 36 by 25.
            assert!(
                counts.iter().all(|count| (count - 100).abs() <= 12),
                "{cells}: {counts:?}"
            );
        }
    }

    #[test]
    fn the_points_are_the_same_for_any_number_of_threads() {
        let (count, corners) = square(3.0, 33);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| surface_samples(count, &corners, 0.05))
        };
        assert_eq!(with(1), with(5));
    }

    #[test]
    fn large_surface_gets_wider_sample_spacing() {
        let (count, corners) = square(1.0, 1);
        let found = surface_samples(count, corners, 1e-4);
        assert_eq!(found.samples.len(), MAX_SAMPLES);
        assert!((found.spacing - (4.0 / MAX_SAMPLES as f64).sqrt()).abs() <= 1e-15);
        let medium = Scattering::from_reflectance([0.8; 3], [1e-5; 3], 1.3).unwrap();
        let dipole = Dipole::new(&medium).unwrap().widened_for_spacing(found.spacing);
        assert!((dipole.sample_spacing() / found.spacing - 1.0).abs() <= 1e-12);
    }

    #[test]
    fn triangles_without_an_area_get_no_point() {
        let bad = [
            [DVec3::ZERO; 3],
            [DVec3::NAN; 3],
            [DVec3::INFINITY, DVec3::X, DVec3::Y],
            [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X],
        ];
        assert_eq!(surface_samples(4, |t| bad[t], 0.1).samples, []);
        assert_eq!(surface_samples(0, |_| bad[0], 0.1).samples, []);
        let good = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let mixed = |t: usize| if t == 4 { good } else { bad[t] };
        let found = surface_samples(5, mixed, f64::INFINITY);
        assert_eq!(found.samples.len(), 1);
        assert_eq!(found.samples[0].triangle, 4);
        assert_eq!(found.samples[0].area, 0.5);
        assert!((found.samples[0].position - DVec3::new(1.0, 1.0, 0.0) / 3.0).length() < 1e-15);
    }
}
