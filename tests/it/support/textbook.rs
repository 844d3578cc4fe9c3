//! The referee: the lecture's recursion, as plainly as it is written on the board, in f64 over brute force.
//!
//! I(P) = emission + ambient + Σ over visible lights (diffuse + specular) + kr · I(reflected) + kt · I(transmitted).
//!
//! It shares no code with the renderer and reads nothing but the scene's plain data. Beside each radiance it gives a
//! bound on how far an honest f32 computation may be from it (see [`super::approx`]), and the least certain decision
//! on the way, on which a picture may jump (see [`super::hits`]).

use glam::DVec3;
use rayon::prelude::*;
use whit::optics::{LINE_D, SpectralSampler};
use whit::scene::{AlphaMode, Background, Camera, Falloff, Light, LightKind, Scene};

use super::approx::{Approx, Approx3, HOPELESS, ROUNDING};
use super::bodies::{Bodies, Boundary, Division, Incidence, disperses};
use super::cones::Cone;
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
    pub wavelengths: u32,
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
    spectrum: SpectralSampler,
    /// Whether light goes through any surface.
    is_clear: bool,
}

/// What a ray has behind it.
#[derive(Clone)]
struct Path {
    /// Reflections and refractions that may still follow.
    depth: u32,
    /// How much of what it sees reaches the film.
    weight: Approx3,
    /// The wavelength that it follows, nanometres, once it has been split.
    wavelength: Option<f64>,
    /// The bodies around it.
    bodies: Bodies,
}

