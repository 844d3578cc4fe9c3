//! Renders of scene files of which the ledger is kept, on one thread.

use rayon::ThreadPool;
use whit::accel::Accel;
use whit::render::{Monitor, RenderProfile, RenderSettings, render};

use crate::scene_folder::{self, FiledScene};

/// Loads a scene file of the folder `scenes`, given without its ending.
pub(crate) fn load(name: &str) -> FiledScene {
    scene_folder::named(&format!("{name}.toml"))
}

/// Returns a pool of one thread, on which no second is anybody else's.
pub(crate) fn one_thread() -> ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap()
}

/// Renders what the first camera sees and returns the ledger.
pub(crate) fn ledger(filed: &FiledScene, accel: &dyn Accel, settings: &RenderSettings) -> RenderProfile {
    let settings = RenderSettings {
        ledger: true,
        ..*settings
    };
    let camera = &filed.scene.cameras[0];
    let rendering = render(
        filed.scene.validate().unwrap(),
        camera,
        accel,
        &settings,
        &Monitor::default(),
    );
    rendering.unwrap().ledger
}
