//! What was made of meshes of scenes before, for those that are built next.
//!
//! Meshes are known by the bits of their vertices and indices. What is kept is a function of these alone, so nobody can
//! tell from a picture that it was.

use std::collections::HashMap;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytemuck::Pod;

use crate::accel::MeshCounts;
use crate::mesh::{Buffer, Mesh};
use crate::parallel;

/// Positions that are looked at before all are.
const SAMPLES: usize = 16;
/// Bytes that a thread compares at a time.
const CHUNK: usize = 1 << 20;

/// What is kept of meshes, by their bits.
pub(in crate::accel) struct BuiltMeshes<T> {
    meshes: Mutex<Meshes<T>>,
}

struct Meshes<T> {
    by_label: HashMap<u64, Vec<Kept<T>>>,
    counts: MeshCounts,
}

/// What a mesh is known by; copies share it.
#[derive(Clone)]
struct Arrays {
    positions: Buffer<[f32; 3]>,
    triangles: Buffer<[u32; 3]>,
}

struct Kept<T> {
    arrays: Arrays,
    made: Arc<T>,
    /// How often it was told to forget since anybody asked for it.
    age: u32,
}

/// What is older than that is forgotten: two scenes may be set up at a time, each of which tells it once it has asked.
const MAX_AGE: u32 = 2;

impl<T> Default for BuiltMeshes<T> {
    fn default() -> BuiltMeshes<T> {
        BuiltMeshes {
            meshes: Mutex::new(Meshes {
                by_label: HashMap::new(),
                counts: MeshCounts::default(),
            }),
        }
    }
}

impl<T> BuiltMeshes<T> {
    /// What is kept of a mesh, or what `make` makes of it.
    pub(in crate::accel) fn of(&self, mesh: &Mesh, make: impl FnOnce() -> T) -> Arc<T> {
        let label = label(mesh);
        // Compared while nothing is locked: other threads are waited for, and this one may take up another mesh
        // meanwhile.
        let alike = self.all().alike(label);
        let arrays = Arrays::of(mesh);
        let found = alike.into_iter().find(|(kept, _)| kept.is_same(&arrays));
        if let Some((_, made)) = found {
            self.all().note(label, &made, arrays);
            return made;
        }
        let made = Arc::new(make());
        let kept = Kept {
            arrays,
            made: made.clone(),
            age: 0,
        };
        self.all().by_label.entry(label).or_default().push(kept);
        made
    }

    /// Forgets what nobody has asked for of late.
    pub(in crate::accel) fn evict_unused(&self) {
        let meshes = &mut self.all().by_label;
        for kept in meshes.values_mut() {
            kept.retain_mut(|kept| {
                kept.age += 1;
                kept.age <= MAX_AGE
            });
        }
        meshes.retain(|_, kept| !kept.is_empty());
    }

    /// How often meshes were asked for so far.
    pub(in crate::accel) fn counts(&self) -> MeshCounts {
        self.all().counts
    }

    /// The sum of what `bytes` tells of everything that is kept.
    pub(in crate::accel) fn byte_count(&self, bytes: impl Fn(&T) -> u64) -> u64 {
        let all = self.all();
        let kept = all.by_label.values().flatten();
        kept.map(|kept| bytes(&kept.made)).sum()
    }

    fn all(&self) -> MutexGuard<'_, Meshes<T>> {
        self.meshes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> Meshes<T> {
    /// What may be of a mesh of this label.
    fn alike(&mut self, label: u64) -> Vec<(Arrays, Arc<T>)> {
        self.counts.asked += 1;
        let kept = self.by_label.get(&label).into_iter().flatten();
        kept.map(|kept| (kept.arrays.clone(), kept.made.clone()))
            .collect()
    }

    /// That `made` was found for equal arrays.
    fn note(&mut self, label: u64, made: &Arc<T>, arrays: Arrays) {
        self.counts.found += 1;
        let mut kept = self.by_label.get_mut(&label).into_iter().flatten();
        if let Some(kept) = kept.find(|kept| Arc::ptr_eq(&kept.made, made)) {
            kept.age = 0;
            // So that those of the scene before can go.
            kept.arrays = arrays;
        }
    }
}

impl Arrays {
    fn of(mesh: &Mesh) -> Arrays {
        Arrays {
            positions: mesh.positions.clone(),
            triangles: mesh.triangles.clone(),
        }
    }

    fn is_same(&self, other: &Arrays) -> bool {
        is_same(&self.positions, &other.positions) && is_same(&self.triangles, &other.triangles)
    }
}

/// Equal meshes have equal ones.
fn label(mesh: &Mesh) -> u64 {
    let mut hasher = DefaultHasher::new();
    [mesh.positions.len(), mesh.triangles.len()].hash(&mut hasher);
    let step = mesh.positions.len().div_ceil(SAMPLES).max(1);
    for position in mesh.positions.iter().step_by(step) {
        position.map(f32::to_bits).hash(&mut hasher);
    }
    hasher.finish()
}

/// Whether two arrays have the same bits.
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
    fn meshes_of_the_same_bits_are_made_once() {
        let shelf = BuiltMeshes::default();
        let make = |x: f32, made: u32| *shelf.of(&mesh(x), || made);
        assert_eq!(make(0.0, 1), 1);
        assert_eq!(make(0.0, 2), 1);
        // An equal number of other bits.
        assert_eq!(make(-0.0, 3), 3);
        let mut turned = mesh(0.0);
        turned.triangles = Buffer::from(vec![[2, 0, 1]]);
        assert_eq!(*shelf.of(&turned, || 4), 4);
        assert_eq!(shelf.counts(), MeshCounts { asked: 4, found: 1 });
        assert_eq!(shelf.byte_count(|&made| u64::from(made)), 1 + 3 + 4);
    }

    #[test]
    fn what_the_last_scenes_did_not_have_is_forgotten() {
        let shelf = BuiltMeshes::default();
        let make = |x: f32, made: u32| *shelf.of(&mesh(x), || made);
        make(0.0, 1);
        make(5.0, 2);
        for _ in 0..=MAX_AGE {
            shelf.evict_unused();
            assert_eq!(make(0.0, 3), 1);
        }
        assert_eq!(make(5.0, 4), 4);
        assert_eq!(make(0.0, 5), 1);
    }

    #[test]
    fn large_arrays_that_differ_in_one_place_are_told_apart() {
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
