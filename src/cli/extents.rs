//! Command `whit bench --extents`: measures the time that bounding volumes around objects save or cost.

use std::path::Path;

use rayon::ThreadPool;

use crate::accel::bsp::BspAccel;
use crate::accel::extents::{
    ExtentCounts, ExtentKind, ListAccel, ListLimits, ProjectedAccel, Spheres, Tally,
};
use crate::accel::{Accel, AccelError, AccelOptions, LANES, RayPacket};
use crate::image::check_writable;
use crate::parallel;
use crate::render::{self, RenderSettings};
use crate::report::bench::{Mode, RayKind, Spread};
use crate::report::extents::{ExtentRow, ExtentTable};
use crate::scene::{Camera, Scene};

use super::args::BenchArgs;
use super::bench::{BenchJob, BenchScene, Reporter, Subject, measure_scenes, write_json};
use super::failure::Failure;
use super::interrupt;
use super::progress::Progress;
use super::replay::{Engine, RaySet, replay_seconds};

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
        table: |rows: &[ExtentRow]| ExtentTable(rows).to_string(),
        write: |rows: &[ExtentRow]| write_json(args, rows),
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
) -> Result<Vec<ExtentRow>, Failure> {
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
    let lists = parallel::install(pool, || ExtentKind::ALL.map(|kind| ListAccel::new(scene, kind)));
    // Put screen bounds in front of a list and of a tree
    let view = camera.view(settings.width, settings.height);
    let project = |inner, kind, limits| ProjectedAccel::new(scene, &view, inner, kind, limits);
    let projected = [
        project(&lists[0], ExtentKind::None, ListLimits::NONE),
        project(&lists[0], ExtentKind::Chosen, ListLimits::NONE),
    ];
    let over_tree = project(with_spheres, ExtentKind::TightSphere, ListLimits::BESIDE_A_TREE);
    // Record the rays of the frame
    progress.phase(name, "record");
    let sets = ray_sets(&settings, scene, camera, bare);
    progress.phase(name, "replay");
    // Measure each kind of ray; screen bounds apply to camera rays only
    let mut rows = Vec::new();
    for set in &sets {
        let is_camera = set.kind == RayKind::Camera;
        let mut contestants: Vec<Contestant> = ExtentKind::ALL
            .iter()
            .zip(&lists)
            .map(|(kind, list)| Contestant::of_list(*kind, list))
            .collect();
        let on_film = projected.iter().flatten().filter(|_| is_camera);
        contestants.extend(["projection", "projection, chosen"].into_iter().zip(on_film).map(
            |(extent, accel)| Contestant {
                structure: "list",
                extent: extent.into(),
                asked: Asked::Projected(accel),
                counts: None,
            },
        ));
        rows.extend(measure(job, path, &contestants, &fitting(&lists[0], set))?);
        // Measure the trees with more rays, as they are faster
        let names = ["none", "tight sphere"];
        let mut in_trees: Vec<Contestant> = names
            .into_iter()
            .zip(&trees)
            .map(|(extent, tree)| Contestant::of_tree(extent, tree, Some(tree.sphere_count())))
            .collect();
        let on_film = over_tree.iter().filter(|_| is_camera);
        in_trees.extend(on_film.map(|accel| Contestant::of_tree("sphere + projection", accel, None)));
        rows.extend(measure(job, path, &in_trees, &set.some(TREE_PACKETS))?);
        progress.fraction(rows.len() as f64 / (rows.len() + 5) as f64);
    }
    Ok(rows)
}

/// Returns the frame's own rays and random ones, one set per kind; kinds without rays are left out.
fn ray_sets(settings: &RenderSettings, scene: &Scene, camera: &Camera, accel: &dyn Accel) -> Vec<RaySet> {
    let recorded = render::record(scene, camera, accel, settings);
    let pixel_count = settings.width as usize * settings.height as usize;
    let mut sets = vec![
        RaySet::new(RayKind::Camera, recorded.camera),
        RaySet::new(RayKind::Shadow, recorded.shadow),
        RaySet::new(RayKind::Reflection, recorded.reflection),
        RaySet::random(&scene.bounds(), pixel_count),
    ];
    sets.retain(|set| set.ray_count > 0);
    sets
}

/// Returns as many rays of the set as a plain list traces in [`LIST_SECONDS`], evenly chosen; at least one.
fn fitting(list: &ListAccel, set: &RaySet) -> RaySet {
    // The shortest of three times, so that an interruption does not leave too few rays.
    let seconds = |some: &RaySet| {
        let timings = (0..3).map(|_| replay_seconds(Engine::Accel(list), some, Mode::Packet));
        timings.fold(f64::INFINITY, f64::min)
    };
    let mut most = 1;
    loop {
        let some = set.some(most);
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
enum Asked<'a> {
    List(&'a ListAccel<'a>),
    Projected(&'a ProjectedAccel<'a, 'a>),
    Tree(&'a dyn Accel),
}

/// Structure of objects and bounding volumes that takes part in the measurement.
struct Contestant<'a> {
    structure: &'static str,
    extent: String,
    asked: Asked<'a>,
    /// Number of objects with each kind of volume, where it is counted.
    counts: Option<ExtentCounts>,
}

impl<'a> Contestant<'a> {
    fn of_list(kind: ExtentKind, list: &'a ListAccel<'a>) -> Contestant<'a> {
        Contestant {
            structure: "list",
            extent: kind.to_string(),
            asked: Asked::List(list),
            counts: Some(list.counts()),
        }
    }

    fn of_tree(extent: &str, tree: &'a dyn Accel, sphere_count: Option<usize>) -> Contestant<'a> {
        Contestant {
            structure: "bsp",
            extent: extent.into(),
            asked: Asked::Tree(tree),
            counts: sphere_count.map(|count| ExtentCounts {
                tight_spheres: count as u64,
                ..ExtentCounts::default()
            }),
        }
    }

    fn accel(&self) -> &'a dyn Accel {
        match self.asked {
            Asked::List(list) => list,
            Asked::Projected(projected) => projected,
            Asked::Tree(tree) => tree,
        }
    }

    /// Returns the results of the rays of a set, and the work that they took.
    fn answers(&self, set: &RaySet) -> (Vec<RayPacket>, Option<Tally>) {
        let mut packets = set.packets().to_vec();
        let is_shadow = set.kind == RayKind::Shadow;
        let tally = match self.asked {
            Asked::List(list) if is_shadow => Some(list.count_occluded(&mut packets)),
            Asked::List(list) => Some(list.count_intersect(&mut packets)),
            Asked::Projected(projected) => Some(projected.count_intersect(&mut packets)),
            Asked::Tree(tree) => {
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
    set: &RaySet,
) -> Result<Vec<ExtentRow>, Failure> {
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
        let (answers, tally) = contestant.answers(set);
        let reference = reference.get_or_insert_with(|| answers.clone());
        let row = ExtentRow {
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
            differ: differing(reference, &answers),
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
        let answer = |p: &RayPacket, lane| (p.is_blocked(lane), p.hit(lane));
        (0..LANES)
            .filter(|&lane| answer(a, lane) != answer(b, lane))
            .count() as u64
    };
    pairs.map(differ).sum()
}
