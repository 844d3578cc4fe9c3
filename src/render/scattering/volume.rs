//! Volume integrator: emission, scattering and transmittance along rays through smoke, fire and fog.
//!
//! The segment of a traced ray from its origin to its hit is marched before the hit is shaded: in-scattered and
//! emitted radiance goes to the film, and the path continues with its throughput times the transmittance. Samples
//! receive light from every light and from the environment map through shadow rays (single scattering with the
//! isotropic phase function 1 / 4 pi), and ambient light from all directions. All shadow rays, those of surfaces too,
//! are attenuated along their way.
//!
//! Computed in f64. Camera and secondary rays are marched one by one, because a march takes many samples per ray and
//! its packets consist of neighbours along the ray; shadow rays are marched by packet, because they take few samples.
//! Light that a volume scatters inside a dielectric is not absorbed by that dielectric.

use std::f64::consts::PI;

use glam::DVec3;
use multiversion::multiversion;

use super::super::aov::LightSource;
use super::super::context::RenderContext;
use super::super::lighting::{AreaLightSampler, PixelSample, SampleIndex, attenuate_shadow_rays, direct};
use super::super::profile::{Accounts, Category, Profiler};
use super::super::sampler::Purpose;
use super::super::surface::Surfaces;
use super::super::wavefront::{BatchInfo, PathPacket, PathStatePacket, ShadingState, ShadowQueue};
use super::march_state::{LightShares, attenuate};
use crate::accel::{ACTIVE, RayPacket};
use crate::numeric::{LANES, Lanes3};
use crate::optics::InteriorStack;
use crate::scene::{Effect, Light, LightKind};
use crate::shading::{TextureSet, sample_punctual_light};
use crate::volume::{March, PointLanes, RaySegment};

/// Isotropic phase function: the share of light that is scattered into a unit of solid angle.
const PHASE: f32 = (0.25 / PI) as f32;

impl ShadingState<'_, '_> {
    /// Marches the rays of a packet, adds their radiance to the film, and returns the throughput behind the volumes;
    /// `weight` is the throughput without them.
    pub(in crate::render) fn march(
        &mut self,
        packet: &RayPacket,
        (path, path_states): (&PathPacket, Option<PathStatePacket>),
        weight: &Lanes3<f32>,
        stage: BatchInfo,
    ) -> Lanes3<f32> {
        let mut left = *weight;
        self.meter.lap_shading();
        let Some(marches) = &mut self.marches else {
            return left;
        };
        let mut radiance = [[0.0; LANES]; 3];
        if let Some(shares) = &mut marches.shares {
            shares.begin_packet();
        }
        // March each active ray that has throughput
        for l in 0..LANES {
            let is_dark = (0..3).all(|channel| path.weight[channel][l] == 0.0);
            if packet.active[l] == 0 || is_dark {
                continue;
            }
            // Set up the lights for the samples of this ray
            let mut light_sampler = LightSampler {
                frame: self.frame,
                shadow: &mut marches.shadow,
                shadow_queue: &mut marches.shadow_queue,
                shares: marches.shares.as_mut(),
                source: LightSource::Emission,
                shadow_surfaces: self.shadow_surfaces.as_deref_mut(),
                meter: &mut self.meter,
                media: path_states.map_or(InteriorStack::EMPTY, |path_states| path_states.media(l)),
                stage,
                time: packet.time[l],
                origin: PixelSample {
                    corner: self.corner,
                    label: path.pixel[l],
                    sample: path_states.map_or(0, |path_states| path_states.sample(l)),
                },
            };
            let ray = packet.ray(l);
            let segment = RaySegment {
                origin: ray.origin.as_dvec3(),
                direction: ray.direction.as_dvec3(),
                t_near: f64::from(ray.t_near),
                t_far: f64::from(ray.t_far),
            };
            // Integrate radiance and transmittance along the ray
            let marched = marches
                .seen
                .radiance(&segment, Some(&mut |points| light_sampler.light(points)));
            self.meter.ledger.volume_samples += marched.sample_count;
            // Repeat the march per light for layers by light
            if let Some(shares) = &mut marches.shares {
                let weight = path.weight.map(|channel| channel[l]);
                shares.divide(&mut marches.seen, &segment, (weight, l));
            }
            for channel in 0..3 {
                radiance[channel][l] = path.weight[channel][l] * marched.radiance[channel] as f32;
                left[channel][l] *= marched.transmittance as f32;
            }
        }
        // Add the radiance to the film
        if radiance.as_flattened().iter().any(|&value| value != 0.0) {
            self.film.add(&path.pixel, &radiance, LightSource::Volume);
            if let (Some(light), Some(shares)) = (self.film.light(), &marches.shares) {
                for (plane, radiance) in shares.seen.iter().enumerate() {
                    light.add_to_plane(plane, &path.pixel, radiance);
                }
            }
        }
        let lanes = std::iter::once((&path.pixel, &packet.active));
        self.meter.lap_over(Category::Volume, lanes);
        self.meter.resume(&path.pixel, &packet.active);
        left
    }
}

