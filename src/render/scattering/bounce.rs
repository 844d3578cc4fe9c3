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

use multiversion::multiversion;

use super::super::lighting::{PixelSample, SampleIndex};
use super::super::profile::{Category, TruncationLimit};
use super::super::sampler::Purpose;
use super::super::surface::{SurfacePacket, Surfaces, lane};
use super::super::wavefront::{
    BatchInfo, BouncedStates, PathState, PathStatePacket, RayLanes, RayWorkItem, ShadingState, TracedPacket,
};
use super::microfacet::spread;
use crate::numeric::lane_math::sin_cos;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::Effect;
use crate::shading::ray_cone::RayCone;
use crate::shading::{MaterialPacket, diffuse_weights};

/// Weight from which on the first bounce ray of a path is always sent, because light from the first diffuse surface is most
/// of what the image gains.
const FIRST_BOUNCE_WEIGHT: f32 = 0.125;

/// Directions that are distributed by the cosine to the shading normals of sixteen surfaces.
pub(in crate::render) struct BounceDirections {
    /// Unit vectors in world space, on the other side where light is transmitted.
    direction: Lanes3<f64>,
    /// The same vectors, rounded to f32.
    pub(in crate::render) wi: Lanes3<f32>,
    /// Cosines to the shading normals, positive.
    cosine: Lanes<f64>,
    /// True on the same side of the geometric surface, where an interpolated normal may lead to the other one.
    leaves: Lanes<bool>,
}

