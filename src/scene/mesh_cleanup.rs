//! Mesh scan and clean-up: one parallel pass checks that indices are in range, counts triangles that cannot be hit and
//! computes the bounds; a second function removes those triangles.
//!
//! A triangle has no area exactly when the cross product of two of its edges vanishes. From f32 corners that product is
//! formed in f64, where differences and products of f32 values of like size are exact, so the test needs no tolerance:
//! needles are kept, lines and points are removed.

use std::fmt;

use glam::{DVec3, Vec3};
use multiversion::multiversion;

use crate::buffer::Buffer;
use crate::mesh::Mesh;
use crate::numeric::{Bounds, LANES, Lanes, Lanes3};
use crate::parallel;

/// Triangles per task: enough to hide the cost of a task, few enough to balance.
const CHUNK: usize = 1 << 14;

/// Result of one pass over a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MeshScan {
    /// Box around the corners of all usable triangles.
    pub(crate) bounds: Bounds,
    /// Number of triangles without area or with a corner that is not finite.
    pub(crate) unusable: usize,
}

/// A triangle that refers to a vertex the mesh does not have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BadIndex {
    pub(crate) triangle: usize,
    pub(crate) vertex: u32,
}

/// Numbers of removed triangles, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Removed {
    pub(crate) not_finite: usize,
    pub(crate) no_area: usize,
}

/// The end of a sentence whose subject is the mesh.
impl fmt::Display for Removed {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let count = |n: usize, of: &str| {
            let s = if n == 1 { "" } else { "s" };
            (n > 0).then(|| format!("{n} triangle{s} {of}"))
        };
        let parts = [
            count(self.no_area, "without an area"),
            count(self.not_finite, "with vertices that are not finite"),
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        write!(f, "had {}: dropped", parts.join(" and "))
    }
}

/// Scans every triangle once, in parallel. Returns the bounds of the usable triangles and the number of the others.
pub(crate) fn scan(mesh: &Mesh) -> Result<MeshScan, BadIndex> {
    let (positions, triangles) = (&mesh.positions[..], &mesh.triangles[..]);
    // Scan chunks in parallel
    let chunks = parallel::map_chunks(triangles, CHUNK, &|chunk, triangles| {
        scan_chunk(positions, triangles, chunk * CHUNK)
    });
    let nothing = MeshScan {
        bounds: Bounds::EMPTY,
        unusable: 0,
    };
    // In the order of the file, so that the error names the first bad index.
    chunks.into_iter().try_fold(nothing, |sum, chunk| {
        let chunk = chunk?;
        Ok(MeshScan {
            bounds: sum.bounds.union(chunk.bounds),
            unusable: sum.unusable + chunk.unusable,
        })
    })
}

/// Returns whether all values are finite.
pub(crate) fn all_finite(values: &[f32]) -> bool {
    const VALUES: usize = 1 << 16;
    // A product with zero is zero for finite values and NaN for others; unlike a chain of tests it vectorises.
    let is_finite = |chunk: &[f32]| chunk.iter().fold(true, |finite, x| finite & (x * 0.0 == 0.0));
    let chunks: Vec<&[f32]> = values.chunks(VALUES).collect();
    parallel::all(chunks.len(), &|i| is_finite(chunks[i]))
}

/// Removes the triangles that cannot be hit, and returns their numbers by reason. Vertices stay.
pub(crate) fn drop_unusable(mesh: &mut Mesh) -> Removed {
    let (positions, triangles) = (&mesh.positions[..], &mesh.triangles[..]);
    let corners = |triangle: [u32; 3]| triangle.map(|v| Vec3::from(positions[v as usize]));
    // Find them in parallel
    let unusable = parallel::map_chunks(triangles, CHUNK, &|chunk, triangles| {
        let numbered = (chunk * CHUNK..).zip(triangles);
        let unusable = numbered.filter(|&(_, &triangle)| !is_usable(corners(triangle)));
        unusable.map(|(index, _)| index).collect::<Vec<usize>>()
    });
    // Copy what is between them
    let mut dropped = Removed::default();
    let mut kept = Vec::with_capacity(triangles.len());
    let mut start = 0;
    for index in unusable.into_iter().flatten() {
        kept.extend_from_slice(&triangles[start..index]);
        start = index + 1;
        match corners(triangles[index]).iter().all(|p| p.is_finite()) {
            true => dropped.no_area += 1,
            false => dropped.not_finite += 1,
        }
    }
    kept.extend_from_slice(&triangles[start..]);
    mesh.triangles = Buffer::from(kept);
    dropped
}

