//! Triangle-cluster intersection in callbacks: one ray against all triangles of a cluster at once, or all rays of a
//! packet against one triangle after the other, with run-time SIMD dispatch.
//!
//! Results equal those of [`Shear::intersect`], and so of brute force, to the bit, except that a zero parameter is
//! always +0, as Embree compares the ends of rays by their bits.

use std::mem::MaybeUninit;

use super::hit_record::{number_of, record_hit};
use super::triangle_cluster::{CORNERS, MEMBERS, TriangleCluster};
use crate::accel::embree::query::ray_packet::{CallbackPacket, active_lanes, row};
use crate::accel::{ACTIVE, Hit, NO_HIT, Query};
use crate::mesh::simd::{SimdKernel, SimdLevel, SimdLimit, div, lanes};
use crate::mesh::triangle::{
    HitLanes, LaneAxes, PACK, ProjectedVertices, Shear, ShearLanes, ShearedVertex, dominant_axes,
    may_contain_origin,
};
use crate::numeric::Ray;

/// Maximum fraction of a packet's rays that are tested one by one, each against all triangles at once: a step does
/// eight times as much, after more preparation.
const FEW_RAYS: f32 = 3.0 / 8.0;

/// Tests the triangles of a cluster against a packet and returns the mask of active lanes with a hit.
#[inline(always)]
pub(super) fn intersect_cluster<const W: usize>(
    simd: SimdLimit,
    cluster: TriangleCluster,
    packet: CallbackPacket,
    active: &[i32; W],
    query_kind: Query,
) -> [i32; W] {
    simd.dispatch_sixteen(ClusterKernel {
        cluster,
        packet,
        active,
        query_kind,
    })
}

/// SIMD kernel for the triangles of a cluster against the active lanes of a packet; returns the mask of hits.
struct ClusterKernel<'a, const W: usize> {
    cluster: TriangleCluster<'a>,
    packet: CallbackPacket,
    active: &'a [i32; W],
    query_kind: Query,
}

impl<const W: usize> SimdKernel for ClusterKernel<'_, W> {
    type Output = [i32; W];

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) -> [i32; W] {
        let mut hit = [0; W];
        // SIMD comparisons work on eight values at a time.
        if W < PACK {
            for lane in (0..W).filter(|&lane| self.active[lane] != 0) {
                self.intersect_ray(isa, lane, &mut hit);
            }
            return hit;
        }
        // Test few rays one by one, each against all triangles
        let active = active_lanes(isa, self.active);
        if active.count_ones() <= const { (FEW_RAYS * W as f32) as u32 } {
            for lane in lanes(active) {
                self.intersect_ray(isa, lane % W, &mut hit);
            }
            return hit;
        }
        // Test many against one triangle after the other, in the order of the axes that is theirs
        let origin = self.packet.vectors::<W>(row::ORIGIN);
        let direction = self.packet.vectors::<W>(row::DIRECTION);
        let along = dominant_axes(isa, &direction);
        match along.iter().position(|&lanes| active & !lanes == 0) {
            Some(axis) => {
                let shears = ShearLanes::new(axis, &origin, &direction);
                self.intersect_rays(isa, &shears, active, &mut hit);
            }
            None => {
                let shears = ShearLanes::of_each(&origin, &direction);
                self.intersect_rays(isa, &shears, active, &mut hit);
            }
        }
        hit
    }
}

