//! Per-path state as structure of arrays; only arrays that an active effect needs are allocated.
//!
//! For example, a scene without dielectrics has no array of interiors, and one without filtered textures no array of
//! ray cones. Each array holds the sixteen lanes of a packet side by side.

use glam::DVec3;

use super::super::profile::Memory;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::optics::{InteriorStack, NestedInterior};
use crate::scene::{Effect, EffectSet};
use crate::shading::ray_cone::RayCone;

/// Density of a path that a mirror has turned aside behind a diffuse surface, where photons represent lights but not the
/// environment map.
pub(in crate::render) const BEHIND_MIRROR: f32 = -1.0;

/// State of one path, besides its throughput.
#[derive(Clone, Copy)]
pub(in crate::render) struct PathState {
    /// Number of reflections and refractions so far, diffuse bounces included.
    pub(in crate::render) depth: u32,
    /// Number of diffuse bounces so far.
    pub(in crate::render) bounces: u32,
    /// True if a mirror or a refracting body turned the path aside, in scenes with caustics.
    pub(in crate::render) bent: bool,
    /// Wavelength that the path follows, in nanometres; 0 for all wavelengths.
    pub(in crate::render) wavelength: f32,
    /// Unit direction, before it is rounded to the f32 direction of the ray.
    pub(in crate::render) direction: DVec3,
    /// Dielectric interiors around the path.
    pub(in crate::render) media: InteriorStack,
    /// Ray cone, as width and spread.
    pub(in crate::render) cone: RayCone,
    /// Index of the pixel sample that the path belongs to. Rays into one lobe count as separate samples.
    pub(in crate::render) sample: u32,
    /// Number of rays that the lobe at the first visible surface was split into, this one included; 1 without a
    /// split.
    pub(in crate::render) split: u32,
    /// Time of the rays, as in [`crate::numeric::Ray::time`].
    pub(in crate::render) time: f32,
    /// Density per steradian of the rays into the lobe that the direction was sampled from, times their number. It is 0
    /// behind a diffuse bounce, where light samples alone represent their lights, and infinite for other directions.
    pub(in crate::render) density: f32,
}

impl PathState {
    /// State of a path that has not begun.
    pub(in crate::render) const NONE: PathState = PathState {
        depth: 0,
        bounces: 0,
        bent: false,
        wavelength: 0.0,
        direction: DVec3::ZERO,
        media: InteriorStack::EMPTY,
        cone: RayCone {
            width: 0.0,
            spread: 0.0,
        },
        sample: 0,
        split: 1,
        time: 0.0,
        density: f32::INFINITY,
    };

    /// Returns the density behind a boundary that refracts the ray, or that it passes unchanged.
    ///
    /// Shadow rays pass such boundaries straight, so light samples at a diffuse surface represent the lights behind them.
    pub(in crate::render) fn density_behind_boundary(&self) -> f32 {
        if self.density <= 0.0 {
            self.density
        } else {
            PathState::NONE.density
        }
    }

    /// Returns the density behind a mirror. Where there are caustics, photons represent the lights that a ray from a
    /// diffuse surface finds there.
    pub(in crate::render) fn density_behind_mirror(&self, has_caustics: bool) -> f32 {
        if has_caustics && self.density <= 0.0 {
            BEHIND_MIRROR
        } else {
            PathState::NONE.density
        }
    }
}

/// State of the paths of a packet of camera rays.
pub(in crate::render) struct CameraPaths<'a> {
    /// Unit directions, if paths need them in f64.
    pub(in crate::render) directions: Option<Lanes<DVec3>>,
    /// Interiors and ray cone, which all camera rays share.
    pub(in crate::render) media: InteriorStack,
    pub(in crate::render) cone: RayCone,
    /// Indices of the pixel samples.
    pub(in crate::render) samples: &'a Lanes<u32>,
    pub(in crate::render) times: &'a Lanes<f32>,
}

/// States of sixteen paths behind diffuse surfaces.
pub(in crate::render) struct BouncedStates<'a> {
    /// States of the rays that hit the surfaces.
    pub(in crate::render) arrival: PathStatePacket<'a>,
    /// Unit directions of the rays that leave.
    pub(in crate::render) direction: &'a Lanes3<f64>,
    pub(in crate::render) cone: &'a Lanes<RayCone>,
}

