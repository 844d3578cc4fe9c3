//! Tracing of photons through mirrors and refracting bodies to the first diffuse surface behind them.
//!
//! Photons are traced as waves of rays whose paths continue at random ([`ShadingState::send_behind_bounce`]): where light
//! is divided between reflection and refraction, weak parts go on with a probability, so that photons do not multiply.

use std::time::Instant;

use super::super::context::RenderContext;
use super::super::film::TileFilm;
use super::super::monitor::{Cancelled, Monitor};
use super::super::profile::{Accounts, Category, RenderProfile, Tally};
use super::super::sampler::{Purpose, number_packet};
use super::super::surface::{ConeSource, Surfaces};
use super::super::tile::{TILE, Tile};
use super::super::wavefront::{BatchInfo, PathState, RayQueue, RayWorkItem, ShadingState, TracedPacket};
use super::emission::{EmittedPhoton, emit};
use super::photon_kernel::PhotonOrigin;
use super::photon_map::PhotonMap;
use super::photon_tree::Photon;
use super::source::{CausticTarget, PhotonSource, targets};
use crate::accel::{BATCH, Coherence, RayPacket};
use crate::numeric::LANES;
use crate::parallel;
use crate::scene::Effect;

/// Number of photons that are traced together: one for each pixel of a tile, which numbers it.
const CHUNK: u32 = TILE * TILE;
/// Number of tiles per row of the virtual image that numbers the photons.
const TILES_A_ROW: u32 = 1 << 10;
/// Largest number of reflections and refractions of a photon.
const MAX_STEPS: u32 = 1024;
/// Weight from which on photons always go on: few are lost to chance where light is divided between a strong part and a weak
/// one.
const KEPT_WEIGHT: f32 = 0.125;
/// Largest radius of a photon's disc, as a part of the largest target's radius.
const MAX_DISC: f64 = 0.25;

impl RenderContext<'_> {
    /// Emits photons and builds the photon map, if the effect is on, and returns the ledger.
    pub(in crate::render) fn emit_photons(&mut self, monitor: &Monitor) -> Result<RenderProfile, Cancelled> {
        if !self.effects().has(Effect::Caustics) {
            return Ok(RenderProfile::default());
        }
        // Trace the photons
        let start = Instant::now();
        let settings = self.scene.caustics.unwrap_or_default();
        let targets = targets(self.scene);
        let (stored, taken) = self.traced_photons(&targets, settings.photons, monitor)?;
        // Build the map, with discs that are small beside the objects
        let largest = targets.iter().map(|target| target.radius).fold(0.0, f64::max);
        let max_radius = (MAX_DISC * largest) as f32;
        let has_photons = !stored.photons.is_empty() && max_radius > 0.0;
        self.photons = has_photons.then(|| {
            PhotonMap::new(
                &stored.photons,
                &stored.origins,
                settings.neighbours as usize,
                max_radius,
            )
        });
        // Book the whole time under one account
        let threads = rayon::current_num_threads() as f64;
        let seconds = if self.settings.ledger {
            threads * start.elapsed().as_secs_f64()
        } else {
            0.0
        };
        Ok(taken.gathered(Category::Caustics, seconds))
    }

    /// Returns the photons that reach diffuse surfaces with their origins, in the order of their numbers.
    fn traced_photons(
        &self,
        targets: &[CausticTarget],
        count: u32,
        monitor: &Monitor,
    ) -> Result<(StoredPhotons, RenderProfile), Cancelled> {
        let sources = self.photon_sources(targets, count);
        // Divide the photons of each light into chunks
        let chunks_of = |source: &PhotonSource| source.count.div_ceil(CHUNK);
        let chunks: Vec<(usize, u32)> = sources
            .iter()
            .enumerate()
            .flat_map(|(index, source)| (0..chunks_of(source)).map(move |chunk| (index, chunk)))
            .collect();
        let far = self.extent_of(targets);
        // Trace the chunks in parallel
        let traced = parallel::map(chunks.len(), &|number| {
            monitor.check()?;
            let (index, chunk) = chunks[number];
            let mut tracer = PhotonTracer::new(self, &sources[index], number as u32);
            Ok(tracer.trace((targets, far), chunk))
        });
        // Join them in order
        let mut stored = StoredPhotons::default();
        let mut ledger = RenderProfile::default();
        let probes = Tally {
            rays: sources.iter().map(|source| source.probes).sum(),
            ..Tally::default()
        };
        ledger.book(Category::Caustics, probes);
        for chunk in traced {
            let (of_chunk, taken) = chunk?;
            stored.photons.extend(of_chunk.photons);
            stored.origins.extend(of_chunk.origins);
            ledger += taken;
        }
        Ok((stored, ledger))
    }

    /// Returns a distance from each target beyond which there is nothing but infinite planes.
    fn extent_of(&self, targets: &[CausticTarget]) -> f64 {
        // Take the farthest end of any object from any target
        let mut far = 1.0f64;
        for instance in &self.scene.instances {
            let geometry = &self.scene.geometries[instance.geometry as usize];
            let bounds = instance.world_bounds(geometry, &geometry.bounds());
            let radius = 0.5 * bounds.extent().length();
            if radius < f64::INFINITY {
                let reach = targets
                    .iter()
                    .map(|target| target.center.distance(bounds.center()));
                far = far.max(reach.fold(0.0, f64::max) + radius);
            }
        }
        far
    }
}

