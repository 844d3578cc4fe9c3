//! User geometry: spheres and placed meshes, tested by Rust in Embree's callbacks, for any number of rays at once.
//!
//! A callback gets N rays as rows of N values. A sphere is tested in f64 on the exact rays. A placed mesh gets the rays
//! in its object space, carried there in f64 and rounded once, and is asked through an Embree scene of its own; `t`
//! needs no conversion. Equal `t` goes to the lower instance, then to the lower primitive.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::slice::from_raw_parts_mut;
use std::sync::atomic::{AtomicBool, Ordering};

use embree_sys as sys;
use glam::{DVec3, Vec3};

use super::build::EmbreeScene;
use super::query::{Query, Width};
use crate::accel::{Hit, LANES, NO_HIT, RayOrder, RayPacket};
use crate::numeric::{Bounds, Ray, object_ray};
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::Sphere;

/// What the callbacks read.
pub(super) struct UserGeometry<'s> {
    scene: &'s Scene,
    primitives: Vec<Placed>,
    /// For each geometry that is a placed mesh: its own scene.
    object_scenes: Vec<Option<EmbreeScene>>,
    width: Width,
    panicked: AtomicBool,
}

/// One user primitive.
pub(super) struct Placed {
    pub(super) instance: u32,
    pub(super) bounds: Bounds,
}

impl<'s> UserGeometry<'s> {
    pub(super) fn new(
        scene: &'s Scene,
        primitives: Vec<Placed>,
        object_scenes: Vec<Option<EmbreeScene>>,
        width: Width,
    ) -> UserGeometry<'s> {
        UserGeometry {
            scene,
            primitives,
            object_scenes,
            width,
            panicked: AtomicBool::new(false),
        }
    }

    pub(super) fn primitive_count(&self) -> usize {
        self.primitives.len()
    }

    /// Whether a callback has panicked, which is a bug; its rays count as misses.
    pub(super) fn has_panicked(&self) -> bool {
        self.panicked.load(Ordering::Relaxed)
    }

    /// Runs the body of a callback; a panic must not cross into C.
    fn guard(&self, body: impl FnOnce()) {
        if catch_unwind(AssertUnwindSafe(body)).is_err() {
            self.panicked.store(true, Ordering::Relaxed);
        }
    }

    /// Offers the hits of primitive `primitive` to `rays`.
    fn intersect(&self, primitive: u32, rays: &mut RayRows, order: RayOrder) {
        let index = self.primitives[primitive as usize].instance;
        let instance = &self.scene.instances[index as usize];
        match &self.scene.geometries[instance.geometry as usize] {
            Geometry::Sphere(sphere) => {
                for lane in rays.active_lanes() {
                    let ray = rays.ray(lane);
                    if let Some(t) = sphere_hit(sphere, instance, &ray) {
                        rays.offer(
                            lane,
                            &Hit {
                                instance: index,
                                primitive: 0,
                                t,
                                u: 0.0,
                                v: 0.0,
                            },
                        );
                    }
                }
            }
            Geometry::Mesh(_) => {
                let Some(object_scene) = &self.object_scenes[instance.geometry as usize] else {
                    return;
                };
                let mut packet = rays.object_packet(instance);
                packet.drop_untraceable();
                Query::new(order).intersect(object_scene, &mut packet, self.object_width(rays));
                for lane in 0..rays.count {
                    if let Some(hit) = packet.hit(lane) {
                        rays.offer(
                            lane,
                            &Hit {
                                instance: index,
                                ..hit
                            },
                        );
                    }
                }
            }
        }
    }

    /// Blocks those of `rays` that meet primitive `primitive`.
    fn occluded(&self, primitive: u32, rays: &mut RayRows, order: RayOrder) {
        let index = self.primitives[primitive as usize].instance;
        let instance = &self.scene.instances[index as usize];
        match &self.scene.geometries[instance.geometry as usize] {
            Geometry::Sphere(sphere) => {
                for lane in rays.active_lanes() {
                    let ray = rays.ray(lane);
                    if sphere_hit(sphere, instance, &ray).is_some() {
                        rays.block(lane);
                    }
                }
            }
            Geometry::Mesh(_) => {
                let Some(object_scene) = &self.object_scenes[instance.geometry as usize] else {
                    return;
                };
                let mut packet = rays.object_packet(instance);
                packet.drop_untraceable();
                Query::new(order).occluded(object_scene, &mut packet, self.object_width(rays));
                for lane in 0..rays.count {
                    if packet.is_blocked(lane) {
                        rays.block(lane);
                    }
                }
            }
        }
    }

    /// Single rays stay single in object space.
    fn object_width(&self, rays: &RayRows) -> Width {
        if rays.count == 1 { Width::One } else { self.width }
    }
}

