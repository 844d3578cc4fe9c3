//! Test of a block of eight triangles against the rays of a group.
//!
//! The triangles are projected to windows in the plane of the rays. If few rays are in the window of them all, each of these is
//! tested against eight triangles at once; else each triangle against the sub-packets that its window overlaps.

use crate::accel::RayPacket;
use crate::mesh::simd::{Float8, WideLevel, lanes};

use super::decide::{CornerRows, LaneTriangles, decide};
use super::edges::{BlockCorners, CandidateLanes, EdgeRows, Edges, OrientedEdges, ProjectedRays};
use super::frame::splat;
use super::frustum::DepthWindow;
use super::projection::GroupProjection;
use super::query::GroupQuery;
use super::rays::{ChangedSubs, GroupRays, GroupWindow, OFF, SUBS};
use super::start::{LaneRays, StartTest, near_start};
use crate::accel::native::layout::LeafBlock;

/// Maximum number of rays that are tested one by one.
const FEW_RAYS: usize = 12;
/// Maximum number of rays a visible triangle that are tested one by one.
const FEW_RAYS_A_TRIANGLE: usize = 2;
/// Error of a projected vertex relative to the greatest |u| of rays: 32 units of roundoff, rounded up, for a reciprocal, a
/// product and the tolerance of the decision in f64.
const WINDOW_ERROR: f32 = 2e-6;
/// Depth of a vertex below which the triangle's window is unbounded: any number whose reciprocal is finite.
const MIN_DEPTH: f32 = 1e-30;

/// Windows of eight triangles.
struct TriangleWindows<W: WideLevel> {
    windows: DepthWindow<W>,
    /// Mask of the triangles that overlap the group's window and depths.
    visible: Float8<W>,
}

/// Rays that are in one window.
struct RayList {
    rays: [u16; FEW_RAYS],
    count: usize,
}

/// Tests the triangles of a block against all rays and keeps the hits.
#[inline(always)]
pub(super) fn test_block<W: WideLevel, P: GroupQuery>(
    wide: W,
    block: &LeafBlock,
    rays: &mut GroupRays,
    packets: &[RayPacket],
) {
    // Cull by windows
    let corners = BlockCorners::new::<P::Projection>(wide, block, rays);
    let windows = TriangleWindows::new::<P::Projection>(wide, &corners, rays);
    let mut visible = windows.visible.bits();
    if visible == 0 {
        return;
    }
    // List the rays if they are few
    let few = FEW_RAYS.min(FEW_RAYS_A_TRIANGLE * visible.count_ones() as usize);
    let list = windows.few_rays(wide, rays, few);
    if let Some(list) = &list
        && list.count == 0
    {
        return;
    }
    // Cull by edges, then test both orientations of triangles that may have either
    let mut oriented = OrientedEdges::new(wide, &corners, &rays.centred);
    visible &= oriented.reaching(wide, &rays.centred);
    let mut changed = ChangedSubs::NONE;
    while visible != 0 {
        let test = BlockTest {
            wide,
            block,
            corners: &corners,
            edges: &oriented.edges,
            packets,
        };
        match &list {
            Some(list) => test.each_ray::<P>(list, visible, rays, &mut changed),
            None => test.each_triangle::<P>(&windows.windows, visible, rays, &mut changed),
        }
        visible &= std::mem::take(&mut oriented.ambiguous);
        if visible != 0 {
            oriented.flip(wide);
        }
    }
    // Update the depths of sub-packets, tiles and group
    if changed != ChangedSubs::NONE {
        rays.update_depths(wide, &changed);
    }
}

