//! Hierarchical evaluation of the radiant exitance at sixteen points: the dipole times the power of every irradiance
//! sample, or of far octree cells.
//!
//! The points walk the octree together, each with its own choice of near and far cells: what is added to one of them
//! does not depend on the others.

use multiversion::multiversion;

use super::dipole::PointSource;
use super::octree::{IrradianceTree, Moments, OctreeNode};
use crate::numeric::{LANES, Lanes, Lanes3};

/// Radiant exitances of sixteen points.
pub(super) struct ExitancePacket {
    /// Sums of exitances in red, green and blue; in f64, so that the order of thousands of terms costs no digit of f32.
    sums: Lanes3<f64>,
    /// Number of evaluations of the dipole for each point.
    evaluation_counts: Lanes<u32>,
}

/// Walk of sixteen points over the nodes of an octree in depth-first order.
struct Walk {
    /// Index of the node at which each point takes part again, behind the subtree of its last far cell.
    resume: Lanes<u32>,
    /// All bits set for the points that take the current node as a whole.
    far: Lanes<u32>,
    /// All bits set for the points that descend into the current node.
    near: Lanes<u32>,
}

impl IrradianceTree {
    /// Returns the radiant exitances of the points in `mask` in linear red, green and blue: the power that leaves the
    /// medium there per unit of area, in all directions together. Other lanes are zero.
    ///
    /// Allocates no memory. The results have identical bits on every machine, for any number of threads, and whatever
    /// the other lanes are.
    pub fn radiant_exitances(&self, p: &Lanes3<f64>, mask: &Lanes<bool>) -> Lanes3<f32> {
        let packet = gather(self, p, mask);
        packet.sums.map(|channel| channel.map(|sum| sum as f32))
    }
}

/// Sums the exitances of the points in `mask` over the octree.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn gather(tree: &IrradianceTree, p: &Lanes3<f64>, mask: &Lanes<bool>) -> ExitancePacket {
    // Move the points to the origin of the tree
    let mut moved = [[0.0f32; LANES]; 3];
    for axis in 0..3 {
        for l in 0..LANES {
            moved[axis][l] = (p[axis][l] - tree.origin[axis]) as f32;
        }
    }
    // Start all points at the root
    let mut packet = ExitancePacket {
        sums: [[0.0; LANES]; 3],
        evaluation_counts: [0; LANES],
    };
    let mut walk = Walk {
        resume: [0; LANES],
        far: [0; LANES],
        near: [0; LANES],
    };
    for l in 0..LANES {
        walk.resume[l] = if mask[l] { 0 } else { u32::MAX };
    }
    // Walk the octree, skipping the subtrees that are far from all points
    let mut n = 0;
    while let Some(node) = tree.nodes.get(n as usize) {
        let next = walk.visit(&moved, n, node);
        // Represent a far cell by its moments; one without power adds nothing
        if node.far2 >= 0.0 && walk.far.iter().any(|&far| far != 0) {
            packet.add_cell(tree, &moved, &tree.moments[n as usize], &walk.far);
        }
        // Add the points of a near leaf; inner nodes have none
        if node.count > 0 && walk.near.iter().any(|&near| near != 0) {
            packet.add_points(tree, &moved, node, &walk.near);
        }
        n = next;
    }
    packet
}

impl Walk {
    /// Divides the points that take part at node `n` into those for which the cell is far and near. Returns the next
    /// node at which some point takes part.
    #[inline(always)]
    fn visit(&mut self, p: &Lanes3<f32>, n: u32, node: &OctreeNode) -> u32 {
        // Points for which the cell is far go on behind its subtree
        let behind = n + node.node_count;
        let mut next = u32::MAX;
        for l in 0..LANES {
            let takes_part = self.resume[l] <= n;
            let is_far = squared_distance([p[0][l], p[1][l], p[2][l]], node.position) > node.far2;
            self.far[l] = if takes_part & is_far { u32::MAX } else { 0 };
            self.near[l] = if takes_part & !is_far { u32::MAX } else { 0 };
            self.resume[l] = if takes_part & is_far {
                behind
            } else {
                self.resume[l]
            };
            next = next.min(self.resume[l].max(n + 1));
        }
        next
    }
}

