//! Test of a block of eight triangles against the rays of a group.
//!
//! The triangles are projected to windows in the plane of the rays. If few rays are in the window of the block's box, or in that
//! of all triangles, each of these is tested against eight triangles at once; else each triangle against the packets that its
//! window overlaps.

use crate::accel::{LANES, RayPacket};
use crate::mesh::simd::{Floats, LaneMask, SimdLevel, WideLevel, lanes};
use crate::numeric::Lanes;

use super::decide::{CornerRows, LaneTriangles, decide};
use super::edges::{BlockCorners, CandidateLanes, EdgeRows, Edges, OrientedEdges, ProjectedRays};
use super::frame::splat;
use super::frustum::DepthWindow;
use super::projection::GroupProjection;
use super::query::GroupQuery;
use super::rays::{GroupRays, GroupWindow, NO_SLOT, OFF, PACKETS};
use super::start::StartTest;
use crate::accel::native::layout::{LeafBlock, TreeView};

/// Maximum number of rays that are tested one by one. With 12 of them, and 2 a triangle, tracing 2 million triangles takes 1.1
/// times as long at one sample a pixel, and the same time at 16.
const FEW_RAYS: usize = 32;
/// Maximum number of rays a visible triangle that are tested one by one.
const FEW_RAYS_A_TRIANGLE: usize = 4;
/// Error of a projected vertex relative to the greatest |u| of rays: 32 units of roundoff, rounded up, for a reciprocal, a
/// product and the tolerance of the decision in f64.
const WINDOW_ERROR: f32 = 2e-6;
/// Depth of a vertex below which the triangle's window is unbounded: any number whose reciprocal is finite.
const MIN_DEPTH: f32 = 1e-30;

/// Windows of eight triangles.
struct TriangleWindows<W: WideLevel<8>> {
    u_min: Floats<W, 8>,
    u_max: Floats<W, 8>,
    v_min: Floats<W, 8>,
    v_max: Floats<W, 8>,
    z_min: Floats<W, 8>,
}

/// Rays that are in one window, by packet.
pub(super) struct RayList {
    packets: [u16; FEW_RAYS],
    /// Lanes of each packet.
    lanes: [u16; FEW_RAYS],
    /// Number of packets in the list.
    pub(super) count: usize,
}

impl RayList {
    /// Keeps the rays that are in a triangle's window; returns the triangles in whose windows they are.
    #[inline(always)]
    fn keep_in<W: WideLevel<8>>(&mut self, eight: W, windows: &TriangleWindows<W>, rays: &GroupRays) -> u32 {
        let (mut visible, mut kept) = (0, 0);
        for i in 0..self.count.min(FEW_RAYS) {
            // Test each ray of the packet
            let (packet, mut inside) = (self.packets[i], u32::from(self.lanes[i]));
            for lane in lanes(inside) {
                let around = windows.around_ray(eight, rays, usize::from(packet), lane);
                visible |= around;
                inside &= !(u32::from(around == 0) << lane);
            }
            // Keep the packet if it has any left
            self.packets[kept % FEW_RAYS] = packet;
            self.lanes[kept % FEW_RAYS] = inside as u16;
            kept += usize::from(inside != 0);
        }
        self.count = kept;
        visible
    }
}

