//! Shading stage of the wavefront: accumulates radiance on the film and queues shadow rays and secondary rays.

use glam::Vec3;

use super::super::aov::LightSource;
use super::super::lighting::{LobeVariants, direct};
use super::super::profile::{Accounts, Category, Moment, TruncationLimit};
use super::super::surface::{ConeSource, Surfaces};
use super::occlusion::{TracingOrder, common_end};
use super::path_state::{PathState, PathStatePacket};
use super::ray_queue::{Paths, RayWorkItem};
use super::shading_state::ShadingState;
use super::traced_packet::{BatchInfo, TracedPacket};
use crate::accel::{Coherence, NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::scene::{Effect, EffectSet, Light};

impl ShadingState<'_, '_> {
    /// Shades the hits and misses of traced packets: adds radiance to the film and queues shadow rays and secondary
    /// rays.
    pub(in crate::render) fn shade_batch(
        &mut self,
        surfaces: &mut Surfaces,
        packets: &[RayPacket],
        paths: Paths,
        stage: BatchInfo,
    ) {
        // Layers of light need the general path, which records the source of all radiance, as does a background for
        // camera rays alone.
        let is_special = self.frame.light_sheet.is_wanted() || self.frame.replaces_background();
        if !is_special && self.frame.effects().are_within(EffectSet::BASIC) {
            self.shade_packets::<true>(surfaces, packets, paths, stage);
        } else {
            self.shade_packets::<false>(surfaces, packets, paths, stage);
        }
    }

    // Not inlined, so that neither variant suffers from the register pressure of the other.
    #[inline(never)]
    fn shade_packets<const BASIC: bool>(
        &mut self,
        surfaces: &mut Surfaces,
        packets: &[RayPacket],
        paths: Paths,
        stage: BatchInfo,
    ) {
        let effects = self.effects::<BASIC>();
        let has_layers = stage.depth == 0 && self.first_hits.is_some();
        self.generation = stage.depth;
        for (index, packet) in packets.iter().enumerate() {
            let (path, path_states) = paths.at(index);
            let path_states = path_states.filter(|_| !BASIC);
            let is_timed = self.meter.watch(&path.pixel, &packet.active);
            // Apply absorption and volumes along the rays
            let weight_after_absorption = path_states
                .filter(|_| effects.has(Effect::Absorption))
                .map(|path_states| self.weight_after_absorption(packet, path, path_states));
            if weight_after_absorption.is_some() {
                self.meter.part(Category::Absorption);
            }
            let weight = weight_after_absorption.as_ref().unwrap_or(&path.weight);
            let marched = effects
                .has(Effect::Volume)
                .then(|| self.march(packet, (path, path_states), weight, stage));
            let mut traced = TracedPacket {
                packet,
                pixel: &path.pixel,
                weight: marched.as_ref().unwrap_or(weight),
                path_states,
            };
            // Replace the background that camera rays see, if another is requested
            let elsewhere = match !BASIC && self.frame.replaces_background() {
                true => self.replace_background(&traced, stage),
                false => None,
            };
            if let Some(elsewhere) = &elsewhere {
                traced.weight = elsewhere;
            }
            let any_hit = packet.instance.iter().any(|&instance| instance != NO_HIT);
            // Compute surface interactions, then shade them
            if any_hit {
                surfaces.texturing = if is_timed { Moment::Wanted } else { Moment::Unknown };
                let widths = self.widths::<BASIC>(path_states);
                self.frame.surfaces.compute_interactions(packet, widths, surfaces);
                self.book_interactions(surfaces);
                if has_layers {
                    self.note_first_hits(packet, &path.pixel, surfaces);
                }
                self.shade::<BASIC>(effects, &traced, surfaces, stage);
            // Add background radiance if all rays missed, unless all of them have seen another one
            } else if effects.has_unlit_radiance() && (BASIC || traced.sees_background()) {
                self.add_background(traced, stage);
            }
            self.meter.leave();
        }
        // Trace the shadow rays that the batch queued
        self.trace_shadow_rays::<BASIC>(stage.order);
    }

    #[cold]
    fn note_first_hits(&mut self, packet: &RayPacket, label: &Lanes<u32>, surfaces: &Surfaces) {
        if let Some(first_hits) = &mut self.first_hits {
            first_hits.add(packet, label, surfaces);
            self.meter.part(Category::Film);
        }
    }

    /// Books the time of surface interactions, and of textures if any were evaluated.
    fn book_interactions(&mut self, surfaces: &Surfaces) {
        match surfaces.texturing {
            Moment::Unknown => {}
            Moment::Wanted => self.meter.part(Category::Surface),
            Moment::Read(moment) => {
                self.meter.count_read();
                self.meter.part_until(Category::Surface, moment);
                self.meter.part(Category::Texture);
            }
        }
    }

    /// Returns the source of the ray cones of a packet.
    fn widths<'t, const BASIC: bool>(&self, path_states: Option<PathStatePacket<'t>>) -> ConeSource<'t> {
        if !self.effects::<BASIC>().has(Effect::TextureFilter) {
            return ConeSource::None;
        }
        match path_states {
            Some(path_states) if self.frame.tracks_cones() => ConeSource::Paths(path_states),
            _ => ConeSource::Camera(self.frame.camera_cone),
        }
    }

    // Not inlined, like other steps that only some scenes take, so that the loop over packets keeps its registers. By
    // value, so that `TracedPacket` is written to memory only where such a step is taken.
    #[inline(never)]
    fn add_background(&mut self, traced: TracedPacket, stage: BatchInfo) {
        let background = self.frame.background_along(&traced, stage);
        let radiance = direct::background_radiance(traced.packet, traced.weight, &background);
        self.meter.part(Category::Surroundings);
        self.film.add(traced.pixel, &radiance, LightSource::Emission);
        self.meter.part(Category::Film);
    }

    #[inline(always)]
    fn shade<const BASIC: bool>(
        &mut self,
        effects: EffectSet,
        traced: &TracedPacket,
        surfaces: &mut Surfaces,
        stage: BatchInfo,
    ) {
        if effects.has(Effect::EnergyConservation) {
            direct::evaluate_lobe_albedo(surfaces);
        }
        if !BASIC && self.frame.combined.has_emissive_objects() {
            self.frame.weight_emission(traced, surfaces, stage);
        }
        match traced
            .path_states
            .filter(|_| !BASIC && effects.has_transmission())
        {
            None if !BASIC && effects.has_layers() => {
                let below = self.shade_layers(effects, traced, surfaces, stage);
                let traced = TracedPacket {
                    weight: &below,
                    ..*traced
                };
                self.shade_surfaces::<BASIC>(effects, &traced, surfaces, stage);
            }
            None => self.shade_surfaces::<BASIC>(effects, traced, surfaces, stage),
            Some(path_states) => {
                // Apply alpha and hidden boundaries, then shade what remains
                let present = self.apply_alpha(traced, path_states, surfaces);
                self.meter.part(Category::Refraction);
                let mut traced = TracedPacket {
                    weight: &present,
                    ..*traced
                };
                let below;
                if effects.has_layers() {
                    below = self.shade_layers(effects, &traced, surfaces, stage);
                    traced.weight = &below;
                }
                self.shade_surfaces::<BASIC>(effects, &traced, surfaces, stage);
                // Add reflected and refracted rays at dielectric boundaries
                if effects.has(Effect::Refraction) {
                    self.refract_rays(&traced, path_states, surfaces);
                    self.meter.part(Category::Refraction);
                }
                if effects.has(Effect::RoughRefraction) {
                    self.refract_rough_rays(&traced, path_states, surfaces, stage);
                    self.meter.part(Category::RoughRefraction);
                }
            }
        }
    }

    #[inline(always)]
    fn shade_surfaces<const BASIC: bool>(
        &mut self,
        effects: EffectSet,
        traced: &TracedPacket,
        surfaces: &Surfaces,
        stage: BatchInfo,
    ) {
        // Add emission, ambient light and background
        if effects.has_unlit_radiance() {
            self.add_emission(*traced, surfaces, stage);
        }
        let variants = LobeVariants::default();
        let lit = direct::ShadingContext::of(traced, surfaces, &variants);
        // Add light scattered below the surface
        if effects.has(Effect::Subsurface) {
            self.add_scattered(traced, surfaces);
        }
        // Add direct lighting and caustics
        self.sample_lights::<BASIC>(traced, &lit, stage);
        self.meter.part(Category::Lighting);
        if effects.has(Effect::Caustics) {
            self.gather_caustics(traced, &lit);
            self.meter.part(Category::Caustics);
        }
        // Spawn mirror rays and rays into GGX lobes
        if effects.has(Effect::Reflection) {
            self.reflect::<BASIC>(*traced, surfaces, stage);
        }
        if effects.has(Effect::RoughReflection) {
            self.reflect_roughly(traced, surfaces, stage);
            self.meter.part(Category::RoughReflection);
        }
        // Spawn rays from diffuse surfaces
        if effects.has(Effect::Interreflection) {
            self.bounce(traced, surfaces, stage);
            self.meter.part(Category::Interreflection);
        }
    }

    #[inline(never)]
    fn add_emission(&mut self, traced: TracedPacket, surfaces: &Surfaces, stage: BatchInfo) {
        // Look up the background if any ray missed the scene
        let mut missed = false;
        for l in 0..LANES {
            missed |= (traced.packet.active[l] != 0) & !surfaces.points.hit[l];
        }
        // Add nothing if all of it is black
        let has_ambient = self.frame.ambient != [0.0; 3];
        let has_background = missed && self.frame.has_background();
        if !(has_ambient || has_background || surfaces.materials.may_emit()) {
            self.meter.part(Category::Surroundings);
            return;
        }
        let background = match missed {
            true => self.frame.background_along(&traced, stage),
            false => [[0.0; LANES]; 3],
        };
        let light = direct::AmbientTerms {
            ambient: self.frame.ambient,
            background: &background,
        };
        let radiance = direct::emitted_radiance(traced.packet, surfaces, traced.weight, &light);
        self.meter.part(Category::Surroundings);
        self.film.add(traced.pixel, &radiance, LightSource::Emission);
        self.meter.part(Category::Film);
    }

    /// Samples direct light from all lights and from the environment map.
    pub(in crate::render) fn sample_lights<const BASIC: bool>(
        &mut self,
        traced: &TracedPacket,
        lit: &direct::ShadingContext,
        stage: BatchInfo,
    ) {
        let frame = self.frame;
        let effects = self.effects::<BASIC>();
        // Sample one of many lights behind a diffuse bounce, and every light elsewhere
        let is_chosen = !BASIC && stage.is_behind_bounce && frame.light_tree.is_some();
        if is_chosen {
            self.sample_lights_of_tree(traced, lit, stage);
        } else {
            let lights = frame.scene.lights.iter().zip(&frame.plan.casts_shadows);
            for (number, (light, &casts)) in lights.enumerate() {
                self.sample_light::<BASIC>((number, light, casts), traced, lit, stage);
            }
        }
        // Sample the environment map
        if effects.has(Effect::Environment) {
            self.current_source = LightSource::Environment;
            self.sample_environment(traced, lit, stage);
        }
    }

    /// Samples one of the lights in the tree, and all that are not in it.
    // Not inlined, so that other scenes do not pay for its registers.
    #[inline(never)]
    fn sample_lights_of_tree(
        &mut self,
        traced: &TracedPacket,
        lit: &direct::ShadingContext,
        stage: BatchInfo,
    ) {
        let frame = self.frame;
        let Some(tree) = &frame.light_tree else { return };
        for number in tree.others.iter().map(|&number| number as usize) {
            let (light, casts) = (&frame.scene.lights[number], frame.plan.casts_shadows[number]);
            self.sample_light::<false>((number, light, casts), traced, lit, stage);
        }
        self.queue_chosen_lights(tree, traced, lit, stage);
    }

    /// Queues shadow rays to light `number`; `casts` is true if anything can occlude it.
    #[inline(always)]
    fn sample_light<const BASIC: bool>(
        &mut self,
        (number, light, casts): (usize, &Light, bool),
        traced: &TracedPacket,
        lit: &direct::ShadingContext,
        stage: BatchInfo,
    ) {
        if !BASIC {
            self.current_source = LightSource::Light(number as u32);
        }
        // Sample area lights point by point
        let has_areas = self.effects::<BASIC>().has(Effect::AreaLight);
        if has_areas && self.queue_area_light(number, traced, lit, stage) {
            return;
        }
        // Trace the queued shadow rays if there is no room for more
        if self.shadow_queue.is_full() {
            self.meter.part(Category::Lighting);
            self.trace_shadow_rays::<BASIC>(stage.order);
            self.meter.resume(traced.pixel, &traced.packet.active);
        }
        // Queue shadow rays to a punctual light
        let (packet, payload) = self.shadow_queue.next();
        let any = if BASIC {
            (self.sample_direct)(light, lit, packet, &mut payload.radiance)
        } else {
            direct::sample_direct(light, lit, packet, &mut payload.radiance)
        };
        if any {
            self.shadow_queue.set_end(common_end(light));
            self.commit_shadow_rays::<BASIC>(traced, casts);
        }
    }

    /// Queues mirror reflection rays that exceed the cut-off. Transmissive surfaces queue theirs in `refract_rays`.
    #[inline(never)]
    pub(in crate::render) fn reflect<const BASIC: bool>(
        &mut self,
        traced: TracedPacket,
        surfaces: &Surfaces,
        stage: BatchInfo,
    ) {
        let mirrored = direct::reflection(&direct::ShadingContext::of(
            &traced,
            surfaces,
            &LobeVariants::default(),
        ));
        let points = &surfaces.points;
        let needs_directions = self.effects::<BASIC>().has(Effect::Refraction);
        let has_caustics = self.effects::<BASIC>().has(Effect::Caustics);
        // Spawn the reflected ray of each lane
        for l in 0..LANES {
            // Skip lanes without a mirror ray above the surface
            let weight: [f32; 3] = std::array::from_fn(|channel| mirrored.weight[channel][l]);
            if !(points.hit[l] && mirrored.leaves[l]) || weight == [0.0; 3] {
                continue;
            }
            let vector = |v: &Lanes3<f32>| Vec3::new(v[0][l], v[1][l], v[2][l]);
            let direction = vector(&mirrored.direction);
            let mut sent = RayWorkItem {
                ray: Ray::new(vector(&points.origin), direction),
                pixel: traced.pixel[l],
                weight,
                sender: Category::Reflection,
                // Extend the path state by the reflection
                travel: traced.path_states.filter(|_| !BASIC).map(|path_states| {
                    let arrival = path_states.lane(l);
                    PathState {
                        depth: arrival.depth + 1,
                        direction: if needs_directions {
                            direction.as_dvec3().normalize()
                        } else {
                            arrival.direction
                        },
                        cone: self
                            .frame
                            .cone_at(&traced, path_states, l)
                            .reflected(surfaces.curvatures[l]),
                        bent: true,
                        density: arrival.density_behind_mirror(has_caustics),
                        ..arrival
                    }
                }),
            };
            self.send::<BASIC>(&mut sent, stage.depth + 1);
        }
        self.meter.part(Category::Reflection);
    }

    /// Queues a ray if it is within the depth limit and the weight cut-off; otherwise records its weight as
    /// truncated.
    ///
    /// `steps` is the number of bounces including this one; it is used where the path itself does not count them.
    #[inline(always)]
    pub(in crate::render) fn send<const BASIC: bool>(&mut self, sent: &mut RayWorkItem, steps: u32) {
        // With dispersion, weights of a single wavelength may be negative.
        let largest = sent.weight.into_iter().map(f32::abs).fold(0.0, f32::max);
        // Drop rays that cannot contribute
        if largest > 0.0 {
            self.send_within_limits::<BASIC>(sent, steps, largest);
        }
    }

    /// Queues a ray like [`ShadingState::send`], where `largest` is the largest magnitude of its weight.
    fn send_within_limits<const BASIC: bool>(&mut self, sent: &mut RayWorkItem, steps: u32, largest: f32) {
        let settings = &self.frame.settings;
        if self.effects::<BASIC>().has_random_paths()
            && sent.travel.as_ref().is_some_and(|travel| travel.bounces > 0)
        {
            return self.send_behind_bounce(sent);
        }
        let depth = match &sent.travel {
            Some(travel) if self.effects::<BASIC>().counts_bounces() => travel.depth,
            _ => steps,
        };
        // Rays of one lobe carry small weights each; compare their sum with the cut-off.
        let together = sent.travel.as_ref().filter(|_| !BASIC);
        let together = together.map_or(1, |travel| travel.split) as f32;
        // Terminate the path and record the lost weight
        if depth > settings.depth || together * largest < settings.weight_cutoff {
            let limit = if depth > settings.depth {
                TruncationLimit::Depth
            } else {
                TruncationLimit::Weight
            };
            self.meter.ledger.lose(limit, largest);
            self.losses.add(sent.pixel, limit, largest);
            return;
        }
        self.next.push(sent);
    }

    /// Traces the queued shadow rays and adds the radiance of unoccluded lights to the film.
    pub(in crate::render) fn trace_shadow_rays<const BASIC: bool>(&mut self, order: Coherence) {
        // Transparent shadows use nearest-hit queries instead
        self.meter.lap_shading();
        if self.effects::<BASIC>().has(Effect::TransparentShadow) {
            return self.trace_transparent_shadow_rays(order);
        }
        let sources = self.shadow_queue.sources();
        let mut tracing_order = TracingOrder::new(self.shadow_queue.ends());
        let chosen = match BASIC {
            true => None,
            false => self.shadow_queue.take_chosen(),
        };
        let (packets, payloads) = self.shadow_queue.drain();
        if packets.is_empty() {
            if !BASIC {
                self.shadow_queue.return_chosen(chosen);
            }
            return;
        }
        // Test shadow rays for occlusion
        let accel = self.frame.accel;
        let casts = self.frame.effects().has(Effect::Shadow);
        if casts {
            let labels_and_accounts =
                |index: usize| (&payloads[index].pixel, Accounts::All(Category::Shadow));
            let traced = self.meter.trace(packets, labels_and_accounts, |packets, first| {
                tracing_order.occlude(accel, packets, first, order);
            });
            self.meter.ledger.book(Category::Shadow, traced);
        }
        // Attenuate unoccluded light by volumes and add it to the film
        let places = tracing_order.places(packets.len());
        for (index, payload) in payloads.iter_mut().enumerate() {
            let packet = &packets[places[index]];
            if casts {
                direct::block(packet, &mut payload.radiance);
            }
            if let Some(marches) = self.marches.as_mut().filter(|_| !BASIC) {
                let samples = marches.attenuate(packet, &packet.t_far, &mut payload.radiance);
                self.meter.ledger.volume_samples += samples;
            }
            let source = if BASIC {
                LightSource::Emission
            } else {
                sources[index]
            };
            self.film.add(&payload.pixel, &payload.radiance, source);
            if let Some(chosen) = chosen.as_ref().filter(|_| source == LightSource::Chosen) {
                self.film
                    .add_to_lights(&payload.pixel, &payload.radiance, &chosen[index]);
            }
        }
        let lanes = (0..packets.len()).map(|index| (&payloads[index].pixel, &packets[places[index]].active));
        self.meter.lap_over(Category::Film, lanes);
        if !BASIC {
            self.shadow_queue.return_chosen(chosen);
        }
    }
}
