//! Cameras and lights: those of the file, and the default light for files without any.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use glam::{DAffine3, DMat3, DVec3};
use gltf::json;
use json::extensions::scene::khr_lights_punctual;
use json::validation::Checked;

use crate::gltf::document::GltfDocument;
use crate::gltf::node::PlacedNode;
use crate::gltf::{DefaultLight, GltfError};
use crate::scene::{Background, BuiltInEnvironment, Camera, Falloff, Light, LightKind, Projection, Scene};

/// Ambient and background radiance with the default light.
const DEFAULT_AMBIENT: [f32; 3] = [0.25; 3];
/// Direction from surfaces to the default light, in camera space: behind the camera's left shoulder.
const TO_DEFAULT_LIGHT: DVec3 = DVec3::new(-0.5, 0.8, 1.0);

impl DefaultLight {
    /// Lights a scene that has a camera and no light.
    pub(in crate::gltf) fn apply(self, scene: &mut Scene) {
        if self == DefaultLight::None {
            return;
        }
        scene.lights.push(default_light(&scene.cameras[0]));
        scene.ambient = DEFAULT_AMBIENT;
        scene.background = Background::Uniform(DEFAULT_AMBIENT);
        // Replace the background by the studio if any surface shows it
        if self == DefaultLight::SunlightInStudio && scene.reflect_background_in_gloss() {
            let studio = BuiltInEnvironment::Studio;
            scene.background = Background::Environment {
                image: scene.images.len() as u32,
                rotation: studio.turn_for(&scene.cameras[0]),
                scale: 1.0,
                samples: 0,
            };
            scene.images.push(studio.image());
        }
    }
}

/// Returns the default light: white sunlight from behind the camera's left shoulder, of ¾ π lux. With the ambient light
/// [`DEFAULT_AMBIENT`], a white Lambertian surface that faces it has radiance 1 and is not clipped.
fn default_light(camera: &Camera) -> Light {
    Light {
        name: "default".into(),
        intensity: [1.0 - DEFAULT_AMBIENT[0]; 3].map(|radiance| radiance * PI as f32),
        kind: LightKind::Directional {
            to_light: (camera.world_from_camera.matrix3 * TO_DEFAULT_LIGHT).normalize(),
        },
    }
}

impl GltfDocument {
    /// Returns the camera at a node, if it has one. An invalid camera is skipped with a warning.
    pub(in crate::gltf) fn camera_at(
        &self,
        node: &PlacedNode,
        warnings: &mut Vec<String>,
    ) -> Result<Option<Camera>, GltfError> {
        let Some(number) = self.root.nodes[node.number].camera.map(|c| c.value()) else {
            return Ok(None);
        };
        let cameras = &self.root.cameras;
        let Some(source) = cameras.get(number) else {
            return Err(self.missing("camera", number, cameras.len()));
        };
        let lens = lens(source);
        let place = rigid(&node.world_from_node);
        let (Some((projection, z_near, z_far)), Some(world_from_camera)) = (lens, place) else {
            warnings.push(format!("camera {number} is invalid and was skipped"));
            return Ok(None);
        };
        let name = source.name.as_deref().filter(|name| !name.is_empty());
        Ok(Some(Camera {
            name: name.map_or_else(|| self.node_name(node.number), str::to_owned),
            world_from_camera,
            projection,
            z_near,
            z_far,
            ..Camera::default()
        }))
    }

    /// Returns the light at a node, if it has one. An invalid light is skipped with a warning.
    pub(in crate::gltf) fn light_at(
        &self,
        node: &PlacedNode,
        warnings: &mut Vec<String>,
    ) -> Result<Option<Light>, GltfError> {
        // Find the light that the node refers to
        let extensions = self.root.nodes[node.number].extensions.as_ref();
        let Some(reference) = extensions.and_then(|e| e.khr_lights_punctual.as_ref()) else {
            return Ok(None);
        };
        let number = reference.light.value();
        let lights = self
            .root
            .extensions
            .as_ref()
            .and_then(|e| e.khr_lights_punctual.as_ref());
        let lights = lights.map_or(&[][..], |l| &l.lights);
        let Some(source) = lights.get(number) else {
            return Err(self.missing("light", number, lights.len()));
        };
        // Check the intensity and the type of the light
        let intensity = source.color.map(|c| c * source.intensity);
        let is_sound = intensity.iter().all(|x| (0.0..f32::INFINITY).contains(x));
        let kind = emit(source, &node.world_from_node).filter(|_| is_sound);
        let Some(kind) = kind else {
            warnings.push(format!("light {number} is invalid and was skipped"));
            return Ok(None);
        };
        let name = source.name.as_deref().filter(|name| !name.is_empty());
        Ok(Some(Light {
            name: name.map_or_else(|| self.node_name(node.number), str::to_owned),
            intensity,
            kind,
        }))
    }
}