/// Tests the triangles of a block against the rays of a list, or else against all rays, and keeps the hits.
#[inline(always)]
pub(super) fn test_block<I: SimdLevel, P: GroupQuery>(
    isa: I,
    tree: TreeView,
    index: usize,
    mut list: Option<RayList>,
    rays: &mut GroupRays,
    packets: &[RayPacket],
) {
    let block = &tree.blocks[index];
    let eight = isa.eight();
    let corners = BlockCorners::new::<P::Projection>(eight, block, rays);
    let windows = TriangleWindows::new::<P::Projection>(eight, &corners, &rays.centred);
    let mut visible;
    if let Some(list) = &mut list {
        // Cull by the windows around each ray
        visible = list.keep_in(eight, &windows, rays);
    } else {
        // Cull by the group's window, then list the rays if they are few
        let overlapping = windows.overlapping::<P::Projection>(eight, &corners, rays);
        visible = overlapping.bits();
        if visible == 0 {
            return;
        }
        let few = FEW_RAYS.min(FEW_RAYS_A_TRIANGLE * visible.count_ones() as usize);
        list = few_rays(isa, &windows.around(eight, overlapping), rays, few);
    }
    if let Some(list) = &list
        && list.count == 0
    {
        return;
    }
    // Cull by edges, then test both orientations of triangles that may have either
    let mut oriented = OrientedEdges::new::<P>(eight, &corners, rays);
    visible &= oriented.reaching(eight, &rays.centred);
    let mut changed = 0;
    while visible != 0 {
        let test = BlockTest {
            isa,
            tree,
            index,
            block,
            corners: &corners,
            edges: &oriented.edges,
            packets,
        };
        match &list {
            Some(list) => test.each_ray::<P>(list, visible, rays, &mut changed),
            None => test.each_triangle::<P>(&windows, visible, rays, &mut changed),
        }
        visible &= std::mem::take(&mut oriented.ambiguous);
        if visible != 0 {
            oriented.flip(eight);
        }
    }
    // Update the depths of packets, tiles and group
    if changed != 0 {
        rays.update_depths(isa, changed);
    }
}

impl<W: WideLevel<8>> TriangleWindows<W> {
    #[inline(always)]
    fn new<J: GroupProjection>(
        eight: W,
        corners: &BlockCorners<W>,
        group: &GroupWindow,
    ) -> TriangleWindows<W> {
        let BlockCorners { x, y, z, .. } = corners;
        // Find the least depths
        let z_min = z[0].min(z[1].min(z[2]));
        // Vertices in the frame of parallel rays are projected already, as the edge test has them
        if J::IS_PARALLEL {
            return TriangleWindows {
                u_min: x[0].min(x[1].min(x[2])),
                u_max: x[0].max(x[1].max(x[2])),
                v_min: y[0].min(y[1].min(y[2])),
                v_max: y[0].max(y[1].max(y[2])),
                z_min,
            };
        }
        // Project the others to the plane z = 1
        let one = splat(eight, 1.0);
        let (r0, r1, r2) = (one / z[0], one / z[1], one / z[2]);
        let (u0, u1, u2) = (x[0] * r0, x[1] * r1, x[2] * r2);
        let (v0, v1, v2) = (y[0] * r0, y[1] * r1, y[2] * r2);
        // Bound them, without limits if a vertex is not in front of the common end
        let error_u = splat(eight, WINDOW_ERROR * group.u_min.abs().max(group.u_max.abs()));
        let error_v = splat(eight, WINDOW_ERROR * group.v_min.abs().max(group.v_max.abs()));
        let behind = z_min.le(splat(eight, MIN_DEPTH));
        let (infinity, minus_infinity) = (splat(eight, f32::INFINITY), splat(eight, f32::NEG_INFINITY));
        TriangleWindows {
            u_min: behind.select(minus_infinity, u0.min(u1.min(u2)) - error_u),
            u_max: behind.select(infinity, u0.max(u1.max(u2)) + error_u),
            v_min: behind.select(minus_infinity, v0.min(v1.min(v2)) - error_v),
            v_max: behind.select(infinity, v0.max(v1.max(v2)) + error_v),
            z_min,
        }
    }

    /// Returns the triangles that overlap the group's window and depths.
    #[inline(always)]
    fn overlapping<J: GroupProjection>(
        &self,
        eight: W,
        corners: &BlockCorners<W>,
        rays: &GroupRays,
    ) -> LaneMask<W, 8> {
        // Compare the depths, which have no lower limit where rays are parallel
        let group = &rays.centred;
        let mut in_depth = self.z_min.le(splat(eight, rays.z_max));
        if !J::IS_PARALLEL {
            let [z0, z1, z2] = corners.z;
            in_depth = in_depth & splat(eight, 0.0).le(z0.max(z1.max(z2)));
        }
        // Compare the windows
        let in_u = self.u_min.le(splat(eight, group.u_max)) & splat(eight, group.u_min).le(self.u_max);
        let in_v = self.v_min.le(splat(eight, group.v_max)) & splat(eight, group.v_min).le(self.v_max);
        in_depth & in_u & in_v
    }

