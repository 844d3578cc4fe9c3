//! `whit bench`: Embree against the BSP on the same recorded rays.

use std::path::Path;
use std::time::Instant;

use rayon::ThreadPool;
use serde::Serialize;

use crate::accel::bsp::BspAccel;
#[cfg(feature = "embree")]
use crate::accel::embree::EmbreeAccel;
use crate::accel::{
    Accel, AccelError, AccelOptions, AccelReport, Backend, Instancing, Kernel, Precision, RayPacket,
};
use crate::image::check_writable;
use crate::numeric::LANES;
use crate::render::{self, Ledger, Monitor, RenderSettings};
use crate::report::bench::{BenchRow, BenchTable, FrameTime, Mode, RayKind, Spread};
use crate::report::memory;
use crate::scene::{Camera, EffectSet, Scene};
use crate::scene_file::{Output, SceneFile};

use super::args::{BenchArgs, DEFAULT_BENCH_SPP};
use super::failure::Failure;
use super::interrupt;
use super::job::{Tracing, check_instancing, choose_camera, settings, wish};
use super::output;
use super::progress::{Progress, Verbosity};
use super::replay::{Differences, Engine, RaySet, differences, replay_seconds};
use super::scene;

/// Everything that `whit bench` is to do with each scene.
pub(super) struct BenchJob {
    /// What the command line says of the frame; the scene may say the rest.
    wish: Output,
    pub(super) tracing: Tracing,
    pub(super) repeat: u32,
}

impl BenchJob {
    /// What the arguments mean.
    pub(super) fn new(args: &BenchArgs) -> BenchJob {
        BenchJob {
            wish: Output {
                spp: args.spp,
                ..wish(&args.frame)
            },
            tracing: Tracing::new(&args.tracing),
            repeat: args.repeat,
        }
    }

    /// The frame of a scene that says `output` of its picture.
    pub(super) fn settings(&self, output: &Output) -> Result<RenderSettings, Failure> {
        let mut picture = self.wish.or(output);
        picture.spp = picture.spp.or(Some(DEFAULT_BENCH_SPP));
        let settings = settings(&picture)?;
        let (width, height, spp) = (settings.width, settings.height, settings.spp);
        let packets = u64::from(width) * u64::from(height) * u64::from(spp) / LANES as u64;
        let needed = packets * size_of::<RayPacket>() as u64;
        if let Some(free) = memory::available_bytes().filter(|&free| needed > free) {
            return Err(Failure::Input(format!(
                "the camera rays alone of {width}x{height} pixels with {spp} samples take {} of memory and {} are free: \
                 give a smaller `--size` or `--spp`",
                memory::in_words(needed),
                memory::in_words(free)
            )));
        }
        Ok(settings)
    }
}

/// Measures what the arguments ask for.
pub(super) fn run(args: &BenchArgs) -> Result<(), Failure> {
    if args.extents {
        return super::extents::run(args);
    }
    if let Some(path) = &args.json {
        check_writable(path)?;
    }
    let asks_embree = args.tracing.isa.is_some() || args.tracing.instancing != Instancing::Auto;
    if asks_embree && !cfg!(feature = "embree") {
        return Err(AccelError::NoEmbree.into());
    }
    check_instancing(&args.tracing)?;
    measure_scenes(args, bench_scene, |rows| BenchTable(rows).to_string())
}

/// A scene that is to be measured.
pub(super) struct BenchScene<'s> {
    pub(super) path: &'s Path,
    pub(super) name: &'s str,
    pub(super) scene: &'s Scene,
    pub(super) camera: &'s Camera,
    pub(super) settings: RenderSettings,
}

