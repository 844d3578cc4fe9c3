//! Subsurface radiance of hits, from the radiant exitance of their objects.

use super::super::aov::LightSource;
use super::super::profile::Category;
use super::super::surface::Surfaces;
use super::super::wavefront::{ShadingState, TracedPacket};
use crate::numeric::{LANES, Lanes};
use crate::optics::dielectric;

impl ShadingState<'_, '_> {
    /// Adds the subsurface radiance of the hits of a packet to the film.
    pub(in crate::render) fn add_scattered(&mut self, traced: &TracedPacket, surfaces: &Surfaces) {
        let Some(bodies) = &self.frame.bodies else { return };
        let (points, materials) = (&surfaces.points, &surfaces.materials);
        let mut radiance = [[0.0; LANES]; 3];
        // Take the hits on one body after the other
        let body_of = |l: usize| {
            let seen = points.hit[l] && traced.weight.iter().any(|channel| channel[l] != 0.0);
            let body = bodies.bodies.get(traced.packet.instance[l] as usize)?;
            body.as_ref().filter(|_| seen)
        };
        let mut left: Lanes<bool> = std::array::from_fn(|l| body_of(l).is_some());
        let any = left.contains(&true);
        while let Some(first) = left.iter().position(|&is_left| is_left) {
            let Some(body) = body_of(first) else { break };
            let instance = traced.packet.instance[first];
            let mask: Lanes<bool> = std::array::from_fn(|l| left[l] && traced.packet.instance[l] == instance);
            // Gather the light that leaves the body at all of its hits
            let exitance = body.tree.radiant_exitances(&points.p, &mask);
            for l in (0..LANES).filter(|&l| mask[l]) {
                left[l] = false;
                // Weigh the exitance by Fresnel's transmittance towards the viewer
                let cosine: f32 = (0..3).map(|axis| points.ns[axis][l] * points.wo[axis][l]).sum();
                let cosine = f64::from(cosine.clamp(0.0, 1.0));
                let transmittance = dielectric(cosine, 1.0, body.eta).transmittance.mean();
                let share = (transmittance * body.scale) as f32 * (1.0 - materials.metallic[l]);
                for c in 0..3 {
                    let color = materials.base_color[c][l];
                    radiance[c][l] = traced.weight[c][l] * color * share * exitance[c][l];
                }
            }
        }
        if any {
            self.film.add(traced.pixel, &radiance, LightSource::Subsurface);
        }
        self.meter.part(Category::Subsurface);
    }
}
