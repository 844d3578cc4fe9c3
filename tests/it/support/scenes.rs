//! Small procedural test scenes, each difficult in a different way, and rays for queries.
#![allow(
    dead_code,
    unreachable_pub,
    reason = "a module of several tests, each of which takes what it needs"
)]

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::{DAffine3, DQuat, DVec3, Vec3};
use whit::accel::{LANES, RayPacket};
use whit::mesh::Mesh;
use whit::numeric::Bounds;
use whit::numeric::Ray;
use whit::scene::{Geometry, Instance, Scene};
use whit::shape::{Cone, Cylinder, HalfSpace, Polyhedron, Quadric, Shape, Sphere, Torus};

/// Generator of numbers in [0, 1): a 64-bit linear congruential generator (Knuth's multiplier).
pub struct SplitMix64(pub u64);

impl SplitMix64 {
    pub fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns a point in the cube [-1, 1]³.
    pub fn in_cube(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next()) * 2.0 - DVec3::ONE
    }

    /// Returns a unit vector, uniformly distributed.
    pub fn on_sphere(&mut self) -> DVec3 {
        let z = 2.0 * self.next() - 1.0;
        let (sin, cos) = (TAU * self.next()).sin_cos();
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * cos, r * sin, z)
    }

    pub fn below(&mut self, count: usize) -> usize {
        (self.next() * count as f64) as usize
    }
}

