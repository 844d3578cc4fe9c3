//! Sphere intersection in callbacks: the lanes of a packet against one sphere of a cluster after the other, or one ray
//! against all of its spheres at once, with run-time SIMD dispatch.
//!
//! In a packet a sphere is tested in f64 only if some ray may hit it by the f32 test (see `sphere_cull`). Results equal
//! those of [`crate::accel::shape_query::shape_hit`] to the bit. This applies only to spheres that are spheres in world
//! space: for ellipsoids each ray is transformed into object space lane by lane, as for all other shapes.

use super::hit_record::record_hit;
use super::sphere_cluster::{MEMBERS, NumberedSpheres};
use super::sphere_cull::{PacketCull, Sphere32};
use crate::accel::embree::query::ray_packet::{CallbackPacket, active_lanes, ray_of, row};
use crate::accel::shape_query::sphere_at;
use crate::accel::{ACTIVE, Hit, NO_HIT, Query};
use crate::mesh::simd::{SimdKernel, SimdLevel, SimdLimit, lanes};
use crate::numeric::Ray;
use crate::shape::Sphere;

/// Tests the spheres of a cluster in f64, on the exact extension of the f32 rays; returns the mask of lanes with a hit.
#[inline(always)]
pub(super) fn intersect_spheres<const W: usize>(
    simd: SimdLimit,
    spheres: NumberedSpheres,
    packet: CallbackPacket,
    active: &[i32; W],
    query_kind: Query,
) -> [i32; W] {
    // Test a packet against one sphere after the other
    if W > 1 {
        return simd.dispatch(SphereClusterKernel {
            spheres,
            packet,
            active,
            query_kind,
        });
    }
    // Test a single ray against all spheres at once
    let (origin, direction) = (
        packet.vectors::<W>(row::ORIGIN),
        packet.vectors::<W>(row::DIRECTION),
    );
    let (t_near, t_far) = (packet.floats::<W>(row::T_NEAR), packet.floats::<W>(row::T_FAR));
    let mut hit = [0; W];
    for lane in (0..W).filter(|&lane| active[lane] != 0) {
        let ray = &ray_of(&origin, &direction, (t_near[lane], t_far[lane], 0.0), lane);
        if let Some(found) = simd.dispatch(SphereClusterRay { spheres, ray }) {
            hit[lane] = record_hit(packet, lane, t_far[lane], &found, query_kind);
        }
    }
    hit
}

/// SIMD kernel for the spheres of a cluster against the active lanes of a packet; returns the mask of hits.
struct SphereClusterKernel<'a, const W: usize> {
    spheres: NumberedSpheres<'a>,
    packet: CallbackPacket,
    active: &'a [i32; W],
    query_kind: Query,
}

impl<const W: usize> SimdKernel for SphereClusterKernel<'_, W> {
    type Output = [i32; W];

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) -> [i32; W] {
        let (packet, query_kind) = (self.packet, self.query_kind);
        // Load the rays for culling
        let (origin, direction) = (packet.vectors(row::ORIGIN), packet.vectors(row::DIRECTION));
        // Cull the sphere if all active rays surely miss it in f32
        let mut cull = PacketCull::<W>::of(origin, direction, packet.floats(row::T_FAR));
        let (mut active, mut hit) = (*self.active, [0; W]);
        for member in 0..MEMBERS {
            let Some(sphere) = &self.spheres.cluster.sphere(member) else {
                break;
            };
            let missed = cull.miss_mask(isa, &Sphere32::of(sphere));
            if active_lanes(isa, &active) & !missed == 0 {
                continue;
            }
            // Intersect the sphere in f64
            let is_hit = SphereKernel {
                sphere,
                instance: self.spheres.instances[member],
                primitive: self.spheres.primitives[member],
                packet,
                active: &active,
                query_kind,
            }
            .run(isa);
            for lane in 0..W {
                hit[lane] |= is_hit[lane];
            }
            // Shorten the rays, or drop the occluded ones
            match query_kind {
                Query::Nearest => cull.end_at(packet.floats(row::T_FAR)),
                Query::Any => {
                    for lane in 0..W {
                        active[lane] &= !is_hit[lane];
                    }
                }
            }
        }
        hit
    }
}

/// SIMD kernel for one world-space sphere against the active lanes of a packet; returns the mask of hits.
pub(super) struct SphereKernel<'a, const W: usize> {
    pub(super) sphere: &'a Sphere,
    pub(super) instance: u32,
    /// Index of the sphere within its instance.
    pub(super) primitive: u32,
    pub(super) packet: CallbackPacket,
    pub(super) active: &'a [i32; W],
    pub(super) query_kind: Query,
}

