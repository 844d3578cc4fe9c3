//! Rendering of one frame of a batch, or of this process's pieces of it: rows after rows, saved at intervals.

use std::borrow::Cow;
use std::ops::{ControlFlow, Range};
use std::time::Instant;

use super::built_scene::BuiltScene;
use super::observer::{BatchObserver, FrameEvent};
use super::queue::Task;
use super::row_schedule::{MAX_BUFFERED_BYTES, RowSteps, must_render_at_once};
use crate::accel::Accel;
use crate::batch::error::BatchError;
use crate::batch::options::BatchOptions;
use crate::batch::pieces::{
    self, Chunk, ChunkDirectory, ChunkKind, ChunkLayout, FrameMetadata, Merge, MergeError, add_sums,
    color_planes, planes_of,
};
use crate::batch::plan::PlannedFrame;
use crate::batch::request::{Notes, ProjectedAccel, RenderRequest, ResolvedSettings, channels};
use crate::image::{ImageError, PngEncoding};
use crate::render::{
    self, Cancelled, Checkpoints, FinishedTile, Layer, Monitor, PartSums, Parts, Plan as EffectPlan, Region,
    RenderProfile, Rendering, Rounds, Share,
};
use crate::scene::Camera;

/// Result of rendering a frame or some of its pieces.
pub(crate) struct FrameResult {
    /// Metadata of the frame.
    pub head: FrameMetadata,
    /// True if the image is complete in its place; otherwise only pieces are on disk.
    pub is_whole: bool,
    /// Mean number of samples per pixel.
    pub samples: f64,
    /// Seconds of loading and of building; 0 except for the first frame of a scene.
    pub setup_seconds: [f64; 2],
    /// Seconds of rendering the image.
    pub render_seconds: f64,
    /// Seconds of writing pieces and the image.
    pub write_seconds: f64,
    /// Rays and seconds by effect.
    pub ledger: RenderProfile,
}

/// State of a frame that is being rendered.
pub(super) struct FrameTask<'a> {
    plan: &'a PlannedFrame,
    request: RenderRequest,
    resolved: ResolvedSettings,
    stage: &'a BuiltScene<'a>,
    camera: Camera,
    options: &'a BatchOptions,
    folder: ChunkDirectory,
    monitor: Monitor<'a>,
    observer: &'a BatchObserver<'a>,
    /// Finished rows that are not on disk yet, in order.
    buffered: Vec<(Range<u32>, Vec<Layer>)>,
    buffered_since: Instant,
    /// True if pieces of the frame are on disk.
    has_pieces: bool,
    /// True if a checkpoint of adaptive sampling is on disk.
    has_rounds: bool,
    ledger: RenderProfile,
    write_seconds: f64,
}

/// Renders some of the pieces of a frame, by their indices, and writes the image if all its pieces are there then.
pub(super) fn make(
    task: &Task,
    stage: &BuiltScene,
    options: &BatchOptions,
    observer: &BatchObserver,
) -> Result<FrameResult, BatchError> {
    let start = Instant::now();
    // Connect the progress, the live preview and the cancellation flag
    let progress = |fraction| (observer.event)(task.plan, FrameEvent::Progress(fraction));
    let show = observer
        .tiles
        .map(|show| move |tile: FinishedTile| show(task.plan, tile));
    let monitor = Monitor {
        progress: &progress,
        cancel: observer.cancel,
        tiles: show.as_ref().map(|show| show as _),
    };
    // Prepare the frame: settings, camera, metadata
    let mut frame_task = FrameTask::new(task, (stage, options), observer, monitor)?;
    let settings = frame_task.resolved.settings;
    let pieces = task.pieces.clone();
    // Choose the strategy: limited time, whole image at once, all rows, or single pieces
    let is_whole_frame = pieces.len() == task.plan.piece_count();
    let samples = if let Some(seconds) = options.time {
        frame_task.render_in_time(seconds)?
    } else if must_render_at_once(&settings) {
        frame_task.render_at_once()?
    } else if is_whole_frame {
        let all = frame_task.folder.cut().all();
        frame_task.render_rows(&all)?;
        f64::from(settings.spp)
    } else {
        frame_task.render_chunks(pieces)?;
        f64::from(settings.spp)
    };
    // Write the image if the frame is complete
    let is_whole = frame_task.finish()?;
    Ok(FrameResult {
        is_whole,
        samples,
        setup_seconds: [0.0; 2],
        render_seconds: start.elapsed().as_secs_f64() - frame_task.write_seconds,
        write_seconds: frame_task.write_seconds,
        ledger: frame_task.ledger,
        head: frame_task.folder.head().clone(),
    })
}

