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

/// Rays of equal depth in the tree. Packets are kept to be filled again.
#[derive(Default)]
struct Generation {
    packets: Vec<RayPacket>,
    paths: Vec<PathPacket>,
    /// Packets in use.
    count: usize,
    /// Lanes in use of the last of them.
    filled: usize,
}

impl Generation {
    fn clear(&mut self) {
        self.count = 0;
        self.filled = LANES;
    }

    /// A fresh packet with its paths.
    #[inline(always)]
    fn push_packet(&mut self) -> (&mut RayPacket, &mut PathPacket) {
        if self.count == self.packets.len() {
            self.packets.push(RayPacket::EMPTY);
            self.paths.push(PathPacket::EMPTY);
        }
        let last = self.count;
        self.count += 1;
        self.packets[last].recycle();
        (&mut self.packets[last], &mut self.paths[last])
    }

    /// One more ray, behind the last.
    #[inline(always)]
    fn push(&mut self, ray: &Ray, pixel: u32, weight: [f32; 3]) {
        if self.filled == LANES {
            self.push_packet();
            self.filled = 0;
        }
        let (last, lane) = (self.count - 1, self.filled);
        self.packets[last].set(lane, ray);
        self.paths[last].pixel[lane] = pixel;
        for channel in 0..3 {
            self.paths[last].weight[channel][lane] = weight[channel];
        }
        self.filled += 1;
    }
}

/// Shadow feelers with the light that arrives if nothing is met.
struct Feelers {
    packets: [RayPacket; BATCH],
    lights: [Feeler; BATCH],
    /// Packets in use.
    count: usize,
}

#[derive(Clone)]
struct Feeler {
    pixel: Lanes<u32>,
    radiance: Lanes3<f32>,
}

impl Feelers {
    fn new() -> Box<Feelers> {
        Box::new(Feelers {
            packets: std::array::from_fn(|_| RayPacket::EMPTY),
            lights: std::array::from_fn(|_| Feeler {
                pixel: [0; LANES],
                radiance: [[0.0; LANES]; 3],
            }),
            count: 0,
        })
    }
}

/// The working memory of one thread, used for tile after tile.
pub(super) struct Wave<'f, 's> {
    frame: &'f Frame<'s>,
    film: TileFilm,
    current: Generation,
    next: Generation,
    feelers: Box<Feelers>,
    ledger: Ledger,
}

impl<'f, 's> Wave<'f, 's> {
    pub(super) fn new(frame: &'f Frame<'s>) -> Wave<'f, 's> {
        Wave {
            frame,
            film: TileFilm::new(),
            current: Generation::default(),
            next: Generation::default(),
            feelers: Feelers::new(),
            ledger: Ledger::default(),
        }
    }

