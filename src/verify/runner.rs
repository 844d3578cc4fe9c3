//! Runs one case on one system under test: generates rays in chunks, in parallel, and counts the results.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DVec3};
use serde::Serialize;

use super::cross_check::QueryResult;
use super::figure_data::{Axis, Error, FigureData, TracedRay};
use super::verdict_cache::{CachedVerdict, VerdictCache};
use crate::accel::{Accel, AccelError, Coherence, EmbreeIdentity, Hit, LANES, RayPacket};
use crate::numeric::{Lanes, Ray, SplitMix64};
use crate::optics::{Fresnel, Refraction};
use crate::parallel;
use crate::render::{Monitor, RenderSettings, Rendering};
use crate::scene::{Camera, Scene, SceneError};

/// Function that builds the acceleration structure of a scene.
pub type Build<'a> = dyn for<'s> Fn(&'s Scene) -> Result<Box<dyn Accel + 's>, AccelError> + Sync + 'a;

/// System under test: acceleration structure and formulas.
pub struct SystemUnderTest<'a> {
    /// Builder of the acceleration structure.
    pub build: &'a Build<'a>,
    /// Functions that need no scene.
    pub formulas: Formulas,
    /// Cached verdicts on the results of other systems under test for this case.
    pub verdict_cache: &'a VerdictCache,
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
    pub const RENDERER: Formulas = Formulas {
        dielectric: crate::optics::dielectric,
        refract: crate::optics::refract,
        corrected_opacity: crate::volume::composite::corrected_opacity,
        transmittance: |layer, count| crate::volume::transmittance_of((0..count).map(|_| layer)),
        march: super::ray_marching::march,
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
pub struct Counts {
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
    pub figure_data: FigureData,
}

/// Verdict on one result against the exact one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Correctness {
    /// Result as exact as the case requires.
    Right,
    /// Different result that rounding explains.
    Tie,
    /// Different result that rounding does not explain.
    Wrong,
}

impl Correctness {
    /// Returns `Wrong` if `is_wrong`, else `Right`.
    pub(super) fn wrong_if(is_wrong: bool) -> Correctness {
        if is_wrong {
            Correctness::Wrong
        } else {
            Correctness::Right
        }
    }
}

impl Counts {
    /// Counts one result; `describe` is called only for the first wrong one.
    pub(super) fn count(&mut self, correctness: Correctness, describe: impl FnOnce() -> String) {
        self.rays += 1;
        match correctness {
            Correctness::Right => {}
            Correctness::Tie => self.ties += 1,
            Correctness::Wrong => {
                self.wrong += 1;
                self.example.get_or_insert_with(describe);
            }
        }
    }

    /// Counts the result of a ray query and keeps the ray if it is among the first of its kind.
    pub(super) fn count_ray(&mut self, correctness: Correctness, ray: &Ray, hit: Option<Hit>) {
        let ray = *ray;
        self.figure_data.keep(TracedRay {
            ray,
            hit,
            correctness,
        });
        self.count(correctness, || describe(&ray, hit));
    }

    /// Counts the secondary rays of an image; its camera rays have been counted with their verdicts.
    pub(super) fn count_secondary_rays(&mut self, rendering: &Rendering) {
        let pixels = rendering.image.pixels.len() as u64;
        self.rays += rendering.ledger.total().rays.saturating_sub(pixels);
    }

    /// Records the error of a formula at an argument, for the plot.
    pub(super) fn record_error_at(&mut self, axis: Axis, at: f64, off: f64) {
        self.record_error(off);
        let correctness = Correctness::wrong_if(!(off <= axis.bound));
        self.figure_data.plot(axis, Error { at, off, correctness });
    }

    /// Records an error, in the unit of the case.
    pub(super) fn record_error(&mut self, error: f64) {
        // NaN counts as an infinite error.
        let error = if error.is_nan() { f64::INFINITY } else { error };
        self.worst = self.worst.max(error);
    }

    /// Returns the sum of two tallies; the first example wins.
    pub(super) fn with(self, other: Counts) -> Counts {
        Counts {
            rays: self.rays + other.rays,
            wrong: self.wrong + other.wrong,
            ties: self.ties + other.ties,
            worst: self.worst.max(other.worst),
            example: self.example.or(other.example),
            figure_data: self.figure_data.with(other.figure_data),
        }
    }
}

/// Detail that a trial records beside its counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Recording {
    /// First queries of each kind.
    Queries,
    /// First queries of each kind, and line drawings of their scenes.
    Drawings,
}

