//! Top-down construction of the BSP: cells are split by axis-aligned planes until a leaf is cheaper.
//!
//! The result is abstract: cells with tight boxes, planes, and the indices of the primitives in each leaf. The layouts
//! for traversal are made from it.
//!
//! A primitive that a plane crosses goes to both sides, so a BSP of careless planes can grow without end. Three limits
//! hold on any input: [`MAX_DEPTH`], [`MAX_DUPLICATION`], and every split must leave both sides with fewer pieces. The
//! result does not depend on the number of threads: the allowance for duplicates is handed down the tree, in proportion
//! to the pieces, and never shared.

use std::sync::atomic::{AtomicU64, Ordering};

use super::heuristic::{SplitPlane, best_plane};
use super::piece::{CellBounds, PrimitivePiece};
use super::primitives::Primitives;
use crate::parallel;

/// Maximum number of splits from the root to any leaf. 2 million triangles need about 22.
pub(super) const MAX_DEPTH: usize = 56;
/// Maximum number of pieces in all leaves per primitive, averaged over the tree, which bounds the memory. Ordinary
/// meshes need about 2, long thin triangles in all directions would take 7 and more.
pub(super) const MAX_DUPLICATION: f64 = 4.0;
/// Number of pieces above which a cell is built by several threads.
const PARALLEL_COUNT: usize = 1 << 12;
/// Fraction of the whole work between progress reports.
const PROGRESS_STEP: f64 = 1.0 / 128.0;
/// Resolution in which work shares are added up as integers.
const SHARE_UNITS: f64 = (1u64 << 40) as f64;

/// A cell with its contents.
pub(super) struct Branch {
    /// Bounding box of everything in the cell.
    pub(super) cell: CellBounds,
    /// Contents of the cell.
    pub(super) content: CellContent,
}

/// Contents of a cell: a leaf or two halves.
pub(super) enum CellContent {
    /// Indices of all primitives with a part in the cell, in ascending order.
    Leaf(Box<[u32]>),
    /// Inner cell, split by a plane.
    Split {
        /// Axis that the plane is perpendicular to.
        axis: usize,
        /// Coordinate of the plane on that axis.
        position: f32,
        /// Halves below and above the plane; primitives within the plane are below.
        halves: Box<[Branch; 2]>,
    },
}

/// A tree together with the memory that building it took.
pub(super) struct Built {
    /// Root cell of the tree.
    pub(super) root: Branch,
    /// Peak bytes in use during the build.
    pub(super) peak_bytes: u64,
    /// Bytes in use by the finished cells.
    pub(super) branch_bytes: u64,
}

/// Builds the tree of `primitives`; `progress` receives the finished fraction.
pub(super) fn build(primitives: &Primitives, progress: &(dyn Fn(f64) + Sync)) -> Built {
    // Bound all primitives
    let pieces = primitives.pieces();
    let mut cell = CellBounds::EMPTY;
    for piece in &pieces {
        cell.include(piece);
    }
    let builder = Builder {
        primitives,
        progress,
        done: AtomicU64::new(0),
        bytes: Meter::default(),
    };
    builder.bytes.add(byte_count(&pieces));
    // Build recursively, with the allowance for duplicates
    let spare = (pieces.len() as f64 * (MAX_DUPLICATION - 1.0)) as usize;
    let task = BuildTask {
        pieces,
        cell,
        spare,
        depth: 0,
        share: 1.0,
        parent_share: 1.0,
    };
    let root = builder.build(task);
    Built {
        root,
        peak_bytes: builder.bytes.peak.into_inner(),
        branch_bytes: builder.bytes.current.into_inner(),
    }
}

/// A cell yet to be built.
struct BuildTask {
    pieces: Vec<PrimitivePiece>,
    cell: CellBounds,
    /// Number of pieces that splits may still add.
    spare: usize,
    depth: usize,
    /// Estimated fraction of the whole work.
    share: f64,
    parent_share: f64,
}

struct Builder<'a> {
    primitives: &'a Primitives<'a>,
    progress: &'a (dyn Fn(f64) + Sync),
    /// Sum of finished shares, in [`SHARE_UNITS`].
    done: AtomicU64,
    bytes: Meter,
}

