//! Dielectric boundaries and alpha: rays that continue through surfaces.
//!
//! A path carries the interiors around it (nested dielectrics by priority), its exact direction, and its wavelength
//! once a dispersive medium has split it. At a smooth boundary, Fresnel's equations divide the throughput between a
//! reflected and a refracted ray; at a rough boundary, those of its microfacets do. Beer-Lambert absorption
//! attenuates the path inside a medium. Functions for one ray serve microfacets, thin walls and thin films; smooth
//! boundaries of solids are computed sixteen at a time ([`super::boundary_packet`]). Both run in f64.

use glam::DVec3;

use super::super::context::RenderContext;
use super::super::profile::Category;
use super::super::surface::{SurfacePacket, Surfaces};
use super::super::wavefront::{
    PathPacket, PathState, PathStatePacket, RayWorkItem, ShadingState, TracedPacket,
};
use super::boundary::Boundary;
use super::microfacet::{Microfacet, ScatteredRay};
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::optics::{LINE_D, reflect, refract};
use crate::scene::{Effect, MIRROR_ROUGHNESS, Model, Phong};
use crate::shading::MaterialPacket;
use crate::shading::ray_cone::RayCone;

impl RenderContext<'_> {
    /// Returns the ray cone of a traced ray at its hit.
    pub(in crate::render) fn cone_at(
        &self,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        l: usize,
    ) -> RayCone {
        if !self.effects().has(Effect::TextureFilter) {
            return PathState::NONE.cone;
        }
        let length = traced.packet.ray(l).direction.as_dvec3().length();
        path_states
            .cone(l)
            .after(f64::from(traced.packet.t_far[l]) * length)
    }

    /// Returns the hit of lane `l` with all that is needed to scatter the ray at the boundary.
    pub(in crate::render) fn boundary_hit<'a>(
        &'a self,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        surfaces: &'a Surfaces,
        l: usize,
    ) -> BoundaryHit<'a> {
        let arrival = path_states.lane(l);
        let (points, materials) = (&surfaces.points, &surfaces.materials);
        let boundary = self.boundary(traced.packet.instance[l], points.front[l], &arrival.media);
        // Split wavelengths only once, where either side is dispersive
        let disperses = self.effects().has(Effect::Dispersion)
            && arrival.wavelength == 0.0
            && !boundary.is_thin_surface()
            && (self.disperses(boundary.crossing.before) || self.disperses(boundary.crossing.after));
        BoundaryHit {
            points,
            materials,
            l,
            pixel: traced.pixel[l],
            weight: std::array::from_fn(|c| traced.weight[c][l]),
            arrival,
            cone: self.cone_at(traced, path_states, l),
            curvature: surfaces.curvatures[l],
            tints: Tints::of(&boundary.material.model, materials, l),
            boundary,
            normal: self.surfaces.interface_normal(traced.packet, surfaces, l),
            disperses,
            is_smooth: materials.extended.is_phong[l] || materials.roughness[l] <= MIRROR_ROUGHNESS,
        }
    }
}

/// Returns whether Fresnel's equations apply to a surface of this model.
pub(super) fn applies_fresnel(model: &Model) -> bool {
    !matches!(model, Model::Phong(Phong { fresnel: false, .. }))
}

/// Tints of reflected and transmitted light at a surface, besides Fresnel's factors.
pub(in crate::render) struct Tints {
    pub(in crate::render) reflected: [f32; 3],
    pub(in crate::render) through: [f32; 3],
    /// True if Fresnel's equations apply.
    applies_fresnel: bool,
}

impl Tints {
    /// Returns the tints of lane `l` of `materials`, which is one of this model and transmits light.
    pub(in crate::render) fn of(model: &Model, materials: &MaterialPacket, l: usize) -> Tints {
        Tints::in_lane(materials, &[applies_fresnel(model); LANES], l)
    }

    /// Returns the tints of lane `l` of `materials`, which transmits light, without branches.
    #[inline(always)]
    pub(super) fn in_lane(materials: &MaterialPacket, applies_fresnel: &Lanes<bool>, l: usize) -> Tints {
        let extended = &materials.extended;
        let is_phong = extended.is_phong[l];
        let dielectric = 1.0 - materials.metallic[l];
        let (mut reflected, mut through) = ([0.0; 3], [0.0; 3]);
        for c in 0..3 {
            let share = extended.transmission[c][l];
            let specular = extended.specular_color[c][l] * extended.specular[l];
            let tinted = materials.base_color[c][l] * share * dielectric;
            reflected[c] = if is_phong {
                extended.reflection[c][l]
            } else {
                specular
            };
            through[c] = if is_phong { share } else { tinted };
        }
        Tints {
            reflected,
            through,
            applies_fresnel: applies_fresnel[l],
        }
    }

