//! Planned frames of a job file, each with the image that its settings request, parsed as flags of `whit render`. Plans
//! are made before any scene is opened, so that all errors known by then are reported early.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use clap::Parser;

use whit::batch::request::RenderRequest;
use whit::batch::{PlannedFrame, make_folders};
use whit::image::ImageFormat;
use whit::jobs::{FlagValue, Frame, JobSettings, Jobs};
use whit::scene::BuiltInEnvironment;

use super::super::args::{Args, Command};
use super::super::failure::Failure;
use super::super::job::RenderJob;

/// Flags of `whit render` that are not allowed in a job's settings, with the replacement for each.
const REPLACED_FLAGS: [(&str, &str); 16] = [
    ("animation", "give the job an `animation`"),
    ("camera", "give the job a `camera`"),
    ("crop", "render that part with `whit render --crop`"),
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

/// Returns the plans of all frames of a job file.
///
/// # Errors
///
/// Any fault of the file, its settings or the output folder, before anything is rendered.
pub(super) fn plans(jobs: &Path, out: &Path, threads: u32) -> Result<Vec<PlannedFrame>, Failure> {
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
        plans.push(PlannedFrame {
            number,
            frame: frame.clone(),
            request,
            jobs_folder: jobs_folder.clone(),
        });
    }
    Ok(plans)
}

/// Returns whether the value of a setting is the path of a file.
fn is_path(name: &str, word: &str) -> bool {
    let is_built_in = || BuiltInEnvironment::from_name(word).is_some();
    name == "settings" || (name == "environment" && !is_built_in())
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
            FlagValue::Word(word) if is_path(name, word) => {
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
