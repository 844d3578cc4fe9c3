//! HTML page of a batch's images: description, status and time of each frame.
//!
//! The page holds thumbnails of all images and links to the full ones beside it. With noisy images it takes 13 MB for
//! 100 frames and 25 MB for 1000, whose thumbnails are smaller.

use std::collections::BTreeMap;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use percent_encoding::{AsciiSet, CONTROLS, utf8_percent_encode};

use super::page::{self, BarEntry, Bars, Card, EffectPart, Group, PageElement, SeriesStyle, Stack, Stacks};
use crate::cost::Interval;
use crate::image::{LinearImage, ToneMap, png_bytes};
use crate::report::cpu;
use crate::report::format::{percent, significant};
use crate::report::text::table::group_thousands;

/// Largest number of frames for each thumbnail side in pixels; more frames have the smallest one.
const SIDES: [(usize, u32); 2] = [(100, 256), (400, 128)];
const SMALLEST_SIDE: u32 = 96;

/// Names and colours of the phases of a frame.
const PHASES: [(&str, SeriesStyle); 4] = [
    ("load", SeriesStyle::Number(3)),
    ("build", SeriesStyle::Number(1)),
    ("render", SeriesStyle::Number(0)),
    ("write", SeriesStyle::Number(2)),
];

/// Number of effects with a colour of their own, those with the longest time; the others share one.
const COLORS: usize = 6;

/// Characters that must be escaped in the path of an address, besides control characters.
const NOT_IN_PATHS: &AsciiSet = &CONTROLS
    .add(b' ')
    .add(b'"')
    .add(b'#')
    .add(b'%')
    .add(b'<')
    .add(b'>')
    .add(b'?')
    .add(b'`')
    .add(b'\\')
    .add(b'{')
    .add(b'}');

/// Contents of the page of a batch.
#[derive(Clone, Debug, Default)]
pub struct Gallery {
    /// Title of the page.
    pub title: String,
    /// Frames of the batch, in order.
    pub frames: Vec<GalleryFrame>,
    /// Wall-clock seconds of the whole batch.
    pub seconds: f64,
}

/// Frame of a batch with its image.
#[derive(Clone, Debug, Default)]
pub struct GalleryFrame {
    /// Name of the frame.
    pub name: String,
    /// Path of the image file relative to the page's folder, with slashes.
    pub image: String,
    /// Small PNG of the image, see [`thumbnail`]; empty if there is none.
    pub thumbnail: Vec<u8>,
    /// Width of the image in pixels.
    pub width: u32,
    /// Height of the image in pixels.
    pub height: u32,
    /// Number of samples per pixel.
    pub spp: u32,
    /// Status of the frame in the batch.
    pub status: FrameStatus,
    /// Reason for a failure, or another message.
    pub message: String,
    /// Wall-clock seconds of each phase: loading the scene, building, rendering and writing.
    pub seconds: [f64; 4],
    /// Rays and time of each effect.
    pub ledger: Vec<EffectShare>,
    /// Settings in which the frame differs from the others, a few words each.
    pub settings: Vec<String>,
}

/// Status of a frame in a batch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FrameStatus {
    /// Frame that this batch rendered.
    Done,
    /// Frame that could not be rendered.
    Failed,
    /// Frame that is not rendered yet.
    #[default]
    Missing,
    /// Frame that existed before the batch.
    Skipped,
}

impl FrameStatus {
    /// All statuses with their words and their CSS classes.
    const ALL: [(FrameStatus, &str, &str); 4] = [
        (FrameStatus::Done, "done", "holds"),
        (FrameStatus::Failed, "failed", "fails"),
        (FrameStatus::Missing, "missing", "measured"),
        (FrameStatus::Skipped, "skipped", "skipped"),
    ];

    /// Returns the word and the CSS class of the status.
    fn word_and_class(self) -> (&'static str, &'static str) {
        let (_, word, class) = FrameStatus::ALL[self as usize];
        (word, class)
    }
}

/// Cost of an effect in a frame.
#[derive(Clone, Debug, Default)]
pub struct EffectShare {
    /// Name of the effect in ledgers.
    pub name: &'static str,
    /// Seconds summed over all threads.
    pub seconds: f64,
    /// Number of rays traced for the effect.
    pub rays: u64,
}

