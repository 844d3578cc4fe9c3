//! Shading stage of the wavefront: accumulates radiance on the film and queues shadow rays and secondary rays.

use std::cell::OnceCell;

use glam::Vec3;

use super::film::{Tile, TileFilm};
use super::first_hits::FirstHits;
use super::ledger::Account;
use super::light_layers::Source;
use super::losses::{Limit, TileLosses};
use super::meter::{Accounts, Meter, Moment};
use super::planes::TileLayer;
use super::queue::{Generation, Paths, Sent, ShadowQueue};
use super::surface::Surfaces;
use super::texturing::Widths;
use super::travel::{Travel, TravelPacket};
use super::volumes::Marches;
use super::{Frame, shade};
use crate::accel::{NO_HIT, RayOrder, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::scene::{Effect, EffectSet};

/// Shading state and working memory of one thread.
pub(super) struct Outcome<'f, 's> {
    pub(super) frame: &'f Frame<'s>,
    pub(super) film: TileFilm,
    /// First-hit AOVs, if layers are requested.
    pub(super) first_hits: Option<Box<FirstHits<'f, 's>>>,
    /// Column and row of the film's first pixel in the image.
    pub(super) corner: [u32; 2],
    pub(super) shadow_queue: Box<ShadowQueue>,
    /// Light that shadow rays are currently sampled from; not maintained in scenes with plain effects only.
    pub(super) asked: Source,
    pub(super) next: Generation,
    pub(super) meter: Meter,
    pub(super) losses: TileLosses,
    /// Surface interactions of shadow rays, in scenes with transparent shadows.
    pub(super) sheets: Option<Box<Surfaces>>,
    /// Ray-marching state, in scenes with volumes or fog.
    pub(super) marches: Option<Box<Marches<'s>>>,
}

/// Properties that all rays of a batch share.
#[derive(Clone, Copy)]
pub(super) struct Stage {
    pub(super) order: RayOrder,
    /// Number of bounces before these rays. In scenes where light goes through surfaces, each ray has its own depth
    /// instead.
    pub(super) depth: u32,
}

/// Traced packet with its pixels, weights and path states.
#[derive(Clone, Copy)]
pub(super) struct Traced<'a> {
    pub(super) packet: &'a RayPacket,
    pub(super) pixel: &'a Lanes<u32>,
    /// Path throughput at the hits, after absorption and scattering along the rays.
    pub(super) weight: &'a Lanes3<f32>,
    pub(super) travels: Option<TravelPacket<'a>>,
}

