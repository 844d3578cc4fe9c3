//! Programs that write files for this project: benchmark meshes, scenes and their assets, contact sheets and tables.
//!
//! ```text
//! cargo run --release --example tools -- help
//! cargo run --release --example tools -- bumpy-sphere --triangles 2000000 bumpy.glb
//! ```

mod bench_meshes;
mod bumpy_sphere;
mod contact_sheet;
mod cost_tables;
mod first_light;
mod gallery;
mod glb;
mod mutate;
mod neon_knot;
mod scan_phantom;
mod scene_textures;

use std::process::ExitCode;

use clap::Parser;

/// Write files for this project: benchmark meshes, scenes and their assets, contact sheets and tables
#[derive(Parser)]
#[command(name = "tools")]
enum Tool {
    /// Write four meshes that are hard on acceleration structures
    BenchMeshes(bench_meshes::Arguments),
    /// Write a closed, displaced sphere of any triangle count above a ground plane
    BumpySphere(bumpy_sphere::Arguments),
    /// Render scenes at a small size and lay them out on one image
    ContactSheet(contact_sheet::Arguments),
    /// Make the tables of what accuracy costs from reports of `whit cost`
    CostTables(cost_tables::Arguments),
    /// Write the scene `scenes/first_light.gltf`
    FirstLight(first_light::Arguments),
    /// Write rows of spheres, each with three images of its own, for times of scenes with many textures
    Gallery(gallery::Arguments),
    /// Load mutations of files, and report each that panics or takes long
    Mutate(mutate::Arguments),
    /// Write the tube of `scenes/glow.toml` as binary glTF
    NeonKnot(neon_knot::Arguments),
    /// Write the volume of `scenes/scan.toml` as a NumPy array
    ScanPhantom(scan_phantom::Arguments),
    /// Write the images that scenes use as textures and backgrounds
    SceneTextures(scene_textures::Arguments),
}

fn main() -> ExitCode {
    let result = match Tool::parse() {
        Tool::BenchMeshes(arguments) => bench_meshes::run(&arguments),
        Tool::BumpySphere(arguments) => bumpy_sphere::run(&arguments),
        Tool::ContactSheet(arguments) => contact_sheet::run(&arguments),
        Tool::CostTables(arguments) => cost_tables::run(&arguments),
        Tool::FirstLight(arguments) => first_light::run(&arguments),
        Tool::Gallery(arguments) => gallery::run(&arguments),
        Tool::Mutate(arguments) => mutate::run(&arguments),
        Tool::NeonKnot(arguments) => neon_knot::run(&arguments),
        Tool::ScanPhantom(arguments) => scan_phantom::run(&arguments),
        Tool::SceneTextures(arguments) => scene_textures::run(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(sentence) => {
            eprintln!("{sentence}");
            ExitCode::from(2)
        }
    }
}
