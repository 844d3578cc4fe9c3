//! Callbacks from Embree for user geometry: one packet of rays of any width against one primitive.
//!
//! Hits are written into the packet itself, with the index of the scene's instance as geometry ID.

use embree_sys as sys;
use glam::DAffine3;

use super::hit_record::record_hit;
use super::point_cluster::PlacedPoints;
use super::primitives::{Primitive, UserGeometry};
use super::sphere_cluster::{MEMBERS, NumberedSpheres};
use super::sphere_test::{SphereKernel, intersect_spheres};
use super::triangle_test::intersect_cluster;
use crate::accel::embree::query::ray_packet::{CallbackPacket, Lanes, hit_of, ray_of, row};
use crate::accel::embree::query::trace::new_query;
use crate::accel::embree::scene::SceneRef;
use crate::accel::shape_query::{point_hit, shape_hit, world_sphere};
use crate::accel::{Coherence, Hit, NO_HIT, Query};
use crate::mesh::simd::{SimdLimit, lanes};
use crate::numeric::{Ray, object_ray};
use crate::scene::{Geometry, Instance};
use crate::shape::Shape;

/// Writes the bounding box of one primitive for Embree's build.
pub(in crate::accel::embree) unsafe extern "C" fn on_bounds(args: *const sys::RTCBoundsFunctionArguments) {
    // SAFETY: Embree's arguments live for this call.
    let args = unsafe { &*args };
    // SAFETY: the pointer is that set by `attach_user`, and `EmbreeAccel` keeps its target while the scene lives.
    let user = unsafe { &*args.geometryUserPtr.cast::<UserGeometry>() };
    let mut bounds = EMPTY_BOX;
    user.guarded(|| {
        bounds = user
            .bounds(args.primID as usize, args.timeStep)
            .unwrap_or(EMPTY_BOX)
    });
    let (low, high) = bounds;
    let bounds = sys::RTCBounds {
        lower_x: low[0],
        lower_y: low[1],
        lower_z: low[2],
        align0: 0.0,
        upper_x: high[0],
        upper_y: high[1],
        upper_z: high[2],
        align1: 0.0,
    };
    // SAFETY: Embree provides memory for one box.
    unsafe { args.bounds_o.write(bounds) };
}

/// Empty box, which makes Embree skip the primitive.
const EMPTY_BOX: ([f32; 3], [f32; 3]) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);

/// Finds the nearest hit of the packet's rays with one primitive.
pub(in crate::accel::embree) unsafe extern "C" fn on_intersect(
    args: *const sys::RTCIntersectFunctionNArguments,
) {
    // SAFETY: Embree's arguments live for this call.
    let args = unsafe { &*args };
    let call = CallbackArgs {
        valid: args.valid,
        rays: args.rayhit.cast(),
        count: args.N as usize,
        primitive: args.primID as usize,
        query: args.context.cast(),
    };
    // SAFETY: as in `on_bounds`.
    let user = unsafe { &*args.geometryUserPtr.cast::<UserGeometry>() };
    call.run(user, Query::Nearest);
}

/// Tests whether the packet's rays hit one primitive.
pub(in crate::accel::embree) unsafe extern "C" fn on_occluded(
    args: *const sys::RTCOccludedFunctionNArguments,
) {
    // SAFETY: Embree's arguments live for this call.
    let args = unsafe { &*args };
    let call = CallbackArgs {
        valid: args.valid,
        rays: args.ray.cast(),
        count: args.N as usize,
        primitive: args.primID as usize,
        query: args.context.cast(),
    };
    // SAFETY: as in `on_bounds`.
    let user = unsafe { &*args.geometryUserPtr.cast::<UserGeometry>() };
    call.run(user, Query::Any);
}

/// Maximum number of active lanes that are tested one by one.
const FEW_LANES: u32 = 2;

/// Arguments of one callback: `count` lanes against one primitive.
struct CallbackArgs {
    valid: *mut i32,
    rays: *mut u32,
    count: usize,
    primitive: usize,
    /// Context that Embree passes back; it is the first field of the query that the trace call was given.
    query: *mut sys::EmbreeQuery,
}

impl CallbackArgs {
    fn run(&self, user: &UserGeometry, query_kind: Query) {
        let mut first = 0;
        while first < self.count {
            // Embree's own packet widths take one step each; other counts take several.
            first += match self.count - first {
                16.. => self.intersect_lanes::<16>(user, first, query_kind),
                8.. => self.intersect_lanes::<8>(user, first, query_kind),
                4.. => self.intersect_lanes::<4>(user, first, query_kind),
                _ => self.block::<1>(user, first, query_kind),
            };
        }
    }

