//! Floors under lamps, pictures of them, and what closed forms say of them.

use std::f64::consts::PI;

use glam::{DAffine3, DQuat, DVec3};
use whit::image::LinearImage;
use whit::mesh::Mesh;
use whit::scene::{
    AreaShape, Camera, Geometry, Lecture, Light, LightKind, Material, Model, Projection, Scene,
};
use whit::shape::Shape;

use super::pictures::{add, estimate};

/// Standard errors that an estimate may be off.
pub const ERRORS: f64 = 3.0;
/// Relative error of single precision through a dozen operations.
pub const ROUNDING: f64 = 16.0 / 16_777_216.0;
/// Radiance of the lamps.
pub const SHINE: f32 = 2.0;

pub fn matte() -> Material {
    Material {
        model: Model::Lecture(Lecture::DEFAULT),
        ..Material::default()
    }
}

/// Black but for what shines.
pub fn shining() -> Material {
    Material {
        name: "neon".into(),
        base_color: [0.0, 0.0, 0.0, 1.0],
        emission: [SHINE; 3],
        ..matte()
    }
}

/// A matte floor z = 0.
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

/// The floor under a lamp.
pub fn under_lamp(geometry: Geometry, place: DAffine3, samples: u32) -> Scene {
    let mut scene = floor();
    let lamp = add(&mut scene, "lamp", geometry, shining(), place);
    scene.add_emissive_light(lamp, samples).unwrap();
    scene
}

/// The floor under a light that is not seen.
pub fn under_light(shape: AreaShape, samples: u32) -> Scene {
    let mut scene = floor();
    scene.lights.push(Light {
        name: "light".into(),
        intensity: [SHINE; 3],
        kind: LightKind::Area { shape, samples },
    });
    scene
}

/// The square [-1, 1]² in z = 0, its front to +z, in two triangles.
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

/// A closed mesh of the unit sphere with `rings` rings of twice as many corners.
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

/// Sees `y_mag` each way of the floor around `place`, from a little above.
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

/// What `radiance` of a polygon makes at the origin of a floor that faces +z: half the sum over the edges of their
/// angle times the height of their plane's normal (J. Lambert, 1760).
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

/// Places a square above and beside the origin: turned, mirrored and stretched.
pub fn skew() -> DAffine3 {
    DAffine3::from_scale_rotation_translation(
        DVec3::new(-1.5, 0.6, 2.0),
        DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.7),
        DVec3::new(1.0, -0.4, 2.5),
    )
}
