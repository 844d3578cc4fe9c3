//! Soft light: feelers to points of lights with an extent.
//!
//! Each surface that a ray meets asks some points of every such light, picked by the numbers of the ray's own sample for
//! [`Purpose::LIGHT`], the light and the step of the path: the samples of a pixel ask points that lie evenly over the
//! light, and nothing depends on which thread renders what when. A light's radiance over the density of the direction is
//! what the surface gets if the feeler meets nothing, right on average ([`AreaLight`]). Rays into which
//! one ray splits at a surface ask the same points.

use super::RenderSettings;
use super::film::TILE;
use super::ledger::Account;
use super::outcome::{Outcome, Stage, Traced};
use super::sampler::{Purpose, sample_2d};
use super::samples::pixel_of;
use super::shade::{self, Lit};
use crate::numeric::{LANES, Lanes3};
use crate::scene::{AreaShape, Effect, LightKind, Scene};
use crate::shading::{AreaLight, DiskLight, QuadLight, SphereLight};

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
        sample_2d(settings.pattern, pixel, index, settings.spp, draw.purpose)
    }
}

/// The lights of a scene as far as they have an extent, one a light.
pub(super) fn area_lights(scene: &Scene) -> Vec<Option<AreaLight>> {
    let with_extent = |kind: &LightKind| match kind {
        LightKind::Area { shape, .. } => area_light(shape),
        _ => None,
    };
    scene
        .lights
        .iter()
        .map(|light| with_extent(&light.kind))
        .collect()
}

fn area_light(shape: &AreaShape) -> Option<AreaLight> {
    match *shape {
        AreaShape::Quad {
            center,
            half_u,
            half_v,
        } => QuadLight::new(center, half_u, half_v).ok().map(AreaLight::Quad),
        AreaShape::Disk {
            center,
            half_u,
            half_v,
        } => DiskLight::new(center, half_u, half_v).ok().map(AreaLight::Disk),
        AreaShape::Sphere { center, radius } => SphereLight::new(center, radius).ok().map(AreaLight::Sphere),
    }
}

impl Outcome<'_, '_> {
    /// Sends feelers to points of light `number`. Returns `false` if that light has no extent.
    pub(super) fn ask_area_light(&mut self, number: usize, traced: &Traced, lit: &Lit, stage: Stage) -> bool {
        let frame = self.frame;
        let light = &frame.scene.lights[number];
        let LightKind::Area { samples, .. } = light.kind else {
            return false;
        };
        let Some(Some(shape)) = frame.area_lights.get(number) else {
            return true;
        };
        let purpose = Purpose::LIGHT.nested(number as u32).nested(stage.depth);
        for sample in 0..samples {
            let draw = Draw {
                purpose,
                number: sample,
                of: samples,
            };
            let arrivals = self.arriving_from(shape, light.intensity, (traced, lit), draw);
            self.ask(&arrivals, (traced, lit), frame.plan.casting[number], stage);
        }
        true
    }

    /// What one point of a light gives to each surface.
    fn arriving_from(
        &self,
        shape: &AreaLight,
        radiance: [f32; 3],
        (traced, lit): (&Traced, &Lit),
        draw: Draw,
    ) -> Arrivals {
        let mut arrivals = Arrivals::NONE;
        let mut from = [[0.0; LANES]; 3];
        for l in (0..LANES).filter(|&l| lit.points.hit[l]) {
            let u = self.numbers(traced, l, draw);
            let Some(sample) = shape.sample(lit.points.point(l), u) else {
                continue;
            };
            if !sample.is_front() {
                continue;
            }
            let share = (sample.pdf * f64::from(draw.of)).recip() as f32;
            for axis in 0..3 {
                arrivals.wi[axis][l] = sample.direction[axis] as f32;
                from[axis][l] = sample.position[axis];
                arrivals.irradiance[axis][l] = radiance[axis] * share;
            }
        }
        arrivals.from = Some(from);
        arrivals
    }

    /// Lets a packet of feelers wait for what they bring, if that is anything.
    pub(super) fn ask(
        &mut self,
        arrivals: &Arrivals,
        (traced, lit): (&Traced, &Lit),
        casts: bool,
        stage: Stage,
    ) {
        if self.feelers.is_full() {
            self.meter.part(Account::Lighting);
            self.answer_feelers(stage.order);
            self.meter.resume(traced.pixel, &traced.packet.active);
        }
        let (packet, feeler) = self.feelers.next();
        if shade::feel_sample(arrivals, lit, packet, &mut feeler.radiance) {
            self.keep_feelers(traced, casts);
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

    /// Counts the packet of feelers last written; those to a light that nothing can hide are not traced.
    pub(super) fn keep_feelers(&mut self, traced: &Traced, casts: bool) {
        let (packet, feeler) = self.feelers.next();
        feeler.pixel = *traced.pixel;
        if self.frame.effects().has(Effect::MotionBlur) {
            packet.time = traced.packet.time;
        }
        if !casts {
            // Nothing to ask; but light is summed in the order in which it was found.
            packet.active = [0; LANES];
        }
        self.feelers.keep();
        if let Some(travels) = traced
            .travels
            .filter(|_| self.frame.effects().has(Effect::Refraction))
        {
            self.feelers.keep_media(travels);
        }
    }
}