    /// The mean radiances of a tile's pixels, row by row, and what they took.
    pub(super) fn render_tile(&mut self, tile: Tile) -> (Vec<[f32; 3]>, Ledger) {
        self.film.clear();
        self.ledger = Ledger::default();
        let spp = self.frame.settings.spp;
        let shape = self.frame.shape;
        self.current.clear();
        self.next.clear();
        let mut packets = 0;
        for y in (0..tile.height).step_by(shape.block as usize) {
            for x in (0..tile.width).step_by(shape.block as usize) {
                for first_sample in (0..spp).step_by(shape.samples as usize) {
                    let start = PacketStart { x, y, first_sample };
                    self.push_camera_packet(tile, start);
                    packets += 1;
                    if self.current.count == BATCH {
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

    fn push_camera_packet(&mut self, tile: Tile, start: PacketStart) {
        let frame = self.frame;
        let (packet, path) = self.current.push_packet();
        let mut film = FilmPoints {
            pixel: [[0; LANES]; 2],
            offset: [[0.0; LANES]; 2],
            seen: [false; LANES],
        };
        for l in 0..LANES {
            let lane = frame.lanes[l];
            let (x, y, sample) = (
                start.x + lane.x,
                start.y + lane.y,
                start.first_sample + lane.sample,
            );
            let seen = x < tile.width && y < tile.height && sample < frame.settings.spp;
            film.seen[l] = seen;
            film.pixel[0][l] = tile.x + x;
            film.pixel[1][l] = tile.y + y;
            path.pixel[l] = if seen {
                y * TILE + x
            } else {
                start.y * TILE + start.x
            };
            let [fx, fy] = frame.positions.get(sample as usize).copied().unwrap_or_default();
            film.offset[0][l] = fx;
            film.offset[1][l] = fy;
        }
        path.weight = [[1.0; LANES]; 3];
        let scale = [frame.settings.width, frame.settings.height].map(|size| 1.0 / f64::from(size));
        fill_camera_packet(&frame.view, &film, scale, packet);
    }

    fn trace_camera_batch(&mut self) {
        if self.current.count == 0 {
            return;
        }
        let mut generation = std::mem::take(&mut self.current);
        let order = RayOrder::Coherent;
        let packets = &mut generation.packets[..generation.count];
        self.ledger.camera += timed(packets, |packets| self.frame.accel.intersect(packets, order));
        self.shade_batch(packets, &generation.paths, order, 0);
        generation.clear();
        self.current = generation;
    }

    /// Traces what mirrors sent out, generation by generation.
    fn follow_reflections(&mut self) {
        self.trace_camera_batch();
        let mut depth = 1;
        while self.next.count > 0 {
            let mut generation = std::mem::take(&mut self.next);
            // `current` is empty between batches of camera rays; its memory serves the next generation.
            std::mem::swap(&mut self.next, &mut self.current);
            self.next.clear();
            let order = RayOrder::Incoherent;
            let paths = generation.paths.chunks(BATCH);
            for (packets, paths) in generation.packets[..generation.count]
                .chunks_mut(BATCH)
                .zip(paths)
            {
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
        let lit = shade::Lit {
            surfaces: &surfaces,
            materials: &materials,
            weight: &path.weight,
            origins: &origins,
        };
        for light in &frame.scene.lights {
            if self.feelers.count == BATCH {
                self.answer_feelers(order);
            }
            let Feelers {
                packets,
                lights,
                count,
            } = &mut *self.feelers;
            if shade::feel(light, &lit, &mut packets[*count], &mut lights[*count].radiance) {
                lights[*count].pixel = path.pixel;
                *count += 1;
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
        let Feelers {
            packets,
            lights,
            count,
        } = &mut *self.feelers;
        if *count == 0 {
            return;
        }
        let accel = self.frame.accel;
        let packets = &mut packets[..*count];
        self.ledger.shadow += timed(packets, |packets| accel.occluded(packets, order));
        for (packet, feeler) in packets.iter().zip(lights) {
            shade::block(packet, &mut feeler.radiance);
            self.film.add(&feeler.pixel, &feeler.radiance);
        }
        *count = 0;
    }
}

/// The first pixel of a packet's block within its tile, and its first sample.
#[derive(Clone, Copy)]
struct PacketStart {
    x: u32,
    y: u32,
    first_sample: u32,
}

/// Sixteen points of the film.
struct FilmPoints {
    /// Column and row of the pixel within the image.
    pixel: [Lanes<u32>; 2],
    /// Position within the pixel.
    offset: [Lanes<f64>; 2],
    /// Whether the lane stands for a sample of the image at all.
    seen: Lanes<bool>,
}

/// Camera rays through sixteen film points, rounded to f32; from there on the f32 rays are the exact ones. `scale` is
/// one over the image's width and height.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn fill_camera_packet(view: &CameraView, film: &FilmPoints, scale: [f64; 2], packet: &mut RayPacket) {
    for l in 0..LANES {
        let x = (f64::from(film.pixel[0][l]) + film.offset[0][l]) * scale[0];
        let y = (f64::from(film.pixel[1][l]) + film.offset[1][l]) * scale[1];
        let ray = view.ray(x, y);
        for axis in 0..3 {
            packet.origin[axis][l] = ray.origin[axis] as f32;
            packet.direction[axis][l] = ray.direction[axis] as f32;
        }
        packet.t_near[l] = ray.t_near as f32;
        packet.t_far[l] = ray.t_far as f32;
        packet.active[l] = -i32::from(film.seen[l]);
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