/// Measures each scene by `measure` and prints its rows as `table` puts them; writes all rows as JSON if that is asked
/// for.
pub(super) fn measure_scenes<Row: Serialize>(
    args: &BenchArgs,
    measure: impl Fn(&BenchJob, BenchScene, &ThreadPool, &Progress) -> Result<Vec<Row>, Failure>,
    table: impl Fn(&[Row]) -> String,
) -> Result<(), Failure> {
    let job = BenchJob::new(args);
    let pool = job.tracing.pool()?;
    let progress = Progress::new(Verbosity::Normal);
    let mut rows = Vec::new();
    for path in &args.scenes {
        let name = path.display().to_string();
        progress.phase(&name, "load");
        let SceneFile { scene, output, .. } = pool.install(|| scene::load(path, EffectSet::NONE))?;
        let bench_scene = BenchScene {
            path,
            name: &name,
            settings: job.settings(&output)?,
            camera: choose_camera(&scene, path, None)?,
            scene: &scene,
        };
        for warning in &scene.warnings {
            progress.warn(&format!("{name}: {warning}"));
        }
        let of_scene = measure(&job, bench_scene, &pool, &progress)?;
        progress.suspend(|| output::print(&table(&of_scene)))?;
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
    bench_scene: BenchScene,
    pool: &ThreadPool,
    progress: &Progress,
) -> Result<Vec<BenchRow>, Failure> {
    let BenchScene {
        path,
        name,
        scene,
        camera,
        settings,
    } = bench_scene;
    progress.phase(name, "build");
    let structures = pool.install(|| Structures::build(scene, job))?;
    let contestants = structures.contestants();
    progress.phase(name, "record");
    let frame = Frame {
        scene,
        camera,
        settings,
        accel: structures.first(),
    };
    let sets = frame.ray_sets();
    progress.phase(name, "replay");
    let times = Times::measure(&contestants, &sets, &frame, job.repeat, progress)?;
    progress.phase(name, "compare");
    rows(job, path, &contestants, &sets, &times, &frame)
}

/// The acceleration structures of a scene, once for each way of asking that needs its own.
struct Structures<'s> {
    /// With the precision and the kind of instancing that were chosen, with the other kind where the scene has placed
    /// meshes, and with the other precisions.
    #[cfg(feature = "embree")]
    embree: Vec<EmbreeStructures<'s>>,
    bsp: [BspAccel<'s>; 2],
    /// Of every build of the first of these.
    bsp_seconds: Vec<f64>,
}

/// Embree's structures for one precision and one kind of instancing, which is absent where nothing is placed.
#[cfg(feature = "embree")]
struct EmbreeStructures<'s> {
    precision: Precision,
    instancing: Option<Instancing>,
    packet: EmbreeAccel<'s>,
    /// How it is built, and what each time took.
    options: AccelOptions<'s>,
    seconds: Vec<f64>,
    /// Absent for precisions that were not chosen.
    single: Option<EmbreeAccel<'s>>,
}

#[cfg(feature = "embree")]
impl<'s> EmbreeStructures<'s> {
    fn build_packet(scene: &'s Scene, options: AccelOptions<'s>) -> Result<EmbreeStructures<'s>, Failure> {
        let (packet, seconds) = timed(|| EmbreeAccel::build(scene, &options))?;
        Ok(EmbreeStructures {
            precision: options.precision,
            instancing: (packet.placed_mesh_count() > 0).then_some(options.instancing),
            single: None,
            packet,
            options,
            seconds: vec![seconds],
        })
    }

    fn build(scene: &'s Scene, options: AccelOptions<'s>) -> Result<EmbreeStructures<'s>, Failure> {
        let single = AccelOptions {
            kernel: Kernel::Single,
            ..options.clone()
        };
        Ok(EmbreeStructures {
            single: Some(timed(|| EmbreeAccel::build(scene, &single))?.0),
            ..EmbreeStructures::build_packet(scene, options)?
        })
    }

    /// All that a scene is measured with.
    fn all(scene: &'s Scene, wish: &AccelOptions<'s>) -> Result<Vec<EmbreeStructures<'s>>, Failure> {
        let at = |precision: Precision| AccelOptions {
            precision,
            instancing: wish.instancing.resolved(precision),
            ..wish.clone()
        };
        let chosen = at(wish.precision);
        let first = EmbreeStructures::build(scene, chosen.clone())?;
        let other = chosen.instancing.other();
        let has_other = first.instancing.is_some() && other.resolved(wish.precision) == other;
        let mut built = vec![first];
        if has_other {
            let instancing = other;
            built.push(EmbreeStructures::build(
                scene,
                AccelOptions { instancing, ..chosen },
            )?);
        }
        for precision in Precision::ALL {
            if precision != wish.precision {
                built.push(EmbreeStructures::build_packet(scene, at(precision))?);
            }
        }
        Ok(built)
    }
}

