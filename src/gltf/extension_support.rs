//! Treatment of each extension of glTF: honoured, approximated, without effect on images, or ignored.
//!
//! Names and meanings follow the registry of the Khronos Group
//! (<https://github.com/KhronosGroup/glTF/tree/main/extensions>).

use super::document::GltfDocument;
use super::{GltfError, UnsupportedExtensions};
use crate::scene::{ExtensionSupport, ExtensionUse};

/// Returns how an extension is treated.
fn support(name: &str) -> ExtensionSupport {
    match name {
        "EXT_mesh_gpu_instancing"
        | "EXT_meshopt_compression"
        | "EXT_texture_webp"
        | "KHR_draco_mesh_compression"
        | "KHR_lights_punctual"
        | "KHR_materials_anisotropy"
        | "KHR_materials_clearcoat"
        | "KHR_materials_diffuse_transmission"
        | "KHR_materials_dispersion"
        | "KHR_materials_emissive_strength"
        | "KHR_materials_ior"
        | "KHR_materials_iridescence"
        | "KHR_materials_pbrSpecularGlossiness"
        | "KHR_materials_specular"
        | "KHR_materials_transmission"
        | "KHR_materials_unlit"
        | "KHR_materials_variants"
        | "KHR_materials_volume"
        | "KHR_mesh_primitive_restart"
        | "KHR_mesh_quantization"
        | "KHR_meshopt_compression"
        | "KHR_node_visibility"
        | "KHR_texture_transform" => ExtensionSupport::Honoured,
        "KHR_texture_basisu" if cfg!(feature = "basisu") => ExtensionSupport::Honoured,
        "KHR_materials_sheen" => {
            ExtensionSupport::Approximated("its fibres reflect lights and the environment, but no objects")
        }
        "KHR_materials_volume_scatter" => ExtensionSupport::Approximated(
            "light that diffuse transmission lets in scatters by diffusion; clear interiors do not scatter",
        ),
        // Metadata, interaction, sound, physics, and structures for programs that edit or stream. Of levels of detail
        // the finest is rendered; primitives that another one with restart indices may replace are rendered themselves.
        "AGI_articulations"
        | "AGI_stk_metadata"
        | "CESIUM_primitive_outline"
        | "EXT_implicit_tiling"
        | "EXT_instance_features"
        | "EXT_mesh_features"
        | "EXT_mesh_manifold"
        | "EXT_mesh_primitive_restart"
        | "EXT_structural_metadata"
        | "FB_geometry_metadata"
        | "FB_ngon_encoding"
        | "GODOT_single_root"
        | "GRIFFEL_bim_data"
        | "KHR_audio"
        | "KHR_audio_emitter"
        | "KHR_implicit_shapes"
        | "KHR_interactivity"
        | "KHR_node_hoverability"
        | "KHR_node_selectability"
        | "KHR_physics_rigid_bodies"
        | "KHR_xmp"
        | "KHR_xmp_json_ld"
        | "MPEG_accessor_timed"
        | "MPEG_audio_spatial"
        | "MPEG_buffer_circular"
        | "MPEG_media"
        | "MSFT_lod"
        | "MSFT_packing_normalRoughnessMetallic"
        | "MSFT_packing_occlusionRoughnessMetallic"
        | "OMI_physics_body"
        | "OMI_physics_shape" => ExtensionSupport::WithoutEffect,
        _ => ExtensionSupport::Ignored(loss(name)),
    }
}

/// Returns what an image lacks without the extension.
fn loss(name: &str) -> &'static str {
    match name {
        "KHR_materials_subsurface" => "light does not scatter inside materials",
        "KHR_animation_pointer" => "only nodes and morph targets are animated",
        "KHR_texture_basisu" => {
            "this program was built without the feature `basisu`; textures use their PNG or JPEG image, or are left out"
        }
        "EXT_texture_avif" | "MSFT_texture_dds" | "EXT_texture_astc" => {
            "textures use their PNG or JPEG image, or are left out"
        }
        "EXT_lights_image_based" | "KHR_lights_environment" => "the environment light is left out",
        "EXT_lights_ies" => "lights emit alike in all directions of their cone",
        "KHR_gaussian_splatting" => "splats are left out",
        _ if name.contains("_materials_") => "materials are rendered without it",
        _ if name.contains("_lights_") => "lights are left out or simplified",
        _ => "what it means is not known",
    }
}

/// Returns the name of a required extension, with the feature of the build that would honour it.
fn with_feature(name: String) -> String {
    match name.as_str() {
        "KHR_texture_basisu" => format!("{name}, which needs a build with `--features basisu`"),
        _ => name,
    }
}

