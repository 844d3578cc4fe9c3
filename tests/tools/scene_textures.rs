//! The subcommand `scene-textures`: writes the images that scenes refer to, each computed from a rule, into a folder.

use std::f32::consts::TAU;
use std::path::PathBuf;

use image::{DynamicImage, Rgb, Rgb32FImage, Rgba, RgbaImage};

/// Arguments of `scene-textures`.
#[derive(clap::Args)]
#[command(after_long_help = "\
Writes globe.png, leaves.png, lattice.png and sky.hdr.

Example:
  cargo run --release --example tools -- scene-textures scenes/textures")]
pub(crate) struct Arguments {
    /// The folder to write into
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
}

/// Writes all images.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    for (name, image) in [
        ("globe.png", DynamicImage::from(globe())),
        ("leaves.png", leaves().into()),
        ("lattice.png", lattice().into()),
        ("sky.hdr", sky().into()),
    ] {
        let path = arguments.folder.join(name);
        image.save(&path).map_err(|error| {
            format!(
                "{}: cannot be written ({error}): choose another folder",
                path.display()
            )
        })?;
    }
    Ok(())
}

/// Returns a planet in longitude and latitude: seas, land, deserts and ice, by the height of a few waves on the sphere.
fn globe() -> RgbaImage {
    RgbaImage::from_fn(256, 128, |x, y| {
        let (longitude, latitude) = (
            (x as f32 + 0.5) / 256.0 * TAU,
            (0.5 - (y as f32 + 0.5) / 128.0) * TAU / 2.0,
        );
        let p = [
            latitude.cos() * longitude.cos(),
            latitude.cos() * longitude.sin(),
            latitude.sin(),
        ];
        let height = height(p);
        let is_ice = latitude.abs() > 1.15 + 0.2 * height;
        let [r, g, b] = match () {
            () if is_ice => [236, 242, 246],
            () if height < 0.0 => [24, 78, 150],
            () if height < 0.06 => [214, 196, 132],
            () if height < 0.45 => [70, 138, 62],
            () => [138, 112, 84],
        };
        Rgba([r, g, b, 255])
    })
}

/// Returns a clear sky in longitude and latitude, brighter towards the horizon and the sun, over pale ground. The sun is
/// a disk of radius 2 degrees, larger than the true one, so that it covers some pixels.
fn sky() -> Rgb32FImage {
    const SUN: [f32; 3] = [-0.62, 0.55, 0.56];
    let length = SUN.iter().map(|x| x * x).sum::<f32>().sqrt();
    Rgb32FImage::from_fn(256, 128, |x, y| {
        let (turn, angle) = (
            ((x as f32 + 0.5) / 256.0 - 0.5) * TAU,
            (y as f32 + 0.5) / 128.0 * TAU / 2.0,
        );
        let direction = [angle.sin() * turn.sin(), angle.cos(), -angle.sin() * turn.cos()];
        let cosine = (0..3).map(|i| direction[i] * SUN[i]).sum::<f32>() / length;
        if cosine > 2f32.to_radians().cos() {
            return Rgb([1900.0, 1650.0, 1300.0]);
        }
        if direction[1] < 0.0 {
            return Rgb([0.42, 0.37, 0.3]);
        }
        let (haze, glow) = ((1.0 - direction[1]).powi(4), cosine.max(0.0).powi(24));
        Rgb([
            0.22 + 0.75 * haze + 1.2 * glow,
            0.42 + 0.65 * haze + glow,
            0.95 + 0.35 * haze + 0.7 * glow,
        ])
    })
}

/// Returns the height of the land at a point of the unit sphere: waves along seven directions, each shorter and lower.
fn height(p: [f32; 3]) -> f32 {
    let mut sum = -0.08;
    let (mut length, mut amplitude) = (1.9, 0.55);
    for wave in 0..7u8 {
        let angle = f32::from(wave) * 2.4;
        let tilt = (f32::from(wave) * 1.7).sin();
        let along = p[0] * angle.cos() + p[1] * angle.sin() + p[2] * tilt;
        sum += amplitude * (length * along + f32::from(wave) * 1.3).sin();
        length *= 1.62;
        amplitude *= 0.74;
    }
    sum
}

/// Returns leaves around a twig, with alpha 1 on them and 0 elsewhere.
fn leaves() -> RgbaImage {
    RgbaImage::from_fn(128, 128, |x, y| {
        let (px, py) = ((x as f32 + 0.5) / 64.0 - 1.0, 1.0 - (y as f32 + 0.5) / 64.0);
        let mut texel = [70, 110, 40, 0];
        if px.abs() < 0.02 && py < 0.7 {
            texel = [92, 66, 40, 255];
        }
        for leaf in 0..9u8 {
            if let Some(vein) = leaf_at(px, py, leaf) {
                let green = 150 - u8::from(vein) * 46 + leaf * 6;
                texel = [56 + leaf * 8, green, 34, 255];
            }
        }
        Rgba(texel)
    })
}

/// Returns `None` where leaf number `leaf` does not cover the point, else whether its vein does.
fn leaf_at(px: f32, py: f32, leaf: u8) -> Option<bool> {
    let side = if leaf.is_multiple_of(2) { 1.0 } else { -1.0 };
    let stalk = -0.8 + 0.19 * f32::from(leaf);
    let angle: f32 = if leaf == 8 {
        0.25 * TAU
    } else {
        0.25 * TAU - side * 0.85
    };
    let (dx, dy) = (px, py - stalk.min(0.45));
    let along = dx * angle.cos() + dy * angle.sin();
    let across = dy * angle.cos() - dx * angle.sin();
    let length = if leaf == 8 {
        0.5
    } else {
        0.72 - 0.03 * f32::from(leaf)
    };
    let s = along / length;
    let half_width = 0.42 * length * (s * (1.0 - s)).max(0.0).sqrt() * (1.0 - 0.45 * s);
    ((0.0..1.0).contains(&s) && across.abs() < half_width).then_some(across.abs() < 0.012)
}

/// Returns a lattice of bars and rings, with alpha 0 between them.
fn lattice() -> RgbaImage {
    RgbaImage::from_fn(128, 128, |x, y| {
        let (px, py) = ((x as f32 + 0.5) / 64.0 - 1.0, (y as f32 + 0.5) / 64.0 - 1.0);
        let is_bar = px.abs() > 0.93 || py.abs() > 0.93;
        let is_ring = (px.hypot(py) - 0.62).abs() < 0.07;
        let is_diagonal = (px.abs() - py.abs()).abs() < 0.09 && px.hypot(py) > 0.55;
        let is_knob = px.hypot(py) < 0.16;
        let covered = is_bar || is_ring || is_diagonal || is_knob;
        Rgba([58, 54, 60, if covered { 255 } else { 0 }])
    })
}
