//! Checked render jobs: paths resolved, numbers in range, output files known to be writable. A job is made before any
//! scene is opened; code after it does not depend on flags.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use whit::accel::Backend;
use whit::batch::request::{RenderRequest, SceneChange, Settings, is_scene_file};
use whit::cost::{self, SettingsFile};
use whit::gltf::LoadOptions;
use whit::image::{Denoiser, ImageFormat, check_writable};
use whit::render::{Exposure, Region};
use whit::scene::image_settings::VisibleBackground;
use whit::scene_file::Output;

use super::accel_options::{check_backend, check_instancing, tracing_options};
use super::args::{FrameArgs, RenderArgs};
use super::crop;
use super::failure::Failure;
use super::image_format::image_encoding;

/// Checked command of `whit render`, for all its scenes.
#[derive(Clone, Debug)]
pub(super) struct RenderJob {
    pub(super) targets: Vec<Target>,
    /// Image to render of each scene.
    pub(super) request: RenderRequest,
    /// Path of the heat map, if one is written.
    pub(super) heat: Option<PathBuf>,
    /// Exposure that is given or chosen automatically; the scene's if absent.
    pub(super) exposure: Option<Exposure>,
    /// Part of the image that is rendered; all of it if absent.
    pub(super) crop: Option<Region>,
    /// Name or index of the camera; the scene's first camera if absent.
    pub(super) camera: Option<String>,
    /// Denoiser of the finished images, if they are denoised.
    pub(super) denoiser: Option<Denoiser>,
    /// Options for loading glTF files.
    pub(super) load: LoadOptions,
    /// Target of the search for settings, if there is one.
    pub(super) aim: Option<SettingsSearch>,
    pub(super) stats: Option<StatsDestination>,
    /// True if the error of the finished image is estimated; a search measures it anyway.
    pub(super) estimates_error: bool,
}

/// Scene file and the image file that it is rendered to.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Target {
    pub(super) scene: PathBuf,
    pub(super) image: PathBuf,
    pub(super) format: ImageFormat,
}

/// Search for settings before the image is rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SettingsSearch {
    /// Error or time that the settings must reach.
    pub(super) target: cost::Target,
    /// Seconds that the search may take.
    pub(super) seconds: f64,
}

impl SettingsSearch {
    fn of(args: &RenderArgs) -> Option<SettingsSearch> {
        let target = match (args.error, args.max_time) {
            (Some(most), _) => cost::Target::Error(most),
            (None, Some(most)) => cost::Target::Seconds(most),
            (None, None) => return None,
        };
        Some(SettingsSearch {
            target,
            seconds: args.pilot,
        })
    }
}

/// Destination of the render statistics.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum StatsDestination {
    /// JSON file at this path.
    File(PathBuf),
    /// Table on standard output.
    Stdout,
}

impl StatsDestination {
    /// Returns the destination for a path on the command line, where a dash is standard output.
    fn of(path: &Path) -> StatsDestination {
        if path == Path::new("-") {
            StatsDestination::Stdout
        } else {
            StatsDestination::File(path.to_owned())
        }
    }

    fn file(&self) -> Option<&Path> {
        match self {
            StatsDestination::File(path) => Some(path),
            StatsDestination::Stdout => None,
        }
    }
}

