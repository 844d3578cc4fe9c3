//! Reference tracer: Whitted's recursion, as plainly as in the literature, in f64 over brute force.
//!
//! I(P) = emission + ambient + Σ over visible lights (diffuse + specular) + kr · I(reflected) + kt · I(transmitted).
//!
//! It shares no code with the renderer and reads only the scene's plain data. With each radiance it returns a bound on
//! the error of an f32 computation (see [`super::approx`]), and the least certain decision on the way, at which an
//! image may be discontinuous (see [`super::hits`]).

use glam::DVec3;
use rayon::prelude::*;
use whit::optics::{LINE_D, SpectralSampler};
use whit::scene::{AlphaMode, Background, Camera, Falloff, Light, LightKind, Scene};

use super::approx::{Approx, Approx3, HOPELESS, ROUNDING};
use super::bodies::{Bodies, Boundary, Division, Incidence, disperses};
use super::cones::Cone;
use super::hits::{Decision, Doubt, Found, Ray, World};
use super::surface::Surface;

/// Image size and sampling that the reference tracer renders with.
#[derive(Clone, Copy, Debug)]
pub struct Request {
    pub width: u32,
    pub height: u32,
    pub spp: u32,
    pub depth: u32,
    pub weight_cutoff: f32,
    pub wavelengths: u32,
}

/// Result of the reference tracer for a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Pixel {
    /// Linear RGB, with the bound on the error of an f32 computation.
    pub radiance: Approx3,
    /// Least certain decision of all samples.
    pub doubt: Doubt,
}

/// Whitted-style reference ray tracer.
pub struct Textbook<'s> {
    world: World<'s>,
    request: Request,
    spectrum: SpectralSampler,
    /// True if any surface transmits light.
    is_clear: bool,
}

/// State of a path before its next hit.
#[derive(Clone)]
struct Path {
    /// Number of reflections and refractions that may still follow.
    depth: u32,
    /// Throughput from this vertex to the film.
    weight: Approx3,
    /// Wavelength of the path in nanometres, once dispersion has split it.
    wavelength: Option<f64>,
    /// Dielectric interiors around the origin.
    bodies: Bodies,
}

/// Renders `scene`, top row first.
pub fn reference_image(scene: &Scene, camera: &Camera, request: Request) -> Vec<Pixel> {
    let textbook = Textbook {
        world: World::new(scene),
        request,
        spectrum: SpectralSampler::new(request.wavelengths as usize),
        is_clear: scene
            .materials
            .iter()
            .any(|m| m.transmits() || m.alpha != AlphaMode::Opaque),
    };
    (0..request.width * request.height)
        .into_par_iter()
        .map(|index| textbook.pixel(camera, index % request.width, index / request.width))
        .collect()
}