impl GltfDocument {
    /// Returns whether the largest index separates strips and fans: `KHR_mesh_primitive_restart`.
    pub(super) fn has_primitive_restart(&self) -> bool {
        self.root
            .extensions_used
            .iter()
            .chain(&self.root.extensions_required)
            .any(|name| name == "KHR_mesh_primitive_restart")
    }

    /// Returns how each extension of the file is treated, sorted by name. Extensions that are ignored are added to
    /// `warnings`.
    ///
    /// # Errors
    /// The file requires an extension that is not implemented; or it uses one that is not fully implemented, and
    /// `unsupported` refuses these.
    pub(super) fn extension_uses(
        &self,
        unsupported: UnsupportedExtensions,
        warnings: &mut Vec<String>,
    ) -> Result<Vec<ExtensionUse>, GltfError> {
        let required = &self.root.extensions_required;
        let mut names: Vec<&String> = self.root.extensions_used.iter().chain(required).collect();
        names.sort();
        names.dedup();
        let use_of = |name: &String| ExtensionUse {
            support: support(name),
            is_required: required.contains(name),
            name: name.clone(),
        };
        let uses: Vec<ExtensionUse> = names.into_iter().map(use_of).collect();
        // Refuse the file for extensions that it cannot be rendered without
        let refused = |is_refused: &dyn Fn(&ExtensionUse) -> bool| -> Vec<String> {
            uses.iter()
                .filter(|&u| is_refused(u))
                .map(|u| u.name.clone())
                .collect()
        };
        let names = refused(&|u| u.is_required && matches!(u.support, ExtensionSupport::Ignored(_)));
        if !names.is_empty() {
            let file = self.file.clone();
            let names = names.into_iter().map(with_feature).collect();
            return Err(GltfError::RequiredExtensions { file, names });
        }
        let names = refused(&|u| !u.support.is_exact());
        if unsupported == UnsupportedExtensions::Refuse && !names.is_empty() {
            let file = self.file.clone();
            return Err(GltfError::InexactExtensions { file, names });
        }
        // Warn about those that are ignored
        for ignored in &uses {
            if let ExtensionSupport::Ignored(loss) = ignored.support {
                let name = &ignored.name;
                warnings.push(format!("the extension {name} is not supported: {loss}"));
            }
        }
        Ok(uses)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use crate::gltf::document::of_json;

    struct UsedExtensions {
        uses: Result<Vec<ExtensionUse>, GltfError>,
        warnings: Vec<String>,
    }

    fn find(used: Value, required: Value, unsupported: UnsupportedExtensions) -> UsedExtensions {
        let root =
            json!({"asset": {"version": "2.0"}, "extensionsUsed": used, "extensionsRequired": required});
        let mut warnings = Vec::new();
        let uses = of_json(&root).extension_uses(unsupported, &mut warnings);
        UsedExtensions { uses, warnings }
    }

    #[test]
    fn only_ignored_extensions_are_warned_about() {
        let used = json!([
            "KHR_xmp_json_ld",
            "KHR_materials_subsurface",
            "KHR_materials_ior",
            "KHR_materials_ior"
        ]);
        let found = find(used, json!([]), UnsupportedExtensions::Warn);
        let support: Vec<ExtensionSupport> = found.uses.unwrap().iter().map(|u| u.support).collect();
        let subsurface = ExtensionSupport::Ignored("light does not scatter inside materials");
        assert_eq!(
            support,
            [
                ExtensionSupport::Honoured,
                subsurface,
                ExtensionSupport::WithoutEffect
            ]
        );
        assert_eq!(
            found.warnings,
            [
                "the extension KHR_materials_subsurface is not supported: light does not scatter inside materials"
            ]
        );
    }

    #[test]
    fn required_extension_without_support_is_an_error() {
        let refused = |used: Value, required: Value, unsupported| {
            find(used, required, unsupported)
                .uses
                .err()
                .map(|e| e.to_string())
        };
        let warn = UnsupportedExtensions::Warn;
        let fault = refused(json!([]), json!(["ABC_secret"]), warn).unwrap();
        assert!(fault.contains("ABC_secret"), "{fault}");
        assert_eq!(refused(json!([]), json!(["KHR_interactivity"]), warn), None);
        // The strict reading refuses extensions that are optional, too
        let strict = UnsupportedExtensions::Refuse;
        let fault = refused(json!(["KHR_materials_subsurface"]), json!([]), strict).unwrap();
        assert!(fault.contains("KHR_materials_subsurface"), "{fault}");
        assert_eq!(
            refused(json!(["KHR_xmp", "KHR_materials_ior"]), json!([]), strict),
            None
        );
    }
}
