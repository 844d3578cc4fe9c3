//! Octree over points of known irradiance, in which far cells represent all their points.
//!
//! Each cell stores the sum of its points' power, and its centroid (Jensen and Buhler 2002, section 3.2). A single
//! point would be wrong by the second moments about the centroid, so these are stored too, and a far cell is evaluated
//! as two points that have them: at equal numbers of evaluations the error falls to about a tenth. Each colour has its
//! own moments, as otherwise lights of different colours on different sides would shift each other's centroid.
//!
//! Nodes are in the order of the Morton curve, each followed by its subtree, so that a traversal needs no stack: it
//! goes to the next node or skips a whole cell. Points are sorted by exact keys and summed in their order: the tree has
//! identical bits for any number of threads.

use glam::DVec3;

use super::Dipole;
use super::dipole::DipoleKernel;
use crate::numeric::morton::{MortonKey, sorted_keys};
use crate::parallel;

/// Default solid angle, in steradians, below which a cell is far: errors of 0.04 % (root mean square) and 0.2 %
/// (greatest) at a hundredth of 100 000 evaluations, by the tests of this module.
pub const DEFAULT_SOLID_ANGLE: f64 = 0.1;

/// Largest number of points in a leaf, unless they coincide.
const LEAF_SIZE: usize = 8;

/// Number of points above which a cell is built by several threads.
const PARALLEL_SIZE: usize = 1 << 13;

/// Irradiance sample: a point that represents a piece of the surface through which light enters.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Zeroable)]
pub struct IrradianceSample {
    /// Position of the point; finite.
    pub position: DVec3,
    /// Area of the piece; finite and not negative.
    pub area: f64,
    /// Irradiance transmitted through the surface there, in linear red, green and blue, per unit of area; finite and
    /// not negative.
    pub irradiance: [f32; 3],
}

/// Points of known irradiance on the surface of one medium, from which the exitance anywhere is evaluated.
#[derive(Clone, Debug)]
pub struct IrradianceTree {
    pub(super) kernel: DipoleKernel,
    /// Origin that all positions are relative to.
    pub(super) origin: DVec3,
    pub(super) nodes: Vec<OctreeNode>,
    /// Moments of each node's points, in red, green and blue.
    pub(super) moments: Vec<[Moments; 3]>,
    /// Coordinates of all points, in the order of the leaves.
    pub(super) position: [Vec<f32>; 3],
    /// Power of all points: irradiance times area.
    pub(super) power: [Vec<f32>; 3],
}

/// Node of the octree: a cell, and the points of a leaf.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OctreeNode {
    /// Centroid of the cell's power, of all colours together.
    pub(super) position: [f32; 3],
    /// Squared distance beyond which the cell's moments represent its subtree; negative if it has no power.
    pub(super) far2: f32,
    /// Number of nodes in the subtree, including this one.
    pub(super) node_count: u32,
    /// Index of the first point of the cell.
    pub(super) first: u32,
    /// Number of points of a leaf; 0 for all other nodes.
    pub(super) count: u32,
}

/// Power of a cell's points in one colour, and its spatial distribution.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Moments {
    /// Sum of the points' power.
    pub(super) power: f32,
    /// Centroid of the points' power.
    pub(super) position: [f32; 3],
    /// Second moments about the centroid, over the power: xx, yy, zz, 2 xy, 2 yz, 2 zx.
    pub(super) spread: [f32; 6],
}

/// Inputs from which all cells are built.
struct OctreeBuilder<'a> {
    /// Morton keys of the points, in ascending order.
    keys: &'a [MortonKey],
    /// Points in the order of `keys`.
    samples: &'a [IrradianceSample],
    origin: DVec3,
    solid_angle: f64,
}

impl IrradianceTree {
    /// Builds the tree of `samples`, fewer than 2^32, on the surface of a medium with this `dipole`, in equal units of
    /// length.
    ///
    /// A cell represents its points where both their area and the disk around them are seen under less than
    /// `solid_angle` (steradians, not negative); at 0 every point is evaluated. The error grows with about the power
    /// 3/2 of `solid_angle`. Runs in the current rayon pool.
    pub fn build(samples: &[IrradianceSample], dipole: &Dipole, solid_angle: f64) -> IrradianceTree {
        debug_assert!(samples.iter().all(IrradianceSample::is_valid));
        // Sort the points along the Morton curve
        let (bounds, keys) = sorted_keys(samples.len(), |i| samples[i].position);
        // Copy the points into the order in which they are read.
        let sorted = parallel::generate(samples.len(), |slot| samples[keys[slot].1 as usize]);
        let builder = OctreeBuilder {
            keys: &keys,
            samples: &sorted,
            origin: if samples.is_empty() {
                DVec3::ZERO
            } else {
                bounds.center()
            },
            solid_angle,
        };
        // Build all cells from the root down
        let cells = if samples.is_empty() {
            Vec::new()
        } else {
            builder.cell(0, samples.len())
        };
        // Convert to structure of arrays, with positions relative to the origin
        let (nodes, moments) = cells.into_iter().unzip();
        IrradianceTree {
            kernel: dipole.kernel(),
            origin: builder.origin,
            nodes,
            moments,
            position: std::array::from_fn(|axis| {
                let coordinate = |i: usize| (sorted[i].position - builder.origin)[axis] as f32;
                parallel::generate(sorted.len(), coordinate)
            }),
            power: std::array::from_fn(|c| parallel::generate(sorted.len(), |i| sorted[i].power()[c] as f32)),
        }
    }

