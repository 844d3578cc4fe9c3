//! What several modules of tests share: the recursive reference renderer and the scenes that it is run on, random
//! scenes and rays, the program as users run it, and readers of what it writes.

pub mod approx;
pub mod bodies;
pub mod browser;
pub mod checkerboards;
pub mod clear_scenes;
pub mod cli_program;
pub mod cones;
pub mod exr_tools;
pub mod hits;
pub mod lamp_scenes;
pub mod meshes;
pub mod naive;
pub mod normals;
pub mod optical_bench;
pub mod patterns;
pub mod picture_error;
pub mod pictures;
pub mod random_scenes;
pub mod referee;
pub mod referee_clear;
pub mod referee_textures;
pub mod sampling_scenes;
pub mod scene_folder;
pub mod scenes;
pub mod shapes;
pub mod surface;
pub mod texels;
pub mod textbook;
pub mod texture_scenes;
pub mod torus;
pub mod verdict;
pub mod wave_scenes;
