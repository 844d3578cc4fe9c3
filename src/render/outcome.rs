//! What shaded rays give: light on the film, feelers to lights, and the rays of the next generation.

use std::time::Instant;

use glam::Vec3;

use super::film::TileFilm;
use super::ledger::{Ledger, RayTally};
use super::losses::{Limit, TileLosses};
use super::queue::{Feelers, Generation, Paths, Sent};
use super::surface::Surfaces;
use super::texturing::Widths;
use super::travel::{Travel, TravelPacket};
use super::{Frame, shade};
use crate::accel::{NO_HIT, RayOrder, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::scene::Effect;

/// The working memory of one thread for what follows from hits.
pub(super) struct Outcome<'f, 's> {
    pub(super) frame: &'f Frame<'s>,
    pub(super) film: TileFilm,
    /// Column and row of the film's first pixel in the picture.
    pub(super) corner: [u32; 2],
    pub(super) feelers: Box<Feelers>,
    pub(super) next: Generation,
    /// Rays of `next` that went through a surface.
    pub(super) refracted: u64,
    pub(super) ledger: Ledger,
    pub(super) losses: TileLosses,
    /// Surfaces that feelers meet, in scenes where light goes through some.
    pub(super) sheets: Option<Box<Surfaces>>,
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
            corner: [0; 2],
            feelers: Feelers::new(frame.effects()),
            next: Generation::new(frame.effects(), frame.follows_widths()),
            refracted: 0,
            ledger: Ledger::default(),
            losses: TileLosses::default(),
            sheets: frame
                .effects()
                .has(Effect::TransparentShadow)
                .then(|| Box::new(Surfaces::new(frame.effects()))),
        }
    }

    pub(super) fn clear(&mut self) {
        self.film.clear();
        self.next.clear();
        self.refracted = 0;
        self.ledger = Ledger::default();
        self.losses.clear();
    }

    /// Adds what traced rays have met to the film, and sends out what follows from it.
    pub(super) fn shade_batch(
        &mut self,
        surfaces: &mut Surfaces,
        packets: &[RayPacket],
        paths: Paths,
        stage: Stage,
    ) {
        for (index, packet) in packets.iter().enumerate() {
            let (path, travels) = paths.at(index);
            let dimmed = travels
                .filter(|_| self.frame.effects().has(Effect::Absorption))
                .map(|travels| self.dimmed(packet, path, travels));
            let traced = Traced {
                packet,
                pixel: &path.pixel,
                weight: dimmed.as_ref().unwrap_or(&path.weight),
                travels,
            };
            let any_hit = packet.instance.iter().any(|&instance| instance != NO_HIT);
            if any_hit {
                self.frame.surfaces.meet(packet, self.widths(travels), surfaces);
                self.shade(&traced, surfaces, stage);
            } else if self.frame.effects().glows() {
                self.add_surroundings(&traced);
            }
        }
        self.answer_feelers(stage.order);
    }

    /// How wide the rays of a packet are.
    fn widths<'t>(&self, travels: Option<TravelPacket<'t>>) -> Widths<'t> {
        if !self.frame.effects().has(Effect::TextureFilter) {
            return Widths::None;
        }
        match travels {
            Some(travels) if self.frame.follows_widths() => Widths::Paths(travels),
            _ => Widths::Camera(self.frame.camera_cone),
        }
    }

    fn add_surroundings(&mut self, traced: &Traced) {
        let background = self.frame.background_seen(traced);
        let radiance = shade::surroundings(traced.packet, traced.weight, &background);
        self.film.add(traced.pixel, &radiance);
    }

    fn shade(&mut self, traced: &Traced, surfaces: &mut Surfaces, stage: Stage) {
        match traced.travels.filter(|_| self.frame.effects().has_sheets()) {
            None => self.shade_surfaces(traced, surfaces, stage),
            Some(travels) => {
                let present = self.pass_through(traced, travels, surfaces);
                let traced = Traced {
                    weight: &present,
                    ..*traced
                };
                self.shade_surfaces(&traced, surfaces, stage);
                if self.frame.effects().has(Effect::Refraction) {
                    self.cross_surfaces(&traced, travels, surfaces);
                }
            }
        }
    }

    fn shade_surfaces(&mut self, traced: &Traced, surfaces: &Surfaces, stage: Stage) {
        let frame = self.frame;
        let (points, materials) = (&surfaces.points, &surfaces.materials);
        if frame.effects().glows() {
            let background = frame.background_seen(traced);
            let light = shade::Uncaused {
                ambient: frame.ambient,
                background: &background,
            };
            let radiance = shade::glow(traced.packet, surfaces, traced.weight, &light);
            self.film.add(traced.pixel, &radiance);
        }
        let lit = shade::Lit {
            points,
            materials,
            weight: traced.weight,
        };
        let lights = frame.scene.lights.iter().zip(&frame.plan.casting);
        for (number, (light, &casts)) in lights.enumerate() {
            if frame.effects().has(Effect::AreaLight) && self.ask_area_light(number, traced, &lit, stage) {
                continue;
            }
            if self.feelers.is_full() {
                self.answer_feelers(stage.order);
            }
            let (packet, feeler) = self.feelers.next();
            if shade::feel(light, &lit, packet, &mut feeler.radiance) {
                self.keep_feelers(traced, casts);
            }
        }
        if frame.effects().has(Effect::Environment) {
            self.ask_surroundings(traced, &lit, stage);
        }
        if frame.effects().has(Effect::Reflection) {
            let mirrored = shade::reflection(&lit);
            self.reflect(surfaces, &mirrored, traced, stage);
        }
    }

    /// Queues the mirror rays that still matter. Surfaces that let light through send theirs elsewhere.
    fn reflect(&mut self, surfaces: &Surfaces, mirrored: &shade::Mirrored, traced: &Traced, stage: Stage) {
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
                travel: traced.travels.map(|travels| {
                    let arrival = travels.lane(l);
                    Travel {
                        depth: arrival.depth + 1,
                        direction: direction.as_dvec3().normalize(),
                        cone: self
                            .frame
                            .cone_at(traced, travels, l)
                            .reflected(self.frame.curvature(traced.packet, surfaces, l)),
                        ..arrival
                    }
                }),
            };
            self.send(&sent, stage.depth + 1);
        }
    }

    /// Queues a ray if it still matters; otherwise its weight is booked as lost. Returns whether it was queued.
    ///
    /// `steps` are those behind it, where the path itself does not count them.
    pub(super) fn send(&mut self, sent: &Sent, steps: u32) -> bool {
        let settings = &self.frame.settings;
        // Light of one wavelength may have negative weights.
        let largest = sent.weight.into_iter().map(f32::abs).fold(0.0, f32::max);
        if !(largest > 0.0) {
            return false;
        }
        let depth = match sent.travel {
            Some(travel) if self.frame.effects().has_sheets() => travel.depth,
            _ => steps,
        };
        if depth > settings.depth || largest < settings.weight_cutoff {
            let limit = if depth > settings.depth {
                Limit::Depth
            } else {
                Limit::Weight
            };
            self.ledger.lose(limit, largest);
            self.losses.add(sent.pixel, limit, largest);
            return false;
        }
        self.next.push(sent);
        true
    }

    /// Asks which of the waiting feelers reach their lights, and lets those lights in.
    pub(super) fn answer_feelers(&mut self, order: RayOrder) {
        if self.frame.effects().has(Effect::TransparentShadow) {
            return self.answer_through_sheets(order);
        }
        let (packets, feelers) = self.feelers.take();
        if packets.is_empty() {
            return;
        }
        let accel = self.frame.accel;
        let casts = self.frame.effects().has(Effect::Shadow);
        if casts {
            self.ledger.shadow += timed(packets, |packets| accel.occluded(packets, order));
        }
        for (packet, feeler) in packets.iter().zip(feelers) {
            if casts {
                shade::block(packet, &mut feeler.radiance);
            }
            self.film.add(&feeler.pixel, &feeler.radiance);
        }
    }
}

/// Runs a trace and books its active rays and its time.
#[inline(always)]
pub(super) fn timed(packets: &mut [RayPacket], trace: impl FnOnce(&mut [RayPacket])) -> RayTally {
    let rays: i32 = packets.iter().flat_map(|packet| &packet.active).sum();
    let start = Instant::now();
    trace(packets);
    RayTally {
        rays: u64::from(rays.unsigned_abs()),
        seconds: start.elapsed().as_secs_f64(),
    }
}
