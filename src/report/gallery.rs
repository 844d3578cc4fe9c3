//! The pictures of a batch as one page: what each is like, whether it is there, and where its time went.
//!
//! The page holds small pictures of all and leads to the large ones beside it. With pictures full of noise it takes 13 MB
//! for 100 frames and 25 MB for 1000, whose thumbnails are smaller.

use std::collections::BTreeMap;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use percent_encoding::{AsciiSet, CONTROLS, utf8_percent_encode};
use serde::{Deserialize, Serialize};

use super::machine;
use super::page::{self, Bars, Group, Length, Look, Stack, Stacks, escape};
use super::table::in_groups;
use super::words::{percent, significant};
use crate::cost::Interval;
use crate::image::{LinearImage, ToneMap, png_bytes};

/// Frames up to which thumbnails are so large; more have the smallest.
const SIDES: [(usize, u32); 2] = [(100, 256), (400, 128)];
const SMALLEST_SIDE: u32 = 96;

/// Effects with a colour of their own, those that took longest; the others share one.
const COLORS: usize = 6;

/// What in a path would end it or be taken for something else within an address.
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

/// A batch.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Gallery {
    /// What it is called.
    pub title: String,
    /// In their order.
    pub frames: Vec<GalleryFrame>,
    /// Seconds on the clock from its beginning to its end.
    pub seconds: f64,
    /// What it ran on; the processor's name if nothing is said.
    pub machine: Option<String>,
    /// Whatever else is to be told of it, names and values.
    pub facts: Vec<(String, String)>,
}

/// A picture of a batch.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct GalleryFrame {
    /// What it is called.
    pub name: String,
    /// Its file, by a path from the page's folder, with slashes.
    pub image: String,
    /// A small PNG of it, see [`thumbnail`]; empty if there is none.
    #[serde(skip)]
    pub thumbnail: Vec<u8>,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Samples a pixel.
    pub spp: u32,
    /// Whether it is there.
    pub status: FrameStatus,
    /// Why not, or what else is to be said of it.
    pub message: String,
    /// What making it took.
    pub seconds: FrameSeconds,
    /// Rays by their kind.
    pub rays: BTreeMap<String, u64>,
    /// What each effect took.
    pub ledger: Vec<EffectShare>,
    /// What sets it apart from the others, a few words each.
    pub settings: Vec<String>,
}

/// Whether a picture of a batch is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FrameStatus {
    /// It was made.
    Done,
    /// It could not be made.
    Failed,
    /// Nobody has made it yet.
    #[default]
    Missing,
    /// It was there already.
    Skipped,
}

impl FrameStatus {
    const ALL: [FrameStatus; 4] = [
        FrameStatus::Done,
        FrameStatus::Failed,
        FrameStatus::Missing,
        FrameStatus::Skipped,
    ];

    fn word(self) -> &'static str {
        match self {
            FrameStatus::Done => "done",
            FrameStatus::Failed => "failed",
            FrameStatus::Missing => "missing",
            FrameStatus::Skipped => "skipped",
        }
    }

    /// What the style knows it by.
    fn class(self) -> &'static str {
        match self {
            FrameStatus::Done => "holds",
            FrameStatus::Failed => "fails",
            FrameStatus::Missing => "measured",
            FrameStatus::Skipped => "skipped",
        }
    }
}

/// Wall-clock seconds of the parts of making a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameSeconds {
    /// Reading the scene; 0 where it was there already.
    pub load: f64,
    /// Building or refitting the acceleration structure.
    pub build: f64,
    /// Rendering.
    pub render: f64,
    /// Writing files.
    pub write: f64,
}

impl FrameSeconds {
    fn parts(&self) -> [f64; 4] {
        [self.load, self.build, self.render, self.write]
    }

    fn sum(&self) -> f64 {
        self.parts().iter().sum()
    }
}

/// What an effect took of a picture.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct EffectShare {
    /// Its name in ledgers.
    pub name: String,
    /// Seconds of all threads together.
    pub seconds: f64,
    /// Rays.
    pub rays: u64,
}

