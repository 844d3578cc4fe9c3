//! Light that reaches rough lobes both by light samples and by rays into the lobes.
//!
//! Light samples find small bright lights, lobe rays find lights in narrow lobes. Light of the environment map and of
//! emissive objects that are area lights reaches the lobes of opaque surfaces by both, each weighted by the balance
//! heuristic (E. Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, section 9.2): in proportion
//! to the density with which it samples the direction. Both densities are known where a sample is taken: a light
//! sample evaluates the lobe there, and a lobe ray carries its density to what it hits.
//!
//! Both ways must have the same paths. Lobe rays that are refracted or reflected on their way have the light behind
//! alone, because light samples pass straight through what refracts. The light that light samples bring to lobes is
//! therefore kept apart from that to the rest of the surface, and ends at the first surface that refracts.

use super::super::plan::Plan;
use super::area_light_sampler::AreaLightSampler;
use crate::scene::{Background, Effect, Instance, Scene};

/// Lights that reach rough lobes both by light samples and by lobe rays.
pub(in crate::render) struct CombinedSampling {
    /// True if the environment map is such a light.
    pub(in crate::render) environment: bool,
    /// Emissive objects that are such lights: instances in ascending order, each with the number of its light.
    emissive_objects: Vec<(u32, u32)>,
    /// True if the light that light samples bring to lobes is kept apart, because some surface refracts.
    pub(in crate::render) splits_shadows: bool,
}

impl CombinedSampling {
    /// Returns the lights of `scene` that are combined; `area_lights` are prepared for sampling.
    pub(in crate::render) fn of(
        scene: &Scene,
        plan: &Plan,
        area_lights: &[Option<AreaLightSampler>],
    ) -> CombinedSampling {
        // Without the shadows that a scene needs, light samples have other paths than lobe rays
        let effects = plan.effects();
        let has_lobes = effects.has(Effect::RoughReflection) && !plan.is_switched_off(Effect::Shadow);
        let is_sampled = matches!(scene.background, Background::Environment { samples: 1.., .. });
        let is_mapped = effects.has(Effect::Environment) && effects.has(Effect::Background);
        // Collect the emissive objects, which lobe rays see if surfaces emit
        let sees_emission = has_lobes && effects.has(Effect::Emission);
        let mut emissive_objects = Vec::new();
        for (number, light) in area_lights.iter().enumerate().filter(|_| sees_emission) {
            let instance = scene.lights[number].emissive_instance();
            if let (Some(_), Some(instance)) = (light, instance) {
                emissive_objects.push((instance, number as u32));
            }
        }
        emissive_objects.sort_unstable();
        let transmits = |instance: &Instance| {
            let material = &scene.materials[instance.material as usize];
            material.transmits()
        };
        let refracts = effects.has(Effect::Refraction) && scene.instances.iter().any(transmits);
        let environment = has_lobes && is_sampled && is_mapped;
        let is_any = environment || !emissive_objects.is_empty();
        CombinedSampling {
            environment,
            emissive_objects,
            splits_shadows: is_any && refracts && effects.has(Effect::TransparentShadow),
        }
    }

    /// Returns whether any light is combined.
    pub(in crate::render) fn is_any(&self) -> bool {
        self.environment || self.has_emissive_objects()
    }

    /// Returns whether any emissive object is combined.
    pub(in crate::render) fn has_emissive_objects(&self) -> bool {
        !self.emissive_objects.is_empty()
    }

    /// Returns the number of the light that lies on `instance`, if it is combined.
    pub(super) fn light_on(&self, instance: u32) -> Option<usize> {
        let found = self
            .emissive_objects
            .binary_search_by_key(&instance, |entry| entry.0);
        found.ok().map(|index| self.emissive_objects[index].1 as usize)
    }
}
