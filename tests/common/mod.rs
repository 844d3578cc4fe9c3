//! What several whole-program tests share: the referee of the renderer and the scenes that it judges.

#![allow(dead_code, unreachable_pub, reason = "each test program uses a part of it")]

pub mod approx;
pub mod hits;
pub mod meshes;
#[cfg(test)]
mod referee;
pub mod surface;
pub mod textbook;
pub mod wave_scenes;
