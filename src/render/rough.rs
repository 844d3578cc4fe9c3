//! Rough surfaces that show what is around them: rays into the lobe of GGX, where a material asks for them.
//!
//! A surface that the eye sees draws as many microfacets as its material says, and one that another ray meets draws one
//! ([`Ggx`]; R. Cook, T. Porter and L. Carpenter, "Distributed ray tracing", SIGGRAPH 1984). Each mirrors a ray, and
//! where light goes through the surface refracts another, as a smooth surface would that lies as the microfacet does;
//! Fresnel's share is that under its angle, and what leaves on the wrong side counts as nothing. The numbers are those
//! of the sample for [`Purpose::LOBE`] and the step of the path: the microfacets of all samples of a pixel make one
//! even set. Rays into a lobe count as samples of their own from there on, so what they ask of lights lies evenly too.
//!
//! No light counts twice. Lights are asked by shadow rays, which the whole lobe answers, and no ray sees them; what rays
//! see, the environment map, what shines and what is lit, the lobe gets by these rays alone. The ambient term keeps its
//! diffuse part.
//!
//! Rays of one lobe start at one point and go much the same way, so they follow each other into the same packet. A hit
//! may send many rays; so that queues stay as small as without, fewer camera packets make a wave. The weight cut-off
//! looks at all rays of a lobe together.

use std::f64::consts::TAU;

use glam::{DMat3, DVec3, Vec3};

use super::Frame;
use super::ledger::Account;
use super::outcome::{Outcome, Stage, Traced};
use super::queue::Sent;
use super::sampler::Purpose;
use super::soft::Draw;
use super::surface::Surfaces;
use super::transparent::{Boundary, Facet};
use super::travel::{Travel, TravelPacket};
use super::wave::WAVE;
use crate::numeric::{LANES, Lanes3, Ray};
use crate::optics::{reflect, refract};
use crate::scene::{Effect, EffectSet, Material, Scene};
use crate::shading::Ggx;

/// Camera packets of a wave: so few that their lobes' rays are no more than the mirror rays of a wave without lobes, if
/// a packet can be that small.
pub(super) fn camera_packets(scene: &Scene, effects: EffectSet) -> usize {
    if !effects.has_lobes() {
        return WAVE;
    }
    // What is not in use calls for nothing.
    let used = scene
        .instances
        .iter()
        .map(|instance| &scene.materials[instance.material as usize]);
    let most = used.map(Material::rough_rays).max();
    (WAVE / most.unwrap_or(0).max(1) as usize).max(1)
}

/// Where a ray goes on from a surface.
pub(super) struct Way {
    /// Unit direction, in world space.
    pub(super) direction: DVec3,
    /// Cosines of the angles before and behind the surface, or a microfacet of it.
    pub(super) cosines: [f64; 2],
    /// What the light from there counts, apart from Fresnel's share and tints.
    pub(super) share: f32,
    /// What a lobe adds to the spread of the ray's cone.
    pub(super) spread: f64,
}

/// A rough surface, seen from where a ray comes from.
struct Lobe {
    ggx: Ggx,
    /// From the frame whose z is the normal.
    world_from_lobe: DMat3,
    /// Unit vector to where the ray came from, in that frame.
    wo: DVec3,
    /// Unit geometric normal on that side, in world space.
    side: DVec3,
    /// Microfacets that are drawn.
    of: u32,
    /// Those that all samples of the pixel draw together.
    of_pixel: f64,
}

/// A part of a rough surface that is as smooth as a mirror.
pub(super) struct Microfacet<'a> {
    lobe: &'a Lobe,
    /// Its unit normal, in the lobe's frame.
    m: DVec3,
}

