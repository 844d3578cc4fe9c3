//! `whit bench`: Embree against the BSP on the same recorded rays.

use std::path::Path;
use std::time::Instant;

use rayon::ThreadPool;

use crate::accel::bsp::BspAccel;
#[cfg(feature = "embree")]
use crate::accel::embree::EmbreeAccel;
use crate::accel::{Accel, AccelError, AccelOptions, AccelReport, Backend, Kernel, Precision};
use crate::image::check_writable;
use crate::render::{self, Ledger, Monitor, RenderSettings};
use crate::report::bench::{BenchRow, BenchTable, FrameTime, Mode, RayKind, Spread};
use crate::scene::{Camera, Scene};

use super::args::BenchArgs;
use super::failure::Failure;
use super::interrupt;
use super::job::{Tracing, choose_camera, settings};
use super::output;
use super::progress::{Progress, Verbosity};
use super::replay::{Differences, Engine, RaySet, differences, replay_seconds};
use super::scene;

/// Everything that `whit bench` is to do with each scene.
struct BenchJob {
    settings: RenderSettings,
    tracing: Tracing,
    repeat: u32,
}

/// Measures what the arguments ask for.
pub(super) fn run(args: &BenchArgs) -> Result<(), Failure> {
    if args.extents {
        return super::extents::run(args);
    }
    if let Some(path) = &args.json {
        check_writable(path)?;
    }
    if args.tracing.isa.is_some() && !cfg!(feature = "embree") {
        return Err(AccelError::NoEmbree.into());
    }
    let job = BenchJob {
        settings: settings(args.frame, args.spp)?,
        tracing: Tracing::new(&args.tracing),
        repeat: args.repeat,
    };
    let pool = job.tracing.pool()?;
    let progress = Progress::new(Verbosity::Normal);
    let mut rows = Vec::new();
    for path in &args.scenes {
        let of_scene = bench_scene(&job, path, &pool, &progress)?;
        progress.suspend(|| output::print(&BenchTable(&of_scene).to_string()))?;
        rows.extend(of_scene);
        // After each scene, so that later trouble loses nothing.
        if let Some(path) = &args.json {
            interrupt::finish_first(|| output::write_json(path, &rows))?;
        }
    }
    progress.clear();
    Ok(())
}

/// The rows of one scene.
fn bench_scene(
    job: &BenchJob,
    path: &Path,
    pool: &ThreadPool,
    progress: &Progress,
) -> Result<Vec<BenchRow>, Failure> {
    let name = path.display().to_string();
    progress.phase(&name, "load");
    let scene = pool.install(|| scene::load(path))?.scene;
    let camera = choose_camera(&scene, path, None)?;
    for warning in &scene.warnings {
        progress.warn(&format!("{name}: {warning}"));
    }
    progress.phase(&name, "build");
    let structures = pool.install(|| Structures::build(&scene, job))?;
    let contestants = structures.contestants();
    progress.phase(&name, "record");
    let frame = Frame {
        scene: &scene,
        camera,
        settings: job.settings,
        accel: structures.first(),
    };
    let sets = frame.ray_sets();
    progress.phase(&name, "replay");
    let times = Times::measure(&contestants, &sets, &frame, job.repeat, progress)?;
    progress.phase(&name, "compare");
    rows(job, path, &contestants, &sets, &times, &frame)
}

