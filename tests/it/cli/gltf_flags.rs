//! Tests of flags of how glTF files are loaded: `--strict` and `--variant`, and the list of extensions.

use std::path::Path;

use serde_json::{Value, json};

use crate::support::cli_program::{fails_with, whit};

/// Writes a triangle with two materials by variants and an extension of each kind of support.
fn write_file(folder: &Path) -> String {
    let variants = "KHR_materials_variants";
    let mappings = json!([{"material": 1, "variants": [1]}]);
    let root = json!({
        "asset": {"version": "2.0"},
        "extensionsUsed": [variants, "KHR_materials_subsurface", "KHR_xmp_json_ld"],
        "extensions": {variants: {"variants": [{"name": "red"}, {"name": "blue"}]}},
        "nodes": [{"mesh": 0}],
        "materials": [{"name": "paint"}, {"name": "varnish"}],
        "meshes": [{"primitives": [
            {"attributes": {"POSITION": 0}, "material": 0, "extensions": {variants: {"mappings": mappings}}}
        ]}],
        "accessors": [{"bufferView": 0, "componentType": 5121, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 9}],
        "buffers": [{"byteLength": 9, "uri": "data:;base64,AAAAAQAAAAEA"}]
    });
    let path = folder.join("triangle.gltf");
    std::fs::write(&path, root.to_string()).unwrap();
    path.display().to_string()
}

#[test]
fn info_lists_extensions_and_variants() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_file(folder.path());
    let run = whit(&["info", &file]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    for line in [
        "variants       red, blue",
        "extension      KHR_materials_subsurface (ignored: light does not scatter inside materials)",
        "extension      KHR_materials_variants (honoured)",
        "extension      KHR_xmp_json_ld (without effect on images)",
    ] {
        assert!(run.stdout.lines().any(|l| l == line), "{line}: {}", run.stdout);
    }
    let run = whit(&["info", "--json", &file]);
    let info: Value = serde_json::from_str(&run.stdout).unwrap();
    let subsurface = json!({"name": "KHR_materials_subsurface", "is_required": false,
        "support": {"kind": "ignored", "note": "light does not scatter inside materials"}});
    assert_eq!(info["extensions"][0], subsurface);
}

#[test]
fn strict_loading_and_unknown_variants_are_errors_of_the_input() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_file(folder.path());
    let image = folder.path().join("out.png").display().to_string();
    let words = "variant `green` does not exist; the file has `red`, `blue`";
    fails_with(2, words, &["render", &file, "-o", &image, "--variant", "green"]);
    let words = "(KHR_materials_subsurface): render it without `--strict`";
    fails_with(2, words, &["render", &file, "-o", &image, "--strict"]);
    assert!(!Path::new(&image).exists());
}

#[test]
fn variant_chooses_the_material() {
    let folder = tempfile::tempdir().unwrap();
    let file = write_file(folder.path());
    for (flags, name) in [
        (&[][..], "paint"),
        (&["--variant", "red"], "paint"),
        (&["--variant", "blue"], "varnish"),
    ] {
        let run = whit(&[&["info", "--json", &file], flags].concat());
        let info: Value = serde_json::from_str(&run.stdout).unwrap();
        assert_eq!(info["material_list"][0]["name"], name, "{flags:?}");
    }
}

#[test]
fn files_outside_of_the_folder_need_permission() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("models");
    std::fs::create_dir(&inner).unwrap();
    let root = json!({
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": "../corners.bin"}]
    });
    let corners: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let bytes: Vec<u8> = corners.into_iter().flat_map(f32::to_le_bytes).collect();
    std::fs::write(folder.path().join("corners.bin"), bytes).unwrap();
    let file = inner.join("triangle.gltf").display().to_string();
    std::fs::write(&file, root.to_string()).unwrap();
    fails_with(2, "allow others by `--allow-outside`", &["info", &file]);
    let run = whit(&["info", &file, "--allow-outside"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
}
