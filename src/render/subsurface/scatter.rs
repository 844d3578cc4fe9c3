//! Preparation of subsurface scattering: points on the objects, their irradiance, and the octrees over them.

use std::time::Instant;

use super::super::context::RenderContext;
use super::super::monitor::{Cancelled, Monitor};
use super::super::profile::{Category, RenderProfile};
use super::objects::{SubsurfaceObject, SubsurfaceObjects, SubsurfaceStats};
use super::points;
use crate::scene::Effect;

impl RenderContext<'_> {
    /// Computes what all tiles share before the first of them: the irradiance of objects with subsurface scattering, and
    /// the photons of caustics. Returns the ledger.
    pub(in crate::render) fn prepare_light(&mut self, monitor: &Monitor) -> Result<RenderProfile, Cancelled> {
        let mut ledger = self.scatter(monitor)?;
        ledger += self.emit_photons(monitor)?;
        Ok(ledger)
    }

    /// Computes the irradiance of all objects, if the effect is on, and returns the ledger.
    fn scatter(&mut self, monitor: &Monitor) -> Result<RenderProfile, Cancelled> {
        if !self.effects().has(Effect::Subsurface) {
            return Ok(RenderProfile::default());
        }
        // Distribute points over the objects
        let start = Instant::now();
        let irradiance_points = points::cover(self.scene);
        let Some(last) = irradiance_points.last() else {
            return Ok(RenderProfile::default());
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
        Ok(taken.gathered(Category::Subsurface, seconds))
    }
}
