//! Test images: pairs of small images with published metric values.

use crate::image::LinearImage;

/// Number of image pairs that [`pairs`] returns.
pub(super) const COUNT: usize = 4;

/// Returns an image of 24x17 pixels from 8-bit codes by column, row and channel, and a map from code to radiance.
pub(super) fn image(code: impl Fn(u32, u32, u32) -> u32, radiance: impl Fn(u32) -> f64) -> LinearImage {
    let mut image = LinearImage::black(24, 17);
    for (index, pixel) in image.pixels.iter_mut().enumerate() {
        let (x, y) = (index as u32 % 24, index as u32 / 24);
        *pixel = [0, 1, 2].map(|c| radiance(code(x, y, c) % 256) as f32);
    }
    image
}

/// Returns pairs of reference and test: noise, a moved edge, an added point, and colours of the largest distance.
pub(super) fn pairs(radiance: fn(u32) -> f64) -> [(&'static str, [LinearImage; 2]); COUNT] {
    let noise = |x, y, c| x * 37 + y * 17 + c * 91 + x * y * 3;
    let squares = |x: u32, y: u32| if (x / 4 + y / 4) % 2 == 1 { 40 } else { 0 };
    let edge = |end| image(move |x, _, c| if x < end { 200 } else { 40 + 10 * c }, radiance);
    let ramp = |x, c| 90 + x * 3 + c * 5;
    let dot = |x, y, c| if (x, y) == (11, 8) { 255 } else { ramp(x, c) };
    let full = |channel| image(move |_, _, c| if c == channel { 255 } else { 0 }, radiance);
    let changed = |x, y, c| noise(x, y, c) + squares(x, y);
    [
        ("noise", [image(noise, radiance), image(changed, radiance)]),
        ("edge", [edge(12), edge(13)]),
        (
            "dot",
            [image(|x, _, c| ramp(x, c), radiance), image(dot, radiance)],
        ),
        ("green and blue", [full(1), full(2)]),
    ]
}

/// Returns the mean of an error map.
pub(super) fn mean(map: &[f32]) -> f64 {
    map.iter().copied().map(f64::from).sum::<f64>() / map.len() as f64
}
