//! Lights that emit photons, and the targets that they emit them to.

use glam::DVec3;

use super::super::context::RenderContext;
use super::super::lighting::AreaLightSampler;
use crate::numeric::Bounds;
use crate::optics::InteriorStack;
use crate::scene::{Falloff, Light, LightKind, Scene};

/// Largest number of targets: further objects share spheres with others.
const MAX_TARGETS: usize = 64;

/// Sphere around objects that reflect or refract sharply.
#[derive(Clone, Copy, Debug)]
pub(super) struct CausticTarget {
    pub(super) center: DVec3,
    pub(super) radius: f64,
}

/// Light that emits photons.
pub(super) struct PhotonSource<'f, 's> {
    pub(super) light: &'f Light,
    /// Index of the light in the scene.
    pub(super) number: u32,
    /// Surface of an area light.
    pub(super) surface: Option<&'f AreaLightSampler<'s>>,
    /// Number of photons that it emits.
    pub(super) count: u32,
    /// Dielectric interiors around the light, and the index of refraction of the innermost one.
    pub(super) media: InteriorStack,
    pub(super) ior: f64,
    /// Number of rays traced to find the interiors.
    pub(super) probes: u64,
}

/// Returns whether the light emits photons: its intensity falls with the square of the distance, and points on its
/// surface can be sampled.
pub(in crate::render) fn emits_photons(light: &Light) -> bool {
    match light.kind {
        LightKind::Directional { .. } | LightKind::Area { .. } => light.intensity != [0.0; 3],
        LightKind::Point { falloff, .. } | LightKind::Spot { falloff, .. } => {
            falloff == Falloff::InverseSquare { range: None } && light.intensity != [0.0; 3]
        }
    }
}

/// Returns the spheres around the objects of a scene that reflect or refract sharply; infinite planes have none.
pub(super) fn targets(scene: &Scene) -> Vec<CausticTarget> {
    let mut targets = Vec::new();
    for instance in &scene.instances {
        // Skip objects that throw no light
        if !scene.materials[instance.material as usize].is_sharp() {
            continue;
        }
        let geometry = &scene.geometries[instance.geometry as usize];
        let bounds = instance.world_bounds(geometry, &geometry.bounds());
        let radius = 0.5 * bounds.extent().length();
        if radius > 0.0 && radius < f64::INFINITY {
            let center = bounds.center();
            targets.push(CausticTarget { center, radius });
        }
    }
    // Let pairs of targets share spheres while there are too many
    while targets.len() > MAX_TARGETS {
        targets = merged(&targets);
    }
    targets
}

/// Merges each two targets that follow each other along the longest axis of all.
fn merged(targets: &[CausticTarget]) -> Vec<CausticTarget> {
    // Pair the targets in the order along the longest axis
    let bounds = Bounds::of_points(targets.iter().map(|target| target.center));
    let axis = bounds.extent().max_position();
    let mut sorted = targets.to_vec();
    sorted.sort_by(|a, b| a.center[axis].total_cmp(&b.center[axis]));
    let around = |pair: &[CausticTarget]| {
        let [a, b] = [pair[0], pair[pair.len() - 1]];
        let distance = a.center.distance(b.center);
        // One sphere may hold the other
        let radius = (0.5 * (distance + a.radius + b.radius))
            .max(a.radius)
            .max(b.radius);
        let along = if distance > 0.0 {
            (radius - a.radius) / distance
        } else {
            0.0
        };
        CausticTarget {
            center: a.center + (b.center - a.center) * along.clamp(0.0, 1.0),
            radius,
        }
    };
    sorted.chunks(2).map(around).collect()
}

impl<'s> RenderContext<'s> {
    /// Returns whether light `number` of the scene emits photons.
    pub(in crate::render) fn emits_photons(&self, number: usize) -> bool {
        let light = &self.scene.lights[number];
        emits_photons(light)
            && (!matches!(light.kind, LightKind::Area { .. }) || self.surface_of(number).is_some())
    }

