//! Tree over photons: sorted along a balanced k-d tree, in nodes of [`LANES`] children.
//!
//! Each [`LANES`] photons in turn are a leaf, each as many leaves a node, and so on to the root, so that the test of a leaf
//! or of a node is one loop over lanes. A node holds the bounds of its children and the greatest radius in each. Bounds are
//! at most as far from a point as the photons within, also after rounding, because both distances take the same steps: no
//! photon is lost, whichever way the tree is split.

use std::f32::consts::FRAC_1_SQRT_2;

use glam::Vec3;

use crate::numeric::{LANES, Lanes, Lanes3};
use crate::parallel;

/// Least cosine between the normals of points on the same side of a surface: 45 degrees.
pub(super) const MIN_COS: f32 = FRAC_1_SQRT_2;
/// Greatest height over the plane of a photon, as a fraction of the radius of its disc or of the distance.
const MAX_HEIGHT: f32 = 0.3;
/// Least number of photons that is sorted on a thread of its own.
const MIN_PARALLEL: usize = 1 << 11;

/// Photon that arrived at a diffuse surface, in world space.
#[derive(Clone, Copy, Debug)]
pub(in crate::render) struct Photon {
    pub(in crate::render) position: [f32; 3],
    /// Unit vector to where the photon came from.
    pub(in crate::render) direction: [f32; 3],
    /// Unit geometric normal on the side at which the photon arrived.
    pub(in crate::render) normal: [f32; 3],
    /// Power in watts, linear RGB; may be negative.
    pub(in crate::render) power: [f32; 3],
    /// Index of the light in the scene.
    pub(in crate::render) light: u32,
}

impl Photon {
    /// Returns whether a point with its normal is on the same side of a surface as the photon, and near the plane of
    /// the photon for a distance whose square is given.
    #[inline(always)]
    pub(super) fn shares_surface(&self, p: Vec3, normal: Vec3, squared_distance: f32) -> bool {
        let height = (p - Vec3::from(self.position)).dot(self.normal.into());
        let is_near = height * height <= MAX_HEIGHT * MAX_HEIGHT * squared_distance;
        is_near & (normal.dot(self.normal.into()) >= MIN_COS)
    }
}

/// Nodes of one level of the tree, each with its children in lanes.
#[derive(Debug)]
pub(super) struct PhotonLevel {
    /// Lower corners of the bounds of children; infinite in lanes without a child.
    pub(super) min: Vec<Lanes3<f32>>,
    /// Upper corners; empty in the level of leaves, where bounds are points.
    pub(super) max: Vec<Lanes3<f32>>,
    /// Square of the greatest radius in each child; 0 in lanes without a child.
    pub(super) squared_radius: Vec<Lanes<f32>>,
}

impl PhotonLevel {
    /// Creates the nodes over the bounds of children: lower and upper corners. Radii are yet unknown.
    fn new(children: &[[Vec3; 2]]) -> PhotonLevel {
        let node_count = children.len().div_ceil(LANES);
        let mut min = vec![[[f32::INFINITY; LANES]; 3]; node_count];
        let mut max = vec![[[f32::NEG_INFINITY; LANES]; 3]; node_count];
        for (child, corners) in children.iter().enumerate() {
            for axis in 0..3 {
                min[child / LANES][axis][child % LANES] = corners[0][axis];
                max[child / LANES][axis][child % LANES] = corners[1][axis];
            }
        }
        PhotonLevel {
            min,
            max,
            squared_radius: vec![[0.0; LANES]; node_count],
        }
    }

    /// Returns the squares of the distances of a node's children to a point; infinite in lanes without one.
    #[inline(always)]
    pub(super) fn squared_distances(&self, node: usize, p: Vec3) -> Lanes<f32> {
        let min = &self.min[node];
        let max = self.max.get(node).unwrap_or(min);
        let mut squared = [0.0; LANES];
        for l in 0..LANES {
            let mut outside = [0.0; 3];
            for axis in 0..3 {
                let [below, above] = [min[axis][l] - p[axis], p[axis] - max[axis][l]];
                let farther = if below > above { below } else { above };
                outside[axis] = if farther > 0.0 { farther } else { 0.0 };
            }
            squared[l] = Vec3::from(outside).length_squared();
        }
        squared
    }
}

/// Returns the indices of the photons with finite positions in the order of the tree.
pub(super) fn tree_order(photons: &[Photon]) -> Vec<u32> {
    let keys = photons.iter().map(|photon| photon.position).zip(0..);
    let mut keys: Vec<([f32; 3], u32)> = keys.filter(|(p, _)| Vec3::from(*p).is_finite()).collect();
    sort_into_leaves(&mut keys);
    keys.iter().map(|&(_, index)| index).collect()
}

/// Sorts positions and indices of photons, so that each aligned run of [`LANES`] times a power of two of them is a cell
/// of a k-d tree, which is split across the longest edge of its bounds.
pub(super) fn sort_into_leaves(keys: &mut [([f32; 3], u32)]) {
    let leaf_count = keys.len().div_ceil(LANES);
    if leaf_count < 2 {
        // Do not leave the order within a leaf to the way of sorting
        keys.sort_unstable_by_key(|key| key.1);
        return;
    }
    // Fill the lower half, so that only the last leaf of all has lanes without a photon
    let middle = LANES * leaf_count.next_power_of_two() / 2;
    let [min, max] = union(keys.iter().map(|&(p, _)| [p.into(); 2]));
    let axis = (max - min).max_position();
    keys.select_nth_unstable_by(middle, |(a, index), (b, other)| {
        a[axis].total_cmp(&b[axis]).then(index.cmp(other))
    });
    let (lower, upper) = keys.split_at_mut(middle);
    if lower.len() >= MIN_PARALLEL {
        parallel::join(|| sort_into_leaves(lower), || sort_into_leaves(upper));
    } else {
        sort_into_leaves(lower);
        sort_into_leaves(upper);
    }
}

/// Returns the bounds of several bounds: lower and upper corners.
fn union(bounds: impl Iterator<Item = [Vec3; 2]>) -> [Vec3; 2] {
    let empty = [Vec3::INFINITY, Vec3::NEG_INFINITY];
    bounds.fold(empty, |[min, max], [low, high]| [min.min(low), max.max(high)])
}

/// Returns the levels of the tree over sorted photons, of which there must be one at least, without radii.
pub(super) fn levels_over(photons: &[Photon]) -> Vec<PhotonLevel> {
    let mut children: Vec<[Vec3; 2]> = photons.iter().map(|photon| [photon.position.into(); 2]).collect();
    let mut levels = vec![PhotonLevel::new(&children)];
    levels[0].max = Vec::new();
    while children.len() > LANES {
        let nodes = children.chunks(LANES);
        children = nodes.map(|node| union(node.iter().copied())).collect();
        levels.push(PhotonLevel::new(&children));
    }
    levels
}

/// Returns one bit for each lane: whether its value is below its limit.
#[inline(always)]
pub(super) fn lanes_below(values: &Lanes<f32>, limits: &Lanes<f32>) -> u32 {
    // Sum up twice the bits, and what all lanes add for that, since compilers take a union of bits apart
    let mut sum = 0;
    for l in 0..LANES {
        sum += if values[l] < limits[l] { 3 << l } else { 1 << l };
    }
    (sum - ((1 << LANES) - 1)) >> 1
}
