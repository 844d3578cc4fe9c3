//! Time that bounding volumes around objects save or cost: `whit bench --extents`.

use std::path::PathBuf;

use serde::Serialize;

use super::error::{BenchError, check};
use super::options::{BenchOptions, MeasuredScene};
use super::ray_workload::{RayKind, RayWorkload};
use super::replay::{Engine, Mode, ReplayPart, replay_time};
use crate::accel::bsp::BspAccel;
use crate::accel::extents::{
    BoundingVolumeCounts, BoundingVolumeKind, ListAccel, ListLimits, Spheres, Tally, TileCulledAccel,
};
use crate::accel::{Accel, AccelError, AccelOptions, LANES, RayPacket};
use crate::measure::Interval;
use crate::parallel;

/// Seconds that one replay through a plain list may take; the number of rays is reduced accordingly.
const LIST_SECONDS: f64 = 0.06;
/// Largest number of packets replayed through a tree.
const TREE_PACKETS: usize = 1 << 13;

/// Measurement of one kind of bounding volume with one kind of ray.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BoundingVolumeRow {
    /// Path of the scene as given on the command line.
    pub scene: PathBuf,
    /// Kind of rays that were traced.
    pub rays: RayKind,
    /// Container of the objects: `list` or `bsp`.
    pub structure: &'static str,
    /// Bounding volume that is tested before an object.
    pub extent: String,
    /// Number of tests that the rays caused; absent for trees.
    pub tally: Option<Tally>,
    /// Time relative to equal rays without bounding volumes: the median over the repetitions.
    pub time: f64,
    /// Smallest time ratio of the repetitions.
    pub time_min: f64,
    /// Largest time ratio of the repetitions.
    pub time_max: f64,
    /// Mean nanoseconds per ray.
    pub ns_per_ray: f64,
    /// Number of rays timed in each repetition.
    pub ray_count: u64,
    /// Number of results that differ from those without bounding volumes in any bit.
    pub differ: u64,
    /// Number of objects by kind of bounding volume; absent for trees.
    pub counts: Option<BoundingVolumeCounts>,
}

impl BoundingVolumeRow {
    /// Returns the fraction of object tests that the bounding volumes saved.
    pub fn saved(&self) -> Option<f64> {
        let tally = self.tally.filter(|tally| tally.objects > 0)?;
        Some(1.0 - tally.object_tests as f64 / tally.objects as f64)
    }

    /// Returns whether the bounding volumes cost more time than they save, beyond the spread of the measurements.
    pub fn is_slower(&self) -> bool {
        self.time_min > 1.0
    }
}

/// Measures bounding volumes with the rays of a scene and returns a row for each set of rays and structure.
///
/// # Errors
///
/// Returns an error where an acceleration structure cannot be built, and on cancellation.
pub fn measure_bounding_volumes(
    measured: &MeasuredScene,
    options: &BenchOptions,
) -> Result<Vec<BoundingVolumeRow>, BenchError> {
    let MeasuredScene { camera, settings, .. } = *measured;
    let scene = measured.scene.get();
    let step = |step| (options.observer.progress)(step, 0.0);
    // Build trees with and without bounding spheres, and lists with every kind of volume
    step("build");
    let build_options = AccelOptions {
        threads: options.accel.threads,
        ..AccelOptions::default()
    };
    let trees = parallel::install(options.pool, || {
        let build = |spheres| BspAccel::build_with_spheres(scene, &build_options, spheres);
        Ok::<_, AccelError>([build(Spheres::Never)?, build(Spheres::Always)?])
    })?;
    let [bare, with_spheres] = &trees;
    let lists = parallel::install(options.pool, || {
        BoundingVolumeKind::ALL.map(|kind| ListAccel::new(scene, kind))
    });
    // Put screen bounds in front of a list and of a tree
    let view = camera.view(settings.width, settings.height);
    let project = |inner, kind, limits| TileCulledAccel::new(scene, &view, inner, kind, limits);
    let over_list = [
        ("projection", BoundingVolumeKind::None),
        ("projection, chosen", BoundingVolumeKind::Chosen),
    ]
    .map(|(extent, kind)| (extent, project(&lists[0], kind, ListLimits::NONE)));
    let over_tree = project(
        with_spheres,
        BoundingVolumeKind::TightSphere,
        ListLimits::BESIDE_A_TREE,
    );
    // Record the rays of the frame
    step("record");
    let sets = RayWorkload::all(measured, bare);
    // Measure each kind of ray; screen bounds apply to camera rays only
    let mut rows = Vec::new();
    for set in &sets {
        let is_camera = set.kind == RayKind::Camera;
        let all_lists = BoundingVolumeKind::ALL.iter().zip(&lists);
        let mut in_list: Vec<VolumeCandidate> = all_lists
            .map(|(kind, list)| VolumeCandidate::of_list(*kind, list))
            .collect();
        let screen_bounds = over_list.iter().filter(|_| is_camera);
        in_list.extend(screen_bounds.filter_map(|(extent, accel)| {
            Some(VolumeCandidate {
                structure: "list",
                extent: (*extent).into(),
                traced: TracedStructure::Projected(accel.as_ref()?),
                counts: None,
            })
        }));
        let some_rays = rays_within_budget(&lists[0], set);
        rows.extend(measure(measured.name, &in_list, &some_rays, options)?);
        // Measure the trees with more rays, as they are faster
        let mut in_tree: Vec<VolumeCandidate> = ["none", "tight sphere"]
            .into_iter()
            .zip(&trees)
            .map(|(extent, tree)| VolumeCandidate::of_tree(extent, tree, Some(tree.sphere_count())))
            .collect();
        let screen_bounds = over_tree.iter().filter(|_| is_camera);
        in_tree
            .extend(screen_bounds.map(|accel| VolumeCandidate::of_tree("sphere + projection", accel, None)));
        rows.extend(measure(
            measured.name,
            &in_tree,
            &set.at_most(TREE_PACKETS),
            options,
        )?);
    }
    Ok(rows)
}

