//! Image error relative to a converged image, estimated with two independent references.

use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::image::LinearImage;
use whit::render::{Monitor, Pattern, RenderSettings, Rendering, render};
use whit::scene::Scene;

/// Scene with two reference images of many samples, whose errors are independent of each other and of any pattern under
/// test.
pub struct Judge<'s> {
    scene: &'s Scene,
    accel: Box<dyn Accel + 's>,
    /// Settings that all images share.
    settings: RenderSettings,
    references: [LinearImage; 2],
    /// Measured errors of 16, 32, ... uniform samples, extended on demand.
    uniform: Vec<(f64, f64)>,
}

impl<'s> Judge<'s> {
    /// Renders the references; `side` is the root of the number of samples of each, or nearly.
    pub fn new(scene: &'s Scene, backend: Backend, settings: RenderSettings, side: u32) -> Judge<'s> {
        let accel = accel::build(scene.validate().unwrap(), backend, &AccelOptions::default()).unwrap();
        let mut judge = Judge {
            scene,
            accel,
            settings,
            references: [LinearImage::default(), LinearImage::default()],
            uniform: Vec::new(),
        };
        // Use jittered samples, so that no sequence under test is a part of them; different grids and seeds give
        // independent samples of pixels, lenses and lights.
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
        let monitor = Monitor::default();
        render(
            self.scene.validate().unwrap(),
            &self.scene.cameras[0],
            &*self.accel,
            &settings,
            &monitor,
        )
        .unwrap()
    }

    /// Returns the root mean square error of sRGB values, black 0 and white 1, and the uncertainty of its square due to
    /// the references, as a fraction of it.
    ///
    /// With x the image, a and b the references, each the truth plus an independent error, the mean of (x - a)(x - b)
    /// is the mean of the image's squared error: errors of the references remain only by chance. With the variance v of
    /// a reference, estimated by (a - b)² / 2, a product has a variance of 2 v times the image's squared error, and v²
    /// for the product of both. For a normal error, the expected squared estimate of v is 3 v². The channels of a pixel
    /// are taken as fully correlated.
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

    /// Compares adaptive sampling with `settings` to uniform sampling.
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

    /// Returns the uniform number of samples with this error, by the power law between the measured powers of two.
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

/// Samples and error of adaptive sampling, with the equivalent uniform samples.
pub struct Comparison {
    /// Camera samples per pixel, on average.
    pub samples: f64,
    /// Error as returned by [`Judge::error`].
    pub error: f64,
    /// Uncertainty of the squared error, as a fraction of it.
    pub uncertainty: f64,
    /// Number of uniform samples per pixel with equal error.
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
