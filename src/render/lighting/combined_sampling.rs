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
//!
//! Rays from diffuse surfaces ([`super::super::scattering`]) hit the same lights, but light samples represent these alone
//! there: such a ray has the density 0.

use super::super::plan::Plan;
use super::area_light_sampler::AreaLightSampler;
use crate::scene::{Background, Effect, Instance, Scene};

/// Lights that surfaces sample and rays hit, and how both divide them.
pub(in crate::render) struct CombinedSampling {
    /// True if light samples and rays into rough lobes share these lights; otherwise lobe rays alone represent them.
    lobes: bool,
    /// True if the environment map is such a light.
    environment: bool,
    /// Emissive objects that are such lights: instances in ascending order, each with the number of its light.
    emissive_objects: Vec<(u32, u32)>,
    /// True if the light that light samples bring to lobes is kept apart, because some surface refracts.
    pub(in crate::render) splits_shadows: bool,
}

impl CombinedSampling {
    /// Returns the lights of `scene` that are sampled and hit; `area_lights` are prepared for sampling.
    pub(in crate::render) fn of(
        scene: &Scene,
        plan: &Plan,
        area_lights: &[Option<AreaLightSampler>],
    ) -> CombinedSampling {
        // Without the shadows that a scene needs, light samples have other paths than lobe rays
        let effects = plan.effects();
        let lobes = effects.has(Effect::RoughReflection) && !plan.is_switched_off(Effect::Shadow);
        let is_needed = lobes || effects.has(Effect::Interreflection);
        let is_sampled = matches!(scene.background, Background::Environment { samples: 1.., .. });
        let is_mapped = effects.has(Effect::Environment) && effects.has(Effect::Background);
        // Collect the emissive objects, which rays see if surfaces emit
        let sees_emission = is_needed && effects.has(Effect::Emission);
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
        let environment = is_needed && is_sampled && is_mapped;
        let is_any = environment || !emissive_objects.is_empty();
        CombinedSampling {
            lobes,
            environment,
            emissive_objects,
            splits_shadows: lobes && is_any && refracts && effects.has(Effect::TransparentShadow),
        }
    }

    /// Returns whether lobes share any light with light samples.
    pub(in crate::render) fn is_any(&self) -> bool {
        self.lobes && (self.environment || self.has_emissive_objects())
    }

    /// Returns whether surfaces sample the environment map and some rays that hit it count less.
    pub(in crate::render) fn has_environment(&self) -> bool {
        self.environment
    }

    /// Returns whether lobes share the environment map with light samples.
    pub(super) fn shares_environment(&self) -> bool {
        self.lobes && self.environment
    }

    /// Returns whether surfaces sample emissive objects and some rays that hit these count less.
    pub(in crate::render) fn has_emissive_objects(&self) -> bool {
        !self.emissive_objects.is_empty()
    }

    /// Returns whether lobes share emissive objects with light samples.
    pub(super) fn shares_emissive_objects(&self) -> bool {
        self.lobes && self.has_emissive_objects()
    }

    /// Returns the weight of the light at the end of a ray of this `density` ([`PathState::density`]), which light
    /// samples find with the density `by_light`, their number included: by the balance heuristic for rays into lobes
    /// that share the light, 0 behind a diffuse surface, and 1 for all others.
    ///
    /// [`PathState::density`]: super::super::wavefront::PathState
    #[inline(always)]
    pub(super) fn share_of_ray(&self, density: f32, by_light: f64) -> f32 {
        let (density, is_shared) = (f64::from(density), self.lobes && density != f32::INFINITY);
        if density <= 0.0 {
            0.0
        } else if is_shared {
            (density / (density + by_light)) as f32
        } else {
            1.0
        }
    }

    /// Returns the number of the light that lies on `instance`, if it is combined.
    pub(super) fn light_on(&self, instance: u32) -> Option<usize> {
        let found = self
            .emissive_objects
            .binary_search_by_key(&instance, |entry| entry.0);
        found.ok().map(|index| self.emissive_objects[index].1 as usize)
    }
}
