//! Measurement of a scene within a time budget: the reference, blocks of images, and their evaluation.

use std::borrow::Cow;

use super::accumulated_reference::AccumulatedReference;
use super::budget::widest;
use super::layout::Layout;
use super::measure::Measured;
use super::reference::{checked_configuration, checks, stricter, strictest_configuration};
use super::workspace::Workspace;
use super::{CostError, Experiment, HitPath, PatchReference, SceneChange, StudyResult};
use crate::measure::Observer;
use crate::render::Plan;
use crate::scene::Scene;

/// Runs all measurements in the current rayon pool.
///
/// # Errors
///
/// Returns an error where an acceleration structure cannot be built, and on cancellation.
pub fn run(experiment: &Experiment, observer: &Observer) -> Result<StudyResult, CostError> {
    // List all configurations that can be measured
    let plan = Plan::new(
        experiment.scene.get(),
        experiment.camera,
        &experiment.base.settings.effects,
    );
    let strict = strictest_configuration(&experiment.base, experiment.scene.get(), &plan);
    let widest = widest(experiment, &plan);
    let checked = checked_configuration(&strict);
    let stricter = stricter(&checked, &plan);
    let all = || {
        let measured = widest.iter().map(|candidate| candidate.configuration);
        measured
            .chain([strict, checked])
            .chain(stricter.iter().map(|(_, configuration)| *configuration))
    };
    // Build a scene for each change and an acceleration structure for each path
    let scenes: Vec<(SceneChange, Cow<Scene>)> = distinct(all().map(|configuration| configuration.change))
        .into_iter()
        .map(|change| (change, scene_of(experiment.scene.get(), &change)))
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
            let reference = AccumulatedReference::finished(count, unfinished.means.clone(), halves);
            let measured = stage.resumed(&layout, unfinished)?;
            (layout, reference, unfinished.head.left.clone(), measured)
        }
        None => {
            let layout = stage.plan_layout(&plan, &strict, stricter.len())?;
            let mut reference = stage.reference(&layout, &strict, 0)?;
            let layout = stage.refine(&plan, layout, &strict, &mut reference)?;
            let mut left = Vec::new();
            for (knob, configuration) in &stricter {
                left.push((*knob, stage.residual_bias(&layout, &checked, configuration)?));
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
