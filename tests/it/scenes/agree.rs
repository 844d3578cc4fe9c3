//! All backends render the same image of every scene in the folder `scenes`.
//!
//! The backends share the f64 shading code and the code of analytic shapes. Images therefore differ only in t, u and v
//! of triangles, which each backend rounds to f32 in its own way, and in ties: rays along an edge or a silhouette, or
//! shadow rays that end on one.
//!
//! Rounding moves u and v by about 8 * 2^-24 = 5e-7 of a triangle. An edge of a checkerboard as wide as the ray, or a
//! sharp highlight on a smooth mesh, changes from dark to bright within a thousandth of a triangle. It amplifies this
//! to 5e-4. Pixels therefore count as different from 1e-3 on, a quarter of a step of an 8-bit image.
//!
//! The large version: `tests/ci/slow agree`.

use crate::support::scene_folder::{files, load};
use whit::accel::Backend;

/// Relative tolerance of a channel: twice the estimated effect of rounding.
const RELATIVE: f32 = 1e-3;
/// Absolute tolerance near black, where white is 1.
const ABSOLUTE: f32 = 1e-4;

/// Returns whether two pixels agree within the tolerances.
fn same(a: [f32; 3], b: [f32; 3]) -> bool {
    (0..3).all(|c| (a[c] - b[c]).abs() <= RELATIVE * a[c].abs().max(b[c].abs()) + ABSOLUTE)
}

/// Renders all scenes with the BSP and another backend, `width` pixels per row, prints the differing pixels, and returns
/// the numbers of differing pixels and of all pixels.
fn compare(backend: Backend, width: u32) -> (usize, usize) {
    /// Maximum number of pixels that are printed per scene.
    const SHOWN: usize = 20;
    let (mut differing, mut pixels) = (0, 0);
    for file in files() {
        let filed = load(&file);
        let settings = filed.settings(width, 1);
        let [other, bsp] = [backend, Backend::Bsp].map(|backend| filed.rendered(backend, &settings).pixels);
        assert_eq!(other.len(), bsp.len());
        let exact = other.iter().zip(&bsp).filter(|(a, b)| a == b).count();
        let unlike: Vec<usize> = (0..bsp.len()).filter(|&i| !same(other[i], bsp[i])).collect();
        println!(
            "{}: {} of {} pixels differ, {exact} have the same bits",
            filed.name,
            unlike.len(),
            bsp.len()
        );
        for &i in unlike.iter().take(SHOWN) {
            let (column, row) = (i % width as usize, i / width as usize);
            println!(
                "    column {column}, row {row}: {backend} {:?}, BSP {:?}",
                other[i], bsp[i]
            );
        }
        differing += unlike.len();
        pixels += bsp.len();
    }
    println!("{differing} of {pixels} pixels differ");
    (differing, pixels)
}

/// Asserts that fewer than one pixel in `rarity` differs between the BSP and every other backend.
fn assert_same_images(width: u32, least_pixels: usize, rarity: usize) {
    let embree = cfg!(feature = "embree").then_some(Backend::Embree);
    for backend in embree.into_iter().chain([Backend::Native, Backend::Auto]) {
        let (differing, pixels) = compare(backend, width);
        assert!(pixels > least_pixels, "only {pixels} pixels were compared");
        assert!(
            differing * rarity < pixels,
            "{backend}: {differing} of {pixels} pixels differ"
        );
    }
}

#[test]
fn backends_render_the_same_small_images() {
    assert_same_images(96, 100_000, 10_000);
}

#[test]
#[ignore = "slow: six million pixels, twice by two backends"]
fn backends_differ_in_fewer_than_1e_5_of_pixels() {
    assert_same_images(640, 5_000_000, 100_000);
}
