//! Which objects and materials the samples of a pixel met first, and what part of it each covers: the mattes of Cryptomatte.
//!
//! Names are what counts: instances of one name are one object. Every sample is counted, so that coverage is exact however
//! many objects a pixel has; only the six that cover most of it get into its layers.

use super::film::Tile;
use super::first_hits::rows;
use super::layers::{LayerKind, LayerSet};
use crate::image::cryptomatte::id_of;
use crate::scene::Scene;

/// Ids that the layers have room for: three times two.
const RANKS: usize = 6;
/// The layers of those: an id and a coverage each.
const PLANES: usize = 2 * RANKS;

impl LayerKind {
    /// The names that its ids are hashes of, one an instance of the scene; `None` where its values are no such ids.
    pub fn matte_names(self, scene: &Scene) -> Option<Vec<&str>> {
        let instances = scene.instances.iter();
        match self {
            LayerKind::CryptoObject => Some(instances.map(|instance| &*instance.name).collect()),
            LayerKind::CryptoMaterial => {
                let name = |material: u32| &*scene.materials[material as usize].name;
                Some(instances.map(|instance| name(instance.material)).collect())
            }
            _ => None,
        }
    }
}

/// The ids of a scene's instances, of each kind of matte that is wanted.
pub(super) struct MatteIds(Vec<(LayerKind, Vec<f32>)>);

impl MatteIds {
    pub(super) fn of(scene: &Scene, wanted: LayerSet) -> MatteIds {
        let ids = |kind: LayerKind| {
            let names = kind.matte_names(scene)?;
            Some((kind, names.into_iter().map(id_of).collect()))
        };
        MatteIds(wanted.kinds().filter_map(ids).collect())
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn byte_count(&self) -> usize {
        self.0.iter().map(|(_, ids)| size_of_val(&ids[..])).sum()
    }

    fn of_kind(&self, kind: LayerKind) -> Option<&[f32]> {
        let mut all = self.0.iter();
        all.find(|(of, _)| *of == kind).map(|(_, ids)| &ids[..])
    }
}

/// How many samples of each pixel of a tile met which instances.
pub(super) struct Meetings {
    /// Of each pixel, the last of its entries.
    last: Vec<u32>,
    entries: Vec<Entry>,
}

/// An instance that samples of a pixel met.
struct Entry {
    instance: u32,
    count: u32,
    /// The entry of the same pixel before this.
    before: u32,
}

/// Where there is no entry.
const NONE: u32 = u32::MAX;

impl Meetings {
    pub(super) fn new(pixel_count: usize) -> Meetings {
        Meetings {
            last: vec![NONE; pixel_count],
            entries: Vec::new(),
        }
    }

    pub(super) fn clear(&mut self) {
        self.last.fill(NONE);
        self.entries.clear();
    }

    pub(super) fn byte_count(&self) -> usize {
        size_of_val(&self.last[..]) + self.entries.capacity() * size_of::<Entry>()
    }

    /// Counts one sample more of a pixel that met an instance.
    pub(super) fn add(&mut self, pixel: usize, instance: u32) {
        let mut place = self.last[pixel];
        while let Some(entry) = self.entries.get_mut(place as usize) {
            if entry.instance == instance {
                entry.count += 1;
                return;
            }
            place = entry.before;
        }
        let place = self.entries.len() as u32;
        self.entries.push(Entry {
            instance,
            count: 1,
            before: self.last[pixel],
        });
        self.last[pixel] = place;
    }

    /// The layers of a kind of matte, each row by row, where every pixel has so many samples.
    pub(super) fn planes(&self, tile: Tile, (kind, ids): (LayerKind, &MatteIds), spp: u32) -> Vec<Vec<f32>> {
        let mut planes = vec![Vec::with_capacity((tile.width * tile.height) as usize); PLANES];
        let ids = ids.of_kind(kind).unwrap_or_default();
        let mut ranked = Vec::new();
        for pixel in rows(tile).flatten() {
            self.rank(pixel, ids, &mut ranked);
            let mut all = ranked.iter();
            for rank in planes.chunks_mut(2) {
                let (id, coverage) = all.next().map_or((0.0, 0.0), |&(id, count)| {
                    (f32::from_bits(id), count as f32 / spp as f32)
                });
                rank[0].push(id);
                rank[1].push(coverage);
            }
        }
        planes
    }

    /// The bits of the ids that a pixel's samples met and how many met each, most first; of equally many in the order of
    /// the bits.
    fn rank(&self, pixel: usize, ids: &[f32], ranked: &mut Vec<(u32, u32)>) {
        ranked.clear();
        let mut place = self.last[pixel];
        while let Some(entry) = self.entries.get(place as usize) {
            let id = ids.get(entry.instance as usize).map_or(0, |id| id.to_bits());
            match ranked.iter_mut().find(|(known, _)| *known == id) {
                Some((_, count)) => *count += entry.count,
                None => ranked.push((id, entry.count)),
            }
            place = entry.before;
        }
        ranked.sort_unstable_by_key(|&(id, count)| (u32::MAX - count, id));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ids(ids: &[f32]) -> MatteIds {
        MatteIds(vec![(LayerKind::CryptoObject, ids.to_vec())])
    }

    const TILE: Tile = Tile {
        x: 0,
        y: 0,
        width: 2,
        height: 1,
    };

    #[test]
    fn the_largest_comes_first_and_equal_ones_in_the_order_of_their_ids() {
        let mut meetings = Meetings::new(2);
        for instance in [0, 1, 2, 1, 0, 3, 1] {
            meetings.add(1, instance);
        }
        let planes = meetings.planes(TILE, (LayerKind::CryptoObject, &ids(&[8.0, 2.0, 5.0, 4.0])), 8);
        let of_pixel = |pixel: usize| planes.iter().map(|plane| plane[pixel]).collect::<Vec<f32>>();
        assert_eq!(of_pixel(0), [0.0; 12]);
        let ranked = [2.0, 0.375, 8.0, 0.25, 4.0, 0.125, 5.0, 0.125, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(of_pixel(1), ranked);
    }

    #[test]
    fn instances_of_one_name_are_one_object_and_a_seventh_is_left_out() {
        let mut meetings = Meetings::new(2);
        for instance in 0..8 {
            (0..=instance).for_each(|_| meetings.add(0, instance));
        }
        let names = ids(&[1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        let planes = meetings.planes(TILE, (LayerKind::CryptoObject, &names), 36);
        let ranked: Vec<f32> = planes.iter().step_by(2).map(|plane| plane[0]).collect();
        // 8, 7, 6, 5, 4 samples; then the 3 of two instances, before the 3 of another.
        assert_eq!(ranked, [7.0, 6.0, 5.0, 4.0, 3.0, 1.0]);
        assert_eq!(planes[11][0], 3.0 / 36.0);
        meetings.clear();
        let planes = meetings.planes(TILE, (LayerKind::CryptoObject, &names), 36);
        assert!(planes.iter().flatten().all(|&value| value == 0.0));
    }
}
