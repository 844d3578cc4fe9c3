//! The subcommand `scan-phantom`: writes the volume of `scenes/scan.toml`, a head as a tomograph would see it, made of
//! ellipsoids: 64³ bytes as a NumPy array, indexed `[z, y, x]`.
//!
//! The ellipsoids are of our own choice, after the idea of L. Shepp and B. Logan's phantom ("The Fourier reconstruction
//! of a head section", 1974).

use std::fs;
use std::path::PathBuf;

use glam::DVec3;

/// Voxels along each axis.
const SIDE: usize = 64;

/// Ellipsoid of one density, in a cube from -1 to 1.
struct Ellipsoid {
    center: [f64; 3],
    radii: [f64; 3],
    density: f64,
}

/// Returns an ellipsoid.
const fn ellipsoid(center: [f64; 3], radii: [f64; 3], density: f64) -> Ellipsoid {
    Ellipsoid {
        center,
        radii,
        density,
    }
}

/// Parts of the head from the outside to the inside: where they overlap, the later one counts.
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

/// Points per axis of a voxel whose mean is its value.
const POINTS: usize = 3;
/// Length field of the array's header: with the ten bytes before it, the header ends at a multiple of 64 bytes.
const HEADER_LENGTH: u16 = 118;

/// Arguments of `scan-phantom`.
#[derive(clap::Args)]
#[command(after_long_help = "\
Example:
  cargo run --release --example tools -- scan-phantom scenes/volumes/head.npy")]
pub(crate) struct Arguments {
    /// The .npy file to write
    #[arg(value_name = "OUT.npy")]
    output: PathBuf,
}

/// Writes the file.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    let path = &arguments.output;
    fs::write(path, to_bytes()).map_err(|error| {
        format!(
            "{}: cannot be written ({error}): choose another place",
            path.display()
        )
    })
}

/// Returns the array as a `.npy` file.
fn to_bytes() -> Vec<u8> {
    let description =
        format!("{{'descr': '|u1', 'fortran_order': False, 'shape': ({SIDE}, {SIDE}, {SIDE}), }}");
    // Magic number, version, length; the header ends with a line feed.
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(HEADER_LENGTH.to_le_bytes());
    let width = usize::from(HEADER_LENGTH) - 1;
    bytes.extend(format!("{description:<width$}\n").bytes());
    let voxel = |i: usize| [i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE];
    bytes.extend((0..SIDE * SIDE * SIDE).map(|i| voxel_mean(voxel(i))));
    bytes
}

/// Returns the mean density over a voxel.
fn voxel_mean(voxel: [usize; 3]) -> u8 {
    let mut sum = 0.0;
    for i in 0..POINTS * POINTS * POINTS {
        let part = [i % POINTS, i / POINTS % POINTS, i / POINTS / POINTS];
        let at = |axis: usize| {
            let fine = (voxel[axis] * POINTS + part[axis]) as f64 + 0.5;
            2.0 * fine / (SIDE * POINTS) as f64 - 1.0
        };
        sum += density(DVec3::new(at(0), at(1), at(2)));
    }
    (sum / (POINTS * POINTS * POINTS) as f64).round() as u8
}

/// Returns the density at a point.
fn density(p: DVec3) -> f64 {
    if p.x > 0.0 && p.y > 0.25 && p.z > 0.0 {
        // Cut away, so that the inside is seen.
        return 0.0;
    }
    let holds = |e: &&Ellipsoid| {
        let q = (p - DVec3::from_array(e.center)) / DVec3::from_array(e.radii);
        q.length_squared() < 1.0
    };
    HEAD.iter().rev().find(holds).map_or(0.0, |e| e.density)
}
