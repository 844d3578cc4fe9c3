//! Generated scenes of increasing triangle count for `whit bench --sweep`.

use glam::{DAffine3, DMat3, DVec3};

use crate::cli::args::MIN_TRIANGLES;
use crate::cli::failure::Failure;
use whit::mesh::{Mesh, bumpy_sphere};
use whit::report::memory;
use whit::report::table::group_thousands;
use whit::scene::{Background, Camera, Falloff, Geometry, Instance, Light, LightKind, Material, Scene};

/// Number of mesh sizes per factor of ten.
const SIZES_A_DECADE: i32 = 2;
/// Peak memory in bytes per triangle: the mesh, and all acceleration structures over it with one that is being built, as
/// measured by the peak at 10^7 triangles, and a third more.
const BYTES_PER_TRIANGLE: u64 = 650;
/// The same where Embree is measured at the requested precision alone.
const BYTES_PER_TRIANGLE_AT_ONE_PRECISION: u64 = 450;

/// Half the edge length of the ground, and its height, which is below the lowest bump.
const GROUND: f32 = 6.0;
const GROUND_HEIGHT: f32 = -1.02;
/// Positions of the camera, of its target, and of the point light.
const CAMERA_POSITION: DVec3 = DVec3::new(1.1, 1.3, 3.9);
const CAMERA_TARGET: DVec3 = DVec3::new(0.05, -0.12, 0.0);
const LIGHT_POSITION: DVec3 = DVec3::new(2.6, 3.6, 3.2);
/// Intensity of the point light in candela.
const LIGHT_INTENSITY: f32 = 75.0;

/// Returns the triangle counts of the meshes in ascending order.
pub(super) fn sizes(most: u64) -> Vec<u64> {
    let of_step = |step: i32| {
        let factor = 10f64.powf(f64::from(step) / f64::from(SIZES_A_DECADE));
        (MIN_TRIANGLES as f64 * factor).round() as u64
    };
    let mut sizes: Vec<u64> = (0..)
        .map(of_step)
        .take_while(|&triangles| triangles < most)
        .collect();
    sizes.push(most);
    sizes
}

/// Returns the name of a mesh of about `triangles` triangles.
pub(super) fn name(triangles: u64) -> String {
    format!("bumpy sphere, {} triangles", group_thousands(triangles))
}

/// Measurements of a mesh that the memory has room for.
pub(super) enum Room {
    /// Embree at all precisions, and everything else.
    All,
    /// Embree at the requested precision alone, and everything else.
    OnePrecision,
    /// None, with the reason.
    Nothing(String),
}

impl Room {
    /// Returns what there is room for with so many triangles, in the memory that is free, if the system states it.
    pub(super) fn of(triangles: u64) -> Room {
        let free = memory::available_bytes().unwrap_or(u64::MAX);
        let needed = triangles * BYTES_PER_TRIANGLE_AT_ONE_PRECISION;
        if needed > free {
            return Room::Nothing(format!(
                "the sweep stops here: {} triangles take about {} of memory and {} are free",
                group_thousands(triangles),
                memory::in_words(needed),
                memory::in_words(free)
            ));
        }
        match triangles * BYTES_PER_TRIANGLE > free {
            true => Room::OnePrecision,
            false => Room::All,
        }
    }
}

/// Returns a scene with a polished bumpy sphere of about so many triangles over a dull ground, lit by a point light,
/// which yields rays of all kinds.
pub(super) fn scene(triangles: u64) -> Result<Scene, Failure> {
    // Each instance uses the mesh and the material of the same index
    let place = |name: &str, number| {
        Instance::new(name, number, number, DAffine3::IDENTITY)
            .map_err(|error| Failure::Work(format!("{name}: {error}")))
    };
    let material = |color: [f32; 3], roughness| Material::metallic_roughness(color, 0.0, roughness);
    Ok(Scene {
        geometries: vec![Geometry::Mesh(bumpy_sphere(triangles)), Geometry::Mesh(ground())],
        instances: vec![place("bumpy sphere", 0)?, place("ground", 1)?],
        materials: vec![
            material([0.80, 0.42, 0.25], 0.0),
            material([0.45, 0.50, 0.55], 0.9),
        ],
        lights: vec![Light {
            name: "light".to_owned(),
            intensity: [LIGHT_INTENSITY; 3],
            kind: LightKind::Point {
                position: LIGHT_POSITION,
                falloff: Falloff::PHYSICAL,
            },
        }],
        cameras: vec![camera()],
        background: Background::Uniform([0.5; 3]),
        ..Scene::default()
    })
}

fn ground() -> Mesh {
    let corners = [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]];
    Mesh {
        positions: corners
            .map(|[x, z]| [GROUND * x, GROUND_HEIGHT, GROUND * z])
            .to_vec()
            .into(),
        triangles: vec![[0, 1, 2], [0, 2, 3]].into(),
        ..Mesh::default()
    }
}

fn camera() -> Camera {
    let back = (CAMERA_POSITION - CAMERA_TARGET).normalize();
    let right = DVec3::Y.cross(back).normalize();
    let axes = DMat3::from_cols(right, back.cross(right), back);
    Camera {
        world_from_camera: DAffine3::from_mat3_translation(axes, CAMERA_POSITION),
        ..Camera::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_logarithmic_steps_up_to_the_largest() {
        assert_eq!(sizes(1_000), [1_000]);
        assert_eq!(sizes(10_000), [1_000, 3_162, 10_000]);
        assert_eq!(sizes(20_000), [1_000, 3_162, 10_000, 20_000]);
        assert_eq!(sizes(10_000_000).len(), 9);
    }

    #[test]
    fn scene_is_valid_and_its_sphere_touches_the_ground() {
        let scene = scene(5_000).unwrap();
        scene.validate().unwrap();
        assert_eq!(scene.triangle_count(), 12 * 20 * 20 + 2);
        let low = scene.geometries[0].bounds().min.y;
        assert!((f64::from(GROUND_HEIGHT)..-0.9).contains(&low), "{low}");
    }

    #[test]
    fn mesh_larger_than_memory_ends_the_sweep() {
        // There is no end on systems that do not report their free memory.
        let Some(free) = memory::available_bytes() else {
            return;
        };
        let Room::Nothing(words) = Room::of(1 << 50) else {
            panic!("there is no room for 2^50 triangles");
        };
        assert!(words.contains("1 125 899 906 842 624 triangles"), "{words}");
        assert!(matches!(Room::of(1_000), Room::All));
        // A size between the two needs
        let between = free * 2 / (BYTES_PER_TRIANGLE + BYTES_PER_TRIANGLE_AT_ONE_PRECISION);
        assert!(matches!(Room::of(between), Room::OnePrecision));
    }
}
