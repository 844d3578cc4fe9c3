//! Ray queues of the wavefront: secondary rays with their path state, and shadow rays with their pending radiance.
//!
//! Memory is reused from tile to tile; packets are refilled instead of allocated.

use super::super::aov::LightSource;
use super::super::context::RenderContext;
use super::super::film::with_step;
use super::super::profile::{Accounts, Category, Memory, RayTypeCounts};
use super::super::settings::RenderSettings;
use super::path_state::{CameraPaths, InteriorArray, PathState, PathStatePacket, PathStates};
use crate::accel::{MAX_BATCH, RayEnd, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::optics::InteriorStack;
use crate::scene::{Effect, EffectSet};

/// Pixels and throughput of the paths of one ray packet.
#[derive(Clone)]
pub(in crate::render) struct PathPacket {
    /// Pixel within the tile's film, with the sample and first-step bits of its label.
    pub(in crate::render) pixel: Lanes<u32>,
    /// Path throughput, linear RGB.
    pub(in crate::render) weight: Lanes3<f32>,
}

impl PathPacket {
    const EMPTY: PathPacket = PathPacket {
        pixel: [0; LANES],
        weight: [[0.0; LANES]; 3],
    };
}

/// Secondary ray to be queued, with its path state.
pub(in crate::render) struct RayWorkItem {
    pub(in crate::render) ray: Ray,
    pub(in crate::render) pixel: u32,
    pub(in crate::render) weight: [f32; 3],
    /// Account of the effect that sent the ray; used for bookkeeping if the ray is of all wavelengths.
    pub(in crate::render) sender: Category,
    /// Path state, in scenes whose paths carry one.
    pub(in crate::render) travel: Option<PathState>,
}

impl RayTypeCounts {
    #[inline(always)]
    fn count(&mut self, sent: &RayWorkItem) {
        let is_color = sent.account() == Category::Dispersion;
        match (sent.sender, is_color) {
            (Category::RoughReflection | Category::RoughRefraction, true) => self.rough_colors += 1,
            (Category::Interreflection, false) => self.bounced += 1,
            (Category::Interreflection, true) => self.bounced_colors += 1,
            (Category::RoughReflection, false) => self.rough_reflected += 1,
            (Category::RoughRefraction, false) => self.rough_refracted += 1,
            (Category::Refraction, true) => self.refracted_colors += 1,
            (Category::Refraction, false) => self.refracted += 1,
            (_, true) => self.mirrored_colors += 1,
            (_, false) => {}
        }
    }
}

impl RayWorkItem {
    fn account(&self) -> Category {
        match &self.travel {
            Some(travel) if travel.wavelength != 0.0 => Category::Dispersion,
            _ => self.sender,
        }
    }
}

/// Queue of the rays of one wavefront generation. Packets are kept for reuse.
pub(in crate::render) struct RayQueue {
    packets: Vec<RayPacket>,
    paths: Vec<PathPacket>,
    path_states: PathStates,
    /// Number of packets in use.
    count: usize,
    /// Number of lanes in use in the last packet.
    filled: usize,
    ray_types: RayTypeCounts,
    /// Account of each ray, if pixel costs or layers by effect are requested.
    accounts: Option<Vec<Lanes<Category>>>,
}

impl RayQueue {
    /// Returns an empty queue for rays of `effects`, whose paths may carry ray cones.
    pub(in crate::render) fn new(effects: EffectSet, combines_samples: bool) -> RayQueue {
        RayQueue {
            packets: Vec::new(),
            paths: Vec::new(),
            path_states: PathStates::new(effects, combines_samples),
            count: 0,
            filled: LANES,
            ray_types: RayTypeCounts::default(),
            accounts: None,
        }
    }

    /// Returns an empty queue for the rays of a render.
    pub(in crate::render) fn of_frame(frame: &RenderContext) -> RayQueue {
        RayQueue::new(frame.effects(), frame.combined.is_any()).with_accounts(&frame.settings)
    }

    /// Returns an empty queue for the rays of a render that continue at random, in scenes that have any.
    pub(in crate::render) fn of_bounces(frame: &RenderContext) -> Option<Box<RayQueue>> {
        let has_paths = frame.effects().has_random_paths();
        has_paths.then(|| Box::new(RayQueue::of_frame(frame)))
    }

    /// Returns the queue with an account per ray if `settings` request pixel costs or layers by effect.
    pub(in crate::render) fn with_accounts(self, settings: &RenderSettings) -> RayQueue {
        RayQueue {
            accounts: (settings.cost_aovs || settings.light_layers.effects).then(Vec::new),
            ..self
        }
    }

    /// Removes all rays from the queue.
    pub(in crate::render) fn clear(&mut self) {
        self.count = 0;
        self.filled = LANES;
        self.ray_types = RayTypeCounts::default();
        self.path_states.clear();
    }

    /// Writes the type of the first step of each path into the labels of rays that have not got one.
    ///
    /// Rays that continue behind fully transparent surfaces have depth 0; their paths have not taken a step yet.
    pub(in crate::render) fn label_steps(&mut self, effects: EffectSet) {
        let Some(accounts) = &self.accounts else { return };
        for (packet, accounts) in accounts.iter().enumerate().take(self.count) {
            let lanes = if packet + 1 == self.count {
                self.filled
            } else {
                LANES
            };
            for l in 0..lanes {
                // Skip paths that have not bounced yet
                if effects.counts_bounces() && self.path_states.at(packet).depth(l) == 0 {
                    continue;
                }
                let label = &mut self.paths[packet].pixel[l];
                *label = with_step(*label, accounts[l]);
            }
        }
    }

    /// Returns the numbers of rays by type that [`RayQueue::push`] counted.
    pub(in crate::render) fn ray_types(&self) -> RayTypeCounts {
        self.ray_types
    }

    /// Returns the number of packets in use.
    pub(in crate::render) fn len(&self) -> usize {
        self.count
    }

    /// Number of bytes of a ray packet and its path packet.
    pub(in crate::render) const PACKET_BYTES: usize = size_of::<RayPacket>() + size_of::<PathPacket>();

    /// Returns the bytes of all ray packets and path packets, in use or not.
    pub(in crate::render) fn byte_count(&self) -> usize {
        self.packets.capacity() * size_of::<RayPacket>() + self.paths.capacity() * size_of::<PathPacket>()
    }

    /// Adds the bytes of the optional arrays.
    pub(in crate::render) fn add_columns_to(&self, memory: &mut Memory, effects: EffectSet) {
        self.path_states.add_to(memory, effects);
        let accounts = self.accounts.as_ref().map_or(0, Vec::capacity);
        memory.add("other", "ray counters", accounts * size_of::<Lanes<Category>>());
    }

    /// Returns the packets in use and their paths.
    pub(in crate::render) fn parts(&mut self) -> (&mut [RayPacket], Paths<'_>) {
        let paths = Paths {
            paths: &self.paths[..self.count],
            path_states: &self.path_states,
            accounts: self.accounts.as_deref(),
            first: 0,
        };
        (&mut self.packets[..self.count], paths)
    }

    /// Sets the path state of lane `l` of the packet pushed last.
    fn set_travel(&mut self, l: usize, travel: &PathState) {
        self.path_states.resize(self.count);
        self.path_states.set(self.count - 1, l, travel);
    }

    /// Sets the states of the paths of the packet pushed last to those of camera rays.
    pub(in crate::render) fn begin_paths(&mut self, paths: &CameraPaths) {
        self.path_states.resize(self.count);
        self.path_states.begin(self.count - 1, paths);
    }

    /// Returns the packet that was pushed last.
    pub(in crate::render) fn last_packet(&mut self) -> &mut RayPacket {
        &mut self.packets[self.count - 1]
    }

    /// Appends an empty packet and returns it with its path packet.
    #[inline(always)]
    pub(in crate::render) fn push_packet(&mut self) -> (&mut RayPacket, &mut PathPacket) {
        if self.count == self.packets.len() {
            self.packets.push(RayPacket::EMPTY);
            self.paths.push(PathPacket::EMPTY);
        }
        let last = self.count;
        self.count += 1;
        self.packets[last].recycle();
        (&mut self.packets[last], &mut self.paths[last])
    }

    /// Appends one ray after the last.
    #[inline(always)]
    pub(in crate::render) fn push(&mut self, sent: &RayWorkItem) {
        // Start a new packet if the last one is full
        if self.filled == LANES {
            self.push_packet();
            self.filled = 0;
        }
        let (last, lane) = (self.count - 1, self.filled);
        // Write the ray, its pixel and its throughput
        self.packets[last].set(lane, &sent.ray);
        self.paths[last].pixel[lane] = sent.pixel;
        for channel in 0..3 {
            self.paths[last].weight[channel][lane] = sent.weight[channel];
        }
        // Count the ray and write its optional state
        self.ray_types.count(sent);
        if let Some(accounts) = &mut self.accounts {
            accounts.resize(self.count.max(accounts.len()), [Category::Reflection; LANES]);
            accounts[last][lane] = sent.account();
        }
        if let Some(travel) = &sent.travel {
            self.packets[last].time[lane] = travel.time;
            self.set_travel(lane, travel);
        }
        self.filled += 1;
    }
}

/// View of the paths of consecutive packets of a generation.
#[derive(Clone, Copy)]
pub(in crate::render) struct Paths<'a> {
    paths: &'a [PathPacket],
    path_states: &'a PathStates,
    accounts: Option<&'a [Lanes<Category>]>,
    /// Index of the first packet of the view within the generation.
    first: usize,
}