    /// Returns the weights of the reflected and of the refracted ray. With total internal reflection, all light is
    /// reflected.
    #[inline(always)]
    pub(in crate::render) fn weights(&self, reflectance: f64, transmittance: f64) -> ([f32; 3], [f32; 3]) {
        let (r, t) = if self.applies_fresnel {
            (reflectance as f32, transmittance as f32)
        } else {
            (1.0, 1.0)
        };
        // Without Fresnel factors, total internal reflection returns both parts
        let returns_all = !(transmittance > 0.0) & !self.applies_fresnel;
        let (mut reflected, mut through) = ([0.0; 3], [0.0; 3]);
        for c in 0..3 {
            let all = (self.reflected[c] + self.through[c]).min(1.0);
            reflected[c] = if returns_all { all } else { self.reflected[c] * r };
            through[c] = if returns_all { 0.0 } else { self.through[c] * t };
        }
        (reflected, through)
    }
}

impl ShadingState<'_, '_> {
    /// Returns the path throughput of a packet at its hits, after absorption along the rays.
    pub(in crate::render) fn weight_after_absorption(
        &self,
        packet: &RayPacket,
        path: &PathPacket,
        path_states: PathStatePacket,
    ) -> Lanes3<f32> {
        let mut weight = path.weight;
        for l in 0..LANES {
            if packet.active[l] == 0 {
                continue;
            }
            // Only media absorb
            let media = path_states.media(l);
            if media.current().is_none() {
                continue;
            }
            let length = packet.ray(l).direction.as_dvec3().length();
            let is_hit = packet.instance[l] != NO_HIT;
            let t = if is_hit {
                f64::from(packet.t_far[l])
            } else {
                f64::INFINITY
            };
            // A ray that continued behind a surface begins there, at `t_near`.
            let distance = (t - f64::from(packet.t_near[l])) * length;
            let left = self.frame.transmittance(&media, distance);
            for channel in 0..3 {
                weight[channel][l] *= left[channel];
            }
        }
        weight
    }

    /// Queues rays that continue through alpha and through hidden boundaries, and returns the throughput of what is
    /// shaded.
    pub(in crate::render) fn apply_alpha(
        &mut self,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        surfaces: &mut Surfaces,
    ) -> Lanes3<f32> {
        let mut present = *traced.weight;
        for l in 0..LANES {
            if traced.packet.instance[l] == NO_HIT || traced.packet.active[l] == 0 {
                continue;
            }
            let surface = self
                .frame
                .crossed_surface(traced.packet.instance[l], surfaces.points.front[l]);
            // Let rays pass hidden boundaries entirely
            let mut coverage = surfaces.materials.alpha[l];
            if surface.interior.is_some() && surface.is_hidden(&path_states.media(l)) {
                coverage = 0.0;
            }
            if coverage == 1.0 {
                continue;
            }
            let travel = path_states.lane(l);
            // Split the throughput between the surface and the continued ray
            let weight = std::array::from_fn(|c| present[c][l] * (1.0 - coverage));
            (0..3).for_each(|c| present[c][l] *= coverage);
            let ray = traced.packet.ray(l);
            let mut sent = RayWorkItem {
                // Continue as the same ray beyond the hit, so that no surface is hit twice or missed.
                ray: Ray {
                    t_near: ray.t_far.next_up(),
                    t_far: f32::INFINITY,
                    ..ray
                },
                pixel: traced.pixel[l],
                weight,
                sender: Category::Refraction,
                // A ray that passes through a gap in the surface of an interior enters that interior as well.
                travel: Some(PathState {
                    media: surface.through(&travel.media),
                    ..travel
                }),
            };
            self.send::<false>(&mut sent, 0);
        }
        present
    }

    /// Queues the reflected and refracted rays of lane `l` at a smooth surface.
    pub(super) fn cross(
        &mut self,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        surfaces: &Surfaces,
        l: usize,
    ) {
        let boundary_hit = self.frame.boundary_hit(traced, path_states, surfaces, l);
        let bend = SmoothInterface {
            d: boundary_hit.arrival.direction,
            n: boundary_hit.normal,
            side: surfaces.points.geometric_normal(l),
        };
        self.scatter_at_boundary(&boundary_hit, &Interface::Smooth(bend));
    }

