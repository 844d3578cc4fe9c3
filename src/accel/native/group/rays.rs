//! Rays of a group, with the windows that enclose them at three levels: sub-packets of eight rays, tiles of eight
//! sub-packets, and the group.

use crate::accel::RayPacket;
use crate::mesh::simd::{Float8, WideLevel};

use super::frame::{GroupFrame, HALVES, splat};
use super::projection::{GroupProjection, ProjectedHalf};

/// Maximum number of packets of a group.
pub(super) const PACKETS: usize = 64;
/// Maximum number of sub-packets of eight rays.
pub(super) const SUBS: usize = PACKETS * HALVES;
/// Maximum number of tiles of eight sub-packets.
pub(super) const TILES: usize = SUBS / 8;
/// Value of [`GroupRays::numbers`] for a ray without a hit: greater than every other one as i32.
pub(super) const NO_HIT_NUMBER: u32 = i32::MAX as u32;
/// Depth of lanes that are off, because they are not in the group or already blocked.
pub(super) const OFF: f32 = f32::NEG_INFINITY;

/// Ratio of a group's window to the sum of its parts' above which it is split.
const MAX_SPARSITY: f32 = 4.0;

/// Windows around rays in the plane, relative to the group's centre, with the greatest depths that they search.
/// Those without rays are low +∞ and high -∞.
#[derive(Clone, Copy)]
pub(super) struct Windows<const N: usize> {
    pub(super) u_min: [[f32; 8]; N],
    pub(super) u_max: [[f32; 8]; N],
    pub(super) v_min: [[f32; 8]; N],
    pub(super) v_max: [[f32; 8]; N],
    pub(super) z_max: [[f32; 8]; N],
}

impl<const N: usize> Windows<N> {
    const EMPTY: Windows<N> = Windows {
        u_min: [[f32::INFINITY; 8]; N],
        u_max: [[f32::NEG_INFINITY; 8]; N],
        v_min: [[f32::INFINITY; 8]; N],
        v_max: [[f32::NEG_INFINITY; 8]; N],
        z_max: [[OFF; 8]; N],
    };

    /// Returns the sum of the areas of eight windows.
    fn area(&self, row: usize) -> f32 {
        (0..8)
            .map(|i| {
                let width = (self.u_max[row][i] - self.u_min[row][i]).max(0.0);
                width * (self.v_max[row][i] - self.v_min[row][i]).max(0.0)
            })
            .sum()
    }
}

/// Window around all rays of a group.
#[derive(Clone, Copy, Default)]
pub(super) struct GroupWindow {
    pub(super) u_min: f32,
    pub(super) u_max: f32,
    pub(super) v_min: f32,
    pub(super) v_max: f32,
}

/// Mask of the sub-packets whose depths have changed.
#[derive(PartialEq, Eq)]
pub(super) struct ChangedSubs([u64; SUBS / 64]);

impl ChangedSubs {
    pub(super) const NONE: ChangedSubs = ChangedSubs([0; SUBS / 64]);

    /// Notes a sub-packet whose depths have changed.
    #[inline(always)]
    pub(super) fn add(&mut self, sub: usize) {
        self.0[(sub / 64) % 2] |= 1 << (sub % 64);
    }
}

/// Rays of a group and their hits.
#[repr(C, align(64))]
pub(super) struct GroupRays {
    pub(super) frame: GroupFrame,
    /// Window around all rays, not relative to the centre.
    pub(super) window: GroupWindow,
    /// Slopes along which vertices are sheared to z: those of the common direction; for rays with a common end those of
    /// the window's centre, which is also subtracted from u and v, so that they are small and keep their digits.
    pub(super) slopes: [f32; 2],
    /// Window relative to the centre.
    pub(super) centred: GroupWindow,
    /// Greatest depth that a ray searches; [`OFF`] if all are off.
    pub(super) z_max: f32,
    pub(super) sub_count: usize,
    /// First sub-packet from which on all are empty.
    cleared_from: usize,
    pub(super) tiles: Windows<{ TILES / 8 }>,
    pub(super) subs: Windows<{ SUBS / 8 }>,
    pub(super) u: [[f32; 8]; SUBS],
    pub(super) v: [[f32; 8]; SUBS],
    /// Depths up to which rays search: of their ends, then of their nearest hits; [`OFF`] for lanes that are off.
    pub(super) z: [[f32; 8]; SUBS],
    /// Depths from which rays search.
    pub(super) z_near: [[f32; 8]; SUBS],
    /// Triangles hit; [`NO_HIT_NUMBER`] for none.
    pub(super) numbers: [[u32; 8]; SUBS],
    /// Mask of the lanes that are in the group, by sub-packet.
    pub(super) taken: [u32; SUBS],
}

