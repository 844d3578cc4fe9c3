//! What a render took: `whit render --stats`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;

use crate::accel::{Backend, EmbreeIdentity, Precision};
use crate::render::plan::Decision;
use crate::render::{
    Account, Holding, Ledger, Loss, Memory, Rendering, SampleCounts, SubsurfaceStats, Tally,
};
use crate::scene::{Geometry, Scene};

/// Everything worth knowing about one rendered image.
#[derive(Clone, Debug, Serialize)]
pub struct RenderStats {
    /// Of whit.
    pub version: &'static str,
    /// What was rendered.
    pub scene: SceneStats,
    /// What became of it.
    pub image: ImageStats,
    /// Samples a pixel; at most, if they are adaptive.
    pub spp: u32,
    /// Samples that were taken.
    pub samples: SampleCounts,
    /// Most generations of reflected and refracted rays.
    pub depth: u32,
    /// What was not followed.
    pub cutoff: CutoffStats,
    /// What found the hits.
    pub backend: Backend,
    /// Which Embree, where it is the backend.
    pub embree: Option<EmbreeIdentity>,
    /// How far triangle hits may be trusted.
    pub precision: Precision,
    /// Threads that built and rendered.
    pub threads: usize,
    /// Where the time went.
    pub seconds: PhaseSeconds,
    /// Rays by purpose.
    pub rays: RayCounts,
    /// What was simulated and what was not, each with its cost and its reason.
    pub effects: BTreeMap<&'static str, EffectStats>,
    /// Every ray, every second and every byte, each under one account, and what the measuring took.
    pub ledger: LedgerStats,
    /// Bodies that scatter light within; null where none does.
    pub subsurface: Option<SubsurfaceStats>,
    /// The acceleration structure.
    pub accel: AccelStats,
    /// Most memory that the process has held so far; null where the system does not tell.
    pub peak_memory_bytes: Option<u64>,
}

/// What a scene holds.
#[derive(Clone, Debug, Serialize)]
pub struct SceneStats {
    /// As it was named on the command line.
    pub path: PathBuf,
    /// Those of a shared mesh count once for every instance.
    pub triangles: usize,
    /// Instances of analytic shapes.
    pub shapes: usize,
    /// Placed geometries.
    pub instances: usize,
    /// Punctual lights.
    pub lights: usize,
    /// Textures of materials.
    pub textures: usize,
    /// Volumes, without fog.
    pub volumes: usize,
    /// Bytes of their grids.
    pub volume_bytes: u64,
    /// Whether fog fills all space.
    pub fog: bool,
}

impl SceneStats {
    /// Counts a scene that was read from `path`.
    pub fn of(scene: &Scene, path: impl Into<PathBuf>) -> SceneStats {
        let is_shape = |geometry: u32| matches!(scene.geometries[geometry as usize], Geometry::Shape(_));
        SceneStats {
            path: path.into(),
            triangles: scene.triangle_count(),
            shapes: scene.instances.iter().filter(|i| is_shape(i.geometry)).count(),
            instances: scene.instances.len(),
            lights: scene.lights.len(),
            textures: scene.textures.len(),
            volumes: scene.volumes.len(),
            volume_bytes: super::memory::volume_bytes(scene),
            fog: scene.fog.is_some(),
        }
    }
}

/// The image that was written.
#[derive(Clone, Debug, Serialize)]
pub struct ImageStats {
    /// Where it is.
    pub path: PathBuf,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Name of the camera.
    pub camera: String,
    /// Radiance of the surroundings, linear RGB.
    pub ambient: [f32; 3],
    /// Stops of exposure, which only a PNG shows.
    pub exposure_ev: f32,
    /// Pixels that hold a NaN or an infinity; 0 in a sound picture.
    pub non_finite_pixels: usize,
}

/// Wall-clock seconds by phase.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PhaseSeconds {
    /// Reading and checking the scene.
    pub load: f64,
    /// Building the acceleration structure.
    pub build: f64,
    /// Rendering.
    pub render: f64,
    /// Writing the image.
    pub write: f64,
    /// From the start of loading to the end of writing.
    pub total: f64,
    /// Within the backend while rendering, summed over threads.
    pub trace: f64,
}

/// Rays by purpose.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct RayCounts {
    /// From the camera.
    pub camera: u64,
    /// To lights.
    pub shadow: u64,
    /// From mirrors.
    pub reflection: u64,
    /// Through surfaces.
    pub refraction: u64,
}

/// Rays that were not followed because they hardly matter, or because of the depth limit.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct CutoffStats {
    /// How many.
    pub rays: u64,
    /// The sum of their weights over all samples: a pixel is on average darker by at most so many times the largest
    /// radiance in the scene.
    pub mean_weight: f64,
    /// The most that any pixel lacks: its samples' lost weights over their number. Times the radiance that a lost ray
    /// could have brought, it is the worst error of a pixel that is filtered by a box.
    pub max_weight: f64,
    /// Of these, rays beyond the depth limit.
    pub depth_limit: LossStats,
    /// Of these, rays that weighed too little.
    pub weight_cutoff: LossStats,
}