impl Textbook<'_> {
    /// Returns the mean of the samples of pixel (`i`, `j`).
    fn pixel(&self, camera: &Camera, i: u32, j: u32) -> Pixel {
        let Request {
            width,
            height,
            spp,
            depth,
            ..
        } = self.request;
        // Set up the ray cone and the interiors around the camera
        let view = camera.view(width, height);
        let cone = Cone::of_sample(&view, [width, height], spp);
        let bodies = Bodies::around(self.world.scene, view.ray(0.5, 0.5).origin);
        let mut doubt = Doubt::NONE;
        let (mut sum, mut error) = (DVec3::ZERO, DVec3::ZERO);
        // Sum the samples, placed by a Kronecker sequence
        for sample in 0..spp {
            let shift = |ratio: f64| (0.5 + f64::from(sample) * ratio).fract();
            let x = (f64::from(i) + shift(0.754_877_666_246_692_7)) / f64::from(width);
            let y = (f64::from(j) + shift(0.569_840_290_998_053_2)) / f64::from(height);
            let seen = view.ray(x, y);
            // From here on the ray is rounded to f32.
            let ray = Ray {
                origin: Approx3::exact(seen.origin.as_vec3().as_dvec3()),
                direction: Approx3::exact(seen.direction.as_vec3().as_dvec3()),
                t_near: Approx::exact(f64::from(seen.t_near as f32)),
                t_far: f64::from(seen.t_far as f32),
                leaves: None,
                cone,
            };
            let path = Path {
                depth,
                weight: Approx3::ONE,
                wavelength: None,
                bodies: bodies.clone(),
            };
            let radiance = self.radiance(&ray, path, &mut doubt);
            sum += radiance.value();
            error += radiance.error();
        }
        // Samples are summed in f64; the mean is rounded once.
        let mean = sum / f64::from(spp);
        let error = error / f64::from(spp) + ROUNDING * mean.abs();
        // Mark values without a usable bound as unknown
        let error = DVec3::select(error.cmplt(DVec3::splat(HOPELESS)), error, DVec3::INFINITY);
        let radiance = Approx3::exact(mean).widened(error);
        if !radiance.error().is_finite() {
            doubt.note(Decision::Value, 0.0);
        }
        Pixel { radiance, doubt }
    }

    /// Returns I(P): the incident radiance along `ray`.
    fn radiance(&self, ray: &Ray, path: Path, doubt: &mut Doubt) -> Approx3 {
        let scene = self.world.scene;
        let found = self.world.nearest(ray, doubt);
        let way = found.map(|found| (found.t - ray.t_near) * ray.direction.length());
        let left = path.bodies.transmittance(scene, way);
        let Some(found) = found else {
            return left * background(scene, ray.direction);
        };
        let surface = Surface::new(&self.world, ray, &found, doubt);
        let interaction = Interaction {
            boundary: self.boundary(&surface, &found, &path.bodies),
            path: Path {
                weight: path.weight * left,
                ..path
            },
            ray,
            surface,
            found,
        };
        left * self.partly_there(&interaction, doubt)
    }

    fn boundary(&self, surface: &Surface, found: &Found, bodies: &Bodies) -> Boundary<'_> {
        let scene = self.world.scene;
        let material = scene.instances[found.instance as usize].material;
        bodies.boundary(scene, material, surface.is_outside)
    }

    /// Blends a surface and the radiance behind it by its alpha coverage.
    fn partly_there(&self, interaction: &Interaction, doubt: &mut Doubt) -> Approx3 {
        // A hidden boundary has no coverage
        let coverage = if interaction.boundary.is_hidden {
            Approx::ZERO
        } else {
            interaction.surface.coverage
        };
        let with = |share: Approx, bodies: &Bodies| Path {
            weight: interaction.path.weight * share,
            bodies: bodies.clone(),
            ..interaction.path
        };
        let is_some = |share: Approx| share.value != 0.0 || share.error != 0.0;
        let gap = if coverage.error == 0.0 {
            Approx::exact(1.0 - coverage.value)
        } else {
            1.0 - coverage
        };
        // Add the radiance behind the surface
        let mut sum = Approx3::ZERO;
        if is_some(gap) {
            let behind = with(gap, &interaction.boundary.through);
            if self.matters(behind.weight, doubt) {
                let ray = interaction.ray.beyond(&interaction.found);
                sum = sum + self.radiance(&ray, behind, doubt) * gap;
            }
        }
        // Add the radiance of the surface
        if is_some(coverage) {
            let here = with(coverage, &interaction.path.bodies);
            sum = sum + self.shaded(interaction, &here, doubt) * coverage;
        }
        sum
    }

    /// Evaluates Whitted's sum at a hit.
    fn shaded(&self, interaction: &Interaction, path: &Path, doubt: &mut Doubt) -> Approx3 {
        let scene = self.world.scene;
        let surface = &interaction.surface;
        let mut sum = surface.emission + Approx3::exact_f32(scene.ambient) * surface.ambient;
        for light in &scene.lights {
            sum = sum + self.direct(interaction, light, doubt);
        }
        if path.depth > 0 {
            sum = sum
                + if surface.lets_through() {
                    self.divided(interaction, path, doubt)
                } else {
                    self.mirrored(interaction, path, doubt)
                };
        }
        sum
    }

    /// Returns the reflected light of one source, tinted by transmissive occluders.
    fn direct(&self, interaction: &Interaction, light: &Light, doubt: &mut Doubt) -> Approx3 {
        let surface = &interaction.surface;
        let Arriving { wi, attenuation } = arriving(light, surface.p);
        let cos = surface.ns.dot(wi).positive_part();
        let intensity = Approx3::exact_f32(light.intensity) * attenuation;
        let irradiance = intensity * cos;
        let surely_dark = irradiance.value() + irradiance.error() == DVec3::ZERO;
        if surely_dark || !surface.rises(wi, doubt) {
            return Approx3::ZERO;
        }
        let shadow_ray = Ray {
            origin: surface.start,
            direction: toward(light, surface.start),
            t_near: Approx::ZERO,
            t_far: match light.kind {
                LightKind::Directional { .. } => f64::INFINITY,
                LightKind::Point { .. } | LightKind::Spot { .. } => 1.0,
                LightKind::Area { .. } => unreachable!("{NO_EXTENT}"),
            },
            leaves: Some(interaction.found.left()),
            cone: Cone::NONE,
        };
        let response = surface.response(wi, cos, doubt);
        if response.value() + response.error() == DVec3::ZERO {
            return Approx3::ZERO;
        }
        response * intensity * self.reaching(shadow_ray, &interaction.path.bodies, doubt)
    }

    /// Returns the transmittance along a shadow ray. It passes straight through transmissive surfaces.
    fn reaching(&self, mut shadow_ray: Ray, bodies: &Bodies, doubt: &mut Doubt) -> Approx3 {
        // Test plain occlusion if no surface transmits light
        if !self.is_clear {
            let blocked = self.world.blocked(&shadow_ray, doubt);
            return if blocked { Approx3::ZERO } else { Approx3::ONE };
        }
        // Return early if an opaque surface surely occludes the ray
        let scene = self.world.scene;
        let stops = |instance: u32| {
            let material = &scene.materials[scene.instances[instance as usize].material as usize];
            !material.transmits() && material.alpha == AlphaMode::Opaque
        };
        if self.world.surely_blocked(&shadow_ray, stops) {
            return Approx3::ZERO;
        }
        // Follow the shadow ray through transmissive surfaces
        let length = shadow_ray.direction.length();
        let mut bodies = bodies.clone();
        let mut left = Approx3::ONE;
        while left.value() + left.error() != DVec3::ZERO {
            let Some(found) = self.world.nearest(&shadow_ray, doubt) else {
                let way = (Approx::exact(shadow_ray.t_far) - shadow_ray.t_near) * length;
                let way = shadow_ray.t_far.is_finite().then_some(way);
                return left * bodies.transmittance(scene, way);
            };
            let way = (found.t - shadow_ray.t_near) * length;
            let surface = Surface::new(&self.world, &shadow_ray, &found, doubt);
            let boundary = self.boundary(&surface, &found, &bodies);
            left = left * bodies.transmittance(scene, Some(way));
            if !boundary.is_hidden {
                let passes = self.passing(&surface, &boundary, &shadow_ray, doubt);
                left = left * (Approx3::ONE - (Approx3::ONE - passes) * surface.coverage);
            }
            bodies = boundary.through;
            shadow_ray = shadow_ray.beyond(&found);
        }
        Approx3::ZERO
    }

    /// Returns the transmittance of a boundary for a shadow ray, without dispersion.
    fn passing(
        &self,
        surface: &Surface,
        boundary: &Boundary,
        shadow_ray: &Ray,
        doubt: &mut Doubt,
    ) -> Approx3 {
        if !surface.lets_through() {
            return Approx3::ZERO;
        }
        let incidence = Incidence::new(shadow_ray.direction.normalize(), surface.ns);
        let division = boundary.division(self.world.scene, &incidence, LINE_D, doubt);
        shares(surface, &division)[1]
    }

    /// Returns kr · I(reflected) of an opaque surface.
    fn mirrored(&self, interaction: &Interaction, path: &Path, doubt: &mut Doubt) -> Approx3 {
        let surface = &interaction.surface;
        let cos = surface.ns.dot(surface.wo);
        let Some(share) = surface.mirror_share(cos) else {
            return Approx3::ZERO;
        };
        let direction = surface.ns * (cos + cos) - surface.wo;
        if !surface.rises(direction, doubt) {
            return Approx3::ZERO;
        }
        self.followed(
            interaction,
            (direction, surface.cone.mirrored(surface.curvature)),
            share,
            path.clone(),
            doubt,
        )
    }

    /// Returns kr · I(reflected) + kt · I(transmitted) of a transmissive surface.
    fn divided(&self, interaction: &Interaction, path: &Path, doubt: &mut Doubt) -> Approx3 {
        let scene = self.world.scene;
        let Interaction {
            surface, boundary, ..
        } = interaction;
        let incidence = Incidence::new(-surface.wo, surface.ns);
        let (mut sum, mut reflected) = (Approx3::ZERO, Approx3::ZERO);
        // Add refracted radiance for each wavelength
        for (color, wavelength) in self.colors(boundary, path) {
            let nanometres = wavelength.unwrap_or(LINE_D);
            let division = boundary.division(scene, &incidence, nanometres, doubt);
            let [up, down] = shares(surface, &division);
            reflected = reflected + color * up;
            if division.is_total {
                continue;
            }
            let etas = boundary.etas(scene, nanometres);
            let Some(direction) = sunk(interaction, &incidence, etas, doubt) else {
                continue;
            };
            let path = Path {
                wavelength,
                bodies: boundary.through.clone(),
                ..path.clone()
            };
            let cone = surface
                .cone
                .refracted(etas, incidence.cosines(direction), surface.curvature);
            sum = sum + self.followed(interaction, (direction, cone), color * down, path, doubt);
        }
        // Add reflected radiance
        if surface.is_smooth {
            let mut direction = incidence.mirrored();
            if !surface.rises(direction, doubt) {
                direction = Incidence::new(incidence.d, surface.ng).mirrored();
            }
            let cone = surface.cone.mirrored(surface.curvature);
            sum = sum + self.followed(interaction, (direction, cone), reflected, path.clone(), doubt);
        }
        sum
    }

    /// Returns the wavelengths that a path follows behind a boundary, each with its fraction of white: several if
    /// dispersion splits it there.
    fn colors(&self, boundary: &Boundary, path: &Path) -> Vec<(Approx3, Option<f64>)> {
        let splits = path.wavelength.is_none()
            && !boundary.is_wall()
            && boundary
                .sides
                .iter()
                .any(|&side| disperses(self.world.scene, side));
        if !splits {
            return vec![(Approx3::ONE, path.wavelength)];
        }
        let weights = self.spectrum.weights().iter().enumerate();
        weights
            .map(|(i, &weight)| (Approx3::exact_f32(weight), Some(self.spectrum.wavelength(i, 0.5))))
            .collect()
    }

    /// Returns share · I(followed), or zero below the cut-off.
    fn followed(
        &self,
        interaction: &Interaction,
        (direction, cone): (Approx3, Cone),
        share: Approx3,
        path: Path,
        doubt: &mut Doubt,
    ) -> Approx3 {
        let path = Path {
            depth: path.depth - 1,
            weight: path.weight * share,
            ..path
        };
        if !self.matters(path.weight, doubt) {
            return Approx3::ZERO;
        }
        let ray = Ray {
            origin: interaction.surface.start,
            direction,
            t_near: Approx::ZERO,
            t_far: f64::INFINITY,
            leaves: Some(interaction.found.left()),
            cone,
        };
        share * self.radiance(&ray, path, doubt)
    }

    /// Returns whether a path of this throughput is above the cut-off.
    fn matters(&self, weight: Approx3, doubt: &mut Doubt) -> bool {
        let largest = weight.largest();
        if largest.value + largest.error == 0.0 {
            return false;
        }
        let above = largest - Approx::exact(f64::from(self.request.weight_cutoff));
        doubt.note(Decision::Cutoff, above.slack());
        above.value >= 0.0
    }
}

