//! Scheduling of a batch: scenes one after another, and the frames of each scene concurrently.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use super::built_scene::{BuiltScene, LoadedScene, SceneCaches};
use super::frame::{FrameResult, make};
use super::limits::frames_at_once;
use super::observer::{BatchObserver, FrameEvent};
use super::queue::{Queue, Task};
use super::scene_slots::SceneSlots;
use crate::accel::MeshCounts;
use crate::batch::error::BatchError;
use crate::batch::fingerprint::Fingerprint;
use crate::batch::lock::{Lock, lock_shard};
use crate::batch::manifest::Manifest;
use crate::batch::options::BatchOptions;
use crate::batch::pieces::ChunkDirectory;
use crate::batch::plan::{PlannedFrame, remove_leftovers};
use crate::batch::request::check;
use crate::batch::shard::Shard;
use crate::parallel;
use crate::scene::CacheStats;

/// Number of scenes processed concurrently: one is rendered while the other is loaded or written.
const SCENES_AT_ONCE: usize = 2;

/// Batch whose output folder is ready, and locked against other processes until the batch is dropped.
pub struct Batch<'a> {
    pub(crate) plans: &'a [PlannedFrame],
    pub(crate) options: &'a BatchOptions,
    manifest: Mutex<Manifest>,
    _lock: Option<Lock>,
}

/// Outcome of a batch: what was rendered, and what sharing scenes among frames has saved.
#[derive(Default)]
pub struct BatchOutcome {
    /// Number of frames of the shard.
    pub total: usize,
    /// Number of frames that were complete already.
    pub skipped: usize,
    /// Number of frames that failed, each of which was reported.
    pub failed: usize,
    /// Wall-clock seconds of the whole batch.
    pub seconds: f64,
    /// True if the output folder accepts no more data.
    pub is_disk_full: bool,
    /// Number of frames that reused a loaded scene and its acceleration structure.
    pub reusing_frames: usize,
    /// Seconds of loading and building that these frames would have taken.
    pub saved_seconds: f64,
    /// Numbers of look-ups and of hits among decoded images of earlier scenes.
    pub images: CacheStats,
    /// Numbers of look-ups and of hits among built meshes of earlier scenes.
    pub meshes: MeshCounts,
    /// Results of frames by their numbers, or the reasons for failures, if the options request them.
    pub(crate) records: HashMap<usize, Result<FrameResult, String>>,
    /// Error of the whole batch, if there is one: an interruption, or that frames have failed.
    pub error: Option<BatchError>,
}

impl<'a> Batch<'a> {
    /// Prepares the output folder: locks this process's shard, removes the leftovers of killed processes, and opens the
    /// manifest. `warn` receives a warning where another process renders the same shard.
    ///
    /// # Errors
    ///
    /// If another process renders into the folder, or the folder has results of an earlier run that are not kept.
    pub fn open(
        plans: &'a [PlannedFrame],
        options: &'a BatchOptions,
        warn: &dyn Fn(&str),
    ) -> Result<Batch<'a>, BatchError> {
        let lock = lock_shard(options, warn)?;
        if lock.is_some() && options.shard == Shard::ALL {
            remove_leftovers(plans, &options.out);
        }
        Ok(Batch {
            plans,
            options,
            manifest: Mutex::new(Manifest::of_batch(options)?),
            _lock: lock,
        })
    }

    /// Returns the number of frames that this process's shard has pieces of.
    pub fn frame_count(&self) -> usize {
        Queue::new(self.plans, self.options.shard).len()
    }

    /// Returns whether the manifest has an entry for a frame, with any inputs.
    pub(crate) fn has_image(&self, plan: &PlannedFrame) -> bool {
        lock(&self.manifest).has(&plan.frame.image)
    }

    /// Renders all frames of this process's shard.
    pub fn run(&self, pool: &rayon::ThreadPool, observer: &BatchObserver) -> BatchOutcome {
        let run = BatchRun {
            batch: self,
            options: self.options,
            observer,
            pool,
            outcome: Mutex::default(),
            keys: Mutex::default(),
            kept: SceneCaches::for_frames(self.plans),
            place: SceneSlots::default(),
        };
        run.render_shard()
    }
}

/// State of a running batch, shared by its threads.
struct BatchRun<'a> {
    batch: &'a Batch<'a>,
    options: &'a BatchOptions,
    observer: &'a BatchObserver<'a>,
    pool: &'a rayon::ThreadPool,
    /// Outcome of the batch so far.
    outcome: Mutex<BatchOutcome>,
    /// Keys of the images that this process has considered so far, by path.
    keys: Mutex<HashMap<PathBuf, Fingerprint>>,
    kept: SceneCaches,
    place: SceneSlots,
}

