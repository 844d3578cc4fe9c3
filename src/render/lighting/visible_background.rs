//! Background that replaces the scene's own for camera rays that go straight into the distance.
//!
//! Such a ray has missed everything, or has passed only surfaces that let it through unchanged: gaps of alpha-tested and
//! alpha-blended surfaces, and volumes. Its weight is what the image shows of the background. Reflected and refracted
//! rays, light samples and ambient light keep the background of the scene.

use super::super::aov::LightSource;
use super::super::film::without_step;
use super::super::profile::Category;
use super::super::wavefront::{BatchInfo, ShadingState, TracedPacket};
use crate::accel::NO_HIT;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::image_settings::VisibleBackground;

impl ShadingState<'_, '_> {
    /// Adds the requested background at the end of straight camera rays, and returns the weights of the packet without
    /// theirs, so that the scene's background adds nothing to them; `None` if the packet has no such ray.
    ///
    /// A transparent background adds the weight to the film of transparency in place of radiance.
    #[inline(never)]
    pub(in crate::render) fn replace_background(
        &mut self,
        traced: &TracedPacket,
        stage: BatchInfo,
    ) -> Option<Lanes3<f32>> {
        // Most packets behind the first hits have no such ray
        let sees_background = self.straight_misses(traced, stage);
        if !sees_background.contains(&true) {
            return None;
        }
        // Divide the weights between straight camera rays that missed and all other lanes
        let mut weight = *traced.weight;
        let mut straight = [[0.0; LANES]; 3];
        for channel in 0..3 {
            for l in 0..LANES {
                let whole = weight[channel][l];
                straight[channel][l] = if sees_background[l] { whole } else { 0.0 };
                weight[channel][l] = if sees_background[l] { 0.0 } else { whole };
            }
        }
        // Add the background to the image, or the weights to the transparency
        match (self.frame.settings.background, &mut self.transparency) {
            (VisibleBackground::Color(color), _) => {
                for (channel, level) in straight.iter_mut().zip(color) {
                    channel.iter_mut().for_each(|weight| *weight *= level);
                }
                self.film.add(traced.pixel, &straight, LightSource::Emission);
            }
            (VisibleBackground::Transparent, Some(film)) => {
                film.add(&traced.pixel.map(without_step), &straight, LightSource::Emission);
            }
            _ => {}
        }
        self.meter.part(Category::Surroundings);
        Some(weight)
    }

    /// Returns which lanes are straight camera rays that missed the scene.
    fn straight_misses(&self, traced: &TracedPacket, stage: BatchInfo) -> Lanes<bool> {
        // Find all rays that missed
        let mut misses = [false; LANES];
        for l in 0..LANES {
            misses[l] = (traced.packet.active[l] != 0) & (traced.packet.instance[l] == NO_HIT);
        }
        if stage.depth == 0 {
            return misses;
        }
        // Paths count their reflections and refractions only in scenes where rays pass surfaces
        let passes = self.frame.effects().counts_bounces();
        let Some(path_states) = traced.path_states.filter(|_| passes) else {
            return [false; LANES];
        };
        for l in 0..LANES {
            misses[l] &= path_states.depth(l) == 0;
        }
        misses
    }
}
