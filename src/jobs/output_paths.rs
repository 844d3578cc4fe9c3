//! Check that no two frames of a job file write to the same file.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::path::Path;

use super::Frame;
use crate::scene_file::SceneFileError;
use crate::scene_file::fault::{Source, file_error};

/// Largest number of bytes of a file name: file systems allow 255, and the temporary name during writing is longer.
const MAX_BYTES: usize = 200;

/// Rejects two frames with the same name, an image that would be the folder of another, and names that are too long.
pub(super) fn check_names(frames: &[Frame], source: &Source) -> Result<(), SceneFileError> {
    let mut frames_by_path: HashMap<&Path, usize> = HashMap::with_capacity(frames.len());
    for (number, frame) in frames.iter().enumerate() {
        // Check the length of each path component
        if frame.image.iter().map(OsStr::len).max() > Some(MAX_BYTES) {
            let sentence = format!(
                "{} has a file name of more than {MAX_BYTES} bytes: shorten `image`",
                describe_frame(frames, number)
            );
            return Err(file_error(&source.path, sentence));
        }
        // Check for a frame with the same path
        if let Some(other) = frames_by_path.insert(&frame.image, number) {
            let sentence = format!(
                "{} and {} would both be written to {}: add fields to `image`, as in \
                 \"{{scene}}.{{camera}}.{{frame:04}}.png\"",
                describe_frame(frames, other),
                describe_frame(frames, number),
                frame.image.display(),
            );
            return Err(file_error(&source.path, sentence));
        }
    }
    // Check that no path is a parent folder of another
    for (number, frame) in frames.iter().enumerate() {
        let folder = frame
            .image
            .ancestors()
            .skip(1)
            .find_map(|folder| frames_by_path.get(folder));
        if let Some(&other) = folder {
            let sentence = format!(
                "{} would be written to {}, which is also the folder of {}: rename one of them",
                describe_frame(frames, other),
                frames[other].image.display(),
                describe_frame(frames, number),
            );
            return Err(file_error(&source.path, sentence));
        }
    }
    Ok(())
}

/// Describes a frame in terms of the job file: its position in the job, the job and the scene.
fn describe_frame(frames: &[Frame], number: usize) -> String {
    let frame = &frames[number];
    let job = &frame.settings.job;
    let first = frames.partition_point(|other| other.settings.line < frame.settings.line);
    let scene = frame.scene.file_name().unwrap_or_default().to_string_lossy();
    format!("image {} of job {job} (of {scene})", number - first + 1)
}
