//! The user geometry: clusters of spheres, and all other shapes and placed meshes, each one primitive, tested by callbacks
//! from Embree. What moves is a second one, as Embree walks trees of boxes that move more slowly than those of boxes that do
//! not.
//!
//! A callback gets the rays of one Embree packet, of any width, and the number of one primitive. It writes hits into the
//! packet itself, under the number of the scene's instance.

use std::panic::{self, AssertUnwindSafe};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use embree_sys as sys;
use glam::{DAffine3, DVec3};

use super::cluster::SphereClusters;
use super::lanes::{Foreign, Lanes, ray_of, row};
use super::native;
use super::scene::{EmbreeScene, SceneRef, placed_mesh};
use super::sphere::{SphereLanes, answer_spheres};
use super::trace::{hit_of, new_query, number_of_instance};
use crate::accel::shapes::{shape_hit, world_sphere};
use crate::accel::{ACTIVE, Hit, Instancing, NO_HIT, RayOrder};
use crate::mesh::lanes::{dispatch, lanes};
use crate::numeric::{Bounds, Motion, object_ray};
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::{Shape, Sphere};

/// Everything that Embree asks our callbacks about.
pub(super) struct UserGeometry<'s> {
    scene: &'s Scene,
    /// The first primitives: spheres that are asked about together.
    clusters: SphereClusters,
    /// The instance that each primitive after them is.
    instances: Vec<u32>,
    /// By geometry; absent where it is no placed mesh.
    parts: Arc<[Option<Box<Part<'s>>>]>,
    /// Equal steps of time between the boxes that Embree is told; 0 where nothing moves.
    step_count: u32,
    panic_count: AtomicU64,
}

/// A placed mesh in its own space.
struct Part<'s> {
    scene: EmbreeScene<'s>,
    bounds: Bounds,
}

/// Spheres of the world, each with the number of its instance, and the numbers of all other `instances`.
fn apart(scene: &Scene, instances: &[(u32, &Instance)]) -> (Vec<(u32, Sphere)>, Vec<u32>) {
    let (mut spheres, mut others) = (Vec::new(), Vec::new());
    for &(index, instance) in instances {
        let sphere = match &scene.geometries[instance.geometry as usize] {
            Geometry::Shape(shape) => world_sphere(&instance.pose(0.0), shape),
            Geometry::Mesh(_) => None,
        };
        match sphere {
            Some(sphere) => spheres.push((index, sphere)),
            None => others.push(index),
        }
    }
    (spheres, others)
}

/// Whether an instance is a primitive of the user geometry.
pub(super) fn is_user(scene: &Scene, instance: &Instance, instancing: Instancing) -> bool {
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(_) => placed_mesh(scene, instance).is_some() && !native::takes(instance, instancing),
        shape => !shape.is_unbounded(),
    }
}

impl<'s> UserGeometry<'s> {
    /// What stands still, and what moves; `parts` holds a committed scene for every mesh with a placed instance.
    pub(super) fn pair(
        scene: &'s Scene,
        parts: Vec<Option<EmbreeScene<'s>>>,
        instancing: Instancing,
    ) -> [UserGeometry<'s>; 2] {
        let instances = (0u32..)
            .zip(&scene.instances)
            .filter(|(_, instance)| is_user(scene, instance, instancing));
        let (moving, others): (Vec<_>, Vec<_>) = instances.partition(|(_, instance)| instance.is_moving());
        let (spheres, mut still) = apart(scene, &others);
        let (clusters, alone) = SphereClusters::of(&spheres);
        still.extend(alone);
        let motions = moving.iter().filter_map(|(_, instance)| instance.motion());
        let step_count = motions.map(Motion::step_count).max().unwrap_or(0);
        let parts = parts.into_iter().zip(&scene.geometries).map(|(part, geometry)| {
            let with_bounds = |scene| {
                Box::new(Part {
                    scene,
                    bounds: geometry.bounds(),
                })
            };
            part.map(with_bounds)
        });
        let parts: Arc<[_]> = parts.collect();
        let moving = moving.iter().map(|(index, _)| *index).collect();
        [
            (clusters, still, 0),
            (SphereClusters::default(), moving, step_count),
        ]
        .map(|(clusters, instances, step_count)| UserGeometry {
            scene,
            clusters,
            instances,
            parts: parts.clone(),
            step_count,
            panic_count: AtomicU64::new(0),
        })
    }

    /// Equal steps of time between the boxes of a primitive; 0 where nothing moves.
    pub(super) fn step_count(&self) -> u32 {
        self.step_count
    }

    /// Shapes and placed meshes.
    pub(super) fn object_count(&self) -> usize {
        self.clusters.sphere_count() + self.instances.len()
    }

    /// What Embree keeps boxes of.
    pub(super) fn primitive_count(&self) -> usize {
        self.clusters.len() + self.instances.len()
    }