/// The picture of `scene`, top row first.
pub fn picture(scene: &Scene, camera: &Camera, request: Request) -> Vec<Pixel> {
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
        let cone = Cone::of_sample(&view, [width, height], spp);
        let bodies = Bodies::around(self.world.scene, view.ray(0.5, 0.5).origin);
        let mut doubt = Doubt::NONE;
        let (mut sum, mut error) = (DVec3::ZERO, DVec3::ZERO);
        for sample in 0..spp {
            let shift = |ratio: f64| (0.5 + f64::from(sample) * ratio).fract();
            let x = (f64::from(i) + shift(0.754_877_666_246_692_7)) / f64::from(width);
            let y = (f64::from(j) + shift(0.569_840_290_998_053_2)) / f64::from(height);
            let seen = view.ray(x, y);
            // From here on the ray is what f32 holds of it.
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
        let error = DVec3::select(error.cmplt(DVec3::splat(HOPELESS)), error, DVec3::INFINITY);
        let radiance = Approx3::exact(mean).widened(error);
        if !radiance.error().is_finite() {
            doubt.note(Decision::Value, 0.0);
        }
        Pixel { radiance, doubt }
    }

    /// I(P): the radiance that comes back along `ray`.
    fn radiance(&self, ray: &Ray, path: Path, doubt: &mut Doubt) -> Approx3 {
        let scene = self.world.scene;
        let found = self.world.nearest(ray, doubt);
        let way = found.map(|found| (found.t - ray.t_near) * ray.direction.length());
        let left = path.bodies.transmittance(scene, way);
        let Some(found) = found else {
            return left * background(scene, ray.direction);
        };
        let surface = Surface::new(&self.world, ray, &found, doubt);
        let meeting = Meeting {
            boundary: self.boundary(&surface, &found, &path.bodies),
            path: Path {
                weight: path.weight * left,
                ..path
            },
            ray,
            surface,
            found,
        };
        left * self.partly_there(&meeting, doubt)
    }

    fn boundary(&self, surface: &Surface, found: &Found, bodies: &Bodies) -> Boundary<'_> {
        let scene = self.world.scene;
        let material = scene.instances[found.instance as usize].material;
        bodies.boundary(scene, material, surface.is_outside)
    }

    /// A surface and what is behind it, by how much of it is there.
    fn partly_there(&self, meeting: &Meeting, doubt: &mut Doubt) -> Approx3 {
        let coverage = if meeting.boundary.is_hidden {
            Approx::ZERO
        } else {
            meeting.surface.coverage
        };
        let with = |share: Approx, bodies: &Bodies| Path {
            weight: meeting.path.weight * share,
            bodies: bodies.clone(),
            ..meeting.path
        };
        let is_some = |share: Approx| share.value != 0.0 || share.error != 0.0;
        let gap = if coverage.error == 0.0 {
            Approx::exact(1.0 - coverage.value)
        } else {
            1.0 - coverage
        };
        let mut sum = Approx3::ZERO;
        if is_some(gap) {
            let behind = with(gap, &meeting.boundary.through);
            if self.matters(behind.weight, doubt) {
                let ray = meeting.ray.beyond(&meeting.found);
                sum = sum + self.radiance(&ray, behind, doubt) * gap;
            }
        }
        if is_some(coverage) {
            let here = with(coverage, &meeting.path.bodies);
            sum = sum + self.shaded(meeting, &here, doubt) * coverage;
        }
        sum
    }

    /// The lecture's sum.
    fn shaded(&self, meeting: &Meeting, path: &Path, doubt: &mut Doubt) -> Approx3 {
        let scene = self.world.scene;
        let surface = &meeting.surface;
        let mut sum = surface.emission + Approx3::exact_f32(scene.ambient) * surface.ambient;
        for light in &scene.lights {
            sum = sum + self.direct(meeting, light, doubt);
        }
        if path.depth > 0 {
            sum = sum
                + if surface.lets_through() {
                    self.divided(meeting, path, doubt)
                } else {
                    self.mirrored(meeting, path, doubt)
                };
        }
        sum
    }

    /// What one light adds, in the colour of what stands in its way.
    fn direct(&self, meeting: &Meeting, light: &Light, doubt: &mut Doubt) -> Approx3 {
        let surface = &meeting.surface;
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
            leaves: Some(meeting.found.left()),
            cone: Cone::NONE,
        };
        let answer = surface.answer(wi, cos, doubt);
        if answer.value() + answer.error() == DVec3::ZERO {
            return Approx3::ZERO;
        }
        answer * intensity * self.reaching(shadow_ray, &meeting.path.bodies, doubt)
    }

    /// What is left of the light at the end of a shadow ray. It goes straight on through whatever lets light through.
    fn reaching(&self, mut shadow_ray: Ray, bodies: &Bodies, doubt: &mut Doubt) -> Approx3 {
        if !self.is_clear {
            let blocked = self.world.blocked(&shadow_ray, doubt);
            return if blocked { Approx3::ZERO } else { Approx3::ONE };
        }
        let scene = self.world.scene;
        let stops = |instance: u32| {
            let material = &scene.materials[scene.instances[instance as usize].material as usize];
            !material.transmits() && material.alpha == AlphaMode::Opaque
        };
        if self.world.surely_blocked(&shadow_ray, stops) {
            return Approx3::ZERO;
        }
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

    /// What a boundary lets pass of a shadow ray's light, which is not split into colours.
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

    /// kr · I(reflected), of what lets no light through.
    fn mirrored(&self, meeting: &Meeting, path: &Path, doubt: &mut Doubt) -> Approx3 {
        let surface = &meeting.surface;
        let cos = surface.ns.dot(surface.wo);
        let Some(share) = surface.mirror_share(cos) else {
            return Approx3::ZERO;
        };
        let direction = surface.ns * (cos + cos) - surface.wo;
        if !surface.rises(direction, doubt) {
            return Approx3::ZERO;
        }
        self.followed(
            meeting,
            (direction, surface.cone.mirrored(surface.curvature)),
            share,
            path.clone(),
            doubt,
        )
    }

    /// kr · I(reflected) + kt · I(transmitted), of what lets light through.
    fn divided(&self, meeting: &Meeting, path: &Path, doubt: &mut Doubt) -> Approx3 {
        let scene = self.world.scene;
        let Meeting {
            surface, boundary, ..
        } = meeting;
        let incidence = Incidence::new(-surface.wo, surface.ns);
        let (mut sum, mut reflected) = (Approx3::ZERO, Approx3::ZERO);
        for (color, wavelength) in self.colors(boundary, path) {
            let nanometres = wavelength.unwrap_or(LINE_D);
            let division = boundary.division(scene, &incidence, nanometres, doubt);
            let [up, down] = shares(surface, &division);
            reflected = reflected + color * up;
            if division.is_total {
                continue;
            }
            let etas = boundary.etas(scene, nanometres);
            let Some(direction) = sunk(meeting, &incidence, etas, doubt) else {
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
            sum = sum + self.followed(meeting, (direction, cone), color * down, path, doubt);
        }
        if surface.is_smooth {
            let mut direction = incidence.mirrored();
            if !surface.rises(direction, doubt) {
                direction = Incidence::new(incidence.d, surface.ng).mirrored();
            }
            let cone = surface.cone.mirrored(surface.curvature);
            sum = sum + self.followed(meeting, (direction, cone), reflected, path.clone(), doubt);
        }
        sum
    }

    /// The wavelengths that a path follows behind a boundary, each with its part of white: several where it is split
    /// there.
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

    /// share · I(followed), if that still matters.
    fn followed(
        &self,
        meeting: &Meeting,
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
            origin: meeting.surface.start,
            direction,
            t_near: Approx::ZERO,
            t_far: f64::INFINITY,
            leaves: Some(meeting.found.left()),
            cone,
        };
        share * self.radiance(&ray, path, doubt)
    }

    /// Whether a path of this weight is followed at all.
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

/// A surface as a path has met it.
struct Meeting<'s> {
    ray: &'s Ray,
    found: Found,
    surface: Surface,
    boundary: Boundary<'s>,
    /// With the weight that it has where it arrives.
    path: Path,
}

