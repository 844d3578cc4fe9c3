//! Arrays of plain values: [`Buffer`] is read-only and owned or a window into the bytes of a file, so that large meshes
//! are not copied out of it; [`BufferMut`] is filled and then frozen.
//!
//! Large arrays are anonymous memory maps in huge pages, where the system grants them: the first write to each page of
//! 4 KiB costs about as long as filling it. Virtual machines that give free memory back to their host are an exception: there
//! the host clears huge pages again, and trees of 10 million triangles take twice as long to build.

use std::marker::PhantomData;
use std::ops::{Deref, DerefMut, Range};
use std::sync::Arc;
#[cfg(target_os = "linux")]
use std::sync::OnceLock;

use bytemuck::Pod;
use memmap2::MmapMut;

/// Read-only array of plain values; clones share it.
#[derive(Clone, Debug)]
pub struct Buffer<T: Pod>(Storage<T>);

#[derive(Clone, Debug)]
enum Storage<T> {
    Owned(Arc<Vec<T>>),
    /// Window into memory that other arrays share, such as the bytes of a file.
    Mapped {
        map: Arc<MmapMut>,
        bytes: Range<usize>,
    },
    /// Memory without a file, from a [`BufferMut`].
    Anonymous(Arc<MmapMut>),
}

/// Page size in bytes: the bytes between a map's end and the end of its page can be read and are zero.
const PAGE: usize = 4096;
/// Size in bytes of a huge page of x86-64 and most others.
const HUGE_PAGE: usize = 2 << 20;

impl<T: Pod> Buffer<T> {
    /// Creates a window of `count` values that starts `offset` bytes into `map`.
    ///
    /// Returns `None` if the window exceeds the map or is not aligned for `T`.
    pub fn from_map(map: &Arc<MmapMut>, offset: usize, count: usize) -> Option<Buffer<T>> {
        let end = count.checked_mul(size_of::<T>())?.checked_add(offset)?;
        let window = map.get(offset..end)?;
        bytemuck::try_cast_slice::<u8, T>(window).ok()?;
        Some(Buffer(Storage::Mapped {
            map: Arc::clone(map),
            bytes: offset..end,
        }))
    }

    /// Returns the number of bytes past the last value that may be read without a fault. Embree reads the last vertex
    /// of a buffer with a 16-byte load.
    pub fn readable_bytes_past_end(&self) -> usize {
        match &self.0 {
            Storage::Owned(values) => (values.capacity() - values.len()) * size_of::<T>(),
            Storage::Mapped { map, bytes } => map.len().next_multiple_of(PAGE) - bytes.end,
            Storage::Anonymous(map) => map.len().next_multiple_of(PAGE) - map.len(),
        }
    }

    /// Returns whether the values are a window into shared memory, such as the bytes of a file.
    pub fn is_window(&self) -> bool {
        matches!(self.0, Storage::Mapped { .. })
    }

    /// Returns whether other buffers share the values.
    pub fn is_shared(&self) -> bool {
        match &self.0 {
            Storage::Owned(values) => Arc::strong_count(values) > 1,
            Storage::Mapped { map, .. } => Arc::strong_count(map) > 1,
            Storage::Anonymous(map) => Arc::strong_count(map) > 1,
        }
    }
}

impl<T: Pod + PartialEq> PartialEq for Buffer<T> {
    fn eq(&self, other: &Buffer<T>) -> bool {
        **self == **other
    }
}

impl<T: Pod> From<Vec<T>> for Buffer<T> {
    /// Takes ownership of the values, and reserves room for one more behind them (see
    /// [`Buffer::readable_bytes_past_end`]).
    fn from(mut values: Vec<T>) -> Buffer<T> {
        values.reserve_exact(1);
        Buffer(Storage::Owned(Arc::new(values)))
    }
}

impl<T: Pod> Default for Buffer<T> {
    fn default() -> Buffer<T> {
        Buffer::from(Vec::new())
    }
}

impl<T: Pod> Deref for Buffer<T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        match &self.0 {
            Storage::Owned(values) => values,
            Storage::Mapped { map, bytes } => bytemuck::cast_slice(&map[bytes.clone()]),
            Storage::Anonymous(map) => bytemuck::cast_slice(map),
        }
    }
}

/// Returns memory of `size` zero bytes, in huge pages if it is large and the system grants them.
///
/// # Errors
/// The system has no such memory, or the size is zero.
pub(crate) fn anonymous_map(size: usize) -> std::io::Result<MmapMut> {
    let map = MmapMut::map_anon(size)?;
    // Without huge pages the map serves as well.
    #[cfg(target_os = "linux")]
    if size >= HUGE_PAGE && !reports_free_pages() {
        let _ = map.advise(memmap2::Advice::HugePage);
    }
    Ok(map)
}