pub fn mesh(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Mesh {
    Mesh {
        positions: positions.into(),
        triangles: triangles.into(),
        ..Mesh::default()
    }
}

/// Returns a closed sphere of about 4 n² triangles, displaced by waves.
pub fn bumpy_sphere(n: u32) -> Mesh {
    let (rings, columns) = (n, 2 * n);
    // Displace the sphere's points by two waves
    let at = |ring: u32, column: u32| {
        let theta = PI * f64::from(ring) / f64::from(rings);
        let phi = TAU * f64::from(column % columns) / f64::from(columns);
        let r = 1.0
            + 0.05 * (20.0 * theta).sin() * (15.0 * phi).sin()
            + 0.02 * (70.0 * theta).sin() * (50.0 * phi).sin();
        let p = r * DVec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
        p.as_vec3().to_array()
    };
    // Add the poles and rings of vertices
    let mut positions = vec![at(0, 0)];
    for ring in 1..rings {
        positions.extend((0..columns).map(|column| at(ring, column)));
    }
    positions.push(at(rings, 0));
    let last = positions.len() as u32 - 1;
    let index = |ring: u32, column: u32| 1 + (ring - 1) * columns + column % columns;
    // Connect them by triangles
    let mut triangles = Vec::new();
    for column in 0..columns {
        triangles.push([0, index(1, column + 1), index(1, column)]);
        triangles.push([last, index(rings - 1, column), index(rings - 1, column + 1)]);
        for ring in 1..rings - 1 {
            let [a, b] = [index(ring, column), index(ring, column + 1)];
            let [c, d] = [index(ring + 1, column), index(ring + 1, column + 1)];
            triangles.push([a, b, c]);
            triangles.push([b, d, c]);
        }
    }
    mesh(positions, triangles)
}

/// Returns long thin triangles in all directions through the cube [-1, 1]³.
pub fn thin_soup(count: u32) -> Mesh {
    let mut random = SplitMix64(3);
    let mut positions = Vec::new();
    for _ in 0..count {
        let (a, b) = (random.in_cube(), random.in_cube());
        let c = a.lerp(b, random.next()) + 0.01 * random.in_cube();
        positions.extend([a, b, c].map(|p| p.as_vec3().to_array()));
    }
    mesh(
        positions,
        (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
    )
}

/// Returns the twelve triangles of a box.
pub fn box_mesh(low: Vec3, high: Vec3) -> Mesh {
    let corner =
        |i: u32| Vec3::select(glam::BVec3::new(i & 1 != 0, i & 2 != 0, i & 4 != 0), high, low).to_array();
    let quads = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    let triangles = quads
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
        .collect();
    mesh((0..8).map(corner).collect(), triangles)
}

/// Returns unit boxes on a lattice, sharing faces with their neighbours; every face of the mesh lies on an integer
/// plane.
pub fn box_lattice(n: u32) -> Mesh {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for i in 0..n * n * n {
        let low = Vec3::new((i % n) as f32, (i / n % n) as f32, (i / n / n) as f32);
        // Omit every third box, so that rays can pass through holes.
        if i % 3 == 2 {
            continue;
        }
        let cube = box_mesh(low, low + 1.0);
        let first = positions.len() as u32;
        positions.extend_from_slice(&cube.positions);
        triangles.extend(cube.triangles.iter().map(|t| t.map(|v| first + v)));
    }
    mesh(positions, triangles)
}

/// Returns a scene of geometries, each instanced by an index and a transform.
pub fn scene(geometries: Vec<Geometry>, places: Vec<(u32, DAffine3)>) -> Scene {
    let instances = places
        .into_iter()
        .enumerate()
        .map(|(i, (geometry, map))| Instance::new(format!("place {i}"), geometry, 0, map).unwrap())
        .collect();
    Scene {
        geometries,
        instances,
        ..Scene::default()
    }
}

pub fn baked(mesh: Mesh) -> Scene {
    scene(vec![Geometry::Mesh(mesh)], vec![(0, DAffine3::IDENTITY)])
}

/// Returns a grid of instances of one mesh, each rotated and scaled differently, and one baked copy in the middle.
pub fn instance_grid(n: u32) -> Scene {
    let mut random = SplitMix64(5);
    let mut places = vec![(0, DAffine3::IDENTITY)];
    for i in 0..n * n {
        let p = DVec3::new(f64::from(i % n), 0.3 * random.next(), f64::from(i / n)) * 2.5 - DVec3::splat(3.0);
        let turn = DQuat::from_axis_angle(random.on_sphere(), TAU * random.next());
        let scale = DVec3::splat(0.5 + random.next());
        places.push((0, DAffine3::from_scale_rotation_translation(scale, turn, p)));
    }
    scene(vec![Geometry::Mesh(bumpy_sphere(5))], places)
}

/// Returns mirrored, squashed and sheared instances, overlapping one another, at an offset.
pub fn mirrored_and_squashed() -> Scene {
    let shear = DAffine3::from_mat3(glam::DMat3::from_cols(
        DVec3::X,
        DVec3::new(0.7, 1.0, 0.0),
        DVec3::new(0.0, -0.4, 1.0),
    ));
    let at = |x: f64, y: f64, z: f64| DAffine3::from_translation(DVec3::new(x, y, z));
    let places = vec![
        (
            0,
            at(10.0, 0.0, 0.0) * DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)),
        ),
        (
            0,
            at(11.0, 0.5, 0.0) * DAffine3::from_scale(DVec3::new(2.0, 0.05, -1.0)),
        ),
        (
            0,
            at(10.5, 1.0, 1.0)
                * DAffine3::from_rotation_x(0.5)
                * DAffine3::from_scale(DVec3::new(0.02, 1.5, 1.0)),
        ),
        (0, at(9.5, 0.0, 1.0) * shear),
        (
            1,
            at(10.0, -1.5, 0.5)
                * DAffine3::from_rotation_z(0.1)
                * DAffine3::from_scale(DVec3::new(3.0, 0.1, 3.0)),
        ),
        (
            1,
            at(10.0, 2.5, 0.5) * DAffine3::from_scale(DVec3::new(-0.5, 0.5, -0.5)),
        ),
    ];
    let cube = box_mesh(Vec3::splat(-1.0), Vec3::splat(1.0));
    scene(
        vec![Geometry::Mesh(bumpy_sphere(5)), Geometry::Mesh(cube)],
        places,
    )
}

