//! The user geometry: spheres and placed meshes, each one primitive, tested by callbacks from Embree.
//!
//! A callback gets the rays of one Embree packet, of any width, and the number of one primitive. It writes hits into the
//! packet itself, under the number of the scene's instance.

use std::panic::{self, AssertUnwindSafe};
use std::sync::atomic::{AtomicU64, Ordering};

use embree_sys as sys;
use glam::{DAffine3, DVec3};

use super::lanes::{Foreign, Lanes, ray_of, row};
use super::scene::{EmbreeScene, SceneRef};
use super::trace::{hit_of, new_query};
use crate::accel::{ACTIVE, Hit, NO_HIT, RayOrder};
use crate::numeric::{Bounds, Ray, object_ray};
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::Sphere;

/// Everything that Embree asks our callbacks about.
pub(super) struct UserGeometry<'s> {
    primitives: Vec<Primitive>,
    /// Scenes of placed meshes, by geometry.
    parts: Vec<Option<EmbreeScene<'s>>>,
    panic_count: AtomicU64,
}

/// One primitive of the user geometry.
struct Primitive {
    instance: u32,
    object_from_world: DAffine3,
    bounds: ([f32; 3], [f32; 3]),
    what: What,
}

enum What {
    Sphere(Sphere),
    /// The mesh of that geometry.
    Mesh(u32),
}

/// Whether an instance is a primitive of the user geometry.
pub(super) fn is_user(scene: &Scene, instance: &Instance) -> bool {
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Sphere(_) => true,
        Geometry::Mesh(mesh) => !instance.is_identity() && !mesh.triangles.is_empty(),
    }
}

