//! Ray marching through volumes: samples along one ray, sixteen at a time, composited front to back.
//!
//! A ray is split where it enters and leaves volumes, so that every interval lies in a fixed set of volumes, and each
//! interval is marched in the shortest of their steps. The sixteen lanes are neighbours along the ray: they share cache
//! lines, and no lane waits for another ray. Shadow rays, which need transmittance only, are short: the rays of a
//! packet fill the lanes together. Samples in empty space are skipped; they would contribute exactly 0, so the result
//! is bit-identical to that of all samples.
//!
//! A march stops once the transmittance T is at most the cut-off. The omitted radiance is then at most T times the
//! largest source radiance behind, and the omitted transmittance at most T.

use super::composite::Composite;
use super::deferred_lighting::{Lighting, PendingSamples};
use super::empty_space_skip::{SkipEmpty, fill, range};
use super::optical_depth::CompensatedSum;
use super::ray_segment::RaySegment;
use super::sample_batch::{PendingBatch, SampleBatch, VolumeSegment, sample, sample_depth};
use super::steps::Steps;
use super::{Fog, Volume};
use crate::numeric::Lanes;

/// Result of [`March::radiance`]: emitted and scattered light of a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Marched {
    /// Linear RGB radiance that the segment's media send to the near end.
    pub radiance: [f64; 3],
    /// Fraction of the radiance at the far end that reaches the near end.
    pub transmittance: f64,
    /// Number of samples that were taken.
    pub sample_count: u64,
}

/// Ray marcher through volumes and fog; it reuses its working memory from ray to ray.
#[derive(Clone, Debug)]
pub struct March<'a> {
    pub(super) volumes: &'a [Volume],
    pub(super) fog: Option<Fog>,
    /// Optical depth of the cut-off, at which a march stops.
    pub(super) cutoff_depth: f64,
    pub(super) skip: SkipEmpty,
    pub(super) segments: Vec<VolumeSegment<'a>>,
    /// Sorted parameters where the ray enters or leaves a volume.
    cuts: Vec<f64>,
    /// Volumes that contain the current interval.
    active: Vec<VolumeSegment<'a>>,
    /// Samples of the current interval that are not lit yet.
    pending_samples: PendingSamples,
}

/// State of a march: the segment, its lighting and the sums so far.
struct MarchProgress<'s, 'l> {
    segment: &'s RaySegment,
    light: Option<Lighting<'l>>,
    composite: Composite,
    depth: CompensatedSum,
    sample_count: u64,
}

/// Decision to continue or to end a march.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Flow {
    Continue,
    Stop,
}

/// Optical depth from which on a transmittance underflows to 0 in f64.
const UNDERFLOW_DEPTH: f64 = 746.0;
/// Default cut-off: a transmittance that is invisible in 24-bit colours, for radiance of up to a thousand times white.
const DEFAULT_CUTOFF: f64 = 1e-7;

impl<'a> March<'a> {
    /// Creates a march through `volumes` and `fog`, with a cut-off of 10^-7.
    pub fn new(volumes: &'a [Volume], fog: Option<Fog>) -> March<'a> {
        March {
            volumes,
            fog,
            cutoff_depth: -DEFAULT_CUTOFF.ln(),
            skip: SkipEmpty::Leap,
            segments: Vec::new(),
            cuts: Vec::new(),
            active: Vec::new(),
            pending_samples: PendingSamples::NONE,
        }
    }

    /// Sets the transmittance at which a march stops, from 0 (never) to 1.
    pub(crate) fn with_cutoff(self, cutoff: f64) -> March<'a> {
        March {
            cutoff_depth: -cutoff.ln(),
            ..self
        }
    }

