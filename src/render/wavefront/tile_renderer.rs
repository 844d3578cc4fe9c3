//! Tile renderer: evaluates the ray trees of a tile breadth-first, so that packets stay full.
//!
//! `I(P) = emission + ambient + direct light + I(reflected)`. A wavefront generation of rays is traced a few packets
//! at a time, small enough to stay in the L1 cache. Its hits are shaded at once, which emits shadow rays (traced
//! before the next few packets) and the rays of the next generation. The tree ends where no ray is left, at the depth
//! limit, or where the throughput of a ray falls below the cut-off.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, PoisonError};

use multiversion::multiversion;

use super::super::aov::{AovBuffers, LightGroupFilm};
use super::super::camera::lens;
use super::super::context::RenderContext;
use super::super::film::{PixelStatistics, TileFilm, TileResult};
use super::super::profile::{
    Accounts, Category, Memory, RayTypeCounts, RenderProfile, Tally, ThreadFootprint,
};
use super::super::sampler::SampleGroup;
use super::super::surface::Surfaces;
use super::super::tile::{Block, PixelVisit, TILE, Tile};
use super::path_state::CameraPaths;
use super::ray_queue::RayQueue;
use super::shading_state::ShadingState;
use super::shadow_queue::ShadowQueue;
use super::traced_packet::BatchInfo;
use crate::accel::{BATCH, Coherence, RayPacket};
use crate::numeric::{LANES, Lanes};
use crate::scene::Effect;

/// Largest number of bounces of any path. It bounds paths through a thousand fully transparent surfaces, which would
/// otherwise not end.
const MAX_PATH_LENGTH: u32 = 1024;

/// Working memory of one thread, reused from tile to tile.
pub(in crate::render) struct TileRenderer<'f, 's> {
    frame: &'f RenderContext<'s>,
    /// Rays that are traced next.
    current: RayQueue,
    /// Rays that are traced next and have left a diffuse surface, in scenes with interreflection.
    current_bounced: Option<Box<RayQueue>>,
    surfaces: Box<Surfaces>,
    outcome: ShadingState<'f, 's>,
    /// True if camera rays need per-path state, a lens or times.
    has_camera_path_states: bool,
    /// Number of camera packets of the current tile so far.
    packets: usize,
    /// Memory use of this thread, with the ledger on.
    held: Option<ThreadFootprint<'f>>,
    /// Packets, rays and ray types of the largest generation of secondary rays so far.
    largest: (usize, u64, RayTypeCounts),
}

impl<'f, 's> TileRenderer<'f, 's> {
    pub(in crate::render) fn new(frame: &'f RenderContext<'s>) -> TileRenderer<'f, 's> {
        let samples = frame.sample_film();
        TileRenderer {
            packets: 0,
            held: frame.thread_memory.as_ref().map(ThreadFootprint::new),
            largest: (0, 0, RayTypeCounts::default()),
            frame,
            current: RayQueue::of_frame(frame),
            current_bounced: RayQueue::of_bounces(frame),
            surfaces: Box::new(Surfaces::new(frame.effects())),
            outcome: ShadingState::new(
                frame,
                TileFilm::new(samples).with_light(LightGroupFilm::of(&frame.light_sheet)),
            ),
            has_camera_path_states: frame.has_camera_path_states(),
        }
    }

    /// Renders a tile and returns its pixels and its ledger; AOVs are written to `planes`.
    pub(in crate::render) fn render_tile(
        &mut self,
        tile: Tile,
        planes: Option<&AovBuffers>,
    ) -> (TileResult, RenderProfile) {
        let mut corners = block_corners(self.frame, tile);
        self.render_blocks(tile, &mut corners, planes)
    }