impl<'s> UserGeometry<'s> {
    /// `parts` holds a committed scene for every mesh with a placed instance.
    pub(super) fn new(scene: &Scene, parts: Vec<Option<EmbreeScene<'s>>>) -> UserGeometry<'s> {
        let placed = (0u32..)
            .zip(&scene.instances)
            .filter(|(_, instance)| is_user(scene, instance));
        let mut object_bounds: Vec<Option<Bounds>> = vec![None; scene.geometries.len()];
        let primitives = placed
            .map(|(index, instance)| {
                let geometry = &scene.geometries[instance.geometry as usize];
                let bounds =
                    object_bounds[instance.geometry as usize].get_or_insert_with(|| geometry.bounds());
                Primitive {
                    instance: index,
                    object_from_world: instance.object_from_world,
                    bounds: padded_bounds(bounds, instance),
                    what: match geometry {
                        Geometry::Sphere(sphere) => What::Sphere(*sphere),
                        Geometry::Mesh(_) => What::Mesh(instance.geometry),
                    },
                }
            })
            .collect();
        UserGeometry {
            primitives,
            parts,
            panic_count: AtomicU64::new(0),
        }
    }

    /// Spheres and placed meshes.
    pub(super) fn primitive_count(&self) -> usize {
        self.primitives.len()
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

    fn part(&self, geometry: u32) -> Option<SceneRef<'_>> {
        self.parts[geometry as usize].as_ref().map(EmbreeScene::as_ref)
    }
}

/// Part of a box's largest coordinate by which it is padded: object-space rays are rounded to f32, which moves them
/// against the geometry by a few 2^-24 of the coordinates involved.
const PLACEMENT_PADDING: f64 = 1.0 / (1 << 20) as f64;

/// The box of a placed geometry, in world space.
fn padded_bounds(object: &Bounds, instance: &Instance) -> ([f32; 3], [f32; 3]) {
    let world = object.transformed(&instance.world_from_object);
    let padding = DVec3::splat(PLACEMENT_PADDING * world.magnitude());
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
    let (low, high) = user
        .primitives
        .get(args.primID as usize)
        .map_or(EMPTY_BOX, |p| p.bounds);
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

#[derive(Clone, Copy, PartialEq)]
enum Question {
    Nearest,
    Any,
}

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
                16.. => self.block::<16>(user, first, question),
                8.. => self.block::<8>(user, first, question),
                4.. => self.block::<4>(user, first, question),
                _ => self.block::<1>(user, first, question),
            };
        }
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
            if let Some(primitive) = user.primitives.get(self.primitive) {
                hit = match &primitive.what {
                    What::Sphere(sphere) => answer_sphere::<W>(primitive, sphere, packet, &asked, question),
                    What::Mesh(geometry) => match user.part(*geometry) {
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

/// Tests one sphere in f64, on the exact extension of the f32 rays.
#[inline(always)]
fn answer_sphere<const W: usize>(
    primitive: &Primitive,
    sphere: &Sphere,
    packet: Foreign,
    asked: &[i32; W],
    question: Question,
) -> [i32; W] {
    let (origin, direction) = (
        packet.vectors::<W>(row::ORIGIN),
        packet.vectors::<W>(row::DIRECTION),
    );
    let (t_near, t_far) = (packet.floats::<W>(row::T_NEAR), packet.floats::<W>(row::T_FAR));
    let mut hit = [0; W];
    for lane in (0..W).filter(|&lane| asked[lane] != 0) {
        let ray = ray_of(&origin, &direction, (t_near[lane], t_far[lane]), lane);
        if let Some(t) = sphere_hit(primitive, sphere, &ray) {
            let found = Hit {
                instance: primitive.instance,
                primitive: 0,
                t,
                u: 0.0,
                v: 0.0,
            };
            hit[lane] = answer(packet, lane, t_far[lane], &found, question);
        }
    }
    hit
}

/// The first parameter past `t_near`, rounded once, if it is not beyond `t_far`.
///
/// `t_far` is the ray's own or the `t` of a hit found before, and that was rounded too: so the comparison is made after
/// rounding, or spheres at the same `t` would be told apart by the order of the questions.
#[inline(always)]
fn sphere_hit(primitive: &Primitive, sphere: &Sphere, ray: &Ray) -> Option<f32> {
    let map = &primitive.object_from_world;
    let origin = map.transform_point3(ray.origin.as_dvec3());
    let direction = map.transform_vector3(ray.direction.as_dvec3());
    let t = sphere.nearest(origin, direction, f64::from(ray.t_near), f64::INFINITY)? as f32;
    (t <= ray.t_far && t.is_finite()).then_some(t)
}

impl Call {
    /// Carries the rays into a placed mesh's object space and traces its own scene with the query at hand.
    #[inline(always)]
    fn answer_mesh<const W: usize>(
        &self,
        primitive: &Primitive,
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
        let mut lanes = Lanes::<W>::new();
        for lane in (0..W).filter(|&lane| asked[lane] != 0) {
            let ray = ray_of(&origin, &direction, (t_near[lane], t_far[lane]), lane);
            lanes.set(lane, &object_ray(&primitive.object_from_world, &ray));
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
                Question::Nearest if lanes.get(row::INSTANCE, lane) != NO_HIT => hit_of(&lanes, lane),
                Question::Any if f32::from_bits(lanes.get(row::T_FAR, lane)) == f32::NEG_INFINITY => {
                    hit_of(&lanes, lane)
                }
                _ => continue,
            };
            let found = Hit {
                instance: primitive.instance,
                ..found
            };
            hit[lane] = answer(packet, lane, t_far[lane], &found, question);
        }
        hit
    }
}

/// Writes what was found into Embree's packet, unless an equally near hit has the lower number.
#[inline(always)]
fn answer(packet: Foreign, lane: usize, t_far: f32, found: &Hit, question: Question) -> i32 {
    if question == Question::Any {
        packet.set(row::T_FAR, lane, f32::NEG_INFINITY.to_bits());
        return ACTIVE;
    }
    // A lane without a hit has the highest number, so a hit at its very end is taken.
    let held = [row::INSTANCE, row::PRIMITIVE].map(|row| packet.load_one(row, lane));
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
            geometries: vec![Geometry::Sphere(Sphere::UNIT)],
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
            geometries: vec![Geometry::Sphere(Sphere::UNIT)],
            instances: vec![Instance::new("sphere", 0, 0, DAffine3::IDENTITY).unwrap()],
            ..Scene::default()
        };
        let user = UserGeometry::new(&scene, vec![None]);
        for count in 1..=37 {
            const ROWS: usize = 21;
            let mut rows = vec![0u32; ROWS * count];
            for lane in 0..count {
                // From (x, 0, 3) down -z at the unit sphere: t = 3 - sqrt(1 - x²), here with x = 0; odd lanes look away.
                rows[2 * count + lane] = 3f32.to_bits();
                rows[6 * count + lane] = if lane % 2 == 0 { -1f32 } else { 1f32 }.to_bits();
                rows[8 * count + lane] = f32::INFINITY.to_bits();
                rows[17 * count + lane] = NO_HIT;
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
