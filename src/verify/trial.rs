//! Runs one case on one system under test: generates rays in chunks, in parallel, and counts the results.

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

/// Function that builds the acceleration structure of a scene.
pub type Build<'a> = dyn for<'s> Fn(&'s Scene) -> Result<Box<dyn Accel + 's>, AccelError> + Sync + 'a;

/// System under test: acceleration structure and formulas.
pub struct Subject<'a> {
    /// Builder of the acceleration structure.
    pub build: &'a Build<'a>,
    /// Functions that need no scene.
    pub formulas: Formulas,
    /// Cached verdicts on the results of other systems under test for this case.
    pub judged: &'a Judged,
}

/// Functions of the renderer that cases test; a test may replace any of them by a careless one.
#[derive(Clone, Copy)]
pub struct Formulas {
    /// Fresnel reflectance, see [`crate::optics::dielectric`].
    pub dielectric: fn(f64, f64, f64) -> Fresnel,
    /// Refracted direction, see [`crate::optics::refract`].
    pub refract: fn(DVec3, DVec3, f64, f64) -> Option<Refraction>,
    /// Opacity correction for a step length, see [`crate::volume::composite::corrected_opacity`].
    pub corrected_opacity: fn(f64, f64) -> f64,
    /// Transmittance of a number of layers of one optical depth, see [`crate::volume::transmittance_of`].
    pub transmittance: fn(f64, u64) -> f64,
    /// White radiance and transmittance of a homogeneous medium from its extinction, a length of at most 2 and the step
    /// length, computed with [`crate::volume::March`].
    pub march: fn(f64, f64, f64) -> [f64; 2],
    /// Sum of a number of packets of samples, see [`crate::render::pixel_sum`].
    pub pixel_sum: fn(&dyn Fn(u64) -> Lanes<f32>, u64) -> f64,
    /// Test whether a geometry can be instanced with a transform, see [`crate::scene::Instance::new`].
    pub is_invertible: fn(&DAffine3) -> bool,
    /// Offset origin of a spawned ray, see [`crate::numeric::spawn_point`].
    pub spawn_point: fn(DVec3, DVec3, f64) -> glam::Vec3,
    /// Scene validation, see [`Scene::validate`].
    pub validate: fn(&Scene) -> Result<(), SceneError>,
    /// Scene normalisation, see [`Scene::normalise`].
    pub normalise: fn(&mut Scene),
    /// Renderer of whole images, see [`crate::render::render`].
    pub render: Render,
}

/// Function that renders an image of a scene.
pub type Render = fn(&Scene, &Camera, &dyn Accel, &RenderSettings, &Monitor) -> Option<Rendering>;

impl Formulas {
    /// Functions of the renderer itself.
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

/// Counts of a case, with its largest error.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Tally {
    /// Number of queries: rays, or arguments of a formula.
    pub rays: u64,
    /// Results that are wrong by more than the rounding error bound.
    pub wrong: u64,
    /// Results that differ from the exact one within the rounding error bound.
    pub ties: u64,
    /// Largest error, in the unit of the case; 0 if the case measures none.
    pub worst: f64,
    /// First wrong result, in a form that allows reproducing the ray.
    pub example: Option<String>,
    /// First queries of each kind, for figures.
    #[serde(skip)]
    pub sketch: Sketch,
}

/// Verdict on one result against the exact one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Answer {
    /// Result as exact as the case requires.
    Right,
    /// Different result that rounding explains.
    Tie,
    /// Different result that rounding does not explain.
    Wrong,
}

impl Answer {
    /// Returns `Wrong` if `is_wrong`, else `Right`.
    pub(super) fn wrong_if(is_wrong: bool) -> Answer {
        if is_wrong { Answer::Wrong } else { Answer::Right }
    }
}

impl Tally {
    /// Counts one result; `describe` is called only for the first wrong one.
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

    /// Counts the result of a ray query and keeps the ray if it is among the first of its kind.
    pub(super) fn count_ray(&mut self, answer: Answer, ray: &Ray, hit: Option<Hit>) {
        let ray = *ray;
        self.sketch.keep(Asked { ray, hit, answer });
        self.count(answer, || describe(&ray, hit));
    }