/// Path states of several packets, as far as the effects need them.
pub(in crate::render) struct PathStates {
    depth: OptionalArray<u32>,
    bounces: OptionalArray<u32>,
    bent: OptionalArray<bool>,
    wavelength: OptionalArray<f32>,
    direction: OptionalArray<DVec3>,
    media: InteriorArray,
    cone: OptionalArray<RayCone>,
    sample: OptionalArray<u32>,
    split: OptionalArray<u32>,
    time: OptionalArray<f32>,
    density: OptionalArray<f32>,
    packet_count: usize,
}

impl PathStates {
    /// Returns empty arrays for these effects, and for ray cones if paths carry them.
    pub(in crate::render) fn new(effects: EffectSet, combines_samples: bool) -> PathStates {
        PathStates {
            depth: OptionalArray::new(effects.counts_bounces()),
            bounces: OptionalArray::new(effects.has_random_paths()),
            bent: OptionalArray::new(effects.has(Effect::Caustics)),
            wavelength: OptionalArray::new(effects.has(Effect::Dispersion)),
            direction: OptionalArray::new(effects.has(Effect::Refraction)),
            media: InteriorArray::new(effects),
            cone: OptionalArray::new(effects.tracks_cones()),
            sample: OptionalArray::new(effects.samples_light()),
            split: OptionalArray::new(effects.has_lobes()),
            time: OptionalArray::new(effects.has(Effect::MotionBlur)),
            density: OptionalArray::new(combines_samples || effects.has(Effect::Interreflection)),
            packet_count: 0,
        }
    }

    /// Returns whether no array is allocated.
    pub(in crate::render) fn is_void(&self) -> bool {
        // Every other array exists only together with one of these.
        !(self.depth.is_allocated
            || self.cone.is_allocated
            || self.sample.is_allocated
            || self.time.is_allocated)
    }

    /// Removes the states of all packets.
    pub(in crate::render) fn clear(&mut self) {
        self.resize(0);
    }

    /// Resizes the arrays to `packets` packets; new ones hold paths that have not begun.
    #[inline(always)]
    pub(in crate::render) fn resize(&mut self, packets: usize) {
        if self.packet_count != packets {
            self.resize_arrays(packets);
        }
    }

    #[inline(never)]
    fn resize_arrays(&mut self, packets: usize) {
        self.packet_count = packets;
        self.depth.resize(packets, 0);
        self.bounces.resize(packets, 0);
        self.bent.resize(packets, false);
        self.wavelength.resize(packets, 0.0);
        self.direction.resize(packets, DVec3::ZERO);
        self.media.resize(packets);
        self.cone.resize(packets, PathState::NONE.cone);
        self.sample.resize(packets, 0);
        self.split.resize(packets, PathState::NONE.split);
        self.time.resize(packets, 0.0);
        self.density.resize(packets, PathState::NONE.density);
    }

    /// Sets the state of lane `l` of packet `packet`.
    pub(in crate::render) fn set(&mut self, packet: usize, l: usize, travel: &PathState) {
        self.depth.set(packet, l, travel.depth);
        self.bounces.set(packet, l, travel.bounces);
        self.bent.set(packet, l, travel.bent);
        self.wavelength.set(packet, l, travel.wavelength);
        self.direction.set(packet, l, travel.direction);
        self.media.set(packet, l, &travel.media);
        self.cone.set(packet, l, travel.cone);
        self.sample.set(packet, l, travel.sample);
        self.split.set(packet, l, travel.split);
        self.time.set(packet, l, travel.time);
        self.density.set(packet, l, travel.density);
    }

    /// Sets free lanes, given by [`FreeLane::index`], to the states of `lanes` behind diffuse surfaces.
    #[inline(always)]
    pub(in crate::render) fn set_bounced(&mut self, bounced: &BouncedStates, free: &[usize], lanes: &[u8]) {
        let (arrival, places) = (bounced.arrival, LaneDestinations { free, lanes });
        let (before, from) = (arrival.path_states, arrival.packet);
        // Count the bounce
        self.depth
            .fill(places, || arrival.depths().map(|depth| depth + 1));
        self.bounces
            .fill(places, || arrival.bounce_counts().map(|bounces| bounces + 1));
        // Turn the path
        let [x, y, z] = bounced.direction;
        self.direction
            .fill(places, || std::array::from_fn(|l| DVec3::new(x[l], y[l], z[l])));
        self.cone.fill(places, || *bounced.cone);
        self.density.fill(places, || [0.0; LANES]);
        // Keep the rest
        self.bent.fill(places, || before.bent.lanes(from, false));
        self.wavelength.fill(places, || arrival.wavelengths());
        self.media.fill(places, &before.media, from);
        self.sample.fill(places, || arrival.samples());
        self.split.fill(places, || arrival.splits());
        self.time.fill(places, || arrival.times());
    }

