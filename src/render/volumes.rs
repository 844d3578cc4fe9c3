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

use super::lamps::AreaLightSampler;
use super::ledger::Category;
use super::light_layers::{LightGroups, LightSource};
use super::memory::Memory;
use super::meter::{Accounts, Profiler};
use super::outcome::{BatchInfo, ShadingState};
use super::queue::{PathPacket, ShadowQueue};
use super::sampler::Purpose;
use super::soft::{PixelSample, SampleIndex};
use super::surface::Surfaces;
use super::tinted::attenuate_shadow_rays;
use super::travel::PathStatePacket;
use super::{RenderContext, shade};
use crate::accel::{ACTIVE, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::optics::InteriorStack;
use crate::scene::{Effect, Light, LightKind};
use crate::shading::{TextureSet, sample_punctual_light};
use crate::volume::{March, PointLanes, RaySegment};

/// Isotropic phase function: the share of light that is scattered into a unit of solid angle.
const PHASE: f32 = (0.25 / PI) as f32;

/// Ray-marching state and working memory of one thread.
pub(super) struct MarchState<'f> {
    /// March along camera rays and secondary rays.
    seen: March<'f>,
    /// March along shadow rays, used while the other march is in progress.
    shadow: March<'f>,
    /// Shadow rays from the samples of a march to one light at a time.
    shadow_queue: Box<ShadowQueue>,
    /// Radiance by light, if layers by light are requested.
    shares: Option<LightShares>,
}