/// Pixels along the longer side of thumbnails of so many frames, so that the page stays small enough to be opened.
pub fn thumbnail_side(frame_count: usize) -> u32 {
    let fitting = SIDES.iter().find(|(most, _)| frame_count <= *most);
    fitting.map_or(SMALLEST_SIDE, |&(_, side)| side)
}

/// A PNG of the picture whose longer side has at most so many pixels: each the mean radiance of those that it stands for.
///
/// # Errors
///
/// Where memory for it cannot be had.
pub fn thumbnail(image: &LinearImage, side: u32, tone: ToneMap) -> std::io::Result<Vec<u8>> {
    let longer = image.width.max(image.height);
    if longer <= side {
        return png_bytes(image, tone);
    }
    let scaled = |size: u32| (u64::from(size) * u64::from(side) / u64::from(longer)).max(1) as u32;
    let mut small = LinearImage::black(scaled(image.width), scaled(image.height));
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
    /// The page.
    pub fn page(&self) -> String {
        let effects = self.effects();
        let mut body = format!("<h1>{}</h1>\n", escape(&self.title));
        body += &self.summary();
        body += &self.times();
        body += &self.effects_in_all(&effects);
        body += "<h2>Frames</h2>\n";
        let statuses: Vec<_> = FrameStatus::ALL
            .into_iter()
            .filter(|&status| self.count(status) > 0)
            .map(|status| (status.class(), status.word()))
            .collect();
        body += &page::filter(&statuses);
        body += ORDER;
        body += "<div class=\"gallery\">\n";
        for (number, frame) in self.frames.iter().enumerate() {
            body += &frame.card(number, &effects);
        }
        body += "</div>\n";
        page::page(&self.title, &body)
    }

    fn count(&self, status: FrameStatus) -> usize {
        self.frames.iter().filter(|frame| frame.status == status).count()
    }

    fn summary(&self) -> String {
        let tile = |status: FrameStatus| {
            let class = if self.count(status) > 0 {
                status.class()
            } else {
                ""
            };
            (self.count(status).to_string(), status.word(), class)
        };
        let mut tiles = vec![(self.frames.len().to_string(), "frames", "")];
        tiles.extend(
            FrameStatus::ALL
                .into_iter()
                .filter(|&s| s != FrameStatus::Skipped || self.count(s) > 0)
                .map(tile),
        );
        tiles.push((time(self.seconds), "in all", ""));
        let rays: u64 = self.frames.iter().flat_map(|frame| frame.rays.values()).sum();
        // In one line.
        tiles.push((in_groups(rays).replace(' ', "\u{202f}"), "rays", ""));
        let machine = self.machine.clone().unwrap_or_else(machine::processor);
        let mut facts = vec![
            ("whit", env!("CARGO_PKG_VERSION").to_owned()),
            ("machine", escape(&machine)),
        ];
        facts.extend(
            self.facts
                .iter()
                .map(|(name, value)| (name.as_str(), escape(value))),
        );
        page::numbers(&tiles) + &page::facts(&facts)
    }

    /// Effects with their seconds in all frames and how they are coloured, the longest first.
    fn effects(&self) -> Vec<(&str, f64, Look)> {
        let mut seconds: BTreeMap<&str, f64> = BTreeMap::new();
        for share in self.frames.iter().flat_map(|frame| &frame.ledger) {
            *seconds.entry(&share.name).or_default() += sound(share.seconds);
        }
        let mut all: Vec<_> = seconds
            .into_iter()
            .filter(|&(_, seconds)| seconds > 0.0)
            .collect();
        all.sort_by(|a, b| b.1.total_cmp(&a.1));
        let look = |place| {
            if place < COLORS {
                Look::Number(place)
            } else {
                Look::Base
            }
        };
        let colored = all.into_iter().enumerate();
        colored
            .map(|(place, (name, seconds))| (name, seconds, look(place)))
            .collect()
    }

    /// Seconds over the number of the frame.
    fn times(&self) -> String {
        let stack = |frame: &GalleryFrame| Stack {
            parts: frame.seconds.parts().to_vec(),
            is_wrong: frame.status == FrameStatus::Failed,
            words: format!("{}: {}, {}", frame.name, frame.status.word(), frame.times()),
        };
        let stacks = Stacks {
            x_label: "frame",
            y_label: "seconds",
            parts: vec![
                (Look::Number(3), "load"),
                (Look::Number(1), "build"),
                (Look::Number(0), "render"),
                (Look::Number(2), "write"),
            ],
            stacks: self.frames.iter().map(stack).collect(),
        };
        format!("<h2>Seconds of each frame</h2>\n{}", stacks.html())
    }

    fn effects_in_all(&self, effects: &[(&str, f64, Look)]) -> String {
        if effects.is_empty() {
            return String::new();
        }
        let whole: f64 = effects.iter().map(|effect| effect.1).sum();
        let bar = |&(name, seconds, look): &(&str, f64, Look)| Length {
            name: name.to_owned(),
            look,
            value: Interval::exact(seconds),
            label: percent(seconds / whole),
            words: format!("{name}: {}, {} of all", time(seconds), percent(seconds / whole)),
        };
        let bars = Bars {
            label: "seconds of all threads",
            groups: vec![Group {
                name: "all frames".to_owned(),
                bars: effects.iter().map(bar).collect(),
            }],
            legend: Vec::new(),
        };
        format!("<h2>Time by effect</h2>\n{}", bars.html())
    }
}

