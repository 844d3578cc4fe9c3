//! Everything that is measured of a scene, within a budget: the reference, blocks of pictures, and what it comes to.

use std::borrow::Cow;
use std::time::{Duration, Instant};

use super::blocks::{Blocks, Protocol};
use super::layout::{Layout, widest};
use super::reference::{Halved, checks, stricter, strictest};
use super::stage::{Stage, View};
use super::unfinished::{Kept, checksum};
use super::{
    Configuration, Curve, Displayed, Halves, HitPath, Interval, Knob, Pictures, Place, Point, Reference,
    SceneChange, Study, Target, Unfinished, front, slope,
};
use crate::accel::{AccelError, EmbreeIdentity};
use crate::image::metrics::{Metrics, Tally, Viewing};
use crate::image::{LinearImage, ToneMap};
use crate::parallel;
use crate::render::{Plan, RenderSettings, Rendering};
use crate::scene::{Camera, Scene};

/// Blocks that are taken at least, at least where there is a target, and at most.
const MIN_BLOCKS: usize = 6;
const MIN_BLOCKS_FOR_A_TARGET: usize = 2;
const MAX_BLOCKS: usize = 40;
/// Part of the budget after which no block begins: what comes after is small.
pub(super) const MEASURED_PART: f64 = 0.94;
/// The same where settings are to be chosen.
const CHOOSING_PART: f64 = 0.35;

/// What was measured is kept as often as this, if blocks are not longer.
const KEEP_EVERY: Duration = Duration::from_secs(5);

/// What is to be measured.
pub struct Experiment<'a> {
    /// The scene; it has passed [`Scene::validate`].
    pub scene: &'a Scene,
    /// Who sees it.
    pub camera: &'a Camera,
    /// The base, with the size that pictures have in the end.
    pub base: Configuration,
    /// How pictures are displayed.
    pub tone: ToneMap,
    /// Width and height of the pictures that are measured; else as large as the budget affords. Nothing where there is a
    /// target: what is measured then is pieces of the whole picture.
    pub size: Option<[u32; 2]>,
    /// What settings are to be chosen for.
    pub target: Option<Target>,
    /// Seconds for everything since `start`.
    pub budget: f64,
    /// When it began.
    pub start: Instant,
    /// Of the current pool.
    pub threads: usize,
    /// Instruction set that Embree is held to.
    pub isa: Option<String>,
    /// One that was interrupted, and goes on; `start` is then as long ago as it had taken.
    pub unfinished: Option<Unfinished>,
}

/// Given what [`Unfinished::parse`] goes on with.
pub type Keep<'a> = &'a dyn Fn(&[u8]);

/// How a long experiment talks to whoever waits for it.
#[derive(Clone, Copy)]
pub struct Watcher<'a> {
    /// Told what is being done and the finished fraction of everything.
    pub progress: &'a dyn Fn(&str, f64),
    /// Set by anyone to stop.
    pub cancel: &'a std::sync::atomic::AtomicBool,
    /// Called now and then, so that an interruption loses little.
    pub keep: Option<Keep<'a>>,
}