    /// Queues the refracted rays, one per wavelength where light disperses, and the reflected ray of a hit.
    pub(in crate::render) fn scatter_at_boundary(&mut self, boundary_hit: &BoundaryHit, facet: &Interface) {
        let frame = self.frame;
        let BoundaryHit {
            weight,
            arrival,
            boundary,
            ..
        } = boundary_hit;
        let mut reflected = [0.0; 3];
        // Loop over the wavelengths of a dispersive boundary
        let (colors, offset): (&[[f32; 3]], f64) = if boundary_hit.disperses {
            let offset = self.wavelength_offsets.get(boundary_hit.pixel as usize);
            (frame.spectrum.weights(), offset.copied().unwrap_or(0.5))
        } else {
            (&[[1.0; 3]], 0.5)
        };
        for (index, color) in colors.iter().enumerate() {
            let wavelength = if boundary_hit.disperses {
                frame.spectrum.wavelength(index, offset)
            } else {
                f64::from(arrival.wavelength)
            };
            let nanometres = if wavelength > 0.0 { wavelength } else { LINE_D };
            // Divide light by Fresnel's equations
            let (reflectance, transmittance) = frame.fresnel_factors(boundary, facet.cos_i(), nanometres);
            let (mut mirrored, mut through) = boundary_hit.tints.weights(reflectance, transmittance);
            let etas =
                [boundary.crossing.before, boundary.crossing.after].map(|body| frame.ior(body, nanometres));
            if frame.effects().has(Effect::Iridescence)
                && let Some(film) = boundary_hit.film_reflectance(reflectance, facet.cos_i(), etas)
            {
                for c in 0..3 {
                    mirrored[c] *= film[c] / reflectance as f32;
                    through[c] *= (1.0 - film[c]) / transmittance as f32;
                }
            }
            (0..3).for_each(|c| reflected[c] += color[c] * mirrored[c]);
            // Spawn the refracted ray
            let Some(scattered_ray) = facet.refracted(boundary, etas) else {
                continue;
            };
            let weight = std::array::from_fn(|c| weight[c] * color[c] * through[c] * scattered_ray.share);
            let cone =
                boundary_hit
                    .cone
                    .refracted(etas[1] / etas[0], scattered_ray.cosines, boundary_hit.curvature);
            let travel = PathState {
                depth: arrival.depth + 1,
                wavelength: wavelength as f32,
                direction: scattered_ray.direction,
                media: boundary.crossing.through,
                cone: cone.spread_by(scattered_ray.spread),
                bent: arrival.bent || !boundary.is_thin_surface(),
                density: arrival.density_behind_boundary(),
                ..*arrival
            };
            self.send_from(boundary_hit, weight, facet.sender(Category::Refraction), travel);
        }
        // Spawn the reflected ray
        if !facet.reflects(frame, boundary_hit) {
            return;
        }
        let Some(scattered_ray) = facet.reflected() else {
            return;
        };
        let travel = PathState {
            depth: arrival.depth + 1,
            direction: scattered_ray.direction,
            cone: boundary_hit
                .cone
                .reflected(boundary_hit.curvature)
                .spread_by(scattered_ray.spread),
            bent: true,
            density: arrival.density_behind_mirror(frame.effects().has(Effect::Caustics)),
            ..*arrival
        };
        let weight = std::array::from_fn(|c| weight[c] * reflected[c] * scattered_ray.share);
        self.send_from(boundary_hit, weight, facet.sender(Category::Reflection), travel);
    }

    /// Queues a ray that leaves the surface, with its origin on the side of its direction.
    fn send_from(
        &mut self,
        boundary_hit: &BoundaryHit,
        weight: [f32; 3],
        sender: Category,
        travel: PathState,
    ) {
        let (points, l) = (boundary_hit.points, boundary_hit.l);
        let ng = points.geometric_normal(l);
        let side = if travel.direction.dot(ng) < 0.0 { -ng } else { ng };
        let origin = points.leave(l, side);
        let mut sent = RayWorkItem {
            ray: Ray::new(origin, travel.direction.as_vec3()),
            pixel: boundary_hit.pixel,
            weight,
            sender,
            travel: Some(travel),
        };
        self.send::<false>(&mut sent, 0);
    }
}

/// Ray at a boundary, with all that is needed to scatter it.
pub(in crate::render) struct BoundaryHit<'a> {
    points: &'a SurfacePacket,
    materials: &'a MaterialPacket,
    l: usize,
    pixel: u32,
    weight: [f32; 3],
    pub(in crate::render) arrival: PathState,
    cone: RayCone,
    curvature: f64,
    boundary: Boundary<'a>,
    pub(in crate::render) tints: Tints,
    /// Unit shading normal for reflection and refraction, on the side of the incident ray.
    pub(in crate::render) normal: DVec3,
    /// True if the boundary splits wavelengths.
    disperses: bool,
    /// True if the surface is smooth enough for mirror rays.
    is_smooth: bool,
}

