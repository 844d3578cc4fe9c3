//! What several whole-program tests share: the referee of the renderer and the scenes that it judges.

#![allow(dead_code, unreachable_pub, reason = "each test program uses a part of it")]

pub mod approx;
pub mod bodies;
pub mod clear_scenes;
pub mod cones;
pub mod hits;
pub mod meshes;
pub mod normals;
pub mod patterns;
#[cfg(test)]
mod referee;
#[cfg(test)]
mod referee_clear;
#[cfg(test)]
mod referee_textures;
pub mod shapes;
pub mod surface;
pub mod texels;
pub mod textbook;
pub mod texture_scenes;
pub mod torus;
pub mod verdict;
pub mod wave_scenes;
