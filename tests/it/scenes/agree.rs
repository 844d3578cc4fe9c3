//! Every scene of the folder `scenes` gives the same picture through Embree and through the BSP.
//!
//! All shading is one code in f64 from what is hit, and analytic shapes are one code for both backends too. So pictures
//! differ in nothing but the triangles' t, u and v, which each backend rounds to f32 in its own way, and in ties: rays
//! along an edge or a silhouette, or a shadow ray's end on one.
//!
//! The rounding moves u and v by some 8 * 2^-24 = 5e-7 of a triangle. An edge of a checkerboard, as wide as the ray, or
//! a sharp highlight on a smooth mesh goes from dark to bright within a thousandth of a triangle and makes 5e-4 of it.
//! So pixels count as different from 1e-3 on, a quarter of a step of an 8-bit picture.
//!
//! The large version: `tests/ci/slow agree`.

use crate::support::scene_folder::{files, load};
use whit::accel::Backend;

/// Share of a channel's value that may differ: twice what rounding was reckoned to do.
const RELATIVE: f32 = 1e-3;
/// The same for what is next to black, where white is 1.
const ABSOLUTE: f32 = 1e-4;

/// Whether two pixels show the same.
fn same(a: [f32; 3], b: [f32; 3]) -> bool {
    (0..3).all(|c| (a[c] - b[c]).abs() <= RELATIVE * a[c].abs().max(b[c].abs()) + ABSOLUTE)
}

/// Renders all scenes twice, `width` pixels a row, prints which pixels differ, and returns how many of how many.
fn compare(width: u32) -> (usize, usize) {
    /// Pixels of a scene that are printed.
    const SHOWN: usize = 20;
    let (mut differing, mut pixels) = (0, 0);
    for file in files() {
        let filed = load(&file);
        let settings = filed.settings(width, 1);
        let [embree, bsp] =
            [Backend::Embree, Backend::Bsp].map(|backend| filed.picture(backend, &settings).pixels);
        assert_eq!(embree.len(), bsp.len());
        let exact = embree.iter().zip(&bsp).filter(|(a, b)| a == b).count();
        let unlike: Vec<usize> = (0..bsp.len()).filter(|&i| !same(embree[i], bsp[i])).collect();
        println!(
            "{}: {} of {} pixels differ, {exact} have the same bits",
            filed.name,
            unlike.len(),
            bsp.len()
        );
        for &i in unlike.iter().take(SHOWN) {
            let (column, row) = (i % width as usize, i / width as usize);
            println!(
                "    column {column}, row {row}: Embree {:?}, BSP {:?}",
                embree[i], bsp[i]
            );
        }
        differing += unlike.len();
        pixels += bsp.len();
    }
    println!("{differing} of {pixels} pixels differ");
    (differing, pixels)
}

#[test]
fn embree_and_the_bsp_make_the_same_small_pictures_of_all_scenes() {
    let (differing, pixels) = compare(96);
    assert!(pixels > 100_000, "only {pixels} pixels were compared");
    assert!(
        differing * 10_000 < pixels,
        "{differing} of {pixels} pixels differ"
    );
}

#[test]
#[ignore = "slow: six million pixels, twice"]
fn fewer_than_one_in_a_hundred_thousand_pixels_of_all_scenes_differ_between_the_backends() {
    let (differing, pixels) = compare(640);
    assert!(pixels > 5_000_000, "only {pixels} pixels were compared");
    assert!(
        differing * 100_000 < pixels,
        "{differing} of {pixels} pixels differ"
    );
}
