//! Files that a scene depends on, found without loading the scene.
//!
//! Every string in a scene file, and every `uri` in a glTF file, that names an existing file relative to it counts as a
//! dependency. One file too many only causes a needless re-render, one too few would miss a change. Each file is hashed
//! once.

use std::collections::{BTreeSet, HashMap};
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use percent_encoding::percent_decode_str;

use super::fingerprint::Fingerprint;

/// Cache of file hashes and of dependencies, by path.
#[derive(Debug, Default)]
pub(crate) struct Sources {
    keys: HashMap<PathBuf, Fingerprint>,
    /// Direct dependencies of each file.
    dependencies: HashMap<PathBuf, Vec<PathBuf>>,
}

impl Sources {
    /// Returns the files that a scene depends on, the scene first, with the hashes of their contents.
    ///
    /// `words` are further values that may name files relative to the scene.
    pub(crate) fn of(&mut self, scene: &Path, words: &[&str]) -> io::Result<Vec<(PathBuf, Fingerprint)>> {
        let mut seen = BTreeSet::new();
        let mut files = Vec::new();
        // Traverse the dependencies depth-first, each file once
        let mut waiting = files_among(words.iter().copied(), scene);
        waiting.push(scene.to_owned());
        while let Some(path) = waiting.pop() {
            if !seen.insert(path.clone()) {
                continue;
            }
            waiting.extend(self.dependencies_of(&path)?.iter().cloned());
            let key = self.key(&path)?;
            files.push((path, key));
        }
        Ok(files)
    }

    fn key(&mut self, path: &Path) -> io::Result<Fingerprint> {
        if let Some(&key) = self.keys.get(path) {
            return Ok(key);
        }
        let key = Fingerprint::of_file(path)?;
        self.keys.insert(path.to_owned(), key);
        Ok(key)
    }

    /// Returns the direct dependencies of a file, from the cache if possible.
    fn dependencies_of(&mut self, path: &Path) -> io::Result<&[PathBuf]> {
        if !self.dependencies.contains_key(path) {
            self.dependencies
                .insert(path.to_owned(), parse_dependencies(path)?);
        }
        Ok(self.dependencies.get(path).map_or(&[], Vec::as_slice))
    }
}

/// Returns the direct dependencies of a file, according to its extension; a file that cannot be parsed has none, as
/// loading it reports the error.
fn parse_dependencies(path: &Path) -> io::Result<Vec<PathBuf>> {
    let kind = path
        .extension()
        .and_then(|kind| kind.to_str())
        .unwrap_or_default();
    // Collect the strings of a scene file or of an NRRD header, or parse the JSON of a glTF file
    let json: serde_json::Value = match kind.to_ascii_lowercase().as_str() {
        "toml" => {
            let text = String::from_utf8_lossy(&std::fs::read(path)?).into_owned();
            let table: toml::Table = text.parse().unwrap_or_default();
            let mut words = Vec::new();
            table.values().for_each(|value| collect_words(value, &mut words));
            return Ok(files_among(words.into_iter(), path));
        }
        "gltf" => json_value(&std::fs::read(path)?),
        "glb" => json_value(&json_of_glb(path)?),
        // NRRD headers name the raw files of volumes.
        "nhdr" => {
            let text = String::from_utf8_lossy(&std::fs::read(path)?).into_owned();
            let words = text
                .lines()
                .filter_map(|line| line.split_once(':'))
                .map(|(_, word)| word.trim());
            return Ok(files_among(words, path));
        }
        _ => return Ok(Vec::new()),
    };
    // Decode the URIs of external glTF files
    let mut uris = Vec::new();
    collect_uris(&json, &mut uris);
    let decoded: Vec<String> = uris
        .into_iter()
        .filter(|uri| !uri.starts_with("data:"))
        .map(|uri| percent_decode_str(uri).decode_utf8_lossy().into_owned())
        .collect();
    Ok(files_among(decoded.iter().map(String::as_str), path))
}

/// Returns the files among `words`, resolved relative to the folder of `path`.
fn files_among<'w>(words: impl Iterator<Item = &'w str>, path: &Path) -> Vec<PathBuf> {
    let folder = path.parent().unwrap_or(Path::new(""));
    // No operating system has longer paths, and line breaks in paths are not supported.
    const MAX_PATH_BYTES: usize = 4096;
    words
        .filter(|word| !word.is_empty() && word.len() <= MAX_PATH_BYTES && !word.contains('\n'))
        .map(|word| folder.join(word))
        .filter(|file| file.is_file())
        .collect()
}

