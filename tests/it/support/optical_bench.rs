//! An optical bench: rays of exactly known direction are sent into a scene by the renderer, and the directions in which
//! they leave it are read off the picture.
//!
//! A background that grows with the height of a ray tells one component of its direction; turning the whole bench
//! round tells the others. Red shows what leaves upwards, green what leaves downwards, blue how much leaves at all, so
//! that quotients are free of the path's weight. A component is known to a few f32 roundings of itself: bodies are
//! placed so that what is asked for is small.
#![allow(
    dead_code,
    unreachable_pub,
    reason = "a module of several tests, each of which takes what it needs"
)]

use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DMat3, DVec3};
use whit::accel::{self, AccelOptions, Backend};
use whit::mesh::Mesh;
use whit::optics::{Absorption, Dispersion};
use whit::render::{Monitor, RenderSettings, render};
use whit::scene::{
    Background, Camera, Geometry, Instance, Interior, Lecture, Material, MetallicRoughness, Model,
    Projection, Scene,
};
use whit::shape::{Shape, Sphere};

/// Red of what leaves upwards and green of what leaves downwards, by the height of the direction; blue of everything.
const GAUGE: Background = Background::Gradient {
    horizon: [0.0, 0.0, 1.0],
    up: [1.0, 0.0, 1.0],
    down: [0.0, 1.0, 1.0],
};

/// All backends of this build.
pub fn backends() -> Vec<Backend> {
    let mut backends = vec![Backend::Brute, Backend::Bsp];
    if cfg!(feature = "embree") {
        backends.push(Backend::Embree);
    }
    backends
}

/// Clear glass of index `ior` with a polished surface that Fresnel's equations govern.
pub fn glass(ior: f64) -> Material {
    Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 0.0,
            roughness: 0.0,
            transmission: 1.0,
            ..MetallicRoughness::DEFAULT
        }),
        interior: Some(Interior {
            ior: Dispersion::Constant(ior),
            absorption: Absorption::NONE,
            priority: 0,
            is_thin: false,
        }),
        ..Material::default()
    }
}

/// A body of index `ior` whose surface sends every ray on whole: kt through it and kr back, without Fresnel's division.
pub fn ideal(ior: Dispersion, reflection: f32) -> Material {
    Material {
        model: Model::Lecture(Lecture {
            ambient: [0.0; 3],
            diffuse: [0.0; 3],
            reflection: [reflection; 3],
            transmission: [1.0; 3],
            ..Lecture::DEFAULT
        }),
        interior: Some(Interior {
            ior,
            absorption: Absorption::NONE,
            priority: 0,
            is_thin: false,
        }),
        ..Material::default()
    }
}

/// The square |x|, |z| <= 1 whose front looks to +y.
pub fn square() -> Mesh {
    mesh(
        &[[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]],
        &[[0, 1, 2], [0, 2, 3]],
    )
}

/// The box |x|, |z| <= 1, -1 <= y <= 0.
pub fn slab() -> Mesh {
    let corners = [
        [-1, 0, -1],
        [-1, 0, 1],
        [1, 0, 1],
        [1, 0, -1],
        [-1, -1, -1],
        [-1, -1, 1],
        [1, -1, 1],
        [1, -1, -1],
    ];
    mesh(
        &corners,
        &quads(&[
            [0, 1, 2, 3],
            [7, 6, 5, 4],
            [4, 5, 1, 0],
            [5, 6, 2, 1],
            [6, 7, 3, 2],
            [7, 4, 0, 3],
        ]),
    )
}

/// A prism of apex angle `apex` in radians: its edge stands at (0, 1), its base is at y = -1, |z| <= 1. The map gives
/// it its angle, so that this angle is no matter of f32 vertices.
pub fn prism(apex: f64) -> (Mesh, DAffine3) {
    let corners = [
        [0, 1, -1],
        [0, 1, 1],
        [-1, -1, -1],
        [-1, -1, 1],
        [1, -1, -1],
        [1, -1, 1],
    ];
    let mut triangles = quads(&[[0, 2, 3, 1], [0, 1, 5, 4], [2, 4, 5, 3]]);
    triangles.extend([[0, 4, 2], [1, 3, 5]]);
    // Half the base is one unit wide and two high: tan(apex / 2) = width / 2.
    let width = 2.0 * (0.5 * apex).tan();
    (
        mesh(&corners, &triangles),
        DAffine3::from_scale(DVec3::new(width, 1.0, 1.0)),
    )
}

fn mesh(corners: &[[i8; 3]], triangles: &[[u32; 3]]) -> Mesh {
    let positions: Vec<[f32; 3]> = corners.iter().map(|corner| corner.map(f32::from)).collect();
    Mesh {
        positions: positions.into(),
        triangles: triangles.to_vec().into(),
        ..Mesh::default()
    }
}

fn quads(corners: &[[u32; 4]]) -> Vec<[u32; 3]> {
    let halves = corners.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    halves.collect()
}

