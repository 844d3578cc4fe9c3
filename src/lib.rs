//! A Whitted-style ray tracer for glTF meshes and analytic shapes.

pub mod accel;
pub mod cli;
pub mod gltf;
pub mod image;
pub mod mesh;
pub mod numeric;
pub mod render;
pub mod report;
pub mod scene;
pub mod shading;
pub mod shape;
