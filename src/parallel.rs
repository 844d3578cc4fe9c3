//! Parallel loops over the threads of the current rayon pool: for, map, try-map, chunks and join.
//!
//! Rayon's own iterators are compiled anew for every closure, some ten thousand lines of LLVM IR each. Every function
//! here takes its work as `&dyn Fn` and comes down to one loop, [`for_each`], which is compiled once; the functions
//! that are generic over types only allocate slots for results. A task should therefore take a microsecond or more;
//! shorter tasks are grouped into chunks, as [`generate`] does.
//!
//! Results are in the order of the tasks for any number of threads, so sums over them are deterministic too. Each task
//! may run on a different thread.

use std::cmp::Reverse;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use bytemuck::Zeroable;
use rayon::ThreadPool;
use rayon::prelude::*;

/// Number of elements that one task of [`generate`] computes: large enough to make the scheduling cost negligible.
const CHUNK: usize = 1 << 12;

/// Runs tasks `0..count` in parallel, in no particular order.
pub fn for_each(count: usize, work: &(dyn Fn(usize) + Sync)) {
    (0..count).into_par_iter().with_max_len(1).for_each(work);
}

/// Returns the results of tasks `0..count`, in their order.
pub fn map<T: Send>(count: usize, work: &(dyn Fn(usize) -> T + Sync)) -> Vec<T> {
    map_in_order(count, &|started| started, work)
}

/// Returns the results of one task per size, in the order of the sizes. The largest tasks are started first, so that no
/// thread is left with one at the end.
pub fn map_largest_first<T: Send>(sizes: &[usize], work: &(dyn Fn(usize) -> T + Sync)) -> Vec<T> {
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&task| Reverse(sizes[task]));
    // Rayon starts the second half of a range on another thread, so the tasks are counted as they start
    let started = AtomicUsize::new(0);
    let next = |_| order[started.fetch_add(1, Ordering::Relaxed)];
    map_in_order(sizes.len(), &next, work)
}

/// Returns the results of tasks `0..count`, in their order. `task_of` gives each of `0..count` a task of its own.
fn map_in_order<T: Send>(
    count: usize,
    task_of: &(dyn Fn(usize) -> usize + Sync),
    work: &(dyn Fn(usize) -> T + Sync),
) -> Vec<T> {
    let slots: Vec<Mutex<Option<T>>> = (0..count).map(|_| Mutex::new(None)).collect();
    for_each(count, &|index| {
        let task = task_of(index);
        let result = work(task);
        // Each slot belongs to one task, so the lock is never contended
        *locked(&slots[task]) = Some(result);
    });
    let results = slots
        .into_iter()
        .filter_map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner));
    let mut results: Vec<T> = results.collect();
    // Collecting in place reuses the allocation of the slots, whose elements are larger than the results.
    results.shrink_to_fit();
    results
}

/// Returns the results of `work` for each chunk of `chunk_len` items and its index, in order; the last chunk may be
/// shorter.
pub fn map_chunks<T: Sync, U: Send>(
    items: &[T],
    chunk_len: usize,
    work: &(dyn Fn(usize, &[T]) -> U + Sync),
) -> Vec<U> {
    let chunks: Vec<&[T]> = items.chunks(chunk_len).collect();
    map(chunks.len(), &|number| work(number, chunks[number]))
}

/// Returns the results of tasks `0..count` in their order, or the error of the first task that fails.
///
/// The error is that of the smallest failing index for any number of threads. Tasks with a larger index than a known
/// failure are not started.
pub fn try_map<T: Send, E: Send>(
    count: usize,
    work: &(dyn Fn(usize) -> Result<T, E> + Sync),
) -> Result<Vec<T>, E> {
    let first_failed = AtomicUsize::new(usize::MAX);
    let results = map(count, &|task| {
        // Skip tasks behind a known failure; smaller indices still run, as one of them may be the first to fail
        if task > first_failed.load(Ordering::Relaxed) {
            return None;
        }
        let result = work(task);
        if result.is_err() {
            first_failed.fetch_min(task, Ordering::Relaxed);
        }
        Some(result)
    });
    // Collect up to the first error in task order
    results.into_iter().flatten().collect()
}

/// Returns the results of `work`, which consumes each item and gets its index, or the first error, as [`try_map`] does.
pub fn try_map_owned<T: Send, U: Send, E: Send>(
    items: Vec<T>,
    work: &(dyn Fn(usize, T) -> Result<U, E> + Sync),
) -> Result<Vec<U>, E> {
    let slots: Vec<Mutex<Option<T>>> = items.into_iter().map(|item| Mutex::new(Some(item))).collect();
    let results = try_map(slots.len(), &|task| {
        let item = locked(&slots[task]).take();
        item.map(|item| work(task, item)).transpose()
    })?;
    Ok(results.into_iter().flatten().collect())
}

/// Returns whether `is_so` holds for all of `0..count`; most tasks after the first failure are skipped.
pub fn all(count: usize, is_so: &(dyn Fn(usize) -> bool + Sync)) -> bool {
    let holds = AtomicBool::new(true);
    for_each(count, &|task| {
        if holds.load(Ordering::Relaxed) && !is_so(task) {
            holds.store(false, Ordering::Relaxed);
        }
    });
    holds.into_inner()
}

/// Runs `work` on each chunk of `chunk_len` items and its index; the last chunk may be shorter.
pub fn for_each_chunk_mut<T: Send>(
    items: &mut [T],
    chunk_len: usize,
    work: &(dyn Fn(usize, &mut [T]) + Sync),
) {
    let chunks: Vec<Mutex<&mut [T]>> = items.chunks_mut(chunk_len).map(Mutex::new).collect();
    for_each(chunks.len(), &|number| {
        let chunk = std::mem::take(&mut *locked(&chunks[number]));
        work(number, chunk);
    });
}

