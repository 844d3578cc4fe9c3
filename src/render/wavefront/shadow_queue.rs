//! Queue of shadow rays, with the radiance that each contributes if it is not occluded.
//!
//! Memory is reused from batch to batch.

use super::super::aov::LightSource;
use super::super::profile::Memory;
use super::path_state::{InteriorArray, PathStatePacket};
use crate::accel::{MAX_BATCH, RayEnd, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::optics::InteriorStack;
use crate::scene::{Effect, EffectSet};

/// Queue of shadow rays, with the radiance that each contributes if it is not occluded.
pub(in crate::render) struct ShadowQueue {
    packets: [RayPacket; MAX_BATCH],
    payloads: [ShadowPayload; MAX_BATCH],
    /// Dielectric interiors around the shaded points.
    media: InteriorArray,
    /// Radiance of each packet that ends at surfaces that refract; `None` if no light is split in this way.
    lobe_radiance: Option<Box<[Lanes3<f32>; MAX_BATCH]>>,
    /// Number of packets in use.
    count: usize,
    /// Largest number of packets.
    capacity: usize,
    /// Light that each packet is sent to; not written in scenes with plain effects only.
    sources: [LightSource; MAX_BATCH],
    /// Light of each ray of packets to chosen lights, if layers by light are requested.
    chosen: Option<Box<ChosenLights>>,
    /// End that all rays of a packet have in common, if there is one.
    ends: [Option<RayEnd>; MAX_BATCH],
    /// True for packets to lights whose photons bring the light behind bodies that refract.
    has_photons: [bool; MAX_BATCH],
}

/// Numbers of the lights of the rays of a batch.
pub(in crate::render) type ChosenLights = [Lanes<u32>; MAX_BATCH];

/// Shadow rays that are traced together.
pub(in crate::render) struct QueuedShadowRays<'a> {
    pub(in crate::render) packets: &'a mut [RayPacket],
    pub(in crate::render) payloads: &'a mut [ShadowPayload],
    /// Dielectric interiors around the shaded points.
    pub(in crate::render) media: &'a mut InteriorArray,
    /// Radiance of each packet beside that of its payload, which ends at surfaces that refract.
    pub(in crate::render) lobe_radiance: Option<&'a mut [Lanes3<f32>]>,
    /// Flag for each packet: whether all of its light ends at bodies that refract.
    pub(in crate::render) has_photons: &'a [bool],
}

/// Pixels that a packet of shadow rays contributes to, and its unoccluded radiance.
#[derive(Clone)]
pub(in crate::render) struct ShadowPayload {
    pub(in crate::render) pixel: Lanes<u32>,
    pub(in crate::render) radiance: Lanes3<f32>,
}

impl ShadowQueue {
    /// Returns an empty queue of `capacity` packets, at most [`MAX_BATCH`], for shadow rays of these effects.
    pub(in crate::render) fn new(effects: EffectSet, capacity: usize) -> Box<ShadowQueue> {
        let mut media = InteriorArray::new(effects);
        media.resize(MAX_BATCH);
        Box::new(ShadowQueue {
            packets: std::array::from_fn(|_| RayPacket::EMPTY),
            payloads: std::array::from_fn(|_| ShadowPayload {
                pixel: [0; LANES],
                radiance: [[0.0; LANES]; 3],
            }),
            media,
            lobe_radiance: None,
            count: 0,
            capacity: capacity.min(MAX_BATCH),
            sources: [LightSource::Emission; MAX_BATCH],
            chosen: None,
            ends: [None; MAX_BATCH],
            has_photons: [false; MAX_BATCH],
        })
    }

    /// Adds the radiance of packets that ends at surfaces that refract, if `is_split`.
    pub(in crate::render) fn with_lobe_radiance(mut self: Box<Self>, is_split: bool) -> Box<ShadowQueue> {
        self.lobe_radiance = is_split.then(|| Box::new([[[0.0; LANES]; 3]; MAX_BATCH]));
        self
    }

    /// Adds the light of each ray if layers by light need it.
    pub(in crate::render) fn with_chosen_lights(mut self: Box<Self>, is_needed: bool) -> Box<ShadowQueue> {
        self.chosen = is_needed.then(|| Box::new([[0; LANES]; MAX_BATCH]));
        self
    }

    /// Number of bytes of the packets and payloads.
    pub(in crate::render) const BYTES: usize = size_of::<ShadowQueue>();

