//! Checked render jobs: paths resolved, numbers in range, output files known to be writable. A job is made before any
//! scene is opened; code after it does not depend on flags.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use whit::accel::Backend;
use whit::cost::{self, SceneChange, Settings, SettingsFile};
use whit::gltf::AnimationTime;
use whit::image::{ImageFormat, ToneMap, check_writable};
use whit::numeric::SpawnPolicy;
use whit::render::{Adaptive, FilterKind, HitPoint, LightAovs, Pattern, PixelFilter, RenderSettings};
use whit::report::memory;
use whit::scene::image_settings::{DEFAULT_DEPTH, DEFAULT_SIZE, DEFAULT_SPP, DEFAULT_WAVELENGTHS};
use whit::scene::{Camera, Effect, EffectOverrides, Scene};
use whit::scene_file::Output;

use super::accel_options::check_backend;
pub(super) use super::accel_options::{Tracing, check_instancing, effective_precision};
use super::args::{Aov, FrameArgs, RenderArgs};
use super::failure::Failure;
use super::image_format::ImageEncoding;
use super::progress::Verbosity;
use super::scene;

/// Checked command of `whit render`, for all its scenes.
#[derive(Clone, Debug)]
pub(super) struct RenderJob {
    pub(super) targets: Vec<Target>,
    /// Encoding of the images in their files.
    pub(super) encoding: ImageEncoding,
    /// Image settings of the command line; the scene may give those that are absent: see [`RenderJob::resolved`].
    requested: Output,
    /// Target standard error of pixels for adaptive sampling; absent for a fixed number of samples.
    adaptive: Option<f64>,
    pub(super) effects: EffectOverrides,
    pub(super) aovs: Vec<Aov>,
    /// Path of the heat map, if one is written.
    pub(super) heat: Option<PathBuf>,
    pub(super) backend: Backend,
    pub(super) tracing: Tracing,
    pub(super) camera: Option<String>,
    /// Animation and time at which the scene is posed; absent for a scene at rest.
    pub(super) pose: Option<AnimationTime>,
    pub(super) ambient: Option<[f32; 3]>,
    /// Changes of every scene: glossy rays, samples of area lights, steps through volumes.
    pub(super) change: SceneChange,
    /// Throughput below which no ray is traced; that of the render settings if absent.
    cutoff: Option<f32>,
    /// Policy that offsets the origins of rays that leave a surface.
    spawn: SpawnPolicy,
    /// Method that computes the hit points on surfaces.
    hit_points: HitPoint,
    pub(super) seed: u32,
    /// Target of the search for settings, if there is one.
    pub(super) aim: Option<SettingsSearch>,
    pub(super) stats: Option<StatsDestination>,
    pub(super) verbosity: Verbosity,
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
        // Choose the backend: flag, then settings file, then default
        let chosen = args.settings.as_deref().map(chosen).transpose()?;
        let backend = args.backend.or(chosen.and_then(|chosen| chosen.backend));
        let backend = backend.unwrap_or_default();
        if backend == Backend::Embree && !cfg!(feature = "embree") {
            return Err(whit::accel::AccelError::NoEmbree.into());
        }
        check_backend(&args.tracing, backend)?;
        check_instancing(&args.tracing)?;
        // Resolve the image paths and check that their formats hold what is requested
        let targets = targets(args)?;
        let encoding = ImageEncoding::new(&args.encoding, targets.iter().map(|target| target.format))?;
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
        // Collect the flags into the job
        let mut job = RenderJob {
            targets,
            encoding,
            requested: Output {
                spp: args.sampling.spp,
                pattern: args.sampling.pattern,
                filter: args.sampling.filter,
                filter_radius: args.sampling.filter_radius,
                exposure: args.exposure,
                depth: args.frame.depth,
                wavelengths: args.frame.wavelengths,
                ..requested(&args.frame)
            },
            adaptive: args.sampling.adaptive,
            effects: args.effects.unwrap_or_default(),
            aovs,
            heat: args.heat.clone(),
            backend,
            tracing: Tracing::new(&args.tracing),
            camera: args.camera.clone(),
            pose: args.moment.pose(),
            ambient: args.ambient.map(|a| a.0),
            change: SceneChange {
                rough_rays: args.rough_rays,
                ..SceneChange::default()
            },
            cutoff: None,
            spawn: args.leaving.spawn,
            hit_points: args.leaving.hit_points,
            seed: args.seed,
            aim,
            stats,
            verbosity: if args.quiet {
                Verbosity::Quiet
            } else {
                Verbosity::Normal
            },
        };
        // Apply the settings file; clap rejects the flags that it would override
        if let Some(chosen) = chosen {
            job = job.with(&chosen);
        }
        job.check_requested()?;
        Ok(job)
    }

    /// Returns this job with the given settings in place of its own.
    pub(super) fn with(&self, chosen: &Settings) -> RenderJob {
        let mut job = self.clone();
        job.requested.spp = chosen.spp.or(job.requested.spp);
        job.requested.pattern = chosen.pattern.or(job.requested.pattern);
        job.requested.depth = chosen.depth.or(job.requested.depth);
        job.requested.wavelengths = chosen.wavelengths.or(job.requested.wavelengths);
        job.adaptive = chosen.adaptive;
        if chosen.texture_filter == Some(false) {
            job.effects.removed = job.effects.removed.with(Effect::TextureFilter);
        }
        job.backend = chosen.backend.unwrap_or(job.backend);
        job.tracing.precision = chosen.precision.unwrap_or(job.tracing.precision);
        job.tracing.instancing = chosen.instancing.unwrap_or(job.tracing.instancing);
        job.tracing.build_quality = chosen.build_quality.unwrap_or(job.tracing.build_quality);
        job.tracing.compact = chosen.compact.unwrap_or(job.tracing.compact);
        // Keep the command line's glossy rays where the settings have none
        job.change = SceneChange {
            rough_rays: chosen.rough_rays.or(job.change.rough_rays),
            ..chosen.change()
        };
        job.cutoff = chosen.cutoff;
        job.spawn = chosen.spawn.unwrap_or(job.spawn);
        job.hit_points = chosen.hit_points.unwrap_or(job.hit_points);
        job
    }

    /// Returns whether any requested channels are not sums over samples.
    pub(super) fn has_first_hit_aovs(&self) -> bool {
        self.aovs.iter().any(|aov| *aov != Aov::Samples)
    }

    /// Returns whether the image must be rendered in one piece: pixels depend on each other, or on the time of
    /// rendering.
    pub(super) fn must_render_at_once(&self) -> bool {
        self.adaptive.is_some() || self.records_costs()
    }

    /// Returns whether the cost of each pixel is recorded.
    fn records_costs(&self) -> bool {
        let is_cost = |aov: &Aov| matches!(aov, Aov::Rays | Aov::Time);
        self.heat.is_some() || self.aovs.iter().any(is_cost)
    }

    /// Checks the settings of the command line for errors that no scene file can resolve.
    fn check_requested(&self) -> Result<(), Failure> {
        let scene_may_filter = self
            .targets
            .iter()
            .any(|target| scene::is_scene_file(&target.scene));
        // A filter radius without a filter is valid if the scene file names a filter that has one
        if self.requested.filter.is_none() && self.requested.filter_radius.is_some() && scene_may_filter {
            return Ok(());
        }
        self.resolved(&Output::default()).map(|_| ())
    }
}