#[inline(always)]
fn widened<const W: usize>(v: &[f32; W]) -> [f64; W] {
    let mut wide = [0.0; W];
    for lane in 0..W {
        wide[lane] = f64::from(v[lane]);
    }
    wide
}

#[inline(always)]
fn load<const W: usize>(packet: CallbackPacket, first: usize) -> [[f64; W]; 3] {
    [
        widened(&packet.floats(first)),
        widened(&packet.floats(first + 1)),
        widened(&packet.floats(first + 2)),
    ]
}

impl<const W: usize> SimdKernel for SphereKernel<'_, W> {
    type Output = [i32; W];

    #[inline(always)]
    fn run<I: SimdLevel>(self, _isa: I) -> [i32; W] {
        let packet = self.packet;
        let (origin, direction) = (load(packet, row::ORIGIN), load(packet, row::DIRECTION));
        let t_near = widened(&packet.floats(row::T_NEAR));
        let exact = self
            .sphere
            .nearest_lanes(&origin, &direction, &t_near, &[f64::INFINITY; W]);
        self.record(&exact)
    }
}

impl<const W: usize> SphereKernel<'_, W> {
    /// Records the hits of one sphere at the parameters `exact` and returns the mask of lanes with a hit.
    #[inline(always)]
    fn record(&self, exact: &[f64; W]) -> [i32; W] {
        let t_far: [f32; W] = self.packet.floats(row::T_FAR);
        let (mut t, mut hit) = ([0.0f32; W], [0i32; W]);
        let mut any = 0;
        for lane in 0..W {
            t[lane] = exact[lane] as f32;
            // Comparisons with NaN, which is a miss, are false.
            let is_hit = (t[lane] <= t_far[lane]) & (t[lane] < f32::INFINITY);
            hit[lane] = if is_hit { self.active[lane] } else { 0 };
            any |= hit[lane];
        }
        if any != 0 {
            match self.query_kind {
                Query::Any => self.block(&t_far, &hit),
                Query::Nearest => self.take(&t_far, &t, &mut hit),
            }
        }
        hit
    }

    #[inline(always)]
    fn block(&self, t_far: &[f32; W], hit: &[i32; W]) {
        let mut ends = [0; W];
        for lane in 0..W {
            let end = if hit[lane] != 0 {
                f32::NEG_INFINITY
            } else {
                t_far[lane]
            };
            ends[lane] = end.to_bits();
        }
        self.packet.store(row::T_FAR, ends);
    }

    /// Writes the hits, except in lanes whose equally near hit has a lower index.
    #[inline(always)]
    fn take(&self, t_far: &[f32; W], t: &[f32; W], hit: &mut [i32; W]) {
        let held: [u32; W] = self.packet.load(row::INSTANCE);
        let held_primitive: [u32; W] = self.packet.load(row::PRIMITIVE);
        for lane in 0..W {
            // A lane without a hit holds the highest index.
            let is_lower = (self.instance < held[lane])
                | ((self.instance == held[lane]) & (self.primitive < held_primitive[lane]));
            let is_first = (t[lane] < t_far[lane]) | is_lower;
            hit[lane] = if is_first & (hit[lane] != 0) { ACTIVE } else { 0 };
        }
        let mut ends = [0; W];
        for lane in 0..W {
            ends[lane] = if hit[lane] != 0 { t[lane] } else { t_far[lane] }.to_bits();
        }
        self.packet.store(row::T_FAR, ends);
        self.set(row::U, 0, hit);
        self.set(row::V, 0, hit);
        self.set(row::PRIMITIVE, self.primitive, hit);
        self.set(row::INSTANCE, self.instance, hit);
        self.set(row::LEVEL, NO_HIT, hit);
    }

    #[inline(always)]
    fn set(&self, row: usize, value: u32, hit: &[i32; W]) {
        let mut bits: [u32; W] = self.packet.load(row);
        for lane in 0..W {
            bits[lane] = if hit[lane] != 0 { value } else { bits[lane] };
        }
        self.packet.store(row, bits);
    }
}

/// SIMD kernel for one ray against the spheres of a cluster: nearest hit within its interval, with ties to the lower
/// instance and primitive index.
struct SphereClusterRay<'a> {
    spheres: NumberedSpheres<'a>,
    ray: &'a Ray,
}

