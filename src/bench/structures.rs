//! Acceleration structures of a benchmark, the times of building them, and the ways of tracing rays through them.

use rayon::ThreadPool;

use super::error::{BenchError, check};
use super::options::BenchOptions;
use super::replay::{Engine, Mode};
use crate::accel::bsp::BspAccel;
#[cfg(feature = "embree")]
use crate::accel::embree::EmbreeAccel;
use crate::accel::native::NativeAccel;
use crate::accel::{Accel, AccelError, AccelOptions, Backend, Instancing, Kernel, Precision};
use crate::measure::{Blocks, Stopwatch, TurnTime};
use crate::parallel;
use crate::scene::Scene;

/// Acceleration structure of known type.
enum TypedAccel<'s> {
    #[cfg(feature = "embree")]
    Embree(EmbreeAccel<'s>),
    Native(NativeAccel<'s>),
    Bsp(BspAccel<'s>),
}

impl<'s> TypedAccel<'s> {
    fn new(scene: &'s Scene, backend: Backend, options: &AccelOptions) -> Result<TypedAccel<'s>, AccelError> {
        match backend {
            #[cfg(feature = "embree")]
            Backend::Embree => Ok(TypedAccel::Embree(EmbreeAccel::build(scene, options)?)),
            #[cfg(not(feature = "embree"))]
            Backend::Embree => Err(AccelError::NoEmbree),
            // `auto` takes one of the structures that are measured for every kind of ray
            Backend::Native | Backend::Auto => Ok(TypedAccel::Native(NativeAccel::build(scene, options)?)),
            Backend::Bsp | Backend::Brute => Ok(TypedAccel::Bsp(BspAccel::build(scene, options)?)),
        }
    }

    fn accel(&self) -> &dyn Accel {
        match self {
            #[cfg(feature = "embree")]
            TypedAccel::Embree(embree) => embree,
            TypedAccel::Native(native) => native,
            TypedAccel::Bsp(bsp) => bsp,
        }
    }

    /// Returns single-ray kernels over the same tree; `None` for Embree, whose structures hold one kind of kernel each.
    fn single_rays(&self) -> Option<TypedAccel<'s>> {
        match self {
            #[cfg(feature = "embree")]
            TypedAccel::Embree(_) => None,
            TypedAccel::Native(native) => Some(TypedAccel::Native(native.with_kernel(Kernel::Single))),
            TypedAccel::Bsp(bsp) => Some(TypedAccel::Bsp(bsp.with_kernel(Kernel::Single))),
        }
    }

    fn has_instanced_meshes(&self) -> bool {
        match self {
            #[cfg(feature = "embree")]
            TypedAccel::Embree(embree) => embree.instanced_mesh_count() > 0,
            TypedAccel::Native(_) | TypedAccel::Bsp(_) => false,
        }
    }
}

/// Acceleration structure that is measured, with one kernel or two.
pub(super) struct Structure<'s> {
    pub(super) backend: Backend,
    /// Options of the build, also used to repeat it.
    options: AccelOptions<'s>,
    packet: TypedAccel<'s>,
    /// Structure with single-ray kernels; absent for precisions of Embree that were not chosen.
    single: Option<TypedAccel<'s>>,
}

impl<'s> Structure<'s> {
    /// Builds the structure with packet kernels alone.
    fn new(
        scene: &'s Scene,
        backend: Backend,
        options: AccelOptions<'s>,
    ) -> Result<Structure<'s>, BenchError> {
        Ok(Structure {
            packet: TypedAccel::new(scene, backend, &options)?,
            backend,
            options,
            single: None,
        })
    }

    /// Adds single-ray kernels, over the same tree or over one of their own.
    fn with_single(self, scene: &'s Scene) -> Result<Structure<'s>, BenchError> {
        let single = match self.packet.single_rays() {
            Some(single) => single,
            None => {
                let options = AccelOptions {
                    kernel: Kernel::Single,
                    ..self.options.clone()
                };
                TypedAccel::new(scene, self.backend, &options)?
            }
        };
        Ok(Structure {
            single: Some(single),
            ..self
        })
    }

    /// Builds the structures of all contestants on the threads of the pool.
    pub(super) fn all(
        scene: &'s Scene,
        options: &BenchOptions<'s>,
    ) -> Result<Vec<Structure<'s>>, BenchError> {
        let requested = options.accel;
        let at = |precision: Precision| AccelOptions {
            precision,
            instancing: requested.instancing.resolved(precision),
            ..requested.clone()
        };
        let new = |backend, options: AccelOptions<'s>| Structure::new(scene, backend, options);
        parallel::install(options.pool, || {
            let mut all = Vec::new();
            if cfg!(feature = "embree") {
                // Embree with the chosen precision, and both kinds of instancing where there are instanced meshes
                let chosen = at(requested.precision);
                let other = chosen.instancing.other();
                all.push(new(Backend::Embree, chosen.clone())?.with_single(scene)?);
                check(options.observer)?;
                if all[0].packet.has_instanced_meshes() && other.resolved(requested.precision) == other {
                    let options = AccelOptions {
                        instancing: other,
                        ..chosen
                    };
                    all.push(new(Backend::Embree, options)?.with_single(scene)?);
                }
                // Embree with the other precisions
                for precision in Precision::ALL {
                    check(options.observer)?;
                    if options.all_precisions && precision != requested.precision {
                        all.push(new(Backend::Embree, at(precision))?);
                    }
                }
            }
            check(options.observer)?;
            all.push(new(Backend::Native, at(Precision::Watertight))?.with_single(scene)?);
            // The BSP is the reference of hits, so it is watertight for any precision requested from Embree.
            check(options.observer)?;
            all.push(new(Backend::Bsp, at(Precision::Watertight))?.with_single(scene)?);
            check(options.observer)?;
            Ok(all)
        })
    }

    /// Builds the structure again, drops it, and returns the time of the build.
    fn rebuild_time(&self, scene: &Scene, pool: &ThreadPool) -> Result<TurnTime, BenchError> {
        let options = AccelOptions {
            threads: pool.current_num_threads(),
            ..self.options.clone()
        };
        let (built, time) = parallel::install(pool, || {
            let watch = Stopwatch::start();
            let built = TypedAccel::new(scene, self.backend, &options);
            (built, watch.time())
        });
        built?;
        Ok(time)
    }

    pub(super) fn accel(&self) -> &dyn Accel {
        self.packet.accel()
    }

    pub(super) fn precision(&self) -> Precision {
        self.options.precision
    }

    /// Returns the kind of instancing in Embree; `None` for other backends and scenes without instanced meshes.
    pub(super) fn instancing(&self) -> Option<Instancing> {
        self.packet
            .has_instanced_meshes()
            .then_some(self.options.instancing)
    }

    /// Returns the contestants that trace rays through the structure.
    fn contestants(&self, structure: usize) -> Vec<Contestant<'_>> {
        let single = self.single.as_ref();
        let mut engines = vec![(Mode::Packet, Engine::Accel(self.accel()))];
        match &self.packet {
            // Packets and single rays, each with and without the code of the backend
            #[cfg(feature = "embree")]
            TypedAccel::Embree(packet) => {
                if let Some(TypedAccel::Embree(single)) = single {
                    engines.push((Mode::Raw, Engine::Raw(packet)));
                    engines.push((Mode::Single, Engine::Accel(single)));
                    engines.push((Mode::RawSingle, Engine::RawSingle(single)));
                }
            }
            // Packets, single rays and batches
            TypedAccel::Native(_) | TypedAccel::Bsp(_) => {
                engines.extend(single.map(|single| (Mode::Single, Engine::Accel(single.accel()))));
                engines.push((Mode::Batch, Engine::Accel(self.accel())));
            }
        }
        engines
            .into_iter()
            .map(|(mode, engine)| Contestant {
                structure,
                mode,
                engine,
            })
            .collect()
    }
}

