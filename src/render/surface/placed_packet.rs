//! Hits of sixteen rays on analytic shapes and transformed instances, in f64.
//!
//! Each lane has the transform of its instance. What lies between the transforms depends on the geometry: the lanes of
//! one shape are computed at once, and those of transformed triangles are.

use glam::{DAffine3, DMat3, DVec3};
use multiversion::multiversion;

use super::instance_view::{InstanceView, InteractionKind};
use super::packet::{SurfacePacket, lane};
use super::uv_frame::UvFrame;
use super::vertex_fetch::FetchedVertices;
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{HitErrorBound, LANES, Lanes, Lanes3, transform_normal, triangle_spawn_error};
use crate::scene::{Instance, InstanceTransform};
use crate::shape::{Implicit, LocatedPoint, ObjectHitPacket, Shape, Sphere, set_masked, set_vector, vector};

/// Working memory for the hits of a packet that are not on world-space triangles.
pub(super) struct PlacedHits {
    /// Transforms of the instances that were hit.
    transforms: TransformLanes,
    /// Rays and hits in object space.
    object: ObjectHitPacket,
    /// Lanes that hit an analytic shape or a transformed triangle.
    mask: Lanes<bool>,
    /// Shading normals of the lanes of smooth triangles in world space; zero in other lanes.
    ns: Lanes3<f64>,
}

impl PlacedHits {
    /// Memory before its first packet.
    pub(super) const ZERO: PlacedHits = PlacedHits {
        transforms: TransformLanes::IDENTITY,
        object: ObjectHitPacket::ZERO,
        mask: [false; LANES],
        ns: [[0.0; LANES]; 3],
    };
}

/// Transforms of the instances that sixteen rays hit.
struct TransformLanes {
    /// Maps from object space to world space.
    world_from_object: AffineLanes,
    /// Maps from world space to object space.
    object_from_world: AffineLanes,
    /// Lanes whose object space is world space.
    is_identity: Lanes<bool>,
}

/// Sixteen affine maps by columns, the translation last.
struct AffineLanes([Lanes3<f64>; 4]);

impl AffineLanes {
    /// Maps that leave points unchanged.
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
        for column in 0..4 {
            for axis in 0..3 {
                self.0[column][axis] = [columns[column][axis]; LANES];
            }
        }
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
    /// Transforms of instances whose object space is world space.
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

/// Instances of a scene with their shading data.
pub(super) struct ViewedInstances<'a> {
    /// Instances of the scene.
    pub(super) instances: &'a [Instance],
    /// Shading data of each instance.
    pub(super) views: &'a [InstanceView<'a>],
    /// Instance of all hits, if they have one in common.
    pub(super) only: Option<u32>,
}

impl<'a> ViewedInstances<'a> {
    /// Returns the shading data of the instance that lane `l` hit.
    #[inline(always)]
    fn view(&self, packet: &RayPacket, l: usize) -> &'a InstanceView<'a> {
        &self.views[packet.instance[l] as usize]
    }

    /// Looks up the transforms of all lanes that hit something.
    #[inline(always)]
    fn gather_transforms(&self, packet: &RayPacket, transforms: &mut TransformLanes) {
        let only = self.only.map(|instance| &self.instances[instance as usize]);
        if let Some(instance) = only.filter(|instance| !instance.is_moving()) {
            return transforms.fill(&instance.pose(0.0));
        }
        for l in 0..LANES {
            if packet.instance[l] != NO_HIT {
                let instance = &self.instances[packet.instance[l] as usize];
                transforms.set(l, &instance.pose(packet.time[l]));
            }
        }
    }
}

