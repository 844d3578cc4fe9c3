//! Rays that go through surfaces: those that are only partly there, and those of transparent bodies.
//!
//! A path keeps the bodies around it (nested dielectrics by priority), its exact direction, and the wavelength that it
//! follows once a dispersive body has split it. At a boundary Fresnel's equations divide its weight between a reflected
//! and a refracted ray, at a rough one those of its microfacets; on its way through a body Beer and Lambert's law takes
//! off what the body swallows. Lane by lane and in f64: packets pay for it only in scenes with such materials.

use glam::DVec3;

use super::Frame;
use super::ledger::Account;
use super::outcome::{Outcome, Traced};
use super::queue::{PathPacket, Sent};
use super::rough::{Microfacet, Way};
use super::surface::{SurfacePacket, Surfaces};
use super::travel::{Travel, TravelPacket};
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes3, Ray};
use crate::optics::{
    Body, BoundaryCrossing, BoundaryEvent, InteriorStack, LINE_D, Polarised, dielectric, reflect, refract,
    thin_slab,
};
use crate::scene::{Effect, Lecture, MIRROR_ROUGHNESS, Material, Model};
use crate::shading::MaterialPacket;
use crate::shading::ray_cone::Cone;

/// A boundary that a ray meets.
pub(super) struct Boundary<'m> {
    pub(super) material: &'m Material,
    pub(super) crossing: BoundaryCrossing,
    /// Whether it is that of a body that light goes through.
    is_body: bool,
}

impl Boundary<'_> {
    /// Whether it has no inside that a ray could be in.
    pub(super) fn is_wall(&self) -> bool {
        self.material.is_wall()
    }

    /// Whether bodies of higher priority hide it: the ray does not notice.
    pub(super) fn is_hidden(&self) -> bool {
        self.is_body && !self.crossing.is_real()
    }
}

impl Material {
    /// Whether it has no inside that a ray could be in.
    fn is_wall(&self) -> bool {
        self.interior.is_none_or(|inside| inside.is_thin)
    }
}

impl Frame<'_> {
    /// The cone of a traced ray where it has met something.
    pub(super) fn cone_at(&self, traced: &Traced, travels: TravelPacket, l: usize) -> Cone {
        if !self.effects().has(Effect::TextureFilter) {
            return Travel::NONE.cone;
        }
        let length = traced.packet.ray(l).direction.as_dvec3().length();
        travels.cone(l).after(f64::from(traced.packet.t_far[l]) * length)
    }

    /// The curvature that widens or narrows rays at a hit, where their widths count.
    pub(super) fn curvature(&self, packet: &RayPacket, surfaces: &Surfaces, l: usize) -> f64 {
        if self.effects().has(Effect::TextureFilter) {
            self.surfaces.curvature(packet, surfaces, l)
        } else {
            0.0
        }
    }

    /// What instance `instance` means to a ray with these bodies around, which comes from its outside if
    /// `from_outside`.
    pub(super) fn boundary(&self, instance: u32, from_outside: bool, media: &InteriorStack) -> Boundary<'_> {
        let index = self.scene.instances[instance as usize].material;
        let material = &self.scene.materials[index as usize];
        let passage = if from_outside {
            BoundaryEvent::Enter
        } else {
            BoundaryEvent::Leave
        };
        let is_body = self.effects().has(Effect::Refraction) && material.transmits() && !material.is_wall();
        let crossing = if !is_body {
            BoundaryCrossing {
                before: media.current(),
                after: media.current(),
                through: *media,
            }
        } else {
            let priority = material.interior.map_or(0, |inside| inside.priority);
            media.crossing(Body { id: index, priority }, passage)
        };
        Boundary {
            material,
            crossing,
            is_body,
        }
    }

    /// What a ray meets in lane `l`.
    pub(super) fn meeting<'a>(
        &'a self,
        traced: &Traced,
        travels: TravelPacket,
        surfaces: &'a Surfaces,
        l: usize,
    ) -> Meeting<'a> {
        let arrival = travels.lane(l);
        let (points, materials) = (&surfaces.points, &surfaces.materials);
        let boundary = self.boundary(traced.packet.instance[l], points.front[l], &arrival.media);
        let disperses = self.effects().has(Effect::Dispersion)
            && arrival.wavelength == 0.0
            && !boundary.is_wall()
            && (self.disperses(boundary.crossing.before) || self.disperses(boundary.crossing.after));
        Meeting {
            points,
            l,
            pixel: traced.pixel[l],
            weight: std::array::from_fn(|c| traced.weight[c][l]),
            arrival,
            cone: self.cone_at(traced, travels, l),
            curvature: self.curvature(traced.packet, surfaces, l),
            tints: Tints::of(&boundary.material.model, materials, l),
            boundary,
            normal: self.surfaces.interface_normal(traced.packet, surfaces, l),
            disperses,
            is_smooth: materials.rich.is_lecture[l] || materials.roughness[l] <= MIRROR_ROUGHNESS,
        }
    }

    fn body_material(&self, body: Option<Body>) -> Option<&Material> {
        body.and_then(|body| self.scene.materials.get(body.id as usize))
    }

    /// Index of refraction inside `body`, or of the surroundings.
    fn ior(&self, body: Option<Body>, wavelength: f64) -> f64 {
        self.body_material(body)
            .map_or(1.0, |material| material.ior(wavelength))
    }

    fn disperses(&self, body: Option<Body>) -> bool {
        let interior = self.body_material(body).and_then(|material| material.interior);
        interior.is_some_and(|inside| inside.ior.spread() != 0.0)
    }

    /// What is left of light after `distance` with these bodies around.
    pub(super) fn transmittance(&self, media: &InteriorStack, distance: f64) -> [f32; 3] {
        match self.body_material(media.current()).and_then(|m| m.interior) {
            Some(inside) => inside.absorption.transmittance(distance).map(|x| x as f32),
            None => [1.0; 3],
        }
    }

    /// The weights of light reflected and let through by a boundary, per channel; the indices may be those of a wall's
    /// material and its surroundings.
    pub(super) fn shares(&self, boundary: &Boundary, cos_i: f64, wavelength: f64) -> (f64, f64) {
        let material = boundary.material;
        let outside = self.ior(boundary.crossing.before, wavelength);
        let mean = |r: Polarised, t: Polarised| (r.mean(), t.mean());
        if material.is_wall() {
            if material.interior.is_none() {
                return (0.0, 1.0);
            }
            let slab = thin_slab(cos_i, outside, material.ior(wavelength));
            mean(slab.reflectance, slab.transmittance)
        } else {
            let inside = self.ior(boundary.crossing.after, wavelength);
            let fresnel = dielectric(cos_i, outside, inside);
            mean(fresnel.reflectance, fresnel.transmittance)
        }
    }
}