impl<'f, 's> Outcome<'f, 's> {
    pub(super) fn new(frame: &'f Frame<'s>, film: TileFilm) -> Outcome<'f, 's> {
        Outcome {
            frame,
            film,
            first_hits: FirstHits::of(frame),
            corner: [0; 2],
            shadow_queue: ShadowQueue::new(frame.effects()),
            asked: Source::Emission,
            next: Generation::new(frame.effects(), frame.follows_widths()).with_accounts(&frame.settings),
            meter: Meter::new(&frame.settings),
            losses: TileLosses::default(),
            sheets: frame
                .effects()
                .has(Effect::TransparentShadow)
                .then(|| Box::new(Surfaces::new(frame.effects()))),
            marches: frame.marches().then(|| Box::new(Marches::new(frame))),
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
        self.meter.lap(Account::Film);
        if let (Some(sheet), Some(costs)) = (&self.frame.costs, &self.meter.costs) {
            sheet.add(tile, costs);
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
    /// Functions with `PLAIN` serve scenes whose effects are all in [`EffectSet::PLAIN`]. All other effects are off
    /// there at compile time, so that a step that is not taken does not cost a test.
    #[inline(always)]
    pub(super) fn effects<const PLAIN: bool>(&self) -> EffectSet {
        let all = self.frame.effects();
        if PLAIN { all.within(EffectSet::PLAIN) } else { all }
    }

    /// Shades the hits and misses of traced packets: adds radiance to the film and queues shadow rays and secondary
    /// rays.
    pub(super) fn shade_batch(
        &mut self,
        surfaces: &mut Surfaces,
        packets: &[RayPacket],
        paths: Paths,
        stage: Stage,
    ) {
        // Layers of light need the general path, which records the source of all radiance.
        let divides_light = self.frame.light_sheet.is_wanted();
        if !divides_light && self.frame.effects().are_within(EffectSet::PLAIN) {
            self.shade_packets::<true>(surfaces, packets, paths, stage);
        } else {
            self.shade_packets::<false>(surfaces, packets, paths, stage);
        }
    }

    // Not inlined, so that neither variant suffers from the register pressure of the other.
    #[inline(never)]
    fn shade_packets<const PLAIN: bool>(
        &mut self,
        surfaces: &mut Surfaces,
        packets: &[RayPacket],
        paths: Paths,
        stage: Stage,
    ) {
        let effects = self.effects::<PLAIN>();
        let has_layers = stage.depth == 0 && self.first_hits.is_some();
        for (index, packet) in packets.iter().enumerate() {
            let (path, travels) = paths.at(index);
            let travels = travels.filter(|_| !PLAIN);
            let is_watched = self.meter.watch(&path.pixel, &packet.active);
            // Apply absorption and volumes along the rays
            let dimmed = travels
                .filter(|_| effects.has(Effect::Absorption))
                .map(|travels| self.dimmed(packet, path, travels));
            if dimmed.is_some() {
                self.meter.part(Account::Absorption);
            }
            let weight = dimmed.as_ref().unwrap_or(&path.weight);
            let marched = effects
                .has(Effect::Volume)
                .then(|| self.march(packet, (path, travels), weight, stage));
            let traced = Traced {
                packet,
                pixel: &path.pixel,
                weight: marched.as_ref().unwrap_or(weight),
                travels,
            };
            let any_hit = packet.instance.iter().any(|&instance| instance != NO_HIT);
            // Compute surface interactions, then shade them
            if any_hit {
                surfaces.texturing = if is_watched {
                    Moment::Wanted
                } else {
                    Moment::Unknown
                };
                let widths = self.widths::<PLAIN>(travels);
                self.frame.surfaces.meet(packet, widths, surfaces);
                self.book_meeting(surfaces);
                if has_layers {
                    self.note_first_hits(packet, &path.pixel, surfaces);
                }
                self.shade::<PLAIN>(effects, &traced, surfaces, stage);
            // Add background radiance if all rays missed
            } else if effects.glows() {
                self.add_surroundings(traced);
            }
            self.meter.leave();
        }
        // Trace the shadow rays that the batch queued
        self.trace_shadow_rays::<PLAIN>(stage.order);
    }

    #[cold]
    fn note_first_hits(&mut self, packet: &RayPacket, label: &Lanes<u32>, surfaces: &Surfaces) {
        if let Some(first_hits) = &mut self.first_hits {
            first_hits.add(packet, label, surfaces);
            self.meter.part(Account::Film);
        }
    }

    /// Books the time of surface interactions, and of textures if any were evaluated.
    fn book_meeting(&mut self, surfaces: &Surfaces) {
        match surfaces.texturing {
            Moment::Unknown => {}
            Moment::Wanted => self.meter.part(Account::Surface),
            Moment::Read(moment) => {
                self.meter.count_read();
                self.meter.part_until(Account::Surface, moment);
                self.meter.part(Account::Texture);
            }
        }
    }

    /// Returns the source of the ray cones of a packet.
    fn widths<'t, const PLAIN: bool>(&self, travels: Option<TravelPacket<'t>>) -> Widths<'t> {
        if !self.effects::<PLAIN>().has(Effect::TextureFilter) {
            return Widths::None;
        }
        match travels {
            Some(travels) if self.frame.follows_widths() => Widths::Paths(travels),
            _ => Widths::Camera(self.frame.camera_cone),
        }
    }

    // Not inlined, like other steps that only some scenes take, so that the loop over packets keeps its registers. By
    // value, so that `Traced` is written to memory only where such a step is taken.
    #[inline(never)]
    fn add_surroundings(&mut self, traced: Traced) {
        let background = self.frame.background_seen(&traced);
        let radiance = shade::surroundings(traced.packet, traced.weight, &background);
        self.meter.part(Account::Surroundings);
        self.film.add(traced.pixel, &radiance, Source::Emission);
        self.meter.part(Account::Film);
    }

    #[inline(always)]
    fn shade<const PLAIN: bool>(
        &mut self,
        effects: EffectSet,
        traced: &Traced,
        surfaces: &mut Surfaces,
        stage: Stage,
    ) {
        match traced.travels.filter(|_| !PLAIN && effects.has_sheets()) {
            None => self.shade_surfaces::<PLAIN>(effects, traced, surfaces, stage),
            Some(travels) => {
                // Apply alpha and hidden boundaries, then shade what remains
                let present = self.pass_through(traced, travels, surfaces);
                self.meter.part(Account::Refraction);
                let traced = Traced {
                    weight: &present,
                    ..*traced
                };
                self.shade_surfaces::<PLAIN>(effects, &traced, surfaces, stage);
                // Add reflected and refracted rays at dielectric boundaries
                if effects.has(Effect::Refraction) {
                    self.cross_surfaces(&traced, travels, surfaces);
                    self.meter.part(Account::Refraction);
                }
                if effects.has(Effect::RoughRefraction) {
                    self.cross_rough_surfaces(&traced, travels, surfaces, stage);
                    self.meter.part(Account::RoughRefraction);
                }
            }
        }
    }

    #[inline(always)]
    fn shade_surfaces<const PLAIN: bool>(
        &mut self,
        effects: EffectSet,
        traced: &Traced,
        surfaces: &Surfaces,
        stage: Stage,
    ) {
        // Add emission, ambient light and background
        if effects.glows() {
            self.add_glow(*traced, surfaces);
        }
        let without_seen_lobes = OnceCell::new();
        let lit = shade::Lit::of(traced, surfaces, &without_seen_lobes);
        // Add light scattered below the surface
        if effects.has(Effect::Subsurface) {
            self.add_scattered(traced, surfaces);
        }
        // Add direct lighting
        self.ask_lights::<PLAIN>(traced, &lit, stage);
        self.meter.part(Account::Lighting);
        // Spawn mirror rays and rays into GGX lobes
        if effects.has(Effect::Reflection) {
            self.reflect::<PLAIN>(*traced, surfaces, stage);
        }
        if effects.has(Effect::RoughReflection) {
            self.reflect_roughly(traced, surfaces, stage);
            self.meter.part(Account::RoughReflection);
        }
    }

    #[inline(never)]
    fn add_glow(&mut self, traced: Traced, surfaces: &Surfaces) {
        let background = self.frame.background_seen(&traced);
        let light = shade::Uncaused {
            ambient: self.frame.ambient,
            background: &background,
        };
        let radiance = shade::glow(traced.packet, surfaces, traced.weight, &light);
        self.meter.part(Account::Surroundings);
        self.film.add(traced.pixel, &radiance, Source::Emission);
        self.meter.part(Account::Film);
    }

    /// Samples direct light from all lights and from the environment map.
    pub(super) fn ask_lights<const PLAIN: bool>(&mut self, traced: &Traced, lit: &shade::Lit, stage: Stage) {
        let frame = self.frame;
        let effects = self.effects::<PLAIN>();
        let lights = frame.scene.lights.iter().zip(&frame.plan.casting);
        for (number, (light, &casts)) in lights.enumerate() {
            if !PLAIN {
                self.asked = Source::Light(number as u32);
            }
            // Sample area lights point by point
            if effects.has(Effect::AreaLight) && self.ask_area_light(number, traced, lit, stage) {
                continue;
            }
            // Trace the queued shadow rays if there is no room for more
            if self.shadow_queue.is_full() {
                self.meter.part(Account::Lighting);
                self.trace_shadow_rays::<PLAIN>(stage.order);
                self.meter.resume(traced.pixel, &traced.packet.active);
            }
            // Queue shadow rays to a punctual light
            let (packet, payload) = self.shadow_queue.next();
            if shade::sample_direct(light, lit, packet, &mut payload.radiance) {
                self.commit_shadow_rays::<PLAIN>(traced, casts);
            }
        }
        // Sample the environment map
        if effects.has(Effect::Environment) {
            self.asked = Source::Environment;
            self.ask_surroundings(traced, lit, stage);
        }
    }

    /// Queues mirror reflection rays that exceed the cut-off. Transmissive surfaces queue theirs in `cross_surfaces`.
    #[inline(never)]
    fn reflect<const PLAIN: bool>(&mut self, traced: Traced, surfaces: &Surfaces, stage: Stage) {
        let mirrored = shade::reflection(&shade::Lit::of(&traced, surfaces, &OnceCell::new()));
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
            let sent = Sent {
                ray: Ray::new(vector(&points.origin), direction),
                pixel: traced.pixel[l],
                weight,
                sender: Account::Reflection,
                // Extend the path state by the reflection
                travel: traced.travels.filter(|_| !PLAIN).map(|travels| {
                    let arrival = travels.lane(l);
                    Travel {
                        depth: arrival.depth + 1,
                        direction: direction.as_dvec3().normalize(),
                        cone: self
                            .frame
                            .cone_at(&traced, travels, l)
                            .reflected(self.frame.curvature(traced.packet, surfaces, l)),
                        ..arrival
                    }
                }),
            };
            self.send::<PLAIN>(&sent, stage.depth + 1);
        }
        self.meter.part(Account::Reflection);
    }