/// How frames may be put in order.
const ORDER: &str = "<form class=\"order\"><label>Order <select aria-label=\"Order\">\
    <option value=\"number\">by number</option><option value=\"name\">by name</option>\
    <option value=\"time\">longest first</option><option value=\"status\">failed first</option></select></label>\n\
    <span class=\"faint\">Arrows go from frame to frame, Enter opens one, / looks for words.</span></form>\n";

impl GalleryFrame {
    /// What it took, part by part.
    fn times(&self) -> String {
        let parts = ["load", "build", "render", "write"]
            .into_iter()
            .zip(self.seconds.parts());
        let parts: Vec<String> = parts
            .filter(|&(_, seconds)| seconds > 0.0)
            .map(|(name, seconds)| format!("{name} {}", time(seconds)))
            .collect();
        match parts.len() {
            0 => "no time".to_owned(),
            1 => parts.concat(),
            _ => format!("{}: {}", time(self.seconds.sum()), parts.join(", ")),
        }
    }

    fn card(&self, number: usize, effects: &[(&str, f64, Look)]) -> String {
        let status = self.status;
        let name = escape(&self.name);
        let is_there = matches!(status, FrameStatus::Done | FrameStatus::Skipped);
        let to = escape(&format!("./{}", utf8_percent_encode(&self.image, NOT_IN_PATHS)));
        let picture = match (&self.thumbnail[..], is_there) {
            ([], true) => "<div class=\"nothing\">no small picture</div>".to_owned(),
            ([], false) => format!("<div class=\"nothing\">{}</div>", status.word()),
            (png, _) => format!(
                "<img loading=\"lazy\" decoding=\"async\" alt=\"{name}\" src=\"data:image/png;base64,{}\">",
                STANDARD.encode(png)
            ),
        };
        let (picture, title) = if is_there {
            (
                format!("<a class=\"open\" tabindex=\"-1\" href=\"{to}\">{picture}</a>"),
                format!("<a tabindex=\"-1\" href=\"{to}\">{name}</a>"),
            )
        } else {
            (picture, name.clone())
        };
        let mut html = format!(
            "<article class=\"frame {class}\" data-verdict=\"{class}\" data-number=\"{number}\" data-name=\"{name}\" \
             data-seconds=\"{}\" tabindex=\"0\">{picture}\n<h3>{title} <span class=\"badge {class}\">{}</span></h3>\n",
            sound(self.seconds.sum()),
            status.word(),
            class = status.class()
        );
        if !self.message.is_empty() {
            html += &format!("<p class=\"message\">{}</p>\n", escape(&self.message));
        }
        html += &self.share(effects);
        html += &format!("<p>{}</p>\n</article>\n", escape(&self.words()));
        html
    }