impl Lobe {
    /// The lobe of a surface of this roughness and unit normal `n`, for light from `wo`; `None` where it is seen from
    /// behind.
    fn new(roughness: f32, [n, side]: [DVec3; 2], wo: DVec3) -> Option<Lobe> {
        let (t, b) = n.any_orthonormal_pair();
        let world_from_lobe = DMat3::from_cols(t, b, n);
        let wo = world_from_lobe.transpose() * wo;
        (wo.z > 0.0).then(|| Lobe {
            ggx: Ggx::from_roughness(f64::from(roughness)),
            world_from_lobe,
            wo,
            side,
            of: 1,
            of_pixel: 1.0,
        })
    }

    fn microfacet(&self, u: [f64; 2]) -> Microfacet<'_> {
        Microfacet {
            lobe: self,
            m: self.ggx.sample_vndf(self.wo, u),
        }
    }

    /// The way along `wi`, which is drawn with the density `pdf` and goes through the surface if that is below.
    fn way(&self, wi: DVec3, cosines: [f64; 2], [visible, pdf]: [f64; 2]) -> Option<Way> {
        let direction = self.world_from_lobe * wi;
        // An interpolated normal may ask for a ray that goes where it cannot.
        (direction.dot(self.side) * wi.z > 0.0).then(|| Way {
            direction,
            cosines,
            share: (visible / f64::from(self.of)) as f32,
            spread: spread(pdf * self.of_pixel),
        })
    }
}

/// How wide a ray is that is one of `density` a steradian: as a pixel's cone, the root of the solid angle that it
/// stands for, which is a hemisphere at most.
///
/// Seen along the normal the middle of the lobe has the density 1 / (4 π alpha²), and one ray the width 2 √π alpha.
fn spread(density: f64) -> f64 {
    density.sqrt().recip().min(TAU.sqrt())
}

impl Microfacet<'_> {
    /// The cosine of the angle under which the ray meets it.
    pub(super) fn cos_i(&self) -> f64 {
        self.lobe.wo.dot(self.m).clamp(0.0, 1.0)
    }

    /// Where it mirrors the ray; `None` if that is into the surface.
    pub(super) fn reflected(&self) -> Option<Way> {
        let Lobe { ggx, wo, .. } = self.lobe;
        let wi = reflect(-wo, self.m);
        if !(wi.z > 0.0) {
            return None;
        }
        let weights = [ggx.g2_over_g1(wi), ggx.reflection_pdf(*wo, wi)];
        self.lobe.way(wi, [self.cos_i(); 2], weights)
    }

    /// Where it lets the ray go on; `None` if it reflects it whole, or if that is not behind the surface.
    ///
    /// Behind a wall are its inside and its other, equally rough surface, of which `KHR_materials_transmission` makes
    /// the mirrored lobe on the far side.
    pub(super) fn refracted(&self, boundary: &Boundary, [eta_i, eta_t]: [f64; 2]) -> Option<Way> {
        let Lobe { ggx, wo, .. } = self.lobe;
        if boundary.is_wall() {
            let mirrored = reflect(-wo, self.m);
            if !(mirrored.z > 0.0) {
                return None;
            }
            let weights = [ggx.g2_over_g1(mirrored), ggx.reflection_pdf(*wo, mirrored)];
            let wi = mirrored.with_z(-mirrored.z);
            return self.lobe.way(wi, [self.cos_i(); 2], weights);
        }
        if eta_i == eta_t {
            // There is nothing to be rough.
            return self.lobe.way(-wo, [self.cos_i(); 2], [1.0, f64::INFINITY]);
        }
        let refraction = refract(-wo, self.m, eta_i, eta_t)?;
        let wi = refraction.direction;
        if !(wi.z < 0.0) {
            return None;
        }
        let pdf = ggx.transmission_pdf(*wo, wi, eta_t / eta_i);
        let cosines = [self.cos_i(), refraction.cos_t];
        self.lobe.way(wi, cosines, [ggx.g2_over_g1(wi), pdf])
    }
}

