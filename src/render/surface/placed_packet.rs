//! Hits of sixteen rays on analytic shapes and transformed instances, in f64.
//!
//! Each lane has the transform of its instance. What lies between the transforms depends on the geometry: the lanes of
//! one shape are computed at once, and those of transformed triangles are.

use glam::{DAffine3, DMat3, DVec3};
use multiversion::multiversion;

use super::instance_view::InteractionKind;
use super::interaction::SurfaceScene;
use super::packet::{SurfacePacket, lane};
use super::uv_frame::UvFrame;
use super::vertex_fetch::FetchedVertices;
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{HitErrorBound, LANES, Lanes, Lanes3, transform_normal, triangle_spawn_error};
use crate::scene::{Instance, InstanceTransform};
use crate::shape::{Implicit, ObjectHitPacket, Shape, Sphere, set_vector, vector};

/// Working memory for the hits of a packet that are not on world-space triangles.
pub(super) struct PlacedHits {
    transforms: TransformLanes,
    object: ObjectHitPacket,
    /// Lanes that hit an analytic shape or a transformed triangle.
    mask: Lanes<bool>,
    /// Shading normals of the lanes of smooth triangles in world space; zero in other lanes.
    ns: Lanes3<f64>,
}

impl PlacedHits {
    pub(super) const ZERO: PlacedHits = PlacedHits {
        transforms: TransformLanes::IDENTITY,
        object: ObjectHitPacket::ZERO,
        mask: [false; LANES],
        ns: [[0.0; LANES]; 3],
    };
}

/// Transforms of the instances that sixteen rays hit.
struct TransformLanes {
    world_from_object: AffineLanes,
    object_from_world: AffineLanes,
    /// Lanes whose object space is world space.
    is_identity: Lanes<bool>,
}

/// Sixteen affine maps by columns, the translation last.
struct AffineLanes([Lanes3<f64>; 4]);

impl AffineLanes {
    const IDENTITY: AffineLanes = AffineLanes([
        [[1.0; LANES], [0.0; LANES], [0.0; LANES]],
        [[0.0; LANES], [1.0; LANES], [0.0; LANES]],
        [[0.0; LANES], [0.0; LANES], [1.0; LANES]],
        [[0.0; LANES]; 3],
    ]);

    /// Returns the map of lane `l`.
    #[inline(always)]
    fn get(&self, l: usize) -> DAffine3 {
        let [x, y, z, translation] = &self.0;
        DAffine3 {
            matrix3: DMat3::from_cols(vector(x, l), vector(y, l), vector(z, l)),
            translation: vector(translation, l),
        }
    }

    /// Sets the maps of all lanes to `map`.
    #[inline(always)]
    fn fill(&mut self, map: &DAffine3) {
        let columns = [map.x_axis, map.y_axis, map.z_axis, map.translation];
        self.0 = columns.map(|column| column.to_array().map(|x| [x; LANES]));
    }

    /// Sets the map of lane `l`.
    #[inline(always)]
    fn set(&mut self, l: usize, map: &DAffine3) {
        let columns = [map.x_axis, map.y_axis, map.z_axis, map.translation];
        for (lanes, column) in self.0.iter_mut().zip(columns) {
            set_vector(lanes, l, column);
        }
    }
}

impl TransformLanes {
    const IDENTITY: TransformLanes = TransformLanes {
        world_from_object: AffineLanes::IDENTITY,
        object_from_world: AffineLanes::IDENTITY,
        is_identity: [true; LANES],
    };

    /// Sets the transforms of all lanes to that of an instance at rest.
    #[inline(always)]
    fn fill(&mut self, pose: &InstanceTransform) {
        self.world_from_object.fill(&pose.world_from_object());
        self.object_from_world.fill(&pose.object_from_world());
        self.is_identity = [pose.is_identity(); LANES];
    }

    /// Sets the transform of lane `l`.
    #[inline(always)]
    fn set(&mut self, l: usize, pose: &InstanceTransform) {
        self.world_from_object.set(l, &pose.world_from_object());
        self.object_from_world.set(l, &pose.object_from_world());
        self.is_identity[l] = pose.is_identity();
    }
}

