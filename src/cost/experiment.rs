//! Measurement of a scene within a time budget: the reference, blocks of images, and their evaluation.

use std::borrow::Cow;
use std::time::{Duration, Instant};

use super::blocks::{Blocks, Protocol};
use super::budget::{Layout, widest};
use super::checkpoint::{CheckpointData, checksum};
use super::reference::{AccumulatedReference, checks, stricter, strictest_configuration};
use super::workspace::{View, Workspace};
use super::{
    Configuration, Curve, DisplayImage, HitPath, ImageSums, Interval, Knob, ParetoPoint, Point, Reference,
    SceneChange, SplitReference, Study, StudyCheckpoint, Target, front, slope,
};
use crate::accel::{AccelError, EmbreeIdentity};
use crate::image::metrics::{Metrics, Tally, Viewing};
use crate::image::{LinearImage, ToneMap};
use crate::parallel;
use crate::render::{Plan, RenderSettings, Rendering};
use crate::scene::{Camera, Scene};

/// Least number of blocks, without and with a target, and the largest number.
const MIN_BLOCKS: usize = 6;
const MIN_BLOCKS_FOR_A_TARGET: usize = 2;
const MAX_BLOCKS: usize = 40;
/// Fraction of the budget after which no block begins; the remaining work is small.
pub(super) const MEASURED_PART: f64 = 0.94;
/// Fraction of the budget for measurement blocks where settings are to be chosen afterwards.
const CHOOSING_PART: f64 = 0.35;

/// Interval between checkpoints, unless blocks take longer.
const KEEP_EVERY: Duration = Duration::from_secs(5);

/// Input of a study: scene, base configuration and limits.
pub struct Experiment<'a> {
    /// Scene to render; it has passed [`Scene::validate`].
    pub scene: &'a Scene,
    /// Camera that the images are rendered with.
    pub camera: &'a Camera,
    /// Base configuration, with the size of the final image.
    pub base: Configuration,
    /// Tone mapping of the displayed values.
    pub tone: ToneMap,
    /// Width and height of the measured images; `None` for the largest that the budget allows. `None` with a target,
    /// where patches of the complete image are measured.
    pub size: Option<[u32; 2]>,
    /// Target that settings are chosen for, if any.
    pub target: Option<Target>,
    /// Seconds for the whole study, counted from `start`.
    pub budget: f64,
    /// Time at which the study began.
    pub start: Instant,
    /// Number of threads of the current pool.
    pub threads: usize,
    /// Instruction set that Embree is restricted to.
    pub isa: Option<String>,
    /// Checkpoint of an interrupted study that is resumed; `start` is then earlier by the time that it had taken.
    pub unfinished: Option<StudyCheckpoint>,
}

/// Function that stores a checkpoint, in the bytes that [`StudyCheckpoint::parse`] reads.
pub type Keep<'a> = &'a dyn Fn(&[u8]);

/// Callbacks of a long experiment: progress, cancellation and checkpoints.
#[derive(Clone, Copy)]
pub struct Observer<'a> {
    /// Progress callback with the current step and the finished fraction of the whole.
    pub progress: &'a dyn Fn(&str, f64),
    /// Flag that stops the experiment when set.
    pub cancel: &'a std::sync::atomic::AtomicBool,
    /// Checkpoint callback, called at intervals so that an interruption loses little.
    pub keep: Option<Keep<'a>>,
}

/// Reasons for which a study ends without a result.
#[derive(Debug, thiserror::Error)]
pub enum CostError {
    /// Cancellation by the watcher's flag.
    #[error("interrupted")]
    Cancelled,
    /// Checkpoint that belongs to another scene, other settings or another version.
    #[error(
        "belongs to another scene, to other settings or to another version of whit: repeat the command of the \
         interrupted study, or leave out `--resume`"
    )]
    Other,
    /// Failure to build an acceleration structure.
    #[error(transparent)]
    Accel(#[from] AccelError),
}

/// Result of an experiment: the study with its images.
pub struct StudyResult {
    /// Numerical results of the study.
    pub study: Study,
    /// Mean image of the reference's halves.
    pub reference: LinearImage,
    /// First image of each point, in the order of the study's points.
    pub images: Vec<LinearImage>,
    /// Configuration of each point, in the order of the study's points.
    pub configurations: Vec<Configuration>,
    /// Configuration chosen for the target; `None` without a target.
    pub chosen: Option<Configuration>,
    /// Data to compute the complete image's error, if there is a target.
    pub patch_reference: Option<PatchReference>,
    /// Identity of the Embree library that the base used, if it used Embree.
    pub embree: Option<EmbreeIdentity>,
}

/// Measured patches of an image with the two halves of their reference.
pub struct PatchReference {
    view: View,
    settings: RenderSettings,
    tone: ToneMap,
    halves: SplitReference,
}

