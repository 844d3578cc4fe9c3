//! Glossy (GGX) reflection and transmission: rays into the lobes of rough surfaces, for materials that request them.
//!
//! The first surface that a path hits samples as many microfacets as its material requests, and every later surface
//! samples one ([`Ggx`]; R. Cook, T. Porter and L. Carpenter, "Distributed ray tracing", SIGGRAPH 1984). Each
//! microfacet reflects a ray, and on transmissive surfaces refracts another, like a smooth surface with the
//! orientation of the microfacet. Fresnel's factor is that of the microfacet, and rays that leave on the wrong side
//! of the surface contribute nothing. The random numbers are those of the pixel sample for [`Purpose::LOBE`] and the
//! bounce, so that the microfacets of all samples of a pixel form one stratified set. From there on, rays into a lobe
//! count as separate samples, so that their light samples are stratified as well.
//!
//! No light counts twice. Shadow rays sample lights that rays cannot hit, and the whole lobe reflects them. Light
//! that rays can hit (the environment map, emissive objects and lit surfaces) reaches the lobe by lobe rays alone.
//! The ambient term keeps its diffuse part.
//!
//! Rays of one lobe start at one point with similar directions, so they are put into the same packet. Because one hit
//! may send many rays, a wave has fewer camera packets, which keeps queues as small as without lobes. The weight
//! cut-off compares the sum of all rays of a lobe.

use std::f64::consts::TAU;

use glam::{DMat3, DVec3, Vec3};

use super::RenderContext;
use super::ledger::Category;
use super::outcome::{BatchInfo, ShadingState, TracedPacket};
use super::queue::RayWorkItem;
use super::sampler::Purpose;
use super::soft::SampleIndex;
use super::surface::Surfaces;
use super::transparent::{Boundary, Interface};
use super::travel::{PathState, PathStatePacket};
use super::wave::WAVE;
use crate::numeric::{LANES, Lanes3, Ray};
use crate::optics::{reflect, refract};
use crate::scene::{Effect, EffectSet, Material, Scene};
use crate::shading::Ggx;

/// Returns the number of camera packets per wave: so few that their lobe rays are no more than the mirror rays of a
/// wave without lobes, but at least one.
pub(super) fn camera_packets(scene: &Scene, effects: EffectSet) -> usize {
    if !effects.has_lobes() {
        return WAVE;
    }
    // Materials that no instance uses do not count.
    let used = scene
        .instances
        .iter()
        .map(|instance| &scene.materials[instance.material as usize]);
    let max_rays = used.map(Material::rough_rays).max();
    (WAVE / max_rays.unwrap_or(0).max(1) as usize).max(1)
}

/// Scattered ray, without its origin.
pub(super) struct ScatteredRay {
    /// Unit direction in world space.
    pub(super) direction: DVec3,
    /// Cosines of the angles of the incident and the scattered ray with the surface normal or a microfacet normal.
    pub(super) cosines: [f64; 2],
    /// Weight of the radiance along the ray, without Fresnel's factor and tints.
    pub(super) share: f32,
    /// Increase of the spread of the ray cone, from the width of the lobe.
    pub(super) spread: f64,
}

/// Lobe of a rough surface for one incident direction.
struct GlossyLobe {
    ggx: Ggx,
    /// Rotation from the shading frame, whose z axis is the normal, to world space.
    world_from_lobe: DMat3,
    /// Unit vector to the origin of the incident ray, in the shading frame.
    wo: DVec3,
    /// Unit geometric normal on the side of the incident ray, in world space.
    side: DVec3,
    /// Number of microfacets that this hit samples.
    of: u32,
    /// Number of microfacets that all samples of the pixel draw together.
    of_pixel: f64,
}

/// Microfacet of a rough surface, which scatters like a mirror.
pub(super) struct Microfacet<'a> {
    lobe: &'a GlossyLobe,
    /// Unit normal of the microfacet, in the shading frame.
    m: DVec3,
}

