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
//! No light counts twice. Shadow rays sample lights that rays cannot hit, and the whole lobe reflects them. Light of
//! the environment map and of emissive objects with light samples reaches the lobe of an opaque surface both ways
//! ([`super::super::lighting::CombinedSampling`]). All other light that rays can hit reaches it by lobe rays alone. The
//! ambient term keeps its diffuse part.
//!
//! Rays of one lobe start at one point with similar directions, so they are put into the same packet. Because one hit
//! may send many rays, a wave has fewer camera packets, which keeps queues as small as without lobes. The weight
//! cut-off compares the sum of all rays of a lobe.

use glam::{DVec3, Vec3};

use super::super::context::RenderContext;
use super::super::lighting::SampleIndex;
use super::super::profile::Category;
use super::super::sampler::Purpose;
use super::super::surface::Surfaces;
use super::super::wavefront::{
    BatchInfo, PathState, PathStatePacket, RayWorkItem, ShadingState, TracedPacket,
};
use super::dielectric::Interface;
use super::lobe_packet::LobePacket;
use super::lobe_rays::{LobeRayCounts, LobeRays};
use super::microfacet::GlossyLobe;
use crate::numeric::{LANES, Lanes, Ray};
use crate::scene::Effect;
use crate::shading::MaterialPacket;