/// Computes the lanes of `surfaces` that hit analytic shapes, points or transformed instances; compiled for several
/// instruction sets.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn compute_placed_hits(
    scene: &ViewedInstances,
    (packet, gathered): (&RayPacket, &FetchedVertices),
    hits: &mut PlacedHits,
    surfaces: &mut SurfacePacket,
) {
    // Look up the transforms and shapes of the lanes
    scene.gather_transforms(packet, &mut hits.transforms);
    let mut shapes = [None; LANES];
    let mut triangles = [false; LANES];
    let mut needs_uv_frames = false;
    for l in 0..LANES {
        hits.mask[l] = false;
        if packet.instance[l] == NO_HIT {
            continue;
        }
        let view = scene.view(packet, l);
        hits.mask[l] = view.needs_object_space();
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
            if let Some(shape) = shapes[l].filter(|_| scene.view(packet, l).needs_uv_frames) {
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
        for l in 0..LANES {
            let corner = |k: usize| lane(&gathered.corners[k], l).as_dvec3();
            let (a, b, c) = (corner(0), corner(1), corner(2));
            let (e1, e2) = (b - a, c - a);
            let (u, v) = (f64::from(packet.u[l]), f64::from(packet.v[l]));
            let point = LocatedPoint {
                p: a + u * e1 + v * e2,
                n: e1.cross(e2).normalize_or_zero(),
                error: triangle_spawn_error(a.as_vec3(), e1.as_vec3(), e2.as_vec3()),
            };
            self.object.store(l, mask, &point);
        }
        // Transform the interpolated normals
        if !gathered.smooth.contains(&true) {
            return;
        }
        let mut smooth = gathered.smooth;
        for l in 0..LANES {
            smooth[l] &= mask[l];
        }
        for l in 0..LANES {
            let corner = |k: usize| lane(&gathered.normals[k], l).as_dvec3();
            let (u, v) = (f64::from(packet.u[l]), f64::from(packet.v[l]));
            let n = (1.0 - u - v) * corner(0) + u * corner(1) + v * corner(2);
            let map = self.transforms.world_from_object.get(l);
            set_masked(&mut self.ns, l, &smooth, transform_normal(&map.matrix3, n));
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
            set_masked(&mut surfaces.p, l, mask, p);
            set_masked(&mut surfaces.exact_normal, l, mask, ng);
            surfaces.front[l] = if hit { front } else { surfaces.front[l] };
            let error = error.along(ng);
            surfaces.error[l] = if hit { error } else { surfaces.error[l] };
            for axis in 0..3 {
                let ns = if is_seen { ns[axis] } else { ng[axis] } as f32;
                let ng = ng[axis] as f32;
                surfaces.ng[axis][l] = if hit { ng } else { surfaces.ng[axis][l] };
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

#[cfg(test)]
mod tests {
    use glam::{DQuat, Vec3};

    use super::*;
    use crate::accel::Hit;
    use crate::numeric::{Ray, SplitMix64};
    use crate::render::surface::shape_hit::world_point;

    /// Returns instances whose transforms are the identity, mirrored, non-uniform, tiny, huge and moving.
    fn instances() -> Vec<Instance> {
        let turn = DAffine3::from_quat(DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(-0.4));
        let shift = DAffine3::from_translation(DVec3::new(0.3, -2.0, 1.0));
        let scaled = |x, y, z| shift * turn * DAffine3::from_scale(DVec3::new(x, y, z));
        let maps = [
            DAffine3::IDENTITY,
            DAffine3::from_translation(DVec3::new(1.0, 2.0, -3.0)),
            scaled(2.0, 2.0, 2.0),
            scaled(-1.0, 1.0, 1.0),
            scaled(3.0, 0.02, -0.5),
            scaled(1e-9, 1e-9, 1e-9),
            scaled(1e7, 2e7, 1e7),
        ];
        let mut instances: Vec<Instance> = maps
            .iter()
            .map(|map| Instance::new("", 0, 0, *map).unwrap())
            .collect();
        instances.push(Instance::moving("", 0, 0, [maps[1], maps[2]]).unwrap());
        instances
    }

    fn bits(v: DVec3) -> [u64; 3] {
        v.to_array()
            .map(|x| if x.is_nan() { f64::NAN } else { x }.to_bits())
    }

    /// Normals and error of one lane, as they were computed one by one.
    struct Turned {
        front: bool,
        ng: DVec3,
        ns: DVec3,
        error: f64,
    }

    impl Turned {
        fn new(ng: DVec3, ns: Option<DVec3>, error: HitErrorBound, wo: DVec3) -> Turned {
            let front = !(ng.dot(wo) < 0.0);
            let ng = if front { ng } else { -ng };
            let mut ns = ns.unwrap_or(ng);
            if ns.dot(ng) < 0.0 {
                ns = -ns;
            }
            if !(ns.dot(wo) > 0.0) {
                ns = ng;
            }
            Turned {
                front,
                ng,
                ns,
                error: error.along(ng),
            }
        }

        fn assert_equals(&self, surfaces: &SurfacePacket, l: usize) {
            let ng = vector(&surfaces.exact_normal, l);
            assert_eq!(surfaces.front[l], self.front);
            assert_eq!(bits(ng), bits(self.ng), "{ng} {}", self.ng);
            assert_eq!(lane(&surfaces.ng, l), self.ng.as_vec3());
            assert_eq!(lane(&surfaces.ns, l), self.ns.as_vec3());
            assert_eq!(surfaces.error[l].to_bits(), self.error.to_bits());
        }
    }

    /// Returns a packet of rays through points near the origins of the instances' object spaces, and the instances.
    fn traced(random: &mut SplitMix64) -> (RayPacket, Vec<Instance>) {
        let instances = instances();
        let mut packet = RayPacket::EMPTY;
        for l in 0..LANES {
            let instance = (random.unit() * instances.len() as f64) as usize;
            let time = random.unit() as f32;
            let mut vector = |size: f64| DVec3::from_array([(); 3].map(|()| size * (random.unit() - 0.5)));
            let map = instances[instance].pose(time).world_from_object();
            let (from, to) = (vector(6.0), vector(2.2));
            let ray = Ray {
                time,
                ..Ray::new(
                    map.transform_point3(from).as_vec3(),
                    map.transform_vector3(to - from).as_vec3(),
                )
            };
            packet.set(l, &ray);
            if random.unit() < 0.8 {
                let (t, u) = (0.4 + 0.8 * random.unit() as f32, random.unit() as f32);
                let v = (1.0 - u) * random.unit() as f32;
                packet.set_hit(
                    l,
                    &Hit {
                        instance: instance as u32,
                        primitive: 0,
                        t,
                        u,
                        v,
                    },
                );
            } else {
                packet.set(l, &Ray::new(Vec3::NAN, Vec3::NAN));
            }
        }
        (packet, instances)
    }

    /// Returns packets of NaN, whose lanes with hits have the transforms of their instances.
    fn prepared(packet: &RayPacket, instances: &[Instance]) -> (PlacedHits, SurfacePacket) {
        let mut hits = PlacedHits::ZERO;
        let mut surfaces = SurfacePacket::new();
        surfaces.face_rays(packet);
        surfaces.p = [[f64::NAN; LANES]; 3];
        surfaces.error = [f64::NAN; LANES];
        for l in (0..LANES).filter(|&l| packet.instance[l] != NO_HIT) {
            let pose = instances[packet.instance[l] as usize].pose(packet.time[l]);
            hits.transforms.set(l, &pose);
            hits.mask[l] = true;
        }
        hits.transform_rays(packet);
        (hits, surfaces)
    }

    #[test]
    fn shapes_have_the_bits_of_single_points_for_every_transform() {
        let seed = 3;
        let mut random = SplitMix64::new(seed, 0);
        for shape in [Shape::Sphere(Sphere::UNIT), Shape::Plane, Shape::Cube] {
            for _ in 0..1000 {
                let (packet, instances) = traced(&mut random);
                let (mut hits, mut surfaces) = prepared(&packet, &instances);
                hits.object.locate(&shape, &hits.mask.clone());
                hits.place(&mut surfaces);
                for l in 0..LANES {
                    if packet.instance[l] == NO_HIT {
                        assert!(surfaces.p[0][l].is_nan() && surfaces.error[l].is_nan());
                        continue;
                    }
                    let pose = instances[packet.instance[l] as usize].pose(packet.time[l]);
                    let point = world_point(&pose, &shape, &packet.ray(l), 0);
                    let wo = lane(&surfaces.wo, l).as_dvec3();
                    assert_eq!(
                        bits(surfaces.point(l)),
                        bits(point.p),
                        "seed {seed}, lane {l}, {pose:?}"
                    );
                    Turned::new(point.n, None, point.error, wo).assert_equals(&surfaces, l);
                    let frame = hits.uv_frame(&shape, l);
                    assert_eq!(frame.uv, point.uv.map(|x| x as f32));
                    assert_eq!(frame.derivatives.map(bits), [point.dpdu, point.dpdv].map(bits));
                }
            }
        }
    }

    #[test]
    fn triangles_have_the_bits_of_single_hits_for_every_transform() {
        let seed = 4;
        let mut random = SplitMix64::new(seed, 0);
        for _ in 0..1000 {
            let (packet, instances) = traced(&mut random);
            let mut gathered = FetchedVertices::new();
            for lanes in gathered.corners.iter_mut().chain(&mut gathered.normals).flatten() {
                *lanes = [(); LANES].map(|()| random.unit() as f32 - 0.5);
            }
            // Some triangles have no area, some normals no direction
            gathered.corners[2][0][3] = f32::NAN;
            (0..3).for_each(|axis| gathered.corners[1][axis][5] = gathered.corners[0][axis][5]);
            (0..3).for_each(|corner| (0..3).for_each(|axis| gathered.normals[corner][axis][7] = 0.0));
            gathered.smooth = [(); LANES].map(|()| random.unit() < 0.5);
            let (mut hits, mut surfaces) = prepared(&packet, &instances);
            hits.locate_triangles(&packet, &gathered, &hits.mask.clone());
            hits.transforms.is_identity = [false; LANES];
            hits.place(&mut surfaces);
            for l in (0..LANES).filter(|&l| packet.instance[l] != NO_HIT) {
                let [a, b, c] = [0, 1, 2].map(|k| lane(&gathered.corners[k], l).as_dvec3());
                let [na, nb, nc] = [0, 1, 2].map(|k| lane(&gathered.normals[k], l).as_dvec3());
                let (u, v) = (f64::from(packet.u[l]), f64::from(packet.v[l]));
                let pose = instances[packet.instance[l] as usize].pose(packet.time[l]);
                let (map, inverse) = (pose.world_from_object(), pose.object_from_world());
                let (e1, e2) = (b - a, c - a);
                let p = map.transform_point3(a + u * e1 + v * e2);
                let ng = transform_normal(&map.matrix3, e1.cross(e2).normalize_or_zero());
                let ns = transform_normal(&map.matrix3, (1.0 - u - v) * na + u * nb + v * nc);
                let ns = (gathered.smooth[l] && ns != DVec3::ZERO).then_some(ns);
                let error = triangle_spawn_error(a.as_vec3(), e1.as_vec3(), e2.as_vec3());
                let wo = lane(&surfaces.wo, l).as_dvec3();
                assert_eq!(
                    bits(surfaces.point(l)),
                    bits(p),
                    "seed {seed}, lane {l}, {pose:?}"
                );
                if p.is_finite() {
                    let error = error.transformed(&map, &inverse, p);
                    Turned::new(ng, ns, error, wo).assert_equals(&surfaces, l);
                }
            }
        }
    }
}