impl Builder<'_> {
    fn build(&self, task: BuildTask) -> Branch {
        let (cell, share, whole) = (task.cell, task.share, task.parent_share);
        let plane = self.choose(&task);
        let is_leaf = plane.is_none();
        let content = match plane {
            None => CellContent::Leaf(self.leaf(task.pieces)),
            Some(plane) => {
                // Split the pieces and build both halves, in parallel if they are many
                let parallel = task.pieces.len() > PARALLEL_COUNT;
                let [left, right] = self.divide(task, plane);
                let halves = if parallel {
                    let (left, right) = parallel::join(|| self.build(left), || self.build(right));
                    [left, right]
                } else {
                    [self.build(left), self.build(right)]
                };
                CellContent::Split {
                    axis: plane.axis,
                    position: plane.position,
                    halves: Box::new(halves),
                }
            }
        };
        // Report progress once per subtree of about one step
        if share < PROGRESS_STEP && whole >= PROGRESS_STEP || share >= PROGRESS_STEP && is_leaf {
            self.report(share);
        }
        Branch { cell, content }
    }

    fn report(&self, share: f64) {
        let units = (share * SHARE_UNITS) as u64;
        let done = self.done.fetch_add(units, Ordering::Relaxed) + units;
        (self.progress)((done as f64 / SHARE_UNITS).min(1.0));
    }

    fn choose(&self, task: &BuildTask) -> Option<SplitPlane> {
        if task.depth >= MAX_DEPTH {
            return None;
        }
        let plane = best_plane(&task.pieces, &task.cell, task.spare)?;
        // Bins are counted by rounded borders: count again by the plane itself.
        let count = task.pieces.len();
        let [mut left, mut right] = [0, 0];
        for piece in &task.pieces {
            let (l, r) = piece.sides(plane.axis, plane.position);
            left += usize::from(l);
            right += usize::from(r);
        }
        (left < count && right < count && left + right <= count + task.spare).then_some(plane)
    }

    fn leaf(&self, pieces: Vec<PrimitivePiece>) -> Box<[u32]> {
        let mut numbers: Box<[u32]> = pieces.iter().map(|piece| piece.number).collect();
        numbers.sort_unstable();
        self.bytes
            .add(size_of_val(&*numbers) as u64 + size_of::<Branch>() as u64);
        self.bytes.remove(byte_count(&pieces));
        numbers
    }

    /// Moves the pieces to their sides, splitting those that the plane crosses. The left half reuses the buffer.
    fn divide(&self, task: BuildTask, plane: SplitPlane) -> [BuildTask; 2] {
        let SplitPlane { axis, position, .. } = plane;
        let mut pieces = task.pieces;
        let before = pieces.len();
        let mut rest = Vec::with_capacity(
            pieces
                .iter()
                .filter(|piece| piece.sides(axis, position).1)
                .count(),
        );
        // Assign each piece to its sides and bound both halves
        let mut cells = [CellBounds::EMPTY; 2];
        let mut kept = 0;
        for i in 0..before {
            let piece = pieces[i];
            let halves = match piece.sides(axis, position) {
                (true, true) => piece.split(self.primitives, axis, position),
                (true, false) => [Some(piece), None],
                (false, _) => [None, Some(piece)],
            };
            if let Some(left) = halves[0] {
                cells[0].include(&left);
                pieces[kept] = left;
                kept += 1;
            }
            if let Some(right) = halves[1] {
                cells[1].include(&right);
                rest.push(right);
            }
        }
        pieces.truncate(kept);
        self.bytes.add(byte_count(&rest));
        // Share the remaining allowance and the work in proportion to the pieces
        let total = (kept + rest.len()).max(1);
        let spare = task.spare - total.saturating_sub(before).min(task.spare);
        let left_spare = (spare as u128 * kept as u128 / total as u128) as usize;
        let left_share = task.share * kept as f64 / total as f64;
        let half = |pieces, cell, spare, share| BuildTask {
            pieces,
            cell,
            spare,
            depth: task.depth + 1,
            share,
            parent_share: task.share,
        };
        [
            half(pieces, cells[0], left_spare, left_share),
            half(rest, cells[1], spare - left_spare, task.share - left_share),
        ]
    }
}

/// Counter of the bytes in use and of their peak.
#[derive(Default)]
struct Meter {
    current: AtomicU64,
    peak: AtomicU64,
}

impl Meter {
    fn add(&self, bytes: u64) {
        let current = self.current.fetch_add(bytes, Ordering::Relaxed) + bytes;
        self.peak.fetch_max(current, Ordering::Relaxed);
    }

