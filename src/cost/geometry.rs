//! Errors of geometry, as an axis of their own: rays that go through what they should meet, and shadows where there are
//! none.
//!
//! Rays of the scene's own picture are recorded, from the eye and from surfaces to lights, and every way of finding hits
//! answers the same ones. What it is held against is the BSP, which decides in f64 where f32 cannot. An answer that
//! differs is an error unless a ray beside it, moved by what rounding in f32 may move it by, gets that answer from the
//! BSP too: then it is a tie, as at an outline.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::layout::{Layout, area};
use super::stage::Stage;
use super::{Configuration, HitPath, Interval, Knob, Point};
use crate::accel::{Accel, LANES, RayOrder, RayPacket};
use crate::numeric::{Ray, SpawnPolicy};
use crate::parallel;
use crate::render::{HitPoint, LayerSet, LightLayers, RecordedRays, RenderSettings, record};
use crate::scene::Effect;

/// What rounding may move a ray by, of its direction's length and of its origin's largest coordinate: sixteen roundings
/// of f32, as many as a triple product and the differences that it is made from have.
const ROUNDING: f32 = 16.0 / (1 << 24) as f32;
/// Part of the budget, and seconds, that go into this at most.
const PART: f64 = 0.02;
const MAX_SECONDS: f64 = 3.0;
/// Camera rays, at most and at least.
const MAX_RAYS: f64 = 131_072.0;
const MIN_RAYS: f64 = 1024.0;
/// Packets that a thread answers before it looks at the clock.
const CHUNK: usize = 64;
/// Chunks are taken in steps of this, a prime number, so that those answered in time lie evenly over the picture.
const STRIDE: usize = 7919;

/// How many answers to the rays of a picture differ from those that f64 gives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GeometricErrors {
    /// Rays from the eye that were asked about.
    pub camera_rays: u64,
    /// Rays from surfaces to lights that were asked about.
    pub shadow_rays: u64,
    /// Camera rays that pass what they should meet, or meet something behind it.
    pub leaks: u64,
    /// Camera rays that meet something where nothing is, or before what they should meet.
    pub false_hits: u64,
    /// Shadow rays that are blocked though the light is seen: by the surface that they leave, or by others.
    pub false_shadows: u64,
    /// Shadow rays that reach the light though something is in the way.
    pub light_leaks: u64,
    /// Answers that differ by no more than rounding explains.
    pub ties: u64,
}

impl GeometricErrors {
    /// Answers that rounding does not explain.
    pub fn count(&self) -> u64 {
        self.leaks + self.false_hits + self.false_shadows + self.light_leaks
    }

    /// Rays that were asked about.
    pub fn rays(&self) -> u64 {
        self.camera_rays + self.shadow_rays
    }

    /// The share of wrong answers, by the score interval (E. B. Wilson, "Probable Inference, the Law of Succession, and
    /// Statistical Inference", Journal of the American Statistical Association 22, 1927).
    pub fn share(&self) -> Interval {
        // So many deviations on either side hold 95 of 100 of a normal distribution.
        const DEVIATIONS: f64 = 1.96;
        let rays = self.rays() as f64;
        let value = self.count() as f64 / rays;
        let square = DEVIATIONS * DEVIATIONS / rays;
        let middle = (value + 0.5 * square) / (1.0 + square);
        let half = (square * (value * (1.0 - value) + 0.25 * square)).sqrt() / (1.0 + square);
        Interval {
            value,
            low: (middle - half).max(0.0),
            high: (middle + half).min(1.0),
        }
    }

    fn with(self, other: GeometricErrors) -> GeometricErrors {
        GeometricErrors {
            camera_rays: self.camera_rays + other.camera_rays,
            shadow_rays: self.shadow_rays + other.shadow_rays,
            leaks: self.leaks + other.leaks,
            false_hits: self.false_hits + other.false_hits,
            false_shadows: self.false_shadows + other.false_shadows,
            light_leaks: self.light_leaks + other.light_leaks,
            ties: self.ties + other.ties,
        }
    }
}

impl Knob {
    /// Whether it can change which hits are found, so that its points have [`GeometricErrors`].
    pub const fn changes_hits(self) -> bool {
        matches!(
            self,
            Knob::HitPath
                | Knob::Instancing
                | Knob::BuildQuality
                | Knob::Compactness
                | Knob::SpawnPoints
                | Knob::HitRefinement
        )
    }
}

