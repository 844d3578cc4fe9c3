//! The subcommand `bumpy-sphere`: writes a benchmark mesh of any size, a closed, displaced sphere above a ground plane,
//! with one point light and a camera, as `.glb`. The sphere is `whit::mesh::bumpy_sphere`.

use std::path::PathBuf;

use crate::glb::{GlbScene, Mesh, Part};

/// Half the edge of the ground plane.
const GROUND: f64 = 6.0;
/// Height of the ground: below the lowest point of the sphere.
const GROUND_HEIGHT: f64 = -1.02;
/// Fewest triangles that `whit::mesh::bumpy_sphere` makes a closed sphere of.
const MIN_TRIANGLES: u64 = 12;
/// A `.glb` counts its bytes in 32 bits; this many triangles stay below that.
const MAX_TRIANGLES: u64 = 150_000_000;

/// Arguments of `bumpy-sphere`.
#[derive(clap::Args)]
#[command(after_long_help = "Example:
  cargo run --release --example tools -- bumpy-sphere --triangles 2_000_000 bumpy.glb")]
pub(crate) struct Arguments {
    /// About how many triangles the sphere has: 12 to 150_000_000, `_` between digits allowed
    #[arg(long, value_name = "N", default_value = "2_000_000", value_parser = triangle_count)]
    triangles: u64,

    /// Make the sphere a perfect mirror
    #[arg(long)]
    mirror: bool,

    /// The .glb file to write
    #[arg(value_name = "OUT.glb")]
    output: PathBuf,
}

/// Parses a number of triangles.
fn triangle_count(text: &str) -> Result<u64, String> {
    text.replace('_', "")
        .parse()
        .ok()
        .filter(|count| (MIN_TRIANGLES..=MAX_TRIANGLES).contains(count))
        .ok_or_else(|| format!("give a number from {MIN_TRIANGLES} to {MAX_TRIANGLES}"))
}

/// Writes the file.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    scene(arguments).write(&arguments.output)
}

/// Returns the sphere above the ground with light and camera.
fn scene(arguments: &Arguments) -> GlbScene {
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
    GlbScene {
        parts: vec![sphere, ground],
        eye: [1.1, 1.3, 3.9],
        target: [0.05, -0.12, 0.0],
        light: [2.6, 3.6, 3.2],
        intensity: 75.0,
    }
}

/// Returns the sphere that `whit bench --sweep` measures too.
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

/// Returns the ground plane.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangle_counts_have_limits_and_may_have_underscores() {
        for (text, count) in [("12", 12), ("2_000_000", 2_000_000), ("150000000", 150_000_000)] {
            assert_eq!(triangle_count(text), Ok(count));
        }
        for text in ["", "_", "11", "-12", "12.5", "150_000_001", "1e6"] {
            assert!(triangle_count(text).is_err(), "{text}");
        }
    }
}
