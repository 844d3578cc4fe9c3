//! Plans of image lookups at sixteen points: probes, mip levels, texel indices and weights.

use crate::numeric::{LANES, Lanes};
use crate::scene::{Filter, Sampler, UvTransform, Wrap};

/// Largest number of lookups along the longer axis of a footprint.
const MAX_PROBES: usize = super::MAX_PROBES as usize;

/// Largest side of an image, in texels, so that coordinates of a mirrored image, up to twice the side, are exact.
pub(super) const MAX_SIDE: u32 = 1 << 22;

/// Largest component of an axis of a footprint, in units of uv. Images are at their coarsest level long before, and its
/// square is finite.
const MAX_AXIS: f32 = (1u64 << 40) as f32;

/// Texture coordinates of sixteen points and the axes of the rays' footprints there, before the transform of a layer.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct UvPacket {
    /// Coordinates u and v.
    pub(crate) uv: [Lanes<f32>; 2],
    /// Axes as full lengths, the longer first; each by u and v.
    pub(crate) axes: [[Lanes<f32>; 2]; 2],
}

impl UvPacket {
    /// Points at the origin, without footprints.
    pub(crate) const ZERO: UvPacket = UvPacket {
        uv: [[0.0; LANES]; 2],
        axes: [[[0.0; LANES]; 2]; 2],
    };

    /// Returns the packet in the coordinates after `transform`. Values that are not finite count as 0.
    #[inline(always)]
    pub(super) fn transformed(&self, transform: &UvTransform) -> UvPacket {
        let finite = |x: f32| if x.abs() < f32::INFINITY { x } else { 0.0 };
        let mut out = UvPacket::ZERO;
        for (row, [a, b]) in transform.matrix.into_iter().enumerate() {
            for l in 0..LANES {
                out.uv[row][l] = finite(a * self.uv[0][l] + b * self.uv[1][l] + transform.offset[row]);
            }
            for axis in 0..2 {
                let [u, v] = &self.axes[axis];
                for l in 0..LANES {
                    out.axes[axis][row][l] = finite(a * u[l] + b * v[l]).clamp(-MAX_AXIS, MAX_AXIS);
                }
            }
        }
        out
    }
}

/// Inputs of a plan besides the points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Layout {
    pub(super) size: [u32; 2],
    pub(super) sampler: Sampler,
    pub(super) has_mips: bool,
    pub(super) tex_coord: u32,
    pub(super) transform: UvTransform,
}

/// Texel indices and weights of the lookups of sixteen points.
#[derive(Debug)]
pub(super) struct LookupPlan {
    /// Number of lookups along the footprint of each lane.
    pub(super) probe_count: Lanes<u32>,
    /// Reciprocal of that number.
    pub(super) share: Lanes<f32>,
    /// Finer of the two mip levels of each lane; 0 is the image.
    pub(super) level: Lanes<u32>,
    /// Weight of the coarser level.
    pub(super) blend: Lanes<f32>,
    /// Texels of each probe on the finer and on the coarser level.
    pub(super) taps: Box<[[Taps; 2]; MAX_PROBES]>,
}

/// The four texels of a bilinear lookup in each lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Taps {
    /// Index of the texel in the first column, in each of the two rows.
    pub(super) first: [Lanes<u32>; 2],
    /// Wrapping step from these indices to those of the second column: 1 except at the edges of the image.
    pub(super) step: Lanes<u32>,
    /// Weight of the second column.
    pub(super) across: Lanes<f32>,
    /// Weight of the second row.
    pub(super) down: Lanes<f32>,
}

impl Taps {
    const ZERO: Taps = Taps {
        first: [[0; LANES]; 2],
        step: [0; LANES],
        across: [0.0; LANES],
        down: [0.0; LANES],
    };
}

impl Default for LookupPlan {
    fn default() -> LookupPlan {
        LookupPlan {
            probe_count: [1; LANES],
            share: [1.0; LANES],
            level: [0; LANES],
            blend: [0.0; LANES],
            taps: Box::new([[Taps::ZERO; 2]; MAX_PROBES]),
        }
    }
}

