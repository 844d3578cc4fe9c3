//! Photon map: photons on surfaces, each with a disc or an ellipse over which its power spreads (H. W. Jensen, "Realistic
//! Image Synthesis Using Photon Mapping", 2001).
//!
//! The radius of a disc is the distance to the k-th nearest neighbour of its photon on the same side of the surface, so
//! discs are small where photons are dense; [ellipses](super::photon_kernel) take the place of those whose bundle of light
//! is known. The integral of each kernel is 1: a plane receives exactly the power of its photons. The irradiance at a
//! point is the sum of power times kernel over the discs that cover it; below, "disc" also stands for "ellipse", and its
//! radius for the longer one.

use glam::{DVec3, Vec3};
use multiversion::multiversion;

use super::photon_kernel::{KernelShape, PhotonKernel, PhotonOrigin, shapes};
use super::photon_tree::{Photon, PhotonLevel, lanes_below, levels_over, tree_order};
use crate::numeric::{LANES, Lanes};
use crate::parallel;

/// Least radius of a disc, as a fraction of the largest coordinate of its photon and of the largest radius.
///
/// Photons at the same point would have a radius of zero. This one, times the greatest height over a photon's plane, is
/// more than twice the distance by which the rounding of coordinates moves two points apart: 2 √3 times 2^-24.
const MIN_RADIUS: f32 = 16.0 * f32::EPSILON;
/// Greatest radius of a disc: its square and the inverse of that are normal numbers.
const MAX_RADIUS: f32 = (1u64 << 62) as f32;
/// Number of levels of the tallest tree: 2^32 photons, with [`LANES`] children a node.
const MAX_LEVELS: usize = 8;
/// Number of photons whose radii one task computes.
const PHOTONS_PER_TASK: usize = 1 << 10;

/// Photons in the order of a tree that finds those whose discs cover a point.
#[derive(Debug, Default)]
pub(in crate::render) struct PhotonMap {
    photons: Vec<Photon>,
    /// Kernel of each photon.
    kernels: Vec<PhotonKernel>,
    /// Leaves, whose children are photons, then the nodes above them; the last level is the root alone.
    levels: Vec<PhotonLevel>,
}

/// Node that a search for neighbours has yet to visit.
struct PendingNode {
    /// Square of the distance to the bounds.
    squared_distance: f32,
    level: usize,
    index: usize,
}

/// Search for the neighbours of photons, by which the radii of discs are chosen.
struct RadiusSearch<'m> {
    map: &'m PhotonMap,
    shapes: &'m [KernelShape],
    /// Number of neighbours to which a disc reaches, at least 1.
    neighbours: usize,
    max_radius: f32,
    /// Stack of nodes; empty between searches, as the nearest ones are.
    pending: Vec<PendingNode>,
    /// Bits of squared distances, which are in the order of the distances themselves.
    nearest: Vec<u32>,
}

impl PhotonMap {
    /// Builds the map of `photons`, whose discs reach to their `neighbours`-th neighbour but not beyond `max_radius`.
    ///
    /// Neighbours have a normal within 45 degrees of the photon's own, and are near its plane; several at one position
    /// count. A disc has at least the radius that f32 positions resolve: 2^-19 of the photon's largest coordinate and
    /// of `max_radius`, which must be positive. Photons with an origin may have an ellipse in place of a disc. Photons
    /// whose position is not finite are left out. The result does not depend on the number of threads.
    pub(in crate::render) fn new(
        photons: &[Photon],
        origins: &[Option<PhotonOrigin>],
        neighbours: usize,
        max_radius: f32,
    ) -> PhotonMap {
        debug_assert!(max_radius > 0.0 && photons.len() <= u32::MAX as usize);
        debug_assert_eq!(photons.len(), origins.len());
        // The squares of radii must be finite, and so must their inverses
        let max_radius = max_radius.min(MAX_RADIUS);
        // Build the tree
        let order = tree_order(photons);
        if order.is_empty() {
            return PhotonMap::default();
        }
        let photons: Vec<Photon> = order.iter().map(|&index| photons[index as usize]).collect();
        let levels = levels_over(&photons);
        let mut map = PhotonMap {
            photons,
            kernels: Vec::new(),
            levels,
        };
        // Fit shapes, then compute their radii
        let origins: Vec<_> = order.iter().map(|&index| origins[index as usize]).collect();
        let shapes = shapes(&map.photons, &origins, neighbours);
        let radii = parallel::map_chunks(&map.photons, PHOTONS_PER_TASK, &|task, photons| {
            let mut search = RadiusSearch {
                map: &map,
                shapes: &shapes,
                neighbours: neighbours.max(1),
                max_radius,
                pending: Vec::new(),
                nearest: Vec::new(),
            };
            squared_radii(&mut search, task * PHOTONS_PER_TASK, photons.len())
        });
        let radii = radii.concat();
        let kernel = |index: usize| {
            let least = min_radius(&map.photons[index], max_radius);
            PhotonKernel::new(&shapes[index], radii[index], least)
        };
        map.kernels = (0..map.photons.len()).map(kernel).collect();
        map.set_radii(radii);
        map
    }

