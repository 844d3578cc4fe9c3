//! Runs one case on one system under test: generates rays in chunks, in parallel, and counts the results.

use std::convert::Infallible;

use super::correctness::Correctness;
use super::counts::Counts;
use super::engine::{Engine, order};
use super::system_under_test::SystemUnderTest;
use super::verdict_cache::CachedVerdict;
use crate::accel::{AccelError, Hit};
use crate::numeric::{Ray, SplitMix64};
use crate::parallel;
use crate::render::{Monitor, RenderSettings, Rendering};
use crate::scene::{Camera, Scene};

/// Detail that a trial records beside its counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Recording {
    /// First queries of each kind.
    Queries,
    /// First queries of each kind, and line drawings of their scenes.
    Drawings,
}

/// Queries of a chunk: enough chunks to share the work among threads, few enough queries that memory is negligible.
const CHUNK: u64 = 4096;

/// One case on one system under test.
pub(in crate::verify) struct CaseRunner<'a> {
    pub(in crate::verify) subject: &'a SystemUnderTest<'a>,
    /// Approximate number of queries.
    pub(in crate::verify) rays: u64,
    seed: u64,
    recording: Recording,
}

impl<'a> CaseRunner<'a> {
    /// Creates the trial of a case; the identifier seeds its random numbers.
    pub(super) fn new(
        id: &str,
        rays: u64,
        subject: &'a SystemUnderTest<'a>,
        recording: Recording,
    ) -> CaseRunner<'a> {
        let seed = id.bytes().fold(0, |seed: u64, byte| seed << 8 | u64::from(byte));
        CaseRunner {
            subject,
            rays,
            seed,
            recording,
        }
    }

    /// Returns part `part` of a case that consists of `count` parts, with its share of the rays and its own seed.
    pub(in crate::verify) fn part(&self, part: usize, count: usize) -> CaseRunner<'a> {
        CaseRunner {
            subject: self.subject,
            rays: (self.rays / count as u64).max(1),
            seed: SplitMix64::new(self.seed, part as u64).bits(),
            recording: self.recording,
        }
    }

    /// Runs `task` for each of `count` parts with its share of the queries, in parallel, and adds up the tallies. The
    /// result does not depend on the number of threads.
    pub(in crate::verify) fn over_parts(
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
    pub(in crate::verify) fn engine<'s>(&self, scene: &'s Scene) -> Result<Engine<'s>, AccelError> {
        let accel = (self.subject.build)(scene)?;
        Ok(Engine { accel, scene })
    }

    /// Renders an image of `scene` with one sample in the centre of each of `size` x `size` pixels and `depth` bounces
    /// of rays whose throughput is `weight_cutoff` or more.
    pub(in crate::verify) fn render_image(
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
        let monitor = Monitor::default();
        Ok((self.subject.formulas.render)(scene, camera, &*accel, &settings, &monitor).ok())
    }

    /// Runs `task` for the queries of each chunk and adds up the tallies. The result does not depend on the number of
    /// threads.
    pub(in crate::verify) fn in_chunks(
        &self,
        task: &(dyn Fn(&mut SplitMix64, usize) -> Counts + Sync),
    ) -> Counts {
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

    /// Runs `task` as [`CaseRunner::in_chunks`] does, and adds a line drawing of the engine's scene if drawings are
    /// enabled.
    pub(in crate::verify) fn trace_in_chunks(
        &self,
        engine: &Engine,
        task: &(dyn Fn(&mut SplitMix64, usize) -> Counts + Sync),
    ) -> Counts {
        self.with_drawing_of(engine, self.in_chunks(task))
    }

    /// Returns whether line drawings of scenes are enabled.
    pub(in crate::verify) fn draws_scenes(&self) -> bool {
        self.recording == Recording::Drawings
    }

    /// Returns `tally` with a line drawing of the engine's scene if drawings are enabled.
    fn with_drawing_of(&self, engine: &Engine, mut tally: Counts) -> Counts {
        if self.draws_scenes() {
            tally.figure_data.draw(engine.scene);
        }
        tally
    }

    /// Traces nearest-hit queries for rays made by `ray`, judges each result with `judge`, and counts the verdicts and
    /// errors. A result that another system under test has returned bit for bit is not judged again.
    pub(in crate::verify) fn nearest(
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
