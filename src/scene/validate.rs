//! Validation of scenes: indices, array lengths and values, so that later stages see no bad index, NaN or singular
//! matrix.

use std::f64::consts::PI;
use std::ops::Deref;

use glam::{DAffine3, DMat3};

use super::validate_geometry::{check_geometry, check_points, check_vertices};
use super::validate_light::{check_emissive_light, check_environment, check_light, max_light_coordinate};
use super::validate_material::{
    check_factors, check_interior, check_procedural, check_scattering, check_texels,
};
use super::validate_value::{UNIT_TOLERANCE, check_coordinate_range, is_radiance, is_size};
use super::{
    AlphaMode, Background, Camera, Geometry, Instance, Material, Projection, Scene, Shutter, Space, Texels,
    Texture,
};
use crate::numeric::{AnimatedTransform, Bounds};
use crate::shape::Implicit;

/// A fault of a scene, worded as advice.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{item}: {fault}")]
pub struct SceneError {
    /// Faulty geometry, instance, material and so on, by name and number.
    pub item: String,
    /// Description of the fault and its remedy.
    pub fault: String,
}

/// Scene that [`Scene::validate`] has accepted, borrowed so that it stays as it was.
#[derive(Clone, Copy, Debug)]
pub struct ValidScene<'s>(&'s Scene);

impl<'s> ValidScene<'s> {
    /// Wraps a scene that is valid by its construction.
    pub(crate) fn assume(scene: &'s Scene) -> ValidScene<'s> {
        ValidScene(scene)
    }

    /// Returns the scene, for as long as it is borrowed.
    pub fn get(self) -> &'s Scene {
        self.0
    }
}

impl Deref for ValidScene<'_> {
    type Target = Scene;

    fn deref(&self) -> &Scene {
        self.0
    }
}

