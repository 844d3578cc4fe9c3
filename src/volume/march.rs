//! Marching: samples along one ray, sixteen at a time, composited front to back.
//!
//! A ray is cut where it enters and leaves volumes, so that along each piece the same ones are met, and every piece is
//! marched in the shortest of their steps. The sixteen lanes are neighbours along the ray: they share cache lines, and no
//! lane waits for another ray. Rays of which transmittance alone is wanted are short: those of a packet fill their lanes
//! together. Samples in empty space are left out; what they would add is exactly 0, so the bits are those of all samples.
//!
//! A march stops once the transmittance T is at most the cut-off. What it leaves out is then at most T times the
//! brightest source behind, and at most T of the transmittance.

use glam::DVec3;

use super::composite::Composite;
use super::deferred_lighting::PendingSamples;
use super::empty_space_skip::{fill, range};
use super::optical_depth::CompensatedSum;
use super::sample_batch::{Batch, PendingBatch, VolumeSegment, sample, sample_depth};
use super::steps::Steps;
use super::{Fog, Volume};
use crate::numeric::{Lanes, Lanes3};

/// The part of a ray that is marched, in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RaySegment {
    /// The point at t = 0.
    pub origin: DVec3,
    /// Direction of any length but 0; `t` is measured in it.
    pub direction: DVec3,
    /// Where the march begins.
    pub t_near: f64,
    /// Where it ends: at the surface that is hit, or at infinity.
    pub t_far: f64,
}

impl RaySegment {
    /// One of no length.
    pub const NONE: RaySegment = RaySegment {
        origin: DVec3::ZERO,
        direction: DVec3::Z,
        t_near: 0.0,
        t_far: 0.0,
    };
}

/// What a march found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Marched {
    /// Linear RGB radiance that reaches the near end from what lies on the way.
    pub radiance: [f64; 3],
    /// The share of the light from beyond the far end that reaches the near one.
    pub transmittance: f64,
    /// Samples that were taken.
    pub sample_count: u64,
}

/// Whether empty space is left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SkipEmpty {
    /// Leaps over it.
    #[default]
    Leap,
    /// Takes every sample: the referee.
    Never,
}

/// Sixteen points along a ray.
#[derive(Clone, Copy, Debug)]
pub struct PointLanes {
    /// In world space.
    pub points: Lanes3<f64>,
    /// Bit `l` says whether lane `l` scatters light; the others are not looked at.
    pub active: u16,
}

/// Light at sixteen points of a ray: the linear RGB radiance that matter of colour 1 sends to the viewer there. For a
/// lamp of irradiance E that is E times the phase function, which is 1 / 4 pi for matter that scatters evenly.
pub type Lighting<'l> = &'l mut dyn FnMut(&PointLanes) -> Lanes3<f64>;

/// A march through volumes and fog; it keeps its working memory from ray to ray.
#[derive(Clone, Debug)]
pub struct March<'a> {
    pub(super) volumes: &'a [Volume],
    pub(super) fog: Option<Fog>,
    /// Optical depth from which on nothing counts.
    pub(super) deepest: f64,
    pub(super) skip: SkipEmpty,
    pub(super) met: Vec<VolumeSegment<'a>>,
    cuts: Vec<f64>,
    active: Vec<VolumeSegment<'a>>,
    unlit: PendingSamples,
}

/// Light on its way: what has been composited.
struct Progress<'s, 'l> {
    stretch: &'s RaySegment,
    light: Option<Lighting<'l>>,
    composite: Composite,
    depth: CompensatedSum,
    sample_count: u64,
}

/// Whether a march goes on.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Flow {
    GoOn,
    Stop,
}

/// Optical depth from which on a transmittance is 0 in f64.
const DARKEST: f64 = 746.0;
/// A transmittance that 24-bit colours cannot show, of light up to a thousand times white.
const DEFAULT_CUTOFF: f64 = 1e-7;

impl<'a> March<'a> {
    /// A march through `volumes` and `fog`, with a cut-off of 10^-7.
    pub fn new(volumes: &'a [Volume], fog: Option<Fog>) -> March<'a> {
        March {
            volumes,
            fog,
            deepest: -DEFAULT_CUTOFF.ln(),
            skip: SkipEmpty::Leap,
            met: Vec::new(),
            cuts: Vec::new(),
            active: Vec::new(),
            unlit: PendingSamples::NONE,
        }
    }

    /// Stops where the transmittance is at most `cutoff`, from 0 (never) to 1.
    pub fn with_cutoff(self, cutoff: f64) -> March<'a> {
        March {
            deepest: -cutoff.ln(),
            ..self
        }
    }

