//! Terrain of integer heights over a square, as a triangle mesh.

use glam::DVec3;

use super::test_meshes::mesh;
use crate::mesh::Mesh;
use crate::numeric::SplitMix64;

/// Number of squares along a side of a terrain.
pub(in crate::verify) const SQUARES: usize = 32;

/// Returns the pseudo-random height of a vertex, a whole number from 0 to 7.
fn height(x: usize, z: usize) -> f64 {
    (SplitMix64::new(0x589, (x * (SQUARES + 1) + z) as u64).below(8)) as f64
}

/// Returns a terrain over a square with `axis` up.
pub(in crate::verify) fn terrain(axis: usize) -> Mesh {
    let count = SQUARES + 1;
    let corners: Vec<DVec3> = (0..count * count)
        .map(|number| {
            let (x, z) = (number / count, number % count);
            turned(axis, x as f64, height(x, z), z as f64)
        })
        .collect();
    let index = |x: usize, z: usize| (x * count + z) as u32;
    let squares = (0..SQUARES * SQUARES).map(|number| (number / SQUARES, number % SQUARES));
    let faces = squares.flat_map(|(x, z)| {
        let [a, b] = [index(x, z), index(x + 1, z)];
        let [c, d] = [index(x, z + 1), index(x + 1, z + 1)];
        [[a, c, b], [b, c, d]]
    });
    mesh(&corners, faces.collect())
}

/// Returns the point with `up` along `axis` and the other coordinates along the other two axes.
pub(in crate::verify) fn turned(axis: usize, x: f64, up: f64, z: f64) -> DVec3 {
    let mut p = DVec3::ZERO;
    (p[(axis + 2) % 3], p[axis], p[(axis + 1) % 3]) = (x, up, z);
    p
}

/// Returns the height of the terrain at whole and half coordinates; the centre of a square lies on the diagonal that
/// cuts it.
pub(in crate::verify) fn height_at(x: f64, z: f64) -> f64 {
    let ends = |v: f64| [v.floor() as usize, v.ceil() as usize];
    let ([x0, x1], [z0, z1]) = (ends(x), ends(z));
    // The mean over the diagonal from (x1, z0) to (x0, z1) is also that of an edge's ends or of a single vertex.
    0.5 * (height(x1, z0) + height(x0, z1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terrain_height_at_square_centre_is_mean_of_corners() {
        assert_eq!(height_at(3.0, 4.0), height(3, 4));
        assert_eq!(height_at(3.5, 4.0), 0.5 * (height(3, 4) + height(4, 4)));
        assert_eq!(height_at(3.5, 4.5), 0.5 * (height(4, 4) + height(3, 5)));
    }
}
