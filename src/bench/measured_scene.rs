//! Scene to measure, with the image that its rays belong to.

use super::BenchError;
use crate::accel::Accel;
use crate::measure::Observer;
use crate::render::{RenderProfile, RenderSettings, TileSample, render, render_sample};
use crate::scene::{Camera, Scene};

/// Scene to measure, with the image that its rays belong to.
#[derive(Clone, Copy)]
pub struct MeasuredScene<'s> {
    /// Name of the scene in the results: its path as the user gave it.
    pub name: &'s str,
    /// Scene that has passed [`Scene::validate`].
    pub scene: &'s Scene,
    /// Camera of the image.
    pub camera: &'s Camera,
    /// Render settings of the image.
    pub settings: RenderSettings,
}

impl MeasuredScene<'_> {
    /// Renders the image in the current thread pool and returns its profile.
    pub(super) fn profile(
        &self,
        accel: &dyn Accel,
        observer: &Observer,
    ) -> Result<RenderProfile, BenchError> {
        let settings = RenderSettings {
            ledger: true,
            ..self.settings
        };
        let monitor = observer.monitor();
        Ok(render(self.scene, self.camera, accel, &settings, &monitor)?.ledger)
    }

    /// Renders `tiles` tiles of the image with other settings, in the current thread pool.
    pub(super) fn sample(
        &self,
        accel: &dyn Accel,
        settings: &RenderSettings,
        tiles: usize,
        observer: &Observer,
    ) -> Result<TileSample, BenchError> {
        let monitor = observer.monitor();
        let view = (self.scene, self.camera);
        Ok(render_sample(view, accel, settings, tiles, &monitor)?)
    }
}
