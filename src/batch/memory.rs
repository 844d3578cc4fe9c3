//! Memory use: peak of the process, available memory of the machine, and the estimate for a scene.

use std::fs;

use crate::render::subsurface_bytes;
use crate::scene::{Geometry, Scene};

/// Film bytes per pixel: linear RGB values (12), 16-bit codes for the PNG encoder (6), and the encoded file, which
/// grows in steps (10).
const FILM_BYTES_PER_PIXEL: u64 = 28;

/// Returns the bytes that an image's film takes until the file is written.
pub fn film_bytes(width: u32, height: u32) -> u64 {
    FILM_BYTES_PER_PIXEL * u64::from(width) * u64::from(height)
}

/// Returns the peak resident memory of this process in bytes, where the system reports it.
pub fn peak_bytes() -> Option<u64> {
    kilobytes_of(&fs::read_to_string("/proc/self/status").ok()?, "VmHWM:")
}

/// Returns the available memory in bytes, where the system reports it.
pub fn available_bytes() -> Option<u64> {
    kilobytes_of(&fs::read_to_string("/proc/meminfo").ok()?, "MemAvailable:")
}

/// Returns the value of a line such as `VmHWM:  1234 kB`, in bytes.
fn kilobytes_of(text: &str, key: &str) -> Option<u64> {
    let value = text.lines().find_map(|line| line.strip_prefix(key))?;
    let kilobytes: u64 = value.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

/// Estimated memory for rendering a scene, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct MemoryForecast {
    /// Bytes of the meshes, images and volumes after loading.
    pub scene_bytes: u64,
    /// Peak bytes of Embree's structure, which it takes during the build.
    pub embree_bytes: u64,
    /// Bytes of the native tree after the build.
    pub native_bytes: u64,
    /// Bytes of the BSP tree after the build.
    pub bsp_bytes: u64,
    /// Bytes of the film of a 1024x1024 image.
    pub film_bytes: u64,
    /// Bytes of the irradiance in subsurface-scattering objects.
    pub subsurface_bytes: u64,
    /// Bytes of the photons of caustics, while their map is built.
    pub photon_bytes: u64,
}

/// Peak bytes per triangle during a build by Embree 3.13.5, measured with 2 million triangles; 70 remain after the
/// build.
const EMBREE_BYTES_PER_TRIANGLE: u64 = 104;
/// Bytes per photon while the map is built: as it is stored, sorted, and in its leaf.
const BYTES_PER_PHOTON: u64 = 160;
/// Bytes per triangle of the native tree, measured with 2 million triangles.
const NATIVE_BYTES_PER_TRIANGLE: u64 = 60;
/// Bytes per triangle of the BSP, duplicates included, measured with 2 million triangles.
const BSP_BYTES_PER_TRIANGLE: u64 = 84;

impl MemoryForecast {
    /// Returns the estimate for a loaded scene. Instances share their geometry.
    pub fn of(scene: &Scene) -> MemoryForecast {
        // Points count as triangles do, except that the native backend leaves them to a BSP
        let primitives: u64 = scene.geometries.iter().map(|g| g.primitive_count() as u64).sum();
        let clouds = scene.geometries.iter().filter_map(Geometry::point_cloud);
        let points: u64 = clouds.map(|cloud| cloud.len() as u64).sum();
        MemoryForecast {
            scene_bytes: mesh_bytes(scene) + image_bytes(scene) + volume_bytes(scene),
            embree_bytes: EMBREE_BYTES_PER_TRIANGLE * primitives,
            native_bytes: NATIVE_BYTES_PER_TRIANGLE * (primitives - points) + BSP_BYTES_PER_TRIANGLE * points,
            bsp_bytes: BSP_BYTES_PER_TRIANGLE * primitives,
            film_bytes: film_bytes(1024, 1024),
            subsurface_bytes: subsurface_bytes(scene),
            photon_bytes: scene
                .caustics
                .map_or(0, |caustics| BYTES_PER_PHOTON * u64::from(caustics.photons)),
        }
    }
}

/// Returns the bytes of all arrays of vertices, indices and points.
pub fn mesh_bytes(scene: &Scene) -> u64 {
    scene
        .geometries
        .iter()
        .map(|geometry| match geometry {
            Geometry::Mesh(mesh) => mesh.byte_count() as u64,
            Geometry::Points(cloud) => cloud.byte_count() as u64,
            Geometry::Shape(_) => 0,
        })
        .sum()
}

/// Returns the bytes of all decoded images.
pub fn image_bytes(scene: &Scene) -> u64 {
    scene.images.iter().map(|image| image.texels.byte_count()).sum()
}

/// Returns the bytes of all volumes' grids; shared grids count for each volume.
pub fn volume_bytes(scene: &Scene) -> u64 {
    scene.volumes.iter().map(|volume| volume.memory() as u64).sum()
}

/// Formats a number of bytes for a person, such as `12.3 MB`.
pub fn in_words(bytes: u64) -> String {
    const UNITS: [&str; 5] = ["kB", "MB", "GB", "TB", "PB"];
    if bytes < 1000 {
        return format!("{bytes} B");
    }
    // Divide by powers of 1000 until at most three digits precede the point
    let mut value = bytes as f64 / 1000.0;
    let mut unit = 0;
    // Values that would round to 1000.0 use the next unit.
    while value >= 999.95 && unit + 1 < UNITS.len() {
        value /= 1000.0;
        unit += 1;
    }
    format!("{value:.1} {}", UNITS[unit])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn proc_status_lines_are_read_in_bytes() {
        let text = "VmPeak:\t 9 kB\nVmHWM:\t  1234 kB\nThreads:\t1\n";
        assert_eq!(kilobytes_of(text, "VmHWM:"), Some(1234 * 1024));
        assert_eq!(kilobytes_of(text, "Threads:"), None);
        assert_eq!(kilobytes_of(text, "VmRSS:"), None);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn peak_memory_grows_with_allocations() {
        const HELD: u64 = 64 << 20;
        let before = peak_bytes().unwrap();
        let held = std::hint::black_box(vec![1u8; HELD as usize]);
        // Other tests may have raised the peak before.
        assert!(peak_bytes().unwrap() >= before.max(HELD), "{}", held.len());
        assert!(available_bytes().unwrap() > 0);
    }

    #[test]
    fn bytes_are_formatted_with_one_decimal_and_a_unit() {
        let words = [0, 999, 1000, 12_345_678, 999_949, 999_950].map(in_words);
        assert_eq!(words, ["0 B", "999 B", "1.0 kB", "12.3 MB", "999.9 kB", "1.0 MB"]);
        assert_eq!(in_words(u64::MAX), "18446.7 PB");
    }
}