/// Returns as many rays of the set as a plain list traces in [`LIST_SECONDS`], evenly chosen; at least one.
fn rays_within_budget(list: &ListAccel, set: &RayWorkload) -> RayWorkload {
    // The shortest of three times, so that an interruption does not leave too few rays.
    let seconds = |some: &RayWorkload| {
        let timings =
            (0..3).map(|_| replay_time(Engine::Accel(list), ReplayPart::whole(some), Mode::Packet).processor);
        timings.fold(f64::INFINITY, f64::min)
    };
    let mut most = 1;
    loop {
        let some = set.at_most(most);
        let taken = seconds(&some);
        // If one packet is too slow, use fewer of its lanes
        if most == 1 && taken > LIST_SECONDS {
            let lanes = (LANES as f64 * LIST_SECONDS / taken).ceil();
            return some.first_lanes(lanes as usize);
        }
        // Otherwise double the number of packets until the time is reached
        if 2.0 * taken > LIST_SECONDS || some.ray_count == set.ray_count {
            return some;
        }
        most *= 2;
    }
}

/// Structure that is traced, by the way in which its work can be counted.
#[derive(Clone, Copy)]
enum TracedStructure<'a> {
    List(&'a ListAccel<'a>),
    Projected(&'a TileCulledAccel<'a, 'a>),
    Tree(&'a dyn Accel),
}

/// Structure of objects and bounding volumes that takes part in the measurement.
struct VolumeCandidate<'a> {
    structure: &'static str,
    extent: String,
    traced: TracedStructure<'a>,
    /// Number of objects with each kind of volume, where it is counted.
    counts: Option<BoundingVolumeCounts>,
}

impl<'a> VolumeCandidate<'a> {
    fn of_list(kind: BoundingVolumeKind, list: &'a ListAccel<'a>) -> VolumeCandidate<'a> {
        VolumeCandidate {
            structure: "list",
            extent: kind.to_string(),
            traced: TracedStructure::List(list),
            counts: Some(list.counts()),
        }
    }

    fn of_tree(extent: &str, tree: &'a dyn Accel, sphere_count: Option<usize>) -> VolumeCandidate<'a> {
        VolumeCandidate {
            structure: "bsp",
            extent: extent.into(),
            traced: TracedStructure::Tree(tree),
            counts: sphere_count.map(|count| BoundingVolumeCounts {
                tight_spheres: count as u64,
                ..BoundingVolumeCounts::default()
            }),
        }
    }

    fn accel(&self) -> &'a dyn Accel {
        match self.traced {
            TracedStructure::List(list) => list,
            TracedStructure::Projected(projected) => projected,
            TracedStructure::Tree(tree) => tree,
        }
    }

    /// Returns the results of the rays of a set, and the work that they took.
    fn results(&self, set: &RayWorkload) -> (Vec<RayPacket>, Option<Tally>) {
        let mut packets = set.packets.clone();
        let is_shadow = set.kind == RayKind::Shadow;
        let tally = match self.traced {
            TracedStructure::List(list) if is_shadow => Some(list.count_occluded(&mut packets)),
            TracedStructure::List(list) => Some(list.count_intersect(&mut packets)),
            TracedStructure::Projected(projected) => Some(projected.count_intersect(&mut packets)),
            TracedStructure::Tree(tree) => {
                if is_shadow {
                    tree.occluded(&mut packets, set.order());
                } else {
                    tree.intersect(&mut packets, set.order());
                }
                None
            }
        };
        (packets, tally)
    }
}

/// Measures the candidates and returns a row for each; times are relative to those of the first.
fn measure(
    name: &str,
    candidates: &[VolumeCandidate],
    set: &RayWorkload,
    options: &BenchOptions,
) -> Result<Vec<BoundingVolumeRow>, BenchError> {
    let blocks = options.blocks("replay", (candidates.len(), 1), |index, _| {
        let engine = Engine::Accel(candidates[index].accel());
        Ok(replay_time(engine, ReplayPart::whole(set), Mode::Packet))
    })?;
    // Compare the results with those of the first candidate
    let mut rows = Vec::new();
    let mut reference = None;
    for (index, candidate) in candidates.iter().enumerate() {
        check(options.observer)?;
        // Trace once more to count the work and to get the results
        let (results, tally) = candidate.results(set);
        let reference = reference.get_or_insert_with(|| results.clone());
        let time = Interval::of_extremes(&blocks.ratios(index, 0));
        let seconds = Interval::of_extremes(&blocks.processor_seconds(index)).value;
        rows.push(BoundingVolumeRow {
            scene: name.into(),
            rays: set.kind,
            structure: candidate.structure,
            extent: candidate.extent.clone(),
            tally,
            time: time.value,
            time_min: time.low,
            time_max: time.high,
            ns_per_ray: 1e9 * seconds / set.ray_count as f64,
            ray_count: set.ray_count,
            differ: differing(reference, &results),
            counts: candidate.counts,
        });
    }
    Ok(rows)
}

/// Returns the number of rays whose results differ in any bit.
fn differing(a: &[RayPacket], b: &[RayPacket]) -> u64 {
    let pairs = a.iter().zip(b);
    let differ = |(a, b): (&RayPacket, &RayPacket)| {
        let result = |p: &RayPacket, lane| (p.is_blocked(lane), p.hit(lane));
        (0..LANES)
            .filter(|&lane| result(a, lane) != result(b, lane))
            .count() as u64
    };
    pairs.map(differ).sum()
}
