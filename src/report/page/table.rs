//! Tables of pages: rows that a filter may hide.

use super::escape;
use crate::report::table::in_groups;

/// A column and how its cells stand.
#[derive(Clone, Copy, Debug)]
pub enum Column<'a> {
    /// Words, from the left.
    Words(&'a str),
    /// Numbers, from the right.
    Numbers(&'a str),
}

/// A cell, as HTML.
#[derive(Clone, Debug, Default)]
pub struct Cell {
    html: String,
    /// Whether its words may go on in another line.
    wraps: bool,
}

impl Cell {
    fn of(html: String) -> Cell {
        Cell { html, wraps: false }
    }

    /// Plain text in one line.
    pub fn text(text: &str) -> Cell {
        Cell::of(escape(text))
    }

    /// Plain text of several words, in as many lines as it takes.
    pub fn wrapped(text: &str) -> Cell {
        Cell {
            html: escape(text),
            wraps: true,
        }
    }

    /// Plain text of which as much is shown as has room in one line; the rest is told where one points at it.
    pub fn short(text: &str) -> Cell {
        let text = escape(text);
        Cell::of(format!("<span class=\"short\" title=\"{text}\">{text}</span>"))
    }

    /// A value and, fainter, where it may lie.
    pub fn with_range(value: &str, range: &str) -> Cell {
        Cell::of(format!(
            "{} <span class=\"faint\">{}</span>",
            escape(value),
            escape(range)
        ))
    }

    /// A number with thin gaps between its thousands.
    pub fn count(number: u64) -> Cell {
        Cell::of(grouped(number))
    }

    /// A word on a ground of the colour of its class, that leads to the element of that name on the page.
    pub fn badge_link((word, class): (&str, &str), to: &str) -> Cell {
        Cell::of(format!(
            "<a class=\"badge {class}\" href=\"#{}\">{}</a>",
            escape(to),
            escape(word)
        ))
    }

    /// Text that leads to the element of that name on the page.
    pub fn link(text: &str, to: &str) -> Cell {
        Cell::of(format!("<a href=\"#{}\">{}</a>", escape(to), escape(text)))
    }

    /// A word on a ground of the colour of its class.
    pub fn badge(word: &str, class: &str) -> Cell {
        Cell::of(format!("<span class=\"badge {class}\">{}</span>", escape(word)))
    }
}

/// A table in the making.
#[derive(Clone, Debug)]
pub struct Table<'a> {
    columns: Vec<Column<'a>>,
    rows: String,
}

impl<'a> Table<'a> {
    /// One without rows.
    pub fn new(columns: &[Column<'a>]) -> Table<'a> {
        Table {
            columns: columns.to_vec(),
            rows: String::new(),
        }
    }

    /// Adds a row that a filter knows by `verdict` and that belongs to the `item` of the page that has a section.
    pub fn row(&mut self, (verdict, item): (&str, &str), cells: &[Cell]) {
        let cells = cells
            .iter()
            .zip(&self.columns)
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

    /// The whole table, which scrolls by itself where it is too wide.
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

/// A number with thin, unbroken gaps between its thousands.
fn grouped(number: u64) -> String {
    in_groups(number).replace(' ', "\u{202f}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_keeps_its_numbers_to_the_right_and_its_words_as_they_are() {
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