/// The nearest hit of an exact f32 ray with a placed sphere, worked out in f64; `t` is rounded once at the end.
fn sphere_hit(sphere: &Sphere, instance: &Instance, ray: &Ray) -> Option<f32> {
    let map = &instance.object_from_world;
    let origin = map.transform_point3(ray.origin.as_dvec3());
    let direction = map.transform_vector3(ray.direction.as_dvec3());
    let t = sphere.intersect(origin, direction, ray.t_near.into(), ray.t_far.into())? as f32;
    // Rounding may carry t over an end of the interval.
    Some(t.clamp(ray.t_near, ray.t_far))
}

/// Part of a coordinate's magnitude by which the box of a placed geometry is padded: the object-space rays are rounded
/// to f32, which moves them against the geometry by a few 2^-24 of the largest coordinate involved.
const PLACEMENT_PADDING: f64 = 1.0 / (1 << 20) as f64;

/// The box of a placed geometry.
pub(super) fn world_bounds(object: Bounds, instance: &Instance) -> Bounds {
    let world = object.transformed(&instance.world_from_object);
    let padding = DVec3::splat(PLACEMENT_PADDING * world.magnitude());
    Bounds {
        min: world.min - padding,
        max: world.max + padding,
    }
}

/// The rays of a callback: rows of `count` 32-bit values, in the order of `RTCRayHitN`.
struct RayRows<'a> {
    values: &'a mut [f32],
    /// What the callback answers: -1 for lanes that have met something.
    met: &'a mut [i32],
    /// The lanes that Embree asks about.
    active: [bool; LANES],
    count: usize,
}

/// Rows of `RTCRayHitN`.
mod row {
    pub(super) const ORIGIN: usize = 0;
    pub(super) const T_NEAR: usize = 3;
    pub(super) const DIRECTION: usize = 4;
    pub(super) const T_FAR: usize = 8;
    pub(super) const U: usize = 15;
    pub(super) const V: usize = 16;
    pub(super) const PRIMITIVE: usize = 17;
    pub(super) const GEOMETRY: usize = 18;
    pub(super) const INSTANCE: usize = 19;
    /// Rows of a ray alone, and of a ray with a hit.
    pub(super) const RAY_COUNT: usize = 12;
    pub(super) const RAY_HIT_COUNT: usize = 20;
}

impl RayRows<'_> {
    /// Takes hold of a callback's rays. None of them has met anything yet, which Embree 4 wants to be told.
    fn new<'a>(values: &'a mut [f32], valid: &'a mut [i32]) -> RayRows<'a> {
        let count = valid.len().min(LANES);
        let active = std::array::from_fn(|lane| lane < count && valid[lane] != 0);
        valid.fill(0);
        RayRows {
            values,
            met: valid,
            active,
            count,
        }
    }

    #[inline(always)]
    fn get(&self, row: usize, lane: usize) -> f32 {
        self.values[row * self.count + lane]
    }

    #[inline(always)]
    fn set(&mut self, row: usize, lane: usize, value: f32) {
        self.values[row * self.count + lane] = value;
    }

    fn active_lanes(&self) -> impl Iterator<Item = usize> + use<> {
        let (active, count) = (self.active, self.count);
        (0..count).filter(move |&lane| active[lane])
    }

    #[inline(always)]
    fn ray(&self, lane: usize) -> Ray {
        let vector = |row: usize| {
            Vec3::new(
                self.get(row, lane),
                self.get(row + 1, lane),
                self.get(row + 2, lane),
            )
        };
        Ray {
            origin: vector(row::ORIGIN),
            direction: vector(row::DIRECTION),
            t_near: self.get(row::T_NEAR, lane),
            t_far: self.get(row::T_FAR, lane),
        }
    }

    /// The active rays in an instance's object space.
    fn object_packet(&self, instance: &Instance) -> RayPacket {
        let mut packet = RayPacket::EMPTY;
        for lane in self.active_lanes() {
            packet.set(lane, &object_ray(&instance.object_from_world, &self.ray(lane)));
        }
        packet
    }

    /// Takes `hit` if it is nearer than what the lane has, or equally near and lower by number.
    fn offer(&mut self, lane: usize, hit: &Hit) {
        let t_far = self.get(row::T_FAR, lane);
        let held = (
            self.get(row::GEOMETRY, lane).to_bits(),
            self.get(row::PRIMITIVE, lane).to_bits(),
        );
        let lower = held.0 == NO_HIT || (hit.instance, hit.primitive) < held;
        if !(hit.t < t_far || (hit.t == t_far && lower)) {
            return;
        }
        self.set(row::T_FAR, lane, hit.t);
        self.set(row::U, lane, hit.u);
        self.set(row::V, lane, hit.v);
        self.set(row::PRIMITIVE, lane, f32::from_bits(hit.primitive));
        self.set(row::GEOMETRY, lane, f32::from_bits(hit.instance));
        self.set(row::INSTANCE, lane, f32::from_bits(NO_HIT));
        self.met[lane] = -1;
    }

    fn block(&mut self, lane: usize) {
        self.set(row::T_FAR, lane, f32::NEG_INFINITY);
        self.met[lane] = -1;
    }
}

