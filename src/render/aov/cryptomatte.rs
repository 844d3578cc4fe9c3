//! Cryptomatte accumulation: the number of samples of a pixel that hit each object or material.
//!
//! Hits are appended to a list, which is compacted when it is full. Every count is therefore exact for any number of
//! objects in a pixel, and the list grows beyond its initial size only to less than three times the number of pairs
//! of pixel and object in the tile. Counts are integers and ties are ranked by id, so the result does not depend on
//! the order of samples.
//!
//! Source: J. Friedman and A. Jones, "Cryptomatte Specification", "Ranking Pixel Filter".

use std::cmp::Reverse;

use super::super::tile::{TILE, Tile};
use super::selection::{AovKind, AovSet, RANKS};
use crate::image::cryptomatte::id_of;
use crate::scene::Scene;

/// Initial capacity of a list: several entries per pixel of a tile.
const FIRST_ENTRIES: usize = 4 * (TILE * TILE) as usize;

impl AovKind {
    /// Returns the names whose hashes are the ids: for each instance of the scene, its name or that of its material;
    /// `None` if the group has no such ids.
    pub fn matte_names(self, scene: &Scene) -> Option<Vec<&str>> {
        let instances = scene.instances.iter();
        match self {
            AovKind::CryptoObject => Some(instances.map(|instance| &*instance.name).collect()),
            AovKind::CryptoMaterial => {
                let name = |material: u32| &*scene.materials[material as usize].name;
                Some(instances.map(|instance| name(instance.material)).collect())
            }
            _ => None,
        }
    }
}

/// Ids of the instances of a scene, for each requested matte in order.
pub(in crate::render) struct MatteIds(Vec<Vec<f32>>);

impl MatteIds {
    pub(in crate::render) fn of(scene: &Scene, wanted: AovSet) -> MatteIds {
        let ids = |kind: AovKind| Some(kind.matte_names(scene)?.into_iter().map(id_of).collect());
        MatteIds(wanted.kinds().filter_map(ids).collect())
    }

    pub(in crate::render) fn byte_count(&self) -> usize {
        self.0.iter().map(|ids| size_of_val(&ids[..])).sum()
    }

    /// Iterates over the mattes and returns the ids of the instances for each.
    pub(in crate::render) fn iter(&self) -> impl Iterator<Item = &[f32]> {
        self.0.iter().map(|ids| &ids[..])
    }
}

/// Hits of the samples of a tile so far, by name.
pub(in crate::render) struct Matte {
    hits: Vec<MatteHits>,
}

/// Number of samples of a pixel that hit one object; a pixel may have several entries for an object until the list is
/// compacted.
#[derive(Clone, Copy, Debug, PartialEq)]
struct MatteHits {
    /// Pixel within the tile, `TILE` pixels per row.
    pixel: u32,
    /// Bits of the f32 id of the object.
    id: u32,
    count: u32,
}

impl Matte {
    pub(in crate::render) fn new() -> Matte {
        Matte {
            hits: Vec::with_capacity(FIRST_ENTRIES),
        }
    }

    pub(in crate::render) fn clear(&mut self) {
        self.hits.clear();
    }

    /// Returns the bytes of the list.
    pub(in crate::render) fn byte_count(&self) -> usize {
        self.hits.capacity() * size_of::<MatteHits>()
    }

    /// Adds a sample of `pixel` that hit the object `id`.
    pub(in crate::render) fn add(&mut self, pixel: u32, id: f32) {
        let id = id.to_bits();
        // Successive samples often belong to one pixel and hit the same object.
        if let Some(last) = self
            .hits
            .last_mut()
            .filter(|hits| (hits.pixel, hits.id) == (pixel, id))
        {
            last.count += 1;
            return;
        }
        if self.hits.len() == self.hits.capacity() {
            self.count_up();
            // Ensure that at least a third of the list is free, so that it is rarely compacted.
            if self.hits.len() > self.hits.capacity() / 2 {
                self.hits.reserve_exact(self.hits.capacity());
            }
        }
        self.hits.push(MatteHits { pixel, id, count: 1 });
    }

