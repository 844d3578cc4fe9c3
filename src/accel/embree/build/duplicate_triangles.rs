//! Detection of triangles that coincide with an earlier triangle.
//!
//! Ties go to the lowest instance, then the lowest primitive, so of triangles with the same three vertices only the
//! first can be the nearest hit. Embree has no such rule, and a filter function cannot add it: it is called only for
//! the triangle that Embree has picked from a block. So the later triangles are not passed to Embree. They are found at
//! a few per cent of the cost of Embree's build:
//!
//! 1. The bits of the three vertices of each triangle are hashed to a key that does not depend on their order. The
//!    upper bits of the key choose a bin, and the lower half is stored in it.
//! 2. A bin fits a processor's own cache. Its keys pass a Bloom filter (Bloom, Space/time trade-offs in hash coding
//!    with allowable errors, 1970) whose bits for one key lie in one word (Putze, Sanders, Singler, Cache-, hash- and
//!    space-efficient Bloom filters, 2007). The keys that seem to repeat are few, and sorting finds those that do.
//! 3. Runs of meshes with a repeated key are scanned again; their triangles with such a key are sorted by their
//!    vertices: exact, and with the same complexity if all triangles are equal.

use rayon::prelude::*;

use crate::mesh::Mesh;
use crate::parallel;

/// Returns for each mesh, in rising order, its triangles with the same vertices as an earlier triangle: of an earlier
/// mesh, or of the same mesh with a lower index.
///
/// Vertices are compared as numbers, with -0 equal to 0, in any order. Runs on the current thread pool; the result does
/// not depend on the number of threads.
pub(super) fn later_duplicates(meshes: &[&Mesh]) -> Vec<Vec<u32>> {
    let mut duplicates = vec![Vec::new(); meshes.len()];
    let runs = runs_of(meshes);
    let suspects = suspects(&runs);
    if suspects.is_empty() {
        return duplicates;
    }
    let mut candidates = candidates(&runs, &suspects);
    candidates.par_sort_unstable();
    for pair in candidates.windows(2) {
        if pair[0].corners == pair[1].corners {
            duplicates[pair[1].mesh as usize].push(pair[1].triangle);
        }
    }
    duplicates
        .iter_mut()
        .for_each(|of_mesh| of_mesh.par_sort_unstable());
    duplicates
}

/// Triangles per run, the unit of parallel work: few enough that their keys stay in a processor's own cache while they
/// are binned.
const RUN: usize = 1 << 15;

/// Approximate number of keys per bin: few enough that the filter stays in the first-level cache.
const KEYS_PER_BIN: usize = 1 << 13;

/// Bits of the filter for each key: about one in 2000 of the unique keys is suspect.
const BITS_PER_KEY: usize = 32;

/// A range of consecutive triangles of one mesh.
struct DuplicateRun<'s> {
    mesh: u32,
    positions: &'s [[f32; 3]],
    first: u32,
    triangles: &'s [[u32; 3]],
}

/// A triangle that may have a duplicate, ordered by its vertices first, then by the order in which ties are broken.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
struct ClusterCandidate {
    corners: [[u32; 3]; 3],
    mesh: u32,
    triangle: u32,
}

fn runs_of<'s>(meshes: &[&'s Mesh]) -> Vec<DuplicateRun<'s>> {
    let runs = (0u32..).zip(meshes).flat_map(|(index, mesh)| {
        let positions = &mesh.positions[..];
        let pieces = (0u32..).step_by(RUN).zip(mesh.triangles.chunks(RUN));
        pieces.map(move |(first, triangles)| DuplicateRun {
            mesh: index,
            positions,
            first,
            triangles,
        })
    });
    runs.collect()
}

/// A key that occurs more than once in its bin, and a run that contains it.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Suspect {
    key: u32,
    run: u32,
}

/// Returns the keys of all coincident triangles, and possibly a few others, with each run that contains one.
fn suspects(runs: &[DuplicateRun]) -> Vec<Suspect> {
    let triangle_count: usize = runs.iter().map(|run| run.triangles.len()).sum();
    let bin_bits = (triangle_count / KEYS_PER_BIN).max(1).ilog2();
    let binned = parallel::map(runs.len(), &|run| BinnedKeys::new(&runs[run], bin_bits));
    parallel::map(1 << bin_bits, &|bin| suspects_of_bin(&binned, bin)).concat()
}

