//! Environment map of a scene, prepared for sampling.

use super::super::sampler::Purpose;
use super::sample_index::SampleIndex;
use crate::image::LinearImage;
use crate::scene::{Background, Effect, EffectSet, Scene, Texels};
use crate::shading::EnvironmentMap;

/// Number of the environment map in the purposes of light samples.
const ENVIRONMENT_LIGHT: u32 = u32::MAX;

/// Environment map, prepared for sampling.
pub(in crate::render) struct Environment {
    map: EnvironmentMap,
    /// Number of directions that each surface interaction samples.
    samples: u32,
}

impl Environment {
    /// Returns the light samples for surfaces that are `depth` bounces from the camera.
    pub(in crate::render) fn draws(&self, depth: u32) -> impl Iterator<Item = SampleIndex> + use<> {
        let of = self.samples;
        let purpose = Purpose::LIGHT.nested(ENVIRONMENT_LIGHT).nested(depth);
        (0..of).map(move |number| SampleIndex { purpose, number, of })
    }

    /// Returns the weight of the map's radiance along a ray whose direction was sampled from a lobe with this density per
    /// steradian, by the balance heuristic with the light samples, which have the density `pdf`; 1 for an infinite density.
    pub(in crate::render) fn share_of_lobe_ray(&self, pdf: f64, density: f32) -> f32 {
        if density == f32::INFINITY {
            return 1.0;
        }
        // Compare the densities of both ways to sample the direction
        let by_light = pdf * f64::from(self.samples);
        let density = f64::from(density);
        (density / (density + by_light)) as f32
    }

    /// Returns the map and its sampling tables.
    pub(in crate::render) fn map(&self) -> &EnvironmentMap {
        &self.map
    }

    /// Returns the environment map of the scene, if it has one and an active effect needs it.
    pub(in crate::render) fn of(scene: &Scene, effects: EffectSet) -> Option<Environment> {
        let Background::Environment {
            image,
            rotation,
            scale,
            samples,
        } = scene.background
        else {
            return None;
        };
        // Skip the map if no effect reads it
        if !(effects.has(Effect::Background) || effects.has(Effect::Environment)) {
            return None;
        }
        let image = &scene.images[image as usize];
        let Texels::Floats(texels) = &image.texels else {
            return None;
        };
        // Scale the radiance, limited to finite values
        let scaled = |texel: &[f32; 4]| [0, 1, 2].map(|channel| (texel[channel] * scale).min(f32::MAX));
        let image = LinearImage {
            width: image.width,
            height: image.height,
            pixels: texels.iter().map(scaled).collect(),
        };
        let map = EnvironmentMap::new(image, rotation).ok()?;
        Some(Environment { map, samples })
    }

    /// Returns the bytes of the map and its sampling tables.
    pub(in crate::render) fn byte_count(&self) -> usize {
        self.map.byte_count()
    }
}
