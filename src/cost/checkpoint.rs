//! Checkpoint of an interrupted study: a line that names the format, a line of JSON, then arrays of little-endian
//! numbers.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::accumulated_reference::AccumulatedReference;
use super::error::ImageSums;
use super::knob::{Knob, LevelRange};
use super::layout::Layout;
use super::target::Target;
use super::view::View;
use crate::image::LinearImage;
use crate::measure::Blocks;
use crate::render::PatchGrid;

/// Format line at the start of the file.
const FORMAT: &str = "whit study 1";

/// Checkpoint of a study, read from a file.
#[derive(Clone, Debug)]
pub struct StudyCheckpoint {
    pub(super) head: Head,
    /// Mean images of both halves of the reference.
    pub(super) means: [LinearImage; 2],
    /// Accumulated images of each configuration.
    pub(super) sums: Vec<ImageSums>,
}

/// Checkpoint's header: everything but the arrays.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Head {
    size: [u32; 2],
    mosaic: Option<PatchGrid>,
    pub(super) threads: usize,
    pub(super) target: Option<Target>,
    pub(super) base_spp: u32,
    pub(super) reach: LevelRange,
    pub(super) reference_spp: u32,
    pub(super) reference_count: u32,
    pub(super) stricter_spp: u32,
    /// Change of the reference by each stricter knob.
    pub(super) left: Vec<(Knob, f64)>,
    pub(super) blocks: Blocks,
    /// Number of pixel blocks in which errors are accumulated.
    pixel_blocks: usize,
    /// Settings of each configuration, which identify it.
    pub(super) words: Vec<BTreeMap<String, String>>,
    /// Checksum of the pixels of the base's first image, which detects another scene or program version.
    pub(super) checksum: u64,
    /// Seconds that the study has taken so far.
    pub(super) spent: f64,
}

/// State of a running study that a checkpoint stores.
pub(super) struct CheckpointData<'a> {
    pub(super) threads: usize,
    pub(super) target: Option<Target>,
    pub(super) layout: &'a Layout,
    pub(super) reference: &'a AccumulatedReference,
    pub(super) left: &'a [(Knob, f64)],
    pub(super) blocks: &'a Blocks,
    pub(super) sums: &'a [ImageSums],
    pub(super) checksum: u64,
    pub(super) spent: f64,
}

impl CheckpointData<'_> {
    /// Returns the checkpoint as the bytes of a file.
    pub(super) fn bytes(&self) -> Vec<u8> {
        let Layout {
            view,
            candidates,
            reference_spp,
            stricter_spp,
            base_spp,
            reach,
        } = self.layout;
        let means = self.reference.means();
        // Assemble the header
        let head = Head {
            size: [means[0].width, means[0].height],
            mosaic: match view {
                View::Whole(_) => None,
                View::Patches(mosaic) => Some(*mosaic),
            },
            threads: self.threads,
            target: self.target,
            base_spp: *base_spp,
            reach: reach.clone(),
            reference_spp: *reference_spp,
            reference_count: self.reference.count(),
            stricter_spp: *stricter_spp,
            left: self.left.to_vec(),
            blocks: self.blocks.clone(),
            pixel_blocks: self.sums.first().map_or(0, ImageSums::block_count),
            words: candidates
                .iter()
                .map(|candidate| candidate.configuration.words())
                .collect(),
            checksum: self.checksum,
            spent: self.spent,
        };
        // Write format line and header
        let mut bytes = format!("{FORMAT}\n").into_bytes();
        // Every value has a JSON form, so that serialisation cannot fail.
        bytes.extend(serde_json::to_vec(&head).unwrap_or_default());
        bytes.push(b'\n');
        // Write the reference's means, then the sums of each configuration
        for mean in means {
            write(&mut bytes, mean.pixels.iter().flatten().map(|x| x.to_le_bytes()));
        }
        for image_sums in self.sums {
            let (sum, products, squares) = image_sums.parts();
            write(&mut bytes, sum.iter().flatten().map(|x| x.to_le_bytes()));
            write(
                &mut bytes,
                products.iter().chain(squares).map(|x| x.to_le_bytes()),
            );
        }
        bytes
    }
}

fn write<const N: usize>(bytes: &mut Vec<u8>, numbers: impl Iterator<Item = [u8; N]>) {
    for number in numbers {
        bytes.extend_from_slice(&number);
    }
}

impl StudyCheckpoint {
    /// Parses a checkpoint file.
    ///
    /// # Errors
    ///
    /// The fault, as the end of a sentence that begins with the file's name.
    pub fn parse(bytes: &[u8]) -> Result<StudyCheckpoint, String> {
        // Read format line and header
        let broken =
            || "is not an interrupted study of this version of whit: leave out `--resume`".to_owned();
        let rest = bytes.strip_prefix(FORMAT.as_bytes()).ok_or_else(broken)?;
        let rest = rest.strip_prefix(b"\n").ok_or_else(broken)?;
        let end = rest.iter().position(|&byte| byte == b'\n').ok_or_else(broken)?;
        let text = std::str::from_utf8(&rest[..end]).map_err(|_| broken())?;
        let head: Head = serde_json::from_str(text).map_err(|_| broken())?;
        // Read the reference's means
        let mut numbers = Numbers(&rest[end + 1..]);
        let short = || "is truncated: leave out `--resume`".to_owned();
        let [width, height] = head.size;
        let pixels = width as usize * height as usize;
        let mut mean = || {
            Some(LinearImage {
                width,
                height,
                pixels: numbers.pixels(pixels)?,
            })
        };
        let means = [mean().ok_or_else(short)?, mean().ok_or_else(short)?];
        // Read the sums of each configuration
        let count = head.blocks.count();
        let mut sums = Vec::new();
        for _ in &head.words {
            let mut one = || {
                let sum = numbers.pixels(pixels)?;
                let products = numbers.doubles(head.pixel_blocks)?;
                let squares = numbers.doubles(head.pixel_blocks)?;
                Some(ImageSums::from_parts(count, sum, products, squares))
            };
            sums.push(one().ok_or_else(short)?);
        }
        Ok(StudyCheckpoint { head, means, sums })
    }

    /// Returns the seconds that the study took before it was interrupted.
    pub fn spent(&self) -> f64 {
        self.head.spent
    }

    pub(super) fn view(&self) -> View {
        self.head
            .mosaic
            .map_or(View::Whole(self.head.size), View::Patches)
    }
}

/// Bytes of a file's arrays that are not read yet.
struct Numbers<'a>(&'a [u8]);

impl Numbers<'_> {
    fn take<const N: usize>(&mut self, count: usize) -> Option<Vec<[u8; N]>> {
        let length = count.checked_mul(N)?;
        let (numbers, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(numbers.as_chunks().0.to_vec())
    }

    fn doubles(&mut self, count: usize) -> Option<Vec<f64>> {
        Some(self.take(count)?.into_iter().map(f64::from_le_bytes).collect())
    }

    fn pixels(&mut self, count: usize) -> Option<Vec<[f32; 3]>> {
        let values: Vec<f32> = self
            .take(count.checked_mul(3)?)?
            .into_iter()
            .map(f32::from_le_bytes)
            .collect();
        Some(values.as_chunks().0.to_vec())
    }
}

/// Returns a 64-bit checksum of the pixels' bits (FNV-1a); different images hardly ever share it.
pub(super) fn checksum(image: &LinearImage) -> u64 {
    let bytes = image
        .pixels
        .iter()
        .flatten()
        .flat_map(|x| x.to_bits().to_le_bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3)
    })
}
