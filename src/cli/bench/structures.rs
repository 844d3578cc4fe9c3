//! Acceleration structures of a benchmark, and the times of building them.

use std::time::Instant;

use rayon::ThreadPool;

use super::job::BenchJob;
use super::seconds::Seconds;
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::cli::replay::Engine;
use whit::accel::bsp::BspAccel;
#[cfg(feature = "embree")]
use whit::accel::embree::EmbreeAccel;
use whit::accel::{Accel, AccelError, AccelOptions, AccelReport, Backend, Instancing, Kernel, Precision};
use whit::parallel;
use whit::report::bench::Mode;
use whit::scene::Scene;

/// Acceleration structures of a scene for all contestants.
pub(super) struct Structures<'s> {
    /// Embree's structures: with the chosen precision and instancing, with the other kind of instancing if the scene
    /// has instanced meshes, and with the other precisions.
    #[cfg(feature = "embree")]
    embree: Vec<EmbreeStructures<'s>>,
    bsp: [BspAccel<'s>; 2],
    /// Build times of the first BSP tree, the one for packets.
    bsp_builds: Seconds,
}

/// Embree's structures for one precision and one kind of instancing, which is absent for a scene without instanced
/// meshes.
#[cfg(feature = "embree")]
struct EmbreeStructures<'s> {
    precision: Precision,
    instancing: Option<Instancing>,
    packet: EmbreeAccel<'s>,
    /// Options of the build, also used to repeat it.
    options: AccelOptions<'s>,
    builds: Seconds,
    /// Structure with single-ray kernels; absent for precisions that were not chosen.
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
            instancing: (packet.instanced_mesh_count() > 0).then_some(options.instancing),
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

    /// Builds the structures for all precisions and kinds of instancing that are measured.
    fn all(
        scene: &'s Scene,
        requested: &AccelOptions<'s>,
        pool: &ThreadPool,
    ) -> Result<Vec<EmbreeStructures<'s>>, Failure> {
        let at = |precision: Precision| AccelOptions {
            precision,
            instancing: requested.instancing.resolved(precision),
            ..requested.clone()
        };
        let chosen = at(requested.precision);
        let first = EmbreeStructures::build(scene, chosen.clone(), pool)?;
        let other = chosen.instancing.other();
        let has_other = first.instancing.is_some() && other.resolved(requested.precision) == other;
        let mut built = vec![first];
        if has_other {
            let options = AccelOptions {
                instancing: other,
                ..chosen
            };
            built.push(EmbreeStructures::build(scene, options, pool)?);
        }
        for precision in Precision::ALL {
            if precision != requested.precision {
                built.push(EmbreeStructures::build_packet(scene, at(precision), pool)?);
            }
        }
        Ok(built)
    }

    /// Builds the structure again, drops it, and returns the seconds.
    fn build_again(&self, scene: &Scene, pool: &ThreadPool) -> Result<f64, Failure> {
        let options = AccelOptions {
            threads: pool.current_num_threads(),
            ..self.options.clone()
        };
        Ok(timed(pool, || EmbreeAccel::build(scene, &options))?.1)
    }
}

impl<'s> Structures<'s> {
    /// Builds the structures of all contestants on the threads of `pool`.
    pub(super) fn build(
        scene: &'s Scene,
        job: &BenchJob,
        pool: &ThreadPool,
    ) -> Result<Structures<'s>, Failure> {
        // Build each structure once and keep it
        let options = |kernel| AccelOptions {
            kernel,
            ..job.tracing.options()
        };
        // The BSP is the reference of hits, so it is watertight for any precision requested from Embree.
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
        // All structures take turns, so that other load on the machine affects all alike.
        for _ in 1..job.repeat {
            structures.build_again(scene, pool, |builds| &mut builds.base)?;
        }
        // Repeat the builds with each thread count of the scaling measurement
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

    /// Builds each structure again, drops it, and appends the seconds to the list that `place` selects.
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

    /// Returns all contestants; the first is the reference of hits.
    pub(super) fn contestants(&self) -> Vec<Contestant<'_>> {
        let mut contestants = Vec::new();
        // Embree: packets and single rays, each with and without the code of the backend
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
        // BSP: packets, single rays and batches
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

    /// Returns the structure that the frame is rendered with.
    pub(super) fn first(&self) -> &dyn Accel {
        #[cfg(feature = "embree")]
        let first = &self.embree[0].packet;
        #[cfg(not(feature = "embree"))]
        let first = &self.bsp[0];
        first
    }
}

/// Returns the result of `work` on the threads of a pool, and its wall-clock seconds.
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

/// Implementation and mode that take part in a benchmark.
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
    /// Returns the contestant that this one's hits are compared with: the first one. Raw calls, of which only distances
    /// are compared, bit by bit, are compared with the backend that wraps them.
    pub(super) fn reference<'c>(&self, contestants: &'c [Contestant<'a>]) -> &'c Contestant<'a> {
        let wrapped_mode = match self.mode {
            Mode::Raw => Mode::Packet,
            Mode::RawSingle => Mode::Single,
            Mode::Packet | Mode::Single | Mode::Batch => return &contestants[0],
        };
        let of = |other: &Contestant| (other.backend, other.instancing, other.precision);
        let is_reference = |other: &&Contestant| other.mode == wrapped_mode && of(other) == of(self);
        contestants.iter().find(is_reference).unwrap_or(&contestants[0])
    }

    /// Returns whether whole frames are rendered with it: the first contestant, and Embree with each other precision.
    pub(super) fn has_frames(&self, contestants: &[Contestant<'a>]) -> bool {
        let first = &contestants[0];
        let is_other_precision = self.backend == Backend::Embree && self.precision != first.precision;
        std::ptr::eq(self, first) || is_other_precision
    }
}