impl RenderJob {
    /// Checks all flags that can be checked without opening a scene.
    pub(super) fn new(args: &RenderArgs) -> Result<RenderJob, Failure> {
        // Choose the backend: flag, then settings file, then scene file, then default
        let chosen = args.settings.as_deref().map(chosen).transpose()?;
        let named = args.backend.or(chosen.and_then(|chosen| chosen.backend));
        let backend = named.unwrap_or_default();
        if backend == Backend::Embree && !cfg!(feature = "embree") {
            return Err(whit::accel::AccelError::NoEmbree.into());
        }
        check_backend(&args.tracing, backend)?;
        check_instancing(&args.tracing)?;
        // Resolve the image paths and check that their formats hold what is requested
        let targets = targets(args)?;
        let encoding = image_encoding(&args.encoding, targets.iter().map(|target| target.format))?;
        let stats = args.stats.as_deref().map(StatsDestination::of);
        let aovs = args.sampling.aov.clone();
        if !aovs.is_empty() && targets.iter().any(|target| target.format != ImageFormat::Exr) {
            return Err(Failure::Input(
                "`--aov` adds channels that a PNG cannot store: write an .exr".into(),
            ));
        }
        if let Some(path) = args.heat.as_deref()
            && ImageFormat::of_path(path) != Some(ImageFormat::Png)
        {
            return Err(Failure::Input(format!(
                "a heat map is a PNG: change the file name {} to end in .png",
                path.display()
            )));
        }
        // Check that every output file can be written
        for path in targets
            .iter()
            .map(|t| t.image.as_path())
            .chain(stats.as_ref().and_then(StatsDestination::file))
            .chain(args.heat.as_deref())
        {
            check_writable(path)?;
        }
        let aim = SettingsSearch::of(args);
        if aim.is_some() && backend == Backend::Brute {
            return Err(Failure::Input(
                "brute force is too slow to search for settings: choose `--backend embree` or `--backend bsp`".into(),
            ));
        }
        if aim.is_some() && args.display.background == Some(VisibleBackground::Transparent) {
            return Err(Failure::Input(
                "`--error` and `--max-time` may choose adaptive sampling, which a transparent background does not allow: \
                 leave out `--background transparent`, or give the settings themselves"
                    .into(),
            ));
        }
        let is_set = chosen.and_then(|chosen| chosen.denoise) == Some(true);
        let denoiser = args.denoising.denoiser(is_set)?;
        if denoiser.is_some() && args.crop.is_some() {
            return Err(Failure::Input(
                "`--denoise` needs all of the image, so that a part would differ from the whole: leave out `--crop`"
                    .into(),
            ));
        }
        if denoiser.is_some() && aim.is_some() {
            return Err(Failure::Input(
                "`--error` and `--max-time` choose settings of images that are not denoised: leave out `--denoise`".into(),
            ));
        }
        // Collect the flags into the job
        let mut job = RenderJob {
            targets,
            request: RenderRequest {
                encoding,
                output: Output {
                    spp: args.sampling.spp,
                    pattern: args.sampling.pattern,
                    filter: args.sampling.filter,
                    filter_radius: args.sampling.filter_radius,
                    exposure: given_stops(args.display.exposure),
                    tone_map: args.display.tone_map,
                    background: args.display.background,
                    backend: named,
                    ..requested(&args.frame)
                },
                adaptive: args.sampling.adaptive,
                edge_contrast: args.sampling.edge_contrast,
                effects: args.effects.unwrap_or_default(),
                aovs,
                needs_costs: args.heat.is_some(),
                needs_ledger: stats.is_some(),
                tracing: tracing_options(&args.tracing, backend),
                camera: args.view.placement(),
                ambient: args.ambient.map(|a| a.0),
                environment: args.surroundings.request(),
                change: SceneChange {
                    rough_rays: args.rough_rays,
                    ..SceneChange::default()
                },
                cutoff: None,
                spawn: args.leaving.spawn,
                hit_points: args.leaving.hit_points,
                seed: args.seed,
            },
            heat: args.heat.clone(),
            exposure: args.display.exposure,
            crop: args.crop.map(|crop| crop.0),
            camera: args.view.camera.clone(),
            load: args.gltf.load_options(),
            // The error of a denoised image is unknown.
            estimates_error: denoiser.is_none() && aim.is_none() && (stats.is_some() || !args.quiet),
            denoiser,
            aim,
            stats,
        };
        // Apply the settings file; clap rejects the flags that it would override
        if let Some(chosen) = chosen {
            job.request = job.request.with(&chosen);
        }
        job.check_requested()?;
        job.check_exposure()?;
        if job.crop.is_some() {
            crop::check_request(&job.request)?;
        }
        Ok(job)
    }

