//! Cache of per-mesh build results of earlier scenes, keyed by mesh content.
//!
//! Meshes are identified by the bits of their vertices and indices. An entry is a function of these alone, so the cache
//! never changes an image.

use std::collections::HashMap;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytemuck::Pod;

use crate::accel::MeshCounts;
use crate::buffer::Buffer;
use crate::mesh::Mesh;
use crate::parallel;

/// Number of vertex positions that are hashed; all arrays are compared only if the hashes agree.
const SAMPLES: usize = 16;
/// Number of bytes that a thread compares at a time.
const CHUNK: usize = 1 << 20;

/// Content-keyed cache of the build results of meshes.
pub(in crate::accel) struct BuiltMeshes<T> {
    meshes: Mutex<Meshes<T>>,
}

struct Meshes<T> {
    by_hash: HashMap<u64, Vec<Entry<T>>>,
    counts: MeshCounts,
}

/// Arrays that identify a mesh; copies share the memory.
#[derive(Clone)]
struct MeshArrays {
    positions: Buffer<[f32; 3]>,
    triangles: Buffer<[u32; 3]>,
}

struct Entry<T> {
    arrays: MeshArrays,
    result: Arc<T>,
    /// Number of evictions since the last lookup.
    age: u32,
}

/// Largest age that is not evicted: two scenes may be in preparation at a time, each of which evicts once after its
/// lookups.
const MAX_AGE: u32 = 2;

impl<T> Default for BuiltMeshes<T> {
    fn default() -> BuiltMeshes<T> {
        BuiltMeshes {
            meshes: Mutex::new(Meshes {
                by_hash: HashMap::new(),
                counts: MeshCounts::default(),
            }),
        }
    }
}

impl<T> BuiltMeshes<T> {
    /// Returns the cached result of a mesh, or that of `make`, which is then stored.
    pub(in crate::accel) fn of(&self, mesh: &Mesh, make: impl FnOnce() -> T) -> Arc<T> {
        // Look up candidates by hash
        let content_hash = content_hash(mesh);
        // Compare while nothing is locked: the comparison waits for other threads, and this thread may start on another
        // mesh meanwhile.
        let candidates = self.all().candidates(content_hash);
        let arrays = MeshArrays::of(mesh);
        let found = candidates.into_iter().find(|(kept, _)| kept.is_same(&arrays));
        if let Some((_, result)) = found {
            self.all().mark_used(content_hash, &result, arrays);
            return result;
        }
        // Build without the lock and insert
        let result = Arc::new(make());
        let kept = Entry {
            arrays,
            result: result.clone(),
            age: 0,
        };
        self.all().by_hash.entry(content_hash).or_default().push(kept);
        result
    }

    /// Evicts the entries that recent scenes have not looked up.
    pub(in crate::accel) fn evict_unused(&self) {
        let meshes = &mut self.all().by_hash;
        for kept in meshes.values_mut() {
            kept.retain_mut(|kept| {
                // An entry becomes young again when it is found
                kept.age += 1;
                kept.age <= MAX_AGE
            });
        }
        meshes.retain(|_, kept| !kept.is_empty());
    }

    /// Returns the numbers of lookups and hits so far.
    pub(in crate::accel) fn counts(&self) -> MeshCounts {
        self.all().counts
    }

    /// Returns the sum of `bytes` over all entries.
    pub(in crate::accel) fn byte_count(&self, bytes: impl Fn(&T) -> u64) -> u64 {
        let all = self.all();
        let kept = all.by_hash.values().flatten();
        kept.map(|kept| bytes(&kept.result)).sum()
    }