    /// Sets the states of packet `packet`, whose paths have not begun, to those of camera rays.
    pub(in crate::render) fn begin(&mut self, packet: usize, paths: &CameraPaths) {
        if let Some(directions) = &paths.directions {
            self.direction.set_lanes(packet, directions);
        }
        for l in 0..LANES {
            self.media.set(packet, l, &paths.media);
        }
        self.cone.set_lanes(packet, &[paths.cone; LANES]);
        self.sample.set_lanes(packet, paths.samples);
        self.time.set_lanes(packet, paths.times);
    }

    /// Sets the pixel samples of packet `packet`.
    pub(in crate::render) fn set_samples(&mut self, packet: usize, samples: &Lanes<u32>) {
        self.sample.set_lanes(packet, samples);
    }

    /// Adds the bytes of each array to the effect that needs it.
    pub(in crate::render) fn add_to(&self, memory: &mut Memory, effects: EffectSet) {
        // Attribute depths to the effect by which light passes surfaces, or by which paths continue at random
        let random = match effects.has(Effect::Interreflection) {
            true => Effect::Interreflection,
            false => Effect::Caustics,
        };
        let counting = match effects.has_transmission() {
            true => effects.transmissive(),
            false => random,
        };
        memory.add(counting.name(), "steps of paths", self.depth.byte_count());
        let bounces = self.bounces.byte_count();
        memory.add(random.name(), "bounces of paths", bounces);
        let bent = self.bent.byte_count();
        memory.add(Effect::Caustics.name(), "turned paths", bent);
        let wavelengths = self.wavelength.byte_count();
        memory.add(Effect::Dispersion.name(), "wavelengths of paths", wavelengths);
        let directions = self.direction.byte_count();
        memory.add(Effect::Refraction.name(), "directions of paths", directions);
        self.media.add_to(memory);
        memory.add(
            Effect::TextureFilter.name(),
            "widths of paths",
            self.cone.byte_count(),
        );
        memory.add("sampling", "samples of paths", self.sample.byte_count());
        // Attribute lobe rays to the first of the effects that send some
        let senders = [Effect::RoughReflection, Effect::RoughRefraction];
        let lobes = senders.into_iter().find(|&effect| effects.has(effect));
        let lobes = lobes.unwrap_or(random);
        memory.add(lobes.name(), "rays of lobes", self.split.byte_count());
        memory.add(lobes.name(), "densities of lobes", self.density.byte_count());
        memory.add(
            Effect::MotionBlur.name(),
            "times of paths",
            self.time.byte_count(),
        );
    }

    /// Returns a view of the states of one packet.
    pub(in crate::render) fn at(&self, packet: usize) -> PathStatePacket<'_> {
        PathStatePacket {
            path_states: self,
            packet,
        }
    }
}

/// View of the path states of one packet.
#[derive(Clone, Copy)]
pub(in crate::render) struct PathStatePacket<'a> {
    path_states: &'a PathStates,
    packet: usize,
}