    /// A bar of where the time of threads went.
    fn share(&self, effects: &[(&str, f64, Look)]) -> String {
        let seconds = |name: &str| {
            let of = self.ledger.iter().filter(|share| share.name == name);
            of.map(|share| sound(share.seconds)).sum::<f64>()
        };
        let parts: Vec<_> = effects
            .iter()
            .map(|&(name, _, look)| (name, seconds(name), look))
            .filter(|part| part.1 > 0.0)
            .collect();
        let whole: f64 = parts.iter().map(|part| part.1).sum();
        if parts.is_empty() {
            return String::new();
        }
        let rays = |name: &str| {
            let of = self.ledger.iter().filter(|share| share.name == name);
            in_groups(of.map(|share| share.rays).sum())
        };
        let bars = parts.iter().map(|&(name, seconds, look)| {
            format!(
                "<i class=\"{}\" style=\"width:{:.2}%\" title=\"{}: {}, {} rays\"></i>",
                look.class(),
                100.0 * seconds / whole,
                escape(name),
                time(seconds),
                rays(name)
            )
        });
        let told = parts
            .iter()
            .map(|&(name, seconds, _)| format!("{name} {}", percent(seconds / whole)));
        let told: Vec<String> = told.collect();
        format!(
            "<div class=\"share\" role=\"img\" aria-label=\"{}\">{}</div>\n",
            escape(&told.join(", ")),
            bars.collect::<String>()
        )
    }

    /// Its size, times, settings and rays.
    fn words(&self) -> String {
        let mut words = vec![format!("{}x{}, {} samples", self.width, self.height, self.spp)];
        if self.seconds.sum() > 0.0 {
            words.push(self.times());
        }
        words.extend(self.settings.iter().cloned());
        let rays: Vec<String> = self
            .rays
            .iter()
            .filter(|(_, count)| **count > 0)
            .map(|(kind, &count)| format!("{kind} {}", in_groups(count)))
            .collect();
        if !rays.is_empty() {
            words.push(format!("rays: {}", rays.join(", ")));
        }
        words.join(" · ")
    }
}

/// What is no time is none.
fn sound(seconds: f64) -> f64 {
    if seconds.is_finite() {
        seconds.max(0.0)
    } else {
        0.0
    }
}

/// Seconds in a word.
fn time(seconds: f64) -> String {
    format!("{} s", significant(seconds, 3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thumbnail_has_the_means_of_what_it_stands_for() {
        let mut image = LinearImage::black(4, 2);
        image.pixels[0] = [1.0; 3];
        image.pixels[5] = [1.0; 3];
        let png = thumbnail(&image, 2, ToneMap::default()).unwrap();
        let read = image::load_from_memory(&png).unwrap().into_rgb8();
        assert_eq!(read.dimensions(), (2, 1));
        // Half a radiance: 1.055 · 0.5^(1/2.4) - 0.055 = 0.7354, 187.5 of 255.
        assert_eq!(read.into_raw(), [188, 188, 188, 0, 0, 0]);
    }

    #[test]
    fn a_thumbnail_of_any_shape_has_at_least_a_pixel_and_at_most_its_side() {
        for (width, height) in [(1, 1), (1000, 1), (1, 300), (257, 256), (64, 64)] {
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
    fn names_and_paths_cannot_leave_their_places() {
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
        assert!(page.contains("href=\"./javascript:a%23b%20c%3F.png\""), "{page}");
        assert!(!page.contains("\"><script>") && !page.contains("<b>\n") && page.contains("&lt;b&gt;"));
        assert!(page.contains("<title>&lt;/title&gt;</title>"));
    }

    #[test]
    fn numbers_that_are_none_leave_no_trace() {
        let frame = GalleryFrame {
            seconds: FrameSeconds {
                render: f64::NAN,
                load: f64::INFINITY,
                ..FrameSeconds::default()
            },
            ledger: vec![EffectShare {
                name: "shadow".to_owned(),
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
        let body = page
            .split("<main>")
            .nth(1)
            .unwrap()
            .split("<script>")
            .next()
            .unwrap();
        assert!(!body.contains("NaN") && !body.contains("width:inf"), "{body}");
    }
}
