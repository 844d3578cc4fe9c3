//! Commands of the program, run as processes.

mod ablation;
mod automatic_backend;
mod bench;
mod compare;
mod compare_stats;
mod disabled_effect_cost;
mod display;
mod gltf_flags;
mod info;
mod manual;
mod output;
mod progress;
mod render;
mod render_stats;
mod tev;
mod verify;
mod verify_scene;
mod view;
