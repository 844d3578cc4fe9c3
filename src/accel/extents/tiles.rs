//! Per-tile object lists for camera rays: the film in tiles, each with the objects seen in it, front to back.
//!
//! A packet of camera rays is tested against the objects of its tiles whose screen-space boxes overlap its own; it is
//! finished as soon as everything left lies deeper than its hits. Packets in tiles with too many objects are traced by
//! another backend, as are rays that are not the camera's.

use super::hull::HullPoints;
use super::kind::BoundingVolumeKind;
use super::list::{Count, ListAccel, PrimitiveSearch, Tally};
use super::projection::{ScreenBounds, ScreenBox};
use super::volumes::BoundingVolumes;

use crate::accel::{Accel, AccelPart, AccelReport, Coherence, Query, RayEnd, RayPacket};
use crate::mesh::simd::{SimdKernel, SimdLevel, dispatch};
use crate::numeric::LANES;
use crate::parallel;
use crate::scene::{CameraView, Geometry, Scene};

/// Least number of tiles along a side.
const FEWEST_TILES: usize = 16;
/// Maximum number of tiles along a side: of 8 pixels each in an image of 1024.
const MAX_TILES: usize = 128;
/// Maximum number of entries of all lists together, 64 MB.
const MAX_ENTRIES: usize = 1 << 24;
/// Maximum number of tiles that a packet may touch for a lookup to pay: blocks of 4 pixels in an image of 256 touch 3
/// by 3.
const MAX_TILES_OF_PACKET: usize = 9;

/// A backend whose camera rays skip objects by screen-space bounding boxes.
pub struct TileCulledAccel<'a, 's> {
    /// Backend for all rays that the lists do not serve.
    inner: &'a dyn Accel,
    list: ListAccel<'s>,
    projection: ScreenBounds,
    tiles: Tiles,
}

/// Limits up to which objects are tested one by one, instead of by the other backend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ListLimits {
    /// Maximum number of objects in a tile.
    pub objects: usize,
    /// Maximum number of primitives of each object.
    pub primitives: usize,
}

impl ListLimits {
    /// No limits, for a backend that tests all objects anyway.
    pub const NONE: ListLimits = ListLimits {
        objects: usize::MAX,
        primitives: usize::MAX,
    };

    /// Limits within which testing a list was measured to be faster than a tree.
    pub const BESIDE_A_TREE: ListLimits = ListLimits {
        objects: 16,
        primitives: 4,
    };
}

/// Screen-space data of an object.
struct TileObject {
    film: ScreenBox,
    /// Flag for objects that may be tested one by one.
    is_listed: bool,
}

/// For each tile the list of objects seen in it.
struct Tiles {
    /// Number of tiles along a side.
    side: usize,
    /// Start of the list of each tile, followed by the end of the last one.
    starts: Vec<u32>,
    /// Flags of the tiles that are left to the other backend.
    uses_inner: Vec<bool>,
    /// Object positions of all lists, tile by tile.
    entries: Vec<u32>,
    /// Screen-space data by position in the list of objects.
    objects_seen: Vec<TileObject>,
}

impl<'a, 's> TileCulledAccel<'a, 's> {
    /// Builds the lists for one view of a validated scene, with bounding volumes of that kind; `None` for cameras of
    /// extremely narrow angles.
    ///
    /// `inner` traces the packets in whose tile the limits are exceeded, and all other rays; it must return the bits of
    /// brute force.
    pub fn new(
        scene: &'s Scene,
        view: &CameraView,
        inner: &'a dyn Accel,
        kind: BoundingVolumeKind,
        limits: ListLimits,
    ) -> Option<TileCulledAccel<'a, 's>> {
        // Bound large meshes by their boxes only
        let is_listed = |geometry: &Geometry| geometry.primitive_count() <= limits.primitives;
        let hull = |geometry: &Geometry| {
            if is_listed(geometry) {
                HullPoints::of(geometry)
            } else {
                HullPoints::from_bounds(geometry)
            }
        };
        let hulls = parallel::map(scene.geometries.len(), &|index| hull(&scene.geometries[index]));
        let projection = ScreenBounds::of_hulls(scene, &hulls, view)?;
        let list = ListAccel::of_extents(scene, BoundingVolumes::of_hulls(scene, &hulls, kind));
        // Project the objects and sort them into tiles
        let objects = list.extents.objects().iter().map(|object| TileObject {
            film: projection.boxes()[object.instance as usize],
            is_listed: is_listed(scene.geometry_of(object.instance)),
        });
        let tiles = Tiles::new(objects.collect(), limits.objects);
        Some(TileCulledAccel {
            inner,
            tiles,
            list,
            projection,
        })
    }