fn collect_words<'v>(value: &'v toml::Value, words: &mut Vec<&'v str>) {
    match value {
        toml::Value::String(word) => words.push(word),
        toml::Value::Array(values) => values.iter().for_each(|value| collect_words(value, words)),
        toml::Value::Table(table) => table.values().for_each(|value| collect_words(value, words)),
        _ => {}
    }
}

/// Returns the parsed JSON text, or null if it is invalid.
fn json_value(text: &[u8]) -> serde_json::Value {
    let text = std::str::from_utf8(text).unwrap_or_default();
    serde_json::from_str(text).unwrap_or_default()
}

fn collect_uris<'v>(value: &'v serde_json::Value, uris: &mut Vec<&'v str>) {
    match value {
        serde_json::Value::Array(values) => values.iter().for_each(|value| collect_uris(value, uris)),
        serde_json::Value::Object(object) => {
            for (name, value) in object {
                match value {
                    serde_json::Value::String(uri) if name == "uri" => uris.push(uri),
                    value => collect_uris(value, uris),
                }
            }
        }
        _ => {}
    }
}

/// Returns the JSON chunk of a binary glTF file: a 12-byte header, then the chunk's length (4 bytes) and type (4
/// bytes).
fn json_of_glb(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = File::open(path)?;
    let mut head = [0; 20];
    if file.read_exact(&mut head).is_err() {
        return Ok(Vec::new());
    }
    let length = u32::from_le_bytes([head[12], head[13], head[14], head[15]]);
    let mut json = Vec::new();
    file.take(length.into()).read_to_end(&mut json)?;
    Ok(json)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn names(sources: &[(PathBuf, Fingerprint)]) -> Vec<String> {
        let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
        let mut names: Vec<String> = sources.iter().map(|(path, _)| name(path)).collect();
        names.sort();
        names
    }

    #[test]
    fn dependencies_of_scene_and_gltf_files_are_found_once() {
        let folder = tempfile::tempdir().unwrap();
        // Write a scene with a cycle of includes, escaped URIs, and a file that is not referenced
        let write = |name: &str, bytes: &[u8]| fs::write(folder.path().join(name), bytes).unwrap();
        write(
            "scene.toml",
            b"[[object]]\ngltf = \"a b.gltf\"\n[[object]]\ninclude = \"other.toml\"\n",
        );
        write(
            "other.toml",
            b"[[object]]\ninclude = \"scene.toml\"\n[texture.t]\nimage = \"t.png\"\n",
        );
        write(
            "a b.gltf",
            br#"{"buffers": [{"uri": "a%20b.bin"}, {"uri": "data:,x"}], "images": [{"uri": "t.png"}]}"#,
        );
        write("a b.bin", b"1");
        write("t.png", b"2");
        write("extra.npy", b"3");
        write("unused.png", b"4");
        let scene = folder.path().join("scene.toml");
        // Follow the dependencies from the scene, and from the extra words
        let mut sources = Sources::default();
        let all = sources.of(&scene, &["extra.npy", "0.5"]).unwrap();
        let expected = [
            "a b.bin",
            "a b.gltf",
            "extra.npy",
            "other.toml",
            "scene.toml",
            "t.png",
        ];
        assert_eq!(names(&all), expected);
        assert_eq!(all.first().map(|(path, _)| path), Some(&scene));
        // A missing scene is an error, unlike a missing dependency
        assert!(
            Sources::default()
                .of(&folder.path().join("none.toml"), &[])
                .is_err()
        );
    }

    #[test]
    fn binary_gltf_lists_its_files_and_a_truncated_one_lists_none() {
        let folder = tempfile::tempdir().unwrap();
        let json = br#"{"images": [{"uri": "t.png"}]}"#;
        let mut glb = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        glb.extend((json.len() as u32).to_le_bytes());
        glb.extend(b"JSON");
        glb.extend(json);
        let path = folder.path().join("a.glb");
        fs::write(&path, &glb).unwrap();
        // Only files that exist count, so the texture is written too
        fs::write(folder.path().join("t.png"), b"1").unwrap();
        assert_eq!(
            names(&Sources::default().of(&path, &[]).unwrap()),
            ["a.glb", "t.png"]
        );
        // A truncated header names no files
        fs::write(&path, &glb[..15]).unwrap();
        assert_eq!(names(&Sources::default().of(&path, &[]).unwrap()), ["a.glb"]);
    }
}