    fn remove(&self, bytes: u64) {
        self.current.fetch_sub(bytes, Ordering::Relaxed);
    }
}

fn byte_count(pieces: &Vec<PrimitivePiece>) -> u64 {
    (pieces.capacity() * size_of::<PrimitivePiece>()) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use glam::Vec3;

    fn mesh(triangles: impl IntoIterator<Item = [Vec3; 3]>) -> Mesh {
        let positions: Vec<[f32; 3]> = triangles.into_iter().flatten().map(|p| p.to_array()).collect();
        let count = positions.len() as u32 / 3;
        Mesh {
            positions: positions.into(),
            triangles: (0..count)
                .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
                .collect::<Vec<_>>()
                .into(),
            ..Mesh::default()
        }
    }

    /// Returns long thin triangles through the unit cube in all directions.
    fn soup(count: u32) -> Mesh {
        let at = |i: u32, k: u32| {
            let fraction = |x: f64| x.fract() as f32;
            let n = f64::from(i * 7 + k) + 1.0;
            Vec3::new(
                fraction(n * 0.754_877_67),
                fraction(n * 0.569_840_29),
                fraction(n * 0.438_579_02),
            )
        };
        mesh((0..count).map(|i| {
            let (a, b) = (at(i, 0), at(i, 3));
            [a, b, a.lerp(b, 0.5) + Vec3::splat(1e-3)]
        }))
    }

    fn built(mesh: &Mesh) -> Branch {
        build(&Primitives::of_mesh(mesh).unwrap(), &|_| ()).root
    }

    /// Returns the number of pieces in all leaves, the size of the longest leaf, and the depth.
    fn census(branch: &Branch) -> (usize, usize, usize) {
        match &branch.content {
            CellContent::Leaf(numbers) => (numbers.len(), numbers.len(), 0),
            CellContent::Split { halves, .. } => {
                let [l, r] = [&halves[0], &halves[1]].map(census);
                (l.0 + r.0, l.1.max(r.1), 1 + l.2.max(r.2))
            }
        }
    }

    fn same(a: &Branch, b: &Branch) -> bool {
        match (&a.content, &b.content) {
            (CellContent::Leaf(x), CellContent::Leaf(y)) => x == y && a.cell == b.cell,
            (
                CellContent::Split {
                    axis,
                    position,
                    halves,
                },
                CellContent::Split {
                    axis: axis_b,
                    position: position_b,
                    halves: halves_b,
                },
            ) => axis == axis_b && position == position_b && (0..2).all(|i| same(&halves[i], &halves_b[i])),
            _ => false,
        }
    }

    #[test]
    fn thin_triangle_soup_stays_within_tree_limits() {
        let count = 20_000;
        let (pieces, longest, depth) = census(&built(&soup(count)));
        assert!(
            pieces as f64 <= MAX_DUPLICATION * f64::from(count),
            "{pieces} pieces"
        );
        assert!(
            pieces > 2 * count as usize,
            "the soup is too tame: {pieces} pieces"
        );
        assert!(longest < count as usize / 2, "{longest}");
        assert!(depth <= MAX_DEPTH);
    }

    #[test]
    fn coincident_triangles_end_in_one_leaf() {
        let one = [Vec3::ZERO, Vec3::X, Vec3::new(0.2, 1.0, 0.7)];
        let (pieces, longest, _) = census(&built(&mesh(std::iter::repeat_n(one, 5000))));
        assert_eq!((pieces, longest), (5000, 5000));
    }

    #[test]
    fn empty_mesh_builds_an_empty_leaf() {
        assert_eq!(census(&built(&Mesh::default())), (0, 0, 0));
    }

    #[test]
    fn triangle_row_is_split_into_small_leaves_with_few_duplicates() {
        let row = mesh((0..1000).map(|i| {
            let p = Vec3::X * (2.0 * i as f32);
            [p, p + Vec3::X, p + Vec3::Y]
        }));
        let (pieces, longest, _) = census(&built(&row));
        // Only cells of more than 64 may be split through a triangle, at most one of the row each: 2^5 - 1 cells.
        assert!(pieces < 1000 + 31, "{pieces}");
        assert!(longest <= 32, "{longest}");
    }

    #[test]
    fn one_and_two_threads_build_the_same_tree() {
        let soup = soup(30_000);
        let by = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| built(&soup))
        };
        assert!(same(&by(1), &by(2)));
    }
}