impl<'a> FrameTask<'a> {
    fn new(
        task: &Task<'a>,
        (stage, options): (&'a BuiltScene<'a>, &'a BatchOptions),
        observer: &'a BatchObserver<'a>,
        monitor: Monitor<'a>,
    ) -> Result<FrameTask<'a>, BatchError> {
        let plan = task.plan;
        let request = plan.request.for_output(&stage.loaded.file.output);
        let mut resolved = request.resolved(&stage.loaded.file.output)?;
        let size = [resolved.settings.width, resolved.settings.height];
        (observer.event)(plan, FrameEvent::Sized(size));
        // The batch's page shows the ray counts of the ledger; recording them changes no pixel.
        resolved.settings.ledger = true;
        plan.check_shares(&resolved.settings, options.time)?;
        let camera = stage.loaded.camera(plan)?;
        // Collect the metadata of the image
        let effects = EffectPlan::new(&stage.scene, &camera, &resolved.settings.effects);
        let embree = stage.accel.report().embree;
        let mut notes = Notes::of(
            (&request, &resolved),
            (&stage.scene, &camera),
            embree.as_ref(),
            &effects,
        );
        notes.add("whit.files", task.recipe.files.clone());
        // Describe the frame for its pieces, so that another process can merge them
        let head = FrameMetadata {
            key: task.recipe.key,
            number: plan.number,
            image: plan.frame.image.clone(),
            size,
            spp: resolved.settings.spp,
            shares: plan.frame.settings.shares,
            exr: request.encoding.exr,
            png: PngEncoding {
                tone: resolved.tone,
                operator: resolved.operator,
                bits: request.encoding.png_bits,
            },
            notes,
        };
        Ok(FrameTask {
            plan,
            request,
            resolved,
            stage,
            camera,
            folder: ChunkDirectory::new(&options.out, head),
            options,
            monitor,
            observer,
            buffered: Vec::new(),
            buffered_since: Instant::now(),
            has_pieces: false,
            has_rounds: false,
            ledger: RenderProfile::default(),
            write_seconds: 0.0,
        })
    }

    /// Renders the whole image at once, from the last checkpoint if there is one; returns the samples per pixel.
    fn render_at_once(&mut self) -> Result<f64, BatchError> {
        let (stage, request, resolved, monitor) =
            (self.stage, self.request.clone(), self.resolved, self.monitor);
        let camera = self.camera.clone();
        let projected = self.projected_accel();
        // Costs of pixels are not part of a checkpoint, so such images cannot be resumed.
        let can_go_on = !resolved.settings.cost_aovs;
        let start = can_go_on.then(|| self.folder.read_rounds());
        let start = start.transpose()?.flatten();
        self.has_rounds = start.is_some();
        // Save a checkpoint at intervals, and stop rendering if that fails
        let seconds = self.options.checkpoint;
        let mut failure = None;
        let mut keep = |rounds: &Rounds| match self.save(|folder| folder.write_rounds(rounds)) {
            Ok(()) => {
                self.has_rounds = true;
                ControlFlow::Continue(())
            }
            Err(error) => {
                failure = Some(error);
                ControlFlow::Break(())
            }
        };
        let mut checkpoints = Checkpoints {
            start,
            seconds,
            keep: &mut keep,
        };
        // Render, then keep the rows in memory
        let rendered = render::render_on(
            stage.scene,
            &camera,
            projected.accel(),
            &resolved.settings,
            &monitor,
            can_go_on.then_some(&mut checkpoints),
        );
        let Ok(rendering) = rendered else {
            return Err(failure.unwrap_or(Cancelled.into()));
        };
        self.keep(
            0..resolved.settings.height,
            planes_of_rendering(&request, &rendering),
        );
        self.ledger += rendering.ledger;
        Ok(rendering.samples.mean)
    }