    /// Renders the blocks of pixels with these corners within a tile, and returns the tile, in which the other pixels are
    /// black, and its ledger; AOVs are written to `planes`.
    pub(in crate::render) fn render_blocks(
        &mut self,
        tile: Tile,
        corners: &mut dyn Iterator<Item = (u32, u32)>,
        planes: Option<&AovBuffers>,
    ) -> (TileResult, RenderProfile) {
        let frame = self.frame;
        let groups = &frame.groups[frame.part.clone()];
        let samples = frame.samples_taken();
        // Trace and shade all camera packets of the tile
        self.begin(tile);
        for corner in corners {
            for group in groups {
                self.add_camera_packet(tile, corner, group);
            }
        }
        self.finish();
        // Book truncated radiance, then collect pixels and AOVs
        let outcome = &mut self.outcome;
        let pixels = (0..TILE * TILE).map(|pixel| (pixel, samples));
        outcome.losses.settle(pixels, &mut outcome.meter.ledger);
        let mut result = outcome.film.picture(tile, frame.settings);
        let transparency = outcome.transparency.as_ref();
        result.transparency = transparency.map(|film| Box::new(film.picture(tile, frame.settings)));
        if frame.returns_sums {
            result.sums = outcome.film.sums_of(tile);
        }
        if let Some(planes) = planes {
            planes.put(tile, &self.outcome.layers(tile));
        }
        self.note_memory(frame.tile_bytes(tile));
        self.outcome.finish(tile);
        (result, self.outcome.meter.ledger)
    }

    /// Returns the sample statistics of the pixels of `visits`, and the ledger of the work.
    ///
    /// Each visit must be of a different pixel, and a packet must hold samples of a single pixel.
    pub(in crate::render) fn render_visits(
        &mut self,
        tile: Tile,
        visits: &[PixelVisit],
    ) -> (Vec<PixelStatistics>, RenderProfile) {
        let frame = self.frame;
        debug_assert_eq!(frame.shape.block, 1);
        self.begin(tile);
        for visit in visits {
            for group in visit.groups.clone() {
                self.add_camera_packet(tile, (visit.x, visit.y), &frame.groups[group as usize]);
            }
        }
        self.finish();
        let outcome = &mut self.outcome;
        let estimates = outcome.film.estimates(visits);
        let pixels = visits
            .iter()
            .zip(&estimates)
            .map(|(visit, estimate)| (visit.y * TILE + visit.x, estimate.count));
        outcome.losses.settle(pixels, &mut outcome.meter.ledger);
        self.note_memory(0);
        self.outcome.finish(tile);
        (estimates, self.outcome.meter.ledger)
    }

    fn begin(&mut self, tile: Tile) {
        self.outcome.meter.begin(tile);
        self.packets = 0;
        self.current.clear();
        self.outcome.clear();
        self.outcome.corner = [tile.x, tile.y];
    }

    /// Adds the camera packet of one sample group for the block at `corner` (in the tile); traces the batch when it
    /// is full.
    fn add_camera_packet(&mut self, tile: Tile, corner: (u32, u32), group: &SampleGroup) {
        self.push_camera_packet(&Block { tile, corner }, group);
        self.packets += 1;
        if self.current.len() == self.frame.batch {
            self.trace_camera_batch();
        }
        if self.packets.is_multiple_of(self.frame.wave) {
            self.finish();
        }
    }

    /// Traces all queued rays until their paths end.
    fn finish(&mut self) {
        self.follow_reflections();
        if let Some(samples) = self.outcome.film.samples() {
            samples.weigh();
            if let Some(samples) = self.outcome.transparency_samples() {
                samples.weigh();
            }
            self.outcome.meter.lap(Category::Film);
        }
    }