impl Frame<'_> {
    /// How many microfacets a path draws where it meets the surface in lane `l`.
    fn rough_rays(&self, surfaces: &Surfaces, travel: &Travel, (l, stage): (usize, Stage)) -> u32 {
        let depth = if self.effects().has_sheets() {
            travel.depth
        } else {
            stage.depth
        };
        if depth == 0 {
            surfaces.materials.rich.rough_rays[l]
        } else {
            1
        }
    }

    /// The lobe at lane `l`, for a ray that came the way of `arrival`.
    fn lobe_at(
        &self,
        surfaces: &Surfaces,
        arrival: &Travel,
        n: DVec3,
        (l, stage): (usize, Stage),
    ) -> Option<Lobe> {
        let points = &surfaces.points;
        let of = self.rough_rays(surfaces, arrival, (l, stage));
        let lobe = Lobe::new(
            surfaces.materials.roughness[l],
            [n, points.geometric_normal(l)],
            -arrival.direction,
        )?;
        Some(Lobe {
            of,
            of_pixel: f64::from(of) * f64::from(arrival.split) * f64::from(self.even_count),
            ..lobe
        })
    }
}

impl Outcome<'_, '_> {
    /// Sends the rays into the lobes of opaque surfaces. Surfaces that let light through send theirs elsewhere.
    pub(super) fn reflect_roughly(&mut self, traced: &Traced, surfaces: &Surfaces, stage: Stage) {
        let Some(travels) = traced.travels else {
            return;
        };
        let divides = self.frame.effects().has(Effect::Refraction);
        for l in 0..LANES {
            let materials = &surfaces.materials;
            // Light of one wavelength may have negative weights, whose sum says nothing.
            let seen = surfaces.points.hit[l] && traced.weight.iter().any(|channel| channel[l] != 0.0);
            if seen && materials.has_lobe(l) && !(divides && materials.transmits(l)) {
                self.reflect_lobe(traced, travels, surfaces, (l, stage));
            }
        }
    }

    fn reflect_lobe(
        &mut self,
        traced: &Traced,
        travels: TravelPacket,
        surfaces: &Surfaces,
        (l, stage): (usize, Stage),
    ) {
        let frame = self.frame;
        let points = &surfaces.points;
        let vector = |v: &Lanes3<f32>| Vec3::new(v[0][l], v[1][l], v[2][l]);
        let arrival = Travel {
            // Not every path keeps it.
            direction: -vector(&points.wo).as_dvec3().normalize(),
            ..travels.lane(l)
        };
        let Some(lobe) = frame.lobe_at(surfaces, &arrival, points.shading_normal(l), (l, stage)) else {
            return;
        };
        let cone = frame
            .cone_at(traced, travels, l)
            .reflected(frame.curvature(traced.packet, surfaces, l));
        for number in 0..lobe.of {
            let facet = lobe.microfacet(self.lobe_numbers(traced, (l, stage), [number, lobe.of]));
            let Some(way) = facet.reflected() else {
                continue;
            };
            let fresnel = surfaces.materials.fresnel(facet.cos_i() as f32, l);
            let sent = Sent {
                ray: Ray::new(vector(&points.origin), way.direction.as_vec3()),
                pixel: traced.pixel[l],
                weight: std::array::from_fn(|c| traced.weight[c][l] * fresnel[c] * way.share),
                sender: Account::RoughReflection,
                travel: Some(Travel {
                    depth: arrival.depth + 1,
                    direction: way.direction,
                    cone: cone.spread_by(way.spread),
                    ..arrival.one_of(number, lobe.of)
                }),
            };
            self.send::<false>(&sent, stage.depth + 1);
        }
    }

    /// Divides the rays that have met rough surfaces that light goes through.
    pub(super) fn cross_rough_surfaces(
        &mut self,
        traced: &Traced,
        travels: TravelPacket,
        surfaces: &Surfaces,
        stage: Stage,
    ) {
        for l in 0..LANES {
            let materials = &surfaces.materials;
            let seen = surfaces.points.hit[l] && traced.weight.iter().any(|channel| channel[l] != 0.0);
            if seen && materials.transmits(l) && materials.has_lobe(l) {
                self.cross_lobe(traced, travels, surfaces, (l, stage));
            }
        }
    }