impl ExitancePacket {
    /// Adds the exitance from a whole cell to the points in `mask`: from two sources of half its power.
    #[inline(always)]
    fn add_cell(&mut self, tree: &IrradianceTree, p: &Lanes3<f32>, cell: &[Moments; 3], mask: &Lanes<u32>) {
        for (c, moments) in cell.iter().enumerate() {
            let sources = &tree.kernel.0[c];
            let half = 0.5 * moments.power;
            let mut exitance = [0.0; LANES];
            for l in 0..LANES {
                let [nearer, farther] = moments.squared_distances([p[0][l], p[1][l], p[2][l]]);
                exitance[l] = half * reflectance(sources, nearer) + half * reflectance(sources, farther);
            }
            self.add(c, &exitance, mask);
        }
        for l in 0..LANES {
            self.evaluation_counts[l] += 2 & mask[l];
        }
    }

    /// Adds the exitance from the points of a leaf to those in `mask`.
    #[inline(always)]
    fn add_points(&mut self, tree: &IrradianceTree, p: &Lanes3<f32>, leaf: &OctreeNode, mask: &Lanes<u32>) {
        let first = leaf.first as usize;
        for i in first..first + leaf.count as usize {
            let source = [tree.position[0][i], tree.position[1][i], tree.position[2][i]];
            for c in 0..3 {
                let sources = &tree.kernel.0[c];
                let power = tree.power[c][i];
                let mut exitance = [0.0; LANES];
                for l in 0..LANES {
                    let r2 = squared_distance([p[0][l], p[1][l], p[2][l]], source);
                    exitance[l] = power * reflectance(sources, r2);
                }
                self.add(c, &exitance, mask);
            }
            for l in 0..LANES {
                self.evaluation_counts[l] += 1 & mask[l];
            }
        }
    }
}

impl ExitancePacket {
    /// Adds exitances in colour channel `c` to the points in `mask`, in a loop of its own: f32 lanes are twice as wide.
    #[inline(always)]
    fn add(&mut self, c: usize, exitance: &Lanes<f32>, mask: &Lanes<u32>) {
        for l in 0..LANES {
            self.sums[c][l] += f64::from(if mask[l] != 0 { exitance[l] } else { 0.0 });
        }
    }
}

impl Moments {
    /// Returns two squared distances from `p` that have the mean and the variance of those of the cell's points, as far
    /// as second moments determine them.
    #[inline(always)]
    fn squared_distances(&self, p: [f32; 3]) -> [f32; 2] {
        let [x, y, z] = [0, 1, 2].map(|axis| p[axis] - self.position[axis]);
        let m = &self.spread;
        let along = m[0] * x * x + m[1] * y * y + m[2] * z * z + m[3] * x * y + m[4] * y * z + m[5] * z * x;
        let mean = x * x + y * y + z * z + (m[0] + m[1] + m[2]);
        let deviation = 2.0 * along.max(0.0).sqrt();
        [(mean - deviation).max(0.0), mean + deviation]
    }
}

/// Returns the dipole's reflectance per unit of area at the squared distance `r2`, from its source and its image.
#[inline(always)]
fn reflectance([source, image]: &[PointSource; 2], r2: f32) -> f32 {
    source.at(r2) + image.at(r2)
}