/// Why there is no study.
#[derive(Debug, thiserror::Error)]
pub enum CostError {
    /// It was cancelled.
    #[error("interrupted")]
    Cancelled,
    /// What was interrupted was something else.
    #[error("is of another scene, of other settings, or of another version of whit")]
    Other,
    /// A structure could not be built.
    #[error(transparent)]
    Accel(#[from] AccelError),
}

/// A study and its pictures.
pub struct Findings {
    /// In numbers.
    pub study: Study,
    /// The mean of the halves of the reference.
    pub reference: LinearImage,
    /// The first picture of each point.
    pub pictures: Vec<LinearImage>,
    /// The configuration of each point.
    pub configurations: Vec<Configuration>,
    /// What was chosen for the target.
    pub chosen: Option<Configuration>,
    /// By what the error of the whole picture can be told, where there is a target.
    pub gauge: Option<Gauge>,
    /// Which Embree found the hits of the base, if one did.
    pub embree: Option<EmbreeIdentity>,
}

/// The parts of a picture that were measured, and the halves of their reference.
pub struct Gauge {
    view: View,
    settings: RenderSettings,
    tone: ToneMap,
    halves: Halves,
}

impl Gauge {
    /// Root of the mean squared error, as displayed, of a picture of the base's size, which none of those that were
    /// measured must be; `None` where it has another size.
    pub fn rmse(&self, picture: &LinearImage) -> Option<Interval> {
        let RenderSettings { width, height, .. } = self.settings;
        if [picture.width, picture.height] != [width, height] {
            return None;
        }
        let shown = match self.view {
            View::Whole(size) if size == [width, height] => Displayed::new(picture, self.tone),
            View::Whole(_) => return None,
            View::Pieces(mosaic) => self.view.in_its_blocks(Displayed::new(
                &mosaic.of_picture(&self.settings, picture),
                self.tone,
            )),
        };
        let mut pictures = Pictures::new(&self.halves);
        pictures.add(&self.halves, &shown);
        Some(pictures.estimate(&self.halves, 0).rmse())
    }
}

/// Measures everything, in the current rayon pool.
///
/// # Errors
///
/// Where a structure cannot be built, and where it is cancelled.
pub fn run(experiment: &Experiment, watcher: &Watcher) -> Result<Findings, CostError> {
    let plan = Plan::new(
        experiment.scene,
        experiment.camera,
        &experiment.base.settings.effects,
    );
    let strict = strictest(&experiment.base, &plan);
    let widest = widest(experiment, &plan);
    let stricter = stricter(&strict, &plan);
    let all = || {
        let measured = widest.iter().map(|contestant| contestant.configuration);
        measured
            .chain([strict])
            .chain(stricter.iter().map(|(_, configuration)| *configuration))
    };
    let scenes: Vec<(SceneChange, Cow<Scene>)> = distinct(all().map(|configuration| configuration.change))
        .into_iter()
        .map(|change| (change, scene_of(experiment.scene, &change)))
        .collect();
    let mut stage = Stage::new(experiment, watcher, &scenes);
    for configuration in all().chain([strict.through(HitPath::BSP)]) {
        stage.build(&configuration)?;
    }
    let (layout, reference, left, measured) = match &experiment.unfinished {
        Some(unfinished) => {
            let layout = Layout::resumed(experiment, &plan, unfinished).ok_or(CostError::Other)?;
            let [a, b] = &unfinished.means;
            let halves = stage.halves(layout.view, [a, b]);
            let count = unfinished.head.reference_count;
            let reference = Halved::new(count, unfinished.means.clone(), halves);
            let measured = stage.resumed(&layout, unfinished)?;
            (layout, reference, unfinished.head.left.clone(), measured)
        }
        None => {
            let layout = stage.lay_out(&plan, &strict, stricter.len())?;
            let mut reference = stage.reference(&layout, &strict)?;
            stage.refine(&layout, &strict, &mut reference)?;
            let mut left = Vec::new();
            for (knob, configuration) in &stricter {
                left.push((*knob, stage.left_by(&layout, &strict, configuration)?));
            }
            let measured = Measured::none(layout.contestants.len(), &reference);
            (layout, reference, left, measured)
        }
    };
    let measured = stage.measure((&layout, &reference, &left), measured)?;
    let mut findings = stage.findings(&layout, &strict, &reference, measured);
    let study = &mut findings.study;
    if let Some(target) = experiment.target {
        let known = (&study.points[..], &findings.configurations[..]);
        let (choice, configuration) = stage.choose(target, (&layout, &reference), known)?;
        study.choice = Some(choice);
        findings.chosen = Some(configuration);
        findings.gauge = Some(Gauge {
            view: layout.view,
            settings: experiment.base.settings,
            tone: experiment.tone,
            halves: reference.halves.clone(),
        });
        study.timing.spent = stage.spent();
    }
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

/// What the blocks gave.
struct Measured {
    blocks: Blocks,
    errors: Vec<Pictures>,
    /// The first picture of each contestant.
    first: Vec<Option<Rendering>>,
}

impl Measured {
    /// Nothing yet.
    fn none(count: usize, reference: &Halved) -> Measured {
        Measured {
            blocks: Blocks::new(count),
            errors: vec![Pictures::new(&reference.halves); count],
            first: (0..count).map(|_| None).collect(),
        }
    }
}

impl Stage<'_, '_> {
    /// Blocks until the time is up, after those that were measured; all of it is kept now and then.
    fn measure(
        &self,
        (layout, reference, left): (&Layout, &Halved, &[(Knob, f64)]),
        mut measured: Measured,
    ) -> Result<Measured, CostError> {
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
        while protocol.goes_on(blocks.count(), longest) {
            let seconds = blocks.add(protocol.seed, |contestant, block| {
                self.say("measure");
                let configuration = &layout.contestants[contestant].configuration;
                let (rendering, seconds) = self.picture(configuration, layout.view, seed_of(block))?;
                errors[contestant].add(&reference.halves, &self.displayed(&rendering.image, layout.view));
                first[contestant].get_or_insert(rendering);
                Ok::<f64, CostError>(seconds)
            })?;
            longest = longest.max(seconds);
            if let Some(keep) = self.watcher.keep
                && kept.is_none_or(|kept| kept.elapsed() >= KEEP_EVERY)
            {
                let base = first[0].as_ref();
                let all = Kept {
                    experiment: self.experiment,
                    layout,
                    reference,
                    left,
                    blocks,
                    pictures: errors,
                    checksum: base.map_or(0, |base| checksum(&base.image)),
                    spent: self.spent(),
                };
                keep(&all.bytes());
                kept = Some(Instant::now());
            }
        }
        Ok(measured)
    }

    /// What was measured before an interruption; first pictures are made again, and tell whether they are the same.
    fn resumed(&self, layout: &Layout, unfinished: &Unfinished) -> Result<Measured, CostError> {
        let mut first = Vec::new();
        for contestant in &layout.contestants {
            self.say("resume");
            let (rendering, _) = self.picture(&contestant.configuration, layout.view, seed_of(0))?;
            if first.is_empty() && checksum(&rendering.image) != unfinished.head.checksum {
                return Err(CostError::Other);
            }
            first.push(Some(rendering));
        }
        Ok(Measured {
            blocks: unfinished.head.blocks.clone(),
            errors: unfinished.pictures.clone(),
            first,
        })
    }

    /// What it all comes to, but for the checks of the reference.
    fn findings(
        &self,
        layout: &Layout,
        strict: &Configuration,
        reference: &Halved,
        measured: Measured,
    ) -> Findings {
        self.say("analyse");
        let mean = reference.mean();
        let pictures: Vec<Rendering> = measured.first.into_iter().flatten().collect();
        let viewing = Viewing {
            tone: self.experiment.tone,
            ..Viewing::default()
        };
        let metrics: Vec<Metrics> = parallel::map(pictures.len(), &|place| {
            let mut tally = Tally::default();
            // Sizes are equal.
            let _ = tally.add(&mean, &pictures[place].image, &viewing);
            tally.metrics()
        });
        let mut points: Vec<Point> = layout
            .contestants
            .iter()
            .enumerate()
            .map(|(place, contestant)| {
                let error = measured.errors[place].estimate(&reference.halves, place as u64);
                Point {
                    knob: contestant.knob,
                    level: contestant.level.clone(),
                    settings: contestant.configuration.words(),
                    build_seconds: self.built(&contestant.configuration).seconds,
                    build_bytes: self.built(&contestant.configuration).accel.report().bytes,
                    ready_seconds: pictures[place].ready_seconds,
                    seconds: measured.blocks.seconds(place),
                    time_ratio: measured.blocks.ratio(place, 0),
                    rmse: error.rmse(),
                    bias_squared: error.bias_squared,
                    variance: error.variance(),
                    rel_mse: metrics[place].rel_mse,
                    flip: metrics[place].flip,
                    max: metrics[place].displayed.max,
                    changed_share: metrics[place].changed_share,
                    non_finite: pictures[place].image.non_finite_count() as u64,
                    rays: pictures[place].ledger.total().rays,
                    instructions: None,
                    geometry: None,
                    on_front: false,
                }
            })
            .collect();
        self.count_geometric_errors(layout, &mut points);
        let places: Vec<Place> = points
            .iter()
            .map(|point| Place {
                time: point.time_ratio,
                error: point.rmse,
            })
            .collect();
        for (point, on_front) in points.iter_mut().zip(front(&places)) {
            point.on_front = on_front;
        }
        let study = Study {
            size: self.size_of(layout.view),
            pieces_of: match layout.view {
                View::Whole(_) => None,
                View::Pieces(_) => Some(self.whole_size()),
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
        Findings {
            study,
            reference: mean,
            chosen: None,
            gauge: None,
            embree: self
                .built(&layout.contestants[0].configuration)
                .accel
                .report()
                .embree,
            pictures: pictures.into_iter().map(|rendering| rendering.image).collect(),
            configurations: layout
                .contestants
                .iter()
                .map(|contestant| contestant.configuration)
                .collect(),
        }
    }
}

/// Of the pictures of a block.
fn seed_of(block: usize) -> u32 {
    block as u32 + 1
}

/// Every knob whose places lie in an order, the base among them, by time.
fn curves(points: &[Point]) -> Vec<Curve> {
    let graded = Knob::ALL.into_iter().filter(|knob| knob.is_graded());
    graded
        .filter_map(|knob| {
            // Samples that differ from pixel to pixel are no further step of equally many.
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

/// Seconds and errors of those of `places`, which are in the order of time, up to the first that is as close as any: what
/// comes after it takes longer for nothing.
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
    fn a_slope_ends_where_the_error_does_not_fall_any_more() {
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