/// Returns `element(0..count)` in order, for elements that are cheap: there is one dynamic call per chunk of many.
pub fn generate<T: Zeroable + Send>(count: usize, element: impl Fn(usize) -> T + Sync) -> Vec<T> {
    // The allocator returns zeroed pages, which are not written here; for alignments above 16 bytes it clears them itself.
    let mut elements: Vec<T> = bytemuck::zeroed_vec(count);
    for_each_chunk_mut(&mut elements, CHUNK, &|chunk, elements| {
        for (index, slot) in (chunk * CHUNK..).zip(elements) {
            *slot = element(index);
        }
    });
    elements
}

/// Returns the results of both closures, which may run in parallel.
pub fn join<A: Send, B: Send>(first: impl FnOnce() -> A + Send, second: impl FnOnce() -> B + Send) -> (A, B) {
    let (mut one, mut other) = (None, None);
    join_dyn(&mut once(first, &mut one), &mut once(second, &mut other));
    (one.expect("rayon runs both"), other.expect("rayon runs both"))
}

/// Returns the result of `work`, run on a thread of `pool`, which is the current pool meanwhile.
pub fn install<T: Send>(pool: &ThreadPool, work: impl FnOnce() -> T + Send) -> T {
    let mut result = None;
    install_dyn(pool, &mut once(work, &mut result));
    result.expect("rayon runs the closure")
}

fn join_dyn(first: &mut (dyn FnMut() + Send), second: &mut (dyn FnMut() + Send)) {
    rayon::join(first, second);
}

fn install_dyn(pool: &ThreadPool, work: &mut (dyn FnMut() + Send)) {
    pool.install(work);
}

/// Wraps `work` into a closure that stores its result in `result` at the first call and does nothing at later calls.
fn once<T>(work: impl FnOnce() -> T, result: &mut Option<T>) -> impl FnMut() {
    let mut work = Some(work);
    move || {
        if let Some(work) = work.take() {
            *result = Some(work());
        }
    }
}

/// Locks a result slot, ignoring poisoning: a panic in another task leaves no slot half written.
fn locked<T>(slot: &Mutex<T>) -> MutexGuard<'_, T> {
    slot.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn in_pools(check: impl Fn() + Sync + Send) {
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            install(&pool, &check);
        }
    }

    #[test]
    fn largest_tasks_start_first_and_results_keep_their_order() {
        let sizes = [3, 9, 1, 9, 5];
        in_pools(|| {
            let started = Mutex::new(Vec::new());
            let results = map_largest_first(&sizes, &|task| {
                locked(&started).push(task);
                10 * task
            });
            assert_eq!(results, [0, 10, 20, 30, 40]);
            let mut started = started.into_inner().unwrap();
            // One thread alone starts them in order, equal sizes by index.
            if rayon::current_num_threads() == 1 {
                assert_eq!(started, [1, 3, 4, 0, 2]);
            }
            started.sort_unstable();
            assert_eq!(started, [0, 1, 2, 3, 4]);
        });
    }

    #[test]
    fn results_are_in_task_order() {
        in_pools(|| {
            for count in [0, 1, 1000] {
                let squares: Vec<usize> = (0..count).map(|i| i * i).collect();
                assert_eq!(map(count, &|i| i * i), squares);
            }
            // Chunks of three: 0 + 1 + 2, 3 + 4 + 5, 6.
            let sums = map_chunks(&[0, 1, 2, 3, 4, 5, 6], 3, &|number, chunk| {
                (number, chunk.iter().sum::<i32>())
            });
            assert_eq!(sums, [(0, 3), (1, 12), (2, 6)]);
            assert!(map_chunks(&[0; 0], 3, &|number, _| number).is_empty());
        });
    }

    #[test]
    fn first_error_is_returned() {
        in_pools(|| {
            let fails_from = |first: usize| move |i: usize| if i < first { Ok(i) } else { Err(i) };
            assert_eq!(try_map(500, &fails_from(77)), Err(77));
            assert_eq!(try_map(500, &fails_from(0)), Err(0));
            assert_eq!(try_map(3, &fails_from(3)), Ok(vec![0, 1, 2]));
            let words = || vec!["a".to_string(), "b".to_string()];
            let numbered = |i: usize, word: String| Ok::<_, ()>(format!("{word}{i}"));
            assert_eq!(
                try_map_owned(words(), &numbered),
                Ok(vec!["a0".into(), "b1".into()])
            );
            let refused = |i: usize, _| if i == 0 { Ok(()) } else { Err(i) };
            assert_eq!(try_map_owned(words(), &refused), Err(1));
        });
    }

    #[test]
    fn all_is_true_unless_one_task_is_false() {
        in_pools(|| {
            assert!(all(0, &|_| false));
            assert!(all(100, &|i| i < 100));
            assert!(!all(100, &|i| i != 99));
        });
    }

    #[test]
    fn chunks_are_written_by_index() {
        in_pools(|| {
            let mut items = [0; 7];
            for_each_chunk_mut(&mut items, 3, &|number, chunk| chunk.fill(number));
            assert_eq!(items, [0, 0, 0, 1, 1, 1, 2]);
            let count = 2 * CHUNK + 1;
            assert!(generate(count, |i| i as u32).into_iter().eq(0..count as u32));
            assert!(generate(0, |i| i as u32).is_empty());
        });
    }

    #[test]
    fn join_returns_both_results() {
        in_pools(|| assert_eq!(join(|| 1, || "two".to_string()), (1, "two".to_string())));
    }
}
