//! Command `whit bench --extents`: measures the time that bounding volumes around objects save or cost.

use std::path::Path;

use rayon::ThreadPool;

use whit::accel::bsp::BspAccel;
use whit::accel::extents::{
    BoundingVolumeCounts, BoundingVolumeKind, ListAccel, ListLimits, Spheres, Tally, TileCulledAccel,
};
use whit::accel::{Accel, AccelError, AccelOptions, LANES, RayPacket};
use whit::image::check_writable;
use whit::parallel;
use whit::render::{self, RenderSettings};
use whit::report::bench::{Mode, RayKind, Spread};
use whit::report::extents::{BoundingVolumeRow, BoundingVolumeTable};
use whit::scene::{Camera, Scene};

use super::args::BenchArgs;
use super::bench::{BenchJob, BenchScene, Reporter, Subject, measure_scenes, write_json};
use super::failure::Failure;
use super::interrupt;
use super::progress::Progress;
use super::replay::{Engine, RayWorkload, replay_seconds};

/// Seconds that one replay through a plain list may take; the number of rays is reduced accordingly.
const LIST_SECONDS: f64 = 0.06;
/// Largest number of packets replayed through a tree.
const TREE_PACKETS: usize = 1 << 13;

/// Measures all scenes of the arguments.
pub(super) fn run(args: &BenchArgs) -> Result<(), Failure> {
    if let Some(path) = &args.json {
        check_writable(path)?;
    }
    let reporter = Reporter {
        table: |rows: &[BoundingVolumeRow]| BoundingVolumeTable(rows).to_string(),
        write: |rows: &[BoundingVolumeRow]| write_json(args, rows),
    };
    measure_scenes(args, &Subject::files(args), bench_scene, reporter)?;
    Ok(())
}

/// Measures one scene and returns its rows.
fn bench_scene(
    job: &BenchJob,
    bench_scene: BenchScene,
    pool: &ThreadPool,
    progress: &Progress,
) -> Result<Vec<BoundingVolumeRow>, Failure> {
    let BenchScene {
        path,
        name,
        scene,
        camera,
        settings,
    } = bench_scene;
    // Build trees with and without bounding spheres, and lists with every kind of volume
    progress.phase(name, "build");
    let options = AccelOptions {
        threads: job.tracing.threads,
        ..AccelOptions::default()
    };
    let trees = parallel::install(pool, || {
        let build = |spheres| BspAccel::build_with_spheres(scene, &options, spheres);
        Ok::<_, AccelError>([build(Spheres::Never)?, build(Spheres::Always)?])
    })?;
    let [bare, with_spheres] = &trees;
    let lists = parallel::install(pool, || {
        BoundingVolumeKind::ALL.map(|kind| ListAccel::new(scene, kind))
    });
    // Put screen bounds in front of a list and of a tree
    let view = camera.view(settings.width, settings.height);
    let project = |inner, kind, limits| TileCulledAccel::new(scene, &view, inner, kind, limits);
    let projected = [
        project(&lists[0], BoundingVolumeKind::None, ListLimits::NONE),
        project(&lists[0], BoundingVolumeKind::Chosen, ListLimits::NONE),
    ];
    let over_tree = project(
        with_spheres,
        BoundingVolumeKind::TightSphere,
        ListLimits::BESIDE_A_TREE,
    );
    // Record the rays of the frame
    progress.phase(name, "record");
    let sets = ray_sets(&settings, scene, camera, bare);
    progress.phase(name, "replay");
    // Measure each kind of ray; screen bounds apply to camera rays only
    let mut rows = Vec::new();
    for set in &sets {
        let is_camera = set.kind == RayKind::Camera;
        let mut contestants: Vec<Contestant> = BoundingVolumeKind::ALL
            .iter()
            .zip(&lists)
            .map(|(kind, list)| Contestant::of_list(*kind, list))
            .collect();
        let screen_bounds = projected.iter().flatten().filter(|_| is_camera);
        contestants.extend(
            ["projection", "projection, chosen"]
                .into_iter()
                .zip(screen_bounds)
                .map(|(extent, accel)| Contestant {
                    structure: "list",
                    extent: extent.into(),
                    traced: TracedStructure::Projected(accel),
                    counts: None,
                }),
        );
        rows.extend(measure(
            job,
            path,
            &contestants,
            &rays_within_budget(&lists[0], set),
        )?);
        // Measure the trees with more rays, as they are faster
        let names = ["none", "tight sphere"];
        let mut tree_contestants: Vec<Contestant> = names
            .into_iter()
            .zip(&trees)
            .map(|(extent, tree)| Contestant::of_tree(extent, tree, Some(tree.sphere_count())))
            .collect();
        let screen_bounds = over_tree.iter().filter(|_| is_camera);
        tree_contestants
            .extend(screen_bounds.map(|accel| Contestant::of_tree("sphere + projection", accel, None)));
        rows.extend(measure(job, path, &tree_contestants, &set.at_most(TREE_PACKETS))?);
        progress.fraction(rows.len() as f64 / (rows.len() + 5) as f64);
    }
    Ok(rows)
}

