//! Array that is owned or a window into a memory-mapped file, so that large meshes are never copied.

use std::ops::{Deref, Range};
use std::sync::Arc;

use bytemuck::Pod;
use memmap2::Mmap;

/// Read-only array of plain values.
#[derive(Clone, Debug)]
pub struct Buffer<T: Pod>(Storage<T>);

#[derive(Clone, Debug)]
enum Storage<T> {
    Owned(Arc<Vec<T>>),
    Mapped { map: Arc<Mmap>, bytes: Range<usize> },
}

/// Page size in bytes: the bytes between a mapped file's end and the end of its page can be read and are zero.
const PAGE: usize = 4096;

impl<T: Pod> Buffer<T> {
    /// Creates a window of `count` values that starts `offset` bytes into `map`.
    ///
    /// Returns `None` if the window exceeds the map or is not aligned for `T`.
    pub fn from_map(map: &Arc<Mmap>, offset: usize, count: usize) -> Option<Buffer<T>> {
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
        }
    }

    /// Returns whether the values are in a mapped file.
    pub fn is_mapped(&self) -> bool {
        matches!(self.0, Storage::Mapped { .. })
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
        }
    }
}

#[cfg(test)]
mod tests {
    use memmap2::MmapMut;

    use super::*;

    fn mapped(bytes: &[u8]) -> Arc<Mmap> {
        let mut map = MmapMut::map_anon(bytes.len()).unwrap();
        map.copy_from_slice(bytes);
        Arc::new(map.make_read_only().unwrap())
    }

    #[test]
    fn window_outside_the_map_or_unaligned_is_rejected() {
        let map = mapped(&[0u8; 64]);
        assert!(Buffer::<[f32; 3]>::from_map(&map, 0, 5).is_some());
        assert!(Buffer::<[f32; 3]>::from_map(&map, 0, 6).is_none());
        assert!(Buffer::<[f32; 3]>::from_map(&map, 2, 1).is_none());
        assert!(Buffer::<[f32; 3]>::from_map(&map, usize::MAX - 3, 1).is_none());
        assert!(Buffer::<[f32; 3]>::from_map(&map, 0, usize::MAX).is_none());
    }

    #[test]
    fn arrays_are_padded_for_16_byte_loads_of_the_last_vertex() {
        assert!(Buffer::from(vec![[0f32; 3]; 7]).readable_bytes_past_end() >= 4);
        let map = mapped(&[0u8; 24]);
        let slab = Buffer::<[f32; 3]>::from_map(&map, 0, 2).unwrap();
        assert_eq!(slab.readable_bytes_past_end(), 4096 - 24);
    }
}