/// Sets vertices that are not finite to zero. Only valid once no triangle uses them.
pub(crate) fn clear_non_finite_positions(mesh: &mut Mesh) {
    if all_finite(bytemuck::cast_slice(&mesh.positions)) {
        return;
    }
    let clear = |p: &[f32; 3]| if Vec3::from(*p).is_finite() { *p } else { [0.0; 3] };
    mesh.positions = Buffer::from(mesh.positions.iter().map(clear).collect::<Vec<_>>());
}

/// Corners of sixteen triangles: by corner, axis and lane.
type CornerLanes = [Lanes3<f32>; 3];

/// Bounds of the corners of each lane.
struct LaneBounds {
    low: Lanes3<f32>,
    high: Lanes3<f32>,
}

/// Scans some triangles, sixteen at a time; `first` is the index of the first.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn scan_chunk(positions: &[[f32; 3]], triangles: &[[u32; 3]], first: usize) -> Result<MeshScan, BadIndex> {
    let mut bounds = LaneBounds {
        low: [[f32::INFINITY; LANES]; 3],
        high: [[f32::NEG_INFINITY; LANES]; 3],
    };
    let mut unusable = 0;
    // Lanes without a triangle keep corners in one point
    let mut corners = [[[0.0; LANES]; 3]; 3];
    for (packet, triangles) in triangles.chunks(LANES).enumerate() {
        // Gather the corners
        if triangles.len() < LANES {
            corners = [[[0.0; LANES]; 3]; 3];
        }
        for (lane, triangle) in triangles.iter().enumerate() {
            for corner in 0..3 {
                let vertex = triangle[corner];
                let Some(position) = positions.get(vertex as usize) else {
                    let triangle = first + packet * LANES + lane;
                    return Err(BadIndex { triangle, vertex });
                };
                for axis in 0..3 {
                    corners[corner][axis][lane] = position[axis];
                }
            }
        }
        // Grow the bounds by usable triangles only, as the corners of others may be NaN
        let mut is_usable = [false; LANES];
        find_usable(&corners, &mut is_usable);
        let mut usable = 0;
        for lane in 0..LANES {
            usable += usize::from(is_usable[lane]);
        }
        unusable += triangles.len() - usable;
        for corner in &corners {
            for axis in 0..3 {
                grow(
                    &corner[axis],
                    &is_usable,
                    &mut bounds.low[axis],
                    &mut bounds.high[axis],
                );
            }
        }
    }
    // Combine the lanes
    let extreme =
        |lanes: &Lanes<f32>, of: fn(f32, f32) -> f32| f64::from(lanes.iter().copied().fold(lanes[0], of));
    let bounds = Bounds {
        min: DVec3::from(bounds.low.each_ref().map(|lanes| extreme(lanes, f32::min))),
        max: DVec3::from(bounds.high.each_ref().map(|lanes| extreme(lanes, f32::max))),
    };
    Ok(MeshScan { bounds, unusable })
}

/// Finds the triangles that [`is_usable`] holds for.
#[inline(always)]
fn find_usable(corners: &CornerLanes, is_usable: &mut Lanes<bool>) {
    let [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] = corners;
    for l in 0..LANES {
        let (x0, y0, z0) = (f64::from(ax[l]), f64::from(ay[l]), f64::from(az[l]));
        let (x1, y1, z1) = (
            f64::from(bx[l]) - x0,
            f64::from(by[l]) - y0,
            f64::from(bz[l]) - z0,
        );
        let (x2, y2, z2) = (
            f64::from(cx[l]) - x0,
            f64::from(cy[l]) - y0,
            f64::from(cz[l]) - z0,
        );
        let (x, y, z) = (y1 * z2 - y2 * z1, z1 * x2 - z2 * x1, x1 * y2 - x2 * y1);
        let area = x * x + y * y + z * z;
        is_usable[l] = (area > 0.0) & (area < f64::INFINITY);
    }
}

/// Extends the bounds of each lane to the coordinates of usable triangles.
#[inline(always)]
fn grow(coordinates: &Lanes<f32>, is_usable: &Lanes<bool>, low: &mut Lanes<f32>, high: &mut Lanes<f32>) {
    for l in 0..LANES {
        low[l] = low[l].min(if is_usable[l] {
            coordinates[l]
        } else {
            f32::INFINITY
        });
        high[l] = high[l].max(if is_usable[l] {
            coordinates[l]
        } else {
            f32::NEG_INFINITY
        });
    }
}