    /// Merges all entries of the same pixel and object.
    fn count_up(&mut self) {
        self.hits.sort_unstable_by_key(|hits| (hits.pixel, hits.id));
        self.hits.dedup_by(|next, kept| {
            let is_same = (next.pixel, next.id) == (kept.pixel, kept.id);
            kept.count += if is_same { next.count } else { 0 };
            is_same
        });
    }

    /// Returns the layers of a tile whose pixels took `samples` each: alternately ids and coverages, the largest
    /// coverage first; 0 for unused ranks.
    pub(in crate::render) fn planes(&mut self, tile: Tile, samples: u32) -> Vec<Vec<f32>> {
        self.count_up();
        // Rank the objects of each pixel by their coverage
        let mut planes = vec![vec![0.0; (tile.width * tile.height) as usize]; 2 * RANKS];
        for hits in self.hits.chunk_by_mut(|a, b| a.pixel == b.pixel) {
            hits.sort_unstable_by_key(|hits| (Reverse(hits.count), hits.id));
            let [column, row] = [hits[0].pixel % TILE, hits[0].pixel / TILE];
            let pixel = (row * tile.width + column) as usize;
            for (hits, planes) in hits.iter().zip(planes.chunks_exact_mut(2)) {
                planes[0][pixel] = f32::from_bits(hits.id);
                planes[1][pixel] = (f64::from(hits.count) / f64::from(samples)) as f32;
            }
        }
        planes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TINY: Tile = Tile {
        x: 0,
        y: 0,
        width: 3,
        height: 2,
    };

    /// Returns the pairs of id and coverage of a pixel.
    fn ranks(planes: &[Vec<f32>], pixel: usize) -> Vec<(f32, f32)> {
        planes
            .chunks_exact(2)
            .map(|pair| (pair[0][pixel], pair[1][pixel]))
            .collect()
    }

    #[test]
    fn mattes_are_ranked_by_coverage_then_id() {
        let mut matte = Matte::new();
        let hits = [7.0, 5.0, 5.0, -1.0, 7.0, 2.0];
        hits.into_iter().for_each(|id| matte.add(TILE + 2, id));
        let planes = matte.planes(TINY, 8);
        // Two of eight samples missed; the sign is the highest bit of an id, so negative ids rank last.
        let expected = [
            (5.0, 0.25),
            (7.0, 0.25),
            (2.0, 0.125),
            (-1.0, 0.125),
            (0.0, 0.0),
            (0.0, 0.0),
        ];
        assert_eq!(ranks(&planes, 5), expected);
        assert!((0..5).all(|pixel| ranks(&planes, pixel) == [(0.0, 0.0); RANKS]));
        matte.clear();
        assert!(matte.planes(TINY, 8).iter().flatten().all(|&value| value == 0.0));
    }

    #[test]
    fn largest_mattes_are_kept_in_any_order() {
        let mut matte = Matte::new();
        // Object n is hit n times, of 1 + ... + 9 = 45 samples.
        for round in 1..10 {
            (round..10).for_each(|id| matte.add(0, id as f32));
        }
        let found = ranks(&matte.planes(TINY, 45), 0);
        let expected: Vec<(f32, f32)> = (4..10).rev().map(|n| (n as f32, n as f32 / 45.0)).collect();
        assert_eq!(found, expected);
    }

    #[test]
    fn full_matte_lists_keep_total_coverage() {
        let mut matte = Matte::new();
        // No two successive entries are equal, and there are more than the initial capacity.
        let (pixels, things, rounds) = (TILE * TILE, 7, 3);
        for _ in 0..rounds {
            for id in 1..=things {
                (0..pixels).for_each(|pixel| matte.add(pixel, id as f32));
            }
        }
        let pairs = (pixels * things) as usize;
        assert!(matte.byte_count() < 3 * pairs * size_of::<MatteHits>());
        let tile = Tile {
            x: 0,
            y: 0,
            width: TILE,
            height: TILE,
        };
        let planes = matte.planes(tile, rounds * things);
        for pixel in 0..pixels as usize {
            let expected: Vec<(f32, f32)> = (1..=6).map(|id| (id as f32, 1.0 / 7.0)).collect();
            assert_eq!(ranks(&planes, pixel), expected);
        }
    }
}