/// Returns the frame's own rays and random ones, one set per kind; kinds without rays are left out.
fn ray_sets(
    settings: &RenderSettings,
    scene: &Scene,
    camera: &Camera,
    accel: &dyn Accel,
) -> Vec<RayWorkload> {
    let recorded = render::record(scene, camera, accel, settings);
    let pixel_count = settings.width as usize * settings.height as usize;
    let mut sets = vec![
        RayWorkload::new(RayKind::Camera, recorded.camera),
        RayWorkload::new(RayKind::Shadow, recorded.shadow),
        RayWorkload::new(RayKind::Reflection, recorded.reflection),
        RayWorkload::random(&scene.bounds(), pixel_count),
    ];
    sets.retain(|set| set.ray_count > 0);
    sets
}

/// Returns as many rays of the set as a plain list traces in [`LIST_SECONDS`], evenly chosen; at least one.
fn rays_within_budget(list: &ListAccel, set: &RayWorkload) -> RayWorkload {
    // The shortest of three times, so that an interruption does not leave too few rays.
    let seconds = |some: &RayWorkload| {
        let timings = (0..3).map(|_| replay_seconds(Engine::Accel(list), some, Mode::Packet));
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
        if 2.0 * taken > LIST_SECONDS || some.packets().len() == set.packets().len() {
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
struct Contestant<'a> {
    structure: &'static str,
    extent: String,
    traced: TracedStructure<'a>,
    /// Number of objects with each kind of volume, where it is counted.
    counts: Option<BoundingVolumeCounts>,
}

impl<'a> Contestant<'a> {
    fn of_list(kind: BoundingVolumeKind, list: &'a ListAccel<'a>) -> Contestant<'a> {
        Contestant {
            structure: "list",
            extent: kind.to_string(),
            traced: TracedStructure::List(list),
            counts: Some(list.counts()),
        }
    }

    fn of_tree(extent: &str, tree: &'a dyn Accel, sphere_count: Option<usize>) -> Contestant<'a> {
        Contestant {
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
        let mut packets = set.packets().to_vec();
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

/// Measures the contestants and returns a row for each; times are relative to those of the first.
fn measure(
    job: &BenchJob,
    path: &Path,
    contestants: &[Contestant],
    set: &RayWorkload,
) -> Result<Vec<BoundingVolumeRow>, Failure> {
    // Replay through all contestants in turn within each repetition
    let mut ratios = vec![Vec::new(); contestants.len()];
    let mut seconds = vec![Vec::new(); contestants.len()];
    for _ in 0..job.repeat {
        // Divide by the time of the first contestant in the same repetition
        let mut first = None;
        for (i, contestant) in contestants.iter().enumerate() {
            interrupt::check()?;
            let taken = replay_seconds(Engine::Accel(contestant.accel()), set, Mode::Packet);
            seconds[i].push(taken);
            ratios[i].push(taken / *first.get_or_insert(taken));
        }
    }
    // Compare the results with those of the first contestant
    let mut rows = Vec::new();
    let mut reference = None;
    for (i, contestant) in contestants.iter().enumerate() {
        interrupt::check()?;
        // Trace once more to count the work and to get the results
        let (results, tally) = contestant.results(set);
        let reference = reference.get_or_insert_with(|| results.clone());
        let row = BoundingVolumeRow {
            scene: path.to_owned(),
            rays: set.kind,
            structure: contestant.structure,
            extent: contestant.extent.clone(),
            tally,
            time: 1.0,
            time_min: 1.0,
            time_max: 1.0,
            ns_per_ray: 1e9 * Spread::of(&seconds[i]).median / set.ray_count as f64,
            ray_count: set.ray_count,
            differ: differing(reference, &results),
            counts: contestant.counts,
        };
        rows.push(row.with_ratios(&ratios[i]));
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
