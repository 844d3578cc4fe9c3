//! What of a batch is done: a line of JSON for each picture, in a file that only grows.
//!
//! A line is written after its picture stands whole in its place. Whoever is killed in between makes that picture again;
//! a line that was cut short is none. Every shard has a file of its own; all are read.

use std::collections::HashMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::key::Key;
use super::shard::Shard;

/// What names of manifests begin and end with.
const NAME: (&str, &str) = ("whit-batch", ".jsonl");

/// A picture that is done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Done {
    /// The frame's number in its batch.
    pub frame: usize,
    /// The picture, within the batch's folder.
    pub image: PathBuf,
    /// What it was made of.
    pub key: Key,
    /// Bytes of its file.
    pub bytes: u64,
    /// Seconds that it took by itself, but for what it shared with others.
    pub seconds: f64,
    /// Those of them in which it was rendered; the others went into its file.
    #[serde(default)]
    pub render_seconds: f64,
    /// Samples a pixel, on average.
    pub samples: f64,
    /// Samples a pixel that were asked for.
    pub spp: u32,
    /// Which machine and process made it.
    pub by: String,
}

/// The pictures that are done, by name, and where more are noted.
#[derive(Debug)]
pub struct Manifest {
    folder: PathBuf,
    file: File,
    done: HashMap<PathBuf, Done>,
}

impl Manifest {
    /// Reads what all shards have noted in `folder`, and goes on with the notes of one.
    pub fn open(folder: &Path, shard: Shard) -> io::Result<Manifest> {
        let (start, end) = NAME;
        let name = match shard {
            Shard::ALL => format!("{start}{end}"),
            Shard { number, count } => format!("{start}.{number}-of-{count}{end}"),
        };
        let mut file = OpenOptions::new()
            .append(true)
            .create(true)
            .open(folder.join(name))?;
        // If the last line was cut short, the next begins anew.
        if file.metadata()?.len() > 0 {
            file.write_all(b"\n")?;
        }
        Ok(Manifest {
            folder: folder.to_owned(),
            file,
            done: Manifest::read(folder)?,
        })
    }

    /// Takes note of what others have noted since.
    pub fn read_again(&mut self) -> io::Result<()> {
        self.done = Manifest::read(&self.folder)?;
        Ok(())
    }

    /// What all shards have noted in `folder`.
    pub fn read(folder: &Path) -> io::Result<HashMap<PathBuf, Done>> {
        let mut done = HashMap::new();
        for entry in fs::read_dir(folder)? {
            let name = entry?.file_name();
            let is_manifest = |name: &str| name.starts_with(NAME.0) && name.ends_with(NAME.1);
            if !name.to_str().is_some_and(is_manifest) {
                continue;
            }
            let bytes = fs::read(folder.join(name))?;
            for line in String::from_utf8_lossy(&bytes).lines() {
                if let Ok(one) = serde_json::from_str::<Done>(line) {
                    done.insert(one.image.clone(), one);
                }
            }
        }
        Ok(done)
    }

    /// What was noted of a picture that still stands there as it was made, of this.
    pub fn find(&self, image: &Path, key: Key) -> Option<&Done> {
        let done = self.done.get(image).filter(|done| done.key == key)?;
        let bytes = fs::metadata(self.folder.join(image)).ok()?.len();
        (bytes == done.bytes).then_some(done)
    }

    /// Whether anything was ever noted of a picture.
    pub fn has(&self, image: &Path) -> bool {
        self.done.contains_key(image)
    }

    /// Notes a picture, for good.
    pub fn add(&mut self, done: Done) -> io::Result<()> {
        let mut line = serde_json::to_string(&done)?;
        line.push('\n');
        // At once, so that lines of two processes do not mix.
        self.file.write_all(line.as_bytes())?;
        self.file.sync_data()?;
        self.done.insert(done.image.clone(), done);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::key::Keyring;
    use super::*;

    fn done(image: &str, key: &str) -> Done {
        Done {
            frame: 3,
            image: image.into(),
            key: Keyring::default().add("", key).key(),
            bytes: 4,
            seconds: 0.5,
            render_seconds: 0.25,
            samples: 16.0,
            spp: 16,
            by: "host 1".into(),
        }
    }

    #[test]
    fn what_is_noted_by_any_shard_is_found_if_it_is_the_same_and_still_there() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = Manifest::open(folder.path(), Shard { number: 1, count: 2 }).unwrap();
        first.add(done("a.png", "one")).unwrap();
        let manifest = Manifest::open(folder.path(), Shard { number: 2, count: 2 }).unwrap();
        let [same, other] = ["one", "two"].map(|key| done("a.png", key).key);
        assert_eq!(manifest.find(Path::new("a.png"), same), None);
        fs::write(folder.path().join("a.png"), b"1234").unwrap();
        assert_eq!(
            manifest.find(Path::new("a.png"), same),
            Some(&done("a.png", "one"))
        );
        assert_eq!(manifest.find(Path::new("a.png"), other), None);
        fs::write(folder.path().join("a.png"), b"123").unwrap();
        assert_eq!(manifest.find(Path::new("a.png"), same), None);
    }

    #[test]
    fn a_line_that_was_cut_short_loses_nothing_but_itself() {
        let folder = tempfile::tempdir().unwrap();
        let open = || Manifest::open(folder.path(), Shard::ALL).unwrap();
        open().add(done("a.png", "one")).unwrap();
        let path = folder.path().join("whit-batch.jsonl");
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"frame\": 4, \"ima").unwrap();
        open().add(done("b.png", "one")).unwrap();
        let mut names: Vec<PathBuf> = Manifest::read(folder.path()).unwrap().into_keys().collect();
        names.sort();
        assert_eq!(names, [Path::new("a.png"), Path::new("b.png")]);
    }
}