/// Computes the lanes of `surfaces` that hit analytic shapes, points or transformed instances, all of them `only` if it
/// is given; compiled for several instruction sets.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn compute_placed_hits(
    scene: &SurfaceScene,
    (packet, gathered): (&RayPacket, &FetchedVertices),
    only: Option<&Instance>,
    hits: &mut PlacedHits,
    surfaces: &mut SurfacePacket,
) {
    // Look up the transforms and shapes of the lanes
    match only.filter(|instance| !instance.is_moving()) {
        Some(instance) => hits.transforms.fill(&instance.pose(0.0)),
        None => scene.gather_transforms(packet, &mut hits.transforms),
    }
    let mut shapes = [None; LANES];
    let mut triangles = [false; LANES];
    let mut needs_uv_frames = false;
    for l in 0..LANES {
        hits.mask[l] = false;
        if packet.instance[l] == NO_HIT {
            continue;
        }
        let view = scene.view(packet.instance[l]);
        hits.mask[l] = view.needs_scalar_path();
        needs_uv_frames |= view.needs_uv_frames;
        hits.object.part[l] = packet.primitive[l];
        match &view.kind {
            InteractionKind::Mesh(_) => triangles[l] = view.is_placed,
            InteractionKind::Shape(shape) => {
                if let Shape::Sphere(sphere) = shape {
                    hits.object.set_sphere(l, sphere);
                }
                shapes[l] = Some(*shape);
            }
            InteractionKind::Points(points) => {
                // A sphere has one part
                hits.object.part[l] = 0;
                if let Shape::Sphere(sphere) = points.cloud.shape(packet.primitive[l]) {
                    hits.object.set_sphere(l, &sphere);
                }
                shapes[l] = Some(&ANY_SPHERE);
            }
        }
    }
    // Compute the hits in object space, taking the lanes of one shape after the other
    hits.transform_rays(packet);
    let mut left = shapes;
    while let Some(shape) = left.iter().find_map(|shape| *shape) {
        let mut mask = [false; LANES];
        for l in 0..LANES {
            mask[l] = left[l].is_some_and(|other| are_located_together(shape, other));
            left[l] = left[l].filter(|_| !mask[l]);
        }
        hits.object.locate(shape, &mask);
    }
    hits.ns = [[0.0; LANES]; 3];
    if triangles.contains(&true) {
        hits.locate_triangles(packet, gathered, &triangles);
    }
    // Transform them to world space
    hits.place(surfaces);
    if needs_uv_frames {
        for l in 0..LANES {
            if let Some(shape) = shapes[l].filter(|_| scene.view(packet.instance[l]).needs_uv_frames) {
                surfaces.shape_frames[l] = hits.uv_frame(shape, l);
            }
        }
    }
}

/// Sphere that stands for those of points, of which each lane has its own.
const ANY_SPHERE: Shape = Shape::Sphere(Sphere::UNIT);

/// Returns whether the lanes of both shapes are computed at once. Each lane of a sphere has its own centre and radius.
#[inline(always)]
fn are_located_together(a: &Shape, b: &Shape) -> bool {
    match (a, b) {
        (Shape::Sphere(_), Shape::Sphere(_))
        | (Shape::Plane, Shape::Plane)
        | (Shape::Cube, Shape::Cube)
        | (Shape::Disk, Shape::Disk)
        | (Shape::Quad, Shape::Quad) => true,
        _ => std::ptr::eq(a, b),
    }
}

impl SurfaceScene<'_> {
    /// Sets the transforms of all lanes that hit something.
    #[inline(always)]
    fn gather_transforms(&self, packet: &RayPacket, transforms: &mut TransformLanes) {
        for l in 0..LANES {
            if packet.instance[l] != NO_HIT {
                transforms.set(l, &self.pose(packet, l));
            }
        }
    }
}

impl PlacedHits {
    /// Transforms the rays to object space.
    #[inline(always)]
    fn transform_rays(&mut self, packet: &RayPacket) {
        for l in 0..LANES {
            let inverse = self.transforms.object_from_world.get(l);
            let origin = inverse.transform_point3(lane(&packet.origin, l).as_dvec3());
            let direction = inverse.transform_vector3(lane(&packet.direction, l).as_dvec3());
            set_vector(&mut self.object.origin, l, origin);
            set_vector(&mut self.object.direction, l, direction);
            self.object.reported[l] = f64::from(packet.t_far[l]);
        }
    }