/// Light sources for the samples of one march.
struct LightSampler<'a, 'f, 's> {
    frame: &'a RenderContext<'s>,
    shadow: &'a mut March<'f>,
    shadow_queue: &'a mut ShadowQueue,
    /// Radiance by light, if layers by light are requested.
    shares: Option<&'a mut LightShares>,
    /// Light that is being sampled.
    source: LightSource,
    shadow_surfaces: Option<&'a mut Surfaces>,
    meter: &'a mut Profiler,
    /// Dielectric interiors around the ray.
    media: InteriorStack,
    stage: BatchInfo,
    /// Time of the ray, as in [`crate::numeric::Ray::time`].
    time: f32,
    /// Pixel sample that the ray belongs to.
    origin: PixelSample,
}

impl LightSampler<'_, '_, '_> {
    /// Returns the radiance that matter of albedo 1 scatters towards the ray origin at `points`.
    fn light(&mut self, points: &PointLanes) -> Lanes3<f64> {
        let frame = self.frame;
        // Start with ambient light
        let mut arriving = frame.ambient.map(|ambient| [f64::from(ambient); LANES]);
        if let Some(shares) = &mut self.shares {
            shares.begin_call(&arriving);
        }
        let lights = frame.scene.lights.iter().zip(&frame.plan.casts_shadows);
        for (number, (light, &casts)) in lights.enumerate() {
            self.source = LightSource::Light(number as u32);
            // Add punctual lights
            let LightKind::Area { samples, .. } = light.kind else {
                let (packet, payload) = self.shadow_queue.next();
                if sample_light(light, points, packet, &mut payload.radiance) {
                    self.add(casts, &mut arriving);
                }
                continue;
            };
            let Some(Some(shape)) = frame.area_lights.get(number) else {
                continue;
            };
            // Add area lights, sampled with the numbers of the pixel sample
            for sample in 0..samples {
                let draw = SampleIndex {
                    purpose: Purpose::LIGHT.nested(number as u32).nested(self.stage.depth),
                    number: sample,
                    of: samples,
                };
                let u = self.origin.numbers(&frame.settings, draw);
                let share = PHASE / samples as f32;
                let (packet, payload) = self.shadow_queue.next();
                let radiance = light.intensity.map(|channel| channel * share);
                let textures = frame.surfaces.textures();
                if sample_area_light(
                    (shape, radiance, u),
                    (textures, points),
                    packet,
                    &mut payload.radiance,
                ) {
                    self.add(casts, &mut arriving);
                }
            }
        }
        // Add the environment map
        if frame.effects().has(Effect::Environment) {
            self.source = LightSource::Environment;
            self.add_environment_light(points, &mut arriving);
        }
        arriving
    }

    /// Adds the light of the environment map at `points` to `arriving`.
    fn add_environment_light(&mut self, points: &PointLanes, arriving: &mut Lanes3<f64>) {
        let frame = self.frame;
        let Some(environment) = &frame.environment else {
            return;
        };
        for draw in environment.draws(self.stage) {
            let u = self.origin.numbers(&frame.settings, draw);
            let Some(sample) = environment.map().sample(u) else {
                continue;
            };
            let share = PHASE * (sample.pdf * f64::from(draw.of)).recip() as f32;
            let sent = sample.radiance.map(|channel| channel * share);
            let (packet, payload) = self.shadow_queue.next();
            if sample_direction((sample.direction, sent), points, packet, &mut payload.radiance) {
                self.add(frame.effects().has(Effect::Shadow), arriving);
            }
        }
    }

    /// Traces the packet of shadow rays last written and adds its light to `arriving`.
    fn add(&mut self, casts: bool, arriving: &mut Lanes3<f64>) {
        self.shadow_queue.next().1.pixel = [self.origin.label; LANES];
        let radiance = self.trace_last_packet(casts);
        if let Some(plane) = self.frame.light_sheet.plane_of(self.source)
            && let Some(shares) = &mut self.shares
        {
            shares.add(plane, &radiance);
        }
        for channel in 0..3 {
            for l in 0..LANES {
                arriving[channel][l] += f64::from(radiance[channel][l]);
            }
        }
    }

    /// Returns the light that arrives along the packet of shadow rays last written.
    fn trace_last_packet(&mut self, casts: bool) -> Lanes3<f32> {
        let reach = self.shadow_queue.next().0.t_far;
        // Test the shadow rays, with transparent shadows if the scene has them
        if casts {
            if self.frame.effects().has(Effect::MotionBlur) {
                self.shadow_queue.next().0.time = [self.time; LANES];
            }
            self.shadow_queue.set_medium(&self.media);
            self.shadow_queue.commit();
            let mut queued = self.shadow_queue.drain_all();
            let lanes = std::iter::once((&queued.payloads[0].pixel, &queued.packets[0].active));
            self.meter.lap_over(Category::Volume, lanes);
            // Attenuate by transmissive surfaces, or test for occlusion
            match &mut self.shadow_surfaces {
                Some(shadow_surfaces) => {
                    attenuate_shadow_rays(
                        self.frame,
                        &mut queued,
                        shadow_surfaces,
                        self.meter,
                        self.stage.order,
                    );
                }
                None => {
                    let (packets, payloads) = (queued.packets, queued.payloads);
                    let accel = self.frame.accel;
                    let labels_and_accounts = |_| (&payloads[0].pixel, Accounts::All(Category::Shadow));
                    let traced = self.meter.trace(packets, labels_and_accounts, |packets, _| {
                        accel.occluded(packets, self.stage.order)
                    });
                    self.meter.ledger.book(Category::Shadow, traced);
                    direct::block(&packets[0], &mut payloads[0].radiance);
                }
            }
        }
        // After draining, `next` is still the memory of the packet just traced.
        let (packet, payload) = self.shadow_queue.next();
        self.meter.ledger.volume_samples += attenuate(self.shadow, packet, &reach, &mut payload.radiance);
        payload.radiance
    }
}