impl<'a> Paths<'a> {
    /// Returns the path packet of packet `index`, and its path states if any effect needs them.
    #[inline(always)]
    pub(in crate::render) fn at(&self, index: usize) -> (&'a PathPacket, Option<PathStatePacket<'a>>) {
        let packet = self.first + index;
        let path_states = (!self.path_states.is_void()).then(|| self.path_states.at(packet));
        (&self.paths[packet], path_states)
    }

    /// Returns the pixel labels of packet `index` and the accounts of its rays: `otherwise` if rays have no own
    /// account.
    pub(in crate::render) fn labels_and_accounts(
        &self,
        index: usize,
        otherwise: Category,
    ) -> (&'a Lanes<u32>, Accounts<'a>) {
        let packet = self.first + index;
        let accounts = match self.accounts.and_then(|accounts| accounts.get(packet)) {
            Some(accounts) => Accounts::Each(accounts),
            None => Accounts::All(otherwise),
        };
        (&self.paths[packet].pixel, accounts)
    }

    /// Returns the view that begins at packet `first` of this one.
    pub(in crate::render) fn from(&self, first: usize) -> Paths<'a> {
        Paths {
            first: self.first + first,
            ..*self
        }
    }
}

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
    /// End that all rays of a packet have in common, if there is one.
    ends: [Option<RayEnd>; MAX_BATCH],
    /// True for packets to lights whose photons bring the light behind bodies that refract.
    has_photons: [bool; MAX_BATCH],
}

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
            ends: [None; MAX_BATCH],
            has_photons: [false; MAX_BATCH],
        })
    }

    /// Adds the radiance of packets that ends at surfaces that refract, if `is_split`.
    pub(in crate::render) fn with_lobe_radiance(mut self: Box<Self>, is_split: bool) -> Box<ShadowQueue> {
        self.lobe_radiance = is_split.then(|| Box::new([[[0.0; LANES]; 3]; MAX_BATCH]));
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