/// Times the builds of all structures with each pool: the one of the options, then those of the scaling measurement.
/// The candidates of the blocks are ordered by structure, then by pool.
pub(super) fn time_builds(
    scene: &Scene,
    structures: &[Structure],
    options: &BenchOptions,
) -> Result<Blocks, BenchError> {
    let pools: Vec<&ThreadPool> = [options.pool].into_iter().chain(options.scaling).collect();
    options.blocks("build", (structures.len() * pools.len(), 1), |candidate, _| {
        let pool = pools[candidate % pools.len()];
        structures[candidate / pools.len()].rebuild_time(scene, pool)
    })
}

/// Way of tracing rays that takes part in a benchmark.
pub(super) struct Contestant<'a> {
    /// Index of the structure.
    pub(super) structure: usize,
    pub(super) mode: Mode,
    pub(super) engine: Engine<'a>,
}

impl<'a> Contestant<'a> {
    /// Returns the contestants of all structures; the first is the reference of hits.
    pub(super) fn all(structures: &'a [Structure]) -> Vec<Contestant<'a>> {
        structures
            .iter()
            .enumerate()
            .flat_map(|(index, structure)| structure.contestants(index))
            .collect()
    }

    /// Returns the contestant that this one's hits are compared with: the first one. Raw calls, of which only distances
    /// are compared, bit by bit, are compared with the backend that wraps them.
    pub(super) fn reference<'c>(&self, contestants: &'c [Contestant<'a>]) -> &'c Contestant<'a> {
        let wrapped_mode = match self.mode {
            Mode::Raw => Mode::Packet,
            Mode::RawSingle => Mode::Single,
            Mode::Packet | Mode::Single | Mode::Batch => return &contestants[0],
        };
        contestants
            .iter()
            .find(|other| other.mode == wrapped_mode && other.structure == self.structure)
            .unwrap_or(&contestants[0])
    }
}