impl<'f> MarchState<'f> {
    pub(super) fn new(frame: &RenderContext<'f>) -> MarchState<'f> {
        let fog = frame.scene.fog.filter(|_| frame.scene.has_fog());
        let march = || March::new(&frame.scene.volumes, fog).with_skip(frame.settings.skip_empty);
        MarchState {
            seen: march(),
            shadow: march(),
            shadow_queue: ShadowQueue::new(frame.effects()),
            shares: LightShares::of(&frame.light_sheet),
        }
    }

    /// Adds the bytes of the marches and of their shadow rays.
    pub(super) fn add_to(&self, memory: &mut Memory) {
        let own = size_of::<MarchState>() + ShadowQueue::BYTES;
        memory.add(Effect::Volume.name(), "marches and their shadow rays", own);
        self.shadow_queue.add_columns_to(memory);
        let shares = self.shares.as_ref().map_or(0, LightShares::byte_count);
        memory.add(Effect::Volume.name(), "radiance of each light", shares);
    }

    /// Attenuates the radiance that the shadow rays of `packet` carry by the volumes along them; ray parameters end
    /// at `reach`. Returns the number of samples.
    pub(super) fn attenuate(
        &mut self,
        packet: &RayPacket,
        reach: &Lanes<f32>,
        radiance: &mut Lanes3<f32>,
    ) -> u64 {
        attenuate(&mut self.shadow, packet, reach, radiance)
    }
}

fn attenuate(march: &mut March, packet: &RayPacket, reach: &Lanes<f32>, radiance: &mut Lanes3<f32>) -> u64 {
    // Collect the segments of lanes that carry radiance
    let mut segments = [RaySegment::NONE; LANES];
    let mut lane = [0; LANES];
    let mut count = 0;
    for l in 0..LANES {
        if (0..3).all(|channel| radiance[channel][l] == 0.0) {
            continue;
        }
        let ray = packet.ray(l);
        segments[count] = RaySegment {
            origin: ray.origin.as_dvec3(),
            direction: ray.direction.as_dvec3(),
            t_near: 0.0,
            t_far: f64::from(reach[l]),
        };
        lane[count] = l;
        count += 1;
    }
    // March them and multiply by the transmittances
    let mut left = [1.0; LANES];
    let samples = march.transmittances(&segments[..count], &mut left);
    for (l, left) in lane.into_iter().zip(left).take(count) {
        for channel in 0..3 {
            radiance[channel][l] *= left as f32;
        }
    }
    samples
}

impl ShadingState<'_, '_> {
    /// Marches the rays of a packet, adds their radiance to the film, and returns the throughput behind the volumes;
    /// `weight` is the throughput without them.
    pub(super) fn march(
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

/// Radiance of each light in marches, for layers by light.
///
/// A march is linear in its incident light. It is repeated with the light that each plane alone gave to its samples,
/// for which no shadow rays are needed, and the emission of the volume is subtracted.
struct LightShares {
    /// Incident light at the samples of a march, for each plane of lights, one entry per call.
    lit: Vec<Vec<Lanes3<f64>>>,
    /// Radiance along the rays of a packet, for each plane of lights.
    seen: Vec<Lanes3<f32>>,
}

const DARK: Lanes3<f64> = [[0.0; LANES]; 3];

impl LightShares {
    fn of(groups: &LightGroups) -> Option<LightShares> {
        groups.has_lights().then(|| LightShares {
            lit: vec![Vec::new(); groups.light_planes()],
            seen: vec![[[0.0; LANES]; 3]; groups.light_planes()],
        })
    }

    fn byte_count(&self) -> usize {
        let calls: usize = self.lit.iter().map(Vec::capacity).sum();
        calls * size_of::<Lanes3<f64>>() + size_of_val(&self.lit[..]) + size_of_val(&self.seen[..])
    }

    fn begin_packet(&mut self) {
        self.seen.fill([[0.0; LANES]; 3]);
        self.lit.iter_mut().for_each(Vec::clear);
    }

    /// Begins a batch of samples; plane 0 starts with the ambient light.
    fn begin_call(&mut self, ambient: &Lanes3<f64>) {
        self.lit.iter_mut().for_each(|calls| calls.push(DARK));
        if let Some(last) = self.lit[0].last_mut() {
            *last = *ambient;
        }
    }

    fn add(&mut self, plane: usize, radiance: &Lanes3<f32>) {
        let Some(last) = self.lit[plane].last_mut() else {
            return;
        };
        for channel in 0..3 {
            for l in 0..LANES {
                last[channel][l] += f64::from(radiance[channel][l]);
            }
        }
    }

    /// Computes the radiance of each light for lane `l` of throughput `weight`, whose march has just finished.
    fn divide(&mut self, march: &mut March, segment: &RaySegment, (weight, l): ([f32; 3], usize)) {
        // March without light to find the emission
        let by_itself = march.radiance(segment, Some(&mut |_| DARK)).radiance;
        for (plane, calls) in self.lit.iter_mut().enumerate() {
            let is_lit = calls
                .iter()
                .any(|call| call.as_flattened().iter().any(|&light| light != 0.0));
            if plane == 0 || is_lit {
                // Replay the recorded light of one plane
                let mut given = calls.iter();
                let light = &mut |_: &PointLanes| given.next().copied().unwrap_or(DARK);
                let marched = march.radiance(segment, Some(light)).radiance;
                for channel in 0..3 {
                    let own = if plane == 0 { 0.0 } else { by_itself[channel] };
                    self.seen[plane][channel][l] = weight[channel] * (marched[channel] - own) as f32;
                }
            }
            calls.clear();
        }
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
        for draw in environment.draws(self.stage.depth) {
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
            let (packets, payloads, media) = self.shadow_queue.drain_with_media();
            let lanes = std::iter::once((&payloads[0].pixel, &packets[0].active));
            self.meter.lap_over(Category::Volume, lanes);
            // Attenuate by transmissive surfaces, or test for occlusion
            match &mut self.shadow_surfaces {
                Some(shadow_surfaces) => {
                    attenuate_shadow_rays(
                        self.frame,
                        (&mut *packets, &mut *payloads, media),
                        shadow_surfaces,
                        self.meter,
                        self.stage.order,
                    );
                }
                None => {
                    let accel = self.frame.accel;
                    let labels_and_accounts = |_| (&payloads[0].pixel, Accounts::All(Category::Shadow));
                    let traced = self.meter.trace(packets, labels_and_accounts, |packets| {
                        accel.occluded(packets, self.stage.order)
                    });
                    self.meter.ledger.book(Category::Shadow, traced);
                    shade::block(&packets[0], &mut payloads[0].radiance);
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
        // Aim the shadow ray from the f32 origin
        for axis in 0..3 {
            let origin = points.points[axis][l] as f32;
            packet.origin[axis][l] = origin;
            packet.direction[axis][l] = match light.kind {
                LightKind::Directional { .. } => arriving.wi[axis][l],
                LightKind::Point { position, .. } | LightKind::Spot { position, .. } => {
                    (position[axis] - f64::from(origin)) as f32
                }
                // Area lights are sampled point by point.
                LightKind::Area { .. } => 0.0,
            };
        }
        packet.t_far[l] = match light.kind {
            LightKind::Directional { .. } => f32::INFINITY,
            // The light is at t = 1 exactly.
            LightKind::Point { .. } | LightKind::Spot { .. } | LightKind::Area { .. } => 1.0,
        };
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
    pub(super) fn marches(&self) -> bool {
        self.effects().has(Effect::Volume)
    }
}
