//! A checkerboard of black and white squares up to the horizon, seen without light, alone or with a ball before the
//! camera.
//!
//! The board comes in three kinds: a procedure, an image with mipmaps, and, not filtered, an image of four texels of
//! which the nearest counts. The sky is the board's mean.

use std::path::Path;

use image::{Luma, imageops::FilterType};
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::gltf::LoadOptions;
use whit::image::LinearImage;
use whit::render::{Monitor, RenderSettings, render};
use whit::scene::Scene;
use whit::scene_file;

/// The board as a procedure. Squares have sides of half a metre, two a unit of texture coordinates.
pub const PROCEDURE: &str = "pattern = 'checker'\nspace = 'uv'\nscale = 2";
/// The board as an image with mipmaps.
pub const MIPMAPPED: &str = "image = 'fine.png'\nfilter = 'mipmap'";
/// The board as an image that is not filtered.
pub const SHARP: &str = "image = 'coarse.png'\nfilter = 'nearest'";

/// Nothing stands on the board.
pub const EMPTY: &str = "";
/// A mirroring ball that fills the image of the near camera.
pub const MIRROR: &str = "base_color = 1\nmetallic = 1\nroughness = 0";
/// A glass ball of the same size.
pub const GLASS: &str = "ior = 1.5\ntransmission = 1\nroughness = 0";

/// Returns the board, with a ball of some material in front of a closer camera unless it is [`EMPTY`].
pub fn scene(texture: &str, ball: &str) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let coarse = image::ImageBuffer::from_fn(2, 2, |x, y| Luma([255 * ((x + y) % 2) as u8]));
    coarse.save(folder.path().join("coarse.png")).unwrap();
    let fine = image::imageops::resize(&coarse, 128, 128, FilterType::Nearest);
    fine.save(folder.path().join("fine.png")).unwrap();
    let view = match ball {
        EMPTY => "from = [0, 1, 0]\nat = [0, 1, -1]\nfov = 50".to_owned(),
        material => format!(
            "from = [0, 1.3, 6]\nat = [0, 1.1, 0]\nfov = 12\n\
             [material.ball]\n{material}\n\
             [[object]]\nshape = {{ sphere = {{ center = [0, 1.1, 0] }} }}\nmaterial = 'ball'"
        ),
    };
    // Neither along the view nor along a diagonal, and no square's edge under the camera.
    let board = "shape = 'plane'\ntransform = [{ rotate = [0, 0, 1, 27] }, { z-to = [0, 1, 0] }, \
                 { translate = [0.13, 0, 0.07] }]";
    let text = format!(
        "background = 0.5\n[camera]\n{view}\n[texture.board]\n{texture}\n\
         [material.board]\nmodel = 'unlit'\nbase_color = {{ texture = 'board' }}\n\
         [[object]]\n{board}\nmaterial = 'board'\n"
    );
    load(folder.path(), &text)
}

/// Renders what the camera sees, in the proportion of 4 to 3.
pub fn render_image(scene: &Scene, accel: &dyn Accel, width: u32, spp: u32) -> LinearImage {
    let settings = RenderSettings {
        width,
        height: width / 4 * 3,
        spp,
        ..RenderSettings::default()
    };
    let monitor = Monitor::default();
    render(
        scene.validate().unwrap(),
        &scene.cameras[0],
        accel,
        &settings,
        &monitor,
    )
    .unwrap()
    .image
}

/// Builds a BSP tree over the scene.
pub fn bsp(scene: &Scene) -> Box<dyn Accel + '_> {
    accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap()
}

fn load(folder: &Path, text: &str) -> Scene {
    let file = folder.join("board.toml");
    std::fs::write(&file, text).unwrap();
    let loaded = scene_file::load(&file, &LoadOptions::default());
    loaded.unwrap_or_else(|fault| panic!("{fault}")).scene
}
