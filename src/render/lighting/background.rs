//! Background of the scene, and direct light from an environment map.
//!
//! Rays that miss the scene see the background. With an environment map, surfaces also send shadow rays in directions
//! that are importance-sampled by its radiance, with random numbers as for area lights ([`super::area_light`]). Surfaces
//! that see the map by mirror rays or lobe rays leave out the specular lobe in these shadow rays, because it would
//! count twice.

use super::super::context::RenderContext;
use super::super::wavefront::{BatchInfo, ShadingState, TracedPacket};
use super::direct::{IncidentLight, ShadingContext};
use super::sample_index::SampleIndex;
use crate::numeric::{LANES, Lanes3};
use crate::scene::{Background, Effect};
use crate::shading::EnvironmentMap;

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
                for l in (0..LANES).filter(|&l| traced.packet.active[l] != 0) {
                    let radiance = environment.map().radiance(direction(l));
                    (0..3).for_each(|c| seen[c][l] = radiance[c]);
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
        let lit = lit.without_sampled_lobes();
        for draw in environment.draws(stage.depth) {
            let arrivals = self.sample_environment_light(environment.map(), (traced, &lit), draw);
            let casts = frame.effects().has(Effect::Shadow);
            self.queue_shadow_rays(&arrivals, (traced, &lit), casts, stage);
        }
    }

    /// Returns the incident light from one sampled direction at each surface.
    fn sample_environment_light(
        &self,
        map: &EnvironmentMap,
        (traced, lit): (&TracedPacket, &ShadingContext),
        draw: SampleIndex,
    ) -> IncidentLight {
        let mut arrivals = IncidentLight::NONE;
        for l in (0..LANES).filter(|&l| lit.points.hit[l]) {
            let Some(sample) = map.sample(self.numbers(traced, l, draw)) else {
                continue;
            };
            // Divide by the density and the number of samples
            let share = (sample.pdf * f64::from(draw.of)).recip() as f32;
            for axis in 0..3 {
                arrivals.wi[axis][l] = sample.direction[axis] as f32;
                arrivals.irradiance[axis][l] = sample.radiance[axis] * share;
            }
        }
        arrivals
    }
}
