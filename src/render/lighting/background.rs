//! Background of the scene, and direct light from an environment map.
//!
//! Rays that miss the scene see the background. With an environment map, surfaces also send shadow rays in directions
//! that are importance-sampled by its radiance, with random numbers as for area lights ([`super::area_light`]). Surfaces
//! that see the map by mirror rays leave out the specular lobe in these shadow rays, because it would count twice. Where
//! rays into a lobe see the map, shadow rays and lobe rays share the lobe ([`super::combined_sampling`]).
//!
//! Rays from diffuse surfaces that miss the scene bring what surfaces would otherwise receive from all directions: ambient
//! light if there is any, else the background, less what light samples of the map represent.

use super::super::context::RenderContext;
use super::super::wavefront::{BEHIND_MIRROR, BatchInfo, ShadingState, TracedPacket};
use super::direct::{IncidentLight, ShadingContext};
use super::sample_index::SampleIndex;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Background, Effect};
use crate::shading::EnvironmentMap;

impl RenderContext<'_> {
    /// Returns whether rays that miss the scene find any light.
    #[inline(always)]
    pub(in crate::render) fn has_background(&self) -> bool {
        let is_black = self.background == Background::default();
        !is_black || self.ambient != [0.0; 3]
    }

    /// Returns the background radiance in the directions of the rays of a packet.
    pub(in crate::render) fn background_along(&self, traced: &TracedPacket, stage: BatchInfo) -> Lanes3<f32> {
        let mut seen = self.scene_background_along(traced, stage);
        // Replace it by ambient light behind diffuse surfaces
        if stage.is_behind_bounce
            && self.ambient != [0.0; 3]
            && let Some(states) = traced.path_states
        {
            // Only rays whose last scattering was diffuse have the density 0
            for l in (0..LANES).filter(|&l| states.density(l) == 0.0) {
                (0..3).for_each(|c| seen[c][l] = self.ambient[c]);
            }
        }
        seen
    }

    /// Returns the radiance of the scene's background in the directions of the rays of a packet.
    fn scene_background_along(&self, traced: &TracedPacket, stage: BatchInfo) -> Lanes3<f32> {
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
                let mut directions = traced.packet.direction;
                for (axis, lanes) in directions.iter_mut().enumerate() {
                    let upward = if axis == 1 { 1.0 } else { 0.0 };
                    for l in 0..LANES {
                        let is_used = traced.packet.active[l] != 0;
                        lanes[l] = if is_used { lanes[l] } else { upward };
                    }
                }
                // Look all directions up at once, without densities if no light sample represents the map too
                let Some(states) = traced.path_states.filter(|_| self.combined.has_environment()) else {
                    return environment.map().look_up_radiance(&directions);
                };
                // Otherwise with densities
                let found = environment.map().look_up(&directions);
                seen = found.radiance;
                // Weight the rays by their share beside light samples
                let samples = f64::from(environment.samples(stage));
                for l in 0..LANES {
                    let density = states.density(l);
                    let share = match density == BEHIND_MIRROR {
                        true => 1.0,
                        false => self.combined.share_of_ray(density, found.pdf[l] * samples),
                    };
                    (0..3).for_each(|c| seen[c][l] *= share);
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
        // Share lobes with lobe rays, or leave out lobes that secondary rays sample already
        let (lit, counts) = if frame.combined.shares_environment() {
            let (lit, counts) = self.with_shared_lobes(traced, lit, stage);
            (lit, Some(counts))
        } else {
            (lit.without_sampled_lobes(), None)
        };
        for draw in environment.draws(stage) {
            let (mut arrivals, densities) =
                self.sample_environment_light(environment.map(), (traced, &lit), draw);
            arrivals.lobe_ratios = counts.map(|counts| std::array::from_fn(|l| counts[l] / densities[l]));
            let casts = frame.effects().has(Effect::Shadow);
            self.queue_shadow_rays(&arrivals, (traced, &lit), casts, stage);
        }
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
        let samples = map.sample_packet(&self.number_packet(traced, draw));
        for l in (0..LANES).filter(|&l| lit.points.hit[l] && samples.pdf[l] > 0.0) {
            // Divide by the density and the number of samples
            let density = samples.pdf[l] * f64::from(draw.of);
            let share = density.recip() as f32;
            densities[l] = density as f32;
            for axis in 0..3 {
                arrivals.wi[axis][l] = samples.direction[axis][l] as f32;
                arrivals.irradiance[axis][l] = samples.radiance[axis][l] * share;
            }
        }
        (arrivals, densities)
    }
}