    /// Computes the points of the lanes in `mask`, which hit triangles of meshes, and their shading normals.
    #[inline(always)]
    fn locate_triangles(&mut self, packet: &RayPacket, gathered: &FetchedVertices, mask: &Lanes<bool>) {
        let object = &mut self.object;
        for l in 0..LANES {
            let corner = |k: usize| lane(&gathered.corners[k], l).as_dvec3();
            let (a, b, c) = (corner(0), corner(1), corner(2));
            let (e1, e2) = (b - a, c - a);
            let (u, v) = (f64::from(packet.u[l]), f64::from(packet.v[l]));
            let p = a + u * e1 + v * e2;
            let n = e1.cross(e2).normalize_or_zero();
            let error = triangle_spawn_error(a.as_vec3(), e1.as_vec3(), e2.as_vec3()).0;
            for axis in 0..3 {
                object.p[axis][l] = if mask[l] { p[axis] } else { object.p[axis][l] };
                object.n[axis][l] = if mask[l] { n[axis] } else { object.n[axis][l] };
                object.error[axis][l] = if mask[l] {
                    error[axis]
                } else {
                    object.error[axis][l]
                };
            }
        }
        // Transform the interpolated normals
        if !gathered.smooth.contains(&true) {
            return;
        }
        for l in 0..LANES {
            let corner = |k: usize| lane(&gathered.normals[k], l).as_dvec3();
            let (u, v) = (f64::from(packet.u[l]), f64::from(packet.v[l]));
            let n = (1.0 - u - v) * corner(0) + u * corner(1) + v * corner(2);
            let ns = transform_normal(&self.transforms.world_from_object.get(l).matrix3, n);
            for axis in 0..3 {
                self.ns[axis][l] = if mask[l] & gathered.smooth[l] {
                    ns[axis]
                } else {
                    0.0
                };
            }
        }
    }

    /// Transforms the points to world space, turns the normals to the side of the ray, and stores the lanes.
    #[inline(always)]
    fn place(&self, surfaces: &mut SurfacePacket) {
        let PlacedHits {
            transforms,
            object,
            mask,
            ns,
        } = self;
        for l in 0..LANES {
            // Transform the point
            let map = transforms.world_from_object.get(l);
            let inverse = transforms.object_from_world.get(l);
            let (p, n, error) = (
                vector(&object.p, l),
                vector(&object.n, l),
                vector(&object.error, l),
            );
            let p_world = map.transform_point3(p);
            let n_world = transform_normal(&map.matrix3, n);
            let error_world = HitErrorBound(error).transformed(&map, &inverse, p_world).0;
            let is_identity = transforms.is_identity[l];
            let pick = |object: DVec3, world: DVec3| {
                DVec3::new(
                    if is_identity { object.x } else { world.x },
                    if is_identity { object.y } else { world.y },
                    if is_identity { object.z } else { world.z },
                )
            };
            let (p, n) = (pick(p, p_world), pick(n, n_world));
            let error = HitErrorBound(pick(error, error_world));
            // Turn the normals to the side of the ray
            let wo = lane(&surfaces.wo, l).as_dvec3();
            let front = !(n.dot(wo) < 0.0);
            let ng = n * if front { 1.0 } else { -1.0 };
            let ns = vector(ns, l);
            let ns = ns * if ns.dot(ng) < 0.0 { -1.0 } else { 1.0 };
            // A normal of zero is not on the side of the ray
            let is_seen = ns.dot(wo) > 0.0;
            // Store the lane
            let hit = mask[l];
            surfaces.front[l] = if hit { front } else { surfaces.front[l] };
            let error = error.along(ng);
            surfaces.error[l] = if hit { error } else { surfaces.error[l] };
            for axis in 0..3 {
                let ns = if is_seen { ns[axis] } else { ng[axis] } as f32;
                let (p, ng) = (p[axis], ng[axis]);
                surfaces.exact_normal[axis][l] = if hit { ng } else { surfaces.exact_normal[axis][l] };
                surfaces.p[axis][l] = if hit { p } else { surfaces.p[axis][l] };
                surfaces.ng[axis][l] = if hit { ng as f32 } else { surfaces.ng[axis][l] };
                surfaces.ns[axis][l] = if hit { ns } else { surfaces.ns[axis][l] };
            }
        }
    }

    /// Returns the texture coordinates of lane `l` on `shape`, and the derivatives of the point by them in world space.
    fn uv_frame(&self, shape: &Shape, l: usize) -> UvFrame {
        let point = shape.point(vector(&self.object.at, l), self.object.part[l]);
        let derivatives = [point.dpdu, point.dpdv];
        let map = self.transforms.world_from_object.get(l);
        UvFrame {
            uv: point.uv.map(|x| x as f32),
            derivatives: if self.transforms.is_identity[l] {
                derivatives
            } else {
                derivatives.map(|derivative| map.transform_vector3(derivative))
            },
        }
    }
}