    fn cross_lobe(
        &mut self,
        traced: &Traced,
        travels: TravelPacket,
        surfaces: &Surfaces,
        (l, stage): (usize, Stage),
    ) {
        let mut meeting = self.frame.meeting(traced, travels, surfaces, l);
        let arrival = meeting.arrival;
        let Some(lobe) = self.frame.lobe_at(surfaces, &arrival, meeting.normal, (l, stage)) else {
            return;
        };
        for number in 0..lobe.of {
            let numbers = self.lobe_numbers(traced, (l, stage), [number, lobe.of]);
            meeting.arrival = arrival.one_of(number, lobe.of);
            self.divide(&meeting, &Facet::Rough(lobe.microfacet(numbers)));
        }
    }

    /// The pair of numbers for microfacet `number` of `of` of the sample that lane `l` is a part of.
    fn lobe_numbers(&self, traced: &Traced, (l, stage): (usize, Stage), [number, of]: [u32; 2]) -> [f64; 2] {
        let draw = Draw {
            purpose: Purpose::LOBE.nested(stage.depth),
            number,
            of,
        };
        self.numbers(traced, l, draw)
    }
}

impl Travel {
    /// The same as ray `number` of the `of` rays into one lobe.
    fn one_of(self, number: u32, of: u32) -> Travel {
        Travel {
            sample: self.sample.wrapping_mul(of).wrapping_add(number),
            split: self.split.saturating_mul(of),
            ..self
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use glam::DAffine3;

    use super::*;
    use crate::scene::{Geometry, Instance};
    use crate::shape::Shape;

    #[test]
    fn the_width_of_a_ray_is_that_of_its_part_of_the_lobe() {
        let roughness = 0.25f32;
        let alpha = f64::from(roughness) * f64::from(roughness);
        let lobe = Lobe {
            of: 4,
            of_pixel: 4.0 * 16.0,
            ..Lobe::new(roughness, [DVec3::Z; 2], DVec3::Z).unwrap()
        };
        let middle = lobe.microfacet([0.0, 0.0]).reflected().unwrap();
        // One of 64 in the middle: 2 √π alpha over the root of 64.
        let expected = 2.0 * PI.sqrt() * alpha / 8.0;
        assert!(
            (middle.spread / expected - 1.0).abs() < 1e-12,
            "{}",
            middle.spread
        );
        assert_eq!((middle.direction, middle.share), (DVec3::Z, 0.25));
        // Far out the lobe is thin; a ray is never wider than a hemisphere.
        assert!(lobe.microfacet([0.0, 0.9]).reflected().unwrap().spread > middle.spread);
        assert_eq!(spread(0.0), TAU.sqrt());
    }

    #[test]
    fn waves_are_smaller_by_the_rays_of_a_lobe() {
        let effects = EffectSet::NONE.with(Effect::RoughReflection);
        let of = |rays: u32| {
            let mut material = Material::metallic_roughness([1.0; 3], 1.0, 0.5);
            if let crate::scene::Model::MetallicRoughness(model) = &mut material.model {
                model.rough_rays = rays;
            }
            Scene {
                geometries: vec![Geometry::Shape(Shape::Plane)],
                materials: vec![material],
                instances: vec![Instance::new("plane", 0, 0, DAffine3::IDENTITY).unwrap()],
                ..Scene::default()
            }
        };
        assert_eq!(camera_packets(&of(8), EffectSet::NONE), WAVE);
        for (rays, packets) in [(0, WAVE), (1, WAVE), (8, WAVE / 8), (200, 1)] {
            assert_eq!(camera_packets(&of(rays), effects), packets);
        }
    }
}