/// Queries of a chunk: enough chunks to share the work among threads, few enough queries that memory is negligible.
const CHUNK: u64 = 4096;

/// One case on one system under test.
pub(super) struct CaseRunner<'a> {
    pub(super) subject: &'a SystemUnderTest<'a>,
    /// Approximate number of queries.
    pub(super) rays: u64,
    seed: u64,
    recording: Recording,
}

impl<'a> CaseRunner<'a> {
    /// Creates the trial of a case; the identifier seeds its random numbers.
    pub(super) fn new(id: &str, rays: u64, subject: &'a SystemUnderTest<'a>) -> CaseRunner<'a> {
        let seed = id.bytes().fold(0, |seed: u64, byte| seed << 8 | u64::from(byte));
        CaseRunner {
            subject,
            rays,
            seed,
            recording: Recording::Queries,
        }
    }

    /// Returns the trial with line drawings of its scenes enabled.
    pub(super) fn with_drawings(self) -> CaseRunner<'a> {
        CaseRunner {
            recording: Recording::Drawings,
            ..self
        }
    }

    /// Returns part `part` of a case that consists of `count` parts, with its share of the rays and its own seed.
    pub(super) fn part(&self, part: usize, count: usize) -> CaseRunner<'a> {
        CaseRunner {
            subject: self.subject,
            rays: (self.rays / count as u64).max(1),
            seed: SplitMix64::new(self.seed, part as u64).bits(),
            recording: self.recording,
        }
    }

    /// Runs `task` for each of `count` parts with its share of the queries, in parallel, and adds up the tallies. The
    /// result does not depend on the number of threads.
    pub(super) fn over_parts(
        &self,
        count: usize,
        task: &(dyn Fn(usize, CaseRunner) -> Result<Counts, AccelError> + Sync),
    ) -> Result<Counts, AccelError> {
        sum(count as u64, &|number| {
            let number = number as usize;
            task(number, self.part(number, count))
        })
    }

    /// Builds the acceleration structure of `scene`.
    pub(super) fn engine<'s>(&self, scene: &'s Scene) -> Result<Engine<'s>, AccelError> {
        let accel = (self.subject.build)(scene)?;
        Ok(Engine { accel, scene })
    }

    /// Renders an image of `scene` with one sample in the centre of each of `size` x `size` pixels and `depth` bounces
    /// of rays whose throughput is `weight_cutoff` or more.
    pub(super) fn render_image(
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

    /// Runs `task` for the queries of each chunk and adds up the tallies. The result does not depend on the number of
    /// threads.
    pub(super) fn in_chunks(&self, task: &(dyn Fn(&mut SplitMix64, usize) -> Counts + Sync)) -> Counts {
        self.in_numbered_chunks(&|_, random, count| task(random, count))
    }

    /// Runs `task` as [`CaseRunner::in_chunks`] does, and passes it the number of the chunk.
    fn in_numbered_chunks(&self, task: &(dyn Fn(u64, &mut SplitMix64, usize) -> Counts + Sync)) -> Counts {
        let Ok(tally) = sum::<Infallible>(self.rays.div_ceil(CHUNK), &|index| {
            let count = CHUNK.min(self.rays - index * CHUNK);
            Ok(task(
                index,
                &mut SplitMix64::new(self.seed, index),
                count as usize,
            ))
        });
        tally
    }

    /// Returns whether line drawings of scenes are enabled.
    pub(super) fn draws_scenes(&self) -> bool {
        self.recording == Recording::Drawings
    }

    /// Returns `tally` with a line drawing of the engine's scene if drawings are enabled.
    pub(super) fn with_drawing_of(&self, engine: &Engine, mut tally: Counts) -> Counts {
        if self.draws_scenes() {
            tally.figure_data.draw(engine.scene);
        }
        tally
    }

    /// Traces nearest-hit queries for rays made by `ray`, judges each result with `judge`, and counts the verdicts and
    /// errors. A result that another system under test has returned bit for bit is not judged again.
    pub(super) fn nearest(
        &self,
        engine: &Engine,
        ray: &(dyn Fn(&mut SplitMix64) -> Ray + Sync),
        judge: &(dyn Fn(&Ray, Option<Hit>, &mut Counts) -> Correctness + Sync),
    ) -> Counts {
        let tally = self.in_numbered_chunks(&|number, random, count| {
            // Generate the rays of the chunk and trace them
            let rays: Vec<Ray> = (0..count).map(|_| ray(random)).collect();
            let hits = engine.nearest(&rays, order(random));
            // Look up the verdicts of an earlier system under test
            let said = self.subject.verdict_cache.lookup((self.seed, number));
            let mut cached_verdicts = Vec::with_capacity(if said.is_empty() { count } else { 0 });
            let mut tally = Counts::default();
            for (i, (ray, hit)) in rays.iter().zip(hits).enumerate() {
                // Judge the hit, unless its verdict is cached
                let cached_verdict = said.get(i).and_then(|said| said.of(hit));
                let cached_verdict = cached_verdict.unwrap_or_else(|| {
                    let mut own = Counts::default();
                    let correctness = judge(ray, hit, &mut own);
                    let error = own.worst;
                    CachedVerdict {
                        hit,
                        correctness,
                        error,
                    }
                });
                // Count the verdict
                tally.record_error(cached_verdict.error);
                tally.count_ray(cached_verdict.correctness, ray, hit);
                if said.is_empty() {
                    cached_verdicts.push(cached_verdict);
                }
            }
            // Cache the verdicts of the first system under test
            if said.is_empty() {
                self.subject
                    .verdict_cache
                    .keep((self.seed, number), cached_verdicts);
            }
            tally
        });
        self.with_drawing_of(engine, tally)
    }
}

