//! One case put to one path: rays in chunks, all at once, and what is counted.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DVec3};
use serde::Serialize;

use super::judged::{Judged, Judgement};
use super::own::Reply;
use super::sketch::{Asked, Axis, Error, Sketch};
use crate::accel::{Accel, AccelError, EmbreeIdentity, Hit, LANES, RayOrder, RayPacket};
use crate::numeric::{Lanes, Ray, SplitMix64};
use crate::optics::{Fresnel, Refraction};
use crate::parallel;
use crate::render::{Monitor, RenderSettings, Rendering};
use crate::scene::{Camera, Scene, SceneError};

/// Builds what finds the hits of a scene.
pub type Build<'a> = dyn for<'s> Fn(&'s Scene) -> Result<Box<dyn Accel + 's>, AccelError> + Sync + 'a;

/// What is put to the test.
pub struct Subject<'a> {
    /// What finds hits.
    pub build: &'a Build<'a>,
    /// What is computed without a scene.
    pub formulas: Formulas,
    /// What was said of the answers of other subjects to the same case.
    pub judged: &'a Judged,
}

/// The formulas that cases ask, so that a test may put a careless one in the place of any.
#[derive(Clone, Copy)]
pub struct Formulas {
    /// As [`crate::optics::dielectric`].
    pub dielectric: fn(f64, f64, f64) -> Fresnel,
    /// As [`crate::optics::refract`].
    pub refract: fn(DVec3, DVec3, f64, f64) -> Option<Refraction>,
    /// As [`crate::volume::composite::corrected_opacity`].
    pub corrected_opacity: fn(f64, f64) -> f64,
    /// The share of light that comes through so many layers of that depth, as [`crate::volume::transmittance_of`].
    pub transmittance: fn(f64, u64) -> f64,
    /// The white light seen in an even medium of an extinction over a length of at most 2, in steps of a length, and the
    /// share let through: what [`crate::volume::March`] makes of it.
    pub march: fn(f64, f64, f64) -> [f64; 2],
    /// The sum of so many packets of samples, as [`crate::render::pixel_sum`].
    pub pixel_sum: fn(&dyn Fn(u64) -> Lanes<f32>, u64) -> f64,
    /// Whether a geometry can be placed by that map, as [`crate::scene::Instance::new`] has it.
    pub is_invertible: fn(&DAffine3) -> bool,
    /// As [`crate::numeric::spawn_point`].
    pub spawn_point: fn(DVec3, DVec3, f64) -> glam::Vec3,
    /// As [`Scene::validate`].
    pub validate: fn(&Scene) -> Result<(), SceneError>,
    /// As [`Scene::normalise`].
    pub normalise: fn(&mut Scene),
    /// As [`crate::render::render`].
    pub render: Render,
}

/// Makes a picture of a scene.
pub type Render = fn(&Scene, &Camera, &dyn Accel, &RenderSettings, &Monitor) -> Option<Rendering>;

impl Formulas {
    /// Those of the renderer.
    pub const OURS: Formulas = Formulas {
        dielectric: crate::optics::dielectric,
        refract: crate::optics::refract,
        corrected_opacity: crate::volume::composite::corrected_opacity,
        transmittance: |layer, count| crate::volume::transmittance_of((0..count).map(|_| layer)),
        march: super::marches::march,
        pixel_sum: |packet, count| crate::render::pixel_sum((0..count).map(packet)),
        is_invertible: |map| crate::scene::Instance::new("", 0, 0, *map).is_ok(),
        spawn_point: crate::numeric::spawn_point,
        validate: Scene::validate,
        normalise: Scene::normalise,
        render: crate::render::render,
    };
}

/// What was counted.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Tally {
    /// Questions asked: rays, or arguments of a formula.
    pub rays: u64,
    /// Answers that are wrong by more than the bound on rounding.
    pub wrong: u64,
    /// Answers that differ from the exact one within that bound.
    pub ties: u64,
    /// The largest error met, in the unit of the case; 0 where it has none.
    pub worst: f64,
    /// The first wrong answer, to be asked again.
    pub example: Option<String>,
    /// The first questions of each kind.
    #[serde(skip)]
    pub sketch: Sketch,
}

