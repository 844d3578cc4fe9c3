//! Decision in f64 about rays close to an edge.

use crate::mesh::simd::{WideLevel, lanes};

use super::edges::BlockCorners;
use super::projection::GroupProjection;

/// Distance from an edge within which a ray counts as inside, relative to the sum of the magnitudes of the edge
/// function's products. It is more than the error of f64, so that where many thin triangles share a vertex none is missed,
/// and far below that of f32.
const TOLERANCE: f64 = 1e-9;

/// Vertices of eight triangles in the frame of a group, in memory.
pub(super) struct CornerRows([[[f32; 8]; 3]; 3]);

impl CornerRows {
    /// Stores the vertices of a block.
    #[inline(always)]
    pub(super) fn new<W: WideLevel<8>>(corners: &BlockCorners<W>) -> CornerRows {
        let mut rows = [[[0.0; 8]; 3]; 3];
        for corner in 0..3 {
            rows[0][corner] = corners.x[corner].to_array();
            rows[1][corner] = corners.y[corner].to_array();
            rows[2][corner] = corners.z[corner].to_array();
        }
        CornerRows(rows)
    }
}

/// Triangles of the lanes of a test.
#[derive(Clone, Copy)]
pub(super) enum LaneTriangles {
    /// The same triangle of the block in all lanes, which are rays.
    One(usize),
    /// The lane's own triangle of the block.
    Each,
}

impl LaneTriangles {
    /// Returns the triangle of a lane.
    #[inline(always)]
    pub(super) fn of(self, lane: usize) -> usize {
        match self {
            LaneTriangles::One(triangle) => triangle % 8,
            LaneTriangles::Each => lane % 8,
        }
    }
}

/// Hits decided in f64.
pub(super) struct Decided<const N: usize> {
    /// Mask of the lanes that hit.
    pub(super) hits: u32,
    pub(super) z: [f32; N],
}

/// Decides in f64 about the lanes of `mask`, whose rays pass through `u` and `v`.
#[cold]
#[inline(never)]
pub(super) fn decide<J: GroupProjection, const N: usize>(
    corners: &CornerRows,
    triangles: LaneTriangles,
    mask: u32,
    [u, v]: [&[f32; N]; 2],
) -> Decided<N> {
    let mut decided = Decided { hits: 0, z: [0.0; N] };
    for lane in lanes(mask) {
        // Fetch the vertices
        let lane = lane % N;
        let triangle = triangles.of(lane);
        let [x, y, z] =
            [0, 1, 2].map(|axis| [0, 1, 2].map(|corner| f64::from(corners.0[axis][corner][triangle])));
        let w = if J::IS_PARALLEL { [1.0; 3] } else { z };
        // Evaluate the edge functions; the products of coordinates are exact
        let (u, v) = (f64::from(u[lane]), f64::from(v[lane]));
        let [mut edge, mut tolerance] = [[0.0; 3]; 2];
        for e in 0..3 {
            let (i, j) = ((e + 1) % 3, (e + 2) % 3);
            let a = y[i] * w[j] - w[i] * y[j];
            let b = w[i] * x[j] - x[i] * w[j];
            let c = x[i] * y[j] - y[i] * x[j];
            edge[e] = a * u + (b * v + c);
            // Bound what counts as on the edge
            let products = (y[i] * w[j] * u).abs() + (w[i] * x[j] * v).abs() + (x[i] * y[j]).abs();
            tolerance[e] = TOLERANCE * products;
        }
        // Accept either orientation
        let is_inside = (0..3).all(|e| edge[e] >= -tolerance[e]) || (0..3).all(|e| edge[e] <= tolerance[e]);
        let sum = edge[0] + edge[1] + edge[2];
        if is_inside && sum != 0.0 {
            // Interpolate the depth
            decided.hits |= 1 << lane;
            decided.z[lane] = ((edge[0] * z[0] + edge[1] * z[1] + edge[2] * z[2]) / sum) as f32;
        }
    }
    decided
}