    /// Returns the triangles whose window contains a ray.
    #[inline(always)]
    fn around_ray(&self, eight: W, rays: &GroupRays, packet: usize, lane: usize) -> u32 {
        let (packet, lane) = (packet % PACKETS, lane % LANES);
        let (u, v) = (
            splat(eight, rays.u[packet][lane]),
            splat(eight, rays.v[packet][lane]),
        );
        let in_u = self.u_min.le(u) & u.le(self.u_max);
        let in_v = self.v_min.le(v) & v.le(self.v_max);
        (in_u & in_v & self.z_min.le(splat(eight, rays.z[packet][lane]))).bits()
    }

    /// Returns the window around the windows of a mask.
    #[inline(always)]
    fn around(&self, eight: W, mask: LaneMask<W, 8>) -> DepthWindow {
        let (infinity, minus_infinity) = (splat(eight, f32::INFINITY), splat(eight, f32::NEG_INFINITY));
        DepthWindow {
            u_min: mask.select(self.u_min, infinity).min_lane(),
            u_max: mask.select(self.u_max, minus_infinity).max_lane(),
            v_min: mask.select(self.v_min, infinity).min_lane(),
            v_max: mask.select(self.v_max, minus_infinity).max_lane(),
            z_min: mask.select(self.z_min, infinity).min_lane(),
        }
    }
}

/// Returns the rays in a window; `None` if they are more than `few`.
#[inline(always)]
pub(super) fn few_rays(
    isa: impl SimdLevel,
    window: &DepthWindow,
    rays: &GroupRays,
    few: usize,
) -> Option<RayList> {
    // Start with an empty list
    let mut list = RayList {
        packets: [0; FEW_RAYS],
        lanes: [0; FEW_RAYS],
        count: 0,
    };
    let mut ray_count = 0;
    // Add the rays of the packets of the tiles that the window overlaps
    for tile in lanes(window.tiles(isa, rays)) {
        for slot in lanes(window.overlap(isa, &rays.packets, tile)) {
            let packet = 8 * tile + slot;
            let inside = window.rays(isa, rays, packet);
            ray_count += inside.count_ones() as usize;
            if ray_count > few {
                return None;
            }
            list.packets[list.count % FEW_RAYS] = packet as u16;
            list.lanes[list.count % FEW_RAYS] = inside as u16;
            list.count += usize::from(inside != 0);
        }
    }
    Some(list)
}

/// Test of a block against the rays of a group.
struct BlockTest<'a, I: SimdLevel> {
    isa: I,
    tree: TreeView<'a>,
    /// Index of the block.
    index: usize,
    block: &'a LeafBlock,
    corners: &'a BlockCorners<I::Eight>,
    edges: &'a Edges<I::Eight, 8>,
    packets: &'a [RayPacket],
}

/// Hits of the lanes of a test.
struct CandidateHits<W: WideLevel<N>, const N: usize> {
    hits: LaneMask<W, N>,
    z: Floats<W, N>,
}

