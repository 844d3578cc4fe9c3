//! A Whitted-style ray tracer for glTF meshes and analytic shapes.
//!
//! Camera rays, shadow rays, recursive reflection and refraction; hits are found by the system's Embree or by an
//! axis-aligned BSP tree of our own, and the two check each other. All shading, shadow and recursion logic is Rust.
//!
//! # The way of the data
//!
//! 1. [`gltf::load`] or [`scene_file::load`] turns a file into a [`scene::Scene`]: checked, flattened, recentred.
//! 2. [`accel::build`] makes the structure that answers two questions about packets of sixteen rays: what is hit
//!    first, and is anything hit at all.
//! 3. [`render::render`] sends waves of packets through it, tile by tile, and sums what comes back.
//! 4. [`image`] writes the picture.
//!
//! Rooms know only those before them: `parallel` · [`numeric`] · [`shape`] [`mesh`] [`optics`] [`volume`] [`image`] ·
//! [`scene`] · [`shading`] · [`gltf`] [`accel`] · [`scene_file`] · [`jobs`] [`render`] · [`batch`] [`cost`] [`verify`]
//! [`watch`] · [`report`] · [`cli`].
//!
//! `unsafe` is found in three places: `accel/embree`, which talks to C; `embree-sys`, which declares it; and the one
//! function of `gltf/map.rs` that maps a file into memory.
//!
//! # A whole program
//!
//! ```no_run
//! use std::path::Path;
//! use std::sync::atomic::AtomicBool;
//!
//! use whit::accel::{self, AccelOptions, Backend};
//! use whit::gltf::LoadOptions;
//! use whit::image::{ImageFormat, ToneMap};
//! use whit::render::{Monitor, RenderSettings};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scene = whit::gltf::load(Path::new("scenes/first_light.gltf"), &LoadOptions::default())?;
//! let accel = accel::build(&scene, Backend::default(), &AccelOptions::default())?;
//! let settings = RenderSettings { width: 640, height: 480, spp: 16, ..RenderSettings::default() };
//! let monitor = Monitor { progress: &|_| {}, cancel: &AtomicBool::new(false), tiles: None };
//! let rendering = whit::render::render(&scene, &scene.cameras[0], &*accel, &settings, &monitor)
//!     .expect("nobody cancels it");
//! whit::image::write(&rendering.image, Path::new("out.png"), ImageFormat::Png, ToneMap::default())?;
//! # Ok(())
//! # }
//! ```

pub mod accel;
pub mod batch;
pub mod cli;
pub mod cost;
pub mod gltf;
pub mod image;
pub mod jobs;
pub mod mesh;
pub mod numeric;
pub mod optics;
mod parallel;
pub mod render;
pub mod report;
pub mod scene;
pub mod scene_file;
pub mod shading;
pub mod shape;
pub mod verify;
pub mod volume;
pub mod watch;
