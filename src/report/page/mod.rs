//! Pages of measurements: one HTML file each, with nothing to load beside it.
//!
//! A page looks well on dark and light screens, narrow ones too, and on paper. It may run its own script and style only,
//! and show pictures that it holds: its policy forbids everything else, so no page ever asks a network.

mod axis;
mod bars;
mod chart;
mod drawing;
mod plot;
mod stacks;
mod table;
mod tornado;
mod viewer;

pub use axis::LogAxis;
pub use bars::{Bars, Group, Length};
pub use chart::{Chart, Line, Look, Series, Spot};
pub use drawing::{Drawing, Region};
pub use plot::{Mark, Plot};
pub use stacks::{Stack, Stacks};
pub use table::{Cell, Column, Table};
pub use tornado::{Bar, End, Row, Tornado};
pub use viewer::{View, picture, viewer};

/// How pages look.
const STYLE: &str = include_str!("page.css");
/// What makes their filters and viewers work.
const SCRIPT: &str = include_str!("page.js");
/// What pages may load.
const POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:";

/// A whole page: `title` is text, `body` is HTML.
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

/// Text as HTML, also within quotes of either kind.
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

/// Names and what they stand for, each pair a line; values are HTML.
pub fn facts(pairs: &[(&str, String)]) -> String {
    let lines = pairs
        .iter()
        .map(|(name, value)| format!("<dt>{}</dt><dd>{value}</dd>\n", escape(name)));
    format!("<dl class=\"facts\">\n{}</dl>\n", lines.collect::<String>())
}

/// Large numbers with a word below each, the first with that class.
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

/// A picture with a line of words below it; `picture` and `words` are HTML.
pub fn figure(picture: &str, words: &str) -> String {
    format!("<figure>{picture}<figcaption>{words}</figcaption></figure>\n")
}

/// A search field and boxes to tick, one for each of the `verdicts` (its class and its word), for what carries
/// `data-verdict` and `data-item`.
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
    fn text_cannot_leave_its_place() {
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
    fn a_page_names_nothing_that_would_have_to_be_loaded() {
        let page = page("a", "");
        for word in ["http:", "https:", "src=", "href=", "@import", "url("] {
            assert!(!page.contains(word), "{word}");
        }
        assert!(page.contains("prefers-color-scheme: dark") && page.contains("@media print"));
    }
}