    fn push_camera_packet(&mut self, block: &Block, group: &SampleGroup) {
        let frame = self.frame;
        // Compute sample positions and camera rays
        let (packet, path) = self.current.push_packet();
        path.weight = [[1.0; LANES]; 3];
        let per_pixel = frame
            .layout
            .is_per_pixel()
            .then(|| lane_positions(frame, block, group));
        let position = per_pixel.as_ref().unwrap_or(&group.position);
        fill_camera_packet(frame, block, group, position, (packet, &mut path.pixel));
        // Register samples with the film and initialize path states
        if let Some(samples) = self.outcome.film.samples() {
            let mut pixels = path.pixel;
            samples.expect(&mut path.pixel, position, &packet.active);
            if let Some(samples) = self.outcome.transparency_samples() {
                samples.expect(&mut pixels, position, &packet.active);
            }
        }
        if self.has_camera_path_states {
            self.begin_path_states(block, group, position);
        }
    }

    /// Sets the times, lens rays and path states of the camera packet pushed last.
    #[inline(never)]
    fn begin_path_states(&mut self, block: &Block, group: &SampleGroup, position: &[Lanes<f64>; 2]) {
        let frame = self.frame;
        let packet = self.current.last_packet();
        if frame.effects().has(Effect::MotionBlur) {
            packet.time = frame.times(block, group);
        }
        let time = packet.time;
        // Compute the rays in f64 where their packet lacks a lens or motion, or paths need exact directions
        let needs_directions = frame.effects().has(Effect::Refraction);
        let rays = (frame.has_lens_or_motion() || needs_directions)
            .then(|| frame.camera_rays(block, (group, &time), position));
        if let Some(rays) = rays.as_ref().filter(|_| frame.has_lens_or_motion()) {
            lens::aim(packet, rays);
        }
        if !frame.has_path_state() {
            return;
        }
        let directions = rays.map(|rays| rays.map(|ray| ray.direction.normalize()));
        self.current.begin_paths(&CameraPaths {
            directions,
            media: frame.media_at_camera,
            cone: frame.camera_cone,
            samples: &group.sample,
            times: &time,
        });
    }

    fn trace_camera_batch(&mut self) {
        let stage = BatchInfo {
            order: Coherence::Coherent,
            depth: 0,
            is_behind_bounce: false,
        };
        let (packets, paths) = self.current.parts();
        if packets.is_empty() {
            return;
        }
        // Book the time of ray generation
        let meter = &mut self.outcome.meter;
        let lanes = (0..packets.len()).map(|index| (&paths.at(index).0.pixel, &packets[index].active));
        meter.lap_over(Category::Sampling, lanes);
        // Intersect camera rays with the scene
        let labels_and_accounts = |index| (&paths.at(index).0.pixel, Accounts::All(Category::Camera));
        let traced = meter.trace(packets, labels_and_accounts, |packets, _| {
            self.frame.accel.intersect(packets, stage.order)
        });
        meter.ledger.book(Category::Camera, traced);
        // Shade the hits, which queues secondary rays
        self.outcome
            .shade_batch(&mut self.surfaces, packets, paths, stage);
        self.current.clear();
    }

    /// Traces secondary rays, one wavefront generation after the other.
    fn follow_reflections(&mut self) {
        self.trace_camera_batch();
        for depth in 1..=MAX_PATH_LENGTH {
            let bounced = self.outcome.next_bounced.as_ref();
            if self.outcome.next.len() + bounced.map_or(0, |bounced| bounced.len()) == 0 {
                return;
            }
            // `current` is empty here; its memory is reused for the following generation.
            std::mem::swap(&mut self.current, &mut self.outcome.next);
            std::mem::swap(&mut self.current_bounced, &mut self.outcome.next_bounced);
            self.trace_generation(depth, false);
            // Trace those behind diffuse surfaces in packets of their own
            if let Some(mut bounced) = self.current_bounced.take() {
                std::mem::swap(&mut self.current, &mut bounced);
                self.trace_generation(depth, true);
                std::mem::swap(&mut self.current, &mut bounced);
                self.current_bounced = Some(bounced);
            }
        }
    }

