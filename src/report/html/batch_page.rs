//! Contents of a batch's page: status, times and a thumbnail of each frame.

use std::path::Path;

use super::gallery::{
    EffectShare, FrameSeconds, FrameStatus, Gallery, GalleryFrame, thumbnail, thumbnail_side,
};
use crate::batch::{Batch, BatchOutcome, FrameRecord, PlannedFrame};
use crate::image::{ToneMap, load_image};
use crate::render::{Category, RenderProfile};

/// Returns the gallery of a batch for the file `page`, with thumbnails of all images that exist.
pub fn gallery(batch: &Batch, outcome: &BatchOutcome, title: String, page: &Path) -> Gallery {
    let plans = batch.plans();
    let side = thumbnail_side(plans.len());
    let folder = page.parent().unwrap_or(Path::new(""));
    Gallery {
        title,
        frames: plans
            .iter()
            .map(|plan| gallery_frame(plan, (batch, outcome), folder, side))
            .collect(),
        seconds: outcome.seconds,
        machine: None,
        facts: vec![("command".into(), "whit batch".into())],
    }
}

/// Returns a frame of the gallery in `folder`, with a thumbnail of at most `side` pixels.
fn gallery_frame(
    plan: &PlannedFrame,
    (batch, outcome): (&Batch, &BatchOutcome),
    folder: &Path,
    side: u32,
) -> GalleryFrame {
    let path = batch.image_path(plan);
    let mut frame = GalleryFrame {
        name: plan.name(),
        image: relative(&path, folder),
        settings: plan.frame.edits.iter().map(ToString::to_string).collect(),
        ..GalleryFrame::default()
    };
    // Fill in the result of this run; without one, an entry of the manifest means that the frame was skipped
    match outcome.records.get(&plan.number) {
        Some(record) => add_record(&mut frame, record),
        None if batch.has_image(plan) => frame.status = FrameStatus::Skipped,
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

fn add_record(frame: &mut GalleryFrame, record: &FrameRecord) {
    match record {
        FrameRecord::Failed(message) => {
            frame.status = FrameStatus::Failed;
            frame.message.clone_from(message);
        }
        FrameRecord::Rendered {
            is_whole,
            size,
            spp,
            samples,
            setup_seconds: [load, build],
            seconds: [render, write],
            ledger,
        } => {
            if *is_whole {
                frame.status = FrameStatus::Done;
                if *samples < f64::from(*spp) {
                    frame.message = format!("{samples:.0} samples per pixel within the time limit");
                }
            } else {
                frame.message = "its pieces are rendered, but not merged".into();
            }
            [frame.width, frame.height] = *size;
            frame.spp = *spp;
            frame.seconds = FrameSeconds {
                load: *load,
                build: *build,
                render: *render,
                write: *write,
            };
            add_ledger(frame, ledger);
        }
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
