//! Everything that a scene's rays are asked of, and how long it takes to build.

use std::time::Instant;

use rayon::ThreadPool;

use super::BenchJob;
use super::times::Seconds;
use crate::accel::bsp::BspAccel;
#[cfg(feature = "embree")]
use crate::accel::embree::EmbreeAccel;
use crate::accel::{Accel, AccelError, AccelOptions, AccelReport, Backend, Instancing, Kernel, Precision};
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::cli::replay::Engine;
use crate::parallel;
use crate::report::bench::Mode;
use crate::scene::Scene;

/// The acceleration structures of a scene, once for each way of asking that needs its own.
pub(super) struct Structures<'s> {
    /// With the precision and the kind of instancing that were chosen, with the other kind where the scene has placed
    /// meshes, and with the other precisions.
    #[cfg(feature = "embree")]
    embree: Vec<EmbreeStructures<'s>>,
    bsp: [BspAccel<'s>; 2],
    /// Of the first of these.
    bsp_builds: Seconds,
}

/// Embree's structures for one precision and one kind of instancing, which is absent where nothing is placed.
#[cfg(feature = "embree")]
struct EmbreeStructures<'s> {
    precision: Precision,
    instancing: Option<Instancing>,
    packet: EmbreeAccel<'s>,
    /// How it is built, and what each time took.
    options: AccelOptions<'s>,
    builds: Seconds,
    /// Absent for precisions that were not chosen.
    single: Option<EmbreeAccel<'s>>,
}

#[cfg(feature = "embree")]
impl<'s> EmbreeStructures<'s> {
    fn build_packet(
        scene: &'s Scene,
        options: AccelOptions<'s>,
        pool: &ThreadPool,
    ) -> Result<EmbreeStructures<'s>, Failure> {
        let (packet, seconds) = timed(pool, || EmbreeAccel::build(scene, &options))?;
        Ok(EmbreeStructures {
            precision: options.precision,
            instancing: (packet.placed_mesh_count() > 0).then_some(options.instancing),
            single: None,
            packet,
            options,
            builds: Seconds::of(seconds),
        })
    }

    fn build(
        scene: &'s Scene,
        options: AccelOptions<'s>,
        pool: &ThreadPool,
    ) -> Result<EmbreeStructures<'s>, Failure> {
        let single = AccelOptions {
            kernel: Kernel::Single,
            ..options.clone()
        };
        Ok(EmbreeStructures {
            single: Some(timed(pool, || EmbreeAccel::build(scene, &single))?.0),
            ..EmbreeStructures::build_packet(scene, options, pool)?
        })
    }

    /// All that a scene is measured with.
    fn all(
        scene: &'s Scene,
        wish: &AccelOptions<'s>,
        pool: &ThreadPool,
    ) -> Result<Vec<EmbreeStructures<'s>>, Failure> {
        let at = |precision: Precision| AccelOptions {
            precision,
            instancing: wish.instancing.resolved(precision),
            ..wish.clone()
        };
        let chosen = at(wish.precision);
        let first = EmbreeStructures::build(scene, chosen.clone(), pool)?;
        let other = chosen.instancing.other();
        let has_other = first.instancing.is_some() && other.resolved(wish.precision) == other;
        let mut built = vec![first];
        if has_other {
            let options = AccelOptions {
                instancing: other,
                ..chosen
            };
            built.push(EmbreeStructures::build(scene, options, pool)?);
        }
        for precision in Precision::ALL {
            if precision != wish.precision {
                built.push(EmbreeStructures::build_packet(scene, at(precision), pool)?);
            }
        }
        Ok(built)
    }

    /// Seconds of another build, which is thrown away.
    fn build_again(&self, scene: &Scene, pool: &ThreadPool) -> Result<f64, Failure> {
        let options = AccelOptions {
            threads: pool.current_num_threads(),
            ..self.options.clone()
        };
        Ok(timed(pool, || EmbreeAccel::build(scene, &options))?.1)
    }
}