    /// Traces and shades the rays of `current`, which are `depth` bounces from the camera.
    fn trace_generation(&mut self, depth: u32, is_behind_bounce: bool) {
        if self.frame.settings.wanted_light().effects {
            self.current.label_steps(self.frame.effects());
        }
        let stage = BatchInfo {
            order: Coherence::Incoherent,
            depth,
            is_behind_bounce,
        };
        let mut all = Tally::default();
        let (packets, paths) = self.current.parts();
        // Intersect and shade the generation in batches that fit in the cache
        for (batch, packets) in packets.chunks_mut(BATCH).enumerate() {
            let paths = paths.from(batch * BATCH);
            let labels_and_accounts = |index| paths.labels_and_accounts(index, Category::Reflection);
            all += self
                .outcome
                .meter
                .trace(packets, labels_and_accounts, |packets, _| {
                    self.frame.accel.intersect(packets, stage.order)
                });
            self.outcome
                .shade_batch(&mut self.surfaces, packets, paths, stage);
        }
        // Book the rays by type
        self.outcome.meter.ledger.book_sent(all, self.current.ray_types());
        if self.held.is_some() && self.current.len() > self.largest.0 {
            self.largest = (self.current.len(), all.rays, self.current.ray_types());
        }
        self.current.clear();
    }
}

/// Returns the corners of the blocks of pixels of a tile. Where queries have more packets than most, they follow Morton's
/// curve, so that those of one query lie in a square.
pub(in crate::render) fn block_corners(
    frame: &RenderContext,
    tile: Tile,
) -> impl Iterator<Item = (u32, u32)> + use<> {
    let side = frame.shape.block;
    let blocks = TILE / side;
    let is_morton = frame.batch > BATCH;
    let corners = (0..blocks * blocks).map(move |index| match is_morton {
        true => (side * even_bits(index), side * even_bits(index >> 1)),
        false => (side * (index % blocks), side * (index / blocks)),
    });
    corners.filter(move |&(x, y)| x < tile.width && y < tile.height)
}

/// Returns the columns and rows, within the tile, of the pixels of a block.
pub(in crate::render) fn block_pixels(
    frame: &RenderContext,
    tile: Tile,
    (x, y): (u32, u32),
) -> impl Iterator<Item = [u32; 2]> + use<> {
    let side = frame.shape.block;
    let (columns, rows) = (x..tile.width.min(x + side), y..tile.height.min(y + side));
    rows.flat_map(move |y| columns.clone().map(move |x| [x, y]))
}

/// Returns the number that bits 0, 2, 4, ... of the index of a block in a tile make.
fn even_bits(index: u32) -> u32 {
    (0..TILE.ilog2()).fold(0, |bits, bit| bits | (index >> (2 * bit) & 1) << bit)
}

/// Pool of the tile renderers of one render. It grows to the largest number of threads that work at the same time.
///
/// The queues of a renderer have grown by the end of a tile, and the next tile reuses them.
pub(in crate::render) struct RendererPool<'f, 's> {
    frame: &'f RenderContext<'s>,
    idle: Mutex<Vec<TileRenderer<'f, 's>>>,
}

impl<'f, 's> RendererPool<'f, 's> {
    pub(in crate::render) fn new(frame: &'f RenderContext<'s>) -> RendererPool<'f, 's> {
        RendererPool {
            frame,
            idle: Mutex::default(),
        }
    }

    /// Takes a tile renderer out of the pool; it returns to the pool when the guard is dropped.
    pub(in crate::render) fn acquire(&self) -> PoolGuard<'_, 'f, 's> {
        let idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        PoolGuard {
            waves: self,
            wave: Some(idle.unwrap_or_else(|| TileRenderer::new(self.frame))),
        }
    }
}

/// Guard of a tile renderer that is taken out of the pool.
pub(in crate::render) struct PoolGuard<'w, 'f, 's> {
    waves: &'w RendererPool<'f, 's>,
    /// Tile renderer; `None` only while it is returned to the pool.
    wave: Option<TileRenderer<'f, 's>>,
}