/// Throughput along the paths of bounce rays.
struct BounceWeights {
    /// Throughput, linear RGB; zero for rays that are not sent.
    weight: Lanes3<f32>,
    /// Largest channel of each, as a magnitude.
    largest: Lanes<f32>,
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
        // Weight the directions by the diffuse part of each material
        let albedo = diffuse_weights(materials, &points.ns, &points.wo, &bounces.wi);
        let mut weights = bounce_weights(points, &bounces, traced.weight, &albedo, &sides.shares);
        // Draw random numbers if the weight of any ray leaves its path to chance
        let before = path_states.bounce_counts();
        let kept = [FIRST_BOUNCE_WEIGHT, self.kept_weight];
        let probability = survival_probabilities(&weights.largest, &path_states.splits(), &before, kept);
        let may_end = (0..LANES).any(|l| (probability[l] < 1.0) & (weights.largest[l] > 0.0));
        let roulette = match may_end {
            true => self.number_packet(traced, self.roulette_draw(Category::Interreflection))[0],
            false => [0.0; LANES],
        };
        // Continue each path with its probability, within the limits
        let limits = [self.frame.max_bounces, self.frame.settings.depth];
        let counts = [&before, &path_states.depths()];
        let ends = continue_paths(&mut weights, (&probability, &roulette), counts, limits);
        if ends.exceeds.contains(&true) {
            for l in (0..LANES).filter(|&l| ends.exceeds[l]) {
                self.lose_path(traced.pixel[l], weights.largest[l]);
            }
        }
        let (mut continued, mut count) = ([0; LANES], 0);
        for l in 0..LANES {
            // Write each lane without a branch, which chance would decide; the next overwrites what is not counted
            continued[count % LANES] = l as u8;
            count += usize::from(ends.continues[l]);
        }
        // Start behind surfaces that transmit the rays
        let mut origin = points.origin;
        if materials.effects.has(Effect::Translucency) {
            for l in (0..LANES).filter(|&l| sides.signs[l] < 0.0) {
                let behind = points.leave(l, -points.geometric_normal(l));
                (0..3).for_each(|axis| origin[axis][l] = behind[axis]);
            }
        }
        // Queue the rays with their path states
        let continued = &continued[..count];
        let states = BouncedStates {
            arrival: path_states,
            direction: &bounces.direction,
            cone: &self.bounced_cones(traced, path_states, surfaces, &bounces, continued),
        };
        let rays = RayLanes {
            origin: &origin,
            direction: &bounces.wi,
            pixel: traced.pixel,
            weight: &weights.weight,
        };
        if let Some(next) = &mut self.next_bounced {
            next.push_bounces(&rays, &states, continued);
        }
    }

    /// Returns the ray cones of `lanes` behind their diffuse surfaces, wider by the share of the hemisphere that one ray of
    /// the pixel stands for; any cones if paths carry none.
    fn bounced_cones(
        &self,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        surfaces: &Surfaces,
        bounces: &BounceDirections,
        lanes: &[u8],
    ) -> Lanes<RayCone> {
        let mut cones = [PathState::NONE.cone; LANES];
        if !self.frame.tracks_cones() {
            return cones;
        }
        for l in lanes.iter().map(|&l| usize::from(l)) {
            let of_pixel = f64::from(path_states.split(l)) * f64::from(self.frame.even_count);
            let density = bounces.cosine[l] * (2.0 / TAU) * of_pixel;
            cones[l] = self
                .frame
                .cone_at(traced, path_states, l)
                .reflected(surfaces.curvatures[l])
                .spread_by(spread(density));
        }
        cones
    }

    /// Queues a ray whose path has left a diffuse surface, with a probability that falls with its weight, if it is within the
    /// limits of bounces and of depth. Its weight is divided by the probability.
    pub(in crate::render) fn send_behind_bounce(&mut self, sent: &mut RayWorkItem) {
        let Some(travel) = &sent.travel else {
            return;
        };
        // Drop rays that cannot contribute
        let largest = sent.weight.into_iter().map(f32::abs).fold(0.0, f32::max);
        if !(largest > 0.0) {
            return;
        }
        // Terminate the path at its limits
        let frame = self.frame;
        let steps = travel.depth - travel.bounces;
        if travel.bounces > frame.max_bounces || steps > frame.settings.depth {
            self.lose_path(sent.pixel, largest);
            return;
        }
        // Continue it with its probability
        let kept = match sent.sender == Category::Interreflection && travel.bounces == 1 {
            true => FIRST_BOUNCE_WEIGHT,
            false => self.kept_weight,
        };
        let probability = survival_probability(largest, travel.split, kept);
        if probability < 1.0 && self.roulette(sent) >= f64::from(probability) {
            return;
        }
        sent.weight = sent.weight.map(|channel| channel / probability);
        // Queue the ray apart from paths that may branch
        if let Some(next) = &mut self.next_bounced {
            next.push(sent);
        }
    }

    /// Books the weight of a path that ends at its limits.
    #[cold]
    fn lose_path(&mut self, pixel: u32, largest: f32) {
        self.meter.ledger.lose(TruncationLimit::Depth, largest);
        self.losses.add(pixel, TruncationLimit::Depth, largest);
    }

    /// Returns the random number in [0, 1) that decides whether a path continues.
    fn roulette(&self, sent: &RayWorkItem) -> f64 {
        let sample = PixelSample {
            corner: self.corner,
            label: sent.pixel,
            sample: sent.travel.as_ref().map_or(0, |travel| travel.sample),
        };
        sample.numbers(&self.frame.settings, self.roulette_draw(sent.sender))[0]
    }

    /// Returns the draw that decides whether paths of this generation continue.
    fn roulette_draw(&self, sender: Category) -> SampleIndex {
        SampleIndex {
            purpose: Purpose::ROULETTE.nested(self.generation).nested(sender as u32),
            number: 0,
            of: 1,
        }
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
        wi: [[0.0; LANES]; 3],
        cosine: [0.0; LANES],
        leaves: [false; LANES],
    };
    for l in 0..LANES {
        // Lift a uniform point of the unit disk to the hemisphere
        let n = lane(&points.ns, l).as_dvec3().normalize();
        let (t, b) = n.any_orthonormal_pair();
        let [sine, cosine] = sin_cos(TAU * u[1][l]);
        let radius = u[0][l].sqrt();
        let height = (1.0 - u[0][l]).max(0.0).sqrt();
        let direction = t * (radius * cosine) + b * (radius * sine) + n * (height * sides[l]);
        // Store it in both precisions, with the side of the surface that it is on
        bounces.cosine[l] = height;
        bounces.leaves[l] = lane(&points.ng, l).as_dvec3().dot(direction) * sides[l] > 0.0;
        for axis in 0..3 {
            bounces.direction[axis][l] = direction[axis];
            bounces.wi[axis][l] = direction[axis] as f32;
        }
    }
    bounces
}

