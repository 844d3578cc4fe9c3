//! Callbacks from Embree: the rays of one packet, of any width, and the number of one primitive of the user geometry.
//!
//! Hits are written into the packet itself, under the number of the scene's instance.

use embree_sys as sys;
use glam::DAffine3;

use super::query::{hit_of, new_query, number_of_instance};
use super::ray_packet::{CallbackPacket, Lanes, ray_of, row};
use super::scene::SceneRef;
use super::sphere::{SphereLanes, answer_spheres};
use super::triangle::answer_patch;
use super::user_geometry::{Primitive, UserGeometry};
use crate::accel::shape_query::{shape_hit, world_sphere};
use crate::accel::{ACTIVE, Hit, NO_HIT, RayOrder};
use crate::mesh::simd::{dispatch, lanes};
use crate::numeric::object_ray;
use crate::scene::{Geometry, Instance};
use crate::shape::Shape;

/// Tells Embree the box of one primitive.
pub(super) unsafe extern "C" fn on_bounds(args: *const sys::RTCBoundsFunctionArguments) {
    // SAFETY: Embree's arguments live for this call.
    let args = unsafe { &*args };
    // SAFETY: the pointer that `attach_user` set, kept by `EmbreeAccel` while the scene lives.
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
    // SAFETY: Embree gives room for one box.
    unsafe { args.bounds_o.write(bounds) };
}

/// A box that Embree leaves out.
const EMPTY_BOX: ([f32; 3], [f32; 3]) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);