/// Returns spheres of very different sizes, some squashed, over a baked floor.
pub fn spheres() -> Scene {
    let mut random = SplitMix64(9);
    let mut places = Vec::new();
    for i in 0..60 {
        let p = 3.0 * random.in_cube();
        let r = 10f64.powf(-3.0 + 3.0 * random.next());
        let squash = if i % 3 == 0 {
            DVec3::new(r, -0.3 * r, 2.0 * r)
        } else {
            DVec3::splat(r)
        };
        let turn = DQuat::from_axis_angle(random.on_sphere(), TAU * random.next());
        places.push((0, DAffine3::from_scale_rotation_translation(squash, turn, p)));
    }
    places.push((1, DAffine3::IDENTITY));
    places.push((2, DAffine3::IDENTITY));
    let ground = Sphere {
        center: DVec3::new(0.0, -1003.0, 0.0),
        radius: 1000.0,
    };
    let floor = box_mesh(Vec3::new(-3.0, -3.1, -3.0), Vec3::new(3.0, -2.9, 3.0));
    scene(
        vec![
            Geometry::Shape(Shape::Sphere(Sphere::UNIT)),
            Geometry::Shape(Shape::Sphere(ground)),
            Geometry::Mesh(floor),
        ],
        places,
    )
}

/// Returns coincident walls, baked and instanced, on planes where a BSP tends to split.
pub fn coplanar_duplicates() -> Scene {
    let cube = box_mesh(Vec3::ZERO, Vec3::splat(4.0));
    let half = box_mesh(Vec3::ZERO, Vec3::new(2.0, 4.0, 4.0));
    let places = vec![
        (0, DAffine3::IDENTITY),
        (0, DAffine3::IDENTITY),
        (1, DAffine3::IDENTITY),
        (1, DAffine3::from_translation(DVec3::new(2.0, 0.0, 0.0))),
        (2, DAffine3::IDENTITY),
        (0, DAffine3::from_translation(DVec3::new(4.0, 0.0, 0.0))),
    ];
    scene(
        vec![
            Geometry::Mesh(cube),
            Geometry::Mesh(half),
            Geometry::Mesh(box_lattice(3)),
        ],
        places,
    )
}

/// Returns every analytic shape, by name. The quadric is an ellipsoid that its box does not clip.
pub fn all_shapes() -> Vec<(&'static str, Shape)> {
    let half_space = |n: DVec3| HalfSpace { n, h: 1.0 };
    let corners = [
        DVec3::ONE,
        DVec3::new(-1.0, -1.0, 1.0),
        DVec3::new(-1.0, 1.0, -1.0),
        DVec3::new(1.0, -1.0, -1.0),
    ];
    let tetrahedron = Polyhedron::from_half_spaces(&corners.map(half_space)).unwrap();
    let clip = Bounds {
        min: -DVec3::ONE,
        max: DVec3::ONE,
    };
    let ellipsoid = Quadric::new([1.5, 0.2, 0.0, 0.1, 2.0, 0.0, 0.0, 3.0, 0.0, -0.6], clip).unwrap();
    let sphere = Sphere {
        center: DVec3::new(0.1, -0.2, 0.3),
        radius: 0.8,
    };
    vec![
        ("sphere", Shape::Sphere(sphere)),
        ("plane", Shape::Plane),
        ("cube", Shape::Cube),
        ("polyhedron", Shape::Polyhedron(Arc::new(tetrahedron))),
        ("disk", Shape::Disk),
        ("quad", Shape::Quad),
        ("cylinder", Shape::Cylinder(Cylinder { capped: true })),
        ("tube", Shape::Cylinder(Cylinder { capped: false })),
        ("cone", Shape::Cone(Cone { capped: true })),
        ("open cone", Shape::Cone(Cone { capped: false })),
        ("torus", Shape::Torus(Torus { minor_radius: 0.35 })),
        ("quadric", Shape::Quadric(Arc::new(ellipsoid))),
    ]
}

