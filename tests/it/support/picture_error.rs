//! How far pictures of a scene are from the one that endless samples would make.

use std::sync::atomic::AtomicBool;

use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::image::LinearImage;
use whit::render::{Monitor, Pattern, RenderSettings, Rendering, render};
use whit::scene::Scene;

/// A scene with two pictures of many samples, which err independently of each other and of any pattern under test.
pub struct Judge<'s> {
    scene: &'s Scene,
    accel: Box<dyn Accel + 's>,
    /// What all pictures have in common.
    settings: RenderSettings,
    references: [LinearImage; 2],
    /// Errors of 16 uniform samples, 32 and so on, as far as they were asked for.
    uniform: Vec<(f64, f64)>,
}

impl<'s> Judge<'s> {
    /// `side` is the root of the number of samples of each reference picture, or nearly.
    pub fn new(scene: &'s Scene, backend: Backend, settings: RenderSettings, side: u32) -> Judge<'s> {
        let accel = accel::build(scene, backend, &AccelOptions::default()).unwrap();
        let mut judge = Judge {
            scene,
            accel,
            settings,
            references: [LinearImage::default(), LinearImage::default()],
            uniform: Vec::new(),
        };
        // Jittered, so that no sequence under test is a part of them; on different grids and with numbers of their own,
        // so they share no samples of pixels, lenses or lights.
        judge.references =
            [(side * side, 1), (side * (side + 1), 2)].map(|(spp, seed)| judge.reference(spp, seed));
        judge
    }

    fn reference(&self, spp: u32, seed: u32) -> LinearImage {
        let settings = RenderSettings {
            spp,
            seed,
            pattern: Pattern::Jittered,
            ..self.settings
        };
        self.rendered(settings).image
    }

    pub fn rendered(&self, settings: RenderSettings) -> Rendering {
        let monitor = Monitor {
            progress: &|_| {},
            cancel: &AtomicBool::new(false),
            tiles: None,
        };
        render(
            self.scene,
            &self.scene.cameras[0],
            &*self.accel,
            &settings,
            &monitor,
        )
        .unwrap()
    }

    /// Root mean square error of sRGB values, black 0 and white 1, and how uncertain the references leave its square, as
    /// a part of it.
    ///
    /// With x the picture, a and b the references, each the truth and an error of its own, the mean of (x - a)(x - b) is
    /// that of the picture's squared error alone: no error of the references is left but by chance. With the variance v
    /// of a reference, of which (a - b)² / 2 is an estimate, a product has by chance a variance of 2 v times the
    /// picture's squared error, and v² for the product of both. Of a normal error, the squared estimate of v is 3 v². The
    /// channels of a pixel are taken to err together.
    pub fn error(&self, image: &LinearImage) -> [f64; 2] {
        let [a, b] = &self.references;
        let pixels = image.pixels.iter().zip(&a.pixels).zip(&b.pixels);
        let [sum, chance] = pixels.fold([0.0; 2], |[mut sum, chance], ((x, a), b)| {
            let mut deviation = 0.0;
            for channel in 0..3 {
                let [x, a, b] = [x, a, b].map(|pixel| srgb(pixel[channel]));
                let product = (x - a) * (x - b);
                let variance = 0.5 * (a - b) * (a - b);
                deviation += (2.0 * variance * product.max(0.0) + variance * variance / 3.0).sqrt();
                sum += product;
            }
            [sum, chance + deviation * deviation]
        });
        let mean = sum.max(0.0) / (3 * image.pixels.len()) as f64;
        [mean.sqrt(), chance.sqrt() / sum.max(0.0)]
    }

    /// Adaptive sampling with `settings` beside uniform sampling.
    pub fn compare(&mut self, settings: RenderSettings) -> Comparison {
        let rendering = self.rendered(settings);
        let [error, uncertainty] = self.error(&rendering.image);
        Comparison {
            samples: rendering.ledger.camera_rays() as f64 / rendering.image.pixels.len() as f64,
            error,
            uncertainty,
            uniform: self.uniform_spp(error, settings.spp),
        }
    }

    /// The uniform number of samples that has this error, by the power law between the measured powers of two.
    fn uniform_spp(&mut self, error: f64, most: u32) -> f64 {
        while self.uniform.len() < 2 || self.uniform.last().is_some_and(|last| last.1 > error) {
            let spp = 16 << self.uniform.len();
            if spp > most {
                break;
            }
            let settings = RenderSettings { spp, ..self.settings };
            let [error, _] = self.error(&self.rendered(settings).image);
            self.uniform.push((f64::from(spp), error));
        }
        let curve = &self.uniform;
        let at = curve.windows(2).find(|pair| pair[1].1 <= error);
        let [(n0, e0), (n1, e1)] =
            at.map_or([curve[curve.len() - 2], curve[curve.len() - 1]], |p| [p[0], p[1]]);
        let slope = (n1 / n0).ln() / (e1 / e0).ln();
        n0 * ((error / e0).ln() * slope).exp()
    }
}

/// What adaptive sampling took.
pub struct Comparison {
    /// Of the camera, for each pixel.
    pub samples: f64,
    /// As [`Judge::error`] tells.
    pub error: f64,
    /// Of the error's square, as a part of it.
    pub uncertainty: f64,
    /// How many uniform samples have the same error.
    pub uniform: f64,
}

fn srgb(radiance: f32) -> f64 {
    let radiance = f64::from(radiance).clamp(0.0, 1.0);
    if radiance <= 0.003_130_8 {
        12.92 * radiance
    } else {
        1.055 * radiance.powf(1.0 / 2.4) - 0.055
    }
}