/// Lower halves of the keys of one run, grouped by bin.
struct BinnedKeys {
    keys: Vec<u32>,
    /// Start offset of each bin, followed by the end.
    begins: Vec<u32>,
}

impl BinnedKeys {
    /// Groups the keys by their upper `bin_bits` bits with a counting sort.
    fn new(run: &DuplicateRun, bin_bits: u32) -> BinnedKeys {
        // Shift in two steps, because `bin_bits` may be 0 and a shift by 64 overflows.
        let bin = |key: u64| (key >> 1 >> (u64::BITS - 1 - bin_bits)) as usize;
        let mut all = Vec::with_capacity(run.triangles.len());
        // Count the keys of each bin
        let mut begins = vec![0u32; (1 << bin_bits) + 1];
        for triangle in run.triangles {
            let key = run.key(triangle);
            begins[bin(key) + 1] += 1;
            all.push(key);
        }
        // Turn counts into start offsets by a prefix sum
        for i in 1..begins.len() {
            begins[i] += begins[i - 1];
        }
        // Scatter the keys into their bins
        let mut keys = vec![0; all.len()];
        let mut next = begins.clone();
        for key in all {
            let place = &mut next[bin(key)];
            keys[*place as usize] = key as u32;
            *place += 1;
        }
        BinnedKeys { keys, begins }
    }

    fn bin(&self, bin: usize) -> &[u32] {
        &self.keys[self.begins[bin] as usize..self.begins[bin + 1] as usize]
    }
}

/// Returns the keys that occur more than once in a bin.
fn suspects_of_bin(binned: &[BinnedKeys], bin: usize) -> Vec<Suspect> {
    let key_count: usize = binned.iter().map(|of_run| of_run.bin(bin).len()).sum();
    // Insert all keys into a Bloom filter and note those that seem to repeat
    let mut seen = KeySet::new((key_count * BITS_PER_KEY).div_ceil(u64::BITS as usize));
    let mut again = Vec::new();
    for of_run in binned {
        for &key in of_run.bin(bin) {
            if !seen.insert(key) {
                again.push(key);
            }
        }
    }
    if again.is_empty() {
        return Vec::new();
    }
    // Collect all occurrences of these keys, with a second filter over them alone
    let again = KeySet::of(again.iter().copied(), again.len());
    let mut suspects = Vec::new();
    for (run, of_run) in (0u32..).zip(binned) {
        for &key in of_run.bin(bin) {
            if again.contains(key) {
                suspects.push(Suspect { key, run });
            }
        }
    }
    // Sort to drop the false positives of the filters
    suspects.sort_unstable();
    let groups = suspects.chunk_by(|a, b| a.key == b.key);
    let repeated = groups.filter(|group| group.len() > 1).flatten();
    repeated
        .map(|&Suspect { key, run }| Suspect { key, run })
        .collect()
}

/// Returns all triangles with a suspect key, and a few others.
fn candidates(runs: &[DuplicateRun], suspects: &[Suspect]) -> Vec<ClusterCandidate> {
    let keys = KeySet::of(suspects.iter().map(|suspect| suspect.key), suspects.len());
    let mut is_suspect = vec![false; runs.len()];
    suspects
        .iter()
        .for_each(|suspect| is_suspect[suspect.run as usize] = true);
    let in_run = |index: usize| -> Vec<ClusterCandidate> {
        let run = &runs[index];
        if !is_suspect[index] {
            return Vec::new();
        }
        let numbered = (run.first..).zip(run.triangles);
        let found = numbered.filter(|(_, triangle)| keys.contains(run.key(triangle) as u32));
        let candidates = found.map(|(number, triangle)| ClusterCandidate {
            corners: run.sorted_corners(triangle),
            mesh: run.mesh,
            triangle: number,
        });
        candidates.collect()
    };
    parallel::map(runs.len(), &in_run).concat()
}