/// The acceleration structures of a scene, once for each way of asking that needs its own.
struct Structures<'s> {
    #[cfg(feature = "embree")]
    embree: [(EmbreeAccel<'s>, f64); 2],
    #[cfg(feature = "embree")]
    precision: Precision,
    bsp: [(BspAccel<'s>, f64); 2],
}

impl<'s> Structures<'s> {
    fn build(scene: &'s Scene, job: &BenchJob) -> Result<Structures<'s>, Failure> {
        let options = |kernel| AccelOptions {
            precision: job.tracing.precision,
            kernel,
            threads: job.tracing.threads,
            isa: job.tracing.isa.clone(),
            progress: None,
        };
        #[cfg(feature = "embree")]
        let embree = |kernel| timed(|| EmbreeAccel::build(scene, &options(kernel)));
        let bsp = |kernel| timed(|| BspAccel::build(scene, &options(kernel)));
        Ok(Structures {
            #[cfg(feature = "embree")]
            embree: [embree(Kernel::Packet)?, embree(Kernel::Single)?],
            #[cfg(feature = "embree")]
            precision: job.tracing.precision,
            bsp: [bsp(Kernel::Packet)?, bsp(Kernel::Single)?],
        })
    }

    /// Every way of asking, the referee of answers first.
    fn contestants(&self) -> Vec<Contestant<'_>> {
        let mut contestants = Vec::new();
        #[cfg(feature = "embree")]
        {
            let [(packet, seconds), (single, _)] = &self.embree;
            let embree = |mode, engine| Contestant {
                backend: Backend::Embree,
                precision: self.precision,
                mode,
                engine,
                build_seconds: *seconds,
                report: packet.report(),
            };
            contestants.push(embree(Mode::Packet, Engine::Accel(packet)));
            contestants.push(embree(Mode::Raw, Engine::Raw(packet)));
            contestants.push(embree(Mode::Single, Engine::Accel(single)));
        }
        let [(packet, seconds), (single, _)] = &self.bsp;
        let bsp = |mode, accel| Contestant {
            backend: Backend::Bsp,
            precision: Precision::Watertight,
            mode,
            engine: Engine::Accel(accel),
            build_seconds: *seconds,
            report: packet.report(),
        };
        contestants.push(bsp(Mode::Packet, packet));
        contestants.push(bsp(Mode::Single, single));
        contestants.push(bsp(Mode::Batch, packet));
        contestants
    }

    /// What the frame is rendered with.
    fn first(&self) -> &dyn Accel {
        #[cfg(feature = "embree")]
        let first = &self.embree[0].0;
        #[cfg(not(feature = "embree"))]
        let first = &self.bsp[0].0;
        first
    }
}

/// What `work` built and its wall-clock seconds.
fn timed<T>(work: impl FnOnce() -> Result<T, AccelError>) -> Result<(T, f64), Failure> {
    let start = Instant::now();
    let built = work()?;
    interrupt::check()?;
    Ok((built, start.elapsed().as_secs_f64()))
}

/// One way of asking for hits.
struct Contestant<'a> {
    backend: Backend,
    precision: Precision,
    mode: Mode,
    engine: Engine<'a>,
    build_seconds: f64,
    report: AccelReport,
}

/// The picture whose rays are replayed.
struct Frame<'a> {
    scene: &'a Scene,
    camera: &'a Camera,
    settings: RenderSettings,
    accel: &'a dyn Accel,
}

impl Frame<'_> {
    /// The frame's own rays and random ones, a set each; kinds without rays are left out.
    fn ray_sets(&self) -> Vec<RaySet> {
        let recorded = render::record(self.scene, self.camera, self.accel, &self.settings);
        let pixel_count = self.settings.width as usize * self.settings.height as usize;
        let mut sets = vec![
            RaySet::new(RayKind::Camera, recorded.camera),
            RaySet::new(RayKind::Shadow, recorded.shadow),
            RaySet::new(RayKind::Reflection, recorded.reflection),
            RaySet::random(&self.scene.bounds(), pixel_count),
        ];
        sets.retain(|set| set.ray_count > 0);
        sets
    }

    /// What one render of the frame takes, on the current thread pool.
    fn ledger(&self) -> Result<Ledger, Failure> {
        let monitor = Monitor {
            progress: &|_| {},
            cancel: &interrupt::CANCELLED,
        };
        render::render(self.scene, self.camera, self.accel, &self.settings, &monitor)
            .map(|rendering| rendering.ledger)
            .ok_or(Failure::Interrupted)
    }
}

