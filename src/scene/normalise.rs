//! Recentring and scaling by a power of two, so that no scene is tiny, huge or far away.
//!
//! f32 values near 10^6 are spaced by 0.06, and products of coordinates near 10^20 leave the range of f32. Scenes with
//! such positions or sizes are moved to the origin and scaled to about unit size before any later stage. The centre is
//! a multiple of the scene's size rounded down to a power of two and only changes axes along which the scene lies far
//! away, and the scale is a power of two, so an f32 coordinate is mapped without rounding. Scenes in a good range are
//! left as they are, which keeps their vertices in the bytes of the file.

use glam::{DAffine3, DVec3};

use super::{Falloff, Geometry, LightKind, Projection, Scene, bake};
use crate::mesh::Mesh;
use crate::numeric::Bounds;
use crate::shape::{Shape, Sphere};

/// Map from the file's coordinates to the scene's: `(p - center) * scale`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normalisation {
    /// Point that becomes the origin, in the file's coordinates.
    pub center: DVec3,
    /// Scale factor, a power of two.
    pub scale: f64,
}

/// Largest ratio of an axis's largest coordinate to the scene's extent at which the axis is not recentred: recentring
/// would then gain three of f32's 24 bits at most.
const MAX_OFFSET_RATIO: f64 = 8.0;
/// Smallest extent, in metres or the file's unit, that is not rescaled: squares and fourth powers of such lengths stay
/// far inside the range of f32.
const MIN_EXTENT: f64 = 1.0 / 1024.0;
/// Largest extent that is not rescaled, for the reason given at [`MIN_EXTENT`].
const MAX_EXTENT: f64 = 1024.0;

impl Default for Normalisation {
    fn default() -> Normalisation {
        Normalisation {
            center: DVec3::ZERO,
            scale: 1.0,
        }
    }
}

impl Normalisation {
    /// Returns the map that brings a scene with these bounds into a good range; the identity if it is already, or has
    /// no extent.
    pub fn fitting(bounds: &Bounds) -> Normalisation {
        let extent = bounds.extent().max_element();
        if bounds.is_empty() || !(extent > 0.0 && extent < f64::INFINITY) {
            return Normalisation::default();
        }
        // Round the extent to a power of two, of which the centre becomes a multiple
        let step = power_of_two_below(extent);
        let magnitude = bounds.min.abs().max(bounds.max.abs());
        let center = bounds.center();
        let axis = |i: usize| {
            if magnitude[i] > MAX_OFFSET_RATIO * extent {
                (center[i] / step).round() * step
            } else {
                0.0
            }
        };
        // Scale only scenes that are tiny or huge
        let scale = if (MIN_EXTENT..=MAX_EXTENT).contains(&extent) {
            1.0
        } else {
            step.recip()
        };
        Normalisation {
            center: DVec3::new(axis(0), axis(1), axis(2)),
            scale,
        }
    }

    /// Returns whether the map is the identity.
    pub fn is_identity(&self) -> bool {
        *self == Normalisation::default()
    }

    /// Returns the map from the file's coordinates to the scene's.
    pub fn map(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(
            DVec3::splat(self.scale),
            glam::DQuat::IDENTITY,
            -self.center * self.scale,
        )
    }

    /// Returns the map from the scene's coordinates to the file's.
    pub fn inverse_map(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(
            DVec3::splat(self.scale.recip()),
            glam::DQuat::IDENTITY,
            self.center,
        )
    }

    /// Returns a point of the file in the scene's coordinates.
    pub fn point(&self, p: DVec3) -> DVec3 {
        (p - self.center) * self.scale
    }

    /// Returns the map that applies `self` and then `next`.
    fn then(&self, next: &Normalisation) -> Normalisation {
        Normalisation {
            center: self.center + next.center / self.scale,
            scale: self.scale * next.scale,
        }
    }
}

