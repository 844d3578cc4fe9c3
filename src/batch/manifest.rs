//! Manifest of the finished images of a batch: one line of JSON per image, in an append-only file.
//!
//! A line is appended after its image is complete at its final path. A process that is killed in between renders that
//! image again; a truncated line is ignored. Every shard has its own file; all files are read.

use std::collections::HashMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::error::BatchError;
use super::fingerprint::Fingerprint;
use super::lock::describe_process;
use super::ongoing_writes::OngoingWrites;
use super::options::BatchOptions;
use super::pieces::FrameMetadata;
use super::shard::Shard;

/// Prefix and suffix of the names of manifest files.
const NAME: (&str, &str) = ("whit-batch", ".jsonl");

/// Manifest entry of one finished image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct CompletedFrame {
    /// Index of the frame in its batch.
    pub frame: usize,
    /// Path of the image relative to the output folder.
    pub image: PathBuf,
    /// Hash of the inputs that the image was rendered from.
    pub key: Fingerprint,
    /// Size of the image file in bytes.
    pub bytes: u64,
    /// Seconds spent on this image alone, without work that is shared with other frames.
    pub seconds: f64,
    /// Seconds of `seconds` that were spent rendering; the rest was spent encoding and writing the file.
    #[serde(default)]
    pub render_seconds: f64,
    /// Mean number of samples per pixel taken.
    pub samples: f64,
    /// Samples per pixel that the settings request.
    pub spp: u32,
    /// Machine and process that made the image.
    pub by: String,
}

/// Finished images of a batch by path, with the open manifest of one shard.
#[derive(Debug)]
pub(crate) struct Manifest {
    folder: PathBuf,
    file: File,
    done: HashMap<PathBuf, CompletedFrame>,
}

impl Manifest {
    /// Reads the entries of all shards in `folder`, and opens the manifest of one shard for appending.
    pub(crate) fn open(folder: &Path, shard: Shard) -> io::Result<Manifest> {
        let (start, end) = NAME;
        let name = match shard {
            Shard::ALL => format!("{start}{end}"),
            Shard { number, count } => format!("{start}.{number}-of-{count}{end}"),
        };
        let mut file = OpenOptions::new()
            .append(true)
            .create(true)
            .open(folder.join(name))?;
        // Terminate a line that a killed process may have left truncated; empty lines are ignored.
        if file.metadata()?.len() > 0 {
            file.write_all(b"\n")?;
        }
        Ok(Manifest {
            folder: folder.to_owned(),
            file,
            done: Manifest::read(folder)?,
        })
    }

    /// Opens the manifest of the output folder; rejects a folder with results of an earlier run, unless these are to be
    /// kept.
    pub(super) fn of_batch(options: &BatchOptions) -> Result<Manifest, BatchError> {
        let out = &options.out;
        let unreadable = |error| BatchError::OpenManifest(out.clone(), error);
        let is_new = !options.resume && options.shard == Shard::ALL;
        if is_new && !Manifest::read(out).map_err(unreadable)?.is_empty() {
            return Err(BatchError::EarlierRun(out.clone()));
        }
        Manifest::open(out, options.shard).map_err(unreadable)
    }

    /// Reads the manifests of all shards again, to see entries that other processes have added.
    pub(crate) fn read_again(&mut self) -> io::Result<()> {
        self.done = Manifest::read(&self.folder)?;
        Ok(())
    }

    /// Returns the entries of all shards in `folder`, by image path; truncated lines are ignored.
    pub(crate) fn read(folder: &Path) -> io::Result<HashMap<PathBuf, CompletedFrame>> {
        let mut done = HashMap::new();
        for entry in fs::read_dir(folder)? {
            let name = entry?.file_name();
            let is_manifest = |name: &str| name.starts_with(NAME.0) && name.ends_with(NAME.1);
            if !name.to_str().is_some_and(is_manifest) {
                continue;
            }
            let bytes = fs::read(folder.join(name))?;
            for line in String::from_utf8_lossy(&bytes).lines() {
                if let Ok(one) = serde_json::from_str::<CompletedFrame>(line) {
                    done.insert(one.image.clone(), one);
                }
            }
        }
        Ok(done)
    }