/// Returns five transforms: identity, scaled, rotated and scaled, mirrored, and strongly stretched.
pub fn all_placements() -> [DAffine3; 5] {
    let at = |x: f64, y: f64, z: f64| DAffine3::from_translation(DVec3::new(x, y, z));
    let turn = DAffine3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 1.1);
    [
        DAffine3::IDENTITY,
        at(2.0, 1.0, -0.5) * DAffine3::from_scale(DVec3::splat(0.7)),
        at(-2.0, 0.5, 1.0) * turn * DAffine3::from_scale(DVec3::splat(1.3)),
        at(0.5, -2.0, 0.3) * turn.inverse() * DAffine3::from_scale(DVec3::new(-1.0, 0.8, 1.2)),
        at(0.3, 0.2, 2.0) * turn * DAffine3::from_scale(DVec3::new(4.0, 0.6, 0.02)),
    ]
}

/// Returns a shape under all transforms, beside a baked box.
pub fn placed_shape(shape: Shape) -> Scene {
    let cube = box_mesh(Vec3::splat(-2.5), Vec3::splat(-1.5));
    let places = all_placements().map(|map| (0, map));
    scene(
        vec![Geometry::Shape(shape), Geometry::Mesh(cube)],
        places.into_iter().chain([(1, DAffine3::IDENTITY)]).collect(),
    )
}

/// Returns the scenes on which all backends must agree, by name.
pub fn all_small() -> Vec<(&'static str, Scene)> {
    vec![
        ("bumpy sphere", baked(bumpy_sphere(9))),
        ("thin soup", baked(thin_soup(300))),
        ("instance grid", instance_grid(3)),
        ("mirrored and squashed", mirrored_and_squashed()),
        ("spheres", spheres()),
        ("coplanar duplicates", coplanar_duplicates()),
        ("box lattice", baked(box_lattice(3))),
    ]
}

/// Groups rays into packets in order; unused lanes of the last packet are inactive.
pub fn packets(rays: &[Ray]) -> Vec<RayPacket> {
    let packet = |rays: &[Ray]| {
        let mut packet = RayPacket::EMPTY;
        rays.iter()
            .enumerate()
            .for_each(|(lane, ray)| packet.set(lane, ray));
        packet
    };
    rays.chunks(LANES).map(packet).collect()
}

/// Returns rays through the pixels of a square film, from outside the scene towards its middle.
pub fn camera_rays(scene: &Scene, width: usize) -> Vec<Ray> {
    let bounds = scene.bounds();
    let (center, size) = (bounds.center(), bounds.extent().length());
    let forward = DVec3::new(-0.6, -0.35, -0.8).normalize();
    let right = forward.cross(DVec3::Y).normalize();
    let up = right.cross(forward);
    let origin = center - forward * size * 0.9;
    let film = |i: usize| (i as f64 + 0.5) / width as f64 - 0.5;
    let mut rays = Vec::with_capacity(width * width);
    // Order by blocks of 4 x 4 pixels, so that sixteen consecutive rays are adjacent.
    for block in 0..(width / 4) * (width / 4) {
        let (block_x, block_y) = (block % (width / 4), block / (width / 4));
        for pixel in 0..16 {
            let (x, y) = (4 * block_x + pixel % 4, 4 * block_y + pixel / 4);
            let direction = forward + film(x) * right - film(y) * up;
            rays.push(Ray::new(origin.as_vec3(), direction.normalize().as_vec3()));
        }
    }
    rays
}

/// Returns rays from the hits of `rays`, given by parameter, to a light beside the scene; misses give none.
pub fn shadow_rays(scene: &Scene, rays: &[Ray], hits: &[Option<f32>]) -> Vec<Ray> {
    let bounds = scene.bounds();
    let light = bounds.center() + bounds.extent() * DVec3::new(0.3, 1.4, -0.4);
    let from = |(ray, t): (&Ray, &Option<f32>)| {
        // Start slightly before the surface: these rays need not be the renderer's.
        let origin = ray.at(f64::from((*t)?) * 0.9999).as_vec3();
        Some(Ray {
            t_far: 1.0,
            ..Ray::new(origin, (light - origin.as_dvec3()).as_vec3())
        })
    };
    rays.iter().zip(hits).filter_map(from).collect()
}

