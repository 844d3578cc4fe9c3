//! Contents of a batch's page: status, times and a thumbnail of each frame.

use std::path::Path;

use super::gallery::{EffectShare, FrameStatus, Gallery, GalleryFrame, thumbnail, thumbnail_side};
use crate::batch::{Batch, BatchOutcome, FrameResult, PlannedFrame};
use crate::image::{ToneMap, load_image};
use crate::render::Category;

/// Returns the gallery of a batch for the file `page`, with thumbnails of all images that exist.
pub fn gallery(batch: &Batch, outcome: &BatchOutcome, title: String, page: &Path) -> Gallery {
    let side = thumbnail_side(batch.plans.len());
    let folder = page.parent().unwrap_or(Path::new(""));
    Gallery {
        title,
        frames: batch
            .plans
            .iter()
            .map(|plan| gallery_frame(plan, (batch, outcome), folder, side))
            .collect(),
        seconds: outcome.seconds,
    }
}

/// Returns a frame of the gallery in `folder`, with a thumbnail of at most `side` pixels.
fn gallery_frame(
    plan: &PlannedFrame,
    (batch, outcome): (&Batch, &BatchOutcome),
    folder: &Path,
    side: u32,
) -> GalleryFrame {
    let path = batch.options.out.join(&plan.frame.image);
    let mut frame = GalleryFrame {
        name: plan.name(),
        image: relative(&path, folder),
        settings: plan.frame.edits.iter().map(ToString::to_string).collect(),
        ..GalleryFrame::default()
    };
    // Fill in the result of this run; without one, an entry of the manifest means that the frame was skipped
    match outcome.records.get(&plan.number) {
        Some(Ok(result)) => add_result(&mut frame, result),
        Some(Err(message)) => {
            frame.status = FrameStatus::Failed;
            frame.message.clone_from(message);
        }
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

fn add_result(frame: &mut GalleryFrame, result: &FrameResult) {
    if !result.is_whole {
        frame.message = "its pieces are rendered, but not merged".into();
    } else {
        frame.status = FrameStatus::Done;
        if result.samples < f64::from(result.head.spp) {
            frame.message = format!("{:.0} samples per pixel within the time limit", result.samples);
        }
    }
    [frame.width, frame.height] = result.head.size;
    frame.spp = result.head.spp;
    let [load, build] = result.setup_seconds;
    frame.seconds = [load, build, result.render_seconds, result.write_seconds];
    // Idle threads are left out: a thread idle in one frame works on the frames rendered concurrently.
    let busy = Category::ALL
        .into_iter()
        .filter(|&account| account != Category::Idle);
    let share = |account: Category| {
        let tally = result.ledger.of(account);
        EffectShare {
            name: account.name(),
            seconds: tally.seconds,
            rays: tally.rays,
        }
    };
    frame.ledger = busy.map(share).collect();
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
