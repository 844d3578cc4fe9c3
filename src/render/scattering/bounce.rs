//! Interreflection: rays from diffuse surfaces, which find the light of other surfaces.
//!
//! Each hit sends one ray, in a direction distributed by the cosine to the normal, so that its weight is the albedo of the
//! diffuse part. Paths are those of path tracing (J. Kajiya, "The Rendering Equation", SIGGRAPH 1986) with light samples at
//! every surface; up to the first diffuse surface they are Whitted's.
//!
//! No light counts twice. Light samples at the surface represent all lights that are sampled, also through surfaces that
//! let shadow rays pass; a bounce ray that hits such a light adds nothing (its density is 0,
//! [`super::super::lighting::CombinedSampling`]). It brings emission that is not sampled, the background, and what the
//! surfaces that it hits reflect. Ambient light comes from outside of the scene: a surface that sends bounce rays drops its
//! diffuse part, and rays that leave the scene bring it.
//!
//! Behind a diffuse surface paths hardly branch: a ray of small weight is continued with a probability in proportion, and
//! then weighs more (Russian roulette; J. Arvo and D. Kirk, "Particle Transport and Image Synthesis", SIGGRAPH 1990). The
//! weight cut-off does not apply there, so nothing is lost but what exceeds the numbers of bounces. Probabilities do not
//! depend on radiance, so that scaling all lights by a power of two scales every bit of the image.

use std::f64::consts::TAU;

use glam::DVec3;
use multiversion::multiversion;

use super::super::lighting::{PixelSample, SampleIndex};
use super::super::profile::{Category, TruncationLimit};
use super::super::sampler::Purpose;
use super::super::surface::{SurfacePacket, Surfaces, lane};
use super::super::wavefront::{BatchInfo, PathState, RayWorkItem, ShadingState, TracedPacket};
use super::microfacet::spread;
use crate::numeric::lane_math::sin_cos;
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::scene::Effect;
use crate::shading::{MaterialPacket, diffuse_weights};

/// Weight from which on the first bounce ray of a path is always sent, because light from the first diffuse surface is most
/// of what the image gains.
const FIRST_BOUNCE_WEIGHT: f32 = 0.125;

/// Directions that are distributed by the cosine to the shading normals of sixteen surfaces.
pub(in crate::render) struct BounceDirections {
    /// Unit vectors in world space, on the other side where light is transmitted.
    pub(in crate::render) direction: Lanes3<f64>,
    /// Cosines to the shading normals, positive.
    cosine: Lanes<f64>,
}

/// Sides on which rays leave sixteen surfaces: the other side for a part of the rays from thin surfaces.
struct BounceSides {
    /// 1 for rays above the surface, -1 for rays behind it.
    signs: Lanes<f64>,
    /// Probabilities with which the sides were selected.
    shares: Lanes<f32>,
}

impl BounceSides {
    /// Selects sides by the random numbers `u`, and stretches the selected part of their range to the whole range.
    fn select(materials: &MaterialPacket, u: &mut Lanes<f64>) -> BounceSides {
        let mut sides = BounceSides {
            signs: [1.0; LANES],
            shares: [1.0; LANES],
        };
        if !materials.effects.has(Effect::Translucency) {
            return sides;
        }
        let transmitted = materials.transmitted_share();
        for l in 0..LANES {
            let share = f64::from(transmitted[l]);
            let is_behind = u[l] < share;
            // Small numbers select the other side
            let (sign, probability, rest) = if is_behind {
                (-1.0, transmitted[l], u[l] / share)
            } else {
                (1.0, 1.0 - transmitted[l], (u[l] - share) / (1.0 - share))
            };
            sides.signs[l] = sign;
            sides.shares[l] = probability;
            u[l] = rest.clamp(0.0, 1.0);
        }
        sides
    }
}