impl LookupPlan {
    /// Plans the lookups at `points`, which are in the coordinates before the layer's transform.
    #[inline(always)]
    pub(super) fn fill(&mut self, layout: &Layout, points: &UvPacket, mask: &Lanes<bool>) {
        let points = points.transformed(&layout.transform);
        let sampler = layout.sampler;
        // Choose the probes and the mip levels by the footprints
        if layout.has_mips {
            self.choose_levels(layout.size, &points.axes);
        } else {
            self.probe_count = [1; LANES];
            self.level = [0; LANES];
            self.blend = [0.0; LANES];
        }
        let mut most = 1;
        let mut blends = false;
        for l in 0..LANES {
            most = most.max(if mask[l] { self.probe_count[l] } else { 1 });
            blends |= mask[l] & (self.blend[l] > 0.0);
        }
        // Wrap the centres first, so that the offsets of the probes are not lost in large coordinates
        let centers = [
            wrapped_center(sampler.wrap_u, &points.uv[0]),
            wrapped_center(sampler.wrap_v, &points.uv[1]),
        ];
        // Find the texels of each probe on both levels
        self.share = self.probe_count.map(|count| 1.0 / count as i32 as f32);
        for probe in 0..most as usize {
            let mut uv = centers;
            if most > 1 {
                for axis in 0..2 {
                    for l in 0..LANES {
                        let offset = (probe as f32 + 0.5) * self.share[l] - 0.5;
                        uv[axis][l] += points.axes[0][axis][l] * offset;
                    }
                }
            }
            let [finer, coarser] = &mut self.taps[probe];
            finer.fill(layout, &uv, &self.level);
            if blends {
                coarser.fill(layout, &uv, &self.level.map(|level| level + 1));
            }
        }
    }

    /// Chooses the number of probes and the mip levels for an image of this size.
    #[inline(always)]
    fn choose_levels(&mut self, size: [u32; 2], axes: &[[Lanes<f32>; 2]; 2]) {
        let coarsest = size[0].max(size[1]).max(1).ilog2() as f32;
        let size = size.map(|side| side as f32);
        for l in 0..LANES {
            // Measure the axes in texels
            let [longer, shorter] = [0, 1].map(|axis| {
                let [u, v] = [axes[axis][0][l] * size[0], axes[axis][1][l] * size[1]];
                (u * u + v * v).sqrt()
            });
            // The comparison is false for 0 / 0, without a footprint
            let ratio = longer / shorter;
            let count = if ratio > 1.0 {
                ratio.ceil().min(MAX_PROBES as f32)
            } else {
                1.0
            };
            let width = shorter.max(longer / count);
            // The level is the binary logarithm of the width
            let level = if width > 1.0 {
                log2(width).min(coarsest)
            } else {
                0.0
            };
            let finer = level.floor();
            self.probe_count[l] = whole(count) as u32;
            self.level[l] = whole(finer) as u32;
            self.blend[l] = level - finer;
        }
    }
}

impl Taps {
    /// Sets the texels around the coordinates `uv` on the mip level of each lane.
    #[inline(always)]
    fn fill(&mut self, layout: &Layout, uv: &[Lanes<f32>; 2], level: &Lanes<u32>) {
        let Sampler {
            wrap_u,
            wrap_v,
            filter,
        } = layout.sampler;
        let is_nearest = filter == Filter::Nearest;
        let side = |axis: usize| level.map(|level| (layout.size[axis] >> level).max(1));
        let (width, height) = (side(0), side(1));
        let columns = neighbors(wrap_u, is_nearest, &uv[0], &width, &mut self.across);
        let rows = neighbors(wrap_v, is_nearest, &uv[1], &height, &mut self.down);
        for l in 0..LANES {
            for row in 0..2 {
                self.first[row][l] = rows[row][l].wrapping_mul(width[l]).wrapping_add(columns[0][l]);
            }
            self.step[l] = columns[1][l].wrapping_sub(columns[0][l]);
        }
    }
}

