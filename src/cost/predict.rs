//! Prediction of combined settings for a target: the measured effects of single levels predict all combinations.
//!
//! Squared errors are assumed to add: the amount that a level adds to the base's error or removes from it is
//! independent of the other knobs. The same amount cannot be removed twice, however: when two knobs each leave a
//! fraction of the error, at least a share (`MIN_REMAINING_SHARE`) of the product of the fractions remains. Times are assumed
//! to multiply. Neither assumption holds everywhere, so that predictions only order what to measure.

use super::{Configuration, Knob, Point};
use crate::render::MIN_ADAPTIVE_ERROR;

/// Largest factor by which predicted samples exceed the largest measured number.
const MAX_EXTRAPOLATION: u32 = 1 << 10;
/// Largest decay of the error per doubling of samples at which the fit is extrapolated. Above it, other knobs may be
/// the floor of the error: then only the variance between images falls, by half per doubling.
const MAX_DECAY: f64 = 0.9;
/// Smallest decay of the error per doubling of samples that is accepted; a faster one is chance.
const MIN_DECAY: f64 = 0.25;
/// Share of the product of the remaining error fractions that remains at least when knobs are combined.
const MIN_REMAINING_SHARE: f64 = 0.25;
/// Predicted adaptive errors, as halvings of the smallest measured one; the first is a larger error.
const ADAPTIVE_HALVINGS: [f64; 6] = [-0.5, 0.5, 1.0, 1.5, 2.0, 2.5];
/// Largest number of combinations that are considered: about ten megabytes.
const MAX_COMBINATIONS: usize = 1 << 17;

/// Settings with their predicted error and time.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// Configuration with several knobs changed.
    pub configuration: Configuration,
    /// Level number of each knob but the sampling ones; configurations that differ in sampling alone have equal arrays.
    pub turns: [u8; Knob::ALL.len()],
    /// Predicted mean squared error of displayed values; at least 0.
    pub mean_square: f64,
    /// Predicted time relative to the base's.
    pub time_ratio: f64,
}

/// Effect of a knob's level: the amount added to the squared error, and the factor on time.
#[derive(Clone, Copy, Debug)]
struct LevelEffect {
    configuration: Configuration,
    added: f64,
    /// Fraction of the base's squared error that the level leaves, at most 1.
    left: f64,
    times: f64,
}

/// Returns predictions for all combinations of levels, from a study's `points` (the base first) with their
/// `configurations`. Only configurations for which `is_offered` holds are returned.
pub fn forecasts(
    points: &[Point],
    configurations: &[Configuration],
    is_offered: impl Fn(&Configuration) -> bool,
) -> Vec<Prediction> {
    let Some((base, start)) = points.first().zip(configurations.first()) else {
        return Vec::new();
    };
    // Convert single levels to effects relative to the base
    let floor = base.mean_square();
    let turn = |place: usize| LevelEffect {
        configuration: configurations[place],
        added: points[place].mean_square() - floor,
        left: if floor > 0.0 {
            (points[place].mean_square() / floor).clamp(0.0, 1.0)
        } else {
            1.0
        },
        times: points[place].time_ratio.value,
    };
    let of_knob = |knob: Knob| (0..points.len()).filter(move |&place| points[place].knob == Some(knob));
    let stay = LevelEffect {
        configuration: *start,
        added: 0.0,
        left: 1.0,
        times: 1.0,
    };
    // Start from sampling levels, each with the product of the remaining error fractions
    let sampling_predictions = sampling_predictions(points, configurations).into_iter();
    let mut all: Vec<(Prediction, f64)> = sampling_predictions
        .map(|forecast| {
            let left = forecast.mean_square;
            (forecast, left)
        })
        .collect();
    // Combine with the levels of each other knob
    for (place, knob) in Knob::ALL.into_iter().enumerate() {
        if matches!(knob, Knob::Samples | Knob::DenoisedSamples | Knob::Adaptive) {
            continue;
        }
        let mut turns: Vec<LevelEffect> = of_knob(knob).map(turn).collect();
        turns.push(stay);
        // Levels that lose in both error and time cannot be part of a best combination.
        drop_dominated(&mut turns);
        if all.len() * turns.len() > MAX_COMBINATIONS {
            break;
        }
        all = all
            .iter()
            .flat_map(|(forecast, left)| {
                turns.iter().enumerate().map(move |(number, turn)| {
                    let forecast = Prediction {
                        configuration: with_knob(&forecast.configuration, knob, &turn.configuration),
                        turns: {
                            let mut turns = forecast.turns;
                            turns[place] = number as u8;
                            turns
                        },
                        mean_square: forecast.mean_square + turn.added,
                        time_ratio: forecast.time_ratio * turn.times,
                    };
                    (forecast, left * turn.left)
                })
            })
            .collect();
    }
    // Remove configurations that are not offered and bound errors from below
    all.retain(|(forecast, _)| is_offered(&forecast.configuration));
    let settled = |(forecast, left): (Prediction, f64)| Prediction {
        mean_square: forecast.mean_square.max(MIN_REMAINING_SHARE * left).max(0.0),
        ..forecast
    };
    all.into_iter().map(settled).collect()
}