    /// Renders the whole image with as many packets of samples as fit into the time; returns the samples per pixel.
    fn render_in_time(&mut self, seconds: f64) -> Result<f64, BatchError> {
        let start = Instant::now();
        let settings = self.resolved.settings;
        let region = Region::whole(&settings);
        let stage = self.stage;
        let mut parts = self.parts(&*stage.accel)?;
        let packet_count = parts.packet_count();
        let mut all: Option<PartSums> = None;
        let mut done = 0;
        while done < packet_count {
            // Estimate from the packets so far how many more fit into the time
            let next =
                affordable_packets(done, start.elapsed().as_secs_f64(), seconds).min(packet_count - done);
            if next == 0 {
                break;
            }
            let (sums, ledger) = parts.sums_of(&region, done..done + next, &self.monitor)?;
            self.ledger += ledger;
            add_sums(&mut all, sums);
            done += next;
        }
        let sums = all.ok_or(Cancelled)?;
        self.keep(0..settings.height, planes_of(&sums));
        Ok(f64::from(sums.samples))
    }

    /// Renders all samples of the missing rows of a piece.
    fn render_rows(&mut self, piece: &Chunk) -> Result<(), BatchError> {
        let missing = self.missing(piece)?;
        if missing.is_empty() {
            return Ok(());
        }
        // Trace camera rays with screen bounds where they pay
        let height = self.resolved.settings.height;
        let projected = self.projected_accel();
        let mut parts = self.parts(projected.accel())?;
        // Render each gap in steps, whose height follows the time of the steps before
        for rows in missing {
            let mut steps = self.steps(rows);
            while let Some(rows) = steps.next() {
                let begun = Instant::now();
                match self.rows(&mut parts, &rows) {
                    Ok(planes) => self.keep(rows.clone(), planes),
                    Err(failure) => {
                        // Finished rows are saved before the interruption is reported.
                        self.flush()?;
                        return Err(failure);
                    }
                }
                steps.adapt(&rows, begun.elapsed().as_secs_f64());
                // Save the rows at the checkpoint interval, or when they take too much memory
                let is_due = self.buffered_since.elapsed().as_secs_f64() >= self.options.checkpoint;
                if (is_due && rows.end < height) || self.buffered_bytes() > MAX_BUFFERED_BYTES {
                    self.flush()?;
                }
            }
        }
        Ok(())
    }

    /// Renders all samples of some rows.
    fn rows(&mut self, parts: &mut Parts, rows: &Range<u32>) -> Result<Vec<Layer>, BatchError> {
        let settings = self.resolved.settings;
        let region = Region::of_rows(&settings, rows.clone());
        // Map the progress of these rows to that of the frame
        let height = f64::from(settings.height);
        let (before, part) = (f64::from(rows.start) / height, f64::from(region.height) / height);
        let progress = |fraction: f64| (self.monitor.progress)(before + part * fraction);
        let monitor = Monitor {
            progress: &progress,
            ..self.monitor
        };
        // Without shares, render the rows directly
        let count = self.plan.frame.settings.shares;
        if count == 1 {
            let rendering = parts.region(&region, &monitor)?;
            let planes = planes_of_rendering(&self.request, &rendering);
            self.ledger += rendering.ledger;
            return Ok(planes);
        }
        // With shares, add their sums in order, as a merge of pieces does
        let mut all: Option<PartSums> = None;
        for index in 0..count {
            let (sums, ledger) = parts.sums(&region, Share { index, count }, &monitor)?;
            self.ledger += ledger;
            add_sums(&mut all, sums);
        }
        Ok(all.as_ref().map(planes_of).ok_or(Cancelled)?)
    }