impl<const W: usize> ClusterKernel<'_, W> {
    /// Tests one ray against all triangles at once.
    #[inline(always)]
    fn intersect_ray<I: SimdLevel>(&self, isa: I, lane: usize, hit: &mut [i32; W]) {
        let of = |row: usize| f32::from_bits(self.packet.load_one(row, lane));
        let vector = |row: usize| glam::Vec3::new(of(row), of(row + 1), of(row + 2));
        let ray = Ray {
            t_near: of(row::T_NEAR),
            t_far: of(row::T_FAR),
            ..Ray::new(vector(row::ORIGIN), vector(row::DIRECTION))
        };
        let found = nearest_of(isa, self.cluster, &ray, self.query_kind);
        if let Some(found) = found {
            hit[lane] = record_hit(self.packet, lane, ray.t_far, &found, self.query_kind);
        }
    }

    /// Tests the rays of the mask `tested` against one triangle after the other.
    #[inline(always)]
    fn intersect_rays<I: SimdLevel, A: LaneAxes<W>>(
        &self,
        isa: I,
        shears: &ShearLanes<W, A>,
        tested: u32,
        hit: &mut [i32; W],
    ) {
        let cluster = self.cluster;
        // Project each vertex of the cluster once for all rays
        let mut projected = [const { MaybeUninit::<ShearedVertex<W>>::uninit() }; CORNERS];
        let [first, second] = cluster.first_blocks();
        let blocks = [first, second, cluster.last().unwrap_or(first)];
        for (index, vertex) in projected.iter_mut().enumerate().take(cluster.corner_count()) {
            vertex.write(shears.sheared_slot(blocks[index / PACK], index % PACK));
        }
        let first = projected.as_ptr().cast::<ShearedVertex<W>>();
        // SAFETY: a triangle's vertex indices are below `corner_count`, and that many elements were written.
        let flat = |corner: usize| unsafe { &*first.wrapping_add(corner) };
        // Find the triangles whose projection may contain the origin for some ray
        let (mut masks, mut members) = ([0u32; MEMBERS], 0u32);
        for member in 0..cluster.member_count() {
            let [a, b, c] = cluster.triangle(member);
            let maybe = may_contain_origin(isa, [&flat(a).projected, &flat(b).projected, &flat(c).projected])
                & tested;
            masks[member] = maybe;
            members |= u32::from(maybe != 0) << member;
        }
        if members == 0 {
            return;
        }
        // Intersect the remaining triangles and keep the nearest hits
        let mut found = TriangleHits::of(self.packet);
        let t_near: [f32; W] = self.packet.floats(row::T_NEAR);
        let mut active = tested;
        for member in lanes(members) {
            let [a, b, c] = cluster.triangle(member);
            let maybe = masks[member] & active;
            let maybe = shears.starting_before(isa, [flat(a), flat(b), flat(c)], maybe);
            if maybe == 0 {
                continue;
            }
            let corners = || [cluster.corner(a), cluster.corner(b), cluster.corner(c)];
            let projected = [flat(a), flat(b), flat(c)];
            let interval = [&t_near, &found.t];
            let new_hits = shears.intersect_sheared(isa, projected, corners, maybe, interval);
            match self.query_kind {
                Query::Nearest => found.merge(isa, &new_hits, cluster, member),
                Query::Any => {
                    found.changed |= new_hits.mask;
                    active &= !new_hits.mask;
                    if active == 0 {
                        break;
                    }
                }
            }
        }
        // Write the hits into Embree's packet
        found.write(self.query_kind);
        for lane in 0..W {
            hit[lane] |= if found.changed >> lane & 1 != 0 { ACTIVE } else { 0 };
        }
    }
}

/// Nearest hits of a packet so far.
struct TriangleHits<const W: usize> {
    packet: CallbackPacket,
    t: [f32; W],
    /// Unnormalized barycentric weights, as in [`HitLanes`].
    weights: [[f32; W]; 2],
    det: [f32; W],
    /// Instance and primitive, valid for lanes in `changed`.
    number: [[u32; W]; 2],
    changed: u32,
}

impl<const W: usize> TriangleHits<W> {
    #[inline(always)]
    fn of(packet: CallbackPacket) -> TriangleHits<W> {
        TriangleHits {
            packet,
            t: packet.floats(row::T_FAR),
            weights: [[0.0; W]; 2],
            det: [1.0; W],
            number: [[0; W]; 2],
            changed: 0,
        }
    }

    /// Records hits within the intervals, except in lanes whose equally near hit has a lower index.
    #[inline(always)]
    fn merge<I: SimdLevel>(
        &mut self,
        isa: I,
        new_hits: &HitLanes<W>,
        cluster: TriangleCluster,
        member: usize,
    ) {
        let number = [cluster.instance(), cluster.primitive(member)];
        let mut taken = new_hits.mask;
        for lane in lanes(new_hits.mask & isa.eq(&new_hits.t, &self.t)) {
            let is_lower = number < self.held(lane % W);
            taken &= !(u32::from(!is_lower) << lane);
        }
        for lane in 0..W {
            let is_taken = taken >> lane & 1 != 0;
            // Adding +0 turns a zero of either sign into +0.
            self.t[lane] = if is_taken {
                new_hits.t[lane] + 0.0
            } else {
                self.t[lane]
            };
            self.det[lane] = if is_taken {
                new_hits.det[lane]
            } else {
                self.det[lane]
            };
            for i in 0..2 {
                let (new, old) = (new_hits.weights[i][lane], self.weights[i][lane]);
                self.weights[i][lane] = if is_taken { new } else { old };
                self.number[i][lane] = if is_taken { number[i] } else { self.number[i][lane] };
            }
        }
        self.changed |= taken;
    }

    /// Returns instance and primitive of a lane's hit; the highest indices if it has none.
    #[inline(always)]
    fn held(&self, lane: usize) -> [u32; 2] {
        if self.changed >> lane & 1 == 0 {
            return number_of(self.packet, lane);
        }
        [self.number[0][lane], self.number[1][lane]]
    }

