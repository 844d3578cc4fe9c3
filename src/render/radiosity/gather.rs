//! Rays of element sides: the light that comes from outside of the elements, and the sides that rays hit.
//!
//! Both sides of each element send the same number of rays from points spread over it, in directions distributed by the
//! cosine to the normal. The share of rays that hit another side is then an estimate of the form factor to it. Points and
//! directions are Owen-scrambled Sobol points that are numbered by side, so they do not depend on the thread. The first and
//! the second half of the rays of a side are each stratified, and give two independent solutions.

use std::f64::consts::FRAC_1_PI;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use glam::Vec3;

use super::super::context::RenderContext;
use super::super::irradiance::{FULL_THROUGHPUT, IrradianceMeter, SUMS, set_point};
use super::super::lighting::direct::evaluate_lobe_albedo;
use super::super::monitor::{Cancelled, Monitor};
use super::super::sampler::{Purpose, number_packet};
use super::super::scattering::cosine_directions;
use super::super::wavefront::{BatchInfo, PathState, PathStates, TracedPacket};
use super::elements::{ElementScene, SurfaceElement};
use crate::accel::{BATCH, Coherence, Hit, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, Ray, warp};
use crate::parallel;
use crate::scene::Effect;
use crate::shading::diffuse_weights;

/// Number of sides whose rays are traced by one task; both halves of the samples of a side have a sum of irradiance.
pub(super) const SIDES: usize = SUMS / 2;
/// Number of rays by which the number of rays of a side is divisible: a packet in each half.
pub(super) const RAY_STEP: usize = 2 * LANES;
/// Hit of a ray that leaves the elements: into the background, or onto an object without elements.
pub(super) const NO_SIDE: u32 = u32::MAX;

/// Light of one side of an element that does not come from other sides, and its reflectance, linear RGB.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SideSource {
    /// Mean radiance that is emitted.
    pub(super) emission: [f32; 3],
    /// True if lights represent the emission, so that rays that hit the side must not add it.
    pub(super) is_sampled: bool,
    /// Fraction of the incident light that is reflected.
    pub(super) albedo: [f32; 3],
    /// Irradiance by lights and background over π, for each half of the samples.
    pub(super) incident: [[f32; 3]; 2],
}

/// Sources and hits of up to [`SIDES`] sides.
pub(super) struct GatheredSides {
    pub(super) sources: Vec<SideSource>,
    /// Sides that the rays hit, ray by ray for each side; [`NO_SIDE`] for none.
    pub(super) hits: Vec<u32>,
}

/// Computes sources and hits of all sides, with `ray_count` rays each, a multiple of [`RAY_STEP`]. The sides of element i
/// are 2 i, its front, and 2 i + 1.
pub(super) fn gather(
    frame: &RenderContext,
    elements: &ElementScene,
    ray_count: usize,
    monitor: &Monitor,
) -> Result<Vec<GatheredSides>, Cancelled> {
    let side_count = 2 * elements.elements().len();
    let chunk_count = side_count.div_ceil(SIDES);
    let idle: Mutex<Vec<SideGatherer>> = Mutex::default();
    let idle = || idle.lock().unwrap_or_else(PoisonError::into_inner);
    let finished = AtomicUsize::new(0);
    // Process chunks in parallel with pooled working memory
    parallel::try_map(chunk_count, &|chunk| {
        monitor.check()?;
        let kept = idle().pop();
        let mut gatherer = kept.unwrap_or_else(|| SideGatherer::new(frame, elements, ray_count));
        let gathered = gatherer.gather(chunk, SIDES.min(side_count - chunk * SIDES));
        idle().push(gatherer);
        let finished = finished.fetch_add(1, Ordering::Relaxed) + 1;
        (monitor.progress)(finished as f64 / chunk_count as f64);
        Ok(gathered)
    })
}

/// Working memory of one thread for the rays of sides.
struct SideGatherer<'f, 's> {
    frame: &'f RenderContext<'s>,
    elements: &'f ElementScene,
    irradiance_meter: IrradianceMeter<'f, 's>,
    /// True for instances whose emission lights represent.
    is_sampled: Vec<bool>,
    /// Rays of one side.
    rays: Vec<RayPacket>,
    /// Path states behind a diffuse surface.
    behind_bounce: PathStates,
}