impl PatchReference {
    /// Returns the root mean squared error, in displayed values, of an image of the base's size, which must not be one
    /// of the measured images; `None` where the size differs.
    pub fn rmse(&self, image: &LinearImage) -> Option<Interval> {
        let RenderSettings { width, height, .. } = self.settings;
        if [image.width, image.height] != [width, height] {
            return None;
        }
        // Extract the patches that the reference covers
        let shown = match self.view {
            View::Whole(size) if size == [width, height] => DisplayImage::new(image, self.tone),
            View::Whole(_) => return None,
            View::Patches(mosaic) => self.view.with_blocks(DisplayImage::new(
                &mosaic.of_picture(&self.settings, image),
                self.tone,
            )),
        };
        // Estimate the error against both halves
        let mut sums = ImageSums::new(&self.halves);
        sums.add(&self.halves, &shown);
        Some(sums.estimate(&self.halves, 0).rmse())
    }
}

/// Runs all measurements in the current rayon pool.
///
/// # Errors
///
/// Returns an error where an acceleration structure cannot be built, and on cancellation.
pub fn run(experiment: &Experiment, observer: &Observer) -> Result<StudyResult, CostError> {
    // List all configurations that can be measured
    let plan = Plan::new(
        experiment.scene,
        experiment.camera,
        &experiment.base.settings.effects,
    );
    let strict = strictest_configuration(&experiment.base, &plan);
    let widest = widest(experiment, &plan);
    let stricter = stricter(&strict, &plan);
    let all = || {
        let measured = widest.iter().map(|candidate| candidate.configuration);
        measured
            .chain([strict])
            .chain(stricter.iter().map(|(_, configuration)| *configuration))
    };
    // Build a scene for each change and an acceleration structure for each path
    let scenes: Vec<(SceneChange, Cow<Scene>)> = distinct(all().map(|configuration| configuration.change))
        .into_iter()
        .map(|change| (change, scene_of(experiment.scene, &change)))
        .collect();
    let mut stage = Workspace::new(experiment, observer, &scenes);
    for configuration in all().chain([strict.with_path(HitPath::BSP)]) {
        stage.build(&configuration)?;
    }
    // Restore the checkpoint, or lay out the study and render the reference
    let (layout, reference, left, measured) = match &experiment.unfinished {
        Some(unfinished) => {
            let layout = Layout::resumed(experiment, &plan, unfinished).ok_or(CostError::Other)?;
            let [a, b] = &unfinished.means;
            let halves = stage.halves(layout.view, [a, b]);
            let count = unfinished.head.reference_count;
            let reference = AccumulatedReference::new(count, unfinished.means.clone(), halves);
            let measured = stage.resumed(&layout, unfinished)?;
            (layout, reference, unfinished.head.left.clone(), measured)
        }
        None => {
            let layout = stage.plan_layout(&plan, &strict, stricter.len())?;
            let mut reference = stage.reference(&layout, &strict)?;
            stage.refine(&layout, &strict, &mut reference)?;
            let mut left = Vec::new();
            for (knob, configuration) in &stricter {
                left.push((*knob, stage.residual_bias(&layout, &strict, configuration)?));
            }
            let measured = Measured::none(layout.candidates.len(), &reference);
            (layout, reference, left, measured)
        }
    };
    // Measure all configurations in blocks
    let measured = stage.measure((&layout, &reference, &left), measured)?;
    let mut findings = stage.findings(&layout, &strict, &reference, measured);
    let study = &mut findings.study;
    // Choose settings for the target
    if let Some(target) = experiment.target {
        let known = (&study.points[..], &findings.configurations[..]);
        let (choice, configuration) = stage.choose(target, (&layout, &reference), known)?;
        study.choice = Some(choice);
        findings.chosen = Some(configuration);
        findings.patch_reference = Some(PatchReference {
            view: layout.view,
            settings: experiment.base.settings,
            tone: experiment.tone,
            halves: reference.halves.clone(),
        });
        study.timing.spent = stage.spent();
    }
    // Check the reference
    study.reference.checks = checks(&strict, &reference, study, &left);
    Ok(findings)
}

fn scene_of<'s>(scene: &'s Scene, change: &SceneChange) -> Cow<'s, Scene> {
    if *change == SceneChange::default() {
        Cow::Borrowed(scene)
    } else {
        let mut changed = scene.clone();
        change.apply(&mut changed);
        Cow::Owned(changed)
    }
}

fn distinct(changes: impl Iterator<Item = SceneChange>) -> Vec<SceneChange> {
    let mut all: Vec<SceneChange> = Vec::new();
    for change in changes {
        if !all.contains(&change) {
            all.push(change);
        }
    }
    all
}

