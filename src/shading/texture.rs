//! Texture look-ups: wrap modes, nearest and bilinear filtering, the sRGB curve.

use std::sync::LazyLock;

use crate::scene::{Encoding, Filter, Image, Sampler, Texels, Wrap};

/// Linear values of the 256 sRGB codes (IEC 61966-2-1).
static LINEAR_FROM_SRGB: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|code| {
        let x = code as f64 / 255.0;
        let linear = if x <= 0.04045 {
            x / 12.92
        } else {
            ((x + 0.055) / 1.055).powf(2.4)
        };
        linear as f32
    })
});

/// Linear RGBA of `image` at (`u`, `v`), u to the right and v downwards from the top left corner.
///
/// Texels are decoded before they are mixed. Coordinates that are not finite count as 0.
pub fn sample(image: &Image, sampler: Sampler, encoding: Encoding, [u, v]: [f32; 2]) -> [f32; 4] {
    let finite = |x: f32| if x.is_finite() { f64::from(x) } else { 0.0 };
    let x = finite(u) * f64::from(image.width);
    let y = finite(v) * f64::from(image.height);
    match sampler.filter {
        Filter::Nearest => texel(image, sampler, encoding, x.floor(), y.floor()),
        Filter::Linear | Filter::Mipmap => {
            let (x, y) = (x - 0.5, y - 0.5);
            let (left, top) = (x.floor(), y.floor());
            let (across, down) = ((x - left) as f32, (y - top) as f32);
            let corner = |dx: f64, dy: f64| texel(image, sampler, encoding, left + dx, top + dy);
            let upper = mix(corner(0.0, 0.0), corner(1.0, 0.0), across);
            let lower = mix(corner(0.0, 1.0), corner(1.0, 1.0), across);
            mix(upper, lower, down)
        }
    }
}

fn mix(a: [f32; 4], b: [f32; 4], t: f32) -> [f32; 4] {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * t)
}

/// The decoded texel with integer coordinates `x`, `y`, which may lie outside the image.
fn texel(image: &Image, sampler: Sampler, encoding: Encoding, x: f64, y: f64) -> [f32; 4] {
    let column = wrap(sampler.wrap_u, x, image.width);
    let row = wrap(sampler.wrap_v, y, image.height);
    let index = row * image.width as usize + column;
    let bytes = match &image.texels {
        Texels::Bytes(texels) => texels[index],
        Texels::Floats(texels) => return texels[index],
    };
    let unit = |byte: u8| f32::from(byte) / 255.0;
    match encoding {
        Encoding::Linear => bytes.map(unit),
        Encoding::Srgb => {
            let linear = |byte: u8| LINEAR_FROM_SRGB[byte as usize];
            [
                linear(bytes[0]),
                linear(bytes[1]),
                linear(bytes[2]),
                unit(bytes[3]),
            ]
        }
    }
}

/// The texel index in 0..size that stands for the integer coordinate `i`.
fn wrap(mode: Wrap, i: f64, size: u32) -> usize {
    let size = f64::from(size);
    let inside = match mode {
        Wrap::Repeat => i.rem_euclid(size),
        Wrap::MirroredRepeat => {
            let j = i.rem_euclid(2.0 * size);
            if j < size { j } else { 2.0 * size - 1.0 - j }
        }
        Wrap::ClampToEdge => i,
    };
    // `rem_euclid` may round up to its divisor.
    inside.clamp(0.0, size - 1.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn black_and_white() -> Image {
        Image {
            name: String::new(),
            width: 2,
            height: 1,
            texels: Texels::Bytes(vec![[0, 0, 0, 255], [255; 4]]),
        }
    }

    fn sampler(wrap: Wrap, filter: Filter) -> Sampler {
        Sampler {
            wrap_u: wrap,
            wrap_v: wrap,
            filter,
        }
    }

    #[test]
    fn each_wrap_mode_continues_the_image_its_own_way() {
        let red = |wrap, u: f32| {
            sample(
                &black_and_white(),
                sampler(wrap, Filter::Nearest),
                Encoding::Linear,
                [u, 0.5],
            )[0]
        };
        // Texels: black on [0, ½), white on [½, 1).
        assert_eq!([red(Wrap::Repeat, 1.25), red(Wrap::Repeat, -0.25)], [0.0, 1.0]);
        assert_eq!(
            [red(Wrap::MirroredRepeat, 1.25), red(Wrap::MirroredRepeat, -0.25)],
            [1.0, 0.0]
        );
        assert_eq!(
            [red(Wrap::ClampToEdge, 7.0), red(Wrap::ClampToEdge, -7.0)],
            [1.0, 0.0]
        );
    }

    #[test]
    fn bilinear_filtering_meets_texels_at_their_middles() {
        let red = |u: f32| {
            sample(
                &black_and_white(),
                sampler(Wrap::ClampToEdge, Filter::Linear),
                Encoding::Linear,
                [u, 0.5],
            )[0]
        };
        assert_eq!([red(0.25), red(0.5), red(0.75)], [0.0, 0.5, 1.0]);
    }

    #[test]
    fn srgb_is_decoded_before_mixing() {
        let red = |u: f32, encoding| {
            let mut image = black_and_white();
            image.texels = Texels::Bytes(vec![[0, 0, 0, 255], [188; 4]]);
            sample(
                &image,
                sampler(Wrap::ClampToEdge, Filter::Linear),
                encoding,
                [u, 0.5],
            )[0]
        };
        // Code 188 is linear 0.5029; half of it lies half-way.
        assert!((red(0.75, Encoding::Srgb) - 0.502_886_5).abs() < 1e-6);
        assert!((red(0.5, Encoding::Srgb) - 0.251_443_2).abs() < 1e-6);
    }

    #[test]
    fn absurd_coordinates_find_some_texel() {
        for u in [f32::NAN, f32::INFINITY, f32::MAX, -f32::MAX, -1e-45] {
            for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
                for filter in [Filter::Nearest, Filter::Linear] {
                    assert!(
                        sample(&black_and_white(), sampler(wrap, filter), Encoding::Srgb, [u, u])[0]
                            .is_finite()
                    );
                }
            }
        }
    }
}
