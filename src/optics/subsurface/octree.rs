//! An octree over points of known irradiance, in which far cells stand for all their points.
//!
//! Each cell keeps the sum of its points' power, and where that has its middle (Jensen and Buhler 2002, section 3.2).
//! As one point it would be wrong by the second moments about the middle, so these are kept too, and a far cell is
//! evaluated as two points that have them: at the same number of evaluations the error falls to about a tenth. Each
//! colour has its own moments, as lamps of different colours on different sides would else pull each other's light
//! along.
//!
//! Nodes lie in the order of Morton's curve, each followed by all that is below it, so that a walk needs no stack: it
//! goes to the next node or past a whole cell. Points are sorted by exact keys and summed in their order: the tree has
//! the same bits for any number of threads.

use glam::DVec3;

use super::Dipole;
use super::dipole::Kernel;
use crate::numeric::morton::{Key, sorted_keys};
use crate::parallel;

/// The solid angle, in steradians, below which a cell is far, where nothing else is asked for: errors of 0.04 % (root
/// mean square) and 0.2 % (greatest) at a hundredth of 100 000 evaluations, by the tests of this room.
pub const DEFAULT_SOLID_ANGLE: f64 = 0.1;

/// Points that a leaf holds at most, unless they coincide.
const LEAF_SIZE: usize = 8;

/// Cells of more points than this are built by several threads.
const PARALLEL_SIZE: usize = 1 << 13;

/// A point through whose piece of the surface light enters.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Zeroable)]
pub struct IrradianceSample {
    /// Where it is; finite.
    pub position: DVec3,
    /// The area of its piece; finite and not negative.
    pub area: f64,
    /// What gets through the surface there, in linear red, green and blue, per unit of area; finite and not negative.
    pub irradiance: [f32; 3],
}

/// Points of known irradiance on the surface of one body, ready to be asked what leaves it anywhere.
#[derive(Clone, Debug)]
pub struct IrradianceTree {
    pub(super) kernel: Kernel,
    /// What all positions are relative to.
    pub(super) origin: DVec3,
    pub(super) nodes: Vec<Node>,
    /// What each node's points are from afar, in red, green and blue.
    pub(super) moments: Vec<[Moments; 3]>,
    /// Coordinates of all points, in the order of the leaves.
    pub(super) position: [Vec<f32>; 3],
    /// Their power, irradiance times area.
    pub(super) power: [Vec<f32>; 3],
}

/// A cell, and the points of a leaf.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Node {
    /// The middle of its power, of all colours together.
    pub(super) position: [f32; 3],
    /// The squared distance from which on its moments stand for all that is below it; negative if nothing is.
    pub(super) far2: f32,
    /// Nodes of its cell, itself among them.
    pub(super) node_count: u32,
    /// The first of its points.
    pub(super) first: u32,
    /// How many points a leaf has; 0 for all other nodes.
    pub(super) count: u32,
}

/// The power of a cell's points in one colour, and how it is spread.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Moments {
    /// The sum.
    pub(super) power: f32,
    /// Its middle.
    pub(super) position: [f32; 3],
    /// Its second moments about the middle, over the power: xx, yy, zz, 2 xy, 2 yz, 2 zx.
    pub(super) spread: [f32; 6],
}

/// What all cells are built from.
struct Builder<'a> {
    /// Places along the curve, in its order.
    keys: &'a [Key],
    /// The points in the same order.
    samples: &'a [IrradianceSample],
    origin: DVec3,
    solid_angle: f64,
}

