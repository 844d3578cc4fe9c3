//! Camera rays by projection extents: the film in tiles, each with the list of the objects seen in it, front to back.
//!
//! A packet of camera rays is asked about the objects of its tiles whose boxes its place on the film meets; as soon as
//! all that is left lies deeper than what was hit, it is done. Packets in whose tiles too much is seen are left to a
//! tree, as are rays that are not the camera's.

use super::ExtentKind;
use super::list::{Count, ListAccel, Question, Search, Tally};
use super::projection::{FilmBox, ProjectionExtents};
use crate::accel::{Accel, AccelReport, RayOrder, RayPacket};
use crate::mesh::lanes::{Isa, Work, dispatch};
use crate::numeric::LANES;
use crate::scene::{CameraView, Scene};

/// Fewest tiles along a side.
const FEWEST_TILES: usize = 16;
/// Most tiles along a side: of 4 pixels each in a picture of 1024.
const MOST_TILES: usize = 256;
/// Most entries of all lists together, 64 MB.
const MOST_ENTRIES: usize = 1 << 24;
/// Packets whose rays are farther apart than this many tiles are not worth looking up.
const MOST_TILES_OF_PACKET: usize = 4;

/// A backend whose camera rays skip objects by projection extents.
pub struct ProjectedAccel<'a, 's> {
    /// Answers all that the lists do not.
    inner: &'a dyn Accel,
    list: ListAccel<'s>,
    projection: ProjectionExtents,
    tiles: Tiles,
    /// Longer lists are left to `inner`.
    longest_list: usize,
}

/// For each tile the objects seen in it.
struct Tiles {
    /// Tiles along a side.
    side: usize,
    /// Where the list of each tile starts, and where the last one ends.
    starts: Vec<u32>,
    /// Positions in the list of objects.
    entries: Vec<u32>,
    /// By position in the list of objects.
    boxes: Vec<FilmBox>,
}

impl<'a, 's> ProjectedAccel<'a, 's> {
    /// Lists for one view of a validated scene, with extents of that kind; `None` for cameras of extremely narrow angles.
    ///
    /// `inner` answers for packets in whose tile more than `longest_list` objects are seen, and for all other rays; it
    /// must give the bits of brute force.
    pub fn new(
        scene: &'s Scene,
        view: &CameraView,
        inner: &'a dyn Accel,
        kind: ExtentKind,
        longest_list: usize,
    ) -> Option<ProjectedAccel<'a, 's>> {
        let projection = ProjectionExtents::new(scene, view)?;
        let list = ListAccel::new(scene, kind);
        let boxes: Vec<FilmBox> = list
            .extents
            .objects()
            .iter()
            .map(|object| projection.boxes()[object.instance as usize])
            .collect();
        Some(ProjectedAccel {
            inner,
            tiles: Tiles::new(boxes),
            list,
            projection,
            longest_list,
        })
    }

    /// [`Accel::intersect`] of coherent rays with the work counted; what `inner` does is not.
    pub fn count_intersect(&self, packets: &mut [RayPacket]) -> Tally {
        let mut tally = Tally::default();
        self.trace(packets, &mut tally);
        tally
    }

    fn trace(&self, packets: &mut [RayPacket], count: &mut impl Count) {
        let mut rest = packets;
        while !rest.is_empty() {
            // A run of packets by lists, then a run by the other backend: batches are cheaper than packets.
            let by_list = dispatch(Batch {
                accel: self,
                packets: rest,
                count,
            });
            if !self.list.planes.is_empty() {
                self.list.planes.intersect(&mut rest[..by_list]);
            }
            rest = &mut rest[by_list..];
            let by_inner = rest
                .iter()
                .take_while(|packet| self.lists_of(packet).is_none())
                .count();
            if by_inner > 0 {
                self.inner.intersect(&mut rest[..by_inner], RayOrder::Coherent);
            }
            rest = &mut rest[by_inner..];
        }
    }

    /// The film of a packet, how parameters become depths, and its tiles' lists, if it is to be asked by them.
    #[inline(always)]
    fn lists_of(&self, packet: &RayPacket) -> Option<(FilmBox, [f32; 2], [[usize; 2]; 2])> {
        let (film, depths) = self.projection.film_of(packet)?;
        let range = self.tiles.range(&film);
        let [[x0, x1], [y0, y1]] = range;
        let fits = (x1 - x0 + 1) * (y1 - y0 + 1) <= MOST_TILES_OF_PACKET
            && self.tiles.longest(range) <= self.longest_list;
        fits.then_some((film, depths, range))
    }
}

impl Accel for ProjectedAccel<'_, '_> {
    fn intersect(&self, packets: &mut [RayPacket], order: RayOrder) {
        match order {
            RayOrder::Coherent => self.trace(packets, &mut ()),
            RayOrder::Incoherent => self.inner.intersect(packets, order),
        }
    }

    fn occluded(&self, packets: &mut [RayPacket], order: RayOrder) {
        self.inner.occluded(packets, order);
    }

    fn report(&self) -> AccelReport {
        let report = self.inner.report();
        let bytes = report.bytes + self.tiles.byte_count();
        AccelReport {
            bytes,
            peak_bytes: report.peak_bytes.max(bytes),
            ..report
        }
    }
}