impl Scene {
    /// Checks everything that later stages rely on: indices, lengths of arrays, finite and sensible values.
    ///
    /// Reads every vertex once, in parallel.
    pub fn validate(&self) -> Result<ValidScene<'_>, SceneError> {
        let mut bounds = Vec::with_capacity(self.geometries.len());
        for (index, geometry) in self.geometries.iter().enumerate() {
            let item = || format!("geometry {index}");
            let geometry_bounds = match geometry {
                Geometry::Mesh(mesh) => check_vertices(mesh).map_err(|fault| error(item(), fault))?,
                Geometry::Points(cloud) => check_points(cloud).map_err(|fault| error(item(), fault))?,
                Geometry::Shape(shape) => shape.bounds(),
            };
            bounds.push(geometry_bounds);
        }
        self.validate_structure(&bounds)?;
        Ok(ValidScene(self))
    }

    /// Runs all checks except those that read every vertex; `bounds` are those of the geometries.
    pub(crate) fn validate_structure(&self, bounds: &[Bounds]) -> Result<(), SceneError> {
        // Check geometries and the instances that refer to them
        for (index, geometry) in self.geometries.iter().enumerate() {
            check_geometry(geometry, &bounds[index])
                .map_err(|fault| error(format!("geometry {index}"), fault))?;
        }
        for (index, instance) in self.instances.iter().enumerate() {
            self.check_instance(instance, bounds)
                .map_err(|fault| error(named("instance", index, &instance.name), fault))?;
        }
        // Check materials, textures and images
        for (index, material) in self.materials.iter().enumerate() {
            self.check_material(material)
                .map_err(|fault| error(named("material", index, &material.name), fault))?;
        }
        self.check_images()?;
        // Check volumes, lights and cameras
        self.check_volumes()
            .map_err(|(index, fault)| error(named("volume", index, self.volumes[index].name()), fault))?;
        for (index, light) in self.lights.iter().enumerate() {
            check_light(light)
                .and_then(|()| check_coordinate_range(max_light_coordinate(light)))
                .and_then(|()| check_emissive_light(self, light))
                .map_err(|fault| error(named("light", index, &light.name), fault))?;
        }
        for (index, camera) in self.cameras.iter().enumerate() {
            check_camera(camera)
                .and_then(|()| check_coordinate_range(max_camera_coordinate(camera)))
                .map_err(|fault| error(named("camera", index, &camera.name), fault))?;
        }
        // Check the ambient light and the background
        if !is_radiance(&self.ambient) {
            return Err(error(
                "the ambient light",
                "is negative or not finite: give 0 or more",
            ));
        }
        // Check the effects that are simulated on request
        if let Some(interreflection) = self.interreflection {
            interreflection
                .check()
                .map_err(|fault| error("the interreflection", fault))?;
        }
        if let Some(caustics) = self.caustics {
            caustics.check().map_err(|fault| error("the caustics", fault))?;
        }
        let background: &[[f32; 3]] = match &self.background {
            Background::Uniform(color) => &[*color],
            Background::Gradient { horizon, up, down } => &[*horizon, *up, *down],
            Background::Environment { .. } => &[],
        };
        if let Background::Environment {
            image,
            rotation,
            scale,
            samples,
        } = self.background
        {
            check_environment(self.images.get(image as usize), (rotation, scale), samples)
                .map_err(|fault| error("the environment map", fault))?;
        }
        if !background.iter().all(is_radiance) {
            return Err(error(
                "the background",
                "is negative or not finite: give 0 or more",
            ));
        }
        Ok(())
    }

    fn check_instance(&self, instance: &Instance, bounds: &[Bounds]) -> Result<(), String> {
        // Check the indices
        let Some(geometry) = self.geometries.get(instance.geometry as usize) else {
            return Err(out_of_range("geometry", instance.geometry, self.geometries.len()));
        };
        let Some(material) = self.materials.get(instance.material as usize) else {
            return Err(out_of_range("material", instance.material, self.materials.len()));
        };
        // For an unbounded geometry only the position of its origin counts.
        let reach = if geometry.is_unbounded() {
            let reach = |map: &DAffine3| map.translation.abs().max_element();
            let [start, end] = instance
                .motion()
                .map_or([instance.world_from_object(); 2], AnimatedTransform::ends);
            reach(&start).max(reach(&end))
        } else {
            let bounds = &bounds[instance.geometry as usize];
            instance.world_bounds(geometry, bounds).magnitude()
        };
        check_coordinate_range(reach)?;
        // Check restrictions of subsurface scattering
        if geometry.is_unbounded() && material.scatters().is_some() {
            return Err(format!(
                "its material `{}` has subsurface scattering, but a plane is unbounded: give a disk or a quad",
                material.name
            ));
        }
        if geometry.point_cloud().is_some() && material.scatters().is_some() {
            return Err(format!(
                "its material `{}` has subsurface scattering, but a point cloud is no body: remove the scattering",
                material.name
            ));
        }
        if instance.is_moving() && material.scatters().is_some() {
            return Err(format!(
                "moves, and its material `{}` has subsurface scattering, which is precomputed at a fixed position: \
                 remove the motion or the scattering",
                material.name
            ));
        }
        // Check that the mesh has the texture coordinates that its material uses
        let Geometry::Mesh(mesh) = geometry else {
            return Ok(());
        };
        for layer in &material.layers {
            let texture = layer.texture;
            if !self.looks_up_coordinates(texture.texture) {
                continue;
            }
            // A set must have one pair per vertex
            let set = mesh.tex_coords.get(texture.tex_coord as usize);
            if set.is_none_or(|set| set.len() != mesh.positions.len()) {
                return Err(format!(
                    "its material `{}` looks up texture coordinate set {}, which its mesh lacks: add the set or remove \
                     the texture",
                    material.name, texture.tex_coord
                ));
            }
        }
        Ok(())
    }

    /// Checks a material and its textures, if they exist.
    pub(crate) fn check_material(&self, material: &Material) -> Result<(), String> {
        check_factors(material)?;
        if matches!(material.alpha, AlphaMode::Mask(cutoff) if !(cutoff >= 0.0)) {
            return Err("its alpha cut-off is negative or not a number: give 0 or more".into());
        }
        check_interior(material)?;
        check_scattering(material)?;
        // Check the textures and their bindings
        for layer in &material.layers {
            let texture = layer.texture;
            if texture.texture as usize >= self.textures.len() {
                return Err(out_of_range("texture", texture.texture, self.textures.len()));
            }
            // Each input has at most one texture
            let of_parameter = material.layers.iter().filter(|l| l.parameter == layer.parameter);
            if of_parameter.count() > 1 {
                return Err(format!("has two textures on {:?}: keep one", layer.parameter));
            }
            let transform = texture.transform;
            let numbers = transform.matrix.as_flattened().iter().chain(&transform.offset);
            if !numbers.chain([&layer.strength]).all(|x| x.is_finite()) {
                return Err("has a texture whose strength or transform is not finite: correct it".into());
            }
            check_texels(self, material, layer)?;
        }
        Ok(())
    }

    /// Returns whether a texture is looked up by texture coordinates.
    pub(crate) fn looks_up_coordinates(&self, texture: u32) -> bool {
        match self.textures.get(texture as usize) {
            Some(Texture::Procedural(procedural)) => procedural.space == Space::Uv,
            _ => true,
        }
    }

    fn check_images(&self) -> Result<(), SceneError> {
        // Check the textures' images and patterns
        for (index, texture) in self.textures.iter().enumerate() {
            let fault = match texture {
                Texture::Image { image, .. } if *image as usize >= self.images.len() => {
                    out_of_range("image", *image, self.images.len())
                }
                Texture::Procedural(procedural) => match check_procedural(procedural) {
                    Ok(()) => continue,
                    Err(fault) => fault,
                },
                _ => continue,
            };
            return Err(error(format!("texture {index}"), fault));
        }
        // Check the sizes of the images
        for (index, image) in self.images.iter().enumerate() {
            // Unread images have a size but no texels
            let texel_count = u64::from(image.width) * u64::from(image.height);
            let is_unread = image.texels == Texels::Unread;
            if texel_count == 0 || (!is_unread && texel_count != image.texels.len() as u64) {
                return Err(error(
                    named("image", index, &image.name),
                    "its texels do not fill width times height: load it again",
                ));
            }
        }
        Ok(())
    }
}