impl GlossyLobe {
    /// Returns the lobe of a surface with this roughness and unit normal `n` for light towards `wo`; `None` if `wo`
    /// is below the surface.
    fn new(roughness: f32, [n, side]: [DVec3; 2], wo: DVec3) -> Option<GlossyLobe> {
        let (t, b) = n.any_orthonormal_pair();
        let world_from_lobe = DMat3::from_cols(t, b, n);
        let wo = world_from_lobe.transpose() * wo;
        (wo.z > 0.0).then(|| GlossyLobe {
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

    /// Returns the ray along `wi`, which has the density `pdf` and is transmitted if `wi` is below the surface;
    /// `None` if it leaves on the wrong side of the geometric surface.
    fn scattered_ray(&self, wi: DVec3, cosines: [f64; 2], [visible, pdf]: [f64; 2]) -> Option<ScatteredRay> {
        let direction = self.world_from_lobe * wi;
        // With an interpolated normal, a direction may lie on the wrong side of the geometric surface.
        (direction.dot(self.side) * wi.z > 0.0).then(|| ScatteredRay {
            direction,
            cosines,
            share: (visible / f64::from(self.of)) as f32,
            spread: spread(pdf * self.of_pixel),
        })
    }
}

/// Returns the spread of a ray with `density` per steradian: the root of the solid angle that it stands for, at most
/// a hemisphere, as for the cone of a pixel.
///
/// For incidence along the normal, the centre of the lobe has the density 1 / (4 π alpha²), and a single ray the
/// spread 2 √π alpha.
fn spread(density: f64) -> f64 {
    density.sqrt().recip().min(TAU.sqrt())
}

impl Microfacet<'_> {
    /// Returns the cosine of the angle of incidence on the microfacet.
    pub(super) fn cos_i(&self) -> f64 {
        self.lobe.wo.dot(self.m).clamp(0.0, 1.0)
    }

    /// Returns the reflected ray, or `None` if it points into the surface.
    pub(super) fn reflected(&self) -> Option<ScatteredRay> {
        let GlossyLobe { ggx, wo, .. } = self.lobe;
        let wi = reflect(-wo, self.m);
        if !(wi.z > 0.0) {
            return None;
        }
        let weights = [ggx.smith_g1(wi), ggx.reflection_pdf(*wo, wi)];
        self.lobe.scattered_ray(wi, [self.cos_i(); 2], weights)
    }

    /// Returns the refracted ray, or `None` with total internal reflection or if the ray does not leave behind the
    /// surface.
    ///
    /// Behind a thin surface are its interior and its equally rough back side, which `KHR_materials_transmission`
    /// models by the mirrored lobe on the far side.
    pub(super) fn refracted(&self, boundary: &Boundary, [eta_i, eta_t]: [f64; 2]) -> Option<ScatteredRay> {
        let GlossyLobe { ggx, wo, .. } = self.lobe;
        // Mirror the reflected lobe to the far side of a thin surface
        if boundary.is_thin_surface() {
            let mirrored = reflect(-wo, self.m);
            if !(mirrored.z > 0.0) {
                return None;
            }
            let weights = [ggx.smith_g1(mirrored), ggx.reflection_pdf(*wo, mirrored)];
            let wi = mirrored.with_z(-mirrored.z);
            return self.lobe.scattered_ray(wi, [self.cos_i(); 2], weights);
        }
        if eta_i == eta_t {
            // Without a change of index, roughness has no effect.
            return self
                .lobe
                .scattered_ray(-wo, [self.cos_i(); 2], [1.0, f64::INFINITY]);
        }
        // Refract at the microfacet
        let refraction = refract(-wo, self.m, eta_i, eta_t)?;
        let wi = refraction.direction;
        if !(wi.z < 0.0) {
            return None;
        }
        let pdf = ggx.transmission_pdf(*wo, wi, eta_t / eta_i);
        let cosines = [self.cos_i(), refraction.cos_t];
        self.lobe.scattered_ray(wi, cosines, [ggx.smith_g1(wi), pdf])
    }
}

impl RenderContext<'_> {
    /// Returns the number of microfacets that a path samples at the surface in lane `l`: the material's number at
    /// depth 0, otherwise 1.
    fn rough_rays(&self, surfaces: &Surfaces, travel: &PathState, (l, stage): (usize, BatchInfo)) -> u32 {
        let depth = if self.effects().has_transmission() {
            travel.depth
        } else {
            stage.depth
        };
        if depth == 0 {
            surfaces.materials.extended.rough_rays[l]
        } else {
            1
        }
    }

    /// Returns the lobe at lane `l` for a ray with the path state `arrival`.
    fn lobe_at(
        &self,
        surfaces: &Surfaces,
        arrival: &PathState,
        n: DVec3,
        (l, stage): (usize, BatchInfo),
    ) -> Option<GlossyLobe> {
        let points = &surfaces.points;
        let of = self.rough_rays(surfaces, arrival, (l, stage));
        let lobe = GlossyLobe::new(
            surfaces.materials.roughness[l],
            [n, points.geometric_normal(l)],
            -arrival.direction,
        )?;
        Some(GlossyLobe {
            of,
            of_pixel: f64::from(of) * f64::from(arrival.split) * f64::from(self.even_count),
            ..lobe
        })
    }
}

impl ShadingState<'_, '_> {
    /// Queues the rays into the lobes of opaque surfaces. Transmissive surfaces queue theirs in
    /// `refract_rough_rays`.
    pub(super) fn reflect_roughly(&mut self, traced: &TracedPacket, surfaces: &Surfaces, stage: BatchInfo) {
        let Some(path_states) = traced.path_states else {
            return;
        };
        let divides = self.frame.effects().has(Effect::Refraction);
        for l in 0..LANES {
            let materials = &surfaces.materials;
            // Weights of a single wavelength may be negative, so that the sum of the channels is not a valid test.
            let seen = surfaces.points.hit[l] && traced.weight.iter().any(|channel| channel[l] != 0.0);
            if seen && materials.has_lobe(l) && !(divides && materials.transmits(l)) {
                self.reflect_lobe(traced, path_states, surfaces, (l, stage));
            }
        }
    }