    /// Adds the bytes of the optional arrays.
    pub(in crate::render) fn add_columns_to(&self, memory: &mut Memory) {
        self.media.add_to(memory);
        let split = self
            .lobe_radiance
            .as_ref()
            .map_or(0, |lobes| size_of_val(&**lobes));
        memory.add(
            Effect::RoughReflection.name(),
            "light of lobes in shadow rays",
            split,
        );
        let chosen = self.chosen.as_ref().map_or(0, |chosen| size_of_val(&**chosen));
        memory.add(Effect::Interreflection.name(), "lights of shadow rays", chosen);
    }

    /// Returns whether there is no room for another packet.
    pub(in crate::render) fn is_full(&self) -> bool {
        self.count == self.capacity
    }

    /// Returns memory for one more packet, which counts once [`ShadowQueue::commit`] is called.
    pub(in crate::render) fn next(&mut self) -> (&mut RayPacket, &mut ShadowPayload) {
        (&mut self.packets[self.count], &mut self.payloads[self.count])
    }

    /// Sets the radiance of the packet committed next that ends at surfaces that refract.
    pub(in crate::render) fn set_lobe_radiance(&mut self, radiance: &Lanes3<f32>) {
        if let Some(lobes) = &mut self.lobe_radiance {
            lobes[self.count] = *radiance;
        }
    }

    /// Sets the light that the packet committed next is sent to.
    pub(in crate::render) fn set_source(&mut self, source: LightSource) {
        self.sources[self.count] = source;
    }

    /// Sets the light of each ray of the packet committed next.
    pub(in crate::render) fn set_chosen(&mut self, lights: &Lanes<u32>) {
        if let Some(chosen) = &mut self.chosen {
            chosen[self.count] = *lights;
        }
    }

    /// Takes the lights of the rays of packets to chosen lights, if they are kept; [`ShadowQueue::return_chosen`] returns them.
    pub(in crate::render) fn take_chosen(&mut self) -> Option<Box<ChosenLights>> {
        self.chosen.take()
    }

    /// Returns the memory that [`ShadowQueue::take_chosen`] took.
    pub(in crate::render) fn return_chosen(&mut self, chosen: Option<Box<ChosenLights>>) {
        self.chosen = chosen;
    }

    /// Sets whether photons bring the light of the packet committed next behind bodies that refract.
    pub(in crate::render) fn set_photons(&mut self, has_photons: bool) {
        self.has_photons[self.count] = has_photons;
    }

    /// Returns the light that each packet was sent to.
    pub(in crate::render) fn sources(&self) -> [LightSource; MAX_BATCH] {
        self.sources
    }

    /// Sets the end that all rays of the packet committed next have in common, if there is one.
    pub(in crate::render) fn set_end(&mut self, end: Option<RayEnd>) {
        self.ends[self.count] = end;
    }

    /// Returns the common end of the rays of each packet.
    pub(in crate::render) fn ends(&self) -> [Option<RayEnd>; MAX_BATCH] {
        self.ends
    }

    /// Adds the packet last written to the queue.
    pub(in crate::render) fn commit(&mut self) {
        self.count += 1;
    }

    /// Sets the interiors around the points of the packet last committed.
    pub(in crate::render) fn set_media(&mut self, path_states: PathStatePacket) {
        for l in 0..LANES {
            self.media.set(self.count - 1, l, &path_states.media(l));
        }
    }

    /// Sets the same interiors around all points of the packet that is committed next.
    pub(in crate::render) fn set_medium(&mut self, media: &InteriorStack) {
        for l in 0..LANES {
            self.media.set(self.count, l, media);
        }
    }

    /// Empties the queue like [`ShadowQueue::drain`] and returns all that its packets carry.
    pub(in crate::render) fn drain_all(&mut self) -> QueuedShadowRays<'_> {
        let count = std::mem::take(&mut self.count);
        QueuedShadowRays {
            packets: &mut self.packets[..count],
            payloads: &mut self.payloads[..count],
            media: &mut self.media,
            lobe_radiance: self.lobe_radiance.as_mut().map(|lobes| &mut lobes[..count]),
            has_photons: &self.has_photons[..count],
        }
    }

    /// Empties the queue and returns its packets and their payloads.
    pub(in crate::render) fn drain(&mut self) -> (&mut [RayPacket], &mut [ShadowPayload]) {
        let count = std::mem::take(&mut self.count);
        (&mut self.packets[..count], &mut self.payloads[..count])
    }
}
