//! Changes of a loaded scene that trade accuracy for time.

use crate::scene::{LightKind, Scene};

/// Changes of the numbers of samples and steps of a whole scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneChange {
    /// Samples per area light; `None` keeps the lights' own numbers.
    pub light_samples: Option<u32>,
    /// Rays per rough lobe; `None` keeps the materials' own numbers.
    pub rough_rays: Option<u32>,
    /// Largest number of bounces of interreflection; `None` keeps the scene's own.
    pub bounces: Option<u32>,
    /// Photons of caustics; `None` keeps the scene's own number.
    pub photons: Option<u32>,
    /// Factor by which march steps through volumes are longer than the volumes' own.
    pub step_factor: f64,
}

impl Default for SceneChange {
    fn default() -> SceneChange {
        SceneChange {
            light_samples: None,
            rough_rays: None,
            bounces: None,
            photons: None,
            step_factor: 1.0,
        }
    }
}

impl SceneChange {
    /// Applies the changes to `scene` in place.
    pub fn apply(&self, scene: &mut Scene) {
        if let Some(count) = self.light_samples {
            for light in &mut scene.lights {
                if let LightKind::Area { samples, .. } = &mut light.kind {
                    *samples = count;
                }
            }
        }
        if let Some(rays) = self.rough_rays {
            scene.set_rough_rays(rays);
        }
        if let (Some(bounces), Some(interreflection)) = (self.bounces, &mut scene.interreflection) {
            interreflection.bounces = bounces;
        }
        if let (Some(photons), Some(caustics)) = (self.photons, &mut scene.caustics) {
            caustics.photons = photons;
        }
        if self.step_factor != 1.0 {
            scene.scale_march_steps(self.step_factor);
        }
    }
}
