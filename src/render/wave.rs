//! Waves: the ray tree of a tile, walked breadth-first so that packets stay full.
//!
//! `I(P) = emission + ambient + direct light + I(reflected)`. A generation of rays is traced a few packets at a time,
//! small enough to stay in the first-level cache; its hits are shaded at once, which emits shadow feelers (answered
//! before the next few packets) and the rays of the next generation. The tree ends where no ray is left, at the depth
//! limit, or where a ray's weight falls under the cut-off.

use std::time::Instant;

use multiversion::multiversion;

use super::film::{TILE, Tile, TileFilm};
use super::ledger::{Ledger, RayTally};
use super::sampler::{PacketShape, sample_position};
use super::surface::SurfacePacket;
use super::{Frame, shade};
use crate::accel::{NO_HIT, RayOrder, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::scene::CameraView;

/// Packets that are traced and shaded together: 12 KB of rays.
const BATCH: usize = 8;

/// Camera packets whose whole ray trees are finished before the next are begun, so that queues stay small at any
/// number of samples.
const WAVE: usize = 64;

/// Whose light a lane's ray carries.
#[derive(Clone)]
struct PathPacket {
    /// Pixel within the tile's film.
    pixel: Lanes<u32>,
    /// What its radiance is multiplied by, linear RGB.
    weight: Lanes3<f32>,
}

impl PathPacket {
    const EMPTY: PathPacket = PathPacket {
        pixel: [0; LANES],
        weight: [[0.0; LANES]; 3],
    };
}

/// Rays of equal depth in the tree.
#[derive(Default)]
struct Generation {
    packets: Vec<RayPacket>,
    paths: Vec<PathPacket>,
    /// Lanes in use of the last packet.
    filled: usize,
}

impl Generation {
    fn clear(&mut self) {
        self.packets.clear();
        self.paths.clear();
        self.filled = LANES;
    }

    /// A fresh packet with its paths.
    #[inline(always)]
    fn push_packet(&mut self) -> (&mut RayPacket, &mut PathPacket) {
        self.packets.push(RayPacket::EMPTY);
        self.paths.push(PathPacket::EMPTY);
        let last = self.packets.len() - 1;
        (&mut self.packets[last], &mut self.paths[last])
    }

    /// One more ray, behind the last.
    #[inline(always)]
    fn push(&mut self, ray: &Ray, pixel: u32, weight: [f32; 3]) {
        if self.filled == LANES {
            self.push_packet();
            self.filled = 0;
        }
        let (last, lane) = (self.packets.len() - 1, self.filled);
        self.packets[last].set(lane, ray);
        self.paths[last].pixel[lane] = pixel;
        for channel in 0..3 {
            self.paths[last].weight[channel][lane] = weight[channel];
        }
        self.filled += 1;
    }
}

/// Shadow feelers with the light that arrives if nothing is met.
#[derive(Default)]
struct Feelers {
    packets: Vec<RayPacket>,
    lights: Vec<Feeler>,
}

#[derive(Clone)]
struct Feeler {
    pixel: Lanes<u32>,
    radiance: Lanes3<f32>,
}

/// The working memory of one thread, used for tile after tile.
pub(super) struct Wave<'f, 's> {
    frame: &'f Frame<'s>,
    film: TileFilm,
    current: Generation,
    next: Generation,
    feelers: Feelers,
    ledger: Ledger,
}

impl<'f, 's> Wave<'f, 's> {
    pub(super) fn new(frame: &'f Frame<'s>) -> Wave<'f, 's> {
        Wave {
            frame,
            film: TileFilm::new(),
            current: Generation::default(),
            next: Generation::default(),
            feelers: Feelers::default(),
            ledger: Ledger::default(),
        }
    }

    /// The mean radiances of a tile's pixels, row by row, and what they took.
    pub(super) fn render_tile(&mut self, tile: Tile) -> (Vec<[f32; 3]>, Ledger) {
        self.film.clear();
        self.ledger = Ledger::default();
        let spp = self.frame.settings.spp;
        let shape = PacketShape::for_samples(spp);
        self.next.clear();
        let mut packets = 0;
        for y in (0..tile.height).step_by(shape.block as usize) {
            for x in (0..tile.width).step_by(shape.block as usize) {
                for first_sample in (0..spp).step_by(shape.samples as usize) {
                    let start = PacketStart { x, y, first_sample };
                    self.push_camera_packet(tile, shape, start);
                    packets += 1;
                    if self.current.packets.len() == BATCH {
                        self.trace_camera_batch();
                    }
                    if packets % WAVE == 0 {
                        self.follow_reflections();
                    }
                }
            }
        }
        self.trace_camera_batch();
        self.follow_reflections();
        (self.film.means(tile, spp), self.ledger)
    }

    fn push_camera_packet(&mut self, tile: Tile, shape: PacketShape, start: PacketStart) {
        let settings = &self.frame.settings;
        let scale = [1.0 / f64::from(settings.width), 1.0 / f64::from(settings.height)];
        let mut film = [[0.0; LANES]; 2];
        let mut seen = [false; LANES];
        let (packet, path) = self.current.push_packet();
        for l in 0..LANES {
            let (dx, dy, ds) = shape.lane(l as u32);
            let (x, y, sample) = (start.x + dx, start.y + dy, start.first_sample + ds);
            seen[l] = x < tile.width && y < tile.height && sample < settings.spp;
            let [fx, fy] = self.frame.positions[sample.min(settings.spp - 1) as usize];
            film[0][l] = (f64::from(tile.x + x) + fx) * scale[0];
            film[1][l] = (f64::from(tile.y + y) + fy) * scale[1];
            path.pixel[l] = if seen[l] {
                y * TILE + x
            } else {
                start.y * TILE + start.x
            };
        }
        path.weight = [[1.0; LANES]; 3];
        fill_camera_packet(&self.frame.view, &film, &seen, packet);
    }

    fn trace_camera_batch(&mut self) {
        if self.current.packets.is_empty() {
            return;
        }
        let mut generation = std::mem::take(&mut self.current);
        let order = RayOrder::Coherent;
        self.ledger.camera += timed(&mut generation.packets, |packets| {
            self.frame.accel.intersect(packets, order)
        });
        self.shade_batch(&generation.packets, &generation.paths, order, 0);
        generation.clear();
        self.current = generation;
    }

    /// Traces what mirrors sent out, generation by generation.
    fn follow_reflections(&mut self) {
        self.trace_camera_batch();
        let mut depth = 1;
        while !self.next.packets.is_empty() {
            let mut generation = std::mem::take(&mut self.next);
            // `current` is empty between batches of camera rays; its memory serves the next generation.
            std::mem::swap(&mut self.next, &mut self.current);
            self.next.clear();
            let order = RayOrder::Incoherent;
            let paths = generation.paths.chunks(BATCH);
            for (packets, paths) in generation.packets.chunks_mut(BATCH).zip(paths) {
                self.ledger.reflection +=
                    timed(packets, |packets| self.frame.accel.intersect(packets, order));
                self.shade_batch(packets, paths, order, depth);
            }
            generation.clear();
            self.current = generation;
            depth += 1;
        }
    }

    /// Adds what traced rays have met to the film, and sends out what follows from it.
    fn shade_batch(&mut self, packets: &[RayPacket], paths: &[PathPacket], order: RayOrder, depth: u32) {
        for (packet, path) in packets.iter().zip(paths) {
            let any_hit = packet.instance.iter().any(|&instance| instance != NO_HIT);
            if !any_hit {
                if self.frame.glows {
                    let radiance = shade::surroundings(packet, &path.weight, self.frame.ambient);
                    self.film.add(&path.pixel, &radiance);
                }
                continue;
            }
            self.shade_packet(packet, path, order, depth);
        }
        self.answer_feelers(order);
    }

    fn shade_packet(&mut self, packet: &RayPacket, path: &PathPacket, order: RayOrder, depth: u32) {
        let frame = self.frame;
        let mut surfaces = SurfacePacket::EMPTY;
        frame.surfaces.surfaces(packet, &mut surfaces);
        let materials = frame.surfaces.materials(packet);
        if frame.glows {
            let radiance = shade::glow(packet, &surfaces, &materials, &path.weight, frame.ambient);
            self.film.add(&path.pixel, &radiance);
        }
        let origins = shade::spawn_origins(&surfaces);
        for light in &frame.scene.lights {
            if self.feelers.packets.len() >= BATCH {
                self.answer_feelers(order);
            }
            self.feelers.packets.push(RayPacket::EMPTY);
            let last = self.feelers.packets.len() - 1;
            let lit = shade::Lit {
                surfaces: &surfaces,
                materials: &materials,
                weight: &path.weight,
                origins: &origins,
            };
            let feeler = &mut self.feelers.packets[last];
            let mut radiance = [[0.0; LANES]; 3];
            if shade::feel(light, &lit, feeler, &mut radiance) {
                self.feelers.lights.push(Feeler {
                    pixel: path.pixel,
                    radiance,
                });
            } else {
                self.feelers.packets.pop();
            }
        }
        if frame.mirrors && depth < frame.settings.depth {
            self.reflect(
                &surfaces,
                &shade::reflection(&surfaces, &materials, &path.weight),
                &origins,
                path,
            );
        }
    }

    /// Queues the mirror rays that still matter.
    fn reflect(
        &mut self,
        surfaces: &SurfacePacket,
        mirrored: &shade::Mirrored,
        origins: &Lanes3<f32>,
        path: &PathPacket,
    ) {
        for l in 0..LANES {
            let weight: [f32; 3] = std::array::from_fn(|channel| mirrored.weight[channel][l]);
            let largest = weight[0].max(weight[1]).max(weight[2]);
            if !surfaces.hit[l]
                || !mirrored.leaves[l]
                || largest <= 0.0
                || largest < self.frame.settings.weight_cutoff
            {
                continue;
            }
            let vector = |v: &Lanes3<f32>| glam::Vec3::new(v[0][l], v[1][l], v[2][l]);
            let ray = Ray::new(vector(origins), vector(&mirrored.direction));
            self.next.push(&ray, path.pixel[l], weight);
        }
    }

    /// Asks which of the waiting feelers reach their lights, and lets those lights in.
    fn answer_feelers(&mut self, order: RayOrder) {
        if self.feelers.packets.is_empty() {
            return;
        }
        let accel = self.frame.accel;
        self.ledger.shadow += timed(&mut self.feelers.packets, |packets| {
            accel.occluded(packets, order)
        });
        for (packet, feeler) in self.feelers.packets.iter().zip(&mut self.feelers.lights) {
            for channel in 0..3 {
                for l in 0..LANES {
                    let blocked = packet.t_far[l] == f32::NEG_INFINITY;
                    let radiance = feeler.radiance[channel][l];
                    feeler.radiance[channel][l] = if blocked { 0.0 } else { radiance };
                }
            }
            self.film.add(&feeler.pixel, &feeler.radiance);
        }
        self.feelers.packets.clear();
        self.feelers.lights.clear();
    }
}

/// The first pixel of a packet's block within its tile, and its first sample.
#[derive(Clone, Copy)]
struct PacketStart {
    x: u32,
    y: u32,
    first_sample: u32,
}

/// Camera rays through sixteen film points, rounded to f32; from there on the f32 rays are the exact ones.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn fill_camera_packet(view: &CameraView, film: &[Lanes<f64>; 2], seen: &Lanes<bool>, packet: &mut RayPacket) {
    for l in 0..LANES {
        let ray = view.ray(film[0][l], film[1][l]);
        for axis in 0..3 {
            packet.origin[axis][l] = ray.origin[axis] as f32;
            packet.direction[axis][l] = ray.direction[axis] as f32;
        }
        packet.t_near[l] = ray.t_near as f32;
        packet.t_far[l] = ray.t_far as f32;
        packet.active[l] = -i32::from(seen[l]);
    }
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

/// The positions of all samples within their pixel.
pub(super) fn sample_positions(spp: u32) -> Vec<[f64; 2]> {
    (0..spp).map(sample_position).collect()
}
