//! Parameters and weights of hits, by the reference test.
//!
//! The group kernel finds which triangle a ray hits first; its depths depend, in their last bits, on the frame of the
//! group. A ray that continues behind a surface starts at the parameter of its hit, and images must not depend on the
//! division into groups. So every hit is computed again as the single-ray kernel computes it, sixteen at a time. Where
//! the reference test misses the triangle, which at an edge it may, it hits a neighbour: the ray is traced alone.

use super::layout::GroupTree;
use super::single::{SingleStack, trace_lane};
use super::triangle_run::TriangleRun;
use crate::accel::{LANES, NO_HIT, Query, RayPacket};
use crate::mesh::simd::{SimdKernel, SimdLevel, lanes};
use crate::mesh::triangle::{ShearLanes, dominant_axis};
use crate::numeric::Lanes;

/// Packets whose hits are computed again.
pub(super) struct ExactHits<'a, 's> {
    /// Tree that the group traversed.
    pub(super) tree: &'a GroupTree,
    /// Instances of the tree's triangles, by their first numbers.
    pub(super) runs: &'a [TriangleRun<'s>],
    /// Packets with the numbers of the triangles that were hit.
    pub(super) packets: &'a mut [RayPacket],
    /// Ends of the rays' intervals before the query, by packet.
    pub(super) t_far: &'a [Lanes<f32>],
}

impl SimdKernel for ExactHits<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) {
        let mut stack = None;
        for (packet, t_far) in self.packets.iter_mut().zip(self.t_far) {
            // Find the lanes with hits
            let mut hits = 0;
            for lane in 0..LANES {
                let is_hit = (packet.active[lane] != 0) & (packet.instance[lane] != NO_HIT);
                hits |= u32::from(is_hit) << lane;
            }
            if hits == 0 {
                continue;
            }
            // Compute them again, and trace the rays that miss their triangle
            let missed = recompute(isa, self.runs, packet, hits, t_far);
            for lane in lanes(missed) {
                let stack = stack.get_or_insert_with(SingleStack::new);
                packet.t_far[lane] = t_far[lane];
                packet.clear_hit(lane);
                trace_lane(isa, self.tree, packet, lane, Query::Nearest, stack);
            }
        }
    }
}

/// Computes the hits of the lanes in `hits` again. Returns the lanes whose ray misses its triangle.
#[inline(always)]
fn recompute(
    isa: impl SimdLevel,
    runs: &[TriangleRun],
    packet: &mut RayPacket,
    hits: u32,
    t_far: &Lanes<f32>,
) -> u32 {
    // Fetch the triangles, and sort the rays by their dominant axes
    let mut corners = [[[f32::NAN; LANES]; 3]; 3];
    let mut by_axis = [0; 3];
    for lane in lanes(hits) {
        let lane = lane % LANES;
        let number = packet.primitive[lane];
        let run = TriangleRun::of(runs, number);
        let vertices = run.mesh.corners(number - run.first);
        for corner in 0..3 {
            for axis in 0..3 {
                corners[corner][axis][lane] = vertices[corner][axis];
            }
        }
        by_axis[dominant_axis(packet.direction.map(|row| row[lane]))] |= 1 << lane;
    }
    // Intersect each ray with its triangle
    let mut missed = 0;
    for axis in 0..3 {
        if by_axis[axis] == 0 {
            continue;
        }
        let shears = ShearLanes::new(axis, &packet.origin, &packet.direction);
        let exact = shears.intersect_each(isa, &corners, &packet.t_near, t_far);
        let found = exact.mask & by_axis[axis];
        missed |= by_axis[axis] & !found;
        // Store the hits
        for lane in 0..LANES {
            let is_found = found >> lane & 1 != 0;
            packet.t_far[lane] = if is_found {
                exact.t[lane]
            } else {
                packet.t_far[lane]
            };
            packet.u[lane] = if is_found { exact.u[lane] } else { packet.u[lane] };
            packet.v[lane] = if is_found { exact.v[lane] } else { packet.v[lane] };
        }
    }
    missed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::native::build::build_tree;
    use crate::accel::native::testing::RandomNumbers;
    use crate::accel::native::{group, single};
    use crate::mesh::bumpy_sphere;
    use crate::mesh::simd::dispatch;
    use crate::numeric::Ray;
    use glam::Vec3;

    #[test]
    fn hits_of_groups_have_the_bits_of_single_rays() {
        let mesh = bumpy_sphere(50_000);
        let tree = build_tree(&[&mesh]).unwrap();
        let runs = [TriangleRun {
            first: 0,
            instance: 0,
            mesh: &mesh,
        }];
        // Aim rays at the cube around the mesh
        let origin = Vec3::new(0.4, 3.0, -0.7);
        let mut random = RandomNumbers(5);
        let mut expected = vec![RayPacket::EMPTY; 2000];
        for packet in &mut expected {
            for lane in 0..LANES {
                packet.set(lane, &Ray::new(origin, random.vector() - origin));
            }
        }
        // Trace them in groups, and one at a time
        let mut actual = expected.clone();
        let t_far: Vec<Lanes<f32>> = actual.iter().map(|packet| packet.t_far).collect();
        group::intersect(&tree, &mut actual, origin);
        dispatch(ExactHits {
            tree: &tree,
            runs: &runs,
            packets: &mut actual,
            t_far: &t_far,
        });
        single::intersect(&tree, &mut expected);
        // Compare the bits, unless a ray through an edge hits the neighbour
        let (mut hit_count, mut tie_count) = (0, 0);
        for (a, b) in expected.iter().zip(&actual) {
            for lane in 0..LANES {
                let (Some(a), Some(b)) = (a.hit(lane), b.hit(lane)) else {
                    assert_eq!(a.hit(lane), b.hit(lane));
                    continue;
                };
                hit_count += 1;
                if a.primitive != b.primitive {
                    tie_count += 1;
                    continue;
                }
                assert_eq!(
                    [a.t, a.u, a.v].map(f32::to_bits),
                    [b.t, b.u, b.v].map(f32::to_bits)
                );
            }
        }
        assert!(hit_count > 10_000, "{hit_count}");
        assert!(1000 * tie_count < hit_count, "{tie_count} of {hit_count}");
    }
}