/// Returns whether the system is a virtual machine that reports free pages to its host, which takes them back.
#[cfg(target_os = "linux")]
fn reports_free_pages() -> bool {
    /// Least number of pages that are reported together, as a power of two; -1, as an unsigned number, if none are.
    const ORDER: &str = "/sys/module/page_reporting/parameters/page_reporting_order";
    static REPORTS: OnceLock<bool> = OnceLock::new();
    *REPORTS.get_or_init(|| {
        let order = std::fs::read_to_string(ORDER).ok();
        let order = order.and_then(|order| order.trim().parse::<u32>().ok());
        order.is_some_and(|order| order < u32::BITS)
    })
}

/// Array of plain values that are written before they are shared.
#[derive(Debug)]
pub struct BufferMut<T: Pod>(StorageMut<T>);

#[derive(Debug)]
enum StorageMut<T> {
    Owned(Vec<T>),
    /// Anonymous map, of which only whole values are used.
    Mapped(MmapMut, PhantomData<T>),
}

impl<T: Pod> BufferMut<T> {
    /// Creates an array of `count` values whose bytes are zero.
    ///
    /// # Panics
    /// If the array exceeds the address space.
    pub fn zeroed(count: usize) -> BufferMut<T> {
        let bytes = count.saturating_mul(size_of::<T>());
        let map = (bytes >= HUGE_PAGE).then(|| anonymous_map(bytes));
        match map {
            Some(Ok(map)) => BufferMut(StorageMut::Mapped(map, PhantomData)),
            // Small, or refused: the allocator decides
            _ => BufferMut(StorageMut::Owned(bytemuck::zeroed_vec(count))),
        }
    }

    /// Makes the array read-only.
    pub fn freeze(self) -> Buffer<T> {
        Buffer(match self.0 {
            StorageMut::Owned(values) => return Buffer::from(values),
            StorageMut::Mapped(map, _) => Storage::Anonymous(Arc::new(map)),
        })
    }
}

impl<T: Pod> Default for BufferMut<T> {
    fn default() -> BufferMut<T> {
        BufferMut::zeroed(0)
    }
}

impl<T: Pod> Deref for BufferMut<T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        match &self.0 {
            StorageMut::Owned(values) => values,
            StorageMut::Mapped(map, _) => bytemuck::cast_slice(map),
        }
    }
}

impl<T: Pod> DerefMut for BufferMut<T> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [T] {
        match &mut self.0 {
            StorageMut::Owned(values) => values,
            StorageMut::Mapped(map, _) => bytemuck::cast_slice_mut(map),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn zeros(size: usize) -> Arc<MmapMut> {
        Arc::new(anonymous_map(size).unwrap())
    }

    #[test]
    fn window_outside_the_map_or_unaligned_is_rejected() {
        let map = zeros(64);
        assert!(Buffer::<[f32; 3]>::from_map(&map, 0, 5).is_some());
        assert!(Buffer::<[f32; 3]>::from_map(&map, 0, 6).is_none());
        assert!(Buffer::<[f32; 3]>::from_map(&map, 2, 1).is_none());
        assert!(Buffer::<[f32; 3]>::from_map(&map, usize::MAX - 3, 1).is_none());
        assert!(Buffer::<[f32; 3]>::from_map(&map, 0, usize::MAX).is_none());
    }

    #[test]
    fn small_and_large_arrays_start_at_zero_and_keep_what_is_written() {
        for count in [0, 1, HUGE_PAGE / 12, HUGE_PAGE / 6 + 1] {
            let mut values = BufferMut::<[f32; 3]>::zeroed(count);
            assert_eq!(values.len(), count);
            assert!(values.iter().all(|value| *value == [0.0; 3]));
            if let Some(last) = values.last_mut() {
                *last = [1.0, 2.0, 3.0];
            }
            let values = values.freeze();
            assert_eq!(values.last(), (count > 0).then_some(&[1.0, 2.0, 3.0]));
            assert!(!values.is_window() && !values.is_shared());
            assert!(values.clone().is_shared());
        }
    }

    #[test]
    fn arrays_are_padded_for_16_byte_loads_of_the_last_vertex() {
        assert!(Buffer::from(vec![[0f32; 3]; 7]).readable_bytes_past_end() >= 4);
        let map = zeros(24);
        let slab = Buffer::<[f32; 3]>::from_map(&map, 0, 2).unwrap();
        assert_eq!(slab.readable_bytes_past_end(), 4096 - 24);
    }
}