/// What a surface's material does to light that it reflects and lets through, apart from Fresnel's division.
pub(super) struct Tints {
    pub(super) reflected: [f32; 3],
    pub(super) through: [f32; 3],
    /// Whether Fresnel's equations apply.
    fresnel: bool,
}

impl Tints {
    pub(super) fn of(model: &Model, materials: &MaterialPacket, l: usize) -> Tints {
        let rich = &materials.rich;
        let lane = |lanes: &Lanes3<f32>| [lanes[0][l], lanes[1][l], lanes[2][l]];
        match model {
            Model::Lecture(Lecture { fresnel, .. }) => Tints {
                reflected: lane(&rich.reflection),
                through: lane(&rich.transmission),
                fresnel: *fresnel,
            },
            _ => {
                let color = lane(&materials.base_color);
                let share = lane(&rich.transmission);
                let dielectric = 1.0 - materials.metallic[l];
                Tints {
                    reflected: lane(&rich.specular_color).map(|c| c * rich.specular[l]),
                    through: std::array::from_fn(|c| color[c] * share[c] * dielectric),
                    fresnel: true,
                }
            }
        }
    }

    /// The weights of the reflected and the refracted ray. Where nothing gets through, all is reflected.
    pub(super) fn weights(&self, reflectance: f64, transmittance: f64) -> ([f32; 3], [f32; 3]) {
        let total = !(transmittance > 0.0);
        let (r, t) = if self.fresnel {
            (reflectance as f32, transmittance as f32)
        } else {
            (1.0, 1.0)
        };
        if total && !self.fresnel {
            let all = std::array::from_fn(|c| (self.reflected[c] + self.through[c]).min(1.0));
            return (all, [0.0; 3]);
        }
        (self.reflected.map(|c| c * r), self.through.map(|c| c * t))
    }
}

impl Outcome<'_, '_> {
    /// The weights of a packet where it arrives: what the bodies on its way swallow is taken off.
    pub(super) fn dimmed(&self, packet: &RayPacket, path: &PathPacket, travels: TravelPacket) -> Lanes3<f32> {
        let mut weight = path.weight;
        for l in 0..LANES {
            if packet.active[l] == 0 {
                continue;
            }
            let media = travels.media(l);
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
            // A ray that has passed something begins behind it.
            let distance = (t - f64::from(packet.t_near[l])) * length;
            let left = self.frame.transmittance(&media, distance);
            for channel in 0..3 {
                weight[channel][l] *= left[channel];
            }
        }
        weight
    }

