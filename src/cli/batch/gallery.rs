//! HTML page of a batch: status, times and a thumbnail of each frame.

use std::collections::HashMap;
use std::path::Path;

use whit::batch::Manifest;
use whit::image::{ToneMap, load_image, write_atomically};
use whit::render::{Category, RenderProfile};
use whit::report::gallery::{
    EffectShare, FrameSeconds, FrameStatus, Gallery, GalleryFrame, thumbnail, thumbnail_side,
};

use super::super::args::BatchArgs;
use super::super::failure::Failure;
use super::built_scene::BuiltScene;
use super::frame::FrameResult;
use super::plan::Plan;

/// Result of a frame for the page.
pub(super) struct Record {
    status: FrameStatus,
    message: String,
    size: [u32; 2],
    spp: u32,
    seconds: FrameSeconds,
    ledger: RenderProfile,
}

impl Record {
    pub(super) fn of(made: &FrameResult, stage: &BuiltScene, status: FrameStatus) -> Record {
        let message = match status {
            FrameStatus::Missing => "its pieces are rendered, but not merged".into(),
            _ if made.samples < f64::from(made.head.spp) => {
                format!("{:.0} samples per pixel within the time limit", made.samples)
            }
            _ => String::new(),
        };
        let [load, build] = stage.seconds_once();
        Record {
            status,
            message,
            size: made.head.size,
            spp: made.head.spp,
            seconds: FrameSeconds {
                load,
                build,
                render: made.render_seconds,
                write: made.write_seconds,
            },
            ledger: made.ledger,
        }
    }

    pub(super) fn failed(failure: &Failure) -> Record {
        Record {
            status: FrameStatus::Failed,
            message: failure.to_string(),
            size: [0; 2],
            spp: 0,
            seconds: FrameSeconds::default(),
            ledger: RenderProfile::default(),
        }
    }
}

/// Contents of the page, collected while the batch runs.
pub(super) struct Page<'a> {
    args: &'a BatchArgs,
    plans: &'a [Plan],
    /// Results of frames, by the index of their plans.
    records: HashMap<usize, Record>,
}

impl<'a> Page<'a> {
    pub(super) fn new(args: &'a BatchArgs, plans: &'a [Plan]) -> Page<'a> {
        Page {
            args,
            plans,
            records: HashMap::new(),
        }
    }

    pub(super) fn record(&mut self, number: usize, record: Record) {
        if self.args.html.is_some() {
            self.records.insert(number, record);
        }
    }

    /// Writes the page to `path`, with thumbnails of all images that exist.
    pub(super) fn write(&self, path: &Path, manifest: &Manifest, seconds: f64) -> Result<(), Failure> {
        let side = thumbnail_side(self.plans.len());
        let frames = self
            .plans
            .iter()
            .map(|plan| self.frame(plan, manifest, (path, side)));
        let gallery = Gallery {
            title: self.args.jobs.display().to_string(),
            frames: frames.collect(),
            seconds,
            machine: None,
            facts: vec![("command".into(), "whit batch".into())],
        };
        let page = gallery.page();
        write_atomically(path, |file| std::io::Write::write_all(file, page.as_bytes()))?;
        Ok(())
    }

    fn frame(&self, plan: &Plan, manifest: &Manifest, (page, side): (&Path, u32)) -> GalleryFrame {
        let path = self.args.out.join(&plan.frame.image);
        let mut frame = GalleryFrame {
            name: plan.name(),
            image: relative(&path, page.parent().unwrap_or(Path::new(""))),
            settings: plan.frame.edits.iter().map(ToString::to_string).collect(),
            ..GalleryFrame::default()
        };
        // Fill in the result of this run; without one, an entry of the manifest means that the frame was skipped
        match self.records.get(&plan.number) {
            Some(record) => {
                frame.status = record.status;
                frame.message.clone_from(&record.message);
                [frame.width, frame.height] = record.size;
                frame.spp = record.spp;
                frame.seconds = record.seconds;
                add_ledger(&mut frame, &record.ledger);
            }
            None if manifest.has(&plan.frame.image) => frame.status = FrameStatus::Skipped,
            None => {}
        }
        // Make the thumbnail from the image on disk, which an earlier run may have rendered
        if matches!(frame.status, FrameStatus::Done | FrameStatus::Skipped)
            && let Ok(loaded) = load_image(&path)
        {
            let image = loaded.image;
            [frame.width, frame.height] = [image.width, image.height];
            frame.thumbnail = thumbnail(&image, side, ToneMap::default()).unwrap_or_default();
        }
        frame
    }
}

fn add_ledger(frame: &mut GalleryFrame, ledger: &RenderProfile) {
    // Idle threads are left out: a thread idle in one frame works on the frames rendered concurrently.
    for account in Category::ALL
        .into_iter()
        .filter(|&account| account != Category::Idle)
    {
        let tally = ledger.of(account);
        if tally.rays > 0 {
            frame.rays.insert(account.name().to_owned(), tally.rays);
        }
        if tally.seconds > 0.0 {
            frame.ledger.push(EffectShare {
                name: account.name().to_owned(),
                seconds: tally.seconds,
                rays: tally.rays,
            });
        }
    }
}

/// Returns the path of a file relative to a folder, with slashes; an absolute path where no relative one exists.
fn relative(file: &Path, folder: &Path) -> String {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let (file, folder) = (absolute(file), absolute(folder));
    let shared = file
        .components()
        .zip(folder.components())
        .take_while(|(a, b)| a == b)
        .count();
    let up = folder.components().skip(shared).map(|_| "..".to_owned());
    let down = file
        .components()
        .skip(shared)
        .map(|part| part.as_os_str().to_string_lossy().into_owned());
    up.chain(down).collect::<Vec<_>>().join("/")
}