    /// Returns the flag that needs the exposure before the image is finished, if there is one.
    pub(super) fn flag_before_exposure(&self) -> Option<&'static str> {
        match self.aim.map(|aim| aim.target) {
            Some(cost::Target::Error(_)) => Some("--error"),
            Some(cost::Target::Seconds(_)) => Some("--max-time"),
            None if self.request.adaptive.is_some() => Some("--adaptive"),
            None if self.crop.is_some() => Some("--crop"),
            None => None,
        }
    }

    /// Rejects automatic exposure where the exposure must be known before the image is finished.
    fn check_exposure(&self) -> Result<(), Failure> {
        match self.flag_before_exposure() {
            Some(flag) if self.exposure == Some(Exposure::Automatic) => Err(Failure::Input(format!(
                "`--exposure auto` needs the finished image, and `{flag}` the exposure before that: give `--exposure` the \
                 stops that a render without `{flag}` prints"
            ))),
            _ => Ok(()),
        }
    }

    /// Checks the settings of the command line for errors that no scene file can resolve.
    fn check_requested(&self) -> Result<(), Failure> {
        let output = &self.request.output;
        let scene_may_filter = self.targets.iter().any(|target| is_scene_file(&target.scene));
        // A filter radius without a filter is valid if the scene file names a filter that has one
        if output.filter.is_none() && output.filter_radius.is_some() && scene_may_filter {
            return Ok(());
        }
        self.request.resolved(&Output::default())?;
        Ok(())
    }
}

/// Returns the stops of a flag that gives a number.
fn given_stops(exposure: Option<Exposure>) -> Option<f32> {
    match exposure {
        Some(Exposure::Stops(stops)) => Some(stops),
        Some(Exposure::Automatic) | None => None,
    }
}

/// Reads a settings file of `whit cost`.
fn chosen(path: &Path) -> Result<Settings, Failure> {
    let refuse = |fault: String| Failure::Input(format!("{} {fault}", path.display()));
    let text = fs::read_to_string(path).map_err(|error| refuse(format!("cannot be read: {error}")))?;
    Ok(SettingsFile::parse(&text).map_err(refuse)?.settings)
}

/// Returns the pairs of scene and image file that the arguments name.
fn targets(args: &RenderArgs) -> Result<Vec<Target>, Failure> {
    match (&args.output, &args.out) {
        (Some(image), _) => {
            let [scene] = &args.scenes[..] else {
                return Err(Failure::Input(
                    "`-o` names a single image: give a single scene, or a folder with `--out`".into(),
                ));
            };
            let format = ImageFormat::of_path(image).ok_or_else(|| {
                Failure::Input(format!(
                    "the file name {} has no known image format: give a name that ends in .png or .exr",
                    image.display()
                ))
            })?;
            Ok(vec![Target {
                scene: scene.clone(),
                image: image.clone(),
                format,
            }])
        }
        (None, Some(folder)) => targets_in(folder, &args.scenes, args.format.unwrap_or_default()),
        // clap requires one of the two flags, so this case does not occur.
        (None, None) => Err(Failure::Input(
            "give an image with `-o` or a folder with `--out`".into(),
        )),
    }
}

fn targets_in(folder: &Path, scenes: &[PathBuf], format: ImageFormat) -> Result<Vec<Target>, Failure> {
    if !folder.is_dir() {
        return Err(Failure::Input(format!(
            "there is no folder {}: create it first",
            folder.display()
        )));
    }
    // Derive the image name from each scene's file name
    let mut taken: HashMap<PathBuf, &Path> = HashMap::new();
    let mut targets = Vec::with_capacity(scenes.len());
    for scene in scenes {
        let Some(stem) = scene.file_stem() else {
            return Err(Failure::Input(format!(
                "{} is no scene file: give the path of a file",
                scene.display()
            )));
        };
        let mut name = stem.to_owned();
        name.push(format!(".{format}"));
        let image = folder.join(name);
        // Two scenes of the same file name would overwrite each other's image
        if let Some(other) = taken.insert(image.clone(), scene) {
            return Err(Failure::Input(format!(
                "{} and {} would both be written to {}: render them into different folders",
                other.display(),
                scene.display(),
                image.display()
            )));
        }
        targets.push(Target {
            scene: scene.clone(),
            image,
            format,
        });
    }
    Ok(targets)
}

/// Returns the image settings that flags give for every kind of render.
pub(super) fn requested(frame: &FrameArgs) -> Output {
    Output {
        size: frame.size.map(|size| [size.width, size.height]),
        depth: frame.depth,
        wavelengths: frame.wavelengths,
        ..Output::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_scenes_with_the_same_image_name_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let scenes = ["a/x.glb".into(), "b/x.gltf".into()];
        let error = targets_in(folder.path(), &scenes, ImageFormat::Png).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(
            error
                .to_string()
                .contains("a/x.glb and b/x.gltf would both be written to")
        );
        let named = targets_in(folder.path(), &scenes[..1], ImageFormat::Exr).unwrap();
        assert_eq!(named[0].image, folder.path().join("x.exr"));
    }
}