    /// Sends rays on through whatever is not there, and returns the weights of what is.
    pub(super) fn pass_through(
        &mut self,
        traced: &Traced,
        travels: TravelPacket,
        surfaces: &mut Surfaces,
    ) -> Lanes3<f32> {
        let mut present = *traced.weight;
        for l in 0..LANES {
            if traced.packet.instance[l] == NO_HIT || traced.packet.active[l] == 0 {
                continue;
            }
            let from_outside = surfaces.points.front[l];
            let travel = travels.lane(l);
            let boundary = self
                .frame
                .boundary(traced.packet.instance[l], from_outside, &travel.media);
            let mut coverage = surfaces.materials.alpha[l];
            if boundary.is_hidden() {
                coverage = 0.0;
            }
            if coverage == 1.0 {
                continue;
            }
            let weight = std::array::from_fn(|c| present[c][l] * (1.0 - coverage));
            (0..3).for_each(|c| present[c][l] *= coverage);
            let ray = traced.packet.ray(l);
            let sent = Sent {
                // The same ray further on: no surface can be met twice or lost.
                ray: Ray {
                    t_near: ray.t_far.next_up(),
                    t_far: f32::INFINITY,
                    ..ray
                },
                pixel: traced.pixel[l],
                weight,
                sender: Account::Refraction,
                // Through a gap in a body's surface a ray is inside it as well.
                travel: Some(Travel {
                    media: boundary.crossing.through,
                    ..travel
                }),
            };
            self.send::<false>(&sent, 0);
        }
        present
    }

    /// Divides the rays that have met transparent bodies into reflected and refracted ones. Rough ones do so elsewhere.
    pub(super) fn cross_surfaces(&mut self, traced: &Traced, travels: TravelPacket, surfaces: &Surfaces) {
        for l in 0..LANES {
            // Light of one wavelength may have negative weights, whose sum says nothing.
            let seen = traced.weight.iter().any(|channel| channel[l] != 0.0);
            let materials = &surfaces.materials;
            if surfaces.points.hit[l] && seen && materials.transmits(l) && !materials.has_lobe(l) {
                self.cross(traced, travels, surfaces, l);
            }
        }
    }

    fn cross(&mut self, traced: &Traced, travels: TravelPacket, surfaces: &Surfaces, l: usize) {
        let meeting = self.frame.meeting(traced, travels, surfaces, l);
        let bend = Bend {
            d: meeting.arrival.direction,
            n: meeting.normal,
            side: surfaces.points.geometric_normal(l),
        };
        self.divide(&meeting, &Facet::Smooth(bend));
    }

    /// Sends a ray on to both sides of what it has met.
    pub(super) fn divide(&mut self, meeting: &Meeting, facet: &Facet) {
        let frame = self.frame;
        let Meeting {
            weight,
            arrival,
            boundary,
            ..
        } = meeting;
        let mut reflected = [0.0; 3];
        let colors: &[[f32; 3]] = if meeting.disperses {
            frame.spectrum.weights()
        } else {
            &[[1.0; 3]]
        };
        for (index, color) in colors.iter().enumerate() {
            let wavelength = if meeting.disperses {
                frame.spectrum.wavelength(index, 0.5)
            } else {
                f64::from(arrival.wavelength)
            };
            let nanometres = if wavelength > 0.0 { wavelength } else { LINE_D };
            let (reflectance, transmittance) = frame.shares(boundary, facet.cos_i(), nanometres);
            let (mirrored, through) = meeting.tints.weights(reflectance, transmittance);
            (0..3).for_each(|c| reflected[c] += color[c] * mirrored[c]);
            let etas =
                [boundary.crossing.before, boundary.crossing.after].map(|body| frame.ior(body, nanometres));
            let Some(way) = facet.refracted(boundary, etas) else {
                continue;
            };
            let weight = std::array::from_fn(|c| weight[c] * color[c] * through[c] * way.share);
            let cone = meeting
                .cone
                .refracted(etas[1] / etas[0], way.cosines, meeting.curvature);
            let travel = Travel {
                depth: arrival.depth + 1,
                wavelength: wavelength as f32,
                direction: way.direction,
                media: boundary.crossing.through,
                cone: cone.spread_by(way.spread),
                ..*arrival
            };
            self.send_from(meeting, weight, facet.sender(Account::Refraction), travel);
        }
        if !facet.reflects(frame, meeting) {
            return;
        }
        let Some(way) = facet.reflected() else { return };
        let travel = Travel {
            depth: arrival.depth + 1,
            direction: way.direction,
            cone: meeting.cone.reflected(meeting.curvature).spread_by(way.spread),
            ..*arrival
        };
        let weight = std::array::from_fn(|c| weight[c] * reflected[c] * way.share);
        self.send_from(meeting, weight, facet.sender(Account::Reflection), travel);
    }