/// Nearest hit of the packet's rays with one primitive.
pub(super) unsafe extern "C" fn on_intersect(args: *const sys::RTCIntersectFunctionNArguments) {
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

/// Whether the packet's rays meet one primitive.
pub(super) unsafe extern "C" fn on_occluded(args: *const sys::RTCOccludedFunctionNArguments) {
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

/// What Embree asks.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Query {
    /// The nearest hit.
    Nearest,
    /// Whether there is one.
    Any,
}

/// Up to so many lanes are answered one by one.
const FEW_LANES: u32 = 2;

/// One callback: `count` lanes against one primitive.
struct CallbackArgs {
    valid: *mut i32,
    rays: *mut u32,
    count: usize,
    primitive: usize,
    /// The context that Embree hands back begins the query that it was given.
    query: *mut sys::EmbreeQuery,
}

impl CallbackArgs {
    fn run(&self, user: &UserGeometry, question: Query) {
        let mut first = 0;
        while first < self.count {
            // Embree's own widths in one step each; anything else in several.
            first += match self.count - first {
                16.. => self.few_or_block::<16>(user, first, question),
                8.. => self.few_or_block::<8>(user, first, question),
                4.. => self.few_or_block::<4>(user, first, question),
                _ => self.block::<1>(user, first, question),
            };
        }
    }

    /// Answers lanes `first .. first + W` and returns `W`. For incoherent rays Embree asks about one lane of a wide
    /// packet at a time, so few lanes are answered without a look at the others.
    #[inline(always)]
    fn few_or_block<const W: usize>(&self, user: &UserGeometry, first: usize, question: Query) -> usize {
        // SAFETY: Embree passes `count` values, and `first + W` is at most that.
        let asked = unsafe { self.valid.wrapping_add(first).cast::<[i32; W]>().read_unaligned() };
        let mut mask = 0u32;
        for lane in 0..W {
            mask |= u32::from(asked[lane] != 0) << lane;
        }
        if mask.count_ones() > FEW_LANES {
            return self.block::<W>(user, first, question);
        }
        for lane in lanes(mask) {
            self.block::<1>(user, first + lane, question);
        }
        W
    }

    /// Answers lanes `first .. first + W` and returns `W`.
    #[inline(always)]
    fn block<const W: usize>(&self, user: &UserGeometry, first: usize, question: Query) -> usize {
        let valid = self.valid.wrapping_add(first);
        // SAFETY: Embree passes `count` values, and `first + W` is at most that.
        let asked = unsafe { valid.cast::<[i32; W]>().read_unaligned() };
        // SAFETY: Embree's packet of `count` lanes is this callback's alone while it runs.
        let packet = unsafe { CallbackPacket::new(self.rays, self.count, first) };
        let mut hit = [0; W];
        let done = user.guarded(|| {
            hit = match user.primitive(self.primitive) {
                Some(Primitive::Spheres(cluster, instances)) => {
                    answer_spheres::<W>((cluster, instances), packet, &asked, question)
                }
                Some(Primitive::TriangleCluster(patch)) => answer_patch::<W>(patch, packet, &asked, question),
                Some(Primitive::Instance(index, instance)) => {
                    self.answer_instance::<W>(user, (index, instance), (packet, &asked), question)
                }
                None => [0; W],
            };
        });
        if !done {
            hit = [0; W];
        }
        // SAFETY: `W` values both sides, as above.
        unsafe { sys::embree_report_lanes(valid, hit.as_ptr(), W as u32) };
        W
    }
}

impl CallbackArgs {
    #[inline(always)]
    fn answer_instance<const W: usize>(
        &self,
        user: &UserGeometry,
        placed: (u32, &Instance),
        (packet, asked): (CallbackPacket, &[i32; W]),
        question: Query,
    ) -> [i32; W] {
        let number = placed.1.geometry;
        match (user.geometry(number), user.part(number)) {
            (Geometry::Shape(shape), _) => answer_shape::<W>(placed, shape, packet, asked, question),
            (Geometry::Mesh(_), Some(part)) => self.answer_mesh::<W>(placed, part, packet, asked, question),
            (Geometry::Mesh(_), None) => [0; W],
        }
    }
}

/// Tests one shape in f64, on the exact extension of the f32 rays.
#[inline(always)]
fn answer_shape<const W: usize>(
    (index, instance): (u32, &Instance),
    shape: &Shape,
    packet: CallbackPacket,
    asked: &[i32; W],
    question: Query,
) -> [i32; W] {
    if W > 1
        && !instance.is_moving()
        && let Some(sphere) = world_sphere(&instance.pose(0.0), shape)
    {
        return dispatch(SphereLanes {
            sphere: &sphere,
            instance: index,
            packet,
            asked,
            question,
        });
    }
    let (origin, direction) = (
        packet.vectors::<W>(row::ORIGIN),
        packet.vectors::<W>(row::DIRECTION),
    );
    let (t_near, t_far) = (packet.floats::<W>(row::T_NEAR), packet.floats::<W>(row::T_FAR));
    let times = times_of::<W>(instance, packet);
    let mut hit = [0; W];
    for lane in (0..W).filter(|&lane| asked[lane] != 0) {
        let ray = ray_of(
            &origin,
            &direction,
            (t_near[lane], t_far[lane], times[lane]),
            lane,
        );
        if let Some(found) = shape_hit(index, instance, shape, &ray) {
            hit[lane] = answer(packet, lane, t_far[lane], &found, question);
        }
    }
    hit
}

/// When the rays are sent, where that counts: for what moves.
#[inline(always)]
fn times_of<const W: usize>(instance: &Instance, packet: CallbackPacket) -> [f32; W] {
    if instance.is_moving() {
        packet.floats(row::TIME)
    } else {
        [0.0; W]
    }
}

/// Nearest hits are asked for a little beyond the ray's end, and judged afterwards: Embree compares a triangle's distance
/// before the division that makes it `t`, and so may refuse a hit whose `t` is exactly the end, which a tie is.
const REACH: f32 = 1.0 + 1.0 / (1 << 20) as f32;

impl CallbackArgs {
    /// Carries the rays into a placed mesh's object space and traces its own scene with the query at hand.
    #[inline(always)]
    fn answer_mesh<const W: usize>(
        &self,
        (index, instance): (u32, &Instance),
        part: SceneRef,
        packet: CallbackPacket,
        asked: &[i32; W],
        question: Query,
    ) -> [i32; W] {
        let (origin, direction) = (
            packet.vectors::<W>(row::ORIGIN),
            packet.vectors::<W>(row::DIRECTION),
        );
        let (t_near, t_far) = (packet.floats::<W>(row::T_NEAR), packet.floats::<W>(row::T_FAR));
        let still: Option<DAffine3> = (!instance.is_moving()).then(|| instance.object_from_world());
        let times = times_of::<W>(instance, packet);
        let mut lanes = Lanes::<W>::new();
        for lane in (0..W).filter(|&lane| asked[lane] != 0) {
            let end = match question {
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
        // Rays that are tame in the world may be wild in object space.
        let mut incoherent;
        let query = if lanes.may_be_coherent() {
            self.query
        } else {
            incoherent = new_query(RayOrder::Incoherent);
            &raw mut incoherent
        };
        match question {
            Query::Nearest => lanes.intersect(part, query),
            Query::Any => lanes.occluded(part, query),
        }
        for lane in (0..W).filter(|&lane| lanes.is_active(lane)) {
            let found = match question {
                Query::Nearest if lanes.get(row::INSTANCE, lane) != NO_HIT => {
                    let found = hit_of(&lanes, lane);
                    if found.t > t_far[lane] {
                        continue;
                    }
                    found
                }
                Query::Any if f32::from_bits(lanes.get(row::T_FAR, lane)) == f32::NEG_INFINITY => {
                    hit_of(&lanes, lane)
                }
                _ => continue,
            };
            let found = Hit {
                instance: index,
                ..found
            };
            hit[lane] = answer(packet, lane, t_far[lane], &found, question);
        }
        hit
    }
}

/// Writes what was found into Embree's packet, unless an equally near hit has the lower number.
#[inline(always)]
pub(super) fn answer(packet: CallbackPacket, lane: usize, t_far: f32, found: &Hit, question: Query) -> i32 {
    if question == Query::Any {
        packet.set(row::T_FAR, lane, f32::NEG_INFINITY.to_bits());
        return ACTIVE;
    }
    // A lane without a hit has the highest number, so a hit at its very end is taken.
    if found.t == t_far && number_of(packet, lane) <= [found.instance, found.primitive] {
        return 0;
    }
    packet.set(row::T_FAR, lane, found.t.to_bits());
    packet.set(row::U, lane, found.u.to_bits());
    packet.set(row::V, lane, found.v.to_bits());
    packet.set(row::PRIMITIVE, lane, found.primitive);
    packet.set(row::INSTANCE, lane, found.instance);
    packet.set(row::LEVEL, lane, NO_HIT);
    ACTIVE
}

/// Instance and primitive of a lane's hit; the highest numbers if it has none.
#[inline(always)]
pub(super) fn number_of(packet: CallbackPacket, lane: usize) -> [u32; 2] {
    let geometry = packet.load_one(row::INSTANCE, lane);
    let level = packet.load_one(row::LEVEL, lane);
    let primitive = packet.load_one(row::PRIMITIVE, lane);
    [number_of_instance([geometry, level]), primitive]
}

#[cfg(test)]
pub(super) mod tests {
    use std::cell::Cell;

    use super::super::EmbreeAccel;
    use super::super::origin_bound::OriginBound;
    use super::super::triangle_cluster::TriangleClusters;
    use super::*;
    use crate::accel::{Accel, AccelOptions, Instancing, RayPacket};
    use crate::numeric::Ray;
    use crate::scene::Scene;
    use crate::shape::Sphere;
    use glam::Vec3;

    thread_local! {
        static PANIC: Cell<bool> = const { Cell::new(false) };
    }

    /// Called inside every guarded callback of a test build.
    pub(in super::super) fn maybe_panic() {
        assert!(!PANIC.get(), "asked to panic");
    }

    #[test]
    fn a_panic_in_a_callback_is_a_counted_miss() {
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
        accel.intersect(&mut broken, RayOrder::Coherent);
        PANIC.set(false);
        assert_eq!(broken[0].hit(3), None);
        assert!(accel.panicked_callback_count() > 0);

        let mut whole = [packet];
        accel.intersect(&mut whole, RayOrder::Coherent);
        assert_eq!(whole[0].hit(3).map(|hit| hit.t), Some(2.0));
    }

    #[test]
    fn a_callback_serves_any_number_of_lanes() {
        let scene = Scene {
            geometries: vec![Geometry::Shape(Shape::Sphere(Sphere::UNIT))],
            instances: vec![Instance::new("sphere", 0, 0, DAffine3::IDENTITY).unwrap()],
            ..Scene::default()
        };
        let near = (&scene, OriginBound::default());
        let [user, _] = UserGeometry::pair(
            near,
            vec![None],
            TriangleClusters::default(),
            Instancing::Callback,
        );
        for count in 1..=37 {
            const ROWS: usize = 21;
            let mut rows = vec![0u32; ROWS * count];
            for lane in 0..count {
                // From (x, 0, 3) down -z at the unit sphere: t = 3 - sqrt(1 - x²), here with x = 0; odd lanes look away.
                rows[2 * count + lane] = 3f32.to_bits();
                rows[6 * count + lane] = if lane % 2 == 0 { -1f32 } else { 1f32 }.to_bits();
                rows[8 * count + lane] = f32::INFINITY.to_bits();
                rows[17 * count + lane] = NO_HIT;
                rows[19 * count + lane] = NO_HIT;
                rows[18 * count + lane] = NO_HIT;
            }
            let mut valid = vec![ACTIVE; count];
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
