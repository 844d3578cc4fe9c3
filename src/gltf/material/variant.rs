//! Variants of a model's materials: `KHR_materials_variants`.

use serde_json::{Map, Value};

use crate::gltf::GltfError;
use crate::gltf::document::GltfDocument;
use crate::gltf::mesh::primitive_id::PrimitiveId;

/// Name of the extension.
const NAME: &str = "KHR_materials_variants";

impl GltfDocument {
    /// Returns the names of the variants; a nameless one has its number.
    pub(in crate::gltf) fn variants(&self) -> Vec<String> {
        let extensions = self.root.extensions.as_ref().map(|e| &e.others);
        let variants = member(extensions, "variants");
        let name = |(number, variant): (usize, &Value)| match variant.get("name").and_then(Value::as_str) {
            Some(name) if !name.is_empty() => name.to_owned(),
            _ => number.to_string(),
        };
        variants.iter().enumerate().map(name).collect()
    }

    /// Chooses the variant of this name for all primitives.
    pub(in crate::gltf) fn choose_variant(&mut self, name: &str) -> Result<(), GltfError> {
        let names = self.variants();
        self.variant = names.iter().position(|known| known == name);
        if self.variant.is_some() {
            return Ok(());
        }
        let fault = match names.is_empty() {
            true => "does not exist, because the file has no variants".to_owned(),
            false => format!("does not exist; the file has `{}`", names.join("`, `")),
        };
        Err(self.fault(format!("variant `{name}`"), fault, "choose one of these, or none"))
    }

    /// Returns the number of a primitive's material: that of the chosen variant, else its own.
    pub(in crate::gltf) fn material_number(&self, id: PrimitiveId) -> Option<usize> {
        let primitive = self.primitive(id);
        let own = primitive.material.map(|material| material.value());
        let Some(variant) = self.variant else {
            return own;
        };
        let extensions = primitive.extensions.as_ref().map(|e| &e.others);
        let is_chosen = |mapping: &&Value| {
            let variants = mapping.get("variants").and_then(Value::as_array);
            let mut numbers = variants.into_iter().flatten().filter_map(Value::as_u64);
            numbers.any(|number| number == variant as u64)
        };
        let mapping = member(extensions, "mappings").iter().find(is_chosen);
        let material = mapping.and_then(|mapping| mapping.get("material")?.as_u64());
        material
            .and_then(|material| usize::try_from(material).ok())
            .or(own)
    }
}

/// Returns the elements of a list in the extension's object; none if it is absent.
fn member<'a>(extensions: Option<&'a Map<String, Value>>, name: &str) -> &'a [Value] {
    extensions
        .and_then(|all| all.get(NAME)?.get(name)?.as_array())
        .map_or(&[], Vec::as_slice)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::gltf::document::of_json;

    fn document() -> GltfDocument {
        let mappings = json!([{"material": 1, "variants": [1]}, {"material": 2, "variants": [0, 2]}]);
        of_json(&json!({
            "asset": {"version": "2.0"},
            "extensions": {NAME: {"variants": [{"name": "red"}, {"name": "blue"}, {}, {"name": "bare"}]}},
            "meshes": [{"primitives": [
                {"attributes": {}, "material": 0, "extensions": {NAME: {"mappings": mappings}}}, {"attributes": {}}
            ]}]
        }))
    }

    fn materials(document: &GltfDocument) -> Vec<Option<usize>> {
        let id = |primitive| PrimitiveId {
            mesh: 0,
            primitive,
            deformation: None,
        };
        (0..2)
            .map(|primitive| document.material_number(id(primitive)))
            .collect()
    }

    #[test]
    fn chosen_variant_replaces_the_materials_that_it_maps() {
        let mut document = document();
        assert_eq!(document.variants(), ["red", "blue", "2", "bare"]);
        assert_eq!(materials(&document), [Some(0), None]);
        for (name, material) in [("blue", 1), ("red", 2), ("2", 2), ("bare", 0)] {
            document.choose_variant(name).unwrap();
            assert_eq!(materials(&document), [Some(material), None], "{name}");
        }
    }

    #[test]
    fn unknown_variant_lists_the_known_ones() {
        let fault = document().choose_variant("green").unwrap_err().to_string();
        assert!(
            fault.contains("variant `green` does not exist; the file has `red`, `blue`, `2`, `bare`"),
            "{fault}"
        );
    }
}