/// Returns the longer side of thumbnails in pixels, smaller for more frames so that browsers can open the page.
pub fn thumbnail_side(frame_count: usize) -> u32 {
    let fitting = SIDES.iter().find(|(most, _)| frame_count <= *most);
    fitting.map_or(SMALLEST_SIDE, |&(_, side)| side)
}

/// Returns a PNG of the image whose longer side has at most `side` pixels; each pixel is the mean radiance of the
/// pixels that it covers.
///
/// # Errors
///
/// Returns an error if memory for the image is not available.
pub fn thumbnail(image: &LinearImage, side: u32, tone: ToneMap) -> std::io::Result<Vec<u8>> {
    let longer = image.width.max(image.height);
    if longer <= side {
        return png_bytes(image, tone);
    }
    let scaled = |size: u32| (u64::from(size) * u64::from(side) / u64::from(longer)).max(1) as u32;
    let mut small = LinearImage::black(scaled(image.width), scaled(image.height));
    // Average the block of pixels that each small pixel covers
    let part = |i: u32, of: u32, size: u32| {
        let start = |i: u32| (u64::from(i) * u64::from(size) / u64::from(of)) as usize;
        start(i)..start(i + 1)
    };
    for y in 0..small.height {
        for x in 0..small.width {
            let columns = part(x, small.width, image.width);
            let mut sum = [0.0; 3];
            let rows = part(y, small.height, image.height);
            let count = (rows.len() * columns.len()) as f64;
            for row in rows {
                let start = row * image.width as usize;
                for pixel in &image.pixels[start + columns.start..start + columns.end] {
                    (0..3).for_each(|c| sum[c] += f64::from(pixel[c]));
                }
            }
            small.pixels[(y * small.width + x) as usize] = sum.map(|sum| (sum / count) as f32);
        }
    }
    png_bytes(&small, tone)
}

impl Gallery {
    /// Returns the HTML page of the gallery.
    pub fn page(&self) -> String {
        // Show the summary and the charts of time
        let effects = self.effects();
        let mut elements = self.summary().to_vec();
        elements.extend([PageElement::heading("Seconds of each frame"), self.times()]);
        if !effects.is_empty() {
            elements.extend([PageElement::heading("Time by effect"), effects_in_all(&effects)]);
        }
        elements.push(PageElement::heading("Frames"));
        // Show a filter for each status that occurs
        let statuses: Vec<_> = FrameStatus::ALL
            .into_iter()
            .filter(|&(status, _, _)| self.count(status) > 0)
            .map(|(_, word, class)| (class, word))
            .collect();
        elements.push(page::filter(&statuses));
        // Show a card for each frame
        elements.push(PageElement::Gallery {
            cards: self.frames.iter().map(|frame| frame.card(&effects)).collect(),
        });
        page::page(&self.title, &self.title, &elements)
    }

    fn count(&self, status: FrameStatus) -> usize {
        self.frames.iter().filter(|frame| frame.status == status).count()
    }

    fn summary(&self) -> [PageElement; 2] {
        let tile = |(status, word, class)| match self.count(status) {
            0 => ("0".to_owned(), word, ""),
            count => (count.to_string(), word, class),
        };
        // Count frames by status
        let mut tiles = vec![(self.frames.len().to_string(), "frames", "")];
        // Omit a count of zero skipped frames
        tiles.extend(
            FrameStatus::ALL
                .into_iter()
                .filter(|&(status, ..)| status != FrameStatus::Skipped || self.count(status) > 0)
                .map(tile),
        );
        tiles.push((time(self.seconds), "in total", ""));
        // Append total time, number of rays and the machine
        let shares = self.frames.iter().flat_map(|frame| &frame.ledger);
        let rays: u64 = shares.map(|share| share.rays).sum();
        // Narrow no-break spaces keep the number in one line.
        tiles.push((group_thousands(rays).replace(' ', "\u{202f}"), "rays", ""));
        let facts = [
            ("whit", env!("CARGO_PKG_VERSION").to_owned()),
            ("machine", cpu::processor()),
            ("command", "whit batch".to_owned()),
        ];
        [page::numbers(&tiles), page::facts(&facts)]
    }

