//! The subcommand `bench-meshes`: writes meshes that are hard on structures over triangles, each as a `.glb` with a point
//! light and a camera, into a folder.
//!
//! `city.glb`: houses with storeys, ledges and window frames, each a box of its own. `mixed.glb`: boxes of all sizes from
//! a thousandth to a half, rotated against the axes. `hair.glb`: strands whose thickness is a seven-hundredth of their
//! length. `fans.glb`: cylinders of 400 sides, whose lids are fans of slivers.

use std::f64::consts::TAU;
use std::path::PathBuf;

use crate::glb::{GlbScene, Mesh, Part, Vector, cross, normalized};

/// Arguments of `bench-meshes`.
#[derive(clap::Args)]
#[command(after_long_help = "\
city.glb: houses of boxes. mixed.glb: boxes of all sizes. hair.glb: thin strands. fans.glb: cylinders whose lids are
fans of slivers.

Example:
  cargo run --release --example tools -- bench-meshes meshes")]
pub(crate) struct Arguments {
    /// The folder to write into; it is made if there is none
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
}

/// Writes all meshes and prints their triangle counts.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    let folder = &arguments.folder;
    std::fs::create_dir_all(folder).map_err(|e| {
        format!(
            "{}: cannot be created ({e}): choose another folder",
            folder.display()
        )
    })?;
    let meshes: [(&'static str, Mesh, Vector, Vector); 4] = [
        ("city", city(), [14.0, 11.0, 34.0], [0.0, 3.0, 0.0]),
        ("mixed", mixed(), [1.5, 2.0, 6.0], [0.0; 3]),
        ("hair", hair(), [1.0, 1.5, 5.5], [0.0; 3]),
        ("fans", fans(), [1.5, 2.0, 6.0], [0.0; 3]),
    ];
    for (name, mesh, eye, target) in meshes {
        println!("{name}.glb: {} triangles", mesh.triangle_count());
        let distance = eye.into_iter().fold(0.0, f64::max);
        let scene = GlbScene {
            parts: vec![Part {
                name,
                mesh,
                color: [0.80, 0.42, 0.25],
                metallic: 0.0,
                roughness: 0.6,
            }],
            eye,
            target,
            light: [0.7 * distance, distance, 0.9 * distance],
            intensity: 6.0 * distance * distance,
        };
        scene.write(&folder.join(format!("{name}.glb")))?;
    }
    Ok(())
}

/// Random number generator, seeded: SplitMix64 (Steele, Lea and Flood 2014).
struct SplitMix64(u64);

impl SplitMix64 {
    /// Returns a number in [0, 1).
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns a number in [low, high).
    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Returns a direction, uniform on the unit sphere.
    fn direction(&mut self) -> Vector {
        let (z, turn) = (self.within(-1.0, 1.0), TAU * self.unit());
        let r = (1.0 - z * z).sqrt();
        [r * turn.cos(), r * turn.sin(), z]
    }
}

/// Adds a closed box from `low` to `high`, whose corners are transformed by `map`.
fn push_box(mesh: &mut Mesh, low: Vector, high: Vector, map: impl Fn(Vector) -> Vector) {
    let first = mesh.vertex_count();
    for corner in 0..8 {
        let side = |axis: usize| if corner >> axis & 1 == 0 { low } else { high }[axis];
        mesh.push_vertex(map([side(0), side(1), side(2)]));
    }
    for [a, b, c, d] in [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ] {
        for triangle in [[a, b, c], [a, c, d]] {
            mesh.push_triangle(triangle.map(|corner| first + corner));
        }
    }
}

/// Returns houses of 4 to 39 storeys, 16 by 16 of them, with eleven window frames a storey on each of four sides.
fn city() -> Mesh {
    let (mut mesh, mut random) = (Mesh::default(), SplitMix64(1));
    let mut add = |low: Vector, high: Vector| push_box(&mut mesh, low, high, |p| p);
    add([-60.0, -0.2, -60.0], [60.0, -0.05, 60.0]);
    for house in 0..256 {
        let [x, z] = [house % 16, house / 16].map(|i| 3.0 * f64::from(i) - 24.0);
        let storeys = 4 + (36.0 * random.unit()) as u32;
        add([x, 0.0, z], [x + 2.0, 0.3 * f64::from(storeys), z + 2.0]);
        for storey in 0..storeys {
            let y = 0.3 * f64::from(storey);
            let top = y + 0.28;
            for frame in 0..11 {
                let [a, b] = [-0.02, 0.02].map(|half| 0.2 * f64::from(frame) + half);
                add([x + a, y, z - 0.05], [x + b, top, z]);
                add([x + a, y, z + 2.0], [x + b, top, z + 2.05]);
                add([x - 0.05, y, z + a], [x, top, z + b]);
                add([x + 2.0, y, z + a], [x + 2.05, top, z + b]);
            }
            add([x - 0.06, y - 0.02, z - 0.06], [x + 2.06, y + 0.02, z + 2.06]);
        }
    }
    mesh
}

