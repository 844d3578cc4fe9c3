//! Checkpoint of an adaptively sampled frame: the per-pixel state of its sampling rounds, in a file beside the frame's
//! pieces.

use std::ops::Range;

use super::chunk_directory::ChunkDirectory;
use super::chunk_format::damaged;
use crate::image::rows::{ExrChannel, RowWindow, SampleType, Samples};
use crate::image::{Attribute, ImageError};
use crate::render::Rounds;

/// Name of the checkpoint file.
const FILE: &str = "rounds.exr";

/// Header attribute with the state that is not per pixel.
const STATE_ATTRIBUTE: &str = "whit.rounds";

/// Number of rows that are written or read at a time.
const ROWS_PER_STEP: usize = 32;

impl ChunkDirectory {
    /// Writes the state of the rounds and replaces an earlier checkpoint.
    pub(crate) fn write_rounds(&self, rounds: &Rounds) -> Result<(), ImageError> {
        let channel = |name: &str| ExrChannel::new(name, SampleType::Uint);
        let rest = rounds.rest();
        let note = Attribute {
            name: STATE_ATTRIBUTE,
            text: &rest,
        };
        let window = RowWindow::of_size(self.head().size);
        let mut writer = self.create(FILE, window, Rounds::WORDS.map(channel).into(), note)?;
        for rows in self.steps() {
            let words = rounds.words(&rows).into_iter().map(Samples::from);
            writer.write_rows(&words.collect::<Vec<Samples>>())?;
        }
        writer.finish()
    }

    /// Returns the state of the last checkpoint, or `None` if there is none.
    pub(crate) fn read_rounds(&self) -> Result<Option<Rounds>, ImageError> {
        let path = self.path(FILE);
        if !path.exists() {
            return Ok(None);
        }
        let size = self.head().size;
        // Read the header and the state that is not per pixel
        let mut reader = self.open_file(&path, RowWindow::of_size(size))?;
        let names: Vec<String> = reader
            .channels()
            .iter()
            .map(|channel| channel.name.clone())
            .collect();
        let mut rounds = Rounds::new(size.map(|side| side as usize));
        let rest = reader
            .note(STATE_ATTRIBUTE)
            .and_then(|rest| rounds.set_rest(&rest));
        rest.ok_or_else(|| damaged(&path))?;
        // Read the per-pixel state, a few rows at a time
        for rows in self.steps() {
            let values = reader.read_rows(rows.start as u32..rows.end as u32)?;
            // Find each channel, which must hold integers
            let plane = |name: &&str| {
                let place = names.iter().position(|channel| channel == name)?;
                match &values[place] {
                    Samples::Integers(words) => Some(&words[..]),
                    Samples::Floats(_) => None,
                }
            };
            // Copy the rows into the state
            let planes: Option<Vec<&[u32]>> = Rounds::WORDS.iter().map(plane).collect();
            planes
                .and_then(|planes| rounds.set_words(&rows, &planes))
                .ok_or_else(|| damaged(&path))?;
        }
        Ok(Some(rounds))
    }

    fn steps(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let height = self.head().size[1] as usize;
        (0..height)
            .step_by(ROWS_PER_STEP)
            .map(move |first| first..(first + ROWS_PER_STEP).min(height))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::super::chunk_directory::folder;
    use super::*;

    #[test]
    fn rounds_are_read_back_and_are_not_a_piece() {
        let out = tempfile::tempdir().unwrap();
        let folder = folder(out.path(), 1);
        assert!(folder.read_rounds().unwrap().is_none());
        let [width, height] = folder.head().size;
        let mut rounds = Rounds::new([width, height].map(|side| side as usize));
        rounds.set_rest(&rounds.rest().replace("true", "false")).unwrap();
        let mut words = rounds.words(&(40..41));
        words.iter_mut().for_each(|plane| plane.fill(2));
        let planes: Vec<&[u32]> = words.iter().map(|plane| &plane[..]).collect();
        rounds.set_words(&(40..41), &planes).unwrap();
        folder.write_rounds(&rounds).unwrap();
        assert_eq!(folder.read_rounds().unwrap().unwrap(), rounds);
        assert_eq!(folder.pieces().unwrap(), []);
        let path = folder.path(FILE);
        fs::write(&path, b"not an image").unwrap();
        assert!(folder.read_rounds().is_err());
        folder.remove();
        assert!(!path.exists());
    }

    #[test]
    fn incomplete_checkpoint_is_rejected_with_its_remedy() {
        let out = tempfile::tempdir().unwrap();
        let folder = folder(out.path(), 1);
        let window = RowWindow::of_size(folder.head().size);
        let note = Attribute {
            name: STATE_ATTRIBUTE,
            text: "{}",
        };
        let channels = vec![ExrChannel::new("count", SampleType::Uint)];
        let mut writer = folder.create(FILE, window, channels, note).unwrap();
        writer.write_rows(&[Samples::from(vec![0u32; 2 * 64])]).unwrap();
        writer.finish().unwrap();
        let message = folder.read_rounds().unwrap_err().to_string();
        assert!(
            message.ends_with("lacks data of its frame: remove it"),
            "{message}"
        );
    }
}