    /// Returns the effects with their seconds in all frames and their colours, in descending order of time.
    fn effects(&self) -> Vec<(&str, f64, SeriesStyle)> {
        // Sum the seconds of each effect over all frames
        let mut seconds: BTreeMap<&str, f64> = BTreeMap::new();
        for share in self.frames.iter().flat_map(|frame| &frame.ledger) {
            *seconds.entry(share.name).or_default() += finite_or_zero(share.seconds);
        }
        let mut all: Vec<_> = seconds
            .into_iter()
            .filter(|&(_, seconds)| seconds > 0.0)
            .collect();
        all.sort_by(|a, b| b.1.total_cmp(&a.1));
        let look = |place| {
            if place < COLORS {
                SeriesStyle::Number(place)
            } else {
                SeriesStyle::Base
            }
        };
        let colored = all.into_iter().enumerate();
        colored
            .map(|(place, (name, seconds))| (name, seconds, look(place)))
            .collect()
    }

    /// Returns the chart of seconds over the number of the frame.
    fn times(&self) -> PageElement {
        let stack = |frame: &GalleryFrame| Stack {
            parts: frame.seconds.to_vec(),
            is_wrong: frame.status == FrameStatus::Failed,
            words: format!(
                "{}: {}, {}",
                frame.name,
                frame.status.word_and_class().0,
                frame.times()
            ),
        };
        PageElement::Stacks(Stacks {
            x_label: "frame",
            y_label: "seconds",
            parts: PHASES.map(|(name, style)| (style, name)).to_vec(),
            stacks: self.frames.iter().map(stack).collect(),
        })
    }
}

/// Returns the chart of each effect's seconds in all frames.
fn effects_in_all(effects: &[(&str, f64, SeriesStyle)]) -> PageElement {
    let whole: f64 = effects.iter().map(|effect| effect.1).sum();
    let bar = |&(name, seconds, look): &(&str, f64, SeriesStyle)| BarEntry {
        name: name.to_owned(),
        look,
        value: Interval::exact(seconds),
        label: percent(seconds / whole),
        words: format!("{name}: {}, {} of all", time(seconds), percent(seconds / whole)),
    };
    PageElement::Bars(Bars {
        label: "seconds of all threads",
        groups: vec![Group {
            name: "all frames".to_owned(),
            bars: effects.iter().map(bar).collect(),
        }],
        legend: Vec::new(),
    })
}

impl GalleryFrame {
    fn seconds_in_all(&self) -> f64 {
        self.seconds.iter().sum()
    }

    /// Returns the total time and the time of each phase in words.
    fn times(&self) -> String {
        let parts = PHASES.into_iter().zip(self.seconds);
        let parts: Vec<String> = parts
            .filter(|&(_, seconds)| seconds > 0.0)
            .map(|((name, _), seconds)| format!("{name} {}", time(seconds)))
            .collect();
        match parts.len() {
            0 => "no time".to_owned(),
            1 => parts.concat(),
            _ => format!("{}: {}", time(self.seconds_in_all()), parts.join(", ")),
        }
    }

    fn card(&self, effects: &[(&str, f64, SeriesStyle)]) -> Card {
        let is_there = matches!(self.status, FrameStatus::Done | FrameStatus::Skipped);
        let (shares, shares_words) = self.shares(effects);
        let (word, class) = self.status.word_and_class();
        Card {
            name: self.name.clone(),
            status: (class, word),
            // Link to the image if it exists
            address: is_there.then(|| format!("./{}", utf8_percent_encode(&self.image, NOT_IN_PATHS))),
            png: STANDARD.encode(&self.thumbnail),
            seconds: finite_or_zero(self.seconds_in_all()),
            message: self.message.clone(),
            shares,
            shares_words,
            words: self.words(),
        }
    }

    /// Returns the shares of the effects in the threads' time, and the shares in words.
    fn shares(&self, effects: &[(&str, f64, SeriesStyle)]) -> (Vec<EffectPart>, String) {
        // Select effects with a positive time
        let own = |name: &str| -> Vec<&EffectShare> {
            self.ledger.iter().filter(|share| share.name == name).collect()
        };
        let seconds =
            |name: &str| -> f64 { own(name).iter().map(|share| finite_or_zero(share.seconds)).sum() };
        let parts: Vec<_> = effects
            .iter()
            .map(|&(name, _, look)| (name, seconds(name), look))
            .filter(|part| part.1 > 0.0)
            .collect();
        let whole: f64 = parts.iter().map(|part| part.1).sum();
        // Describe each effect for its tooltip, and all of them for screen readers
        let shares = parts.iter().map(|&(name, seconds, look)| {
            let rays = group_thousands(own(name).iter().map(|share| share.rays).sum());
            EffectPart {
                look,
                part: seconds / whole,
                words: format!("{name}: {}, {rays} rays", time(seconds)),
            }
        });
        let words: Vec<String> = parts
            .iter()
            .map(|&(name, seconds, _)| format!("{name} {}", percent(seconds / whole)))
            .collect();
        (shares.collect(), words.join(", "))
    }