/// Photons on diffuse surfaces, and as many origins; area lights have none.
#[derive(Default)]
struct StoredPhotons {
    photons: Vec<Photon>,
    origins: Vec<Option<PhotonOrigin>>,
}

/// Working memory for the photons of one chunk.
struct PhotonTracer<'f, 's> {
    frame: &'f RenderContext<'s>,
    source: &'f PhotonSource<'f, 's>,
    current: RayQueue,
    surfaces: Box<Surfaces>,
    outcome: ShadingState<'f, 's>,
    /// Photons of the chunk as they leave the light; without power where there is none.
    emitted: Vec<EmittedPhoton>,
    stored: StoredPhotons,
}

impl<'f, 's> PhotonTracer<'f, 's> {
    /// Returns a tracer for chunk `number` of all chunks.
    fn new(
        frame: &'f RenderContext<'s>,
        source: &'f PhotonSource<'f, 's>,
        number: u32,
    ) -> PhotonTracer<'f, 's> {
        let mut outcome = ShadingState::new(frame, TileFilm::new(None));
        // Number the photons by the pixels of a virtual image
        let corner = [number % TILES_A_ROW, number / TILES_A_ROW].map(|tile| tile * TILE);
        outcome.meter.begin(Tile {
            x: corner[0],
            y: corner[1],
            width: TILE,
            height: TILE,
        });
        outcome.clear();
        outcome.corner = corner;
        outcome.kept_weight = KEPT_WEIGHT;
        PhotonTracer {
            frame,
            source,
            current: RayQueue::of_frame(frame),
            surfaces: Box::new(Surfaces::new(frame.effects())),
            outcome,
            emitted: Vec::with_capacity(CHUNK as usize),
            stored: StoredPhotons::default(),
        }
    }

    /// Traces chunk `chunk` of the photons of the light.
    fn trace(
        &mut self,
        (targets, far): (&[CausticTarget], f64),
        chunk: u32,
    ) -> (StoredPhotons, RenderProfile) {
        // Emit the photons, then follow them wave by wave
        self.emit_chunk((targets, far), chunk);
        for depth in 0..MAX_STEPS {
            if self.current.len() == 0 {
                break;
            }
            self.trace_generation(BatchInfo {
                order: Coherence::Incoherent,
                depth,
                is_behind_bounce: true,
            });
            self.current.clear();
            if let Some(next) = &mut self.outcome.next_bounced {
                std::mem::swap(&mut self.current, &mut **next);
            }
        }
        (std::mem::take(&mut self.stored), self.outcome.meter.ledger)
    }

    /// Queues the rays of the photons of a chunk.
    fn emit_chunk(&mut self, (targets, far): (&[CausticTarget], f64), chunk: u32) {
        let first = chunk * CHUNK;
        let count = (self.source.count - first).min(CHUNK);
        let time = self.frame.shutter.time(0.5);
        let seed = self.frame.settings.seed;
        let purposes = [0, 1, 2].map(|pair| Purpose::PHOTON.nested(pair).seeded(seed));
        for start in (0..count).step_by(LANES) {
            // Number the photons of each light from 0
            let samples = std::array::from_fn(|l| first + start + l as u32);
            let pixels = [[self.source.number; LANES], [0; LANES]];
            let [direction, point, wavelength] =
                purposes.map(|purpose| number_packet(&pixels, &samples, purpose));
            for l in 0..LANES.min((count - start) as usize) {
                let u = [direction, point].map(|pair| [pair[0][l], pair[1][l]]);
                let emitted = emit(self.source, targets, u, far);
                if let Some(photon) = &emitted {
                    self.queue(start + l as u32, photon, time);
                }
                self.emitted.push(emitted.unwrap_or(EmittedPhoton::NONE));
                self.outcome.wavelength_offsets.push(wavelength[0][l]);
            }
        }
    }

