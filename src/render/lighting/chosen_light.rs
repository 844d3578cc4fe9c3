//! Shadow rays to one of many lights, chosen anew at each surface behind a diffuse bounce: see [`super::light_tree`].

use glam::DVec3;

use super::super::aov::LightSource;
use super::super::sampler::Purpose;
use super::super::surface::lane;
use super::super::wavefront::{BatchInfo, ShadingState, TracedPacket};
use super::direct::{IncidentLight, ShadingContext};
use super::light_tree::{ChosenLight, LightTree};
use super::sample_index::SampleIndex;
use crate::numeric::{LANES, Lanes};
use crate::scene::{Effect, LightKind};
use crate::shading::sample_punctual_light;

impl ShadingState<'_, '_> {
    /// Queues a shadow ray from each surface to a light that it chooses from the tree.
    #[inline(never)]
    pub(in crate::render) fn queue_chosen_lights(
        &mut self,
        tree: &LightTree,
        traced: &TracedPacket,
        lit: &ShadingContext,
        stage: BatchInfo,
    ) {
        // Choose a light at each surface, and a point on it
        let purpose = Purpose::LIGHT_CHOICE.nested(stage.depth);
        let draw = |purpose| SampleIndex {
            purpose,
            number: 0,
            of: 1,
        };
        let choice = self.number_packet(traced, draw(purpose))[0];
        let numbers = self.number_packet(traced, draw(purpose.nested(0)));
        let is_two_sided = self.frame.effects().has(Effect::Translucency);
        let mut chosen = [None; LANES];
        for l in (0..LANES).filter(|&l| lit.points.hit[l]) {
            let p = DVec3::from([0, 1, 2].map(|axis| lit.points.p[axis][l]));
            let normal = (!is_two_sided).then(|| lane(&lit.points.ng, l).as_dvec3());
            chosen[l] = tree.choose(p, normal, choice[l]);
        }
        let casts = chosen
            .iter()
            .flatten()
            .any(|light| self.frame.plan.casts_shadows[light.number as usize]);
        self.current_source = LightSource::Chosen;
        let lights = chosen.map(|light| light.map_or(0, |light| light.number));
        // Queue the lights that rays cannot hit, then those that mirror rays find as well
        let unseen = self.chosen_arrivals(&chosen, lit, &numbers, false);
        if let Some(arrivals) = unseen {
            self.make_room(traced, stage);
            self.shadow_queue.set_chosen(&lights);
            self.queue_shadow_rays(&arrivals, (traced, lit), casts, stage);
        }
        if let Some(arrivals) = self.chosen_arrivals(&chosen, lit, &numbers, true) {
            let effects = self.frame.effects();
            let lit = match effects.has(Effect::Reflection) || effects.has_lobes() {
                true => lit.without_sampled_lobes(),
                false => *lit,
            };
            self.make_room(traced, stage);
            self.shadow_queue.set_chosen(&lights);
            self.queue_shadow_rays(&arrivals, (traced, &lit), casts, stage);
        }
    }

    /// Returns the incident light from those of the chosen lights that rays can hit, or cannot; `None` if there is none.
    fn chosen_arrivals(
        &self,
        chosen: &Lanes<Option<ChosenLight>>,
        lit: &ShadingContext,
        numbers: &[Lanes<f64>; 2],
        are_seen: bool,
    ) -> Option<IncidentLight> {
        let frame = self.frame;
        let mut arrivals = IncidentLight::NONE;
        let (mut from, mut is_any) = ([[0.0; LANES]; 3], false);
        for l in 0..LANES {
            let Some(ChosenLight { number, probability }) = chosen[l] else {
                continue;
            };
            let light = &frame.scene.lights[number as usize];
            if light.emissive_instance().is_some() != are_seen {
                continue;
            }
            is_any = true;
            let share = probability.recip();
            // Sample a point of an area light, or go to the position of a punctual one
            let (wi, end, factor) = match light.kind {
                LightKind::Area { .. } => {
                    let sampler = frame.area_lights.get(number as usize).and_then(Option::as_ref);
                    let p = DVec3::from([0, 1, 2].map(|axis| f64::from(lit.points.origin[axis][l])));
                    let textures = frame.surfaces.textures();
                    let sample = sampler
                        .and_then(|sampler| sampler.sample(textures, p, [numbers[0][l], numbers[1][l]]));
                    let Some(sample) = sample else { continue };
                    let factor = (share / sample.pdf) as f32;
                    let tint = sample.tint.map(|channel| channel * factor);
                    (sample.direction.as_vec3().to_array(), sample.end, tint)
                }
                _ => {
                    let Some(position) = light.position() else {
                        continue;
                    };
                    let p = lit.points.p.map(|axis| [axis[l]; LANES]);
                    let sample = sample_punctual_light(light, &p);
                    let factor = sample.attenuation[0] * share as f32;
                    (sample.wi.map(|axis| axis[0]), position, [factor; 3])
                }
            };
            for axis in 0..3 {
                arrivals.wi[axis][l] = wi[axis];
                from[axis][l] = end[axis];
                arrivals.irradiance[axis][l] = light.intensity[axis] * factor[axis];
            }
        }
        arrivals.from = Some(from);
        is_any.then_some(arrivals)
    }
}
