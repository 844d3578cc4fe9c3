//! Workspace of an experiment: its scene variants, and the acceleration structures that were built for them.

use std::borrow::Cow;
use std::collections::HashMap;
use std::time::Instant;

use super::view::{View, area};
use super::{Configuration, CostError, DisplayImage, Experiment, HitPath, SceneChange};
use crate::accel::{self, Accel, AccelOptions};
use crate::image::LinearImage;
use crate::measure::{Observer, Stopwatch, TurnTime};
use crate::render::{AovSet, PatchGrid, RenderSettings, Rendering, render, render_patches, render_pixels};
use crate::scene::{Effect, Scene, ValidScene};

/// Acceleration structure with its build time in seconds.
pub(super) struct BuiltAccel<'s> {
    pub(super) accel: Box<dyn Accel + 's>,
    pub(super) seconds: f64,
}

/// Workspace that renders the images of an experiment.
pub(super) struct Workspace<'a, 's> {
    pub(super) experiment: &'a Experiment<'a>,
    pub(super) observer: &'a Observer<'a>,
    scenes: &'s [(SceneChange, Cow<'a, Scene>)],
    /// Structures by scene index and path.
    built: HashMap<(usize, HitPath), BuiltAccel<'s>>,
}

impl<'a, 's> Workspace<'a, 's> {
    /// Returns a workspace for these scene variants, without any acceleration structure.
    pub(super) fn new(
        experiment: &'a Experiment<'a>,
        observer: &'a Observer<'a>,
        scenes: &'s [(SceneChange, Cow<'a, Scene>)],
    ) -> Workspace<'a, 's> {
        Workspace {
            experiment,
            observer,
            scenes,
            built: HashMap::new(),
        }
    }
}