    fn queue(&mut self, number: u32, photon: &EmittedPhoton, time: f32) {
        self.current.push(&RayWorkItem {
            ray: photon.ray(time),
            pixel: number,
            weight: [1.0; 3],
            sender: Category::Caustics,
            travel: Some(PathState {
                depth: 1,
                bounces: 1,
                direction: photon.direction,
                media: self.source.media,
                time,
                ..PathState::NONE
            }),
        });
    }

    /// Traces the rays of one generation, stores photons and queues the next rays.
    fn trace_generation(&mut self, stage: BatchInfo) {
        let (frame, outcome) = (self.frame, &mut self.outcome);
        let effects = frame.effects();
        outcome.generation = stage.depth;
        let (packets, paths) = self.current.parts();
        for (batch, packets) in packets.chunks_mut(BATCH).enumerate() {
            let paths = paths.from(batch * BATCH);
            let labels_and_accounts =
                |index: usize| (&paths.at(index).0.pixel, Accounts::All(Category::Caustics));
            let traced = outcome.meter.trace(packets, labels_and_accounts, |packets, _| {
                frame.accel.intersect(packets, stage.order)
            });
            outcome.meter.ledger.book(Category::Caustics, traced);
            for (index, packet) in packets.iter().enumerate() {
                let (path, path_states) = paths.at(index);
                let Some(path_states) = path_states.filter(|_| has_hit(packet)) else {
                    continue;
                };
                frame
                    .surfaces
                    .compute_interactions(packet, ConeSource::None, &mut self.surfaces);
                // Attenuate the photons by media and volumes
                let mut weight = if effects.has(Effect::Absorption) {
                    outcome.weight_after_absorption(packet, path, path_states)
                } else {
                    path.weight
                };
                if let Some(marches) = &mut outcome.marches {
                    let samples = marches.attenuate(packet, &packet.t_far, &mut weight);
                    outcome.meter.ledger.volume_samples += samples;
                }
                let mut traced = TracedPacket {
                    packet,
                    pixel: &path.pixel,
                    weight: &weight,
                    path_states: Some(path_states),
                };
                // Let the uncovered part pass
                let present;
                if effects.has_transmission() {
                    present = outcome.apply_alpha(&traced, path_states, &mut self.surfaces);
                    traced.weight = &present;
                }
                // Store photons that were turned aside, and reflect and refract what is left
                store(
                    frame,
                    &traced,
                    &self.surfaces,
                    (self.source, &self.emitted),
                    &mut self.stored,
                );
                if effects.has(Effect::Reflection) {
                    outcome.reflect::<false>(traced, &self.surfaces, stage);
                }
                if effects.has(Effect::Refraction) {
                    outcome.refract_rays(&traced, path_states, &self.surfaces);
                }
            }
        }
    }
}

/// Returns whether any ray of the packet hit a surface.
fn has_hit(packet: &RayPacket) -> bool {
    (0..LANES).any(|l| packet.active[l] != 0 && packet.hit(l).is_some())
}

/// Stores the photons of a packet that were turned aside and arrived at surfaces that scatter them.
fn store(
    frame: &RenderContext,
    traced: &TracedPacket,
    surfaces: &Surfaces,
    (source, emitted): (&PhotonSource, &[EmittedPhoton]),
    stored: &mut StoredPhotons,
) {
    let Some(path_states) = traced.path_states else {
        return;
    };
    let points = &surfaces.points;
    for l in (0..LANES).filter(|&l| traced.packet.active[l] != 0 && points.hit[l]) {
        let state = path_states.lane(l);
        if !state.bent || !surfaces.materials.scatters_light_samples(l) {
            continue;
        }
        // Scale the power at the light by what is left of the photon
        let photon = &emitted[traced.pixel[l] as usize];
        let weighted = |c: usize| (f64::from(traced.weight[c][l]) * photon.power[c]) as f32;
        let power: [f32; 3] = std::array::from_fn(weighted);
        if power == [0.0; 3] || power.iter().any(|channel| !channel.is_finite()) {
            continue;
        }
        stored.photons.push(Photon {
            position: points.point(l).as_vec3().to_array(),
            direction: [0, 1, 2].map(|axis| points.wo[axis][l]),
            normal: [0, 1, 2].map(|axis| points.ng[axis][l]),
            power,
            light: source.number,
        });
        let wavelength = f64::from(state.wavelength);
        let stratum = match wavelength > 0.0 {
            true => 1 + frame.spectrum.stratum(wavelength) as u32,
            false => 0,
        };
        stored.origins.push(photon.of(source).map(|emitted| PhotonOrigin {
            emitted,
            group: [source.number, state.depth, traced.packet.instance[l], stratum],
        }));
    }
}