impl<I: SimdLevel> BlockTest<'_, I> {
    /// Tests each triangle against the packets that its window overlaps.
    #[inline(always)]
    fn each_triangle<P: GroupQuery>(
        &self,
        windows: &TriangleWindows<I::Eight>,
        visible: u32,
        rays: &mut GroupRays,
        changed: &mut u64,
    ) {
        // Store edges and windows in memory, to broadcast those of one triangle at a time
        let isa = self.isa;
        let rows = EdgeRows::new::<P, _>(self.edges);
        let windows = [
            windows.u_min.to_array(),
            windows.u_max.to_array(),
            windows.v_min.to_array(),
            windows.v_max.to_array(),
            windows.z_min.to_array(),
        ];
        for triangle in lanes(visible) {
            // Broadcast the triangle
            let triangle = triangle % 8;
            let target = DepthWindow {
                u_min: windows[0][triangle],
                u_max: windows[1][triangle],
                v_min: windows[2][triangle],
                v_max: windows[3][triangle],
                z_min: windows[4][triangle],
            };
            let edges = rows.broadcast::<P, _, LANES>(isa.sixteen(), triangle);
            // Test the packets of each tile that it overlaps
            for tile in lanes(target.tiles(isa, rays)) {
                for slot in lanes(target.overlap(isa, &rays.packets, tile)) {
                    let packet = (8 * tile + slot) % PACKETS;
                    if self.triangle_and_packet::<P>(&edges, triangle, packet, rays) {
                        *changed |= 1 << packet;
                    }
                }
            }
        }
    }

    /// Tests a triangle against the rays of a packet; returns whether there is a hit.
    #[inline(always)]
    fn triangle_and_packet<P: GroupQuery>(
        &self,
        edges: &Edges<I::Sixteen, LANES>,
        triangle: usize,
        packet: usize,
        rays: &mut GroupRays,
    ) -> bool {
        // Find the lanes that hit the triangle
        let sixteen = self.isa.sixteen();
        let lane_rays = ProjectedRays {
            u: Floats::load(sixteen, &rays.u[packet]),
            v: Floats::load(sixteen, &rays.v[packet]),
            z_near: Floats::load(sixteen, &rays.z_near[packet]),
            z: Floats::load(sixteen, &rays.z[packet]),
        };
        let Some(candidates) = edges.candidates::<P>(sixteen, &lane_rays) else {
            return false;
        };
        let triangles = LaneTriangles::One(triangle);
        let found = self.decided::<P, _, LANES>(sixteen, &candidates, &lane_rays, triangles);
        let mut hits = found.hits;
        if P::IS_ANY {
            // Discard hits behind the starts
            let near = hits.bits() & candidates.near_start(found.z, &lane_rays);
            if near != 0 {
                let (frame, packets) = (&rays.frame, self.packets);
                let test = StartTest::of_packet::<P::Projection>(
                    sixteen, frame, packets, packet, self.block, triangle,
                );
                let behind = test.behind(near);
                hits = LaneMask::of_bits(sixteen, hits.bits() & !behind);
            }
            // Turn off the rays that are blocked
            rays.z[packet] = hits.select(splat(sixteen, OFF), lane_rays.z).to_array();
            return hits.bits() != 0;
        }
        // Keep the hits that are nearer, or as near and of a lower number
        let ties = (hits & found.z.eq(lane_rays.z)).bits();
        hits = hits & found.z.lt(lane_rays.z);
        if ties != 0 {
            let won = self.won_ties(triangle, ties, &rays.slots[packet]);
            hits = hits | LaneMask::of_bits(sixteen, won);
        }
        if hits.bits() == 0 {
            return false;
        }
        // Store them
        let slot = splat(sixteen, f32::from_bits(TreeView::slot(self.index, triangle)));
        let slots = Floats::load(sixteen, bytemuck::cast_ref(&rays.slots[packet]));
        // Store depths between load and store of the slots, of which the compiler would make a slow store by a mask
        rays.z[packet] = hits.select(found.z, lane_rays.z).to_array();
        rays.slots[packet] = bytemuck::cast(hits.select(slot, slots).to_array());
        true
    }

    /// Returns the lanes of `ties` whose hit in `slots` is on a triangle of a higher number, or that have none.
    #[cold]
    #[inline(never)]
    fn won_ties(&self, triangle: usize, ties: u32, slots: &Lanes<u32>) -> u32 {
        // Compare the numbers of the triangles
        let number = self.block.numbers[triangle];
        let mut won = 0;
        for lane in lanes(ties) {
            let slot = slots[lane % LANES];
            let is_won = slot == NO_SLOT || number < self.tree.triangle_at(slot).number;
            won |= u32::from(is_won) << lane;
        }
        won
    }

    /// Tests each listed ray against the visible triangles.
    #[inline(always)]
    fn each_ray<P: GroupQuery>(&self, list: &RayList, visible: u32, rays: &mut GroupRays, changed: &mut u64) {
        for i in 0..list.count.min(FEW_RAYS) {
            let packet = usize::from(list.packets[i]) % PACKETS;
            for lane in lanes(u32::from(list.lanes[i])) {
                if self.ray_and_block::<P>(packet, lane % LANES, visible, rays) {
                    *changed |= 1 << packet;
                }
            }
        }
    }

    /// Tests a ray against the visible triangles; returns whether there is a hit.
    #[inline(always)]
    fn ray_and_block<P: GroupQuery>(
        &self,
        packet: usize,
        lane: usize,
        visible: u32,
        rays: &mut GroupRays,
    ) -> bool {
        // Find the triangles that the ray hits
        let eight = self.isa.eight();
        let lane_rays = ProjectedRays {
            u: splat(eight, rays.u[packet][lane]),
            v: splat(eight, rays.v[packet][lane]),
            z_near: splat(eight, rays.z_near[packet][lane]),
            z: splat(eight, rays.z[packet][lane]),
        };
        let Some(candidates) = self.edges.candidates::<P>(eight, &lane_rays) else {
            return false;
        };
        let found = self.decided::<P, _, 8>(eight, &candidates, &lane_rays, LaneTriangles::Each);
        let mut hits = found.hits.bits() & visible;
        // Discard hits behind its start
        if P::IS_ANY {
            let near = hits & candidates.near_start(found.z, &lane_rays);
            if near != 0 {
                let (frame, packets) = (&rays.frame, self.packets);
                let test =
                    StartTest::of_ray::<P::Projection>(eight, frame, packets, packet, lane, self.block);
                hits &= !test.behind(near);
            }
        }
        if hits == 0 {
            return false;
        }
        // Turn off the ray if it is blocked
        if P::IS_ANY {
            rays.z[packet][lane] = OFF;
            return true;
        }
        // Keep the nearest, of equals that of the lowest number
        let z = found.z.to_array();
        let mut is_nearer = false;
        for triangle in lanes(hits) {
            let triangle = triangle % 8;
            let best = rays.z[packet][lane];
            let is_tie = z[triangle] == best;
            if z[triangle] < best || is_tie && self.won_ties(triangle, 1 << lane, &rays.slots[packet]) != 0 {
                rays.z[packet][lane] = z[triangle];
                rays.slots[packet][lane] = TreeView::slot(self.index, triangle);
                is_nearer = true;
            }
        }
        is_nearer
    }

    /// Returns the hits within the rays' depths, after lanes close to an edge have been decided in f64.
    #[inline(always)]
    fn decided<P: GroupQuery, W: WideLevel<N>, const N: usize>(
        &self,
        level: W,
        candidates: &CandidateLanes<W, N>,
        lane_rays: &ProjectedRays<W, N>,
        triangles: LaneTriangles,
    ) -> CandidateHits<W, N> {
        let mut found = CandidateHits {
            hits: candidates.inside,
            z: candidates.z,
        };
        let near_edge = candidates.near_edge.bits();
        if near_edge != 0 {
            // Copy the vertices here, so that on the common path they stay in registers
            let corners = CornerRows::new(self.corners);
            let (u, v) = (lane_rays.u.to_array(), lane_rays.v.to_array());
            let decided = decide::<P::Projection, N>(&corners, triangles, near_edge, [&u, &v]);
            // Replace the lanes that were decided
            let near_edge = candidates.near_edge;
            found.z = near_edge.select(Floats::load(level, &decided.z), found.z);
            // Keep those within the ray's depths
            let within = candidates.within::<P>(found.z, lane_rays);
            let certain = candidates.inside.bits() & !near_edge.bits();
            let decided_hits = near_edge.bits() & decided.hits & within.bits();
            found.hits = LaneMask::of_bits(level, certain | decided_hits);
        }
        found
    }
}
