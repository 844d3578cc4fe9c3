//! Transparent shadows: shadow rays continue straight through transmissive surfaces and are tinted by them.
//!
//! As in the model of Phong and Whitted, a transparent occluder tints light but does not refract it. Each surface
//! removes what Fresnel's equations reflect and multiplies by its colour, and each medium absorbs. A shadow ray
//! continues as the same ray from just behind the hit, so it can neither hit a surface twice nor miss one.

use super::super::aov::LightSource;
use super::super::context::RenderContext;
use super::super::profile::{Accounts, Category, Profiler};
use super::super::scattering::Tints;
use super::super::surface::{ConeSource, Surfaces};
use super::super::wavefront::{InteriorArray, QueuedShadowRays, ShadingState};
use super::direct;
use crate::accel::{Coherence, MAX_BATCH, NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::optics::LINE_D;
use crate::scene::Effect;

/// Largest number of surfaces that a shadow ray passes before it counts as occluded; no real material leaves any
/// light behind so many.
const MAX_SHADOW_SURFACES: usize = 256;

impl ShadingState<'_, '_> {
    /// Traces the queued shadow rays through transmissive surfaces and adds the attenuated radiance to the film.
    pub(in crate::render) fn trace_transparent_shadow_rays(&mut self, order: Coherence) {
        let Some(shadow_surfaces) = &mut self.shadow_surfaces else {
            return;
        };
        let (sources, chosen) = (self.shadow_queue.sources(), self.shadow_queue.take_chosen());
        let mut queued = self.shadow_queue.drain_all();
        let reaches = attenuate_shadow_rays(self.frame, &mut queued, shadow_surfaces, &mut self.meter, order);
        let QueuedShadowRays {
            packets, payloads, ..
        } = queued;
        // Attenuate by volumes and add to the film
        for (index, ((packet, payload), reach)) in packets.iter().zip(payloads).zip(&reaches).enumerate() {
            if let Some(marches) = &mut self.marches {
                let samples = marches.attenuate(packet, reach, &mut payload.radiance);
                self.meter.ledger.volume_samples += samples;
            }
            self.film.add(&payload.pixel, &payload.radiance, sources[index]);
            if let Some(chosen) = chosen.as_ref().filter(|_| sources[index] == LightSource::Chosen) {
                self.film
                    .add_to_lights(&payload.pixel, &payload.radiance, &chosen[index]);
            }
        }
        self.shadow_queue.return_chosen(chosen);
        self.meter.lap(Category::Film);
    }
}

/// Attenuates the pending radiance of shadow rays by the surfaces and media along them. Returns the ray parameters of
/// the lights.
pub(in crate::render) fn attenuate_shadow_rays(
    frame: &RenderContext,
    queued: &mut QueuedShadowRays,
    shadow_surfaces: &mut Surfaces,
    meter: &mut Profiler,
    order: Coherence,
) -> [Lanes<f32>; MAX_BATCH] {
    let QueuedShadowRays {
        packets,
        payloads,
        media,
        lobe_radiance,
        has_photons,
    } = queued;
    // The packets still hold intervals and hits of earlier shadow rays.
    for packet in packets.iter_mut() {
        packet.t_near = [0.0; LANES];
        (0..LANES).for_each(|l| packet.clear_hit(l));
    }
    // Remember the ray parameters of the lights
    let mut reaches = [[0.0; LANES]; MAX_BATCH];
    for (reach, packet) in reaches.iter_mut().zip(packets.iter()) {
        *reach = packet.t_far;
    }
    let mut account = Category::Shadow;
    // Advance all rays to the next surface until none is left
    for _ in 0..MAX_SHADOW_SURFACES {
        if !packets.iter().any(RayPacket::any_active) {
            break;
        }
        let labels_and_accounts = |index: usize| (&payloads[index].pixel, Accounts::All(account));
        let traced = meter.trace(packets, labels_and_accounts, |packets, _| {
            frame.accel.intersect(packets, order)
        });
        meter.ledger.book(account, traced);
        account = Category::TransparentShadow;
        // Attenuate each packet at its hits
        for (index, packet) in packets.iter_mut().enumerate() {
            if packet.any_active() {
                let lobe_radiance = lobe_radiance.as_mut().map(|lobes| &mut lobes[index]);
                let shadow_rays = ShadowRays {
                    reach: &reaches[index],
                    media,
                    index,
                    radiance: &mut payloads[index].radiance,
                    lobe_radiance,
                    has_photons: has_photons[index],
                };
                shadow_rays.advance_rays(frame, packet, shadow_surfaces);
            }
        }
        let lanes = (0..packets.len()).map(|index| (&payloads[index].pixel, &packets[index].active));
        meter.lap_over(account, lanes);
    }
    for (index, (packet, payload)) in packets.iter_mut().zip(payloads.iter_mut()).enumerate() {
        // Add the light that is kept apart, and leave none to the next packets
        if let Some(lobes) = lobe_radiance {
            let kept = std::mem::replace(&mut lobes[index], [[0.0; LANES]; 3]);
            for c in 0..3 {
                (0..LANES).for_each(|l| payload.radiance[c][l] += kept[c][l]);
            }
        }
        // Rays that are still active after the last pass count as occluded.
        for l in 0..LANES {
            packet.t_far[l] = if packet.active[l] != 0 {
                f32::NEG_INFINITY
            } else {
                0.0
            };
        }
        direct::block(packet, &mut payload.radiance);
    }
    reaches
}

/// Remaining way of sixteen shadow rays to their lights.
struct ShadowRays<'a> {
    /// Ray parameters of the lights.
    reach: &'a Lanes<f32>,
    /// Dielectric interiors around the rays.
    media: &'a mut InteriorArray,
    /// Index of the packet within the batch.
    index: usize,
    /// Radiance that all surfaces attenuate.
    radiance: &'a mut Lanes3<f32>,
    /// Radiance that ends at surfaces that refract.
    lobe_radiance: Option<&'a mut Lanes3<f32>>,
    /// True if photons bring the light behind bodies that refract.
    has_photons: bool,
}

