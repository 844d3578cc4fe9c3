//! Our own backend: an axis-aligned BSP tree in two levels, in safe Rust.
//!
//! The world tree holds the triangles of all baked meshes, the analytic shapes and the placed meshes; every mesh that is
//! placed has a tree of its own, which the ray enters in object space. [`builder`] cuts the cells, [`heuristic`] says
//! where; [`reference`] is the walk of the lecture, plain and slow.

mod builder;
mod clip;
mod heuristic;
mod primitives;
mod reference;
mod slack;

use std::collections::BTreeSet;

use super::brute::{ray_in, shape_hit, sphere_hit};
use super::{Accel, AccelError, AccelOptions, AccelReport, Hit, LANES, RayOrder, RayPacket};
use crate::mesh::Mesh;
use crate::mesh::triangle::Shear;
use crate::numeric::Ray;
use crate::scene::{Geometry, Scene};
use builder::Built;
use primitives::{Primitives, RunKind};
use reference::{PlaneTree, Walk};

/// The BSP trees of a scene.
pub struct BspAccel<'s> {
    scene: &'s Scene,
    world: Level<'s>,
    /// By geometry; absent where no instance but a baked one uses it.
    objects: Vec<Option<Level<'s>>>,
    report: AccelReport,
}

/// One tree and what its numbers stand for.
struct Level<'s> {
    primitives: Primitives<'s>,
    planes: PlaneTree,
}

impl<'s> BspAccel<'s> {
    /// Builds the trees of a validated scene.
    pub fn build(scene: &'s Scene, options: &AccelOptions) -> Result<BspAccel<'s>, AccelError> {
        Self::build_reference(scene, options)
    }

    /// Builds trees that are walked by the reference kernel: plain, slow, and what the fast kernels are tested against.
    pub fn build_reference(scene: &'s Scene, options: &AccelOptions) -> Result<BspAccel<'s>, AccelError> {
        in_pool(options.threads, || BspAccel::build_here(scene, options))
    }

    fn build_here(scene: &'s Scene, options: &AccelOptions) -> Result<BspAccel<'s>, AccelError> {
        let mut peak = 0;
        let mut bytes = 0;
        let mut level = |primitives: Option<Primitives<'s>>, progress: &(dyn Fn(f64) + Sync)| {
            let primitives = primitives.ok_or(AccelError::OutOfMemory)?;
            let Built { root, peak_bytes } = builder::build(&primitives, progress);
            let planes = PlaneTree::new(&root);
            peak = peak.max(bytes + peak_bytes);
            bytes += planes.byte_count();
            Ok(Level { primitives, planes })
        };
        let silent = |_: f64| ();
        let placed = placed_meshes(scene);
        let mut objects: Vec<Option<Level>> = Vec::new();
        for (index, geometry) in scene.geometries.iter().enumerate() {
            objects.push(match geometry {
                Geometry::Mesh(mesh) if placed.contains(&index) => {
                    Some(level(Primitives::of_mesh(mesh), &silent)?)
                }
                _ => None,
            });
        }
        let world = level(Primitives::of_world(scene), options.progress.unwrap_or(&silent))?;
        let report = AccelReport {
            bytes,
            peak_bytes: peak.max(bytes),
            embree: None,
            summary: format!(
                "BSP of {} primitives, {} trees",
                world.primitives.count(),
                1 + placed.len()
            ),
        };
        Ok(BspAccel {
            scene,
            world,
            objects,
            report,
        })
    }

    fn nearest(&self, ray: &Ray) -> Option<Hit> {
        let mut best = Best::new(ray.t_far);
        let shear = Shear::new(ray);
        let span = [ray.t_near, ray.t_far.min(f32::MAX)];
        self.world.planes.walk(ray.origin, ray.direction, span, |number| {
            let run = self.world.primitives.run(number);
            match &run.kind {
                RunKind::Triangles(mesh) => {
                    best.offer_triangle(&shear, mesh, ray, run.instance, number - run.first);
                }
                RunKind::Whole(_) => self.nearest_within(run.instance, ray, &mut best),
            }
            Walk::Until(best.t)
        });
        best.hit
    }

    fn nearest_within(&self, index: u32, ray: &Ray, best: &mut Best) {
        let instance = &self.scene.instances[index as usize];
        match &self.scene.geometries[instance.geometry as usize] {
            Geometry::Sphere(sphere) => {
                if let Some(t) = sphere_hit(instance, sphere, ray) {
                    best.offer(shape_hit(index, t));
                }
            }
            Geometry::Mesh(mesh) => {
                let Some(object) = &self.objects[instance.geometry as usize] else {
                    return;
                };
                let ray = ray_in(instance, ray);
                let shear = Shear::new(&ray);
                object
                    .planes
                    .walk(ray.origin, ray.direction, [ray.t_near, best.t], |number| {
                        best.offer_triangle(&shear, mesh, &ray, index, number);
                        Walk::Until(best.t)
                    });
            }
        }
    }

    fn is_blocked(&self, ray: &Ray) -> bool {
        let mut blocked = false;
        let shear = Shear::new(ray);
        let span = [ray.t_near, ray.t_far.min(f32::MAX)];
        self.world.planes.walk(ray.origin, ray.direction, span, |number| {
            let run = self.world.primitives.run(number);
            blocked = match &run.kind {
                RunKind::Triangles(mesh) => is_blocked_by(&shear, mesh, ray, number - run.first),
                RunKind::Whole(_) => self.is_blocked_within(run.instance, ray),
            };
            if blocked { Walk::Done } else { Walk::Until(span[1]) }
        });
        blocked
    }

    fn is_blocked_within(&self, index: u32, ray: &Ray) -> bool {
        let instance = &self.scene.instances[index as usize];
        match &self.scene.geometries[instance.geometry as usize] {
            Geometry::Sphere(sphere) => sphere_hit(instance, sphere, ray).is_some(),
            Geometry::Mesh(mesh) => {
                let Some(object) = &self.objects[instance.geometry as usize] else {
                    return false;
                };
                let mut blocked = false;
                let ray = ray_in(instance, ray);
                let shear = Shear::new(&ray);
                let span = [ray.t_near, ray.t_far.min(f32::MAX)];
                object.planes.walk(ray.origin, ray.direction, span, |number| {
                    blocked = is_blocked_by(&shear, mesh, &ray, number);
                    if blocked { Walk::Done } else { Walk::Until(span[1]) }
                });
                blocked
            }
        }
    }
}

impl Accel for BspAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], _order: RayOrder) {
        for packet in packets {
            packet.drop_untraceable();
            for lane in 0..LANES {
                if packet.is_active(lane)
                    && let Some(hit) = self.nearest(&packet.ray(lane))
                {
                    packet.set_hit(lane, &hit);
                }
            }
        }
    }

    fn occluded(&self, packets: &mut [RayPacket], _order: RayOrder) {
        for packet in packets {
            packet.drop_untraceable();
            for lane in 0..LANES {
                if packet.is_active(lane) && self.is_blocked(&packet.ray(lane)) {
                    packet.set_blocked(lane);
                }
            }
        }
    }

    fn report(&self) -> AccelReport {
        self.report.clone()
    }
}

