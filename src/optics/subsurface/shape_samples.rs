//! Points spread evenly over a surface by intersecting it with lines: for analytic shapes of any kind, without
//! triangles.
//!
//! The lines of three square lattices, one along each axis, intersect a surface with the unit normal n in
//! `|n_x| + |n_y| + |n_z|` points per square of their spacing (the Cauchy-Crofton formula, with three directions in place of all). So
//! each point represents the inverse of that area, at any position, and every part of the surface that is wider than
//! the spacing gets a point. Lattices lie in object space, where faces are aligned with them, and fill the box around
//! the shape exactly: a square or a cube gets a square lattice.

use glam::{DAffine3, DVec3};

use super::mesh_samples::SurfaceSample;
use crate::numeric::Bounds;
use crate::parallel;

/// Largest number of lines along one axis of a lattice: more points than are ever requested.
const MAX_LINES: f64 = 65536.0;

/// Returns points where lines intersect a surface within `bounds`, in object space, of which no two neighbours lie
/// farther apart than `spacing` in the world.
///
/// `cross` is called with a line's origin and unit direction and reports each intersection: point, outward unit normal,
/// and part. There are about 1.5 points per square of edge `spacing` on a curved surface. All inputs must be finite,
/// and `spacing` positive. Runs in the current rayon pool; the points are identical for any number of threads.
pub fn lattice_samples(
    bounds: &Bounds,
    world_from_object: &DAffine3,
    spacing: f64,
    cross: impl Fn(DVec3, DVec3, &mut dyn FnMut(DVec3, DVec3, u32)) + Sync,
) -> Vec<SurfaceSample> {
    let lattice = Lattice::new(bounds, world_from_object, spacing);
    let rows = (0..3).flat_map(|axis| (0..lattice.counts[(axis + 1) % 3]).map(move |row| (axis, row)));
    let rows: Vec<(usize, u32)> = rows.collect();
    let in_row = |slot: usize| lattice.row(rows[slot].0, rows[slot].1, &cross);
    parallel::map(rows.len(), &in_row).concat()
}

/// Axis-aligned lines through the bounding box of a shape.
struct Lattice<'a> {
    bounds: &'a Bounds,
    world_from_object: &'a DAffine3,
    /// Number of lines side by side along each axis.
    counts: [u32; 3],
    /// Distance between neighbouring lines along each axis.
    steps: [f64; 3],
    /// Number of lines along each axis that cross a unit of area.
    density: DVec3,
    /// Columns of the matrix that maps an object-space normal to the area vector in the world of a unit of area.
    stretch: [DVec3; 3],
}

