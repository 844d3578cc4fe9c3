//! From what is written to frames: scenes, cameras, values of sweeps and numbers of frames, multiplied.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;
use toml::Value;

use super::form::{AnimationForm, Document, JobForm, KeyForm, SplitForm, SweepForm, TurntableForm};
use super::range::{FrameRange, MOST_FRAMES};
use super::template::Template;
use super::view::{Key, Pose, View, along};
use super::{FlagValue, Frame, JobSettings, Jobs, Moment};
use crate::scene_file::assembly::read;
use crate::scene_file::fault::{Fault, Source, file_error};
use crate::scene_file::value::At;
use crate::scene_file::{Edit, SceneFileError};

/// The most pieces of a frame.
const MOST_PIECES: u32 = 4096;

/// See [`Jobs::load`].
pub(super) fn load(path: &Path) -> Result<Jobs, SceneFileError> {
    let source = read(path)?;
    let document: Document = toml::from_str(&source.text).map_err(|error| source.toml_error(&error))?;
    if document.job.is_empty() {
        return Err(file_error(path, "has no jobs: add a [[job]]"));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut frames = Vec::new();
    for (number, form) in document.job.iter().enumerate() {
        let job = Job::of(form, (number, &document), folder).map_err(|fault| source.error(fault))?;
        if frames.len().saturating_add(job.count()) > MOST_FRAMES {
            let sentence =
                format!("is the one with which there are more than {MOST_FRAMES} frames: split the file");
            return Err(source.error(form.fault(sentence)));
        }
        job.add_frames(&mut frames);
    }
    check_names(&frames, &source)?;
    Ok(Jobs {
        path: path.to_owned(),
        frames,
    })
}

/// A job, understood.
struct Job {
    name: String,
    scenes: Vec<PathBuf>,
    cameras: Vec<Option<String>>,
    range: FrameRange,
    motion: Motion,
    animation: Option<Animation>,
    /// The edits of each combination of values, with what names call the values.
    sweeps: Vec<Vec<(String, Edit)>>,
    settings: Arc<JobSettings>,
    image: Template,
}

/// What the camera does.
enum Motion {
    None,
    Turntable {
        turns: f64,
        axis: DVec3,
        center: Option<DVec3>,
    },
    Path(Vec<Key>),
}

struct Animation {
    name: Option<String>,
    fps: f64,
    from: f64,
}

impl Job {
    fn of(form: &At<JobForm>, (number, document): (usize, &Document), folder: &Path) -> Result<Job, Fault> {
        let range = range(form)?;
        let sweeps = combinations(&form.sweep)?;
        let known = fields(&form.sweep);
        let name = form
            .name
            .as_ref()
            .map_or_else(|| (number + 1).to_string(), |name| (**name).clone());
        let image = image(form, &known)?;
        let settings = JobSettings {
            flags: flags(&document.settings, &form.settings)?,
            bands: split(form.split.as_ref(), |split| split.bands)?,
            shares: split(form.split.as_ref(), |split| split.shares)?,
            job: name.clone(),
        };
        Ok(Job {
            name,
            scenes: scenes(form, folder)?,
            cameras: match &form.camera.0[..] {
                [] => vec![None],
                several => several.iter().cloned().map(Some).collect(),
            },
            range,
            motion: motion(form)?,
            animation: form.animation.as_ref().map(animation).transpose()?,
            sweeps,
            settings: Arc::new(settings),
            image,
        })
    }

    fn count(&self) -> usize {
        let frames = self.range.numbers().count();
        [self.scenes.len(), self.cameras.len(), self.sweeps.len()]
            .into_iter()
            .fold(frames, usize::saturating_mul)
    }

    /// Frames that have most in common stand together.
    fn add_frames(&self, frames: &mut Vec<Frame>) {
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

    fn frame(&self, scene: &Path, sweep: &[(String, Edit)], number: u32, camera: Option<&String>) -> Frame {
        let seconds =
            |animation: &Animation| animation.from + f64::from(number - self.range.first) / animation.fps;
        let moment = self.animation.as_ref().map(|animation| Moment {
            animation: animation.name.clone(),
            seconds: seconds(animation),
        });
        let value = |field: &str| match field {
            "scene" => stem(scene),
            "camera" => camera.cloned().unwrap_or_else(|| "camera".into()),
            "job" => self.name.clone(),
            "frame" => number.to_string(),
            "time" => moment.as_ref().map_or(0.0, |moment| moment.seconds).to_string(),
            swept => sweep
                .iter()
                .find(|(name, _)| name == swept)
                .map_or_else(String::new, |(_, edit)| word(&edit.value)),
        };
        Frame {
            scene: scene.to_owned(),
            camera: camera.cloned(),
            view: self.view(number),
            image: self.image.name(value),
            moment,
            edits: sweep.iter().map(|(_, edit)| edit.clone()).collect(),
            settings: self.settings.clone(),
        }
    }

    fn view(&self, number: u32) -> View {
        match &self.motion {
            Motion::None => View::Own,
            Motion::Turntable { turns, axis, center } => View::Turn {
                turns: turns * f64::from(number - self.range.first) / f64::from(self.range.span()),
                axis: *axis,
                center: *center,
            },
            Motion::Path(keys) => along(keys, f64::from(number)).map_or(View::Own, View::Pose),
        }
    }
}

/// The name of a scene's file, without its kind.
fn stem(scene: &Path) -> String {
    scene
        .file_stem()
        .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

/// A value as names have it.
fn word(value: &Value) -> String {
    match value {
        Value::String(word) => word.clone(),
        Value::Array(values) => values.iter().map(word).collect::<Vec<_>>().join(","),
        value => value.to_string(),
    }
}

/// The numbers of a job's frames: those of its frames, of its path or of its animation.
fn range(form: &At<JobForm>) -> Result<FrameRange, Fault> {
    if let Some(range) = form.frames {
        return Ok(range);
    }
    if form.turntable.is_some() {
        return Err(form.fault("turns without frames: add `frames`, as in `frames = 24`"));
    }
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
    match &form.animation {
        None => Ok(FrameRange::ONE),
        Some(animation) => {
            let seconds = animation.to.map(|to| to - animation.from);
            let frames = seconds.map(|seconds| (seconds * animation.fps).floor() + 1.0);
            let most = MOST_FRAMES as f64;
            let frames = frames.filter(|frames| (1.0..=most).contains(frames));
            frames.map(|last| counted(1.0, last)).ok_or_else(|| {
                animation.fault("has no end: add `frames`, or `to`, in seconds and not before `from`")
            })
        }
    }
}

fn scenes(form: &At<JobForm>, folder: &Path) -> Result<Vec<PathBuf>, Fault> {
    if form.scene.0.is_empty() {
        return Err(form.scene.fault("names no scene: give one, or a list"));
    }
    let path = |name: &String| {
        let path = folder.join(name);
        match path.is_file() {
            true => Ok(path),
            false => Err(form
                .scene
                .fault(format!("there is no file {}: correct the name", path.display()))),
        }
    };
    form.scene.0.iter().map(path).collect()
}

fn motion(form: &At<JobForm>) -> Result<Motion, Fault> {
    match (&form.turntable, &form.path[..]) {
        (Some(turntable), []) => turning(turntable),
        (None, []) => Ok(Motion::None),
        (None, keys) => path(keys),
        (Some(turntable), _) => Err(turntable.fault("stands beside a `path`: keep one of them")),
    }
}

fn turning(form: &At<TurntableForm>) -> Result<Motion, Fault> {
    let axis = DVec3::from(form.axis).try_normalize();
    let axis = axis.ok_or_else(|| form.fault("has no axis: give a direction, as in `axis = [0, 1, 0]`"))?;
    if !form.turns.is_finite() || form.center.is_some_and(|center| !DVec3::from(center).is_finite()) {
        return Err(form.fault("has numbers that are not finite: correct them"));
    }
    Ok(Motion::Turntable {
        turns: form.turns,
        axis,
        center: form.center.map(DVec3::from),
    })
}

fn path(forms: &[At<KeyForm>]) -> Result<Motion, Fault> {
    let mut keys: Vec<Key> = Vec::with_capacity(forms.len());
    for form in forms {
        let pose = Pose {
            from: form.from.into(),
            at: form.at.into(),
            up: form.up.into(),
            y_fov: form.fov.map(f64::to_radians),
        };
        let is_open = |fov: f64| fov > 0.0 && fov < 180.0;
        if !pose.is_possible() || !form.fov.is_none_or(is_open) {
            return Err(form.fault(
                "is no view: `at` must lie apart from `from`, `up` not along the way there, and `fov` between 0 and 180",
            ));
        }
        if !form.frame.is_finite() || keys.last().is_some_and(|before| before.frame >= form.frame) {
            return Err(form.fault("does not come after the one before: order them by their frames"));
        }
        keys.push(Key {
            frame: form.frame,
            pose,
        });
    }
    Ok(Motion::Path(keys))
}

fn animation(form: &At<AnimationForm>) -> Result<Animation, Fault> {
    if !(form.fps > 0.0 && form.fps.is_finite() && form.from.is_finite()) {
        return Err(form.fault("has no time: give `fps` above 0 and `from` in seconds"));
    }
    Ok(Animation {
        name: form.name.as_ref().map(|name| name.0.clone()),
        fps: form.fps,
        from: form.from,
    })
}

fn split(form: Option<&At<SplitForm>>, part: impl Fn(&SplitForm) -> u32) -> Result<u32, Fault> {
    let Some(form) = form else {
        return Ok(1);
    };
    let pieces = form.bands.saturating_mul(form.shares);
    match (1..=MOST_PIECES).contains(&pieces) {
        true => Ok(part(form)),
        false => Err(form.fault(format!(
            "makes {pieces} pieces of a frame: give 1 to {MOST_PIECES}"
        ))),
    }
}

/// The last words of swept keys, by which names have their values.
fn fields(sweep: &BTreeMap<String, At<SweepForm>>) -> Vec<String> {
    let last = |key: &String| Edit::words(key).ok().and_then(|words| words.last().cloned());
    sweep.keys().filter_map(last).collect()
}

fn image(form: &At<JobForm>, swept: &[String]) -> Result<Template, Fault> {
    let mut known = vec!["scene", "camera", "job", "frame", "time"];
    known.extend(swept.iter().map(String::as_str));
    let several = form.camera.0.len() > 1;
    let usual = || {
        let camera = if several { ".{camera}" } else { "" };
        let swept: String = swept.iter().map(|name| format!(".{{{name}}}")).collect();
        format!("{{scene}}{camera}{swept}.{{frame:04}}.png")
    };
    match &form.image {
        Some(text) => Template::parse(text, &known).map_err(|sentence| text.fault(sentence)),
        None => Template::parse(&usual(), &known).map_err(|sentence| form.fault(sentence)),
    }
}

/// Every combination of the values of all keys.
fn combinations(sweep: &BTreeMap<String, At<SweepForm>>) -> Result<Vec<Vec<(String, Edit)>>, Fault> {
    let mut all = vec![Vec::new()];
    for (key, form) in sweep {
        let words = Edit::words(key).map_err(|sentence| form.fault(sentence))?;
        let name = words.last().cloned().unwrap_or_default();
        let values = values(form)?;
        if all.len().saturating_mul(values.len()) > MOST_FRAMES {
            return Err(form.fault(format!("makes more than {MOST_FRAMES} frames: give fewer values")));
        }
        let with = |before: &Vec<(String, Edit)>, value: &Value| {
            let edit = Edit {
                key: words.clone(),
                value: value.clone(),
            };
            before.iter().cloned().chain([(name.clone(), edit)]).collect()
        };
        all = all
            .iter()
            .flat_map(|before| values.iter().map(|value| with(before, value)))
            .collect();
    }
    Ok(all)
}

fn values(form: &At<SweepForm>) -> Result<Vec<Value>, Fault> {
    match &**form {
        SweepForm::List(values) if values.is_empty() => Err(form.fault("has no values: give some")),
        SweepForm::List(values) => Ok(values.clone()),
        SweepForm::Steps(steps) => {
            let count = steps.steps;
            if !(2..=MOST_FRAMES as u32).contains(&count) || !steps.from.is_finite() || !steps.to.is_finite()
            {
                return Err(form.fault(format!(
                    "makes no steps: give finite ends and 2 to {MOST_FRAMES} `steps`"
                )));
            }
            let part = |step: u32| f64::from(step) / f64::from(count - 1);
            let value = |step: u32| steps.from + (steps.to - steps.from) * part(step);
            Ok((0..count).map(|step| Value::Float(value(step))).collect())
        }
    }
}

/// What all jobs have, and what this one has beside or in place of it.
fn flags(
    all: &BTreeMap<String, At<Value>>,
    own: &BTreeMap<String, At<Value>>,
) -> Result<Vec<(String, FlagValue)>, Fault> {
    let mut merged: BTreeMap<&String, &At<Value>> = all.iter().collect();
    merged.extend(own);
    let mut flags = Vec::with_capacity(merged.len());
    for (name, value) in merged {
        match flag_value(value) {
            Some(Some(given)) => flags.push((name.clone(), given)),
            Some(None) => {}
            None => return Err(value.fault("is no setting: give a word, a number, true or false")),
        }
    }
    Ok(flags)
}

/// What a flag is given; an inner nothing where it is off.
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

/// Refuses two frames of one name.
fn check_names(frames: &[Frame], source: &Source) -> Result<(), SceneFileError> {
    let mut taken: HashMap<&Path, usize> = HashMap::with_capacity(frames.len());
    for (number, frame) in frames.iter().enumerate() {
        if let Some(other) = taken.insert(&frame.image, number) {
            let [this, other] = [frame, &frames[other]]
                .map(|frame| format!("{} of job {}", stem(&frame.scene), frame.settings.job));
            let sentence = format!(
                "two frames would both become {} ({other}, {this}): add fields to `image`, as in \
                 \"{{scene}}.{{camera}}.{{frame:04}}.png\"",
                frame.image.display()
            );
            return Err(file_error(&source.path, sentence));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn jobs(text: &str) -> Result<Jobs, String> {
        let folder = tempfile::tempdir().unwrap();
        for scene in ["a.toml", "b.glb"] {
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
    fn a_turntable_steps_evenly_and_does_not_come_back() {
        let jobs = jobs("[[job]]\nscene = \"a.toml\"\nframes = 4\nturntable = {}\n").unwrap();
        let turns: Vec<f64> = jobs
            .frames
            .iter()
            .map(|frame| match frame.view {
                View::Turn {
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
        let text = "[[job]]\nscene = [\"a.toml\", \"b.glb\"]\ncamera = [\"top\", 1]\nframes = \"5-6\"\n\
                    sweep = { \"material.x.ior\" = [1.5, 2], \"ambient\" = { from = 0, to = 1, steps = 3 } }\n";
        let all = names(text);
        assert_eq!(all.len(), 2 * 2 * 2 * 2 * 3);
        assert_eq!(all[0], "a.top.0.0.1.5.0005.png");
        assert_eq!(all.last().unwrap(), "b.1.1.0.2.0006.png");
    }

    #[test]
    fn settings_are_those_of_all_and_its_own() {
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
    fn an_animation_has_frames_from_its_seconds() {
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
    fn what_makes_no_frames_is_told_in_one_sentence() {
        for (text, words) in [
            ("", "has no jobs: add a [[job]]"),
            ("[[job]]\n", "lacks"),
            ("[[job]]\nscene = \"c.toml\"\n", "there is no file"),
            ("[[job]]\nscene = []\n", "names no scene"),
            ("[[job]]\nscene = \"a.toml\"\nframes = 0\n", "has no frames"),
            (
                "[[job]]\nscene = \"a.toml\"\nframes = 2000000\n",
                "more than 1000000 frames",
            ),
            (
                "[[job]]\nscene = \"a.toml\"\nturntable = {}\n",
                "turns without frames",
            ),
            (
                "[[job]]\nscene = \"a.toml\"\nframes = 2\nturntable = { axis = [0, 0, 0] }\n",
                "has no axis",
            ),
            (
                "[[job]]\nscene = \"a.toml\"\ncolour = 2\n",
                "`colour` is not known here",
            ),
            (
                "[[job]]\nscene = \"a.toml\"\nframes = 2\nimage = \"x.png\"\n",
                "two frames would both become x.png",
            ),
            ("[[job]]\nscene = \"a.toml\"\nimage = \"../x.png\"\n", "leads out"),
            (
                "[[job]]\nscene = \"a.toml\"\nsweep = { \"a.b\" = [] }\n",
                "has no values",
            ),
            (
                "[[job]]\nscene = \"a.toml\"\nsweep = { \"a..b\" = [1] }\n",
                "is no key",
            ),
            (
                "[[job]]\nscene = \"a.toml\"\nsweep = { a = { from = 0, to = 1, steps = 1 } }\n",
                "makes no steps",
            ),
            (
                "[[job]]\nscene = \"a.toml\"\nsplit = { bands = 0 }\n",
                "makes 0 pieces",
            ),
            (
                "[[job]]\nscene = \"a.toml\"\nsplit = { bands = 99999, shares = 99999 }\n",
                "pieces of a frame",
            ),
            (
                "[[job]]\nscene = \"a.toml\"\nanimation = { fps = 0, to = 1 }\n",
                "has no",
            ),
            ("[[job]]\nscene = \"a.toml\"\nanimation = {}\n", "has no end"),
            (
                "[[job]]\nscene = \"a.toml\"\nsettings = { spp = { a = 1 } }\n",
                "is no setting",
            ),
            (
                "[[job]]\nscene = \"a.toml\"\npath = [{ frame = 1, from = [0, 0, 0], at = [0, 0, 0] }]\n",
                "is no view",
            ),
            (
                "[[job]]\nscene = \"a.toml\"\npath = [{ frame = 1, from = [0, 0, 5], at = [0, 0, 0] }, \
                 { frame = 1, from = [0, 0, 5], at = [0, 0, 0] }]\n",
                "order them",
            ),
        ] {
            let message = jobs(text).unwrap_err();
            assert!(message.contains(words), "{text}: {message}");
            assert!(
                message.contains("x.jobs.toml") && !message.contains('\n'),
                "{message}"
            );
        }
    }
}