impl GroupRays {
    /// Allocates the arrays of an empty group.
    pub(super) fn new() -> Box<GroupRays> {
        Box::new(GroupRays {
            frame: GroupFrame::along([0.0, 0.0, 1.0], [0.0; 3]),
            window: GroupWindow::default(),
            slopes: [0.0; 2],
            centred: GroupWindow::default(),
            z_max: OFF,
            sub_count: 0,
            cleared_from: 0,
            tiles: Windows::EMPTY,
            subs: Windows::EMPTY,
            u: [[0.0; 8]; SUBS],
            v: [[0.0; 8]; SUBS],
            z: [[OFF; 8]; SUBS],
            z_near: [[0.0; 8]; SUBS],
            numbers: [[NO_HIT_NUMBER; 8]; SUBS],
            taken: [0; SUBS],
        })
    }

    /// Takes the pending rays that fit the frame, up to [`PACKETS`] packets; returns their number.
    #[inline(always)]
    pub(super) fn load<W: WideLevel, J: GroupProjection>(
        &mut self,
        wide: W,
        packets: &[RayPacket],
        pending: &[u32],
        projection: J,
        frame: GroupFrame,
    ) -> u32 {
        // Start with an empty window
        self.frame = frame;
        let (infinity, minus_infinity) = (splat(wide, f32::INFINITY), splat(wide, f32::NEG_INFINITY));
        let (mut u_min, mut u_max) = (infinity, minus_infinity);
        let (mut v_min, mut v_max) = (infinity, minus_infinity);
        let mut count = 0;
        self.sub_count = 0;
        for (packet, &pending) in packets.iter().zip(pending).take(PACKETS) {
            for h in 0..HALVES {
                let sub = self.sub_count % SUBS;
                self.sub_count += 1;
                let pending = Float8::mask_of(wide, pending >> (8 * h));
                let projected = projection.project(wide, packet, h, pending, &frame);
                let ProjectedHalf {
                    fits,
                    u,
                    v,
                    z_near,
                    z_far,
                } = projected;
                // Store the rays, with lanes that do not fit turned off
                self.u[sub] = u.to_array();
                self.v[sub] = v.to_array();
                self.z[sub] = fits.select(z_far, splat(wide, OFF)).to_array();
                self.z_near[sub] = z_near.to_array();
                self.taken[sub] = fits.bits();
                count += fits.bits().count_ones();
                // Extend the window to them
                u_min = u_min.min(fits.select(u, infinity));
                u_max = u_max.max(fits.select(u, minus_infinity));
                v_min = v_min.min(fits.select(v, infinity));
                v_max = v_max.max(fits.select(v, minus_infinity));
            }
        }
        // Reduce the window's lanes
        self.window = GroupWindow {
            u_min: u_min.min_lane(),
            u_max: u_max.max_lane(),
            v_min: v_min.min_lane(),
            v_max: v_max.max_lane(),
        };
        if count > 0 {
            self.centre::<W, J>(wide);
        }
        count
    }