/// Largest number of runs of tallies; each run is summed up by one thread, and all sums stay in memory until the end.
const MAX_RUNS: u64 = 1 << 10;

/// Returns the sum of `tally(0..count)` in ascending order, or the error of the first that fails.
fn sum<E: Send>(count: u64, tally: &(dyn Fn(u64) -> Result<Counts, E> + Sync)) -> Result<Counts, E> {
    let run = count.div_ceil(MAX_RUNS).max(1);
    let runs = parallel::try_map(count.div_ceil(run) as usize, &|number| {
        let first = number as u64 * run;
        let mut sum = tally(first)?;
        for index in first + 1..count.min(first + run) {
            sum = sum.with(tally(index)?);
        }
        Ok(sum)
    })?;
    Ok(runs.into_iter().reduce(Counts::with).unwrap_or_default())
}

/// Returns a random ray order, which affects the speed but never the result.
pub(super) fn order(random: &mut SplitMix64) -> Coherence {
    random.choose(&[Coherence::Coherent, Coherence::Incoherent])
}

/// Formats a ray with its hit so that both can be reproduced.
pub fn describe(ray: &Ray, hit: Option<Hit>) -> String {
    format!("{}: {}", describe_ray(ray), QueryResult::of_hit(hit))
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
    pub(super) fn traced(&self, rays: &[Ray], order: Coherence) -> Vec<RayPacket> {
        let mut packets = packets(rays);
        self.accel.intersect(&mut packets, order);
        packets
    }

    /// Returns the nearest hit of each ray.
    pub(super) fn nearest(&self, rays: &[Ray], order: Coherence) -> Vec<Option<Hit>> {
        let packets = self.traced(rays, order);
        (0..rays.len())
            .map(|i| packets[i / LANES].hit(i % LANES))
            .collect()
    }

    /// Returns whether each ray is occluded.
    pub(super) fn blocked(&self, rays: &[Ray], order: Coherence) -> Vec<bool> {
        let mut packets = packets(rays);
        self.accel.occluded(&mut packets, order);
        (0..rays.len())
            .map(|i| packets[i / LANES].is_blocked(i % LANES))
            .collect()
    }
}

/// Returns the version and instruction set of Embree if the system under test uses it.
pub(super) fn embree_identity(subject: &SystemUnderTest) -> Result<Option<EmbreeIdentity>, AccelError> {
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