/// Packets as they were recorded, with the answers that count.
pub struct Answered<'a> {
    reference: &'a dyn Accel,
    camera: &'a [RayPacket],
    shadow: &'a [RayPacket],
    /// Parameters of what the camera rays meet, infinite for nothing.
    met: Vec<[f32; LANES]>,
    /// Whether the shadow rays are blocked.
    blocked: Vec<[bool; LANES]>,
}

impl<'a> Answered<'a> {
    /// By `reference`, whatever it answers.
    pub fn by(reference: &'a dyn Accel, rays: &'a RecordedRays) -> Answered<'a> {
        let (camera, shadow) = (&rays.camera[..], &rays.shadow[..]);
        let met = parallel::map_chunks(camera, CHUNK, &|_, chunk| hits(reference, chunk));
        let blocked = parallel::map_chunks(shadow, CHUNK, &|_, chunk| shadows(reference, chunk));
        Answered {
            met: met.concat(),
            blocked: blocked.concat(),
            reference,
            camera,
            shadow,
        }
    }

    /// How `accel` errs about the same rays, as many of them as it answers until `deadline`. It is asked the shadow rays
    /// `shadow`, which go to the same places from where another rule lets them start; where they are not the same in
    /// number, nothing is said of shadows.
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
        let asked = parallel::map(chunk_count, &|turn| {
            // The first of all is answered whatever the time is.
            if turn > 0 && Instant::now() > deadline {
                return GeometricErrors::default();
            }
            let chunk = if chunk_count.is_multiple_of(STRIDE) {
                turn
            } else {
                turn * STRIDE % chunk_count
            };
            let start = chunk * CHUNK;
            errors(start..(start + CHUNK).min(packet_count))
        });
        asked
            .into_iter()
            .fold(GeometricErrors::default(), GeometricErrors::with)
    }

    fn camera_chunk(&self, accel: &dyn Accel, at: std::ops::Range<usize>) -> GeometricErrors {
        let mut errors = GeometricErrors::default();
        let asked = &self.camera[at.clone()];
        for ((packet, right), found) in asked.iter().zip(&self.met[at]).zip(hits(accel, asked)) {
            for lane in active(packet) {
                errors.camera_rays += 1;
                self.count_hit(&mut errors, &packet.ray(lane), [right[lane], found[lane]]);
            }
        }
        errors
    }

    fn count_hit(&self, errors: &mut GeometricErrors, ray: &Ray, [right, found]: [f32; 2]) {
        let reach = ray.origin.abs().max_element() / ray.direction.length();
        let slack = |t: f32| ROUNDING * (reach + t.abs());
        if right == found || (right - found).abs() <= slack(right.min(found)) {
            return;
        }
        let mut packet = [RayPacket::EMPTY];
        for (lane, ray) in beside(ray).into_iter().flatten().enumerate() {
            packet[0].set(lane, &ray);
        }
        self.reference.intersect(&mut packet, RayOrder::Incoherent);
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
        let asked = &shadow[at.clone()];
        let right = self.shadow[at.clone()].iter().zip(&self.blocked[at]);
        for (((packet, right), other), found) in right.zip(asked).zip(shadows(accel, asked)) {
            // Where a lane is asked of one and not of the other, rounding has turned the surface away from the light.
            for lane in active(packet).filter(|&lane| other.is_active(lane)) {
                errors.shadow_rays += 1;
                if right[lane] != found[lane] {
                    self.count_shadow(&mut errors, &packet.ray(lane), found[lane]);
                }
            }
        }
        errors
    }

    fn count_shadow(&self, errors: &mut GeometricErrors, ray: &Ray, found: bool) {
        let mut packet = [RayPacket::EMPTY];
        // From where it starts: what is beside that may be within the surface.
        let [turned, _] = beside(ray);
        for (lane, ray) in turned.iter().enumerate() {
            packet[0].set(lane, ray);
        }
        self.reference.occluded(&mut packet, RayOrder::Incoherent);
        let is_tie = (0..LANES / 2).any(|lane| packet[0].is_blocked(lane) == found);
        errors.ties += u64::from(is_tie);
        errors.false_shadows += u64::from(!is_tie && found);
        errors.light_leaks += u64::from(!is_tie && !found);
    }
}