    /// Tests lanes `first .. first + W` and returns `W`. For incoherent rays Embree activates one lane of a wide packet
    /// at a time, so few active lanes are tested without loading the others.
    #[inline(always)]
    fn intersect_lanes<const W: usize>(&self, user: &UserGeometry, first: usize, query_kind: Query) -> usize {
        // SAFETY: Embree passes `count` values, and `first + W` is at most `count`.
        let active = unsafe { self.valid.wrapping_add(first).cast::<[i32; W]>().read_unaligned() };
        let mut mask = 0u32;
        for lane in 0..W {
            mask |= u32::from(active[lane] != 0) << lane;
        }
        if mask.count_ones() > FEW_LANES {
            return self.block::<W>(user, first, query_kind);
        }
        for lane in lanes(mask) {
            self.block::<1>(user, first + lane, query_kind);
        }
        W
    }

    /// Tests lanes `first .. first + W` and returns `W`.
    #[inline(always)]
    fn block<const W: usize>(&self, user: &UserGeometry, first: usize, query_kind: Query) -> usize {
        let valid = self.valid.wrapping_add(first);
        // SAFETY: Embree passes `count` values, and `first + W` is at most `count`.
        let active = unsafe { valid.cast::<[i32; W]>().read_unaligned() };
        // SAFETY: this callback has exclusive access to Embree's packet of `count` lanes while it runs.
        let packet = unsafe { CallbackPacket::new(self.rays, self.count, first) };
        // Dispatch on the kind of primitive; a panic must not unwind into Embree
        let mut hit = [0; W];
        let done = user.guarded(|| {
            hit = match user.primitive(self.primitive) {
                Some(Primitive::Spheres(spheres)) => {
                    intersect_spheres::<W>(user.simd(), spheres, packet, &active, query_kind)
                }
                Some(Primitive::TriangleCluster(cluster)) => {
                    intersect_cluster::<W>(user.simd(), cluster, packet, &active, query_kind)
                }
                Some(Primitive::Instance(index, instance)) => {
                    self.intersect_instance::<W>(user, (index, instance), (packet, &active), query_kind)
                }
                Some(Primitive::Points(points)) => {
                    intersect_points::<W>(user.simd(), points, packet, &active, query_kind)
                }
                None => [0; W],
            };
        });
        // Treat a panicked callback as a miss of all lanes
        if !done {
            hit = [0; W];
        }
        // SAFETY: both pointers are valid for `W` values: `first + W` is at most `count`, and `hit` has `W` elements.
        unsafe { sys::embree_report_lanes(valid, hit.as_ptr(), W as u32) };
        W
    }
}

impl CallbackArgs {
    #[inline(always)]
    fn intersect_instance<const W: usize>(
        &self,
        user: &UserGeometry,
        placed: (u32, &Instance),
        (packet, active): (CallbackPacket, &[i32; W]),
        query_kind: Query,
    ) -> [i32; W] {
        let number = placed.1.geometry;
        match (user.geometry(number), user.part(number)) {
            (Geometry::Shape(shape), _) => {
                let (index, instance) = placed;
                let placed = PlacedShape {
                    index,
                    instance,
                    shape,
                };
                intersect_shape::<W>(user.simd(), placed, packet, active, query_kind)
            }
            (Geometry::Mesh(_), Some(part)) => {
                self.intersect_mesh::<W>(placed, part, packet, active, query_kind)
            }
            (Geometry::Mesh(_) | Geometry::Points(_), _) => [0; W],
        }
    }
}

/// A shape as an instance.
struct PlacedShape<'a> {
    /// Index of the instance in the scene.
    index: u32,
    instance: &'a Instance,
    shape: &'a Shape,
}

/// Tests one shape in f64, on the exact extension of the f32 rays.
// Not inlined, so that callbacks for triangles need little of the stack
#[inline(never)]
fn intersect_shape<const W: usize>(
    simd: SimdLimit,
    placed: PlacedShape,
    packet: CallbackPacket,
    active: &[i32; W],
    query_kind: Query,
) -> [i32; W] {
    let PlacedShape {
        index,
        instance,
        shape,
    } = placed;
    // Test all lanes at once if the shape is a static sphere in world space
    if W > 1
        && !instance.is_moving()
        && let Some(sphere) = world_sphere(&instance.pose(0.0), shape)
    {
        return simd.dispatch(SphereKernel {
            sphere: &sphere,
            instance: index,
            primitive: 0,
            packet,
            active,
            query_kind,
        });
    }
    // Otherwise test the active lanes one by one
    by_lane(instance, packet, active, query_kind, |ray| {
        shape_hit(index, instance, shape, ray)
    })
}