/// One body on the bench.
pub struct Bench {
    pub geometry: Geometry,
    pub place: DAffine3,
    pub material: Material,
    pub backend: Backend,
    /// Steps that paths are followed.
    pub depth: u32,
}

/// Parallel rays.
#[derive(Clone, Copy)]
pub struct Beam {
    /// The middle of where they start.
    pub origin: DVec3,
    /// Unit vector.
    pub direction: DVec3,
    /// Unit vector across the beam, along which the rays lie.
    pub across: DVec3,
    /// Half of its width.
    pub half_width: f64,
    pub rays: u32,
}

impl Beam {
    /// One ray through `target`, `distance` before it.
    pub fn ray(target: DVec3, direction: DVec3, distance: f64) -> Beam {
        Beam {
            origin: target - distance * direction,
            direction,
            across: direction.any_orthonormal_vector(),
            // The middle of the one pixel; its width only must not be zero.
            half_width: 1e-6,
            rays: 1,
        }
    }

    /// How far ray `index` lies from the middle.
    pub fn offset(&self, index: u32) -> f64 {
        self.half_width * (1.0 - (2.0 * f64::from(index) + 1.0) / f64::from(self.rays))
    }
}

impl Bench {
    pub fn sphere(material: Material, backend: Backend, depth: u32) -> Bench {
        Bench {
            geometry: Geometry::Shape(Shape::Sphere(Sphere::UNIT)),
            place: DAffine3::IDENTITY,
            material,
            backend,
            depth,
        }
    }

    /// What is seen by every ray of `beam` before `background`.
    pub fn see(&self, beam: Beam, background: Background) -> Vec<DVec3> {
        self.see_turned(beam, background, DMat3::IDENTITY)
    }

    /// The directions in which the rays leave, each times the share that leaves, and those shares: of rays that divide,
    /// the sums.
    ///
    /// A component is the sum over what leaves on its positive side less that on its negative one.
    pub fn leaving(&self, beam: Beam) -> Vec<(DVec3, f64)> {
        // x becomes y, y becomes z, z becomes x: without any rounding.
        let turn = DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X);
        let heights = self.see(beam, GAUGE);
        let widths = self.see_turned(beam, GAUGE, turn);
        let depths = self.see_turned(beam, GAUGE, turn * turn);
        let height = |seen: DVec3| seen.x - seen.y;
        (0..heights.len())
            .map(|i| {
                let sum = DVec3::new(height(widths[i]), height(heights[i]), height(depths[i]));
                (sum, heights[i].z)
            })
            .collect()
    }

    /// The direction in which a single ray leaves that does not divide.
    pub fn exit(&self, beam: Beam) -> DVec3 {
        let (sum, share) = self.leaving(beam)[0];
        sum / share
    }

    /// What leaves upwards, what leaves downwards, and all of it, of the one ray of `beam`; the first two times the
    /// height of their directions.
    pub fn divided(&self, beam: Beam) -> DVec3 {
        self.see(beam, GAUGE)[0]
    }

    fn see_turned(&self, beam: Beam, background: Background, turn: DMat3) -> Vec<DVec3> {
        let turn = DAffine3::from_mat3(turn);
        let scene = Scene {
            geometries: vec![self.geometry.clone()],
            instances: vec![Instance::new("body", 0, 0, turn * self.place).unwrap()],
            materials: vec![self.material.clone()],
            background,
            ..Scene::default()
        };
        scene.validate().unwrap();
        let beam = Beam {
            origin: turn.transform_point3(beam.origin),
            direction: turn.transform_vector3(beam.direction),
            across: turn.transform_vector3(beam.across),
            ..beam
        };
        see_scene(&scene, beam, self.backend, self.depth)
    }
}

/// What every ray of `beam` sees of `scene`, in `depth` steps.
pub fn see_scene(scene: &Scene, beam: Beam, backend: Backend, depth: u32) -> Vec<DVec3> {
    let axes = DMat3::from_cols(beam.across.cross(-beam.direction), beam.across, -beam.direction);
    let camera = Camera {
        world_from_camera: DAffine3::from_mat3_translation(axes, beam.origin),
        projection: Projection::Orthographic {
            y_mag: beam.half_width,
            x_mag: None,
        },
        ..Camera::default()
    };
    let settings = RenderSettings {
        width: 1,
        height: beam.rays,
        depth,
        weight_cutoff: 0.0,
        ..RenderSettings::default()
    };
    picture(scene, &camera, backend, &settings)
}

/// The pixels of a picture, row by row.
pub fn picture(scene: &Scene, camera: &Camera, backend: Backend, settings: &RenderSettings) -> Vec<DVec3> {
    let accel = accel::build(scene, backend, &AccelOptions::default()).unwrap();
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(false),
        tiles: None,
    };
    let rendering = render(scene, camera, accel.as_ref(), settings, &monitor).unwrap();
    let pixels = rendering.image.pixels.iter();
    pixels.map(|&pixel| DVec3::from(pixel.map(f64::from))).collect()
}
