//! Geometric errors as an axis of their own: leaks, false hits and false shadows by each intersection backend.
//!
//! Camera rays and shadow rays of the scene's own image are recorded, and every backend traces the same rays. The
//! reference is the BSP, which decides in f64 where f32 cannot. A result that differs is an error unless a nearby ray,
//! perturbed by the size of f32 rounding, has that result in the BSP too: then it is a tie, as at a silhouette.

use std::time::{Duration, Instant};

use super::layout::Layout;
use super::view::area;
use super::workspace::Workspace;
use super::{Configuration, GeometricErrors, HitPath, Knob, Point};
use crate::accel::{Accel, Coherence, LANES, RayPacket};
use crate::numeric::{Ray, SpawnPolicy};
use crate::parallel;
use crate::render::{HitPoint, RecordedRays, RenderSettings, record};
use crate::scene::Effect;

/// Perturbation by f32 rounding, relative to the direction's length and to the origin's largest coordinate: sixteen
/// roundings of f32, the number in a triple product with its differences.
const ROUNDING: f32 = 16.0 / (1 << 24) as f32;
/// Largest fraction of the budget, and largest number of seconds, for geometric errors.
const PART: f64 = 0.02;
const MAX_SECONDS: f64 = 3.0;
/// Largest and smallest number of camera rays.
const MAX_RAYS: f64 = 131_072.0;
const MIN_RAYS: f64 = 1024.0;
/// Number of packets that a thread traces between looks at the clock.
const CHUNK: usize = 64;
/// Stride in which chunks are processed, a prime number, so that the chunks traced before the deadline cover the image
/// evenly.
const STRIDE: usize = 7919;

/// Recorded ray packets with the reference backend's results.
pub struct ReferenceResults<'a> {
    reference: &'a dyn Accel,
    camera: &'a [RayPacket],
    shadow: &'a [RayPacket],
    /// Ray parameters of the camera rays' nearest hits, infinite for a miss.
    nearest_t: Vec<[f32; LANES]>,
    /// Occlusion of the shadow rays by the reference.
    blocked: Vec<[bool; LANES]>,
}

