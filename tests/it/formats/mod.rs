//! Tests of file formats that are read and written: glTF, scene files, job files, images.

mod exr_readers;
mod gltf_animation;
mod gltf_anisotropy;
mod gltf_deformation;
mod gltf_extensions;
mod gltf_files;
mod gltf_hostile;
mod gltf_points;
mod lazy_image_decoding;
mod scene_file_errors_material;
mod scene_file_errors_structure;
mod scene_files;
mod scene_images;
