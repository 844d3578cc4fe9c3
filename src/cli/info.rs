//! Command `whit info`: prints a summary of a scene.

use whit::batch::request::load_scene;
use whit::gltf::LoadOptions;
use whit::report::info::SceneInfo;
use whit::scene::CameraRequest;

use super::args::InfoArgs;
use super::failure::Failure;
use super::forecast::{self, ForecastResult};
use super::{ablation, output};

/// Prints the contents of the scene, with costs and a forecast if requested.
pub(super) fn run(args: &InfoArgs) -> Result<(), Failure> {
    // Load the scene at the requested time
    let options = LoadOptions {
        without: args.effects.unwrap_or_default().removed,
        camera: CameraRequest {
            image_size: args.ablation.size.map(|size| [size.width, size.height]),
            ..CameraRequest::default()
        },
        ..args.gltf.load_options()
    };
    let loaded = load_scene(&args.scene, &[], &options)?;
    // Measure the costs of effects, or forecast their shares of the time
    let prices = if args.ablation.prices {
        Some(ablation::run(args, &loaded)?)
    } else {
        None
    };
    let (forecast, no_forecast) = match forecast::run(args, &loaded)? {
        ForecastResult::Forecast(forecast) => (Some(*forecast), None),
        ForecastResult::Unavailable(reason) => (None, Some(reason)),
    };
    // Collect the information about the scene
    let info = SceneInfo {
        groups: loaded.group_count,
        included_files: loaded.include_count + loaded.gltf_count,
        prices,
        forecast,
        no_forecast,
        ..SceneInfo::of(&loaded.scene, &args.scene, &args.effects.unwrap_or_default())
    };
    // Print it as text or as JSON
    if !args.json {
        return output::print(&info.to_string());
    }
    let mut text = serde_json::to_string_pretty(&info).map_err(|error| {
        Failure::Work(format!(
            "cannot convert the summary of the scene to JSON: {error}"
        ))
    })?;
    text.push('\n');
    output::print(&text)
}
