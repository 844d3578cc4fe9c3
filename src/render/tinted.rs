//! Shadow rays in scenes where light goes through surfaces: they are followed straight on, surface by surface, and
//! take the colour of what they pass.
//!
//! The lecture's rule: a transparent occluder tints the light and does not bend it. Each surface takes off what
//! Fresnel's equations reflect there and multiplies by its colour, each body on the way swallows its part. A shadow ray
//! goes on as the same ray from just behind the hit, so it can neither meet a surface twice nor lose one.

use super::ledger::Account;
use super::meter::{Accounts, Meter};
use super::outcome::Outcome;
use super::queue::{BATCH, ShadowPayload};
use super::surface::Surfaces;
use super::texturing::Widths;
use super::transparent::Tints;
use super::travel::MediaColumn;
use super::{Frame, shade};
use crate::accel::{NO_HIT, RayOrder, RayPacket};
use crate::numeric::{LANES, Lanes};
use crate::optics::LINE_D;
use crate::scene::Effect;

/// Surfaces after which a shadow ray counts as blocked: no light is left behind so many of any real material.
const MAX_SHEETS: usize = 256;

/// Shadow rays that wait, what they bring, and the bodies around the shaded points.
type Waiting<'a> = (&'a mut [RayPacket], &'a mut [ShadowPayload], &'a mut MediaColumn);

impl Outcome<'_, '_> {
    /// Lets in the light that reaches the waiting shadow rays' points, in whatever colour is left of it.
    pub(super) fn answer_through_sheets(&mut self, order: RayOrder) {
        let Some(sheets) = &mut self.sheets else { return };
        let sources = self.shadow_queue.sources();
        let (packets, payloads, media) = self.shadow_queue.drain_with_media();
        let waiting = (&mut *packets, &mut *payloads, media);
        let reaches = through_sheets(self.frame, waiting, sheets, &mut self.meter, order);
        for (((packet, payload), reach), source) in packets.iter().zip(payloads).zip(&reaches).zip(sources) {
            if let Some(marches) = &mut self.marches {
                let samples = marches.dim(packet, reach, &mut payload.radiance);
                self.meter.ledger.volume_samples += samples;
            }
            self.film.add(&payload.pixel, &payload.radiance, source);
        }
        self.meter.lap(Account::Film);
    }
}

/// Leaves of the light that shadow rays bring what the surfaces and bodies on their way let through. Returns how far
/// away, as ray parameters, the lights are.
pub(super) fn through_sheets(
    frame: &Frame,
    (packets, payloads, media): Waiting,
    sheets: &mut Surfaces,
    meter: &mut Meter,
    order: RayOrder,
) -> [Lanes<f32>; BATCH] {
    // The memory is that of earlier shadow rays, which have left where they went.
    for packet in packets.iter_mut() {
        packet.t_near = [0.0; LANES];
        (0..LANES).for_each(|l| packet.forget_hit(l));
    }
    let mut reaches = [[0.0; LANES]; BATCH];
    for (reach, packet) in reaches.iter_mut().zip(packets.iter()) {
        *reach = packet.t_far;
    }
    let mut account = Account::Shadow;
    for _ in 0..MAX_SHEETS {
        if !packets.iter().any(RayPacket::any_active) {
            break;
        }
        let whose = |index: usize| (&payloads[index].pixel, Accounts::All(account));
        let traced = meter.trace(packets, whose, |packets| frame.accel.intersect(packets, order));
        meter.ledger.book(account, traced);
        account = Account::TransparentShadow;
        for (index, packet) in packets.iter_mut().enumerate() {
            if packet.any_active() {
                let way = Way {
                    reach: &reaches[index],
                    media,
                    index,
                };
                way.pass_next(frame, packet, &mut payloads[index], sheets);
            }
        }
        let lanes = (0..packets.len()).map(|index| (&payloads[index].pixel, &packets[index].active));
        meter.lap_over(account, lanes);
    }
    for (packet, payload) in packets.iter_mut().zip(payloads) {
        // Whoever is still on the way counts as blocked.
        for l in 0..LANES {
            packet.t_far[l] = if packet.active[l] != 0 {
                f32::NEG_INFINITY
            } else {
                0.0
            };
        }
        shade::block(packet, &mut payload.radiance);
    }
    reaches
}

/// The rest of the way of sixteen shadow rays.
struct Way<'a> {
    /// Where the lights are, as ray parameters.
    reach: &'a Lanes<f32>,
    /// The bodies around.
    media: &'a mut MediaColumn,
    /// The packet's place among those that are answered together.
    index: usize,
}

impl Way<'_> {
    /// Takes each lane to the light or behind the surface that it has met.
    fn pass_next(
        mut self,
        frame: &Frame,
        packet: &mut RayPacket,
        payload: &mut ShadowPayload,
        sheets: &mut Surfaces,
    ) {
        let any_hit = (0..LANES).any(|l| packet.active[l] != 0 && packet.instance[l] != NO_HIT);
        if any_hit {
            frame.surfaces.meet(packet, Widths::None, sheets);
        }
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
            if is_hit {
                let through = self.tint(frame, packet, sheets, l);
                (0..3).for_each(|c| left[c] *= through[c]);
            }
            (0..3).for_each(|c| payload.radiance[c][l] *= left[c]);
            let is_dark = (0..3).all(|c| payload.radiance[c][l] == 0.0);
            if !is_hit || is_dark {
                packet.active[l] = 0;
                continue;
            }
            packet.t_near[l] = end.next_up();
            packet.t_far[l] = self.reach[l];
            packet.forget_hit(l);
            if !(packet.t_near[l] <= packet.t_far[l]) {
                packet.active[l] = 0;
            }
        }
    }

    /// What the surface that lane `l` has met leaves of the light; the lane's bodies become those behind it.
    fn tint(&mut self, frame: &Frame, packet: &RayPacket, sheets: &Surfaces, l: usize) -> [f32; 3] {
        let points = &sheets.points;
        let media = self.media.get(self.index, l);
        let boundary = frame.boundary(packet.instance[l], points.front[l], &media);
        let is_hidden = boundary.is_hidden();
        let coverage = sheets.materials.alpha[l];
        let mut through = [0.0; 3];
        if is_hidden {
            through = [1.0; 3];
        } else if frame.effects().has(Effect::Refraction) && boundary.material.transmits() {
            let d = packet.ray(l).direction.as_dvec3().normalize();
            let n = frame.surfaces.interface_normal(packet, sheets, l);
            let cos_i = (-d.dot(n)).clamp(0.0, 1.0);
            let (reflectance, transmittance) = frame.shares(&boundary, cos_i, LINE_D);
            let tints = Tints::of(&boundary.material.model, &sheets.materials, l);
            through = tints.weights(reflectance, transmittance).1;
        }
        self.media.set(self.index, l, &boundary.crossing.through);
        through.map(|c| 1.0 - coverage + coverage * c)
    }
}