impl PathStatePacket<'_> {
    /// Returns the state of lane `l`; members without an array have the values of [`PathState::NONE`].
    #[inline(always)]
    pub(in crate::render) fn lane(&self, l: usize) -> PathState {
        let (path_states, packet) = (self.path_states, self.packet);
        PathState {
            depth: path_states.depth.get(packet, l, 0),
            bounces: path_states.bounces.get(packet, l, 0),
            bent: path_states.bent.get(packet, l, false),
            wavelength: path_states.wavelength.get(packet, l, 0.0),
            direction: path_states.direction.get(packet, l, DVec3::ZERO),
            media: path_states.media.get(packet, l),
            cone: self.cone(l),
            sample: self.sample(l),
            split: self.split(l),
            time: self.time(l),
            density: self.density(l),
        }
    }

    /// Returns the number of reflections and refractions of lane `l` so far; 0 if paths do not count them.
    pub(in crate::render) fn depth(&self, l: usize) -> u32 {
        self.path_states.depth.get(self.packet, l, 0)
    }

    /// Returns [`PathStatePacket::depth`] of all lanes.
    #[inline(always)]
    pub(in crate::render) fn depths(&self) -> Lanes<u32> {
        self.path_states.depth.lanes(self.packet, 0)
    }

    /// Returns the number of diffuse surfaces that each lane has left; 0 if paths do not count them.
    #[inline(always)]
    pub(in crate::render) fn bounce_counts(&self) -> Lanes<u32> {
        self.path_states.bounces.lanes(self.packet, 0)
    }

    /// Returns [`PathStatePacket::split`] of all lanes.
    #[inline(always)]
    pub(in crate::render) fn splits(&self) -> Lanes<u32> {
        self.path_states.split.lanes(self.packet, PathState::NONE.split)
    }

    /// Returns [`PathStatePacket::sample`] of all lanes.
    #[inline(always)]
    pub(in crate::render) fn samples(&self) -> Lanes<u32> {
        self.path_states.sample.lanes(self.packet, 0)
    }

    /// Returns [`PathStatePacket::wavelength`] of all lanes.
    #[inline(always)]
    pub(in crate::render) fn wavelengths(&self) -> Lanes<f32> {
        self.path_states.wavelength.lanes(self.packet, 0.0)
    }

    /// Returns [`PathStatePacket::time`] of all lanes.
    #[inline(always)]
    pub(in crate::render) fn times(&self) -> Lanes<f32> {
        self.path_states.time.lanes(self.packet, 0.0)
    }

    /// Returns the unit direction of lane `l`, before it is rounded to the f32 direction of the ray.
    pub(in crate::render) fn direction(&self, l: usize) -> DVec3 {
        self.path_states.direction.get(self.packet, l, DVec3::ZERO)
    }

    /// Returns the wavelength that lane `l` follows, in nanometres; 0 for all wavelengths.
    pub(in crate::render) fn wavelength(&self, l: usize) -> f32 {
        self.path_states.wavelength.get(self.packet, l, 0.0)
    }

    /// Returns the time of lane `l`; 0 if nothing moves.
    pub(in crate::render) fn time(&self, l: usize) -> f32 {
        self.path_states.time.get(self.packet, l, 0.0)
    }

    /// Returns the ray cone of lane `l`.
    pub(in crate::render) fn cone(&self, l: usize) -> RayCone {
        self.path_states.cone.get(self.packet, l, PathState::NONE.cone)
    }

    /// Returns the pixel sample that lane `l` belongs to.
    pub(in crate::render) fn sample(&self, l: usize) -> u32 {
        self.path_states.sample.get(self.packet, l, 0)
    }

    /// Returns the density of the rays into the lobe that the direction of lane `l` was sampled from.
    pub(in crate::render) fn density(&self, l: usize) -> f32 {
        self.path_states
            .density
            .get(self.packet, l, PathState::NONE.density)
    }

    /// Returns the number of rays that the lobes on the path of lane `l` split a sample into.
    pub(in crate::render) fn split(&self, l: usize) -> u32 {
        self.path_states.split.get(self.packet, l, PathState::NONE.split)
    }

    /// Returns the interiors around lane `l`.
    #[inline(always)]
    pub(in crate::render) fn media(&self, l: usize) -> InteriorStack {
        self.path_states.media.get(self.packet, l)
    }
}

/// Lane of a packet for the next ray.
#[derive(Clone, Copy)]
pub(in crate::render) struct FreeLane {
    pub(in crate::render) packet: usize,
    pub(in crate::render) lane: usize,
}

impl FreeLane {
    /// No lane of any packet.
    pub(in crate::render) const NONE: FreeLane = FreeLane {
        packet: 0,
        lane: LANES,
    };

    /// Returns the position of the lane among those of all packets.
    #[inline(always)]
    pub(in crate::render) fn index(self) -> usize {
        self.packet * LANES + self.lane
    }
}

/// Free lanes, given by [`FreeLane::index`], for those of `lanes` of another packet.
#[derive(Clone, Copy)]
struct LaneDestinations<'a> {
    free: &'a [usize],
    lanes: &'a [u8],
}

