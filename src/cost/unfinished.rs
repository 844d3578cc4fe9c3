//! What a study had measured when it was interrupted, as bytes: a line that names the format, a line of JSON, then
//! numbers, the least significant byte first.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::blocks::Blocks;
use super::choose::Target;
use super::error::Pictures;
use super::experiment::Experiment;
use super::knob::{Knob, Reach};
use super::layout::Layout;
use super::reference::Halved;
use super::stage::View;
use crate::image::LinearImage;
use crate::render::Mosaic;

/// First line of the file.
const FORMAT: &str = "whit study 1";

/// A study that was interrupted.
#[derive(Clone, Debug)]
pub struct Unfinished {
    pub(super) head: Head,
    /// The means of both halves of the reference.
    pub(super) means: [LinearImage; 2],
    /// Of each configuration.
    pub(super) pictures: Vec<Pictures>,
}

/// What is in no array.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Head {
    size: [u32; 2],
    mosaic: Option<Mosaic>,
    pub(super) threads: usize,
    pub(super) target: Option<Target>,
    pub(super) base_spp: u32,
    pub(super) reach: Reach,
    pub(super) reference_spp: u32,
    pub(super) reference_count: u32,
    pub(super) stricter_spp: u32,
    /// By how much knobs at their strictest moved the reference.
    pub(super) left: Vec<(Knob, f64)>,
    pub(super) blocks: Blocks,
    /// Blocks of pixels that errors are added up in.
    pixel_blocks: usize,
    /// The settings of each configuration, to know them by.
    pub(super) words: Vec<BTreeMap<String, String>>,
    /// Of the pixels of the base's first picture, which tells another scene or program.
    pub(super) checksum: u64,
    /// Seconds.
    pub(super) spent: f64,
}

/// What there is to keep.
pub(super) struct Kept<'a> {
    pub(super) experiment: &'a Experiment<'a>,
    pub(super) layout: &'a Layout,
    pub(super) reference: &'a Halved,
    pub(super) left: &'a [(Knob, f64)],
    pub(super) blocks: &'a Blocks,
    pub(super) pictures: &'a [Pictures],
    pub(super) checksum: u64,
    pub(super) spent: f64,
}

impl Kept<'_> {
    /// All of it as a file holds it.
    pub(super) fn bytes(&self) -> Vec<u8> {
        let Layout {
            view,
            contestants,
            reference_spp,
            stricter_spp,
            base_spp,
            reach,
        } = self.layout;
        let means = self.reference.means();
        let head = Head {
            size: [means[0].width, means[0].height],
            mosaic: match view {
                View::Whole(_) => None,
                View::Pieces(mosaic) => Some(*mosaic),
            },
            threads: self.experiment.threads,
            target: self.experiment.target,
            base_spp: *base_spp,
            reach: reach.clone(),
            reference_spp: *reference_spp,
            reference_count: self.reference.count,
            stricter_spp: *stricter_spp,
            left: self.left.to_vec(),
            blocks: self.blocks.clone(),
            pixel_blocks: self.pictures.first().map_or(0, Pictures::block_count),
            words: contestants
                .iter()
                .map(|contestant| contestant.configuration.words())
                .collect(),
            checksum: self.checksum,
            spent: self.spent,
        };
        let mut bytes = format!("{FORMAT}\n").into_bytes();
        // Nothing in it has no form in JSON.
        bytes.extend(serde_json::to_vec(&head).unwrap_or_default());
        bytes.push(b'\n');
        for mean in means {
            write(&mut bytes, mean.pixels.iter().flatten().map(|x| x.to_le_bytes()));
        }
        for pictures in self.pictures {
            let (sum, products, squares) = pictures.parts();
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

impl Unfinished {
    /// What a file holds.
    ///
    /// # Errors
    ///
    /// What is wrong with it, as the end of a sentence that begins with the file's name.
    pub fn parse(bytes: &[u8]) -> Result<Unfinished, String> {
        let broken = || "is no study that was interrupted, or of another version of whit".to_owned();
        let rest = bytes.strip_prefix(FORMAT.as_bytes()).ok_or_else(broken)?;
        let rest = rest.strip_prefix(b"\n").ok_or_else(broken)?;
        let end = rest.iter().position(|&byte| byte == b'\n').ok_or_else(broken)?;
        let text = std::str::from_utf8(&rest[..end]).map_err(|_| broken())?;
        let head: Head = serde_json::from_str(text).map_err(|_| broken())?;
        let mut numbers = Numbers(&rest[end + 1..]);
        let short = || "has been cut short".to_owned();
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
        let count = head.blocks.count();
        let mut pictures = Vec::new();
        for _ in &head.words {
            let mut one = || {
                let sum = numbers.pixels(pixels)?;
                let products = numbers.doubles(head.pixel_blocks)?;
                let squares = numbers.doubles(head.pixel_blocks)?;
                Some(Pictures::from_parts(count, sum, products, squares))
            };
            pictures.push(one().ok_or_else(short)?);
        }
        Ok(Unfinished {
            head,
            means,
            pictures,
        })
    }

    /// Seconds that it took before it was interrupted.
    pub fn spent(&self) -> f64 {
        self.head.spent
    }

    pub(super) fn view(&self) -> View {
        self.head.mosaic.map_or(View::Whole(self.head.size), View::Pieces)
    }
}

/// Numbers that are left in a file.
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

/// A number that pictures with other bits have hardly ever in common (FNV-1a, 64 bits).
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
