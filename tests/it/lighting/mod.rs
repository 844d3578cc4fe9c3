//! Light and materials against closed forms and published formulas.

mod area_light_render;
mod area_light_sampling;
mod camera_formula;
mod caustics;
mod caustics_cost;
mod caustics_photons;
mod combined_sampling;
mod emissive_objects;
mod interreflection;
mod layered_materials;
mod many_lights;
mod mip_filtering;
mod motion_render;
mod optics_render;
mod radiosity;
mod rough_render;
mod subsurface_render;
mod textbook_paths;
mod volumes;