    /// Returns size, times, settings and rays in words.
    fn words(&self) -> String {
        let mut words = vec![format!("{}x{}, {} samples", self.width, self.height, self.spp)];
        if self.seconds_in_all() > 0.0 {
            words.push(self.times());
        }
        words.extend(self.settings.iter().cloned());
        let traced = self.ledger.iter().filter(|share| share.rays > 0);
        let mut rays: Vec<String> = traced
            .map(|share| format!("{} {}", share.name, group_thousands(share.rays)))
            .collect();
        rays.sort();
        if !rays.is_empty() {
            words.push(format!("rays: {}", rays.join(", ")));
        }
        words.join(" · ")
    }
}

/// Returns the seconds, or 0 if they are negative or not finite.
fn finite_or_zero(seconds: f64) -> f64 {
    if seconds.is_finite() {
        seconds.max(0.0)
    } else {
        0.0
    }
}

/// Formats seconds with three significant digits.
fn time(seconds: f64) -> String {
    format!("{} s", significant(seconds, 3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thumbnail_pixels_are_means_of_image_pixels() {
        let mut image = LinearImage::black(4, 2);
        image.pixels[0] = [1.0; 3];
        image.pixels[5] = [1.0; 3];
        let png = thumbnail(&image, 2, ToneMap::default()).unwrap();
        let read = image::load_from_memory(&png).unwrap().into_rgb8();
        assert_eq!(read.dimensions(), (2, 1));
        // A radiance of 1/2 encodes to 1.055 · 0.5^(1/2.4) - 0.055 = 0.7354, which is 187.5 of 255.
        assert_eq!(read.into_raw(), [188, 188, 188, 0, 0, 0]);
    }

    #[test]
    fn thumbnail_size_is_between_one_pixel_and_its_side() {
        for (width, height) in [(1, 1), (1000, 1), (1, 300), (257, 256), (64, 64)] {
            // Thumbnails of extreme aspect ratios keep at least one pixel per side
            let png = thumbnail(&LinearImage::black(width, height), 64, ToneMap::default()).unwrap();
            let (w, h) = image::load_from_memory(&png).unwrap().into_rgb8().dimensions();
            assert!(
                (1..=64).contains(&w) && (1..=64).contains(&h),
                "{width}x{height}: {w}x{h}"
            );
        }
        assert_eq!([10, 101, 1000].map(thumbnail_side), [256, 128, 96]);
    }

    #[test]
    fn names_and_paths_are_escaped() {
        let frame = GalleryFrame {
            name: "\"><script>".to_owned(),
            image: "javascript:a#b c?.png".to_owned(),
            status: FrameStatus::Done,
            message: "<b>".to_owned(),
            ..GalleryFrame::default()
        };
        let page = Gallery {
            title: "</title>".to_owned(),
            frames: vec![frame],
            ..Gallery::default()
        }
        .page();
        assert!(
            page.contains(r#""address":"./javascript:a%23b%20c%3F.png""#),
            "{page}"
        );
        assert!(!page.contains("\"><script>") && !page.contains("<b>") && page.contains("\\u003cb>"));
        assert!(page.contains("<title>&lt;/title></title>"));
    }

    #[test]
    fn non_finite_numbers_are_not_shown() {
        let frame = GalleryFrame {
            seconds: [f64::INFINITY, 0.0, f64::NAN, 0.0],
            ledger: vec![EffectShare {
                name: "shadow",
                seconds: f64::NAN,
                rays: 1,
            }],
            ..GalleryFrame::default()
        };
        let gallery = Gallery {
            frames: vec![frame],
            ..Gallery::default()
        };
        let page = gallery.page();
        let (_, description) = page.split_once("application/json").unwrap();
        let (description, _) = description.split_once("</script>").unwrap();
        assert!(
            !description.contains("NaN") && !description.contains("inf"),
            "{description}"
        );
    }
}