    /// Counts the secondary rays of an image; its camera rays have been counted with their verdicts.
    pub(super) fn count_followed(&mut self, rendering: &Rendering) {
        let pixels = rendering.image.pixels.len() as u64;
        self.rays += rendering.ledger.total().rays.saturating_sub(pixels);
    }

    /// Records the error of a formula at an argument, for the plot.
    pub(super) fn note_at(&mut self, axis: Axis, at: f64, off: f64) {
        self.note(off);
        let answer = Answer::wrong_if(!(off <= axis.bound));
        self.sketch.plot(axis, Error { at, off, answer });
    }

    /// Records an error, in the unit of the case.
    pub(super) fn note(&mut self, error: f64) {
        // NaN counts as an infinite error.
        let error = if error.is_nan() { f64::INFINITY } else { error };
        self.worst = self.worst.max(error);
    }

    /// Returns the sum of two tallies; the first example wins.
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

/// Detail that a trial records beside its counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Keeps {
    /// First queries of each kind.
    Questions,
    /// First queries of each kind, and line drawings of their scenes.
    Drawings,
}

/// Queries of a chunk: enough chunks to share the work among threads, few enough queries that memory is negligible.
const CHUNK: u64 = 4096;

/// One case on one system under test.
pub(super) struct Trial<'a> {
    pub(super) subject: &'a Subject<'a>,
    /// Approximate number of queries.
    pub(super) rays: u64,
    seed: u64,
    keeps: Keeps,
}

impl<'a> Trial<'a> {
    /// Creates the trial of a case; the identifier seeds its random numbers.
    pub(super) fn new(id: &str, rays: u64, subject: &'a Subject<'a>) -> Trial<'a> {
        let seed = id.bytes().fold(0, |seed: u64, byte| seed << 8 | u64::from(byte));
        Trial {
            subject,
            rays,
            seed,
            keeps: Keeps::Questions,
        }
    }

    /// Returns the trial with line drawings of its scenes enabled.
    pub(super) fn drawn(self) -> Trial<'a> {
        Trial {
            keeps: Keeps::Drawings,
            ..self
        }
    }

    /// Returns part `part` of a case that consists of `count` parts, with its share of the rays and its own seed.
    pub(super) fn part(&self, part: usize, count: usize) -> Trial<'a> {
        Trial {
            subject: self.subject,
            rays: (self.rays / count as u64).max(1),
            seed: SplitMix64::new(self.seed, part as u64).bits(),
            keeps: self.keeps,
        }
    }

    /// Runs `ask` for each of `count` parts with its share of the queries, in parallel, and adds up the tallies. The
    /// result does not depend on the number of threads.
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

    /// Builds the acceleration structure of `scene`.
    pub(super) fn engine<'s>(&self, scene: &'s Scene) -> Result<Engine<'s>, AccelError> {
        let accel = (self.subject.build)(scene)?;
        Ok(Engine { accel, scene })
    }

    /// Renders an image of `scene` with one sample in the centre of each of `size` x `size` pixels and `depth` bounces
    /// of rays whose throughput is `weight_cutoff` or more.
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

    /// Runs `ask` for the queries of each chunk and adds up the tallies. The result does not depend on the number of
    /// threads.
    pub(super) fn in_chunks(&self, ask: &(dyn Fn(&mut SplitMix64, usize) -> Tally + Sync)) -> Tally {
        self.in_numbered_chunks(&|_, random, count| ask(random, count))
    }

    /// Runs `ask` as [`Trial::in_chunks`] does, and passes it the number of the chunk.
    fn in_numbered_chunks(&self, ask: &(dyn Fn(u64, &mut SplitMix64, usize) -> Tally + Sync)) -> Tally {
        let Ok(tally) = sum::<Infallible>(self.rays.div_ceil(CHUNK), &|index| {
            let count = CHUNK.min(self.rays - index * CHUNK);
            Ok(ask(index, &mut SplitMix64::new(self.seed, index), count as usize))
        });
        tally
    }

    /// Returns whether line drawings of scenes are enabled.
    pub(super) fn is_drawn(&self) -> bool {
        self.keeps == Keeps::Drawings
    }

    /// Returns `tally` with a line drawing of the engine's scene if drawings are enabled.
    pub(super) fn with_drawing(&self, engine: &Engine, mut tally: Tally) -> Tally {
        if self.is_drawn() {
            tally.sketch.draw(engine.scene);
        }
        tally
    }

    /// Traces nearest-hit queries for rays made by `ray`, judges each result with `judge`, and counts the verdicts and
    /// errors. A result that another system under test has returned bit for bit is not judged again.
    pub(super) fn nearest(
        &self,
        engine: &Engine,
        ray: &(dyn Fn(&mut SplitMix64) -> Ray + Sync),
        judge: &(dyn Fn(&Ray, Option<Hit>, &mut Tally) -> Answer + Sync),
    ) -> Tally {
        let tally = self.in_numbered_chunks(&|number, random, count| {
            // Generate the rays of the chunk and trace them
            let rays: Vec<Ray> = (0..count).map(|_| ray(random)).collect();
            let hits = engine.nearest(&rays, order(random));
            // Look up the verdicts of an earlier system under test
            let said = self.subject.judged.recall((self.seed, number));
            let mut judgements = Vec::with_capacity(if said.is_empty() { count } else { 0 });
            let mut tally = Tally::default();
            for (i, (ray, hit)) in rays.iter().zip(hits).enumerate() {
                // Judge the hit, unless its verdict is cached
                let judgement = said.get(i).and_then(|said| said.of(hit));
                let judgement = judgement.unwrap_or_else(|| {
                    let mut own = Tally::default();
                    let answer = judge(ray, hit, &mut own);
                    let error = own.worst;
                    Judgement { hit, answer, error }
                });
                // Count the verdict
                tally.note(judgement.error);
                tally.count_ray(judgement.answer, ray, hit);
                if said.is_empty() {
                    judgements.push(judgement);
                }
            }
            // Cache the verdicts of the first system under test
            if said.is_empty() {
                self.subject.judged.keep((self.seed, number), judgements);
            }
            tally
        });
        self.with_drawing(engine, tally)
    }
}