impl DuplicateRun<'_> {
    /// Returns a hash of a triangle's vertices that does not depend on their order.
    #[inline(always)]
    fn key(&self, triangle: &[u32; 3]) -> u64 {
        let [a, b, c] = *triangle;
        self.hash(a).wrapping_add(self.hash(b)).wrapping_add(self.hash(c))
    }

    #[inline(always)]
    fn hash(&self, vertex: u32) -> u64 {
        hash(bits_of(self.positions[vertex as usize]))
    }

    fn sorted_corners(&self, triangle: &[u32; 3]) -> [[u32; 3]; 3] {
        let mut corners = triangle.map(|v| bits_of(self.positions[v as usize]));
        corners.sort_unstable();
        corners
    }
}

/// Returns the bits of a position; equal numbers have equal bits.
#[inline(always)]
fn bits_of([x, y, z]: [f32; 3]) -> [u32; 3] {
    // Adding +0 turns -0 into 0 and changes nothing else.
    [(x + 0.0).to_bits(), (y + 0.0).to_bits(), (z + 0.0).to_bits()]
}

/// Odd words of evenly mixed bits: the fractions of the golden ratio and of the square root of 2.
const SALTS: [u64; 2] = [0x9e37_79b9_7f4a_7c15, 0x6a09_e667_f3bc_c909];

/// Mixes a position by one 128-bit product, folded to 64 bits (Wang Yi, wyhash, 2019). Sums of hashes are as good as
/// random.
#[inline(always)]
fn hash([x, y, z]: [u32; 3]) -> u64 {
    let xy = u64::from(x) | u64::from(y) << 32;
    let product = u128::from(xy ^ SALTS[0]) * u128::from(u64::from(z) ^ SALTS[1]);
    (product >> 64) as u64 ^ product as u64
}

/// A Bloom filter: contains every inserted key, and reports a few others as present.
struct KeySet {
    words: Vec<u64>,
}

impl KeySet {
    fn new(word_count: usize) -> KeySet {
        KeySet {
            words: vec![0; word_count],
        }
    }

    fn of(keys: impl Iterator<Item = u32>, word_count: usize) -> KeySet {
        let mut set = KeySet::new(word_count);
        keys.for_each(|key| {
            set.insert(key);
        });
        set
    }

    /// Inserts a key; returns false if the key was, or seemed to be, present before.
    #[inline(always)]
    fn insert(&mut self, key: u32) -> bool {
        let (word, bits) = self.place(key);
        let before = self.words[word];
        self.words[word] = before | bits;
        before & bits != bits
    }

    #[inline(always)]
    fn contains(&self, key: u32) -> bool {
        let (word, bits) = self.place(key);
        self.words[word] & bits == bits
    }

