//! Soft light: shadow rays to points of lights with an extent.
//!
//! Each surface that a ray meets asks some points of every such light, picked by the numbers of the ray's own sample
//! for [`Purpose::LIGHT`], the light and the step of the path: the samples of a pixel ask points that lie evenly over
//! the light, and nothing depends on which thread renders what when. A light's radiance over the density of the
//! direction is what the surface gets if the shadow ray meets nothing, right on average ([`crate::shading::AreaLight`]).
//! Rays into which one ray splits at a surface ask the same points.
//!
//! Smooth surfaces see lamps, which are objects, by their mirror rays, so to shadow rays to those they answer without
//! their lobe: it would count twice.

use glam::DVec3;

use super::RenderSettings;
use super::film::TILE;
use super::lamps::SoftLight;
use super::ledger::Account;
use super::outcome::{Outcome, Stage, Traced};
use super::sampler::Purpose;
use super::samples::pixel_of;
use super::shade::{self, Lit};
use crate::numeric::{LANES, Lanes3};
use crate::scene::{Effect, LightKind, MIRROR_ROUGHNESS};
use crate::shading::MaterialPacket;

/// What sixteen surfaces get from the points or directions that they ask; nothing where `irradiance` is 0.
pub(super) struct Arrivals {
    /// Unit vectors to where light may come from.
    pub(super) wi: Lanes3<f32>,
    /// Irradiance on a surface that faces it, linear RGB.
    pub(super) irradiance: Lanes3<f32>,
    /// Where it comes from, if that is not infinitely far away.
    pub(super) from: Option<Lanes3<f64>>,
}

impl Arrivals {
    /// Nothing for any surface.
    pub(super) const NONE: Arrivals = Arrivals {
        wi: [[0.0; LANES]; 3],
        irradiance: [[0.0; LANES]; 3],
        from: None,
    };
}

/// The samples that a surface asks of one light: which of how many.
#[derive(Clone, Copy)]
pub(super) struct Draw {
    pub(super) purpose: Purpose,
    pub(super) number: u32,
    pub(super) of: u32,
}

/// Which sample of which pixel a ray is a part of.
#[derive(Clone, Copy)]
pub(super) struct Origin {
    /// Column and row of the film's first pixel in the picture.
    pub(super) corner: [u32; 2],
    /// The ray's label on the film.
    pub(super) label: u32,
    pub(super) sample: u32,
}

impl Origin {
    /// The pair of numbers for one draw.
    pub(super) fn numbers(&self, settings: &RenderSettings, draw: Draw) -> [f64; 2] {
        let pixel = pixel_of(self.label);
        let pixel = [self.corner[0] + pixel % TILE, self.corner[1] + pixel / TILE];
        // Those of all samples of a pixel make one even set.
        let index = self.sample.wrapping_mul(draw.of).wrapping_add(draw.number);
        settings.numbers(pixel, index, draw.purpose)
    }
}

impl<'a> Lit<'a> {
    /// The surfaces as they answer light that they see as well.
    pub(super) fn without_seen_lobes(&self) -> Lit<'a> {
        let materials = self.materials;
        Lit {
            materials: self
                .without_seen_lobes
                .get_or_init(|| without_seen_lobes(materials)),
            ..*self
        }
    }
}

/// The materials as they answer light that they see as well: those that reflect an image, a sharp one or by rays into
/// their lobe, without a lobe, and those of the lecture's model that have a reflected ray without a highlight.
fn without_seen_lobes(materials: &MaterialPacket) -> MaterialPacket {
    let mut without = materials.clone();
    for l in 0..LANES {
        if materials.roughness[l] <= MIRROR_ROUGHNESS || materials.has_lobe(l) {
            without.roughness[l] = 0.0;
        }
        let rich = &mut without.rich;
        if rich.is_lecture[l] && (0..3).any(|c| rich.reflection[c][l] != 0.0) {
            (0..3).for_each(|c| rich.specular_color[c][l] = 0.0);
        }
    }
    without
}