/// Returns the base at measured, intermediate and larger numbers of samples, and at measured, intermediate and smaller
/// adaptive errors.
fn sampling_predictions(points: &[Point], configurations: &[Configuration]) -> Vec<Prediction> {
    let place = |place: usize| Prediction {
        configuration: configurations[place],
        turns: [0; Knob::ALL.len()],
        mean_square: points[place].mean_square(),
        time_ratio: points[place].time_ratio.value,
    };
    // Collect measured numbers of samples, the base's included
    let is_sampling = |&place: &usize| matches!(points[place].knob, None | Some(Knob::Samples));
    let mut all: Vec<Prediction> = (0..points.len()).filter(is_sampling).map(place).collect();
    all.sort_by_key(|forecast| forecast.configuration.settings.spp);
    // Extrapolate to more samples, by doubling
    if let [.., half, last] = &all[..] {
        let more = last.configuration.settings.spp / half.configuration.settings.spp.max(1);
        let fall = (last.mean_square / half.mean_square).powf(1.0 / f64::from(more.max(2)).log2());
        let last = last.clone();
        let variance = variance_of(points, &last);
        let mut times = 2;
        while times <= MAX_EXTRAPOLATION {
            let mut further = last.clone();
            further.configuration.settings.spp = last.configuration.settings.spp.saturating_mul(times);
            if fall < MAX_DECAY {
                further.mean_square *= fall.max(MIN_DECAY).powf(f64::from(times).log2());
            } else {
                further.mean_square -= variance * (1.0 - 1.0 / f64::from(times));
            }
            further.time_ratio *= f64::from(times);
            all.push(further);
            times *= 2;
        }
    }
    // Interpolate between doublings
    let between: Vec<Prediction> = all
        .windows(2)
        .filter_map(|pair| interpolate_samples(&pair[0], &pair[1]))
        .collect();
    all.extend(between);
    // Add adaptive sampling
    let adaptive = (0..points.len()).filter(|&place| points[place].knob == Some(Knob::Adaptive));
    all.extend(extrapolate_adaptive(adaptive.map(place).collect()));
    all
}

/// Returns the variance between images of the base with the samples of `forecast`, as part of its squared error.
fn variance_of(points: &[Point], forecast: &Prediction) -> f64 {
    let is_it = |point: &&Point| {
        matches!(point.knob, None | Some(Knob::Samples)) && point.time_ratio.value == forecast.time_ratio
    };
    let point = points.iter().find(is_it);
    point.map_or(0.0, |point| point.variance.clamp(0.0, forecast.mean_square))
}