impl<'f, 's> Deref for PoolGuard<'_, 'f, 's> {
    type Target = TileRenderer<'f, 's>;

    fn deref(&self) -> &TileRenderer<'f, 's> {
        self.wave.as_ref().expect("given back only when dropped")
    }
}

impl<'f, 's> DerefMut for PoolGuard<'_, 'f, 's> {
    fn deref_mut(&mut self) -> &mut TileRenderer<'f, 's> {
        self.wave.as_mut().expect("given back only when dropped")
    }
}

impl Drop for PoolGuard<'_, '_, '_> {
    fn drop(&mut self) {
        let mut idle = self.waves.idle.lock().unwrap_or_else(PoisonError::into_inner);
        idle.extend(self.wave.take());
    }
}

impl TileRenderer<'_, '_> {
    /// Records the memory in use, with the ledger on, and adds `finished` bytes of output that a tile keeps.
    fn note_memory(&mut self, finished: usize) {
        if self.held.is_some() {
            let memory = self.memory();
            self.held
                .iter_mut()
                .for_each(|held| held.note(memory.clone(), finished));
        }
    }

    /// Returns the memory that this thread uses, by holder.
    fn memory(&self) -> Memory {
        let (outcome, effects) = (&self.outcome, self.frame.effects());
        let mut memory = Memory::default();
        // Add ray queues and optional path state
        self.add_queues_to(&mut memory);
        for generation in self.queues() {
            generation.add_columns_to(&mut memory, effects);
        }
        let shadow_effect = match effects.has(Effect::Shadow) {
            true => Category::Shadow,
            false => Category::Lighting,
        };
        memory.add(shadow_effect.name(), "shadow rays", ShadowQueue::BYTES);
        outcome.shadow_queue.add_columns_to(&mut memory);
        // Add surface interactions
        memory.add(
            Category::Surface.name(),
            "points and materials",
            size_of::<Surfaces>(),
        );
        if outcome.shadow_surfaces.is_some() {
            let behind = Effect::TransparentShadow.name();
            memory.add(behind, "points and materials", size_of::<Surfaces>());
        }
        if outcome.layer_surfaces.is_some() {
            let above = [Effect::Clearcoat, Effect::Sheen];
            let above = above.into_iter().find(|&effect| self.frame.effects().has(effect));
            let holder = above.unwrap_or(Effect::Sheen).name();
            memory.add(holder, "points and materials", size_of::<Surfaces>());
        }
        // Add volumes, film and AOVs
        outcome
            .marches
            .iter()
            .for_each(|marches| marches.add_to(&mut memory));
        outcome.film.add_to(&mut memory);
        if let Some(film) = &outcome.transparency {
            film.add_to(&mut memory);
        }
        let first_hits = outcome.first_hits.as_ref().map_or(0, |hits| hits.byte_count());
        memory.add(Category::Film.name(), "first hits of a tile", first_hits);
        let losses = outcome.losses.byte_count();
        memory.add(Category::Film.name(), "weights of lost rays", losses);
        let costs = outcome.meter.costs.as_ref().map_or(0, |costs| costs.byte_count());
        memory.add(Category::Other.name(), "costs of a tile", costs);
        memory
    }

    /// Iterates over the queues of rays.
    fn queues(&self) -> impl Iterator<Item = &RayQueue> {
        let bounced = [&self.current_bounced, &self.outcome.next_bounced];
        let bounced = bounced.into_iter().flatten().map(|bounced| &**bounced);
        [&self.current, &self.outcome.next].into_iter().chain(bounced)
    }