impl Outcome<'_, '_> {
    /// Sends shadow rays to points of light `number`. Returns `false` if that light has no extent.
    pub(super) fn ask_area_light(&mut self, number: usize, traced: &Traced, lit: &Lit, stage: Stage) -> bool {
        let frame = self.frame;
        let light = &frame.scene.lights[number];
        let LightKind::Area { samples, .. } = light.kind else {
            return false;
        };
        let Some(Some(shape)) = frame.soft_lights.get(number) else {
            return true;
        };
        let effects = frame.effects();
        let is_mirrored = shape.is_seen() && (effects.has(Effect::Reflection) || effects.has_lobes());
        let lit = if is_mirrored {
            lit.without_seen_lobes()
        } else {
            *lit
        };
        let purpose = Purpose::LIGHT.nested(number as u32).nested(stage.depth);
        for sample in 0..samples {
            let draw = Draw {
                purpose,
                number: sample,
                of: samples,
            };
            let arrivals = self.arriving_from(shape, light.intensity, (traced, &lit), draw);
            self.ask(&arrivals, (traced, &lit), frame.plan.casting[number], stage);
        }
        true
    }

    /// What one point of a light gives to each surface.
    fn arriving_from(
        &self,
        light: &SoftLight,
        radiance: [f32; 3],
        (traced, lit): (&Traced, &Lit),
        draw: Draw,
    ) -> Arrivals {
        let textures = self.frame.surfaces.textures();
        let mut arrivals = Arrivals::NONE;
        let mut from = [[0.0; LANES]; 3];
        for l in (0..LANES).filter(|&l| lit.points.hit[l]) {
            let u = self.numbers(traced, l, draw);
            // Off a lamp that is seen, whichever side of the surface that is hit is lit.
            let p = if light.is_seen() {
                DVec3::from([0, 1, 2].map(|axis| f64::from(lit.points.origin[axis][l])))
            } else {
                lit.points.point(l)
            };
            let Some(sample) = light.sample(textures, p, u) else {
                continue;
            };
            let share = (sample.pdf * f64::from(draw.of)).recip() as f32;
            for axis in 0..3 {
                arrivals.wi[axis][l] = sample.direction[axis] as f32;
                from[axis][l] = sample.end[axis];
                arrivals.irradiance[axis][l] = radiance[axis] * sample.tint[axis] * share;
            }
        }
        arrivals.from = Some(from);
        arrivals
    }

    /// Lets a packet of shadow rays wait for what they bring, if that is anything.
    pub(super) fn ask(
        &mut self,
        arrivals: &Arrivals,
        (traced, lit): (&Traced, &Lit),
        casts: bool,
        stage: Stage,
    ) {
        if self.shadow_queue.is_full() {
            self.meter.part(Account::Lighting);
            self.trace_shadow_rays::<false>(stage.order);
            self.meter.resume(traced.pixel, &traced.packet.active);
        }
        let (packet, payload) = self.shadow_queue.next();
        if shade::sample_direct_area(arrivals, lit, packet, &mut payload.radiance) {
            self.commit_shadow_rays::<false>(traced, casts);
        }
    }

    /// The pair of numbers of the sample that lane `l` is a part of.
    pub(super) fn numbers(&self, traced: &Traced, l: usize, draw: Draw) -> [f64; 2] {
        Origin {
            corner: self.corner,
            label: traced.pixel[l],
            sample: traced.travels.map_or(0, |travels| travels.sample(l)),
        }
        .numbers(&self.frame.settings, draw)
    }

    /// Counts the packet of shadow rays last written; those to a light that nothing can hide are not traced.
    pub(super) fn commit_shadow_rays<const PLAIN: bool>(&mut self, traced: &Traced, casts: bool) {
        let effects = self.effects::<PLAIN>();
        if !PLAIN {
            self.shadow_queue.set_source(self.asked);
        }
        let (packet, payload) = self.shadow_queue.next();
        payload.pixel = *traced.pixel;
        if effects.has(Effect::MotionBlur) {
            packet.time = traced.packet.time;
        }
        if !casts {
            // Nothing to ask; but light is summed in the order in which it was found.
            packet.active = [0; LANES];
        }
        self.shadow_queue.commit();
        if let Some(travels) = traced.travels.filter(|_| effects.has(Effect::Refraction)) {
            self.shadow_queue.set_media(travels);
        }
    }
}
