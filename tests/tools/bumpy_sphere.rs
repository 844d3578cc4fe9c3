//! Writes a benchmark mesh of any size: a closed, displaced sphere above a ground plane, with one point light and a
//! camera, as `.glb`.
//!
//! ```text
//! cargo run --release --example bumpy-sphere -- --triangles 2000000 bumpy.glb
//! ```
//!
//! The sphere is a cube of n by n squares a face, blown up: its vertices are shared across all edges, so it is closed,
//! it has no poles, and no triangle is degenerate. `--mirror` makes it a perfect mirror.

mod glb;

use std::f64::consts::FRAC_PI_4;
use std::path::PathBuf;
use std::process::ExitCode;

use glb::{Mesh, Part, Picture, Vector, dot, normalized};

/// Bumps: direction and frequency of a plane wave, and its height. Few enough to be quick, with no common period.
const WAVES: [(Vector, f64); 6] = [
    ([4.1, 1.7, -2.3], 0.022),
    ([-2.9, 5.3, 3.1], 0.016),
    ([7.9, -6.1, 4.7], 0.010),
    ([-11.3, 3.7, 13.9], 0.006),
    ([19.1, 23.3, -9.7], 0.0035),
    ([-31.7, -17.9, 37.1], 0.002),
];
/// Half the edge of the ground plane.
const GROUND: f64 = 6.0;
/// Height of the ground: under the lowest bump.
const GROUND_HEIGHT: f64 = -1.02;
/// A `.glb` counts its bytes in 32 bits; this many triangles stay under that.
const MOST_TRIANGLES: u64 = 150_000_000;

struct Arguments {
    triangles: u64,
    mirror: bool,
    output: PathBuf,
}

fn main() -> ExitCode {
    let result = parse_arguments(std::env::args().skip(1))
        .and_then(|arguments| picture(&arguments).write(&arguments.output));
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(sentence) => {
            eprintln!("{sentence}");
            ExitCode::from(2)
        }
    }
}

fn parse_arguments(mut words: impl Iterator<Item = String>) -> Result<Arguments, String> {
    const USAGE: &str = "usage: bumpy-sphere [--triangles N] [--mirror] OUT.glb";
    let mut triangles = 2_000_000;
    let mut mirror = false;
    let mut output = None;
    while let Some(word) = words.next() {
        match word.as_str() {
            "--triangles" => {
                let number = words.next().and_then(|n| n.replace('_', "").parse().ok());
                triangles = number
                    .filter(|n| (12..=MOST_TRIANGLES).contains(n))
                    .ok_or(format!(
                        "--triangles takes a number from 12 to {MOST_TRIANGLES}: {USAGE}"
                    ))?;
            }
            "--mirror" => mirror = true,
            _ if word.starts_with('-') => return Err(format!("`{word}` is not an option: {USAGE}")),
            _ if output.is_some() => return Err(format!("`{word}` is one file too many: {USAGE}")),
            _ => output = Some(PathBuf::from(word)),
        }
    }
    Ok(Arguments {
        triangles,
        mirror,
        output: output.ok_or(format!("no file to write: {USAGE}"))?,
    })
}

fn picture(arguments: &Arguments) -> Picture {
    let edge = ((arguments.triangles as f64 / 12.0).sqrt().round() as u32).max(1);
    let (color, metallic, roughness) = if arguments.mirror {
        ([0.95, 0.93, 0.88], 1.0, 0.0)
    } else {
        ([0.80, 0.42, 0.25], 0.0, 0.6)
    };
    let sphere = Part {
        name: "bumpy sphere",
        mesh: Sphere::tessellated(edge),
        color,
        metallic,
        roughness,
    };
    let ground = Part {
        name: "ground",
        mesh: ground(),
        color: [0.45, 0.50, 0.55],
        metallic: 0.0,
        roughness: 0.9,
    };
    Picture {
        parts: vec![sphere, ground],
        eye: [1.1, 1.3, 3.9],
        target: [0.05, -0.12, 0.0],
        lamp: [2.6, 3.6, 3.2],
        intensity: 75.0,
    }
}

