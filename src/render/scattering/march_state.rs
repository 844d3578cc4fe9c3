//! Ray-marching state of one thread, and the division of marched radiance among lights.

use super::super::aov::LightGroups;
use super::super::context::RenderContext;
use super::super::profile::Memory;
use super::super::wavefront::ShadowQueue;
use crate::accel::RayPacket;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::Effect;
use crate::volume::{March, PointLanes, RaySegment};

/// Ray-marching state and working memory of one thread.
pub(in crate::render) struct MarchState<'f> {
    /// March along camera rays and secondary rays.
    pub(in crate::render) seen: March<'f>,
    /// March along shadow rays, used while the other march is in progress.
    pub(in crate::render) shadow: March<'f>,
    /// Shadow rays from the samples of a march to one light at a time.
    pub(in crate::render) shadow_queue: Box<ShadowQueue>,
    /// Radiance by light, if layers by light are requested.
    pub(in crate::render) shares: Option<LightShares>,
}

impl<'f> MarchState<'f> {
    pub(in crate::render) fn new(frame: &RenderContext<'f>) -> MarchState<'f> {
        let fog = frame.scene.fog.filter(|_| frame.scene.has_fog());
        let march = || March::new(&frame.scene.volumes, fog).with_skip(frame.settings.skip_empty);
        MarchState {
            seen: march(),
            shadow: march(),
            shadow_queue: ShadowQueue::new(frame.effects(), 1),
            shares: LightShares::of(&frame.light_sheet),
        }
    }

    /// Adds the bytes of the marches and of their shadow rays.
    pub(in crate::render) fn add_to(&self, memory: &mut Memory) {
        let own = size_of::<MarchState>() + ShadowQueue::BYTES;
        memory.add(Effect::Volume.name(), "marches and their shadow rays", own);
        self.shadow_queue.add_columns_to(memory);
        let shares = self.shares.as_ref().map_or(0, LightShares::byte_count);
        memory.add(Effect::Volume.name(), "radiance of each light", shares);
    }

    /// Attenuates the radiance that the shadow rays of `packet` carry by the volumes along them; ray parameters end
    /// at `reach`. Returns the number of samples.
    pub(in crate::render) fn attenuate(
        &mut self,
        packet: &RayPacket,
        reach: &Lanes<f32>,
        radiance: &mut Lanes3<f32>,
    ) -> u64 {
        attenuate(&mut self.shadow, packet, reach, radiance)
    }
}

pub(in crate::render) fn attenuate(
    march: &mut March,
    packet: &RayPacket,
    reach: &Lanes<f32>,
    radiance: &mut Lanes3<f32>,
) -> u64 {
    // Collect the segments of lanes that carry radiance
    let mut segments = [RaySegment::NONE; LANES];
    let mut lane = [0; LANES];
    let mut count = 0;
    for l in 0..LANES {
        if (0..3).all(|channel| radiance[channel][l] == 0.0) {
            continue;
        }
        let ray = packet.ray(l);
        segments[count] = RaySegment {
            origin: ray.origin.as_dvec3(),
            direction: ray.direction.as_dvec3(),
            t_near: 0.0,
            t_far: f64::from(reach[l]),
        };
        lane[count] = l;
        count += 1;
    }
    // March them and multiply by the transmittances
    let mut left = [1.0; LANES];
    let samples = march.transmittances(&segments[..count], &mut left);
    for (l, left) in lane.into_iter().zip(left).take(count) {
        for channel in 0..3 {
            radiance[channel][l] *= left as f32;
        }
    }
    samples
}

/// Radiance of each light in marches, for layers by light.
///
/// A march is linear in its incident light. It is repeated with the light that each plane alone gave to its samples,
/// for which no shadow rays are needed, and the emission of the volume is subtracted.
pub(in crate::render) struct LightShares {
    /// Incident light at the samples of a march, for each plane of lights, one entry per call.
    pub(in crate::render) lit: Vec<Vec<Lanes3<f64>>>,
    /// Radiance along the rays of a packet, for each plane of lights.
    pub(in crate::render) seen: Vec<Lanes3<f32>>,
}

pub(in crate::render) const DARK: Lanes3<f64> = [[0.0; LANES]; 3];

impl LightShares {
    fn of(groups: &LightGroups) -> Option<LightShares> {
        groups.has_lights().then(|| LightShares {
            lit: vec![Vec::new(); groups.light_planes()],
            seen: vec![[[0.0; LANES]; 3]; groups.light_planes()],
        })
    }

    fn byte_count(&self) -> usize {
        let calls: usize = self.lit.iter().map(Vec::capacity).sum();
        calls * size_of::<Lanes3<f64>>() + size_of_val(&self.lit[..]) + size_of_val(&self.seen[..])
    }

    pub(in crate::render) fn begin_packet(&mut self) {
        self.seen.fill([[0.0; LANES]; 3]);
        self.lit.iter_mut().for_each(Vec::clear);
    }

    /// Begins a batch of samples; plane 0 starts with the ambient light.
    pub(in crate::render) fn begin_call(&mut self, ambient: &Lanes3<f64>) {
        self.lit.iter_mut().for_each(|calls| calls.push(DARK));
        if let Some(last) = self.lit[0].last_mut() {
            *last = *ambient;
        }
    }

    pub(in crate::render) fn add(&mut self, plane: usize, radiance: &Lanes3<f32>) {
        let Some(last) = self.lit[plane].last_mut() else {
            return;
        };
        for channel in 0..3 {
            for l in 0..LANES {
                last[channel][l] += f64::from(radiance[channel][l]);
            }
        }
    }

    /// Computes the radiance of each light for lane `l` of throughput `weight`, whose march has just finished.
    pub(in crate::render) fn divide(
        &mut self,
        march: &mut March,
        segment: &RaySegment,
        (weight, l): ([f32; 3], usize),
    ) {
        // March without light to find the emission
        let by_itself = march.radiance(segment, Some(&mut |_| DARK)).radiance;
        for (plane, calls) in self.lit.iter_mut().enumerate() {
            let is_lit = calls
                .iter()
                .any(|call| call.as_flattened().iter().any(|&light| light != 0.0));
            if plane == 0 || is_lit {
                // Replay the recorded light of one plane
                let mut given = calls.iter();
                let light = &mut |_: &PointLanes| given.next().copied().unwrap_or(DARK);
                let marched = march.radiance(segment, Some(light)).radiance;
                for channel in 0..3 {
                    let own = if plane == 0 { 0.0 } else { by_itself[channel] };
                    self.seen[plane][channel][l] = weight[channel] * (marched[channel] - own) as f32;
                }
            }
            calls.clear();
        }
    }
}
