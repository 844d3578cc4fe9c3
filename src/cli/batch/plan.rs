//! What a batch is to make: its frames, each with the render command that its settings mean. Made before any scene is
//! opened; whatever can be told before is told here.

use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Parser;

use crate::image::{ImageFormat, check_writable};
use crate::jobs::{FlagValue, Frame, JobSettings, Jobs};

use super::super::args::{Args, Command};
use super::super::failure::Failure;
use super::super::job::RenderJob;

/// Flags of `whit render` that a batch says in its own way, with that way.
const SAID_OTHERWISE: [(&str, &str); 15] = [
    ("animation", "give the job an `animation`"),
    ("camera", "give the job a `camera`"),
    (
        "error",
        "choose settings with `whit cost` and give its file as `settings = { settings = \"FILE\" }`",
    ),
    ("format", "end `image` in .png or .exr"),
    ("heat", "render that frame with `whit render --heat`"),
    ("max-time", "give `whit batch` a `--time`"),
    ("out", "give `whit batch` an `--out`"),
    ("output", "give the job an `image`"),
    ("pilot", "leave it out"),
    ("progress", "give it to `whit batch`"),
    ("quiet", "give it to `whit batch`"),
    ("stats", "look into the manifest in the folder of results"),
    ("tev", "give it to `whit batch`"),
    ("threads", "give it to `whit batch`"),
    ("time", "give the job an `animation`"),
];

/// A frame and how it is rendered.
#[derive(Clone, Debug)]
pub(in crate::cli) struct Plan {
    /// Its number in the batch.
    pub(super) number: usize,
    pub(super) frame: Frame,
    /// The same for all frames of a job that are files of one kind.
    pub(super) job: Arc<RenderJob>,
    /// Where files that settings name lie.
    pub(super) jobs_folder: Arc<Path>,
}

impl Plan {
    /// How it may be called in messages.
    pub(super) fn name(&self) -> String {
        self.frame.image.display().to_string()
    }

    /// Whether both frames are of one loaded scene.
    pub(super) fn shares_scene_with(&self, other: &Plan) -> bool {
        let (a, b) = (&self.frame, &other.frame);
        Arc::ptr_eq(&a.settings, &b.settings)
            && Arc::ptr_eq(&self.job, &other.job)
            && (&a.scene, &a.moment, &a.edits) == (&b.scene, &b.moment, &b.edits)
    }

    /// How many pieces it is asked to be made in.
    pub(super) fn piece_count(&self) -> usize {
        self.frame.settings.bands as usize * self.frame.settings.shares as usize
    }
}

/// Refuses to divide frames that depend on all of themselves.
///
/// # Errors
///
/// The first of them.
pub(super) fn check_division(plans: &[Plan], time: Option<f64>) -> Result<(), Failure> {
    for plan in plans {
        let refuse = |fault: &str| Err(Failure::Input(format!("{}: {fault}", plan.name())));
        if plan.job.is_one() && (plan.piece_count() > 1 || time.is_some()) {
            return refuse(
                "adaptive sampling and channels of rays and time need the whole frame at once: leave out `split` and `--time`",
            );
        }
        if (plan.frame.settings.shares > 1 || time.is_some()) && plan.job.has_layers() {
            return refuse(
                "of the further channels only `samples` can be summed up from shares: leave the others out",
            );
        }
    }
    Ok(())
}

/// Removes what processes have left in the folders of pictures that were killed while they wrote.
pub(super) fn sweep_up(plans: &[Plan], out: &Path) {
    let folders: BTreeSet<PathBuf> = plans
        .iter()
        .filter_map(|plan| Some(out.join(plan.frame.image.parent()?)))
        .collect();
    let entries = folders
        .iter()
        .filter_map(|folder| fs::read_dir(folder).ok())
        .flatten();
    for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
        let is_left_over = |name: &str| name.starts_with(".whit-") && name.ends_with(".tmp");
        if path
            .file_name()
            .and_then(|name| name.to_str())
            .is_some_and(is_left_over)
        {
            // What cannot be removed is only in the way.
            let _ = fs::remove_file(path);
        }
    }
}