    /// Returns whether there is no photon in the map.
    pub(in crate::render) fn is_empty(&self) -> bool {
        self.photons.is_empty()
    }

    /// Returns a photon by its index in the order of the tree, which [`Self::covering`] reports.
    #[inline(always)]
    pub(in crate::render) fn photon(&self, index: u32) -> &Photon {
        &self.photons[index as usize]
    }

    /// Replaces `found` by the photons whose discs cover `p` on a surface of unit normal `normal`, with the values of
    /// their kernels at `p` per square metre. Indices ascend.
    ///
    /// A disc covers the points that are nearer than its radius, not higher over its plane than 0.3 of the radius, and
    /// whose normal is within 45 degrees of the photon's own. `p` is rounded to f32, as the positions of photons are.
    pub(in crate::render) fn covering(&self, p: DVec3, normal: Vec3, found: &mut Vec<(u32, f32)>) {
        found.clear();
        let p = p.as_vec3();
        if p.is_finite() && !self.is_empty() {
            collect_covering(self, p, normal, found);
        }
    }

    /// Returns the number of bytes that the map occupies.
    pub(in crate::render) fn byte_count(&self) -> usize {
        let of_levels = self.levels.iter().map(|level| {
            let corners = size_of_val(&level.min[..]) + size_of_val(&level.max[..]);
            corners + size_of_val(&level.squared_radius[..])
        });
        let kernels = size_of_val(&self.kernels[..]);
        size_of_val(&self.photons[..]) + kernels + of_levels.sum::<usize>()
    }

    /// Stores the radii of all photons, and above these the greatest one in each child.
    fn set_radii(&mut self, mut squared: Vec<f32>) {
        for level in &mut self.levels {
            for (lanes, children) in level.squared_radius.iter_mut().zip(squared.chunks(LANES)) {
                lanes[..children.len()].copy_from_slice(children);
            }
            let largest = |lanes: &Lanes<f32>| lanes.iter().copied().fold(0.0, f32::max);
            squared = level.squared_radius.iter().map(largest).collect();
        }
    }
}

/// Returns the squares of the radii of `count` photons from the one of index `first`.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn squared_radii(search: &mut RadiusSearch, first: usize, count: usize) -> Vec<f32> {
    let mut radii = vec![0.0; count];
    for (index, radius) in (first..).zip(&mut radii) {
        *radius = search.squared_radius(index);
    }
    radii
}

/// Returns the least radius of a photon's disc; its square does not underflow even where all is at the origin.
#[inline(always)]
fn min_radius(photon: &Photon, max_radius: f32) -> f32 {
    let largest = |largest: f32, x: f32| largest.max(x.abs());
    let largest = photon.position.into_iter().fold(max_radius, largest);
    (MIN_RADIUS * largest).max(f32::MIN_POSITIVE.sqrt())
}

