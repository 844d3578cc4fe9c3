//! Cache of decoded images, shared between scenes that are loaded one after another, such as the frames of an
//! animation.
//!
//! Entries are keyed by the hash of the encoded bytes, so a file that has changed is decoded again.

use std::collections::HashMap;
use std::fs::File;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::texture::{Encoding, Image, Texels};
use crate::image::ImageError;

/// Cache of decoded images between loads; clones share the entries.
///
/// The default caches nothing.
#[derive(Clone, Debug, Default)]
pub struct ImageCache(Option<Arc<CacheEntries>>);

#[derive(Debug, Default)]
struct CacheEntries {
    images: Mutex<HashMap<CacheKey, CachedImage>>,
    found: AtomicUsize,
    lookups: AtomicUsize,
}

/// Cache key: hash of the encoded image, and the encoding that it is read with; `None` where that makes no difference.
type CacheKey = (blake3::Hash, Option<Encoding>);

/// Size and pixels of a decoded image.
#[derive(Clone, Debug)]
pub(crate) struct CachedImage {
    pub(crate) size: [u32; 2],
    pub(crate) texels: Texels,
}

/// Lookup statistics of an image cache.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheStats {
    /// Number of lookups in all.
    pub lookups: usize,
    /// Number of lookups that found an entry.
    pub found: usize,
}

impl ImageCache {
    /// Returns an empty cache that keeps images.
    pub fn new() -> ImageCache {
        ImageCache(Some(Arc::default()))
    }

    /// Returns the decoded pixels of the 8-bit image in `encoded`, from the cache or by `decode`, whose result is
    /// cached.
    pub(crate) fn image<E>(
        &self,
        encoded: &[u8],
        decode: impl FnOnce() -> Result<CachedImage, E>,
    ) -> Result<CachedImage, E> {
        let Some(entries) = &self.0 else { return decode() };
        // 8-bit images are decoded at lookup, so their encoding is not part of the key
        let key = (blake3::hash(encoded), None);
        if let Some(cached) = entries.find(&key) {
            return Ok(cached);
        }
        // Decoded without the lock held, so that threads decode different images in parallel
        let made = decode()?;
        entries.images().insert(key, made.clone());
        Ok(made)
    }

    /// Returns the image of the file at `path`, as [`Image::read`] decodes it, from the cache if it is there.
    ///
    /// # Errors
    /// Those of [`Image::read`].
    pub(crate) fn read(&self, path: &Path, encoding: Encoding, max_texels: u64) -> Result<Image, ImageError> {
        let read = || Image::read(path, encoding, max_texels);
        // Without a cache, or for an unreadable file, just read
        let Some((entries, hash)) = self.0.as_ref().zip(hash_of(path)) else {
            return read();
        };
        let key = (hash, Some(encoding));
        match entries.find(&key) {
            // An image beyond the limit is read all the same, as that reports the error.
            Some(cached) if cached.texels.budget() <= max_texels => Ok(Image {
                name: path.display().to_string(),
                width: cached.size[0],
                height: cached.size[1],
                texels: cached.texels,
            }),
            _ => {
                let image = read()?;
                let cached = CachedImage {
                    size: [image.width, image.height],
                    texels: image.texels.clone(),
                };
                entries.images().insert(key, cached);
                Ok(image)
            }
        }
    }

    /// Removes images that no loaded scene uses.
    pub fn evict_unused(&self) {
        if let Some(entries) = &self.0 {
            entries.images().retain(|_, cached| cached.texels.is_shared());
        }
    }

    /// Returns the numbers of lookups and of hits so far.
    pub fn counts(&self) -> CacheStats {
        let Some(entries) = &self.0 else {
            return CacheStats::default();
        };
        CacheStats {
            lookups: entries.lookups.load(Ordering::Relaxed),
            found: entries.found.load(Ordering::Relaxed),
        }
    }
}

impl CacheEntries {
    fn images(&self) -> MutexGuard<'_, HashMap<CacheKey, CachedImage>> {
        // Entries are inserted and removed whole, so the map is consistent even after a panic
        self.images.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn find(&self, key: &CacheKey) -> Option<CachedImage> {
        let found = self.images().get(key).cloned();
        self.lookups.fetch_add(1, Ordering::Relaxed);
        self.found
            .fetch_add(usize::from(found.is_some()), Ordering::Relaxed);
        found
    }
}

/// Returns the hash of a file's bytes; `None` where the file cannot be read, which reading it afterwards reports.
fn hash_of(path: &Path) -> Option<blake3::Hash> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(File::open(path).ok()?).ok()?;
    Some(hasher.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray(code: u8) -> Result<CachedImage, ()> {
        Ok(CachedImage {
            size: [1, 1],
            texels: Texels::Bytes(vec![[code; 4]].into()),
        })
    }

    fn counts(image_cache: &ImageCache) -> [usize; 2] {
        [image_cache.counts().lookups, image_cache.counts().found]
    }

    #[test]
    fn live_images_are_found_by_content_and_others_are_evicted() {
        let image_cache = ImageCache::new();
        let held = image_cache.image(b"a", || gray(1)).unwrap();
        drop(image_cache.image(b"b", || gray(2)).unwrap());
        image_cache.evict_unused();
        let again = image_cache.image(b"a", || gray(9)).unwrap();
        assert_eq!(again.texels, held.texels);
        let anew = image_cache.image(b"b", || gray(3)).unwrap();
        assert_eq!(anew.texels, gray(3).unwrap().texels);
        assert_eq!(counts(&image_cache), [4, 1]);
    }

    #[test]
    fn failed_decodes_are_not_cached() {
        let image_cache = ImageCache::new();
        assert!(image_cache.image(b"a", || Err::<CachedImage, ()>(())).is_err());
        assert!(image_cache.image(b"a", || gray(1)).is_ok());
        assert_eq!(counts(&image_cache), [2, 0]);
    }

    #[test]
    fn files_are_cached_by_bytes_and_by_usage() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let write = |code: u8| {
            image::RgbaImage::from_pixel(2, 1, image::Rgba([code; 4]))
                .save(&path)
                .unwrap()
        };
        write(7);
        let image_cache = ImageCache::new();
        let read = |encoding| image_cache.read(&path, encoding, 8).unwrap();
        // A second read with the same encoding is a hit, one with another is not
        let first = read(Encoding::Srgb);
        assert_eq!(read(Encoding::Srgb).texels, first.texels);
        read(Encoding::Linear);
        assert_eq!(counts(&image_cache), [3, 1]);
        // A changed file is read again
        write(8);
        assert_ne!(read(Encoding::Srgb).texels, first.texels);
        assert_eq!(counts(&image_cache), [4, 1]);
        // Cached images count against the budget, too.
        let _kept = read(Encoding::Srgb);
        assert!(image_cache.read(&path, Encoding::Srgb, 1).is_err());
        assert!(
            image_cache
                .read(Path::new("missing.png"), Encoding::Srgb, 8)
                .is_err()
        );
    }
}