/// Returns whether the triangle is finite and has an area.
fn is_usable(corners: [Vec3; 3]) -> bool {
    let [p0, p1, p2]: [DVec3; 3] = corners.map(|p| p.as_dvec3());
    // f32 coordinates to the fourth power stay far inside the range of f64, so only NaN and infinity give such an area.
    let area = (p1 - p0).cross(p2 - p0).length_squared();
    area > 0.0 && area < f64::INFINITY
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Mesh {
        Mesh {
            positions: Buffer::from(positions),
            triangles: Buffer::from(triangles),
            ..Mesh::default()
        }
    }

    #[test]
    fn needles_are_kept_and_lines_dropped_at_any_scale() {
        for scale in [1e-30f32, 1e-3, 1.0, 1e30] {
            let p = |x: f32, y: f32| [x * scale, y * scale, 0.0];
            let mut mesh = mesh(
                vec![p(0.0, 0.0), p(1.0, 1.0), p(2.0, 2.0), p(2.0, 2.0000002)],
                vec![[0, 1, 2], [0, 1, 3]],
            );
            assert_eq!(scan(&mesh).unwrap().unusable, 1, "scale {scale}");
            let dropped = drop_unusable(&mut mesh);
            assert_eq!((dropped.no_area, dropped.not_finite), (1, 0));
            assert_eq!(mesh.triangles[..], [[0, 1, 3]]);
        }
    }

    #[test]
    fn packets_find_what_each_triangle_is() {
        // Corners on a coarse grid, so that many triangles are lines or points, and some that are not finite
        let mut random = crate::numeric::SplitMix64::new(7, 0);
        let mut coordinate = || match (random.unit() * 200.0) as u32 {
            0 => f32::NAN,
            1 => f32::NEG_INFINITY,
            step => (step % 3) as f32,
        };
        let positions: Vec<[f32; 3]> = (0..3 * 1003).map(|_| [0; 3].map(|_| coordinate())).collect();
        let triangles: Vec<[u32; 3]> = (0..1003).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let corners = |triangle: &[u32; 3]| triangle.map(|v| Vec3::from(positions[v as usize]));
        for count in [1, 15, 16, 17, 1003] {
            let scanned = scan(&mesh(positions.clone(), triangles[..count].to_vec())).unwrap();
            let usable: Vec<[Vec3; 3]> = triangles[..count]
                .iter()
                .map(corners)
                .filter(|&c| is_usable(c))
                .collect();
            assert!(count < 1003 || (100..900).contains(&usable.len()));
            assert_eq!(scanned.unusable, count - usable.len());
            let all = usable.as_flattened().iter().map(|corner| corner.as_dvec3());
            assert_eq!(scanned.bounds, Bounds::of_points(all));
        }
    }

    #[test]
    fn infinite_vertex_drops_only_its_triangles() {
        let mut mesh = mesh(
            vec![
                [0.0; 3],
                [1.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [0.0, f32::INFINITY, 0.0],
                [f32::NAN; 3],
            ],
            vec![[0, 1, 2], [0, 1, 3], [4, 1, 2]],
        );
        assert_eq!(scan(&mesh).unwrap().bounds.max, DVec3::new(1.0, 1.0, 0.0));
        assert_eq!(drop_unusable(&mut mesh).not_finite, 2);
        clear_non_finite_positions(&mut mesh);
        assert_eq!(mesh.positions[3..], [[0.0; 3]; 2]);
        assert_eq!(mesh.triangles.len(), 1);
    }

    #[test]
    fn first_invalid_index_is_reported() {
        let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let mut triangles = vec![[0u32, 1, 2]; 40_000];
        triangles[20_000] = [0, 3, 1];
        triangles[39_999] = [0, 1, u32::MAX];
        let found = scan(&mesh(positions, triangles)).unwrap_err();
        assert_eq!((found.triangle, found.vertex), (20_000, 3));
    }

    #[test]
    fn single_non_finite_value_is_found() {
        let mut values = vec![f32::MAX; 200_000];
        assert!(all_finite(&values));
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            values[150_001] = bad;
            assert!(!all_finite(&values));
        }
    }

    #[test]
    fn dropped_triangles_are_reported() {
        let dropped = Removed {
            no_area: 1,
            not_finite: 2,
        };
        assert_eq!(
            dropped.to_string(),
            "had 1 triangle without an area and 2 triangles with vertices that are not finite: dropped"
        );
    }
}