/// The plans of all frames of a job file.
///
/// # Errors
///
/// What is wrong with the file, its settings or the folder, before anything is rendered.
pub(in crate::cli) fn plans(jobs: &Path, out: &Path, threads: u32) -> Result<Vec<Plan>, Failure> {
    let jobs = Jobs::load(jobs)?;
    make_folders(&jobs, out)?;
    let mut known: HashMap<(*const JobSettings, ImageFormat), Arc<RenderJob>> = HashMap::new();
    let mut plans = Vec::with_capacity(jobs.frames.len());
    let jobs_folder: Arc<Path> = jobs.path.parent().unwrap_or(Path::new("")).into();
    for (number, frame) in jobs.frames.iter().enumerate() {
        let format = ImageFormat::of_path(&frame.image).ok_or_else(|| {
            let (jobs, image) = (jobs.path.display(), frame.image.display());
            Failure::Input(format!(
                "{jobs}: cannot tell the kind of image from the name {image}: end `image` in .png or .exr"
            ))
        })?;
        let key = (Arc::as_ptr(&frame.settings), format);
        let job = match known.get(&key) {
            Some(job) => job.clone(),
            None => {
                let job = Arc::new(render_job(&jobs.path, frame, out, threads)?);
                known.insert(key, job.clone());
                job
            }
        };
        plans.push(Plan {
            number,
            frame: frame.clone(),
            job,
            jobs_folder: jobs_folder.clone(),
        });
    }
    Ok(plans)
}

/// Makes the folders of all pictures, and checks that they take files.
fn make_folders(jobs: &Jobs, out: &Path) -> Result<(), Failure> {
    let mut folders: Vec<PathBuf> = vec![out.to_owned()];
    folders.extend(
        jobs.frames
            .iter()
            .filter_map(|frame| Some(out.join(frame.image.parent()?))),
    );
    folders.sort();
    folders.dedup();
    for folder in folders {
        fs::create_dir_all(&folder).map_err(|error| {
            Failure::Input(format!(
                "cannot make the folder {} ({error}): choose another `--out`",
                folder.display()
            ))
        })?;
        check_writable(&folder.join("picture.png"))?;
    }
    Ok(())
}

/// What the settings of a frame mean, as flags of `whit render`.
fn render_job(jobs: &Path, frame: &Frame, out: &Path, threads: u32) -> Result<RenderJob, Failure> {
    let refuse = |fault: String| {
        let (jobs, job) = (jobs.display(), &frame.settings.job);
        Failure::Input(format!("{jobs}: settings of job {job}: {fault}"))
    };
    let mut words = vec!["whit".to_owned(), "render".into(), format!("--threads={threads}")];
    for (name, value) in &frame.settings.flags {
        if let Some((_, way)) = SAID_OTHERWISE.iter().find(|(other, _)| other == name) {
            return Err(refuse(format!("`{name}` is no setting of a job: {way}")));
        }
        words.push(match value {
            FlagValue::None => format!("--{name}"),
            FlagValue::Word(word) if name == "settings" => {
                let beside = jobs.parent().unwrap_or(Path::new("")).join(word);
                format!("--{name}={}", beside.display())
            }
            FlagValue::Word(word) => format!("--{name}={word}"),
        });
    }
    let paths = [
        Path::new("-o"),
        &out.join(&frame.image),
        Path::new("--"),
        &frame.scene,
    ];
    let words = words.into_iter().map(Into::into);
    let words = words.chain(paths.iter().map(|path| path.as_os_str().to_owned()));
    let args = Args::try_parse_from(words).map_err(|error| {
        let text = error.render().to_string();
        let first = text.lines().next().unwrap_or_default();
        refuse(first.strip_prefix("error: ").unwrap_or(first).to_owned())
    })?;
    let Command::Render(args) = args.command else {
        return Err(refuse("are no settings of a render".into()));
    };
    RenderJob::new(&args).map_err(|failure| match failure {
        Failure::Input(fault) => refuse(fault),
        failure => failure,
    })
}