/// Returns rays in a direction from the hits of `rays`, given by parameter; misses give none.
pub fn parallel_shadow_rays(rays: &[Ray], hits: &[Option<f32>], direction: DVec3) -> Vec<Ray> {
    let from = |(ray, t): (&Ray, &Option<f32>)| {
        // Start slightly before the surface: these rays need not be the renderer's.
        let origin = ray.at(f64::from((*t)?) * 0.9999).as_vec3();
        Some(Ray::new(origin, direction.as_vec3()))
    };
    rays.iter().zip(hits).filter_map(from).collect()
}

/// Returns rays between random points in and around the scene; some with an interval, some far from unit length.
pub fn random_rays(scene: &Scene, count: usize, seed: u64) -> Vec<Ray> {
    let bounds = scene.bounds();
    let mut random = SplitMix64(seed);
    let ray = |_| {
        let origin = bounds.center() + bounds.extent() * random.in_cube() * 0.8;
        let length = if random.next() < 0.1 {
            10f64.powf(12.0 * random.next() - 6.0)
        } else {
            1.0
        };
        let direction = random.on_sphere() * length;
        let mut ray = Ray::new(origin.as_vec3(), direction.as_vec3());
        if random.next() < 0.2 {
            let reach = bounds.extent().length() / length;
            ray.t_near = (0.2 * reach * random.next()) as f32;
            ray.t_far = ray.t_near + (0.4 * reach * random.next()) as f32;
        }
        ray
    };
    (0..count).map(ray).collect()
}

/// Returns rays that start on vertex coordinates or in walls and run along axes and diagonals, or nearly so: with zero
/// of either sign, denormal and tiny components.
pub fn lattice_rays(scene: &Scene, count: usize, seed: u64) -> Vec<Ray> {
    let bounds = scene.bounds();
    let mut random = SplitMix64(seed);
    // Collect the coordinates of all vertices, by axis
    let mut coordinates: [Vec<f32>; 3] = Default::default();
    for instance in &scene.instances {
        if let Geometry::Mesh(mesh) = &scene.geometries[instance.geometry as usize] {
            for &p in mesh.positions.iter() {
                let p = instance
                    .world_from_object()
                    .transform_point3(Vec3::from(p).as_dvec3())
                    .as_vec3();
                (0..3).for_each(|axis| coordinates[axis].push(p[axis]));
            }
        }
    }
    let small = [0.0, -0.0, 1e-40, -1e-40, 1e-20, -1e-20, 1e-7, -1e-7];
    // Draw origins on these coordinates and directions with small components
    let ray = |_| {
        let anywhere = bounds.center() + bounds.extent() * random.in_cube();
        let mut origin = anywhere.as_vec3();
        let mut direction = [0.0f32; 3];
        for axis in 0..3 {
            let on = &coordinates[axis];
            if random.next() < 0.6 && !on.is_empty() {
                origin[axis] = on[random.below(on.len())];
            }
            let kind = random.next();
            direction[axis] = if kind < 0.5 {
                small[random.below(small.len())]
            } else if kind < 0.8 {
                if random.next() < 0.5 { 1.0 } else { -1.0 }
            } else {
                (2.0 * random.next() - 1.0) as f32
            };
        }
        // Avoid directions that are almost zero
        if direction.iter().all(|d| d.abs() < 1e-5) {
            direction[random.below(3)] = if random.next() < 0.5 { 1.0 } else { -1.0 };
        }
        Ray::new(origin, Vec3::from(direction))
    };
    (0..count).map(ray).collect()
}