impl BoundaryHit<'_> {
    /// Returns the reflectance of the boundary with its thin film from that without it; `None` without a film, and where
    /// the bare boundary reflects all light or none. A film reflects as much light from inside as from the direction
    /// outside into which that light refracts.
    #[inline(never)]
    fn film_reflectance(&self, reflectance: f64, cos_i: f64, [eta_i, eta_t]: [f64; 2]) -> Option<[f32; 3]> {
        let bare = [reflectance as f32; 3];
        // Refract light from inside to the direction outside
        let ratio = (eta_i / eta_t).max(1.0);
        let squared_sine = ratio * ratio * (1.0 - cos_i * cos_i);
        let is_divided = reflectance > 0.0 && reflectance < 1.0 && squared_sine < 1.0;
        if !is_divided || !(self.materials.extended.film[self.l] > 0.0) {
            return None;
        }
        let cosine = (1.0 - squared_sine).sqrt();
        Some(self.materials.with_film(bare, cosine as f32, self.l))
    }
}

/// Interface that scatters a ray: a smooth surface, or a microfacet of a rough one.
pub(in crate::render) enum Interface<'a> {
    Smooth(SmoothInterface),
    Rough(Microfacet<'a>),
}

impl Interface<'_> {
    fn cos_i(&self) -> f64 {
        match self {
            Interface::Smooth(bend) => bend.cos_i(),
            Interface::Rough(facet) => facet.cos_i(),
        }
    }

    /// Returns whether a reflected ray is sent.
    fn reflects(&self, frame: &RenderContext, boundary_hit: &BoundaryHit) -> bool {
        match self {
            Interface::Smooth(_) => boundary_hit.is_smooth && frame.effects().has(Effect::Reflection),
            Interface::Rough(_) => true,
        }
    }

    fn reflected(&self) -> Option<ScatteredRay> {
        match self {
            Interface::Smooth(bend) => Some(bend.scattered_ray(bend.reflected())),
            Interface::Rough(facet) => facet.reflected(),
        }
    }

    fn refracted(&self, boundary: &Boundary, etas: [f64; 2]) -> Option<ScatteredRay> {
        match self {
            Interface::Smooth(bend) => bend
                .refracted(boundary, etas)
                .map(|direction| bend.scattered_ray(direction)),
            Interface::Rough(facet) => facet.refracted(boundary, etas),
        }
    }

    /// Returns the account of a ray; `smooth` is the account for a smooth surface.
    fn sender(&self, smooth: Category) -> Category {
        match self {
            Interface::Smooth(_) => smooth,
            Interface::Rough(_) => Category::RoughRefraction,
        }
    }
}

/// Incidence of a ray on a smooth boundary.
pub(in crate::render) struct SmoothInterface {
    /// Unit direction of the incident ray.
    pub(super) d: DVec3,
    /// Unit shading normal for reflection and refraction, on the side of the incident ray.
    pub(super) n: DVec3,
    /// Unit geometric normal on the side of the incident ray; scattered rays must not cross it because of an
    /// interpolated `n`.
    pub(super) side: DVec3,
}

impl SmoothInterface {
    /// Returns the cosine of the angle of incidence, within [0, 1].
    pub(super) fn cos_i(&self) -> f64 {
        (-self.d.dot(self.n)).clamp(0.0, 1.0)
    }

    /// Returns the scattered ray along `direction`.
    fn scattered_ray(&self, direction: DVec3) -> ScatteredRay {
        ScatteredRay {
            direction,
            cosines: [self.cos_i(), direction.dot(self.n).abs()],
            share: 1.0,
            spread: 0.0,
        }
    }

    /// Returns the direction of the reflected ray, which leaves on the side of the incident ray.
    pub(super) fn reflected(&self) -> DVec3 {
        let mirrored = reflect(self.d, self.n);
        // Fall back to the geometric normal if the ray would enter the surface
        if mirrored.dot(self.side) > 0.0 {
            mirrored
        } else {
            reflect(self.d, self.side)
        }
    }

    /// Returns the direction of the refracted ray, or `None` with total internal reflection.
    fn refracted(&self, boundary: &Boundary, etas: [f64; 2]) -> Option<DVec3> {
        // Thin surfaces do not change the direction
        if boundary.material.is_thin_surface() {
            return Some(self.d);
        }
        self.refracted_into_solid(etas)
    }

    /// Returns the direction of the ray refracted from index `eta_i` to `eta_t`, or `None` with total internal reflection.
    pub(super) fn refracted_into_solid(&self, [eta_i, eta_t]: [f64; 2]) -> Option<DVec3> {
        // Equal indices do not change the direction
        if eta_i == eta_t {
            return Some(self.d);
        }
        let bent = refract(self.d, self.n, eta_i, eta_t)?.direction;
        // Fall back to the geometric normal if the ray would stay on its side
        if bent.dot(self.side) < 0.0 {
            return Some(bent);
        }
        refract(self.d, self.side, eta_i, eta_t).map(|refraction| refraction.direction)
    }
}