    /// Returns the entry of an image with the given key, if the file is still there with the recorded size.
    pub(crate) fn find(&self, image: &Path, key: Fingerprint) -> Option<&CompletedFrame> {
        let done = self.done.get(image).filter(|done| done.key == key)?;
        let bytes = fs::metadata(self.folder.join(image)).ok()?.len();
        (bytes == done.bytes).then_some(done)
    }

    /// Returns whether the manifests have an entry for an image, with any key.
    pub(crate) fn has(&self, image: &Path) -> bool {
        self.done.contains_key(image)
    }

    /// Adds a complete image with the mean number of its samples, and the seconds of rendering and of writing it.
    pub(super) fn add_image(
        &mut self,
        head: &FrameMetadata,
        samples: f64,
        [render_seconds, write_seconds]: [f64; 2],
        writes: &OngoingWrites,
    ) -> Result<(), BatchError> {
        let done = fs::metadata(self.folder.join(&head.image)).map(|file| CompletedFrame {
            frame: head.number,
            image: head.image.clone(),
            key: head.key,
            bytes: file.len(),
            seconds: render_seconds + write_seconds,
            render_seconds,
            samples,
            spp: head.spp,
            by: describe_process(),
        });
        let added = done.and_then(|done| writes.during(|| self.add(done)));
        added.map_err(|error| BatchError::AddToManifest(head.image.clone(), error))
    }

    /// Appends an entry and syncs the file to disk.
    pub(crate) fn add(&mut self, done: CompletedFrame) -> io::Result<()> {
        let mut line = serde_json::to_string(&done)?;
        line.push('\n');
        // Append the line in one write, so that lines of two processes do not mix
        self.file.write_all(line.as_bytes())?;
        self.file.sync_data()?;
        self.done.insert(done.image.clone(), done);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::fingerprint::FingerprintHasher;
    use super::*;

    fn done(image: &str, key: &str) -> CompletedFrame {
        CompletedFrame {
            frame: 3,
            image: image.into(),
            key: FingerprintHasher::default().add("", key).key(),
            bytes: 4,
            seconds: 0.5,
            render_seconds: 0.25,
            samples: 16.0,
            spp: 16,
            by: "host 1".into(),
        }
    }

    #[test]
    fn entries_of_all_shards_are_found_if_image_and_key_match() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = Manifest::open(folder.path(), Shard { number: 1, count: 2 }).unwrap();
        first.add(done("a.png", "one")).unwrap();
        let manifest = Manifest::open(folder.path(), Shard { number: 2, count: 2 }).unwrap();
        let [same, other] = ["one", "two"].map(|key| done("a.png", key).key);
        assert_eq!(manifest.find(Path::new("a.png"), same), None);
        fs::write(folder.path().join("a.png"), b"1234").unwrap();
        // An entry counts only for the same key and the same size of the file
        assert_eq!(
            manifest.find(Path::new("a.png"), same),
            Some(&done("a.png", "one"))
        );
        assert_eq!(manifest.find(Path::new("a.png"), other), None);
        fs::write(folder.path().join("a.png"), b"123").unwrap();
        assert_eq!(manifest.find(Path::new("a.png"), same), None);
    }

    #[test]
    fn truncated_line_leaves_other_entries_intact() {
        let folder = tempfile::tempdir().unwrap();
        let open = || Manifest::open(folder.path(), Shard::ALL).unwrap();
        open().add(done("a.png", "one")).unwrap();
        let path = folder.path().join("whit-batch.jsonl");
        // Append half a line, as a process killed during a write leaves it
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"frame\": 4, \"ima").unwrap();
        open().add(done("b.png", "one")).unwrap();
        let mut names: Vec<PathBuf> = Manifest::read(folder.path()).unwrap().into_keys().collect();
        names.sort();
        assert_eq!(names, [Path::new("a.png"), Path::new("b.png")]);
    }
}