/// Rays that one limit cut off.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LossStats {
    /// How many.
    pub rays: u64,
    /// Their weights over all samples.
    pub mean_weight: f64,
    /// The most that any pixel lacks because of them.
    pub max_weight: f64,
}

impl LossStats {
    fn of(loss: &Loss, samples: u64) -> LossStats {
        LossStats {
            rays: loss.rays,
            mean_weight: loss.weight / samples.max(1) as f64,
            max_weight: loss.max_weight,
        }
    }
}

impl CutoffStats {
    /// Those of a ledger, for so many samples.
    pub fn of(ledger: &Ledger, samples: u64) -> CutoffStats {
        CutoffStats {
            rays: ledger.lost_rays,
            mean_weight: ledger.lost_weight / samples.max(1) as f64,
            max_weight: ledger.max_lost_weight,
            depth_limit: LossStats::of(&ledger.depth_limit, samples),
            weight_cutoff: LossStats::of(&ledger.weight_cutoff, samples),
        }
    }
}

impl RayCounts {
    /// The counts of a ledger.
    pub fn of(ledger: &Ledger) -> RayCounts {
        RayCounts {
            camera: ledger.camera_rays(),
            shadow: ledger.shadow_rays(),
            reflection: ledger.reflection_rays(),
            refraction: ledger.refraction_rays(),
        }
    }
}

/// What an effect cost and why it was simulated.
#[derive(Clone, Debug, Serialize)]
pub struct EffectStats {
    /// Rays traced for it; 0 where it has no account of its own.
    pub rays: u64,
    /// Seconds that it took, summed over threads; 0 where it has no account of its own.
    pub seconds: f64,
    /// Bytes that were held for it.
    pub bytes: u64,
    /// Whether it was simulated.
    pub on: bool,
    /// What in the scene calls for it, or that nothing does.
    pub reason: String,
}

/// The effects of a frame by name.
pub fn effect_stats(rendering: &Rendering) -> BTreeMap<&'static str, EffectStats> {
    let Rendering {
        plan, ledger, memory, ..
    } = rendering;
    let tally = |effect| Account::of(effect).map_or(Tally::default(), |account| ledger.of(account));
    let entry = |decision: &Decision| EffectStats {
        rays: tally(decision.effect).rays,
        seconds: tally(decision.effect).seconds,
        bytes: memory.of(decision.effect.name()),
        on: decision.on,
        reason: decision.reason.clone(),
    };
    plan.decisions
        .iter()
        .map(|decision| (decision.effect.name(), entry(decision)))
        .collect()
}

/// Where rays, seconds and bytes of the render phase went.
#[derive(Clone, Debug, Serialize)]
pub struct LedgerStats {
    /// By account; an effect's has the effect's name. Rays add up to all that were asked of the backend, seconds to
    /// `thread_seconds`.
    pub accounts: BTreeMap<&'static str, AccountStats>,
    /// Wall-clock seconds of the phase times its threads.
    pub thread_seconds: f64,
    /// How often the clock was read.
    pub clock_reads: u64,
    /// Seconds that one reading takes, as measured before the render.
    pub clock_read_seconds: f64,
    /// Seconds that reading the clock took, summed over threads.
    pub seconds_of_measuring: f64,
    /// Bytes of all holdings, each at its own peak.
    pub bytes: u64,
    /// Bytes that were held at the same time, at most.
    pub bytes_at_once: u64,
    /// What was held in memory, and for what: effects, accounts, and what serves to find hits.
    pub holdings: Vec<Holding>,
}

/// What one account took.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AccountStats {
    /// Rays asked of the backend.
    pub rays: u64,
    /// Seconds, summed over threads.
    pub seconds: f64,
    /// Of these, within the backend.
    pub trace_seconds: f64,
    /// Bytes that were held for it.
    pub bytes: u64,
}

impl LedgerStats {
    /// Those of a render.
    pub fn of(ledger: &Ledger, memory: &Memory) -> LedgerStats {
        let entry = |(account, tally): (Account, Tally)| {
            let stats = AccountStats {
                rays: tally.rays,
                seconds: tally.seconds,
                trace_seconds: tally.trace_seconds,
                bytes: memory.of(account.name()),
            };
            (account.name(), stats)
        };
        LedgerStats {
            accounts: ledger.tallies().map(entry).collect(),
            thread_seconds: ledger.seconds * ledger.threads as f64,
            clock_reads: ledger.clock_reads,
            clock_read_seconds: ledger.clock_read_seconds,
            seconds_of_measuring: ledger.seconds_of_measuring(),
            bytes: memory.total(),
            bytes_at_once: memory.at_once(),
            holdings: memory.holdings().to_vec(),
        }
    }
}

/// The acceleration structure that was used.
#[derive(Clone, Debug, Serialize)]
pub struct AccelStats {
    /// After the build.
    pub bytes: u64,
    /// At most during the build.
    pub peak_bytes: u64,
    /// What it is, for a person.
    pub summary: String,
}