/// kr and kt of a surface whose boundary divides light so. Without Fresnel's equations they hold at all angles up to
/// total reflection, which gets both.
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

/// The direction behind a boundary. One that an interpolated normal would keep on this side is bent by the geometric
/// normal instead.
fn sunk(meeting: &Meeting, incidence: &Incidence, etas: [Approx; 2], doubt: &mut Doubt) -> Option<Approx3> {
    if meeting.boundary.is_wall() {
        return Some(incidence.d);
    }
    let bent = incidence.refracted(etas, doubt)?;
    if meeting.surface.rises(bent, doubt) {
        return Incidence::new(incidence.d, meeting.surface.ng).refracted(etas, doubt);
    }
    Some(bent)
}

/// What is behind everything in a direction of any length.
fn background(scene: &Scene, direction: Approx3) -> Approx3 {
    match scene.background {
        Background::Uniform(color) => Approx3::exact_f32(color),
        Background::Environment { .. } => unreachable!("the textbook knows no environment maps"),
        Background::Gradient { horizon, up, down } => {
            let height = direction.normalize().y;
            let pole = if height.value < 0.0 { down } else { up };
            let [level, pole] = [horizon, pole].map(Approx3::exact_f32);
            level + (pole - level) * height.abs()
        }
    }
}

/// Light as it comes to a point.
struct Arriving {
    /// To the light; unit.
    wi: Approx3,
    /// What is left of the intensity, the cosine of the surface not counted.
    attenuation: Approx,
}

/// The textbook has no random numbers.
const NO_EXTENT: &str = "the textbook knows no lights with an extent";

/// Unnormalised way from `p` to the light.
fn toward(light: &Light, p: Approx3) -> Approx3 {
    match light.kind {
        LightKind::Directional { to_light } => Approx3::rounded(to_light),
        LightKind::Point { position, .. } | LightKind::Spot { position, .. } => {
            Approx3::rounded(position) - p
        }
        LightKind::Area { .. } => unreachable!("{NO_EXTENT}"),
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
        LightKind::Area { .. } => unreachable!("{NO_EXTENT}"),
    };
    Arriving { wi, attenuation }
}