impl<'a> ReferenceResults<'a> {
    /// Traces all recorded rays with `reference`, whose results count as right.
    pub fn by(reference: &'a dyn Accel, rays: &'a RecordedRays) -> ReferenceResults<'a> {
        let (camera, shadow) = (&rays.camera[..], &rays.shadow[..]);
        let nearest_t = parallel::map_chunks(camera, CHUNK, &|_, chunk| hits(reference, chunk));
        let blocked = parallel::map_chunks(shadow, CHUNK, &|_, chunk| shadows(reference, chunk));
        ReferenceResults {
            nearest_t: nearest_t.concat(),
            blocked: blocked.concat(),
            reference,
            camera,
            shadow,
        }
    }

    /// Returns the errors of `accel` for the recorded rays, as many as it traces until `deadline`. It traces the shadow
    /// rays `shadow`, which have the same targets but may start elsewhere under another spawn policy. If their number
    /// differs from the recorded one, shadows are not compared.
    pub fn errors(&self, accel: &dyn Accel, shadow: &[RayPacket], deadline: Instant) -> GeometricErrors {
        let camera = self.by_chunks(self.camera.len(), deadline, &|at| self.camera_chunk(accel, at));
        let shadow_count = if shadow.len() == self.shadow.len() {
            shadow.len()
        } else {
            0
        };
        let shadow = self.by_chunks(shadow_count, deadline, &|at| self.shadow_chunk(accel, shadow, at));
        camera.with(shadow)
    }

    fn by_chunks(
        &self,
        packet_count: usize,
        deadline: Instant,
        errors: &(dyn Fn(std::ops::Range<usize>) -> GeometricErrors + Sync),
    ) -> GeometricErrors {
        let chunk_count = packet_count.div_ceil(CHUNK);
        let queried = parallel::map(chunk_count, &|turn| {
            // The first chunk is traced regardless of the deadline, so that there is a result.
            if turn > 0 && Instant::now() > deadline {
                return GeometricErrors::default();
            }
            // A stride visits every chunk exactly once unless the count is a multiple of it.
            let chunk = if chunk_count.is_multiple_of(STRIDE) {
                turn
            } else {
                turn * STRIDE % chunk_count
            };
            let start = chunk * CHUNK;
            errors(start..(start + CHUNK).min(packet_count))
        });
        queried
            .into_iter()
            .fold(GeometricErrors::default(), GeometricErrors::with)
    }

    fn camera_chunk(&self, accel: &dyn Accel, at: std::ops::Range<usize>) -> GeometricErrors {
        let mut errors = GeometricErrors::default();
        let queried = &self.camera[at.clone()];
        for ((packet, right), found) in queried.iter().zip(&self.nearest_t[at]).zip(hits(accel, queried)) {
            for lane in active(packet) {
                errors.camera_rays += 1;
                self.classify_hit(&mut errors, &packet.ray(lane), [right[lane], found[lane]]);
            }
        }
        errors
    }

    fn classify_hit(&self, errors: &mut GeometricErrors, ray: &Ray, [right, found]: [f32; 2]) {
        // Compare the hit distances within rounding
        let reach = ray.origin.abs().max_element() / ray.direction.length();
        let slack = |t: f32| ROUNDING * (reach + t.abs());
        if right == found || (right - found).abs() <= slack(right.min(found)) {
            return;
        }
        // Trace rays perturbed by rounding with the reference
        let mut packet = [RayPacket::EMPTY];
        for (lane, ray) in perturbed_rays(ray).into_iter().flatten().enumerate() {
            packet[0].set(lane, &ray);
        }
        self.reference.intersect(&mut packet, Coherence::Incoherent);
        // Classify the difference as tie, leak or false hit
        let around: [f32; LANES] = std::array::from_fn(|lane| parameter(&packet[0], lane));
        let nearest = around.iter().copied().fold(right, f32::min);
        let farthest = around.iter().copied().fold(right, f32::max);
        let is_leak = found > right;
        let is_tie = match is_leak {
            true => found <= farthest + slack(farthest),
            false => found >= nearest - slack(nearest),
        };
        errors.ties += u64::from(is_tie);
        errors.leaks += u64::from(!is_tie && is_leak);
        errors.false_hits += u64::from(!is_tie && !is_leak);
    }

    fn shadow_chunk(
        &self,
        accel: &dyn Accel,
        shadow: &[RayPacket],
        at: std::ops::Range<usize>,
    ) -> GeometricErrors {
        let mut errors = GeometricErrors::default();
        let queried = &shadow[at.clone()];
        let right = self.shadow[at.clone()].iter().zip(&self.blocked[at]);
        for (((packet, right), other), found) in right.zip(queried).zip(shadows(accel, queried)) {
            // A lane that is active in one packet only results from rounding: the surface faces away from the light
            // there.
            for lane in active(packet).filter(|&lane| other.is_active(lane)) {
                errors.shadow_rays += 1;
                if right[lane] != found[lane] {
                    self.classify_shadow(&mut errors, &packet.ray(lane), found[lane]);
                }
            }
        }
        errors
    }

    fn classify_shadow(&self, errors: &mut GeometricErrors, ray: &Ray, found: bool) {
        let mut packet = [RayPacket::EMPTY];
        // Perturb directions only: a shifted origin may lie inside the surface.
        let [turned, _] = perturbed_rays(ray);
        for (lane, ray) in turned.iter().enumerate() {
            packet[0].set(lane, ray);
        }
        self.reference.occluded(&mut packet, Coherence::Incoherent);
        let is_tie = (0..LANES / 2).any(|lane| packet[0].is_blocked(lane) == found);
        errors.ties += u64::from(is_tie);
        errors.false_shadows += u64::from(!is_tie && found);
        errors.light_leaks += u64::from(!is_tie && !found);
    }
}

/// Returns rays perturbed by the size of rounding: eight with rotated directions, and eight with shifted origins.
fn perturbed_rays(ray: &Ray) -> [[Ray; LANES / 2]; 2] {
    let (x, y) = ray.direction.normalize().any_orthonormal_pair();
    let length = ray.direction.length();
    let reach = ray.origin.abs().max_element();
    let around = |turn: usize| {
        let angle = turn as f32 * std::f32::consts::FRAC_PI_4;
        ROUNDING * (x * angle.cos() + y * angle.sin())
    };
    [
        std::array::from_fn(|turn| Ray {
            direction: ray.direction + length * around(turn),
            ..*ray
        }),
        std::array::from_fn(|turn| Ray {
            origin: ray.origin + reach * around(turn),
            ..*ray
        }),
    ]
}

fn active(packet: &RayPacket) -> impl Iterator<Item = usize> {
    (0..LANES).filter(|&lane| packet.is_active(lane))
}