/// Seconds of every repetition.
struct Times {
    /// By set, then by contestant.
    replays: Vec<Vec<Vec<f64>>>,
    frames: Vec<Ledger>,
}

impl Times {
    /// Times everything in turn within each repetition, so that whatever else the machine does hits all alike.
    fn measure(
        contestants: &[Contestant],
        sets: &[RaySet],
        frame: &Frame,
        repeat: u32,
        progress: &Progress,
    ) -> Result<Times, Failure> {
        let single = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .map_err(|error| Failure::Work(format!("could not start a thread: {error}")))?;
        let mut times = Times {
            replays: vec![vec![Vec::new(); contestants.len()]; sets.len()],
            frames: Vec::new(),
        };
        for repetition in 0..repeat {
            for (set, of_set) in sets.iter().zip(&mut times.replays) {
                for (contestant, seconds) in contestants.iter().zip(of_set) {
                    interrupt::check()?;
                    seconds.push(replay_seconds(contestant.engine, set, contestant.mode));
                }
            }
            times.frames.push(single.install(|| frame.ledger())?);
            progress.fraction(f64::from(repetition + 1) / f64::from(repeat));
        }
        Ok(times)
    }

    /// The render loop against the raw traces of the same rays.
    fn frame(&self, contestants: &[Contestant], sets: &[RaySet]) -> Option<FrameTime> {
        let raw = contestants
            .iter()
            .position(|contestant| contestant.mode == Mode::Raw)?;
        let ledger = self.frames.first()?;
        let raw_seconds: f64 = sets
            .iter()
            .zip(&self.replays)
            .map(|(set, of_set)| {
                let rays = match set.kind {
                    RayKind::Camera => ledger.camera.rays,
                    RayKind::Shadow => ledger.shadow.rays,
                    RayKind::Reflection => ledger.reflection.rays,
                    RayKind::Random => 0,
                };
                rays as f64 * Spread::of(&of_set[raw]).median / set.ray_count as f64
            })
            .sum();
        let median =
            |of: fn(&Ledger) -> f64| Spread::of(&self.frames.iter().map(of).collect::<Vec<_>>()).median;
        let seconds = median(|ledger| ledger.seconds);
        Some(FrameTime {
            seconds,
            rays: ledger.camera.rays + ledger.shadow.rays + ledger.reflection.rays,
            over_raw: seconds / raw_seconds,
            trace_share: median(|ledger| ledger.trace_seconds() / ledger.seconds),
        })
    }
}

/// Everything measured, a row for each set and contestant.
fn rows(
    job: &BenchJob,
    path: &Path,
    contestants: &[Contestant],
    sets: &[RaySet],
    times: &Times,
    frame: &Frame,
) -> Result<Vec<BenchRow>, Failure> {
    let frame_time = times.frame(contestants, sets);
    let mut rows = Vec::with_capacity(sets.len() * contestants.len());
    for (set, of_set) in sets.iter().zip(&times.replays) {
        for (contestant, seconds) in contestants.iter().zip(of_set) {
            interrupt::check()?;
            // The referee needs no comparison with itself.
            let differ = match rows.len() % contestants.len() {
                0 => Differences::default(),
                _ => differences(frame.scene, set, contestants[0].engine, contestant.engine),
            };
            let speed = |seconds: f64| set.ray_count as f64 * 1e-6 / seconds;
            let spread = Spread::of(seconds);
            rows.push(BenchRow {
                scene: path.to_owned(),
                backend: contestant.backend,
                precision: contestant.precision,
                rays: set.kind,
                mode: contestant.mode,
                mrays_per_s: speed(spread.median),
                mrays_per_s_min: speed(spread.max),
                mrays_per_s_max: speed(spread.min),
                ray_count: set.ray_count,
                build_seconds: contestant.build_seconds,
                bytes: contestant.report.bytes,
                mismatches: differ.wrong,
                ties: differ.ties,
                threads: job.tracing.threads,
                embree: contestant.report.embree.clone(),
                frame: frame_time,
            });
        }
    }
    Ok(rows)
}