/// The best hit so far.
struct Best {
    t: f32,
    hit: Option<Hit>,
}

impl Best {
    fn new(t_far: f32) -> Best {
        Best {
            t: t_far.min(f32::MAX),
            hit: None,
        }
    }

    /// Keeps the better hit: smallest `t`, then instance, then primitive. `hit.t` is within the ray's interval.
    fn offer(&mut self, hit: Hit) {
        let rank = |h: &Hit| (h.instance, h.primitive);
        if self
            .hit
            .is_none_or(|b| hit.t < b.t || (hit.t == b.t && rank(&hit) < rank(&b)))
        {
            self.t = hit.t;
            self.hit = Some(hit);
        }
    }

    fn offer_triangle(&mut self, shear: &Shear, mesh: &Mesh, ray: &Ray, instance: u32, primitive: u32) {
        let corners = mesh.corners(primitive).map(|p| p.to_array());
        if let Some(hit) = shear.intersect(corners, ray.t_near, self.t) {
            self.offer(Hit {
                instance,
                primitive,
                t: hit.t,
                u: hit.u,
                v: hit.v,
            });
        }
    }
}

fn is_blocked_by(shear: &Shear, mesh: &Mesh, ray: &Ray, primitive: u32) -> bool {
    let corners = mesh.corners(primitive).map(|p| p.to_array());
    shear.intersect(corners, ray.t_near, ray.t_far).is_some()
}

/// The meshes that need a tree in their own space.
fn placed_meshes(scene: &Scene) -> BTreeSet<usize> {
    let placed = scene.instances.iter().filter(|instance| !instance.is_identity());
    placed.map(|instance| instance.geometry as usize).collect()
}

/// Runs `work` on `threads` threads of its own, or on the current pool for 0.
fn in_pool<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    if threads == 0 || threads == rayon::current_num_threads() {
        return work();
    }
    // Where the system grants no more threads, the current ones do the work.
    match rayon::ThreadPoolBuilder::new().num_threads(threads).build() {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    }
}