/// Transmittance of a surface that a shadow ray hits.
struct ShadowTint {
    /// Transmittance of the whole surface.
    all: [f32; 3],
    /// Transmittance to light that surfaces end where they refract.
    unrefracted: [f32; 3],
}

impl ShadowRays<'_> {
    /// Advances each lane to its light or behind the surface that it hit, and attenuates its radiance.
    fn advance_rays(mut self, frame: &RenderContext, packet: &mut RayPacket, shadow_surfaces: &mut Surfaces) {
        self.end_at_opaque_surfaces(frame, packet);
        let any_hit = (0..LANES).any(|l| packet.active[l] != 0 && packet.instance[l] != NO_HIT);
        if any_hit {
            frame
                .surfaces
                .compute_interactions(packet, ConeSource::None, shadow_surfaces);
        }
        // Attenuate by the medium and by the surface
        for l in 0..LANES {
            if packet.active[l] == 0 {
                continue;
            }
            let is_hit = packet.instance[l] != NO_HIT;
            let end = if is_hit { packet.t_far[l] } else { self.reach[l] };
            let ray = packet.ray(l);
            let length = ray.direction.as_dvec3().length();
            let distance = (f64::from(end) - f64::from(ray.t_near)) * length;
            let mut left = [1.0; 3];
            if frame.effects().has(Effect::Absorption) {
                left = frame.transmittance(&self.media.get(self.index, l), distance);
            }
            let mut lobe_left = left;
            if is_hit {
                let through = self.tint(frame, packet, shadow_surfaces, l);
                (0..3).for_each(|c| lobe_left[c] *= through.unrefracted[c]);
                (0..3).for_each(|c| left[c] *= through.all[c]);
            }
            (0..3).for_each(|c| self.radiance[c][l] *= left[c]);
            let mut is_dark = (0..3).all(|c| self.radiance[c][l] == 0.0);
            if let Some(lobes) = &mut self.lobe_radiance {
                (0..3).for_each(|c| lobes[c][l] *= lobe_left[c]);
                is_dark &= (0..3).all(|c| lobes[c][l] == 0.0);
            }
            // Finish lanes that reach the light or carry no radiance
            if !is_hit || is_dark {
                packet.active[l] = 0;
                continue;
            }
            // Continue behind the surface
            packet.t_near[l] = end.next_up();
            packet.t_far[l] = self.reach[l];
            packet.clear_hit(l);
            if !(packet.t_near[l] <= packet.t_far[l]) {
                packet.active[l] = 0;
            }
        }
    }

    /// Ends the rays that hit surfaces without any transmission, which need no interaction.
    fn end_at_opaque_surfaces(&mut self, frame: &RenderContext, packet: &mut RayPacket) {
        for l in 0..LANES {
            let instance = packet.instance[l];
            if packet.active[l] == 0 || instance == NO_HIT || !is_opaque(frame, instance) {
                continue;
            }
            // Remove the radiance and deactivate the lane
            (0..3).for_each(|c| self.radiance[c][l] = 0.0);
            if let Some(lobes) = &mut self.lobe_radiance {
                (0..3).for_each(|c| lobes[c][l] = 0.0);
            }
            packet.active[l] = 0;
            packet.clear_hit(l);
        }
    }

    /// Returns the transmittance of the surface that lane `l` hit, and updates the lane's interiors to those behind
    /// it.
    fn tint(
        &mut self,
        frame: &RenderContext,
        packet: &RayPacket,
        shadow_surfaces: &Surfaces,
        l: usize,
    ) -> ShadowTint {
        let points = &shadow_surfaces.points;
        let media = self.media.get(self.index, l);
        let boundary = frame.boundary(packet.instance[l], points.front[l], &media);
        let is_hidden = boundary.is_hidden();
        let coverage = shadow_surfaces.materials.alpha[l];
        let (mut through, mut unrefracted) = ([0.0; 3], [0.0; 3]);
        // A hidden boundary transmits everything
        if is_hidden {
            (through, unrefracted) = ([1.0; 3], [1.0; 3]);
        } else if frame.effects().has(Effect::Refraction) && boundary.material.transmits() {
            // Multiply Fresnel's transmittance by the tint
            let d = packet.ray(l).direction.as_dvec3().normalize();
            let n = frame.surfaces.interface_normal(packet, shadow_surfaces, l);
            let cos_i = (-d.dot(n)).clamp(0.0, 1.0);
            let (reflectance, transmittance) = frame.fresnel_factors(&boundary, cos_i, LINE_D);
            let tints = Tints::of(&boundary.material.model, &shadow_surfaces.materials, l);
            through = tints.weights(reflectance, transmittance).1;
            // Photons follow the refracted ray, unless the surface is thin or sends rays into a lobe
            if self.has_photons && !boundary.is_thin_surface() && !shadow_surfaces.materials.has_lobe(l) {
                through = [0.0; 3];
            }
        }
        self.media.set(self.index, l, &boundary.crossing.through);
        // Add the light that passes through the uncovered part
        let mixed = |transmittance: f32| 1.0 - coverage + coverage * transmittance;
        ShadowTint {
            all: through.map(mixed),
            unrefracted: unrefracted.map(mixed),
        }
    }
}

/// Returns whether no light passes through the surfaces of an instance, wherever they are hit.
fn is_opaque(frame: &RenderContext, instance: u32) -> bool {
    let effects = frame.effects();
    let material = &frame.scene.materials[frame.scene.instances[instance as usize].material as usize];
    let transmits = effects.has(Effect::Refraction) && material.transmits();
    !(material.alpha.is_simulated(effects) || transmits)
}