    /// Moves the centre of the window to zero, where rays have a common end, and computes the windows of all levels.
    #[inline(always)]
    fn centre<W: WideLevel, J: GroupProjection>(&mut self, wide: W) {
        let GroupWindow {
            u_min,
            u_max,
            v_min,
            v_max,
        } = self.window;
        // Move the window; the frame of parallel rays is amid them already
        let centre = match J::IS_PARALLEL {
            true => [0.0; 2],
            false => [0.5 * (u_min + u_max), 0.5 * (v_min + v_max)],
        };
        self.slopes = if J::IS_PARALLEL { self.frame.slopes } else { centre };
        self.centred = GroupWindow {
            u_min: u_min - centre[0],
            u_max: u_max - centre[0],
            v_min: v_min - centre[1],
            v_max: v_max - centre[1],
        };
        // Move the rays and bound the sub-packets
        let (infinity, minus_infinity) = (splat(wide, f32::INFINITY), splat(wide, f32::NEG_INFINITY));
        let [centre_u, centre_v] = [splat(wide, centre[0]), splat(wide, centre[1])];
        for sub in 0..self.sub_count.min(SUBS) {
            let z = Float8::load(wide, &self.z[sub]);
            let u = Float8::load(wide, &self.u[sub]) - centre_u;
            let v = Float8::load(wide, &self.v[sub]) - centre_v;
            self.u[sub] = u.to_array();
            self.v[sub] = v.to_array();
            let is_off = z.eq(splat(wide, OFF));
            let (row, slot) = (sub / 8, sub % 8);
            self.subs.u_min[row][slot] = is_off.select(infinity, u).min_lane();
            self.subs.u_max[row][slot] = is_off.select(minus_infinity, u).max_lane();
            self.subs.v_min[row][slot] = is_off.select(infinity, v).min_lane();
            self.subs.v_max[row][slot] = is_off.select(minus_infinity, v).max_lane();
            self.subs.z_max[row][slot] = z.max_lane();
            self.numbers[sub] = [NO_HIT_NUMBER; 8];
        }
        // Clear the rest of the last tile, and what a larger group has left: unbounded triangles overlap all windows
        let end = self.sub_count.next_multiple_of(8).max(self.cleared_from);
        self.cleared_from = self.sub_count;
        for sub in self.sub_count..end.min(SUBS) {
            let (row, slot) = (sub / 8, sub % 8);
            self.z[sub] = [OFF; 8];
            self.subs.u_min[row][slot] = f32::INFINITY;
            self.subs.u_max[row][slot] = f32::NEG_INFINITY;
            self.subs.v_min[row][slot] = f32::INFINITY;
            self.subs.v_max[row][slot] = f32::NEG_INFINITY;
            self.subs.z_max[row][slot] = OFF;
        }
        // Bound the tiles, then the group
        self.tiles = Windows::EMPTY;
        for tile in 0..self.tile_count() {
            let (row, slot) = (tile / 8, tile % 8);
            self.tiles.u_min[row][slot] = Float8::load(wide, &self.subs.u_min[tile]).min_lane();
            self.tiles.u_max[row][slot] = Float8::load(wide, &self.subs.u_max[tile]).max_lane();
            self.tiles.v_min[row][slot] = Float8::load(wide, &self.subs.v_min[tile]).min_lane();
            self.tiles.v_max[row][slot] = Float8::load(wide, &self.subs.v_max[tile]).max_lane();
            self.tiles.z_max[row][slot] = Float8::load(wide, &self.subs.z_max[tile]).max_lane();
        }
        self.bound_depth(wide);
    }

    /// Computes the greatest depths anew where sub-packets have changed.
    #[inline(always)]
    pub(super) fn update_depths<W: WideLevel>(&mut self, wide: W, changed: &ChangedSubs) {
        // Update the sub-packets
        for word in 0..2 {
            let mut subs = changed.0[word];
            while subs != 0 {
                let sub = (64 * word + subs.trailing_zeros() as usize) % SUBS;
                subs &= subs - 1;
                self.subs.z_max[sub / 8][sub % 8] = Float8::load(wide, &self.z[sub]).max_lane();
            }
        }
        // Update their tiles
        for word in 0..2 {
            let mut subs = changed.0[word];
            while subs != 0 {
                let tile = (8 * word + subs.trailing_zeros() as usize / 8) % 16;
                subs &= !(0xff << (8 * (tile % 8)));
                self.tiles.z_max[tile / 8][tile % 8] = Float8::load(wide, &self.subs.z_max[tile]).max_lane();
            }
        }
        // Update the group
        self.bound_depth(wide);
    }

    /// Returns the number of tiles in use.
    #[inline(always)]
    pub(super) fn tile_count(&self) -> usize {
        self.sub_count.div_ceil(8).min(TILES)
    }

    /// Computes the greatest depth of all rays from those of the tiles.
    #[inline(always)]
    fn bound_depth<W: WideLevel>(&mut self, wide: W) {
        let low = Float8::load(wide, &self.tiles.z_max[0]);
        let high = Float8::load(wide, &self.tiles.z_max[1]);
        self.z_max = low.max(high).max_lane();
    }

    /// Returns the greatest magnitude of u or v of a ray, not relative to the centre.
    #[inline(always)]
    pub(super) fn reach(&self) -> f32 {
        let GroupWindow {
            u_min,
            u_max,
            v_min,
            v_max,
        } = self.window;
        let u = u_min.abs().max(u_max.abs());
        u.max(v_min.abs().max(v_max.abs()))
    }

    /// Returns whether the rays leave most of the group's window empty.
    pub(super) fn is_sparse(&self) -> bool {
        let GroupWindow {
            u_min,
            u_max,
            v_min,
            v_max,
        } = self.centred;
        // Add the areas of the smallest parts that are in use
        let parts = if self.tile_count() > 1 {
            self.tiles.area(0) + self.tiles.area(1)
        } else {
            self.subs.area(0)
        };
        (u_max - u_min) * (v_max - v_min) > MAX_SPARSITY * parts
    }
}