impl Scene {
    /// Normalises the scene, whose geometries have these bounds, and its object spaces; bakes meshes of single
    /// instances; and removes triangles that rounding collapsed, with a warning, and meshes that are left empty.
    pub(crate) fn normalise_and_bake(&mut self, normalisation: Normalisation, bounds: &[Bounds]) {
        self.apply_normalisation(normalisation);
        self.normalise_object_spaces(bounds);
        self.bake_single_uses();
        for (name, removed) in self.drop_rounded_triangles() {
            self.warnings.push(format!("{name} {removed}"));
        }
        self.remove_empty_meshes();
    }

    /// Normalises the scene, as described at the head of this module: geometry, cameras, lights and volumes are mapped
    /// together, so that the image stays the same. Does nothing to a scene in a good range.
    ///
    /// The scene's indices must be in range.
    pub fn normalise(&mut self) {
        let bounds = self.bounds().union(self.volume_bounds());
        self.apply_normalisation(Normalisation::fitting(&bounds));
    }

    /// Maps the whole scene by `normalisation` and records it.
    pub(crate) fn apply_normalisation(&mut self, normalisation: Normalisation) {
        if normalisation.is_identity() {
            return;
        }
        self.transform_instances(&normalisation);
        self.transform_cameras(&normalisation);
        self.transform_lights(&normalisation);
        self.transform_volumes(&normalisation);
        self.scale_media(normalisation.scale);
        self.normalisation = self.normalisation.then(&normalisation);
    }

    /// Normalises the object spaces of meshes that are instanced several times or move; the instances' transforms
    /// compensate the change. `bounds` are those of the geometries.
    pub(crate) fn normalise_object_spaces(&mut self, bounds: &[Bounds]) {
        let use_counts = self.use_counts();
        // Find the meshes that move
        let mut moves = vec![false; self.geometries.len()];
        for instance in &self.instances {
            moves[instance.geometry as usize] |= instance.is_moving();
        }
        for (index, geometry) in self.geometries.iter_mut().enumerate() {
            let mut normalisation = Normalisation::fitting(&bounds[index]);
            if moves[index] {
                // A moving mesh rotates about the origin of its object space, so only its size changes.
                normalisation.center = DVec3::ZERO;
            }
            let Geometry::Mesh(mesh) = geometry else { continue };
            if !(use_counts[index] > 1 || moves[index]) || normalisation.is_identity() {
                continue;
            }
            // Map the mesh, and undo it in the transforms of its instances
            *mesh = transformed_mesh(mesh, &normalisation);
            let back = normalisation.inverse_map();
            for instance in self.instances.iter_mut().filter(|i| i.geometry as usize == index) {
                // The factor is a power of two: a map that had an inverse keeps one.
                let is_placed = instance.replace(|map| map * back);
                debug_assert!(is_placed.is_ok());
            }
        }
    }

    /// Maps instances: meshes and spheres of a single instance with the identity transform are mapped themselves, which
    /// is exact; all others by their instances' transforms.
    fn transform_instances(&mut self, normalisation: &Normalisation) {
        let use_counts = self.use_counts();
        for instance in &mut self.instances {
            let geometry = &mut self.geometries[instance.geometry as usize];
            let material = self.materials.get(instance.material as usize);
            let has_object_space_texture =
                material.is_some_and(|m| bake::has_object_space_texture(m, &self.textures));
            // Map the geometry itself where nothing else depends on its object space
            if use_counts[instance.geometry as usize] == 1
                && instance.is_identity()
                && !has_object_space_texture
            {
                match geometry {
                    Geometry::Mesh(mesh) => {
                        *mesh = transformed_mesh(mesh, normalisation);
                        continue;
                    }
                    Geometry::Shape(Shape::Sphere(sphere)) => {
                        *sphere = Sphere {
                            center: normalisation.point(sphere.center),
                            radius: sphere.radius * normalisation.scale,
                        };
                        continue;
                    }
                    // Points stay as in the file, shared with its bytes: a translation costs rays next to nothing
                    Geometry::Shape(_) | Geometry::Points(_) => (),
                }
            }
            // A power of two changes no condition number, so the inverse exists if it did before; computed anew it is
            // free of the cancellation of far translations.
            let is_placed = instance.replace(|old| DAffine3 {
                matrix3: old.matrix3 * normalisation.scale,
                translation: normalisation.point(old.translation),
            });
            debug_assert!(is_placed.is_ok());
        }
    }