/// Tests the points of a cluster in f64, on the exact extension of the f32 rays.
// Not inlined, as `intersect_shape`
#[inline(never)]
fn intersect_points<const W: usize>(
    simd: SimdLimit,
    points: PlacedPoints,
    packet: CallbackPacket,
    active: &[i32; W],
    query_kind: Query,
) -> [i32; W] {
    let PlacedPoints {
        index,
        instance,
        cloud,
        ..
    } = points;
    // Test all points at once if they are static spheres in world space
    if let Some(cluster) = &points.world_spheres() {
        let numbered = NumberedSpheres {
            cluster,
            instances: &[index; MEMBERS],
            primitives: points.slots(),
        };
        return intersect_spheres::<W>(simd, numbered, packet, active, query_kind);
    }
    // Otherwise test one point after the other
    let mut hit = [0; W];
    for point in points.points() {
        let is_hit = by_lane(instance, packet, active, query_kind, |ray| {
            point_hit(index, instance, cloud, point, ray)
        });
        for lane in 0..W {
            hit[lane] |= is_hit[lane];
        }
    }
    hit
}

/// Tests the active lanes one by one by `intersect`, and records the hits.
#[inline(always)]
fn by_lane<const W: usize>(
    instance: &Instance,
    packet: CallbackPacket,
    active: &[i32; W],
    query_kind: Query,
    intersect: impl Fn(&Ray) -> Option<Hit>,
) -> [i32; W] {
    let (origin, direction) = (
        packet.vectors::<W>(row::ORIGIN),
        packet.vectors::<W>(row::DIRECTION),
    );
    let (t_near, t_far) = (packet.floats::<W>(row::T_NEAR), packet.floats::<W>(row::T_FAR));
    // Load the ray times only if the instance moves
    let times = times_of::<W>(instance, packet);
    let mut hit = [0; W];
    for lane in (0..W).filter(|&lane| active[lane] != 0) {
        let ray = ray_of(
            &origin,
            &direction,
            (t_near[lane], t_far[lane], times[lane]),
            lane,
        );
        if let Some(found) = intersect(&ray) {
            hit[lane] = record_hit(packet, lane, t_far[lane], &found, query_kind);
        }
    }
    hit
}

/// Returns the times of the rays if the instance moves, else zeros.
#[inline(always)]
fn times_of<const W: usize>(instance: &Instance, packet: CallbackPacket) -> [f32; W] {
    if instance.is_moving() {
        packet.floats(row::TIME)
    } else {
        [0.0; W]
    }
}

/// Factor that extends rays for nearest-hit queries; hits are compared to the true end afterwards. Embree compares a
/// triangle's distance before the division that makes it `t`, and so may reject a hit whose `t` is exactly the end,
/// which is a tie.
const REACH: f32 = 1.0 + 1.0 / (1 << 20) as f32;

impl CallbackArgs {
    /// Transforms the rays into the object space of an instanced mesh and traces its own scene with the current query.
    // Not inlined, as `intersect_shape`
    #[inline(never)]
    fn intersect_mesh<const W: usize>(
        &self,
        (index, instance): (u32, &Instance),
        part: SceneRef,
        packet: CallbackPacket,
        active: &[i32; W],
        query_kind: Query,
    ) -> [i32; W] {
        // Transform the active rays into object space
        let (origin, direction) = (
            packet.vectors::<W>(row::ORIGIN),
            packet.vectors::<W>(row::DIRECTION),
        );
        let (t_near, t_far) = (packet.floats::<W>(row::T_NEAR), packet.floats::<W>(row::T_FAR));
        let still: Option<DAffine3> = (!instance.is_moving()).then(|| instance.object_from_world());
        let times = times_of::<W>(instance, packet);
        let mut lanes = Lanes::<W>::new();
        for lane in (0..W).filter(|&lane| active[lane] != 0) {
            let end = match query_kind {
                Query::Nearest => t_far[lane] * REACH,
                Query::Any => t_far[lane],
            };
            let ray = ray_of(&origin, &direction, (t_near[lane], end, times[lane]), lane);
            let object_from_world = still.unwrap_or_else(|| instance.pose(ray.time).object_from_world());
            lanes.set(lane, &object_ray(&object_from_world, &ray));
        }
        let mut hit = [0; W];
        if !lanes.any_active() {
            return hit;
        }
        // Flag the query as incoherent if a transformed direction has a vanishing component, which the world-space ray
        // need not have
        let mut incoherent;
        let query = if lanes.may_be_coherent() {
            self.query
        } else {
            incoherent = new_query(Coherence::Incoherent);
            &raw mut incoherent
        };
        // Trace the mesh's own scene
        lanes.trace(part, query, query_kind);
        // Copy hits within the true interval into Embree's packet
        for lane in (0..W).filter(|&lane| lanes.is_active(lane)) {
            let found = match query_kind {
                Query::Nearest if lanes.get(row::INSTANCE, lane) != NO_HIT => {
                    let found = hit_of(&lanes, lane);
                    if found.t > t_far[lane] {
                        continue;
                    }
                    found
                }
                Query::Any if lanes.is_blocked(lane) => hit_of(&lanes, lane),
                _ => continue,
            };
            let found = Hit {
                instance: index,
                ..found
            };
            hit[lane] = record_hit(packet, lane, t_far[lane], &found, query_kind);
        }
        hit
    }
}