    /// Leaps over empty space, or does not.
    pub fn with_skip(self, skip: SkipEmpty) -> March<'a> {
        March { skip, ..self }
    }

    /// The light that reaches the near end of `stretch`, and what is left of the light from the far end.
    ///
    /// Without `light` everything is lit by 1: colours are seen as they are.
    pub fn radiance(&mut self, stretch: &RaySegment, light: Option<Lighting<'_>>) -> Marched {
        let mut progress = Progress {
            stretch,
            light,
            composite: Composite::CLEAR,
            depth: CompensatedSum::default(),
            sample_count: 0,
        };
        self.meet(stretch);
        self.walk::<true>(&mut progress);
        Marched {
            radiance: progress.composite.color(),
            transmittance: progress.depth.transmittance(),
            sample_count: progress.sample_count,
        }
    }

    /// What share of the light from the far end of `stretch` reaches the near one: for shadow rays.
    pub fn transmittance(&mut self, stretch: &RaySegment) -> f64 {
        self.meet(stretch);
        self.depth(stretch, &mut 0).transmittance()
    }

    /// The depth of `stretch`, which [`March::meet`] has seen; adds how many samples it took to `sample_count`.
    pub(super) fn depth(&mut self, stretch: &RaySegment, sample_count: &mut u64) -> CompensatedSum {
        let mut progress = Progress {
            stretch,
            light: None,
            composite: Composite::CLEAR,
            depth: CompensatedSum::default(),
            sample_count: 0,
        };
        self.walk::<false>(&mut progress);
        *sample_count += progress.sample_count;
        progress.depth
    }

    /// Goes along the ray, piece by piece.
    fn walk<const COLORED: bool>(&mut self, progress: &mut Progress) {
        for i in 1..self.cuts.len() {
            let (from, to) = (self.cuts[i - 1], self.cuts[i]);
            if from >= to {
                continue;
            }
            let met = self.met.iter().copied();
            self.active.clear();
            self.active
                .extend(met.filter(|met| met.enter <= from && to <= met.leave));
            let flow = match (self.active.is_empty(), self.fog) {
                (true, None) => Flow::GoOn,
                (true, Some(fog)) => self.pass_fog::<COLORED>(&fog, from, to, progress),
                (false, _) => self.march::<COLORED>(from, to, progress),
            };
            if flow == Flow::Stop {
                break;
            }
        }
    }

    /// Finds the volumes that the ray meets, and all places where it enters or leaves one.
    pub(super) fn meet(&mut self, stretch: &RaySegment) {
        self.met.clear();
        self.cuts.clear();
        if !(stretch.t_near < stretch.t_far) {
            return;
        }
        if self.fog.is_some() {
            self.cuts.extend([stretch.t_near, stretch.t_far]);
        }
        for volume in self.volumes {
            if let Some(met) = volume.meet(stretch) {
                self.cuts.extend([met.enter, met.leave]);
                self.met.push(met);
            }
        }
        self.cuts.sort_unstable_by(f64::total_cmp);
    }

    /// A stretch of nothing but fog.
    fn pass_fog<const COLORED: bool>(
        &mut self,
        fog: &Fog,
        from: f64,
        to: f64,
        progress: &mut Progress,
    ) -> Flow {
        let unit = progress.stretch.direction.length();
        if !COLORED || progress.light.is_none() || fog.extinction() == 0.0 {
            let length = (to - from) * unit;
            fog.pass(length, &mut progress.composite);
            progress.depth.add(fog.depth(length));
            return progress.flow(self.deepest);
        }
        // Lamps make it differ from place to place; beyond the cut-off nothing is seen.
        let seen = self.deepest.min(DARKEST) / (fog.extinction() * unit);
        self.march::<COLORED>(from, to.min(from + seen), progress)
    }

    /// Marches through the volumes at hand.
    fn march<const COLORED: bool>(&mut self, from: f64, to: f64, progress: &mut Progress) -> Flow {
        let unit = progress.stretch.direction.length();
        let volume_steps = self.active.iter().map(|met| met.volume.step);
        let lit_fog = self.fog.filter(|_| self.active.is_empty()).map(|fog| fog.step());
        let step = volume_steps.chain(lit_fog).fold(f64::INFINITY, f64::min);
        let steps = Steps::new(from, to, step / unit);
        // Fog is everywhere, and some volumes have no empty block.
        let is_full = |met: &VolumeSegment| met.volume.empty.share() == 0.0;
        let leaps = self.fog.is_none() && !self.active.iter().any(is_full);
        let skip = if leaps { self.skip } else { SkipEmpty::Never };
        let mut waiting = PendingBatch::NONE;
        let mut steps_left = range(&self.active, skip, &steps);
        let mut flow = Flow::GoOn;
        while flow == Flow::GoOn && (!steps_left.is_empty() || waiting.filled > 0) {
            steps_left.start = fill(
                &self.active,
                skip,
                (&steps, unit),
                steps_left.clone(),
                &mut waiting,
            );
            if waiting.filled > 0 {
                flow = self.take::<COLORED>(&waiting.pop(), progress);
            }
        }
        while COLORED && !self.unlit.is_empty() {
            progress.composite(&mut self.unlit);
        }
        flow
    }

    /// Takes the samples of a batch; those that add something wait for their light.
    fn take<const COLORED: bool>(&mut self, batch: &Batch, progress: &mut Progress) -> Flow {
        progress.sample_count += batch.filled as u64;
        if !COLORED {
            let depth = sample_depth(&self.active, self.fog.as_ref(), batch);
            progress.deepen(&depth, batch.filled, self.deepest);
            return progress.flow(self.deepest);
        }
        let seen = sample(&self.active, self.fog.as_ref(), batch);
        let count = progress.deepen(&seen.matter.depth, batch.filled, self.deepest);
        self.unlit.push(&batch.t, &seen, count);
        if self.unlit.is_full() {
            progress.composite(&mut self.unlit);
        }
        progress.flow(self.deepest)
    }
}

impl Progress<'_, '_> {
    /// Adds the depths of the first `filled` samples up to the one that ends the march. Returns how many these are.
    #[inline(always)]
    fn deepen(&mut self, depths: &Lanes<f64>, filled: usize, deepest: f64) -> usize {
        for (l, depth) in depths[..filled].iter().enumerate() {
            self.depth.add(*depth);
            // After the sample that did it, wherever a batch ends.
            if self.depth.rounded() >= deepest {
                return l + 1;
            }
        }
        filled
    }

    /// Lights up to sixteen samples and puts them behind what has been met before.
    fn composite(&mut self, unlit: &mut PendingSamples) {
        unlit.composite(self.stretch, self.light.as_mut(), &mut self.composite);
    }

    /// Whether anything more could be seen.
    fn flow(&self, deepest: f64) -> Flow {
        if self.depth.rounded() >= deepest {
            Flow::Stop
        } else {
            Flow::GoOn
        }
    }
}