/// Returns the throughput along the paths of bounce rays: that of the rays that hit the surfaces times the albedos, over the
/// probabilities of the sides.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn bounce_weights(
    points: &SurfacePacket,
    bounces: &BounceDirections,
    arriving: &Lanes3<f32>,
    albedo: &Lanes3<f32>,
    shares: &Lanes<f32>,
) -> BounceWeights {
    let mut bounced = BounceWeights {
        weight: [[0.0; LANES]; 3],
        largest: [0.0; LANES],
    };
    for l in 0..LANES {
        // Send no ray from a miss or into the surface
        let is_sent = points.hit[l] & bounces.leaves[l];
        for channel in 0..3 {
            let weight = arriving[channel][l] * albedo[channel][l] / shares[l];
            let weight = if is_sent { weight } else { 0.0 };
            bounced.weight[channel][l] = weight;
            bounced.largest[l] = bounced.largest[l].max(weight.abs());
        }
    }
    bounced
}

/// Returns the probability with which a path continues: in proportion to its weight, up to the weight that is always kept.
/// Rays of one lobe carry small weights each.
#[inline(always)]
fn survival_probability(largest: f32, split: u32, kept: f32) -> f32 {
    let probability = split as f32 * largest / kept;
    if probability < 1.0 { probability } else { 1.0 }
}

/// Returns the probabilities with which paths continue, which have left `before` diffuse surfaces until now. `kept` are the
/// weights that are always kept behind the first surface and behind others.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn survival_probabilities(
    largest: &Lanes<f32>,
    splits: &Lanes<u32>,
    before: &Lanes<u32>,
    kept: [f32; 2],
) -> Lanes<f32> {
    let mut probability = [1.0; LANES];
    for l in 0..LANES {
        let kept = if before[l] == 0 { kept[0] } else { kept[1] };
        probability[l] = survival_probability(largest[l], splits[l], kept);
    }
    probability
}

/// Decisions about sixteen paths behind diffuse surfaces: which continue, and which end at their limits.
struct PathEnds {
    /// True for paths that continue.
    continues: Lanes<bool>,
    /// True for paths that end at their limits.
    exceeds: Lanes<bool>,
}

/// Decides which paths continue: by the random numbers `roulette`, and with the numbers of bounces and of all steps so far
/// within the `limits` of bounces and of other steps. Divides all weights by the probabilities.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn continue_paths(
    weights: &mut BounceWeights,
    (probability, roulette): (&Lanes<f32>, &Lanes<f64>),
    [bounces, depths]: [&Lanes<u32>; 2],
    limits: [u32; 2],
) -> PathEnds {
    let mut ends = PathEnds {
        continues: [false; LANES],
        exceeds: [false; LANES],
    };
    for l in 0..LANES {
        let is_sent = weights.largest[l] > 0.0;
        let is_within = (bounces[l] < limits[0]) & (depths[l].wrapping_sub(bounces[l]) <= limits[1]);
        let survives = (probability[l] >= 1.0) | (roulette[l] < f64::from(probability[l]));
        ends.continues[l] = is_sent & is_within & survives;
        ends.exceeds[l] = is_sent & !is_within;
        for channel in 0..3 {
            weights.weight[channel][l] /= probability[l];
        }
    }
    ends
}
