//! Identity of a primitive, and its lookup in the document.

use gltf::json;

use crate::gltf::document::GltfDocument;

/// Identity of a primitive: its mesh, its number in it, and the deformation that is applied to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(in crate::gltf) struct PrimitiveId {
    pub(in crate::gltf) mesh: usize,
    pub(in crate::gltf) primitive: usize,
    pub(in crate::gltf) deformation: Option<usize>,
}

impl GltfDocument {
    /// Returns a primitive's description for messages.
    pub(in crate::gltf) fn primitive_item(&self, id: PrimitiveId) -> String {
        let mesh = &self.root.meshes[id.mesh];
        let name = match &mesh.name {
            Some(name) if !name.is_empty() => format!("mesh {} `{name}`", id.mesh),
            _ => format!("mesh {}", id.mesh),
        };
        if mesh.primitives.len() > 1 {
            format!("{name} primitive {}", id.primitive)
        } else {
            name
        }
    }

    pub(in crate::gltf) fn primitive(&self, id: PrimitiveId) -> &json::mesh::Primitive {
        &self.root.meshes[id.mesh].primitives[id.primitive]
    }
}