    /// The instance that a primitive is, with its number; none where it is a cluster.
    #[inline(always)]
    fn instance(&self, primitive: usize) -> Option<(u32, &'s Instance)> {
        let index = *self.instances.get(primitive.checked_sub(self.clusters.len())?)?;
        Some((index, self.scene.instances.get(index as usize)?))
    }

    /// The box of a primitive in world space after that many steps of time, padded.
    ///
    /// Embree interpolates boxes in f32, by a part of a step that is off by 2^-24 of all steps, over which a box moves by
    /// twice the largest coordinate at most.
    fn bounds(&self, primitive: usize, step: u32) -> Option<([f32; 3], [f32; 3])> {
        if let Some((cluster, _)) = self.clusters.get(primitive) {
            let world = cluster.bounds();
            return Some(padded(&world, padding(&world)));
        }
        let (_, instance) = self.instance(primitive)?;
        let geometry = &self.scene.geometries[instance.geometry as usize];
        let object = match (&self.parts[instance.geometry as usize], geometry) {
            (Some(part), _) => part.bounds,
            (None, shape) => shape.bounds(),
        };
        if self.step_count == 0 {
            let world = instance.world_bounds(geometry, &object);
            return Some(padded(&world, padding(&world)));
        }
        let now = instance.step_bounds(geometry, &object, [step, self.step_count]);
        let always = instance.world_bounds(geometry, &object).magnitude();
        let interpolation = UNIT * f64::from(2 * self.step_count + 4);
        Some(padded(
            &now,
            padding(&now) + (PLACEMENT_PADDING + interpolation) * always,
        ))
    }

    /// Bytes that it takes itself, and its parts.
    pub(super) fn byte_count(&self) -> u64 {
        let parts = self.parts.iter().flatten().count() * size_of::<Part>();
        self.own_byte_count() + (size_of_val(&*self.parts) + parts) as u64
    }

    /// Bytes that it takes itself.
    pub(super) fn own_byte_count(&self) -> u64 {
        size_of_val(&*self.instances) as u64 + self.clusters.byte_count()
    }

    /// Callbacks that have panicked.
    pub(super) fn panic_count(&self) -> u64 {
        self.panic_count.load(Ordering::Relaxed)
    }

    /// Runs a callback's work. No panic may cross into C: after one, the callback's lanes have missed.
    fn guarded(&self, work: impl FnOnce()) -> bool {
        let done = panic::catch_unwind(AssertUnwindSafe(|| {
            #[cfg(test)]
            tests::maybe_panic();
            work();
        }));
        if done.is_err() {
            self.panic_count.fetch_add(1, Ordering::Relaxed);
        }
        done.is_ok()
    }

    /// The scene of a placed mesh.
    pub(super) fn part(&self, geometry: u32) -> Option<SceneRef<'_>> {
        let part = self.parts[geometry as usize].as_ref()?;
        Some(part.scene.as_ref())
    }
}

/// Part of a box's largest coordinate by which it is padded: object-space rays are rounded to f32, which moves them
/// against the geometry by a few 2^-24 of the coordinates involved.
const PLACEMENT_PADDING: f64 = 1.0 / (1 << 20) as f64;
/// Half a unit in the last place of an f32 at 1.
const UNIT: f64 = 1.0 / (1 << 24) as f64;

/// Part of a box's longest edge by which it is padded: Embree walks to user geometry by `b/d - o/d`, robust or not, and
/// finds sides `b` some 3/2^24 of the distance `o` aside, and this is more for rays that start within hundreds of edges.
const DISTANT_PADDING: f64 = 1.0 / (1 << 13) as f64;

/// What a box is padded by on all sides.
fn padding(world: &Bounds) -> f64 {
    PLACEMENT_PADDING * world.magnitude() + DISTANT_PADDING * world.extent().max_element()
}

fn padded(world: &Bounds, by: f64) -> ([f32; 3], [f32; 3]) {
    let padding = DVec3::splat(by);
    Bounds {
        min: world.min - padding,
        max: world.max + padding,
    }
    .to_f32_outward()
}

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
    let call = Call {
        valid: args.valid,
        rays: args.rayhit.cast(),
        count: args.N as usize,
        primitive: args.primID as usize,
        query: args.context.cast(),
    };
    // SAFETY: as in `on_bounds`.
    let user = unsafe { &*args.geometryUserPtr.cast::<UserGeometry>() };
    call.run(user, Question::Nearest);
}

/// Whether the packet's rays meet one primitive.
pub(super) unsafe extern "C" fn on_occluded(args: *const sys::RTCOccludedFunctionNArguments) {
    // SAFETY: Embree's arguments live for this call.
    let args = unsafe { &*args };
    let call = Call {
        valid: args.valid,
        rays: args.ray.cast(),
        count: args.N as usize,
        primitive: args.primID as usize,
        query: args.context.cast(),
    };
    // SAFETY: as in `on_bounds`.
    let user = unsafe { &*args.geometryUserPtr.cast::<UserGeometry>() };
    call.run(user, Question::Any);
}

/// What Embree asks.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Question {
    /// The nearest hit.
    Nearest,
    /// Whether there is one.
    Any,
}