/// Fills the shadow-ray packet from `points` to a punctual light, and the unoccluded radiance scattered towards the
/// ray origin. Returns whether any lane is active.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn sample_light(
    light: &Light,
    points: &PointLanes,
    packet: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    let arriving = sample_punctual_light(light, &points.points);
    let mut any = 0;
    // Scale the intensity by phase function and attenuation
    for l in 0..LANES {
        let is_active = points.active >> l & 1 == 1;
        let share = if is_active {
            PHASE * arriving.attenuation[l]
        } else {
            0.0
        };
        let mut largest = 0.0f32;
        for channel in 0..3 {
            radiance[channel][l] = light.intensity[channel] * share;
            largest = largest.max(radiance[channel][l]);
        }
        packet.active[l] = -i32::from(largest > 0.0);
        any |= packet.active[l];
        for axis in 0..3 {
            packet.origin[axis][l] = points.points[axis][l] as f32;
        }
    }
    // Aim the shadow rays from the f32 origins
    match light.kind {
        LightKind::Directional { .. } => direct::aim_along(&arriving.wi, packet),
        LightKind::Point { position, .. } | LightKind::Spot { position, .. } => {
            direct::aim_at(&position.to_array().map(|axis| [axis; LANES]), packet);
        }
        // Area lights are sampled point by point
        LightKind::Area { .. } => return false,
    }
    any != 0
}

/// Fills the shadow-ray packet from `points` to the points of an area light that the numbers `u` select, and the
/// unoccluded radiance for the given `intensity`. Returns whether any lane is active. All samples along a ray use the
/// same numbers.
fn sample_area_light(
    (light, intensity, u): (&AreaLightSampler, [f32; 3], [f64; 2]),
    (textures, points): (&TextureSet, &PointLanes),
    packet: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    // Deactivate lanes without a sample
    *radiance = [[0.0; LANES]; 3];
    packet.active = [0; LANES];
    packet.t_far = [1.0; LANES];
    for l in (0..LANES).filter(|l| points.active >> l & 1 == 1) {
        let p = DVec3::from([0, 1, 2].map(|axis| points.points[axis][l]));
        let Some(sample) = light.sample(textures, p, u) else {
            continue;
        };
        // Aim from the f32 origin and divide by the density
        packet.active[l] = ACTIVE;
        for axis in 0..3 {
            let origin = p[axis] as f32;
            packet.origin[axis][l] = origin;
            packet.direction[axis][l] = (sample.end[axis] - f64::from(origin)) as f32;
            radiance[axis][l] = intensity[axis] * sample.tint[axis] * sample.pdf.recip() as f32;
        }
    }
    packet.any_active()
}

/// Fills the shadow-ray packet from `points` along one direction, with infinite length; `sent` is the radiance
/// scattered towards the ray origin. Returns whether any lane is active.
fn sample_direction(
    (direction, sent): (DVec3, [f32; 3]),
    points: &PointLanes,
    packet: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    packet.t_far = [f32::INFINITY; LANES];
    for l in 0..LANES {
        let is_active = points.active >> l & 1 == 1 && sent != [0.0; 3];
        packet.active[l] = if is_active { ACTIVE } else { 0 };
        for axis in 0..3 {
            packet.origin[axis][l] = points.points[axis][l] as f32;
            packet.direction[axis][l] = direction[axis] as f32;
            radiance[axis][l] = if is_active { sent[axis] } else { 0.0 };
        }
    }
    packet.any_active()
}

impl RenderContext<'_> {
    /// Returns whether the scene has volumes or fog to be marched.
    #[inline(always)]
    pub(in crate::render) fn marches(&self) -> bool {
        self.effects().has(Effect::Volume)
    }
}