impl<'s> Structures<'s> {
    fn build(scene: &'s Scene, job: &BenchJob) -> Result<Structures<'s>, Failure> {
        let options = |kernel| AccelOptions {
            kernel,
            ..job.tracing.options()
        };
        // The referee of answers, whatever Embree is asked for.
        let exact = |kernel| AccelOptions {
            precision: Precision::Watertight,
            ..options(kernel)
        };
        let bsp = |kernel| timed(|| BspAccel::build(scene, &exact(kernel)));
        let (packet, seconds) = bsp(Kernel::Packet)?;
        let mut structures = Structures {
            #[cfg(feature = "embree")]
            embree: EmbreeStructures::all(scene, &options(Kernel::Packet))?,
            bsp: [packet, bsp(Kernel::Single)?.0],
            bsp_seconds: vec![seconds],
        };
        // All in turn, so that whatever else the machine does hits all alike.
        for _ in 1..job.repeat {
            #[cfg(feature = "embree")]
            for built in &mut structures.embree {
                let again = timed(|| EmbreeAccel::build(scene, &built.options))?;
                built.seconds.push(again.1);
            }
            structures.bsp_seconds.push(bsp(Kernel::Packet)?.1);
        }
        Ok(structures)
    }

    /// Every way of asking, the referee of answers first.
    fn contestants(&self) -> Vec<Contestant<'_>> {
        let mut contestants = Vec::new();
        #[cfg(feature = "embree")]
        for built in &self.embree {
            let packet = &built.packet;
            let embree = |mode, engine| Contestant {
                backend: Backend::Embree,
                instancing: built.instancing,
                precision: built.precision,
                mode,
                engine,
                build_seconds: Spread::of(&built.seconds),
                report: packet.report(),
            };
            contestants.push(embree(Mode::Packet, Engine::Accel(packet)));
            if let Some(single) = &built.single {
                contestants.push(embree(Mode::Raw, Engine::Raw(packet)));
                contestants.push(embree(Mode::Single, Engine::Accel(single)));
            }
        }
        let [packet, single] = &self.bsp;
        let bsp = |mode, accel| Contestant {
            backend: Backend::Bsp,
            instancing: None,
            precision: Precision::Watertight,
            mode,
            engine: Engine::Accel(accel),
            build_seconds: Spread::of(&self.bsp_seconds),
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
        let first = &self.embree[0].packet;
        #[cfg(not(feature = "embree"))]
        let first = &self.bsp[0];
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
    instancing: Option<Instancing>,
    precision: Precision,
    mode: Mode,
    engine: Engine<'a>,
    build_seconds: Spread,
    report: AccelReport,
}

impl<'a> Contestant<'a> {
    /// Whose answers this one's are held against: the first one's. Raw calls, of which only distances are compared, bit
    /// by bit, are held against the packets that they are the bare form of.
    fn referee<'c>(&self, contestants: &'c [Contestant<'a>]) -> &'c Contestant<'a> {
        let is_referee = |other: &&Contestant| {
            self.mode != Mode::Raw || (other.backend, other.instancing) == (self.backend, self.instancing)
        };
        contestants.iter().find(is_referee).unwrap_or(&contestants[0])
    }

    /// Whether whole frames are rendered with it: with the first one, and with Embree at each other precision.
    fn has_frames(&self, contestants: &[Contestant<'a>]) -> bool {
        let first = &contestants[0];
        let is_rung = self.backend == Backend::Embree && self.precision != first.precision;
        std::ptr::eq(self, first) || is_rung
    }
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
    fn ledger(&self, accel: &dyn Accel) -> Result<Ledger, Failure> {
        let monitor = Monitor {
            progress: &|_| {},
            cancel: &interrupt::CANCELLED,
        };
        let settings = RenderSettings {
            ledger: true,
            ..self.settings
        };
        render::render(self.scene, self.camera, accel, &settings, &monitor)
            .map(|rendering| rendering.ledger)
            .ok_or(Failure::Interrupted)
    }
}

/// Seconds of every repetition.
struct Times {
    /// By set, then by contestant.
    replays: Vec<Vec<Vec<f64>>>,
    /// By contestant; empty for those without frames.
    frames: Vec<Vec<Ledger>>,
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
            frames: vec![Vec::new(); contestants.len()],
        };
        for repetition in 0..repeat {
            for (set, of_set) in sets.iter().zip(&mut times.replays) {
                for (contestant, seconds) in contestants.iter().zip(of_set) {
                    interrupt::check()?;
                    seconds.push(replay_seconds(contestant.engine, set, contestant.mode));
                }
            }
            for (contestant, ledgers) in contestants.iter().zip(&mut times.frames) {
                if let Engine::Accel(accel) = contestant.engine
                    && contestant.has_frames(contestants)
                {
                    ledgers.push(single.install(|| frame.ledger(accel))?);
                }
            }
            progress.fraction(f64::from(repetition + 1) / f64::from(repeat));
        }
        Ok(times)
    }

    /// The render loop with one contestant, or with the first if it has no frames, against the first one's raw traces of
    /// the same rays.
    fn frame(&self, contestants: &[Contestant], sets: &[RaySet], index: usize) -> Option<FrameTime> {
        let raw = contestants
            .iter()
            .position(|contestant| contestant.mode == Mode::Raw)?;
        let frames = [index, 0].map(|index| &self.frames[index]);
        let frames = frames.into_iter().find(|frames| !frames.is_empty())?;
        let ledger = frames.first()?;
        let raw_seconds: f64 = sets
            .iter()
            .zip(&self.replays)
            .map(|(set, of_set)| {
                let rays = match set.kind {
                    RayKind::Camera => ledger.camera_rays(),
                    RayKind::Shadow => ledger.shadow_rays(),
                    RayKind::Reflection => ledger.reflection_rays(),
                    RayKind::Random => 0,
                };
                rays as f64 * Spread::of(&of_set[raw]).median / set.ray_count as f64
            })
            .sum();
        let median = |of: fn(&Ledger) -> f64| Spread::of(&frames.iter().map(of).collect::<Vec<_>>()).median;
        let seconds = median(|ledger| ledger.seconds);
        Some(FrameTime {
            seconds,
            rays: ledger.camera_rays() + ledger.shadow_rays() + ledger.reflection_rays(),
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
    let frame_times: Vec<_> = (0..contestants.len())
        .map(|index| times.frame(contestants, sets, index))
        .collect();
    let mut rows = Vec::with_capacity(sets.len() * contestants.len());
    for (set, of_set) in sets.iter().zip(&times.replays) {
        for ((contestant, seconds), frame_time) in contestants.iter().zip(of_set).zip(&frame_times) {
            interrupt::check()?;
            // The referee needs no comparison with itself.
            let differ = match rows.len() % contestants.len() {
                0 => Differences::default(),
                _ => differences(
                    frame.scene,
                    set,
                    contestant.referee(contestants).engine,
                    contestant.engine,
                ),
            };
            let speed = |seconds: f64| set.ray_count as f64 * 1e-6 / seconds;
            let spread = Spread::of(seconds);
            rows.push(BenchRow {
                scene: path.to_owned(),
                backend: contestant.backend,
                instancing: contestant.instancing,
                precision: contestant.precision,
                rays: set.kind,
                mode: contestant.mode,
                mrays_per_s: speed(spread.median),
                mrays_per_s_min: speed(spread.max),
                mrays_per_s_max: speed(spread.min),
                ray_count: set.ray_count,
                build_seconds: contestant.build_seconds.median,
                build_seconds_min: contestant.build_seconds.min,
                build_seconds_max: contestant.build_seconds.max,
                bytes: contestant.report.bytes,
                mismatches: differ.wrong,
                ties: differ.ties,
                threads: job.tracing.threads,
                embree: contestant.report.embree.clone(),
                frame: *frame_time,
            });
        }
    }
    Ok(rows)
}
