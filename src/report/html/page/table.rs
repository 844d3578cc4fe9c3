//! Tables of HTML pages, with rows that a filter can hide.

use super::elements::escape;
use crate::report::text::table::group_thousands;

/// Column with its heading and alignment.
#[derive(Clone, Copy, Debug)]
pub enum Column<'a> {
    /// Text column, aligned to the left.
    Words(&'a str),
    /// Number column, aligned to the right.
    Numbers(&'a str),
}

/// Table cell as HTML.
#[derive(Clone, Debug, Default)]
pub struct Cell {
    html: String,
    /// True if the text may wrap into further lines.
    wraps: bool,
}

impl Cell {
    fn of(html: String) -> Cell {
        Cell { html, wraps: false }
    }

    /// Returns a cell of plain text in one line.
    pub fn text(text: &str) -> Cell {
        Cell::of(escape(text))
    }

    /// Returns a cell of plain text that wraps into several lines.
    pub fn wrapped(text: &str) -> Cell {
        Cell {
            html: escape(text),
            wraps: true,
        }
    }

    /// Returns a cell of plain text that is cut off at one line; the tooltip has the complete text.
    pub fn short(text: &str) -> Cell {
        let text = escape(text);
        Cell::of(format!("<span class=\"short\" title=\"{text}\">{text}</span>"))
    }

    /// Returns a cell of a value with its range in a fainter colour.
    pub fn with_range(value: &str, range: &str) -> Cell {
        Cell::of(format!(
            "{} <span class=\"faint\">{}</span>",
            escape(value),
            escape(range)
        ))
    }

    /// Returns a cell of a number with narrow spaces between thousands.
    pub fn count(number: u64) -> Cell {
        Cell::of(grouped(number))
    }

    /// Returns a word in the colour of its class that links to the element `to` of the page.
    pub fn badge_link((word, class): (&str, &str), to: &str) -> Cell {
        Cell::of(format!(
            "<a class=\"badge {class}\" href=\"#{}\">{}</a>",
            escape(to),
            escape(word)
        ))
    }

    /// Returns text that links to the element `to` of the page.
    pub fn link(text: &str, to: &str) -> Cell {
        Cell::of(format!("<a href=\"#{}\">{}</a>", escape(to), escape(text)))
    }

    /// Returns a word on a background in the colour of its class.
    pub fn badge(word: &str, class: &str) -> Cell {
        Cell::of(format!("<span class=\"badge {class}\">{}</span>", escape(word)))
    }
}

/// Table under construction: columns and finished rows.
#[derive(Clone, Debug)]
pub struct Table<'a> {
    columns: Vec<Column<'a>>,
    rows: String,
}

impl<'a> Table<'a> {
    /// Returns a table without rows.
    pub fn new(columns: &[Column<'a>]) -> Table<'a> {
        Table {
            columns: columns.to_vec(),
            rows: String::new(),
        }
    }

    /// Adds a row with `verdict` as its key for the filter; `item` is the page's section that the row belongs to.
    pub fn row(&mut self, (verdict, item): (&str, &str), cells: &[Cell]) {
        let cells = cells
            .iter()
            .zip(&self.columns)
            // Only text columns wrap
            .map(|(cell, column)| match column {
                Column::Words(_) if cell.wraps => format!("<td class=\"wrap\">{}</td>", cell.html),
                Column::Words(_) => format!("<td>{}</td>", cell.html),
                Column::Numbers(_) => format!("<td class=\"number\">{}</td>", cell.html),
            });
        self.rows += &format!(
            "<tr data-verdict=\"{}\" data-item=\"{}\">{}</tr>\n",
            escape(verdict),
            escape(item),
            cells.collect::<String>()
        );
    }

    /// Returns the complete table, which scrolls horizontally where it is too wide.
    pub fn html(&self, class: &str) -> String {
        let head = self.columns.iter().map(|column| match column {
            Column::Words(name) => format!("<th scope=\"col\">{}</th>", escape(name)),
            Column::Numbers(name) => format!("<th scope=\"col\" class=\"number\">{}</th>", escape(name)),
        });
        format!(
            "<div class=\"scroll\"><table class=\"{class}\">\n<thead><tr>{}</tr></thead>\n\
             <tbody>\n{}</tbody>\n</table></div>\n",
            head.collect::<String>(),
            self.rows
        )
    }
}

/// Formats a number with narrow no-break spaces between thousands.
fn grouped(number: u64) -> String {
    group_thousands(number).replace(' ', "\u{202f}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn row_aligns_numbers_and_escapes_text() {
        let mut table = Table::new(&[Column::Words("path"), Column::Numbers("rays")]);
        table.row(("holds", "H01"), &[Cell::text("<b>"), Cell::count(1_234_567)]);
        let html = table.html("checks");
        assert!(html.contains(
            "<tr data-verdict=\"holds\" data-item=\"H01\"><td>&lt;b&gt;</td>\
             <td class=\"number\">1\u{202f}234\u{202f}567</td></tr>"
        ));
        assert!(html.contains("<th scope=\"col\" class=\"number\">rays</th>"));
    }
}