    /// Writes the changed lanes into Embree's packet.
    #[inline(always)]
    fn write(&self, query_kind: Query) {
        if self.changed == 0 {
            return;
        }
        if query_kind == Query::Any {
            return self.write_row(row::T_FAR, [f32::NEG_INFINITY.to_bits(); W]);
        }
        self.write_row(row::T_FAR, bits_of(&self.t));
        self.write_row(row::U, bits_of(&div(&self.weights[0], &self.det)));
        self.write_row(row::V, bits_of(&div(&self.weights[1], &self.det)));
        self.write_row(row::INSTANCE, self.number[0]);
        self.write_row(row::PRIMITIVE, self.number[1]);
        self.write_row(row::LEVEL, [NO_HIT; W]);
    }

    #[inline(always)]
    fn write_row(&self, row: usize, values: [u32; W]) {
        let mut bits: [u32; W] = self.packet.load(row);
        for lane in 0..W {
            let is_new = self.changed >> lane & 1 != 0;
            bits[lane] = if is_new { values[lane] } else { bits[lane] };
        }
        self.packet.store(row, bits);
    }
}

#[inline(always)]
fn bits_of<const W: usize>(values: &[f32; W]) -> [u32; W] {
    let mut bits = [0; W];
    for lane in 0..W {
        bits[lane] = values[lane].to_bits();
    }
    bits
}

/// Returns the nearest hit of a ray with a cluster within its interval, with ties to the lowest index, or any hit for
/// [`Query::Any`].
#[inline(always)]
fn nearest_of<I: SimdLevel>(isa: I, cluster: TriangleCluster, ray: &Ray, query_kind: Query) -> Option<Hit> {
    // Project the vertices into the ray's sheared frame
    let shear = Shear::new(ray);
    let [first, second] = cluster.first_blocks();
    let first = shear.flatten(first);
    // Clusters of eight vertices are common: those of boxes.
    let mut maybe = if cluster.corner_count() <= PACK {
        may_hold(isa, cluster, &first)
    } else {
        let second = shear.flatten(second);
        match cluster.last() {
            None => may_hold(isa, cluster, &joined::<2, 16>([first, second])),
            Some(last) => may_hold(
                isa,
                cluster,
                &joined::<3, CORNERS>([first, second, shear.flatten(last)]),
            ),
        }
    };
    // Clear the bits of unused slots: their degenerate triangles are hit by no ray but may pass the conservative test
    maybe &= (1 << cluster.member_count()) - 1;
    // Intersect the candidates in order
    let mut best: Option<Hit> = None;
    for member in lanes(maybe) {
        let [a, b, c] = cluster.triangle(member);
        let corners = [cluster.corner(a), cluster.corner(b), cluster.corner(c)];
        let t_far = best.map_or(ray.t_far, |best| best.t);
        let Some(crossing) = shear.intersect(corners, ray.t_near, t_far) else {
            continue;
        };
        let found = Hit {
            instance: cluster.instance(),
            primitive: cluster.primitive(member),
            t: crossing.t + 0.0,
            u: crossing.u,
            v: crossing.v,
        };
        if query_kind == Query::Any {
            return Some(found);
        }
        if best.is_none_or(|best| found.t < best.t || found.primitive < best.primitive) {
            best = Some(found);
        }
    }
    best
}

/// Concatenates blocks of projected vertices.
#[inline(always)]
fn joined<const M: usize, const N: usize>(blocks: [ProjectedVertices<PACK>; M]) -> ProjectedVertices<N> {
    let mut all = [[0.0; N]; 2];
    for (number, block) in blocks.iter().enumerate() {
        for i in 0..2 {
            all[i][PACK * number..PACK * (number + 1)].copy_from_slice(&block[i]);
        }
    }
    all
}

/// Returns a mask of candidates: bit `i` is set if the ray may hit triangle `i`, given the projected vertices.
#[inline(always)]
fn may_hold<I: SimdLevel, const N: usize>(
    isa: I,
    cluster: TriangleCluster,
    [x, y]: &ProjectedVertices<N>,
) -> u32 {
    if is_aside(isa, x) || is_aside(isa, y) {
        return 0;
    }
    // Gather the vertices of eight triangles at a time and test the signs of their edge functions
    let mut maybe = 0;
    for first in (0..MEMBERS).step_by(PACK) {
        if first >= cluster.member_count() {
            break;
        }
        let mut index = [[0u32; PACK]; 3];
        for row in 0..3 {
            for i in 0..PACK {
                index[row][i] = u32::from(cluster.triangles()[row][first + i]);
            }
        }
        let [a, b, c] = &index;
        let a = [isa.permute(x, a), isa.permute(y, a)];
        let b = [isa.permute(x, b), isa.permute(y, b)];
        let c = [isa.permute(x, c), isa.permute(y, c)];
        maybe |= may_contain_origin(isa, [&a, &b, &c]) << first;
    }
    maybe
}

