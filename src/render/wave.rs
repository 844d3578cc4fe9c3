//! Waves: the ray tree of a tile, walked breadth-first so that packets stay full.
//!
//! `I(P) = emission + ambient + direct light + I(reflected)`. A generation of rays is traced a few packets at a time,
//! small enough to stay in the first-level cache; its hits are shaded at once, which emits shadow feelers (answered
//! before the next few packets) and the rays of the next generation. The tree ends where no ray is left, at the depth
//! limit, or where a ray's weight falls under the cut-off.

use std::ops::Range;
use std::time::Instant;

use multiversion::multiversion;

use super::adaptive::Estimate;
use super::film::{TILE, Tile, TileFilm};
use super::filter::Splat;
use super::ledger::{Ledger, RayTally};
use super::queue::{BATCH, Feelers, Generation, PathPacket};
use super::sampler::SampleGroup;
use super::samples::SampleFilm;
use super::surface::{SurfacePacket, Surfaces};
use super::{Frame, shade};
use crate::accel::{NO_HIT, RayOrder, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, Ray};

/// Camera packets whose whole ray trees are finished before the next are begun, so that queues stay small at any
/// number of samples.
pub(super) const WAVE: usize = 64;

/// The working memory of one thread, used for tile after tile.
pub(super) struct Wave<'f, 's> {
    frame: &'f Frame<'s>,
    /// The rays that are traced next.
    current: Generation,
    surfaces: Box<Surfaces>,
    outcome: Outcome<'f, 's>,
    /// Camera packets of this tile so far.
    packets: usize,
}

/// A tile's pixels, row by row.
pub(super) struct TilePicture {
    pub(super) means: Vec<[f32; 3]>,
    /// Filtered sums, where there is a filter.
    pub(super) splat: Option<Splat>,
    /// What the samples of each pixel tell, if that was asked for.
    pub(super) estimates: Vec<Estimate>,
}

/// Packets of samples for one pixel.
pub(super) struct Visit {
    /// Column within the tile.
    pub(super) x: u32,
    /// Row within the tile.
    pub(super) y: u32,
    /// Which of the frame's groups of samples.
    pub(super) groups: Range<u32>,
}

/// What shaded rays give: light on the film, feelers to lights, and the next generation.
struct Outcome<'f, 's> {
    frame: &'f Frame<'s>,
    film: TileFilm,
    feelers: Box<Feelers>,
    next: Generation,
    ledger: Ledger,
}

/// What the rays of a batch have in common.
#[derive(Clone, Copy)]
struct Stage {
    order: RayOrder,
    /// Reflections behind them.
    depth: u32,
}

impl<'f, 's> Wave<'f, 's> {
    pub(super) fn new(frame: &'f Frame<'s>) -> Wave<'f, 's> {
        let samples = frame
            .keeps_samples()
            .then(|| SampleFilm::new(frame.settings.filter));
        Wave {
            packets: 0,
            frame,
            current: Generation::default(),
            surfaces: Box::new(Surfaces::new(frame.features)),
            outcome: Outcome {
                frame,
                film: TileFilm::new(samples),
                feelers: Feelers::new(),
                next: Generation::default(),
                ledger: Ledger::default(),
            },
        }
    }

    /// The picture of a tile and what it took.
    pub(super) fn render_tile(&mut self, tile: Tile) -> (TilePicture, Ledger) {
        let frame = self.frame;
        let block = frame.shape.block as usize;
        self.begin();
        for y in (0..tile.height).step_by(block) {
            for x in (0..tile.width).step_by(block) {
                for group in &frame.groups {
                    self.add_camera_packet(tile, (x, y), group);
                }
            }
        }
        self.finish();
        let picture = self.outcome.film.picture(tile, frame.settings);
        (picture, self.outcome.ledger)
    }

    /// What the samples of each of `visits` tell, and what they took.
    ///
    /// Each visit is of another pixel; packets must hold samples of a single one.
    pub(super) fn render_visits(&mut self, tile: Tile, visits: &[Visit]) -> (Vec<Estimate>, Ledger) {
        let frame = self.frame;
        debug_assert_eq!(frame.shape.block, 1);
        self.begin();
        for visit in visits {
            for group in visit.groups.clone() {
                self.add_camera_packet(tile, (visit.x, visit.y), &frame.groups[group as usize]);
            }
        }
        self.finish();
        let estimates = self.outcome.film.estimates(visits);
        (estimates, self.outcome.ledger)
    }

