//! Expansion of a parsed job file to frames: the product of scenes, cameras, swept values and frame numbers.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use toml::Value;

use super::camera_motion::{CameraMotion, camera_motion};
use super::output_paths::check_names;
use super::range::{FrameRange, MAX_FRAMES};
use super::spec::{AnimationSpec, JobDocument, JobSpec, SplitSpec};
use super::sweep::{FIELDS, SweepValue, combinations, word};
use super::template::Template;
use super::{FlagValue, Frame, JobSettings, Jobs, Moment};
use crate::image::ImageFormat;
use crate::scene_file::SceneFileError;
use crate::scene_file::fault::{Diagnostic, Source, file_error};
use crate::scene_file::source_text::read;
use crate::scene_file::value::Located;

/// Largest number of pieces of a frame.
const MAX_PIECES: u32 = 4096;

/// Parses a job file and expands it; see [`Jobs::load`].
pub(super) fn load(path: &Path) -> Result<Jobs, SceneFileError> {
    let source = read(path)?;
    let document: JobDocument = source.parse()?;
    if document.job.is_empty() {
        return Err(file_error(path, "has no jobs: add a [[job]]"));
    }
    // Validate each job and append its frames, within the limit of the file
    let mut frames = Vec::new();
    for (number, form) in document.job.iter().enumerate() {
        let job = Job::of(form, (number, &document), &source).map_err(|fault| source.error(fault))?;
        if frames.len().saturating_add(job.count()) > MAX_FRAMES {
            let sentence = format!("brings the file to more than {MAX_FRAMES} frames: split the file");
            return Err(source.error(form.fault(sentence)));
        }
        job.append_frames(&mut frames);
    }
    check_names(&frames, &source)?;
    Ok(Jobs {
        path: path.to_owned(),
        frames,
    })
}

/// Validated job, ready to be expanded.
struct Job {
    name: String,
    scenes: Vec<PathBuf>,
    cameras: Vec<Option<String>>,
    range: FrameRange,
    camera_motion: CameraMotion,
    animation: Option<JobAnimation>,
    /// Edits of each combination of swept values.
    sweeps: Vec<Vec<SweepValue>>,
    settings: Arc<JobSettings>,
    image: Template,
}

struct JobAnimation {
    name: Option<String>,
    fps: f64,
    from: f64,
}

impl Job {
    fn of(
        form: &Located<JobSpec>,
        (number, document): (usize, &JobDocument),
        source: &Source,
    ) -> Result<Job, Diagnostic> {
        // Parse the sweep first, as its fields are known to the image name
        let sweeps = combinations(&form.sweep, form.zip.as_ref())?;
        let range = range(form)?;
        let given = form.name.as_ref().map(|name| (**name).clone());
        let name = given.unwrap_or_else(|| (number + 1).to_string());
        // Keys of the job replace those of the whole file
        let cameras = form.camera.as_ref().or(document.camera.as_ref());
        let cameras: &[String] = cameras.map_or(&[], |cameras| &cameras.0);
        let cut = form.split.as_ref().or(document.split.as_ref());
        let settings = JobSettings {
            flags: flags(&document.settings, &form.settings)?,
            bands: split(cut, |split| split.bands)?,
            shares: split(cut, |split| split.shares)?,
            line: source.line(form.span.start),
            job: name.clone(),
        };
        // Validate the remaining keys
        Ok(Job {
            name,
            scenes: scenes(form, document, &source.path)?,
            image: image(form, document, (cameras.len(), &sweeps[0]))?,
            cameras: match cameras {
                [] => vec![None],
                several => several.iter().cloned().map(Some).collect(),
            },
            camera_motion: camera_motion(form, &range)?,
            range,
            animation: form.animation.as_ref().map(animation).transpose()?,
            sweeps,
            settings: Arc::new(settings),
        })
    }

    fn count(&self) -> usize {
        let frames = self.range.count();
        [self.scenes.len(), self.cameras.len(), self.sweeps.len()]
            .into_iter()
            .fold(frames, usize::saturating_mul)
    }

    /// Appends the frames in an order in which neighbours share as much as possible: scene, then edits, then frame
    /// number, then camera.
    fn append_frames(&self, frames: &mut Vec<Frame>) {
        for scene in &self.scenes {
            for sweep in &self.sweeps {
                for number in self.range.numbers() {
                    for camera in &self.cameras {
                        frames.push(self.frame(scene, sweep, number, camera.as_ref()));
                    }
                }
            }
        }
    }

