//! HTML pages of measurements: self-contained files without external resources.
//!
//! A page adapts to dark and light screens, to narrow screens and to paper. Its content security policy permits only
//! its own script and style and embedded images, so that a page never accesses a network.

mod axis;
mod bars;
mod chart;
mod line_drawing;
mod plot;
mod stacked_bars;
mod table;
mod tornado;
mod viewer;

pub use axis::LogAxis;
pub use bars::{BarEntry, Bars, Group};
pub use chart::{Chart, DataPoint, Line, Series, SeriesStyle};
pub use line_drawing::{Drawing, Region};
pub use plot::{Mark, Plot};
pub use stacked_bars::{Stack, Stacks};
pub use table::{Cell, Column, Table};
pub use tornado::{Bar, End, Row, Tornado};
pub use viewer::{View, embedded_image, viewer};

/// Style sheet of all pages.
const STYLE: &str = include_str!("page.css");
/// Script for filters, viewers and charts.
const SCRIPT: &str = include_str!("page.js");
/// Content security policy of all pages.
const POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:";

/// Returns a complete page: `title` is text, `body` is HTML.
pub fn page(title: &str, body: &str) -> String {
    let title = escape(title);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n\
         <body>\n<main>\n{body}</main>\n<script>\n{SCRIPT}</script>\n</body>\n</html>\n"
    )
}

/// Escapes text for HTML, also within quotes of either kind.
pub fn escape(text: &str) -> String {
    let mut html = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => html.push_str("&amp;"),
            '<' => html.push_str("&lt;"),
            '>' => html.push_str("&gt;"),
            '"' => html.push_str("&quot;"),
            '\'' => html.push_str("&#39;"),
            _ => html.push(character),
        }
    }
    html
}

/// Returns a list of names and values, one pair per line; values are HTML.
pub fn facts(pairs: &[(&str, String)]) -> String {
    let lines = pairs
        .iter()
        .map(|(name, value)| format!("<dt>{}</dt><dd>{value}</dd>\n", escape(name)));
    format!("<dl class=\"facts\">\n{}</dl>\n", lines.collect::<String>())
}

/// Returns tiles of a large number with a word below each; the third value is the tile's CSS class.
pub fn numbers(all: &[(String, &str, &str)]) -> String {
    let tiles = all.iter().map(|(number, word, class)| {
        format!(
            "<div class=\"tile {class}\"><b>{}</b><span>{}</span></div>\n",
            escape(number),
            escape(word)
        )
    });
    format!("<div class=\"tiles\">\n{}</div>\n", tiles.collect::<String>())
}

/// Returns an image with a caption below it; `content` and `words` are HTML.
pub fn figure(content: &str, words: &str) -> String {
    format!("<figure>{content}<figcaption>{words}</figcaption></figure>\n")
}

/// Returns a form with a search field and a check box for each of the `verdicts` (CSS class and word), which filters
/// elements with `data-verdict` and `data-item`.
pub fn filter(verdicts: &[(&str, &str)]) -> String {
    let boxes = verdicts.iter().map(|(class, word)| {
        format!(
            "<label><input type=\"checkbox\" value=\"{class}\" checked> \
             <span class=\"badge {class}\">{word}</span></label>\n"
        )
    });
    format!(
        "<form class=\"filter\" role=\"search\">\n\
         <input type=\"search\" placeholder=\"Filter by name, path or words\" aria-label=\"Filter\">\n{}\
         <output></output>\n</form>\n",
        boxes.collect::<String>()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_escaped() {
        assert_eq!(
            escape("a<b> & \"c\" 'd'"),
            "a&lt;b&gt; &amp; &quot;c&quot; &#39;d&#39;"
        );
        let page = page("</title><script>", "<p>x</p>");
        assert!(
            page.contains("<title>&lt;/title&gt;&lt;script&gt;</title>"),
            "{page}"
        );
    }

    #[test]
    fn page_refers_to_no_external_resource() {
        let page = page("a", "");
        for word in ["http:", "https:", "src=", "href=", "@import", "url("] {
            assert!(!page.contains(word), "{word}");
        }
        assert!(page.contains("prefers-color-scheme: dark") && page.contains("@media print"));
    }
}
