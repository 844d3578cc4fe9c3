//! HTML elements that pages share, and the escaping of text.

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