    /// Returns the number of points in the tree.
    pub fn sample_count(&self) -> usize {
        self.position[0].len()
    }

    /// Returns the bytes of all arrays.
    pub fn byte_count(&self) -> usize {
        self.nodes.len() * (size_of::<OctreeNode>() + size_of::<[Moments; 3]>())
            + 6 * self.sample_count() * size_of::<f32>()
    }
}

impl IrradianceSample {
    /// Returns the power that enters through the piece, by colour.
    fn power(&self) -> [f64; 3] {
        self.irradiance
            .map(|irradiance| f64::from(irradiance) * self.area)
    }

    /// Returns whether all numbers are in range, which [`IrradianceTree::build`] requires.
    fn is_valid(&self) -> bool {
        let in_range = |x: f64| (0.0..f64::INFINITY).contains(&x);
        self.position.is_finite()
            && in_range(self.area)
            && self.irradiance.iter().all(|&e| in_range(e.into()))
    }
}

impl OctreeBuilder<'_> {
    /// Builds the cell of the points from `first` to before `end`, at least one, and its subtree.
    fn cell(&self, first: usize, end: usize) -> Vec<(OctreeNode, [Moments; 3])> {
        // Summarise the points and stop at a leaf
        let mut node = self.node(first, end);
        let moments = std::array::from_fn(|c| self.moments(first, end, c));
        let (lowest, highest) = (self.keys[first].0, self.keys[end - 1].0);
        if end - first <= LEAF_SIZE || lowest == highest {
            node.count = (end - first) as u32;
            return vec![(node, moments)];
        }
        // Find the highest octal digit in which its points differ, so that levels with a single child are skipped.
        let shift = (lowest ^ highest).ilog2() / 3 * 3;
        let mut starts = [end; 9];
        starts[0] = first;
        for digit in 1..8 {
            let run = &self.keys[first..end];
            starts[digit] = first + run.partition_point(|key| (key.0 >> shift & 7) < digit as u64);
        }
        // Build the children, in parallel if the cell is large
        let child = |digit: usize| {
            let (first, end) = (starts[digit], starts[digit + 1]);
            if first < end {
                self.cell(first, end)
            } else {
                Vec::new()
            }
        };
        let children: Vec<Vec<_>> = if end - first > PARALLEL_SIZE {
            parallel::map(8, &child)
        } else {
            (0..8).map(child).collect()
        };
        // Concatenate the node and its subtrees
        node.node_count += children.iter().map(|cells| cells.len() as u32).sum::<u32>();
        let mut cells = Vec::with_capacity(node.node_count as usize);
        cells.push((node, moments));
        children.into_iter().for_each(|below| cells.extend(below));
        cells
    }

    /// Returns the node of the points from `first` to before `end`, without children.
    fn node(&self, first: usize, end: usize) -> OctreeNode {
        // Sum area and power, and compute the centroid
        let (mut area, mut total, mut middle) = (0.0, 0.0, DVec3::ZERO);
        for sample in self.samples(first, end) {
            let power: f64 = sample.power().iter().sum();
            area += sample.area;
            total += power;
            middle += power * (sample.position - self.origin);
        }
        let is_lit = total > 0.0;
        middle = if is_lit { middle / total } else { DVec3::ZERO };
        // Find the distance beyond which the cell is far
        let radius2 = self
            .samples(first, end)
            .map(|sample| (sample.position - self.origin).distance_squared(middle))
            .fold(0.0, f64::max);
        let disk = std::f64::consts::PI * radius2;
        OctreeNode {
            position: middle.as_vec3().to_array(),
            far2: if is_lit {
                (area.max(disk) / self.solid_angle) as f32
            } else {
                -1.0
            },
            node_count: 1,
            first: first as u32,
            count: 0,
        }
    }

    /// Returns the moments of the points from `first` to before `end`, in one colour.
    fn moments(&self, first: usize, end: usize, c: usize) -> Moments {
        let (mut total, mut middle) = (0.0, DVec3::ZERO);
        for sample in self.samples(first, end) {
            let power = sample.power()[c];
            total += power;
            middle += power * (sample.position - self.origin);
        }
        if total == 0.0 {
            return Moments::default();
        }
        middle /= total;
        // Sum the second moments about the centroid
        let mut spread = [0.0; 6];
        for sample in self.samples(first, end) {
            let weight = sample.power()[c] / total;
            let d = sample.position - self.origin - middle;
            let [xy, yz, zx] = [d.x * d.y, d.y * d.z, d.z * d.x].map(|product| 2.0 * product);
            let squares = [d.x * d.x, d.y * d.y, d.z * d.z, xy, yz, zx];
            (0..6).for_each(|k| spread[k] += weight * squares[k]);
        }
        Moments {
            power: total as f32,
            position: middle.as_vec3().to_array(),
            spread: spread.map(|moment| moment as f32),
        }
    }

    /// Returns the points from `first` to before `end`.
    fn samples(&self, first: usize, end: usize) -> impl Iterator<Item = &IrradianceSample> {
        self.samples[first..end].iter()
    }
}