/// Hit of a path with its surface and boundary.
struct Interaction<'s> {
    ray: &'s Ray,
    found: Found,
    surface: Surface,
    boundary: Boundary<'s>,
    /// Path state with the throughput at the hit.
    path: Path,
}

/// Returns kr and kt of a surface whose boundary divides light in this way. Without Fresnel's equations they hold at
/// all angles up to total reflection, which gets the sum of both.
fn shares(surface: &Surface, division: &Division) -> [Approx3; 2] {
    let (up, down) = (surface.reflected_tint, surface.tint);
    match (surface.obeys_fresnel, division.is_total) {
        (true, _) => [up * division.reflectance, down * division.transmittance],
        (false, false) => [up, down],
        (false, true) => {
            let all = (up + down).to_array().map(|v| v.clamp(0.0, 1.0));
            [Approx3::from(all), Approx3::ZERO]
        }
    }
}

/// Returns the refracted direction. If an interpolated normal would keep it on the incident side, the geometric normal
/// is used instead.
fn sunk(
    interaction: &Interaction,
    incidence: &Incidence,
    etas: [Approx; 2],
    doubt: &mut Doubt,
) -> Option<Approx3> {
    if interaction.boundary.is_wall() {
        return Some(incidence.d);
    }
    let bent = incidence.refracted(etas, doubt)?;
    if interaction.surface.rises(bent, doubt) {
        return Incidence::new(incidence.d, interaction.surface.ng).refracted(etas, doubt);
    }
    Some(bent)
}

