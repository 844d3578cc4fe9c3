//! Solution of the radiosity equation by gathering, with its errors.
//!
//! In radiance, side i has `L_i = S_i + ρ_i H_i`, where the source `S_i` is its emission and the light of lights and
//! background that it reflects, and `H_i` is the mean radiance that its rays find on other sides. Jacobi sweeps evaluate
//! the equation for all sides at once: sweep n adds the light of n reflections, until what is missing is below a tolerance
//! (M. F. Cohen and J. R. Wallace, "Radiosity and Realistic Image Synthesis", 1993, chapter 5).
//!
//! Two errors are known. *Remaining light*: if the power that sweeps add falls by the factor r from one to the next, all
//! later sweeps add r / (1 - r) times the power of the last one. *Sampling error*: the two halves of the rays give two
//! solutions of independent noise; half of their difference has the standard deviation of their mean.
//!
//! Parts of elements inside of solids, such as a floor below a wall, receive no light. Their rays hit the inner side of a
//! surface, which is known by receiving nothing while its outer side does; the inner side of a closed mesh, by receiving
//! nothing straight from sources. Such rays are left out of all means, so that an element represents its visible part.

use super::super::monitor::{Cancelled, Monitor};
use super::elements::{ElementScene, SurfaceElement};
use super::gather::{GatheredSides, NO_SIDE, SIDES, SideSource};
use super::result::EnergyBalance;
use super::settings::RadiositySettings;
use crate::parallel;

/// Largest number of sweeps, as of bounces of interreflection.
pub const MAX_SWEEPS: u32 = 256;

/// Largest incident light of a side of an object that counts as unlit, relative to the other side: no 16-bit colour at an
/// exposure for the other shows it, and rays that leak through an edge by rounding bring less.
const UNLIT: f64 = 1.0 / 8192.0;

/// Hit of a ray that starts inside of a solid.
const INSIDE: u32 = NO_SIDE - 1;

/// Radiosity solution of all sides of elements.
pub(super) struct SolvedSides {
    /// Radiance that each side reflects and emits to others, linear RGB.
    pub(super) radiance: Vec<[f32; 3]>,
    /// Mean radiance that the rays of each side found on other sides.
    pub(super) gathered: Vec<[f32; 3]>,
    pub(super) sweeps: u32,
    /// Power that later sweeps would add, relative to that of the sources.
    pub(super) remaining: f64,
}

/// Part of the rays that a solution takes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum RaySet {
    /// All rays of each side.
    All,
    /// One half of the rays of each side, 0 or 1.
    Half(usize),
}

/// Sources, hits and visible parts of all sides.
pub(super) struct Transport<'e> {
    elements: &'e ElementScene,
    chunks: Vec<GatheredSides>,
    /// True for sides inside of solids, two for each instance, front first.
    is_unlit: Vec<bool>,
}