    /// Returns the surface of an area light, if points on it can be sampled.
    fn surface_of(&self, number: usize) -> Option<&AreaLightSampler<'s>> {
        let surface = self.area_lights.get(number)?.as_ref()?;
        surface.emits_from_points().then_some(surface)
    }

    /// Returns the lights that emit photons to `targets`, with their shares of `count` photons by the flux that reaches
    /// the targets.
    pub(super) fn photon_sources(&self, targets: &[CausticTarget], count: u32) -> Vec<PhotonSource<'_, 's>> {
        // Estimate the flux of each light through the targets
        let lights = (0..self.scene.lights.len()).filter(|&number| self.emits_photons(number));
        let fluxes: Vec<(usize, f64)> = lights
            .map(|number| (number, self.flux(number, targets)))
            .filter(|(_, flux)| *flux > 0.0 && flux.is_finite())
            .collect();
        let whole: f64 = fluxes.iter().map(|(_, flux)| flux).sum();
        // Divide the photons in proportion, by differences of rounded sums
        let (mut sum, mut given) = (0.0, 0);
        let mut sources = Vec::new();
        for (number, flux) in fluxes {
            sum += flux;
            // Count what is left to this light
            let upto = (f64::from(count) * (sum / whole)).round() as u32;
            let share = upto.min(count) - given;
            given += share;
            if share == 0 {
                continue;
            }
            let light = &self.scene.lights[number];
            let (media, probes) = match self.place_of(number) {
                Some(place) => self.media_around(place, self.shutter.time(0.5)),
                None => (InteriorStack::EMPTY, 0),
            };
            sources.push(PhotonSource {
                light,
                number: number as u32,
                surface: self.surface_of(number),
                count: share,
                media,
                probes,
                ior: self.ior(media.current(), crate::optics::LINE_D),
            });
        }
        sources
    }

    /// Returns the flux of a light through the targets, roughly, in watts of all channels.
    fn flux(&self, number: usize, targets: &[CausticTarget]) -> f64 {
        let light = &self.scene.lights[number];
        let intensity: f64 = light.intensity.into_iter().map(f64::from).sum();
        // Sum up the solid angles or areas in which the light sees the targets
        let through = targets
            .iter()
            .map(|target| match (light.kind, self.place_of(number)) {
                (LightKind::Directional { .. }, _) | (_, None) => target.disc_area(),
                (_, Some(place)) => target.solid_angle(place),
            });
        let area = match self.surface_of(number) {
            Some(surface) => surface.area(),
            None => 1.0,
        };
        intensity * area * through.sum::<f64>()
    }

    /// Returns a point of a light; `None` for directional light.
    fn place_of(&self, number: usize) -> Option<DVec3> {
        let light = &self.scene.lights[number];
        let on_surface = || {
            self.surface_of(number)?
                .surface_point([0.5; 2])
                .map(|point| point.position)
        };
        light.position().or_else(on_surface)
    }
}

impl CausticTarget {
    /// Returns the solid angle of the cone from `p` that holds the sphere; that of all directions from inside of it.
    pub(super) fn solid_angle(&self, p: DVec3) -> f64 {
        let squared = self.center.distance_squared(p);
        let sine_squared = self.radius * self.radius / squared;
        if !(sine_squared < 1.0) {
            return 4.0 * std::f64::consts::PI;
        }
        // 1 - cos as sin² / (1 + cos), which keeps its digits for far spheres
        std::f64::consts::TAU * sine_squared / (1.0 + (1.0 - sine_squared).sqrt())
    }

    /// Returns whether the cone from `p` that holds the sphere holds `direction`, a unit vector.
    pub(super) fn holds(&self, p: DVec3, direction: DVec3) -> bool {
        // Compare the distance of the centre from the line
        let to_center = self.center - p;
        let along = to_center.dot(direction);
        let beside = to_center.length_squared() - along * along;
        let is_inside = to_center.length_squared() <= self.radius * self.radius;
        is_inside || along > 0.0 && beside <= self.radius * self.radius
    }

    /// Returns the area of the sphere's disc.
    pub(super) fn disc_area(&self) -> f64 {
        std::f64::consts::PI * self.radius * self.radius
    }
}
