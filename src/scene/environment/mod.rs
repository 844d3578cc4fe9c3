//! Environment maps that are computed rather than read: a studio and a clear sky.
//!
//! Both are turned with the camera, as the default light is. Their radiance is in the unit of the default light: a white
//! Lambertian surface that faces the light has radiance of about 1, so that images need no exposure.

mod sky;
mod studio;

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::{Camera, Image, Light, Texels};

/// Number of texels across; a texel is 0.7 degrees wide, several times narrower than the edges of everything in the maps.
const WIDTH: u32 = 512;
/// Number of texels down.
const HEIGHT: u32 = WIDTH / 2;

/// Environment map that is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BuiltInEnvironment {
    /// Room of graded grey with soft boxes.
    Studio,
    /// Clear sky above a grey ground, with the sun as a light of its own.
    Sky,
}

impl BuiltInEnvironment {
    /// Returns the environment of this name, if there is one.
    pub fn from_name(name: &str) -> Option<BuiltInEnvironment> {
        [BuiltInEnvironment::Studio, BuiltInEnvironment::Sky]
            .into_iter()
            .find(|environment| environment.name() == name)
    }

    /// Returns the name of the environment.
    pub fn name(self) -> &'static str {
        match self {
            BuiltInEnvironment::Studio => "studio",
            BuiltInEnvironment::Sky => "sky",
        }
    }

    /// Returns the light that belongs to the environment and is not in its map.
    pub fn light(self) -> Option<Light> {
        match self {
            BuiltInEnvironment::Studio => None,
            BuiltInEnvironment::Sky => Some(sky::sun()),
        }
    }

    /// Returns the angle about +y in radians by which the environment is turned for a camera, whose left shoulder the
    /// main light then is behind. No turn for a camera that looks straight up or down.
    pub fn turn_for(self, camera: &Camera) -> f64 {
        let back = camera.world_from_camera.matrix3.z_axis;
        match back.x == 0.0 && back.z == 0.0 {
            true => 0.0,
            false => back.x.atan2(back.z),
        }
    }

    /// Returns the equirectangular map, laid out as [`super::Background::Environment`] requires.
    pub fn image(self) -> Image {
        let texels = match self {
            BuiltInEnvironment::Studio => texels(studio::radiance),
            BuiltInEnvironment::Sky => {
                let sky = sky::ClearSky::new();
                texels(|direction| sky.radiance(direction))
            }
        };
        Image {
            name: self.name().into(),
            width: WIDTH,
            height: HEIGHT,
            texels: Texels::Floats(texels.into()),
        }
    }
}

/// Returns the linear RGBA texels of the radiance in the directions of their centres.
fn texels(radiance: impl Fn(DVec3) -> [f64; 3]) -> Vec<[f32; 4]> {
    (0..WIDTH * HEIGHT)
        .map(|index| {
            let [r, g, b] = radiance(direction(index % WIDTH, index / WIDTH)).map(|channel| channel as f32);
            [r, g, b, 1.0]
        })
        .collect()
}

/// Returns the unit vector through the centre of a texel: the top row is at +y, the middle of the map at -z, and +x to
/// the right of that.
fn direction(column: u32, row: u32) -> DVec3 {
    let (sin, cos) = (PI * (f64::from(row) + 0.5) / f64::from(HEIGHT)).sin_cos();
    let (sin_turn, cos_turn) = (TAU * ((f64::from(column) + 0.5) / f64::from(WIDTH) - 0.5)).sin_cos();
    DVec3::new(sin * sin_turn, cos, -sin * cos_turn)
}

/// Returns the integral over all texels of `value` times solid angle.
fn integral(value: impl Fn(DVec3) -> f64) -> f64 {
    let side = PI / f64::from(HEIGHT);
    (0..WIDTH * HEIGHT)
        .map(|index| {
            let direction = direction(index % WIDTH, index / WIDTH);
            value(direction) * side * side * direction.x.hypot(direction.z)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;
    use crate::scene::{LightKind, axes_looking_along};

    /// Returns the radiance of a white Lambertian surface with normal `n` in each channel.
    fn white(environment: BuiltInEnvironment, n: DVec3) -> [f64; 3] {
        let Texels::Floats(texels) = environment.image().texels else {
            unreachable!()
        };
        let side = PI / f64::from(HEIGHT);
        let mut sum = [0.0; 3];
        for (index, texel) in texels.iter().enumerate() {
            let direction = direction(index as u32 % WIDTH, index as u32 / WIDTH);
            let weight = side * side * direction.x.hypot(direction.z) * direction.dot(n).max(0.0) / PI;
            (0..3).for_each(|channel| sum[channel] += weight * f64::from(texel[channel]));
        }
        if let Some(Light {
            intensity,
            kind: LightKind::Directional { to_light },
            ..
        }) = environment.light()
        {
            (0..3).for_each(|channel| {
                sum[channel] += f64::from(intensity[channel]) * to_light.dot(n).max(0.0) / PI
            });
        }
        sum
    }

    #[test]
    fn environment_turns_with_the_camera() {
        let camera = |back: DVec3| Camera {
            world_from_camera: DAffine3::from_mat3(
                axes_looking_along(-back, DVec3::new(0.1, 1.0, 0.2)).unwrap(),
            ),
            ..Camera::default()
        };
        let turn = |back| BuiltInEnvironment::Studio.turn_for(&camera(back));
        // A camera at +z needs no turn, one at +x a quarter turn
        assert_eq!((turn(DVec3::Z), turn(DVec3::Y)), (0.0, 0.0));
        assert!((turn(DVec3::new(2.0, 5.0, 0.0)) - 0.5 * PI).abs() < 4.0 * f64::EPSILON);
    }

    #[test]
    fn integral_of_one_is_the_whole_sphere() {
        // The midpoint rule over n rows is off by a part of (π / n)² / 24.
        assert!((integral(|_| 1.0) / (4.0 * PI) - 1.0).abs() < (PI / 256.0).powi(2) / 23.0);
    }

    #[test]
    fn white_surfaces_are_bright_and_hardly_clipped() {
        for environment in [BuiltInEnvironment::Studio, BuiltInEnvironment::Sky] {
            let sides = [DVec3::Z, DVec3::Y, DVec3::X, DVec3::NEG_X, DVec3::NEG_Z];
            for n in sides.into_iter().chain([DVec3::new(-0.5, 1.0, 1.0).normalize()]) {
                let [r, g, b] = white(environment, n);
                assert!((0.1..1.15).contains(&g), "{environment:?} {n}: {g}");
                assert!(
                    (r / g - 1.0).abs() < 0.35 && (b / g - 1.0).abs() < 0.7,
                    "{environment:?} {n}: {r} {g} {b}"
                );
            }
        }
    }

    #[test]
    fn environments_are_found_by_their_names() {
        assert_eq!(
            BuiltInEnvironment::from_name("sky"),
            Some(BuiltInEnvironment::Sky)
        );
        assert_eq!(BuiltInEnvironment::from_name("sky.hdr"), None);
    }
}
