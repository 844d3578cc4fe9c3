//! Memory use of a render by holder: every byte is attributed to one effect, account or structure.
//!
//! Sizes are actual ones: capacities of queues and arrays, mesh data, decoded images and data derived from them. The
//! memory of all threads together is recorded after each tile, because their queues grow on demand and never shrink;
//! all other sizes follow from the image and the scene. With the ledger off, nothing is recorded.

use std::sync::{Mutex, PoisonError};

/// Entry of the memory statistics.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct MemoryEntry {
    /// Holder: the name of an effect or of an account; `geometry`, `instances`, `triangles`, `user-geometry`, `tree`
    /// or `extents` for data that serves to find hits; `unused` for data of the scene that no active effect reads.
    pub holder: &'static str,
    /// Description of the data.
    pub what: &'static str,
    /// Size in bytes, at its peak.
    pub bytes: u64,
}

/// Memory statistics of a render; empty with the ledger off.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Memory {
    holdings: Vec<MemoryEntry>,
    pub(in crate::render) at_once: u64,
}

impl Memory {
    /// Returns all entries, none of which is empty.
    pub fn holdings(&self) -> &[MemoryEntry] {
        &self.holdings
    }

    /// Returns the bytes that are attributed to `holder`.
    pub fn of(&self, holder: &str) -> u64 {
        let held = self.holdings.iter().filter(|holding| holding.holder == holder);
        held.map(|holding| holding.bytes).sum()
    }

    /// Returns the largest number of bytes in use at the same time: thread memory is freed before the image is
    /// assembled.
    pub fn at_once(&self) -> u64 {
        self.at_once
    }

    /// Returns the sum of all entries, each at its own peak.
    pub fn total(&self) -> u64 {
        self.holdings.iter().map(|holding| holding.bytes).sum()
    }

    /// Adds `bytes` to an entry, which is created if necessary.
    pub(in crate::render) fn add(&mut self, holder: &'static str, what: &'static str, bytes: usize) {
        if bytes == 0 {
            return;
        }
        let bytes = bytes as u64;
        let known = self.holdings.iter_mut();
        match known
            .into_iter()
            .find(|holding| holding.holder == holder && holding.what == what)
        {
            Some(holding) => holding.bytes += bytes,
            None => self.holdings.push(MemoryEntry { holder, what, bytes }),
        }
    }

    fn add_all(&mut self, other: &Memory) {
        for holding in &other.holdings {
            self.add(holding.holder, holding.what, holding.bytes as usize);
        }
    }

    fn remove_all(&mut self, other: &Memory) {
        for gone in &other.holdings {
            let is_it =
                |holding: &&mut MemoryEntry| (holding.holder, holding.what) == (gone.holder, gone.what);
            if let Some(holding) = self.holdings.iter_mut().find(is_it) {
                holding.bytes -= gone.bytes;
            }
        }
    }
}

/// Memory of all threads of a render together.
#[derive(Debug, Default)]
pub(in crate::render) struct ThreadMemory(Mutex<PeakMemory>);

#[derive(Debug, Default)]
struct PeakMemory {
    now: Memory,
    /// Memory of the threads when it was largest.
    peak: Memory,
    /// Bytes of the pixels of finished tiles.
    finished: u64,
    /// Largest sum of thread memory and finished tiles.
    max_bytes: u64,
    /// Largest number of bytes of a round of adaptive sampling.
    max_round_bytes: u64,
}

impl ThreadMemory {
    /// Records that the memory of a thread changed from `before` to `after`.
    fn change(&self, before: &Memory, after: &Memory) {
        let mut watched = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        watched.now.remove_all(before);
        watched.now.add_all(after);
        watched.max_bytes = watched.max_bytes.max(watched.now.total() + watched.finished);
        // Keep a copy of the entries at the peak
        if watched.now.total() > watched.peak.total() {
            watched.peak = watched.now.clone();
        }
    }

    /// Records the bytes of a finished tile.
    fn finish(&self, bytes: usize) {
        let mut watched = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        watched.finished += bytes as u64;
        watched.max_bytes = watched.max_bytes.max(watched.now.total() + watched.finished);
    }

    /// Records the bytes of a round of adaptive sampling: estimates of the image and results of its visits.
    pub(in crate::render) fn note_round(&self, bytes: usize) {
        let mut watched = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        watched.max_round_bytes = watched.max_round_bytes.max(bytes as u64);
    }

    pub(in crate::render) fn max_round_bytes(&self) -> u64 {
        let watched = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        watched.max_round_bytes
    }

    /// Returns the memory of the threads when it was largest, and the largest sum of thread memory and finished
    /// tiles.
    pub(in crate::render) fn peak(&self) -> (Memory, u64) {
        let watched = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        (watched.peak.clone(), watched.max_bytes)
    }
}

/// Memory of one thread, as recorded last.
pub(in crate::render) struct ThreadFootprint<'f> {
    together: &'f ThreadMemory,
    noted: Memory,
}

impl<'f> ThreadFootprint<'f> {
    pub(in crate::render) fn new(together: &'f ThreadMemory) -> ThreadFootprint<'f> {
        ThreadFootprint {
            together,
            noted: Memory::default(),
        }
    }

    /// Records the current memory of the thread, and the bytes of output finished since the last call.
    pub(in crate::render) fn note(&mut self, memory: Memory, finished: usize) {
        if memory != self.noted {
            self.together.change(&self.noted, &memory);
            self.noted = memory;
        }
        self.together.finish(finished);
    }
}

impl Drop for ThreadFootprint<'_> {
    fn drop(&mut self) {
        self.together.change(&self.noted, &Memory::default());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(parts: &[(&'static str, &'static str, usize)]) -> Memory {
        let mut memory = Memory::default();
        for &(holder, what, bytes) in parts {
            memory.add(holder, what, bytes);
        }
        memory
    }

    #[test]
    fn peak_of_summed_thread_memory_is_recorded() {
        let together = ThreadMemory::default();
        let mut first = ThreadFootprint::new(&together);
        first.note(of(&[("film", "sums", 10), ("camera", "rays", 5)]), 3);
        let mut second = ThreadFootprint::new(&together);
        second.note(of(&[("film", "sums", 10), ("shadow", "rays", 1)]), 0);
        second.note(of(&[("film", "sums", 10), ("shadow", "rays", 7)]), 0);
        drop(first);
        second.note(of(&[("film", "sums", 10), ("shadow", "rays", 9)]), 0);
        drop(second);
        let (peak, max_bytes) = together.peak();
        // 15 of the first thread and 17 of the second, before the first one ends; plus 3 of the finished tile.
        assert_eq!(max_bytes, 35);
        assert_eq!((peak.total(), peak.of("film"), peak.of("shadow")), (32, 20, 7));
        assert_eq!(together.0.lock().unwrap().now.total(), 0);
    }

    #[test]
    fn equal_holdings_are_merged_and_empty_ones_omitted() {
        let memory = of(&[
            ("film", "sums", 1),
            ("film", "sums", 2),
            ("film", "means", 4),
            ("other", "", 0),
        ]);
        assert_eq!(
            (memory.holdings().len(), memory.of("film"), memory.total()),
            (2, 7, 7)
        );
    }
}