    /// Queues a ray if it is within the depth limit and the weight cut-off; otherwise records its weight as
    /// truncated.
    ///
    /// `steps` is the number of bounces including this one; it is used where the path itself does not count them.
    pub(super) fn send<const PLAIN: bool>(&mut self, sent: &Sent, steps: u32) {
        let settings = &self.frame.settings;
        // With dispersion, weights of a single wavelength may be negative.
        let largest = sent.weight.into_iter().map(f32::abs).fold(0.0, f32::max);
        // Drop rays that cannot contribute
        if !(largest > 0.0) {
            return;
        }
        let depth = match sent.travel {
            Some(travel) if self.effects::<PLAIN>().has_sheets() => travel.depth,
            _ => steps,
        };
        // Rays of one lobe carry small weights each; compare their sum with the cut-off.
        let together = sent.travel.filter(|_| !PLAIN).map_or(1, |travel| travel.split) as f32;
        // Terminate the path and record the lost weight
        if depth > settings.depth || together * largest < settings.weight_cutoff {
            let limit = if depth > settings.depth {
                Limit::Depth
            } else {
                Limit::Weight
            };
            self.meter.ledger.lose(limit, largest);
            self.losses.add(sent.pixel, limit, largest);
            return;
        }
        self.next.push(sent);
    }

