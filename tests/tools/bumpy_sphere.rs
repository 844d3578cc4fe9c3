//! Writes a benchmark mesh of any size: a closed, displaced sphere above a ground plane, with one point light and a
//! camera, as `.glb`.
//!
//! ```text
//! cargo run --release --example bumpy-sphere -- --triangles 2000000 bumpy.glb
//! ```
//!
//! The sphere is `whit::mesh::bumpy_sphere`. `--mirror` makes it a perfect mirror.

mod glb;

use std::path::PathBuf;
use std::process::ExitCode;

use glb::{Mesh, Part, Picture};

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
    let (color, metallic, roughness) = if arguments.mirror {
        ([0.95, 0.93, 0.88], 1.0, 0.0)
    } else {
        ([0.80, 0.42, 0.25], 0.0, 0.6)
    };
    let sphere = Part {
        name: "bumpy sphere",
        mesh: sphere(arguments.triangles),
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

/// The sphere that `whit bench --sweep` measures too.
fn sphere(triangles: u64) -> Mesh {
    let bumpy = whit::mesh::bumpy_sphere(triangles);
    let mut mesh = Mesh::default();
    for &position in bumpy.positions.iter() {
        mesh.push_vertex(position.map(f64::from));
    }
    for &normal in bumpy.normals.iter().flat_map(|normals| normals.iter()) {
        mesh.push_normal(normal.map(f64::from));
    }
    for &triangle in bumpy.triangles.iter() {
        mesh.push_triangle(triangle);
    }
    mesh
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
