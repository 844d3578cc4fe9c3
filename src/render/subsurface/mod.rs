//! Light that bodies scatter within: in place of what a surface would send back where light arrives, what leaves the
//! body there of all the light that enters it anywhere.
//!
//! Before the first wave every such body is covered with points ([`points`]), and the light that gets in at each of
//! them is found by the shadow rays that surfaces send ([`receive`]): from lights of every kind, the environment map and
//! the ambient light, through whatever hides or colours it. A tree over the points ([`IrradianceTree`]) then tells the
//! radiant exitance at every hit. Reflection stays the surface's own. Light that one body or mirror sends to another
//! does not enter.

mod points;
mod receive;

use std::f64::consts::PI;
use std::time::Instant;

use serde::Serialize;

use super::ledger::{Account, Ledger};
use super::light_layers::Source;
use super::outcome::{Outcome, Traced};
use super::surface::Surfaces;
use super::{Frame, Monitor};
use crate::numeric::LANES;
use crate::optics::dielectric;
use crate::optics::subsurface::{
    DEFAULT_SOLID_ANGLE, IrradianceSample, IrradianceTree, MAX_SAMPLES, diffuse_transmittance,
};
use crate::scene::{Effect, Scene};
use points::Covered;

/// Most bytes that a point takes while the trees are built: as a point, with its light, in order, and in its tree.
const BYTES_PER_POINT: u64 = 256;

/// What the bodies of a picture that scatter light within took.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SubsurfaceStats {
    /// How many there are.
    pub bodies: usize,
    /// Points at which the light that enters them was found: at most 2^21 for all bodies together, give or take what
    /// rounding adds.
    pub samples: usize,
    /// Bytes of their trees.
    pub bytes: u64,
    /// How many times as far apart as their materials ask for points lie at most: light is blurred over so much more. 1
    /// where there are points enough.
    pub coarseness: f64,
}

/// Bytes that the light within the bodies of a scene takes at most.
pub fn subsurface_bytes(scene: &Scene) -> u64 {
    points::count(scene).min(MAX_SAMPLES as f64) as u64 * BYTES_PER_POINT
}

/// The bodies of a scene that scatter light within, with their light.
pub(super) struct Bodies {
    /// One an instance.
    bodies: Vec<Option<Box<Body>>>,
    pub(super) stats: SubsurfaceStats,
}

struct Body {
    tree: IrradianceTree,
    /// Index of refraction.
    eta: f64,
    /// Radiance that leaves where Fresnel's transmittance is 1, over the radiant exitance.
    scale: f64,
}

impl Frame<'_> {
    /// Finds the light within all bodies, where that effect is on, and tells what it took. `None` if it was cancelled.
    pub(super) fn scatter(&mut self, monitor: &Monitor) -> Option<Ledger> {
        if !self.effects().has(Effect::Subsurface) {
            return Some(Ledger::default());
        }
        let start = Instant::now();
        let covered = points::cover(self.scene);
        let Some(last) = covered.last() else {
            return Some(Ledger::default());
        };
        let mut bodies = Vec::new();
        bodies.resize_with(last.instance as usize + 1, || None);
        let mut stats = SubsurfaceStats {
            bodies: covered.len(),
            samples: 0,
            bytes: 0,
            coarseness: 1.0,
        };
        let mut taken = Ledger::default();
        for covered in covered {
            let (irradiance, ledger) = self.receive(&covered, stats.samples, monitor)?;
            taken += ledger;
            let body = Body::new(&covered, &irradiance);
            stats.samples += irradiance.len();
            stats.bytes += body.tree.byte_count() as u64;
            stats.coarseness = stats.coarseness.max(covered.coarseness());
            bodies[covered.instance as usize] = Some(Box::new(body));
        }
        self.bodies = Some(Bodies { bodies, stats });
        let threads = rayon::current_num_threads() as f64;
        let seconds = if self.settings.ledger {
            threads * start.elapsed().as_secs_f64()
        } else {
            0.0
        };
        Some(taken.gathered(Account::Subsurface, seconds))
    }
}

impl Body {
    fn new(covered: &Covered, irradiance: &[[f32; 3]]) -> Body {
        let sample = |(point, &irradiance): (&points::Point, &[f32; 3])| IrradianceSample {
            position: point.position,
            area: point.area,
            irradiance,
        };
        let samples: Vec<IrradianceSample> = covered.points.iter().zip(irradiance).map(sample).collect();
        let eta = covered.scattering.eta;
        Body {
            tree: IrradianceTree::build(&samples, &covered.dipole, DEFAULT_SOLID_ANGLE),
            eta,
            scale: 1.0 / (PI * diffuse_transmittance(eta)),
        }
    }
}

impl Outcome<'_, '_> {
    /// Adds to the film what leaves bodies where rays have met them.
    pub(super) fn add_scattered(&mut self, traced: &Traced, surfaces: &Surfaces) {
        let Some(bodies) = &self.frame.bodies else { return };
        let (points, materials) = (&surfaces.points, &surfaces.materials);
        let mut radiance = [[0.0; LANES]; 3];
        let mut any = false;
        for l in 0..LANES {
            let seen = points.hit[l] && traced.weight.iter().any(|channel| channel[l] != 0.0);
            let instance = traced.packet.instance[l] as usize;
            let body = bodies.bodies.get(instance).filter(|_| seen);
            let Some(Some(body)) = body else { continue };
            let cosine: f32 = (0..3).map(|axis| points.ns[axis][l] * points.wo[axis][l]).sum();
            let cosine = f64::from(cosine.clamp(0.0, 1.0));
            let transmittance = dielectric(cosine, 1.0, body.eta).transmittance.mean();
            let share = (transmittance * body.scale) as f32 * (1.0 - materials.metallic[l]);
            let exitance = body.tree.radiant_exitance(points.point(l));
            for c in 0..3 {
                radiance[c][l] = traced.weight[c][l] * materials.base_color[c][l] * share * exitance[c];
            }
            any = true;
        }
        if any {
            self.film.add(traced.pixel, &radiance, Source::Subsurface);
        }
        self.meter.part(Account::Subsurface);
    }
}