impl<'e> Transport<'e> {
    /// Creates the transport of light between sides, of which all count as visible.
    pub(super) fn new(elements: &'e ElementScene, chunks: Vec<GatheredSides>) -> Transport<'e> {
        Transport {
            elements,
            chunks,
            is_unlit: vec![false; 2 * elements.scene.instances.len()],
        }
    }

    /// Returns the source of a side.
    pub(super) fn source(&self, side: usize) -> &SideSource {
        &self.chunks[side / SIDES].sources[side % SIDES]
    }

    /// Returns the rays of a side.
    fn hits(&self, side: usize, set: RaySet) -> &[u32] {
        let chunk = &self.chunks[side / SIDES];
        let count = chunk.hits.len() / chunk.sources.len();
        let first = side % SIDES * count;
        match set {
            RaySet::All => &chunk.hits[first..first + count],
            RaySet::Half(half) => {
                let first = first + half * count / 2;
                &chunk.hits[first..first + count / 2]
            }
        }
    }

    /// Returns whether no light reaches a side of an instance, while it reaches the other.
    fn is_unlit(&self, instance: u32, side: usize) -> bool {
        self.is_unlit[2 * instance as usize + side % 2]
    }

    /// Returns the fraction of the rays of a side that start outside of solids; 0 for the side of a solid's surface that is
    /// inside.
    pub(super) fn visible_fraction(&self, side: usize, set: RaySet) -> f64 {
        if self.is_unlit(self.elements.elements()[side / 2].instance, side) {
            return 0.0;
        }
        let hits = self.hits(side, set);
        let visible = hits.iter().filter(|&&hit| hit != INSIDE).count();
        visible as f64 / hits.len() as f64
    }

    /// Returns the mean emitted radiance that the rays of a side find, summed over the channels.
    fn emission_found(&self, side: usize) -> f64 {
        let hits = self.hits(side, RaySet::All);
        let seen = hits.iter().filter(|&&hit| hit != NO_SIDE);
        let found: f64 = seen.map(|&hit| sum(self.source(hit as usize).emission)).sum();
        found / hits.len() as f64
    }

    /// Finds the sides of instances that no light reaches, in a first solution, and leaves out the rays that hit them.
    pub(super) fn find_unlit(&mut self, solved: &SolvedSides) {
        // Sum up the incident light of both sides of each instance, and that which comes straight from sources
        let mut power = vec![0.0; self.is_unlit.len()];
        let mut direct = vec![0.0; self.is_unlit.len()];
        for side in 0..solved.radiance.len() {
            let element = &self.elements.elements()[side / 2];
            let number = 2 * element.instance as usize + side % 2;
            let [one, other] = self.source(side).incident.map(sum);
            let from_sources = 0.5 * (one + other) + self.emission_found(side);
            direct[number] += element.area * from_sources;
            power[number] += element.area * (0.5 * (one + other) + sum(solved.gathered[side]));
        }
        // Compare each side with the other. Elements that are partly outside of a solid light its inside by mistake, so that
        // only light straight from sources counts there
        for side in 0..self.is_unlit.len() {
            let is_inner = self.elements.inner_side(side / 2) == Some(side % 2);
            let received = if is_inner { direct[side] } else { power[side] };
            self.is_unlit[side] = received <= UNLIT * power[side ^ 1] && power[side ^ 1] > 0.0;
        }
        // Mark the rays
        let (elements, is_unlit) = (self.elements.elements(), &self.is_unlit);
        for hit in self.chunks.iter_mut().flat_map(|chunk| &mut chunk.hits) {
            let side = *hit as usize;
            let instance = |element: &SurfaceElement| 2 * element.instance as usize + side % 2;
            if *hit != NO_SIDE
                && elements
                    .get(side / 2)
                    .is_some_and(|element| is_unlit[instance(element)])
            {
                *hit = INSIDE;
            }
        }
        // Leave out rays that hit elements of which no ray represents a visible part
        let is_hidden: Vec<bool> = (0..solved.radiance.len())
            .map(|side| self.hits(side, RaySet::All).iter().all(|&hit| hit == INSIDE))
            .collect();
        for hit in self.chunks.iter_mut().flat_map(|chunk| &mut chunk.hits) {
            if is_hidden.get(*hit as usize) == Some(&true) {
                *hit = INSIDE;
            }
        }
    }

    /// Solves for the radiance of all sides with a part of the rays.
    pub(super) fn solve(
        &self,
        set: RaySet,
        settings: &RadiositySettings,
        monitor: &Monitor,
    ) -> Result<SolvedSides, Cancelled> {
        // Weight the rays that are outside of solids
        let count = 2 * self.elements.elements().len();
        let weights: Vec<f32> = parallel::generate(count, |side| match self.visible_fraction(side, set) {
            visible if visible > 0.0 => visible.recip() as f32,
            _ => 0.0,
        });
        // Start with the sources
        let sources = parallel::generate(count, |side| self.emitted(side, set, weights[side]));
        let area = |side: usize| match weights[side] {
            weight if weight > 0.0 => self.elements.elements()[side / 2].area / f64::from(weight),
            _ => 0.0,
        };
        let power = |radiance: &dyn Fn(usize, usize) -> f64| -> f64 {
            (0..count)
                .map(|side| area(side) * (0..3).map(|c| radiance(side, c)).sum::<f64>())
                .sum()
        };
        let source_power = power(&|side, c| f64::from(sources[side][c]));
        let mut solved = SolvedSides {
            radiance: sources.clone(),
            gathered: vec![[0.0; 3]; count],
            sweeps: 0,
            remaining: 0.0,
        };
        // Gather until the light that is missing is small
        let mut added_before = source_power;
        while solved.sweeps < MAX_SWEEPS && source_power > 0.0 {
            monitor.check()?;
            let gathered = self.gathered(&solved.radiance, set, &weights);
            // Reflect what the rays found
            let next = parallel::generate(count, |side| {
                let albedo = self.source(side).albedo;
                [0, 1, 2].map(|c| sources[side][c] + albedo[c] * gathered[side][c])
            });
            let change =
                |side: usize, c: usize| f64::from(next[side][c]) - f64::from(solved.radiance[side][c]);
            let added = power(&|side, c| change(side, c).abs());
            // Extrapolate the geometric series of the powers that sweeps add
            let ratio = added / added_before;
            solved.remaining = if ratio < 1.0 {
                added / source_power * ratio / (1.0 - ratio)
            } else {
                f64::INFINITY
            };
            added_before = added;
            solved.sweeps += 1;
            (solved.radiance, solved.gathered) = (next, gathered);
            if !(solved.remaining > settings.tolerance) {
                break;
            }
        }
        Ok(solved)
    }

    /// Returns the radiance of a side that is no light of other sides. `weight` is the reciprocal of its visible fraction.
    fn emitted(&self, side: usize, set: RaySet, weight: f32) -> [f32; 3] {
        let source = self.source(side);
        let incident = |c: usize| match set {
            RaySet::All => 0.5 * (source.incident[0][c] + source.incident[1][c]),
            RaySet::Half(half) => source.incident[half][c],
        };
        [0, 1, 2].map(|c| {
            let emission = if source.is_sampled {
                0.0
            } else {
                source.emission[c]
            };
            emission + source.albedo[c] * weight * incident(c)
        })
    }

    /// Returns the mean radiance on the hits of each side.
    fn gathered(&self, radiance: &[[f32; 3]], set: RaySet, weights: &[f32]) -> Vec<[f32; 3]> {
        parallel::generate(radiance.len(), |side| {
            let hits = self.hits(side, set);
            let mut sum = [0.0f64; 3];
            for &hit in hits {
                let Some(found) = radiance.get(hit as usize) else {
                    continue;
                };
                (0..3).for_each(|c| sum[c] += f64::from(found[c]));
            }
            let share = f64::from(weights[side]) / hits.len() as f64;
            sum.map(|sum| (share * sum) as f32)
        })
    }

    /// Returns the powers that are emitted, absorbed and lost of a solution by all rays.
    ///
    /// The absorbed power takes rays for paths of arriving light, and the lost power takes them for paths of leaving light,
    /// so that their sum equals the emitted power only as far as the rays represent the form factors of both directions.
    pub(super) fn energy_balance(&self, solved: &SolvedSides) -> EnergyBalance {
        let mut balance = EnergyBalance::default();
        for side in 0..solved.radiance.len() {
            let visible = self.visible_fraction(side, RaySet::All);
            if !(visible > 0.0) {
                continue;
            }
            // Find the share of the leaving light that no side receives
            let area = visible * self.elements.elements()[side / 2].area;
            let hits = self.hits(side, RaySet::All);
            let lost = hits.iter().filter(|&&hit| hit == NO_SIDE).count() as f64;
            let lost_share = lost / (visible * hits.len() as f64);
            let emitted = self.emitted(side, RaySet::All, visible.recip() as f32);
            let albedo = self.source(side).albedo;
            // Add the powers of the side, over π
            for c in 0..3 {
                balance.emitted += area * f64::from(emitted[c]);
                balance.absorbed += area * f64::from((1.0 - albedo[c]) * solved.gathered[side][c]);
                balance.escaped += area * lost_share * f64::from(solved.radiance[side][c]);
            }
        }
        balance
    }

    /// Returns the root mean square of half the difference of two solutions by halves of the rays, relative to the mean
    /// radiance of all sides that have any. Radiance above `white` counts as white.
    pub(super) fn sampling_error(&self, halves: [&SolvedSides; 2], white: f32) -> f64 {
        let (mut squares, mut sum, mut areas) = (0.0, 0.0, 0.0);
        for side in 0..halves[0].radiance.len() {
            let [one, other] = halves.map(|half| half.radiance[side].map(|channel| channel.min(white)));
            // Skip the insides of solids and unlit rooms
            if one == [0.0; 3] && other == [0.0; 3] {
                continue;
            }
            let area = self.elements.elements()[side / 2].area * self.visible_fraction(side, RaySet::All);
            for c in 0..3 {
                let [one, other] = [one[c], other[c]].map(f64::from);
                squares += area * (0.5 * (one - other)).powi(2);
                sum += area * 0.5 * (one + other);
            }
            areas += 3.0 * area;
        }
        match sum > 0.0 {
            true => (squares / areas).sqrt() / (sum / areas),
            false => 0.0,
        }
    }
}

/// Returns the sum of the channels.
fn sum(channels: [f32; 3]) -> f64 {
    channels.into_iter().map(f64::from).sum()
}
