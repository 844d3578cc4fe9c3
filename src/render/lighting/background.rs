//! Background of the scene, and direct light from an environment map.
//!
//! Rays that miss the scene see the background. With an environment map, surfaces also send shadow rays in directions
//! that are importance-sampled by its radiance, with random numbers as for area lights ([`super::area_light`]). Surfaces
//! that see the map by mirror rays leave out the specular lobe in these shadow rays, because it would count twice. Where
//! rays into a lobe see the map, shadow rays and lobe rays share the lobe by the balance heuristic
//! ([`RenderContext::combines_samples`]), or lobe rays have it alone.

use super::super::context::RenderContext;
use super::super::wavefront::{BatchInfo, ShadingState, TracedPacket};
use super::area_light::without_sampled_lobes;
use super::direct::{IncidentLight, ShadingContext};
use super::sample_index::SampleIndex;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Background, Effect};
use crate::shading::{EnvironmentMap, MaterialPacket};

impl RenderContext<'_> {
    /// Returns the background radiance in the directions of the rays of a packet.
    pub(in crate::render) fn background_along(&self, traced: &TracedPacket) -> Lanes3<f32> {
        let mut seen = [[0.0; LANES]; 3];
        let direction = |l| traced.packet.ray(l).direction.as_dvec3().normalize();
        match self.background {
            Background::Uniform(color) => return color.map(|channel| [channel; LANES]),
            // Interpolate a gradient by the height of the direction
            Background::Gradient { horizon, up, down } => {
                for l in 0..LANES {
                    let direction = direction(l);
                    let pole = if direction.y < 0.0 { down } else { up };
                    let height = direction.y.abs();
                    for c in 0..3 {
                        let (level, pole) = (f64::from(horizon[c]), f64::from(pole[c]));
                        seen[c][l] = (level + (pole - level) * height) as f32;
                    }
                }
            }
            Background::Environment { .. } => {
                let Some(environment) = &self.environment else {
                    return seen;
                };
                // Unused lanes of a packet may have no valid direction.
                let mut directions = [[0.0; LANES], [1.0; LANES], [0.0; LANES]];
                for l in (0..LANES).filter(|&l| traced.packet.active[l] != 0) {
                    let direction = direction(l);
                    (0..3).for_each(|axis| directions[axis][l] = direction[axis]);
                }
                // Look all directions up at once
                let found = environment.map().look_up(&directions);
                seen = found.radiance;
                // Weight rays into lobes that light samples share
                if let Some(states) = traced.path_states.filter(|_| self.combines_samples) {
                    for l in 0..LANES {
                        let share = environment.share_of_lobe_ray(found.pdf[l], states.density(l));
                        (0..3).for_each(|c| seen[c][l] *= share);
                    }
                }
            }
        }
        seen
    }
}

impl ShadingState<'_, '_> {
    /// Queues shadow rays to importance-sampled directions of the environment map.
    pub(in crate::render) fn sample_environment(
        &mut self,
        traced: &TracedPacket,
        lit: &ShadingContext,
        stage: BatchInfo,
    ) {
        let frame = self.frame;
        let Some(environment) = &frame.environment else {
            return;
        };
        // Leave out the lobes that secondary rays have alone
        let counts = frame
            .combines_samples
            .then(|| self.lobe_ray_counts(traced, lit, stage));
        let materials = counts
            .as_ref()
            .map(|counts| without_single_lobes(lit.materials, counts));
        let lit = match &materials {
            Some(materials) => ShadingContext { materials, ..*lit },
            None => lit.without_sampled_lobes(),
        };
        for draw in environment.draws(stage.depth) {
            let (mut arrivals, densities) =
                self.sample_environment_light(environment.map(), (traced, &lit), draw);
            arrivals.lobe_ratios = counts.map(|counts| std::array::from_fn(|l| counts[l] / densities[l]));
            let casts = frame.effects().has(Effect::Shadow);
            self.queue_shadow_rays(&arrivals, (traced, &lit), casts, stage);
        }
    }

    /// Returns the numbers of rays into the lobes of the surfaces; 0 where a surface sends none.
    fn lobe_ray_counts(&self, traced: &TracedPacket, lit: &ShadingContext, stage: BatchInfo) -> Lanes<f32> {
        let frame = self.frame;
        std::array::from_fn(|l| {
            // Lanes without a lobe send no rays into it
            if !lit.materials.has_lobe(l) {
                return 0.0;
            }
            let path_depth = traced.path_states.map_or(0, |states| states.depth(l));
            frame.rough_rays(lit.materials, frame.depth_of(path_depth, stage), l) as f32
        })
    }

    /// Returns the incident light from one sampled direction at each surface, and the densities of the directions per
    /// steradian times the number of samples.
    fn sample_environment_light(
        &self,
        map: &EnvironmentMap,
        (traced, lit): (&TracedPacket, &ShadingContext),
        draw: SampleIndex,
    ) -> (IncidentLight, Lanes<f32>) {
        let mut arrivals = IncidentLight::NONE;
        let mut densities = [1.0; LANES];
        for l in (0..LANES).filter(|&l| lit.points.hit[l]) {
            let Some(sample) = map.sample(self.numbers(traced, l, draw)) else {
                continue;
            };
            // Divide by the density and the number of samples
            let density = sample.pdf * f64::from(draw.of);
            let share = density.recip() as f32;
            densities[l] = density as f32;
            for axis in 0..3 {
                arrivals.wi[axis][l] = sample.direction[axis] as f32;
                arrivals.irradiance[axis][l] = sample.radiance[axis] * share;
            }
        }
        (arrivals, densities)
    }
}

/// Returns the materials without the lobes that secondary rays have alone: without a lobe where a mirror ray samples it,
/// and without the highlight where the Phong model has a reflected ray. `counts` are the numbers of rays into lobes.
fn without_single_lobes(materials: &MaterialPacket, counts: &Lanes<f32>) -> MaterialPacket {
    // Restore the lobes that light samples share
    let mut without = without_sampled_lobes(materials);
    for l in (0..LANES).filter(|&l| counts[l] > 0.0) {
        without.roughness[l] = materials.roughness[l];
    }
    without
}