impl SimdKernel for SphereClusterRay<'_> {
    type Output = Option<Hit>;

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) -> Option<Hit> {
        let NumberedSpheres {
            cluster,
            instances,
            primitives,
        } = self.spheres;
        let (origin, direction) = (self.ray.origin.as_dvec3(), self.ray.direction.as_dvec3());
        let exact = Sphere::nearest_of(
            &cluster.center,
            &cluster.radius,
            (origin, direction),
            f64::from(self.ray.t_near),
        );
        let mut t = [0.0f32; MEMBERS];
        for member in 0..MEMBERS {
            t[member] = exact[member] as f32;
        }
        // Comparisons with NaN, which is a miss, are false.
        let is_hit = isa.le(&t, &[self.ray.t_far; MEMBERS]) & isa.lt(&t, &[f32::INFINITY; MEMBERS]);
        let mut first: Option<Hit> = None;
        for member in lanes(is_hit) {
            let found = Hit {
                primitive: primitives[member],
                ..sphere_at(instances[member], t[member])
            };
            let number = |hit: &Hit| [hit.instance, hit.primitive];
            if first
                .is_none_or(|held| found.t < held.t || (found.t == held.t && number(&found) < number(&held)))
            {
                first = Some(found);
            }
        }
        first
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DQuat, DVec3, Vec3};

    use super::*;
    use crate::accel::brute::BruteAccel;
    use crate::accel::embree::EmbreeAccel;
    use crate::accel::{Accel, AccelOptions, Coherence, LANES, RayPacket};
    use crate::scene::{Geometry, Instance, Scene};
    use crate::shape::Shape;

    /// Returns a number in [-1, 1) (Weyl's sequence on the golden ratio).
    fn number(i: usize) -> f64 {
        2.0 * (0.5 + i as f64 * 0.618_033_988_749_894_9).fract() - 1.0
    }

    fn vector(i: usize) -> DVec3 {
        DVec3::new(number(3 * i), number(5 * i + 1), number(7 * i + 2))
    }

    /// Builds overlapping spheres, of which in every six three coincide.
    fn scene(count: usize) -> Scene {
        let place = |i: usize| {
            let at = if (i / 3).is_multiple_of(2) { i - i % 3 } else { i };
            let scale = DVec3::splat(0.15 + 0.1 * number(at + 11));
            let map = DAffine3::from_scale_rotation_translation(scale, DQuat::IDENTITY, vector(at));
            Instance::new("", 0, 0, map).unwrap()
        };
        Scene {
            geometries: vec![Geometry::Shape(Shape::Sphere(Sphere::UNIT))],
            instances: (0..count).map(place).collect(),
            ..Scene::default()
        }
    }

    /// Returns sixteen rays with nearby origins and targets and any length, some lanes of them inactive.
    fn packet(i: usize, spread: f32) -> RayPacket {
        let (from, to) = (2.0 * vector(i).as_vec3(), vector(2 * i + 1).as_vec3());
        let mut packet = RayPacket::EMPTY;
        for lane in (0..LANES).filter(|lane| !(i + lane).is_multiple_of(5)) {
            let to = to + spread * vector(i * LANES + lane).as_vec3();
            let mut ray = Ray::new(from + spread * Vec3::splat(number(lane) as f32), to - from);
            if lane % 4 == 1 {
                ray.t_far = number(lane + i).abs() as f32;
            }
            packet.set(lane, &ray);
        }
        packet
    }

    #[test]
    fn sphere_clusters_equal_single_spheres_with_ties_to_lowest_instance() {
        // The first count allows packets in any order; with the second, incoherent rays are traced one by one.
        for count in [40, 400] {
            let scene = scene(count);
            let ours = EmbreeAccel::build(&scene, &AccelOptions::default()).unwrap();
            let reference = BruteAccel::new(&scene);
            for order in [Coherence::Coherent, Coherence::Incoherent] {
                for i in 0..600 {
                    let active = packet(i, [0.01, 0.1, 1.0][i % 3]);
                    let mut found = [active.clone(), active.clone()];
                    ours.intersect(&mut found[..1], order);
                    reference.intersect(&mut found[1..], order);
                    let mut blocked = [active.clone(), active];
                    ours.occluded(&mut blocked[..1], order);
                    reference.occluded(&mut blocked[1..], order);
                    for lane in 0..LANES {
                        let [ours, right] = [0, 1].map(|by| found[by].hit(lane));
                        assert_eq!(ours, right, "{count} spheres, packet {i}, lane {lane}");
                        let [ours, right] = [0, 1].map(|by| blocked[by].t_far[lane].to_bits());
                        assert_eq!(ours, right, "{count} spheres, packet {i}, lane {lane}");
                    }
                }
            }
        }
    }
}
