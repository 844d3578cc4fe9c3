//! Statistics of a render: `whit render --stats`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;

use crate::accel::{Backend, EmbreeIdentity, Precision};
use crate::render::plan::Decision;
use crate::render::{
    Category, ImageError, Memory, MemoryEntry, RenderProfile, Rendering, SampleCounts, SubsurfaceStats,
    Tally, TruncationBound,
};
use crate::report::memory;
use crate::scene::{Geometry, Scene};

/// Complete statistics of one rendered image.
#[derive(Clone, Debug, Serialize)]
pub struct RenderStats {
    /// Version of whit that rendered.
    pub version: &'static str,
    /// Scene that was rendered.
    pub scene: SceneStats,
    /// Image that was written.
    pub image: ImageStats,
    /// Samples per pixel; with adaptive sampling the largest number.
    pub spp: u32,
    /// Number of samples that were taken.
    pub samples: SampleCounts,
    /// Maximum depth of reflected and refracted rays.
    pub depth: u32,
    /// Rays that were cut off by the depth limit or the weight.
    pub cutoff: CutoffStats,
    /// Intersection backend that found the hits.
    pub backend: Backend,
    /// Identity of the Embree library, where it is the backend.
    pub embree: Option<EmbreeIdentity>,
    /// Precision of triangle hits.
    pub precision: Precision,
    /// Number of threads that built and rendered.
    pub threads: usize,
    /// Wall-clock seconds of each phase.
    pub seconds: PhaseSeconds,
    /// Number of rays by purpose.
    pub rays: RayCounts,
    /// Simulated and skipped effects, each with its cost and reason.
    pub effects: BTreeMap<&'static str, EffectStats>,
    /// Profile of all rays, seconds and bytes, each under one account, with the overhead of measuring.
    pub ledger: LedgerStats,
    /// Subsurface-scattering objects; null where none scatters.
    pub subsurface: Option<SubsurfaceStats>,
    /// Estimated error of the image by noise; null where a search for settings measured it.
    pub error: Option<ImageError>,
    /// Size and kind of the acceleration structure.
    pub accel: AccelStats,
    /// Peak memory of the process so far; null where the system does not report it.
    pub peak_memory_bytes: Option<u64>,
}

/// Numbers of objects in a scene.
#[derive(Clone, Debug, Serialize)]
pub struct SceneStats {
    /// Path of the scene as given on the command line.
    pub path: PathBuf,
    /// Number of triangles; a shared mesh counts once per instance.
    pub triangles: usize,
    /// Number of instances of analytic shapes.
    pub shapes: usize,
    /// Number of points; a shared point cloud counts once per instance.
    pub points: usize,
    /// Number of instances of all geometries.
    pub instances: usize,
    /// Number of lights in the scene.
    pub lights: usize,
    /// Number of material textures.
    pub textures: usize,
    /// Number of volumes, without fog.
    pub volumes: usize,
    /// Bytes of the volumes' grids.
    pub volume_bytes: u64,
    /// True if fog fills all space.
    pub fog: bool,
}

impl SceneStats {
    /// Counts the objects of a scene that was read from `path`.
    pub fn of(scene: &Scene, path: impl Into<PathBuf>) -> SceneStats {
        // Count instances of shapes rather than distinct shapes
        let is_shape = |geometry: u32| matches!(scene.geometries[geometry as usize], Geometry::Shape(_));
        SceneStats {
            path: path.into(),
            triangles: scene.triangle_count(),
            shapes: scene.instances.iter().filter(|i| is_shape(i.geometry)).count(),
            points: scene.point_count(),
            instances: scene.instances.len(),
            lights: scene.lights.len(),
            textures: scene.textures.len(),
            volumes: scene.volumes.len(),
            volume_bytes: memory::volume_bytes(scene),
            fog: scene.fog.is_some(),
        }
    }
}

/// Image that was written, with its size and exposure.
#[derive(Clone, Debug, Serialize)]
pub struct ImageStats {
    /// Path of the image file.
    pub path: PathBuf,
    /// Width of the image in pixels.
    pub width: u32,
    /// Height of the image in pixels.
    pub height: u32,
    /// Name of the camera.
    pub camera: String,
    /// Radiance of the background, linear RGB.
    pub ambient: [f32; 3],
    /// Exposure in stops, which affects a PNG only.
    pub exposure_ev: f32,
    /// Number of pixels with a NaN or an infinity; 0 in a valid image.
    pub non_finite_pixels: usize,
}

/// Wall-clock seconds by phase.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PhaseSeconds {
    /// Seconds to read and check the scene.
    pub load: f64,
    /// Seconds to build the acceleration structure.
    pub build: f64,
    /// Seconds to render the image.
    pub render: f64,
    /// Seconds to write the image.
    pub write: f64,
    /// Seconds from the start of loading to the end of writing.
    pub total: f64,
    /// Seconds within the backend while rendering, summed over threads.
    pub trace: f64,
}