impl<W: WideLevel> TriangleWindows<W> {
    #[inline(always)]
    fn new<J: GroupProjection>(wide: W, corners: &BlockCorners<W>, rays: &GroupRays) -> TriangleWindows<W> {
        // Find the range of depths
        let z = &corners.z;
        let z_min = z[0].min(z[1].min(z[2]));
        let z_max = z[0].max(z[1].max(z[2]));
        // Bound the vertices, which of parallel rays are those of the edge test
        let windows = match J::IS_PARALLEL {
            true => {
                let BlockCorners { x, y, .. } = corners;
                DepthWindow {
                    u_min: x[0].min(x[1].min(x[2])),
                    u_max: x[0].max(x[1].max(x[2])),
                    v_min: y[0].min(y[1].min(y[2])),
                    v_max: y[0].max(y[1].max(y[2])),
                    z_min,
                }
            }
            false => perspective_windows(wide, corners, &rays.centred, z_min),
        };
        // Compare with the group's window and depths
        let group = &rays.centred;
        let mut in_depth = z_min.le(splat(wide, rays.z_max));
        if !J::IS_PARALLEL {
            in_depth = in_depth & splat(wide, 0.0).le(z_max);
        }
        let in_u = windows.u_min.le(splat(wide, group.u_max)) & splat(wide, group.u_min).le(windows.u_max);
        let in_v = windows.v_min.le(splat(wide, group.v_max)) & splat(wide, group.v_min).le(windows.v_max);
        TriangleWindows {
            windows,
            visible: in_depth & in_u & in_v,
        }
    }

    /// Returns the rays in the window around all visible triangles; `None` if they are more than `few`.
    #[inline(always)]
    fn few_rays(&self, wide: W, rays: &GroupRays, few: usize) -> Option<RayList> {
        // Bound the windows of all visible triangles
        let (infinity, minus_infinity) = (splat(wide, f32::INFINITY), splat(wide, f32::NEG_INFINITY));
        let DepthWindow {
            u_min,
            u_max,
            v_min,
            v_max,
            z_min,
        } = self.windows;
        let visible = self.visible;
        let all = DepthWindow {
            u_min: splat(wide, visible.select(u_min, infinity).min_lane()),
            u_max: splat(wide, visible.select(u_max, minus_infinity).max_lane()),
            v_min: splat(wide, visible.select(v_min, infinity).min_lane()),
            v_max: splat(wide, visible.select(v_max, minus_infinity).max_lane()),
            z_min: splat(wide, visible.select(z_min, infinity).min_lane()),
        };
        // List the rays inside until they are too many
        let mut list = RayList {
            rays: [0; FEW_RAYS],
            count: 0,
        };
        for tile in lanes(all.tiles(wide, rays)) {
            for slot in lanes(all.overlap(wide, &rays.subs, tile)) {
                let sub = (8 * tile + slot) % SUBS;
                let inside = all.rays(wide, rays, sub);
                if list.count + inside.count_ones() as usize > few {
                    return None;
                }
                for lane in lanes(inside) {
                    list.rays[list.count % FEW_RAYS] = (8 * sub + lane) as u16;
                    list.count += 1;
                }
            }
        }
        Some(list)
    }
}

/// Returns the windows of eight triangles in the plane z = 1, without limits if a vertex is not in front of the common
/// end. `z_min` are the least depths of their vertices.
#[inline(always)]
fn perspective_windows<W: WideLevel>(
    wide: W,
    corners: &BlockCorners<W>,
    group: &GroupWindow,
    z_min: Float8<W>,
) -> DepthWindow<W> {
    // Project the vertices
    let BlockCorners { x, y, z, .. } = corners;
    let one = splat(wide, 1.0);
    let (r0, r1, r2) = (one / z[0], one / z[1], one / z[2]);
    let (u0, u1, u2) = (x[0] * r0, x[1] * r1, x[2] * r2);
    let (v0, v1, v2) = (y[0] * r0, y[1] * r1, y[2] * r2);
    // Bound them
    let error_u = splat(wide, WINDOW_ERROR * group.u_min.abs().max(group.u_max.abs()));
    let error_v = splat(wide, WINDOW_ERROR * group.v_min.abs().max(group.v_max.abs()));
    let behind = z_min.le(splat(wide, MIN_DEPTH));
    let (infinity, minus_infinity) = (splat(wide, f32::INFINITY), splat(wide, f32::NEG_INFINITY));
    DepthWindow {
        u_min: behind.select(minus_infinity, u0.min(u1.min(u2)) - error_u),
        u_max: behind.select(infinity, u0.max(u1.max(u2)) + error_u),
        v_min: behind.select(minus_infinity, v0.min(v1.min(v2)) - error_v),
        v_max: behind.select(infinity, v0.max(v1.max(v2)) + error_v),
        z_min,
    }
}