/// How one answer compares with the exact one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Answer {
    /// As exact as it must be.
    Right,
    /// Another one, which rounding explains.
    Tie,
    /// Another one, which it does not.
    Wrong,
}

impl Answer {
    /// Wrong if `is_wrong`, else right.
    pub(super) fn wrong_if(is_wrong: bool) -> Answer {
        if is_wrong { Answer::Wrong } else { Answer::Right }
    }
}

impl Tally {
    /// Counts one answer.
    pub(super) fn count(&mut self, answer: Answer, describe: impl FnOnce() -> String) {
        self.rays += 1;
        match answer {
            Answer::Right => {}
            Answer::Tie => self.ties += 1,
            Answer::Wrong => {
                self.wrong += 1;
                self.example.get_or_insert_with(describe);
            }
        }
    }

    /// Counts what was answered to a ray, and keeps it if it is among the first.
    pub(super) fn count_ray(&mut self, answer: Answer, ray: &Ray, hit: Option<Hit>) {
        let ray = *ray;
        self.sketch.keep(Asked { ray, hit, answer });
        self.count(answer, || describe(&ray, hit));
    }

    /// Counts the rays of a picture that came after those of its pixels, each of which was counted with its answer.
    pub(super) fn count_followed(&mut self, rendering: &Rendering) {
        let pixels = rendering.image.pixels.len() as u64;
        self.rays += rendering.ledger.total().rays.saturating_sub(pixels);
    }

    /// Notes the error of a formula at an argument, to be plotted.
    pub(super) fn note_at(&mut self, axis: Axis, at: f64, off: f64) {
        self.note(off);
        let answer = Answer::wrong_if(!(off <= axis.bound));
        self.sketch.plot(axis, Error { at, off, answer });
    }

    /// Notes an error, in the unit of the case.
    pub(super) fn note(&mut self, error: f64) {
        // A NaN is as bad as can be.
        let error = if error.is_nan() { f64::INFINITY } else { error };
        self.worst = self.worst.max(error);
    }

    /// Both together.
    pub(super) fn with(self, other: Tally) -> Tally {
        Tally {
            rays: self.rays + other.rays,
            wrong: self.wrong + other.wrong,
            ties: self.ties + other.ties,
            worst: self.worst.max(other.worst),
            example: self.example.or(other.example),
            sketch: self.sketch.with(other.sketch),
        }
    }
}

/// What a trial keeps beside its counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Keeps {
    /// The first questions.
    Questions,
    /// The first questions, and lines of what they are put to.
    Drawings,
}

/// Questions of a chunk: so many that threads share the work, so few that memory does not count.
const CHUNK: u64 = 4096;

/// One case put to one subject.
pub(super) struct Trial<'a> {
    pub(super) subject: &'a Subject<'a>,
    /// How many questions, about.
    pub(super) rays: u64,
    seed: u64,
    keeps: Keeps,
}