/// The lattice points of the surface of a cube of `edge` squares an edge, numbered.
struct Sphere {
    edge: u32,
}

impl Sphere {
    /// All vertices and triangles.
    fn tessellated(edge: u32) -> Mesh {
        let sphere = Sphere { edge };
        let mut mesh = Mesh::default();
        sphere.for_each_point(|point| {
            let (position, normal) = bumpy(sphere.direction(point));
            mesh.push_vertex(position);
            mesh.push_normal(normal);
        });
        // Each face by its fixed axis and side; the other two axes follow in cyclic order, so that u x v points along
        // the axis and the winding is outward on the far side.
        for axis in 0..3 {
            for far in [false, true] {
                for v in 0..edge {
                    for u in 0..edge {
                        let corner = |du: u32, dv: u32| {
                            let mut point = [0; 3];
                            point[axis] = if far { edge } else { 0 };
                            point[(axis + 1) % 3] = u + du;
                            point[(axis + 2) % 3] = v + dv;
                            sphere.number(point)
                        };
                        let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                        let (first, second) = ([a, b, c], [a, c, d]);
                        let turned = |[a, b, c]: [u32; 3]| if far { [a, b, c] } else { [a, c, b] };
                        mesh.push_triangle(turned(first));
                        mesh.push_triangle(turned(second));
                    }
                }
            }
        }
        mesh
    }

    /// Every surface point once, in the order of [`Sphere::number`].
    fn for_each_point(&self, mut visit: impl FnMut([u32; 3])) {
        let n = self.edge;
        for z in [0, n] {
            for y in 0..=n {
                for x in 0..=n {
                    visit([x, y, z]);
                }
            }
        }
        for z in 1..n {
            (0..n).for_each(|i| visit([i, 0, z]));
            (0..n).for_each(|i| visit([n, i, z]));
            (0..n).for_each(|i| visit([n - i, n, z]));
            (0..n).for_each(|i| visit([0, n - i, z]));
        }
    }

    /// The number of a surface point: bottom, top, then rings around the sides.
    fn number(&self, [x, y, z]: [u32; 3]) -> u32 {
        let n = self.edge;
        let lid = (n + 1) * (n + 1);
        if z == 0 {
            return y * (n + 1) + x;
        }
        if z == n {
            return lid + y * (n + 1) + x;
        }
        let around = if y == 0 && x < n {
            x
        } else if x == n && y < n {
            n + y
        } else if y == n && x > 0 {
            2 * n + (n - x)
        } else {
            3 * n + (n - y)
        };
        2 * lid + (z - 1) * 4 * n + around
    }

    /// The direction of a surface point; the tangent evens out the triangles.
    fn direction(&self, point: [u32; 3]) -> Vector {
        let warped = point.map(|i| (FRAC_PI_4 * (2.0 * f64::from(i) / f64::from(self.edge) - 1.0)).tan());
        normalized(warped)
    }
}

/// Point and normal of the surface p = r(d) d: the normal is r d minus the tangential gradient of r.
fn bumpy(d: Vector) -> (Vector, Vector) {
    let mut radius = 1.0;
    let mut gradient = [0.0; 3];
    for (k, height) in WAVES {
        let phase = dot(k, d);
        radius += height * phase.sin();
        for axis in 0..3 {
            gradient[axis] += height * phase.cos() * k[axis];
        }
    }
    let along = dot(gradient, d);
    let normal = [0, 1, 2].map(|axis| radius * d[axis] - (gradient[axis] - along * d[axis]));
    (d.map(|x| radius * x), normalized(normal))
}

fn ground() -> Mesh {
    let mut mesh = Mesh::default();
    for [x, z] in [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]] {
        mesh.push_vertex([GROUND * x, GROUND_HEIGHT, GROUND * z]);
        mesh.push_normal([0.0, 1.0, 0.0]);
    }
    mesh.push_triangle([0, 1, 2]);
    mesh.push_triangle([0, 2, 3]);
    mesh
}