impl RadiusSearch<'_> {
    /// Returns the square of the radius of a photon.
    #[inline(always)]
    fn squared_radius(&mut self, index: usize) -> f32 {
        let mut limit = self.max_radius * self.max_radius;
        self.pending.push(PendingNode {
            squared_distance: 0.0,
            level: self.map.levels.len() - 1,
            index: 0,
        });
        while let Some(node) = self.pending.pop() {
            if node.squared_distance < limit {
                self.visit(&node, index, limit);
            }
            // Keep the nearest ones when there are many
            if self.nearest.len() >= 2 * self.neighbours {
                limit = self.last_neighbour();
            }
        }
        if self.nearest.len() >= self.neighbours {
            limit = self.last_neighbour();
        }
        self.nearest.clear();
        let least = min_radius(&self.map.photons[index], self.max_radius);
        limit.max(least * least)
    }

    /// Keeps as many of the nearest neighbours as are needed; returns the square of the distance to the last of them.
    #[inline(always)]
    fn last_neighbour(&mut self) -> f32 {
        let last = *self.nearest.select_nth_unstable(self.neighbours - 1).1;
        self.nearest.truncate(self.neighbours);
        f32::from_bits(last)
    }

    /// Adds the children of a node that are nearer to a photon than the root of `limit`: neighbours from a leaf, others
    /// to the stack, the nearest one last.
    #[inline(always)]
    fn visit(&mut self, node: &PendingNode, index: usize, limit: f32) {
        let photon = &self.map.photons[index];
        let squared = self.map.levels[node.level].squared_distances(node.index, photon.position.into());
        let stacked = self.pending.len();
        let mut left = lanes_below(&squared, &[limit; LANES]);
        while left != 0 {
            let l = left.trailing_zeros() as usize % LANES;
            left &= left - 1;
            let child = LANES * node.index + l;
            if node.level > 0 {
                self.pending.push(PendingNode {
                    squared_distance: squared[l],
                    level: node.level - 1,
                    index: child,
                });
                continue;
            }
            let other = &self.map.photons[child];
            let offset = Vec3::from(other.position) - Vec3::from(photon.position);
            let reach = self.shapes[index].squared_reach(offset, squared[l]);
            let is_near = photon.shares_surface(other.position.into(), other.normal.into(), squared[l]);
            if is_near & (child != index) & (reach < limit) {
                self.nearest.push(reach.to_bits());
            }
        }
        let stacked = &mut self.pending[stacked..];
        stacked.sort_unstable_by(|a, b| b.squared_distance.total_cmp(&a.squared_distance));
    }
}