impl<'f, 's> SideGatherer<'f, 's> {
    fn new(
        frame: &'f RenderContext<'s>,
        elements: &'f ElementScene,
        ray_count: usize,
    ) -> SideGatherer<'f, 's> {
        // Rays from diffuse surfaces have the density 0, so that the background leaves out what lights represent
        let mut behind_bounce = PathStates::new(frame.effects(), frame.combined.is_any());
        behind_bounce.resize(1);
        for l in 0..LANES {
            let state = PathState {
                depth: 1,
                bounces: 1,
                density: 0.0,
                ..PathState::NONE
            };
            behind_bounce.set(0, l, &state);
        }
        // Find the emissive objects that lights represent
        let mut is_sampled = vec![false; frame.scene.instances.len()];
        for (light, area_light) in frame.scene.lights.iter().zip(&frame.area_lights) {
            if let (Some(instance), Some(_)) = (light.emissive_instance(), area_light) {
                is_sampled[instance as usize] = true;
            }
        }
        SideGatherer {
            frame,
            elements,
            irradiance_meter: IrradianceMeter::new(frame, 1.0),
            is_sampled,
            rays: vec![RayPacket::EMPTY; ray_count / LANES],
            behind_bounce,
        }
    }

    /// Traces the rays of `count` sides, those of chunk `chunk`.
    fn gather(&mut self, chunk: usize, count: usize) -> GatheredSides {
        let ray_count = self.rays.len() * LANES;
        let mut gathered = GatheredSides {
            sources: Vec::with_capacity(count),
            hits: Vec::with_capacity(count * ray_count),
        };
        self.irradiance_meter.begin(chunk);
        // Trace the rays of each side, and queue its shadow rays
        for number in 0..count {
            let side = chunk * SIDES + number;
            let mut source = self.spawn(side);
            for rays in self.rays.chunks_mut(BATCH) {
                self.frame.accel.intersect(rays, Coherence::Incoherent);
            }
            source.incident = self.background();
            for packet in &self.rays {
                gathered.hits.extend((0..LANES).map(|l| self.hit_side(packet, l)));
            }
            gathered.sources.push(source);
        }
        // Add the light of lights
        let sums = self.irradiance_meter.finish();
        let share = FRAC_1_PI / LANES as f64;
        for (number, source) in gathered.sources.iter_mut().enumerate() {
            for half in 0..2 {
                for c in 0..3 {
                    let incident =
                        f64::from(source.incident[half][c]) + share * sums[number + half * SIDES][c];
                    source.incident[half][c] = finite(incident);
                }
            }
        }
        gathered
    }

    /// Sets up the rays of a side and samples the lights at the origins of the first packet of each half. Returns emission
    /// and albedo, as means over the points and directions.
    fn spawn(&mut self, side: usize) -> SideSource {
        let element = &self.elements.elements()[side / 2];
        let effects = self.frame.effects();
        let packet_count = self.rays.len();
        let (mut emission, mut albedo) = ([0.0; 3], [0.0; 3]);
        for index in 0..packet_count {
            // Spread points over the element and compute their materials
            let samples: Lanes<u32> = std::array::from_fn(|l| (index * LANES + l) as u32);
            let points = self.points(side, element, &samples);
            let meter = &mut self.irradiance_meter;
            meter.compute_interactions(&points);
            if effects.has(Effect::EnergyConservation) {
                evaluate_lobe_albedo(&mut meter.surfaces);
            }
            // Sample the lights
            let packets_a_half = packet_count / 2;
            if index % packets_a_half == 0 {
                let label = side % SIDES + index / packets_a_half * SIDES;
                meter.sample_lights(&points, &[label as u32; LANES], &samples);
            }
            // Spawn a ray from each point, and weight it
            let surfaces = &meter.surfaces;
            let u = numbers(side, &samples, Purpose::BOUNCE.nested(1));
            let bounces = cosine_directions(&surfaces.points, &u, &[1.0; LANES]);
            let rays = &mut self.rays[index];
            rays.recycle();
            let (points, wi) = (&surfaces.points, &bounces.wi);
            for l in 0..LANES {
                let vector = |v: &Lanes3<f32>| Vec3::new(v[0][l], v[1][l], v[2][l]);
                rays.set(l, &Ray::new(vector(&points.origin), vector(wi)));
            }
            let weights = diffuse_weights(&surfaces.materials, &points.ns, &points.wo, wi);
            // Sum up emission and albedo
            for c in 0..3 {
                emission[c] += lane_sum(&surfaces.materials.emission[c]);
                albedo[c] += lane_sum(&weights[c]);
            }
        }
        let share = 1.0 / (packet_count * LANES) as f64;
        SideSource {
            emission: emission.map(|sum| finite(share * sum)),
            is_sampled: self.is_sampled[element.instance as usize],
            albedo: albedo.map(|sum| finite(share * sum).min(1.0)),
            incident: [[0.0; 3]; 2],
        }
    }