/// Returns the prediction for one and a half times the samples of `few`; `None` unless `many` has twice its samples.
fn interpolate_samples(few: &Prediction, many: &Prediction) -> Option<Prediction> {
    let [from, to] = [few, many].map(|forecast| forecast.configuration.settings.spp);
    let mut between = few.clone();
    between.configuration.settings.spp = from + from / 2;
    // Interpolate in the logarithm of samples: log2(1.5) of the way from `few` to `many`.
    let part = 1.5f64.log2();
    between.mean_square *= (many.mean_square / few.mean_square).powf(part);
    between.time_ratio *= (many.time_ratio / few.time_ratio).powf(part);
    (to == 2 * from && from > 1 && between.mean_square.is_finite()).then_some(between)
}

/// Returns the measured adaptive levels with predictions for smaller and intermediate adaptive errors.
fn extrapolate_adaptive(mut adaptive: Vec<Prediction>) -> Vec<Prediction> {
    let error = |forecast: &Prediction| {
        let adaptive = forecast.configuration.settings.adaptive;
        adaptive.map_or(f64::INFINITY, |adaptive| adaptive.error)
    };
    adaptive.sort_by(|a, b| error(b).total_cmp(&error(a)));
    let [.., before, last] = &adaptive[..] else {
        return adaptive;
    };
    // Fit error and time per halving of the adaptive error
    let halvings = (error(before) / error(last)).log2();
    let fall = (last.mean_square / before.mean_square).powf(1.0 / halvings);
    let growth = (last.time_ratio / before.time_ratio).powf(1.0 / halvings);
    let (fall, growth) = (fall.clamp(MIN_DECAY, 1.0), growth.clamp(1.0, 1.0 / MIN_DECAY));
    // Extrapolate along the fit
    let reach = ADAPTIVE_HALVINGS.into_iter();
    let extrapolate_adaptive = reach.filter_map(|halvings| {
        let mut further = last.clone();
        let adaptive = further.configuration.settings.adaptive.as_mut()?;
        adaptive.error *= 0.5f64.powf(halvings);
        further.mean_square *= fall.powf(halvings);
        further.time_ratio *= growth.powf(halvings);
        let is_possible = adaptive.error >= MIN_ADAPTIVE_ERROR && further.mean_square.is_finite();
        is_possible.then_some(further)
    });
    let extrapolate_adaptive: Vec<Prediction> = extrapolate_adaptive.collect();
    adaptive.extend(extrapolate_adaptive);
    adaptive
}

/// Removes levels that another level of the knob beats in both error and time.
fn drop_dominated(turns: &mut Vec<LevelEffect>) {
    let beats = |one: &LevelEffect, other: &LevelEffect| {
        one.added <= other.added
            && one.times <= other.times
            && (one.added, one.times) != (other.added, other.times)
    };
    let all = turns.clone();
    turns.retain(|turn| !all.iter().any(|other| beats(other, turn)));
}

/// Returns `configuration` with one knob set as in `turned`; [`Knob::Adaptive`] includes the samples.
pub fn with_knob(configuration: &Configuration, knob: Knob, turned: &Configuration) -> Configuration {
    let mut result = *configuration;
    let (settings, from) = (&mut result.settings, &turned.settings);
    match knob {
        Knob::Samples => settings.spp = from.spp,
        Knob::DenoisedSamples => (settings.spp, result.denoises) = (from.spp, turned.denoises),
        Knob::Pattern => settings.pattern = from.pattern,
        Knob::Adaptive => (settings.spp, settings.adaptive) = (from.spp, from.adaptive),
        Knob::Depth => settings.depth = from.depth,
        Knob::Cutoff => settings.weight_cutoff = from.weight_cutoff,
        Knob::Wavelengths => settings.wavelengths = from.wavelengths,
        Knob::LightSamples => result.change.light_samples = turned.change.light_samples,
        Knob::RoughRays => result.change.rough_rays = turned.change.rough_rays,
        Knob::Bounces => result.change.bounces = turned.change.bounces,
        Knob::Photons => result.change.photons = turned.change.photons,
        Knob::MarchStep => result.change.step_factor = turned.change.step_factor,
        Knob::TextureFilter => settings.effects = from.effects,
        Knob::HitPath => {
            (result.path.backend, result.path.precision) = (turned.path.backend, turned.path.precision)
        }
        Knob::Instancing => result.path.instancing = turned.path.instancing,
        Knob::BuildQuality => result.path.build_quality = turned.path.build_quality,
        Knob::Compactness => result.path.compact = turned.path.compact,
        Knob::SpawnPoints => settings.spawn = from.spawn,
        Knob::HitRefinement => settings.hit_points = from.hit_points,
    }
    result
}

