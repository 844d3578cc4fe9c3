//! Complete page with its style, script, description and content security policy.

use serde_json::json;

use super::element::PageElement;

/// Style sheet of all pages.
const STYLE: &str = include_str!("page.css");
/// Script that draws a page from its description.
const SCRIPT: &str = include_str!("page.js");
/// Content security policy of all pages.
const POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:";

/// Returns a complete page, whose script draws the `elements` below a heading.
pub fn page(title: &str, heading: &str, elements: &[PageElement]) -> String {
    let description = json!({ "heading": heading, "elements": elements }).to_string();
    // Keep text from ending the script element
    let description = description.replace('<', "\\u003c");
    let title = title.replace('&', "&amp;").replace('<', "&lt;");
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n\
         <body>\n<main>\n<noscript><p>This page needs JavaScript.</p></noscript>\n</main>\n\
         <script type=\"application/json\" id=\"description\">{description}</script>\n\
         <script>\n{SCRIPT}</script>\n</body>\n</html>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_end_the_title_or_the_description() {
        let page = page("</title><script>", "</script><b>", &[]);
        assert!(page.contains("<title>&lt;/title>&lt;script></title>"), "{page}");
        assert!(page.contains(r#""heading":"\u003c/script>\u003cb>""#), "{page}");
        assert!(!page.contains("<b>"), "{page}");
    }

    #[test]
    fn page_refers_to_no_external_resource() {
        let page = page("a", "b", &[]);
        for word in ["http:", "https:", "src=", "href=", "@import", "url("] {
            assert!(!page.contains(word), "{word}");
        }
        assert!(page.contains("prefers-color-scheme: dark") && page.contains("@media print"));
    }
}