/// Returns 84,000 small boxes and 300 larger ones in a cube.
fn mixed() -> Mesh {
    let (mut mesh, mut random) = (Mesh::default(), SplitMix64(2));
    let rotated = |[x, y, z]: Vector| {
        [
            0.8 * x + 0.36 * y + 0.48 * z,
            -0.6 * x + 0.48 * y + 0.64 * z,
            -0.8 * y + 0.6 * z,
        ]
    };
    for number in 0..84_300 {
        let largest = if number < 300 { -0.3 } else { -1.1 };
        let size = 0.3 * 10f64.powf(random.within(-3.0, largest));
        let center = [(); 3].map(|()| random.within(-2.0, 2.0));
        let half = [(); 3].map(|()| size * random.within(0.2, 1.0));
        let at = |sign: f64| [0, 1, 2].map(|axis| center[axis] + sign * half[axis]);
        push_box(&mut mesh, at(-1.0), at(1.0), rotated);
    }
    mesh
}

/// Number of strands.
const STRANDS: u32 = 40_000;
/// Pieces of a strand, each a prism of three sides.
const PIECES: u32 = 8;

/// Returns curled strands on the unit sphere.
fn hair() -> Mesh {
    let (mut mesh, mut random) = (Mesh::default(), SplitMix64(3));
    for _ in 0..STRANDS {
        let root = random.direction();
        let [lean, curl] = [random.direction(), random.direction()];
        let along = [0, 1, 2].map(|i| root[i] + 0.5 * lean[i]);
        let aside = normalized(cross(along, [0.3, 0.5, 0.8]));
        let other = normalized(cross(along, aside));
        let first = mesh.vertex_count();
        for piece in 0..=PIECES {
            let s = f64::from(piece) / f64::from(PIECES);
            for corner in 0..3 {
                let (sine, cosine) = (TAU * f64::from(corner) / 3.0).sin_cos();
                mesh.push_vertex([0, 1, 2].map(|i| {
                    let middle = root[i] + s * along[i] + 0.3 * s * s * curl[i];
                    middle + 0.0015 * (cosine * aside[i] + sine * other[i])
                }));
            }
        }
        let at = |piece: u32, corner: u32| first + 3 * piece + corner % 3;
        for piece in 0..PIECES {
            for corner in 0..3 {
                let [a, b] = [at(piece, corner), at(piece, corner + 1)];
                let [c, d] = [at(piece + 1, corner + 1), at(piece + 1, corner)];
                mesh.push_triangle([a, b, c]);
                mesh.push_triangle([a, c, d]);
            }
        }
        mesh.push_triangle([at(0, 0), at(0, 2), at(0, 1)]);
        mesh.push_triangle([at(PIECES, 0), at(PIECES, 1), at(PIECES, 2)]);
    }
    mesh
}

/// Number of cylinders.
const CYLINDERS: u32 = 750;
/// Sides of a cylinder.
const SIDES: u32 = 400;

/// Returns closed cylinders in a cube.
fn fans() -> Mesh {
    let (mut mesh, mut random) = (Mesh::default(), SplitMix64(4));
    for _ in 0..CYLINDERS {
        let center = [(); 3].map(|()| random.within(-2.0, 2.0));
        let (radius, half) = (random.within(0.03, 0.25), random.within(0.05, 0.5));
        let axis = random.direction();
        let aside = normalized(cross(axis, random.direction()));
        let other = cross(axis, aside);
        let place =
            |x: f64, y: f64, z: f64| [0, 1, 2].map(|i| center[i] + x * aside[i] + y * other[i] + z * axis[i]);
        let first = mesh.vertex_count();
        for z in [-half, half] {
            for side in 0..SIDES {
                let (sine, cosine) = (TAU * f64::from(side) / f64::from(SIDES)).sin_cos();
                mesh.push_vertex(place(radius * cosine, radius * sine, z));
            }
        }
        let [bottom, top] = [-half, half].map(|z| mesh.push_vertex(place(0.0, 0.0, z)));
        for side in 0..SIDES {
            let [a, b] = [side, (side + 1) % SIDES].map(|side| first + side);
            mesh.push_triangle([a, b, b + SIDES]);
            mesh.push_triangle([a, b + SIDES, a + SIDES]);
            mesh.push_triangle([b, a, bottom]);
            mesh.push_triangle([a + SIDES, b + SIDES, top]);
        }
    }
    mesh
}
