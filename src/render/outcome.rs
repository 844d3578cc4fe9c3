//! What shaded rays give: light on the film, shadow rays to lights, and the rays of the next generation.

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

/// The working memory of one thread for what follows from hits.
pub(super) struct Outcome<'f, 's> {
    pub(super) frame: &'f Frame<'s>,
    pub(super) film: TileFilm,
    /// Where layers are wanted.
    pub(super) first_hits: Option<Box<FirstHits<'f, 's>>>,
    /// Column and row of the film's first pixel in the picture.
    pub(super) corner: [u32; 2],
    pub(super) shadow_queue: Box<ShadowQueue>,
    /// Which light is being asked; not kept in scenes with plain effects only.
    pub(super) asked: Source,
    pub(super) next: Generation,
    pub(super) meter: Meter,
    pub(super) losses: TileLosses,
    /// Surfaces that shadow rays meet, in scenes where light goes through some.
    pub(super) sheets: Option<Box<Surfaces>>,
    /// In scenes with volumes or fog.
    pub(super) marches: Option<Box<Marches<'s>>>,
}

/// What the rays of a batch have in common.
#[derive(Clone, Copy)]
pub(super) struct Stage {
    pub(super) order: RayOrder,
    /// Steps behind them. In scenes where light goes through surfaces each ray has its own depth.
    pub(super) depth: u32,
}

