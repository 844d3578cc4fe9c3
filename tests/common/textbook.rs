//! The referee: the lecture's recursion, as plainly as it is written on the board, in f64 over brute force.
//!
//! I(P) = emission + ambient + Σ over visible lights (diffuse + specular) + Fs · I(reflected).
//!
//! It shares no code with the renderer and reads nothing but the scene's plain data. Beside each radiance it gives a
//! bound on how far an honest f32 computation may be from it (see [`super::approx`]), and the least certain decision
//! on the way, on which a picture may jump (see [`super::hits`]).

use rayon::prelude::*;
use whit::scene::{Camera, Falloff, Light, LightKind, Scene};

use super::approx::{Approx, Approx3, ROUNDING};
use super::hits::{Decision, Doubt, Found, Ray, World};
use super::surface::Surface;

/// What is asked for.
#[derive(Clone, Copy, Debug)]
pub struct Request {
    pub width: u32,
    pub height: u32,
    pub spp: u32,
    pub depth: u32,
    pub weight_cutoff: f32,
}

/// The referee's answer for a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Pixel {
    /// Linear RGB, with the bound on the error of an f32 computation.
    pub radiance: Approx3,
    /// The least certain decision of all samples.
    pub doubt: Doubt,
}

/// The lecture's ray tracer.
pub struct Textbook<'s> {
    world: World<'s>,
    request: Request,
}

/// The picture of `scene`, top row first.
pub fn picture(scene: &Scene, camera: &Camera, request: Request) -> Vec<Pixel> {
    let textbook = Textbook {
        world: World::new(scene),
        request,
    };
    (0..request.width * request.height)
        .into_par_iter()
        .map(|index| textbook.pixel(camera, index % request.width, index / request.width))
        .collect()
}

impl Textbook<'_> {
    /// The mean of the samples of pixel (`i`, `j`).
    fn pixel(&self, camera: &Camera, i: u32, j: u32) -> Pixel {
        let Request {
            width,
            height,
            spp,
            depth,
            ..
        } = self.request;
        let view = camera.view(width, height);
        let mut doubt = Doubt::NONE;
        let (mut sum, mut error) = (glam::DVec3::ZERO, glam::DVec3::ZERO);
        for sample in 0..spp {
            let shift = |ratio: f64| (0.5 + f64::from(sample) * ratio).fract();
            let x = (f64::from(i) + shift(0.754_877_666_246_692_7)) / f64::from(width);
            let y = (f64::from(j) + shift(0.569_840_290_998_053_2)) / f64::from(height);
            let seen = view.ray(x, y);
            // From here on the ray is what f32 holds of it.
            let ray = Ray {
                origin: Approx3::exact(seen.origin.as_vec3().as_dvec3()),
                direction: Approx3::exact(seen.direction.as_vec3().as_dvec3()),
                t_near: f64::from(seen.t_near as f32),
                t_far: f64::from(seen.t_far as f32),
                leaves: None,
            };
            let radiance = self.radiance(&ray, depth, Approx3::ONE, &mut doubt);
            sum += radiance.value();
            error += radiance.error();
        }
        // Samples are summed in f64; the mean is rounded once.
        let mean = sum / f64::from(spp);
        let radiance = Approx3::exact(mean).widened(error / f64::from(spp) + ROUNDING * mean.abs());
        if !radiance.error().is_finite() {
            doubt.note(Decision::Value, 0.0);
        }
        Pixel { radiance, doubt }
    }

    /// I(P): the radiance that comes back along `ray`, of which `weight` reaches the film.
    fn radiance(&self, ray: &Ray, depth: u32, weight: Approx3, doubt: &mut Doubt) -> Approx3 {
        let ambient = Approx3::exact_f32(self.world.scene.ambient);
        let Some(found) = self.world.nearest(ray, doubt) else {
            return ambient;
        };
        let surface = Surface::new(&self.world, ray, &found, doubt);
        // A mirror shows its surroundings itself.
        let glossy = if surface.is_mirror {
            Approx3::ZERO
        } else {
            surface.f0
        };
        let mut sum = surface.emission + ambient * (surface.c_diff + glossy);
        for light in &self.world.scene.lights {
            sum = sum + self.direct(&surface, &found, light, doubt);
        }
        if surface.is_mirror && depth > 0 {
            sum = sum + self.reflected(&surface, &found, depth, weight, doubt);
        }
        sum
    }

    /// What one light adds, if nothing stands in its way.
    fn direct(&self, surface: &Surface, found: &Found, light: &Light, doubt: &mut Doubt) -> Approx3 {
        let Arriving { wi, attenuation } = arriving(light, surface.p);
        let cos = surface.ns.dot(wi).positive_part();
        let irradiance = Approx3::exact_f32(light.intensity) * (attenuation * cos);
        let surely_dark = irradiance.value() + irradiance.error() == glam::DVec3::ZERO;
        if surely_dark || !surface.rises(wi, doubt) {
            return Approx3::ZERO;
        }
        let feeler = Ray {
            origin: surface.start,
            direction: toward(light, surface.start),
            t_near: 0.0,
            t_far: match light.kind {
                LightKind::Directional { .. } => f64::INFINITY,
                LightKind::Point { .. } | LightKind::Spot { .. } => 1.0,
            },
            leaves: Some((found.instance, found.primitive)),
        };
        if self.world.blocked(&feeler, doubt) {
            return Approx3::ZERO;
        }
        surface.lobe(wi) * irradiance
    }

    /// Fs · I(reflected).
    fn reflected(
        &self,
        surface: &Surface,
        found: &Found,
        depth: u32,
        weight: Approx3,
        doubt: &mut Doubt,
    ) -> Approx3 {
        let cos = surface.ns.dot(surface.wo);
        let direction = surface.ns * (cos + cos) - surface.wo;
        if !surface.rises(direction, doubt) {
            return Approx3::ZERO;
        }
        let share = surface.fresnel(cos);
        let weight = weight * share;
        let above = weight.max_element() - Approx::exact(f64::from(self.request.weight_cutoff));
        doubt.note(Decision::Cutoff, above.slack());
        if above.value < 0.0 {
            return Approx3::ZERO;
        }
        let ray = Ray {
            origin: surface.start,
            direction,
            t_near: 0.0,
            t_far: f64::INFINITY,
            leaves: Some((found.instance, found.primitive)),
        };
        share * self.radiance(&ray, depth - 1, weight, doubt)
    }
}