/// Returns the smallest predicted squared error, and the knob that would lower it most if its range went further: the
/// one whose last level lowered the error most.
pub(super) fn floor(points: &[Point], forecasts: &[Prediction]) -> Option<(f64, Knob)> {
    let least = forecasts
        .iter()
        .map(|forecast| forecast.mean_square)
        .min_by(f64::total_cmp)?;
    // Measure the gain of a knob's strictest level over the next
    let last_gain = |knob: Knob| {
        let errors = points
            .iter()
            .filter(|point| point.knob.is_none_or(|of| of == knob));
        let mut errors: Vec<f64> = errors.map(Point::mean_square).collect();
        errors.sort_by(f64::total_cmp);
        match errors[..] {
            [strictest, before, ..] => before - strictest,
            _ => 0.0,
        }
    };
    let graded = Knob::ALL.into_iter().filter(|knob| knob.is_graded());
    let knob = graded.max_by(|&a, &b| last_gain(a).total_cmp(&last_gain(b)))?;
    Some((least, knob))
}

#[cfg(test)]
mod tests {
    use super::super::target::Goal;
    use super::*;
    use crate::cost::{HitPath, Interval, SceneChange};
    use crate::render::{Pattern, RenderSettings};

    const DEPTHS: [(u32, f64, f64); 3] = [(1, 4e-4, 0.5), (4, 0.0, 1.0), (8, -1e-5, 1.3)];
    const SAMPLES: [u32; 5] = [1, 2, 4, 8, 16];

    /// Returns error and time in a model where squared errors add and times multiply.
    fn truth(configuration: &Configuration) -> (f64, f64) {
        let spp = f64::from(configuration.settings.spp);
        let depth = DEPTHS
            .iter()
            .find(|depth| depth.0 == configuration.settings.depth)
            .unwrap();
        let sobol = configuration.settings.pattern == Pattern::Sobol;
        let (less, longer) = if sobol { (-1e-5, 1.1) } else { (0.0, 1.0) };
        (1e-2 / spp + depth.1 + less + 2e-5, spp / 4.0 * depth.2 * longer)
    }

    fn point(knob: Option<Knob>, configuration: &Configuration) -> Point {
        let (square, ratio) = truth(configuration);
        Point::plain(knob, ratio, square.sqrt())
    }

    fn world() -> (Vec<Point>, Vec<Configuration>) {
        let base = Configuration {
            settings: RenderSettings {
                spp: 4,
                pattern: Pattern::R2,
                depth: 4,
                ..RenderSettings::default()
            },
            path: HitPath::BSP,
            change: SceneChange::default(),
            denoises: false,
        };
        let set = |change: &dyn Fn(&mut Configuration)| {
            let mut configuration = base;
            change(&mut configuration);
            configuration
        };
        let mut all = vec![(None, base)];
        for spp in SAMPLES.into_iter().filter(|&spp| spp != 4) {
            all.push((Some(Knob::Samples), set(&|c| c.settings.spp = spp)));
        }
        for (depth, _, _) in DEPTHS.into_iter().filter(|depth| depth.0 != 4) {
            all.push((Some(Knob::Depth), set(&|c| c.settings.depth = depth)));
        }
        all.push((Some(Knob::Pattern), set(&|c| c.settings.pattern = Pattern::Sobol)));
        let points = all
            .iter()
            .map(|(knob, configuration)| point(*knob, configuration));
        (
            points.collect(),
            all.iter().map(|(_, configuration)| *configuration).collect(),
        )
    }