/// Render settings and tone mapping of one scene: those of the command line, else those of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ResolvedSettings {
    pub(super) settings: RenderSettings,
    pub(super) tone: ToneMap,
}

impl RenderJob {
    /// Returns the settings for a scene whose file gives the image settings `output`.
    pub(super) fn resolved(&self, output: &Output) -> Result<ResolvedSettings, Failure> {
        // The command line takes precedence over the scene
        let requested = self.requested.or(output);
        let exposure_ev = requested.exposure.unwrap_or(0.0);
        let cost_aovs = self.records_costs();
        let settings = RenderSettings {
            adaptive: self.adaptive.map(|error| Adaptive {
                error,
                gain: f64::from(exposure_ev).exp2(),
            }),
            sample_aovs: self.aovs.contains(&Aov::Samples),
            layers: self.aovs.iter().filter_map(|aov| aov.layers()).collect(),
            light_layers: LightAovs {
                lights: self.aovs.contains(&Aov::Lights),
                effects: self.aovs.contains(&Aov::Effects),
            },
            cost_aovs,
            effects: self.effects,
            seed: self.seed,
            spawn: self.spawn,
            hit_points: self.hit_points,
            ledger: self.stats.is_some() || cost_aovs,
            ..settings(&requested)?
        };
        // Replace the cutoff only where the job has one
        let settings = RenderSettings {
            weight_cutoff: self.cutoff.unwrap_or(settings.weight_cutoff),
            ..settings
        };
        if settings.adaptive.is_some() {
            check_adaptive(&settings)?;
        }
        check_light_layers(&settings)?;
        // The number of lights is unknown here, so the check counts none.
        check_memory(&settings, 0)?;
        Ok(ResolvedSettings {
            settings,
            tone: ToneMap { exposure_ev },
        })
    }
}

/// Rejects settings that conflict with different numbers of samples per pixel.
fn check_adaptive(settings: &RenderSettings) -> Result<(), Failure> {
    let refuse = |words: &str| Err(Failure::Input(words.into()));
    if settings.filter.kind != FilterKind::Box {
        return refuse(
            "`--adaptive` gives pixels different numbers of samples, which only the box filter supports: leave out \
             `--filter`, or give `--filter box` if the scene file has another",
        );
    }
    if !(settings.layers.is_empty() && settings.light_layers.is_empty()) {
        return refuse(
            "`--adaptive` supports only the channels `samples`, `rays` and `time`: give `--aov` only these, or leave \
             out `--adaptive`",
        );
    }
    if settings.pattern == Pattern::Regular {
        return refuse(
            "a regular pattern repeats the same samples in every round of `--adaptive`: choose another `--pattern`",
        );
    }
    Ok(())
}

