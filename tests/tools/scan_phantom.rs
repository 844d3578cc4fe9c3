//! Draws the array of `scenes/scan.toml`: a head as a tomograph would see it, made of ellipsoids.
//!
//! `cargo run --release --example scan-phantom -- scenes/volumes/head.npy` writes 64³ bytes as a NumPy array, indexed
//! `[z, y, x]`. The ellipsoids are of our own choice, after the idea of L. Shepp and B. Logan's phantom ("The Fourier
//! reconstruction of a head section", 1974).

use std::fs;

use glam::DVec3;

/// Samples a side.
const SIDE: usize = 64;

/// What fills an ellipsoid.
struct Ellipsoid {
    center: [f64; 3],
    radii: [f64; 3],
    value: f64,
}

const fn ellipsoid(center: [f64; 3], radii: [f64; 3], value: f64) -> Ellipsoid {
    Ellipsoid { center, radii, value }
}

/// From the outside to the inside: later ones replace what was there.
const HEAD: [Ellipsoid; 16] = [
    ellipsoid([0.0, -0.8, -0.15], [0.36, 0.5, 0.36], 80.0),
    ellipsoid([0.0, -0.8, -0.2], [0.12, 0.5, 0.12], 220.0),
    ellipsoid([0.0, 0.1, 0.0], [0.75, 0.82, 0.88], 80.0),
    ellipsoid([0.0, -0.02, 0.9], [0.11, 0.18, 0.12], 90.0),
    ellipsoid([0.78, 0.0, -0.05], [0.07, 0.18, 0.13], 90.0),
    ellipsoid([-0.78, 0.0, -0.05], [0.07, 0.18, 0.13], 90.0),
    ellipsoid([0.0, 0.15, -0.03], [0.66, 0.72, 0.78], 220.0),
    ellipsoid([0.0, -0.46, 0.32], [0.36, 0.22, 0.36], 220.0),
    ellipsoid([0.0, -0.42, 0.24], [0.28, 0.13, 0.36], 80.0),
    ellipsoid([0.0, 0.19, -0.06], [0.57, 0.62, 0.68], 115.0),
    ellipsoid([0.12, 0.2, -0.05], [0.07, 0.2, 0.3], 40.0),
    ellipsoid([-0.12, 0.2, -0.05], [0.07, 0.2, 0.3], 40.0),
    ellipsoid([0.27, 0.0, 0.72], [0.17, 0.15, 0.2], 95.0),
    ellipsoid([-0.27, 0.0, 0.72], [0.17, 0.15, 0.2], 95.0),
    ellipsoid([0.0, -0.17, 0.75], [0.08, 0.12, 0.16], 40.0),
    ellipsoid([0.3, 0.45, 0.15], [0.1, 0.1, 0.1], 150.0),
];

/// Points a voxel and axis that its value is the mean of.
const FINE: usize = 3;

fn value(p: DVec3) -> f64 {
    if p.x > 0.0 && p.y > 0.25 && p.z > 0.0 {
        // Cut away, so that the inside is seen.
        return 0.0;
    }
    let holds = |e: &&Ellipsoid| {
        let q = (p - DVec3::from_array(e.center)) / DVec3::from_array(e.radii);
        q.length_squared() < 1.0
    };
    HEAD.iter().rev().find(holds).map_or(0.0, |e| e.value)
}

/// The mean over a voxel.
fn mean(voxel: [usize; 3]) -> u8 {
    let mut sum = 0.0;
    for i in 0..FINE * FINE * FINE {
        let part = [i % FINE, i / FINE % FINE, i / FINE / FINE];
        let at = |axis: usize| {
            let fine = (voxel[axis] * FINE + part[axis]) as f64 + 0.5;
            2.0 * fine / (SIDE * FINE) as f64 - 1.0
        };
        sum += value(DVec3::new(at(0), at(1), at(2)));
    }
    (sum / (FINE * FINE * FINE) as f64).round() as u8
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args()
        .nth(1)
        .ok_or("give the path of the array to write")?;
    let description =
        format!("{{'descr': '|u1', 'fortran_order': False, 'shape': ({SIDE}, {SIDE}, {SIDE}), }}");
    // Magic number, version, length; the header ends with a line feed at a multiple of 64 bytes.
    let length = (10 + description.len() + 1).next_multiple_of(64) - 10;
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(u16::try_from(length)?.to_le_bytes());
    bytes.extend(format!("{description:<width$}\n", width = length - 1).bytes());
    let voxel = |i: usize| [i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE];
    bytes.extend((0..SIDE * SIDE * SIDE).map(|i| mean(voxel(i))));
    fs::write(path, bytes)?;
    Ok(())
}
