//! Shading stage of the wavefront: accumulates radiance on the film and queues shadow rays and secondary rays.

use std::cell::OnceCell;

use glam::Vec3;

use super::film::{Tile, TileFilm};
use super::first_hits::FirstHits;
use super::ledger::Category;
use super::light_layers::LightSource;
use super::losses::{TileTruncation, TruncationLimit};
use super::meter::{Accounts, Moment, Profiler};
use super::planes::TileLayer;
use super::queue::{Paths, RayQueue, RayWorkItem, ShadowQueue};
use super::surface::Surfaces;
use super::texturing::ConeSource;
use super::travel::{PathState, PathStatePacket};
use super::volumes::MarchState;
use super::{RenderContext, shade};
use crate::accel::{Coherence, NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::scene::{Effect, EffectSet};

/// Shading state and working memory of one thread.
pub(super) struct ShadingState<'f, 's> {
    pub(super) frame: &'f RenderContext<'s>,
    pub(super) film: TileFilm,
    /// First-hit AOVs, if layers are requested.
    pub(super) first_hits: Option<Box<FirstHits<'f, 's>>>,
    /// Column and row of the film's first pixel in the image.
    pub(super) corner: [u32; 2],
    pub(super) shadow_queue: Box<ShadowQueue>,
    /// Light that shadow rays are currently sampled from; not maintained in scenes with plain effects only.
    pub(super) current_source: LightSource,
    pub(super) next: RayQueue,
    pub(super) meter: Profiler,
    pub(super) losses: TileTruncation,
    /// Surface interactions of shadow rays, in scenes with transparent shadows.
    pub(super) shadow_surfaces: Option<Box<Surfaces>>,
    /// Ray-marching state, in scenes with volumes or fog.
    pub(super) marches: Option<Box<MarchState<'s>>>,
}

/// Properties that all rays of a batch share.
#[derive(Clone, Copy)]
pub(super) struct BatchInfo {
    pub(super) order: Coherence,
    /// Number of bounces before these rays. In scenes where light goes through surfaces, each ray has its own depth
    /// instead.
    pub(super) depth: u32,
}

/// Traced packet with its pixels, weights and path states.
#[derive(Clone, Copy)]
pub(super) struct TracedPacket<'a> {
    pub(super) packet: &'a RayPacket,
    pub(super) pixel: &'a Lanes<u32>,
    /// Path throughput at the hits, after absorption and scattering along the rays.
    pub(super) weight: &'a Lanes3<f32>,
    pub(super) path_states: Option<PathStatePacket<'a>>,
}

impl<'f, 's> ShadingState<'f, 's> {
    pub(super) fn new(frame: &'f RenderContext<'s>, film: TileFilm) -> ShadingState<'f, 's> {
        ShadingState {
            frame,
            film,
            first_hits: FirstHits::of(frame),
            corner: [0; 2],
            shadow_queue: ShadowQueue::new(frame.effects()),
            current_source: LightSource::Emission,
            next: RayQueue::new(frame.effects(), frame.tracks_cones()).with_accounts(&frame.settings),
            meter: Profiler::new(&frame.settings),
            losses: TileTruncation::default(),
            shadow_surfaces: frame
                .effects()
                .has(Effect::TransparentShadow)
                .then(|| Box::new(Surfaces::new(frame.effects()))),
            marches: frame.marches().then(|| Box::new(MarchState::new(frame))),
        }
    }

    pub(super) fn clear(&mut self) {
        self.film.clear();
        self.next.clear();
        self.losses.clear();
        if let Some(first_hits) = &mut self.first_hits {
            first_hits.clear();
        }
    }

    /// Books the film time at the end of a tile, and adds the tile's pixel costs to the cost image.
    pub(super) fn finish(&mut self, tile: Tile) {
        self.meter.lap(Category::Film);
        if let (Some(buffer), Some(costs)) = (&self.frame.costs, &self.meter.costs) {
            buffer.add(tile, costs);
        }
    }