/// Returns coordinates in the same place of the repeated image that are near 0 where the image repeats.
#[inline(always)]
fn wrapped_center(wrap: Wrap, coordinate: &Lanes<f32>) -> Lanes<f32> {
    match wrap {
        Wrap::Repeat => coordinate.map(|x| x - x.floor()),
        Wrap::MirroredRepeat => coordinate.map(|x| x - 2.0 * (0.5 * x).floor()),
        Wrap::ClampToEdge => *coordinate,
    }
}

/// Returns the two texels between whose centres each coordinate lies, along one side of an image, and writes the weight
/// of the second one; for nearest lookups, the texel that contains the coordinate, twice.
#[inline(always)]
fn neighbors(
    wrap: Wrap,
    is_nearest: bool,
    coordinate: &Lanes<f32>,
    size: &Lanes<u32>,
    weight: &mut Lanes<f32>,
) -> [Lanes<u32>; 2] {
    // Wrap the coordinates to [0, 1], of a mirrored image to [0, 2]
    let inside = match wrap {
        Wrap::Repeat => coordinate.map(|x| x - x.floor()),
        Wrap::MirroredRepeat => coordinate.map(|x| x - 2.0 * (0.5 * x).floor()),
        Wrap::ClampToEdge => coordinate.map(|x| x.clamp(0.0, 1.0)),
    };
    // Find the texel centre to the left, and its distance. Each of these loops has one step, or it is not vectorised.
    let half = if is_nearest { 0.0 } else { 0.5 };
    let mut left = [0; LANES];
    for l in 0..LANES {
        let x = inside[l] * size[l] as i32 as f32 - half;
        let floor = x.floor();
        weight[l] = x - floor;
        left[l] = whole(floor);
    }
    let mut right = left;
    if is_nearest {
        *weight = [0.0; LANES];
    } else {
        right = left.map(|i| i + 1);
    }
    // Wrap the texels beyond the edges
    let last = size.map(|size| size as i32 - 1);
    match wrap {
        Wrap::Repeat => {
            for l in 0..LANES {
                left[l] = if left[l] < 0 { last[l] } else { left[l] };
                right[l] = if right[l] > last[l] { 0 } else { right[l] };
            }
        }
        Wrap::MirroredRepeat => {
            for l in 0..LANES {
                left[l] = left[l].min(2 * last[l] + 1 - left[l]);
                right[l] = right[l].min(2 * last[l] + 1 - right[l]);
            }
        }
        Wrap::ClampToEdge => {}
    }
    // `clamp` may panic, which would keep a loop from being vectorised
    let mut texels = [[0; LANES]; 2];
    for l in 0..LANES {
        texels[0][l] = left[l].max(0).min(last[l]) as u32;
        texels[1][l] = right[l].max(0).min(last[l]) as u32;
    }
    texels
}

/// Returns a whole number in -1..2^23 - 1 as an integer. The cast of the language, which saturates, is not vectorised.
#[inline(always)]
fn whole(x: f32) -> i32 {
    /// In the binade of 2^23, the last bit of a number has the value 1.
    const ONES: f32 = (1 << 23) as f32;
    (x + 1.0 + ONES).to_bits().wrapping_sub(ONES.to_bits()) as i32 - 1
}

/// Returns the binary logarithm of a normal `x` ≥ 1, with an error of less than 1e-6. Exact for powers of two, and
/// continuous there.
#[inline(always)]
fn log2(x: f32) -> f32 {
    /// Minimax polynomial of log2(1 + f) / f in [0, 1], whose coefficients add up to 1.
    const COEFFICIENTS: [f32; 7] = [
        0.015_209_038,
        -0.078_534_72,
        0.193_029_31,
        -0.325_139_95,
        0.473_324_1,
        -0.720_554_2,
        1.442_666_4,
    ];
    const FRACTION: u32 = (1 << 23) - 1;
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let f = f32::from_bits(bits & FRACTION | 1.0f32.to_bits()) - 1.0;
    let mut sum = 0.0;
    for coefficient in COEFFICIENTS {
        sum = sum * f + coefficient;
    }
    exponent as f32 + sum * f
}