/// Results of the measurement blocks so far.
struct Measured {
    blocks: Blocks,
    errors: Vec<ImageSums>,
    /// First image of each candidate.
    first: Vec<Option<Rendering>>,
}

impl Measured {
    /// Returns an empty result for `count` candidates.
    fn none(count: usize, reference: &AccumulatedReference) -> Measured {
        Measured {
            blocks: Blocks::new(count),
            errors: vec![ImageSums::new(&reference.halves); count],
            first: (0..count).map(|_| None).collect(),
        }
    }
}

impl Workspace<'_, '_> {
    /// Measures blocks until the time is up, after those in `measured`, and stores checkpoints at intervals.
    fn measure(
        &self,
        (layout, reference, left): (&Layout, &AccumulatedReference, &[(Knob, f64)]),
        mut measured: Measured,
    ) -> Result<Measured, CostError> {
        // Derive the number of blocks and the deadline
        let (least, most, until) = match self.experiment.target {
            Some(_) => (MIN_BLOCKS_FOR_A_TARGET, MIN_BLOCKS, CHOOSING_PART),
            None => (MIN_BLOCKS, MAX_BLOCKS, MEASURED_PART),
        };
        let until = until * self.experiment.budget;
        let protocol = Protocol {
            least,
            most,
            deadline: self.experiment.start + Duration::from_secs_f64(until),
            seed: 1,
        };
        let Measured {
            blocks,
            errors,
            first,
        } = &mut measured;
        let (mut longest, mut kept) = (0.0f64, None::<Instant>);
        // Measure one block: an image of every candidate
        while protocol.may_continue(blocks.count(), longest) {
            let seconds = blocks.add(protocol.seed, |candidate, block| {
                self.report_step("measure");
                let configuration = &layout.candidates[candidate].configuration;
                let (rendering, seconds) = self.render_image(configuration, layout.view, seed_of(block))?;
                errors[candidate].add(&reference.halves, &self.displayed(&rendering.image, layout.view));
                first[candidate].get_or_insert(rendering);
                Ok::<f64, CostError>(seconds)
            })?;
            longest = longest.max(seconds);
            // Store a checkpoint
            if let Some(keep) = self.observer.keep
                && kept.is_none_or(|kept| kept.elapsed() >= KEEP_EVERY)
            {
                let base = first[0].as_ref();
                let all = CheckpointData {
                    experiment: self.experiment,
                    layout,
                    reference,
                    left,
                    blocks,
                    sums: errors,
                    checksum: base.map_or(0, |base| checksum(&base.image)),
                    spent: self.spent(),
                };
                keep(&all.bytes());
                kept = Some(Instant::now());
            }
        }
        Ok(measured)
    }

    /// Restores the measurements of an interrupted study. First images are rendered again; the base's checksum verifies
    /// that the scene is unchanged.
    fn resumed(&self, layout: &Layout, unfinished: &StudyCheckpoint) -> Result<Measured, CostError> {
        let mut first = Vec::new();
        for candidate in &layout.candidates {
            self.report_step("resume");
            let (rendering, _) = self.render_image(&candidate.configuration, layout.view, seed_of(0))?;
            if first.is_empty() && checksum(&rendering.image) != unfinished.head.checksum {
                return Err(CostError::Other);
            }
            first.push(Some(rendering));
        }
        Ok(Measured {
            blocks: unfinished.head.blocks.clone(),
            errors: unfinished.sums.clone(),
            first,
        })
    }