    fn begin(&mut self) {
        self.packets = 0;
        self.current.clear();
        self.outcome.clear();
    }

    /// Makes the camera packet of one group of samples of the block at `corner`, within the tile; traces what is due.
    fn add_camera_packet(&mut self, tile: Tile, corner: (u32, u32), group: &SampleGroup) {
        self.push_camera_packet(&Block { tile, corner }, group);
        self.packets += 1;
        if self.current.len() == BATCH {
            self.trace_camera_batch();
        }
        if self.packets.is_multiple_of(WAVE) {
            self.finish();
        }
    }

    /// Follows all rays to their ends.
    fn finish(&mut self) {
        self.follow_reflections();
        if let Some(samples) = self.outcome.film.samples() {
            samples.weigh();
        }
    }

    fn push_camera_packet(&mut self, block: &Block, group: &SampleGroup) {
        let frame = self.frame;
        let (packet, path) = self.current.push_packet();
        path.weight = [[1.0; LANES]; 3];
        let per_pixel = frame
            .layout
            .is_per_pixel()
            .then(|| lane_positions(frame, block, group));
        let position = per_pixel.as_ref().unwrap_or(&group.position);
        fill_camera_packet(frame, block, group, position, (packet, &mut path.pixel));
        if let Some(samples) = self.outcome.film.samples() {
            samples.expect(&mut path.pixel, position, &packet.active);
        }
    }

    fn trace_camera_batch(&mut self) {
        let stage = Stage {
            order: RayOrder::Coherent,
            depth: 0,
        };
        let (packets, paths) = self.current.parts();
        if packets.is_empty() {
            return;
        }
        self.outcome.ledger.camera += timed(packets, |packets| {
            self.frame.accel.intersect(packets, stage.order)
        });
        self.outcome
            .shade_batch(&mut self.surfaces, packets, paths, stage);
        self.current.clear();
    }

    /// Traces what mirrors sent out, generation by generation.
    fn follow_reflections(&mut self) {
        self.trace_camera_batch();
        for depth in 1.. {
            if self.outcome.next.len() == 0 {
                return;
            }
            // `current` is empty here; its memory serves the generation after this one.
            std::mem::swap(&mut self.current, &mut self.outcome.next);
            self.outcome.next.clear();
            let stage = Stage {
                order: RayOrder::Incoherent,
                depth,
            };
            let (packets, paths) = self.current.parts();
            for (packets, paths) in packets.chunks_mut(BATCH).zip(paths.chunks(BATCH)) {
                self.outcome.ledger.reflection += timed(packets, |packets| {
                    self.frame.accel.intersect(packets, stage.order)
                });
                self.outcome
                    .shade_batch(&mut self.surfaces, packets, paths, stage);
            }
            self.current.clear();
        }
    }
}

impl Outcome<'_, '_> {
    fn clear(&mut self) {
        self.film.clear();
        self.next.clear();
        self.ledger = Ledger::default();
    }

    /// Adds what traced rays have met to the film, and sends out what follows from it.
    fn shade_batch(
        &mut self,
        surfaces: &mut Surfaces,
        packets: &[RayPacket],
        paths: &[PathPacket],
        stage: Stage,
    ) {
        for (packet, path) in packets.iter().zip(paths) {
            let any_hit = packet.instance.iter().any(|&instance| instance != NO_HIT);
            if any_hit {
                self.frame.surfaces.meet(packet, surfaces);
                self.shade(packet, path, surfaces, stage);
            } else if self.frame.glows {
                let radiance = shade::surroundings(packet, &path.weight, self.frame.ambient);
                self.film.add(&path.pixel, &radiance);
            }
        }
        self.answer_feelers(stage.order);
    }

    fn shade(&mut self, packet: &RayPacket, path: &PathPacket, surfaces: &Surfaces, stage: Stage) {
        let frame = self.frame;
        let (points, materials) = (&surfaces.points, &surfaces.materials);
        if frame.glows {
            let radiance = shade::glow(packet, surfaces, &path.weight, frame.ambient);
            self.film.add(&path.pixel, &radiance);
        }
        let lit = shade::Lit {
            points,
            materials,
            weight: &path.weight,
        };
        for light in &frame.scene.lights {
            if self.feelers.is_full() {
                self.answer_feelers(stage.order);
            }
            let (packet, feeler) = self.feelers.next();
            if shade::feel(light, &lit, packet, &mut feeler.radiance) {
                feeler.pixel = path.pixel;
                self.feelers.keep();
            }
        }
        if frame.mirrors && stage.depth < frame.settings.depth {
            self.reflect(points, &shade::reflection(&lit), path);
        }
    }

