//! Area lights: shadow rays to sampled points of lights with an extent.
//!
//! Each surface interaction samples some points of every area light, with the numbers of its pixel sample for
//! [`Purpose::LIGHT`], the light and the bounce. The samples of a pixel are therefore stratified over the light, and
//! nothing depends on the thread or on the order of rendering. The radiance of the light divided by the density of
//! the direction is an unbiased estimate of the unoccluded irradiance ([`crate::shading::AreaLight`]). Rays into
//! which one ray splits at a surface use the same points.
//!
//! Smooth surfaces see emissive objects by mirror rays. Shadow rays to these lights therefore leave out the specular
//! lobe, which would count twice. Rough lobes are shared with lobe rays ([`super::combined_sampling`]).

use glam::DVec3;
use multiversion::multiversion;

use super::super::aov::LightSource;
use super::super::profile::Category;
use super::super::sampler::Purpose;
use super::super::wavefront::{BatchInfo, ShadingState, TracedPacket};
use super::area_light_sampler::AreaLightSampler;
use super::direct::{self, IncidentLight, ShadingContext};
use super::sample_index::{PixelSample, SampleIndex};
use crate::numeric::{LANES, Lanes};
use crate::scene::{Effect, LightKind, LightSamplePacket};

/// Returns the incident light of `radiance` from sampled points, divided by `count`, at the surfaces that were hit.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn incident_light(
    samples: &LightSamplePacket,
    hit: &Lanes<bool>,
    radiance: [f32; 3],
    count: f64,
) -> IncidentLight {
    let mut arrivals = IncidentLight::NONE;
    for l in 0..LANES {
        let is_sample = hit[l] & (samples.pdf[l] > 0.0);
        let share = (samples.pdf[l] * count).recip() as f32;
        for axis in 0..3 {
            let wi = samples.direction[axis][l] as f32;
            arrivals.wi[axis][l] = if is_sample { wi } else { 0.0 };
            arrivals.irradiance[axis][l] = if is_sample { radiance[axis] * share } else { 0.0 };
        }
    }
    arrivals.from = Some(samples.position);
    arrivals
}

/// Returns the numbers of lobe rays over the densities of light samples times their number; 0 in lanes without a sample.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn lobe_ratios(lobe_rays: &Lanes<f32>, pdf: &Lanes<f64>, (count, hit): (f64, &Lanes<bool>)) -> Lanes<f32> {
    let mut ratios = [0.0; LANES];
    for l in 0..LANES {
        let share = (pdf[l] * count).recip() as f32;
        let is_sample = hit[l] & (pdf[l] > 0.0);
        ratios[l] = if is_sample { lobe_rays[l] * share } else { 0.0 };
    }
    ratios
}

impl ShadingState<'_, '_> {
    /// Queues shadow rays to sampled points of light `number`. Returns `false` if that light is not an area light.
    pub(in crate::render) fn queue_area_light(
        &mut self,
        number: usize,
        traced: &TracedPacket,
        lit: &ShadingContext,
        stage: BatchInfo,
    ) -> bool {
        let frame = self.frame;
        let light = &frame.scene.lights[number];
        let LightKind::Area { samples, .. } = light.kind else {
            return false;
        };
        let samples = stage.light_samples(samples);
        let Some(Some(shape)) = frame.area_lights.get(number) else {
            return true;
        };
        // Share lobes with lobe rays, or leave out lobes that secondary rays sample already
        let effects = frame.effects();
        let is_mirrored = shape.is_seen() && (effects.has(Effect::Reflection) || effects.has_lobes());
        let is_combined = shape.is_seen() && frame.combined.shares_emissive_objects();
        let (lit, lobe_rays) = if is_combined {
            let (lit, counts) = self.with_shared_lobes(traced, lit, stage);
            (lit, Some(counts))
        } else if is_mirrored {
            (lit.without_sampled_lobes(), None)
        } else {
            (*lit, None)
        };
        // Draw the samples, from all hit points at once if no surface of the scene emits the light
        let view = shape.view_packet(&lit.points.p);
        let purpose = Purpose::LIGHT.nested(number as u32).nested(stage.depth);
        for sample in 0..samples {
            let draw = SampleIndex {
                purpose,
                number: sample,
                of: samples,
            };
            let numbers = self.number_packet(traced, draw);
            let count = f64::from(samples);
            let arrivals = match &view {
                Some(view) => {
                    let samples = shape.sample_packet(view, &lit.points.p, &numbers);
                    incident_light(&samples, &lit.points.hit, light.intensity, count)
                }
                None => {
                    self.sample_emissive_object(shape, light.intensity, (&lit, &numbers), (count, lobe_rays))
                }
            };
            self.queue_shadow_rays(&arrivals, (traced, &lit), frame.plan.casts_shadows[number], stage);
        }
        true
    }