/// Returns the projection, the near and the far plane, if they are valid.
fn lens(source: &json::Camera) -> Option<(Projection, f64, f64)> {
    let is_size = |x: &f64| *x > 0.0 && *x < f64::INFINITY;
    let size = |x: f32| Some(f64::from(x)).filter(is_size);
    let (projection, z_near, z_far) = match source.type_ {
        Checked::Valid(json::camera::Type::Perspective) => {
            let lens = source.perspective.as_ref()?;
            let projection = Projection::Perspective {
                y_fov: size(lens.yfov).filter(|&y_fov| y_fov < PI)?,
                aspect: lens.aspect_ratio.and_then(size),
            };
            (
                projection,
                f64::from(lens.znear),
                lens.zfar.map_or(f64::INFINITY, f64::from),
            )
        }
        Checked::Valid(json::camera::Type::Orthographic) => {
            let lens = source.orthographic.as_ref()?;
            let projection = Projection::Orthographic {
                y_mag: size(lens.ymag)?,
                x_mag: Some(size(lens.xmag)?),
            };
            (projection, f64::from(lens.znear), f64::from(lens.zfar))
        }
        Checked::Invalid => return None,
    };
    // The near plane must be in front of the far plane
    let is_sound = (0.0..f64::INFINITY).contains(&z_near) && z_far > z_near;
    is_sound.then_some((projection, z_near, z_far))
}

/// Returns the type of a light at its node; it emits along the node's -z axis, unscaled.
fn emit(source: &khr_lights_punctual::Light, world_from_node: &DAffine3) -> Option<LightKind> {
    let position = Some(world_from_node.translation).filter(|p| p.is_finite())?;
    // Scale and shear are removed from the direction
    let forward = || world_from_node.matrix3.z_axis.try_normalize().map(|back| -back);
    // An invalid range counts as none.
    let range = source
        .range
        .map(f64::from)
        .filter(|&r| r > 0.0 && r < f64::INFINITY);
    let falloff = Falloff::InverseSquare { range };
    match source.type_ {
        Checked::Valid(khr_lights_punctual::Type::Directional) => Some(LightKind::Directional {
            to_light: -forward()?,
        }),
        Checked::Valid(khr_lights_punctual::Type::Point) => Some(LightKind::Point { position, falloff }),
        Checked::Valid(khr_lights_punctual::Type::Spot) => {
            let cone = source.spot.as_ref();
            let inner = cone.map_or(0.0, |c| f64::from(c.inner_cone_angle));
            let outer = cone.map_or(FRAC_PI_4, |c| f64::from(c.outer_cone_angle));
            // Exporters round π/2 up to f32.
            let outer = outer.min(FRAC_PI_2);
            let (cos_inner, cos_outer) = (inner.cos(), outer.cos());
            let is_sound = 0.0 <= inner && inner < outer && cos_outer < cos_inner;
            is_sound.then_some(LightKind::Spot {
                position,
                direction: forward()?,
                cos_inner,
                cos_outer,
                falloff,
            })
        }
        Checked::Invalid => None,
    }
}

/// Returns the map without scale, shear and mirroring: the view axis keeps its direction, and up is made orthogonal to
/// it.
fn rigid(map: &DAffine3) -> Option<DAffine3> {
    let back = map.matrix3.z_axis.try_normalize()?;
    let up = map.matrix3.y_axis.try_normalize()?;
    let up = (up - up.dot(back) * back).try_normalize()?;
    let translation = Some(map.translation).filter(|t| t.is_finite())?;
    let axes = DMat3::from_cols(up.cross(back), up, back);
    Some(DAffine3::from_mat3_translation(axes, translation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;

    #[test]
    fn studio_is_the_background_only_where_a_surface_shows_it() {
        let lit = |light: DefaultLight, metallic: f32, roughness: f32| {
            let mut scene = Scene {
                cameras: vec![Camera::default()],
                materials: vec![
                    Material::default(),
                    Material::metallic_roughness([1.0; 3], metallic, roughness),
                ],
                ..Scene::default()
            };
            light.apply(&mut scene);
            assert_eq!(scene.materials[0].rough_rays(), 0, "chalk shows no shapes");
            (
                scene.background,
                scene.materials[1].rough_rays(),
                scene.lights.len(),
            )
        };
        let (plain, studio) = (DefaultLight::Sunlight, DefaultLight::SunlightInStudio);
        let grey = (Background::Uniform(DEFAULT_AMBIENT), 0, 1);
        assert_eq!(lit(studio, 1.0, 0.7), grey);
        assert_eq!(lit(studio, 0.0, 0.5), grey);
        assert_eq!(lit(plain, 1.0, 0.5), grey);
        for (metallic, roughness) in [(1.0, 0.5), (0.0, 0.3)] {
            let (background, rough_rays, lights) = lit(studio, metallic, roughness);
            assert!(matches!(background, Background::Environment { samples: 0, .. }));
            assert_eq!((rough_rays, lights), (1, 1));
        }
        let (none, ..) = lit(DefaultLight::None, 1.0, 0.5);
        assert_eq!(none, Background::default());
    }

    #[test]
    fn scaled_and_mirrored_camera_node_gives_an_orthonormal_camera() {
        let turn = DAffine3::from_rotation_y(0.5);
        let map = turn * DAffine3::from_scale(DVec3::new(-3.0, 2.0, 0.1));
        let axes = rigid(&map).unwrap().matrix3;
        assert!(
            (axes - turn.matrix3)
                .to_cols_array()
                .iter()
                .all(|x| x.abs() < 1e-15)
        );
    }
}