/// Numbers of rays by purpose.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct RayCounts {
    /// Rays from the camera.
    pub camera: u64,
    /// Shadow rays to lights.
    pub shadow: u64,
    /// Rays reflected at surfaces.
    pub reflection: u64,
    /// Rays refracted or transmitted through surfaces.
    pub refraction: u64,
}

/// Rays that were not followed because of their low weight or the depth limit.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct CutoffStats {
    /// Number of rays cut off.
    pub rays: u64,
    /// Sum of the rays' weights over the number of samples: a pixel is on average darker by at most this factor times
    /// the largest radiance in the scene.
    pub mean_weight: f64,
    /// Largest loss of any pixel: its samples' lost weights over their number. Multiplied by the radiance that a lost
    /// ray could have contributed, it is the largest error of a pixel under a box filter.
    pub max_weight: f64,
    /// Part of the loss due to the depth limit.
    pub depth_limit: LossStats,
    /// Part of the loss due to the weight cut-off.
    pub weight_cutoff: LossStats,
}

/// Rays that one limit cut off.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LossStats {
    /// Number of rays cut off by the limit.
    pub rays: u64,
    /// Sum of the rays' weights over the number of samples.
    pub mean_weight: f64,
    /// Largest loss of any pixel due to the limit.
    pub max_weight: f64,
}

impl LossStats {
    fn of(loss: &TruncationBound, samples: u64) -> LossStats {
        LossStats {
            rays: loss.rays,
            mean_weight: loss.weight / samples.max(1) as f64,
            max_weight: loss.max_weight,
        }
    }
}

impl CutoffStats {
    /// Returns the cut-off statistics of a ledger, for `samples` samples.
    pub fn of(ledger: &RenderProfile, samples: u64) -> CutoffStats {
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
    /// Returns the ray counts of a ledger.
    pub fn of(ledger: &RenderProfile) -> RayCounts {
        RayCounts {
            camera: ledger.camera_rays(),
            shadow: ledger.shadow_rays(),
            reflection: ledger.reflection_rays(),
            refraction: ledger.refraction_rays(),
        }
    }
}

/// Cost of an effect and the reason for simulating it.
#[derive(Clone, Debug, Serialize)]
pub struct EffectStats {
    /// Number of rays traced for the effect; 0 where it has no account of its own.
    pub rays: u64,
    /// Seconds of the effect, summed over threads; 0 where it has no account of its own.
    pub seconds: f64,
    /// Bytes that were held for the effect.
    pub bytes: u64,
    /// True if the effect was simulated.
    pub on: bool,
    /// Objects in the scene that need the effect, or the statement that none does.
    pub reason: String,
}

/// Returns the statistics of a frame's effects by name.
pub fn effect_stats(rendering: &Rendering) -> BTreeMap<&'static str, EffectStats> {
    let Rendering {
        plan, ledger, memory, ..
    } = rendering;
    // Effects without an account of their own have zero rays and seconds
    let tally = |effect| Category::of(effect).map_or(Tally::default(), |account| ledger.of(account));
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

/// Profile of the rays, seconds and bytes of the render phase.
#[derive(Clone, Debug, Serialize)]
pub struct LedgerStats {
    /// Statistics by account; an effect's account has the effect's name. Rays sum to all rays that the backend traced,
    /// seconds to `thread_seconds`.
    pub accounts: BTreeMap<&'static str, AccountStats>,
    /// Wall-clock seconds of the phase times its number of threads.
    pub thread_seconds: f64,
    /// Number of clock readings.
    pub clock_reads: u64,
    /// Seconds per clock reading, as measured before the render.
    pub clock_read_seconds: f64,
    /// Seconds that all clock readings took, summed over threads.
    pub seconds_of_measuring: f64,
    /// Sum of the bytes of all holdings, each at its own peak.
    pub bytes: u64,
    /// Largest number of bytes held at the same time.
    pub bytes_at_once: u64,
    /// Memory by purpose: effects, accounts, and the acceleration structure.
    pub holdings: Vec<MemoryEntry>,
}

/// Cost of one account.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AccountStats {
    /// Number of rays that the backend traced.
    pub rays: u64,
    /// Seconds, summed over threads.
    pub seconds: f64,
    /// Part of the seconds that was spent within the backend.
    pub trace_seconds: f64,
    /// Bytes that were held for the account.
    pub bytes: u64,
}

impl LedgerStats {
    /// Returns the statistics of a render's ledger and memory.
    pub fn of(ledger: &RenderProfile, memory: &Memory) -> LedgerStats {
        let entry = |(account, tally): (Category, Tally)| {
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

/// Size and description of the acceleration structure.
#[derive(Clone, Debug, Serialize)]
pub struct AccelStats {
    /// Bytes after the build.
    pub bytes: u64,
    /// Peak bytes during the build.
    pub peak_bytes: u64,
    /// Description of the structure for a person.
    pub summary: String,
}
