//! Elements of a page.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;

use super::chart::{Bars, Plot, Row, ScatterChart, SeriesStyle, Stacks};
use super::line_drawing::Drawing;
use super::table::{Cell, Table};
use crate::image::{LinearImage, ToneMap, png_bytes};

/// Element of a page, which the script draws by its `kind`.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum PageElement {
    /// Heading of level 2 or 3.
    Heading {
        /// Level of the heading.
        level: u8,
        /// Text of the heading.
        text: String,
        /// Name for links; may be empty.
        id: &'static str,
    },
    /// Paragraph of text, badges and links.
    Paragraph {
        /// Parts of the text.
        parts: Vec<Cell>,
    },
    /// Paragraph in a fainter colour.
    Note {
        /// Text of the paragraph.
        text: String,
    },
    /// Names and values, one pair per line.
    Facts {
        /// Names with their values.
        pairs: Vec<(String, String)>,
    },
    /// Tiles of a large number with a word below each.
    Numbers {
        /// Number, word and CSS class of each tile.
        tiles: Vec<(String, String, &'static str)>,
    },
    /// Warning that readers must not miss.
    Alert {
        /// First line of the warning.
        title: &'static str,
        /// Reasons, one per line.
        items: Vec<String>,
        /// Consequence of the warning.
        text: &'static str,
    },
    /// Preformatted text with its line breaks.
    Preformatted {
        /// Lines of the text.
        text: String,
    },
    /// Search field and a check box for each verdict, which filter rows and cards.
    Filter {
        /// CSS class and word of each verdict.
        verdicts: Vec<(&'static str, &'static str)>,
    },
    /// Meanings of the colours of verification figures.
    Key {
        /// CSS class and meaning of each colour.
        colors: Vec<(&'static str, &'static str)>,
    },
    /// Framed part of the page.
    Section {
        /// Name for links and for the filter.
        id: String,
        /// Contents of the section.
        elements: Vec<PageElement>,
    },
    /// Elements side by side.
    SideBySide {
        /// CSS class of the layout.
        class: &'static str,
        /// Elements from left to right.
        elements: Vec<PageElement>,
    },
    /// Elements with a caption below them.
    Figure {
        /// Contents of the figure.
        elements: Vec<PageElement>,
        /// Text below the contents.
        caption: String,
    },
    /// Image in its own size.
    Image(PngImage),
    /// Viewer of images: a slider or alternation compares the first two.
    Viewer {
        /// Name of each image with the image.
        views: Vec<(String, PngImage)>,
    },
    /// Table with rows that a filter can hide.
    Table(Table),
    /// Points over two logarithmic axes.
    Scatter(ScatterChart),
    /// Scatter charts with captions and equal axes.
    Multiples {
        /// Caption of each chart with the chart.
        charts: Vec<(String, ScatterChart)>,
    },
    /// Horizontal bars in groups.
    Bars(Bars),
    /// Stacked columns over their number.
    Stacks(Stacks),
    /// Bars from the smallest to the largest ratio of each change, with the longest at the top.
    Tornado {
        /// Label of the axis.
        label: &'static str,
        /// Changes in any order.
        rows: Vec<Row>,
    },
    /// Errors with their limit.
    Plot(Plot),
    /// Drawing of lines and dots.
    Drawing(Drawing),
    /// Frames of a batch, with their order and their keys.
    Gallery {
        /// Cards in the order of the frames.
        cards: Vec<Card>,
    },
}

impl PageElement {
    /// Returns a heading of level 2.
    pub fn heading(text: &str) -> PageElement {
        PageElement::Heading {
            level: 2,
            text: text.to_owned(),
            id: "",
        }
    }

    /// Returns a heading of level 2 with a name for links.
    pub fn named_heading(id: &'static str, text: &str) -> PageElement {
        PageElement::Heading {
            level: 2,
            text: text.to_owned(),
            id,
        }
    }

    /// Returns a heading of level 3.
    pub fn subheading(text: &str) -> PageElement {
        PageElement::Heading {
            level: 3,
            text: text.to_owned(),
            id: "",
        }
    }

    /// Returns a paragraph of plain text.
    pub fn text(text: &str) -> PageElement {
        PageElement::Paragraph {
            parts: vec![Cell::text(text)],
        }
    }
}

/// Image as an encoded PNG.
#[derive(Clone, Debug, Serialize)]
pub struct PngImage {
    /// Width on the page in pixels.
    pub width: u32,
    /// Height on the page in pixels.
    pub height: u32,
    /// Description of the image.
    pub words: String,
    /// Encoded PNG in base64.
    pub png: String,
}

/// Image of a viewer with its texts.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Label of the image's button, of one or two words.
    pub name: &'a str,
    /// Description of the image, shown below it.
    pub words: &'a str,
    /// Linear image to display.
    pub image: &'a LinearImage,
    /// Tone mapping for the display.
    pub tone: ToneMap,
}

impl View<'_> {
    /// Returns the image, enlarged by `scale`.
    ///
    /// # Errors
    ///
    /// Returns an error if the image has more pixels than a PNG can store.
    pub fn image(&self, scale: u32) -> std::io::Result<PngImage> {
        Ok(PngImage {
            width: scale * self.image.width,
            height: scale * self.image.height,
            words: self.words.to_owned(),
            png: STANDARD.encode(png_bytes(self.image, self.tone)?),
        })
    }
}

/// Frame of a batch.
#[derive(Clone, Debug, Serialize)]
pub struct Card {
    /// Name of the frame.
    pub name: String,
    /// CSS class and word of the frame's status.
    pub status: (&'static str, &'static str),
    /// Address of the image; absent if there is none.
    pub address: Option<String>,
    /// Thumbnail as PNG in base64; may be empty.
    pub png: String,
    /// Wall-clock seconds of the frame.
    pub seconds: f64,
    /// Reason for a failure, or another message; may be empty.
    pub message: String,
    /// Shares of effects in the threads' time.
    pub shares: Vec<EffectPart>,
    /// Shares of effects in words.
    pub shares_words: String,
    /// Size, times and settings in words.
    pub words: String,
}

/// Share of an effect in a frame's time.
#[derive(Clone, Debug, Serialize)]
pub struct EffectPart {
    /// Colour of the effect.
    pub look: SeriesStyle,
    /// Fraction of the whole.
    pub part: f64,
    /// Text of the tooltip.
    pub words: String,
}

/// Returns a list of names and values, one pair per line.
pub fn facts(pairs: &[(&str, String)]) -> PageElement {
    let pairs = pairs
        .iter()
        .map(|(name, value)| ((*name).to_owned(), value.clone()));
    PageElement::Facts {
        pairs: pairs.collect(),
    }
}

/// Returns tiles of a large number with a word below each; the third value is the tile's CSS class.
pub fn numbers(all: &[(String, &str, &'static str)]) -> PageElement {
    let tiles = all
        .iter()
        .map(|(number, word, class)| (number.clone(), (*word).to_owned(), *class));
    PageElement::Numbers {
        tiles: tiles.collect(),
    }
}

/// Returns a search field and a check box for each of the `verdicts` (CSS class and word).
pub fn filter(verdicts: &[(&'static str, &'static str)]) -> PageElement {
    PageElement::Filter {
        verdicts: verdicts.to_vec(),
    }
}