/// Returns the ray parameter of a traced lane's hit; infinite for a miss.
fn parameter(packet: &RayPacket, lane: usize) -> f32 {
    packet.hit(lane).map_or(f32::INFINITY, |hit| hit.t)
}

fn hits(accel: &dyn Accel, queried: &[RayPacket]) -> Vec<[f32; LANES]> {
    let mut packets = queried.to_vec();
    accel.intersect(&mut packets, Coherence::Coherent);
    let nearest_t = packets.iter();
    nearest_t
        .map(|packet| std::array::from_fn(|lane| parameter(packet, lane)))
        .collect()
}

fn shadows(accel: &dyn Accel, queried: &[RayPacket]) -> Vec<[bool; LANES]> {
    let mut packets = queried.to_vec();
    accel.occluded(&mut packets, Coherence::Coherent);
    let traced = packets.iter();
    traced
        .map(|packet| std::array::from_fn(|lane| packet.is_blocked(lane)))
        .collect()
}

impl Workspace<'_, '_> {
    /// Counts the geometric errors of the base and of all points whose knob may change them.
    pub(super) fn count_geometric_errors(&self, layout: &Layout, points: &mut [Point]) {
        // List the points to count
        let counted: Vec<usize> = (0..points.len())
            .filter(|&place| points[place].knob.is_none_or(Knob::changes_hits))
            .collect();
        let Some(base) = points.first() else { return };
        let seconds = (PART * self.experiment.budget).min(MAX_SECONDS);
        let configuration = &layout.candidates[0].configuration;
        let samples = area(self.size_of(layout.view)) * f64::from(configuration.settings.spp);
        // One thread records rays, and all threads trace them.
        let a_ray = base.seconds.value * self.experiment.threads as f64 / samples;
        let rays = 0.5 * seconds / (a_ray * (1 + counted.len()) as f64);
        let lists = (1 + self.scene(configuration).lights.len()) as f64;
        let rays = rays.clamp(MIN_RAYS, MAX_RAYS / lists.min(MAX_RAYS / MIN_RAYS));
        // Record rays and trace them with the reference
        let recorded = self.recorded(&with_exact_spawning(configuration), rays);
        let reference = &*self.built(&configuration.with_path(HitPath::BSP)).accel;
        let right = ReferenceResults::by(reference, &recorded);
        let share = Duration::from_secs_f64(0.5 * seconds / counted.len() as f64);
        // Trace the rays with each point's backend
        for place in counted {
            self.report_step("geometry");
            let configuration = &layout.candidates[place].configuration;
            let accel = &*self.built(configuration).accel;
            let own = (with_exact_spawning(configuration) != *configuration)
                .then(|| self.recorded(configuration, rays));
            let shadow = own.as_ref().map_or(&recorded.shadow, |own| &own.shadow);
            let errors = right.errors(accel, shadow, Instant::now() + share);
            points[place].geometry = Some(errors);
        }
    }

    /// Records about `rays` camera rays of a configuration's image, and the shadow rays from their hits to the lights.
    fn recorded(&self, configuration: &Configuration, rays: f64) -> RecordedRays {
        // Scale the image to the number of rays
        let [width, height] = self.whole_size().map(f64::from);
        let scale = (rays / (width * height)).sqrt();
        let [width, height] = [width, height].map(|side| ((side * scale).round() as u32).max(1));
        let mut effects = configuration.settings.effects;
        // These effects change no camera ray or shadow ray, but would take time.
        for effect in [Effect::Volume, Effect::Subsurface, Effect::TransparentShadow] {
            effects.removed = effects.removed.with(effect);
        }
        let settings = RenderSettings {
            width,
            height,
            spp: 1,
            depth: 0,
            adaptive: None,
            ledger: false,
            effects,
            ..configuration.settings.without_aovs()
        };
        let scene = self.scene(configuration);
        let reference = &*self.built(&configuration.with_path(HitPath::BSP)).accel;
        record(scene, self.experiment.camera, reference, &settings)
    }
}

