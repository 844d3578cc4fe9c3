//! Lobes that light samples share with lobe rays ([`super::CombinedSampling`]).

use glam::DVec3;

use super::super::context::RenderContext;
use super::super::surface::Surfaces;
use super::super::wavefront::{BEHIND_MIRROR, BatchInfo, ShadingState, TracedPacket};
use super::direct::ShadingContext;
use super::lobe_variants::{SharedLobes, without_sampled_lobes};
use crate::accel::NO_HIT;
use crate::numeric::{LANES, Lanes};
use crate::scene::LightKind;

impl ShadingState<'_, '_> {
    /// Returns the surfaces with the materials for light samples of a light that is combined, and the numbers of rays
    /// into their lobes.
    pub(super) fn with_shared_lobes<'a>(
        &self,
        traced: &TracedPacket,
        lit: &ShadingContext<'a>,
        stage: BatchInfo,
    ) -> (ShadingContext<'a>, &'a Lanes<f32>) {
        let shared = lit.variants.shared.get_or_init(|| {
            let counts = self
                .frame
                .lobe_ray_counts(lit.materials, traced.path_states, stage);
            let counts = counts.map(|count| count as f32);
            // Restore the lobes that light samples share
            let mut materials = without_sampled_lobes(lit.materials);
            for l in (0..LANES).filter(|&l| counts[l] > 0.0) {
                materials.roughness[l] = lit.materials.roughness[l];
            }
            SharedLobes { materials, counts }
        });
        let lit = ShadingContext {
            materials: &shared.materials,
            ..*lit
        };
        (lit, &shared.counts)
    }
}

impl RenderContext<'_> {
    /// Weights the emission of emissive objects that light samples represent too ([`CombinedSampling::share_of_ray`]).
    ///
    /// [`CombinedSampling::share_of_ray`]: super::CombinedSampling::share_of_ray
    #[inline(never)]
    pub(in crate::render) fn weight_emission(
        &self,
        traced: &TracedPacket,
        surfaces: &mut Surfaces,
        stage: BatchInfo,
    ) {
        let Some(states) = traced.path_states.filter(|_| surfaces.materials.may_emit()) else {
            return;
        };
        let is_hit = surfaces.points.hit;
        for l in (0..LANES).filter(|&l| is_hit[l]) {
            // Find the light on the surface; rays that no light sample shares have an infinite density
            let density = states.density(l);
            let instance = traced.packet.instance[l];
            let light = (density != f32::INFINITY && instance != NO_HIT)
                .then(|| self.combined.light_on(instance))
                .flatten();
            let Some(number) = light else {
                continue;
            };
            let (Some(Some(sampler)), LightKind::Area { samples, .. }) =
                (self.area_lights.get(number), self.scene.lights[number].kind)
            else {
                continue;
            };
            // Compare the densities of both ways to sample the direction, as seen from the origin of the ray
            let points = &surfaces.points;
            let hit = DVec3::from([0, 1, 2].map(|axis| points.p[axis][l]));
            let origin = traced.packet.ray(l).origin.as_dvec3();
            let pdf = sampler.pdf(origin, hit, points.geometric_normal(l));
            let by_light = pdf * f64::from(stage.light_samples(samples));
            // Photons represent the light only if it emits any
            let is_unseen = density == BEHIND_MIRROR && !self.emits_photons(number);
            let share = if is_unseen {
                1.0
            } else {
                self.combined.share_of_ray(density, by_light)
            };
            surfaces.scale_emission(l, share);
        }
    }
}