#[cfg(test)]
mod tests {
    use super::super::primitives::PANIC;
    use super::super::triangle_cluster::TriangleClusters;
    use super::*;
    use crate::accel::embree::EmbreeAccel;
    use crate::accel::embree::origin_bound::OriginBound;
    use crate::accel::{ACTIVE, Accel, AccelOptions, Instancing, RayPacket};
    use crate::numeric::Ray;
    use crate::scene::Scene;
    use crate::shape::Sphere;
    use glam::Vec3;

    #[test]
    fn a_panic_in_a_callback_is_a_counted_miss() {
        // Build a scene with one sphere, which is intersected by a callback
        let scene = Scene {
            geometries: vec![Geometry::Shape(Shape::Sphere(Sphere::UNIT))],
            instances: vec![Instance::new("sphere", 0, 0, DAffine3::IDENTITY).unwrap()],
            ..Scene::default()
        };
        let accel = EmbreeAccel::build(&scene, &AccelOptions::default()).unwrap();
        let mut packet = RayPacket::EMPTY;
        packet.set(3, &Ray::new(Vec3::new(0.0, 0.0, 3.0), Vec3::NEG_Z));

        PANIC.set(true);
        let mut broken = [packet.clone()];
        accel.intersect(&mut broken, Coherence::Coherent);
        PANIC.set(false);
        assert_eq!(broken[0].hit(3), None);
        assert!(accel.panicked_callback_count() > 0);

        let mut whole = [packet];
        accel.intersect(&mut whole, Coherence::Coherent);
        assert_eq!(whole[0].hit(3).map(|hit| hit.t), Some(2.0));
    }

    #[test]
    fn callback_handles_any_number_of_lanes() {
        let scene = Scene {
            geometries: vec![Geometry::Shape(Shape::Sphere(Sphere::UNIT))],
            instances: vec![Instance::new("sphere", 0, 0, DAffine3::IDENTITY).unwrap()],
            ..Scene::default()
        };
        // Register the sphere as a user geometry, without an Embree scene
        let near = (&scene, OriginBound::default());
        let [user, _] = UserGeometry::pair(
            near,
            SimdLimit::Avx512,
            vec![None],
            TriangleClusters::default(),
            Instancing::Callback,
        );
        for count in 1..=37 {
            const ROWS: usize = 21;
            // Lay out a packet of `count` rays as Embree does, one row per field
            let mut rows = vec![0u32; ROWS * count];
            for lane in 0..count {
                // From (x, 0, 3) along -z at the unit sphere: t = 3 - sqrt(1 - x²), here with x = 0; odd lanes point
                // away.
                rows[2 * count + lane] = 3f32.to_bits();
                rows[6 * count + lane] = if lane % 2 == 0 { -1f32 } else { 1f32 }.to_bits();
                rows[8 * count + lane] = f32::INFINITY.to_bits();
                rows[17 * count + lane] = NO_HIT;
                rows[19 * count + lane] = NO_HIT;
                rows[18 * count + lane] = NO_HIT;
            }
            let mut valid = vec![ACTIVE; count];
            // Call back and compare each lane with the expected hit
            let query = std::ptr::null_mut();
            let call = CallbackArgs {
                valid: valid.as_mut_ptr(),
                rays: rows.as_mut_ptr(),
                count,
                primitive: 0,
                query,
            };
            call.run(&user, Query::Nearest);
            for lane in 0..count {
                let t = f32::from_bits(rows[8 * count + lane]);
                assert_eq!(
                    t,
                    if lane % 2 == 0 { 2.0 } else { f32::INFINITY },
                    "lane {lane} of {count}"
                );
                assert_eq!(rows[18 * count + lane] == NO_HIT, lane % 2 == 1);
            }
        }
    }
}
