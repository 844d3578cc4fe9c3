//! Light of photons at diffuse surfaces.

use glam::Vec3;

use super::super::aov::LightSource;
use super::super::lighting::direct::{self, IncidentLight, ShadingContext};
use super::super::surface::lane;
use super::super::wavefront::{ShadingState, TracedPacket};
use crate::accel::RayPacket;
use crate::numeric::LANES;
use crate::optics::LINE_D;
use crate::scene::Effect;

/// Smallest cosine between a photon and the geometric normal that its power is divided by: at more grazing angles,
/// interpolated normals would raise it without bound.
const MIN_COSINE: f32 = 1.0 / 64.0;

impl ShadingState<'_, '_> {
    /// Adds the light that photons bring to the surfaces of a packet.
    #[inline(never)]
    pub(in crate::render) fn gather_caustics(&mut self, traced: &TracedPacket, lit: &ShadingContext) {
        let frame = self.frame;
        let Some(map) = &frame.photons else {
            return;
        };
        // Find the photons that cover each surface
        let mut found = std::mem::take(&mut self.found_photons);
        let mut most = 0;
        for (l, found) in found.iter_mut().enumerate() {
            found.clear();
            let is_seen = lit.points.hit[l] && traced.weight.iter().any(|channel| channel[l] != 0.0);
            if is_seen && lit.materials.scatters_light_samples(l) {
                map.covering(lit.points.point(l), lane(&lit.points.ng, l), found);
            }
            most = most.max(found.len());
        }
        // Inside of a medium, radiance is divided by the square of its index of refraction
        let mut scale = [1.0f32; LANES];
        if frame.effects().has(Effect::Refraction)
            && let Some(states) = traced.path_states
        {
            for l in (0..LANES).filter(|&l| !found[l].is_empty()) {
                let ior = frame.ior(states.media(l).current(), LINE_D);
                scale[l] = (1.0 / (ior * ior)) as f32;
            }
        }
        // Reflect one photon of each surface at a time, by the material without lobes that rays sample
        let lit = lit.without_sampled_lobes();
        let mut scratch = RayPacket::EMPTY;
        let mut total = [[0.0; LANES]; 3];
        let has_layers = frame.settings.wanted_light().lights;
        for turn in 0..most {
            let mut arrivals = IncidentLight::NONE;
            let mut lights = [0; LANES];
            for l in (0..LANES).filter(|&l| turn < found[l].len()) {
                let (index, density) = found[l][turn];
                let photon = map.photon(index);
                let cosine = Vec3::from(photon.direction).dot(lane(&lit.points.ng, l));
                let share = density * scale[l] / cosine.max(MIN_COSINE);
                lights[l] = photon.light;
                for axis in 0..3 {
                    arrivals.wi[axis][l] = photon.direction[axis];
                    arrivals.irradiance[axis][l] = photon.power[axis] * share;
                }
            }
            let mut radiance = [[0.0; LANES]; 3];
            if !direct::sample_direct_area(&arrivals, &lit, &mut scratch, &mut radiance) {
                continue;
            }
            // Sum up the photons of all lights, and keep them apart in layers of light
            if has_layers {
                self.film.add_to_lights(traced.pixel, &radiance, &lights);
            }
            for (sums, channel) in total.iter_mut().zip(&radiance) {
                (0..LANES).for_each(|l| sums[l] += channel[l]);
            }
        }
        if most > 0 {
            self.film.add(traced.pixel, &total, LightSource::Chosen);
        }
        self.found_photons = found;
    }
}