    /// Returns a packet of points on a side, seen along its normal.
    fn points(&self, side: usize, element: &SurfaceElement, samples: &Lanes<u32>) -> RayPacket {
        let u = numbers(side, samples, Purpose::BOUNCE.nested(0));
        // Look at the side from outside
        let [a, b, c] = self.elements.corners(element);
        let facing = if side.is_multiple_of(2) { 1.0 } else { -1.0 };
        let normal = facing * element.normal.as_dvec3();
        // Place one point in each lane
        let mut packet = RayPacket::EMPTY;
        for l in 0..LANES {
            let [to_b, to_c] = warp::triangle([u[0][l], u[1][l]]);
            let hit = Hit {
                t: 0.0,
                u: to_b as f32,
                v: to_c as f32,
                instance: element.instance,
                primitive: element.primitive,
            };
            let position = a + to_b * (b - a) + to_c * (c - a);
            set_point(&mut packet, l, position, normal, self.elements.spacing, hit);
        }
        packet
    }

    /// Returns the mean radiance of the background along the rays of each half, zero for those that hit something.
    fn background(&self) -> [[f32; 3]; 2] {
        let stage = BatchInfo {
            order: Coherence::Incoherent,
            depth: 1,
            is_behind_bounce: true,
        };
        let packets_a_half = self.rays.len() / 2;
        let mut means = [[0.0; 3]; 2];
        for (mean, packets) in means.iter_mut().zip(self.rays.chunks(packets_a_half)) {
            let mut sums = [0.0; 3];
            // Look up the background where rays missed everything
            for packet in packets {
                if (0..LANES).all(|l| packet.hit(l).is_some()) {
                    continue;
                }
                let traced = TracedPacket {
                    packet,
                    pixel: &[0; LANES],
                    weight: &FULL_THROUGHPUT,
                    path_states: Some(self.behind_bounce.at(0)),
                };
                let seen = self.frame.background_along(&traced, stage);
                for l in (0..LANES).filter(|&l| packet.is_active(l) && packet.hit(l).is_none()) {
                    (0..3).for_each(|c| sums[c] += f64::from(seen[c][l]));
                }
            }
            *mean = sums.map(|sum| finite(sum / (packets_a_half * LANES) as f64));
        }
        means
    }

    /// Returns the side that lane `l` of a traced packet hit.
    fn hit_side(&self, packet: &RayPacket, l: usize) -> u32 {
        let Some(hit) = packet.hit(l) else {
            return NO_SIDE;
        };
        let Some(element) = self.elements.element(hit.instance, hit.primitive) else {
            return NO_SIDE;
        };
        let normal = self.elements.elements()[element as usize].normal;
        let is_front = packet.ray(l).direction.dot(normal) < 0.0;
        2 * element + u32::from(!is_front)
    }
}

/// Returns the random pairs of samples of a side for one purpose.
fn numbers(side: usize, samples: &Lanes<u32>, purpose: Purpose) -> [Lanes<f64>; 2] {
    number_packet(&[[side as u32; LANES], [0; LANES]], samples, purpose)
}

/// Returns the sum over all lanes.
fn lane_sum(lanes: &Lanes<f32>) -> f64 {
    lanes.iter().copied().map(f64::from).sum()
}

/// Returns a value as a finite f32 of 0 or more; NaN becomes 0.
fn finite(value: f64) -> f32 {
    if value > 0.0 {
        value.min(f64::from(f32::MAX)) as f32
    } else {
        0.0
    }
}
