//! Irradiance pass: the light that enters an object at its points, computed with the shadow rays of surfaces.
//!
//! Each point becomes a hit seen along its normal, and a film with the pixels of one tile collects the irradiance.
//! Points therefore use the same code as camera hits, and random points on lights are numbered by position and not by
//! thread.

use std::sync::{Mutex, PoisonError};

use super::super::context::RenderContext;
use super::super::film::TileFilm;
use super::super::lighting::{LobeVariants, ShadingContext};
use super::super::monitor::{Cancelled, Monitor};
use super::super::profile::RenderProfile;
use super::super::surface::{ConeSource, Surfaces};
use super::super::tile::{TILE, Tile};
use super::super::wavefront::{BatchInfo, PathStates, ShadingState, TracedPacket};
use super::points::{IrradiancePoint, IrradiancePoints};
use crate::accel::{Coherence, Hit, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::optics::subsurface::diffuse_transmittance;
use crate::parallel;
use crate::shading::MaterialPacket;

/// Number of points whose irradiance is computed together: one for each pixel of a tile.
const CHUNK: usize = (TILE * TILE) as usize;

/// Number of tiles per row of the virtual image that numbers the points.
const TILES_A_ROW: usize = 1 << 10;

/// Limit of irradiance such that no sum over all points exceeds the range of f32: 2^21 points make 2 10^30, which
/// leaves 10^8 for the factors of areas and dipoles.
const MAX_IRRADIANCE: f64 = 1e24;

/// Throughput of 1 in every lane.
const ALL: Lanes3<f32> = [[1.0; LANES]; 3];

impl RenderContext<'_> {
    /// Returns the irradiance that enters an object at each of its points. `before` is the number of points of
    /// objects before it.
    pub(super) fn receive(
        &self,
        irradiance_points: &IrradiancePoints,
        before: usize,
        monitor: &Monitor,
    ) -> Result<(Vec<[f32; 3]>, RenderProfile), Cancelled> {
        // Each object before this one may have left its last chunk partly empty.
        let first = before.div_ceil(CHUNK) + irradiance_points.instance as usize;
        let idle: Mutex<Vec<Receiver>> = Mutex::default();
        let idle = || idle.lock().unwrap_or_else(PoisonError::into_inner);
        // Process chunks in parallel with pooled working memory
        let chunks = parallel::map_chunks(&irradiance_points.points, CHUNK, &|chunk, points| {
            monitor.check()?;
            let kept = idle().pop();
            let mut receiver = kept.unwrap_or_else(|| Receiver::new(self, irradiance_points));
            let received = receiver.receive(points, first + chunk);
            idle().push(receiver);
            Ok(received)
        });
        // Join the chunks in order
        let mut ledger = RenderProfile::default();
        let mut irradiance = Vec::with_capacity(irradiance_points.points.len());
        for received in chunks {
            let (of_chunk, taken) = received?;
            irradiance.extend(of_chunk);
            ledger += taken;
        }
        Ok((irradiance, ledger))
    }
}

/// Working memory of one thread for the irradiance pass.
struct Receiver<'f, 's> {
    frame: &'f RenderContext<'s>,
    irradiance_points: &'f IrradiancePoints,
    surfaces: Box<Surfaces>,
    outcome: ShadingState<'f, 's>,
    /// Material that returns the transmitted irradiance.
    entrance: MaterialPacket,
    /// Path states at the points, outside of all interiors.
    path_states: PathStates,
    /// Irradiance of the ambient light, linear RGB.
    ambient: [f64; 3],
}

impl<'f, 's> Receiver<'f, 's> {
    fn new(frame: &'f RenderContext<'s>, irradiance_points: &'f IrradiancePoints) -> Receiver<'f, 's> {
        let mut path_states = PathStates::new(frame.effects(), frame.combined.is_any());
        path_states.resize(1);
        let eta = irradiance_points.scattering.eta;
        let even = std::f64::consts::PI * diffuse_transmittance(eta);
        Receiver {
            frame,
            irradiance_points,
            surfaces: Box::new(Surfaces::new(frame.effects())),
            outcome: ShadingState::new(frame, TileFilm::new(None)),
            entrance: MaterialPacket {
                effects: frame.effects(),
                entry_ior: Some(eta as f32),
                ..MaterialPacket::BLACK
            },
            path_states,
            ambient: frame.ambient.map(|channel| even * f64::from(channel)),
        }
    }

    /// Returns the irradiance that enters at the points of a chunk.
    fn receive(&mut self, points: &[IrradiancePoint], chunk: usize) -> (Vec<[f32; 3]>, RenderProfile) {
        let stage = BatchInfo {
            order: Coherence::Incoherent,
            depth: 0,
            is_behind_bounce: false,
        };
        // Give the chunk a tile of the virtual image
        let corner = [chunk % TILES_A_ROW, chunk / TILES_A_ROW].map(|tile| tile as u32 * TILE);
        self.outcome.meter.begin(Tile {
            x: corner[0],
            y: corner[1],
            width: TILE,
            height: TILE,
        });
        self.outcome.clear();
        self.outcome.corner = corner;
        let variants = LobeVariants::default();
        // Turn sixteen points at a time into hits and sample all lights
        for (number, points) in points.chunks(LANES).enumerate() {
            let (packet, pixel) = self.seen(points, number * LANES);
            self.frame
                .surfaces
                .compute_interactions(&packet, ConeSource::None, &mut self.surfaces);
            let traced = TracedPacket {
                packet: &packet,
                pixel: &pixel,
                weight: &ALL,
                path_states: Some(self.path_states.at(0)),
            };
            let lit = ShadingContext {
                points: &self.surfaces.points,
                materials: &self.entrance,
                weight: &ALL,
                variants: &variants,
            };
            self.outcome.sample_lights::<false>(&traced, &lit, stage);
        }
        // Trace the remaining shadow rays and read the film
        self.outcome.trace_shadow_rays::<false>(stage.order);
        let sums = &self.outcome.film.sums()[..points.len()];
        let total = |sum: &[f64; 3]| {
            let channel = |c: usize| match sum[c] + self.ambient[c] {
                light if light > 0.0 => light.min(MAX_IRRADIANCE) as f32,
                // NaN counts as zero.
                _ => 0.0,
            };
            [channel(0), channel(1), channel(2)]
        };
        (sums.iter().map(total).collect(), self.outcome.meter.ledger)
    }

    /// Returns a packet of up to sixteen points as hits, with their pixels from `first` on.
    fn seen(&self, points: &[IrradiancePoint], first: usize) -> (RayPacket, Lanes<u32>) {
        let mut packet = RayPacket::EMPTY;
        let mut pixel = [first as u32; LANES];
        let distance = self.irradiance_points.spacing;
        for (l, point) in points.iter().enumerate() {
            pixel[l] = (first + l) as u32;
            let origin = (point.position + distance * point.normal).as_vec3();
            packet.set(l, &Ray::new(origin, -point.normal.as_vec3()));
            packet.set_hit(
                l,
                &Hit {
                    t: distance as f32,
                    u: point.uv[0] as f32,
                    v: point.uv[1] as f32,
                    instance: self.irradiance_points.instance,
                    primitive: point.triangle,
                },
            );
        }
        (packet, pixel)
    }
}