/// The packets from the first on that are answered by lists; how many there are.
struct Batch<'b, 'a, 's, C> {
    accel: &'b ProjectedAccel<'a, 's>,
    packets: &'b mut [RayPacket],
    count: &'b mut C,
}

impl<C: Count> Work for Batch<'_, '_, '_, C> {
    type Output = usize;

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> usize {
        let accel = self.accel;
        let objects = accel.list.extents.objects();
        for (done, packet) in self.packets.iter_mut().enumerate() {
            packet.drop_untraceable();
            let Some((film, depths, range)) = accel.lists_of(packet) else {
                return done;
            };
            if accel.tiles.longest(range) == 0 {
                self.count.rays(active(packet), objects.len());
                continue;
            }
            let mut search = Search::new(isa, &accel.list, packet, Question::Nearest);
            self.count.rays(search.active, objects.len());
            let [[x0, x1], [y0, y1]] = range;
            for y in y0..=y1 {
                for x in x0..=x1 {
                    accel.search_tile(
                        isa,
                        accel.tiles.list(x, y),
                        (&film, depths),
                        &mut search,
                        self.count,
                    );
                }
            }
            search.write(packet);
        }
        self.packets.len()
    }
}

impl ProjectedAccel<'_, '_> {
    /// Asks about one list. An object of several tiles may be asked about again, to no effect.
    #[inline(always)]
    fn search_tile(
        &self,
        isa: impl Isa,
        entries: &[u32],
        (film, [scale, base]): (&FilmBox, [f32; 2]),
        search: &mut Search,
        count: &mut impl Count,
    ) {
        let mut deepest = f32::INFINITY;
        for &entry in entries {
            let on_film = &self.tiles.boxes[entry as usize];
            if on_film.depth > deepest {
                return;
            }
            count.film();
            if !on_film.overlaps(film) {
                continue;
            }
            search.ask(isa, &self.list.extents.objects()[entry as usize], u32::MAX, count);
            deepest = search.last() * scale + base;
            // Three roundings.
            deepest += deepest.abs() * 4.0 * f32::EPSILON;
        }
    }
}

fn active(packet: &RayPacket) -> u32 {
    (0..LANES).fold(0, |mask, l| mask | u32::from(packet.active[l] != 0) << l)
}

impl Tiles {
    fn new(boxes: Vec<FilmBox>) -> Tiles {
        let wish = (2.0 * (boxes.len() as f64).sqrt()) as usize;
        let mut side = wish.next_power_of_two().clamp(FEWEST_TILES, MOST_TILES);
        let count = |side: usize| -> usize {
            let of = |film: &FilmBox| {
                let [[x0, x1], [y0, y1]] = range(side, film);
                (x1 - x0 + 1) * (y1 - y0 + 1)
            };
            boxes.iter().filter(|film| !film.is_nowhere()).map(of).sum()
        };
        while side > 1 && count(side) > MOST_ENTRIES {
            side /= 2;
        }
        let mut front_to_back: Vec<u32> = (0..boxes.len() as u32)
            .filter(|&i| !boxes[i as usize].is_nowhere())
            .collect();
        front_to_back.sort_by(|&a, &b| boxes[a as usize].depth.total_cmp(&boxes[b as usize].depth));
        let mut lists: Vec<Vec<u32>> = vec![Vec::new(); side * side];
        for i in front_to_back {
            let [[x0, x1], [y0, y1]] = range(side, &boxes[i as usize]);
            for y in y0..=y1 {
                for x in x0..=x1 {
                    lists[y * side + x].push(i);
                }
            }
        }
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
            entries: lists.concat(),
            boxes,
        }
    }

    /// The tiles that a box on the film touches, by axis.
    #[inline(always)]
    fn range(&self, film: &FilmBox) -> [[usize; 2]; 2] {
        range(self.side, film)
    }

    #[inline(always)]
    fn list(&self, x: usize, y: usize) -> &[u32] {
        let tile = y * self.side + x;
        &self.entries[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }

    /// The length of the longest list in a range of tiles.
    #[inline(always)]
    fn longest(&self, [[x0, x1], [y0, y1]]: [[usize; 2]; 2]) -> usize {
        let mut longest = 0;
        for y in y0..=y1 {
            for x in x0..=x1 {
                longest = longest.max(self.list(x, y).len());
            }
        }
        longest
    }

    fn byte_count(&self) -> u64 {
        (size_of_val(&*self.starts) + size_of_val(&*self.entries) + size_of_val(&*self.boxes)) as u64
    }
}

/// The tiles that a box touches; what is beyond the film belongs to the tiles at its edge. Rounding is monotonic, so
/// boxes that overlap have a tile in common.
#[inline(always)]
fn range(side: usize, film: &FilmBox) -> [[usize; 2]; 2] {
    let tile = |x: f32| ((x * side as f32) as usize).min(side - 1);
    [
        [tile(film.low[0]), tile(film.high[0])],
        [tile(film.low[1]), tile(film.high[1])],
    ]
}