    /// Renders some of the pieces that the frame is divided into, each to a file of its own.
    fn render_chunks(&mut self, numbers: Range<usize>) -> Result<(), BatchError> {
        let settings = self.resolved.settings;
        let requested = &self.plan.frame.settings;
        let cut = ChunkLayout {
            height: settings.height,
            bands: requested.bands.min(ChunkLayout::max_bands(settings.height)),
            shares: requested.shares,
        };
        for number in numbers.start..numbers.end.min(cut.piece_count()) {
            let piece = cut.piece(number);
            match piece.part {
                ChunkKind::All => self.render_rows(&piece)?,
                ChunkKind::Share(share) => self.render_share(&piece, share)?,
            }
            self.flush()?;
        }
        Ok(())
    }

    /// Renders the missing rows of one share of the samples.
    fn render_share(&mut self, piece: &Chunk, index: u32) -> Result<(), BatchError> {
        let settings = self.resolved.settings;
        let missing = self.missing(piece)?;
        if missing.is_empty() {
            return Ok(());
        }
        let stage = self.stage;
        let mut parts = self.parts(&*stage.accel)?;
        let share = self.folder.cut().share(index);
        // Render each gap in steps, and save the sums after each step
        for rows in missing {
            let mut steps = self.steps(rows);
            while let Some(rows) = steps.next() {
                let begun = Instant::now();
                let region = Region::of_rows(&settings, rows.clone());
                let (sums, ledger) = parts.sums(&region, share, &self.monitor)?;
                self.ledger += ledger;
                steps.adapt(&rows, begun.elapsed().as_secs_f64());
                self.save(|folder| folder.write_sums(&rows, index, &sums))?;
                self.has_pieces = true;
            }
        }
        Ok(())
    }

    fn steps(&self, rows: Range<u32>) -> RowSteps {
        let film = self.stage.loaded.film(&self.resolved.settings);
        RowSteps::new(rows, &film, self.options.checkpoint)
    }

    /// Returns the rows of a piece that are still missing.
    fn missing(&mut self, piece: &Chunk) -> Result<Vec<Range<u32>>, BatchError> {
        let unreadable = |error| BatchError::ReadPieces(self.plan.name(), error);
        let coverage = self.folder.coverage().map_err(unreadable)?;
        self.has_pieces |= !coverage.is_empty();
        Ok(coverage.missing(piece))
    }