impl<'a> Lattice<'a> {
    /// Lays out the lines so that neighbours are at most `spacing` apart in the world.
    fn new(bounds: &'a Bounds, world_from_object: &'a DAffine3, spacing: f64) -> Lattice<'a> {
        let extent = bounds.extent();
        let m = &world_from_object.matrix3;
        let count = |axis: usize| {
            let lines = extent[axis] * m.col(axis).length() / spacing;
            lines.ceil().clamp(1.0, MAX_LINES) as u32
        };
        let counts = [0, 1, 2].map(count);
        let steps = [0, 1, 2].map(|axis| extent[axis] / f64::from(counts[axis]));
        // A flat surface has zero thickness that lines along it could cross.
        let density = |axis: usize| {
            let cell = steps[(axis + 1) % 3] * steps[(axis + 2) % 3];
            if cell > 0.0 { cell.recip() } else { 0.0 }
        };
        Lattice {
            bounds,
            world_from_object,
            counts,
            steps,
            density: DVec3::from([0, 1, 2].map(density)),
            stretch: [0, 1, 2].map(|axis| m.col((axis + 1) % 3).cross(m.col((axis + 2) % 3))),
        }
    }

    /// Returns the points on one row of lines along `axis`.
    fn row(
        &self,
        axis: usize,
        row: u32,
        cross: &impl Fn(DVec3, DVec3, &mut dyn FnMut(DVec3, DVec3, u32)),
    ) -> Vec<SurfaceSample> {
        let mut found = Vec::new();
        if self.density[axis] == 0.0 {
            return found;
        }
        let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
        let middle =
            |axis: usize, line: u32| self.bounds.min[axis] + (f64::from(line) + 0.5) * self.steps[axis];
        let mut origin = DVec3::ZERO;
        // Start well before the box, so that surfaces that touch it are intersected too.
        origin[axis] = self.bounds.min[axis] - self.bounds.extent().max_element();
        origin[j] = middle(j, row);
        for line in 0..self.counts[k] {
            origin[k] = middle(k, line);
            cross(origin, DVec3::AXES[axis], &mut |p, n, part| {
                found.extend(self.sample(p, n, part))
            });
        }
        found
    }

    /// Returns the sample at `p` with the area that it represents; `None` if area or position is not finite.
    fn sample(&self, p: DVec3, n: DVec3, part: u32) -> Option<SurfaceSample> {
        let [x, y, z] = self.stretch;
        let normal = n.x * x + n.y * y + n.z * z;
        let area = normal.length() / self.density.dot(n.abs());
        // Keep the normal outside if the map mirrors.
        let side = x.dot(self.world_from_object.matrix3.x_axis).signum();
        let sample = SurfaceSample {
            position: self.world_from_object.transform_point3(p),
            normal: (side * normal).normalize_or_zero(),
            area,
            triangle: part,
            uv: [0.0; 2],
        };
        (area.is_finite() && sample.position.is_finite()).then_some(sample)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    /// Intersects a line with the unit sphere.
    fn sphere(origin: DVec3, d: DVec3, out: &mut dyn FnMut(DVec3, DVec3, u32)) {
        let b = origin.dot(d);
        let discriminant = b * b - origin.length_squared() + 1.0;
        if discriminant > 0.0 {
            for t in [-b - discriminant.sqrt(), -b + discriminant.sqrt()] {
                let p = (origin + t * d).normalize();
                out(p, p, 0);
            }
        }
    }

    /// Intersects a line with the square [-1, 1]² in z = 0.
    fn square(origin: DVec3, d: DVec3, out: &mut dyn FnMut(DVec3, DVec3, u32)) {
        let p = origin - origin.z / d.z * d;
        if d.z != 0.0 && p.x.abs() <= 1.0 && p.y.abs() <= 1.0 {
            out(p, DVec3::Z, 7);
        }
    }

    const CUBE: Bounds = Bounds {
        min: DVec3::NEG_ONE,
        max: DVec3::ONE,
    };

    #[test]
    fn the_points_of_a_sphere_share_its_area_evenly() {
        let found = lattice_samples(&CUBE, &DAffine3::IDENTITY, 0.05, sphere);
        let total: f64 = found.iter().map(|sample| sample.area).sum();
        // Three times 40² lines: the number of a lattice's points in a disk of radius 20 is accurate to 1 % (Gauss's
        // circle problem).
        assert!((total / (4.0 * PI) - 1.0).abs() <= 0.01, "{total}");
        // Expected number of points: 4 pi 1.5 / 0.05².
        assert!(
            (found.len() as f64 / 7540.0 - 1.0).abs() <= 0.02,
            "{}",
            found.len()
        );
        // Caps around directions along no axis have the area 2 pi (1 - 0.9) each.
        for axis in [DVec3::ONE, DVec3::new(-1.0, 2.0, 0.3), DVec3::new(0.1, -0.2, 1.0)] {
            let axis = axis.normalize();
            let cap: f64 = found
                .iter()
                .filter(|s| s.position.dot(axis) > 0.9)
                .map(|s| s.area)
                .sum();
            // About 380 points, of which a few lie on one side of the edge or the other.
            assert!((cap / (0.2 * PI) - 1.0).abs() <= 0.03, "{axis}: {cap}");
        }
    }

    #[test]
    fn a_turned_and_stretched_square_gets_a_lattice_along_its_edges() {
        let map = DAffine3::from_rotation_x(0.7) * DAffine3::from_scale(DVec3::new(-2.0, 0.5, 3.0));
        let flat_bounds = Bounds {
            min: DVec3::new(-1.0, -1.0, 0.0),
            max: DVec3::new(1.0, 1.0, 0.0),
        };
        let found = lattice_samples(&flat_bounds, &map, 0.1, square);
        // The square is 4 by 1 in steps of 0.1.
        assert_eq!(found.len(), 400);
        for sample in &found {
            assert!((sample.area - 0.01).abs() <= 1e-15 && sample.triangle == 7);
            let n = DAffine3::from_rotation_x(0.7).transform_vector3(DVec3::Z);
            assert!((sample.normal - n).length() <= 1e-15, "{sample:?}");
        }
    }

    #[test]
    fn shape_samples_do_not_depend_on_thread_count() {
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| lattice_samples(&CUBE, &DAffine3::IDENTITY, 0.1, sphere))
        };
        assert_eq!(with(1), with(7));
        assert!(lattice_samples(&CUBE, &DAffine3::IDENTITY, 0.1, |_, _, _| {}).is_empty());
    }
}