impl RenderContext<'_> {
    /// Returns the number of microfacets that a path samples in lane `l` of `materials`, at a surface that is `depth`
    /// bounces from the camera: the material's number at depth 0, otherwise 1.
    pub(in crate::render) fn rough_rays(&self, materials: &MaterialPacket, depth: u32, l: usize) -> u32 {
        if depth == 0 {
            materials.extended.rough_rays[l]
        } else {
            1
        }
    }

    /// Returns the numbers of rays into the lobes of opaque surfaces; 0 for surfaces without a lobe, and for those that
    /// refract, whose rays `refract_rough_rays` sends.
    pub(in crate::render) fn lobe_ray_counts(
        &self,
        materials: &MaterialPacket,
        path_states: Option<PathStatePacket>,
        stage: BatchInfo,
    ) -> Lanes<u32> {
        let refracts = self.effects().has(Effect::Refraction);
        std::array::from_fn(|l| {
            if !materials.has_lobe(l) || refracts && materials.transmits(l) {
                return 0;
            }
            let path_depth = path_states.map_or(0, |states| states.depth(l));
            self.rough_rays(materials, self.depth_of(path_depth, stage), l)
        })
    }

    /// Returns the number of bounces from the camera to the surfaces of a batch, for a path that counts `path_depth`.
    pub(in crate::render) fn depth_of(&self, path_depth: u32, stage: BatchInfo) -> u32 {
        if self.effects().counts_bounces() {
            path_depth
        } else {
            stage.depth
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
        let of = self.rough_rays(&surfaces.materials, self.depth_of(arrival.depth, stage), l);
        let lobe = GlossyLobe::of_material(
            &surfaces.materials,
            l,
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
    pub(in crate::render) fn reflect_roughly(
        &mut self,
        traced: &TracedPacket,
        surfaces: &Surfaces,
        stage: BatchInfo,
    ) {
        let Some(path_states) = traced.path_states else {
            return;
        };
        // Count the rays into each lobe
        let frame = self.frame;
        let mut counts = LobeRayCounts {
            of: frame.lobe_ray_counts(&surfaces.materials, Some(path_states), stage),
            of_pixel: [0.0; LANES],
        };
        for l in 0..LANES {
            // Weights of a single wavelength may be negative, so that the sum of the channels is not a valid test.
            let seen = surfaces.points.hit[l] && traced.weight.iter().any(|channel| channel[l] != 0.0);
            if !seen {
                counts.of[l] = 0;
            }
            let of_sample = f64::from(counts.of[l]) * f64::from(path_states.split(l));
            counts.of_pixel[l] = of_sample * f64::from(frame.even_count);
        }
        let most = counts.of.into_iter().max().unwrap_or(0);
        if most == 0 {
            return;
        }
        // Reflect at the microfacets of all lanes, then send the rays of each lobe together
        let lobes = LobePacket::of(surfaces);
        let mut rays = std::mem::take(&mut self.lobe_rays);
        rays.clear();
        for number in 0..most {
            let numbers = self.lobe_number_packet(traced, &counts.of, [number, most], stage);
            rays.push(lobes.reflect(&numbers, &counts));
        }
        for l in (0..LANES).filter(|&l| counts.of[l] > 0) {
            let of = counts.of[l];
            self.send_into_lobe(traced, path_states, surfaces, (l, stage), &rays[..of as usize]);
        }
        self.lobe_rays = rays;
    }

    /// Queues the rays into the lobe of lane `l`.
    fn send_into_lobe(
        &mut self,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        surfaces: &Surfaces,
        (l, stage): (usize, BatchInfo),
        rays: &[LobeRays],
    ) {
        let origin = Vec3::from([0, 1, 2].map(|axis| surfaces.points.origin[axis][l]));
        let arrival = path_states.lane(l);
        let cone = self
            .frame
            .cone_at(traced, path_states, l)
            .reflected(surfaces.curvatures[l]);
        for (number, ray) in (0..).zip(rays).filter(|(_, ray)| ray.leaves[l]) {
            let direction = DVec3::from([0, 1, 2].map(|axis| ray.direction[axis][l]));
            let reflectance = surfaces.materials.microfacet_reflectance(ray.cos_i[l], l);
            let mut sent = RayWorkItem {
                ray: Ray::new(origin, direction.as_vec3()),
                pixel: traced.pixel[l],
                weight: std::array::from_fn(|c| traced.weight[c][l] * reflectance[c] * ray.share[l]),
                sender: Category::RoughReflection,
                travel: Some(PathState {
                    depth: arrival.depth + 1,
                    direction,
                    cone: cone.spread_by(ray.spread[l]),
                    density: ray.density[l],
                    ..arrival.one_of(number, rays.len() as u32)
                }),
            };
            self.send::<false>(&mut sent, stage.depth + 1);
        }
    }

    /// Queues the reflected and refracted rays at rough transmissive surfaces.
    pub(in crate::render) fn refract_rough_rays(
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
        // Raise the reflected rays by multiple scattering
        let raised = surfaces.materials.multiple_scattering_factors(l);
        (0..3).for_each(|c| boundary_hit.tints.reflected[c] *= raised[c]);
        // Scatter at each sampled microfacet
        for number in 0..lobe.of {
            let numbers = self.lobe_numbers(traced, (l, stage), [number, lobe.of]);
            boundary_hit.arrival = arrival.one_of(number, lobe.of);
            self.scatter_at_boundary(&boundary_hit, &Interface::Rough(lobe.microfacet(numbers)));
        }
    }

    /// Returns the random pairs for microfacet `number` of each lane, where lane `l` has `of[l]` of them, `most` at most.
    fn lobe_number_packet(
        &self,
        traced: &TracedPacket,
        of: &Lanes<u32>,
        [number, most]: [u32; 2],
        stage: BatchInfo,
    ) -> [Lanes<f64>; 2] {
        let purpose = Purpose::LOBE.nested(stage.depth);
        // Usually all lobes have equally many rays
        if of.iter().all(|&of| of == 0 || of == most) {
            return self.number_packet(
                traced,
                SampleIndex {
                    purpose,
                    number,
                    of: most,
                },
            );
        }
        let mut numbers = [[0.0; LANES]; 2];
        for l in (0..LANES).filter(|&l| number < of[l]) {
            let [first, second] = self.lobe_numbers(traced, (l, stage), [number, of[l]]);
            (numbers[0][l], numbers[1][l]) = (first, second);
        }
        numbers
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