    fn transform_cameras(&mut self, normalisation: &Normalisation) {
        let scale = normalisation.scale;
        for camera in &mut self.cameras {
            let end = camera.world_from_camera_end.as_mut();
            // Map the positions at the start and at the end of the motion; axes stay
            for map in end.into_iter().chain([&mut camera.world_from_camera]) {
                map.translation = normalisation.point(map.translation);
            }
            camera.z_near *= scale;
            camera.z_far *= scale;
            camera.lens = camera.lens.map(|lens| lens.scaled(scale));
            // Scale the lengths of the projection
            match &mut camera.projection {
                Projection::Perspective { .. } => {}
                Projection::Window {
                    half_width,
                    half_height,
                    distance,
                } => {
                    *half_width *= scale;
                    *half_height *= scale;
                    *distance *= scale;
                }
                Projection::Orthographic { y_mag, x_mag } => {
                    *y_mag *= scale;
                    *x_mag = x_mag.map(|x| x * scale);
                }
            }
        }
    }

    fn transform_lights(&mut self, normalisation: &Normalisation) {
        let scale = normalisation.scale;
        for light in &mut self.lights {
            let (position, falloff) = match &mut light.kind {
                LightKind::Directional { .. } => continue,
                // Radiance does not depend on the size of the scene.
                LightKind::Area { shape, .. } => {
                    *shape = shape.transformed(|p| normalisation.point(p), scale);
                    continue;
                }
                LightKind::Point { position, falloff } => (position, falloff),
                LightKind::Spot {
                    position, falloff, ..
                } => (position, falloff),
            };
            *position = normalisation.point(*position);
            match falloff {
                Falloff::InverseSquare { range } => {
                    *range = range.map(|r| r * scale);
                    // Irradiance is intensity over distance squared.
                    light.intensity = light.intensity.map(|i| {
                        let scaled = f64::from(i) * scale * scale;
                        scaled.min(f64::from(f32::MAX)) as f32
                    });
                }
                Falloff::Polynomial {
                    linear, quadratic, ..
                } => {
                    // Keep each term of the polynomial: d is multiplied by the scale
                    *linear /= scale;
                    *quadratic /= scale * scale;
                }
            }
        }
    }

    /// Scales absorption and scattering coefficients, which are per unit of length.
    fn scale_media(&mut self, scale: f64) {
        for interior in self.materials.iter_mut().filter_map(|m| m.interior.as_mut()) {
            interior.absorption.sigma_a = interior.absorption.sigma_a.map(|sigma| sigma / scale);
        }
        for scattering in self.materials.iter_mut().filter_map(|m| m.subsurface.as_mut()) {
            *scattering = scattering.scaled(scale);
        }
    }
}

/// Returns the mapped mesh. The subtraction comes first: for a far scene it is exact.
fn transformed_mesh(mesh: &Mesh, normalisation: &Normalisation) -> Mesh {
    bake::with_positions(mesh, |p| normalisation.point(p))
}