/// Returns the squared distance between two points.
#[inline(always)]
fn squared_distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use rayon::prelude::*;

    use super::super::{
        DEFAULT_SOLID_ANGLE, Dipole, IrradianceSample, SubsurfacePreset, SurfaceSample, surface_samples,
    };
    use super::*;

    impl IrradianceTree {
        /// Returns the exitance at one point, and the number of evaluations of the dipole for it.
        fn gather(&self, p: DVec3) -> ([f32; 3], usize) {
            let mut mask = [false; LANES];
            mask[5] = true;
            let mut points = [[f64::NAN; LANES]; 3];
            (0..3).for_each(|axis| points[axis][5] = p[axis]);
            let packet = gather(self, &points, &mask);
            (
                packet.sums.map(|sum| sum[5] as f32),
                packet.evaluation_counts[5] as usize,
            )
        }

        fn radiant_exitance(&self, p: DVec3) -> [f32; 3] {
            self.gather(p).0
        }
    }

    const CENTER: DVec3 = DVec3::new(100.0, -50.0, 7.0);

    /// Returns points of the unit sphere, evenly spread (a spiral of the golden angle).
    fn sphere_points(count: usize) -> impl Iterator<Item = DVec3> {
        (0..count).map(move |i| {
            let z = 1.0 - (2 * i + 1) as f64 / count as f64;
            let turn = (i as f64 * 2.399_963_229_728_653).sin_cos();
            let r = ((1.0 - z) * (1.0 + z)).sqrt();
            DVec3::new(r * turn.1, r * turn.0, z)
        })
    }

    /// Returns samples of a sphere under one light, with the shadow of a bar across it: its unlit half receives
    /// scattered light only.
    fn lit_sphere(count: usize, radius: f64, color: [f32; 3]) -> Vec<IrradianceSample> {
        let light = DVec3::new(2.0, 1.0, 2.0) / 3.0;
        sphere_points(count)
            .map(|n| {
                let lit = if n.x.abs() < 0.1 {
                    0.0
                } else {
                    n.dot(light).max(0.0)
                };
                IrradianceSample {
                    position: radius * n + CENTER,
                    area: 4.0 * std::f64::consts::PI * radius * radius / count as f64,
                    irradiance: color.map(|channel| channel * lit as f32),
                }
            })
            .collect()
    }

    /// Returns the exitance by summing over every point, in f64.
    fn brute_force(samples: &[IrradianceSample], dipole: &Dipole, p: DVec3) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for sample in samples {
            let reflectance = dipole.reflectance_at(sample.position.distance(p));
            (0..3).for_each(|c| sum[c] += reflectance[c] * sample.area * f64::from(sample.irradiance[c]));
        }
        sum
    }

    fn preset(name: &str) -> Dipole {
        Dipole::new(&SubsurfacePreset::named(name).unwrap().scattering).unwrap()
    }

    /// Returns the radius at which a sphere of `count` points is sampled as densely as the dipole requires.
    fn radius_for(count: usize, dipole: &Dipole) -> f64 {
        dipole.sample_spacing() * (count as f64 / (4.0 * std::f64::consts::PI)).sqrt()
    }

    /// Returns the root mean square and the greatest error, and the evaluations per point. Errors are relative to each
    /// point's own exitance, but for the darkest points to a thousandth of the exitance in full light.
    fn errors(samples: &[IrradianceSample], dipole: &Dipole, solid_angle: f64) -> [f64; 3] {
        // Compare every point with brute force, in parallel
        let tree = IrradianceTree::build(samples, dipole, solid_angle);
        let radius = samples[0].position.distance(CENTER);
        let floor = dipole.diffuse_reflectance().map(|reflectance| 1e-3 * reflectance);
        let points: Vec<DVec3> = sphere_points(61).map(|n| CENTER + radius * n).collect();
        let of_point = |&p: &DVec3| {
            let exact = brute_force(samples, dipole, p);
            let (found, evaluations) = tree.gather(p);
            let error = |c: usize| (f64::from(found[c]) - exact[c]).abs() / exact[c].max(floor[c]);
            ([error(0), error(1), error(2)], evaluations)
        };
        let found: Vec<_> = points.par_iter().map(of_point).collect();
        // Summarise errors and evaluations
        let all = || found.iter().flat_map(|f| f.0);
        let squares: f64 = all().map(|e| e * e).sum();
        let evaluations: usize = found.iter().map(|f| f.1).sum();
        [
            (squares / (3 * found.len()) as f64).sqrt(),
            all().fold(0.0, f64::max),
            evaluations as f64 / found.len() as f64,
        ]
    }

    #[test]
    fn the_hierarchy_is_within_a_hundredth_of_brute_force_at_a_tenth_of_its_evaluations() {
        const COUNT: usize = 100_000;
        for name in ["marble", "skimmilk", "ketchup", "spectralon"] {
            let dipole = preset(name);
            let samples = lit_sphere(COUNT, radius_for(COUNT, &dipole), [1.0, 0.8, 0.5]);
            let [rms, most, evaluations] = errors(&samples, &dipole, DEFAULT_SOLID_ANGLE);
            println!("{name}: rms {rms:.2e}, most {most:.2e}, {evaluations:.0} evaluations");
            assert!(most <= 0.002 && rms <= 0.0004, "{name}: {rms} {most}");
            assert!(evaluations <= COUNT as f64 / 50.0, "{name}: {evaluations}");
        }
    }

    #[test]
    fn other_lanes_change_no_bit_of_a_point() {
        let dipole = preset("marble");
        let samples = lit_sphere(20_000, radius_for(20_000, &dipole), [1.0, 0.8, 0.5]);
        let tree = IrradianceTree::build(&samples, &dipole, DEFAULT_SOLID_ANGLE);
        let radius = samples[0].position.distance(CENTER);
        // Take neighbours and points far apart, near and far from the surface
        let points: Vec<DVec3> = (0..LANES)
            .map(|l| {
                let apart = DVec3::new(0.01, 0.0, 0.02) * (l * l) as f64;
                CENTER + radius * (DVec3::Z + apart).normalize() * if l == 9 { 3.0 } else { 1.0 }
            })
            .collect();
        let mut mask = [true; LANES];
        mask[3] = false;
        let lanes = [0, 1, 2].map(|axis| std::array::from_fn(|l| points[l][axis]));
        let together = tree.radiant_exitances(&lanes, &mask);
        for l in 0..LANES {
            let alone = if mask[l] {
                tree.radiant_exitance(points[l])
            } else {
                [0.0; 3]
            };
            assert_eq!(
                together.map(|channel| channel[l].to_bits()),
                alone.map(f32::to_bits),
                "{l}"
            );
        }
    }

    #[test]
    fn a_finer_solid_angle_is_the_more_exact_and_none_is_brute_force() {
        let dipole = preset("skin1");
        let samples = lit_sphere(20_000, radius_for(20_000, &dipole), [1.0; 3]);
        let [coarse, middle, fine] = [0.8, 0.2, 0.05].map(|angle| errors(&samples, &dipole, angle)[0]);
        assert!(
            4.0 * middle < coarse && 4.0 * fine < middle,
            "{coarse} {middle} {fine}"
        );
        let [_, most, evaluations] = errors(&samples, &dipole, 0.0);
        // Half of the points are unlit and skipped, except for those in leaves with lit ones.
        assert!(most <= 1e-5 && evaluations <= 20_000.0, "{most} {evaluations}");
    }

    #[test]
    fn lights_of_two_colours_on_two_sides_keep_their_colours() {
        let dipole = preset("marble");
        let radius = radius_for(20_000, &dipole);
        let mut samples = lit_sphere(20_000, radius, [1.0, 0.5, 0.0]);
        for sample in &mut samples {
            let n = (sample.position - CENTER) / radius;
            sample.irradiance[2] = (-n.x).max(0.0) as f32;
        }
        let [rms, most, _] = errors(&samples, &dipole, DEFAULT_SOLID_ANGLE);
        assert!(rms <= 0.0002 && most <= 0.0005, "{rms} {most}");
    }

    #[test]
    fn a_half_space_in_even_light_sends_back_its_diffuse_reflectance() {
        let dipole = preset("skin1");
        let at = |x: f64, y: f64| 40.0 * DVec3::new(x, y, 0.0);
        // Sample and light a square far larger than the mean free path
        let triangles = [
            [at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0)],
            [at(-1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)],
        ];
        let surface = surface_samples(2, |t| triangles[t], 0.5 * dipole.sample_spacing());
        let lit = |sample: &SurfaceSample| IrradianceSample {
            position: sample.position,
            area: sample.area,
            irradiance: [2.0; 3],
        };
        let samples: Vec<_> = surface.samples.iter().map(lit).collect();
        let tree = IrradianceTree::build(&samples, &dipole, DEFAULT_SOLID_ANGLE);
        let (least, most) = (dipole.reflectance_within(30.0), dipole.diffuse_reflectance());
        let mut mean = [0.0; 3];
        // Compare points near the centre with the closed form
        for i in 0..200 {
            let [x, y] = [0.7548, 0.5698].map(|step| (f64::from(i) * step).fract() - 0.5);
            let found = tree.radiant_exitance(20.0 * DVec3::new(x, y, 0.0));
            for c in 0..3 {
                let reflectance = 0.5 * f64::from(found[c]);
                mean[c] += reflectance / 200.0;
                // Noise of points at this spacing, for the most absorbing channel.
                let noise = 0.04 * most[c];
                assert!(
                    (least[c] - noise..most[c] + noise).contains(&reflectance),
                    "{found:?}"
                );
            }
        }
        for c in 0..3 {
            assert!((mean[c] / most[c] - 1.0).abs() <= 0.002, "{mean:?} {most:?}");
        }
    }

    #[test]
    fn subsurface_transport_is_reciprocal() {
        let dipole = preset("wholemilk");
        let (here, there) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(1.5, 1.0, 2.0));
        let leaves = |from: DVec3, to: DVec3| {
            let sample = IrradianceSample {
                position: from,
                area: 0.1,
                irradiance: [3.0; 3],
            };
            IrradianceTree::build(&[sample], &dipole, DEFAULT_SOLID_ANGLE).radiant_exitance(to)
        };
        assert_eq!(leaves(here, there), leaves(there, here));
        // Expected exitance: 3 · 0.1 · R_d(1.5).
        let exact = dipole.reflectance_at(1.5).map(|reflectance| 0.3 * reflectance);
        for c in 0..3 {
            let found = f64::from(leaves(here, there)[c]);
            assert!((found / exact[c] - 1.0).abs() <= 1e-5, "{found} {exact:?}");
        }
    }

    #[test]
    fn unlit_or_empty_media_are_dark_without_evaluations() {
        let dipole = preset("marble");
        let dark = lit_sphere(1000, 1.0, [0.0; 3]);
        for samples in [&dark[..], &[]] {
            let tree = IrradianceTree::build(samples, &dipole, DEFAULT_SOLID_ANGLE);
            assert_eq!(tree.gather(CENTER), ([0.0; 3], 0));
            assert_eq!(tree.sample_count(), samples.len());
        }
    }

    #[test]
    fn coincident_points_count_separately() {
        let sample = |i: usize| IrradianceSample {
            position: DVec3::splat((i / 100) as f64),
            area: 0.5,
            irradiance: [1.0; 3],
        };
        let samples: Vec<_> = (0..200).map(sample).collect();
        let dipole = preset("marble");
        let found =
            IrradianceTree::build(&samples, &dipole, DEFAULT_SOLID_ANGLE).radiant_exitance(DVec3::ZERO);
        let exact = brute_force(&samples, &dipole, DVec3::ZERO);
        for c in 0..3 {
            assert!((f64::from(found[c]) / exact[c] - 1.0).abs() <= 1e-5);
        }
    }
}
