//! What lies behind everything, and the light that an environment map gives to surfaces.
//!
//! Rays that miss see the background. With a map, surfaces also send shadow rays in directions in which it is bright,
//! picked as points of lights with an extent are ([`super::soft`]). Surfaces that see the map by mirror rays, or by
//! rays into their lobes, answer these shadow rays without their lobe: it would count twice.

use super::Frame;
use super::outcome::{Outcome, Stage, Traced};
use super::sampler::Purpose;
use super::shade::Lit;
use super::soft::{Arrivals, Draw};
use crate::image::LinearImage;
use crate::numeric::{LANES, Lanes3};
use crate::scene::{Background, Effect, EffectSet, Scene, Texels};
use crate::shading::EnvironmentMap;

/// The number of the light that the surroundings are.
const SURROUNDINGS: u32 = u32::MAX;

/// An environment map made ready.
pub(super) struct Environment {
    map: EnvironmentMap,
    /// Directions that each surface asks.
    samples: u32,
}

impl Environment {
    /// What is asked of it by those who are `depth` steps from the camera.
    pub(super) fn draws(&self, depth: u32) -> impl Iterator<Item = Draw> + use<> {
        let of = self.samples;
        let purpose = Purpose::LIGHT.nested(SURROUNDINGS).nested(depth);
        (0..of).map(move |number| Draw { purpose, number, of })
    }

    /// The map.
    pub(super) fn map(&self) -> &EnvironmentMap {
        &self.map
    }

    /// That of the scene, if it has one and anything asks for it.
    pub(super) fn of(scene: &Scene, effects: EffectSet) -> Option<Environment> {
        let Background::Environment {
            image,
            rotation,
            scale,
            samples,
        } = scene.background
        else {
            return None;
        };
        if !(effects.has(Effect::Background) || effects.has(Effect::Environment)) {
            return None;
        }
        let image = &scene.images[image as usize];
        let Texels::Floats(texels) = &image.texels else {
            return None;
        };
        let scaled = |texel: &[f32; 4]| [0, 1, 2].map(|channel| (texel[channel] * scale).min(f32::MAX));
        let image = LinearImage {
            width: image.width,
            height: image.height,
            pixels: texels.iter().map(scaled).collect(),
        };
        let map = EnvironmentMap::new(image, rotation).ok()?;
        Some(Environment { map, samples })
    }

    /// Bytes of the map and its tables.
    pub(super) fn byte_count(&self) -> usize {
        self.map.byte_count()
    }
}

impl Frame<'_> {
    /// What lies behind everything in the directions of a packet's rays.
    pub(super) fn background_seen(&self, traced: &Traced) -> Lanes3<f32> {
        let mut seen = [[0.0; LANES]; 3];
        let direction = |l| traced.packet.ray(l).direction.as_dvec3().normalize();
        match self.background {
            Background::Uniform(color) => return color.map(|channel| [channel; LANES]),
            Background::Gradient { horizon, up, down } => {
                for l in 0..LANES {
                    let direction = direction(l);
                    let pole = if direction.y < 0.0 { down } else { up };
                    let height = direction.y.abs();
                    for c in 0..3 {
                        let (level, pole) = (f64::from(horizon[c]), f64::from(pole[c]));
                        seen[c][l] = (level + (pole - level) * height) as f32;
                    }
                }
            }
            Background::Environment { .. } => {
                let Some(environment) = &self.environment else {
                    return seen;
                };
                // A packet's spare lanes may point nowhere.
                for l in (0..LANES).filter(|&l| traced.packet.active[l] != 0) {
                    let radiance = environment.map.radiance(direction(l));
                    (0..3).for_each(|c| seen[c][l] = radiance[c]);
                }
            }
        }
        seen
    }
}

impl Outcome<'_, '_> {
    /// Sends shadow rays to where the environment map is bright.
    pub(super) fn ask_surroundings(&mut self, traced: &Traced, lit: &Lit, stage: Stage) {
        let frame = self.frame;
        let Some(environment) = &frame.environment else {
            return;
        };
        let lit = lit.without_seen_lobes();
        for draw in environment.draws(stage.depth) {
            let arrivals = self.arriving_from_afar(&environment.map, (traced, &lit), draw);
            let casts = frame.effects().has(Effect::Shadow);
            self.ask(&arrivals, (traced, &lit), casts, stage);
        }
    }

    /// What one direction gives to each surface.
    fn arriving_from_afar(
        &self,
        map: &EnvironmentMap,
        (traced, lit): (&Traced, &Lit),
        draw: Draw,
    ) -> Arrivals {
        let mut arrivals = Arrivals::NONE;
        for l in (0..LANES).filter(|&l| lit.points.hit[l]) {
            let Some(sample) = map.sample(self.numbers(traced, l, draw)) else {
                continue;
            };
            let share = (sample.pdf * f64::from(draw.of)).recip() as f32;
            for axis in 0..3 {
                arrivals.wi[axis][l] = sample.direction[axis] as f32;
                arrivals.irradiance[axis][l] = sample.radiance[axis] * share;
            }
        }
        arrivals
    }
}