/// Up to so many lanes are answered one by one.
const FEW_LANES: u32 = 2;

/// One callback: `count` lanes against one primitive.
struct Call {
    valid: *mut i32,
    rays: *mut u32,
    count: usize,
    primitive: usize,
    /// The context that Embree hands back begins the query that it was given.
    query: *mut sys::EmbreeQuery,
}

impl Call {
    fn run(&self, user: &UserGeometry, question: Question) {
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
    fn few_or_block<const W: usize>(&self, user: &UserGeometry, first: usize, question: Question) -> usize {
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
    fn block<const W: usize>(&self, user: &UserGeometry, first: usize, question: Question) -> usize {
        let valid = self.valid.wrapping_add(first);
        // SAFETY: Embree passes `count` values, and `first + W` is at most that.
        let asked = unsafe { valid.cast::<[i32; W]>().read_unaligned() };
        // SAFETY: Embree's packet of `count` lanes is this callback's alone while it runs.
        let packet = unsafe { Foreign::new(self.rays, self.count, first) };
        let mut hit = [0; W];
        let done = user.guarded(|| {
            if let Some(cluster) = user.clusters.get(self.primitive) {
                hit = answer_spheres::<W>(cluster, packet, &asked, question);
            } else if let Some(primitive) = user.instance(self.primitive) {
                hit = match &user.scene.geometries[primitive.1.geometry as usize] {
                    Geometry::Shape(shape) => answer_shape::<W>(primitive, shape, packet, &asked, question),
                    Geometry::Mesh(_) => match user.part(primitive.1.geometry) {
                        Some(part) => self.answer_mesh::<W>(primitive, part, packet, &asked, question),
                        None => [0; W],
                    },
                };
            }
        });
        if !done {
            hit = [0; W];
        }
        // SAFETY: `W` values both sides, as above.
        unsafe { sys::embree_report_lanes(valid, hit.as_ptr(), W as u32) };
        W
    }
}

/// Tests one shape in f64, on the exact extension of the f32 rays.
#[inline(always)]
fn answer_shape<const W: usize>(
    (index, instance): (u32, &Instance),
    shape: &Shape,
    packet: Foreign,
    asked: &[i32; W],
    question: Question,
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
fn times_of<const W: usize>(instance: &Instance, packet: Foreign) -> [f32; W] {
    if instance.is_moving() {
        packet.floats(row::TIME)
    } else {
        [0.0; W]
    }
}

/// Nearest hits are asked for a little beyond the ray's end, and judged afterwards: Embree compares a triangle's distance
/// before the division that makes it `t`, and so may refuse a hit whose `t` is exactly the end, which a tie is.
const REACH: f32 = 1.0 + 1.0 / (1 << 20) as f32;

impl Call {
    /// Carries the rays into a placed mesh's object space and traces its own scene with the query at hand.
    #[inline(always)]
    fn answer_mesh<const W: usize>(
        &self,
        (index, instance): (u32, &Instance),
        part: SceneRef,
        packet: Foreign,
        asked: &[i32; W],
        question: Question,
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
                Question::Nearest => t_far[lane] * REACH,
                Question::Any => t_far[lane],
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
            Question::Nearest => lanes.intersect(part, query),
            Question::Any => lanes.occluded(part, query),
        }
        for lane in (0..W).filter(|&lane| lanes.is_active(lane)) {
            let found = match question {
                Question::Nearest if lanes.get(row::INSTANCE, lane) != NO_HIT => {
                    let found = hit_of(&lanes, lane);
                    if found.t > t_far[lane] {
                        continue;
                    }
                    found
                }
                Question::Any if f32::from_bits(lanes.get(row::T_FAR, lane)) == f32::NEG_INFINITY => {
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
pub(super) fn answer(packet: Foreign, lane: usize, t_far: f32, found: &Hit, question: Question) -> i32 {
    if question == Question::Any {
        packet.set(row::T_FAR, lane, f32::NEG_INFINITY.to_bits());
        return ACTIVE;
    }
    // A lane without a hit has the highest number, so a hit at its very end is taken.
    let [geometry, level, primitive] =
        [row::INSTANCE, row::LEVEL, row::PRIMITIVE].map(|row| packet.load_one(row, lane));
    let held = [number_of_instance([geometry, level]), primitive];
    if found.t == t_far && held <= [found.instance, found.primitive] {
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

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::super::EmbreeAccel;
    use super::*;
    use crate::accel::{Accel, AccelOptions, RayPacket};
    use crate::numeric::Ray;
    use glam::Vec3;

    thread_local! {
        static PANIC: Cell<bool> = const { Cell::new(false) };
    }

    /// Called inside every guarded callback of a test build.
    pub(super) fn maybe_panic() {
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
        let [user, _] = UserGeometry::pair(&scene, vec![None], Instancing::Callback);
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
            let call = Call {
                valid: valid.as_mut_ptr(),
                rays: rows.as_mut_ptr(),
                count,
                primitive: 0,
                query,
            };
            call.run(&user, Question::Nearest);
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