    /// Returns the requested layers of a tile.
    pub(super) fn layers(&mut self, tile: Tile) -> Vec<TileLayer<'_>> {
        let first_hits = self.first_hits.as_mut();
        let mut layers = first_hits.map_or(Vec::new(), |first_hits| first_hits.layers(tile));
        if let Some(light) = self.film.light() {
            layers.extend(light.layers(self.frame.settings.spp));
        }
        layers
    }

    /// Returns the effects that are on.
    ///
    /// Functions with `BASIC` serve scenes whose effects are all in [`EffectSet::BASIC`]. All other effects are off
    /// there at compile time, so that a step that is not taken does not cost a test.
    #[inline(always)]
    pub(super) fn effects<const BASIC: bool>(&self) -> EffectSet {
        let all = self.frame.effects();
        if BASIC { all.within(EffectSet::BASIC) } else { all }
    }

    /// Shades the hits and misses of traced packets: adds radiance to the film and queues shadow rays and secondary
    /// rays.
    pub(super) fn shade_batch(
        &mut self,
        surfaces: &mut Surfaces,
        packets: &[RayPacket],
        paths: Paths,
        stage: BatchInfo,
    ) {
        // Layers of light need the general path, which records the source of all radiance.
        let divides_light = self.frame.light_sheet.is_wanted();
        if !divides_light && self.frame.effects().are_within(EffectSet::BASIC) {
            self.shade_packets::<true>(surfaces, packets, paths, stage);
        } else {
            self.shade_packets::<false>(surfaces, packets, paths, stage);
        }
    }

    // Not inlined, so that neither variant suffers from the register pressure of the other.
    #[inline(never)]
    fn shade_packets<const BASIC: bool>(
        &mut self,
        surfaces: &mut Surfaces,
        packets: &[RayPacket],
        paths: Paths,
        stage: BatchInfo,
    ) {
        let effects = self.effects::<BASIC>();
        let has_layers = stage.depth == 0 && self.first_hits.is_some();
        for (index, packet) in packets.iter().enumerate() {
            let (path, path_states) = paths.at(index);
            let path_states = path_states.filter(|_| !BASIC);
            let is_timed = self.meter.watch(&path.pixel, &packet.active);
            // Apply absorption and volumes along the rays
            let weight_after_absorption = path_states
                .filter(|_| effects.has(Effect::Absorption))
                .map(|path_states| self.weight_after_absorption(packet, path, path_states));
            if weight_after_absorption.is_some() {
                self.meter.part(Category::Absorption);
            }
            let weight = weight_after_absorption.as_ref().unwrap_or(&path.weight);
            let marched = effects
                .has(Effect::Volume)
                .then(|| self.march(packet, (path, path_states), weight, stage));
            let traced = TracedPacket {
                packet,
                pixel: &path.pixel,
                weight: marched.as_ref().unwrap_or(weight),
                path_states,
            };
            let any_hit = packet.instance.iter().any(|&instance| instance != NO_HIT);
            // Compute surface interactions, then shade them
            if any_hit {
                surfaces.texturing = if is_timed { Moment::Wanted } else { Moment::Unknown };
                let widths = self.widths::<BASIC>(path_states);
                self.frame.surfaces.compute_interactions(packet, widths, surfaces);
                self.book_interactions(surfaces);
                if has_layers {
                    self.note_first_hits(packet, &path.pixel, surfaces);
                }
                self.shade::<BASIC>(effects, &traced, surfaces, stage);
            // Add background radiance if all rays missed
            } else if effects.has_unlit_radiance() {
                self.add_background(traced);
            }
            self.meter.leave();
        }
        // Trace the shadow rays that the batch queued
        self.trace_shadow_rays::<BASIC>(stage.order);
    }

    #[cold]
    fn note_first_hits(&mut self, packet: &RayPacket, label: &Lanes<u32>, surfaces: &Surfaces) {
        if let Some(first_hits) = &mut self.first_hits {
            first_hits.add(packet, label, surfaces);
            self.meter.part(Category::Film);
        }
    }

    /// Books the time of surface interactions, and of textures if any were evaluated.
    fn book_interactions(&mut self, surfaces: &Surfaces) {
        match surfaces.texturing {
            Moment::Unknown => {}
            Moment::Wanted => self.meter.part(Category::Surface),
            Moment::Read(moment) => {
                self.meter.count_read();
                self.meter.part_until(Category::Surface, moment);
                self.meter.part(Category::Texture);
            }
        }
    }

    /// Returns the source of the ray cones of a packet.
    fn widths<'t, const BASIC: bool>(&self, path_states: Option<PathStatePacket<'t>>) -> ConeSource<'t> {
        if !self.effects::<BASIC>().has(Effect::TextureFilter) {
            return ConeSource::None;
        }
        match path_states {
            Some(path_states) if self.frame.tracks_cones() => ConeSource::Paths(path_states),
            _ => ConeSource::Camera(self.frame.camera_cone),
        }
    }

    // Not inlined, like other steps that only some scenes take, so that the loop over packets keeps its registers. By
    // value, so that `TracedPacket` is written to memory only where such a step is taken.
    #[inline(never)]
    fn add_background(&mut self, traced: TracedPacket) {
        let background = self.frame.background_along(&traced);
        let radiance = shade::background_radiance(traced.packet, traced.weight, &background);
        self.meter.part(Category::Surroundings);
        self.film.add(traced.pixel, &radiance, LightSource::Emission);
        self.meter.part(Category::Film);
    }

    #[inline(always)]
    fn shade<const BASIC: bool>(
        &mut self,
        effects: EffectSet,
        traced: &TracedPacket,
        surfaces: &mut Surfaces,
        stage: BatchInfo,
    ) {
        match traced
            .path_states
            .filter(|_| !BASIC && effects.has_transmission())
        {
            None => self.shade_surfaces::<BASIC>(effects, traced, surfaces, stage),
            Some(path_states) => {
                // Apply alpha and hidden boundaries, then shade what remains
                let present = self.apply_alpha(traced, path_states, surfaces);
                self.meter.part(Category::Refraction);
                let traced = TracedPacket {
                    weight: &present,
                    ..*traced
                };
                self.shade_surfaces::<BASIC>(effects, &traced, surfaces, stage);
                // Add reflected and refracted rays at dielectric boundaries
                if effects.has(Effect::Refraction) {
                    self.refract_rays(&traced, path_states, surfaces);
                    self.meter.part(Category::Refraction);
                }
                if effects.has(Effect::RoughRefraction) {
                    self.refract_rough_rays(&traced, path_states, surfaces, stage);
                    self.meter.part(Category::RoughRefraction);
                }
            }
        }
    }

    #[inline(always)]
    fn shade_surfaces<const BASIC: bool>(
        &mut self,
        effects: EffectSet,
        traced: &TracedPacket,
        surfaces: &Surfaces,
        stage: BatchInfo,
    ) {
        // Add emission, ambient light and background
        if effects.has_unlit_radiance() {
            self.add_emission(*traced, surfaces);
        }
        let without_sampled_lobes = OnceCell::new();
        let lit = shade::ShadingContext::of(traced, surfaces, &without_sampled_lobes);
        // Add light scattered below the surface
        if effects.has(Effect::Subsurface) {
            self.add_scattered(traced, surfaces);
        }
        // Add direct lighting
        self.sample_lights::<BASIC>(traced, &lit, stage);
        self.meter.part(Category::Lighting);
        // Spawn mirror rays and rays into GGX lobes
        if effects.has(Effect::Reflection) {
            self.reflect::<BASIC>(*traced, surfaces, stage);
        }
        if effects.has(Effect::RoughReflection) {
            self.reflect_roughly(traced, surfaces, stage);
            self.meter.part(Category::RoughReflection);
        }
    }

    #[inline(never)]
    fn add_emission(&mut self, traced: TracedPacket, surfaces: &Surfaces) {
        let background = self.frame.background_along(&traced);
        let light = shade::AmbientTerms {
            ambient: self.frame.ambient,
            background: &background,
        };
        let radiance = shade::emitted_radiance(traced.packet, surfaces, traced.weight, &light);
        self.meter.part(Category::Surroundings);
        self.film.add(traced.pixel, &radiance, LightSource::Emission);
        self.meter.part(Category::Film);
    }

    /// Samples direct light from all lights and from the environment map.
    pub(super) fn sample_lights<const BASIC: bool>(
        &mut self,
        traced: &TracedPacket,
        lit: &shade::ShadingContext,
        stage: BatchInfo,
    ) {
        let frame = self.frame;
        let effects = self.effects::<BASIC>();
        let lights = frame.scene.lights.iter().zip(&frame.plan.casts_shadows);
        for (number, (light, &casts)) in lights.enumerate() {
            if !BASIC {
                self.current_source = LightSource::Light(number as u32);
            }
            // Sample area lights point by point
            if effects.has(Effect::AreaLight) && self.queue_area_light(number, traced, lit, stage) {
                continue;
            }
            // Trace the queued shadow rays if there is no room for more
            if self.shadow_queue.is_full() {
                self.meter.part(Category::Lighting);
                self.trace_shadow_rays::<BASIC>(stage.order);
                self.meter.resume(traced.pixel, &traced.packet.active);
            }
            // Queue shadow rays to a punctual light
            let (packet, payload) = self.shadow_queue.next();
            if shade::sample_direct(light, lit, packet, &mut payload.radiance) {
                self.commit_shadow_rays::<BASIC>(traced, casts);
            }
        }
        // Sample the environment map
        if effects.has(Effect::Environment) {
            self.current_source = LightSource::Environment;
            self.sample_environment(traced, lit, stage);
        }
    }

    /// Queues mirror reflection rays that exceed the cut-off. Transmissive surfaces queue theirs in `refract_rays`.
    #[inline(never)]
    fn reflect<const BASIC: bool>(&mut self, traced: TracedPacket, surfaces: &Surfaces, stage: BatchInfo) {
        let mirrored = shade::reflection(&shade::ShadingContext::of(&traced, surfaces, &OnceCell::new()));
        let points = &surfaces.points;
        // Spawn the reflected ray of each lane
        for l in 0..LANES {
            let weight: [f32; 3] = std::array::from_fn(|channel| mirrored.weight[channel][l]);
            // Skip lanes without a mirror ray above the surface
            if !(points.hit[l] && mirrored.leaves[l]) {
                continue;
            }
            let vector = |v: &Lanes3<f32>| Vec3::new(v[0][l], v[1][l], v[2][l]);
            let direction = vector(&mirrored.direction);
            let sent = RayWorkItem {
                ray: Ray::new(vector(&points.origin), direction),
                pixel: traced.pixel[l],
                weight,
                sender: Category::Reflection,
                // Extend the path state by the reflection
                travel: traced.path_states.filter(|_| !BASIC).map(|path_states| {
                    let arrival = path_states.lane(l);
                    PathState {
                        depth: arrival.depth + 1,
                        direction: direction.as_dvec3().normalize(),
                        cone: self
                            .frame
                            .cone_at(&traced, path_states, l)
                            .reflected(self.frame.curvature(traced.packet, surfaces, l)),
                        ..arrival
                    }
                }),
            };
            self.send::<BASIC>(&sent, stage.depth + 1);
        }
        self.meter.part(Category::Reflection);
    }

    /// Queues a ray if it is within the depth limit and the weight cut-off; otherwise records its weight as
    /// truncated.
    ///
    /// `steps` is the number of bounces including this one; it is used where the path itself does not count them.
    pub(super) fn send<const BASIC: bool>(&mut self, sent: &RayWorkItem, steps: u32) {
        let settings = &self.frame.settings;
        // With dispersion, weights of a single wavelength may be negative.
        let largest = sent.weight.into_iter().map(f32::abs).fold(0.0, f32::max);
        // Drop rays that cannot contribute
        if !(largest > 0.0) {
            return;
        }
        let depth = match sent.travel {
            Some(travel) if self.effects::<BASIC>().has_transmission() => travel.depth,
            _ => steps,
        };
        // Rays of one lobe carry small weights each; compare their sum with the cut-off.
        let together = sent.travel.filter(|_| !BASIC).map_or(1, |travel| travel.split) as f32;
        // Terminate the path and record the lost weight
        if depth > settings.depth || together * largest < settings.weight_cutoff {
            let limit = if depth > settings.depth {
                TruncationLimit::Depth
            } else {
                TruncationLimit::Weight
            };
            self.meter.ledger.lose(limit, largest);
            self.losses.add(sent.pixel, limit, largest);
            return;
        }
        self.next.push(sent);
    }

    /// Traces the queued shadow rays and adds the radiance of unoccluded lights to the film.
    pub(super) fn trace_shadow_rays<const BASIC: bool>(&mut self, order: Coherence) {
        // Transparent shadows use nearest-hit queries instead
        self.meter.lap_shading();
        if self.effects::<BASIC>().has(Effect::TransparentShadow) {
            return self.trace_transparent_shadow_rays(order);
        }
        let sources = self.shadow_queue.sources();
        let (packets, payloads) = self.shadow_queue.drain();
        if packets.is_empty() {
            return;
        }
        // Test shadow rays for occlusion
        let accel = self.frame.accel;
        let casts = self.frame.effects().has(Effect::Shadow);
        if casts {
            let labels_and_accounts =
                |index: usize| (&payloads[index].pixel, Accounts::All(Category::Shadow));
            let traced = self.meter.trace(packets, labels_and_accounts, |packets| {
                accel.occluded(packets, order)
            });
            self.meter.ledger.book(Category::Shadow, traced);
        }
        // Attenuate unoccluded light by volumes and add it to the film
        for (index, (packet, payload)) in packets.iter().zip(payloads.iter_mut()).enumerate() {
            if casts {
                shade::block(packet, &mut payload.radiance);
            }
            if let Some(marches) = self.marches.as_mut().filter(|_| !BASIC) {
                let samples = marches.attenuate(packet, &packet.t_far, &mut payload.radiance);
                self.meter.ledger.volume_samples += samples;
            }
            let source = if BASIC {
                LightSource::Emission
            } else {
                sources[index]
            };
            self.film.add(&payload.pixel, &payload.radiance, source);
        }
        let lanes = (0..packets.len()).map(|index| (&payloads[index].pixel, &packets[index].active));
        self.meter.lap_over(Category::Film, lanes);
    }
}
