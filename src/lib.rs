//! A Whitted-style ray tracer for glTF meshes and analytic shapes.
//!
//! Camera rays, shadow rays, recursive reflection and refraction. Hits are found by the system's Embree, or in Rust by a
//! tree for groups of rays or an axis-aligned BSP, and each is checked against the others. All shading, shadow and
//! recursion logic is Rust.
//!
//! # Data flow
//!
//! 1. [`gltf::load`] or [`scene_file::load`] turns a file into a [`scene::Scene`]: checked, flattened into instances, and
//!    moved near the origin.
//! 2. [`accel::build`] builds an [`accel::Accel`], which answers two queries for packets of sixteen rays: nearest hit, and
//!    occlusion.
//! 3. [`render::render`] traces tiles of the image wavefront by wavefront and returns a [`render::Rendering`].
//! 4. [`image`] writes PNG and EXR files.
//!
//! Folders import only earlier ones: `processor_time` `parallel` [`buffer`] · [`manual`] · [`numeric`] · [`shape`] [`mesh`] [`optics`] [`volume`]
//! [`image`] · [`scene`] · [`shading`] · [`gltf`] [`accel`] · [`scene_file`] · [`jobs`] [`render`] · [`batch`]
//! [`measure`] · [`cost`] [`verify`] [`bench`] [`watch`] · [`report`]. `tests/ci/structure.py` checks it. `batch` also has
//! the settings that any image is requested with. Modules that the list of modules below leaves out are the program's own
//! and may change in any version; its command line parses flags, calls them, and prints.
//!
//! `unsafe` code is in three places: `accel/embree`, which calls C, `embree-sys`, which declares it, and
//! `image/denoise/oidn.rs`, which calls a denoiser's library where one is installed.
//!
//! # From glTF to PNG
//!
//! ```no_run
//! use std::path::Path;
//!
//! use whit::accel::{self, AccelOptions, Backend};
//! use whit::gltf::LoadOptions;
//! use whit::image::{ImageFormat, ToneMap};
//! use whit::render::{Monitor, RenderSettings, render};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scene = whit::gltf::load(Path::new("scenes/first_light.gltf"), &LoadOptions::default())?;
//! let scene = scene.validate()?;
//! let accel = accel::build(scene, Backend::default(), &AccelOptions::default())?;
//! let settings = RenderSettings { width: 640, height: 480, spp: 16, ..RenderSettings::default() };
//! let rendering = render(scene, &scene.cameras[0], &*accel, &settings, &Monitor::default())?;
//! whit::image::write(&rendering.image, Path::new("out.png"), ImageFormat::Png, ToneMap::default())?;
//! # Ok(())
//! # }
//! ```
//!
//! # A scene in code
//!
//! ```
//! use glam::{DAffine3, DVec3};
//! use whit::accel::{self, AccelOptions, Backend};
//! use whit::render::{Monitor, RenderSettings, render};
//! use whit::scene::{Camera, Geometry, Instance, Material, Scene};
//! use whit::shape::Shape;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scene = Scene {
//!     geometries: vec![Geometry::Shape(Shape::Cube)],
//!     instances: vec![Instance::new("cube", 0, 0, DAffine3::from_translation(DVec3::new(0.0, 0.0, -5.0)))?],
//!     materials: vec![Material { emission: [0.5; 3], ..Material::default() }],
//!     cameras: vec![Camera::default()],
//!     ..Scene::default()
//! };
//! let scene = scene.validate()?;
//! let accel = accel::build(scene, Backend::Bsp, &AccelOptions::default())?;
//! let settings = RenderSettings { width: 32, height: 32, ..RenderSettings::default() };
//! let rendering = render(scene, &scene.cameras[0], &*accel, &settings, &Monitor::default())?;
//! assert_eq!(rendering.image.pixels[16 * 32 + 16], [0.5; 3]);
//! # Ok(())
//! # }
//! ```
//!
//! # Rays through an `Accel`
//!
//! ```
//! use glam::{DAffine3, Vec3};
//! use whit::accel::{self, AccelOptions, Backend, Coherence, RayPacket};
//! use whit::numeric::Ray;
//! use whit::scene::{Geometry, Instance, Material, Scene};
//! use whit::shape::Shape;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scene = Scene {
//!     geometries: vec![Geometry::Shape(Shape::Cube)],
//!     instances: vec![Instance::new("cube", 0, 0, DAffine3::IDENTITY)?],
//!     materials: vec![Material::default()],
//!     ..Scene::default()
//! };
//! let scene = scene.validate()?;
//! let accel = accel::build(scene, Backend::Bsp, &AccelOptions::default())?;
//! let mut packet = [RayPacket::EMPTY];
//! packet[0].set(0, &Ray::new(Vec3::new(0.25, 0.5, 5.0), Vec3::NEG_Z));
//! accel.intersect(&mut packet, Coherence::Incoherent);
//! assert_eq!(packet[0].hit(0).map(|hit| hit.t), Some(4.0));
//! # Ok(())
//! # }
//! ```
//!
//! # Glossary
//!
//! - **AOV**: arbitrary output variable, a further channel of an image such as depth.
//! - **Area light**: light with an extent, which casts soft shadows; an *emissive object* is one that is visible.
//! - **Backend**: what intersects rays with the scene: Embree, the native tree, the BSP, or brute force.
//! - **BSP**: binary space partitioning tree with axis-aligned planes (a k-d tree) over clipped primitives.
//! - **Bounding volume**: box or sphere around an object, tested before it. Flags and keys call it *extent*.
//! - **Camera ray**, **shadow ray**, **secondary ray**: ray from the camera, to a light, or after a bounce.
//! - **Effect**: part of the simulation that a scene may need or not, such as refraction; see [`scene::Effect`].
//! - **Generation**: all rays of equal depth in a wavefront.
//! - **Hit**, **nearest hit**, **occluded**: results of queries.
//! - **Instance**: geometry with a transform and a material.
//! - **Interior**: medium inside a closed dielectric surface; *nested* interiors are ranked by priority.
//! - **Lane**: one of the sixteen rays of a packet in structure-of-arrays layout.
//! - **Packet**: sixteen rays that are traced and shaded together.
//! - **Phong model**: ambient, diffuse and specular terms after Phong with Whitted's recursive terms. Scene files call it
//!   *lecture*.
//! - **Plan**: effects that are simulated, with the reason for each; see [`render::Plan`].
//! - **Profile**: rays, seconds and bytes by effect. The JSON key is *ledger*.
//! - **Radiosity**: light that leaves a diffuse surface; also the method that solves for it on all surfaces at once.
//! - **Spawn**: starting a secondary ray off a surface, by a bound on the rounding error.
//! - **Thin surface**: surface without an interior, such as a soap film or a leaf.
//! - **Throughput**: factor by which radiance at the end of a path contributes to its pixel.
//! - **Tile**: square of 32x32 pixels that one task renders.
//! - **Watertight**: property of a triangle test that lets no ray through shared edges and vertices.
//! - **Wavefront**: breadth-first evaluation of ray trees.

pub mod accel;
#[doc(hidden)]
pub mod batch;
#[doc(hidden)]
pub mod bench;
pub mod buffer;
#[doc(hidden)]
pub mod cost;
pub mod gltf;
pub mod image;
#[doc(hidden)]
pub mod jobs;
pub mod manual;
#[doc(hidden)]
pub mod measure;
pub mod mesh;
pub mod numeric;
#[doc(hidden)]
pub mod optics;
#[doc(hidden)]
pub mod parallel;
mod processor_time;
pub mod render;
#[doc(hidden)]
pub mod report;
pub mod scene;
pub mod scene_file;
#[doc(hidden)]
pub mod shading;
pub mod shape;
#[doc(hidden)]
pub mod verify;
pub mod volume;
#[doc(hidden)]
pub mod watch;
