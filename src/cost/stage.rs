//! Where pictures of an experiment are taken: its scenes, changed or not, and what finds the hits in them.

use std::borrow::Cow;
use std::collections::HashMap;
use std::time::Instant;

use super::layout::area;
use super::{Configuration, CostError, Displayed, Experiment, HitPath, SceneChange, Watcher};
use crate::accel::{self, Accel, AccelOptions};
use crate::image::LinearImage;
use crate::render::{
    LayerSet, LightLayers, Monitor, Mosaic, RenderSettings, Rendering, render, render_mosaic,
};
use crate::scene::Scene;

/// What is rendered for a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum View {
    /// All of the picture, at this width and height.
    Whole([u32; 2]),
    /// Pieces of it at its own width and height.
    Pieces(Mosaic),
}

impl View {
    /// A picture of it in the blocks that errors are drawn from: pieces where it shows them.
    pub(super) fn in_its_blocks(self, displayed: Displayed) -> Displayed {
        match self {
            View::Whole(_) => displayed,
            View::Pieces(mosaic) => displayed.in_columns(mosaic.columns),
        }
    }
}

/// A structure that finds hits, and what it took to build.
pub(super) struct Built<'s> {
    pub(super) accel: Box<dyn Accel + 's>,
    pub(super) seconds: f64,
}

/// Where pictures are taken.
pub(super) struct Stage<'a, 's> {
    pub(super) experiment: &'a Experiment<'a>,
    pub(super) watcher: &'a Watcher<'a>,
    scenes: &'s [(SceneChange, Cow<'a, Scene>)],
    /// By scene and path.
    built: HashMap<(usize, HitPath), Built<'s>>,
}

impl<'a, 's> Stage<'a, 's> {
    /// One for scenes that are changed in these ways, on which nothing is built yet.
    pub(super) fn new(
        experiment: &'a Experiment<'a>,
        watcher: &'a Watcher<'a>,
        scenes: &'s [(SceneChange, Cow<'a, Scene>)],
    ) -> Stage<'a, 's> {
        Stage {
            experiment,
            watcher,
            scenes,
            built: HashMap::new(),
        }
    }
}

impl Stage<'_, '_> {
    /// Whether there is a scene that is changed so.
    pub(super) fn has_scene(&self, change: &SceneChange) -> bool {
        self.scenes.iter().any(|(known, _)| known == change)
    }

    /// Seconds since the experiment began.
    pub(super) fn spent(&self) -> f64 {
        self.experiment.start.elapsed().as_secs_f64()
    }

    /// Tells what is being done.
    pub(super) fn say(&self, what: &str) {
        (self.watcher.progress)(what, (self.spent() / self.experiment.budget).min(1.0));
    }

    fn scene_index(&self, change: &SceneChange) -> usize {
        let place = self.scenes.iter().position(|(known, _)| known == change);
        place.expect("scenes were made for all configurations")
    }

    /// Builds what finds the hits of a configuration, if it is not there.
    pub(super) fn build(&mut self, configuration: &Configuration) -> Result<(), CostError> {
        let scene = self.scene_index(&configuration.change);
        let path = configuration.path;
        if self.built.contains_key(&(scene, path)) {
            return Ok(());
        }
        self.say("build");
        let options = AccelOptions {
            precision: path.precision,
            instancing: path.instancing,
            build_quality: path.build_quality,
            compact: path.compact,
            threads: self.experiment.threads,
            isa: self.experiment.isa.clone(),
            ..AccelOptions::default()
        };
        let start = Instant::now();
        let accel = accel::build(&self.scenes[scene].1, path.backend, &options)?;
        let seconds = start.elapsed().as_secs_f64();
        self.built.insert((scene, path), Built { accel, seconds });
        Ok(())
    }

    /// The scene of a configuration.
    pub(super) fn scene(&self, configuration: &Configuration) -> &Scene {
        &self.scenes[self.scene_index(&configuration.change)].1
    }

    /// What was built for a configuration.
    pub(super) fn built(&self, configuration: &Configuration) -> &Built<'_> {
        &self.built[&(self.scene_index(&configuration.change), configuration.path)]
    }

    /// A picture, and the seconds that its samples took.
    pub(super) fn picture(
        &self,
        configuration: &Configuration,
        view: View,
        seed: u32,
    ) -> Result<(Rendering, f64), CostError> {
        let [width, height] = match view {
            View::Whole(size) => size,
            View::Pieces(_) => self.whole_size(),
        };
        let settings = RenderSettings {
            width,
            height,
            seed,
            ledger: false,
            sample_aovs: false,
            layers: LayerSet::NONE,
            light_layers: LightLayers::NONE,
            cost_aovs: false,
            ..configuration.settings
        };
        let monitor = Monitor {
            progress: &|_| {},
            cancel: self.watcher.cancel,
            tiles: None,
        };
        let scene = &self.scenes[self.scene_index(&configuration.change)].1;
        let accel = &*self.built(configuration).accel;
        let camera = self.experiment.camera;
        let start = Instant::now();
        let rendering = match view {
            View::Whole(_) => render(scene, camera, accel, &settings, &monitor),
            View::Pieces(mosaic) => render_mosaic((scene, camera), accel, &settings, mosaic, &monitor),
        };
        let seconds = start.elapsed().as_secs_f64();
        rendering
            .map(|rendering| {
                let seconds = seconds - rendering.ready_seconds;
                (rendering, seconds)
            })
            .ok_or(CostError::Cancelled)
    }

    /// Width and height of the picture that is made in the end.
    pub(super) fn whole_size(&self) -> [u32; 2] {
        let RenderSettings { width, height, .. } = self.experiment.base.settings;
        [width, height]
    }

    /// About so many pixels, not more than the picture has. For a target pieces of the picture, as its errors depend on
    /// its size; else a small picture of its shape, which shows more.
    pub(super) fn view_of(&self, pixels: f64) -> View {
        let whole @ [width, height] = self.whole_size();
        if self.experiment.target.is_some() {
            let mosaic = Mosaic::of(&self.experiment.base.settings, pixels);
            return mosaic.map_or(View::Whole(whole), View::Pieces);
        }
        let scale = (pixels / (f64::from(width) * f64::from(height))).sqrt().min(1.0);
        View::Whole([width, height].map(|side| ((f64::from(side) * scale).round() as u32).max(1)))
    }

    /// Width and height of what a view shows.
    pub(super) fn size_of(&self, view: View) -> [u32; 2] {
        match view {
            View::Whole(size) => size,
            View::Pieces(mosaic) => mosaic.size(&self.experiment.base.settings),
        }
    }

    /// What a picture of a view looks like on the display, in the blocks that errors are drawn from. For a target it is a
    /// part of the picture that is made in the end; else the scene could show others.
    pub(super) fn displayed(&self, image: &LinearImage, view: View) -> Displayed {
        let displayed = view.in_its_blocks(Displayed::new(image, self.experiment.tone));
        match self.experiment.target {
            Some(_) => displayed.as_share(area(self.size_of(view)) / area(self.whole_size())),
            None => displayed,
        }
    }
}