impl ShadingState<'_, '_> {
    /// Queues a ray from the diffuse part of each surface.
    #[inline(never)]
    pub(in crate::render) fn bounce(&mut self, traced: &TracedPacket, surfaces: &Surfaces, stage: BatchInfo) {
        let Some(path_states) = traced.path_states else {
            return;
        };
        let (points, materials) = (&surfaces.points, &surfaces.materials);
        // Sample a direction at each surface, above it or behind it
        let draw = SampleIndex {
            purpose: Purpose::BOUNCE.nested(stage.depth),
            number: 0,
            of: 1,
        };
        let mut u = self.number_packet(traced, draw);
        let sides = BounceSides::select(materials, &mut u[0]);
        let bounces = cosine_directions(points, &u, &sides.signs);
        let mut wi = [[0.0; LANES]; 3];
        for axis in 0..3 {
            for l in 0..LANES {
                wi[axis][l] = bounces.direction[axis][l] as f32;
            }
        }
        // Weight the directions by the diffuse part of each material
        let albedo = diffuse_weights(materials, &points.ns, &points.wo, &wi);
        // Queue the rays
        for l in (0..LANES).filter(|&l| points.hit[l]) {
            let direction = DVec3::from([0, 1, 2].map(|axis| bounces.direction[axis][l]));
            let above = lane(&points.ng, l).as_dvec3().dot(direction) * sides.signs[l];
            let weight: [f32; 3] = [0, 1, 2].map(|c| traced.weight[c][l] * albedo[c][l] / sides.shares[l]);
            // With an interpolated normal, a direction may lie on the wrong side of the geometric surface
            if !(above > 0.0) || weight == [0.0; 3] {
                continue;
            }
            let arrival = path_states.lane(l);
            // Widen the ray cone by the share of the hemisphere that one ray of the pixel stands for
            let of_pixel = f64::from(arrival.split) * f64::from(self.frame.even_count);
            let density = bounces.cosine[l] * (2.0 / TAU) * of_pixel;
            let cone = self
                .frame
                .cone_at(traced, path_states, l)
                .reflected(surfaces.curvatures[l]);
            let origin = match sides.signs[l] < 0.0 {
                true => points.leave(l, -points.geometric_normal(l)),
                false => lane(&points.origin, l),
            };
            let sent = RayWorkItem {
                ray: Ray::new(origin, direction.as_vec3()),
                pixel: traced.pixel[l],
                weight,
                sender: Category::Interreflection,
                travel: Some(PathState {
                    depth: arrival.depth + 1,
                    bounces: arrival.bounces + 1,
                    direction,
                    cone: cone.spread_by(spread(density)),
                    density: 0.0,
                    ..arrival
                }),
            };
            self.send::<false>(&sent, stage.depth + 1);
        }
    }

    /// Queues a ray whose path has left a diffuse surface, with a probability that falls with its weight, if it is within the
    /// limits of bounces and of depth.
    pub(in crate::render) fn send_behind_bounce(&mut self, sent: &RayWorkItem, travel: &PathState) {
        let frame = self.frame;
        // Drop rays that cannot contribute
        let largest = sent.weight.into_iter().map(f32::abs).fold(0.0, f32::max);
        if !(largest > 0.0) {
            return;
        }
        // Terminate the path at its limits
        let steps = travel.depth - travel.bounces;
        if travel.bounces > frame.max_bounces || steps > frame.settings.depth {
            self.meter.ledger.lose(TruncationLimit::Depth, largest);
            self.losses.add(sent.pixel, TruncationLimit::Depth, largest);
            return;
        }
        // Continue it with a probability in proportion to its weight; rays of one lobe carry small weights each
        let together = travel.split as f32 * largest;
        let is_first = travel.bounces == 1 && sent.sender == Category::Interreflection;
        let kept_weight = if is_first {
            FIRST_BOUNCE_WEIGHT
        } else {
            self.kept_weight
        };
        let probability = together / kept_weight;
        let mut weight = sent.weight;
        if probability < 1.0 {
            if self.roulette(sent, travel) >= f64::from(probability) {
                return;
            }
            weight = weight.map(|channel| channel / probability);
        }
        // Queue it apart from paths that may branch
        if let Some(next) = &mut self.next_bounced {
            next.push(&RayWorkItem { weight, ..*sent });
        }
    }

    /// Returns the random number in [0, 1) that decides whether a path continues.
    fn roulette(&self, sent: &RayWorkItem, travel: &PathState) -> f64 {
        let purpose = Purpose::ROULETTE
            .nested(self.generation)
            .nested(sent.sender as u32);
        let draw = SampleIndex {
            purpose,
            number: 0,
            of: 1,
        };
        let sample = PixelSample {
            corner: self.corner,
            label: sent.pixel,
            sample: travel.sample,
        };
        sample.numbers(&self.frame.settings, draw)[0]
    }
}

/// Returns directions that are distributed by the cosine to the shading normals times `sides`.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(in crate::render) fn cosine_directions(
    points: &SurfacePacket,
    u: &[Lanes<f64>; 2],
    sides: &Lanes<f64>,
) -> BounceDirections {
    let mut bounces = BounceDirections {
        direction: [[0.0; LANES]; 3],
        cosine: [0.0; LANES],
    };
    for l in 0..LANES {
        // Lift a uniform point of the unit disk to the hemisphere
        let n = lane(&points.ns, l).as_dvec3().normalize();
        let (t, b) = n.any_orthonormal_pair();
        let [sine, cosine] = sin_cos(TAU * u[1][l]);
        let radius = u[0][l].sqrt();
        let height = (1.0 - u[0][l]).max(0.0).sqrt();
        let direction = t * (radius * cosine) + b * (radius * sine) + n * (height * sides[l]);
        bounces.cosine[l] = height;
        for axis in 0..3 {
            bounces.direction[axis][l] = direction[axis];
        }
    }
    bounces
}
