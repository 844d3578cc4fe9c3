//! Subsurface scattering: the diffuse reflection of a surface is replaced by light that enters the object anywhere
//! and leaves it at the hit.
//!
//! Before the first wave, every such object is covered with points ([`points`]), and the irradiance that enters at
//! each of them is computed with the shadow rays of surfaces ([`receive`]): from lights of every kind, the
//! environment map and the ambient light, with all occlusion and transparent shadows. An octree over the points
//! ([`IrradianceTree`]) then gives the radiant exitance at every hit. Specular reflection is handled at the surface
//! as usual. Light that one object or mirror sends to another does not enter.

mod points;
mod receive;

use std::f64::consts::PI;
use std::time::Instant;

use serde::Serialize;

use super::ledger::{Category, RenderProfile};
use super::light_layers::LightSource;
use super::outcome::{ShadingState, TracedPacket};
use super::surface::Surfaces;
use super::{Monitor, RenderContext};
use crate::numeric::LANES;
use crate::optics::dielectric;
use crate::optics::subsurface::{
    DEFAULT_SOLID_ANGLE, IrradianceSample, IrradianceTree, MAX_SAMPLES, diffuse_transmittance,
};
use crate::scene::{Effect, Scene};
use points::IrradiancePoints;

/// Largest number of bytes per point while the trees are built: as a point, with its irradiance, sorted, and in its
/// tree.
const BYTES_PER_POINT: u64 = 256;

/// Statistics of subsurface scattering.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SubsurfaceStats {
    /// Number of objects with subsurface scattering.
    pub bodies: usize,
    /// Number of points at which irradiance was computed: at most 2^21 for all objects together, except for rounding.
    pub samples: usize,
    /// Number of bytes of the trees.
    pub bytes: u64,
    /// Largest ratio of the spacing of points to the spacing that the material needs: light is blurred by this
    /// factor. 1 if there are enough points.
    pub coarseness: f64,
}

/// Returns an upper bound on the bytes for subsurface scattering in a scene.
pub fn subsurface_bytes(scene: &Scene) -> u64 {
    points::count(scene).min(MAX_SAMPLES as f64) as u64 * BYTES_PER_POINT
}

/// Objects of a scene with subsurface scattering, with their irradiance.
pub(super) struct SubsurfaceObjects {
    /// Objects with subsurface scattering, indexed by instance.
    bodies: Vec<Option<Box<SubsurfaceObject>>>,
    pub(super) stats: SubsurfaceStats,
}

struct SubsurfaceObject {
    tree: IrradianceTree,
    /// Index of refraction of the interior.
    eta: f64,
    /// Radiance that leaves where Fresnel's transmittance is 1, divided by the radiant exitance.
    scale: f64,
}

impl RenderContext<'_> {
    /// Computes the irradiance of all objects, if the effect is on, and returns the ledger. Returns `None` if
    /// cancelled.
    pub(super) fn scatter(&mut self, monitor: &Monitor) -> Option<RenderProfile> {
        if !self.effects().has(Effect::Subsurface) {
            return Some(RenderProfile::default());
        }
        // Distribute points over the objects
        let start = Instant::now();
        let irradiance_points = points::cover(self.scene);
        let Some(last) = irradiance_points.last() else {
            return Some(RenderProfile::default());
        };
        let mut bodies = Vec::new();
        bodies.resize_with(last.instance as usize + 1, || None);
        let mut stats = SubsurfaceStats {
            bodies: irradiance_points.len(),
            samples: 0,
            bytes: 0,
            coarseness: 1.0,
        };
        let mut taken = RenderProfile::default();
        // Compute irradiance and build the tree of each object
        for irradiance_points in irradiance_points {
            let (irradiance, ledger) = self.receive(&irradiance_points, stats.samples, monitor)?;
            taken += ledger;
            let body = SubsurfaceObject::new(&irradiance_points, &irradiance);
            stats.samples += irradiance.len();
            stats.bytes += body.tree.byte_count() as u64;
            stats.coarseness = stats.coarseness.max(irradiance_points.coarseness());
            bodies[irradiance_points.instance as usize] = Some(Box::new(body));
        }
        self.bodies = Some(SubsurfaceObjects { bodies, stats });
        // Book the whole time under one account
        let threads = rayon::current_num_threads() as f64;
        let seconds = if self.settings.ledger {
            threads * start.elapsed().as_secs_f64()
        } else {
            0.0
        };
        Some(taken.gathered(Category::Subsurface, seconds))
    }
}

impl SubsurfaceObject {
    fn new(irradiance_points: &IrradiancePoints, irradiance: &[[f32; 3]]) -> SubsurfaceObject {
        let sample = |(point, &irradiance): (&points::Point, &[f32; 3])| IrradianceSample {
            position: point.position,
            area: point.area,
            irradiance,
        };
        let samples: Vec<IrradianceSample> = irradiance_points
            .points
            .iter()
            .zip(irradiance)
            .map(sample)
            .collect();
        let eta = irradiance_points.scattering.eta;
        SubsurfaceObject {
            tree: IrradianceTree::build(&samples, &irradiance_points.dipole, DEFAULT_SOLID_ANGLE),
            eta,
            scale: 1.0 / (PI * diffuse_transmittance(eta)),
        }
    }
}

impl ShadingState<'_, '_> {
    /// Adds the subsurface radiance of the hits of a packet to the film.
    pub(super) fn add_scattered(&mut self, traced: &TracedPacket, surfaces: &Surfaces) {
        let Some(bodies) = &self.frame.bodies else { return };
        let (points, materials) = (&surfaces.points, &surfaces.materials);
        let mut radiance = [[0.0; LANES]; 3];
        let mut any = false;
        for l in 0..LANES {
            let seen = points.hit[l] && traced.weight.iter().any(|channel| channel[l] != 0.0);
            let instance = traced.packet.instance[l] as usize;
            let body = bodies.bodies.get(instance).filter(|_| seen);
            let Some(Some(body)) = body else { continue };
            // Weigh the exitance by Fresnel's transmittance towards the viewer
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
            self.film.add(traced.pixel, &radiance, LightSource::Subsurface);
        }
        self.meter.part(Category::Subsurface);
    }
}