impl<'s> Structures<'s> {
    /// Builds all that the rays of a scene are asked of, on the threads of `pool`.
    pub(super) fn build(
        scene: &'s Scene,
        job: &BenchJob,
        pool: &ThreadPool,
    ) -> Result<Structures<'s>, Failure> {
        let options = |kernel| AccelOptions {
            kernel,
            ..job.tracing.options()
        };
        // The referee of answers, whatever Embree is asked for.
        let exact = |kernel| AccelOptions {
            precision: Precision::Watertight,
            ..options(kernel)
        };
        let bsp = |kernel| timed(pool, || BspAccel::build(scene, &exact(kernel)));
        let (packet, seconds) = bsp(Kernel::Packet)?;
        let mut structures = Structures {
            #[cfg(feature = "embree")]
            embree: EmbreeStructures::all(scene, &options(Kernel::Packet), pool)?,
            bsp: [packet, bsp(Kernel::Single)?.0],
            bsp_builds: Seconds::of(seconds),
        };
        // All in turn, so that whatever else the machine does hits all alike.
        for _ in 1..job.repeat {
            structures.build_again(scene, pool, |builds| &mut builds.usual)?;
        }
        for repetition in 0..job.repeat {
            for (number, pool) in job.scaling.iter().enumerate() {
                structures.build_again(scene, pool, |builds| {
                    if repetition == 0 {
                        builds.by_threads.push(Vec::new());
                    }
                    &mut builds.by_threads[number]
                })?;
            }
        }
        Ok(structures)
    }

    /// Times another build of each, which is thrown away.
    fn build_again(
        &mut self,
        scene: &Scene,
        pool: &ThreadPool,
        place: impl Fn(&mut Seconds) -> &mut Vec<f64>,
    ) -> Result<(), Failure> {
        #[cfg(feature = "embree")]
        for built in &mut self.embree {
            let seconds = built.build_again(scene, pool)?;
            place(&mut built.builds).push(seconds);
        }
        let options = AccelOptions {
            threads: pool.current_num_threads(),
            ..AccelOptions::default()
        };
        let (_, seconds) = timed(pool, || BspAccel::build(scene, &options))?;
        place(&mut self.bsp_builds).push(seconds);
        Ok(())
    }

    /// Every way of asking, the referee of answers first.
    pub(super) fn contestants(&self) -> Vec<Contestant<'_>> {
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
                builds: &built.builds,
                report: packet.report(),
            };
            contestants.push(embree(Mode::Packet, Engine::Accel(packet)));
            if let Some(single) = &built.single {
                contestants.push(embree(Mode::Raw, Engine::Raw(packet)));
                contestants.push(embree(Mode::Single, Engine::Accel(single)));
                contestants.push(embree(Mode::RawSingle, Engine::RawSingle(single)));
            }
        }
        let [packet, single] = &self.bsp;
        let bsp = |mode, accel| Contestant {
            backend: Backend::Bsp,
            instancing: None,
            precision: Precision::Watertight,
            mode,
            engine: Engine::Accel(accel),
            builds: &self.bsp_builds,
            report: packet.report(),
        };
        contestants.push(bsp(Mode::Packet, packet));
        contestants.push(bsp(Mode::Single, single));
        contestants.push(bsp(Mode::Batch, packet));
        contestants
    }

    /// What the frame is rendered with.
    pub(super) fn first(&self) -> &dyn Accel {
        #[cfg(feature = "embree")]
        let first = &self.embree[0].packet;
        #[cfg(not(feature = "embree"))]
        let first = &self.bsp[0];
        first
    }
}

/// What `work` built on the threads of a pool, and its wall-clock seconds.
fn timed<T: Send>(
    pool: &ThreadPool,
    work: impl FnOnce() -> Result<T, AccelError> + Send,
) -> Result<(T, f64), Failure> {
    let (built, seconds) = parallel::install(pool, || {
        let start = Instant::now();
        (work(), start.elapsed().as_secs_f64())
    });
    interrupt::check()?;
    Ok((built?, seconds))
}

/// One way of asking for hits.
pub(super) struct Contestant<'a> {
    pub(super) backend: Backend,
    pub(super) instancing: Option<Instancing>,
    pub(super) precision: Precision,
    pub(super) mode: Mode,
    pub(super) engine: Engine<'a>,
    pub(super) builds: &'a Seconds,
    pub(super) report: AccelReport,
}

impl<'a> Contestant<'a> {
    /// Whose answers this one's are held against: the first one's. Raw calls, of which only distances are compared, bit
    /// by bit, are held against what they are the bare form of.
    pub(super) fn referee<'c>(&self, contestants: &'c [Contestant<'a>]) -> &'c Contestant<'a> {
        let dressed = match self.mode {
            Mode::Raw => Mode::Packet,
            Mode::RawSingle => Mode::Single,
            Mode::Packet | Mode::Single | Mode::Batch => return &contestants[0],
        };
        let of = |other: &Contestant| (other.backend, other.instancing, other.precision);
        let is_referee = |other: &&Contestant| other.mode == dressed && of(other) == of(self);
        contestants.iter().find(is_referee).unwrap_or(&contestants[0])
    }

    /// Whether whole frames are rendered with it: with the first one, and with Embree at each other precision.
    pub(super) fn has_frames(&self, contestants: &[Contestant<'a>]) -> bool {
        let first = &contestants[0];
        let is_rung = self.backend == Backend::Embree && self.precision != first.precision;
        std::ptr::eq(self, first) || is_rung
    }
}