    /// Returns the incident light from one sampled point of an emissive object at each surface, divided by `count`;
    /// `lobe_rays` are the numbers of rays into lobes that share the samples.
    fn sample_emissive_object(
        &self,
        light: &AreaLightSampler,
        radiance: [f32; 3],
        (lit, numbers): (&ShadingContext, &[Lanes<f64>; 2]),
        (count, lobe_rays): (f64, Option<&Lanes<f32>>),
    ) -> IncidentLight {
        // Sample meshes without a texture in lanes
        if let Some(samples) = light.sample_mesh(&lit.points.origin, numbers) {
            let mut arrivals = incident_light(&samples, &lit.points.hit, radiance, count);
            arrivals.lobe_ratios =
                lobe_rays.map(|counts| lobe_ratios(counts, &samples.pdf, (count, &lit.points.hit)));
            return arrivals;
        }
        let mut arrivals = IncidentLight::NONE;
        let mut ratios = [0.0; LANES];
        let textures = self.frame.surfaces.textures();
        let mut from = [[0.0; LANES]; 3];
        for l in (0..LANES).filter(|&l| lit.points.hit[l]) {
            // The hit point may lie on the emissive object itself, so use the origin that is offset from the surface.
            let p = DVec3::from([0, 1, 2].map(|axis| f64::from(lit.points.origin[axis][l])));
            let Some(sample) = light.sample(textures, p, [numbers[0][l], numbers[1][l]]) else {
                continue;
            };
            // Store direction, light point and irradiance
            let share = (sample.pdf * count).recip() as f32;
            ratios[l] = lobe_rays.map_or(0.0, |counts| counts[l] * share);
            for axis in 0..3 {
                arrivals.wi[axis][l] = sample.direction[axis] as f32;
                from[axis][l] = sample.end[axis];
                arrivals.irradiance[axis][l] = radiance[axis] * sample.tint[axis] * share;
            }
        }
        arrivals.from = Some(from);
        arrivals.lobe_ratios = lobe_rays.map(|_| ratios);
        arrivals
    }

    /// Queues a packet of shadow rays if any lane would contribute.
    pub(in crate::render) fn queue_shadow_rays(
        &mut self,
        arrivals: &IncidentLight,
        (traced, lit): (&TracedPacket, &ShadingContext),
        casts: bool,
        stage: BatchInfo,
    ) {
        self.make_room(traced, stage);
        let reaches_lobes = |ratios: &Lanes<f32>| ratios.iter().any(|&ratio| ratio > 0.0);
        let is_split =
            self.frame.combined.splits_shadows && arrivals.lobe_ratios.as_ref().is_some_and(reaches_lobes);
        let base = is_split.then(|| lit.without_sampled_lobes());
        let (packet, payload) = self.shadow_queue.next();
        // Evaluate the light to the surface without its lobes
        let mut without_lobes = [[0.0; LANES]; 3];
        if let Some(base) = &base {
            direct::sample_direct_area(arrivals, base, packet, &mut without_lobes);
        }
        if direct::sample_direct_area(arrivals, lit, packet, &mut payload.radiance) {
            // Keep the light to the lobes apart
            if is_split {
                let whole = std::mem::replace(&mut payload.radiance, without_lobes);
                let difference = |c: usize, l: usize| whole[c][l] - without_lobes[c][l];
                let lobes = std::array::from_fn(|c| std::array::from_fn(|l| difference(c, l)));
                self.shadow_queue.set_lobe_radiance(&lobes);
            }
            self.shadow_queue.set_end(None);
            self.commit_shadow_rays::<false>(traced, casts);
        }
    }

    /// Traces the queued shadow rays if there is no room for another packet.
    #[inline(always)]
    pub(super) fn make_room(&mut self, traced: &TracedPacket, stage: BatchInfo) {
        if self.shadow_queue.is_full() {
            self.meter.part(Category::Lighting);
            self.trace_shadow_rays::<false>(stage.order);
            self.meter.resume(traced.pixel, &traced.packet.active);
        }
    }

    /// Returns the random pairs of the samples that the lanes belong to.
    pub(in crate::render) fn number_packet(
        &self,
        traced: &TracedPacket,
        draw: SampleIndex,
    ) -> [Lanes<f64>; 2] {
        let samples = traced
            .path_states
            .map_or([0; LANES], |path_states| path_states.samples());
        draw.number_packet(self.corner, traced.pixel, &samples, &self.frame.settings)
    }

    /// Returns the random pair of the sample that lane `l` belongs to.
    pub(in crate::render) fn numbers(&self, traced: &TracedPacket, l: usize, draw: SampleIndex) -> [f64; 2] {
        PixelSample {
            corner: self.corner,
            label: traced.pixel[l],
            sample: traced.path_states.map_or(0, |path_states| path_states.sample(l)),
        }
        .numbers(&self.frame.settings, draw)
    }

    /// Commits the packet of shadow rays last written; packets to a light that cannot be occluded are not traced.
    pub(in crate::render) fn commit_shadow_rays<const BASIC: bool>(
        &mut self,
        traced: &TracedPacket,
        casts: bool,
    ) {
        let effects = self.effects::<BASIC>();
        if !BASIC {
            self.shadow_queue.set_source(self.current_source);
            if effects.has(Effect::Caustics) {
                let has_photons = match self.current_source {
                    LightSource::Light(number) => self.frame.emits_photons(number as usize),
                    _ => false,
                };
                self.shadow_queue.set_photons(has_photons);
            }
        }
        let (packet, payload) = self.shadow_queue.next();
        payload.pixel = *traced.pixel;
        if effects.has(Effect::MotionBlur) {
            packet.time = traced.packet.time;
        }
        if !casts {
            // Not traced, but queued, because radiance is summed in the order of sampling.
            packet.active = [0; LANES];
        }
        self.shadow_queue.commit();
        if let Some(path_states) = traced.path_states.filter(|_| effects.has(Effect::Refraction)) {
            self.shadow_queue.set_media(path_states);
        }
    }
}
