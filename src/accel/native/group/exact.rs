//! Parameters and weights of hits, by the reference test.
//!
//! The group kernel finds which triangle a ray hits first; its depths depend, in their last bits, on the frame of the
//! group. A ray that continues behind a surface starts at the parameter of its hit, and images must not depend on the
//! division into groups. So every hit is computed again as the single-ray kernel computes it, sixteen at a time. Where
//! the reference test misses the triangle, which at an edge it may, it hits a neighbour: the ray is traced alone.

use crate::accel::native::layout::TreeView;
use crate::accel::native::single::{SingleStack, trace_lane};
use crate::accel::native::triangle_run::TriangleRun;
use crate::accel::{LANES, Query, RayPacket};
use crate::mesh::simd::{Float8, SimdLevel, lanes};
use crate::mesh::triangle::ShearLanes;
use crate::numeric::Lanes;

use super::frame::{HALVES, half_mut, splat};
use super::rays::{GroupRays, NO_HIT_NUMBER, SUBS};

/// Structures from which hits are computed again.
#[derive(Clone, Copy)]
pub(super) struct ExactHits<'a, 's> {
    /// Tree that the group traversed.
    pub(super) tree: TreeView<'a>,
    /// Instances of the tree's triangles, by their first numbers.
    pub(super) runs: &'a [TriangleRun<'s>],
}

impl ExactHits<'_, '_> {
    /// Writes the hits of a group into its packets.
    #[inline(always)]
    pub(super) fn write<I: SimdLevel>(
        &self,
        isa: I,
        rays: &GroupRays,
        packets: &mut [RayPacket],
        stack: &mut SingleStack,
    ) {
        let none = splat(isa.wide(), f32::from_bits(NO_HIT_NUMBER));
        for (index, packet) in packets.iter_mut().enumerate() {
            // Find the lanes with hits
            let mut hits = 0;
            let mut numbers = [NO_HIT_NUMBER; LANES];
            for h in 0..HALVES {
                let sub = (HALVES * index + h) % SUBS;
                let is_hit = Float8::load_u32(isa.wide(), &rays.numbers[sub]).lt_i32(none);
                hits |= (is_hit.bits() & rays.taken[sub]) << (8 * h);
                *half_mut(&mut numbers, h) = rays.numbers[sub];
            }
            if hits == 0 {
                continue;
            }
            // Compute them again, and trace the rays that miss their triangle
            let missed = self.recompute(isa, packet, hits, &numbers);
            for lane in lanes(missed) {
                trace_lane(isa, self.tree, packet, lane % LANES, Query::Nearest, stack);
            }
        }
    }

    /// Writes the hits of the lanes in `hits` on the triangles of these numbers. Returns the lanes whose ray misses its
    /// triangle.
    #[inline(always)]
    fn recompute(&self, isa: impl SimdLevel, packet: &mut RayPacket, hits: u32, numbers: &Lanes<u32>) -> u32 {
        // Fetch the triangles; lanes without a hit take that of any other, which avoids branches
        let any = numbers[hits.trailing_zeros() as usize % LANES];
        let mut corners = [[[0.0; LANES]; 3]; 3];
        for lane in 0..LANES {
            let number = if hits >> lane & 1 != 0 { numbers[lane] } else { any };
            let vertices = TriangleRun::corners(self.runs, number);
            for corner in 0..3 {
                for axis in 0..3 {
                    corners[corner][axis][lane] = vertices[corner][axis];
                }
            }
        }
        // Intersect each ray with its triangle
        let shears = ShearLanes::of_each(isa, &packet.origin, &packet.direction);
        let exact = shears.intersect_each(isa, &corners, &packet.t_near, &packet.t_far);
        let found = exact.mask & hits;
        // Store the hits; the instance follows from the number
        for lane in 0..LANES {
            let is_found = found >> lane & 1 != 0;
            let choose = |new: f32, old: f32| if is_found { new } else { old };
            packet.t_far[lane] = choose(exact.t[lane], packet.t_far[lane]);
            packet.u[lane] = choose(exact.u[lane], packet.u[lane]);
            packet.v[lane] = choose(exact.v[lane], packet.v[lane]);
            packet.primitive[lane] = if is_found {
                numbers[lane]
            } else {
                packet.primitive[lane]
            };
            packet.instance[lane] = if is_found { 0 } else { packet.instance[lane] };
        }
        hits & !found
    }
}

#[cfg(test)]
mod tests {
    use super::super::intersect;
    use crate::accel::native::build::build_tree;
    use crate::accel::native::single;
    use crate::accel::native::testing::RandomNumbers;
    use crate::accel::native::triangle_run::TriangleRun;
    use crate::accel::{LANES, Query, RayPacket};
    use crate::mesh::bumpy_sphere;
    use crate::numeric::Ray;
    use glam::Vec3;

    #[test]
    fn hits_of_groups_have_the_bits_of_single_rays() {
        let mesh = bumpy_sphere(50_000);
        let tree = build_tree(&[&mesh]).unwrap();
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
        intersect(tree.view(), &[TriangleRun::new(0, 0, &mesh)], &mut actual, origin);
        single::trace(tree.view(), &mut expected, Query::Nearest);
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