    fn reflect_lobe(
        &mut self,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        surfaces: &Surfaces,
        (l, stage): (usize, BatchInfo),
    ) {
        // Build the lobe in the shading frame
        let frame = self.frame;
        let points = &surfaces.points;
        let vector = |v: &Lanes3<f32>| Vec3::new(v[0][l], v[1][l], v[2][l]);
        let arrival = PathState {
            // The path state holds a direction only with refraction.
            direction: -vector(&points.wo).as_dvec3().normalize(),
            ..path_states.lane(l)
        };
        let Some(lobe) = frame.lobe_at(surfaces, &arrival, points.shading_normal(l), (l, stage)) else {
            return;
        };
        let cone =
            frame
                .cone_at(traced, path_states, l)
                .reflected(frame.curvature(traced.packet, surfaces, l));
        // Sample microfacets and spawn their reflected rays
        for number in 0..lobe.of {
            let facet = lobe.microfacet(self.lobe_numbers(traced, (l, stage), [number, lobe.of]));
            let Some(scattered_ray) = facet.reflected() else {
                continue;
            };
            let fresnel = surfaces.materials.fresnel(facet.cos_i() as f32, l);
            let sent = RayWorkItem {
                ray: Ray::new(vector(&points.origin), scattered_ray.direction.as_vec3()),
                pixel: traced.pixel[l],
                weight: std::array::from_fn(|c| traced.weight[c][l] * fresnel[c] * scattered_ray.share),
                sender: Category::RoughReflection,
                travel: Some(PathState {
                    depth: arrival.depth + 1,
                    direction: scattered_ray.direction,
                    cone: cone.spread_by(scattered_ray.spread),
                    ..arrival.one_of(number, lobe.of)
                }),
            };
            self.send::<false>(&sent, stage.depth + 1);
        }
    }

    /// Queues the reflected and refracted rays at rough transmissive surfaces.
    pub(super) fn refract_rough_rays(
        &mut self,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        surfaces: &Surfaces,
        stage: BatchInfo,
    ) {
        for l in 0..LANES {
            let materials = &surfaces.materials;
            let seen = surfaces.points.hit[l] && traced.weight.iter().any(|channel| channel[l] != 0.0);
            if seen && materials.transmits(l) && materials.has_lobe(l) {
                self.cross_lobe(traced, path_states, surfaces, (l, stage));
            }
        }
    }

    fn cross_lobe(
        &mut self,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        surfaces: &Surfaces,
        (l, stage): (usize, BatchInfo),
    ) {
        let mut boundary_hit = self.frame.boundary_hit(traced, path_states, surfaces, l);
        let arrival = boundary_hit.arrival;
        let Some(lobe) = self
            .frame
            .lobe_at(surfaces, &arrival, boundary_hit.normal, (l, stage))
        else {
            return;
        };
        // Scatter at each sampled microfacet
        for number in 0..lobe.of {
            let numbers = self.lobe_numbers(traced, (l, stage), [number, lobe.of]);
            boundary_hit.arrival = arrival.one_of(number, lobe.of);
            self.scatter_at_boundary(&boundary_hit, &Interface::Rough(lobe.microfacet(numbers)));
        }
    }

    /// Returns the random pair for microfacet `number` of `of`, for the sample of lane `l`.
    fn lobe_numbers(
        &self,
        traced: &TracedPacket,
        (l, stage): (usize, BatchInfo),
        [number, of]: [u32; 2],
    ) -> [f64; 2] {
        let draw = SampleIndex {
            purpose: Purpose::LOBE.nested(stage.depth),
            number,
            of,
        };
        self.numbers(traced, l, draw)
    }
}

impl PathState {
    /// Returns the state of ray `number` of the `of` rays into one lobe.
    fn one_of(self, number: u32, of: u32) -> PathState {
        PathState {
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
    fn ray_width_covers_its_share_of_the_lobe() {
        let roughness = 0.25f32;
        let alpha = f64::from(roughness) * f64::from(roughness);
        let lobe = GlossyLobe {
            of: 4,
            of_pixel: 4.0 * 16.0,
            ..GlossyLobe::new(roughness, [DVec3::Z; 2], DVec3::Z).unwrap()
        };
        let middle = lobe.microfacet([0.0, 0.0]).reflected().unwrap();
        // One of 64 rays at the centre: 2 √π alpha over the root of 64.
        let expected = 2.0 * PI.sqrt() * alpha / 8.0;
        assert!(
            (middle.spread / expected - 1.0).abs() < 1e-12,
            "{}",
            middle.spread
        );
        assert_eq!((middle.direction, middle.share), (DVec3::Z, 0.25));
        // Far from the centre the density is low; a ray is never wider than a hemisphere.
        assert!(lobe.microfacet([0.0, 0.9]).reflected().unwrap().spread > middle.spread);
        assert_eq!(spread(0.0), TAU.sqrt());
    }

    #[test]
    fn wave_size_is_divided_by_rays_per_lobe() {
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