/// Checks a camera.
///
/// Coordinates outside the valid range are allowed, as a scene that is not normalised yet may have them.
pub(crate) fn check_camera(camera: &Camera) -> Result<(), String> {
    // Check that both maps are finite and orthonormal
    for map in [Some(camera.world_from_camera), camera.world_from_camera_end]
        .into_iter()
        .flatten()
    {
        let (place, axes) = (map.translation, map.matrix3);
        // Columns are orthonormal if this matrix is zero
        let gram = axes.transpose() * axes - DMat3::IDENTITY;
        if !(place.is_finite() && row_sum(&gram) <= 3.0 * UNIT_TOLERANCE) {
            return Err(
                "its position is not finite or its axes are not orthonormal: correct its transform".into(),
            );
        }
    }
    // Check the motion and the shutter
    let end = camera.world_from_camera_end;
    if end.is_some_and(|end| AnimatedTransform::new(camera.world_from_camera, end).is_err()) {
        return Err("it is mirrored where its motion begins or where it ends and not at the other: correct its transform".into());
    }
    let Shutter { open, close } = camera.shutter;
    if !(0.0 <= open && open <= close && close <= 1.0) {
        return Err(format!(
            "its shutter is open from {open} to {close}: give two parts of the motion from 0 to 1, the smaller first"
        ));
    }
    // Check the projection and the depth range
    let is_sound = match camera.projection {
        Projection::Perspective { y_fov, .. } => y_fov > 0.0 && y_fov < PI,
        Projection::Window {
            half_width,
            half_height,
            distance,
        } => is_size(half_width) && is_size(half_height) && is_size(distance),
        Projection::Orthographic { y_mag, x_mag } => is_size(y_mag) && x_mag.is_none_or(is_size),
    };
    if !is_sound {
        return Err(
            "its field of view is not between 0 and 180 degrees or its window has no size: correct it".into(),
        );
    }
    if !(camera.z_near >= 0.0 && camera.z_near < f64::INFINITY && camera.z_far > camera.z_near) {
        return Err("its near plane is not before its far plane: correct the planes".into());
    }
    Ok(())
}

/// Returns the largest coordinate of a camera's positions, or the radius of its lens if that is larger.
fn max_camera_coordinate(camera: &Camera) -> f64 {
    [Some(camera.world_from_camera), camera.world_from_camera_end]
        .into_iter()
        .flatten()
        .map(|map| map.translation.abs().max_element())
        .fold(camera.lens_radius(), f64::max)
}

fn row_sum(m: &DMat3) -> f64 {
    let rows = m.x_axis.abs() + m.y_axis.abs() + m.z_axis.abs();
    // `max_element` may ignore NaN
    if rows.is_nan() {
        f64::NAN
    } else {
        rows.max_element()
    }
}

fn error(item: impl Into<String>, fault: impl Into<String>) -> SceneError {
    SceneError {
        item: item.into(),
        fault: fault.into(),
    }
}

fn named(kind: &str, index: usize, name: &str) -> String {
    format!("{kind} {index} `{name}`")
}