    /// Enables or disables empty-space skipping.
    pub fn with_skip(self, skip: SkipEmpty) -> March<'a> {
        March { skip, ..self }
    }

    /// Returns the radiance that the media of `segment` send to its near end, and the transmittance from the far end.
    ///
    /// Without `light` the in-scattered radiance is 1 everywhere: colours are seen as they are.
    pub fn radiance(&mut self, segment: &RaySegment, light: Option<Lighting<'_>>) -> Marched {
        let mut progress = MarchProgress {
            segment,
            light,
            composite: Composite::CLEAR,
            depth: CompensatedSum::default(),
            sample_count: 0,
        };
        // Find volumes along the ray and march through them
        self.intersect(segment);
        self.walk::<true>(&mut progress);
        Marched {
            radiance: progress.composite.color(),
            transmittance: progress.depth.transmittance(),
            sample_count: progress.sample_count,
        }
    }

    /// Returns the fraction of the radiance at the far end of `segment` that reaches the near end: for shadow rays.
    pub fn transmittance(&mut self, segment: &RaySegment) -> f64 {
        self.intersect(segment);
        self.depth(segment, &mut 0).transmittance()
    }

    /// Returns the optical depth of `segment`, for which [`March::intersect`] was called; adds the number of samples to
    /// `sample_count`.
    pub(super) fn depth(&mut self, segment: &RaySegment, sample_count: &mut u64) -> CompensatedSum {
        let mut progress = MarchProgress {
            segment,
            light: None,
            composite: Composite::CLEAR,
            depth: CompensatedSum::default(),
            sample_count: 0,
        };
        self.walk::<false>(&mut progress);
        *sample_count += progress.sample_count;
        progress.depth
    }

    /// Marches along the ray, interval by interval.
    fn walk<const COLORED: bool>(&mut self, progress: &mut MarchProgress) {
        for i in 1..self.cuts.len() {
            // Skip intervals of zero length
            let (from, to) = (self.cuts[i - 1], self.cuts[i]);
            if from >= to {
                continue;
            }
            // Collect the volumes that contain the interval
            let segments = self.segments.iter().copied();
            self.active.clear();
            self.active
                .extend(segments.filter(|inside| inside.enter <= from && to <= inside.leave));
            // Integrate the interval: empty, fog only, or volumes
            let flow = match (self.active.is_empty(), self.fog) {
                (true, None) => Flow::Continue,
                (true, Some(fog)) => self.pass_fog::<COLORED>(&fog, from, to, progress),
                (false, _) => self.march::<COLORED>(from, to, progress),
            };
            if flow == Flow::Stop {
                break;
            }
        }
    }

    /// Clips the ray to all volumes, and collects the sorted parameters where it enters or leaves one.
    pub(super) fn intersect(&mut self, segment: &RaySegment) {
        self.segments.clear();
        self.cuts.clear();
        if !(segment.t_near < segment.t_far) {
            return;
        }
        // Fog fills the whole segment
        if self.fog.is_some() {
            self.cuts.extend([segment.t_near, segment.t_far]);
        }
        // Clip the segment to each volume
        for volume in self.volumes {
            if let Some(inside) = volume.intersect(segment) {
                self.cuts.extend([inside.enter, inside.leave]);
                self.segments.push(inside);
            }
        }
        self.cuts.sort_unstable_by(f64::total_cmp);
    }

    /// Integrates an interval that contains only fog.
    fn pass_fog<const COLORED: bool>(
        &mut self,
        fog: &Fog,
        from: f64,
        to: f64,
        progress: &mut MarchProgress,
    ) -> Flow {
        let unit = progress.segment.direction.length();
        // Use the closed form where incident radiance is constant
        if !COLORED || progress.light.is_none() || fog.extinction() == 0.0 {
            let length = (to - from) * unit;
            if COLORED {
                fog.pass(length, &mut progress.composite);
            }
            progress.depth.add(fog.depth(length));
            return progress.flow(self.cutoff_depth);
        }
        // March fog lit by lights, as its in-scattering varies; beyond the cut-off nothing is visible.
        let seen = self.cutoff_depth.min(UNDERFLOW_DEPTH) / (fog.extinction() * unit);
        self.march::<COLORED>(from, to.min(from + seen), progress)
    }

    /// Marches through the volumes of [`March::active`], from `from` to `to`.
    fn march<const COLORED: bool>(&mut self, from: f64, to: f64, progress: &mut MarchProgress) -> Flow {
        let unit = progress.segment.direction.length();
        // Divide the interval by the shortest step of its media
        let volume_steps = self.active.iter().map(|inside| inside.volume.step);
        let lit_fog = self.fog.filter(|_| self.active.is_empty()).map(|fog| fog.step());
        let step = volume_steps.chain(lit_fog).fold(f64::INFINITY, f64::min);
        let steps = Steps::new(from, to, step / unit);
        // Disable skipping where fog fills all space or a volume has no empty block
        let is_full = |inside: &VolumeSegment| inside.volume.empty.share() == 0.0;
        let leaps = self.fog.is_none() && !self.active.iter().any(is_full);
        let skip = if leaps { self.skip } else { SkipEmpty::Never };
        // Evaluate batches of non-empty steps up to the cut-off
        let mut pending = PendingBatch::NONE;
        let mut steps_left = range(&self.active, skip, &steps);
        let mut flow = Flow::Continue;
        while flow == Flow::Continue && (!steps_left.is_empty() || pending.filled > 0) {
            steps_left.start = fill(
                &self.active,
                skip,
                (&steps, unit),
                steps_left.clone(),
                &mut pending,
            );
            if pending.filled > 0 {
                flow = self.evaluate_batch::<COLORED>(&pending.pop(), progress);
            }
        }
        // Light and composite the remaining samples
        while COLORED && !self.pending_samples.is_empty() {
            progress.composite(&mut self.pending_samples);
        }
        flow
    }

    /// Evaluates the samples of a batch; those that contribute are queued for lighting.
    fn evaluate_batch<const COLORED: bool>(
        &mut self,
        batch: &SampleBatch,
        progress: &mut MarchProgress,
    ) -> Flow {
        progress.sample_count += batch.filled as u64;
        // Sum optical depths only, for shadow rays
        if !COLORED {
            let depth = sample_depth(&self.active, self.fog.as_ref(), batch);
            progress.deepen(&depth, batch.filled, self.cutoff_depth);
            return progress.flow(self.cutoff_depth);
        }
        // Sample media, and queue the contributing samples for lighting
        let seen = sample(&self.active, self.fog.as_ref(), batch);
        let count = progress.deepen(&seen.medium.depth, batch.filled, self.cutoff_depth);
        self.pending_samples.push(&batch.t, &seen, count);
        if self.pending_samples.is_full() {
            progress.composite(&mut self.pending_samples);
        }
        progress.flow(self.cutoff_depth)
    }
}

impl MarchProgress<'_, '_> {
    /// Adds the depths of the first `filled` samples up to the one that ends the march. Returns the number of depths
    /// added.
    #[inline(always)]
    fn deepen(&mut self, depths: &Lanes<f64>, filled: usize, cutoff_depth: f64) -> usize {
        for (l, depth) in depths[..filled].iter().enumerate() {
            self.depth.add(*depth);
            // Stop right after the sample that reaches the cut-off, wherever a batch ends.
            if self.depth.rounded() >= cutoff_depth {
                return l + 1;
            }
        }
        filled
    }

    /// Lights up to sixteen samples and composites them behind the earlier ones.
    fn composite(&mut self, pending_samples: &mut PendingSamples) {
        pending_samples.composite(self.segment, self.light.as_mut(), &mut self.composite);
    }

    /// Returns [`Flow::Stop`] once the optical depth has reached that of the cut-off.
    fn flow(&self, cutoff_depth: f64) -> Flow {
        if self.depth.rounded() >= cutoff_depth {
            Flow::Stop
        } else {
            Flow::Continue
        }
    }
}