    /// Sends a ray off a surface, on the side that it goes to.
    fn send_from(&mut self, meeting: &Meeting, weight: [f32; 3], sender: Account, travel: Travel) {
        let (points, l) = (meeting.points, meeting.l);
        let ng = points.geometric_normal(l);
        let side = if travel.direction.dot(ng) < 0.0 { -ng } else { ng };
        let origin = points.leave(l, side);
        let sent = Sent {
            ray: Ray::new(origin, travel.direction.as_vec3()),
            pixel: meeting.pixel,
            weight,
            sender,
            travel: Some(travel),
        };
        self.send::<false>(&sent, 0);
    }
}

/// A ray at a boundary that divides it.
pub(super) struct Meeting<'a> {
    points: &'a SurfacePacket,
    l: usize,
    pixel: u32,
    weight: [f32; 3],
    pub(super) arrival: Travel,
    cone: Cone,
    curvature: f64,
    boundary: Boundary<'a>,
    tints: Tints,
    /// Unit normal that counts for optics, on the side that the ray came from.
    pub(super) normal: DVec3,
    /// Whether wavelengths part there.
    disperses: bool,
    /// Whether it is smooth enough to mirror.
    is_smooth: bool,
}

/// What light meets: all of a smooth surface, or a microfacet of a rough one.
pub(super) enum Facet<'a> {
    Smooth(Bend),
    Rough(Microfacet<'a>),
}

impl Facet<'_> {
    fn cos_i(&self) -> f64 {
        match self {
            Facet::Smooth(bend) => bend.cos_i(),
            Facet::Rough(facet) => facet.cos_i(),
        }
    }

    /// Whether it sends a ray back.
    fn reflects(&self, frame: &Frame, meeting: &Meeting) -> bool {
        match self {
            Facet::Smooth(_) => meeting.is_smooth && frame.effects().has(Effect::Reflection),
            Facet::Rough(_) => true,
        }
    }

    fn reflected(&self) -> Option<Way> {
        match self {
            Facet::Smooth(bend) => Some(bend.way(bend.reflected())),
            Facet::Rough(facet) => facet.reflected(),
        }
    }

    fn refracted(&self, boundary: &Boundary, etas: [f64; 2]) -> Option<Way> {
        match self {
            Facet::Smooth(bend) => bend
                .refracted(boundary, etas)
                .map(|direction| bend.way(direction)),
            Facet::Rough(facet) => facet.refracted(boundary, etas),
        }
    }

    /// What a ray is booked under that a smooth surface's would be booked under `smooth`.
    fn sender(&self, smooth: Account) -> Account {
        match self {
            Facet::Smooth(_) => smooth,
            Facet::Rough(_) => Account::RoughRefraction,
        }
    }
}

/// A direction that meets a smooth boundary.
pub(super) struct Bend {
    /// Unit direction of travel.
    d: DVec3,
    /// Unit normal that counts for optics, on the side that the ray came from.
    n: DVec3,
    /// Unit geometric normal on that side: an interpolated `n` may not send a ray to the wrong side of it.
    side: DVec3,
}

impl Bend {
    fn cos_i(&self) -> f64 {
        (-self.d.dot(self.n)).clamp(0.0, 1.0)
    }

    /// The way along `direction`.
    fn way(&self, direction: DVec3) -> Way {
        Way {
            direction,
            cosines: [self.cos_i(), direction.dot(self.n).abs()],
            share: 1.0,
            spread: 0.0,
        }
    }

    fn reflected(&self) -> DVec3 {
        let mirrored = reflect(self.d, self.n);
        if mirrored.dot(self.side) > 0.0 {
            mirrored
        } else {
            reflect(self.d, self.side)
        }
    }

    /// Where the ray goes on behind the boundary; `None` where it is reflected whole.
    fn refracted(&self, boundary: &Boundary, [eta_i, eta_t]: [f64; 2]) -> Option<DVec3> {
        if boundary.material.is_wall() || eta_i == eta_t {
            return Some(self.d);
        }
        let bent = refract(self.d, self.n, eta_i, eta_t)?.direction;
        if bent.dot(self.side) < 0.0 {
            return Some(bent);
        }
        refract(self.d, self.side, eta_i, eta_t).map(|refraction| refraction.direction)
    }
}