    /// Returns predictions that reach the goal, the best first.
    fn candidates(forecasts: &[Prediction], goal: Goal) -> Vec<&Prediction> {
        let key = |forecast: &&Prediction| match goal {
            Goal::Error(_) => forecast.time_ratio,
            Goal::TimeRatio(_) => forecast.mean_square,
        };
        let reaches = |forecast: &&Prediction| match goal {
            Goal::Error(most) => forecast.mean_square <= most * most,
            Goal::TimeRatio(most) => forecast.time_ratio <= most,
        };
        let mut fitting: Vec<&Prediction> = forecasts.iter().filter(reaches).collect();
        fitting.sort_by(|a, b| key(a).total_cmp(&key(b)));
        fitting
    }

    #[test]
    fn best_combination_comes_first_if_errors_add_up() {
        let (points, configurations) = world();
        let forecasts = forecasts(&points, &configurations, |_| true);
        for most in [0.11, 0.06, 0.03, 0.02, 0.012, 0.005] {
            let chosen = candidates(&forecasts, Goal::Error(most));
            // The search space has every number of samples up to 1024 times the largest measured one.
            let mut best = f64::INFINITY;
            for power in 0..15 {
                for (depth, _, _) in DEPTHS {
                    for pattern in [Pattern::R2, Pattern::Sobol] {
                        let mut configuration = configurations[0];
                        configuration.settings.spp = 1 << power;
                        configuration.settings.depth = depth;
                        configuration.settings.pattern = pattern;
                        let (square, ratio) = truth(&configuration);
                        // Allow 1 % for the extrapolation beyond the measured samples.
                        if square <= 0.99 * most * most {
                            best = best.min(ratio);
                        }
                    }
                }
            }
            match chosen.first() {
                Some(first) => assert!(first.time_ratio <= 1.001 * best, "{most}: {first:?}, {best}"),
                None => assert!(best.is_infinite() || most < 0.01, "{most}: {best}"),
            }
        }
    }

    #[test]
    fn predicted_error_stays_positive_under_two_knobs() {
        let (mut points, configurations) = world();
        for (point, configuration) in points.iter_mut().zip(&configurations) {
            let is_turned =
                configuration.settings.pattern == Pattern::Sobol || configuration.settings.depth == 8;
            point.rmse = Interval::exact(if is_turned { 0.02 } else { 0.04 });
        }
        let forecasts = forecasts(&points, &configurations, |c| {
            c.settings.pattern == Pattern::Sobol && c.settings.depth == 8
        });
        // Each knob leaves a quarter of the squared error; plain addition would remove half of it beyond zero.
        assert!(!forecasts.is_empty());
        assert!(
            forecasts.iter().all(|forecast| forecast.mean_square > 0.0),
            "{forecasts:?}"
        );
    }

    #[test]
    fn time_target_orders_by_error_and_excludes_slower_settings() {
        let (points, configurations) = world();
        let forecasts = forecasts(&points, &configurations, |_| true);
        let chosen = candidates(&forecasts, Goal::TimeRatio(1.2));
        assert!(chosen.iter().all(|forecast| forecast.time_ratio <= 1.2));
        let first = chosen[0];
        assert!(
            chosen
                .iter()
                .all(|forecast| forecast.mean_square >= first.mean_square)
        );
        assert_eq!(
            (
                first.configuration.settings.spp,
                first.configuration.settings.pattern
            ),
            (8, Pattern::Sobol)
        );
    }

    #[test]
    fn unavailable_levels_are_not_predicted_and_floor_names_its_knob() {
        let (points, configurations) = world();
        let shallow = forecasts(&points, &configurations, |c| c.settings.depth == 1);
        assert!(!shallow.is_empty() && shallow.iter().all(|f| f.configuration.settings.depth == 1));
        let (least, knob) = floor(&points, &shallow).unwrap();
        assert!(least > 3e-4 && knob == Knob::Samples, "{least} {knob}");
        assert!(forecasts(&[], &[], |_| true).is_empty());
    }
}