    /// Runs [`Accel::intersect`] for coherent rays and returns the number of tests; those of `inner` are not counted.
    pub fn count_intersect(&self, packets: &mut [RayPacket]) -> Tally {
        let mut tally = Tally::default();
        self.trace(packets, &mut tally);
        tally
    }

    fn trace(&self, packets: &mut [RayPacket], count: &mut impl Count) {
        let mut rest = packets;
        while !rest.is_empty() {
            // Trace a run of packets by lists, then a run by the other backend: batches are cheaper than single packets
            let by_list = dispatch(TileBatch {
                accel: self,
                packets: rest,
                count,
            });
            self.list.planes.trace(&mut rest[..by_list], Query::Nearest);
            rest = &mut rest[by_list..];
            let uses_inner = |packet: &&RayPacket| self.lists_of(packet).is_none();
            let by_inner = rest.iter().take_while(uses_inner).count();
            if by_inner > 0 {
                self.inner.intersect(&mut rest[..by_inner], Coherence::Coherent);
            }
            rest = &mut rest[by_inner..];
        }
    }

    /// Returns the film box of a packet, the scale and base from parameters to depths, and its range of tiles, if lists
    /// serve it.
    #[inline(always)]
    fn lists_of(&self, packet: &RayPacket) -> Option<(ScreenBox, [f32; 2], [[usize; 2]; 2])> {
        let (film, depths) = self.projection.screen_box_of(packet)?;
        let range = self.tiles.range(&film);
        let [[x0, x1], [y0, y1]] = range;
        let fits = (x1 - x0 + 1) * (y1 - y0 + 1) <= MAX_TILES_OF_PACKET && !self.tiles.any_uses_inner(range);
        fits.then_some((film, depths, range))
    }
}

impl Accel for TileCulledAccel<'_, '_> {
    fn intersect(&self, packets: &mut [RayPacket], order: Coherence) {
        match order {
            Coherence::Coherent => self.trace(packets, &mut ()),
            Coherence::Incoherent => self.inner.intersect(packets, order),
        }
    }

    fn occluded(&self, packets: &mut [RayPacket], order: Coherence) {
        self.inner.occluded(packets, order);
    }

    fn occluded_towards(&self, packets: &mut [RayPacket], end: RayEnd) {
        self.inner.occluded_towards(packets, end);
    }

    fn gains_from_ends(&self) -> bool {
        self.inner.gains_from_ends()
    }

    fn batch(&self) -> usize {
        self.inner.batch()
    }

    fn report(&self) -> AccelReport {
        let mut report = self.inner.report();
        let bytes = report.bytes + self.tiles.byte_count();
        report.parts.push(AccelPart {
            holder: "extents",
            what: "lists of tiles",
            bytes: self.tiles.byte_count(),
        });
        AccelReport {
            bytes,
            peak_bytes: report.peak_bytes.max(bytes),
            ..report
        }
    }
}

/// SIMD kernel for the leading packets that lists serve; returns their number.
struct TileBatch<'b, 'a, 's, C> {
    accel: &'b TileCulledAccel<'a, 's>,
    packets: &'b mut [RayPacket],
    count: &'b mut C,
}

impl<C: Count> SimdKernel for TileBatch<'_, '_, '_, C> {
    type Output = usize;

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) -> usize {
        let accel = self.accel;
        let objects = accel.list.extents.objects();
        for (done, packet) in self.packets.iter_mut().enumerate() {
            packet.drop_untraceable();
            let Some((film, depths, range)) = accel.lists_of(packet) else {
                return done;
            };
            if accel.tiles.are_empty(range) {
                self.count.rays(active(packet), objects.len());
                continue;
            }
            let mut search = PrimitiveSearch::new(isa, &accel.list, packet, Query::Nearest);
            self.count.rays(search.active, objects.len());
            for tile in tiles_of(accel.tiles.side, range) {
                let entries = accel.tiles.list(tile);
                accel.search_tile(isa, entries, (&film, depths), &mut search, self.count);
            }
            search.write(packet);
        }
        self.packets.len()
    }
}

impl TileCulledAccel<'_, '_> {
    /// Tests the objects of one list. An object of several tiles may be tested again, without effect.
    #[inline(always)]
    fn search_tile(
        &self,
        isa: impl SimdLevel,
        entries: &[u32],
        (film, [scale, base]): (&ScreenBox, [f32; 2]),
        search: &mut PrimitiveSearch,
        count: &mut impl Count,
    ) {
        // Visit the objects front to back until all are behind the farthest hit
        let mut deepest = f32::INFINITY;
        for &entry in entries {
            let on_film = &self.tiles.objects_seen[entry as usize].film;
            if on_film.depth > deepest {
                return;
            }
            count.film();
            if !on_film.overlaps(film) {
                continue;
            }
            search.test_object(isa, &self.list.extents.objects()[entry as usize], u32::MAX, count);
            deepest = search.last() * scale + base;
            // The factor covers three roundings.
            deepest += deepest.abs() * 4.0 * f32::EPSILON;
        }
    }
}