    /// Queues the mirror rays that still matter.
    fn reflect(&mut self, points: &SurfacePacket, mirrored: &shade::Mirrored, path: &PathPacket) {
        let cutoff = self.frame.settings.weight_cutoff;
        for l in 0..LANES {
            let weight: [f32; 3] = std::array::from_fn(|channel| mirrored.weight[channel][l]);
            let largest = weight[0].max(weight[1]).max(weight[2]);
            if points.hit[l] && mirrored.leaves[l] && largest > 0.0 && largest >= cutoff {
                let vector = |v: &Lanes3<f32>| glam::Vec3::new(v[0][l], v[1][l], v[2][l]);
                let ray = Ray::new(vector(&points.origin), vector(&mirrored.direction));
                self.next.push(&ray, path.pixel[l], weight);
            }
        }
    }

    /// Asks which of the waiting feelers reach their lights, and lets those lights in.
    fn answer_feelers(&mut self, order: RayOrder) {
        let (packets, feelers) = self.feelers.take();
        if packets.is_empty() {
            return;
        }
        let accel = self.frame.accel;
        self.ledger.shadow += timed(packets, |packets| accel.occluded(packets, order));
        for (packet, feeler) in packets.iter().zip(feelers) {
            shade::block(packet, &mut feeler.radiance);
            self.film.add(&feeler.pixel, &feeler.radiance);
        }
    }
}

/// A packet's block of pixels.
struct Block {
    tile: Tile,
    /// Column and row of its first pixel within the tile.
    corner: (u32, u32),
}

/// Places of the samples of a packet within their pixels, where they differ from pixel to pixel.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn lane_positions(frame: &Frame, block: &Block, group: &SampleGroup) -> [Lanes<f64>; 2] {
    let (tile, corner) = (block.tile, block.corner);
    let x = frame.pixels[0].map(|x| tile.x + corner.0 + x);
    let y = frame.pixels[1].map(|y| tile.y + corner.1 + y);
    frame.layout.lane_positions(&x, &y, group)
}

/// Camera rays through sixteen film points, rounded to f32, from where on the f32 rays are the exact ones; and their
/// pixels within the tile's film.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn fill_camera_packet(
    frame: &Frame,
    block: &Block,
    group: &SampleGroup,
    position: &[Lanes<f64>; 2],
    out: (&mut RayPacket, &mut Lanes<u32>),
) {
    let (packet, pixel) = out;
    let (tile, corner) = (block.tile, block.corner);
    for l in 0..LANES {
        let x = corner.0 + frame.pixels[0][l];
        let y = corner.1 + frame.pixels[1][l];
        let inside = (x < tile.width) & (y < tile.height);
        // Lanes beyond the tile's edge have nothing to add; any of its pixels takes it.
        pixel[l] = if inside {
            y * TILE + x
        } else {
            corner.1 * TILE + corner.0
        };
        packet.active[l] = -i32::from(inside & group.exists[l]);
    }
    let eye = frame.view.eye();
    for l in 0..LANES {
        let x = f64::from(tile.x + corner.0 + frame.pixels[0][l]) + position[0][l];
        let y = f64::from(tile.y + corner.1 + frame.pixels[1][l]) + position[1][l];
        let ray = frame.view.ray(x * frame.pixel_size[0], y * frame.pixel_size[1]);
        for axis in 0..3 {
            if eye.is_none() {
                packet.origin[axis][l] = ray.origin[axis] as f32;
            }
            packet.direction[axis][l] = ray.direction[axis] as f32;
        }
    }
    if let Some(eye) = eye {
        packet.origin = eye.to_array().map(|axis| [axis as f32; LANES]);
    }
    packet.t_near = [frame.view.t_near() as f32; LANES];
    packet.t_far = [frame.view.t_far() as f32; LANES];
}

/// Runs a trace and books its active rays and its time.
#[inline(always)]
fn timed(packets: &mut [RayPacket], trace: impl FnOnce(&mut [RayPacket])) -> RayTally {
    let rays: i32 = packets.iter().flat_map(|packet| &packet.active).sum();
    let start = Instant::now();
    trace(packets);
    RayTally {
        rays: u64::from(rays.unsigned_abs()),
        seconds: start.elapsed().as_secs_f64(),
    }
}