fn out_of_range(kind: &str, index: u32, count: usize) -> String {
    format!("refers to {kind} {index} of {count}: correct the index")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::buffer::Buffer;
    use crate::mesh::Mesh;
    use crate::optics::subsurface::SubsurfacePreset;
    use crate::optics::{Absorption, Dispersion};
    use crate::scene::{
        Filter, Image, MaterialInput, Medium, MediumKind, MetallicRoughness, Model, Pattern, Phong,
        Procedural, Sampler, Texels, TextureBinding, TextureUse, Translucency, Wrap,
    };
    use crate::scene::{Light, LightKind};
    use crate::shape::{Shape, Sphere, Torus};
    use glam::{DAffine3, DVec3};

    /// Returns a valid scene of a textured triangle, a sphere, a light and a camera.
    fn scene() -> Scene {
        let mesh = Mesh {
            positions: Buffer::from(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
            triangles: Buffer::from(vec![[0, 1, 2]]),
            normals: Some(Buffer::from(vec![[0.0, 0.0, 1.0]; 3])),
            tex_coords: vec![Buffer::from(vec![[0.0; 2]; 3])],
            ..Mesh::default()
        };
        // Stretch the triangle by 1e6 and mirror it
        let turned = DAffine3::from_rotation_x(0.4) * DAffine3::from_scale(DVec3::new(-1e3, 1.0, 1e-3));
        Scene {
            geometries: vec![Geometry::Mesh(mesh), Geometry::Shape(Shape::Sphere(Sphere::UNIT))],
            instances: vec![
                Instance::new("triangle", 0, 0, turned).unwrap(),
                Instance::new("ball", 1, 0, DAffine3::IDENTITY).unwrap(),
            ],
            materials: vec![Material {
                layers: vec![base_color_layer(0)],
                ..Material::default()
            }],
            textures: vec![Texture::Image {
                image: 0,
                sampler: Sampler {
                    wrap_u: Wrap::Repeat,
                    wrap_v: Wrap::Repeat,
                    filter: Filter::Linear,
                },
            }],
            images: vec![Image {
                name: "dot".into(),
                width: 1,
                height: 1,
                texels: Texels::Bytes(vec![[255; 4]].into()),
            }],
            lights: vec![Light {
                name: "sun".into(),
                intensity: [1.0; 3],
                kind: LightKind::Directional { to_light: DVec3::Y },
            }],
            cameras: vec![Camera {
                name: "eye".into(),
                world_from_camera: DAffine3::IDENTITY,
                projection: Projection::Perspective {
                    y_fov: 1.0,
                    aspect: None,
                },
                ..Camera::default()
            }],
            ..Scene::default()
        }
    }

    fn base_color_layer(texture: u32) -> TextureBinding {
        TextureBinding {
            parameter: MaterialInput::BaseColor,
            texture: TextureUse::new(texture),
            strength: 1.0,
        }
    }

    fn mesh(scene: &mut Scene) -> &mut Mesh {
        match &mut scene.geometries[0] {
            Geometry::Mesh(mesh) => mesh,
            Geometry::Shape(_) | Geometry::Points(_) => unreachable!(),
        }
    }

    #[test]
    fn valid_scene_passes_validation() {
        // The triangle is the worst valid case: mirrored and stretched by 1e6.
        assert_eq!(scene().validate().err(), None);
    }

    #[test]
    fn every_fault_is_found_with_its_item() {
        type Break = fn(&mut Scene);
        let breaks: [(&str, Break); 36] = [
            // Faults of geometries and instances
            ("geometry 0", |s| {
                mesh(s).triangles = Buffer::from(vec![[0, 1, 3]])
            }),
            ("geometry 0", |s| {
                mesh(s).triangles = Buffer::from(vec![[0, 1, 1]])
            }),
            ("geometry 0", |s| {
                mesh(s).positions = Buffer::from(vec![[f32::NAN; 3]; 3])
            }),
            ("geometry 0", |s| {
                mesh(s).normals = Some(Buffer::from(vec![[1.0; 3]; 2]))
            }),
            ("geometry 0", |s| {
                mesh(s).normals = Some(Buffer::from(vec![[f32::NAN; 3]; 3]))
            }),
            ("geometry 0", |s| {
                mesh(s).tangents = Some(Buffer::from(vec![[1.0; 4]; 4]))
            }),
            ("geometry 0", |s| {
                mesh(s).tangents = Some(Buffer::from(vec![[f32::NAN; 4]; 3]))
            }),
            ("geometry 0", |s| {
                mesh(s).colors = Some(Buffer::from(vec![[f32::INFINITY; 4]; 3]))
            }),
            ("instance 0", |s| mesh(s).tex_coords.clear()),
            ("geometry 1", |s| {
                s.geometries[1] = Geometry::Shape(Shape::Sphere(Sphere {
                    radius: -1.0,
                    ..Sphere::UNIT
                }))
            }),
            ("geometry 1", |s| {
                s.geometries[1] = Geometry::Shape(Shape::Sphere(Sphere {
                    radius: 1e30,
                    ..Sphere::UNIT
                }))
            }),
            ("geometry 1", |s| {
                s.geometries[1] = Geometry::Shape(Shape::Torus(Torus { minor_radius: 1.0 }))
            }),
            ("geometry 1", |s| {
                s.geometries[1] = Geometry::Shape(Shape::Torus(Torus {
                    minor_radius: f64::NAN,
                }))
            }),
            ("instance 1", |s| s.instances[1].geometry = 2),
            ("instance 1", |s| s.instances[1].material = 1),
            ("instance 1", |s| {
                let far = DAffine3::from_translation(DVec3::splat(1e30));
                s.instances[1].place(far).unwrap();
            }),
            ("instance 1", |s| {
                s.geometries[1] = Geometry::Shape(Shape::Plane);
                let far = DAffine3::from_translation(DVec3::splat(1e30));
                s.instances[1].place(far).unwrap();
            }),
            // Faults of materials
            ("material 0", |s| s.materials[0].emission[1] = f32::INFINITY),
            ("material 0", |s| {
                s.materials[0].model = Model::MetallicRoughness(MetallicRoughness {
                    roughness: 1.5,
                    ..MetallicRoughness::DEFAULT
                })
            }),
            ("material 0", |s| {
                s.materials[0].layers = vec![base_color_layer(1)]
            }),
            ("material 0", |s| {
                s.materials[0].layers = vec![base_color_layer(0); 2]
            }),
            ("material 0", |s| s.materials[0].alpha = AlphaMode::Mask(f32::NAN)),
            ("material 0", |s| {
                s.materials[0].model = Model::Phong(Phong {
                    reflection: [2.0; 3],
                    ..Phong::DEFAULT
                })
            }),
            ("material 0", |s| {
                s.materials[0].interior = Some(Medium {
                    ior: Dispersion::Constant(2e9),
                    absorption: Absorption::NONE,
                    priority: 0,
                    kind: MediumKind::Solid,
                })
            }),
            ("material 0", |s| {
                s.materials[0].subsurface = Some(SubsurfacePreset::ALL[0].scattering.scaled(-1.0));
            }),
            ("material 0", |s| {
                s.materials[0].translucency = Some(Translucency {
                    factor: 1.5,
                    color: [1.0; 3],
                });
            }),
            ("instance 1", |s| {
                s.geometries[1] = Geometry::Shape(Shape::Plane);
                s.materials[0].subsurface = Some(SubsurfacePreset::ALL[0].scattering);
            }),
            // Faults of textures and images
            ("texture 0", |s| {
                if let Texture::Image { image, .. } = &mut s.textures[0] {
                    *image = 1;
                }
            }),
            ("texture 0", |s| {
                s.textures[0] = Texture::Procedural(Procedural {
                    pattern: Pattern::Noise { octaves: 0 },
                    colors: [[0.0; 4], [1.0; 4]],
                    space: Space::Uv,
                    scale: [1.0; 3],
                })
            }),
            ("image 0", |s| s.images[0].width = 2),
            // Faults of lights and cameras
            ("light 0", |s| s.lights[0].intensity[0] = -1.0),
            ("light 0", |s| {
                s.lights[0].kind = LightKind::Directional { to_light: DVec3::ONE }
            }),
            ("camera 0", |s| {
                s.cameras[0].projection = Projection::Perspective {
                    y_fov: PI,
                    aspect: None,
                }
            }),
            ("camera 0", |s| {
                s.cameras[0].world_from_camera.matrix3.x_axis *= 2.0
            }),
            // Faults of the ambient light and the background
            ("the ambient light", |s| s.ambient[2] = f32::NAN),
            ("the background", |s| {
                s.background = Background::Uniform([-1.0; 3])
            }),
        ];
        // Break a valid scene in one way each and check the message
        for (number, (item, spoil)) in breaks.into_iter().enumerate() {
            let mut scene = scene();
            spoil(&mut scene);
            let error = scene
                .validate()
                .expect_err(&format!("fault {number} went unseen"));
            assert!(error.item.starts_with(item), "fault {number}: {error}");
            assert!(error.fault.contains(": "), "no remedy: {error}");
        }
    }
}