    fn frame(&self, scene: &Path, sweep: &[SweepValue], number: u32, camera: Option<&String>) -> Frame {
        let seconds =
            |animation: &JobAnimation| animation.from + f64::from(number - self.range.first) / animation.fps;
        let moment = self.animation.as_ref().map(|animation| Moment {
            animation: animation.name.clone(),
            seconds: seconds(animation),
        });
        // Look up a field of the image name
        let value = |field: &str| match field {
            "scene" => stem(scene),
            "camera" => camera.cloned().unwrap_or_else(|| "camera".into()),
            "job" => self.name.clone(),
            "frame" => number.to_string(),
            "time" => format!("{:.4}", moment.as_ref().map_or(0.0, |moment| moment.seconds)),
            swept => sweep
                .iter()
                .find(|point| point.field == swept)
                .map_or_else(String::new, |point| point.label.clone()),
        };
        Frame {
            scene: scene.to_owned(),
            camera: camera.cloned(),
            view: self.camera_motion.view(number, &self.range),
            image: self.image.name(value),
            moment,
            edits: sweep.iter().map(|point| point.edit.clone()).collect(),
            settings: self.settings.clone(),
        }
    }
}

/// Returns the name of a scene's file without its extension.
fn stem(scene: &Path) -> String {
    scene
        .file_stem()
        .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

/// Returns the frame numbers of a job: from its `frames`, from its path, or from its animation.
fn range(form: &Located<JobSpec>) -> Result<FrameRange, Diagnostic> {
    if let Some(range) = form.frames {
        // `to` would give the range a second time
        return match &form.animation {
            Some(animation) if animation.to.is_some() => {
                Err(animation.fault("has `to` in addition to `frames`: keep one of them"))
            }
            _ => Ok(range),
        };
    }
    if form.turntable.is_some() {
        return Err(form.fault("has a turntable but no frames: add `frames`, as in `frames = 24`"));
    }
    // Without `frames`, a path gives the range by its first and last key
    let counted = |first: f64, last: f64| FrameRange {
        first: first as u32,
        last: last as u32,
        step: 1,
    };
    if let (Some(first), Some(last)) = (form.path.first(), form.path.last()) {
        return Ok(counted(
            first.frame.ceil().max(0.0),
            last.frame.floor().max(first.frame.ceil()),
        ));
    }
    // With neither there is a single frame
    let Some(animation) = &form.animation else {
        return Ok(FrameRange::ONE);
    };
    // Without a path, the animation gives it by its length in seconds
    let last = animation.last_step().map(|step| step + 1.0);
    let last = last.filter(|last| (1.0..=MAX_FRAMES as f64).contains(last));
    last.map(|last| counted(1.0, last)).ok_or_else(|| {
        animation.fault(format!(
            "has no valid end: add `frames`, or `to` in seconds, from `from` to at most {MAX_FRAMES} frames later"
        ))
    })
}

impl AnimationSpec {
    /// Returns the index of the last frame relative to the first, such that it is not later than `to`.
    fn last_step(&self) -> Option<f64> {
        let to = self.to?;
        let steps = (to - self.from) * self.fps;
        // The product may be rounded below the integer that is meant.
        let nearest_step = steps.round();
        Some(if self.from + nearest_step / self.fps <= to {
            nearest_step
        } else {
            steps.floor()
        })
    }
}

fn scenes(form: &Located<JobSpec>, document: &JobDocument, path: &Path) -> Result<Vec<PathBuf>, Diagnostic> {
    let Some(names) = form.scene.as_ref().or(document.scene.as_ref()) else {
        return Err(form.fault("lacks `scene`: add it, as in `scene = \"a.toml\"`"));
    };
    if names.0.is_empty() {
        return Err(names.fault("has no scene: give a file name or a list of them"));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    // Each scene must exist, and must be a scene file if it is swept
    let path = |name: &String| {
        let path = folder.join(name);
        if !path.is_file() {
            return Err(names.fault(format!(
                "there is no file {}: correct the file name",
                path.display()
            )));
        }
        let is_scene_file = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
        if !is_scene_file && !form.sweep.is_empty() {
            return Err(names.fault(format!(
                "sweeps change scene files, which {name} is not: write a scene file that includes it as an [[object]] \
                 with `gltf = \"{name}\"`"
            )));
        }
        Ok(path)
    };
    names.0.iter().map(path).collect()
}

fn animation(form: &Located<AnimationSpec>) -> Result<JobAnimation, Diagnostic> {
    if !(form.fps > 0.0 && form.fps.is_finite() && form.from.is_finite()) {
        return Err(
            form.fault("has no valid time: give a finite `fps` above 0 and a finite `from` in seconds")
        );
    }
    Ok(JobAnimation {
        name: form.name.as_ref().map(|name| name.0.clone()),
        fps: form.fps,
        from: form.from,
    })
}

fn split(form: Option<&Located<SplitSpec>>, part: impl Fn(&SplitSpec) -> u32) -> Result<u32, Diagnostic> {
    let Some(form) = form else {
        return Ok(1);
    };
    let pieces = form.bands.saturating_mul(form.shares);
    match (1..=MAX_PIECES).contains(&pieces) {
        true => Ok(part(form)),
        false => Err(form.fault(format!(
            "splits a frame into {pieces} pieces: give 1 to {MAX_PIECES}"
        ))),
    }
}

/// Returns the pattern of the image names of a job with `camera_count` cameras and with the keys `swept` of its first
/// frame.
fn image(
    form: &Located<JobSpec>,
    document: &JobDocument,
    (camera_count, swept): (usize, &[SweepValue]),
) -> Result<Template, Diagnostic> {
    let mut known = FIELDS.to_vec();
    known.extend(swept.iter().map(|point| point.field.as_str()));
    // Without `image`, build the default name from all fields that differ between frames
    let Some(text) = form.image.as_ref().or(document.image.as_ref()) else {
        let camera = if camera_count > 1 { ".{camera}" } else { "" };
        let swept: String = swept
            .iter()
            .map(|point| format!(".{{{}}}", point.field))
            .collect();
        let usual = format!("{{scene}}{camera}{swept}.{{frame:04}}.png");
        return Template::parse(&usual, &known).map_err(|sentence| form.fault(sentence));
    };
    // Parse the given pattern, whose extension selects the image format
    let template = Template::parse(text, &known).map_err(|sentence| text.fault(sentence))?;
    if ImageFormat::of_path(Path::new(text.as_str())).is_none() {
        return Err(text.fault("has no known image format: end `image` in .png or .exr"));
    }
    Ok(template)
}

/// Merges the settings of the whole file with those of one job, which take precedence.
fn flags(
    all: &BTreeMap<String, Located<Value>>,
    own: &BTreeMap<String, Located<Value>>,
) -> Result<Vec<(String, FlagValue)>, Diagnostic> {
    let mut merged: BTreeMap<&String, &Located<Value>> = all.iter().collect();
    merged.extend(own);
    let mut flags = Vec::with_capacity(merged.len());
    for (name, value) in merged {
        match flag_value(value) {
            Some(Some(given)) => flags.push((name.clone(), given)),
            Some(None) => {}
            None => return Err(value.fault("is not a valid setting: give a string, a number, true or false")),
        }
    }
    Ok(flags)
}

/// Returns the value of a flag; `Some(None)` for a flag that is switched off, `None` for an invalid value.
fn flag_value(value: &Value) -> Option<Option<FlagValue>> {
    match value {
        Value::Boolean(false) => Some(None),
        Value::Boolean(true) => Some(Some(FlagValue::None)),
        Value::String(_) | Value::Integer(_) | Value::Float(_) => Some(Some(FlagValue::Word(word(value)))),
        Value::Array(values) if !values.iter().any(Value::is_array) => {
            Some(Some(FlagValue::Word(word(value))))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use glam::DVec3;

    use super::super::OrbitView;
    use super::*;

    fn jobs(text: &str) -> Result<Jobs, String> {
        let folder = tempfile::tempdir().unwrap();
        for scene in ["a.toml", "b.glb", "c.toml"] {
            fs::write(folder.path().join(scene), b"").unwrap();
        }
        let path = folder.path().join("x.jobs.toml");
        fs::write(&path, text).unwrap();
        load(&path).map_err(|error| error.to_string())
    }

    fn names(text: &str) -> Vec<String> {
        let jobs = jobs(text).unwrap();
        jobs.frames
            .iter()
            .map(|frame| frame.image.display().to_string())
            .collect()
    }

    #[test]
    fn turntable_takes_equal_steps_and_omits_the_full_turn() {
        let jobs = jobs("[[job]]\nscene = \"a.toml\"\nframes = 4\nturntable = {}\n").unwrap();
        let turns: Vec<f64> = jobs
            .frames
            .iter()
            .map(|frame| match frame.view {
                OrbitView::Turn {
                    turns,
                    axis,
                    center: None,
                } if axis == DVec3::Y => turns,
                other => panic!("{other:?}"),
            })
            .collect();
        assert_eq!(turns, [0.0, 0.25, 0.5, 0.75]);
        assert_eq!(jobs.frames[2].image, Path::new("a.0003.png"));
    }

    #[test]
    fn scenes_cameras_sweeps_and_frames_multiply() {
        let text = "[[job]]\nscene = [\"a.toml\", \"c.toml\"]\ncamera = [\"top\", 1]\nframes = \"5-6\"\n\
                    sweep = { \"material.x.ior\" = [1.5, 2], \"ambient\" = { from = 0, to = 1, steps = 3 } }\n";
        let all = names(text);
        assert_eq!(all.len(), 2 * 2 * 2 * 2 * 3);
        assert_eq!(all[0], "a.top.1.5.0.0.0005.png");
        assert_eq!(all.last().unwrap(), "c.1.2.1.0.0006.png");
    }

    #[test]
    fn job_settings_override_settings_of_the_file() {
        let text = "settings = { spp = 4, size = \"8x8\", quiet = true }\n[[job]]\nscene = \"a.toml\"\n\
                    settings = { spp = 9, aov = [\"rays\", \"time\"], quiet = false }\n";
        let flags = jobs(text).unwrap().frames[0].settings.flags.clone();
        let word = |word: &str| FlagValue::Word(word.into());
        let expected = [
            ("aov", word("rays,time")),
            ("size", word("8x8")),
            ("spp", word("9")),
        ];
        assert_eq!(flags, expected.map(|(name, value)| (name.to_owned(), value)));
    }

    #[test]
    fn animation_range_and_rate_give_the_frames() {
        let text = "[[job]]\nscene = \"b.glb\"\nanimation = { name = 1, fps = 10, from = 2, to = 2.5 }\n";
        let seconds: Vec<f64> = jobs(text)
            .unwrap()
            .frames
            .iter()
            .map(|frame| frame.moment.as_ref().unwrap().seconds)
            .collect();
        assert_eq!(seconds, [2.0, 2.1, 2.2, 2.3, 2.4, 2.5]);
    }

    #[test]
    fn end_rounded_just_below_a_frame_includes_that_frame() {
        // In f64, 0.29 * 100 is 28.999999999999996.
        let text = "[[job]]\nscene = \"b.glb\"\nanimation = { fps = 100, to = 0.29 }\n";
        let last = jobs(text).unwrap().frames.pop().unwrap();
        assert_eq!(last.moment.unwrap().seconds, 0.29);
    }

    #[test]
    fn jobs_inherit_the_values_of_the_file() {
        let text = "scene = \"a.toml\"\nimage = \"{job}/{scene}.exr\"\nsplit = { bands = 2 }\n\
                    [[job]]\n[[job]]\nname = \"two\"\nscene = \"c.toml\"\nsplit = { shares = 3 }\n";
        assert_eq!(names(text), ["1/a.exr", "two/c.exr"]);
        let pieces: Vec<[u32; 2]> = jobs(text)
            .unwrap()
            .frames
            .iter()
            .map(|frame| [frame.settings.bands, frame.settings.shares])
            .collect();
        assert_eq!(pieces, [[2, 1], [1, 3]]);
    }

    #[test]
    fn hundred_thousand_frames_are_expanded() {
        let text = "[[job]]\nscene = \"a.toml\"\nframes = 1000\nsweep = { x = { from = 1, to = 100, steps = 100 } }\n\
                    image = \"{x}/{frame}.png\"\n";
        let all = jobs(text).unwrap().frames;
        assert_eq!(all.len(), 100_000);
        assert_eq!(all[99_999].image, Path::new("100/1000.png"));
    }
}
