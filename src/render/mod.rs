//! From a scene and a backend to a picture: tiles in parallel, each a series of waves of packets.
//!
//! This room knows no file formats and no backend by name. A picture has the same bits for any number of threads and
//! any order of tiles: every tile owns its pixels and sums in one order.

mod film;
mod ledger;
mod queue;
mod record;
mod sampler;
mod shade;
mod shape_point;
mod surface;
mod wave;

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use rayon::prelude::*;

pub use ledger::{Ledger, RayTally};
pub use record::{RecordedRays, record};

use crate::accel::Accel;
use crate::image::LinearImage;
use crate::numeric::Lanes;
use crate::scene::{Camera, CameraView, Material, Scene};
use sampler::{PacketShape, SampleGroup};
use surface::SurfaceScene;
use wave::Wave;

/// Most tiles that one thread takes in a row: few enough that no thread is left with much when the others are done.
const RUN: usize = 16;

/// What picture is made of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Pixels a row; at least 1.
    pub width: u32,
    /// Rows; at least 1.
    pub height: u32,
    /// Samples a pixel; at least 1.
    pub spp: u32,
    /// Reflections that are followed at most; 0 for none.
    pub depth: u32,
    /// A reflected ray is not traced if its weight in every channel is under this.
    pub weight_cutoff: f32,
}

impl Default for RenderSettings {
    fn default() -> RenderSettings {
        RenderSettings {
            width: 1024,
            height: 1024,
            spp: 1,
            depth: 5,
            weight_cutoff: 1.0 / 512.0,
        }
    }
}

/// A picture and what it took.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Linear RGB radiance.
    pub image: LinearImage,
    /// Rays and seconds.
    pub ledger: Ledger,
}

/// How a long render talks to whoever waits for it.
#[derive(Clone, Copy)]
pub struct Monitor<'a> {
    /// Told the finished fraction, from any thread.
    pub progress: &'a (dyn Fn(f64) + Sync),
    /// Set by anyone to stop the render.
    pub cancel: &'a AtomicBool,
}

/// Everything that stays the same over one picture.
struct Frame<'s> {
    scene: &'s Scene,
    accel: &'s dyn Accel,
    settings: RenderSettings,
    view: CameraView,
    surfaces: SurfaceScene<'s>,
    /// Width and height of a pixel as parts of the image's.
    pixel_size: [f64; 2],
    shape: PacketShape,
    /// Pixels of the lanes of that shape, within its block.
    pixels: [Lanes<u32>; 2],
    /// The samples of each pixel, a packet's share at a time.
    groups: Vec<SampleGroup>,
    ambient: [f32; 3],
    /// Whether anything is seen without a light: ambient or emission.
    glows: bool,
    /// Whether any material may reflect as a mirror.
    mirrors: bool,
}

/// Renders `scene` as `camera` sees it, in the current rayon pool. `None` if it was cancelled.
///
/// `scene` must have passed [`Scene::validate`], and `accel` must have been built from it.
pub fn render(
    scene: &Scene,
    camera: &Camera,
    accel: &dyn Accel,
    settings: &RenderSettings,
    monitor: &Monitor,
) -> Option<Rendering> {
    let start = Instant::now();
    let frame = Frame::new(scene, camera, accel, settings);
    let tiles = film::tiles(settings.width, settings.height);
    let finished = AtomicUsize::new(0);
    let render_tile = |wave: &mut Wave, tile: film::Tile| {
        if monitor.cancel.load(Ordering::Relaxed) {
            return None;
        }
        let (means, ledger) = wave.render_tile(tile);
        let finished = finished.fetch_add(1, Ordering::Relaxed) + 1;
        (monitor.progress)(finished as f64 / tiles.len() as f64);
        Some(((tile, means), ledger))
    };
    let rendered: Option<Vec<_>> = tiles
        .par_iter()
        .with_max_len(RUN)
        .map_init(|| Wave::new(&frame), |wave, &tile| render_tile(wave, tile))
        .collect();
    let mut ledger = Ledger::default();
    let mut finished_tiles = Vec::with_capacity(tiles.len());
    for (tile, tile_ledger) in rendered? {
        ledger += tile_ledger;
        finished_tiles.push(tile);
    }
    let image = film::assemble(settings.width, settings.height, &finished_tiles);
    ledger.seconds = start.elapsed().as_secs_f64();
    Some(Rendering { image, ledger })
}

impl<'s> Frame<'s> {
    fn new(scene: &'s Scene, camera: &Camera, accel: &'s dyn Accel, settings: &RenderSettings) -> Frame<'s> {
        let used = || {
            scene
                .instances
                .iter()
                .map(|i| &scene.materials[i.material as usize])
        };
        let ambient_light = scene.ambient != [0.0; 3];
        let shape = PacketShape::for_samples(settings.spp);
        Frame {
            scene,
            accel,
            settings: *settings,
            view: camera.view(settings.width, settings.height),
            surfaces: SurfaceScene::new(scene),
            pixel_size: [settings.width, settings.height].map(|size| 1.0 / f64::from(size)),
            shape,
            pixels: shape.pixels(),
            groups: shape.groups(settings.spp),
            ambient: scene.ambient,
            glows: ambient_light || used().any(|material| material.emission != [0.0; 3]),
            mirrors: used().any(Material::may_mirror),
        }
    }
}