    /// Adds the bytes of the ray queues. One batch is attributed to camera rays; the rest is divided like the rays of
    /// the largest generation of secondary rays.
    fn add_queues_to(&self, memory: &mut Memory) {
        let all = self.queues().map(RayQueue::byte_count).sum::<usize>();
        let camera = all.min(BATCH * RayQueue::PACKET_BYTES);
        memory.add(Category::Camera.name(), "queued rays", camera);
        let (_, rays, ray_types) = self.largest;
        let mut left = (all - camera, rays);
        for (account, part) in ray_types.accounts(rays) {
            let holder = match account {
                // Rays through alpha-blended surfaces are booked as if they were refracted.
                Category::Refraction => self.frame.effects().transmissive().name(),
                _ => account.name(),
            };
            // Round each part against the remaining bytes, so that the parts add up exactly.
            let bytes = (left.0 as f64 * part as f64 / left.1.max(1) as f64) as usize;
            memory.add(holder, "queued rays", bytes);
            left = (left.0 - bytes, left.1.saturating_sub(part));
        }
        // Reserved for secondary rays, but camera rays sent none.
        memory.add(Category::Camera.name(), "queued rays", left.0);
    }
}

/// Returns the sample positions of a packet within their pixels, for patterns that differ from pixel to pixel.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn lane_positions(frame: &RenderContext, block: &Block, group: &SampleGroup) -> [Lanes<f64>; 2] {
    let (tile, corner) = (block.tile, block.corner);
    let (mut x, mut y) = ([0; LANES], [0; LANES]);
    for l in 0..LANES {
        x[l] = tile.x + corner.0 + frame.pixels[0][l];
        y[l] = tile.y + corner.1 + frame.pixels[1][l];
    }
    frame.layout.lane_positions(&x, &y, group, frame.settings.seed)
}

/// Fills a packet with camera rays through sixteen film points and their pixels within the tile's film.
///
/// Rays are rounded to f32; from here on, the f32 rays are the exact ones.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn fill_camera_packet(
    frame: &RenderContext,
    block: &Block,
    group: &SampleGroup,
    position: &[Lanes<f64>; 2],
    out: (&mut RayPacket, &mut Lanes<u32>),
) {
    let (packet, pixel) = out;
    let (tile, corner) = (block.tile, block.corner);
    // Map lanes to pixels and deactivate lanes outside the tile
    for l in 0..LANES {
        let x = corner.0 + frame.pixels[0][l];
        let y = corner.1 + frame.pixels[1][l];
        let inside = (x < tile.width) & (y < tile.height);
        // Lanes beyond the tile's edge contribute nothing; assign them any of its pixels.
        pixel[l] = if inside {
            y * TILE + x
        } else {
            corner.1 * TILE + corner.0
        };
        packet.active[l] = -i32::from(inside & group.exists[l]);
    }
    // Generate rays from precomputed offsets, or from each film point in f64
    let on_film = |x: f64, y: f64| frame.view.ray(x * frame.pixel_size[0], y * frame.pixel_size[1]);
    match &group.aside {
        Some(aside) => {
            let first = on_film(f64::from(tile.x + corner.0), f64::from(tile.y + corner.1));
            for axis in 0..3 {
                packet.origin[axis] = [first.origin[axis] as f32; LANES];
                for l in 0..LANES {
                    packet.direction[axis][l] = (first.direction[axis] + aside[axis][l]) as f32;
                }
            }
        }
        None => {
            for l in 0..LANES {
                let x = f64::from(tile.x + corner.0 + frame.pixels[0][l]) + position[0][l];
                let y = f64::from(tile.y + corner.1 + frame.pixels[1][l]) + position[1][l];
                let ray = on_film(x, y);
                for axis in 0..3 {
                    packet.origin[axis][l] = ray.origin[axis] as f32;
                    packet.direction[axis][l] = ray.direction[axis] as f32;
                }
            }
        }
    }
    // Only points beyond the near plane are visible, and ray intervals include their ends.
    let near = frame.view.t_near() as f32;
    packet.t_near = [if near > 0.0 { near.next_up() } else { near }; LANES];
    packet.t_far = [frame.view.t_far() as f32; LANES];
}
