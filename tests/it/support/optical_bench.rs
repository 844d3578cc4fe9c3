//! Optical bench: the renderer traces rays of exactly known direction into a scene, and the directions in which they
//! leave it are decoded from the image.
//!
//! A background that grows with the height of a ray encodes one component of its direction; rotating the whole bench
//! gives the others. Red encodes rays that leave upwards, green those that leave downwards, blue the total weight, so
//! that quotients are independent of the path's throughput. A component is accurate to a few f32 roundings of itself:
//! objects are placed so that the measured component is small.
#![allow(
    dead_code,
    unreachable_pub,
    reason = "a module of several tests, each of which takes what it needs"
)]

use glam::{DAffine3, DMat3, DVec3};
use whit::accel::{self, AccelOptions, Backend};
use whit::mesh::Mesh;
use whit::optics::{Absorption, Dispersion};
use whit::render::{Monitor, RenderSettings, render};
use whit::scene::{
    Background, Camera, Geometry, Instance, Material, Medium, MediumKind, MetallicRoughness, Model, Phong,
    Projection, Scene,
};
use whit::shape::{Shape, Sphere};

/// Background with red for upward and green for downward directions, by their height, and constant blue.
const GAUGE: Background = Background::Gradient {
    horizon: [0.0, 0.0, 1.0],
    up: [1.0, 0.0, 1.0],
    down: [0.0, 1.0, 1.0],
};

/// Returns all backends of this build.
pub fn backends() -> Vec<Backend> {
    let mut backends = vec![Backend::Brute, Backend::Bsp, Backend::Native];
    if cfg!(feature = "embree") {
        backends.push(Backend::Embree);
    }
    backends
}

/// Returns clear glass of index `ior` with a smooth surface that obeys Fresnel's equations.
pub fn glass(ior: f64) -> Material {
    Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 0.0,
            roughness: 0.0,
            transmission: 1.0,
            ..MetallicRoughness::DEFAULT
        }),
        interior: Some(Medium {
            ior: Dispersion::Constant(ior),
            absorption: Absorption::NONE,
            priority: 0,
            kind: MediumKind::Solid,
        }),
        ..Material::default()
    }
}

/// Returns a dielectric of index `ior` whose surface transmits kt and reflects kr at all angles, without Fresnel's
/// equations.
pub fn ideal(ior: Dispersion, reflection: f32) -> Material {
    Material {
        model: Model::Phong(Phong {
            ambient: [0.0; 3],
            diffuse: [0.0; 3],
            reflection: [reflection; 3],
            transmission: [1.0; 3],
            ..Phong::DEFAULT
        }),
        interior: Some(Medium {
            ior,
            absorption: Absorption::NONE,
            priority: 0,
            kind: MediumKind::Solid,
        }),
        ..Material::default()
    }
}

/// Returns the square |x|, |z| <= 1 whose front faces +y.
pub fn square() -> Mesh {
    mesh(
        &[[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]],
        &[[0, 1, 2], [0, 2, 3]],
    )
}

/// Returns the box |x|, |z| <= 1, -1 <= y <= 0.
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

/// Returns a prism of apex angle `apex` in radians: its edge is at (0, 1), its base at y = -1, |z| <= 1. The transform
/// sets the angle, so that it does not depend on f32 vertices.
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

/// Object on the bench with its transform and backend.
pub struct Bench {
    pub geometry: Geometry,
    pub place: DAffine3,
    pub material: Material,
    pub backend: Backend,
    /// Maximum depth of paths.
    pub depth: u32,
}

/// Beam of parallel rays.
#[derive(Clone, Copy)]
pub struct Beam {
    /// Middle of the rays' origins.
    pub origin: DVec3,
    /// Unit direction of the rays.
    pub direction: DVec3,
    /// Unit vector across the beam, along which the origins lie.
    pub across: DVec3,
    /// Half of the beam's width.
    pub half_width: f64,
    pub rays: u32,
}

impl Beam {
    /// Returns a beam of one ray through `target`, starting `distance` before it.
    pub fn ray(target: DVec3, direction: DVec3, distance: f64) -> Beam {
        Beam {
            origin: target - distance * direction,
            direction,
            across: direction.any_orthonormal_vector(),
            // The ray is in the middle of the only pixel; the width must not be zero.
            half_width: 1e-6,
            rays: 1,
        }
    }

    /// Returns the offset of ray `index` from the middle.
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

    /// Returns the radiance of every ray of `beam` in front of `background`.
    pub fn see(&self, beam: Beam, background: Background) -> Vec<DVec3> {
        self.see_turned(beam, background, DMat3::IDENTITY)
    }

    /// Returns the exit directions of the rays, weighted by their throughput, and the throughputs: sums for rays that
    /// split.
    ///
    /// A component is the sum over rays that leave on its positive side minus the sum on its negative one.
    pub fn leaving(&self, beam: Beam) -> Vec<(DVec3, f64)> {
        // Cyclic permutation of the axes, without any rounding: x becomes y, y becomes z, z becomes x.
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

    /// Returns the exit direction of a single ray that does not split.
    pub fn exit(&self, beam: Beam) -> DVec3 {
        let (sum, share) = self.leaving(beam)[0];
        sum / share
    }

    /// Returns the upward, downward and total throughput of the one ray of `beam`; the first two multiplied by the
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

/// Returns the radiance of every ray of `beam` in `scene`, to a depth of `depth`.
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
    render_image(scene, &camera, backend, &settings)
}

/// Returns the pixels of a rendered image, row by row.
pub fn render_image(
    scene: &Scene,
    camera: &Camera,
    backend: Backend,
    settings: &RenderSettings,
) -> Vec<DVec3> {
    let accel = accel::build(scene.validate().unwrap(), backend, &AccelOptions::default()).unwrap();
    let monitor = Monitor::default();
    let rendering = render(
        scene.validate().unwrap(),
        camera,
        accel.as_ref(),
        settings,
        &monitor,
    )
    .unwrap();
    let pixels = rendering.image.pixels.iter();
    pixels.map(|&pixel| DVec3::from(pixel.map(f64::from))).collect()
}