impl<'a> Trial<'a> {
    /// The trial of a case: its name says which random numbers it takes.
    pub(super) fn new(id: &str, rays: u64, subject: &'a Subject<'a>) -> Trial<'a> {
        let seed = id.bytes().fold(0, |seed: u64, byte| seed << 8 | u64::from(byte));
        Trial {
            subject,
            rays,
            seed,
            keeps: Keeps::Questions,
        }
    }

    /// The same with drawings of what is asked.
    pub(super) fn drawn(self) -> Trial<'a> {
        Trial {
            keeps: Keeps::Drawings,
            ..self
        }
    }

    /// The same with its share of the rays, where a case consists of `count` parts; this is number `part`.
    pub(super) fn part(&self, part: usize, count: usize) -> Trial<'a> {
        Trial {
            subject: self.subject,
            rays: (self.rays / count as u64).max(1),
            seed: SplitMix64::new(self.seed, part as u64).bits(),
            keeps: self.keeps,
        }
    }

    /// Puts its share of the questions to each of `count` parts, several at once, and adds up what they count: the same
    /// for every number of threads.
    pub(super) fn over_parts(
        &self,
        count: usize,
        ask: &(dyn Fn(usize, Trial) -> Result<Tally, AccelError> + Sync),
    ) -> Result<Tally, AccelError> {
        sum(count as u64, &|number| {
            let number = number as usize;
            ask(number, self.part(number, count))
        })
    }

    /// Builds what finds the hits of `scene`.
    pub(super) fn engine<'s>(&self, scene: &'s Scene) -> Result<Engine<'s>, AccelError> {
        let accel = (self.subject.build)(scene)?;
        Ok(Engine { accel, scene })
    }

    /// A picture of `scene` with one sample in the middle of each of `size` x `size` pixels and `depth` generations of
    /// rays that weigh `weight_cutoff` or more.
    pub(super) fn picture(
        &self,
        (scene, camera): (&Scene, &Camera),
        size: u32,
        (depth, weight_cutoff): (u32, f32),
    ) -> Result<Option<Rendering>, AccelError> {
        let accel = (self.subject.build)(scene)?;
        let settings = RenderSettings {
            width: size,
            height: size,
            spp: 1,
            depth,
            weight_cutoff,
            ..RenderSettings::default()
        };
        let monitor = Monitor {
            progress: &|_| {},
            cancel: &AtomicBool::new(false),
            tiles: None,
        };
        Ok((self.subject.formulas.render)(
            scene, camera, &*accel, &settings, &monitor,
        ))
    }

    /// Asks `ask` for the questions of each chunk and adds up what it counts: the same for every number of threads.
    pub(super) fn in_chunks(&self, ask: &(dyn Fn(&mut SplitMix64, usize) -> Tally + Sync)) -> Tally {
        self.in_numbered_chunks(&|_, random, count| ask(random, count))
    }

    /// As [`Trial::in_chunks`], with the number of the chunk.
    fn in_numbered_chunks(&self, ask: &(dyn Fn(u64, &mut SplitMix64, usize) -> Tally + Sync)) -> Tally {
        let Ok(tally) = sum::<Infallible>(self.rays.div_ceil(CHUNK), &|index| {
            let count = CHUNK.min(self.rays - index * CHUNK);
            Ok(ask(index, &mut SplitMix64::new(self.seed, index), count as usize))
        });
        tally
    }

    /// Whether lines of scenes are wanted.
    pub(super) fn is_drawn(&self) -> bool {
        self.keeps == Keeps::Drawings
    }

    /// What was counted of rays through `engine`, with lines of its scene where they are wanted.
    pub(super) fn with_drawing(&self, engine: &Engine, mut tally: Tally) -> Tally {
        if self.is_drawn() {
            tally.sketch.draw(engine.scene);
        }
        tally
    }

    /// Asks for the nearest hits of rays that `ray` makes, and counts what `judge` says of each, and the error that it
    /// notes. An answer that another subject gave is not judged again.
    pub(super) fn nearest(
        &self,
        engine: &Engine,
        ray: &(dyn Fn(&mut SplitMix64) -> Ray + Sync),
        judge: &(dyn Fn(&Ray, Option<Hit>, &mut Tally) -> Answer + Sync),
    ) -> Tally {
        let tally = self.in_numbered_chunks(&|number, random, count| {
            let rays: Vec<Ray> = (0..count).map(|_| ray(random)).collect();
            let hits = engine.nearest(&rays, order(random));
            let said = self.subject.judged.recall((self.seed, number));
            let mut judgements = Vec::with_capacity(if said.is_empty() { count } else { 0 });
            let mut tally = Tally::default();
            for (i, (ray, hit)) in rays.iter().zip(hits).enumerate() {
                let judgement = said.get(i).and_then(|said| said.of(hit));
                let judgement = judgement.unwrap_or_else(|| {
                    let mut own = Tally::default();
                    let answer = judge(ray, hit, &mut own);
                    let error = own.worst;
                    Judgement { hit, answer, error }
                });
                tally.note(judgement.error);
                tally.count_ray(judgement.answer, ray, hit);
                if said.is_empty() {
                    judgements.push(judgement);
                }
            }
            if said.is_empty() {
                self.subject.judged.keep((self.seed, number), judgements);
            }
            tally
        });
        self.with_drawing(engine, tally)
    }
}