    /// Traces the queued shadow rays and adds the radiance of unoccluded lights to the film.
    pub(super) fn trace_shadow_rays<const PLAIN: bool>(&mut self, order: RayOrder) {
        // Transparent shadows use nearest-hit queries instead
        self.meter.lap_shading();
        if self.effects::<PLAIN>().has(Effect::TransparentShadow) {
            return self.answer_through_sheets(order);
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
            let whose = |index: usize| (&payloads[index].pixel, Accounts::All(Account::Shadow));
            let traced = self
                .meter
                .trace(packets, whose, |packets| accel.occluded(packets, order));
            self.meter.ledger.book(Account::Shadow, traced);
        }
        // Attenuate unoccluded light by volumes and add it to the film
        for (index, (packet, payload)) in packets.iter().zip(payloads.iter_mut()).enumerate() {
            if casts {
                shade::block(packet, &mut payload.radiance);
            }
            if let Some(marches) = self.marches.as_mut().filter(|_| !PLAIN) {
                let samples = marches.dim(packet, &packet.t_far, &mut payload.radiance);
                self.meter.ledger.volume_samples += samples;
            }
            let source = if PLAIN { Source::Emission } else { sources[index] };
            self.film.add(&payload.pixel, &payload.radiance, source);
        }
        let lanes = (0..packets.len()).map(|index| (&payloads[index].pixel, &packets[index].active));
        self.meter.lap_over(Account::Film, lanes);
    }
}