/// Returns the largest power of two that does not exceed a positive finite number, within the normal range.
fn power_of_two_below(x: f64) -> f64 {
    const FRACTION_BITS: u64 = (1 << 52) - 1;
    f64::from_bits(x.max(f64::MIN_POSITIVE).to_bits() & !FRACTION_BITS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::buffer::Buffer;
    use crate::scene::{Camera, Instance, Light};

    const POSITIONS: [[f32; 3]; 3] = [[0.25, -1.0, 0.1], [1.5, 0.3, -0.7], [-0.9, 2.1, 0.0]];

    /// Returns a scene of one baked triangle, a point light, a camera and an instanced sphere, moved and scaled.
    fn scene(scale: f64, offset: DVec3) -> Scene {
        let transformed = |p: DVec3| p * scale + offset;
        let triangle = Mesh {
            positions: Buffer::from(
                POSITIONS
                    .map(|p| transformed(glam::Vec3::from(p).as_dvec3()).as_vec3().to_array())
                    .to_vec(),
            ),
            triangles: Buffer::from(vec![[0, 1, 2]]),
            ..Mesh::default()
        };
        // Place a sphere by its instance, the triangle by its vertices
        let map = DAffine3::from_scale_rotation_translation(
            DVec3::splat(scale),
            glam::DQuat::IDENTITY,
            transformed(DVec3::new(0.5, 0.5, 0.5)),
        );
        Scene {
            geometries: vec![
                Geometry::Mesh(triangle),
                Geometry::Shape(Shape::Sphere(Sphere::UNIT)),
            ],
            instances: vec![
                Instance::new("triangle", 0, 0, DAffine3::IDENTITY).unwrap(),
                Instance::new("sphere", 1, 0, map).unwrap(),
            ],
            // Scale light and camera so that the image stays the same
            lights: vec![Light {
                name: "lamp".into(),
                intensity: [(3.0 * scale * scale) as f32; 3],
                kind: LightKind::Point {
                    position: transformed(DVec3::new(0.0, 4.0, 0.0)),
                    falloff: Falloff::InverseSquare {
                        range: Some(8.0 * scale),
                    },
                },
            }],
            cameras: vec![Camera {
                name: "camera".into(),
                world_from_camera: DAffine3::from_translation(transformed(DVec3::Z)),
                projection: Projection::Orthographic {
                    y_mag: 2.0 * scale,
                    x_mag: None,
                },
                z_near: 0.5 * scale,
                ..Camera::default()
            }],
            materials: vec![Default::default()],
            ..Scene::default()
        }
    }

    fn positions(scene: &Scene) -> Vec<[f32; 3]> {
        match &scene.geometries[0] {
            Geometry::Mesh(mesh) => mesh.positions.to_vec(),
            Geometry::Shape(_) | Geometry::Points(_) => Vec::new(),
        }
    }

    #[test]
    fn normalised_scene_is_unchanged() {
        let mut scene = scene(1.0, DVec3::ZERO);
        scene.normalise();
        assert!(scene.normalisation.is_identity());
        assert_eq!(positions(&scene), POSITIONS);
    }

    #[test]
    fn scenes_scaled_by_a_power_of_two_normalise_identically() {
        let normalised = |exponent: i32| {
            let mut scene = scene(2f64.powi(exponent), DVec3::ZERO);
            scene.normalise();
            scene.validate().unwrap();
            scene
        };
        // All scenes must be normalised to the same numbers
        let reference = normalised(-20);
        assert_eq!(positions(&reference), POSITIONS.map(|p| p.map(|x| x * 0.5)));
        for exponent in [-60, -40, 20, 40, 60] {
            let scene = normalised(exponent);
            assert_eq!(positions(&scene), positions(&reference), "{exponent}");
            assert_eq!(
                scene.instances[1].world_from_object(),
                reference.instances[1].world_from_object()
            );
            assert_eq!(scene.lights[0].intensity, reference.lights[0].intensity);
            assert_eq!(scene.lights[0].kind, reference.lights[0].kind);
            assert_eq!(scene.cameras[0].z_near, reference.cameras[0].z_near);
            assert_eq!(scene.cameras[0].projection, reference.cameras[0].projection);
        }
    }

    #[test]
    fn moving_mesh_keeps_its_pivot() {
        let mut scene = scene(1.0, DVec3::ZERO);
        let far = scene.geometries[0].bounds();
        scene.geometries[0] = Geometry::Mesh(match &scene.geometries[0] {
            Geometry::Mesh(mesh) => bake::with_positions(mesh, |p| p * 1e6 + DVec3::new(0.0, 1e9, 0.0)),
            Geometry::Shape(_) | Geometry::Points(_) => unreachable!(),
        });
        // A motion that scales and rotates about the origin of object space
        let ends = [
            DAffine3::from_scale(DVec3::splat(1e-6)),
            DAffine3::from_rotation_z(0.1),
        ];
        scene.instances[0] = Instance::moving("moving", 0, 0, ends).unwrap();
        let bounds: Vec<Bounds> = scene.geometries.iter().map(Geometry::bounds).collect();
        scene.normalise_object_spaces(&bounds);
        // The mesh has a size of about 1, and is still as far away, in relation to it: 10^9 of 3 10^6.
        let placed = scene.geometries[0].bounds();
        assert!(placed.extent().max_element() < 4.0 * far.extent().max_element());
        assert!(placed.center().y > 100.0 * far.extent().y);
        // The origin about which it turns is still that of object space
        let maps = scene.instances[0].motion().unwrap().ends();
        assert_eq!(maps.map(|map| map.translation), [DVec3::ZERO; 2]);
    }

    #[test]
    fn far_scene_moves_to_the_origin_losslessly() {
        // 1e6 is a multiple of the centre's step, and the triangle's rounding at 1e6 happened before.
        let offset = DVec3::new(1e6, 0.0, -3e6);
        let mut scene = scene(1.0, offset);
        let before = positions(&scene);
        scene.normalise();
        assert!(scene.bounds().magnitude() < 8.0);
        let center = scene.normalisation.center;
        assert_eq!((center.y, scene.normalisation.scale), (0.0, 1.0));
        for (old, new) in before.iter().zip(positions(&scene)) {
            // Moving back must restore every bit
            let back = glam::Vec3::from(new).as_dvec3() + center;
            assert_eq!(back, glam::Vec3::from(*old).as_dvec3());
        }
        let LightKind::Point { position, .. } = scene.lights[0].kind else {
            unreachable!()
        };
        assert_eq!(position + center, DVec3::new(0.0, 4.0, 0.0) + offset);
        scene.validate().unwrap();
    }

    #[test]
    fn tiny_far_scene_keeps_geometry_and_irradiance() {
        let offset = DVec3::new(0.0, 1.0, 0.0);
        let mut scene = scene(2f64.powi(-12), offset);
        // Intensity must grow with the square of the scale
        let before = scene.lights[0].intensity[0];
        scene.normalise();
        let scale = scene.normalisation.scale;
        assert_eq!(
            scene.normalisation.point(offset + DVec3::X),
            scene.normalisation.map().transform_point3(offset + DVec3::X)
        );
        assert!(scene.bounds().magnitude() < 8.0);
        assert_eq!(
            scene.lights[0].intensity[0],
            (f64::from(before) * scale * scale) as f32
        );
    }

    #[test]
    fn instanced_mesh_far_in_object_space_is_recentred() {
        let mut scene = scene(1.0, DVec3::ZERO);
        let far = scene_far_triangle();
        let back = DAffine3::from_translation(DVec3::new(-1e6, 0.0, 0.0));
        scene.geometries.push(Geometry::Mesh(far));
        // Two instances bring the mesh back near the origin
        for x in [0.0, 3.0] {
            let map = DAffine3::from_translation(DVec3::new(x, 0.0, 0.0)) * back;
            scene.instances.push(Instance::new("far", 2, 0, map).unwrap());
        }
        let bounds: Vec<Bounds> = scene.geometries.iter().map(Geometry::bounds).collect();
        let world = scene.bounds();
        scene.normalise_object_spaces(&bounds);
        assert!(scene.geometries[2].bounds().magnitude() < 8.0);
        assert_eq!(scene.bounds(), world);
        scene.validate().unwrap();
    }

    fn scene_far_triangle() -> Mesh {
        Mesh {
            positions: Buffer::from(vec![[1e6, 0.0, 0.0], [1e6 + 1.0, 0.0, 0.0], [1e6, 1.0, 0.0]]),
            triangles: Buffer::from(vec![[0, 1, 2]]),
            ..Mesh::default()
        }
    }
}
