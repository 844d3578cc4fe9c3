//! Samples of one ray that were taken and wait for light: what lamps send to them is asked for sixteen at a time.
//!
//! Only those that add something wait: whole batches of points that scatter light go to the lamps, however much of what a
//! march goes through is clear. They are composited in their order along the ray once they are lit.

use super::composite::Composite;
use super::march::{Lighting, PointLanes, RaySegment};
use super::sample_batch::{ROOM, ShadedSamples};
use crate::numeric::{LANES, Lanes};

/// Taken samples, the nearest first.
#[derive(Clone, Debug)]
pub(super) struct PendingSamples {
    rows: [[f64; ROOM]; ROWS],
    /// Fewer than sixteen, but while more are put to them.
    filled: usize,
}

/// Numbers that are known of a sample: where on the ray it is, alpha, share, and three channels each of what it scatters
/// and what it sends out.
const ROWS: usize = 9;
const T: usize = 0;
const ALPHA: usize = 1;
const SHARE: usize = 2;
const SCATTERING: usize = 3;
const EMISSION: usize = 6;

impl PendingSamples {
    /// None.
    pub(super) const NONE: PendingSamples = PendingSamples {
        rows: [[0.0; ROOM]; ROWS],
        filled: 0,
    };

    /// Whether none is left.
    pub(super) fn is_empty(&self) -> bool {
        self.filled == 0
    }

    /// Whether there are enough for the lamps to be asked.
    #[inline(always)]
    pub(super) fn is_full(&self) -> bool {
        self.filled >= LANES
    }

    /// Puts those of the first `count` samples that add anything to the ones that wait, which are fewer than sixteen.
    #[inline(always)]
    pub(super) fn push(&mut self, t: &Lanes<f64>, seen: &ShadedSamples, count: usize) {
        let from = self.filled % LANES;
        let [red, green, blue] = &seen.matter.scattering;
        let [red_sent, green_sent, blue_sent] = &seen.matter.emission;
        let rows: [&Lanes<f64>; ROWS] = [
            t,
            &seen.alpha,
            &seen.share,
            red,
            green,
            blue,
            red_sent,
            green_sent,
            blue_sent,
        ];
        let mut left = u32::from(seen.adds) & ((1 << count) - 1);
        if left.count_ones() as usize == count {
            // What is copied in excess is written over by what comes next.
            for (own, row) in self.rows.iter_mut().zip(rows) {
                own[from..from + LANES].copy_from_slice(row);
            }
            self.filled = from + count;
            return;
        }
        self.filled = from;
        while left != 0 {
            let l = left.trailing_zeros() as usize % LANES;
            let to = self.filled % ROOM;
            for (own, row) in self.rows.iter_mut().zip(rows) {
                own[to] = row[l];
            }
            self.filled += 1;
            left &= left - 1;
        }
    }

    /// Lights the first sixteen, or all, of the ray along `stretch`, and puts them behind what has been met before.
    pub(super) fn composite(
        &mut self,
        stretch: &RaySegment,
        light: Option<&mut Lighting>,
        composite: &mut Composite,
    ) {
        let count = self.filled.min(LANES);
        if let Some(light) = light {
            self.light_up(stretch, light, count);
        }
        let rows = &self.rows;
        for l in 0..count {
            let source = |c: usize| rows[SHARE][l] * (rows[SCATTERING + c][l] + rows[EMISSION + c][l]);
            composite.add([source(0), source(1), source(2)], rows[ALPHA][l]);
        }
        self.filled -= count;
        if self.filled > 0 {
            for row in &mut self.rows {
                row.copy_within(LANES.., 0);
            }
        }
    }

    /// Asks for the light at those of the first `count` samples that scatter any.
    fn light_up(&mut self, stretch: &RaySegment, light: &mut Lighting, count: usize) {
        let mut active = 0;
        for l in 0..count {
            let scatters = (0..3).any(|channel| self.rows[SCATTERING + channel][l] > 0.0);
            active |= u16::from(scatters) << l;
        }
        if active == 0 {
            return;
        }
        let mut points = [[0.0; LANES]; 3];
        for axis in 0..3 {
            for l in 0..LANES {
                points[axis][l] = stretch.origin[axis] + self.rows[T][l] * stretch.direction[axis];
            }
        }
        let arriving = light(&PointLanes { points, active });
        for channel in 0..3 {
            for l in 0..LANES {
                if active >> l & 1 == 1 {
                    self.rows[SCATTERING + channel][l] *= arriving[channel][l];
                }
            }
        }
    }
}