/// Rays around one, as far from it as rounding may move it: eight that are turned, and eight that start aside.
fn beside(ray: &Ray) -> [[Ray; LANES / 2]; 2] {
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

/// Where a traced lane has hit something; infinite for nothing.
fn parameter(packet: &RayPacket, lane: usize) -> f32 {
    packet.hit(lane).map_or(f32::INFINITY, |hit| hit.t)
}

fn hits(accel: &dyn Accel, asked: &[RayPacket]) -> Vec<[f32; LANES]> {
    let mut packets = asked.to_vec();
    accel.intersect(&mut packets, RayOrder::Coherent);
    let met = packets.iter();
    met.map(|packet| std::array::from_fn(|lane| parameter(packet, lane)))
        .collect()
}

fn shadows(accel: &dyn Accel, asked: &[RayPacket]) -> Vec<[bool; LANES]> {
    let mut packets = asked.to_vec();
    accel.occluded(&mut packets, RayOrder::Coherent);
    let answered = packets.iter();
    answered
        .map(|packet| std::array::from_fn(|lane| packet.is_blocked(lane)))
        .collect()
}

impl Stage<'_, '_> {
    /// Counts the geometric errors of the base and of all points whose knob may change them.
    pub(super) fn count_geometric_errors(&self, layout: &Layout, points: &mut [Point]) {
        let counted: Vec<usize> = (0..points.len())
            .filter(|&place| points[place].knob.is_none_or(Knob::changes_hits))
            .collect();
        let Some(base) = points.first() else { return };
        let seconds = (PART * self.experiment.budget).min(MAX_SECONDS);
        let configuration = &layout.contestants[0].configuration;
        let samples = area(self.size_of(layout.view)) * f64::from(configuration.settings.spp);
        // Recorded on one thread, then answered by each.
        let a_ray = base.seconds.value * self.experiment.threads as f64 / samples;
        let rays = 0.5 * seconds / (a_ray * (1 + counted.len()) as f64);
        let lists = (1 + self.scene(configuration).lights.len()) as f64;
        let rays = rays.clamp(MIN_RAYS, MAX_RAYS / lists.min(MAX_RAYS / MIN_RAYS));
        let recorded = self.recorded(&left_rightly(configuration), rays);
        let reference = &*self.built(&configuration.through(HitPath::BSP)).accel;
        let right = Answered::by(reference, &recorded);
        let share = Duration::from_secs_f64(0.5 * seconds / counted.len() as f64);
        for place in counted {
            self.say("geometry");
            let configuration = &layout.contestants[place].configuration;
            let accel = &*self.built(configuration).accel;
            let own =
                (left_rightly(configuration) != *configuration).then(|| self.recorded(configuration, rays));
            let shadow = own.as_ref().map_or(&recorded.shadow, |own| &own.shadow);
            let errors = right.errors(accel, shadow, Instant::now() + share);
            points[place].geometry = Some(errors);
        }
    }

    /// About so many camera rays of a configuration's picture, and the rays from what they meet to the lights.
    fn recorded(&self, configuration: &Configuration, rays: f64) -> RecordedRays {
        let [width, height] = self.whole_size().map(f64::from);
        let scale = (rays / (width * height)).sqrt();
        let [width, height] = [width, height].map(|side| ((side * scale).round() as u32).max(1));
        let mut effects = configuration.settings.effects;
        // No ray from the eye or to a light is another for these.
        for effect in [Effect::Volume, Effect::Subsurface, Effect::TransparentShadow] {
            effects.removed = effects.removed.with(effect);
        }
        let settings = RenderSettings {
            width,
            height,
            spp: 1,
            depth: 0,
            adaptive: None,
            sample_aovs: false,
            layers: LayerSet::NONE,
            light_layers: LightLayers::NONE,
            cost_aovs: false,
            ledger: false,
            effects,
            ..configuration.settings
        };
        let scene = self.scene(configuration);
        let reference = &*self.built(&configuration.through(HitPath::BSP)).accel;
        record(scene, self.experiment.camera, reference, &settings)
    }
}

/// The same with surfaces left as it is right.
fn left_rightly(configuration: &Configuration) -> Configuration {
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

    /// A disk at x = 1 around the axis, and a smaller one in it that is told to be nearer or farther, or not at all.
    #[derive(Clone, Copy)]
    struct Disk {
        radius: f32,
        wrong_radius: f32,
        added: Option<f32>,
    }

    const RIGHT: Disk = Disk {
        radius: 3.0,
        wrong_radius: -1.0,
        added: None,
    };

    impl Disk {
        fn meets(&self, ray: &Ray) -> Option<f32> {
            let t = (1.0 - ray.origin.x) / ray.direction.x;
            let aside = (ray.origin + t * ray.direction).with_x(0.0).length();
            match aside <= self.wrong_radius {
                true => self.added.map(|added| t + added),
                false => (aside <= self.radius).then_some(t),
            }
        }

        fn ask(&self, packets: &mut [RayPacket], mut answer: impl FnMut(&mut RayPacket, usize, f32)) {
            for packet in packets {
                for lane in active(&packet.clone()) {
                    if let Some(t) = self.meets(&packet.ray(lane)) {
                        answer(packet, lane, t);
                    }
                }
            }
        }
    }

    impl Accel for Disk {
        fn intersect(&self, packets: &mut [RayPacket], _: RayOrder) {
            self.ask(packets, |packet, lane, t| {
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

        fn occluded(&self, packets: &mut [RayPacket], _: RayOrder) {
            self.ask(packets, |packet, lane, _| packet.set_blocked(lane));
        }

        fn report(&self) -> AccelReport {
            AccelReport::default()
        }
    }

    fn rays() -> RecordedRays {
        let mut packet = RayPacket::EMPTY;
        // At 1 these are 0, 0.5, ... 4.5 from the axis.
        for lane in 0..10 {
            packet.set(
                lane,
                &Ray::new(Vec3::ZERO, Vec3::new(1.0, 0.5 * lane as f32, 0.0)),
            );
        }
        RecordedRays {
            camera: vec![packet.clone(); 3],
            shadow: vec![packet],
            reflection: Vec::new(),
        }
    }

    fn errors_of(disk: Disk) -> GeometricErrors {
        let rays = rays();
        let answered = Answered::by(&RIGHT, &rays);
        answered.errors(&disk, &rays.shadow, Instant::now() + Duration::from_secs(60))
    }

    #[test]
    fn every_kind_of_wrong_answer_is_counted_as_what_it_is() {
        let none = errors_of(RIGHT);
        let asked = (none.camera_rays, none.shadow_rays);
        assert_eq!((asked, none.count(), none.ties), ((30, 10), 0, 0));
        // Of rays at 0, 0.5 and 1, in three packets of camera rays and one of shadow rays.
        let within = |added| {
            errors_of(Disk {
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
        // As near as rounding.
        assert_eq!(within(Some(2.0 * f32::EPSILON)).count(), 0);
        // 3.5, 4 and 4.5 should meet nothing.
        let more = errors_of(Disk { radius: 9.0, ..RIGHT });
        assert_eq!((more.false_hits, more.false_shadows, more.count()), (9, 3, 12));
    }

    #[test]
    fn at_an_outline_an_answer_that_rounding_explains_is_a_tie() {
        // The ray at 3 misses this one, and so do rays beside it the right one.
        let radius = 3f32.next_down();
        let errors = errors_of(Disk { radius, ..RIGHT });
        assert_eq!((errors.count(), errors.ties), (0, 4));
    }

    #[test]
    fn after_the_deadline_no_more_is_asked_than_a_chunk_of_each_kind() {
        let mut rays = rays();
        rays.camera = vec![rays.camera[0].clone(); 10 * CHUNK];
        let past = Instant::now() - Duration::from_millis(1);
        let errors = Answered::by(&RIGHT, &rays).errors(&RIGHT, &rays.shadow, past);
        assert_eq!((errors.camera_rays, errors.shadow_rays), (10 * CHUNK as u64, 10));
    }

    #[test]
    fn of_few_rays_a_share_is_not_known_well() {
        let errors = GeometricErrors {
            camera_rays: 100,
            leaks: 10,
            ..GeometricErrors::default()
        };
        // Wilson, 1927: 10 of 100 lie between 0.0552 and 0.1744.
        let share = errors.share();
        assert!(
            (share.low - 0.0552).abs() < 1e-4 && (share.high - 0.1744).abs() < 1e-4,
            "{share:?}"
        );
        let none = GeometricErrors { leaks: 0, ..errors };
        assert!(none.share().low == 0.0 && none.share().high > 0.03);
    }
}