    fn all(&self) -> MutexGuard<'_, Meshes<T>> {
        self.meshes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> Meshes<T> {
    /// Returns the entries with this hash and counts a lookup.
    fn candidates(&mut self, content_hash: u64) -> Vec<(MeshArrays, Arc<T>)> {
        self.counts.requested += 1;
        let kept = self.by_hash.get(&content_hash).into_iter().flatten();
        kept.map(|kept| (kept.arrays.clone(), kept.result.clone()))
            .collect()
    }

    /// Records a cache hit: the entry of `result` becomes recent.
    fn mark_used(&mut self, content_hash: u64, result: &Arc<T>, arrays: MeshArrays) {
        self.counts.found += 1;
        let mut kept = self.by_hash.get_mut(&content_hash).into_iter().flatten();
        if let Some(kept) = kept.find(|kept| Arc::ptr_eq(&kept.result, result)) {
            kept.age = 0;
            // Keep the new arrays, so that those of the previous scene can be freed.
            kept.arrays = arrays;
        }
    }
}

impl MeshArrays {
    fn of(mesh: &Mesh) -> MeshArrays {
        MeshArrays {
            positions: mesh.positions.clone(),
            triangles: mesh.triangles.clone(),
        }
    }

    fn is_same(&self, other: &MeshArrays) -> bool {
        is_same(&self.positions, &other.positions) && is_same(&self.triangles, &other.triangles)
    }
}

/// Returns a hash of a mesh: its counts and a sample of its positions. Equal meshes have equal hashes.
fn content_hash(mesh: &Mesh) -> u64 {
    let mut hasher = DefaultHasher::new();
    [mesh.positions.len(), mesh.triangles.len()].hash(&mut hasher);
    let step = mesh.positions.len().div_ceil(SAMPLES).max(1);
    for position in mesh.positions.iter().step_by(step) {
        position.map(f32::to_bits).hash(&mut hasher);
    }
    hasher.finish()
}

/// Returns whether two arrays have the same bits.
fn is_same<T: Pod + Sync>(one: &Buffer<T>, other: &Buffer<T>) -> bool {
    let [one, other] = [one, other].map(|rows| bytemuck::cast_slice::<T, u8>(rows));
    if one.len() != other.len() || one.as_ptr() == other.as_ptr() {
        return one.len() == other.len();
    }
    let chunks: Vec<_> = one.chunks(CHUNK).zip(other.chunks(CHUNK)).collect();
    parallel::all(chunks.len(), &|i| chunks[i].0 == chunks[i].1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh(x: f32) -> Mesh {
        Mesh {
            positions: Buffer::from(vec![[x, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
            triangles: Buffer::from(vec![[0, 1, 2]]),
            ..Mesh::default()
        }
    }

    #[test]
    fn meshes_of_equal_bits_are_built_once() {
        let cache = BuiltMeshes::default();
        let make = |x: f32, result: u32| *cache.of(&mesh(x), || result);
        assert_eq!(make(0.0, 1), 1);
        assert_eq!(make(0.0, 2), 1);
        // An equal number with different bits is another mesh.
        assert_eq!(make(-0.0, 3), 3);
        let mut turned = mesh(0.0);
        turned.triangles = Buffer::from(vec![[2, 0, 1]]);
        assert_eq!(*cache.of(&turned, || 4), 4);
        assert_eq!(
            cache.counts(),
            MeshCounts {
                requested: 4,
                found: 1
            }
        );
        assert_eq!(cache.byte_count(|&result| u64::from(result)), 1 + 3 + 4);
    }

    #[test]
    fn meshes_unused_by_recent_scenes_are_evicted() {
        let cache = BuiltMeshes::default();
        let make = |x: f32, result: u32| *cache.of(&mesh(x), || result);
        make(0.0, 1);
        make(5.0, 2);
        for _ in 0..=MAX_AGE {
            cache.evict_unused();
            assert_eq!(make(0.0, 3), 1);
        }
        assert_eq!(make(5.0, 4), 4);
        assert_eq!(make(0.0, 5), 1);
    }

    #[test]
    fn large_arrays_that_differ_in_one_element_are_distinguished() {
        let rows = |odd: usize| -> Buffer<[f32; 3]> {
            Buffer::from(
                (0..3 * CHUNK)
                    .map(|i| [f32::from(u8::from(i == odd)); 3])
                    .collect::<Vec<_>>(),
            )
        };
        let one = rows(2 * CHUNK + 7);
        assert!(is_same(&one, &rows(2 * CHUNK + 7)) && is_same(&one, &one.clone()));
        assert!(!is_same(&one, &rows(2 * CHUNK + 8)));
        assert!(!is_same(&one, &Buffer::from(one[1..].to_vec())));
    }
}
