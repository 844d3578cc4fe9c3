//! `whit verify SCENE`: the scene's own rays through two backends, and what is wrong with its meshes.

use std::collections::BTreeMap;
use std::path::Path;

use crate::accel::{self, Accel, AccelOptions, Backend};
use crate::image::check_writable;
use crate::render;
use crate::report::own::OwnReport;
use crate::scene::{EffectSet, Geometry, Scene};
use crate::scene_file::{Output, SceneFile};
use crate::verify::{Hygiene, Question, compare_all};

use super::args::VerifyArgs;
use super::failure::Failure;
use super::interrupt;
use super::job::{Tracing, choose_camera, settings};
use super::output;
use super::progress::{Progress, Verbosity};
use super::scene;

/// Checks each scene that the arguments name.
pub(super) fn run(args: &VerifyArgs) -> Result<(), Failure> {
    if let Some(path) = &args.json {
        check_writable(path)?;
    }
    let tracing = Tracing::of_threads(args.threads);
    let pool = tracing.pool()?;
    let progress = Progress::new(Verbosity::Normal);
    let mut reports = Vec::new();
    for path in &args.scenes {
        interrupt::check()?;
        let name = path.display().to_string();
        progress.phase(&name, "load");
        let file = pool.install(|| scene::load(path, EffectSet::NONE))?;
        progress.phase(&name, "compare");
        let options = AccelOptions {
            threads: tracing.threads,
            isa: args.isa.clone(),
            ..AccelOptions::default()
        };
        let report = pool.install(|| check(path, &file, args, &options))?;
        progress.suspend(|| output::print(&report.text()))?;
        reports.push(report);
    }
    progress.clear();
    if let Some(path) = &args.json {
        interrupt::finish_first(|| output::write_json(path, &reports))?;
    }
    match reports.iter().filter(|report| report.is_wrong()).count() {
        0 => Ok(()),
        wrong => Err(Failure::Work(format!(
            "backends differ by more than rounding in {wrong} of {} scenes",
            reports.len()
        ))),
    }
}

fn check(
    path: &Path,
    SceneFile { scene, output, .. }: &SceneFile,
    args: &VerifyArgs,
    options: &AccelOptions,
) -> Result<OwnReport, Failure> {
    let picture = Output {
        size: args.size.map(|size| [size.width, size.height]),
        ..Output::default()
    };
    let settings = render::RenderSettings {
        spp: 1,
        adaptive: None,
        ..settings(&picture.or(output))?
    };
    let camera = choose_camera(scene, path, None)?;
    let backends = [Backend::default(), Backend::Bsp];
    let second = accel::build(scene, backends[1], options)?;
    let first = match backends[0] {
        Backend::Bsp => accel::build(scene, Backend::Brute, options)?,
        backend => accel::build(scene, backend, options)?,
    };
    let accels: [&dyn Accel; 2] = [&*first, &*second];
    let recorded = render::record(scene, camera, accels[0], &settings);
    interrupt::check()?;
    let kinds = [
        ("camera", recorded.camera, Question::Nearest),
        ("shadow", recorded.shadow, Question::Blocked),
        ("reflection", recorded.reflection, Question::Nearest),
    ];
    let mut rays = BTreeMap::new();
    for (kind, packets, question) in kinds {
        interrupt::check()?;
        rays.insert(kind, compare_all(scene, accels, &packets, question));
    }
    Ok(OwnReport {
        scene: path.to_owned(),
        backends: accels.map(|accel| accel.report().summary),
        embree: first.report().embree,
        rays,
        meshes: hygiene(scene),
        warnings: scene.warnings.clone(),
    })
}

/// Of all meshes together, each once.
fn hygiene(scene: &Scene) -> Hygiene {
    let meshes = scene.geometries.iter().filter_map(|geometry| match geometry {
        Geometry::Mesh(mesh) => Some(Hygiene::of(mesh)),
        Geometry::Shape(_) => None,
    });
    meshes.fold(Hygiene::default(), Hygiene::with)
}