fn active(packet: &RayPacket) -> u32 {
    (0..LANES).fold(0, |mask, l| mask | u32::from(packet.active[l] != 0) << l)
}

impl Tiles {
    fn new(objects_seen: Vec<TileObject>, max_objects: usize) -> Tiles {
        // Sort the visible objects front to back
        let side = side_for(&objects_seen);
        let mut front_to_back: Vec<u32> = (0..objects_seen.len() as u32)
            .filter(|&i| !objects_seen[i as usize].film.is_nowhere())
            .collect();
        let depth = |i: &u32| objects_seen[*i as usize].film.depth;
        front_to_back.sort_by(|a, b| depth(a).total_cmp(&depth(b)));
        // Enter each object into the tiles that it touches, unless a limit is exceeded
        let mut lists: Vec<Vec<u32>> = vec![Vec::new(); side * side];
        let mut uses_inner = vec![false; side * side];
        for i in front_to_back {
            let TileObject { film, is_listed } = &objects_seen[i as usize];
            for tile in tiles_of(side, range(side, film)) {
                uses_inner[tile] |= !is_listed || lists[tile].len() >= max_objects;
                if uses_inner[tile] {
                    lists[tile] = Vec::new();
                } else {
                    lists[tile].push(i);
                }
            }
        }
        // Concatenate the lists
        let mut starts = Vec::with_capacity(lists.len() + 1);
        let mut end = 0;
        starts.push(0);
        for list in &lists {
            end += list.len() as u32;
            starts.push(end);
        }
        Tiles {
            side,
            starts,
            uses_inner,
            entries: lists.concat(),
            objects_seen,
        }
    }

    /// Returns the tiles that a screen-space box touches, by axis.
    #[inline(always)]
    fn range(&self, film: &ScreenBox) -> [[usize; 2]; 2] {
        range(self.side, film)
    }

    #[inline(always)]
    fn list(&self, tile: usize) -> &[u32] {
        &self.entries[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }

    /// Returns whether any tile of a range is left to the other backend.
    #[inline(always)]
    fn any_uses_inner(&self, range: [[usize; 2]; 2]) -> bool {
        tiles_of(self.side, range).any(|tile| self.uses_inner[tile])
    }

    /// Returns whether all lists in a range of tiles are empty.
    #[inline(always)]
    fn are_empty(&self, range: [[usize; 2]; 2]) -> bool {
        tiles_of(self.side, range).all(|tile| self.starts[tile] == self.starts[tile + 1])
    }

    fn byte_count(&self) -> u64 {
        (size_of_val(&*self.starts) + size_of_val(&*self.entries) + size_of_val(&*self.objects_seen)) as u64
    }
}

/// Chooses the number of tiles along a side so that few objects share a tile, within the limit on entries.
fn side_for(objects_seen: &[TileObject]) -> usize {
    let wanted_side = (2.0 * (objects_seen.len() as f64).sqrt()) as usize;
    let mut side = wanted_side.next_power_of_two().clamp(FEWEST_TILES, MAX_TILES);
    let entries = |side: usize| -> usize {
        let of = |objects_seen: &TileObject| {
            let [[x0, x1], [y0, y1]] = range(side, &objects_seen.film);
            (x1 - x0 + 1) * (y1 - y0 + 1)
        };
        objects_seen
            .iter()
            .filter(|objects_seen| !objects_seen.film.is_nowhere())
            .map(of)
            .sum()
    };
    // Halve the resolution until the lists fit into memory
    while side > 1 && entries(side) > MAX_ENTRIES {
        side /= 2;
    }
    side
}

/// Returns the indices of the tiles in a range.
#[inline(always)]
fn tiles_of(side: usize, [[x0, x1], [y0, y1]]: [[usize; 2]; 2]) -> impl Iterator<Item = usize> {
    (y0..=y1).flat_map(move |y| (x0..=x1).map(move |x| y * side + x))
}

/// Returns the tiles that a box touches; the tiles at the edge include everything beyond the film. Rounding is
/// monotonic, so boxes that overlap have a tile in common.
#[inline(always)]
fn range(side: usize, film: &ScreenBox) -> [[usize; 2]; 2] {
    let tile = |x: f32| ((x * side as f32) as usize).min(side - 1);
    [
        [tile(film.low[0]), tile(film.high[0])],
        [tile(film.low[1]), tile(film.high[1])],
    ]
}