/// Array with one value per lane, or nothing if no effect needs it.
struct OptionalArray<T> {
    is_allocated: bool,
    packets: Vec<Lanes<T>>,
}

impl<T: Copy> OptionalArray<T> {
    fn new(is_allocated: bool) -> OptionalArray<T> {
        OptionalArray {
            is_allocated,
            packets: Vec::new(),
        }
    }

    fn resize(&mut self, packets: usize, value: T) {
        if self.is_allocated {
            self.packets.resize(packets, [value; LANES]);
        }
    }

    fn byte_count(&self) -> usize {
        self.packets.capacity() * size_of::<Lanes<T>>()
    }

    #[inline(always)]
    fn set(&mut self, packet: usize, l: usize, value: T) {
        if self.is_allocated {
            self.packets[packet][l] = value;
        }
    }

    #[inline(always)]
    fn set_lanes(&mut self, packet: usize, values: &Lanes<T>) {
        if self.is_allocated {
            self.packets[packet] = *values;
        }
    }

    /// Sets free lanes to the values of the lanes that they are for.
    #[inline(always)]
    fn fill(&mut self, places: LaneDestinations, values: impl FnOnce() -> Lanes<T>) {
        if !self.is_allocated {
            return;
        }
        let (lanes, values) = (self.packets.as_flattened_mut(), values());
        for (&place, &l) in places.free.iter().zip(places.lanes) {
            lanes[place] = values[usize::from(l) % LANES];
        }
    }

    #[inline(always)]
    fn lanes(&self, packet: usize, otherwise: T) -> Lanes<T> {
        if self.is_allocated {
            self.packets[packet]
        } else {
            [otherwise; LANES]
        }
    }

    #[inline(always)]
    fn get(&self, packet: usize, l: usize, otherwise: T) -> T {
        if self.is_allocated {
            self.packets[packet][l]
        } else {
            otherwise
        }
    }
}

/// Interiors around every lane: no array without refraction, one interior per lane where no two can overlap, a stack
/// otherwise.
pub(in crate::render) struct InteriorArray {
    single: OptionalArray<Option<NestedInterior>>,
    nested: OptionalArray<InteriorStack>,
}

impl InteriorArray {
    /// Returns empty arrays for these effects.
    pub(in crate::render) fn new(effects: EffectSet) -> InteriorArray {
        let nests = effects.has(Effect::NestedMedia);
        InteriorArray {
            single: OptionalArray::new(effects.has(Effect::Refraction) && !nests),
            nested: OptionalArray::new(effects.has(Effect::Refraction) && nests),
        }
    }

    /// Resizes the arrays to `packets` packets; new lanes are outside of all interiors.
    pub(in crate::render) fn resize(&mut self, packets: usize) {
        self.single.resize(packets, None);
        self.nested.resize(packets, InteriorStack::EMPTY);
    }

    /// Adds the bytes of the arrays.
    pub(in crate::render) fn add_to(&self, memory: &mut Memory) {
        let single = self.single.byte_count();
        memory.add(Effect::Refraction.name(), "the medium around each path", single);
        let nested = self.nested.byte_count();
        memory.add(Effect::NestedMedia.name(), "the media around each path", nested);
    }

    /// Sets the interiors of lane `l` of packet `packet`.
    #[inline(always)]
    pub(in crate::render) fn set(&mut self, packet: usize, l: usize, media: &InteriorStack) {
        if self.single.is_allocated {
            self.single.set(packet, l, media.current());
        }
        if self.nested.is_allocated {
            self.nested.set(packet, l, *media);
        }
    }

    /// Sets free lanes to the interiors of packet `from` of `others`, which have the same arrays.
    fn fill(&mut self, places: LaneDestinations, others: &InteriorArray, from: usize) {
        self.single.fill(places, || others.single.lanes(from, None));
        self.nested
            .fill(places, || others.nested.lanes(from, InteriorStack::EMPTY));
    }

    /// Returns the interiors around lane `l` of packet `packet`.
    #[inline(always)]
    pub(in crate::render) fn get(&self, packet: usize, l: usize) -> InteriorStack {
        match self.single.get(packet, l, None) {
            Some(body) => InteriorStack::of(body),
            None => self.nested.get(packet, l, InteriorStack::EMPTY),
        }
    }
}
