//! Environment map of a scene, prepared for sampling.

use super::super::sampler::Purpose;
use super::super::wavefront::BatchInfo;
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
    /// Returns the light samples for the surfaces of a batch.
    pub(in crate::render) fn draws(&self, stage: BatchInfo) -> impl Iterator<Item = SampleIndex> + use<> {
        let of = self.samples(stage);
        let purpose = Purpose::LIGHT.nested(ENVIRONMENT_LIGHT).nested(stage.depth);
        (0..of).map(move |number| SampleIndex { purpose, number, of })
    }

    /// Returns the number of light samples of each surface of a batch.
    pub(super) fn samples(&self, stage: BatchInfo) -> u32 {
        stage.light_samples(self.samples)
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