/// Returns whether all coordinates are on one side of zero. No triangle of such vertices contains the origin, as the
/// signs of edge functions are exact.
#[inline(always)]
fn is_aside<I: SimdLevel, const N: usize>(isa: I, all: &[f32; N]) -> bool {
    let zero = [0.0; N];
    let whole = u32::MAX >> (u32::BITS as usize - N);
    isa.lt(all, &zero) == whole || isa.lt(&zero, all) == whole
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3, Vec3};

    use super::*;
    use crate::accel::embree::EmbreeAccel;
    use crate::accel::embree::origin_bound::unpadded;
    use crate::accel::{Accel, AccelOptions, Coherence, LANES, Precision, RayPacket};
    use crate::buffer::Buffer;
    use crate::mesh::Mesh;
    use crate::scene::{Geometry, Instance, Scene};

    /// Builds a closed sphere-like mesh of 8 n² triangles around a point: a subdivided octahedron with displaced
    /// vertices.
    fn ball(n: i32, middle: DVec3) -> Scene {
        let mut positions = Vec::new();
        let mut triangles = Vec::new();
        let mut number = std::collections::HashMap::new();
        let mut corner = |p: [i32; 3]| {
            // Displace each lattice point of the octahedron from the centre, once per shared vertex
            *number.entry(p).or_insert_with(|| {
                let direction = DVec3::from_array(p.map(f64::from)).normalize();
                let height = 1.0 + 0.1 * (9.0 * direction.x + 4.0 * direction.y - 7.0 * direction.z).sin();
                positions.push((middle + height * direction).as_vec3().to_array());
                positions.len() as u32 - 1
            })
        };
        // Triangulate the eight faces
        for octant in 0..8 {
            let sign = |axis: i32| if octant >> axis & 1 == 0 { 1 } else { -1 };
            let mut at = |i: i32, j: i32| corner([sign(0) * i, sign(1) * j, sign(2) * (n - i - j)]);
            for i in 0..n {
                for j in 0..n - i {
                    triangles.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
                    if i + j < n - 1 {
                        triangles.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                    }
                }
            }
        }
        let mesh = Mesh {
            positions: Buffer::from(positions),
            triangles: Buffer::from(triangles),
            ..Mesh::default()
        };
        Scene {
            geometries: vec![Geometry::Mesh(mesh)],
            instances: vec![Instance::new("", 0, 0, DAffine3::IDENTITY).unwrap()],
            ..Scene::default()
        }
    }

    /// Counts rays that miss the mesh, of `rounds` rays from near the middle to each vertex.
    fn leaks(accel: &EmbreeAccel, scene: &Scene, (middle, rounds): (DVec3, usize)) -> usize {
        let Geometry::Mesh(mesh) = &scene.geometries[0] else {
            unreachable!("the scene is of a mesh")
        };
        let mut leaks = 0;
        for (number, targets) in mesh.positions.repeat(rounds).chunks(LANES).enumerate() {
            let mut packet = RayPacket::EMPTY;
            for (lane, &target) in targets.iter().enumerate() {
                let part = |i: usize| {
                    0.2 * ((number * LANES + lane) as f64 * [0.819_172, 0.671_044, 0.549_700][i]).fract()
                        - 0.1
                };
                let origin = (middle + DVec3::new(part(0), part(1), part(2))).as_vec3();
                let direction = Vec3::from(target).as_dvec3() - origin.as_dvec3();
                packet.set(lane, &Ray::new(origin, direction.as_vec3()));
            }
            let mut packets = [packet];
            accel.intersect(&mut packets, Coherence::Coherent);
            leaks += (0..targets.len())
                .filter(|&lane| packets[0].hit(lane).is_none())
                .count();
        }
        leaks
    }

    #[test]
    fn rays_leak_only_where_boxes_are_not_padded() {
        let options = AccelOptions {
            precision: Precision::Watertight,
            ..AccelOptions::default()
        };
        let middle = DVec3::new(10.0, 3.7, -5.5);
        let scene = ball(40, middle);
        let build = || EmbreeAccel::build(&scene, &options).unwrap();
        assert!(leaks(&unpadded(build), &scene, (middle, 4)) > 0);
        assert_eq!(leaks(&build(), &scene, (middle, 4)), 0);
    }
}
