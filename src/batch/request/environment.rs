//! Environment map that is requested in place of a scene's background.

use std::collections::HashSet;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use glam::DQuat;

use super::error::RequestError;
use crate::gltf::LoadOptions;
use crate::scene::{
    Background, BuiltInEnvironment, DEFAULT_LIGHT_SAMPLES, Effect, Encoding, Image, Light, LightKind, Scene,
};

/// Environment map in place of a scene's background, ambient light and default light.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentRequest {
    /// File or formula of the map.
    pub source: EnvironmentSource,
    /// Rotation about +y in radians, counter-clockwise as seen from above; for a map that is computed, from its place
    /// behind the camera.
    pub rotation: f64,
    /// Factor on the radiance of the map.
    pub scale: f32,
}

/// File or formula of an environment map.
#[derive(Clone, Debug, PartialEq)]
pub enum EnvironmentSource {
    /// Map that is computed.
    BuiltIn(BuiltInEnvironment),
    /// Radiance or EXR file.
    File(PathBuf),
}

impl FromStr for EnvironmentSource {
    type Err = String;

    fn from_str(text: &str) -> Result<EnvironmentSource, String> {
        if let Some(environment) = BuiltInEnvironment::from_name(text) {
            return Ok(EnvironmentSource::BuiltIn(environment));
        }
        let path = PathBuf::from(text);
        let is_of = |kind| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(kind));
        match is_of("hdr") || is_of("exr") {
            true => Ok(EnvironmentSource::File(path)),
            false => Err("give the name of an .hdr or .exr file, `studio` or `sky`".into()),
        }
    }
}

impl fmt::Display for EnvironmentSource {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            EnvironmentSource::BuiltIn(environment) => f.write_str(environment.name()),
            EnvironmentSource::File(path) => write!(f, "{}", path.display()),
        }
    }
}

impl EnvironmentRequest {
    /// Replaces the background and the ambient light of a scene by the environment map, and lets its rough surfaces
    /// reflect it.
    ///
    /// # Errors
    ///
    /// If the file cannot be read.
    pub(super) fn apply(&self, scene: &mut Scene, options: &LoadOptions) -> Result<(), RequestError> {
        let image = scene.images.len() as u32;
        scene.images.push(self.image(options)?);
        // Turn an environment of our own with the camera, and add the light that is not in its map
        let mut rotation = self.rotation;
        if let EnvironmentSource::BuiltIn(environment) = &self.source {
            rotation += scene
                .cameras
                .first()
                .map_or(0.0, |camera| environment.turn_for(camera));
            scene
                .lights
                .extend(environment.light().map(|light| self.turned(light, rotation)));
        }
        scene.ambient = [0.0; 3];
        scene.background = Background::Environment {
            image,
            rotation,
            scale: self.scale,
            samples: DEFAULT_LIGHT_SAMPLES,
        };
        scene.reflect_environment(&HashSet::new());
        Ok(())
    }

    /// Returns a light of the environment, turned by `rotation` about +y and scaled as the map is.
    fn turned(&self, light: Light, rotation: f64) -> Light {
        let kind = match light.kind {
            LightKind::Directional { to_light } => LightKind::Directional {
                to_light: DQuat::from_rotation_y(rotation) * to_light,
            },
            other => other,
        };
        Light {
            intensity: light.intensity.map(|channel| channel * self.scale),
            kind,
            ..light
        }
    }

    fn image(&self, options: &LoadOptions) -> Result<Image, RequestError> {
        let path = match &self.source {
            EnvironmentSource::BuiltIn(environment) => return Ok(environment.image()),
            EnvironmentSource::File(path) => path,
        };
        // Read only the size of a map that no effect uses
        let is_used = [Effect::Background, Effect::Environment]
            .into_iter()
            .any(|effect| !options.without.has(effect));
        let read = match is_used {
            true => options
                .image_cache
                .read(path, Encoding::Linear, options.max_texels),
            false => Image::unread(path),
        };
        read.map_err(RequestError::Environment)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;

    #[test]
    fn source_is_a_name_or_a_file_of_radiance() {
        let source = |text: &str| text.parse::<EnvironmentSource>();
        assert_eq!(
            source("studio"),
            Ok(EnvironmentSource::BuiltIn(BuiltInEnvironment::Studio))
        );
        assert_eq!(source("a/b.HDR"), Ok(EnvironmentSource::File("a/b.HDR".into())));
        for bad in ["", "night", "a.png", "hdr"] {
            assert!(source(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn environment_replaces_background_and_ambient_light() {
        let mut scene = Scene {
            ambient: [0.25; 3],
            materials: vec![Material::metallic_roughness([1.0; 3], 1.0, 0.5)],
            ..Scene::default()
        };
        let request = EnvironmentRequest {
            source: EnvironmentSource::BuiltIn(BuiltInEnvironment::Studio),
            rotation: 0.5,
            scale: 2.0,
        };
        request.apply(&mut scene, &LoadOptions::default()).unwrap();
        assert_eq!((scene.ambient, scene.images.len()), ([0.0; 3], 1));
        assert_eq!(
            scene.background,
            Background::Environment {
                image: 0,
                rotation: 0.5,
                scale: 2.0,
                samples: DEFAULT_LIGHT_SAMPLES
            }
        );
        assert_eq!(scene.materials[0].rough_rays(), 1);
    }

    #[test]
    fn sun_is_turned_and_scaled_with_the_sky() {
        let request = |turn: f64, scale: f32| EnvironmentRequest {
            source: EnvironmentSource::BuiltIn(BuiltInEnvironment::Sky),
            rotation: turn.to_radians(),
            scale,
        };
        let sun = |request: EnvironmentRequest| {
            let mut scene = Scene::default();
            request.apply(&mut scene, &LoadOptions::default()).unwrap();
            match scene.lights[0].kind {
                LightKind::Directional { to_light } => (to_light, scene.lights[0].intensity[0]),
                _ => unreachable!(),
            }
        };
        let ((plain, one), (turned, two)) = (sun(request(0.0, 1.0)), sun(request(90.0, 2.0)));
        // A quarter turn counter-clockwise takes +z to +x and +x to -z
        let expected = glam::DVec3::new(plain.z, plain.y, -plain.x);
        assert!((turned - expected).length() < 4.0 * f64::EPSILON);
        assert_eq!(two, 2.0 * one);
    }

    #[test]
    fn materials_keep_their_own_number_of_rough_rays() {
        let mut scene = Scene {
            materials: vec![Material::metallic_roughness([1.0; 3], 1.0, 0.5)],
            ..Scene::default()
        };
        scene.set_rough_rays(8);
        scene.reflect_environment(&HashSet::new());
        assert_eq!(scene.materials[0].rough_rays(), 8);
    }
}
