//! Flag `whit info --prices`: measures what the effects of a scene cost.

use whit::batch::request::{TracingOptions, choose_camera, render_settings};
use whit::bench::{AblationOptions, AblationStudy, MeasuredScene, ablation_study};
use whit::image::ToneMap;
use whit::image::metrics::Viewing;
use whit::parallel;
use whit::render::RenderSettings;
use whit::scene_file::{Output, SceneFile};

use super::args::InfoArgs;
use super::failure::Failure;
use super::progress::{Progress, Verbosity};

/// Returns the image settings of the arguments, completed by those of the scene.
fn image_settings(args: &InfoArgs, output: &Output) -> Output {
    let requested = Output {
        size: args.ablation.size.map(|size| [size.width, size.height]),
        spp: args.ablation.spp,
        depth: args.ablation.depth,
        ..Output::default()
    };
    requested.or(output)
}

/// Returns the render settings for the arguments and the image settings of the scene.
pub(super) fn settings_of(args: &InfoArgs, output: &Output) -> Result<RenderSettings, Failure> {
    Ok(RenderSettings {
        effects: args.effects.unwrap_or_default(),
        ..render_settings(&image_settings(args, output))?
    })
}

/// Measures the costs of a scene's effects on the requested number of threads.
pub(super) fn run(args: &InfoArgs, loaded: &SceneFile) -> Result<AblationStudy, Failure> {
    let name = args.scene.display().to_string();
    let tracing = TracingOptions::of_threads(args.ablation.threads);
    let tone = ToneMap {
        exposure_ev: image_settings(args, &loaded.output).exposure.unwrap_or(0.0),
    };
    let measured = MeasuredScene {
        name: &name,
        scene: loaded.scene.validate()?,
        camera: choose_camera(&loaded.scene, &args.scene, None)?,
        settings: settings_of(args, &loaded.output)?,
    };
    let options = AblationOptions {
        backend: args.ablation.backend.unwrap_or_default(),
        threads: tracing.threads,
        viewing: Viewing {
            tone,
            ..Viewing::default()
        },
        budget: args.ablation.budget,
    };
    let progress = Progress::new(Verbosity::Normal);
    progress.phase(&name, "build");
    let study = parallel::install(&tracing.pool()?, || {
        progress.observe(|observer| ablation_study(&measured, &options, observer))
    });
    progress.clear();
    Ok(study?)
}