/// A traced packet with what it is for.
#[derive(Clone, Copy)]
pub(super) struct Traced<'a> {
    pub(super) packet: &'a RayPacket,
    pub(super) pixel: &'a Lanes<u32>,
    /// Weights at the surfaces: what the way there swallowed is taken off.
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

    /// Books the end of a tile.
    pub(super) fn finish(&mut self, tile: Tile) {
        self.meter.lap(Account::Film);
        if let (Some(sheet), Some(costs)) = (&self.frame.costs, &self.meter.costs) {
            sheet.add(tile, costs);
        }
    }

    /// The layers of a tile that are wanted.
    pub(super) fn layers(&mut self, tile: Tile) -> Vec<TileLayer<'_>> {
        let first_hits = self.first_hits.as_mut();
        let mut layers = first_hits.map_or(Vec::new(), |first_hits| first_hits.layers(tile));
        if let Some(light) = self.film.light() {
            layers.extend(light.layers(self.frame.settings.spp));
        }
        layers
    }

    /// The effects that are on.
    ///
    /// Functions with `PLAIN` serve scenes in which none but [`EffectSet::PLAIN`] are. All others are off there at
    /// compile time, so that a step that is not taken does not even cost the question.
    #[inline(always)]
    pub(super) fn effects<const PLAIN: bool>(&self) -> EffectSet {
        let all = self.frame.effects();
        if PLAIN { all.within(EffectSet::PLAIN) } else { all }
    }

    /// Adds what traced rays have met to the film, and sends out what follows from it.
    pub(super) fn shade_batch(
        &mut self,
        surfaces: &mut Surfaces,
        packets: &[RayPacket],
        paths: Paths,
        stage: Stage,
    ) {
        // Whoever wants to know whose light it is takes the way that keeps it.
        let divides_light = self.frame.light_sheet.is_wanted();
        if !divides_light && self.frame.effects().are_within(EffectSet::PLAIN) {
            self.shade_packets::<true>(surfaces, packets, paths, stage);
        } else {
            self.shade_packets::<false>(surfaces, packets, paths, stage);
        }
    }

    // Out of line, so that neither is the worse for the other's need of registers.
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
            } else if effects.glows() {
                self.add_surroundings(traced);
            }
            self.meter.leave();
        }
        self.trace_shadow_rays::<PLAIN>(stage.order);
    }

    #[cold]
    fn note_first_hits(&mut self, packet: &RayPacket, label: &Lanes<u32>, surfaces: &Surfaces) {
        if let Some(first_hits) = &mut self.first_hits {
            first_hits.add(packet, label, surfaces);
            self.meter.part(Account::Film);
        }
    }

    /// Books the time of points and materials, and of textures if there were any.
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

    /// How wide the rays of a packet are.
    fn widths<'t, const PLAIN: bool>(&self, travels: Option<TravelPacket<'t>>) -> Widths<'t> {
        if !self.effects::<PLAIN>().has(Effect::TextureFilter) {
            return Widths::None;
        }
        match travels {
            Some(travels) if self.frame.follows_widths() => Widths::Paths(travels),
            _ => Widths::Camera(self.frame.camera_cone),
        }
    }

    // Out of line, as other steps that not all scenes take: the loop over packets keeps its registers. By value, so that
    // `Traced` is written to memory only where such a step is taken.
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
                let present = self.pass_through(traced, travels, surfaces);
                self.meter.part(Account::Refraction);
                let traced = Traced {
                    weight: &present,
                    ..*traced
                };
                self.shade_surfaces::<PLAIN>(effects, &traced, surfaces, stage);
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
        if effects.glows() {
            self.add_glow(*traced, surfaces);
        }
        let without_seen_lobes = OnceCell::new();
        let lit = shade::Lit::of(traced, surfaces, &without_seen_lobes);
        if effects.has(Effect::Subsurface) {
            self.add_scattered(traced, surfaces);
        }
        self.ask_lights::<PLAIN>(traced, &lit, stage);
        self.meter.part(Account::Lighting);
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

    /// Sends shadow rays to all lights.
    pub(super) fn ask_lights<const PLAIN: bool>(&mut self, traced: &Traced, lit: &shade::Lit, stage: Stage) {
        let frame = self.frame;
        let effects = self.effects::<PLAIN>();
        let lights = frame.scene.lights.iter().zip(&frame.plan.casting);
        for (number, (light, &casts)) in lights.enumerate() {
            if !PLAIN {
                self.asked = Source::Light(number as u32);
            }
            if effects.has(Effect::AreaLight) && self.ask_area_light(number, traced, lit, stage) {
                continue;
            }
            if self.shadow_queue.is_full() {
                self.meter.part(Account::Lighting);
                self.trace_shadow_rays::<PLAIN>(stage.order);
                self.meter.resume(traced.pixel, &traced.packet.active);
            }
            let (packet, payload) = self.shadow_queue.next();
            if shade::sample_direct(light, lit, packet, &mut payload.radiance) {
                self.commit_shadow_rays::<PLAIN>(traced, casts);
            }
        }
        if effects.has(Effect::Environment) {
            self.asked = Source::Environment;
            self.ask_surroundings(traced, lit, stage);
        }
    }

    /// Queues the mirror rays that still matter. Surfaces that let light through send theirs elsewhere.
    #[inline(never)]
    fn reflect<const PLAIN: bool>(&mut self, traced: Traced, surfaces: &Surfaces, stage: Stage) {
        let mirrored = shade::reflection(&shade::Lit::of(&traced, surfaces, &OnceCell::new()));
        let points = &surfaces.points;
        for l in 0..LANES {
            let weight: [f32; 3] = std::array::from_fn(|channel| mirrored.weight[channel][l]);
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

    /// Queues a ray if it still matters; otherwise its weight is booked as lost.
    ///
    /// `steps` are those behind it, where the path itself does not count them.
    pub(super) fn send<const PLAIN: bool>(&mut self, sent: &Sent, steps: u32) {
        let settings = &self.frame.settings;
        // Light of one wavelength may have negative weights.
        let largest = sent.weight.into_iter().map(f32::abs).fold(0.0, f32::max);
        if !(largest > 0.0) {
            return;
        }
        let depth = match sent.travel {
            Some(travel) if self.effects::<PLAIN>().has_sheets() => travel.depth,
            _ => steps,
        };
        // Rays into one lobe weigh little each, and together what counts.
        let together = sent.travel.filter(|_| !PLAIN).map_or(1, |travel| travel.split) as f32;
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

    /// Asks which of the waiting shadow rays reach their lights, and lets those lights in.
    pub(super) fn trace_shadow_rays<const PLAIN: bool>(&mut self, order: RayOrder) {
        self.meter.lap_shading();
        if self.effects::<PLAIN>().has(Effect::TransparentShadow) {
            return self.answer_through_sheets(order);
        }
        let sources = self.shadow_queue.sources();
        let (packets, payloads) = self.shadow_queue.drain();
        if packets.is_empty() {
            return;
        }
        let accel = self.frame.accel;
        let casts = self.frame.effects().has(Effect::Shadow);
        if casts {
            let whose = |index: usize| (&payloads[index].pixel, Accounts::All(Account::Shadow));
            let traced = self
                .meter
                .trace(packets, whose, |packets| accel.occluded(packets, order));
            self.meter.ledger.book(Account::Shadow, traced);
        }
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