impl<'s> Workspace<'_, 's> {
    /// Returns whether a scene variant with `change` exists.
    pub(super) fn has_scene_variant(&self, change: &SceneChange) -> bool {
        self.scenes.iter().any(|(known, _)| known == change)
    }

    /// Returns the seconds since the experiment began.
    pub(super) fn spent(&self) -> f64 {
        self.experiment.start.elapsed().as_secs_f64()
    }

    /// Reports the current step and the spent fraction of the budget.
    pub(super) fn report_step(&self, what: &str) {
        (self.observer.progress)(what, (self.spent() / self.experiment.budget).min(1.0));
    }

    /// Returns a scene variant, which the changes keep valid.
    fn valid(&self, index: usize) -> ValidScene<'s> {
        ValidScene::assume(&self.scenes[index].1)
    }

    fn scene_index(&self, change: &SceneChange) -> usize {
        let place = self.scenes.iter().position(|(known, _)| known == change);
        place.expect("scenes were made for all configurations")
    }

    /// Builds the acceleration structure for a configuration, unless it exists.
    pub(super) fn build(&mut self, configuration: &Configuration) -> Result<(), CostError> {
        let scene = self.scene_index(&configuration.change);
        let path = configuration.path;
        if self.built.contains_key(&(scene, path)) {
            return Ok(());
        }
        self.report_step("build");
        // Build with the options of the path, and measure the time
        let options = AccelOptions {
            threads: self.experiment.threads,
            isa: self.experiment.isa.clone(),
            ..path.options_for(self.valid(scene), &configuration.settings)
        };
        let start = Instant::now();
        let accel = accel::build(self.valid(scene), path.backend, &options)?;
        let seconds = start.elapsed().as_secs_f64();
        self.built.insert((scene, path), BuiltAccel { accel, seconds });
        Ok(())
    }

    /// Returns the scene variant of a configuration.
    pub(super) fn scene(&self, configuration: &Configuration) -> ValidScene<'s> {
        self.valid(self.scene_index(&configuration.change))
    }

    /// Returns the acceleration structure of a configuration.
    pub(super) fn built(&self, configuration: &Configuration) -> &BuiltAccel<'_> {
        &self.built[&(self.scene_index(&configuration.change), configuration.path)]
    }

    /// Returns the settings of an image of a view, without outputs that measurements do not need.
    fn image_settings(&self, configuration: &Configuration, view: View, seed: u32) -> RenderSettings {
        // Patches are rendered at the size of the complete image
        let [width, height] = match view {
            View::Whole(size) => size,
            View::Patches(_) => self.whole_size(),
        };
        RenderSettings {
            width,
            height,
            seed,
            ledger: false,
            ..configuration.settings.without_aovs()
        }
    }

    /// Renders an image, and returns it with the time of its samples, setup not counted.
    pub(super) fn render_image(
        &self,
        configuration: &Configuration,
        view: View,
        seed: u32,
    ) -> Result<(Rendering, TurnTime), CostError> {
        let settings = self.image_settings(configuration, view, seed);
        let denoiser = self.experiment.denoiser.filter(|_| configuration.denoises);
        let settings = match denoiser {
            Some(_) => settings.with_guides(),
            None => settings,
        };
        let monitor = self.observer.monitor();
        // Render the view and measure the time
        let scene = self.scene(configuration);
        let accel = &*self.built(configuration).accel;
        let camera = self.experiment.camera;
        let watch = Stopwatch::start();
        let mut rendering = match view {
            View::Whole(_) => render(scene, camera, accel, &settings, &monitor),
            View::Patches(mosaic) => render_patches((scene, camera), accel, &settings, mosaic, &monitor),
        }?;
        if let Some(denoiser) = denoiser {
            rendering.denoise(denoiser, AovSet::NONE)?;
        }
        // Subtract the setup, so that the time is proportional to the samples; of photons, which are set up too, the
        // view bears its share, as their number is a knob
        let mut time = watch.time();
        if rendering.plan.effects().has(Effect::Caustics) {
            let share = area(self.size_of(view)) / area(self.whole_size());
            time = time.without((1.0 - share) * rendering.ready_seconds);
            rendering.ready_seconds = 0.0;
        } else {
            time = time.without(rendering.ready_seconds);
        }
        Ok((rendering, time))
    }

    /// Renders the chosen pixels of a whole image; the others are black. The filter must be a box.
    pub(super) fn render_pixels(
        &self,
        configuration: &Configuration,
        view: View,
        seed: u32,
        is_chosen: &[bool],
    ) -> Result<LinearImage, CostError> {
        let settings = self.image_settings(configuration, view, seed);
        let viewed = (self.scene(configuration), self.experiment.camera);
        let accel = &*self.built(configuration).accel;
        let monitor = self.observer.monitor();
        Ok(render_pixels(viewed, accel, &settings, is_chosen, &monitor)?)
    }

    /// Returns width and height of the final image.
    pub(super) fn whole_size(&self) -> [u32; 2] {
        let RenderSettings { width, height, .. } = self.experiment.base.settings;
        [width, height]
    }

    /// Returns a view of about `pixels` pixels, at most the complete image. With a target it consists of patches of the
    /// image, whose errors depend on its size; otherwise it is a scaled-down image, which shows more of the scene.
    pub(super) fn choose_view(&self, pixels: f64) -> View {
        let whole @ [width, height] = self.whole_size();
        if self.experiment.target.is_some() {
            let mosaic = PatchGrid::of(&self.experiment.base.settings, pixels);
            return mosaic.map_or(View::Whole(whole), View::Patches);
        }
        let scale = (pixels / (f64::from(width) * f64::from(height))).sqrt().min(1.0);
        View::Whole([width, height].map(|side| ((f64::from(side) * scale).round() as u32).max(1)))
    }

    /// Returns width and height of the image that a view renders.
    pub(super) fn size_of(&self, view: View) -> [u32; 2] {
        match view {
            View::Whole(size) => size,
            View::Patches(mosaic) => mosaic.size(&self.experiment.base.settings),
        }
    }

    /// Returns the displayed values of a view's image, with blocks for resampling. With a target it counts as a part of
    /// the final image; otherwise as a sample of possible images of the scene.
    pub(super) fn displayed(&self, image: &LinearImage, view: View) -> DisplayImage {
        let displayed = view.with_blocks(DisplayImage::new(image, self.experiment.tone));
        match self.experiment.target {
            Some(_) => displayed.as_fraction(area(self.size_of(view)) / area(self.whole_size())),
            None => displayed,
        }
    }
}
