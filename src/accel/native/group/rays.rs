//! Rays of a group, with the windows that enclose them at three levels: packets of sixteen rays, tiles of eight packets,
//! and the group.

use crate::accel::{LANES, RayPacket};
use crate::mesh::simd::{Floats, SimdLevel};
use crate::numeric::Lanes;

use super::frame::{GroupFrame, splat};
use super::projection::{GroupProjection, ProjectedPacket};

/// Maximum number of packets of a group.
pub(super) const PACKETS: usize = 64;
/// Maximum number of tiles of eight packets.
const TILES: usize = PACKETS / 8;
/// Value of [`GroupRays::slots`] for a ray without a hit.
pub(super) const NO_SLOT: u32 = u32::MAX;
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

/// Rays of a group and their hits.
#[repr(C, align(64))]
pub(super) struct GroupRays {
    pub(super) frame: GroupFrame,
    /// Window around all rays, not relative to the centre.
    pub(super) window: GroupWindow,
    /// Greatest magnitude of u or v of a ray, not relative to the centre.
    pub(super) reach: f32,
    /// Slopes along which vertices are sheared to z: those of the common direction; for rays with a common end those of
    /// the window's centre, which is also subtracted from u and v, so that they are small and keep their digits.
    pub(super) slopes: [f32; 2],
    /// Window relative to the centre.
    pub(super) centred: GroupWindow,
    /// Greatest depth that a ray searches; [`OFF`] if all are off.
    pub(super) z_max: f32,
    packet_count: usize,
    /// First packet from which on all are empty.
    cleared_from: usize,
    pub(super) tiles: Windows<1>,
    pub(super) packets: Windows<TILES>,
    pub(super) u: [Lanes<f32>; PACKETS],
    pub(super) v: [Lanes<f32>; PACKETS],
    /// Depths up to which rays search: of their ends, then of their nearest hits; [`OFF`] for lanes that are off.
    pub(super) z: [Lanes<f32>; PACKETS],
    /// Depths from which rays search.
    pub(super) z_near: [Lanes<f32>; PACKETS],
    /// Slots in the tree's blocks of the triangles hit, as [`TreeView::slot`] numbers them; [`NO_SLOT`] for none.
    pub(super) slots: [Lanes<u32>; PACKETS],
    /// Mask of the lanes that are in the group, by packet.
    pub(super) taken: [u32; PACKETS],
}

impl GroupRays {
    /// Allocates the arrays of an empty group.
    pub(super) fn new() -> Box<GroupRays> {
        Box::new(GroupRays {
            frame: GroupFrame::along([0.0, 0.0, 1.0], [0.0; 3]),
            window: GroupWindow::default(),
            reach: 0.0,
            slopes: [0.0; 2],
            centred: GroupWindow::default(),
            z_max: OFF,
            packet_count: 0,
            cleared_from: 0,
            tiles: Windows::EMPTY,
            packets: Windows::EMPTY,
            u: [[0.0; LANES]; PACKETS],
            v: [[0.0; LANES]; PACKETS],
            z: [[OFF; LANES]; PACKETS],
            z_near: [[0.0; LANES]; PACKETS],
            slots: [[NO_SLOT; LANES]; PACKETS],
            taken: [0; PACKETS],
        })
    }

    /// Takes the pending rays that fit the frame, up to [`PACKETS`] packets; returns their number.
    #[inline(always)]
    pub(super) fn load<I: SimdLevel, J: GroupProjection>(
        &mut self,
        isa: I,
        packets: &[RayPacket],
        pending: &[u32],
        projection: J,
        frame: GroupFrame,
    ) -> u32 {
        // Start with an empty window
        self.frame = frame;
        let sixteen = isa.sixteen();
        let infinity = splat(sixteen, f32::INFINITY);
        let minus_infinity = splat(sixteen, f32::NEG_INFINITY);
        let (mut u_min, mut u_max) = (infinity, minus_infinity);
        let (mut v_min, mut v_max) = (infinity, minus_infinity);
        let mut count = 0;
        self.packet_count = 0;
        for (packet, &pending) in packets.iter().zip(pending).take(PACKETS) {
            let index = self.packet_count % PACKETS;
            self.packet_count += 1;
            let projected = projection.project(isa, packet, pending, &frame);
            let ProjectedPacket {
                fits,
                u,
                v,
                z_near,
                z_far,
            } = projected;
            // Store the rays, with lanes that do not fit turned off
            self.u[index] = u.to_array();
            self.v[index] = v.to_array();
            self.z[index] = fits.select(z_far, splat(sixteen, OFF)).to_array();
            self.z_near[index] = z_near.to_array();
            self.taken[index] = fits.bits();
            count += fits.bits().count_ones();
            // Extend the window to them
            u_min = u_min.min(fits.select(u, infinity));
            u_max = u_max.max(fits.select(u, minus_infinity));
            v_min = v_min.min(fits.select(v, infinity));
            v_max = v_max.max(fits.select(v, minus_infinity));
        }
        // Reduce the window's lanes
        self.window = GroupWindow {
            u_min: u_min.min_lane(),
            u_max: u_max.max_lane(),
            v_min: v_min.min_lane(),
            v_max: v_max.max_lane(),
        };
        if count > 0 {
            self.centre::<I, J>(isa);
        }
        count
    }

