//! Plans of a batch: its frames, each with the request that its settings describe. Plans are made before any scene
//! is opened, so that all errors known by then are reported early.

use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Parser;

use whit::batch::request::RenderRequest;
use whit::image::{ImageFormat, check_writable};
use whit::jobs::{FlagValue, Frame, JobSettings, Jobs};

use super::super::args::{Args, Command};
use super::super::failure::Failure;
use super::super::job::RenderJob;

/// Flags of `whit render` that are not allowed in a job's settings, with the replacement for each.
const REPLACED_FLAGS: [(&str, &str); 15] = [
    ("animation", "give the job an `animation`"),
    ("camera", "give the job a `camera`"),
    (
        "error",
        "choose settings with `whit cost` and give their file as `settings = { settings = \"FILE\" }`",
    ),
    ("format", "end `image` in .png or .exr"),
    ("heat", "render that frame with `whit render --heat`"),
    ("max-time", "give `whit batch` a `--time`"),
    ("out", "give `whit batch` an `--out`"),
    ("output", "give the job an `image`"),
    ("pilot", "leave it out"),
    ("progress", "give it to `whit batch`"),
    ("quiet", "give it to `whit batch`"),
    ("stats", "read the manifest in the output folder"),
    ("tev", "give it to `whit batch`"),
    ("threads", "give it to `whit batch`"),
    ("time", "give the job an `animation`"),
];

/// Frame of a batch with its render job.
#[derive(Clone, Debug)]
pub(in crate::cli) struct Plan {
    /// Index of the frame in the batch.
    pub(super) number: usize,
    pub(super) frame: Frame,
    /// Requested image, shared by all frames of a job that have the same image format.
    pub(super) request: Arc<RenderRequest>,
    /// Folder of the job file, which paths in settings are relative to.
    pub(super) jobs_folder: Arc<Path>,
}

impl Plan {
    /// Returns the name of the frame in messages: its image path.
    pub(super) fn name(&self) -> String {
        self.frame.image.display().to_string()
    }

    /// Returns whether both frames can share one loaded scene.
    pub(super) fn shares_scene_with(&self, other: &Plan) -> bool {
        let (a, b) = (&self.frame, &other.frame);
        Arc::ptr_eq(&a.settings, &b.settings)
            && Arc::ptr_eq(&self.request, &other.request)
            && (&a.scene, &a.moment, &a.edits) == (&b.scene, &b.moment, &b.edits)
    }

    /// Returns the number of pieces that the job divides the frame into.
    pub(super) fn piece_count(&self) -> usize {
        self.frame.settings.bands as usize * self.frame.settings.shares as usize
    }
}

/// Returns an error if a frame that must be rendered at once is to be divided.
///
/// # Errors
///
/// The error of the first such frame.
pub(super) fn check_division(plans: &[Plan], time: Option<f64>) -> Result<(), Failure> {
    for plan in plans {
        let refuse = |fault: &str| Err(Failure::Input(format!("{}: {fault}", plan.name())));
        if plan.request.must_render_at_once() && (plan.piece_count() > 1 || time.is_some()) {
            return refuse(
                "adaptive sampling and channels of rays and time require rendering the whole frame at once: leave out \
                 `split` and `--time`",
            );
        }
        if (plan.frame.settings.shares > 1 || time.is_some()) && plan.request.has_first_hit_aovs() {
            return refuse(
                "shares and `--time` support only `aov = \"samples\"`: leave out the other channels",
            );
        }
    }
    Ok(())
}

/// Removes temporary files that killed processes have left in the folders of the images.
pub(super) fn remove_leftovers(plans: &[Plan], out: &Path) {
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
            // Files that cannot be removed do no harm.
            let _ = fs::remove_file(path);
        }
    }
}

/// Returns the plans of all frames of a job file.
///
/// # Errors
///
/// Any fault of the file, its settings or the output folder, before anything is rendered.
pub(in crate::cli) fn plans(jobs: &Path, out: &Path, threads: u32) -> Result<Vec<Plan>, Failure> {
    let jobs = Jobs::load(jobs)?;
    make_folders(&jobs, out)?;
    let mut known: HashMap<(*const JobSettings, ImageFormat), Arc<RenderRequest>> = HashMap::new();
    let mut plans = Vec::with_capacity(jobs.frames.len());
    let jobs_folder: Arc<Path> = jobs.path.parent().unwrap_or(Path::new("")).into();
    // Parse the settings once per job and image format
    for (number, frame) in jobs.frames.iter().enumerate() {
        let format = ImageFormat::of_path(&frame.image).ok_or_else(|| {
            let (jobs, image) = (jobs.path.display(), frame.image.display());
            Failure::Input(format!(
                "{jobs}: the file name {image} has no known image format: end `image` in .png or .exr"
            ))
        })?;
        let key = (Arc::as_ptr(&frame.settings), format);
        let request = match known.get(&key) {
            Some(request) => request.clone(),
            None => {
                let request = Arc::new(parse_request(&jobs.path, frame, out, threads)?);
                known.insert(key, request.clone());
                request
            }
        };
        // Keep the frame with its shared request
        plans.push(Plan {
            number,
            frame: frame.clone(),
            request,
            jobs_folder: jobs_folder.clone(),
        });
    }
    Ok(plans)
}

/// Creates the folders of all images, and checks that files can be written to them.
fn make_folders(jobs: &Jobs, out: &Path) -> Result<(), Failure> {
    let mut folders: Vec<PathBuf> = vec![out.to_owned()];
    folders.extend(
        jobs.frames
            .iter()
            .filter_map(|frame| Some(out.join(frame.image.parent()?))),
    );
    // Create each folder once
    folders.sort();
    folders.dedup();
    for folder in folders {
        fs::create_dir_all(&folder).map_err(|error| {
            Failure::Input(format!(
                "cannot create the folder {} ({error}): choose another `--out`",
                folder.display()
            ))
        })?;
        check_writable(&folder.join("picture.png"))?;
    }
    Ok(())
}

/// Returns the requested image of a frame, by parsing its settings as flags of `whit render`.
fn parse_request(jobs: &Path, frame: &Frame, out: &Path, threads: u32) -> Result<RenderRequest, Failure> {
    let refuse = |fault: String| {
        let (jobs, job) = (jobs.display(), &frame.settings.job);
        Failure::Input(format!("{jobs}: settings of job {job}: {fault}"))
    };
    // Translate the settings to flags; paths are relative to the job file
    let mut words = vec!["whit".to_owned(), "render".into(), format!("--threads={threads}")];
    for (name, value) in &frame.settings.flags {
        if let Some((_, way)) = REPLACED_FLAGS.iter().find(|(other, _)| other == name) {
            return Err(refuse(format!("`{name}` is not a setting of a job: {way}")));
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
    // Parse the command line as clap does for `whit render`
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
    let Some(Command::Render(args)) = args.command else {
        return Err(refuse(
            "they are not settings of a render: give flags of `whit render`".into(),
        ));
    };
    // Report errors in terms of the job file
    let job = RenderJob::new(&args).map_err(|failure| match failure {
        Failure::Input(fault) => refuse(fault),
        failure => failure,
    })?;
    Ok(job.request)
}