impl IrradianceTree {
    /// The tree of `mesh_samples`, fewer than 2^32, under the surface of a body of that `dipole`, in the same units of
    /// length.
    ///
    /// A cell stands for its points where both their area and the disk around them are seen under less than
    /// `solid_angle` (steradians, not negative); at 0 every point is evaluated. The error grows with about its power of
    /// 3/2. Runs in the current rayon pool.
    pub fn build(samples: &[IrradianceSample], dipole: &Dipole, solid_angle: f64) -> IrradianceTree {
        debug_assert!(samples.iter().all(IrradianceSample::is_valid));
        let (bounds, keys) = sorted_keys(samples.len(), |i| samples[i].position);
        // In the order in which all of them are read.
        let sorted = parallel::generate(samples.len(), |place| samples[keys[place].1 as usize]);
        let builder = Builder {
            keys: &keys,
            samples: &sorted,
            origin: if samples.is_empty() {
                DVec3::ZERO
            } else {
                bounds.center()
            },
            solid_angle,
        };
        let cells = if samples.is_empty() {
            Vec::new()
        } else {
            builder.cell(0, samples.len())
        };
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

    /// How many points it holds.
    pub fn sample_count(&self) -> usize {
        self.position[0].len()
    }

    /// Bytes of all arrays.
    pub fn byte_count(&self) -> usize {
        self.nodes.len() * (size_of::<Node>() + size_of::<[Moments; 3]>())
            + 6 * self.sample_count() * size_of::<f32>()
    }
}

impl IrradianceSample {
    fn power(&self) -> [f64; 3] {
        self.irradiance
            .map(|irradiance| f64::from(irradiance) * self.area)
    }

    fn is_valid(&self) -> bool {
        let in_range = |x: f64| (0.0..f64::INFINITY).contains(&x);
        self.position.is_finite()
            && in_range(self.area)
            && self.irradiance.iter().all(|&e| in_range(e.into()))
    }
}

impl Builder<'_> {
    /// The cell of the points from `first` to before `end`, at least one, and all below it.
    fn cell(&self, first: usize, end: usize) -> Vec<(Node, [Moments; 3])> {
        let mut node = self.node(first, end);
        let moments = std::array::from_fn(|c| self.moments(first, end, c));
        let (lowest, highest) = (self.keys[first].0, self.keys[end - 1].0);
        if end - first <= LEAF_SIZE || lowest == highest {
            node.count = (end - first) as u32;
            return vec![(node, moments)];
        }
        // The highest octal digit in which its points differ: levels with a single child are left out.
        let shift = (lowest ^ highest).ilog2() / 3 * 3;
        let mut starts = [end; 9];
        starts[0] = first;
        for digit in 1..8 {
            let run = &self.keys[first..end];
            starts[digit] = first + run.partition_point(|key| (key.0 >> shift & 7) < digit as u64);
        }
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
        node.node_count += children.iter().map(|cells| cells.len() as u32).sum::<u32>();
        let mut cells = Vec::with_capacity(node.node_count as usize);
        cells.push((node, moments));
        children.into_iter().for_each(|below| cells.extend(below));
        cells
    }

    /// The node of the points from `first` to before `end`, as if nothing were below it.
    fn node(&self, first: usize, end: usize) -> Node {
        let (mut area, mut total, mut middle) = (0.0, 0.0, DVec3::ZERO);
        for sample in self.samples(first, end) {
            let power: f64 = sample.power().iter().sum();
            area += sample.area;
            total += power;
            middle += power * (sample.position - self.origin);
        }
        let is_lit = total > 0.0;
        middle = if is_lit { middle / total } else { DVec3::ZERO };
        let radius2 = self
            .samples(first, end)
            .map(|sample| (sample.position - self.origin).distance_squared(middle))
            .fold(0.0, f64::max);
        let disk = std::f64::consts::PI * radius2;
        Node {
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

    /// What the points from `first` to before `end` are from afar, in one colour.
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

    fn samples(&self, first: usize, end: usize) -> impl Iterator<Item = &IrradianceSample> {
        self.samples[first..end].iter()
    }
}

#[cfg(test)]
mod tests {
    use super::super::SubsurfacePreset;
    use super::*;

    /// Points of a crumpled sheet, some of them dark.
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
            // Every point rounded to f32, and the sum.
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
    fn two_points_have_their_middle_and_their_spread() {
        let sample = |x: f64, irradiance: f32| IrradianceSample {
            position: DVec3::new(x, 2.0 * x, 0.0),
            area: 1.0,
            irradiance: [irradiance; 3],
        };
        // Around x = 2: the middle of 1 at 0 and 3 at 4 is at 3, their variance (1 · 9 + 3 · 1) / 4 = 3.
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
        // The disk around them, of radius 3 · 5^(1/2), under 0.1 steradians.
        let far2 = 45.0 * std::f64::consts::PI / DEFAULT_SOLID_ANGLE;
        assert!((f64::from(node.far2) / far2 - 1.0).abs() <= 1e-7);
    }
}