    /// Moves the centre of the window to zero, where rays have a common end, and computes the windows of all levels.
    #[inline(always)]
    fn centre<I: SimdLevel, J: GroupProjection>(&mut self, isa: I) {
        let GroupWindow {
            u_min,
            u_max,
            v_min,
            v_max,
        } = self.window;
        let reach_u = u_min.abs().max(u_max.abs());
        self.reach = reach_u.max(v_min.abs().max(v_max.abs()));
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
        // Move the rays and bound the packets
        let sixteen = isa.sixteen();
        let infinity = splat(sixteen, f32::INFINITY);
        let minus_infinity = splat(sixteen, f32::NEG_INFINITY);
        let [centre_u, centre_v] = [splat(sixteen, centre[0]), splat(sixteen, centre[1])];
        for packet in 0..self.packet_count.min(PACKETS) {
            let z = Floats::load(sixteen, &self.z[packet]);
            let u = Floats::load(sixteen, &self.u[packet]) - centre_u;
            let v = Floats::load(sixteen, &self.v[packet]) - centre_v;
            self.u[packet] = u.to_array();
            self.v[packet] = v.to_array();
            let is_off = z.eq(splat(sixteen, OFF));
            let (row, slot) = (packet / 8, packet % 8);
            self.packets.u_min[row][slot] = is_off.select(infinity, u).min_lane();
            self.packets.u_max[row][slot] = is_off.select(minus_infinity, u).max_lane();
            self.packets.v_min[row][slot] = is_off.select(infinity, v).min_lane();
            self.packets.v_max[row][slot] = is_off.select(minus_infinity, v).max_lane();
            self.packets.z_max[row][slot] = z.max_lane();
            self.slots[packet] = [NO_SLOT; LANES];
        }
        // Clear the rest of the last tile, and what a larger group has left: unbounded triangles overlap all windows
        let end = self.packet_count.next_multiple_of(8).max(self.cleared_from);
        self.cleared_from = self.packet_count;
        for packet in self.packet_count..end.min(PACKETS) {
            let (row, slot) = (packet / 8, packet % 8);
            self.z[packet] = [OFF; LANES];
            self.packets.u_min[row][slot] = f32::INFINITY;
            self.packets.u_max[row][slot] = f32::NEG_INFINITY;
            self.packets.v_min[row][slot] = f32::INFINITY;
            self.packets.v_max[row][slot] = f32::NEG_INFINITY;
            self.packets.z_max[row][slot] = OFF;
        }
        // Bound the tiles, then the group
        let eight = isa.eight();
        self.tiles = Windows::EMPTY;
        for tile in 0..self.tile_count() {
            self.tiles.u_min[0][tile] = Floats::load(eight, &self.packets.u_min[tile]).min_lane();
            self.tiles.u_max[0][tile] = Floats::load(eight, &self.packets.u_max[tile]).max_lane();
            self.tiles.v_min[0][tile] = Floats::load(eight, &self.packets.v_min[tile]).min_lane();
            self.tiles.v_max[0][tile] = Floats::load(eight, &self.packets.v_max[tile]).max_lane();
            self.tiles.z_max[0][tile] = Floats::load(eight, &self.packets.z_max[tile]).max_lane();
        }
        self.z_max = Floats::load(eight, &self.tiles.z_max[0]).max_lane();
    }

    /// Computes the greatest depths anew; those of the packets in the mask `changed` have changed.
    #[inline(always)]
    pub(super) fn update_depths(&mut self, isa: impl SimdLevel, changed: u64) {
        // Update the packets
        let mut packets = changed;
        while packets != 0 {
            let packet = packets.trailing_zeros() as usize % PACKETS;
            packets &= packets - 1;
            let z_max = Floats::load(isa.sixteen(), &self.z[packet]).max_lane();
            self.packets.z_max[packet / 8][packet % 8] = z_max;
        }
        // Update their tiles
        let mut packets = changed;
        while packets != 0 {
            let tile = packets.trailing_zeros() as usize / 8 % TILES;
            packets &= !(0xff << (8 * tile));
            let z_max = Floats::load(isa.eight(), &self.packets.z_max[tile]).max_lane();
            self.tiles.z_max[0][tile] = z_max;
        }
        // Update the group
        self.z_max = Floats::load(isa.eight(), &self.tiles.z_max[0]).max_lane();
    }

    /// Returns the number of tiles in use.
    #[inline(always)]
    pub(super) fn tile_count(&self) -> usize {
        self.packet_count.div_ceil(8).min(TILES)
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
            self.tiles.area(0)
        } else {
            self.packets.area(0)
        };
        (u_max - u_min) * (v_max - v_min) > MAX_SPARSITY * parts
    }
}