/// Largest number of runs of tallies; each run is summed up by one thread, and all sums stay in memory until the end.
const MAX_RUNS: u64 = 1 << 10;

/// Returns the sum of `tally(0..count)` in ascending order, or the error of the first that fails.
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

/// Returns a random ray order, which affects the speed but never the result.
pub(super) fn order(random: &mut SplitMix64) -> RayOrder {
    random.pick(&[RayOrder::Coherent, RayOrder::Incoherent])
}

/// Formats a ray with its hit so that both can be reproduced.
pub fn describe(ray: &Ray, hit: Option<Hit>) -> String {
    format!("{}: {}", describe_ray(ray), Reply::of_hit(hit))
}

/// Formats a ray so that it can be reproduced.
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

/// Acceleration structure with the scene that it was built over.
pub(super) struct Engine<'s> {
    accel: Box<dyn Accel + 's>,
    scene: &'s Scene,
}

impl<'s> Engine<'s> {
    /// Wraps a structure that was built elsewhere over `scene`.
    pub(super) fn of(accel: Box<dyn Accel + 's>, scene: &'s Scene) -> Engine<'s> {
        Engine { accel, scene }
    }

    /// Packs the rays into packets and traces their nearest hits.
    pub(super) fn traced(&self, rays: &[Ray], order: RayOrder) -> Vec<RayPacket> {
        let mut packets = packets(rays);
        self.accel.intersect(&mut packets, order);
        packets
    }

    /// Returns the nearest hit of each ray.
    pub(super) fn nearest(&self, rays: &[Ray], order: RayOrder) -> Vec<Option<Hit>> {
        let packets = self.traced(rays, order);
        (0..rays.len())
            .map(|i| packets[i / LANES].hit(i % LANES))
            .collect()
    }

    /// Returns whether each ray is occluded.
    pub(super) fn blocked(&self, rays: &[Ray], order: RayOrder) -> Vec<bool> {
        let mut packets = packets(rays);
        self.accel.occluded(&mut packets, order);
        (0..rays.len())
            .map(|i| packets[i / LANES].is_blocked(i % LANES))
            .collect()
    }
}

/// Returns the version and instruction set of Embree if the system under test uses it.
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
