//! Support code that several test modules share: the recursive reference tracer and its scenes, random scenes and rays,
//! runs of the program, and readers of its output.

pub mod approx;
pub mod assets;
pub mod bodies;
pub mod browser;
pub mod checkerboards;
pub mod clear_scenes;
pub mod cli_program;
pub mod cones;
pub mod emissive_scenes;
pub mod exr_tools;
pub mod gltf_lobe;
pub mod hits;
pub mod image_error;
pub mod images;
pub mod meshes;
pub mod naive;
pub mod normals;
pub mod optical_bench;
pub mod patterns;
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
pub mod textbook_paths;
pub mod texture_scenes;
pub mod torus;
pub mod verdict;
pub mod wave_scenes;