    /// Returns the word index, from the upper half of a product, and four bits in the word, from the lower half.
    #[inline(always)]
    fn place(&self, key: u32) -> (usize, u64) {
        let mixed = u64::from(key).wrapping_mul(SALTS[0]);
        let word = ((mixed >> 32) * self.words.len() as u64) >> 32;
        let bit = |n: u32| 1u64 << (mixed >> (8 + 6 * n) & 63);
        (word as usize, bit(0) | bit(1) | bit(2) | bit(3))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::buffer::Buffer;

    fn mesh(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Mesh {
        Mesh {
            positions: Buffer::from(positions),
            triangles: Buffer::from(triangles),
            ..Mesh::default()
        }
    }

    /// Returns a strip of `n` triangles with separate vertices each; no two coincide.
    fn strip(n: u32) -> Mesh {
        let corner = |i: u32| [i as f32, (i % 2) as f32, (i / 7) as f32];
        let positions = (0..n).flat_map(|i| [corner(i), corner(i + 1), corner(i + 2)]);
        mesh(
            positions.collect(),
            (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        )
    }

    /// Finds duplicates by comparing each triangle with each earlier one.
    fn reference(meshes: &[&Mesh]) -> Vec<Vec<u32>> {
        let same = |a: [[f32; 3]; 3], b: [[f32; 3]; 3]| {
            let orders = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
            orders.iter().any(|order| order.map(|i| a[i]) == b)
        };
        let mut earlier = Vec::new();
        let mut duplicates = vec![Vec::new(); meshes.len()];
        for (of_mesh, mesh) in duplicates.iter_mut().zip(meshes) {
            for number in 0..mesh.triangles.len() as u32 {
                let corners = mesh.corners(number).map(|p| p.to_array());
                if earlier.iter().any(|&other| same(other, corners)) {
                    of_mesh.push(number);
                }
                earlier.push(corners);
            }
        }
        duplicates
    }

    fn in_pool_of<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(work)
    }

    #[test]
    fn duplicates_are_found_in_any_order_winding_and_zero_sign() {
        let corners = vec![
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [0.0, 1.0, 1.0],
            [-0.0, -0.0, 1.0],
        ];
        let first = mesh(corners.clone(), vec![[0, 1, 2], [1, 2, 0]]);
        let second = mesh(
            corners,
            vec![[2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2], [3, 1, 2]],
        );
        assert_eq!(
            later_duplicates(&[&first, &second]),
            [vec![1], vec![0, 1, 2, 3, 4]]
        );
    }

    #[test]
    fn triangles_with_two_shared_corners_are_not_duplicates() {
        // The second differs in one vertex by one unit in the last place, the third uses a vertex twice.
        let next = 1f32.next_up();
        let corners = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, next, 0.0]];
        let alike = mesh(corners, vec![[0, 1, 2], [0, 1, 3], [0, 1, 1]]);
        assert_eq!(later_duplicates(&[&alike]), [Vec::<u32>::new()]);
    }

    #[test]
    fn duplicates_equal_pairwise_comparison_for_any_thread_count() {
        // Marsaglia's xorshift; five values per coordinate, so that duplicates are common.
        let mut state = 0x1234_5678_9abc_def1u64;
        let mut random = |n: u64| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state % n
        };
        let mut random_mesh = |n: usize| {
            let value = |i: u64| [-1.0, -0.0, 0.0, 1.0, 2.5][i as usize];
            let positions: Vec<[f32; 3]> = (0..24).map(|_| [(); 3].map(|()| value(random(5)))).collect();
            let triangles: Vec<[u32; 3]> = (0..n).map(|_| [(); 3].map(|()| random(24) as u32)).collect();
            mesh(positions, triangles)
        };
        let meshes = [random_mesh(700), random_mesh(0), random_mesh(900)];
        let meshes: Vec<&Mesh> = meshes.iter().collect();
        let expected = reference(&meshes);
        assert!(expected[0].len() > 10 && expected[2].len() > 100);
        for threads in 1..=4 {
            assert_eq!(
                in_pool_of(threads, || later_duplicates(&meshes)),
                expected,
                "{threads} threads"
            );
        }
    }

    #[test]
    fn duplicate_in_another_work_item_is_found() {
        let n = 3 * RUN as u32 + 5;
        let long = strip(n);
        let mut triangles = long.triangles.to_vec();
        triangles.push([1, 0, 2]);
        triangles.insert(RUN - 1, [5, 4, 3]);
        let doubled = mesh(long.positions.to_vec(), triangles);
        assert_eq!(later_duplicates(&[&doubled]), [vec![RUN as u32 - 1, n + 1]]);
        assert_eq!(
            later_duplicates(&[&long, &long]),
            [vec![], (0..n).collect::<Vec<_>>()]
        );
    }

    #[test]
    fn few_unique_triangles_are_duplicate_candidates() {
        let long = strip(1 << 17);
        // Of 2^17 keys of 36 bits, 2^34 / 2 / 2^36 = 1/8 pairs are equal by chance.
        let count = suspects(&runs_of(&[&long])).len();
        assert!(count <= 2, "{count}");
    }

    #[test]
    fn all_equal_triangles_but_the_first_are_duplicates() {
        let equal = mesh(
            vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            vec![[0, 1, 2]; 100_000],
        );
        assert_eq!(later_duplicates(&[&equal]), [(1..100_000).collect::<Vec<_>>()]);
    }
}