    fn projected_accel(&self) -> ProjectedAccel<'a> {
        let accel = (&*self.stage.accel, self.request.backend());
        let view = (self.stage.scene.get(), &self.camera);
        ProjectedAccel::new(accel, view, &self.resolved.settings)
    }

    fn parts(&self, accel: &'a dyn Accel) -> Result<Parts<'a>, BatchError> {
        let scene = (self.stage.scene, &self.camera);
        Ok(Parts::new(scene, accel, &self.resolved.settings, &self.monitor)?)
    }

    fn keep(&mut self, rows: Range<u32>, planes: Vec<Layer>) {
        self.show(&rows, &planes);
        if self.buffered.is_empty() {
            self.buffered_since = Instant::now();
        }
        self.buffered.push((rows, planes));
    }

    /// Shows finished rows in the live preview: filtered, and with all of their samples.
    fn show(&self, rows: &Range<u32>, planes: &[Layer]) {
        if let Some(show) = self.monitor.tiles {
            show(FinishedTile {
                x: 0,
                y: rows.start,
                width: self.resolved.settings.width,
                height: rows.end - rows.start,
                pixels: &pieces::colors(planes),
            });
        }
    }

    fn buffered_bytes(&self) -> usize {
        let planes = self.buffered.iter().flat_map(|(_, planes)| planes);
        planes.map(|plane| size_of_val(&plane.values[..])).sum()
    }

    /// Writes the finished rows in memory to disk.
    fn flush(&mut self) -> Result<(), BatchError> {
        for (rows, planes) in join_rows(std::mem::take(&mut self.buffered)) {
            self.save(|folder| folder.write_finished(&rows, &planes))?;
            self.has_pieces = true;
        }
        Ok(())
    }

    fn save(&mut self, write: impl Fn(&ChunkDirectory) -> Result<(), ImageError>) -> Result<(), BatchError> {
        let start = Instant::now();
        let attempt = || -> Result<(), BatchError> {
            // Create the folder on the first write
            self.folder.make().map_err(BatchError::CreatePieces)?;
            Ok(self.observer.writes.during(|| write(&self.folder))?)
        };
        match attempt() {
            // Another process has merged the same frame meanwhile and removed the folder of the pieces.
            Err(_) if !self.folder.folder().exists() => attempt()?,
            result => result?,
        }
        self.write_seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Writes the image if all of its rows are there; returns whether they are.
    fn finish(&mut self) -> Result<bool, BatchError> {
        let start = Instant::now();
        let (out, writes) = (&self.options.out, self.observer.writes);
        // Without pieces on disk, write the rows from memory; otherwise merge the pieces
        if !self.has_pieces {
            let head = self.folder.head();
            let mut buffered = std::mem::take(&mut self.buffered).into_iter();
            let rows = || Ok::<_, ImageError>(buffered.next().map(|(_, planes)| planes));
            writes.during(|| pieces::write(out, head, rows))?;
            if self.has_rounds {
                self.folder.remove();
            }
        } else {
            self.flush()?;
            match pieces::merge(out, &self.folder, writes) {
                Ok(()) => {}
                Err(MergeError::Missing { .. }) => return Ok(false),
                // Another process has merged the frame meanwhile: a piece was listed and is gone.
                Err(_) if matches!(Merge::of(&self.folder), Err(MergeError::Missing { .. })) => {
                    return Ok(false);
                }
                Err(error) => return Err(error.into()),
            }
        }
        self.write_seconds += start.elapsed().as_secs_f64();
        Ok(true)
    }
}

/// Returns the number of packets of samples to take next, where `done` packets took `elapsed` seconds: as many again,
/// but no more than fit into the time. The first packet is taken regardless of the time.
fn affordable_packets(done: usize, elapsed: f64, seconds: f64) -> usize {
    match done {
        0 => 1,
        _ => {
            // Estimate the seconds per packet from those done
            let of_packet = (elapsed / done as f64).max(f64::MIN_POSITIVE);
            done.min(((seconds - elapsed) / of_packet).max(0.0) as usize)
        }
    }
}

/// Joins neighbouring ranges of rows.
fn join_rows(buffered: Vec<(Range<u32>, Vec<Layer>)>) -> Vec<(Range<u32>, Vec<Layer>)> {
    let mut all: Vec<(Range<u32>, Vec<Layer>)> = Vec::new();
    for (rows, planes) in buffered {
        match all.last_mut() {
            Some((before, join_rows)) if before.end == rows.start => {
                before.end = rows.end;
                for (join_rows, plane) in join_rows.iter_mut().zip(planes) {
                    join_rows.values.extend(plane.values);
                }
            }
            _ => all.push((rows, planes)),
        }
    }
    all
}

/// Returns the channels of a rendering: its colours and its further layers.
fn planes_of_rendering(request: &RenderRequest, rendering: &Rendering) -> Vec<Layer> {
    let mut planes = color_planes(&rendering.image.pixels);
    let further = channels(&request.aovs, rendering);
    planes.extend(further.into_iter().map(Cow::into_owned));
    planes
}
