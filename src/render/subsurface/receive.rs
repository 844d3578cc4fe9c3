//! Irradiance pass: the light that enters an object at its points, computed with the shadow rays of surfaces.

use std::sync::{Mutex, PoisonError};

use super::super::context::RenderContext;
use super::super::irradiance::{IrradianceMeter, SUMS, set_point};
use super::super::monitor::{Cancelled, Monitor};
use super::super::profile::RenderProfile;
use super::points::{IrradiancePoint, IrradiancePoints};
use crate::accel::{Hit, RayPacket};
use crate::numeric::{LANES, Lanes};
use crate::optics::subsurface::diffuse_transmittance;
use crate::parallel;

/// Limit of irradiance such that no sum over all points exceeds the range of f32: 2^21 points make 2 10^30, which
/// leaves 10^8 for the factors of areas and dipoles.
const MAX_IRRADIANCE: f64 = 1e24;

impl RenderContext<'_> {
    /// Returns the irradiance that enters an object at each of its points. `before` is the number of points of
    /// objects before it.
    pub(super) fn receive(
        &self,
        irradiance_points: &IrradiancePoints,
        before: usize,
        monitor: &Monitor,
    ) -> Result<(Vec<[f32; 3]>, RenderProfile), Cancelled> {
        // Each object before this one may have left its last chunk partly empty.
        let first = before.div_ceil(SUMS) + irradiance_points.instance as usize;
        let idle: Mutex<Vec<Receiver>> = Mutex::default();
        let idle = || idle.lock().unwrap_or_else(PoisonError::into_inner);
        // Process chunks in parallel with pooled working memory
        let chunks = parallel::map_chunks(&irradiance_points.points, SUMS, &|chunk, points| {
            monitor.check()?;
            let kept = idle().pop();
            let mut receiver = kept.unwrap_or_else(|| Receiver::new(self, irradiance_points));
            let received = receiver.receive(points, first + chunk);
            idle().push(receiver);
            Ok(received)
        });
        // Join the chunks in order
        let mut ledger = RenderProfile::default();
        let mut irradiance = Vec::with_capacity(irradiance_points.points.len());
        for received in chunks {
            let (of_chunk, taken) = received?;
            irradiance.extend(of_chunk);
            ledger += taken;
        }
        Ok((irradiance, ledger))
    }
}

/// Working memory of one thread for the irradiance pass.
struct Receiver<'f, 's> {
    irradiance_points: &'f IrradiancePoints,
    irradiance_meter: IrradianceMeter<'f, 's>,
    /// Irradiance of the ambient light, linear RGB.
    ambient: [f64; 3],
}

impl<'f, 's> Receiver<'f, 's> {
    fn new(frame: &'f RenderContext<'s>, irradiance_points: &'f IrradiancePoints) -> Receiver<'f, 's> {
        let eta = irradiance_points.scattering.eta;
        let even = std::f64::consts::PI * diffuse_transmittance(eta);
        Receiver {
            irradiance_points,
            irradiance_meter: IrradianceMeter::new(frame, eta),
            ambient: frame.ambient.map(|channel| even * f64::from(channel)),
        }
    }

    /// Returns the irradiance that enters at the points of a chunk.
    fn receive(&mut self, points: &[IrradiancePoint], chunk: usize) -> (Vec<[f32; 3]>, RenderProfile) {
        self.irradiance_meter.begin(chunk);
        // Turn sixteen points at a time into hits and sample all lights
        for (number, points) in points.chunks(LANES).enumerate() {
            let (packet, pixel) = self.seen(points, number * LANES);
            self.irradiance_meter.compute_interactions(&packet);
            self.irradiance_meter.sample_lights(&packet, &pixel, &[0; LANES]);
        }
        // Trace the remaining shadow rays and read the film
        let ambient = self.ambient;
        let sums = &self.irradiance_meter.finish()[..points.len()];
        let total = |sum: &[f64; 3]| {
            let channel = |c: usize| match sum[c] + ambient[c] {
                light if light > 0.0 => light.min(MAX_IRRADIANCE) as f32,
                // NaN counts as zero.
                _ => 0.0,
            };
            [channel(0), channel(1), channel(2)]
        };
        let irradiance = sums.iter().map(total).collect();
        (irradiance, self.irradiance_meter.ledger())
    }

    /// Returns a packet of up to sixteen points as hits, with their pixels from `first` on.
    fn seen(&self, points: &[IrradiancePoint], first: usize) -> (RayPacket, Lanes<u32>) {
        let mut packet = RayPacket::EMPTY;
        let mut pixel = [first as u32; LANES];
        for (l, point) in points.iter().enumerate() {
            pixel[l] = (first + l) as u32;
            let hit = Hit {
                t: 0.0,
                u: point.uv[0] as f32,
                v: point.uv[1] as f32,
                instance: self.irradiance_points.instance,
                primitive: point.triangle,
            };
            let spacing = self.irradiance_points.spacing;
            set_point(&mut packet, l, point.position, point.normal, spacing, hit);
        }
        (packet, pixel)
    }
}