/// Embree asks for the box of a user primitive.
pub(super) unsafe extern "C" fn bounds(arguments: *const sys::RTCBoundsFunctionArguments) {
    // SAFETY: Embree passes valid arguments.
    let arguments = unsafe { &*arguments };
    // SAFETY: the user data is the `UserGeometry` that `attach_user` has set.
    let user = unsafe { &*arguments.geometryUserPtr.cast::<UserGeometry>() };
    // SAFETY: Embree passes a box to be written.
    let out = unsafe { &mut *arguments.bounds_o };
    user.guard(|| {
        let (low, high) = user.primitives[arguments.primID as usize].bounds.to_f32_outward();
        [out.lower_x, out.lower_y, out.lower_z] = low;
        [out.upper_x, out.upper_y, out.upper_z] = high;
    });
}

/// Embree asks for the nearest hits of a user primitive.
pub(super) unsafe extern "C" fn intersect(arguments: *const sys::RTCIntersectFunctionNArguments) {
    // SAFETY: Embree passes valid arguments.
    let arguments = unsafe { &*arguments };
    // SAFETY: the user data is the `UserGeometry` that `attach_user` has set.
    let user = unsafe { &*arguments.geometryUserPtr.cast::<UserGeometry>() };
    // SAFETY: every query is made with a `Query`.
    let order = unsafe { Query::order_of(arguments.context.cast()) };
    let count = arguments.N as usize;
    // SAFETY: Embree passes N rays as rows of N values, which the callback may read and write.
    let values = unsafe { from_raw_parts_mut(arguments.rayhit.cast(), row::RAY_HIT_COUNT * count) };
    // SAFETY: Embree passes a mask of N values, apart from the rays.
    let valid = unsafe { from_raw_parts_mut(arguments.valid, count) };
    let mut rays = RayRows::new(values, valid);
    user.guard(|| user.intersect(arguments.primID, &mut rays, order));
}

/// Embree asks which rays meet a user primitive.
pub(super) unsafe extern "C" fn occluded(arguments: *const sys::RTCOccludedFunctionNArguments) {
    // SAFETY: Embree passes valid arguments.
    let arguments = unsafe { &*arguments };
    // SAFETY: the user data is the `UserGeometry` that `attach_user` has set.
    let user = unsafe { &*arguments.geometryUserPtr.cast::<UserGeometry>() };
    // SAFETY: every query is made with a `Query`.
    let order = unsafe { Query::order_of(arguments.context.cast()) };
    let count = arguments.N as usize;
    // SAFETY: Embree passes N rays as rows of N values, which the callback may read and write.
    let values = unsafe { from_raw_parts_mut(arguments.ray.cast(), row::RAY_COUNT * count) };
    // SAFETY: Embree passes a mask of N values, apart from the rays.
    let valid = unsafe { from_raw_parts_mut(arguments.valid, count) };
    let mut rays = RayRows::new(values, valid);
    user.guard(|| user.occluded(arguments.primID, &mut rays, order));
}