/// Appends the photons whose discs cover `p`, with their kernels, in ascending order.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn collect_covering(map: &PhotonMap, p: Vec3, normal: Vec3, found: &mut Vec<(u32, f32)>) {
    // Start above the root
    let top = map.levels.len();
    let mut level = top;
    let mut indices = [0; MAX_LEVELS + 1];
    let mut left = [0u32; MAX_LEVELS + 1];
    left[top] = 1;
    let mut squared = [0.0; LANES];
    loop {
        // Return from nodes without further children
        while left[level] == 0 {
            if level == top {
                return;
            }
            level += 1;
        }
        let l = left[level].trailing_zeros() as usize % LANES;
        left[level] &= left[level] - 1;
        let child = LANES * indices[level] + l;
        // Descend to the next child in the order of the tree
        if level > 0 {
            level -= 1;
            let nodes = &map.levels[level];
            indices[level] = child;
            squared = nodes.squared_distances(child, p);
            left[level] = lanes_below(&squared, &nodes.squared_radius[child]);
            continue;
        }
        // Add a photon of the leaf whose distances were computed last
        let squared_radius = map.levels[0].squared_radius[indices[0]][l];
        if map.photons[child].shares_surface(p, normal, squared_radius) {
            let offset = p - Vec3::from(map.photons[child].position);
            let kernel = map.kernels[child].value(offset, squared[l]);
            if kernel > 0.0 {
                found.push((child as u32, kernel));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::super::photon_tree::MIN_COS;
    use super::*;
    use crate::numeric::SplitMix64;

    fn photon(position: [f64; 3], normal: Vec3) -> Photon {
        Photon {
            position: position.map(|x| x as f32),
            direction: normal.to_array(),
            normal: normal.to_array(),
            power: [1.0, 0.5, -0.25],
            light: 0,
        }
    }

    /// Returns photons on a floor with a step and on a wall, some of them in clusters and some at the same position.
    fn corner_photons(count: usize, random: &mut SplitMix64) -> Vec<Photon> {
        let mut photons: Vec<Photon> = Vec::new();
        for _ in 0..count {
            let size = random.choose(&[1.0, 0.03]);
            let [u, v] = [size * random.unit(), size * random.unit()];
            photons.push(match random.below(8) {
                0..4 => photon([u, v, 0.0], Vec3::Z),
                4 => photon([u, v, -0.01], Vec3::Z),
                5 => photon([u, v, 0.0], Vec3::NEG_Z),
                6 if !photons.is_empty() => random.choose(&photons),
                _ => photon([0.0, u, v], Vec3::X),
            });
        }
        photons
    }

    /// Returns the map of photons without origins, which have discs.
    fn built(photons: &[Photon], neighbours: usize, max_radius: f32) -> PhotonMap {
        PhotonMap::new(photons, &vec![None; photons.len()], neighbours, max_radius)
    }

    fn radius_of(map: &PhotonMap, index: usize) -> f64 {
        f64::from(map.levels[0].squared_radius[index / LANES][index % LANES]).sqrt()
    }

    fn position(photon: &Photon) -> DVec3 {
        photon.position.map(f64::from).into()
    }

    /// Returns the distance of `p` from a photon if it is as near to its plane as 0.3 of `reach` or the distance.
    fn distance(photon: &Photon, (p, normal): (DVec3, Vec3), reach: Option<f64>) -> Option<f64> {
        let offset = p - position(photon);
        let height = offset.dot(Vec3::from(photon.normal).as_dvec3()).abs();
        let is_near = height <= 0.3 * reach.unwrap_or(offset.length());
        (is_near && normal.dot(photon.normal.into()) >= MIN_COS).then_some(offset.length())
    }

    #[test]
    fn radii_are_those_of_a_search_through_all_photons() {
        let mut random = SplitMix64::new(11, 1);
        for (count, neighbours, max_radius) in [(15, 3, 0.5), (600, 1, 0.2), (1500, 10, 0.05)] {
            let map = built(&corner_photons(count, &mut random), neighbours, max_radius);
            for (index, photon) in map.photons.iter().enumerate() {
                let others = map.photons.iter().enumerate().filter(|other| other.0 != index);
                let points = others.map(|(_, other)| (position(other), other.normal.into()));
                let mut distances: Vec<f64> = points.filter_map(|at| distance(photon, at, None)).collect();
                distances.sort_by(f64::total_cmp);
                let reached = distances.get(neighbours - 1).unwrap_or(&f64::INFINITY);
                let expected = reached.min(f64::from(max_radius));
                let radius = radius_of(&map, index);
                // Coordinates are up to 1
                let is_least = expected < radius && radius <= f64::from(MIN_RADIUS);
                let error = (radius - expected).abs();
                assert!(is_least || error <= 1e-6 * expected, "{radius}, not {expected}");
            }
        }
    }

    #[test]
    fn covering_photons_are_those_of_a_search_through_all() {
        let mut random = SplitMix64::new(12, 1);
        let mut found = Vec::new();
        for (count, neighbours) in [(1, 4), (17, 4), (300, 5), (3000, 20)] {
            let map = built(&corner_photons(count, &mut random), neighbours, 0.1);
            for query in 0..300 {
                // Points on the surfaces, off them, and at photons
                let at = corner_photons(1, &mut random)[0];
                let p = match query % 3 {
                    0 => position(&at),
                    1 => position(&at) + 0.02 * random.in_cube(),
                    _ => position(&random.choose(&map.photons)),
                };
                let normal = (Vec3::from(at.normal) + random.in_cube().as_vec3()).normalize();
                map.covering(p, normal, &mut found);
                assert!(found.is_sorted_by(|one, next| one.0 < next.0));
                for (photon, index) in map.photons.iter().zip(0..) {
                    let radius = radius_of(&map, index as usize);
                    let d = distance(photon, (p, normal), Some(radius)).unwrap_or(radius);
                    let expected = (1.0 - (d / radius).powi(2)).max(0.0);
                    let kernel = found
                        .iter()
                        .find(|found| found.0 == index)
                        .map_or(0.0, |found| found.1);
                    let ratio = f64::from(kernel) * PI * radius * radius / 2.0;
                    // Rounding moves p by up to 2^-24
                    let error = 1e-6 + 0.5f64.powi(22) / radius;
                    assert!((ratio - expected).abs() < error, "{ratio}, not {expected}");
                }
            }
        }
    }

    #[test]
    fn kernel_integrates_to_one() {
        let map = built(&[photon([0.0; 3], Vec3::Z)], 1, 0.5);
        let mut found = Vec::new();
        // Rings of equal area, π / 4 in all
        let mut sum = 0.0;
        for ring in 0..20_000 {
            let p = DVec3::X * (0.25 * (f64::from(ring) + 0.5) / 20_000.0).sqrt();
            map.covering(p, Vec3::Z, &mut found);
            sum += f64::from(found[0].1);
        }
        let mean = sum / 20_000.0;
        assert!((mean * PI / 4.0 - 1.0).abs() < 1e-6, "{mean}");
    }

    #[test]
    fn plane_receives_the_power_of_its_photons() {
        let mut random = SplitMix64::new(13, 1);
        let mut photon = |_| Photon {
            power: [1.0, random.unit() as f32, random.within(-0.5, 1.0) as f32],
            ..photon([random.unit(), random.unit().powi(2), 0.0], Vec3::Z)
        };
        let photons: Vec<Photon> = (0..500).map(&mut photon).collect();
        let map = built(&photons, 20, 0.25);
        // Integrate over all discs: [-0.25, 1.25]² in 600² cells
        let cell = 1.5 / 600.0;
        let mut found = Vec::new();
        let mut received = DVec3::ZERO;
        for index in 0..600 * 600 {
            let [x, y] = [index % 600, index / 600].map(|i| (f64::from(i) + 0.5) * cell - 0.25);
            map.covering(DVec3::new(x, y, 0.0), Vec3::Z, &mut found);
            for &(index, kernel) in &found {
                received += (kernel * Vec3::from(map.photon(index).power)).as_dvec3() * cell * cell;
            }
        }
        let powers = map.photons.iter().map(|photon| Vec3::from(photon.power));
        let sent: DVec3 = powers.map(Vec3::as_dvec3).sum();
        let error = (received / sent - 1.0).abs().max_element();
        assert!(error < 1e-3, "{received} of {sent}");
    }

    #[test]
    fn map_is_the_same_for_any_number_of_threads() {
        let photons = corner_photons(10_000, &mut SplitMix64::new(14, 1));
        let origin = |(index, photon): (usize, &Photon)| {
            (index % 4 != 0).then_some(PhotonOrigin {
                emitted: photon.position,
                group: [0, 1, index as u32 % 2, 0],
            })
        };
        let origins: Vec<_> = photons.iter().enumerate().map(origin).collect();
        let built = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let map = parallel::install(&pool.build().unwrap(), || {
                PhotonMap::new(&photons, &origins, 8, 0.1)
            });
            // Printed numbers are exact
            format!("{map:?}")
        };
        let alone = built(1);
        assert!([2, 7].into_iter().all(|threads| built(threads) == alone));
    }

    #[test]
    fn degenerate_maps_have_finite_kernels() {
        let at = |p: [f64; 3]| photon(p, Vec3::Z);
        let line =
            |scale: f64| -> Vec<Photon> { (0..100).map(|i| at([scale * f64::from(i), 0.0, 0.0])).collect() };
        let sets = [
            vec![at([f64::NAN, 0.0, 0.0]), at([0.0, f64::INFINITY, 0.0])],
            vec![at([1.0, 2.0, 3.0])],
            vec![at([0.0; 3]), at([1.0, 0.0, 0.0])],
            vec![at([0.0; 3]); 100],
            vec![at([1e6, -1e6, 1e6]); 100],
        ];
        let lines = [1e-30, 1e-6, 1e6].map(line);
        let rules = [(0, 1.0), (4, 1.0), (200, 1.0), (4, f32::MIN_POSITIVE), (4, 1e30)];
        let mut found = vec![(7, 7.0)];
        for photons in sets.into_iter().chain(lines) {
            for (neighbours, max_radius) in rules {
                let map = built(&photons, neighbours, max_radius);
                assert_eq!(map.is_empty(), position(&photons[0]).is_nan());
                // Each photon covers its own position
                for photon in &map.photons {
                    map.covering(position(photon), Vec3::Z, &mut found);
                    assert!(!found.is_empty() && found.iter().all(|found| found.1.is_finite()));
                }
                for p in [DVec3::NAN, DVec3::INFINITY, DVec3::splat(1e300)] {
                    map.covering(p, Vec3::Z, &mut found);
                    assert!(found.is_empty());
                }
            }
        }
    }
}