/// Light as it comes to a point.
struct Arriving {
    /// To the light; unit.
    wi: Approx3,
    /// What is left of the intensity, the cosine of the surface not counted.
    attenuation: Approx,
}

/// Unnormalised way from `p` to the light.
fn toward(light: &Light, p: Approx3) -> Approx3 {
    match light.kind {
        LightKind::Directional { to_light } => Approx3::rounded(to_light),
        LightKind::Point { position, .. } | LightKind::Spot { position, .. } => {
            Approx3::rounded(position) - p
        }
    }
}

/// `KHR_lights_punctual`.
fn arriving(light: &Light, p: Approx3) -> Arriving {
    let way = toward(light, p);
    let wi = way.normalize();
    let by_distance = |falloff: Falloff| {
        let square = way.dot(way);
        let range = match falloff {
            Falloff::InverseSquare { range } => range,
            Falloff::Polynomial {
                constant,
                linear,
                quadratic,
            } => {
                let distance = square.sqrt();
                let [constant, linear, quadratic] = [constant, linear, quadratic].map(Approx::rounded);
                return Approx::ONE / (constant + distance * linear + square * quadratic);
            }
        };
        let window = range.map_or(Approx::ONE, |range| {
            let ratio = square / Approx::rounded(range).squared();
            (1.0 - ratio.squared()).clamp(0.0, 1.0)
        });
        window / square
    };
    let attenuation = match light.kind {
        LightKind::Directional { .. } => Approx::ONE,
        LightKind::Point { falloff, .. } => by_distance(falloff),
        LightKind::Spot {
            direction,
            cos_inner,
            cos_outer,
            falloff,
            ..
        } => {
            let cos = -Approx3::rounded(direction).dot(wi);
            let ramp = Approx::rounded((cos_inner - cos_outer).max(0.001));
            let part = ((cos - Approx::rounded(cos_outer)) / ramp).clamp(0.0, 1.0);
            by_distance(falloff) * part.squared()
        }
    };
    Arriving { wi, attenuation }
}
