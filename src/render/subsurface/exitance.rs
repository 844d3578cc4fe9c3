//! Subsurface radiance of hits, from the radiant exitance of their objects.

use super::super::aov::LightSource;
use super::super::profile::Category;
use super::super::surface::Surfaces;
use super::super::wavefront::{ShadingState, TracedPacket};
use crate::numeric::LANES;
use crate::optics::dielectric;

impl ShadingState<'_, '_> {
    /// Adds the subsurface radiance of the hits of a packet to the film.
    pub(in crate::render) fn add_scattered(&mut self, traced: &TracedPacket, surfaces: &Surfaces) {
        let Some(bodies) = &self.frame.bodies else { return };
        let (points, materials) = (&surfaces.points, &surfaces.materials);
        let mut radiance = [[0.0; LANES]; 3];
        let mut any = false;
        for l in 0..LANES {
            let seen = points.hit[l] && traced.weight.iter().any(|channel| channel[l] != 0.0);
            let instance = traced.packet.instance[l] as usize;
            let body = bodies.bodies.get(instance).filter(|_| seen);
            let Some(Some(body)) = body else { continue };
            // Weigh the exitance by Fresnel's transmittance towards the viewer
            let cosine: f32 = (0..3).map(|axis| points.ns[axis][l] * points.wo[axis][l]).sum();
            let cosine = f64::from(cosine.clamp(0.0, 1.0));
            let transmittance = dielectric(cosine, 1.0, body.eta).transmittance.mean();
            let share = (transmittance * body.scale) as f32 * (1.0 - materials.metallic[l]);
            let exitance = body.tree.radiant_exitance(points.point(l));
            for c in 0..3 {
                radiance[c][l] = traced.weight[c][l] * materials.base_color[c][l] * share * exitance[c];
            }
            any = true;
        }
        if any {
            self.film.add(traced.pixel, &radiance, LightSource::Subsurface);
        }
        self.meter.part(Category::Subsurface);
    }
}