/// Runs of tallies that are summed up each by one thread, at most: as many are kept until all are there.
const MAX_RUNS: u64 = 1 << 10;

/// Returns the sum of `tally(0..count)` in that order, or the error of the first that fails.
fn sum<E: Send>(count: u64, tally: &(dyn Fn(u64) -> Result<Tally, E> + Sync)) -> Result<Tally, E> {
    let run = count.div_ceil(MAX_RUNS).max(1);
    let runs = parallel::try_map(count.div_ceil(run) as usize, &|number| {
        let first = number as u64 * run;
        let mut sum = tally(first)?;
        for index in first + 1..count.min(first + run) {
            sum = sum.with(tally(index)?);
        }
        Ok(sum)
    })?;
    Ok(runs.into_iter().reduce(Tally::with).unwrap_or_default())
}

/// Either order: it changes the speed, never the answer.
pub(super) fn order(random: &mut SplitMix64) -> RayOrder {
    random.pick(&[RayOrder::Coherent, RayOrder::Incoherent])
}

/// A ray and what was answered, so that both can be had again.
pub fn describe(ray: &Ray, hit: Option<Hit>) -> String {
    format!("{}: {}", describe_ray(ray), Reply::of_hit(hit))
}

/// A ray, so that it can be had again.
pub fn describe_ray(ray: &Ray) -> String {
    let Ray {
        origin: o,
        direction: d,
        t_near,
        t_far,
        ..
    } = ray;
    format!(
        "from [{:e}, {:e}, {:e}] along [{:e}, {:e}, {:e}] between {t_near:e} and {t_far:e}",
        o.x, o.y, o.z, d.x, d.y, d.z
    )
}

/// What was built over a scene.
pub(super) struct Engine<'s> {
    accel: Box<dyn Accel + 's>,
    scene: &'s Scene,
}

impl<'s> Engine<'s> {
    /// One that was built elsewhere, over that scene.
    pub(super) fn of(accel: Box<dyn Accel + 's>, scene: &'s Scene) -> Engine<'s> {
        Engine { accel, scene }
    }

    /// The rays in packets, asked for their nearest hits.
    pub(super) fn traced(&self, rays: &[Ray], order: RayOrder) -> Vec<RayPacket> {
        let mut packets = packets(rays);
        self.accel.intersect(&mut packets, order);
        packets
    }

    /// The nearest hit of each ray.
    pub(super) fn nearest(&self, rays: &[Ray], order: RayOrder) -> Vec<Option<Hit>> {
        let packets = self.traced(rays, order);
        (0..rays.len())
            .map(|i| packets[i / LANES].hit(i % LANES))
            .collect()
    }

    /// Whether each ray meets anything.
    pub(super) fn blocked(&self, rays: &[Ray], order: RayOrder) -> Vec<bool> {
        let mut packets = packets(rays);
        self.accel.occluded(&mut packets, order);
        (0..rays.len())
            .map(|i| packets[i / LANES].is_blocked(i % LANES))
            .collect()
    }
}

/// Which Embree a subject's is, if it is one.
pub(super) fn embree_identity(subject: &Subject) -> Result<Option<EmbreeIdentity>, AccelError> {
    let scene = Scene::default();
    Ok((subject.build)(&scene)?.report().embree)
}

fn packets(rays: &[Ray]) -> Vec<RayPacket> {
    let mut packets = vec![RayPacket::EMPTY; rays.len().div_ceil(LANES)];
    for (i, ray) in rays.iter().enumerate() {
        packets[i / LANES].set(i % LANES, ray);
    }
    packets
}