#[cfg(test)]
mod tests {
    use super::super::SubsurfacePreset;
    use super::*;

    /// Returns points of a curved surface, some of them unlit.
    fn samples(count: usize) -> Vec<IrradianceSample> {
        let sample = |i: usize| {
            let [x, y] = [0.754_877_666, 0.569_840_291].map(|step| (i as f64 * step).fract());
            IrradianceSample {
                position: DVec3::new(x, y, (5.0 * x).sin() * (7.0 * y).cos()),
                area: 1.0 / count as f64 * (1.0 + x),
                irradiance: [if x > 0.7 { 0.0 } else { 1.0 + y as f32 }; 3],
            }
        };
        (0..count).map(sample).collect()
    }

    fn build(samples: &[IrradianceSample]) -> IrradianceTree {
        let dipole = Dipole::new(&SubsurfacePreset::ALL[0].scattering).unwrap();
        IrradianceTree::build(samples, &dipole, DEFAULT_SOLID_ANGLE)
    }

    #[test]
    fn the_tree_has_the_same_bits_for_any_number_of_threads() {
        let samples = samples(50_000);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| build(&samples))
        };
        let (one, many) = (with(1), with(5));
        assert_eq!((one.nodes, one.moments), (many.nodes, many.moments));
        assert_eq!((one.position, one.power), (many.position, many.power));
    }

    #[test]
    fn every_point_is_in_one_leaf_and_every_cell_has_the_power_of_its_points() {
        let tree = build(&samples(20_000));
        let mut next = 0;
        for (n, node) in tree.nodes.iter().enumerate() {
            let cell = &tree.nodes[n..n + node.node_count as usize];
            let count: u32 = cell.iter().map(|node| node.count).sum();
            let points = node.first as usize..(node.first + count) as usize;
            let power: f64 = tree.power[1][points.clone()].iter().map(|&p| f64::from(p)).sum();
            // Rounding of every point to f32, and of the sum.
            assert!(
                (power - f64::from(tree.moments[n][1].power)).abs() <= 2.0 * 0.5f64.powi(24) * power,
                "{n}"
            );
            let far2 = f64::from(node.far2);
            assert!(if power > 0.0 { far2 > 0.0 } else { far2 == -1.0 });
            if node.count > 0 {
                assert_eq!((node.first, node.node_count), (next, 1));
                assert!(node.count as usize <= LEAF_SIZE);
                next += node.count;
            }
        }
        assert_eq!(next, 20_000);
        assert_eq!(tree.nodes[0].node_count as usize, tree.nodes.len());
    }

    #[test]
    fn cell_of_two_points_has_their_centroid_and_radius() {
        let sample = |x: f64, irradiance: f32| IrradianceSample {
            position: DVec3::new(x, 2.0 * x, 0.0),
            area: 1.0,
            irradiance: [irradiance; 3],
        };
        // Origin at x = 2: the centroid of 1 at 0 and 3 at 4 is at 3, the variance (1 · 9 + 3 · 1) / 4 = 3.
        let tree = build(&[sample(0.0, 1.0), sample(4.0, 3.0)]);
        let node = tree.nodes[0];
        assert_eq!(tree.origin, DVec3::new(2.0, 4.0, 0.0));
        assert_eq!(node.position, [1.0, 2.0, 0.0]);
        let moments = Moments {
            power: 4.0,
            position: node.position,
            spread: [3.0, 12.0, 0.0, 12.0, 0.0, 0.0],
        };
        assert_eq!(tree.moments[0], [moments; 3]);
        // Disk around both points, of radius 3 · 5^(1/2), under 0.1 steradians.
        let far2 = 45.0 * std::f64::consts::PI / DEFAULT_SOLID_ANGLE;
        assert!((f64::from(node.far2) / far2 - 1.0).abs() <= 1e-7);
    }
}