/// Returns the background radiance in a direction of any length.
fn background(scene: &Scene, direction: Approx3) -> Approx3 {
    match scene.background {
        Background::Uniform(color) => Approx3::exact_f32(color),
        Background::Environment { .. } => unreachable!("the reference tracer has no environment maps"),
        Background::Gradient { horizon, up, down } => {
            let height = direction.normalize().y;
            let pole = if height.value < 0.0 { down } else { up };
            let [level, pole] = [horizon, pole].map(Approx3::exact_f32);
            level + (pole - level) * height.abs()
        }
    }
}

/// Incident light of a source at a point.
struct Arriving {
    /// Unit direction to the light.
    wi: Approx3,
    /// Attenuation of the intensity, without the cosine at the surface.
    attenuation: Approx,
}

/// Message for area lights, which need random numbers.
const NO_EXTENT: &str = "the reference tracer has no area lights";

/// Returns the unnormalised vector from `p` to the light.
fn toward(light: &Light, p: Approx3) -> Approx3 {
    match light.kind {
        LightKind::Directional { to_light } => Approx3::rounded(to_light),
        LightKind::Point { position, .. } | LightKind::Spot { position, .. } => {
            Approx3::rounded(position) - p
        }
        LightKind::Area { .. } => unreachable!("{NO_EXTENT}"),
    }
}

/// Returns the incident light by `KHR_lights_punctual`.
fn arriving(light: &Light, p: Approx3) -> Arriving {
    let way = toward(light, p);
    let wi = way.normalize();
    // Attenuate by distance
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
    // Attenuate by the kind of light
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
        LightKind::Area { .. } => unreachable!("{NO_EXTENT}"),
    };
    Arriving { wi, attenuation }
}