/// Test of a block against the rays of a group.
struct BlockTest<'a, W: WideLevel> {
    wide: W,
    block: &'a LeafBlock,
    corners: &'a BlockCorners<W>,
    edges: &'a Edges<W>,
    packets: &'a [RayPacket],
}

/// Hits of the lanes of a test.
struct CandidateHits<W: WideLevel> {
    hits: Float8<W>,
    z: Float8<W>,
}

impl<W: WideLevel> BlockTest<'_, W> {
    /// Tests each triangle against the sub-packets that its window overlaps.
    #[inline(always)]
    fn each_triangle<P: GroupQuery>(
        &self,
        windows: &DepthWindow<W>,
        visible: u32,
        rays: &mut GroupRays,
        changed: &mut ChangedSubs,
    ) {
        let wide = self.wide;
        // Store edges and windows in memory, to broadcast those of one triangle at a time
        let rows = EdgeRows::new(self.edges);
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
                u_min: splat(wide, windows[0][triangle]),
                u_max: splat(wide, windows[1][triangle]),
                v_min: splat(wide, windows[2][triangle]),
                v_max: splat(wide, windows[3][triangle]),
                z_min: splat(wide, windows[4][triangle]),
            };
            let edges = rows.broadcast(wide, triangle);
            // Test the sub-packets of each tile that it overlaps
            for tile in lanes(target.tiles(wide, rays)) {
                for slot in lanes(target.overlap(wide, &rays.subs, tile)) {
                    let sub = (8 * tile + slot) % SUBS;
                    if self.triangle_and_sub::<P>(&edges, triangle, sub, rays) {
                        changed.add(sub);
                    }
                }
            }
        }
    }

    /// Tests a triangle against the rays of a sub-packet; returns whether there is a hit.
    #[inline(always)]
    fn triangle_and_sub<P: GroupQuery>(
        &self,
        edges: &Edges<W>,
        triangle: usize,
        sub: usize,
        rays: &mut GroupRays,
    ) -> bool {
        // Find the lanes that hit the triangle
        let wide = self.wide;
        let lane_rays = ProjectedRays {
            u: Float8::load(wide, &rays.u[sub]),
            v: Float8::load(wide, &rays.v[sub]),
            z_near: Float8::load(wide, &rays.z_near[sub]),
            z: Float8::load(wide, &rays.z[sub]),
        };
        let Some(candidates) = edges.candidates(wide, &lane_rays) else {
            return false;
        };
        let found = self.decided::<P::Projection>(&candidates, &lane_rays, LaneTriangles::One(triangle));
        let mut hits = found.hits;
        if P::IS_ANY {
            // Discard hits behind the starts
            let starts = near_start::<W, P::Projection>(wide, rays, edges, &candidates, lane_rays.z, found.z);
            let near = hits.bits() & starts;
            if near != 0 {
                let test = self.start_test(rays, LaneTriangles::One(triangle), LaneRays::Sub(sub));
                let behind = test.behind::<W, P::Projection>(wide, near);
                hits = Float8::mask_of(wide, hits.bits() & !behind);
            }
            // Turn off the rays that are blocked
            rays.z[sub] = hits.select(splat(wide, OFF), lane_rays.z).to_array();
            return hits.bits() != 0;
        }
        // Keep the hits that are nearer, or as near and of a lower number
        let number = splat(wide, f32::from_bits(self.block.numbers[triangle]));
        let numbers = Float8::load_u32(wide, &rays.numbers[sub]);
        let is_tie_won = found.z.eq(lane_rays.z) & number.lt_i32(numbers);
        hits = hits & (found.z.lt(lane_rays.z) | is_tie_won);
        if hits.bits() == 0 {
            return false;
        }
        // Store them
        rays.z[sub] = hits.select(found.z, lane_rays.z).to_array();
        rays.numbers[sub] = hits.select(number, numbers).to_u32s();
        true
    }

    /// Tests each listed ray against the visible triangles.
    #[inline(always)]
    fn each_ray<P: GroupQuery>(
        &self,
        list: &RayList,
        visible: u32,
        rays: &mut GroupRays,
        changed: &mut ChangedSubs,
    ) {
        let wide = self.wide;
        for &index in list.rays.iter().take(list.count) {
            // Find the triangles that the ray hits
            let index = usize::from(index);
            let (sub, lane) = (index / 8 % SUBS, index % 8);
            let lane_rays = ProjectedRays {
                u: splat(wide, rays.u[sub][lane]),
                v: splat(wide, rays.v[sub][lane]),
                z_near: splat(wide, rays.z_near[sub][lane]),
                z: splat(wide, rays.z[sub][lane]),
            };
            let Some(candidates) = self.edges.candidates(wide, &lane_rays) else {
                continue;
            };
            let found = self.decided::<P::Projection>(&candidates, &lane_rays, LaneTriangles::Each);
            let mut hits = found.hits.bits() & visible;
            // Discard hits behind its start
            if P::IS_ANY {
                let edges = self.edges;
                let starts =
                    near_start::<W, P::Projection>(wide, rays, edges, &candidates, lane_rays.z, found.z);
                let near = hits & starts;
                if near != 0 {
                    let test = self.start_test(rays, LaneTriangles::Each, LaneRays::One(index));
                    hits &= !test.behind::<W, P::Projection>(wide, near);
                }
            }
            if hits == 0 {
                continue;
            }
            // Turn off the ray if it is blocked
            if P::IS_ANY {
                rays.z[sub][lane] = OFF;
                changed.add(sub);
                continue;
            }
            // Keep the nearest, of equals that of the lowest number
            let z = found.z.to_array();
            for triangle in lanes(hits) {
                let triangle = triangle % 8;
                let number = self.block.numbers[triangle];
                let best = rays.z[sub][lane];
                if z[triangle] < best || (z[triangle] == best && number < rays.numbers[sub][lane]) {
                    rays.z[sub][lane] = z[triangle];
                    rays.numbers[sub][lane] = number;
                    changed.add(sub);
                }
            }
        }
    }

    /// Returns the comparison of hits with the starts of their rays.
    #[inline(always)]
    fn start_test<'t>(
        &'t self,
        rays: &'t GroupRays,
        triangles: LaneTriangles,
        lane_rays: LaneRays,
    ) -> StartTest<'t> {
        StartTest {
            frame: &rays.frame,
            block: self.block,
            triangles,
            packets: self.packets,
            rays: lane_rays,
        }
    }

    /// Returns the hits within the rays' depths, after lanes close to an edge have been decided in f64.
    #[inline(always)]
    fn decided<J: GroupProjection>(
        &self,
        candidates: &CandidateLanes<W>,
        lane_rays: &ProjectedRays<W>,
        triangles: LaneTriangles,
    ) -> CandidateHits<W> {
        let wide = self.wide;
        let mut found = CandidateHits {
            hits: candidates.inside,
            z: candidates.z,
        };
        let near_edge = candidates.near_edge.bits();
        if near_edge != 0 {
            // Copy the vertices here, so that on the common path they stay in registers
            let corners = CornerRows::new(self.corners);
            let (u, v) = (lane_rays.u.to_array(), lane_rays.v.to_array());
            let decided = decide::<J>(&corners, triangles, near_edge, [&u, &v]);
            // Replace the lanes that were decided
            let near_edge = candidates.near_edge;
            found.z = near_edge.select(Float8::load(wide, &decided.z), found.z);
            // Keep those within the ray's depths
            let within = lane_rays.z_near.le(found.z) & found.z.le(lane_rays.z);
            let hits = Float8::mask_of(wide, decided.hits) & within;
            found.hits = near_edge.select(hits, found.hits);
        }
        found
    }
}