impl<'a> BatchRun<'a> {
    fn render_shard(self) -> BatchOutcome {
        let start = Instant::now();
        // Queue the shard's frames, in the order of their scenes
        let queue = Queue::new(self.batch.plans, self.options.shard);
        let total = queue.len();
        let queue = Mutex::new(queue);
        // Render scene after scene on a few threads
        let result = run_on_threads(SCENES_AT_ONCE, || {
            while self.should_continue()? {
                let tasks = self.next_scene(&queue);
                if tasks.is_empty() {
                    break;
                }
                self.render_scene_frames(&tasks)?;
            }
            Ok(())
        });
        // Remove stale pieces, then complete the outcome
        self.remove_stale_pieces();
        let mut outcome = self.outcome.into_inner().unwrap_or_else(PoisonError::into_inner);
        let failed = outcome.failed;
        outcome.total = total;
        outcome.seconds = start.elapsed().as_secs_f64();
        (outcome.images, outcome.meshes) = self.kept.counts();
        outcome.error = result.err();
        if failed > 0 {
            let error = BatchError::FailedFrames(failed, total);
            outcome.error.get_or_insert(error);
        }
        outcome
    }

    /// Returns the tasks for the frames of the next scene that are not done yet.
    fn next_scene(&self, queue: &Mutex<Queue<'a>>) -> Vec<Task<'a>> {
        lock(queue).next_scene(|plan, recipe| {
            let recipe = recipe.map_err(|error| self.fail_unbegun(plan, error)).ok()?;
            let (image, key) = (plan.frame.image.clone(), recipe.key);
            lock(&self.keys).insert(image, key);
            if self.is_done(plan, key) {
                // Another process that rendered the same frame may have left pieces.
                ChunkDirectory::remove_of(&self.options.out, key);
                self.emit(plan, FrameEvent::Skipped);
                lock(&self.outcome).skipped += 1;
                return None;
            }
            Some(recipe)
        })
    }

    fn is_done(&self, plan: &PlannedFrame, key: Fingerprint) -> bool {
        if !self.options.resume {
            return false;
        }
        let manifest = lock(&self.batch.manifest);
        let done = manifest.find(&plan.frame.image, key);
        // A frame that ran out of time is done only for runs with a time limit.
        done.is_some_and(|done| done.samples >= f64::from(done.spp) || self.options.time.is_some())
    }

    /// Removes pieces whose key is outdated because their scene or settings have changed.
    fn remove_stale_pieces(&self) {
        let keys = lock(&self.keys);
        for folder in ChunkDirectory::all(&self.options.out).unwrap_or_default() {
            let head = folder.head();
            if keys.get(&head.image).is_some_and(|key| *key != head.key) {
                folder.remove();
            }
        }
    }

    /// Returns whether rendering continues; an error if it was interrupted.
    fn should_continue(&self) -> Result<bool, BatchError> {
        check(self.observer.cancel)?;
        Ok(!lock(&self.outcome).is_disk_full)
    }

    /// Renders frames that share one scene.
    fn render_scene_frames(&self, tasks: &[Task]) -> Result<(), BatchError> {
        let Some(Task { plan, .. }) = tasks.first() else {
            return Ok(());
        };
        let (pool, observer) = (self.pool, self.observer);
        // This thread is not part of the pool, whose threads may take up other work while they wait.
        let place = self.place.enter(tasks.len() > 1 || self.options.time.is_some());
        // Load the scene
        let loaded = match parallel::install(pool, || LoadedScene::new(plan, &self.kept, observer)) {
            Ok(loaded) => loaded,
            Err(error) => return self.fail_all(tasks, error),
        };
        // The claim outlives the acceleration structure, which is declared later and dropped first.
        let _place = match loaded.is_large(&plan.request) {
            true => self.place.clear(place),
            false => place,
        };
        // Build the acceleration structure if at least one frame fits into memory
        let threads = pool.current_num_threads();
        let at_once = frames_at_once(self.options, plan, (&loaded, &self.kept), threads);
        let stage = at_once.and_then(|at_once| {
            let build = || BuiltScene::new(plan, (&loaded, &self.kept), observer);
            Ok((at_once, parallel::install(pool, build)?))
        });
        let (at_once, stage) = match stage {
            Ok(stage) => stage,
            Err(error) => return self.fail_all(tasks, error),
        };
        // Account for the time that sharing the scene has saved
        self.note_reuse(tasks.len() - 1, loaded.seconds + stage.build_seconds);
        // Render the frames concurrently
        let next = AtomicUsize::new(0);
        run_on_threads(at_once.min(tasks.len()), || {
            while self.should_continue()? {
                let Some(task) = tasks.get(next.fetch_add(1, Ordering::Relaxed)) else {
                    break;
                };
                parallel::install(pool, || self.render_one_frame(task, &stage))?;
            }
            Ok(())
        })
    }

    fn render_one_frame(&self, task: &Task, stage: &BuiltScene) -> Result<(), BatchError> {
        let plan = task.plan;
        self.emit(plan, FrameEvent::Begun);
        // Render the frame and add it to the manifest
        let made = make(task, stage, self.options, self.observer);
        self.emit(plan, FrameEvent::Rendered);
        match made.and_then(|made| self.note(&made).map(|()| made)) {
            Ok(mut made) => {
                self.warn_if_out_of_time(plan, &made);
                made.setup_seconds = stage.seconds_once();
                self.record(plan, Ok(made));
                self.emit(plan, FrameEvent::Done);
                Ok(())
            }
            Err(error @ BatchError::Cancelled(_)) => {
                self.emit(plan, FrameEvent::Interrupted);
                Err(error)
            }
            Err(error) => {
                self.fail(plan, error);
                // On failure, check whether the disk is full: then no further frame can succeed
                if !self.can_write() {
                    lock(&self.outcome).is_disk_full = true;
                }
                Ok(())
            }
        }
    }

    fn note_reuse(&self, frames: usize, seconds: f64) {
        let mut outcome = lock(&self.outcome);
        outcome.reusing_frames += frames;
        outcome.saved_seconds += frames as f64 * seconds;
    }

    /// Warns that a frame has fewer samples than requested.
    fn warn_if_out_of_time(&self, plan: &PlannedFrame, made: &FrameResult) {
        if self.options.time.is_some() && made.samples < f64::from(made.head.spp) {
            (self.observer.warn)(&format!(
                "{}: the time limit was reached after {:.0} of {} samples per pixel",
                plan.name(),
                made.samples,
                made.head.spp
            ));
        }
    }

    /// Adds a complete image to the manifest.
    fn note(&self, made: &FrameResult) -> Result<(), BatchError> {
        if !made.is_whole {
            return Ok(());
        }
        let seconds = [made.render_seconds, made.write_seconds];
        lock(&self.batch.manifest).add_image(&made.head, made.samples, seconds, self.observer.writes)
    }

    /// Returns whether the output folder still accepts data, so that no frame is rendered in vain.
    fn can_write(&self) -> bool {
        /// Size of the probe file in bytes, below that of any image.
        const BYTES: usize = 1 << 14;
        let probe = self
            .options
            .out
            .join(format!(".whit-{}.probe", std::process::id()));
        let written = std::fs::write(&probe, [0; BYTES]);
        let _ = std::fs::remove_file(&probe);
        written.is_ok()
    }

    /// Records and reports that a frame has failed.
    fn fail(&self, plan: &PlannedFrame, error: BatchError) {
        self.record(plan, Err(error.to_string()));
        self.emit(plan, FrameEvent::Failed(error));
        lock(&self.outcome).failed += 1;
    }

    /// Records and reports that a frame has failed before it began.
    fn fail_unbegun(&self, plan: &PlannedFrame, error: BatchError) {
        self.emit(plan, FrameEvent::Begun);
        self.fail(plan, error);
    }

    /// Records that none of the frames of a scene can be rendered.
    fn fail_all(&self, tasks: &[Task], error: BatchError) -> Result<(), BatchError> {
        if matches!(error, BatchError::Cancelled(_)) {
            return Err(error);
        }
        // Report the error for the first frame, and refer to it for the others
        let mut error = Some(error);
        for Task { plan, .. } in tasks {
            let again = || BatchError::FailedScene(plan.name(), plan.frame.scene.clone());
            let error = error.take().unwrap_or_else(again);
            self.fail_unbegun(plan, error);
        }
        Ok(())
    }

    fn record(&self, plan: &PlannedFrame, result: Result<FrameResult, String>) {
        if self.options.keeps_records {
            lock(&self.outcome).records.insert(plan.number, result);
        }
    }

    fn emit(&self, plan: &PlannedFrame, event: FrameEvent) {
        (self.observer.event)(plan, event);
    }
}

/// Locks a mutex. Ignoring poisoning is safe: a panic in another thread leaves no state half-changed.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs `work` on several threads to completion; returns the first error, if there is one.
fn run_on_threads(
    threads: usize,
    work: impl Fn() -> Result<(), BatchError> + Sync,
) -> Result<(), BatchError> {
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(&work)).collect();
        let ends = threads.into_iter().map(|thread| thread.join());
        ends.map(|end| end.unwrap_or(Err(BatchError::Panicked)))
            .fold(Ok(()), Result::and)
    })
}
