//! Small test scenes, their renderings, and estimates from their pixels.

use glam::DAffine3;
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::image::LinearImage;
use whit::render::{Monitor, RenderSettings, Rendering, render};
use whit::scene::{Background, Camera, Geometry, Image, Instance, Material, Scene, Texels};

/// Adds an object with a material of its own to the scene, and returns its index.
pub fn add(scene: &mut Scene, name: &str, geometry: Geometry, material: Material, place: DAffine3) -> u32 {
    scene.geometries.push(geometry);
    scene.materials.push(material);
    let (geometry, material) = (
        scene.geometries.len() as u32 - 1,
        scene.materials.len() as u32 - 1,
    );
    let instance = Instance::new(name, geometry, material, place).unwrap();
    scene.instances.push(instance);
    scene.instances.len() as u32 - 1
}

/// Makes the only image of the scene its environment map, of linear RGBA texels.
pub fn set_environment(scene: &mut Scene, [width, height]: [u32; 2], texels: Vec<[f32; 4]>, samples: u32) {
    scene.images = vec![Image {
        name: "environment".into(),
        width,
        height,
        texels: Texels::Floats(texels.into()),
    }];
    scene.background = Background::Environment {
        image: 0,
        rotation: 0.0,
        scale: 1.0,
        samples,
    };
}

/// Returns settings for a square image.
pub fn settings(size: u32, spp: u32) -> RenderSettings {
    RenderSettings {
        width: size,
        height: size,
        spp,
        ..RenderSettings::default()
    }
}

/// Renders with the BSP backend.
pub fn rendered(scene: &Scene, camera: &Camera, settings: &RenderSettings) -> Rendering {
    rendered_by(scene, camera, (Backend::Bsp, &AccelOptions::default()), settings)
}

pub fn render_image(
    scene: &Scene,
    camera: &Camera,
    backend: Backend,
    settings: &RenderSettings,
) -> LinearImage {
    rendered_by(scene, camera, (backend, &AccelOptions::default()), settings).image
}

/// Renders a valid scene without progress reports or cancellation.
pub fn rendered_by(
    scene: &Scene,
    camera: &Camera,
    (backend, options): (Backend, &AccelOptions),
    settings: &RenderSettings,
) -> Rendering {
    let scene = scene.validate().unwrap();
    let accel = accel::build(scene, backend, options).unwrap();
    render(scene, camera, &*accel, settings, &Monitor::default()).unwrap()
}

/// Renders the first camera of a valid scene without progress reports or cancellation.
pub fn rendered_with(scene: &Scene, accel: &dyn Accel, settings: &RenderSettings) -> Rendering {
    let scene = scene.validate().unwrap();
    render(scene, &scene.cameras[0], accel, settings, &Monitor::default()).unwrap()
}

/// Returns the mean of the pixels' green, and its standard error from their variance.
pub fn estimate(image: &LinearImage) -> (f64, f64) {
    let count = image.pixels.len() as f64;
    let greens = || image.pixels.iter().map(|pixel| f64::from(pixel[1]));
    let mean = greens().sum::<f64>() / count;
    let variance = greens().map(|g| (g - mean).powi(2)).sum::<f64>() / (count - 1.0);
    (mean, (variance / count).sqrt())
}