/// Returns the configuration with exact hit points and bounded spawn offsets.
fn with_exact_spawning(configuration: &Configuration) -> Configuration {
    let mut left = *configuration;
    left.settings.spawn = SpawnPolicy::Bounded;
    left.settings.hit_points = HitPoint::Refined;
    left
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::accel::AccelReport;

    /// Disk at x = 1 around the axis, with a smaller disk in it that reports a wrong hit distance, or no hit.
    #[derive(Clone, Copy)]
    struct MemoryDisk {
        radius: f32,
        wrong_radius: f32,
        added: Option<f32>,
    }

    const RIGHT: MemoryDisk = MemoryDisk {
        radius: 3.0,
        wrong_radius: -1.0,
        added: None,
    };

    impl MemoryDisk {
        fn intersect_disk(&self, ray: &Ray) -> Option<f32> {
            let t = (1.0 - ray.origin.x) / ray.direction.x;
            let aside = (ray.origin + t * ray.direction).with_x(0.0).length();
            match aside <= self.wrong_radius {
                true => self.added.map(|added| t + added),
                false => (aside <= self.radius).then_some(t),
            }
        }

        fn for_each_hit(
            &self,
            packets: &mut [RayPacket],
            mut record_hit: impl FnMut(&mut RayPacket, usize, f32),
        ) {
            for packet in packets {
                for lane in active(&packet.clone()) {
                    if let Some(t) = self.intersect_disk(&packet.ray(lane)) {
                        record_hit(packet, lane, t);
                    }
                }
            }
        }
    }

    impl Accel for MemoryDisk {
        fn intersect(&self, packets: &mut [RayPacket], _: Coherence) {
            self.for_each_hit(packets, |packet, lane, t| {
                let hit = crate::accel::Hit {
                    instance: 0,
                    primitive: 0,
                    t,
                    u: 0.0,
                    v: 0.0,
                };
                packet.set_hit(lane, &hit);
            });
        }

        fn occluded(&self, packets: &mut [RayPacket], _: Coherence) {
            self.for_each_hit(packets, |packet, lane, _| packet.set_blocked(lane));
        }

        fn report(&self) -> AccelReport {
            AccelReport::default()
        }
    }

    fn rays() -> RecordedRays {
        let mut packet = RayPacket::EMPTY;
        // At x = 1 these rays are 0, 0.5, ... 4.5 from the axis.
        for lane in 0..10 {
            packet.set(
                lane,
                &Ray::new(Vec3::ZERO, Vec3::new(1.0, 0.5 * lane as f32, 0.0)),
            );
        }
        RecordedRays {
            camera: vec![packet.clone(); 3],
            shadow: vec![packet],
            ..RecordedRays::default()
        }
    }

    fn errors_of(disk: MemoryDisk) -> GeometricErrors {
        let rays = rays();
        let results = ReferenceResults::by(&RIGHT, &rays);
        results.errors(&disk, &rays.shadow, Instant::now() + Duration::from_secs(60))
    }

    #[test]
    fn wrong_results_are_counted_by_kind() {
        let none = errors_of(RIGHT);
        let queried = (none.camera_rays, none.shadow_rays);
        assert_eq!((queried, none.count(), none.ties), ((30, 10), 0, 0));
        // The wrong disk covers rays at 0, 0.5 and 1, in three camera-ray packets and one shadow-ray packet.
        let within = |added| {
            errors_of(MemoryDisk {
                wrong_radius: 1.0,
                added,
                ..RIGHT
            })
        };
        let gone = within(None);
        assert_eq!((gone.leaks, gone.light_leaks, gone.count()), (9, 3, 12));
        let farther = within(Some(0.5));
        assert_eq!((farther.leaks, farther.count()), (9, 9));
        let nearer = within(Some(-0.5));
        assert_eq!((nearer.false_hits, nearer.count()), (9, 9));
        // This difference is within rounding.
        assert_eq!(within(Some(2.0 * f32::EPSILON)).count(), 0);
        // Rays at 3.5, 4 and 4.5 should miss.
        let more = errors_of(MemoryDisk { radius: 9.0, ..RIGHT });
        assert_eq!((more.false_hits, more.false_shadows, more.count()), (9, 3, 12));
    }

    #[test]
    fn result_within_rounding_at_an_outline_is_a_tie() {
        // The ray at 3 misses this disk; so do nearby rays with the right one.
        let radius = 3f32.next_down();
        let errors = errors_of(MemoryDisk { radius, ..RIGHT });
        assert_eq!((errors.count(), errors.ties), (0, 4));
    }

    #[test]
    fn after_the_deadline_one_chunk_of_each_kind_is_traced() {
        let mut rays = rays();
        rays.camera = vec![rays.camera[0].clone(); 10 * CHUNK];
        let past = Instant::now() - Duration::from_millis(1);
        let errors = ReferenceResults::by(&RIGHT, &rays).errors(&RIGHT, &rays.shadow, past);
        assert_eq!((errors.camera_rays, errors.shadow_rays), (10 * CHUNK as u64, 10));
    }
}