    /// Evaluates all measurements, except for the checks of the reference.
    fn findings(
        &self,
        layout: &Layout,
        strict: &Configuration,
        reference: &AccumulatedReference,
        measured: Measured,
    ) -> StudyResult {
        self.report_step("analyse");
        // Compute image metrics of each first image against the reference
        let mean = reference.mean();
        let renderings: Vec<Rendering> = measured.first.into_iter().flatten().collect();
        let viewing = Viewing {
            tone: self.experiment.tone,
            ..Viewing::default()
        };
        let metrics: Vec<Metrics> = parallel::map(renderings.len(), &|place| {
            let mut tally = Tally::default();
            // The sizes are equal, so that no error can occur.
            let _ = tally.add(&mean, &renderings[place].image, &viewing);
            tally.metrics()
        });
        // Assemble the points with times and errors
        let mut points: Vec<Point> = layout
            .candidates
            .iter()
            .enumerate()
            .map(|(place, candidate)| {
                let error = measured.errors[place].estimate(&reference.halves, place as u64);
                Point {
                    knob: candidate.knob,
                    level: candidate.level.clone(),
                    settings: candidate.configuration.words(),
                    build_seconds: self.built(&candidate.configuration).seconds,
                    build_bytes: self.built(&candidate.configuration).accel.report().bytes,
                    ready_seconds: renderings[place].ready_seconds,
                    seconds: measured.blocks.seconds(place),
                    time_ratio: measured.blocks.ratio(place, 0),
                    rmse: error.rmse(),
                    bias_squared: error.bias_squared,
                    variance: error.variance(),
                    rel_mse: metrics[place].rel_mse,
                    flip: metrics[place].flip,
                    max: metrics[place].displayed.max,
                    changed_share: metrics[place].changed_share,
                    non_finite: renderings[place].image.non_finite_count() as u64,
                    rays: renderings[place].ledger.total().rays,
                    instructions: None,
                    geometry: None,
                    on_front: false,
                }
            })
            .collect();
        // Count wrong hits and mark the Pareto front
        self.count_geometric_errors(layout, &mut points);
        let places: Vec<ParetoPoint> = points
            .iter()
            .map(|point| ParetoPoint {
                time: point.time_ratio,
                error: point.rmse,
            })
            .collect();
        for (point, on_front) in points.iter_mut().zip(front(&places)) {
            point.on_front = on_front;
        }
        // Assemble the study
        let study = Study {
            size: self.size_of(layout.view),
            pieces_of: match layout.view {
                View::Whole(_) => None,
                View::Patches(_) => Some(self.whole_size()),
            },
            threads: self.experiment.threads,
            reference: Reference {
                spp: layout.reference_spp * reference.count,
                paths: [strict.path.name(), HitPath::BSP.name()],
                noise: reference.halves.noise_squared().sqrt(),
                checks: Vec::new(),
            },
            timing: measured.blocks.timing(self.spent(), self.experiment.budget),
            curves: curves(&points),
            choice: None,
            points,
        };
        StudyResult {
            study,
            reference: mean,
            chosen: None,
            patch_reference: None,
            embree: self
                .built(&layout.candidates[0].configuration)
                .accel
                .report()
                .embree,
            images: renderings.into_iter().map(|rendering| rendering.image).collect(),
            configurations: layout
                .candidates
                .iter()
                .map(|candidate| candidate.configuration)
                .collect(),
        }
    }
}

/// Returns the random seed for the images of a block.
fn seed_of(block: usize) -> u32 {
    block as u32 + 1
}

/// Returns a curve for every graded knob, the base included, in order of time.
fn curves(points: &[Point]) -> Vec<Curve> {
    let graded = Knob::ALL.into_iter().filter(|knob| knob.is_graded());
    graded
        .filter_map(|knob| {
            // Adaptive sampling distributes samples unevenly, so that the uniform base is not one of its levels.
            let from_base = knob != Knob::Adaptive;
            let of_knob = |&place: &usize| place == 0 && from_base || points[place].knob == Some(knob);
            let mut places: Vec<usize> = (0..points.len()).filter(of_knob).collect();
            if places.len() < 2 {
                return None;
            }
            places.sort_by(|&a, &b| points[a].seconds.value.total_cmp(&points[b].seconds.value));
            Some(Curve {
                knob,
                slope: slope(&falling(points, &places)),
                points: places,
            })
        })
        .collect()
}

/// Returns times and errors of `places`, which are in order of time, up to the first with the smallest error within its
/// interval: later levels take longer without less error.
fn falling(points: &[Point], places: &[usize]) -> Vec<(f64, f64)> {
    let least = places
        .iter()
        .map(|&place| points[place].rmse.high)
        .fold(f64::INFINITY, f64::min);
    let first = places.iter().position(|&place| points[place].rmse.low <= least);
    let fall = &places[..first.map_or(places.len(), |first| first + 1)];
    fall.iter()
        .map(|&place| (points[place].time_ratio.value, points[place].rmse.value))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(knob: Option<Knob>, seconds: f64, rmse: f64) -> Point {
        Point {
            rmse: Interval {
                value: rmse,
                low: 0.9 * rmse,
                high: 1.1 * rmse,
            },
            ..Point::plain(knob, seconds, rmse)
        }
    }

    #[test]
    fn slope_uses_points_only_while_the_error_falls() {
        let depth = Some(Knob::Depth);
        let points = [
            point(None, 8.0, 0.125),
            point(depth, 1.0, 1.0),
            point(depth, 2.0, 0.5),
            point(depth, 4.0, 0.25),
            point(depth, 16.0, 0.125),
            point(depth, 32.0, 0.126),
            point(Some(Knob::Pattern), 32.0, 0.01),
        ];
        let curves = curves(&points);
        let names: Vec<Knob> = curves.iter().map(|curve| curve.knob).collect();
        assert_eq!(names, [Knob::Depth], "patterns are in no order");
        assert_eq!(curves[0].points, [1, 2, 3, 0, 4, 5]);
        assert!((curves[0].slope.unwrap().value + 1.0).abs() < 1e-12);
    }
}