/// Rejects light layers with filters that spread samples over several pixels.
fn check_light_layers(settings: &RenderSettings) -> Result<(), Failure> {
    if settings.light_layers.is_empty() || settings.filter.kind == FilterKind::Box {
        return Ok(());
    }
    Err(Failure::Input(
        "`--aov lights` and `--aov effects` are not filtered and would not add up to the image: leave out `--filter`, \
         or give `--filter box` if the scene file has another"
            .into(),
    ))
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

/// Returns the render settings for an image, with defaults for what is absent; rejects images larger than the memory.
pub(super) fn settings(output: &Output) -> Result<RenderSettings, Failure> {
    // Fill in the defaults
    let [width, height] = output.size.unwrap_or(DEFAULT_SIZE);
    let settings = RenderSettings {
        width,
        height,
        spp: output.spp.unwrap_or(DEFAULT_SPP),
        pattern: output.pattern.unwrap_or_default(),
        filter: filter(output)?,
        depth: output.depth.unwrap_or(DEFAULT_DEPTH),
        wavelengths: output.wavelengths.unwrap_or(DEFAULT_WAVELENGTHS),
        ..RenderSettings::default()
    };
    check_memory(&settings, 0)?;
    Ok(settings)
}

fn filter(output: &Output) -> Result<PixelFilter, Failure> {
    let usual = PixelFilter::of_kind(output.filter.unwrap_or_default());
    match output.filter_radius {
        None => Ok(usual),
        Some(_) if usual.kind == FilterKind::Box => Err(Failure::Input(
            "a box filter always covers one pixel: leave out `--filter-radius` or choose another `--filter`"
                .into(),
        )),
        Some(radius) => Ok(PixelFilter { radius, ..usual }),
    }
}

/// Rejects images that do not fit into the available memory.
pub(super) fn check_memory(settings: &RenderSettings, light_count: usize) -> Result<(), Failure> {
    // Compare the film and the sampling buffers with the free memory
    let (width, height) = (settings.width, settings.height);
    let pixels = u64::from(width) * u64::from(height);
    let needed = memory::film_bytes(width, height) + settings.sampling_bytes_per_pixel(light_count) * pixels;
    if let Some(available) = memory::available_bytes().filter(|&available| needed > available) {
        return Err(Failure::Input(format!(
            "an image of {width}x{height} pixels takes {} of memory and {} are free: give a smaller `--size`",
            memory::in_words(needed),
            memory::in_words(available)
        )));
    }
    Ok(())
}

/// Returns the requested camera, looked up by name first and then by index; the first camera if none is requested.
pub(super) fn choose_camera<'s>(
    scene: &'s Scene,
    path: &Path,
    requested: Option<&str>,
) -> Result<&'s Camera, Failure> {
    // Search by name first: a name may look like an index
    let cameras = &scene.cameras;
    let found = match requested {
        None => cameras.first(),
        Some(requested) => cameras
            .iter()
            .find(|camera| camera.name == requested)
            .or_else(|| cameras.get(requested.parse::<usize>().ok()?)),
    };
    // List the cameras in the error message
    found.ok_or_else(|| {
        let known: Vec<String> = cameras
            .iter()
            .enumerate()
            .map(|(number, camera)| format!("{number} `{}`", camera.name))
            .collect();
        Failure::Input(format!(
            "{} has no camera `{}`: it has {}",
            path.display(),
            requested.unwrap_or_default(),
            if known.is_empty() {
                "none".into()
            } else {
                known.join(", ")
            }
        ))
    })
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;
    use whit::scene::Projection;

    fn scene_with_cameras(names: &[&str]) -> Scene {
        let cameras = names
            .iter()
            .map(|name| Camera {
                name: (*name).into(),
                world_from_camera: DAffine3::IDENTITY,
                projection: Projection::Perspective {
                    y_fov: 1.0,
                    aspect: None,
                },
                ..Camera::default()
            })
            .collect();
        Scene {
            cameras,
            ..Scene::default()
        }
    }

    #[test]
    fn camera_is_found_by_name_before_number() {
        let scene = scene_with_cameras(&["front", "2", "top"]);
        let name = |requested| choose_camera(&scene, Path::new("a.glb"), requested).map(|c| c.name.clone());
        assert_eq!(name(None).unwrap(), "front");
        assert_eq!(name(Some("top")).unwrap(), "top");
        assert_eq!(name(Some("2")).unwrap(), "2");
        assert_eq!(name(Some("1")).unwrap(), "2");
        assert_eq!(
            name(Some("back")).unwrap_err().to_string(),
            "a.glb has no camera `back`: it has 0 `front`, 1 `2`, 2 `top`"
        );
    }

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
