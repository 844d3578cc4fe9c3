//! Scenes of floors under area lights, their renderings, and closed forms for the radiance.

use std::f64::consts::PI;

use glam::{DAffine3, DQuat, DVec3};
use whit::image::LinearImage;
use whit::mesh::Mesh;
use whit::scene::{AreaShape, Camera, Geometry, Light, LightKind, Material, Model, Phong, Projection, Scene};
use whit::shape::Shape;

use super::images::{add, estimate};

/// Tolerance of an estimate in standard errors.
pub const ERRORS: f64 = 3.0;
/// Relative error of single precision after a dozen operations.
pub const ROUNDING: f64 = 16.0 / 16_777_216.0;
/// Radiance of the area lights.
pub const EMISSION: f32 = 2.0;

pub fn matte() -> Material {
    Material {
        model: Model::Phong(Phong::DEFAULT),
        ..Material::default()
    }
}

/// Returns a black material with emission.
pub fn emissive_material() -> Material {
    Material {
        name: "neon".into(),
        base_color: [0.0, 0.0, 0.0, 1.0],
        emission: [EMISSION; 3],
        ..matte()
    }
}

/// Returns a scene with a diffuse floor z = 0.
pub fn floor() -> Scene {
    let mut scene = Scene::default();
    add(
        &mut scene,
        "floor",
        Geometry::Shape(Shape::Plane),
        matte(),
        DAffine3::IDENTITY,
    );
    scene
}

/// Returns the floor under an emissive object.
pub fn under_emissive_object(geometry: Geometry, place: DAffine3, samples: u32) -> Scene {
    let mut scene = floor();
    let emissive = add(&mut scene, "lamp", geometry, emissive_material(), place);
    scene.add_emissive_light(emissive, samples).unwrap();
    scene
}

/// Returns the floor under an area light without visible geometry.
pub fn under_light(shape: AreaShape, samples: u32) -> Scene {
    let mut scene = floor();
    scene.lights.push(Light {
        name: "light".into(),
        intensity: [EMISSION; 3],
        kind: LightKind::Area { shape, samples },
    });
    scene
}

/// Returns the square [-1, 1]² in z = 0, its front to +z, in two triangles.
pub fn square() -> Mesh {
    Mesh {
        positions: vec![
            [-1.0, -1.0, 0.0],
            [1.0, -1.0, 0.0],
            [1.0, 1.0, 0.0],
            [-1.0, 1.0, 0.0],
        ]
        .into(),
        triangles: vec![[0, 1, 2], [0, 2, 3]].into(),
        tex_coords: vec![vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]].into()],
        ..Mesh::default()
    }
}

/// Returns a closed mesh of the unit sphere with `rings` rings of twice as many corners.
pub fn ball(rings: u32) -> Mesh {
    let columns = 2 * rings;
    let at = |ring: u32, column: u32| {
        let (sin, cos) = (PI * f64::from(ring) / f64::from(rings)).sin_cos();
        let (side, ahead) = (PI * f64::from(column) / f64::from(rings)).sin_cos();
        DVec3::new(sin * ahead, sin * side, cos).as_vec3().to_array()
    };
    let index = |ring: u32, column: u32| ring * columns + column % columns;
    let mut triangles = Vec::new();
    for (ring, column) in (0..rings).flat_map(|ring| (0..columns).map(move |column| (ring, column))) {
        let [a, b] = [index(ring, column), index(ring + 1, column)];
        let [c, d] = [index(ring + 1, column + 1), index(ring, column + 1)];
        if ring + 1 < rings {
            triangles.push([a, b, c]);
        }
        if ring > 0 {
            triangles.push([a, c, d]);
        }
    }
    Mesh {
        positions: (0..=rings)
            .flat_map(|ring| (0..columns).map(move |column| at(ring, column)))
            .collect::<Vec<_>>()
            .into(),
        triangles: triangles.into(),
        ..Mesh::default()
    }
}

pub fn up(height: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::Z * height)
}

pub fn camera(place: DVec3, projection: Projection) -> Camera {
    Camera {
        world_from_camera: DAffine3::from_translation(place),
        projection,
        ..Camera::default()
    }
}

/// Returns a camera that sees `y_mag` in each direction of the floor around `place`, from slightly above.
pub fn look_at(place: DVec3, y_mag: f64) -> Camera {
    camera(
        place + 1e-3 * DVec3::Z,
        Projection::Orthographic { y_mag, x_mag: None },
    )
}

pub fn assert_is_near(what: &str, image: &LinearImage, exact: f64) {
    let (found, error) = estimate(image);
    println!("{what}: {found:.6} ± {error:.6}, exactly {exact:.6}");
    assert!(
        (found - exact).abs() <= ERRORS * error + ROUNDING * exact,
        "{what}: {found} ± {error}, not {exact}"
    );
}

/// Returns the reflected radiance of a polygon of `radiance` at the origin of a floor that faces +z: half the sum over
/// the edges of their angle times the height of their plane's normal (J. Lambert, 1760).
pub fn lambert(corners: &[DVec3], radiance: f64) -> f64 {
    let seen: Vec<DVec3> = corners.iter().map(|corner| corner.normalize()).collect();
    let sum: f64 = (0..seen.len())
        .map(|i| {
            let (a, b) = (seen[i], seen[(i + 1) % seen.len()]);
            let across = a.cross(b);
            across.normalize().z * across.length().atan2(a.dot(b))
        })
        .sum();
    0.5 * radiance * sum.abs()
}

/// Returns a transform that places a square above and beside the origin: rotated, mirrored and stretched.
pub fn skew() -> DAffine3 {
    DAffine3::from_scale_rotation_translation(
        DVec3::new(-1.5, 0.6, 2.0),
        DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.7),
        DVec3::new(1.0, -0.4, 2.5),
    )
}
